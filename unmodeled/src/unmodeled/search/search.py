"""Search for the sets of causes that explain the records: add, drop, exchange.

Every smaller set gets the same chance as a larger one: it is also fitted from the parameters of the
larger set. A cause is then never named because the fit without it had not converged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from unmodeled.data import Array
from unmodeled.errors import InvalidParameter
from unmodeled.search.evidence import Fitted, best_of, log_odds
from unmodeled.search.fit import (
    POOR,
    Start,
    empty_point,
    first_step,
    fit_sets,
    together,
)
from unmodeled.search.held_out import Predicted
from unmodeled.search.linear import Ask, Linear, Point, evaluate, local_of, unknowns_of
from unmodeled.search.options import Options
from unmodeled.search.problem import Member, Members, Observed, Problem
from unmodeled.search.progress import Stop
from unmodeled.search.score import Directions, Score, directions, scores

__all__ = ["Searched", "model_alone", "rank", "search", "with_all_records"]

#: Log evidence that a larger set must gain, and that a change must gain.
WORTH, BETTER = 0.5, 0.1
#: Share of the limit of time after which the search ends; the rest is for the held-out records.
SEARCH = 0.6
#: Growing parts of the records to which the model alone is fitted, as shares of their durations.
PARTS = (0.03, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)


@dataclass(eq=False)
class Searched:
    """All fitted sets of a search."""

    problem: Problem
    sets: dict[tuple[int, ...], Fitted] = field(default_factory=dict)
    tried: set[tuple[tuple[int, ...], int]] = field(default_factory=set)
    first: list[Score] = field(default_factory=list)
    """Scores at the fit of the model alone."""
    directions: Directions | None = None
    """Directions at this fit."""
    ended_by: BaseException | None = None
    """``Stop`` or ``KeyboardInterrupt``, if one ended the search before its end."""

    def ranked(self) -> tuple[list[Fitted], Array]:
        """Sets in the order of their posterior probability, and these probabilities."""
        return rank(self.problem, list(self.sets.values()))


def rank(problem: Problem, sets: Sequence[Fitted]) -> tuple[list[Fitted], Array]:
    """Sets in the order of their posterior probability, and these probabilities.

    Parameters
    ----------
    problem, sets
        The problem and fitted sets.
    """
    best = best_of(problem, sets)
    values = np.array([log_odds(problem, s, best) for s in sets])
    order = np.argsort(-values, kind="stable")
    weight = np.exp(values[order] - values[order[0]])
    return [sets[k] for k in order], weight / weight.sum()


def search(
    problem: Problem,
    options: Options,
    tell: Callable[[str], None] = lambda _: None,
    step: Callable[[], None] = lambda: None,
) -> Searched:
    """Search the sets of causes.

    Parameters
    ----------
    problem
        Model, causes and records.
    options
        Options of the diagnosis.
    tell
        Is called with the stage.
    step
        Is called before each simulation of all fits that proceed together.

    Raises
    ------
    InvalidParameter
        The model alone cannot be simulated.
    """
    end = time.monotonic() + SEARCH * options.seconds

    def check() -> None:
        step()
        if time.monotonic() > end:
            raise Stop

    found = Searched(problem)
    now = model_alone(problem, step)
    _keep(found, [now])
    try:
        _climb(problem, options, found, now, check, tell)
    except (Stop, KeyboardInterrupt) as stop:
        found.ended_by = stop
    return found


def _keep(found: Searched, fits: Sequence[Fitted | None]) -> None:
    """Keep the best fit of every set."""
    for fitted in fits:
        if fitted is None:
            continue
        old = found.sets.get(fitted.causes)
        if old is None or log_odds(found.problem, fitted, old) > 0.0:
            found.sets[fitted.causes] = fitted


def model_alone(problem: Problem, step: Callable[[], None] = lambda: None) -> Fitted:
    """Fit of the model without causes.

    If the first step does not gain what it promises, growing parts of the records are fitted: the
    end of a record depends more strongly on the unknowns than its beginning, so that a fit of whole
    records from poor values may end far from the best one.

    Parameters
    ----------
    problem
        Model and records.
    step
        Is called before each simulation.

    Raises
    ------
    InvalidParameter
        The model cannot be simulated.
    """
    point, fitted = empty_point(problem, (), problem.fit), None
    try:
        known = together(problem, [first_step(problem, point)], step)[0]
        start = Start((), (point,), () if known is None else known)
        for part in (1.0,) if known is not None else PARTS:
            cut = replace(problem, fit=tuple(o.first(part) for o in problem.fit))
            begin = [replace(start, points=(point,))]
            fitted = fit_sets(cut, begin, step, rough=part < 1.0)[0]
            if fitted is not None:
                point = fitted.point
    except Stop as stop:  # there is nothing to answer with
        raise stop.__cause__ or stop from None
    if fitted is None:
        raise InvalidParameter(
            f"model {problem.model.name}: its simulation gives no finite outputs for the "
            "tabulated parameters, expected a model that can follow the records"
        )
    return fitted


def _start(problem: Problem, members: Members, origin: Fitted, added: Score | None) -> Start:
    """Start of the fit of a set from the fit of another one.

    ``added``: score of the cause that the other set lacks; None: it lacks none.
    """
    base, new = origin.point, unknowns_of(problem, members)
    kept = {m.cause for m in members if m in origin.members}
    old = {
        key: j
        for j, key in enumerate(unknowns_of(problem, origin.members))
        if key[0] == "parameter" or key[1] in kept
    }
    x = np.array([base.x[old[key]] if key in old else 0.0 for key in new])
    same = all(
        local_of(problem, members, o) == local_of(problem, origin.members, o) for o in problem.fit
    )
    known: tuple[Linear, ...] = ()
    if added is not None and same:
        known = _extended(problem, origin, added, [old.get(key, -1) for key in new], new)
    if added is not None and not known and ("magnitude", added.cause, 0) in new:
        x[new.index(("magnitude", added.cause, 0))] = added.step
    values = tuple(
        _carried(problem, o, origin.members, v, members)
        for o, v in zip(problem.fit, base.local, strict=True)
    )
    points = [Point(x, values)]
    if added is not None and origin.share < POOR:
        # A model that is far off moves its parameters: also from the tabulated ones, and with the
        # expected magnitude.
        plain = np.where([key[0] == "parameter" for key in new], 0.0, x)
        if ("magnitude", added.cause, 0) in new:
            low, high = problem.causes[added.cause].bounds
            at = new.index(("magnitude", added.cause, 0))
            plain[at] = np.clip(np.sign(added.step) or 1.0, low, high)
        points.append(Point(plain, values))
    return Start(members, tuple(points), known)


def _extended(
    problem: Problem,
    origin: Fitted,
    added: Score,
    old: Sequence[int],
    new: Sequence[tuple[str, int, int]],
) -> tuple[Linear, ...]:
    """Residuals and derivatives of a set with one more cause at the magnitude zero.

    ``old``: place of each unknown in the other set, -1: it is new. (): they are not known.
    """
    if problem.causes[added.cause].effect is not None and not added.columns:
        return ()
    out = []
    for r, linear in enumerate(origin.linears):
        columns = np.zeros((*linear.residual.shape, len(new)))
        for k, (at, key) in enumerate(zip(old, new, strict=True)):
            if at >= 0:
                columns[..., k] = linear.by_global[..., at]
            elif key[0] == "magnitude":
                columns[..., k] = added.columns[r]
        nothing = np.zeros((*linear.residual.shape, 0))
        out.append(Linear(linear.residual, columns, linear.by_local, nothing))
    return tuple(out)


def _carried(
    problem: Problem, observed: Observed, old: Members, values: Array, new: Members
) -> Array:
    """Unknowns of a record in a set, with the values that they have in another set.

    Hidden states have the numbers of their set, so that another set begins with their priors.
    """
    own = len(problem.model.states())
    known = {
        (q.kind, q.index): v
        for q, v in zip(local_of(problem, old, observed), values, strict=True)
        if old == new or q.kind != "start" or q.index < own
    }
    return np.array([known.get((q.kind, q.index), 0.0) for q in local_of(problem, new, observed)])


def _with(origin: Fitted, score: Score) -> Members:
    """A set with one more cause."""
    return tuple(sorted((*origin.members, Member(score.cause, score.shape)), key=lambda m: m.cause))


def _refit(
    problem: Problem,
    found: Searched,
    jobs: Sequence[tuple[Members, Fitted, Score | None]],
    check: Callable[[], None],
) -> list[Fitted | None]:
    """Fit sets from others, each once from each, and keep the best fit of every set."""
    todo = []
    for members, origin, added in jobs:
        key = tuple(m.cause for m in members)
        if (key, id(origin)) in found.tried or found.sets.get(key) is origin:
            continue
        found.tried.add((key, id(origin)))
        todo.append(_start(problem, members, origin, added))
    rivals = [best_of(problem, list(found.sets.values()))] if found.sets else []
    try:
        _keep(found, fit_sets(problem, todo, check, rivals))
    except Stop as stop:
        _keep(found, stop.fits)
        raise
    return [found.sets.get(tuple(m.cause for m in members)) for members, _, _ in jobs]


def with_all_records(
    found: Searched,
    sets: Sequence[Fitted],
    predicted: Sequence[Predicted | None],
    check: Callable[[], None] = lambda: None,
) -> Searched:
    """The sets, fitted to all records, so that the held-out ones decide by the same likelihood.

    A set that cannot follow the held-out records is omitted. Then every smaller set gets the chance
    to start from the parameters of the best one. If the time is up, the fits are used as they are.

    Raises
    ------
    Stop
        The time is up before the model alone was compared with all records.
    """
    problem = found.problem
    everything = replace(problem, fit=(*problem.fit, *problem.held_out), held_out=())
    out = Searched(everything, first=found.first, ended_by=found.ended_by)
    pairs = [(s, p) for s, p in zip(sets, predicted, strict=True) if p is not None]
    held = evaluate(problem, [Ask(s.members, p.point, problem.held_out) for s, p in pairs])
    starts = [
        Start(
            s.members,
            (Point(s.point.x, (*s.point.local, *p.point.local)),),
            (*s.linears, *further),
        )
        for (s, p), further in zip(pairs, held, strict=True)
    ]
    try:
        _keep(out, fit_sets(everything, starts, check))
    except Stop as stop:
        _keep(out, stop.fits)
        if () not in out.sets:
            raise
        out.ended_by = stop
        return out
    if () not in out.sets:
        raise InvalidParameter(
            f"model {problem.model.name}: its simulation of the held-out records gives no finite "
            "outputs, expected a model that can follow all records"
        )
    best = best_of(everything, list(out.sets.values()))
    smaller = [s for s in out.sets.values() if set(s.causes) < set(best.causes)]
    try:
        _refit(everything, out, [(s.members, best, None) for s in smaller], check)
    except Stop as stop:
        out.ended_by = stop
    return out


def _choose(problem: Problem, ranked: Sequence[Score], tries: int) -> list[Score]:
    """The first causes by score; errors of records take at most half of the places."""
    of_records = [s.cause for s in ranked if problem.causes[s.cause].of_records]
    too_many = set(of_records[(tries + 1) // 2 :])
    return [s for s in ranked if s.cause not in too_many][:tries]


def _climb(
    problem: Problem,
    options: Options,
    found: Searched,
    now: Fitted,
    check: Callable[[], None],
    tell: Callable[[str], None],
) -> None:
    """Add the best of some causes, drop those that are not needed any more, and so on.

    When nothing more gains, each cause of the set is exchanged for those that resemble it.
    """

    def gain(s: Fitted, over: Fitted) -> float:
        return log_odds(problem, s, over)

    @cache
    def scored(fitted: Fitted) -> list[Score]:
        seen = directions(problem, fitted, found.directions)
        found.directions = found.directions or seen
        return scores(problem, fitted, seen)

    def less(origin: Fitted) -> list[Fitted]:
        """Every set with one cause less, fitted from the parameters of the larger set."""
        jobs = [
            (tuple(m for m in origin.members if m is not out), origin, None)
            for out in origin.members
        ]
        return [f for f in _refit(problem, found, jobs, check) if f is not None]

    while len(now.members) < options.most:  # add
        tell("search")
        ranked = scored(now)
        if not found.first:
            found.first = ranked
        jobs = [(_with(now, s), now, s) for s in _choose(problem, ranked, options.tries)]
        fits = [f for f in _refit(problem, found, jobs, check) if f is not None]
        if not fits:
            break
        best = best_of(problem, fits)
        if gain(best, now) < WORTH:
            break
        before, now = now, best
        while now.members:  # drop
            smaller = less(now)
            if not smaller:
                break
            best = best_of(problem, smaller)
            if gain(best, now) < (WORTH if best.causes == before.causes else 0.0):
                break
            now = best
        if now.causes == before.causes and gain(now, before) <= 0.0:
            break
    improved = True
    while improved and now.members:  # exchange
        improved = False
        tell("exchange")
        for out in now.members:
            rest = next((f for f in less(now) if out.cause not in f.causes), None)
            if rest is None:
                continue
            jobs = [(_with(rest, s), rest, s) for s in scored(rest)[:3] if s.cause != out.cause]
            fits = [f for f in _refit(problem, found, jobs, check) if f is not None]
            if fits and gain(best := best_of(problem, fits), now) > BETTER:
                now, improved = best, True
                break
