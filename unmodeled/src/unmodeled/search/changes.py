"""The changes of an answer: the fewest parameters that explain the fit, and what each takes away.

A fit moves all parameters a little. The answer is the smallest set of them that does as well: a
search on the normal equations of the fit finds it, and a fit of these parameters alone, with all
others at their tabulated values, gives their sizes.

What a change takes away is the difference of two fits with the same freedom, with it and without
it, in held-out records where there are some. An effect is what no parameter can do: with it and
without it, all parameters are fitted. A parameter can mostly be replaced by small changes of many
others, which the search has found less probable: with it and without it, those that are not in the
answer keep their tabulated values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import Fitted, log_evidence
from unmodeled.search.fit import Start, fit_sets
from unmodeled.search.held_out import Predicted, predict
from unmodeled.search.linear import EvaluationRequest, Point, evaluate, local_of, unknowns_of
from unmodeled.search.problem import Members, Observed, Problem, rms_of
from unmodeled.search.progress import Stop
from unmodeled.search.result import ParameterValue, Without
from unmodeled.search.search import start_from

_Seen = Fitted | Predicted | None

#: Largest number of members of a class, of causes or of parameters, that is told.
CLASS = 6
#: Odds to the best parameter up to which another one is its equivalent.
ALIKE = 0.01


@dataclass(frozen=True)
class Explanation:
    """Parameters that explain a fit, and what is left without each change."""

    changed: tuple[tuple[ParameterValue, ...], ...] = ()
    without: tuple[Without, ...] = ()
    ended_by: BaseException | None = None
    """What ended the fits before the parameters were known."""


def smallest(
    x: Array, covariance: Array, free: Sequence[int], credibility: float
) -> list[list[int]]:
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
    credibility
        Posterior probability that one needs against none of the others.

    Returns
    -------
    list of list of int
        For each unknown that is needed, the unknowns that could stand for it, the best one first.
    """

    def odds(besides: Sequence[int]) -> dict[int, float]:
        return _odds(x, covariance, free, besides)

    def best_of(scores: Mapping[int, float]) -> int:
        return max(scores, key=lambda k: scores[k])

    found: list[int] = []
    enough = math.log(credibility / (1.0 - credibility) * max(len(free), 1))
    for _ in free:
        scores = odds(found)
        if scores[best := best_of(scores)] < enough:
            break
        found.append(best)
        for _ in found:  # at most as often as there are unknowns
            exchanged = list(found)
            for place in range(len(exchanged)):
                exchanged[place] = best_of(odds([*exchanged[:place], *exchanged[place + 1 :]]))
            if exchanged == found:
                break
            found = exchanged
        found = [k for k in found if odds([j for j in found if j != k])[k] >= enough]
    return _equivalents(x, covariance, free, found)


def _odds(
    x: Array, covariance: Array, free: Sequence[int], besides: Sequence[int]
) -> dict[int, float]:
    """Log posterior odds of each further unknown if the others are zero, but those ``besides``."""
    zero = [k for k in free if k not in besides]
    inverse = np.linalg.inv(covariance[np.ix_(zero, zero)])
    own = np.diag(inverse)
    log_odds = 0.5 * ((inverse @ x[zero]) ** 2 / own - np.log(own))
    return dict(zip(zero, map(float, log_odds), strict=True))


def _equivalents(
    x: Array, covariance: Array, free: Sequence[int], found: Sequence[int]
) -> list[list[int]]:
    """For each unknown of a set, those that could stand for it, the best one first."""
    groups = []
    for k in found:
        scores = _odds(x, covariance, free, [j for j in found if j != k])
        alike = [j for j, v in scores.items() if v > scores[k] + math.log(ALIKE)]
        groups.append(sorted(alike, key=lambda j: -scores[j])[:CLASS])
    return groups


def explain(
    problem: Problem,
    best: Fitted,
    covariance: Array,
    sets: Mapping[tuple[int, ...], Fitted],
    predicted: Mapping[tuple[int, ...], Predicted | None],
    groups: Sequence[Sequence[int]],
    values: Callable[[Problem, Fitted], Sequence[ParameterValue]],
    matters: Callable[[Without], float],
    credibility: float,
    check: Callable[[], None] = lambda: None,
) -> Explanation:
    """The fewest parameters that explain a fit, and what is left without each change.

    A parameter that takes away less than what matters is dropped, the least one first, and the
    others are fitted again: what it did may be a part of what one of them does.

    Parameters
    ----------
    problem
        The problem: records that are fitted, and those that are held out.
    best
        The reported set, fitted.
    covariance
        Covariance of its unknowns.
    sets, predicted
        Fitted sets, and the held-out records with some of them; None: the simulation fails.
    groups
        Causes of each answer: one cause, or the members of a class.
    values
        Values of the parameters of a fit with their intervals.
    matters
        What a change takes away, over what matters.
    credibility
        Posterior probability that a parameter of the answer needs.
    check
        Is called before each simulation of all fits that proceed together; may raise ``Stop``: what
        is left without the later changes is not known then. A part of the parameters would explain
        nothing: all are told, or none.
    """
    work = _Fits(problem, best, covariance, sets, predicted, credibility, check)
    out: tuple[tuple[ParameterValue, ...], ...] = ()
    without: list[Without] = []
    try:
        out = tuple(work.alike(group, values) for group in work.groups)
        # Before parameters are dropped: an effect could take up what they did.
        for causes in groups:
            without += work.without_causes(causes)
        if work.drop(matters):
            out = tuple(work.alike(group, values) for group in work.groups)
        for group, parameters in zip(work.groups, out, strict=True):
            less = work.fitted(work.kept - {group[0]})
            without += work.without_listed([p.name for p in parameters], less)
    except (Stop, KeyboardInterrupt) as stop:
        return Explanation(out, tuple(without), None if out else stop)
    return Explanation(out, tuple(without))


class _Fits:
    """Fits of a set with some of the parameters only, all others at their tabulated values.

    Parameters without a prior are always fitted: nothing is known that they could change from.
    """

    def __init__(
        self,
        problem: Problem,
        best: Fitted,
        covariance: Array,
        sets: Mapping[tuple[int, ...], Fitted],
        predicted: Mapping[tuple[int, ...], Predicted | None],
        credibility: float,
        check: Callable[[], None],
    ) -> None:
        self.problem, self.best, self.covariance, self.check = problem, best, covariance, check
        self.sets = sets
        self.seen = {(id(problem), causes): p for causes, p in predicted.items()}
        own = [problem.model.parameters[i] for i in problem.free]
        released = problem.released(best.members)
        self.tested = tested = [
            k
            for k, p in enumerate(own)
            if p.of_the_machine and math.isfinite(p.sd) and not released[k]
        ]
        self.groups = smallest(best.point.x, covariance, tested, credibility)
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
            if found is None:  # to first order, the others have gone too far
                point = replace(point, x=np.delete(best.point.x, [*zero, *gone]))
                (found,) = fit_sets(smaller, [Start(members, (point,))], self.check, rough=True)
            self.known[key] = smaller, found
        return self.known[key]

    def drop(self, matters: Callable[[Without], float]) -> bool:
        """Drop the parameters that take away less than what matters; whether there was one."""
        found, needed = [group[0] for group in self.groups], set[int]()
        while open_ := [k for k in found if k not in needed]:
            takes = dict.fromkeys(open_, math.inf)
            for k in open_:
                for left in self.without_listed([""], self.fitted(self.kept - {k})):
                    takes[k] = matters(left)
            needed |= {k for k in open_ if takes[k] > 1.0}
            if len(needed) == len(found):
                break
            least = min(takes, key=lambda k: takes[k])
            found.remove(least)
            self.kept.remove(least)
        dropped = len(found) < len(self.groups)
        if dropped:
            self.groups = _equivalents(self.best.point.x, self.covariance, self.tested, found)
        return dropped

    def without_causes(self, group: Sequence[int]) -> list[Without]:
        """What is left without a cause, or without all members of a class."""
        problem, best = self.problem, self.best
        member = next((i for i in group if i in best.causes), None)
        if member is None:
            return []
        names = [problem.causes[i].name for i in group]
        index = problem.causes[member].parameter
        if index is not None:
            return self.without_listed(names, self.fitted(self.kept - {problem.free.index(index)}))
        rest = tuple(m for m in best.members if m.cause != member)
        less = self.sets.get(tuple(m.cause for m in rest))
        if less is None:
            (less,) = fit_sets(problem, [start_from(problem, rest, best)], self.check)
        found = self._without(names, (problem, best), (problem, less))
        if less is None:
            return found
        alone = self.without_listed(names, self.fitted(self.kept, member, less.point.local))
        return [replace(w, alone=a) for w, a in zip(found, alone, strict=bool(alone))] or found

    def without_listed(
        self, names: Sequence[str], less: tuple[Problem, Fitted | None]
    ) -> list[Without]:
        """What is left without a change if nothing but the changes differs from the model.

        What a record varies by itself must not stand in for it: the unknowns of the records keep
        the values that they have with it, and only starts that are not known are fitted.
        """
        return self._without(names, self.fitted(self.kept), less, same_records=True)

    def _without(
        self,
        names: Sequence[str],
        whole: tuple[Problem, Fitted | None],
        less: tuple[Problem, Fitted | None],
        *,
        same_records: bool = False,
    ) -> list[Without]:
        """What two fits leave, with and without a change that has several names."""
        problem, left = self.problem, []
        seen: list[tuple[tuple[Observed, ...], _Seen, _Seen]] = [(problem.fit, whole[1], less[1])]
        if problem.held_out:
            seen += [(problem.held_out, self._held_out(*whole), self._held_out(*less))]
        for records, full, part in seen:
            if full is None:
                break
            residuals = None if part is None else part.residuals
            if same_records and part is not None and less[1] is not None:
                residuals = _at(less[0], less[1].members, full.point, part.point, records)
            left.append((_rms(records, residuals), _rms(records, full.residuals)))
        if not left:
            return []
        there = left[1] if len(left) > 1 else None
        return [Without(name, *left[0], held_out=there) for name in names]

    def _held_out(self, problem: Problem, fitted: Fitted | None) -> Predicted | None:
        """The held-out records with a set; None: the simulation fails."""
        if fitted is None:
            return None
        key = id(problem), fitted.causes
        if key not in self.seen:
            self.seen[key] = predict(problem, [fitted], self.check)[0]
        return self.seen[key]

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
    problem: Problem,
    members: Members,
    whole: Point,
    own: Point,
    records: tuple[Observed, ...],
) -> tuple[Array, ...]:
    """Residuals of a smaller set with the unknowns of the records that the whole set has.

    Unknown starts are those of the smaller set.
    """
    local = []
    for o, mine, theirs in zip(records, own.local, whole.local, strict=True):
        known = [not q.unknown for q in local_of(problem, members, o)]
        local.append(np.where(known, theirs, mine) if mine.size == theirs.size else mine)
    ask = EvaluationRequest(members, Point(own.x, tuple(local)), records, derivatives=False)
    return tuple(x.residual for x in evaluate(problem, [ask])[0])


def _rms(records: Sequence[Observed], residuals: Sequence[Array] | None) -> tuple[float, ...]:
    """Residual by channel [its unit]; infinite if the simulation fails."""
    if residuals is None:
        return (math.inf,) * int(records[0].sd.shape[1])
    with np.errstate(all="ignore"):
        rms = rms_of(records, residuals)
    return tuple(float(v) if math.isfinite(v) else math.inf for v in rms)
