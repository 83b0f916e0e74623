"""The verdict: probabilities of sets become named causes, classes, or an unknown cause."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from unmodeled.chain import fault_of
from unmodeled.data import Array
from unmodeled.data.smoothing import noise_of_samples
from unmodeled.fit.model import Effect, Parameter, UserUnit
from unmodeled.search.changes import CLASS, explain
from unmodeled.search.evidence import (
    Fitted,
    NormalEquations,
    log_odds,
    precision,
    prior_of,
    system,
    weights,
)
from unmodeled.search.fit import empty_point
from unmodeled.search.held_out import HALF, Predicted, compare, predict
from unmodeled.search.linear import (
    EvaluationRequest,
    evaluate,
    local_of,
    movable,
    shapes_of,
    theta_at,
)
from unmodeled.search.locate import cells, events, most_different, places
from unmodeled.search.options import Options
from unmodeled.search.problem import RELEASED, STRICT, Cause, Problem, rms_of, spread
from unmodeled.search.progress import Stop, interrupted
from unmodeled.search.result import (
    Channel,
    NamedCause,
    ParameterValue,
    Place,
    Reason,
    Result,
    SetOfCauses,
    Trace,
    Verdict,
    Without,
    takes_over,
    worst_of,
)
from unmodeled.search.score import by_record, index_of
from unmodeled.search.search import Searched, rank, with_all_records, without_one

#: Number of sets that are fitted to all records; probability, or odds to the best one, below which
#: a set is not possible.
PREDICTED, UNLIKELY = 8, 1e-3
#: Probability of the differences of a magnitude between records below which it is no name.
SAME = 0.01
#: Share of the motion that does not matter, unless the user states it.
GOOD_ENOUGH = 0.01
#: Number of sets from which the search for a supported one begins; log of the smallest ratio of
#: held-out residuals without and with a member.
SUPPORTED, WORTH_A_MEMBER = 3, 0.2
#: Difference of the log likelihoods below which two causes are equal.
EQUAL = 1.0


def judge(
    searched: Searched,
    options: Options,
    seconds: float,
    tell: Callable[[str], None] = lambda _: None,
    check: Callable[[], None] = lambda: None,
) -> Result:
    """The result of a search.

    ``seconds``: time that preparation and search took [s]. ``check`` is called before each
    simulation of all fits that proceed together; it may raise ``Stop``.
    """
    shown = searched.problem
    tell("held_out")
    problem, sets, weight, predicted, worse, ours_only = _posterior(searched, check)
    tell("judge")
    alone = next(s for s in sets if not s.causes)
    probable = sets[0]
    trusted = _by_trust(problem, sets, options)
    sets, weight, imitations = _consistent(problem, sets, weight)
    told, classes = _told(sets, weight, options.credibility)
    not_needed: list[int] = []
    while failed := _not_needed(problem, shown, sets, told, predicted):
        not_needed += failed
        sets, weight = _without(problem, sets, failed)
        told, classes = _told(sets, weight, options.credibility)
    told, classes = _with_equivalents(problem, searched.alike, sets, told, classes)
    best = _representative(sets, told, classes)
    known = {*told, *(i for group in classes for i in group)}
    supported: list[int] = []
    matters = any(c.material for c in _channels(problem, shown, alone, best, {}, options))
    if ours_only is not None and matters and {*told} <= {*ours_only.causes}:
        # A set that is less probable than nothing is not supported, whatever it predicts.
        likely = {s.causes: w for s, w in zip(sets, weight, strict=True)}
        if likely.get(ours_only.causes, 0.0) > likely[()]:
            supported = [i for i in ours_only.causes if i not in known]
        if supported:
            best = next(s for s in sets if s.causes == ours_only.causes)
    by_user = interrupted(searched.ended_by)
    missing = [s for s in (alone, best) if s.causes not in predicted]
    if shown.held_out and problem.fit is shown.fit and not by_user:  # a few runs after the limit
        predicted |= {s.causes: p for s, p in zip(missing, predict(shown, missing), strict=True)}
    searched.answer = problem, alone, best
    channels = _channels(problem, shown, alone, best, predicted, options)
    if shown.held_out and (part := searched.sets.get(best.causes)) is not None:
        channels = tuple(
            replace(c, fitted_explained=float(v))
            for c, v in zip(channels, _rms(shown, part), strict=True)
        )
    ours, base = predicted.get(best.causes), predicted.get(())
    gain = None
    if best is not alone and ours is not None and base is not None:
        ratio, low, high = (math.exp(v) for v in compare(ours, base, best.noise, best.effective))
        gain = ratio, low, high
    lost = bool(shown.held_out) and (ours is None or base is None)
    tried = {i for s in searched.sets.values() for i in s.causes}
    tried |= problem.families_of(tried)  # a scope is no further law
    order = dict.fromkeys((*(s.cause for s in searched.first), *range(len(problem.causes))))
    order = {i: None for i in order if problem.causes[i].family < 0}
    tell("locate")
    ports: tuple[Place, ...] = ()
    material = [c.material for c in channels]
    if any(material):
        try:
            check()
            ports = places(problem, best)
        except (Stop, KeyboardInterrupt) as stop:
            searched.ended_by = stop
    unknowns, correlation = _correlation(problem, best)
    parameters = _parameters(problem, best)
    own, fitted = (
        (shown, searched.sets[best.causes])
        if shown.held_out and best.causes in searched.sets
        else (problem, best)
    )
    changes = explain(
        own,
        fitted,
        _covariance(own, fitted),
        searched.sets if own is shown else {s.causes: s for s in sets},
        predicted,
        [[i] for i in (*told, *supported)] + classes,
        _parameters,
        lambda without: takes_over(channels, without),
        options.credibility,
        check,
    )
    searched.ended_by = searched.ended_by or changes.ended_by
    reasons = {
        Reason.DIFFERS_BETWEEN_RECORDS: bool(imitations & {*probable.causes}),
        Reason.NOT_COMPLETE: searched.ended_by is not None,
        Reason.INTERRUPTED: by_user or interrupted(searched.ended_by),
        Reason.NOT_NEEDED: bool(not_needed),
        Reason.NOISE_NOT_STATED: problem.noise_estimated,
        Reason.CALIBRATION_PREDICTS_WORSE: worse,
        Reason.NO_HELD_OUT_GAIN: gain is not None and gain[0] >= 1.0,
        Reason.NOT_PREDICTED: lost,
        Reason.NOTHING_INSIDE: bool(told or classes or supported or any(material))
        and not any(_inside(problem, c) for c in problem.causes),
    }
    result = Result(
        verdict=_verdict(told, classes, supported, channels),
        reasons=tuple(reason for reason, holds in reasons.items() if holds),
        channels=channels,
        named=tuple(_named(problem, best, sets, weight, i) for i in told),
        classes=tuple(
            tuple(_named(problem, _where(sets, i, group), sets, weight, i) for i in group)
            for group in classes
        ),
        supported=tuple(_named(problem, best, sets, weight, i) for i in supported),
        not_needed=tuple(problem.causes[i].name for i in not_needed),
        parameters=parameters,
        changed=changes.changed,
        without=changes.without,
        sets=tuple(
            SetOfCauses(
                tuple(problem.causes[i].name for i in s.causes),
                float(w),
                tuple(float(v) for v in _rms(problem, s)),
                tuple(_size(problem, s, i)[0] for i in s.causes),
            )
            for s, w in zip(sets, weight, strict=True)
        ),
        held_out_gain=gain,
        nothing=float(sum(w for s, w in zip(sets, weight, strict=True) if not s.causes)),
        not_tried=tuple(problem.causes[i].name for i in order if i not in tried),
        causes=sum(c.family < 0 for c in problem.causes),
        refused=tuple(problem.causes[i].name for i in probable.causes if i in imitations),
        complete=searched.ended_by is None,
        notes=(*problem.notes, *trusted),
        seconds=seconds,
        records=tuple(o.record.name for o in problem.fit),
        cells=cells(problem, alone, best),
        events=events(problem, alone, best),
        places=ports,
        apart=tuple(
            most_different(problem, _where(sets, a), _where(sets, b)) for a, b, *_ in classes
        ),
        unknowns=unknowns,
        correlation=correlation,
        reported=tuple(problem.causes[i].name for i in best.causes)
        if told or classes or supported
        else (),
        traces=_traces(problem, shown, alone, best, channels),
    )
    return _of_changes(result)


def _of_changes(result: Result) -> Result:
    """The result whose named causes and classes are those of its list of changes.

    A cause that takes away less than what matters has no name, however probable it is. Several
    that stand for each other have one if they matter together.
    """
    listed = {c.name for c in result.changes}
    named = tuple(n for n in result.named if n.cause in listed)
    kept = [k for k, group in enumerate(result.classes) if group[0].cause in listed]
    classes = tuple(result.classes[k] for k in kept)
    told = {n.cause for group in (named, *classes) for n in group}
    every = [n for group in (result.named, *result.classes) for n in group]
    small = {n.cause: n.probability for n in every if n.cause not in told}
    if not small:
        return result
    rest = {n for n in result.reported if n not in small}
    less = next((s.residual for s in result.sets if {*s.causes} == rest), None)
    if less is not None:
        explained = tuple(c.explained for c in result.channels)
        together = Without("", less, explained)
        if len(small) > 1 and takes_over(result.channels, together) > 1.0:
            others = (w for w in result.without if w.name not in small)
            note = f"{' and '.join(small)} stand for each other: what is left without one is what "
            return replace(
                result,
                without=(*others, *(replace(together, name=n) for n in small)),
                notes=(*result.notes, f"{note}is left without all of them"),
            )
    note = ", ".join(f"{n} ({100.0 * p:.0f} %)" for n, p in small.items())
    channels = result.channels
    if less is not None:
        channels = tuple(
            replace(
                c,
                explained=v,
                held_out_explained=math.nan if rest else c.held_out_calibrated,
                fitted_explained=math.nan,
            )
            for c, v in zip(channels, less, strict=True)
        )
    return replace(
        result,
        verdict=_verdict(named, classes, result.supported, channels),
        channels=channels,
        named=named,
        classes=classes,
        held_out_gain=result.held_out_gain if less is None else None,
        apart=tuple(result.apart[k] for k in kept),
        reported=tuple(n for n in result.reported if n not in small or less is None),
        notes=(*result.notes, f"Probable, but takes away less than what matters: {note}"),
    )


def _inside(problem: Problem, cause: Cause) -> bool:
    """Whether a cause acts inside the model, not at an input or a sensor; no parameter does."""
    inputs = {f"input {n}" for o in problem.fit for n in o.record.inputs}
    return not (cause.of_records or cause.of_parameter or cause.component in inputs)


def _verdict(
    told: Sequence[object],
    classes: Sequence[object],
    supported: Sequence[object],
    channels: Sequence[Channel],
) -> Verdict:
    if told:
        return Verdict.NAMED
    if classes:
        return Verdict.ONE_OF
    if supported:
        return Verdict.SUPPORTED
    if any(c.material for c in channels):
        return Verdict.UNKNOWN
    if any(replace(c, explained=c.tabulated).material for c in channels):
        return Verdict.CALIBRATED
    return Verdict.NO_GAP


Predictions = dict[tuple[int, ...], Predicted | None]


def _posterior(
    searched: Searched, check: Callable[[], None]
) -> tuple[Problem, list[Fitted], Array, Predictions, bool, Fitted | None]:
    """Sets by posterior probability, given fitted and held-out records.

    The most probable sets are fitted to all records; the model alone is among them. Then: whether
    the calibrated model predicts the held-out records surely worse than the tabulated one, and the
    set that the held-out records support.
    """
    problem = searched.problem
    strict, sets = replace(problem, discrepancy_samples=STRICT), list(searched.sets.values())
    if not problem.held_out:
        return strict, *rank(strict, sets), {}, False, None
    some: dict[tuple[int, ...], Fitted] = {}
    for trust in (problem, strict):
        ranked, weight = rank(trust, sets)
        some |= {
            s.causes: s for s, w in zip(ranked[:PREDICTED], weight, strict=False) if w > UNLIKELY
        }
    best = next(iter(some.values()), None)
    for s in sets:  # what was exchanged for members of the best set
        apart = {*s.causes} ^ {*best.causes} if best is not None else set()
        if len(apart) == 2 and apart <= _linked(searched.alike, min(apart)):
            some[s.causes] = s
    alone = next(s for s in sets if not s.causes)
    some[()] = alone
    tabulated = replace(alone, point=replace(alone.point, x=np.zeros_like(alone.point.x)))
    known: Predictions = {}
    supported: Fitted | None = None
    try:
        *predicted, before = predict(problem, [*some.values(), tabulated], check)
        known = dict(zip(some, predicted, strict=True))
        supported = _supported(searched, list(some.values()), known, check)
        if supported is not None:
            some[supported.causes] = supported
        fitted = [s for s in some.values() if s.causes in known]
        everything = with_all_records(searched, fitted, [known[s.causes] for s in fitted], check)
    except (Stop, KeyboardInterrupt) as stop:
        searched.ended_by = stop
        return strict, *rank(strict, sets), known, False, supported
    searched.ended_by = everything.ended_by
    after, worse = known[()], False
    if after is not None and before is not None:
        worse = compare(after, before, alone.noise, alone.effective)[1] > 0.0
    return everything.problem, *everything.ranked(), known, worse, supported


def _supported(
    searched: Searched,
    some: Sequence[Fitted],
    predicted: Predictions,
    check: Callable[[], None],
) -> Fitted | None:
    """The smallest set of which each member surely improves the prediction of held-out records.

    From the best sets, members are dropped that do not, or that have another magnitude in each
    record, or are at a limit. Of sets that predict equally well, it is the most probable one.
    ``predicted`` gets the predictions of the sets without a member.
    """
    problem = searched.problem
    strict = replace(problem, discrepancy_samples=STRICT)
    base, found = predicted[()], None
    if base is None:
        return None

    def left(s: Fitted) -> float:
        own = predicted[s.causes]
        return math.inf if own is None else compare(own, base, s.noise, s.effective)[0]

    starts = sorted((s for s in some if s.causes), key=left)[:SUPPORTED]
    for now in starts:
        while now.members and predicted.get(now.causes) is not None:
            smaller = without_one(searched, now, check)
            new = [f for f in smaller if f is not None and f.causes not in predicted]
            for f, p in zip(new, predict(problem, new, check), strict=True):
                predicted[f.causes] = p
            worst, lowest = None, 0.0
            for member, one in zip(now.members, smaller, strict=True):
                need = _need(strict, now, member.cause, one, predicted)
                if need < lowest:
                    worst, lowest = one, need
            if worst is None:
                break
            now = worst
        ours = predicted.get(now.causes)
        if not now.members or ours is None:
            continue
        sure = compare(ours, base, now.noise, now.effective)[2] < 0.0
        if (
            sure
            and not _worse_than_constant(problem, ours)
            and (found is None or _preferred(left(found) - left(now), log_odds(strict, now, found)))
        ):
            found = now
    return found


def _preferred(gain: float, odds: float) -> bool:
    """Whether a set predicts better than another one, or as well and is more probable.

    ``gain``: log ratio of the residuals of the other one and its own; ``odds``: log odds.
    """
    return gain > (-WORTH_A_MEMBER if odds > 0.0 else WORTH_A_MEMBER)


def _need(
    problem: Problem, now: Fitted, cause: int, without: Fitted | None, predicted: Predictions
) -> float:
    """How surely a member improves the prediction of held-out records; < 0: not surely.

    Lower end of the interval of the log ratio of the residuals without and with it.
    """
    ours, theirs = predicted[now.causes], None if without is None else predicted[without.causes]
    if without is None or ours is None:
        return 0.0
    if theirs is None:  # without it, the simulation fails
        return math.inf
    ratio, low, _ = compare(theirs, ours, now.noise, now.effective)
    everywhere = problem.causes[cause].local is None
    if everywhere and (_by_record(problem, now, cause)[1] < SAME or _at_limit(problem, now, cause)):
        return -10.0 + low
    return low if ratio > WORTH_A_MEMBER else min(low, ratio - WORTH_A_MEMBER)


def _at_limit(problem: Problem, fitted: Fitted, cause: int) -> bool:
    """Whether a magnitude is at a limit that is none of its law: 0 and 1 are."""
    found = problem.causes[cause]
    if found.effect is None:
        return False
    x = fitted.point.x[index_of(problem, fitted.members, cause)]
    return any(
        math.isfinite(v) and abs(x - v) < 1e-6 * max(abs(v), 1.0) and v * found.effect.scale != 1.0
        for v in found.bounds
    )


def _worse_than_constant(problem: Problem, predicted: Predicted) -> bool:
    """Whether the mean of a channel would predict the held-out records better.

    Not if a record shows noise only: at rest, no model is better than the mean.
    """
    least = np.maximum(spread(problem.held_out), 2.0 * problem.noise)
    return bool(np.any(predicted.rms(problem) > least))


def _not_needed(
    problem: Problem,
    shown: Problem,
    sets: Sequence[Fitted],
    told: Sequence[int],
    predicted: Predictions,
) -> list[int]:
    """The first told cause that is not needed, or all if the held-out records refuse their set.

    A cause is needed if the set without it was fitted: its evidence is that of both.
    """
    if not told:
        return []
    best, by_causes = _representative(sets, told, ()), {s.causes for s in sets}
    ours, base = predicted.get(best.causes), predicted.get(())
    if ours is not None and base is not None:
        worse = compare(ours, base, best.noise, best.effective)[1] > 0.0
        if worse or _worse_than_constant(shown, ours):
            return list(told)
    for i in told:
        if problem.causes[i].local is not None:
            continue
        if tuple(k for k in best.causes if k != i) not in by_causes:
            return [i]
    return []


def _worse_by(problem: Problem, one: Fitted, other: Fitted) -> float:
    """Difference of the negative log likelihoods of two sets."""
    left = [problem.samples * np.log(s.noise) + 0.5 * s.squares / s.noise**2 for s in (one, other)]
    return float(weights(problem, one, other) @ (left[0] - left[1]))


def _without(
    problem: Problem, sets: Sequence[Fitted], causes: Sequence[int]
) -> tuple[list[Fitted], Array]:
    """The sets without some causes, with their probabilities."""
    return rank(problem, [s for s in sets if not {*s.causes} & {*causes}])


def _tested(problem: Problem, cause: int) -> bool:
    """Whether the part of a parameter was tested by itself."""
    of = problem.causes[cause].parameter
    return of is not None and problem.model.parameters[of].before is not None


def _with_equivalents(
    problem: Problem,
    alike: Sequence[frozenset[int]],
    sets: Sequence[Fitted],
    told: Sequence[int],
    classes: Sequence[Sequence[int]],
) -> tuple[list[int], list[list[int]]]:
    """Named causes and classes, in which those are that explain the records equally well.

    A law with a shape is omitted if one without explains the records as well: a dead zone or a
    saturation whose level no record reaches is a gain. A part that was tested by itself is not
    put beside another cause: its test contradicts it.
    """
    names: list[int] = []
    out: list[list[int]] = []
    for group in (*([i] for i in told), *classes):
        own = list(group)
        for i in group:
            ours = _where(sets, i)
            for j in _linked(alike, i) - {*own}:
                theirs = [s for s in sets if {*s.causes} == ({*ours.causes} - {i}) | {j}]
                if not theirs:
                    continue
                equal = abs(_worse_by(problem, theirs[0], ours)) < EQUAL
                if _tested(problem, j) or not equal:
                    continue
                odds = log_odds(problem, theirs[0], ours)
                odds += _of_sizes(problem, (ours, i), (theirs[0], j))
                if odds > math.log(UNLIKELY):
                    own.append(j)
        plain = [i for i in own if not _has_shape(problem, i)]
        if plain and len(own) > len(group):
            own = plain
        own.sort(key=lambda i: (_has_shape(problem, i), not problem.causes[i].of_records))
        if len(own) > 1:
            out.append(own[:CLASS])
        else:
            names += own
    return names, out


def _linked(alike: Sequence[frozenset[int]], cause: int) -> set[int]:
    """Causes that stand for a cause, also by way of others."""
    linked: set[int] = {cause}
    while more := {k for pair in alike if pair & linked for k in pair} - linked:
        linked |= more
    return linked


def _of_sizes(problem: Problem, one: tuple[Fitted, int], other: tuple[Fitted, int]) -> float:
    """What the size of one member costs less than that of another one; 0 if it is usual.

    Beyond five expected sizes the expectation was wrong, and tells no equivalent from another.
    """
    costs: list[float] = []
    for fitted, cause in (one, other):
        x, k = fitted.point.x, index_of(problem, fitted.members, cause)
        prior = prior_of(problem, fitted.members)
        if not costs and prior.weight[k] * x[k] ** 2 < RELEASED**2:
            return 0.0
        costs.append(prior.penalty(x) - prior.penalty(np.where(np.arange(x.size) == k, 0.0, x)))
    return 0.5 * (costs[1] - costs[0])


def _has_shape(problem: Problem, cause: int) -> bool:
    effect = problem.causes[cause].effect
    return effect is not None and bool(movable(effect))


def _by_trust(problem: Problem, sets: Sequence[Fitted], options: Options) -> tuple[str, ...]:
    """A note if the told causes depend on the number of samples as which a discrepancy counts."""
    said = {}
    for count in (0.5 * STRICT, STRICT, 2.0 * STRICT):
        told, classes = _told(
            *rank(replace(problem, discrepancy_samples=count), sets), options.credibility
        )
        names = [problem.causes[i].name for i in told]
        names += ["one of " + ", ".join(problem.causes[i].name for i in g) for g in classes]
        said[count] = " and ".join(names) or "nothing"
    now = said.pop(STRICT)
    return tuple(
        f"If a discrepancy of the model counted as {count:g} samples instead of {STRICT:g}, {text} "
        "would be told"
        for count, text in said.items()
        if text != now
    )


def _consistent(
    problem: Problem, sets: Sequence[Fitted], weight: Array
) -> tuple[list[Fitted], Array, set[int]]:
    """The sets without imitations, with their probabilities, and the imitations.

    A cause whose magnitude differs between records in every set is an imitation of something that
    no cause of the list has, whatever its evidence.
    """
    causes = {i for s in sets for i in s.causes if problem.causes[i].local is None}
    imitations = {
        i for i in causes if all(_by_record(problem, s, i)[1] < SAME for s in sets if i in s.causes)
    }
    kept = [s for s in sets if not imitations & set(s.causes)]
    if len(kept) == len(sets):
        return list(sets), weight, imitations
    return (*rank(problem, kept), imitations)


def _told(
    sets: Sequence[Fitted], weight: Array, credibility: float
) -> tuple[list[int], list[list[int]]]:
    """Causes that are named, and classes of which one is missing.

    As long as the sets with a cause that is not told yet have the probability ``credibility``
    together, the fewest such causes are collected, the most probable first, of which at least one
    is in sets of this probability. One cause is named; several are a class.
    """
    told: list[int] = []
    classes: list[list[int]] = []
    taken: set[int] = set()
    while True:
        rest = [set(s.causes) - taken for s in sets]
        if sum(w for r, w in zip(rest, weight, strict=True) if r) < credibility:
            break
        group: list[int] = []
        while True:
            open_ = [(r, w) for r, w in zip(rest, weight, strict=True) if not r & set(group)]
            covered = 1.0 - sum(w for _, w in open_)
            if covered >= credibility:
                break
            share: dict[int, float] = {}
            for r, w in open_:
                for i in r:
                    share[i] = share.get(i, 0.0) + float(w)
            group.append(max(share, key=lambda i: share[i]))
        taken |= set(group)
        if len(group) > CLASS:
            break
        if len(group) > 1:
            classes.append(group)
        else:
            told.append(group[0])
    return told, classes


def _where(sets: Sequence[Fitted], cause: int, group: Sequence[int] = ()) -> Fitted:
    """The most probable set with a cause, if there is one without the others of its class."""
    own = [s for s in sets if cause in s.causes]
    return next((s for s in own if {*s.causes} & {*group} <= {cause}), own[0])


def _representative(
    sets: Sequence[Fitted], told: Sequence[int], classes: Sequence[Sequence[int]]
) -> Fitted:
    """The most probable set that agrees with what is told."""
    for s in sets:
        own = set(s.causes)
        agrees = set(told) <= own and all(own & set(group) for group in classes)
        if agrees and (told or classes or not own):
            return s
    return sets[0]


def _covariance(problem: Problem, fitted: Fitted) -> Array:
    """Covariance of the global unknowns of a set, in their scales."""
    return _precision(problem, fitted)[1]


def _precision(problem: Problem, fitted: Fitted) -> tuple[NormalEquations, Array]:
    """Normal equations of a set, and the covariance of its global unknowns in their scales.

    What an estimate has taken up of a discrepancy is not seen. It may be larger than what is left,
    so that the discrepancy counts as half a sample: of the numbers 1/4, 1/2, 0.7 and 1, it has the
    least interval score on the imperfect machines of the yardstick.
    """
    samples = np.maximum(problem.samples, 1.0)
    left = np.maximum(fitted.noise / np.maximum(_white(problem, fitted), 1.0), 1.0) ** 2
    weight = (
        left
        * precision(left, 1.0 / (fitted.effective * samples), discrepancy_samples=0.5)
        / samples
    )
    point, linears = fitted.point, fitted.linears
    own = system(problem, problem.fit, fitted.members, point, linears, fitted.noise, weight)
    prior = prior_of(problem, fitted.members).weights(point.x)
    return own, np.asarray(np.linalg.inv(own.matrix + np.diag(prior)))


def _by_record(problem: Problem, fitted: Fitted, cause: int) -> tuple[Array, float]:
    """Magnitude in each record in its scale, and the probability of their differences.

    Differences that move no channel of a record by more than its noise are none, however many
    samples show them.
    """
    from scipy.special import chdtrc

    k = index_of(problem, fitted.members, cause)
    if len(problem.fit) < 2:
        return fitted.point.x[k : k + 1], 1.0
    values, covariance = by_record(problem, fitted, k)
    inverse = np.linalg.inv(covariance)
    apart = values - (inverse @ values).sum() / inverse.sum()
    counts = [np.maximum(o.samples, 1.0) for o in problem.fit]
    moved = [
        abs(d) * np.sqrt((x.by_global[..., k] ** 2).sum(axis=0) / n) / fitted.noise
        for d, x, n in zip(apart, fitted.linears, counts, strict=True)
    ]
    if np.max(moved) < 1.0:
        return values, 1.0
    return values, float(chdtrc(len(values) - 1, apart @ inverse @ apart))


def _named(
    problem: Problem, fitted: Fitted, sets: Sequence[Fitted], weight: Array, cause: int
) -> NamedCause:
    """A cause with its magnitude in a set."""
    found = problem.causes[cause]
    probability = float(sum(w for s, w in zip(sets, weight, strict=True) if cause in s.causes))
    if found.local is not None:
        return _in_each_record(problem, fitted, cause, probability)
    k = index_of(problem, fitted.members, cause)
    sd = math.sqrt(max(_covariance(problem, fitted)[k, k], 0.0))
    values, _ = _by_record(problem, fitted, cause)
    effect, words, shape, changes = found.effect, found.effect or found.alias, None, ""
    value, zero, scale = _size(problem, fitted, cause)
    if effect is not None:
        shape = shapes_of(problem, fitted.members, fitted.point.x)[k - len(problem.free)].shape
    else:
        p = problem.model.parameters[problem.free[k]]
        changes, unit, (low, high) = p.name, p.unit, (p.lower, p.upper)
    if words is not None:
        unit, (low, high) = words.unit, words.bounds
    half = HALF * sd * abs(scale)
    return NamedCause(
        cause=found.name,
        component=found.component,
        unit=unit,
        magnitude=value,
        low=float(max(value - half, low)),
        high=float(min(value + half, high)),
        probability=probability,
        shape=shape,
        shape_names=() if effect is None else effect.shape_names,
        by_record=tuple(float(zero + scale * v) for v in values),
        parameter=words is None,
        changes=changes,
        mechanism="" if words is None else words.mechanism,
        remedy="" if words is None else words.remedy,
        kind="parameter" if words is None else words.kind,
        title="" if words is None else words.label,
        relative=words is not None and words.relative,
        user_unit=None if effect is not None else _user_unit(p, found.alias),
        subject=found.subject,
    )


def _user_unit(p: Parameter, alias: Effect | None) -> UserUnit | None:
    """The further unit of a parameter, per unit of the effect that is its other name."""
    unit = p.user_unit
    if alias is None:
        return unit
    if unit is None and p.relative and alias.unit != p.unit:
        unit = UserUnit("%", 100.0)
    return unit and replace(unit, per_unit=unit.per_unit * alias.tolerance_ratio)


def _size(problem: Problem, fitted: Fitted, cause: int) -> tuple[float, float, float]:
    """Magnitude of a cause in a set, its zero and its scale; NaN: it differs between records."""
    found = problem.causes[cause]
    if found.local is not None:
        return math.nan, 0.0, math.nan
    k, zero = index_of(problem, fitted.members, cause), 0.0
    if found.effect is not None:
        scale = found.effect.scale
    elif found.alias is not None:
        scale = float(problem.unit[k]) / found.alias.tolerance_ratio
    else:
        zero, scale = float(problem.tabulated[problem.free[k]]), float(problem.unit[k])
    return zero + scale * float(fitted.point.x[k]), zero, scale


def _in_each_record(problem: Problem, fitted: Fitted, cause: int, probability: float) -> NamedCause:
    """An error of a sensor in each record; its magnitude is the rms over the records."""
    found = problem.causes[cause]
    assert found.local is not None
    fault = fault_of(found.local.kind)
    assert fault.each is not None
    key = (fault.name, found.local.index)
    at = [
        [(q.kind, q.index) for q in local_of(problem, fitted.members, o)].index(key)
        for o in problem.fit
    ]
    values = [float(v[k]) for v, k in zip(fitted.point.local, at, strict=True)]
    rms = math.sqrt(sum(v * v for v in values) / len(values))
    own, covariance = _precision(problem, fitted)
    # The rms depends on the values, and these on the unknowns that all records have.
    variance, shared = 0.0, np.zeros(covariance.shape[0])
    for v, k, (inner, coupling, _) in zip(values, at, own.locals, strict=True):
        slope = v / (len(values) * rms) if rms > 0.0 else 0.0
        of_record = np.linalg.solve(inner, np.column_stack([np.eye(len(inner))[k], coupling]))[k]
        variance += slope**2 * float(of_record[0])
        shared += slope * of_record[1:]
    half = HALF * math.sqrt(variance + float(shared @ covariance @ shared))
    scale = found.local.scale
    return NamedCause(
        cause=found.name,
        component=found.component,
        unit=fault.unit or problem.units[found.local.index],
        magnitude=scale * rms,
        low=scale * max(rms - half, 0.0),
        high=scale * (rms + half),
        probability=probability,
        by_record=tuple(scale * v for v in values),
        mechanism=f"The sensor has another {fault.each[0]} in each record.",
        remedy=fault.each[1],
        kind="sensor",
        subject=found.subject,
    )


def _parameters(problem: Problem, fitted: Fitted) -> tuple[ParameterValue, ...]:
    """Values of the free parameters of the machine with their intervals."""
    theta, covariance = theta_at(problem, fitted.point.x), _covariance(problem, fitted)
    out = []
    for k, i in enumerate(problem.free):
        p = problem.model.parameters[i]
        if not p.of_the_machine:
            continue
        half = HALF * problem.unit[k] * math.sqrt(max(covariance[k, k], 0.0))
        out.append(
            ParameterValue(
                p.name,
                p.title,
                p.unit,
                p.value,
                p.sd,
                float(theta[i]),
                float(max(theta[i] - half, p.lower)),
                float(min(theta[i] + half, p.upper)),
                p.relative,
                p.user_unit,
            )
        )
    return tuple(out)


def _correlation(problem: Problem, fitted: Fitted) -> tuple[tuple[str, ...], Array]:
    """Names of the unknowns of the machine in a set, and their correlation."""
    covariance = _covariance(problem, fitted)
    free = [problem.model.parameters[i] for i in problem.free]
    names = [*(p.name for p in free), *(e.name for e in problem.effects_of(fitted.members))]
    kept = [k for k in range(len(names)) if k >= len(free) or free[k].of_the_machine]
    part = covariance[np.ix_(kept, kept)]
    sd = np.sqrt(np.maximum(np.diag(part), 1e-300))
    return tuple(names[k] for k in kept), part / np.outer(sd, sd)


def _traces(
    problem: Problem, shown: Problem, alone: Fitted, best: Fitted, channels: Sequence[Channel]
) -> tuple[Trace, ...]:
    """Residuals of the channel that the calibrated model misses most."""
    c = worst_of(channels)
    held = {o.record.name for o in shown.held_out}
    out = []
    for r, o in enumerate(problem.fit):
        own = slice(o.end)
        if not o.valid[own, c].any():
            continue
        pair = [
            np.where(o.valid[own, c], s.linears[r].residual[own, c] * o.sd[own, c], np.nan)
            for s in (alone, best)
        ]
        name = o.record.name
        out.append(Trace(name, name in held, o.record.time[own], *pair))
    return tuple(out)


def _rms(problem: Problem, fitted: Fitted) -> Array:
    """Rms of the residual by channel [its unit], (m,)."""
    return rms_of(problem.fit, fitted.residuals)


def _white(problem: Problem, fitted: Fitted) -> Array:
    """Noise of each sensor from the residual of a set, in units of the noise so far [1], (m,).

    It is the part of the residual that neighboring samples do not share, so that a residual which
    is white is noise.
    """
    of_records = [
        [
            noise_of_samples(o.record.time[o.valid[:, c]], x.residual[o.valid[:, c], c], 1)
            for c in range(fitted.noise.size)
        ]
        for x, o in zip(fitted.linears, problem.fit, strict=True)
    ]
    return np.asarray(np.sqrt(np.mean(np.square(of_records), axis=0)))


def _channels(
    problem: Problem,
    shown: Problem,
    alone: Fitted,
    best: Fitted,
    predicted: dict[tuple[int, ...], Predicted | None],
    options: Options,
) -> tuple[Channel, ...]:
    """Residuals by channel of the tabulated, the calibrated, and the explained model."""
    point = empty_point(problem, (), problem.fit)
    start = type(point)(
        point.x,
        tuple(
            np.array([v if q.weight < 1e-4 else 0.0 for q, v in zip(o.local, values, strict=True)])
            for o, values in zip(problem.fit, alone.point.local, strict=True)
        ),
    )
    seen = evaluate(problem, [EvaluationRequest((), start, problem.fit, derivatives=False)])[0]
    tabulated = rms_of(problem.fit, (x.residual for x in seen))
    calibrated, explained = _rms(problem, alone), _rms(problem, best)
    noise = problem.noise * (_white(problem, best) if problem.noise_estimated else 1.0)
    held = [None if (p := predicted.get(s.causes)) is None else p.rms(shown) for s in (alone, best)]
    out = []
    for c, (name, unit) in enumerate(zip(problem.names, problem.units, strict=True)):
        stated = options.good_enough.get(name, options.good_enough.get(unit))
        motion = float(problem.motion[c])
        out.append(
            Channel(
                name,
                unit,
                float(noise[c]) or math.nan,
                motion,
                float(tabulated[c]),
                float(calibrated[c]),
                float(explained[c]),
                math.nan if held[0] is None else float(held[0][c]),
                math.nan if held[1] is None else float(held[1][c]),
                GOOD_ENOUGH * motion if stated is None else stated,
            )
        )
    return tuple(out)
