"""The diagnosis: data checks, fit, place of the gap, search, held-out proof, verdict."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Record
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import Store
from feltmb.fit.model import Effect, Model
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import SegmentedRecord, segment_record
from feltmb.fit.solve import Fit, FitSettings, finish, fit_problem, polish, with_variability
from feltmb.fit.watch import FIT, PROOF, REPORT, SEARCH, Tell, Watch, current, watching
from feltmb.gap.acceptance import Accepted, accept, refutes, shapley
from feltmb.gap.assemble import closest_set, how_far_rows, ranked, with_effects
from feltmb.gap.calibrate import calibrate, largest_statistic
from feltmb.gap.checks import (
    DataChecks,
    check_against,
    check_records,
    with_sigma,
    without_constant,
    without_copies,
)
from feltmb.gap.components import component_table
from feltmb.gap.criteria import (
    CLOSE_ALARM,
    COLOR_GAIN,
    EXCESS,
    GIVEN_SIGMA,
    REST_EXCESS,
    WIDE_GAP,
)
from feltmb.gap.decide import Facts, decide
from feltmb.gap.discrepancy import (
    color_of_discrepancy,
    converged,
    discrepancy_of,
    noise_factors,
    with_color,
    with_factor,
    with_noise,
)
from feltmb.gap.experiments import advise
from feltmb.gap.findings import Advice, NotTested, Profile, Verdict, Where
from feltmb.gap.lead import lead
from feltmb.gap.misfit import form_of, misfit
from feltmb.gap.options import Options
from feltmb.gap.overlay import wrong_units
from feltmb.gap.profile import profile_of
from feltmb.gap.proof import HeldOut, Outcome, residuals_by_segment
from feltmb.gap.refine import (
    CandidateSet,
    full_evidence,
    refit_at,
    tighten,
    worth_of,
)
from feltmb.gap.report import Report
from feltmb.gap.score import all_candidates, family_threshold, score_fit
from feltmb.gap.search import (
    Search,
    at_its_variability,
    in_refined_steps,
    search,
    with_larger_noise,
)
from feltmb.gap.sizes import Sizes
from feltmb.gap.smoke_test import try_effects
from feltmb.gap.split import split_records
from feltmb.gap.steps import next_steps
from feltmb.gap.stopped import cut_short, left_out
from feltmb.gap.tabulated import (
    as_it_is,
    calibrated_rows,
    fitted_starts,
    found_starts,
    given_values,
    moved_together,
    tabulated_outcome,
)
from feltmb.gap.tolerance import (
    besides_tolerances,
    beyond_prior,
    more_of_tolerances,
    prior_deviations_told,
    refuted_tolerances,
    released,
    within_tolerance,
    without_several,
)
from feltmb.gap.where import event_ledger, first_act, ledger, split_gap

__all__ = ["diagnose", "fit_model", "prepare"]

Progress = Callable[[str, int, int], None]
#: Number of times that the unexplained residual is estimated again.
ROUNDS = 4


def _ready(
    model: Model, records: Sequence[Record], hold_out: Sequence[str] = ()
) -> tuple[Model, tuple[Record, ...], DataChecks, tuple[str, ...]]:
    """Prepare the model and the records; also return the data checks and notes about copies.

    ``hold_out``: names of records that are kept if they have a copy.

    Raises
    ------
    DataError
        The faults because of which the records cannot be used, all in one message.
    """
    records, copies = without_copies(records, hold_out)
    records, inputs = model.driven(records)
    records, constant = without_constant(records, model.outputs)
    checks = check_against(model, records)
    ready = model.ready([with_sigma(r, checks.noise(r.name)) for r in records])
    # A model may increase the noise of a sensor to the error of its own outputs.
    known = {r.name: r.sensors for r in ready.records}
    channels = [
        replace(c, sigma=max(c.sigma, known[c.record][c.channel].sigma or 0.0))
        for c in checks.channels
    ]
    warnings = (*copies, *inputs, *constant, *checks.warnings, *ready.notes)
    checks = replace(checks, channels=tuple(channels), warnings=warnings)
    return ready.model, ready.records, checks, copies


def prepare(
    model: Model, records: Sequence[Record], checks: DataChecks, segment: float | None
) -> tuple[SegmentedRecord, ...]:
    """Cut records into segments, with the noise of the data checks."""
    return tuple(segment_record(model, r, checks.noise(r.name), segment) for r in records)


def _usable(model: Model, effects: Sequence[Effect]) -> tuple[list[Effect], list[NotTested]]:
    """Effects that the model can simulate, and why the others cannot be tested."""
    names = [e.name for e in effects]
    doubled = sorted({n for n in names if names.count(n) > 1})
    if doubled:
        raise InvalidParameter(f"effects: the name {', '.join(doubled)} is used twice")
    good, bad = [], []
    own = {t.name: t for t in model.own_effects}
    for e in effects:
        if e.observe is None and e.excite is None and not model.accepts(e):
            why = f"the model {model.name} cannot simulate it"
            if e.name in own:
                given = own[e.name].shape
                told = f"{given:.3g}" if isinstance(given, float) else str(given)
                shape = f", with the shape {told}" if len(e.shapes) > 1 else ""
                why = f"it is a parameter of the model{shape}"
            bad.append(NotTested(name=e.name, why=why))
        else:
            good.append(e)
    return good, bad


def _investigate(
    model: Model,
    segmented_records: tuple[SegmentedRecord, ...],
    effects: Sequence[Effect],
    options: Options,
    settings: FitSettings,
    store: Store | None,
    progress: Progress | None,
    known: Search | None = None,
) -> Search:
    """Fit the model and search for effects, with the noise of the segmented records.

    ``known``: a search with much less noise. The fit starts from the fit of that search, and from
    the priors only if the first start does not explain the records. The new search starts with the
    best set of each size of that search.
    """
    problem, label = Problem(model, segmented_records, store=store), "the model alone"
    watch = current()
    watch.misfit = None  # the noise has changed, and so has the scale
    watch.enter(FIT)
    if known is None:
        led = lead(problem, effects, settings, most=options.max_effects, progress=progress)
        fit = _alone(led, problem, settings, progress, label)
    else:
        led = _best_of_each_size(known, problem)
        point = replace(known.model_fit.point, memo={})
        brief = replace(settings, restarts=0)
        fit = fit_problem(problem, brief, point=point, progress=progress, label=label)
    if fit is None or (known is not None and not fit.explains):
        way = settings if fit is None else replace(settings, restarts=0)
        other = fit_problem(problem, way, progress=progress, label=label)
        fit = other if fit is None or other.log_evidence > fit.log_evidence else fit
    if not watch.stopping():
        fit = without_several(fit, settings)
    if known is None:
        fit = with_variability(fit, settings)
        led = [f.in_problem(replace(f.problem, model=fit.problem.model)) for f in led]
    watch.fitted(fit.chi2 / fit.dof)
    watch.enter(SEARCH)
    found = search(
        fit,
        effects,
        replace(settings, restarts=0),
        most=options.max_effects,
        width=options.width,
        progress=progress,
        led=led,
    )
    if watch.stopping():
        return found
    found = at_its_variability(found, settings, progress=progress)
    return within_tolerance(in_refined_steps(found, settings, progress=progress), settings)


def _best_of_each_size(known: Search, problem: Problem) -> list[Fit]:
    """The best set of each size of a search that beats the model, as starts in another problem."""
    best: dict[int, Fit] = {}
    for c in known.sets:
        if c.evidence > known.model_evidence:
            best.setdefault(len(c.names), c.fit)
    return [fit.in_problem(problem.with_candidates(fit.included)) for fit in best.values()]


def _alone(
    led: Sequence[Fit],
    problem: Problem,
    settings: FitSettings,
    progress: Progress | None,
    label: str,
) -> Fit | None:
    """The fit of the model alone; None: ``lead`` gave no fits.

    No further starts are tried in two cases: the model explains the records, or a set of effects
    explains them and the model alone, started there, does not.
    """
    if not led:
        return None
    (alone,) = [f for f in led if not f.included]
    if led[0].included and led[0].plausible and alone.cost > worth_of(led[0]):
        return alone
    if alone.plausible:
        return polish(problem, replace(alone.point, memo={}), 1.0, settings)
    return fit_problem(
        problem, settings, point=replace(alone.point, memo={}), progress=progress, label=label
    )


def _explained(
    first: Search,
    found: Search,
    effects: Sequence[Effect],
    settings: FitSettings,
    checks: DataChecks,
    options: Options,
    progress: Progress | None,
) -> Search | None:
    """The first search with the set found with an unexplained residual, if it explains the records.

    If the model is far from the records, linear scores may miss a cause that explains everything.
    """
    if found.best is None:
        return None
    base, near = first.model_fit, found.best.fit
    problem = base.problem.with_candidates(near.included)
    fit = refit_at(problem, replace(near.point, memo={}), base.level, settings, patient=True)
    best = CandidateSet(fit, full_evidence(fit, sum(e.weight for e in effects)))
    if first.best is not None and not best.evidence > first.best.evidence:
        return None
    allowed = form_of(best.evidence - first.tight_evidence, options.form)
    tight = tighten(fit, settings)
    if misfit(fit, tight, estimated=checks.estimated, bar=REST_EXCESS, allowed=allowed).left:
        return None
    others = tuple(c for c in first.sets if c.key != best.key)
    whole = replace(first, sets=(best, *others))
    return within_tolerance(in_refined_steps(whole, settings, progress=progress), settings)


@checked
def diagnose(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record] | Record,
    hold_out: Sequence[str] | str | None = None,
    options: Options | None = None,
    progress: Tell | None = None,
    *,
    budget: float | None = None,
    stop: Callable[[], bool] | None = None,
) -> Report:
    """Diagnose the gap between a model and measurements: its place, its cause, and its reduction.

    Parameters
    ----------
    model
        The model; see :class:`feltmb.fit.Model`.
    effects
        Candidate causes that the model lacks; with magnitude zero, each is exactly the model.
    records
        Measured runs.
    hold_out
        Names of the held-out records, which are used for the proof only. None: the records with the
        role "held_out"; if there are none, some are chosen (see :func:`split_records`).
    options, progress
        ``progress(p)`` is called now and then, from any thread, with a
        :class:`feltmb.fit.Progress`.
    budget
        Time limit [s]. The report then has the best result so far and lists what was not tried.
        Fits stop after four fifths of the time, and the held-out proof follows. Simulations that
        have started are completed, so that the limit may be exceeded by a few simulations.
    stop
        Function that is called now and then; when it returns True, the diagnosis ends as if the
        time limit were reached.

    Raises
    ------
    DataError, InvalidParameter
        Records or arguments are invalid.
    """
    if budget is not None and not budget > 0.0:
        raise InvalidParameter(f"budget = {budget!r} s, expected > 0")
    options = options or Options()
    if isinstance(records, Record):
        records = [records]
    watch = Watch(progress, budget, stop)
    with watching(watch):
        report = _diagnosed(model, effects, records, hold_out, options, watch)
        watch.say("done")
    return report


def _diagnosed(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    hold_out: Sequence[str] | str | None,
    options: Options,
    watch: Watch,
) -> Report:
    progress = watch.say
    seconds: dict[str, float] = {}
    tick = clock.perf_counter()

    def lap(stage: str) -> None:
        nonlocal tick
        now = clock.perf_counter()
        seconds[stage] = seconds.get(stage, 0.0) + now - tick
        tick = now

    watch.enter(watch.stage)
    model.forget()
    named = [hold_out] if isinstance(hold_out, str) else hold_out or ()
    model, records, whole, copies = _ready(model, records, named)
    fit_records, held_records = split_records(
        records, hold_out, masked=model.from_rest, left_out=copies
    )
    checks = _inherit(check_records([*fit_records, *held_records], model.outputs), whole, records)
    if checks.problems:
        raise DataError("records: " + "; ".join(checks.problems))
    checks = _floored(checks, options.good_enough, model)
    exposed = getattr(model, "effects", ())
    offered = [e.name for e in exposed if isinstance(e, Effect)]
    if offered and not effects:
        checks = replace(
            checks,
            warnings=(
                *checks.warnings,
                f"no effect was given, but the model exposes {', '.join(offered)}: pass "
                "effects=model.effects to have them tested",
            ),
        )
    segmented_records = prepare(model, fit_records, checks, options.segment)
    held_segmented_records = prepare(model, held_records, checks, options.segment)
    lap("data checks")

    settings = options.fit or FitSettings(restarts=options.restarts, seed=options.seed)
    store = None if options.resume is None else Store(options.resume)
    usable, not_tested = _usable(model, effects)
    try_effects(model, usable, fit_records[0])
    sensed = held_segmented_records
    watch.say("gap as it is")
    tabulated = tabulated_outcome(
        model, (*segmented_records, *sensed), settings, options.segmented_level
    )
    metric = "segmented" if model.chaotic else "open_loop"
    _check_units(model, tabulated, metric)
    lap("gap as it is")
    first = _investigate(model, segmented_records, usable, options, settings, store, progress)
    model = first.model_fit.problem.model
    color = None
    if not (checks.estimated or watch.stopping()):
        color = _recolored(first, segmented_records, settings, store)
    if color is not None:
        checks = _with_color(checks, color)
        segmented_records = tuple(with_color(model, s, color) for s in segmented_records)
        sensed = held_segmented_records = tuple(
            with_color(model, s, color) for s in held_segmented_records
        )
        first = _investigate(model, segmented_records, usable, options, settings, store, progress)
        model = first.model_fit.problem.model
    rescaled = None if watch.stopping() else _rescaled(first, segmented_records, checks)
    if rescaled is not None:
        factor, segmented_records = rescaled
        checks = _with_factor(checks, factor)
        sensed = held_segmented_records = tuple(
            with_factor(model, s, factor) for s in held_segmented_records
        )
        first = with_larger_noise(first, segmented_records, settings, progress=progress)
        first = at_its_variability(first, settings, progress=progress)
        first = within_tolerance(in_refined_steps(first, settings, progress=progress), settings)
        model = first.model_fit.problem.model
    found, rest_noise = first, None
    plain = segmented_records
    for _ in range(ROUNDS):
        new = None if watch.stopping() else discrepancy_of(found, plain, settings)
        if new is None or (rest_noise is not None and converged(rest_noise, new)):
            break
        # The library does not explain all of the gap: effects must now be better than the
        # unexplained residual, which shrinks with every effect that is found.
        before = (found, rest_noise, segmented_records, held_segmented_records)
        rest_noise = new
        segmented_records = tuple(with_noise(model, s, new) for s in plain)
        held_segmented_records = tuple(with_noise(model, s, new) for s in sensed)
        found = _investigate(
            model, segmented_records, usable, options, settings, store, progress, found
        )
        if watch.stopping():  # the previous search is complete
            found, rest_noise, segmented_records, held_segmented_records = before
        model = found.model_fit.problem.model
    if rest_noise is not None and not watch.stopping():
        clean = _explained(first, found, usable, settings, checks, options, progress)
        if clean is not None:
            found, rest_noise, segmented_records, held_segmented_records = (
                clean,
                None,
                plain,
                sensed,
            )
            model = found.model_fit.problem.model
    lap("which")
    skipped = left_out(found, usable) if found.skipped else ()
    watch.enter(PROOF)
    scale = found.model_fit.problem.state_scale
    held = HeldOut(held_segmented_records, np.zeros(0) if scale is None else scale, sensed)

    def proven(search: Search) -> Accepted:
        return accept(
            search,
            held,
            settings,
            options,
            discrepancy=rest_noise is not None,
            progress=progress,
        )

    accepted = proven(found)
    more = more_of_tolerances(accepted.best, beyond_prior(found.model_fit))
    if not more and rest_noise is None and not watch.over():
        free = released(found, settings, estimated=checks.estimated)
        again = None if free is None else proven(free)
        if free is not None and again is not None and not refutes(accepted, again, held):
            found = first = free
            accepted = again
    for name, why in found.failed:
        not_tested.append(NotTested(name=name, why=why))
    blind = [
        t for t, ok in zip(found.scores.candidates, found.scores.testable, strict=True) if not ok
    ]
    for e in usable:
        if all(t in blind for t in found.scores.candidates if t.effect is e):
            not_tested.append(
                NotTested(
                    name=e.name,
                    why="parameters, start states and sensor errors can reproduce its whole "
                    "signature in these records",
                )
            )
    not_tested += skipped
    fit = found.model_fit
    checks = replace(checks, warnings=(*checks.warnings, *refuted_tolerances(fit)))
    lap("how far")
    watch.say("where the gap lies")
    # The place of the gap is determined with the noise of the sensors: an unexplained residual that
    # counts as noise would hide it.
    tight = None if model.chaotic else first.tight_fit
    seen = tight or first.bare
    cells, onset = ledger(seen)
    events = event_ledger(seen)
    components = component_table(first.bare, tight)
    where = Where(
        ledger=cells, events=events, components=components, onset=onset, split=split_gap(seen)
    )
    lap("where")

    which_gap = _primary(model, accepted, sensed)
    shares: dict[str, float] = {}
    if not watch.over():
        shares = shapley(
            found,
            accepted,
            held,
            settings,
            which=which_gap,
            segmented_level=options.segmented_level,
            progress=progress,
        )
    lap("how far")
    # With its most likely continuity defects: the tightest ones would turn errors in the form of a
    # law, which the allowance permits, into scores of effects.
    judged = besides_tolerances(fit, usable)
    reference = found.scores.among(judged)
    bar, maxima = family_threshold(reference, options.alpha, seed=options.seed)
    # A correction can only raise the threshold. It matters only for a score slightly above the
    # threshold, and only if there is no other evidence against the model.
    bare_misfit = misfit(first.bare, first.tight_fit, estimated=checks.estimated)
    alarm = largest_statistic(
        found,
        reference,
        maxima,
        settings,
        confirm=accepted.best is None and not bare_misfit.left,
        progress=progress,
    )
    close = bar < alarm < CLOSE_ALARM * bar and not bare_misfit.left
    null = calibrate(
        fit,
        reference,
        judged,
        options.alpha,
        options.bootstrap if close and not watch.over() else 0,
        seed=options.seed,
        progress=progress,
    )
    rest = accepted.tightest
    leftover = 0.0
    if accepted.best is not None:
        others = all_candidates(usable, accepted.best.names)
        if others:
            after = score_fit(rest or accepted.best.fit, others)
            limit, _ = family_threshold(after, options.alpha, seed=options.seed)
            # The robust score must be significant too: a single segment is not a trend.
            both = np.minimum(after.singles(), after.robust())
            form = form_of(accepted.best.evidence - found.tight_evidence, options.form)
            least = max(limit, 2.0 * form)
            leftover = float(np.max(both) / least) if np.isfinite(limit) else 0.0
    lap("null")
    if accepted.best is not None:
        where = replace(
            where,
            onset={**where.onset, **first_act(accepted.best.fit)},
            remains=ledger(_with_other_noise(rest or accepted.best.fit, plain))[0],
        )
    beyond = None
    if not watch.over() and (accepted.best is not None or not bare_misfit.left):
        alone = Problem(model, held_segmented_records, store=store)
        beyond = _beyond(accepted, alone, settings, checks, options.form, watch.say)
    lap("how far")
    watch.enter(REPORT)
    best_fit = found.model_fit if accepted.best is None else accepted.best.fit
    held_tabulated = tabulated.part(slice(len(plain), None))
    how_far = how_far_rows(accepted, held_tabulated, sensed, shares, which_gap, options.seed)
    end = rest or (found.tight_fit if accepted.best is None else None) or best_fit
    there = replace(end, problem=replace(end.problem, segmented_records=plain))
    fitted = Outcome(there, np.zeros(0), settings, options.segmented_level, there)
    calibrated = calibrated_rows(
        best_fit, [tabulated], [fitted, accepted.after], which_gap, options.alpha
    )
    given = given_values(best_fit, options.alpha)
    closest = closest_set(found, accepted, sensed, which_gap, options.seed)
    sizes = Sizes(found, accepted, options.form)
    facts = Facts(
        checks=checks,
        search=found,
        accepted=accepted,
        belief=accepted.belief,
        p=null.p(alarm),
        options=options,
        how_far=how_far,
        where=where,
        rest=rest,
        first=first,
        misfit=bare_misfit,
        unexplained=rest_noise is not None,
        leftover=leftover,
        beyond=beyond,
        apart=moved_together(best_fit, options.alpha),
        calibrated=calibrated,
        given=given,
        closest=closest,
        sizes=sizes,
        enough=bool(options.good_enough) and _within(first.tight_fit or first.bare),
        enough_left=bool(options.good_enough) and _within(rest or best_fit),
    )
    decision = decide(facts)
    if watch.why:
        decision = cut_short(decision, watch, found, skipped, len(usable), sizes)
    told = prior_deviations_told(fit if accepted.best is None else accepted.best.fit)
    if told:
        checks = replace(checks, warnings=(*checks.warnings, told))
    which = ranked(found, accepted, decision.belief, null, decision.named, decision.one_of, sizes)
    lap("verdict")
    advice: tuple[Advice, ...] = ()
    answered = decision.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    if options.advice and not answered and not watch.over():
        if accepted.rivals:
            watch.say("next experiment")
        advice = advise(found, accepted)
    lap("next")
    rows = as_it_is(tabulated, metric)
    advice += next_steps(
        decision.verdict,
        rows,
        calibrated,
        [r for r in which.effects if r.named],
        [r for r in which.effects if r.effect in decision.one_of],
        decision.closest,
        components,
        best_fit.intervals(),
    )
    provenance = _provenance(best_fit, records)
    starts = found_starts(accepted.after.tight) | fitted_starts(best_fit, rest, settings)
    before_starts = found_starts(accepted.before.tight) | fitted_starts(
        found.model_fit, found.tight_fit, settings
    )
    plain_fit = tabulated.fit
    profiles: tuple[Profile, ...] = ()
    no_profile = ""
    if options.profile:
        if accepted.best is None or not decision.named:
            no_profile = "no effect is named"
        elif watch.over():
            no_profile = watch.why
        else:
            best = accepted.best.fit
            profiles = tuple(profile_of(best, n, settings, progress) for n in decision.named)
        lap("profile")
    return Report(
        verdict=decision.verdict,
        statement=decision.statement,
        named=decision.named,
        one_of=decision.one_of,
        confidence=decision.confidence,
        as_it_is=rows,
        calibrated=calibrated,
        given=given,
        closest=decision.closest,
        where=where,
        which=which,
        how_far=how_far,
        next=advice,
        model=with_effects(model, best_fit, starts, provenance),
        fitted=with_effects(model, found.model_fit, before_starts, provenance),
        tabulated=with_effects(model, plain_fit, found_starts(plain_fit), provenance),
        not_tested=tuple(not_tested),
        refused=tuple(NotTested(name=n, why=w) for n, w in accepted.rejected),
        fit=fit,
        checks=checks,
        profiles=profiles,
        no_profile=no_profile,
        seconds=seconds,
        stopped=f"{watch.stopped_in} ({watch.why})" if watch.why else "",
    )


def _check_units(model: Model, tabulated: Outcome, metric: str) -> None:
    """Raise an error if records are in a different unit than stated: no fit would be useful."""
    records = tabulated.fit.problem.segmented_records
    runs = [
        (s.record, rest, {n: x.sigma for n, x in zip(model.outputs, s.noise, strict=True)})
        for s, rest in zip(records, getattr(tabulated, metric), strict=True)
    ]
    wrong = wrong_units(model, runs)
    if wrong:
        raise DataError(
            f"DATA PROBLEM: the unit of {wrong}. Specify the true unit: --unit CHANNEL=UNIT, "
            "unit in the TOML file, in Python units of ReadOptions; feltmb gap check shows model "
            "and record"
        )


def _inherit(checks: DataChecks, whole: DataChecks, records: Sequence[Record]) -> DataChecks:
    """Blocks of a record inherit the noise that was found for the whole record."""
    by_name = {(c.record, c.channel): c for c in whole.channels}
    channels = []
    for c in checks.channels:
        parent = by_name.get((c.record, c.channel))
        if parent is None:
            base = next(r.name for r in records if c.record.startswith(r.name + "["))
            parent = by_name[base, c.channel]
        channels.append(
            replace(
                c,
                sigma=parent.sigma,
                method=parent.method,
                correlation_time=parent.correlation_time,
                averaged=parent.averaged,
                quantum=parent.quantum,
                white=parent.white,
            )
        )
    return replace(
        checks,
        channels=tuple(channels),
        warnings=whole.warnings,
        problems=whole.problems,
        repeatability=whole.repeatability,
        estimated=whole.estimated,
    )


def _floored(checks: DataChecks, floors: Mapping[str, float], model: Model) -> DataChecks:
    """The data checks with the practical accuracy added to the noise of some channels."""
    if not floors:
        return checks
    units = {c.unit for c in checks.channels}
    unknown = [n for n in floors if n not in model.outputs and n not in units]
    if unknown:
        raise InvalidParameter(
            f"good_enough: got {', '.join(unknown)}, expected an output "
            f"({', '.join(model.outputs)}) or a unit of one ({', '.join(sorted(units))})"
        )
    channels = []
    for c in checks.channels:
        floor = floors.get(c.channel, floors.get(c.unit, 0.0))
        channels.append(replace(c, sigma=math.hypot(c.sigma, floor)))
    return replace(checks, channels=tuple(channels))


def _with_other_noise(fit: Fit, sensed: tuple[SegmentedRecord, ...]) -> Fit:
    """Evaluate a fit, unchanged, with another noise."""
    if fit.problem.segmented_records is sensed:
        return fit
    problem = replace(fit.problem, segmented_records=sensed)
    return finish(problem, replace(fit.point, memo={}), fit.level, fit.gap_sd)


def _within(fit: Fit) -> bool:
    """Whether the residual of a fit is within the given noise in every channel."""
    records = fit.problem.segmented_records
    for c, _ in enumerate(fit.problem.model.outputs):
        total = expected = 0.0
        for s, r in zip(records, residuals_by_segment(fit), strict=True):
            seen = r[np.isfinite(r[:, c]), c]
            total += float(seen @ seen)
            expected += seen.size * s.noise[c].sigma ** 2
        if total > expected:
            return False
    return True


def _provenance(fit: Fit, records: Sequence[Record]) -> str:
    """Text that identifies the diagnosis; it has no time, so that equal records give equal text."""
    names = list(dict.fromkeys(r.name for r in records))
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    dates = sorted({str(r.conditions["date"]) for r in records if "date" in r.conditions})
    when = f" of {', '.join(dates)}" if dates else ""
    return f"diagnosis of {fit.problem.model.name} with records {shown}{when}"


def _recolored(
    first: Search,
    segmented_records: tuple[SegmentedRecord, ...],
    settings: FitSettings,
    store: Store | None,
) -> dict[str, float] | None:
    """Correlation times [s] of noise that would explain the residual; None: they do not.

    With this noise the model must explain the records. It must also be more likely than white noise
    with an unknown force or signal, and than the best set of effects.
    """
    fit = first.model_fit
    white = misfit(fit, first.tight_fit, estimated=False)
    color = color_of_discrepancy(first, segmented_records) if white.left else None
    if color is None:
        return None
    model = fit.problem.model
    colored = tuple(with_color(model, s, color) for s in segmented_records)
    again = fit_problem(Problem(model, colored, store=store), settings)
    tight = tighten(again, settings)
    if misfit(again, tight, estimated=False).left:
        return None
    plain = fit.log_evidence + (0.0 if fit.gap_sd.size else white.other)
    if first.best is not None:
        plain = max(plain, first.best.fit.log_evidence)
    gain = again.log_evidence + _log_weights(colored) - plain - _log_weights(segmented_records)
    return color if gain > COLOR_GAIN else None


def _rescaled(
    first: Search, segmented_records: tuple[SegmentedRecord, ...], checks: DataChecks
) -> tuple[dict[str, float], tuple[SegmentedRecord, ...]] | None:
    """Factors of the noise and records with it, if the residual is only noise then; else None.

    See :func:`noise_factors`. A residual that exceeds this larger noise as well is not due to the
    given sigma. It is admitted as a discrepancy, whose noise does not depend on the given sigma.
    """
    best = first.best
    fit, tight = (first.model_fit, first.tight_fit) if best is None else (best.fit, None)
    if not misfit(fit, tight, estimated=checks.estimated).left:
        return None
    factor = noise_factors(first)
    if not factor:
        return None
    model = fit.problem.model
    noisier = tuple(with_factor(model, s, factor) for s in segmented_records)
    fit = _with_other_noise(fit, noisier)
    tight = None if tight is None else _with_other_noise(tight, noisier)
    left = misfit(fit, tight, estimated=checks.estimated).left
    return None if left else (factor, noisier)


def _with_factor(checks: DataChecks, factor: dict[str, float]) -> DataChecks:
    """The data checks with larger noise of some channels, and warnings about it."""
    channels = tuple(
        replace(c, sigma=c.sigma * factor[c.channel]) if c.channel in factor else c
        for c in checks.channels
    )
    warnings = tuple(
        f"{name}: neighboring samples differ by {f:.3g} times the given noise (assumed accurate "
        f"to {GIVEN_SIGMA:.0%}); the larger noise is used"
        for name, f in factor.items()
    )
    return replace(checks, channels=channels, warnings=(*checks.warnings, *warnings))


def _log_weights(segmented_records: Sequence[SegmentedRecord]) -> float:
    """Contribution of the noise standard deviations to a log likelihood."""
    return sum(float(np.sum(np.log(s.weight[s.valid]))) for s in segmented_records)


def _with_color(checks: DataChecks, color: dict[str, float]) -> DataChecks:
    """The data checks with correlated noise of some channels, and warnings about it."""
    channels = tuple(
        replace(c, correlation_time=color[c.channel]) if c.channel in color else c
        for c in checks.channels
    )
    warnings = tuple(
        f"{name}: the residual of the model is no larger than the noise of its sensor, but it is "
        f"correlated over {time:.3g} s, and no force or effect explains this as well. "
        "It is treated as noise; if this is correct, specify its correlation_time"
        for name, time in color.items()
    )
    return replace(checks, channels=channels, warnings=(*checks.warnings, *warnings))


def _beyond(
    accepted: Accepted,
    held: Problem,
    settings: FitSettings,
    checks: DataChecks,
    form: float,
    say: Callable[[str], None],
) -> float | None:
    """Sum of squares over its expectation of the accepted model, fitted to held-out records alone.

    Returned only if the held-out records show a gap that no parameter values and magnitudes
    explain, else None.
    """
    known = accepted.after.fit
    model = known.problem.model
    which = "segmented" if model.chaotic else "open_loop"
    if not accepted.after.gap(held.segmented_records, which) > WIDE_GAP:
        return None
    say("held-out records alone")
    problem = replace(held, model=model, included=known.included)
    fit = fit_problem(problem, settings, point=replace(known.point, memo={}))
    if not fit.explains:
        start = problem.start(known.point.magnitudes)
        other = fit_problem(problem, replace(settings, restarts=0), point=start)
        fit = other if other.log_evidence > fit.log_evidence else fit
    tight = tighten(fit, settings)
    bar = EXCESS if accepted.best is None else REST_EXCESS
    explained = float(np.sum(accepted.after.density - accepted.before.density))
    allowed = form_of(explained, form)
    left = misfit(fit, tight, estimated=checks.estimated, bar=bar, allowed=allowed)
    reference = tight or fit
    beyond = left.left and left.excess > bar and fit.converged
    return reference.chi2 / reference.dof if beyond else None


def _primary(model: Model, accepted: object, segmented_records: Sequence[SegmentedRecord]) -> str:
    """The main metric: open loop, unless the model is chaotic or a simulation fails."""
    before, after = accepted.before, accepted.after  # type: ignore[attr-defined]
    if model.chaotic:
        return "segmented"
    finite = all(np.isfinite(o.gap(segmented_records, "open_loop")) for o in (before, after))
    return "open_loop" if finite else "segmented"


@checked
def fit_model(
    model: Model,
    records: Sequence[Record],
    *,
    segment: float | None = None,
    settings: FitSettings | None = None,
    progress: Tell | None = None,
    resume: Path | None = None,
    budget: float | None = None,
    stop: Callable[[], bool] | None = None,
) -> Fit:
    """Fit the model without effects to all records: parameters with intervals.

    The notes of the fit hold the warnings of the data checks and the parts of the records that are
    not used. ``resume`` is a folder for finished optimizations, from which an interrupted fit
    continues. ``progress``, ``budget`` [s] and ``stop`` have the meaning of :func:`diagnose`; the
    notes state whether the fit was stopped.

    Parameters
    ----------
    model
        Model with its parameters.
    records
        Records that are fitted.
    segment
        Length of a segment [s]; None: chosen from the records.
    settings
        Settings of the fit.
    progress
        Function that is called with the progress of the fit.
    resume
        Folder of an earlier run that continues.
    budget
        Time after which the fit stops [s].
    stop
        Function that returns True to stop the fit.
    """
    watch = Watch(progress, budget, stop)
    with watching(watch):
        fit = _fitted(model, records, segment, settings, resume, watch)
    if watch.why:
        note = f"stopped ({watch.why}): the fit is the best so far, but not converged"
        fit = replace(fit, notes=(note, *fit.notes))
    return fit


def _fitted(
    model: Model,
    records: Sequence[Record],
    segment: float | None,
    settings: FitSettings | None,
    resume: Path | None,
    watch: Watch,
) -> Fit:
    watch.enter(watch.stage)
    model.forget()
    model, records, checks, _ = _ready(model, records)
    try_effects(model, (), records[0])
    segmented_records = prepare(model, records, checks, segment)
    store = None if resume is None else Store(resume)
    watch.enter(FIT)
    problem = Problem(model, segmented_records, store=store)
    fit = fit_problem(problem, settings, progress=watch.say)
    fit = with_variability(fit, settings or FitSettings())
    watch.fitted(fit.chi2 / fit.dof)
    told = prior_deviations_told(fit)
    return replace(fit, notes=(*fit.notes, *([told] if told else []), *checks.warnings))
