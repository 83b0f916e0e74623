"""Joint uncertainty of magnitudes and fitted shapes.

A fitted shape is a number of the model like a magnitude, and the two are often correlated: a wider
clearance with a lower stiffness may fit as well. The derivative by the logarithm of the shape is
computed as a difference of residuals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Candidate
from feltmb.fit.solve import Fit, inverse_scaled
from feltmb.gap.shape import movable, moved_shape, shape_number

__all__ = ["Spread", "spread"]

#: Step of the difference, in the logarithm of a shape.
STEP = 0.01
#: Prior standard deviation of that logarithm; the lists of shapes span a few factors.
WIDE = 1.0


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviations of the magnitudes of a fit and of the logarithms of its shapes."""

    magnitudes: Array
    """Standard deviations of the magnitudes, (k,), in the order of the included effects [their
    units]."""
    shapes: dict[tuple[int, int], float]
    """(candidate, index of the number in its shape) -> standard deviation of its logarithm [1]."""


def spread(fit: Fit) -> Spread:
    """Standard deviations of the fitted magnitudes and of the shapes that can take any value."""
    count = len(fit.problem.free)
    places = [(k, i) for k, candidate in enumerate(fit.included) for i in movable(candidate.effect)]
    matrix = fit.normal.matrix
    if places:
        columns = [_columns(fit, k, i) for k, i in places]
        shared = count + len(fit.included)
        linears = [_with(x, [c[n] for c in columns], shared) for n, x in enumerate(fit.linears)]
        matrix = fit.problem.normal(fit.point, linears, fit.gap_sd).matrix.copy()
        for j in range(len(places)):
            matrix[shared + j, shared + j] += 1.0 / WIDE**2
    sd = np.sqrt(np.maximum(np.diag(inverse_scaled(matrix)), 0.0))
    at = count + len(fit.included)
    return Spread(sd[count:at], {p: float(sd[at + j]) for j, p in enumerate(places)})


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
    number = shape_number(included[k].shape, place) * factor
    included[k] = Candidate(included[k].effect, moved_shape(included[k].shape, place, number))
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
