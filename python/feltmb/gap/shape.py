"""Fits the shapes of effects, for example a width, level or time, between the values of the list.

The list is coarse. If the true backlash is half as wide as the nearest value, a residual remains,
and the search would compensate it with effects that do not exist.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from feltmb.data import Array
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Candidate, Effect
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import FITTED_SHAPE
from feltmb.gap.score import score_fit

__all__ = ["between", "by_shapes", "movable", "moved_shape", "off_grid", "shape_number"]

#: Factor by which a fitted shape may exceed the range of its list.
BEYOND = 5.0
#: Number of steps to bracket the maximum, and within the bracket.
STEPS, FINER = 3, 4
#: Number of Gauss-Newton steps of all numbers together.
TOGETHER = 3
#: Relative accuracy of a shape within the bracket.
CLOSE = 0.002
#: Gain that is not worth a further step [log evidence].
SMALL_GAIN = 0.1
#: Step of the difference for a derivative, in the logarithm of a shape.
STEP = 0.01
#: Log evidence of a fit that cannot be simulated.
WORST = 1e30

Make = Callable[[Fit, tuple[Candidate, ...]], Fit]


def movable(effect: Effect) -> tuple[int, ...]:
    """Indices of the numbers of a shape that may take any value: (0,) if the shape is one number.

    These are floats on one side of ``effect.shape_zero``, of which the list has two or more values.
    Shapes with other texts may be on the other side. Integers, zeros, texts and constants are not
    fitted.
    """
    rows = [s if isinstance(s, tuple) else (s,) for s in effect.shapes]
    zero = effect.shape_zero
    if len({len(r) for r in rows}) != 1:
        return ()
    return tuple(
        k
        for k, column in enumerate(zip(*rows, strict=True))
        if all(isinstance(v, float) and 0.0 < abs(v - zero) < math.inf for v in column)
        and len(set(column)) > 1
        and len({(_texts(r), math.copysign(1.0, r[k] - zero)) for r in rows})
        == len({*map(_texts, rows)})
    )


def _texts(shape: Any) -> tuple[str, ...]:
    """Texts of a shape."""
    return tuple(v for v in shape if isinstance(v, str)) if isinstance(shape, tuple) else ()


def off_grid(fit: Fit) -> bool:
    """Whether other shapes of its effects improve a fit, so that the true ones are not listed.

    It is a score test of the logarithm of each number of a shape, with all other unknowns
    projected out.
    """
    _, gains = _one_step(fit)
    return max(gains, default=0.0) > FITTED_SHAPE


def _one_step(fit: Fit) -> tuple[dict[tuple[int, int], float], list[float]]:
    """Step of the logarithm of each number of a shape alone, and what it gains [log evidence]."""
    places = [(k, i) for k, c in enumerate(fit.included) for i in movable(c.effect)]
    if not places:
        return {}, []
    numbers = tuple(
        Candidate(replace(fit.included[k].effect, scale=1.0, sign=0), None) for k, _ in places
    )
    scores = score_fit(fit, numbers, linears=by_shapes(fit, places))
    gram = np.where(scores.testable, np.diag(scores.gram), np.inf)
    steps = dict(zip(places, (scores.b / gram).tolist(), strict=True))
    return steps, (0.5 * scores.b**2 / gram).tolist()


def by_shapes(fit: Fit, places: Sequence[tuple[int, int]]) -> list[Linear]:
    """Linearizations of a fit, with the derivatives by the logarithms of numbers of its shapes.

    They are differences of simulations, in the place of the candidates.

    Parameters
    ----------
    places
        Candidate and number of its shape, by their indices.
    """
    columns = [_columns(fit, k, place) for k, place in places]
    shared = len(fit.problem.free) + len(fit.included)
    return [_with(x, [c[n] for c in columns], shared) for n, x in enumerate(fit.linears)]


def _columns(fit: Fit, k: int, place: int) -> list[tuple[Array, Array]]:
    """By record: minus the derivative of the residual (W, m), and of the ends (W - 1, nx)."""
    up, down = (_seen(fit, k, place, math.exp(s)) for s in (STEP, -STEP))
    out = []
    for (high, end), (low, start) in zip(up, down, strict=True):
        with np.errstate(invalid="ignore"):
            pair = (low - high) / (2.0 * STEP), (end - start) / (2.0 * STEP)
        out.append((np.nan_to_num(pair[0]), np.nan_to_num(pair[1])))
    return out


def _seen(fit: Fit, k: int, place: int, factor: float) -> list[tuple[Array, Array]]:
    """Residuals and continuity defects with one changed shape."""
    included = list(fit.included)
    effect, shape = included[k].effect, included[k].shape
    number = shape_number(effect, shape, place) * factor
    included[k] = Candidate(effect, moved_shape(effect, shape, place, number))
    seen = fit.problem.with_candidates(tuple(included)).predict(fit.point)
    return [(residual, gap) for _, residual, gap in seen]


def _with(linear: Linear, columns: list[tuple[Array, Array]], at: int) -> Linear:
    """A linearization with more columns after those of the magnitudes."""
    outputs = np.stack([c[0] for c in columns], axis=2)
    ends = np.zeros((*linear.ends_by_global.shape[:2], len(columns)))
    if ends.shape[1]:
        ends[:-1] = np.stack([c[1] for c in columns], axis=2)
    return replace(
        linear,
        by_global=np.insert(linear.by_global, [at] * len(columns), outputs, axis=2),
        ends_by_global=np.insert(linear.ends_by_global, [at] * len(columns), ends, axis=2),
    )


def between(fit: Fit, make: Make, value: Callable[[Fit], float]) -> Fit:
    """The fit with the shapes of its effects moved to the maximum of ``value``.

    Each number is searched by itself. Then all of them move by Gauss-Newton steps.

    Parameters
    ----------
    fit
        Fit of a set of effects.
    make
        ``make(near, included)``: fits the same effects with other shapes, starting from the fit
        ``near``.
    value
        Log evidence of a fit.
    """
    best = fit
    for k, candidate in enumerate(fit.included):
        for place in movable(candidate.effect):
            best = _along(best, k, place, make, value)
    for _ in range(TOGETHER):
        steps, gains = _one_step(best)
        if max(gains, default=0.0) < SMALL_GAIN:
            break
        included = list(best.included)
        for (k, place), step in steps.items():
            effect, shape = included[k].effect, included[k].shape
            number = shape_number(effect, shape, place)
            low, high = _limits(effect, shape, place)
            x = np.clip(math.log(abs(number)) + np.clip(step, -0.5, 0.5), low, high)
            number = math.copysign(math.exp(x), number)
            included[k] = Candidate(effect, moved_shape(effect, shape, place, number))
        trial = make(best, tuple(included))
        if not (math.isfinite(trial.cost) and value(trial) > value(best)):
            break
        best = trial
    return best


def _listed(effect: Effect, shape: Any, place: int) -> list[float]:
    """Values of a number in the list of an effect, without their sign, in ascending order."""
    alike = [s for s in effect.shapes if _texts(s) == _texts(shape)]
    return sorted({abs(shape_number(effect, s, place)) for s in alike})


def _limits(effect: Effect, shape: Any, place: int) -> tuple[float, float]:
    """Smallest and largest logarithm of a fitted number."""
    listed = _listed(effect, shape, place)
    return math.log(listed[0] / BEYOND), math.log(listed[-1] * BEYOND)


def _along(fit: Fit, k: int, place: int, make: Make, value: Callable[[Fit], float]) -> Fit:
    """A fit near the maximum over the logarithm of one number: a bracket, then Brent's method."""
    from scipy.optimize import minimize_scalar

    effect, shape = fit.included[k].effect, fit.included[k].shape
    listed = _listed(effect, shape, place)
    low, high = _limits(effect, shape, place)
    number = shape_number(effect, shape, place)
    sign, here = math.copysign(1.0, number), math.log(abs(number))
    fits = {here: fit}
    values = {here: value(fit)}

    def loss(x: float) -> float:
        x = float(x)
        if x not in values:
            near = fits[min(fits, key=lambda known: abs(known - x))]
            included = list(near.included)
            included[k] = Candidate(
                effect, moved_shape(effect, included[k].shape, place, sign * math.exp(x))
            )
            fits[x] = make(near, tuple(included))
            values[x] = value(fits[x]) if math.isfinite(fits[x].cost) else -WORST
        return -values[x]

    # Half of the distance to the next value of the list, so that both sides are covered.
    step = 0.5 * float(np.min(np.diff(np.log(listed)), initial=math.log(BEYOND)))
    left, top, right = max(here - step, low), here, min(here + step, high)
    for _ in range(STEPS):
        if loss(left) < loss(top) and left > low:
            left, top, right = max(left - step, low), left, top
        elif loss(right) < loss(top) and right < high:
            left, top, right = top, right, min(right + step, high)
        else:
            break
    if left < top < right and loss(top) < min(loss(left), loss(right)):
        minimize_scalar(
            loss,
            bracket=(left, top, right),
            method="brent",
            options={"xtol": CLOSE / max(abs(top), 1.0), "maxiter": FINER},
        )
    return fits[max(values, key=lambda x: values[x])]


def shape_number(effect: Effect, shape: Any, place: int) -> float:
    """One number of a shape, by index, from the zero of its effect."""
    return float(shape[place] if isinstance(shape, tuple) else shape) - effect.shape_zero


def moved_shape(effect: Effect, shape: Any, place: int, number: float) -> Any:
    """Copy of a shape with one changed number, from the zero of its effect."""
    number += effect.shape_zero
    if not isinstance(shape, tuple):
        return number
    if hasattr(shape, "_make"):  # a named tuple keeps its type
        return shape._make((*shape[:place], number, *shape[place + 1 :]))
    return (*shape[:place], number, *shape[place + 1 :])
