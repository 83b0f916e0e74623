"""The verdict: the chosen set becomes named causes, classes, and causes that are not sure.

Everything that is told is of one fitted set: sizes, intervals, what each change takes away, the
model that is handed out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unmodeled.chain import fault_of
from unmodeled.data import Array
from unmodeled.models.model import Effect, Parameter, UserUnit
from unmodeled.search.choice import UNLIKELY, Chosen, Need, choose
from unmodeled.search.evidence import Fitted, log_evidence, log_odds, prior_of, weights
from unmodeled.search.fit import Start, empty_point, fit_sets
from unmodeled.search.held_out import HALF, compare
from unmodeled.search.ledger import SAME, Finding, Mark, marked
from unmodeled.search.linear import (
    EvaluationRequest,
    Point,
    evaluate,
    movable,
    shapes_of,
    theta_at,
)
from unmodeled.search.locate import cells, events, most_different, places
from unmodeled.search.options import Options
from unmodeled.search.problem import RELEASED, STRICT, Cause, Problem, rms_of
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
from unmodeled.search.search import Searched, linked, rank, refit
from unmodeled.search.tolerances import (
    Combination,
    Posterior,
    combination,
    in_each_record,
    posterior,
    white,
)

#: Largest number of members of a class, of causes or of parameters, that is told.
CLASS = 6
#: Difference of the log likelihoods below which two causes are equal.
EQUAL = 1.0


@dataclass(frozen=True, eq=False)
class Answer:
    """The one fitted set of which everything is told."""

    chosen: Chosen
    problem: Problem
    """All records; parameters that keep their tabulated values are ``narrow``."""
    best: Fitted
    """The set."""
    posterior: Posterior
    """Of its global unknowns."""
    sets: list[Fitted]
    """All sets, the most probable first."""
    weight: Array
    """Their probabilities [1]."""
    groups: dict[int, list[int]]
    """Equivalents of each member that has some."""


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
    tell("held_out")
    chosen = choose(searched, options, check)
    tell("judge")
    answer = _answer(chosen, options, check)
    problem, best = answer.problem, answer.best
    searched.answer = problem, chosen.alone, best
    channels = _channels(answer, options)
    without = _together(answer, channels, _without(answer), check)
    changed, of_parameters = _changed(answer, options)
    without += of_parameters
    findings = _findings(answer, channels, without, options)
    told = _marked_causes(answer, findings)
    classes = tuple(told[Mark.ONE_OF])
    tell("locate")
    ports = _places(answer, channels, check)
    verdict = _verdict(told, channels)
    unknowns, correlation = _correlation(answer)
    return Result(
        verdict=verdict,
        reasons=_reasons(answer, told, channels),
        channels=channels,
        named=tuple(g[0] for g in told[Mark.NAMED]),
        classes=classes,
        supported=tuple(g[0] for g in told[Mark.SUPPORTED]),
        small=tuple(told[Mark.SMALL]),
        unsure=tuple(told[Mark.UNSURE]),
        parameters=_parameters(answer),
        changed=changed,
        without=tuple(without),
        sets=_sets(answer),
        held_out_gain=_held_out_gain(answer),
        nothing=float(
            sum(w for s, w in zip(answer.sets, answer.weight, strict=True) if not s.causes)
        ),
        not_tried=_not_tried(problem, findings),
        causes=sum(c.family < 0 for c in problem.causes),
        complete=searched.ended_by is None,
        drawn=answer.posterior.drawn,
        notes=problem.notes,
        seconds=seconds,
        records=tuple(o.record.name for o in problem.fit),
        cells=cells(problem, chosen.alone, best),
        events=events(problem, chosen.alone, best),
        places=ports,
        apart=_apart(answer, findings),
        unknowns=unknowns,
        correlation=correlation,
        reported=tuple(problem.causes[i].name for i in best.causes),
        findings=findings,
        traces=_traces(answer, channels),
    )


# ---------------------------------------------------------------- the one set


def _answer(chosen: Chosen, options: Options, check: Callable[[], None]) -> Answer:
    """The chosen set with the reading of the tolerances that the records prefer."""
    problem, best = chosen.problem, chosen.best
    sets, weight = rank(problem, list(chosen.everything.sets.values()))
    own = posterior(problem, best, options.tolerances)
    try:
        refit = _kept(chosen, own, check)
    except (Stop, KeyboardInterrupt) as stop:
        chosen.searched.ended_by = chosen.searched.ended_by or stop
        refit = None
    if refit is not None:
        problem, best = refit
        own = posterior(problem, best, options.tolerances)
    elif len(own.configurations[0].wide) < len(own.tested):
        own = posterior(problem, best, "drawn")
    groups = _equivalents(chosen, sets, weight, options.credibility)
    return Answer(chosen, problem, best, own, sets, weight, groups)


def _kept(
    chosen: Chosen, own: Posterior, check: Callable[[], None]
) -> tuple[Problem, Fitted] | None:
    """The set with the parameters that keep their tabulated values.

    None: all deviate by their tolerances, or a fit with these is less probable after all.
    """
    problem, best, first = chosen.problem, chosen.best, own.configurations[0]
    narrow = frozenset(own.tested) - first.wide
    if not narrow:
        return None
    less = replace(problem, narrow=narrow)
    low, high = problem.parameter_bounds
    x = first.mean.copy()
    x[: low.size] = np.clip(x[: low.size], low, high)
    start = Start(best.members, (Point(x, best.point.local), best.point))
    (fitted,) = fit_sets(less, [start], check)
    if fitted is None:
        return None
    drawn = next((c for c in own.configurations if len(c.wide) == len(own.tested)), None)
    if drawn is not None:
        weight = weights(problem, best, fitted)
        prior = first.log_prior - drawn.log_prior
        gain = log_evidence(less, fitted, weight) - log_evidence(problem, best, weight)
        if gain + prior < 0.0:
            return None
    return less, fitted


# ---------------------------------------------------------------- findings


def _findings(
    answer: Answer, channels: Sequence[Channel], without: Sequence[Without], options: Options
) -> tuple[Finding, ...]:
    """The finding of each candidate, members first, then by their gain to first order."""
    chosen, problem = answer.chosen, answer.problem
    fitted = {i for s in chosen.searched.sets.values() for i in s.causes}
    fitted |= problem.families_of(fitted)  # a scope is no further law
    gains = {s.cause: s.gain for s in chosen.searched.first}
    taken = {w.name: takes_over(channels, w) for w in without}
    by_trust = [
        rank(replace(chosen.problem, discrepancy_samples=f * STRICT), answer.sets)
        for f in (0.5, 2.0)
    ]
    out = []
    for i, cause in enumerate(problem.causes):
        need = chosen.needs.get(i, Need())
        member = i in answer.best.causes
        found = Finding(
            cause.name,
            member=member,
            left=need.left and not member,
            fitted=i in fitted,
            gain=gains.get(i, math.nan),
            probability=_probability(answer.sets, answer.weight, i),
            least_probability=min(_probability(*ranked, i) for ranked in by_trust),
            evidence=need.evidence,
            predicts=need.predicts,
            refused=need.refused,
            same=need.differs,
            stands_for=tuple(
                problem.causes[m].name for m, group in answer.groups.items() if i in group
            ),
            complete=chosen.searched.grown,
            credibility=options.credibility,
        )
        if need.held_out is not None:
            ratio = need.held_out
            found = replace(
                found,
                held_out=(math.exp(ratio.value), math.exp(ratio.low), math.exp(ratio.high)),
                better=ratio.records - ratio.smaller,
                of=ratio.records,
            )
        if member:
            found = replace(
                found,
                at_limit=_at_limit(problem, answer.best, i),
                takes=taken.get(cause.name, math.nan),
                excludes_zero=_excludes_zero(answer, i),
                together=_probability(answer.sets, answer.weight, i, *answer.groups.get(i, ())),
                equivalents=tuple(problem.causes[k].name for k in answer.groups.get(i, ())),
            )
        out.append(marked(found))
    return tuple(sorted(out, key=lambda f: (not f.member, -np.nan_to_num(f.gain, nan=-math.inf))))


def _not_tried(problem: Problem, findings: Sequence[Finding]) -> tuple[str, ...]:
    """Laws that no fitted set has in any scope."""
    laws = {c.name for c in problem.causes if c.family < 0}
    return tuple(f.cause for f in findings if not f.fitted and f.cause in laws)


def _probability(sets: Sequence[Fitted], weight: Array, *causes: int) -> float:
    """Probability of the sets with one of these causes."""
    own = (w for s, w in zip(sets, weight, strict=True) if not {*causes}.isdisjoint(s.causes))
    return min(float(sum(own)), 1.0)


def _excludes_zero(answer: Answer, cause: int) -> bool:
    """Whether the interval of a member of the set excludes zero."""
    if answer.problem.causes[cause].local is not None:
        return True
    k = index_of(answer.problem, answer.best.members, cause)
    _, low, high = answer.posterior.interval(k)
    return not low <= 0.0 <= high


def _marked_causes(
    answer: Answer, findings: Sequence[Finding]
) -> dict[Mark, list[tuple[NamedCause, ...]]]:
    """The members of the set by mark, each with its equivalents."""
    names = {c.name: i for i, c in enumerate(answer.problem.causes)}
    told: dict[Mark, list[tuple[NamedCause, ...]]] = {mark: [] for mark in Mark}
    for f in findings:
        if f.mark is None:
            continue
        i = names[f.cause]
        group = answer.groups.get(i, [])
        own = [_named(answer, answer.best, answer.posterior, i)]
        for k in group:
            other = _where(answer.sets, k, [i, *group])
            whole = posterior(answer.chosen.problem, other, "drawn")
            own.append(_named(answer, other, whole, k))
        told[f.mark].append(tuple(replace(n, mark=f.mark.value) for n in own))
    return told


def _equivalents(
    chosen: Chosen, sets: Sequence[Fitted], weight: Array, credibility: float
) -> dict[int, list[int]]:
    """Equivalents of each member of the chosen set.

    They are the other members of its class beside the other members of the set, else of its class
    in all sets, and what explains the records equally well.
    """
    told, classes = _told([s.causes for s in sets], weight, credibility)
    members, out = set(chosen.best.causes), {}
    for i in chosen.best.causes:
        others = members - {i}
        beside = [k for k, s in enumerate(sets) if others <= {*s.causes}]
        share = weight[beside] / weight[beside].sum()
        _, own = _told([{*sets[k].causes} - others for k in beside], share, credibility)
        known = [[k] for k in told] + own + classes
        group = next((g for g in known if i in g), [i])
        whole = _with_equivalents(chosen.problem, chosen.searched.alike, sets, group)
        rest = [k for k in whole if k != i and k not in members]
        if rest:
            out[i] = rest[: CLASS - 1]
    return out


# ---------------------------------------------------------------- what a change takes away


def _without(answer: Answer) -> list[Without]:
    """What is left without each member of the set, all other unknowns fitted again.

    A parameter that is a member, or an equivalent of one, has its tabulated value.
    """
    problem, after = answer.problem, tuple(map(float, _rms(answer.problem, answer.best)))
    out = []
    for i in answer.best.causes:
        rest = answer.chosen.everything.sets.get(tuple(k for k in answer.best.causes if k != i))
        before = (math.inf,) * len(after)
        group = [problem.causes[k] for k in (i, *answer.groups.get(i, ()))]
        own = [problem.free.index(c.parameter) for c in group if c.parameter is not None]
        if rest is not None and own:
            (before,) = _with_tabulated(problem, rest, posterior(problem, rest, "drawn"), [own])
        elif rest is not None:
            before = tuple(map(float, _rms(problem, rest)))
        out += [Without(c.name, before, after) for c in group]
    return out


def _together(
    answer: Answer,
    channels: Sequence[Channel],
    without: Sequence[Without],
    check: Callable[[], None],
) -> list[Without]:
    """What is left without each member, where those that take little alone take much together.

    Two laws that do nearly the same take little each. If all members that take less than what
    matters take more together, each matters without which the others of them take less.
    """
    found, problem = {w.name: w for w in without}, answer.problem

    def over(cause: int, before: tuple[float, ...]) -> float:
        return takes_over(channels, replace(found[problem.causes[cause].name], before=before))

    def names(causes: Collection[int]) -> list[str]:
        return [problem.causes[i].name for i in causes]

    little = [i for i, n in zip(answer.best.causes, names(answer.best.causes), strict=True)
              if takes_over(channels, found[n]) < 1.0]  # fmt: skip
    if len(little) < 2:
        return list(found.values())
    try:
        whole = _left_without(answer, little, check)
        if over(little[0], whole) < 1.0:
            return list(found.values())
        rest = {i: [k for k in little if k != i] for i in little}
        matter = [i for i in little if over(i, _left_without(answer, rest[i], check)) < 1.0]
    except (Stop, KeyboardInterrupt) as stop:
        answer.chosen.searched.ended_by = stop
        return list(found.values())
    for i in matter or little:
        for name in names([i, *answer.groups.get(i, ())]):
            found[name] = replace(found[name], before=whole, beside=tuple(names(rest[i])))
    return list(found.values())


def _left_without(
    answer: Answer, causes: Collection[int], check: Callable[[], None]
) -> tuple[float, ...]:
    """Residual by channel of the set without some members; infinite: it cannot be fitted."""
    kept = tuple(m for m in answer.best.members if m.cause not in causes)
    (fitted,) = refit(answer.chosen.everything, [(kept, answer.best, ())], check)
    if fitted is None:
        return (math.inf,) * len(answer.problem.channels)
    return tuple(map(float, _rms(answer.problem, fitted)))


def _changed(
    answer: Answer, options: Options
) -> tuple[tuple[tuple[ParameterValue, ...], ...], list[Without]]:
    """Parameters that changed, each with its equivalents, and what is left without them."""
    own = answer.posterior
    apart = [k for k in own.tested if not (i := own.interval(k))[1] <= 0.0 <= i[2]]
    told, classes = _told(own.sets(), own.weight, options.credibility)
    groups = [[k] for k in dict.fromkeys([*apart, *told])]
    groups += [g for g in classes if not {*g} & {*apart, *told}]
    values = [tuple(_parameter(answer, k, (k,) if len(g) > 1 else ()) for k in g) for g in groups]
    lost = [*groups]
    together = combination(own, _relative(answer.problem), {k for g in groups for k in g})
    if together is not None:
        values.append((_product(answer.problem, together),))
        lost.append(list(together.parameters))
    after = tuple(map(float, _rms(answer.problem, answer.best)))
    left = _with_tabulated(answer.problem, answer.best, own, lost)
    without = [
        Without(p.name, before, after)
        for alike, before in zip(values, left, strict=True)
        for p in alike
    ]
    return tuple(values), without


def _relative(problem: Problem) -> Array:
    """Standard deviation of the prior of each free parameter over its value [1]; 0: no product."""
    own = [problem.model.parameters[i] for i in problem.free]
    return np.array(
        [p.sd / p.value if p.value > 0.0 and not p.relative and p.sd < 0.3 * p.value else 0.0
         for p in own]
    )  # fmt: skip


def _product(problem: Problem, found: Combination) -> ParameterValue:
    """A product of powers of parameters in the form of a parameter: its relative deviation."""
    names = [problem.model.parameters[problem.free[k]].name for k in found.parameters]
    powers = [n if e == 1 else f"{n}^{e}" for n, e in zip(names, found.exponents, strict=True)]
    name = " ".join(powers)
    either = f"{', or '.join(names)}, or {'both' if len(names) == 2 else 'all'}"
    return ParameterValue(
        name, f"The product {name} ({either})", "1", 0.0, found.sd, found.value, found.low,
        found.high, relative=True,
    )  # fmt: skip


def _with_tabulated(
    problem: Problem, fitted: Fitted, own: Posterior, changed: Sequence[Sequence[int]]
) -> list[tuple[float, ...]]:
    """Residual by channel if some parameters have their tabulated values, for each such group.

    The other unknowns follow to first order, but not the parameters that keep their values.
    Infinite: a simulation fails.
    """
    inverse = np.linalg.inv(own.configurations[0].covariance)
    low, high = problem.parameter_bounds
    asked = []
    for at in changed:
        x = fitted.point.x.copy()
        rest = [j for j in range(x.size) if j not in problem.narrow and j not in at]
        x[rest] += np.linalg.solve(inverse[np.ix_(rest, rest)], inverse[np.ix_(rest, at)] @ x[at])
        x[: low.size] = np.clip(x[: low.size], low, high)
        x[at] = 0.0
        point = Point(x, fitted.point.local)
        asked.append(EvaluationRequest(fitted.members, point, problem.fit, derivatives=False))
    out = []
    for linears in evaluate(problem, asked) if asked else []:
        with np.errstate(all="ignore"):
            rms = rms_of(problem.fit, (v.residual for v in linears))
        out.append(tuple(float(v) if math.isfinite(v) else math.inf for v in rms))
    return out


def _places(
    answer: Answer, channels: Sequence[Channel], check: Callable[[], None]
) -> tuple[Place, ...]:
    """Where something unknown acts, if what remains matters."""
    if not any(c.material for c in channels):
        return ()
    try:
        check()
        return places(answer.problem, answer.best)
    except (Stop, KeyboardInterrupt) as stop:
        answer.chosen.searched.ended_by = stop
        return ()


def _apart(answer: Answer, findings: Sequence[Finding]) -> tuple[str, ...]:
    """For each class, the record in which its first two members differ most."""
    names = {c.name: i for i, c in enumerate(answer.problem.causes)}
    pairs = [
        (names[f.cause], answer.groups[names[f.cause]][0])
        for f in findings
        if f.mark is Mark.ONE_OF
    ]
    return tuple(
        most_different(answer.chosen.problem, _where(answer.sets, a), _where(answer.sets, b))
        for a, b in pairs
    )


def _held_out_gain(answer: Answer) -> tuple[float, float, float] | None:
    """Held-out residual with the set over that without causes, and its interval [1]."""
    chosen, best = answer.chosen, answer.chosen.best
    ours, base = chosen.predicted.get(best.causes), chosen.predicted.get(())
    if not best.causes or ours is None or base is None:
        return None
    ratio = compare(ours, base, best.noise, best.effective)
    return math.exp(ratio.value), math.exp(ratio.low), math.exp(ratio.high)


def _sets(answer: Answer) -> tuple[SetOfCauses, ...]:
    problem = answer.chosen.problem
    return tuple(
        SetOfCauses(
            tuple(problem.causes[i].name for i in s.causes),
            float(w),
            tuple(float(v) for v in _rms(problem, s)),
            tuple(_size(problem, s, i)[0] for i in s.causes),
        )
        for s, w in zip(answer.sets, answer.weight, strict=True)
    )


# ---------------------------------------------------------------- words for the whole


def _verdict(
    told: dict[Mark, list[tuple[NamedCause, ...]]], channels: Sequence[Channel]
) -> Verdict:
    """The best that can be told."""
    sure = ((Mark.NAMED, Verdict.NAMED), (Mark.ONE_OF, Verdict.ONE_OF),
            (Mark.SUPPORTED, Verdict.SUPPORTED))  # fmt: skip
    for mark, verdict in sure:
        if told[mark]:
            return verdict
    gap = any(replace(c, explained=c.calibrated).material for c in channels)
    if any(c.material for c in channels) or (told[Mark.UNSURE] and gap):
        return Verdict.UNKNOWN
    if any(replace(c, explained=c.tabulated).material for c in channels):
        return Verdict.CALIBRATED
    return Verdict.NO_GAP


def _reasons(
    answer: Answer, told: dict[Mark, list[tuple[NamedCause, ...]]], channels: Sequence[Channel]
) -> tuple[Reason, ...]:
    """Why the verdict is what it is."""
    chosen, searched, problem = answer.chosen, answer.chosen.searched, answer.problem
    gain = _held_out_gain(answer)
    found = any(told.values()) or any(c.material for c in channels)
    lost = {answer.chosen.best.causes, ()} - {k for k, v in chosen.predicted.items() if v}
    reasons = {
        Reason.DIFFERS_BETWEEN_RECORDS: any(n.left and n.differs < SAME
                                            for n in chosen.needs.values()),
        Reason.NOT_COMPLETE: searched.ended_by is not None,
        Reason.INTERRUPTED: interrupted(searched.ended_by),
        Reason.NOISE_NOT_STATED: problem.noise_estimated,
        Reason.CALIBRATION_PREDICTS_WORSE: chosen.calibration_worse,
        Reason.WORSE_THAN_MEAN: chosen.worse_than_mean,
        Reason.NO_HELD_OUT_GAIN: gain is not None and gain[0] >= 1.0,
        Reason.NOT_PREDICTED: bool(searched.problem.held_out) and bool(lost),
        Reason.NOTHING_INSIDE: found and not any(_inside(problem, c) for c in problem.causes),
    }  # fmt: skip
    return tuple(reason for reason, holds in reasons.items() if holds)


# ---------------------------------------------------------------- classes


def _told(
    sets: Sequence[Collection[int]], weight: Array, credibility: float
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
        rest = [set(s) - taken for s in sets]
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


def _with_equivalents(
    problem: Problem, alike: Sequence[frozenset[int]], sets: Sequence[Fitted], group: Sequence[int]
) -> list[int]:
    """A class with what explains the records equally well as one of its members.

    A law with a shape is not added to one without that explains the records as well: a dead zone or
    a saturation whose level no record reaches is a gain. A part that was tested by itself is not
    put beside another cause: its test contradicts it.
    """
    added: list[int] = []
    for i in group:
        ours = _where(sets, i)
        for j in linked(alike, i) - {*group, *added}:
            theirs = [s for s in sets if {*s.causes} == ({*ours.causes} - {i}) | {j}]
            if not theirs or _tested(problem, j):
                continue
            odds = log_odds(problem, theirs[0], ours)
            odds += _of_sizes(problem, (ours, i), (theirs[0], j))
            if abs(_worse_by(problem, theirs[0], ours)) < EQUAL and odds > math.log(UNLIKELY):
                added.append(j)
    if any(not _has_shape(problem, i) for i in group):
        added = [j for j in added if not _has_shape(problem, j)]
    return sorted(
        [*group, *added],
        key=lambda i: (_has_shape(problem, i), not problem.causes[i].of_records),
    )


def _where(sets: Sequence[Fitted], cause: int, group: Sequence[int] = ()) -> Fitted:
    """The most probable set with a cause, if there is one without the others of its class."""
    own = [s for s in sets if cause in s.causes]
    return next((s for s in own if {*s.causes} & {*group} <= {cause}), own[0])


def _worse_by(problem: Problem, one: Fitted, other: Fitted) -> float:
    """Difference of the negative log likelihoods of two sets."""
    left = [problem.samples * np.log(s.noise) + 0.5 * s.squares / s.noise**2 for s in (one, other)]
    return float(weights(problem, one, other) @ (left[0] - left[1]))


def _tested(problem: Problem, cause: int) -> bool:
    """Whether the part of a parameter was tested by itself."""
    of = problem.causes[cause].parameter
    return of is not None and problem.model.parameters[of].before is not None


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


def _at_limit(problem: Problem, fitted: Fitted, cause: int) -> bool:
    """Whether a magnitude is at a limit that is none of its law: 0 and 1 are."""
    found = problem.causes[cause]
    if found.effect is None:
        return False
    x, scale = fitted.point.x[index_of(problem, fitted.members, cause)], found.effect.scale
    return any(
        math.isclose(x, v, rel_tol=1e-6, abs_tol=1e-6)
        for v in found.bounds
        if math.isfinite(v) and not math.isclose(v * scale, 1.0, rel_tol=1e-9)
    )


def _inside(problem: Problem, cause: Cause) -> bool:
    """Whether a cause acts inside the model, not at an input or a sensor; no parameter does."""
    inputs = {f"input {n}" for o in problem.fit for n in o.record.inputs}
    return not (cause.of_records or cause.of_parameter or cause.component in inputs)


# ---------------------------------------------------------------- sizes


def _named(answer: Answer, fitted: Fitted, own: Posterior, cause: int) -> NamedCause:
    """A cause with its size in a set, whose global unknowns have the given posterior."""
    problem = answer.problem if fitted is answer.best else answer.chosen.problem
    found = problem.causes[cause]
    probability = _probability(answer.sets, answer.weight, cause)
    if found.local is not None:
        return _in_each_record(problem, fitted, cause, probability, own.covariance)
    k = index_of(problem, fitted.members, cause)
    effect, words, shape, changes = found.effect, found.effect or found.alias, None, ""
    value, zero, scale = _size(problem, fitted, cause)
    _, *ends = own.interval(k)
    low, high = sorted(zero + scale * v for v in ends)
    if effect is not None:
        shape = shapes_of(problem, fitted.members, fitted.point.x)[k - len(problem.free)].shape
    else:
        p = problem.model.parameters[problem.free[k]]
        changes, unit, limits = p.name, p.unit, (p.lower, p.upper)
    if words is not None:
        unit, limits = words.unit, words.bounds
    return NamedCause(
        cause=found.name,
        component=found.component,
        unit=unit,
        magnitude=value,
        low=float(max(min(low, value), limits[0])),
        high=float(min(max(high, value), limits[1])),
        probability=probability,
        shape=shape,
        shape_names=() if effect is None else effect.shape_names,
        by_record=tuple(zero + scale * v for v in _by_record(problem, fitted, k)),
        parameter=words is None,
        changes=changes,
        ratio=1.0 if found.alias is None else found.alias.tolerance_ratio,
        mechanism="" if words is None else words.mechanism,
        remedy="" if words is None else words.remedy,
        kind="parameter" if words is None else words.kind,
        title="" if words is None else words.label,
        relative=words is not None and words.relative,
        user_unit=None if effect is not None else _user_unit(p, found.alias),
        subject=found.subject,
    )


def _by_record(problem: Problem, fitted: Fitted, k: int) -> list[float]:
    """Value of a global unknown in each record by itself, in its scale."""
    if len(problem.fit) < 2:
        return [float(fitted.point.x[k])]
    return [float(v) for v in by_record(problem, fitted, k)[0]]


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


def _in_each_record(
    problem: Problem, fitted: Fitted, cause: int, probability: float, covariance: Array
) -> NamedCause:
    """What each record has by itself; its magnitude is the rms over the records."""
    found = problem.causes[cause]
    assert found.local is not None
    values, variance = in_each_record(
        problem, fitted, found.local.kind, found.local.index, covariance
    )
    rms = math.sqrt(sum(v * v for v in values) / len(values))
    half, scale = HALF * math.sqrt(variance), found.local.scale
    own = NamedCause(found.name, found.component, "", 0.0, 0.0, 0.0, probability, kind="sensor")
    at = 0.0
    if (effect := found.effect) is not None:
        at = _common(problem, fitted, cause)
        own = replace(
            own,
            unit=effect.unit,
            kind=effect.kind,
            title=effect.label,
            mechanism=effect.mechanism,
            remedy=effect.remedy,
        )
    else:
        fault = fault_of(found.local.kind)
        assert fault.each is not None
        own = replace(
            own,
            unit=fault.unit or problem.units[found.local.index],
            mechanism=f"The sensor has another {fault.each[0]} in each record.",
            remedy=fault.each[1],
        )
    return replace(
        own,
        magnitude=scale * rms,
        low=scale * max(rms - half, 0.0),
        high=scale * (rms + half),
        by_record=tuple(at + scale * v for v in values),
        subject=found.subject,
    )


def _common(problem: Problem, fitted: Fitted, cause: int) -> float:
    """What a law that each record has by itself has in common: the parameter, or a magnitude."""
    effect = problem.causes[cause].effect
    assert effect is not None
    if effect.moves is not None:
        return float(theta_at(problem, fitted.point.x)[effect.moves])
    return effect.scale * float(fitted.point.x[index_of(problem, fitted.members, cause)])


def _parameter(answer: Answer, k: int, given: Sequence[int] = ()) -> ParameterValue:
    """Value of a free parameter with its interval; ``given``: if these changed."""
    problem = answer.problem
    p = problem.model.parameters[problem.free[k]]
    value = float(theta_at(problem, answer.best.point.x)[problem.free[k]])
    mean, low, high = answer.posterior.interval(k, given)
    if given:
        value = p.value + problem.unit[k] * mean
    return ParameterValue(
        p.name,
        p.title,
        p.unit,
        p.value,
        p.sd,
        float(value),
        float(max(min(p.value + problem.unit[k] * low, value), p.lower)),
        float(min(max(p.value + problem.unit[k] * high, value), p.upper)),
        p.relative,
        p.user_unit,
    )


def _parameters(answer: Answer) -> tuple[ParameterValue, ...]:
    """Values of the free parameters of the machine with their intervals."""
    problem = answer.problem
    return tuple(
        _parameter(answer, k)
        for k, i in enumerate(problem.free)
        if problem.model.parameters[i].of_the_machine
    )


def _correlation(answer: Answer) -> tuple[tuple[str, ...], Array]:
    """Names of the unknowns of the machine in the set, and their correlation."""
    problem, covariance = answer.problem, answer.posterior.covariance
    free = [problem.model.parameters[i] for i in problem.free]
    effects = problem.effects_of(answer.best.members)
    names = [*(p.name for p in free), *(e.name for e in effects)]
    kept = [k for k in range(len(names)) if k >= len(free) or free[k].of_the_machine]
    part = covariance[np.ix_(kept, kept)]
    sd = np.sqrt(np.maximum(np.diag(part), 1e-300))
    return tuple(names[k] for k in kept), part / np.outer(sd, sd)


# ---------------------------------------------------------------- residuals


def _channels(answer: Answer, options: Options) -> tuple[Channel, ...]:
    """Residuals by channel of the tabulated, the calibrated, and the explained model."""
    problem, chosen, best = answer.problem, answer.chosen, answer.best
    shown, alone = chosen.searched.problem, chosen.alone
    tabulated = _tabulated(problem, alone)
    calibrated, explained = _rms(problem, alone), _rms(problem, best)
    noise = problem.noise * (white(problem, best) if problem.noise_estimated else 1.0)
    missing = np.full(len(problem.names), math.nan)
    held = [
        missing if (p := chosen.predicted.get(s.causes)) is None else p.rms(shown)
        for s in (alone, chosen.best)
    ]
    part = chosen.searched.sets.get(best.causes) if shown.held_out else None
    fitted = missing if part is None else _rms(shown, part)
    return tuple(
        Channel(
            name,
            unit,
            float(noise[c]) or math.nan,
            float(problem.motion[c]),
            float(tabulated[c]),
            float(calibrated[c]),
            float(explained[c]),
            float(held[0][c]),
            float(held[1][c]),
            options.matters(name, unit, float(problem.compared[c])),
            float(fitted[c]),
        )
        for c, (name, unit) in enumerate(zip(problem.names, problem.units, strict=True))
    )


def _tabulated(problem: Problem, alone: Fitted) -> Array:
    """Rms of the residual of the tabulated model by channel, with the starts of the fitted one."""
    point = empty_point(problem, (), problem.fit)
    local = tuple(
        np.array([v if q.weight < 1e-4 else 0.0 for q, v in zip(o.local, values, strict=True)])
        for o, values in zip(problem.fit, alone.point.local, strict=True)
    )
    ask = EvaluationRequest((), Point(point.x, local), problem.fit, derivatives=False)
    return rms_of(problem.fit, (x.residual for x in evaluate(problem, [ask])[0]))


def _rms(problem: Problem, fitted: Fitted) -> Array:
    """Rms of the residual by channel [its unit], (m,)."""
    return rms_of(problem.fit, fitted.residuals)


def _traces(answer: Answer, channels: Sequence[Channel]) -> tuple[Trace, ...]:
    """Residuals of the channel that the calibrated model misses most."""
    problem, c = answer.problem, worst_of(channels)
    shown, pair_of = answer.chosen.searched.problem, (answer.chosen.alone, answer.best)
    held = {o.record.name for o in shown.held_out}
    out = []
    for r, o in enumerate(problem.fit):
        own = slice(o.end)
        if not o.valid[own, c].any():
            continue
        pair = [
            np.where(o.valid[own, c], s.linears[r].residual[own, c] * o.sd[own, c], np.nan)
            for s in pair_of
        ]
        name = o.record.name
        out.append(Trace(name, name in held, o.record.time[own], *pair))
    return tuple(out)
