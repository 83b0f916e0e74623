"""Shapes between those of an effect's list: a width, level or time is fitted like a magnitude.

The list is a coarse net: a play that is half as wide as its nearest entry leaves a residual, and
the search would compensate this residual with effects that do not exist.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from feltmb.fit.model import Candidate, Effect
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import FITTED_SHAPE, WORTH_SHAPE
from feltmb.gap.score import score_fit

__all__ = ["between", "movable", "moved_shape", "off_grid", "shape_number"]

#: Factor by which a shape may leave the range of its list.
BEYOND = 5.0
#: Steps to a bracket of the top, and within it.
STEPS, FINER = 3, 6
#: Relative accuracy of a shape.
CLOSE = 0.002
#: Log evidence of what cannot be simulated.
WORST = 1e30

Make = Callable[[Fit, tuple[Candidate, ...]], Fit]


def movable(effect: Effect) -> tuple[int, ...]:
    """Places of the shape whose number may take any value: (0,) where the shape is one number.

    Such are positive floats of which the list has two or more values; whole numbers, zeros, words
    and what the list holds only once stay as they are.
    """
    rows = [s if isinstance(s, tuple) else (s,) for s in effect.shapes]
    if len({len(r) for r in rows}) != 1:
        return ()
    return tuple(
        k
        for k, column in enumerate(zip(*rows, strict=True))
        if all(isinstance(v, float) and 0.0 < v < math.inf for v in column) and len(set(column)) > 1
    )


def off_grid(fit: Fit) -> bool:
    """Whether a second shape of one of its effects would help a fit: the true one is elsewhere."""
    included = [
        Candidate(t.effect, s)
        for t in fit.included
        if movable(t.effect) and _adds(t.effect)
        for s in t.effect.shapes
        if repr(s) != repr(t.shape)
    ]
    if not included:
        return False
    scores = score_fit(fit, tuple(included))
    gram = np.where(scores.testable, np.diag(scores.gram), np.inf)
    # A mixture may need a negative share of either, so that signs do not count.
    return bool(np.max(scores.b**2 / gram) > 2.0 * (FITTED_SHAPE + WORTH_SHAPE))


def _adds(effect: Effect) -> bool:
    """Whether two shapes of it add up; those of an effect that the model itself knows may not."""
    ways = (effect.rate, effect.regressor, effect.observe, effect.excite)
    return any(w is not None for w in ways)


def between(fit: Fit, make: Make, value: Callable[[Fit], float]) -> Fit:
    """The fit with the shapes of its effects moved to where its value is largest.

    Parameters
    ----------
    fit
        A set of effects, fitted.
    make
        ``make(near, included)``: fits the same effects with other shapes, from a fit that is near.
    value
        Log evidence of a fit.
    """
    best = fit
    for k, candidate in enumerate(fit.included):
        for place in movable(candidate.effect):
            best = _along(best, k, place, make, value)
    return best


def _along(fit: Fit, k: int, place: int, make: Make, value: Callable[[Fit], float]) -> Fit:
    """The best fit along the logarithm of one number: a bracket by steps, then Brent's method."""
    from scipy.optimize import minimize_scalar

    effect = fit.included[k].effect
    listed = sorted({shape_number(s, place) for s in effect.shapes})
    low, high = math.log(listed[0] / BEYOND), math.log(listed[-1] * BEYOND)
    here = math.log(shape_number(fit.included[k].shape, place))
    fits = {here: fit}
    values = {here: value(fit)}

    def loss(x: float) -> float:
        x = float(x)
        if x not in values:
            near = fits[min(fits, key=lambda known: abs(known - x))]
            included = list(near.included)
            included[k] = Candidate(effect, moved_shape(included[k].shape, place, math.exp(x)))
            fits[x] = make(near, tuple(included))
            values[x] = value(fits[x]) if math.isfinite(fits[x].cost) else -WORST
        return -values[x]

    # Half of the way to the next of the list, so that both sides of its net are seen.
    step = 0.5 * float(np.min(np.diff(np.log(listed))))
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


def shape_number(shape: Any, place: int) -> float:
    """One number of a shape."""
    return float(shape[place]) if isinstance(shape, tuple) else float(shape)


def moved_shape(shape: Any, place: int, number: float) -> Any:
    """Copy of the shape with one changed number."""
    if not isinstance(shape, tuple):
        return number
    if hasattr(shape, "_make"):  # a named tuple keeps its names
        return shape._make((*shape[:place], number, *shape[place + 1 :]))
    return (*shape[:place], number, *shape[place + 1 :])
