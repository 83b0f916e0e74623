"""The changes of an answer: the fewest parameters that explain the fit, and what each takes away.

A fit moves all parameters a little. The answer is the smallest set of them that does as well: a
search on the normal equations of the fit finds it, and a fit of these parameters alone, with all
others at their tabulated values, gives their sizes. What a change takes away is the difference of
two fits, with it and without it, in held-out records where there are some.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import Fitted, log_evidence
from unmodeled.search.fit import Start, fit_sets
from unmodeled.search.held_out import predict
from unmodeled.search.linear import (
    EvaluationRequest,
    Linear,
    Point,
    evaluate,
    local_of,
    unknowns_of,
)
from unmodeled.search.problem import Observed, Problem, rms_of
from unmodeled.search.progress import Stop
from unmodeled.search.result import ParameterValue, Without

#: Largest number of parameters of an answer, and of equivalents of one.
MOST, EQUIVALENTS = 6, 3
#: Posterior odds that a parameter needs against none of the others, and odds to the best one up to
#: which another one is its equivalent.
ODDS, ALIKE = 9.0, 0.01


@dataclass(frozen=True)
class Explained:
    """Parameters that explain a fit, and what is left without each change."""

    changed: tuple[tuple[ParameterValue, ...], ...] = ()
    without: tuple[Without, ...] = ()


def smallest(x: Array, covariance: Array, free: Sequence[int]) -> list[list[int]]:
    """The fewest unknowns that explain a fit if all others are zero, with equivalents.

    Forward steps with exchange and removal, by the log posterior odds of each unknown, to first
    order.

    Parameters
    ----------
    x
        Estimates, in standard deviations of their priors, (g,).
    covariance
        Their posterior covariance, (g, g).
    free
        Indices of those that may be zero.

    Returns
    -------
    list of list of int
        For each unknown that is needed, the unknowns that could stand for it, the best one first.
    """

    def odds(besides: Sequence[int]) -> dict[int, float]:
        zero = [k for k in free if k not in besides]
        inverse = np.linalg.inv(covariance[np.ix_(zero, zero)])
        own = np.diag(inverse)
        log_odds = 0.5 * ((inverse @ x[zero]) ** 2 / own - np.log(own))
        return dict(zip(zero, map(float, log_odds), strict=True))

    def others(k: int) -> list[int]:
        return [j for j in found if j != k]

    def best_of(scores: Mapping[int, float]) -> int:
        return max(scores, key=lambda k: scores[k])

    found: list[int] = []
    enough = math.log(ODDS * max(len(free), 1))
    while len(found) < min(MOST, len(free)):
        scores = odds(found)
        if scores[best := best_of(scores)] < enough:
            break
        found.append(best)
        for _ in range(MOST):
            exchanged = list(found)
            for place in range(len(exchanged)):
                exchanged[place] = best_of(odds([*exchanged[:place], *exchanged[place + 1 :]]))
            if exchanged == found:
                break
            found = exchanged
        found = [k for k in found if odds(others(k))[k] >= enough]
    groups = []
    for k in found:
        scores = odds(others(k))
        alike = [j for j, v in scores.items() if v > scores[k] + math.log(ALIKE)]
        groups.append(sorted(alike, key=lambda j: -scores[j])[: 1 + EQUIVALENTS])
    return groups


def explain(
    problem: Problem,
    best: Fitted,
    covariance: Array,
    sets: Mapping[tuple[int, ...], Fitted],
    groups: Sequence[Sequence[int]],
    values: Callable[[Problem, Fitted], Sequence[ParameterValue]],
    check: Callable[[], None] = lambda: None,
) -> Explained:
    """The fewest parameters that explain a fit, and what is left without each change.

    Parameters
    ----------
    problem
        The problem: records that are fitted, and those that are held out.
    best
        The reported set, fitted.
    covariance
        Covariance of its unknowns.
    sets
        Other fitted sets.
    groups
        Causes of each answer: one cause, or the members of a class.
    values
        Values of the parameters of a fit with their intervals.
    check
        Is called before each simulation of all fits that proceed together; may raise ``Stop``: the
        changes without a fit are omitted.
    """
    work = _Fits(problem, best, covariance, check)
    out, without = [], []
    try:
        for group in groups:
            without += work.causes(group, sets)
        for group in work.groups:
            out.append(work.alike(group, values))
            less = work.fitted(work.kept - {group[0]})
            without += work.without([p.name for p in out[-1]], less)
    except (Stop, KeyboardInterrupt):
        pass
    return Explained(tuple(out), tuple(without))


class _Fits:
    """Fits of a set with some of the parameters only, all others at their tabulated values.

    Parameters without a prior are always fitted: nothing is known that they could change from.
    """

    def __init__(
        self, problem: Problem, best: Fitted, covariance: Array, check: Callable[[], None]
    ) -> None:
        self.problem, self.best, self.covariance, self.check = problem, best, covariance, check
        own = [problem.model.parameters[i] for i in problem.free]
        released = problem.released(best.members)
        tested = [
            k
            for k, p in enumerate(own)
            if p.of_the_machine and math.isfinite(p.sd) and not released[k]
        ]
        self.groups = smallest(best.point.x, covariance, tested)
        self.kept = set(range(len(own))) - set(tested) | {group[0] for group in self.groups}
        self.known: dict[tuple[frozenset[int], int | None], tuple[Problem, Fitted | None]] = {}

    def fitted(
        self, kept: set[int], lost: int | None = None, local: Sequence[Array] | None = None
    ) -> tuple[Problem, Fitted | None]:
        """The set with some of the free parameters, fitted; None: the simulation fails.

        The cause ``lost`` is left out; ``local`` are starts of the unknowns of the records.
        """
        key = frozenset(kept), lost
        if key not in self.known:
            problem, best = self.problem, self.best
            free = [problem.model.parameters[i] for i in problem.free]
            fixed = {p.name: replace(p, sd=0.0) for k, p in enumerate(free) if k not in kept}
            smaller = replace(problem, model=problem.model.with_parameters(fixed))
            zero = [k for k in range(len(free)) if k not in kept]
            x, cov = best.point.x, self.covariance
            if zero:
                x = x - cov[:, zero] @ np.linalg.solve(cov[np.ix_(zero, zero)], x[zero])
            low, high = problem.parameter_bounds
            x = np.concatenate([np.clip(x[: len(free)], low, high), x[len(free) :]])
            members = tuple(
                m
                for m in best.members
                if m.cause != lost
                and (
                    (i := problem.causes[m.cause].parameter) is None
                    or problem.free.index(i) in kept
                )
            )
            gone = [k for k, u in enumerate(unknowns_of(problem, best.members))
                    if u[0] != "parameter" and u[1] == lost]  # fmt: skip
            point = Point(np.delete(x, [*zero, *gone]), tuple(local or best.point.local))
            (found,) = fit_sets(smaller, [Start(members, (point,))], self.check, rough=True)
            self.known[key] = smaller, found
        return self.known[key]

    def without(
        self,
        names: Sequence[str],
        less: tuple[Problem, Fitted | None],
    ) -> list[Without]:
        """What is left without a change, under the names of it and its equivalents.

        It is compared with one fit for all changes: that of all of them, and of nothing else.
        """
        (problem, full), (smaller, part) = self.fitted(self.kept), less
        if full is None:
            return []
        none = (math.inf,) * len(problem.channels)
        before, there, after = none, None, _rms(full.linears, problem.fit)
        if part is not None:
            before = _rms(_at(smaller, part, full.point, part.point, problem.fit), problem.fit)
        if problem.held_out and (f := predict(problem, [full], self.check)[0]) is not None:
            records, lost = problem.held_out, none
            p = None if part is None else predict(smaller, [part], self.check)[0]
            if part is not None and p is not None:
                lost = _rms(_at(smaller, part, f.point, p.point, records), records)
            there = lost, tuple(map(float, f.rms(problem)))
        return [Without(name, before, after, there) for name in names]

    def causes(self, group: Sequence[int], sets: Mapping[tuple[int, ...], Fitted]) -> list[Without]:
        """What is left without a cause, or without all members of a class."""
        problem, best = self.problem, self.best
        member = next((i for i in group if i in best.causes), None)
        if member is None:
            return []
        index = problem.causes[member].parameter
        if index is not None:
            less = self.fitted(self.kept - {problem.free.index(index)})
        elif problem.causes[member].local is not None or any(
            e.hidden for e in problem.effects_of(best.members)
        ):  # other unknowns of the records
            smaller = sets.get(tuple(i for i in best.causes if i != member))
            if smaller is None:  # no start is known
                return []
            less = self.fitted(self.kept, member, smaller.point.local)
        else:
            less = self.fitted(self.kept, member)
        return self.without([problem.causes[i].name for i in group], less)

    def alike(
        self,
        group: Sequence[int],
        values: Callable[[Problem, Fitted], Sequence[ParameterValue]],
    ) -> tuple[ParameterValue, ...]:
        """Values of a parameter and of its equivalents in its place, the most probable first."""
        found = []
        for k in group:
            name = self.problem.model.parameters[self.problem.free[k]].name
            problem, fitted = self.fitted(self.kept - {group[0]} | {k})
            if fitted is not None:
                weight = np.full(fitted.noise.size, self.best.effective)
                own = next(p for p in values(problem, fitted) if p.name == name)
                found.append(
                    (log_evidence(problem, replace(fitted, noise=self.best.noise), weight), own)
                )
        top = max((e for e, _ in found), default=0.0)
        found = [f for f in found if f[0] > top + math.log(ALIKE)]
        return tuple(p for _, p in sorted(found, key=lambda f: -f[0]))


def _at(
    problem: Problem, fitted: Fitted, whole: Point, own: Point, records: tuple[Observed, ...]
) -> tuple[Linear, ...]:
    """Residuals of a smaller set with the unknowns of the records that the whole set has.

    What a record varies by itself must not stand in for the change that is left out. Unknown starts
    are those of the smaller set.
    """
    local = []
    for o, mine, theirs in zip(records, own.local, whole.local, strict=True):
        known = [not q.unknown for q in local_of(problem, fitted.members, o)]
        local.append(np.where(known, theirs, mine) if mine.size == theirs.size else mine)
    ask = EvaluationRequest(fitted.members, Point(own.x, tuple(local)), records, derivatives=False)
    return tuple(evaluate(problem, [ask])[0])


def _rms(linears: Sequence[Linear], records: Sequence[Observed]) -> tuple[float, ...]:
    """Residual by channel [its unit]; infinite if the simulation fails."""
    with np.errstate(all="ignore"):
        rms = rms_of(records, (x.residual for x in linears))
    return tuple(float(v) if math.isfinite(v) else math.inf for v in rms)
