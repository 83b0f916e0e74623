"""Fits of sets of causes: a damped Gauss-Newton method, and the noise that a set leaves.

A fit is a generator that yields the points at which it needs residuals. Several fits proceed in
step, and the simulations of one step are one call of the model (:func:`together`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import (
    Fitted,
    Prior,
    best_of,
    effective_share,
    local_penalty,
    log_odds,
    misfit,
    prior_of,
    softness,
    system,
    weights,
)
from unmodeled.search.linear import (
    EvaluationRequest,
    Linear,
    Point,
    count_global,
    evaluate,
    local_of,
)
from unmodeled.search.problem import Members, Observed, Problem
from unmodeled.search.progress import Stop
from unmodeled.search.steps import AS_PROMISED, RADIUS, TRIALS, Box, Freshness, Move, TrustRadius

#: Smallest gain of a step that continues a fit [log evidence].
CONVERGED = 0.1
#: Largest number of steps.
ROUNDS = 40
#: Change of the logarithm of the noise in a step below which the residual is that of the set.
SETTLED = 0.1
#: A fit ends that is behind the best one by more than NEAR [log evidence], if its last step gained
#: less than this share of the distance.
NEAR, CATCH_UP = 3.0, 0.3
#: Largest difference of the unknowns of two fits of one set that are the same, in their scales.
SAME_POINT = 0.05
#: Growing parts of records that are fitted first where a start is not known, as shares of them.
PARTS = (0.03, 0.1, 0.2, 0.35, 0.5, 0.7)
#: Effective share below which a model is so wrong that it may have moved the parameters far away.
POOR = 0.3

Steps = Generator[EvaluationRequest, list[Linear], Any]


@dataclass(frozen=True, eq=False)
class Start:
    """Where the fit of a set begins."""

    members: Members
    points: tuple[Point, ...]
    """Starts; the best fit of them is kept."""
    known: tuple[Linear, ...] = ()
    """Residuals and derivatives at the first of them, by record; (): not known."""


@dataclass(eq=False)
class Descent:
    """A fit that proceeds, and its state."""

    problem: Problem
    members: Members
    point: Point
    known: tuple[Linear, ...] = ()
    now: Fitted | None = None
    gain: float = np.inf
    """Gain of the last step [log evidence]."""
    rough: bool = False
    """Whether it ends where the noise changes little."""


def run_in_lockstep(
    problem: Problem,
    runs: Sequence[Steps],
    check: Callable[[], None] = lambda: None,
    prune: Callable[[Iterable[int]], set[int]] = lambda _: set(),
) -> list[Any]:
    """Advance fits in step until all have ended; their results, None: it failed.

    Parameters
    ----------
    problem
        The problem of all fits.
    runs
        The fits.
    check
        Is called before each step; may raise :class:`Stop`.
    prune
        Those of some fits that shall end before their next step; their results are then None.
    """
    results: list[Any] = [None] * len(runs)
    waiting: dict[int, EvaluationRequest] = {}

    def advance(i: int, value: list[Linear] | None) -> None:
        try:
            waiting[i] = runs[i].send(value)  # type: ignore[arg-type]
        except StopIteration as end:
            results[i] = end.value
        except np.linalg.LinAlgError:  # its derivatives are of no use: it ends where it is
            pass

    for i in range(len(runs)):
        advance(i, None)
    while waiting:
        check()
        ended = prune(waiting)
        asks, waiting = {i: a for i, a in waiting.items() if i not in ended}, {}
        answers = evaluate(problem, list(asks.values()))
        for i, answer in zip(asks, answers, strict=True):
            advance(i, answer)
    return results


def fit_sets(
    problem: Problem,
    starts: Sequence[Start],
    check: Callable[[], None] = lambda: None,
    rivals: Sequence[Fitted] = (),
    rough: bool = False,
) -> list[Fitted | None]:
    """Fit several sets, each from all of its starts; None: a set that cannot be simulated.

    ``rough``: the fits are starts of others, and end where the noise changes little.

    A fit ends early if it comes too slowly nearer to the best one of all and of ``rivals``, or if
    another fit of the same set is at the same point.

    Raises
    ------
    Stop
        With the fits as far as they are.
    """
    fits = [
        Descent(problem, s.members, point, s.known if k == 0 else (), rough=rough)
        for s in starts
        for k, point in enumerate(s.points)
    ]

    reason: BaseException | None = None
    try:
        run_in_lockstep(problem, [_descend(f) for f in fits], check, partial(_ended, fits, rivals))
    except (Stop, KeyboardInterrupt) as stop:
        reason = stop
    best, found = [], iter(fits)
    for s in starts:
        own = [f.now for f in (next(found) for _ in s.points) if f.now is not None]
        best.append(best_of(problem, own) if own else None)
    if reason is not None:
        raise Stop(best) from reason
    return best


def _ended(fits: Sequence[Descent], rivals: Sequence[Fitted], waiting: Iterable[int]) -> set[int]:
    """Those of some fits that come too slowly nearer to the best one, or are where another is."""
    some = [(i, now) for i in waiting if (now := fits[i].now) and np.isfinite(fits[i].gain)]
    if not some:
        return set()
    problem, known = fits[0].problem, [f.now for f in fits if f.now is not None]
    best = best_of(problem, [*known, *rivals])
    return {
        i
        for i, now in some
        if _reached(now, fits[:i])
        or fits[i].gain < CATCH_UP * (log_odds(problem, best, now) - NEAR)
    }


def _reached(now: Fitted, others: Iterable[Descent]) -> bool:
    """Whether another fit of the same set is at the same point."""
    found = (f.now for f in others if f.now is not None and f.members == now.members)
    return any(np.abs(f.point.x - now.point.x).max(initial=0.0) < SAME_POINT for f in found)


def noise_left(problem: Problem, linears: Sequence[Linear], taken: float = 0.0) -> Array:
    """Rms of what a set leaves by channel, at least the noise of the sensor (1).

    ``taken``: share of the samples that the fit took as degrees of freedom.
    """
    squares = sum((x.residual**2).sum(axis=0) for x in linears)
    return _noise(problem.samples, np.asarray(squares) / (1.0 - min(taken, 0.5)))


def _noise(samples: Array, squares: Array) -> Array:
    """Noise that squares of residuals show, at least that of the sensor (1)."""
    return np.asarray(np.sqrt(np.maximum(squares / np.maximum(samples, 1.0), 1.0)))


def _taken(
    problem: Problem,
    members: Members,
    point: Point,
    linears: Sequence[Linear],
    noise: Array,
) -> float:
    """Share of the samples that the fit took as degrees of freedom of the global unknowns."""
    share = effective_share(linears, noise)
    own = system(problem, problem.fit, members, point, linears, noise, share)
    weight = prior_of(problem, members).weights(point.x)
    taken = float(np.trace(np.linalg.solve(own.matrix + np.diag(weight), own.matrix)))
    for inner, _, _ in own.locals:
        taken += len(inner) - float(np.trace(np.linalg.inv(inner)))
    return max(taken, 0.0) / (share * float(problem.samples.sum()))


def box_of(problem: Problem, members: Members) -> Box:
    """Limits of the global unknowns."""
    low, high = problem.parameter_bounds
    bounds = [c.bounds for m in members if (c := problem.causes[m.cause]).effect is not None]
    shapes = count_global(problem, members) - len(low) - len(bounds)
    return Box(
        np.concatenate([low, [b[0] for b in bounds], np.full(shapes, -3.0)]),
        np.concatenate([high, [b[1] for b in bounds], np.full(shapes, 3.0)]),
    )


def _sums(records: Sequence[Observed], linears: Sequence[Linear]) -> tuple[Array, Array]:
    """Number of samples, and sum of the squared residuals, by channel; the linears may be cut."""
    pairs = list(zip(records, linears, strict=True))
    samples = sum(o.valid[: len(x.residual)].sum(axis=0) for o, x in pairs)
    squares = sum((x.residual**2).sum(axis=0) for _, x in pairs)
    return np.asarray(samples, dtype=np.float64), np.asarray(squares)


def _cost(
    problem: Problem,
    records: Sequence[Observed],
    members: Members,
    prior: Prior,
    point: Point,
    linears: Sequence[Linear],
    weight: Array,
) -> float:
    """Negative log posterior with the noise that is left; infinite if a simulation failed."""
    total = float(weight @ misfit(*_sums(records, linears)))
    total += 0.5 * (prior.penalty(point.x) + local_penalty(problem, records, members, point))
    return total if np.isfinite(total) else np.inf


@dataclass(eq=False)
class _Place:
    """Where a fit is: its point, what is seen there, and what its next step needs."""

    fit: Descent
    prior: Prior
    box: Box
    point: Point
    seen: Sequence[Linear]
    trust: TrustRadius
    freshness: Freshness
    noise: Array
    weight: Array
    change: float = np.inf
    """Of the logarithm of the noise in the last step."""
    settled: bool = False
    """Whether the noise is that of the set."""

    @classmethod
    def first(cls, fit: Descent, box: Box, point: Point, seen: Sequence[Linear]) -> _Place:
        """The start. All samples have the full weight.

        The weight is that of what the set leaves: at the start, the motion itself is a residual,
        and it would count so little that the prior could keep the parameters there.
        """
        return cls(
            fit,
            prior_of(fit.problem, fit.members),
            box,
            point,
            seen,
            TrustRadius(),
            Freshness(fit.problem.model.cheap_derivatives),
            noise_left(fit.problem, seen),
            np.ones(len(fit.problem.channels)),
        )

    def settle(self, first: bool) -> bool:
        """Let noise and weight follow what the set leaves; False: a rough fit ends before."""
        fit, problem = self.fit, self.fit.problem
        taken = _taken(problem, fit.members, self.point, self.seen, self.noise)
        left = noise_left(problem, self.seen, taken)
        self.settled = self.settled or (self.change < SETTLED and not self.trust.far)
        if self.settled and fit.rough:
            return False
        own = Fitted(fit.members, self.point, tuple(self.seen), left)
        if self.settled:
            self.weight = weights(problem, own, own)
        if not first:
            self.change = float(np.abs(np.log(left / self.noise)).max())
        self.noise = left
        if not (fit.known and first):
            fit.now = own
        return True

    def cost(self, point: Point, seen: Sequence[Linear]) -> float:
        """Negative log posterior."""
        problem = self.fit.problem
        return _cost(problem, problem.fit, self.fit.members, self.prior, point, seen, self.weight)

    def move(self, damping: float) -> Move:
        """The step with a damping."""
        problem, members = self.fit.problem, self.fit.members
        own = system(
            *(problem, problem.fit, members, self.point, self.seen),
            *(self.noise, self.weight, damping),
            softness(problem, problem.fit, members, self.point, begins=True),
        )
        return self.box.move(own, self.prior, self.point.x, damping)

    def ask(self, point: Point, derivatives: bool = True) -> EvaluationRequest:
        """Request of residuals at a point."""
        problem = self.fit.problem
        return EvaluationRequest(self.fit.members, point, problem.fit, derivatives=derivatives)


def _descend(fit: Descent) -> Steps:
    """Damped Gauss-Newton steps of the unknowns; noise and weights follow what the set leaves.

    A step increases the log posterior, in which a sample has the weight that it has in the
    comparison of sets.
    """
    box = box_of(fit.problem, fit.members)
    point = replace(fit.point, x=box.inside(fit.point.x))
    first = [*fit.known] or (yield EvaluationRequest(fit.members, point, fit.problem.fit))
    if any(x.failed for x in first):
        return None
    at = _Place.first(fit, box, point, first)
    for _ in range(ROUNDS):
        if not at.settle(at.seen is first):
            break
        gain = yield from _improve(at)
        fit.gain = gain if at.settled else max(gain, CONVERGED)
        if at.trust.far and gain > 0.0:  # its steps are limited, and grow
            fit.gain = np.inf
        if fit.gain < CONVERGED:
            if not at.freshness.stale:
                break
            at.seen = yield at.ask(at.point)
            at.freshness.renewed()
        at.settled = at.settled or gain < CONVERGED
    fit.now = Fitted(fit.members, at.point, tuple(at.seen), at.noise)
    return fit.now


def _improve(at: _Place) -> Generator[EvaluationRequest, list[Linear], float]:
    """One step, shorter and shorter until it gains; its gain, 0: there is none."""
    now = at.cost(at.point, at.seen)
    for trial in range(TRIALS):
        move = at.trust.within(at.move)
        if at.change < SETTLED and move.promised < CONVERGED:
            return 0.0
        moved = move.of(at.point)
        own = at.freshness.asked
        found = yield at.ask(moved, own)
        cost = at.cost(moved, found)
        if cost < now:
            at.freshness.accepted(now - cost, move.promised)
            if at.freshness.stale:
                found = _secant(at.seen, found, move.step, move.local)
            elif not own:
                found = yield at.ask(moved)
            at.trust.accepted(move)
            at.point, at.seen = moved, found
            return now - cost
        if at.freshness.due(trial):
            at.seen = yield at.ask(at.point)
            at.freshness.renewed()
        elif not at.freshness.stale and cost < now + CONVERGED:  # flat
            return 0.0
        else:
            at.trust.rejected(move)
            at.freshness.rejected()
    return 0.0


def _secant(
    seen: Sequence[Linear], found: Sequence[Linear], step: Array, local: Sequence[Array]
) -> list[Linear]:
    """Residuals after a step, and the derivatives before it, corrected by what the step changed.

    The smallest correction with which the derivatives predict the step (Broyden, Mathematics of
    Computation 19, 1965, 577).
    """
    out, square = [], float(step @ step)
    for x, y, d in zip(seen, found, local, strict=True):
        missed = x.residual - y.residual - x.by_global @ step - x.by_local @ d
        change = missed[..., None] * (step / square) if square > 0.0 else 0.0
        out.append(replace(x, residual=y.residual, by_global=x.by_global + change))
    return out


def first_step(
    problem: Problem, point: Point
) -> Generator[EvaluationRequest, list[Linear], tuple[Linear, ...] | None]:
    """Residuals and derivatives of the model alone at a point; None: it is far from linear there.

    It is if a step does not gain what it promises.
    """
    fit = Descent(problem, (), point)
    seen = yield EvaluationRequest((), point, problem.fit)
    if any(x.failed for x in seen):
        return None
    at = _Place.first(fit, box_of(problem, ()), point, seen)
    move = at.move(0.0)
    if move.length > RADIUS:
        return None
    moved = move.of(point)
    found = yield at.ask(moved, derivatives=False)
    gain = at.cost(point, seen) - at.cost(moved, found)
    return tuple(seen) if gain > AS_PROMISED * move.promised else None


def fit_local(
    problem: Problem,
    records: tuple[Observed, ...],
    members: Members,
    point: Point,
    noise: Array,
    weight: Array,
    rounds: int = 6,
    parts: Sequence[float] = (),
) -> Generator[EvaluationRequest, list[Linear], Fitted | None]:
    """Fit the unknowns of records only; the global unknowns keep their values.

    Parameters
    ----------
    problem, members
        The problem and the set.
    records
        Records, which may be held-out ones.
    point
        Global unknowns, and the start of the local ones.
    noise, weight
        Noise, and weight of a sample, by channel.
    rounds
        Largest number of steps for each part.
    parts
        Growing parts of the records that are fitted first, as shares of their length: a start state
        that is far off is found from the beginning of a record.
    """
    prior = Prior(np.zeros(0), np.zeros(0, dtype=bool))
    none = np.zeros(0)

    def cut(linears: Sequence[Linear], part: float) -> list[Linear]:
        out = []
        for x in linears:
            n = max(2, round(part * len(x.residual)))
            out.append(Linear(x.residual[:n], x.by_global[:n], x.by_local[:n], x.by_further[:n]))
        return out

    seen = yield EvaluationRequest(members, point, records, by_global=False)
    for part in (*parts, 1.0):
        now = cut(seen, part)
        local_point = Point(none, point.local)
        cost = _cost(problem, records, members, prior, local_point, now, weight)
        damping = 1e-3
        for _ in range(rounds):
            left = _noise(*_sums(records, now))
            soft = softness(problem, records, members, local_point, begins=True)
            own = system(problem, records, members, local_point, now, left, weight, damping, soft)
            moved = replace(
                point,
                local=tuple(
                    a + np.linalg.solve(inner, target)
                    for a, (inner, _, target) in zip(point.local, own.locals, strict=True)
                ),
            )
            found = yield EvaluationRequest(members, moved, records, by_global=False)
            trial = Point(none, moved.local)
            own_cost = _cost(problem, records, members, prior, trial, cut(found, part), weight)
            if not own_cost < cost:
                damping *= 30.0
                if damping > 1e3:
                    break
                continue
            gain, cost, damping = cost - own_cost, own_cost, damping / 6.0
            point, local_point, seen, now = moved, trial, found, cut(found, part)
            if gain < CONVERGED:
                break
    if any(x.failed for x in seen):
        return None
    return Fitted(members, point, tuple(seen), noise)


def empty_point(problem: Problem, members: Members, records: Sequence[Observed]) -> Point:
    """Tabulated parameters, no magnitudes, listed shapes, and the expected starts."""
    return Point(
        np.zeros(count_global(problem, members)),
        tuple(np.zeros(len(local_of(problem, members, o))) for o in records),
    )
