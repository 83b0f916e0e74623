"""Fits of sets of causes: a damped Gauss-Newton method, and the noise that a set leaves.

A fit is a generator that yields the points at which it needs residuals. Several fits proceed in
step, and the simulations of one step are one call of the model (:func:`together`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import (
    Fitted,
    NormalEquations,
    Prior,
    best_of,
    effective_share,
    local_penalty,
    log_odds,
    misfit,
    prior_of,
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

#: Smallest gain of a step that continues a fit [log evidence].
CONVERGED = 0.1
#: Largest number of steps.
ROUNDS = 40
#: Change of the logarithm of the noise in a step below which the residual is that of the set.
SETTLED = 0.1
#: Largest change of a global unknown in the first step, in its scale; it follows the success.
RADIUS = 2.0
#: Share of the promised gain above which derivatives are used again [1].
AS_PROMISED = 0.5
#: Trials of a step, and how many shorter ones are tried with derivatives of an earlier point:
#: these cost ten times as much as a trial, and a step often fails at a kink that they do not show.
TRIALS, STALE = 7, 2
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

    def prune(waiting: Iterable[int]) -> set[int]:
        known = [f.now for f in fits if f.now is not None]
        some = [i for i in waiting if fits[i].now is not None and np.isfinite(fits[i].gain)]
        if not some:
            return set()
        best, ended = best_of(problem, [*known, *rivals]), set()
        for i in some:
            own = fits[i].now
            assert own is not None
            same = any(
                np.abs(f.now.point.x - own.point.x).max(initial=0.0) < SAME_POINT
                for f in fits[:i]
                if f.now is not None and f.members == own.members
            )
            behind = log_odds(problem, best, own) - NEAR
            if same or fits[i].gain < CATCH_UP * behind:
                ended.add(i)
        return ended

    reason: BaseException | None = None
    try:
        run_in_lockstep(problem, [_descend(f) for f in fits], check, prune)
    except (Stop, KeyboardInterrupt) as stop:
        reason = stop
    best, found = [], iter(fits)
    for s in starts:
        own = [f.now for f in (next(found) for _ in s.points) if f.now is not None]
        best.append(best_of(problem, own) if own else None)
    if reason is not None:
        raise Stop(best) from reason
    return best


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


def _limits(problem: Problem, members: Members) -> tuple[Array, Array]:
    """Lower and upper limits of the global unknowns."""
    low, high = problem.parameter_bounds
    bounds = [c.bounds for m in members if (c := problem.causes[m.cause]).effect is not None]
    shapes = count_global(problem, members) - len(low) - len(bounds)
    return (
        np.concatenate([low, [b[0] for b in bounds], np.full(shapes, -3.0)]),
        np.concatenate([high, [b[1] for b in bounds], np.full(shapes, 3.0)]),
    )


def _step(
    own: NormalEquations, prior: Prior, x: Array, low: Array, high: Array, damping: float
) -> tuple[Array, list[Array]]:
    """Step of global and local unknowns within the limits, from normal equations."""
    weight = prior.weights(x)
    matrix = own.matrix + np.diag(weight * (1.0 + damping) + damping * np.diag(own.matrix))
    right = own.right - weight * x
    step, held = np.zeros(x.size), np.zeros(x.size, dtype=bool)
    for _ in range(6):
        inner = ~held
        if inner.any():
            target = right[inner] - matrix[np.ix_(inner, held)] @ step[held]
            step[inner] = np.linalg.solve(matrix[np.ix_(inner, inner)], target)
        # A limit that the step passes is reached exactly, and the others adapt to it.
        beyond = inner & ((x + step < low) | (x + step > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(x + step, low, high)[beyond] - x[beyond]
        held |= beyond
    step = np.clip(x + step, low, high) - x
    local: list[Array] = [
        np.asarray(np.linalg.solve(inner, target - coupling @ step))
        for inner, coupling, target in own.locals
    ]
    return np.asarray(step), local


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


def _descend(fit: Descent) -> Steps:
    """Damped Gauss-Newton steps of the unknowns; noise and weights follow what the set leaves.

    A step increases the log posterior, in which a sample has the weight that it has in the
    comparison of sets. Derivatives that are not cheap are used again while steps gain what they
    promise; the last point has its own.
    """
    problem, members, point = fit.problem, fit.members, fit.point
    prior = prior_of(problem, members)
    low, high = _limits(problem, members)
    point = replace(point, x=np.clip(point.x, low, high))
    first = seen = [*fit.known] or (yield EvaluationRequest(members, point, problem.fit))
    if any(x.failed for x in seen):
        return None
    # The weight is that of what the set leaves: at the start, the motion itself is a residual, and
    # it would count so little that the prior could keep the parameters there.
    noise, weight, change = noise_left(problem, seen), np.ones(len(problem.channels)), np.inf
    radius, derivatives, far, settled = RADIUS, problem.model.cheap_derivatives, False, False
    stale = False
    for _ in range(ROUNDS):
        left = noise_left(problem, seen, _taken(problem, members, point, seen, noise))
        settled = settled or (change < SETTLED and not far)
        if settled and fit.rough:
            break
        own_fit = Fitted(members, point, tuple(seen), left)
        if settled:
            weight = weights(problem, own_fit, own_fit)
        if seen is not first:
            change = float(np.abs(np.log(left / noise)).max())
        noise = left
        if not (fit.known and seen is first):
            fit.now = own_fit
        now = _cost(problem, problem.fit, members, prior, point, seen, weight)
        gain = 0.0
        for trial in range(TRIALS):
            damping = 1e-3
            for _ in range(20):
                own = system(problem, problem.fit, members, point, seen, noise, weight, damping)
                step, local = _step(own, prior, point.x, low, high, damping)
                length = float(np.abs(step).max(initial=0.0))
                if length <= 1.1 * radius:
                    break
                damping = max(damping, 0.03) * min(length / radius, 10.0)
            promised = _promised(own, prior, point.x, step)
            if change < SETTLED and promised < CONVERGED:
                break
            moved = Point(
                point.x + step,
                tuple(a + b for a, b in zip(point.local, local, strict=True)),
            )
            found = yield EvaluationRequest(members, moved, problem.fit, derivatives=derivatives)
            cost = _cost(problem, problem.fit, members, prior, moved, found, weight)
            if cost < now:
                gain = now - cost
                if not derivatives:
                    stale = not problem.model.cheap_derivatives and gain > AS_PROMISED * promised
                    found = (
                        _secant(seen, found, step, local)
                        if stale
                        else (yield EvaluationRequest(members, moved, problem.fit))
                    )
                # The next first trial is mostly accepted, and its successor needs derivatives.
                derivatives = problem.model.cheap_derivatives
                point, seen = moved, found
                far = damping > 1e-3 and radius >= RADIUS
                radius = max(radius, 2.0 * length)
                break
            if stale and trial == STALE:
                seen, stale = (yield EvaluationRequest(members, point, problem.fit)), False
                continue
            if not stale and cost < now + CONVERGED:  # flat
                break
            radius, derivatives = 0.4 * length, False
        fit.gain = gain if settled else max(gain, CONVERGED)
        if far and gain > 0.0:  # its steps are limited, and grow
            fit.gain = np.inf
        if fit.gain < CONVERGED:
            if not stale:
                break
            seen, stale = (yield EvaluationRequest(members, point, problem.fit)), False
        settled = settled or gain < CONVERGED
    fit.now = Fitted(members, point, tuple(seen), noise)
    return fit.now


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
    prior = prior_of(problem, ())
    low, high = _limits(problem, ())
    seen = yield EvaluationRequest((), point, problem.fit)
    if any(x.failed for x in seen):
        return None
    noise = noise_left(problem, seen)
    own = system(problem, problem.fit, (), point, seen, noise, 1.0)
    step, local = _step(own, prior, point.x, low, high, 0.0)
    if float(np.abs(step).max(initial=0.0)) > RADIUS:
        return None
    moved = Point(point.x + step, tuple(a + b for a, b in zip(point.local, local, strict=True)))
    found = yield EvaluationRequest((), moved, problem.fit, derivatives=False)
    now, cost = (
        _cost(problem, problem.fit, (), prior, p, x, np.ones(len(problem.channels)))
        for p, x in ((point, seen), (moved, found))
    )
    promised = _promised(own, prior, point.x, step)
    return tuple(seen) if now - cost > AS_PROMISED * promised else None


def _promised(own: NormalEquations, prior: Prior, x: Array, step: Array) -> float:
    """Gain that a step of the global unknowns promises, to second order; local ones follow."""
    slope = own.right - prior.weights(x) * x
    inner = sum(float(target @ np.linalg.solve(matrix, target)) for matrix, _, target in own.locals)
    return float(slope @ step) - 0.5 * float(step @ own.matrix @ step) + 0.5 * inner


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
            own = system(problem, records, members, local_point, now, left, weight, damping)
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
