"""The diagnosis: data checks, fit, search, held-out proof, place of the gap, verdict."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Record
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import Store
from feltmb.fit.model import Effect, Model
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit, FitSettings, fit_problem, with_variability
from feltmb.fit.starts import from_other_starts
from feltmb.fit.watch import CHECKS, FIT, PROOF, REPORT, Tell, Watch, watching
from feltmb.gap.acceptance import Accepted, accept, refutes, shapley
from feltmb.gap.advise import advise
from feltmb.gap.assemble import closest_set, how_far_rows, ranked, with_effects
from feltmb.gap.calibrate import Null, calibrate, largest_statistic
from feltmb.gap.checks import DataChecks
from feltmb.gap.common_delay import common_delay
from feltmb.gap.components import component_table
from feltmb.gap.criteria import NOISE_ERROR, refuted, unknown_gain
from feltmb.gap.decide import Decision, Facts, decide
from feltmb.gap.discrepancy import larger_than_noise, only_white
from feltmb.gap.findings import (
    Advice,
    AsItIs,
    Calibrated,
    GivenValue,
    HowFar,
    NotTested,
    Profile,
    Verdict,
    Where,
    Which,
)
from feltmb.gap.investigate import Investigation, Task, investigate
from feltmb.gap.judged_data import judged_data, prepare, ready, with_other_noise
from feltmb.gap.law_errors import law_errors
from feltmb.gap.measured import known_by_test
from feltmb.gap.misfit import Misfit, form_of, misfit
from feltmb.gap.one_record import error_of_one_record
from feltmb.gap.options import Options
from feltmb.gap.overlay import (
    exchanged_channels,
    expected_outputs,
    wrong_input,
    wrong_units,
)
from feltmb.gap.profile import profile_of
from feltmb.gap.proof import HeldOut, Outcome, metric_of, residuals_by_segment
from feltmb.gap.refine import tighten
from feltmb.gap.report import Report
from feltmb.gap.resumed import resumed
from feltmb.gap.score import (
    NO_SIGNATURE,
    all_candidates,
    family_threshold,
    refuting_score,
    score_fit,
)
from feltmb.gap.search import Search
from feltmb.gap.sizes import Sizes
from feltmb.gap.smoke_test import try_effects
from feltmb.gap.spread import Spread
from feltmb.gap.steps import next_steps
from feltmb.gap.stopped import completion, cut_short, left_out
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
)
from feltmb.gap.uncorrelated import Uncorrelated, uncorrelated
from feltmb.gap.where import event_ledger, first_act, ledger, split_gap

__all__ = ["diagnose", "fit_model"]


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
        Fits stop after three fifths of the time, and the held-out proof follows. The
        proof may take two fifths; if it takes longer, it is discarded and no effect is named. A
        step that has started (the derivatives or a simulation of all records) is completed.
    stop
        Function that is called at each step; when it returns True, the fit or search ends at its
        present point. Proof and report then have 5 s; a proof that takes longer is discarded, and
        no effect is named.

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
        report = _Diagnosis(model, effects, records, hold_out, options, watch).report()
        watch.say("done")
    return report


@dataclass(frozen=True, eq=False)
class _Proof:
    """The accepted set and the held-out records that prove it."""

    accepted: Accepted
    held: HeldOut


@dataclass(frozen=True, eq=False)
class _Alarm:
    """Whether the model alone is refuted."""

    largest: float
    """Largest score of an effect."""
    null: Null
    """Its distribution without an effect."""
    bare: Misfit
    """Unexplained residual of the model, with the noise of the sensors."""
    leftover: float
    """Largest score after acceptance, as a share of its threshold."""


@dataclass(frozen=True, eq=False)
class _Described:
    """The model with an accepted set, or alone."""

    fit: Fit
    tight: Fit | None
    """With the tightest continuity defects; None: ``fit`` has them."""
    end: Fit
    """The tighter of both, with the noise of the sensors."""
    after: Outcome
    """On the held-out records."""
    where: Where
    how_far: HowFar
    sizes: Sizes
    wide: Spread
    """Uncertainty of ``fit``."""
    calibrated: tuple[Calibrated, ...]
    given: tuple[GivenValue, ...]
    apart: bool
    """Whether the parameters moved, jointly, by more than noise and errors of form would."""
    uncorrelated: tuple[Uncorrelated, ...]
    """Channels whose residual is not correlated in time."""
    only_noise: bool
    """Whether nothing that is correlated in time is left."""


class _Diagnosis:
    """One diagnosis: the prepared model and data, and the stages in their order."""

    def __init__(
        self,
        model: Model,
        effects: Sequence[Effect],
        records: Sequence[Record],
        hold_out: Sequence[str] | str | None,
        options: Options,
        watch: Watch,
    ):
        self.watch, self.options = watch, options
        self.seconds: dict[str, float] = {}
        self._tick = clock.perf_counter()
        watch.enter(watch.stage)
        model.forget()
        self.model, self.data, self.records = judged_data(
            model, records, hold_out, good_enough=options.good_enough, segment=options.segment
        )
        self.metric = metric_of(self.model)
        offered = [e.name for e in self.model.effects]
        if offered and not effects:
            self.data = self.data.warned(
                [
                    f"no effect was given, but the model exposes {', '.join(offered)}: pass "
                    "effects=model.effects to have them tested"
                ]
            )
        self._lap("data checks")
        usable, self.not_tested = _usable(self.model, effects)
        self.skipped: tuple[NotTested, ...] = ()
        self.resumed = ""
        self.task = Task(
            effects=usable,
            options=options,
            settings=FitSettings(restarts=options.restarts, seed=options.seed),
            store=None,
            progress=watch.say,
        )
        try_effects(self.model, usable, self.data.fitted[0].record)

    def _lap(self, stage: str) -> None:
        """Add the time since the last call to a stage."""
        now = clock.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._tick
        self._tick = now

    def report(self) -> Report:
        """Search, prove, locate, decide."""
        tabulated = self._tabulated()
        done = investigate(self.model, self.data, self.task)
        self.model = done.model
        self._lap("which")
        if done.found.skipped:
            self.skipped = left_out(done.found, self.task.effects)
        done, proof = self._proven(done)
        self._add_not_tested(done.found)
        fit = done.found.model_fit
        done = replace(done, sensed=done.sensed.warned(refuted_tolerances(fit)))
        self._lap("how far")
        where = self._where(done.first)
        if proof.accepted.best is None and not self.watch.over():
            everything = (*done.sensed.fitted, *done.sensed.held)
            theta, alpha = done.first.bare.point.theta, self.options.alpha
            hint = error_of_one_record(self.model, everything, theta, self.task.settings, alpha)
            where = replace(where, one_record=hint)
        self._lap("where")
        which_gap = _primary(self.model, proof.accepted, done.sensed.held)
        shares = self._shares(done.found, proof, which_gap)
        self._lap("how far")
        alarm = self._alarm(done, proof.accepted)
        self._lap("null")
        return self._assembled(tabulated, done, proof, where, which_gap, shares, alarm)

    def _tabulated(self) -> Outcome:
        """The model with its tabulated numbers, on all records."""
        self.watch.say("gap as it is")
        tabulated = tabulated_outcome(
            self.model,
            (*self.data.fitted, *self.data.held),
            self.task.settings,
        )
        _check_columns(self.model, tabulated, self.metric, self.records)
        late = common_delay(self.model, (*self.data.fitted, *self.data.held))
        if late:
            self.data = self.data.warned([late])
            self.watch.note(late)
        if self.options.resume is not None:
            store, self.resumed = resumed(
                self.options.resume,
                self.model,
                self.task.effects,
                self.records,
                [s.record.whole for s in self.data.held],
                self.options,
                tabulated,
            )
            self.task = replace(self.task, store=store)
            self.watch.note(self.resumed)
        self._lap("gap as it is")
        return tabulated

    def _proven(self, done: Investigation) -> tuple[Investigation, _Proof]:
        """The proof on held-out records, perhaps of the model without refuted tolerances."""
        self.watch.enter(PROOF)
        scale = done.found.model_fit.problem.state_scale
        held = HeldOut(done.judged.held, np.zeros(0) if scale is None else scale, done.sensed.held)

        def proven(search: Search) -> Accepted:
            return accept(
                search,
                held,
                self.task.settings,
                self.options,
                progress=self.task.progress,
            )

        accepted = proven(done.found)
        more = more_of_tolerances(accepted.best, beyond_prior(done.found.model_fit))
        if more or done.unexplained or self.watch.over():
            return done, _Proof(accepted, held)
        free = released(
            done.found,
            self.task.settings,
            alpha=self.options.alpha,
            estimated=self.data.checks.estimated,
        )
        again = None if free is None else proven(free)
        if (
            free is None
            or again is None
            or self.watch.proof_over()  # the other proof may be incomplete
            or refutes(accepted, again, self.options.credibility)
        ):
            return done, _Proof(accepted, held)
        return replace(done, first=free, found=free), _Proof(again, held)

    def _add_not_tested(self, found: Search) -> None:
        """Effects that the search could not test, or had no time for."""
        for name, why in found.failed:
            self.not_tested.append(NotTested(name=name, why=why))
        scores = found.scores
        for e in self.task.effects:
            own = [i for i, t in enumerate(scores.candidates) if t.effect is e]
            if not own or np.any(scores.testable[own]):
                continue
            why = (
                "parameters, start states and sensor errors can reproduce its whole signature in "
                "these records"
                if not np.all(scores.raw[own] <= NO_SIGNATURE)
                else "it changes no recorded output"
            )
            self.not_tested.append(NotTested(name=e.name, why=why))
        self.not_tested += self.skipped

    def _where(self, first: Search) -> Where:
        """Place of the gap, with the noise of the sensors.

        An unexplained residual that counts as noise would hide it.
        """
        self.watch.say("where the gap lies")
        tight = None if self.model.chaotic else first.tight_fit
        seen = tight or first.bare
        cells, onset = ledger(seen, self.options.alpha)
        laws = law_errors(first.tightest, self.task.settings)
        told = laws.gain > unknown_gain(self.options.alpha)
        return Where(
            ledger=cells,
            events=event_ledger(seen, self.options.alpha),
            components=component_table(first.bare, tight, self.options.alpha),
            onset=onset,
            split=split_gap(seen),
            varying=laws.laws if told else (),
            varying_gain=laws.gain if told else 0.0,
        )

    def _shares(self, found: Search, proof: _Proof, which: str) -> dict[str, float]:
        """Share of the held-out gap by effect."""
        shares: dict[str, float] = {}
        if not self.watch.over():
            with self.watch.keeping():
                shares = shapley(
                    found,
                    proof.accepted,
                    proof.held,
                    self.task.settings,
                    which=which,
                    progress=self.task.progress,
                )
        return shares

    def _alarm(self, done: Investigation, accepted: Accepted) -> _Alarm:
        """The largest score, and what chance gives."""
        options, found, first = self.options, done.found, done.first
        # With its most likely continuity defects: the tightest ones would turn errors in the form
        # of a law, which the allowance permits, into scores of effects.
        judged = besides_tolerances(found.model_fit, self.task.effects)
        reference = found.scores.among(judged)
        bar, maxima = family_threshold(reference, options.alpha, seed=options.seed)
        # A correction can only raise the threshold. It matters only for a score above the
        # threshold, and only if there is no other evidence against the model.
        bare = misfit(
            first.bare,
            first.tight_fit,
            alpha=options.alpha,
            estimated=done.sensed.checks.estimated,
        )
        largest = largest_statistic(
            found,
            reference,
            refuting_score(maxima, reference.tested, refuted(options.alpha)),
            self.task.settings,
            confirm=accepted.best is None and not bare.left,
            progress=self.task.progress,
        )
        doubtful = bar < largest and not bare.left
        null = calibrate(
            found.model_fit,
            reference,
            judged,
            options.alpha,
            options.bootstrap if doubtful and not self.watch.over() else 0,
            seed=options.seed,
            progress=self.task.progress,
        )
        return _Alarm(largest, null, bare, self._leftover(found, accepted))

    def _leftover(self, found: Search, accepted: Accepted) -> float:
        """Largest score of the effects that are not accepted, as a share of its threshold."""
        if accepted.best is None:
            return 0.0
        others = all_candidates(self.task.effects, accepted.best.names)
        if not others:
            return 0.0
        after = score_fit(accepted.tightest or accepted.best.fit, others)
        limit, _ = family_threshold(after, self.options.alpha, seed=self.options.seed)
        # The robust score must be significant too: a single segment is not a trend.
        both = np.minimum(after.singles(), after.robust())
        form = form_of(accepted.best.evidence - found.tight_evidence, self.options.form)
        least = max(limit, 2.0 * form)
        return float(np.max(both) / least) if np.isfinite(limit) else 0.0

    def _beyond(self, done: Investigation, accepted: Accepted, bare: Misfit) -> float | None:
        """Misfit of the held-out records alone; see :func:`_beyond`."""
        if self.watch.over() or (accepted.best is None and bare.left):
            return None
        alone = Problem(self.model, done.judged.held, store=self.task.store)
        beyond: float | None = None
        with self.watch.keeping():
            beyond = _beyond(
                accepted,
                alone,
                self.task.settings,
                self.data.checks,
                self.options,
                self.watch.say,
            )
        return beyond

    def _assembled(
        self,
        tabulated: Outcome,
        done: Investigation,
        proof: _Proof,
        where: Where,
        which_gap: str,
        shares: dict[str, float],
        alarm: _Alarm,
    ) -> Report:
        """The decision, and the report of everything that it is based on."""
        settings, watch = self.task.settings, self.watch
        found, accepted, model = done.found, proof.accepted, self.model
        beyond = self._beyond(done, accepted, alarm.bare)
        self._lap("how far")
        watch.enter(REPORT)

        def describe(chosen: Accepted, by_part: dict[str, float]) -> _Described:
            return self._described(tabulated, done, chosen, where, which_gap, by_part)

        told, facts, decision = self._decided(
            done, accepted, alarm, describe, describe(accepted, shares), which_gap, beyond
        )
        sizes, fit, wide = told.sizes, told.fit, told.wide
        if watch.proof_over() or watch.why:
            decision = cut_short(
                decision, watch, accepted, found, self.skipped, len(self.task.effects), sizes
            )
        checks = facts.checks
        far = prior_deviations_told(fit, wide)
        if far:
            checks = replace(checks, warnings=(*checks.warnings, far))
        if watch.model_cut:
            cut = (
                f"the fit of the model alone was ended after {watch.model_cut:.0f} s to leave time "
                "for effects: its parameters and its gap may not be the best ones (a larger budget "
                "completes it)"
            )
            checks = replace(checks, warnings=(*checks.warnings, cut))
        which = ranked(
            found, accepted, decision.belief, alarm.null, decision.named, decision.one_of, sizes
        )
        self._lap("verdict")
        rows = as_it_is(tabulated, self.metric)
        advice = self._next(told, facts, decision, which, rows)
        starts = found_starts(told.after.tight) | fitted_starts(fit, told.tight, settings)
        before_starts = found_starts(accepted.before.tight) | fitted_starts(
            found.model_fit, found.tight_fit, settings
        )
        provenance = _provenance(fit, self.records)
        profiles, no_profile = self._profiles(accepted, decision)
        if self.options.profile:
            self._lap("profile")
        return Report(
            verdict=decision.verdict,
            statement=decision.statement,
            named=decision.named,
            one_of=decision.one_of,
            confidence=decision.confidence,
            as_it_is=rows,
            calibrated=told.calibrated,
            given=told.given,
            closest=decision.closest,
            where=told.where,
            which=which,
            how_far=told.how_far,
            next=advice,
            model=with_effects(model, fit, starts, provenance),
            fitted=with_effects(model, found.model_fit, before_starts, provenance),
            tabulated=with_effects(model, tabulated.fit, found_starts(tabulated.fit), provenance),
            not_tested=tuple(self.not_tested),
            refused=tuple(NotTested(name=n, why=w) for n, w in accepted.rejected),
            fit=found.model_fit,
            checks=checks,
            profiles=profiles,
            no_profile=no_profile,
            seconds=self.seconds,
            stopped=f"{watch.stopped_in} ({watch.why})" if watch.why else "",
            resumed=self.resumed,
            fits=None if self.task.store is None else self.task.store.folder,
        )

    def _decided(
        self,
        done: Investigation,
        accepted: Accepted,
        alarm: _Alarm,
        describe: Callable[[Accepted, dict[str, float]], _Described],
        told: _Described,
        which_gap: str,
        beyond: float | None,
    ) -> tuple[_Described, Facts, Decision]:
        """The decision, with the facts and the description of the model that it is based on.

        ``describe(accepted, shares)`` describes the model with an accepted set; ``told`` is that
        of ``accepted``.
        """
        options, first = self.options, done.first
        wanted = bool(options.good_enough)
        facts = Facts(
            checks=done.sensed.checks,
            search=done.found,
            accepted=accepted,
            belief=accepted.belief,
            p=alarm.null.p(alarm.largest),
            options=options,
            how_far=told.how_far,
            where=told.where,
            rest=accepted.tightest,
            first=first,
            misfit=alarm.bare,
            unexplained=done.unexplained,
            leftover=alarm.leftover,
            uncorrelated=told.uncorrelated,
            only_noise=told.only_noise,
            beyond=beyond,
            apart=told.apart,
            calibrated=told.calibrated,
            given=told.given,
            closest=closest_set(done.found, accepted, done.sensed.held, which_gap, options.seed),
            sizes=told.sizes,
            enough=wanted and _within(first.tight_fit or first.bare),
            enough_left=wanted and _within(told.end),
        )
        decision = decide(facts)
        if accepted.best is not None and not (decision.named or decision.one_of):
            # A set that is not named is no part of the model, nor of its parameters.
            bare = replace(accepted, best=None, after=accepted.before, tightest=None)
            told = describe(bare, {})
            facts = replace(
                facts,
                calibrated=told.calibrated,
                given=told.given,
                where=told.where,
                apart=told.apart,
                uncorrelated=told.uncorrelated,
            )
            decision = decide(facts)
        return told, facts, decision

    def _next(
        self,
        told: _Described,
        facts: Facts,
        decision: Decision,
        which: Which,
        rows: tuple[AsItIs, ...],
    ) -> tuple[Advice, ...]:
        """Recommended next steps; ``rows``: the gap of the model with tabulated numbers."""
        watch, accepted = self.watch, facts.accepted
        answered = decision.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
        advice = completion(watch, kept=self.options.resume is not None)
        if self.options.advice and not answered and not watch.over():
            if accepted.rivals:
                watch.say("next experiment")
            advice += advise(facts.search, accepted)
        self._lap("next")
        if not answered and facts.checks.spiky:
            text = (
                f"Leave out the samples of {', '.join(facts.checks.spiky)} that are far from the "
                "samples before and after (see the warning), then repeat the diagnosis: one of "
                "them outweighs many others."
            )
            advice = (Advice(text=text), *advice)
        if not watch.why:
            advice += tuple(Advice(text=u.remedy) for u in facts.uncorrelated)
        return advice + next_steps(
            decision.verdict,
            rows,
            told.calibrated,
            [r for r in which.effects if r.named],
            [r for r in which.effects if r.effect in decision.one_of],
            decision.closest,
            told.where.components,
            told.fit.intervals(told.wide.covariance, told.wide.by_form),
            self.model,
            self.task.effects,
        )

    def _described(
        self,
        tabulated: Outcome,
        done: Investigation,
        accepted: Accepted,
        where: Where,
        which_gap: str,
        shares: dict[str, float],
    ) -> _Described:
        """The model with an accepted set: place and size of the gap, parameters."""
        options, settings, found = self.options, self.task.settings, done.found
        plain, sensed, best = done.sensed.fitted, done.sensed.held, accepted.best
        fit = found.model_fit if best is None else best.fit
        if best is not None:
            there = with_other_noise(accepted.tightest or fit, plain)
            where = replace(
                where,
                onset={**where.onset, **first_act(fit)},
                remains=ledger(there, options.alpha)[0],
            )
        tight = found.tight_fit if best is None else accepted.tightest
        end = tight or fit
        end = replace(end, problem=replace(end.problem, segmented_records=plain))
        sizes = Sizes(found, accepted, options.form)
        wide = sizes.spread(fit)
        fitted = Outcome(end, settings, end)
        larger = larger_than_noise(end, options.alpha)
        self.watch.say("gap that the parameters explain")
        return _Described(
            fit=fit,
            tight=tight,
            end=end,
            after=accepted.after,
            where=where,
            how_far=how_far_rows(
                accepted,
                tabulated.part(slice(len(plain), None)),
                sensed,
                shares,
                which_gap,
                options.seed,
            ),
            sizes=sizes,
            wide=wide,
            calibrated=calibrated_rows(
                fit, wide, [tabulated], [fitted, accepted.after], which_gap, options.alpha
            ),
            given=given_values(fit, wide, tabulated.fit.problem.model, options.alpha),
            apart=moved_together(fit, wide, options.alpha),
            uncorrelated=uncorrelated(end, larger, options.alpha),
            only_noise=only_white(larger),
        )

    def _profiles(self, accepted: Accepted, decision: Decision) -> tuple[tuple[Profile, ...], str]:
        """Profiles of the named magnitudes, if they are wanted, or why there are none."""
        if not self.options.profile:
            return (), ""
        if accepted.best is None or not decision.named:
            return (), "no effect is named"
        if self.watch.over():
            return (), self.watch.why
        best, settings = accepted.best.fit, self.task.settings
        profiles = (profile_of(best, n, settings, self.task.progress) for n in decision.named)
        return tuple(profiles), ""


def _usable(model: Model, effects: Sequence[Effect]) -> tuple[list[Effect], list[NotTested]]:
    """Effects that can be tested, and why the others cannot."""
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
        elif known := known_by_test(e, model):
            why = f"the test of {known} measured the number that it changes"
            bad.append(NotTested(name=e.name, why=why))
        else:
            good.append(e)
    return good, bad


def _check_columns(model: Model, tabulated: Outcome, metric: str, whole: Sequence[Record]) -> None:
    """Raise an error if units or columns of records are wrong: no fit would be useful.

    Estimated start states may absorb a wrong unit. The expected ones are therefore tried as well,
    on ``whole``, the records before they were cut into blocks, whose start may be known.
    """
    records = tabulated.fit.problem.segmented_records
    noise = [dict(zip(model.outputs, s.rms_noise.tolist(), strict=True)) for s in records]
    own = [s.record for s in records]
    cases = [list(zip(own, getattr(tabulated, metric), noise, strict=True))]
    known = [r for r in whole if r.start is None or r.start.known]
    if model.states() and known:
        rest = [r.output_array(model.outputs) - expected_outputs(model, r) for r in known]
        sigma = {r.name: _noise_of(r, own, noise) for r in known}
        cases.append([(r, x, sigma[r.name]) for r, x in zip(known, rest, strict=True)])
    unit = (
        "DATA PROBLEM: the unit of {}. Specify the true unit: --unit CHANNEL=UNIT, unit in the "
        "TOML file, in Python units of ReadOptions (another direction: --scale CHANNEL=-1); feltmb "
        "gap check shows model and record"
    )
    for runs in cases:
        if wrong := wrong_units(model, runs):
            raise DataError(unit.format(wrong))
        if exchanged := exchanged_channels(model, runs):
            raise DataError(
                f"DATA PROBLEM: in all records, {exchanged}: the columns are exchanged. Assign "
                "them: --column CHANNEL=COLUMN, column in the TOML file; feltmb gap check shows "
                "model and record"
            )
    # All outputs in another unit resemble an input in another unit.
    if wrong := wrong_input(model, known or own):
        raise DataError(unit.format(wrong))


def _noise_of(
    whole: Record, parts: Sequence[Record], noise: Sequence[Mapping[str, float]]
) -> dict[str, float]:
    """Noise of the outputs of a record, from its blocks."""
    return {
        name: sigma[name]
        for part, sigma in zip(parts, noise, strict=True)
        if part.part_of(whole.name)
        for name in part.outputs
        if name in sigma
    }


def _within(fit: Fit) -> bool:
    """Whether the residual of a fit is within the given noise in every channel."""
    records = fit.problem.segmented_records
    for c, _ in enumerate(fit.problem.model.outputs):
        total = expected = 0.0
        for s, r in zip(records, residuals_by_segment(fit), strict=True):
            seen = np.isfinite(r[:, c])
            total += float(np.sum(r[seen, c] ** 2))
            expected += float(np.sum(s.sd[seen, c] ** 2))
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


def _beyond(
    accepted: Accepted,
    held: Problem,
    settings: FitSettings,
    checks: DataChecks,
    options: Options,
    say: Callable[[str], None],
) -> float | None:
    """Sum of squares over its expectation of the accepted model, fitted to held-out records alone.

    Returned only if the held-out records show a gap that no parameter values and magnitudes
    explain, else None.
    """
    known = accepted.after.fit
    model = known.problem.model
    which = metric_of(model)
    if not accepted.after.gap(held.segmented_records, which) > NOISE_ERROR:
        return None
    say("held-out records alone")
    problem = replace(held, model=model, included=known.included)
    fit = fit_problem(problem, settings, point=replace(known.point, memo={}))
    if not fit.explains:
        start = problem.start(known.point.magnitudes)
        other = fit_problem(problem, replace(settings, restarts=0), point=start)
        fit = other if other.log_evidence > fit.log_evidence else fit
    tight = tighten(fit, settings)
    explained = float(np.sum(accepted.after.density - accepted.before.density))
    allowed = form_of(explained, options.form)
    left = misfit(fit, tight, alpha=options.alpha, estimated=checks.estimated, allowed=allowed)
    reference = tight or fit
    beyond = left.far and fit.converged
    return reference.chi2 / reference.dof if beyond else None


def _primary(model: Model, accepted: Accepted, segmented_records: Sequence[SegmentedRecord]) -> str:
    """The metric of the model, or by segment if a simulation of a whole record fails."""
    which = metric_of(model)
    outcomes = (accepted.before, accepted.after)
    finite = all(np.isfinite(o.gap(segmented_records, which)) for o in outcomes)
    return which if finite else "segmented"


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
    watch = Watch(progress, budget, stop, stages=(CHECKS, FIT))
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
    model, records, checks, _ = ready(model, records)
    try_effects(model, (), records[0])
    segmented_records = prepare(model, records, checks, segment)
    store = None if resume is None else Store(resume)
    watch.enter(FIT)
    problem = Problem(model, segmented_records, store=store)
    fit = fit_problem(problem, settings, progress=watch.say)
    fit = from_other_starts(fit, settings or FitSettings())
    fit = with_variability(fit, settings or FitSettings())
    watch.fitted(fit.chi2 / fit.dof)
    told = prior_deviations_told(fit)
    return replace(fit, notes=(*fit.notes, *([told] if told else []), *checks.warnings))
