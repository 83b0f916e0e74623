"""Monotone curve through the samples of one branch of a loop, with the errors of its forces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Most intervals of the spline of a branch.
INTERVALS = 40
#: Lowest sample of a branch, as a share of the compression, that needs no extrapolation.
LOWEST = 0.02
#: Range of the exponent of an extrapolated branch.
EXPONENTS = (1.0, 10.0)
#: Parts of a branch within which the scatter counts as constant, and least samples of one.
PARTS, SAMPLES = 8, 16
#: Largest correlation of successive samples, and number of samples from which it is determined.
CORRELATED, LEAST_CORRELATED = 0.98, 64
#: Range of the logarithm of the stiffness of the spline, beside that of its samples.
STIFFNESS = (-20.0, 16.0)


@dataclass(frozen=True)
class MonotoneCurve:
    """Force of one branch, which starts at zero and never falls."""

    knots: Array
    """Knots of the cubic spline [m], without their repetitions at the ends."""
    steps: Array
    """Rises from coefficient to coefficient of the spline [N], at least 0; first the force at the
    beginning."""
    low: float
    """Compression below which the curve is a power of the compression [m], or 0."""
    before: int
    """Number of samples before the contact, which are not used."""
    spread: Array
    """Independent errors of the steps, (steps, errors) [N]."""
    scatter: tuple[Array, float]
    """Standard deviation of each sample [N], and the correlation of successive ones."""

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the sample with the smallest compression [N]."""
        return float(self.scatter[0][0])

    def at(self, grid: Array) -> Array:
        """Force at some compressions, in ascending order [N]."""
        force = self._spline(grid, self.steps[:, None])[:, 0]
        near = min(2.0, float(self.knots[-1]) / self.low) if self.low else 1.0
        if near > 1.0:
            ends = np.array([self.low, near * self.low])
            small, large = self._spline(ends, self.steps[:, None])[:, 0]
            power = 1.0
            if small > 0.0:
                power = float(np.clip(np.log(large / small) / np.log(near), *EXPONENTS))
            below = grid < self.low
            force[below] = small * (np.maximum(grid[below], 0.0) / self.low) ** power
        return np.maximum.accumulate(np.where(grid > 0.0, np.maximum(force, 0.0), 0.0))

    def errors(self, grid: Array) -> Array:
        """Independent errors of the curve (rows, errors) [N].

        Each column is one standard deviation of an error at all compressions of the grid, from the
        scatter of the samples and from what may lie between them.
        """
        change = self._spline(grid, self.spread)
        if self.low:  # as a share of the curve
            below, ends = grid < self.low, self.at(np.array([self.low]))
            share = self.at(grid[below]) / ends if ends[0] > 0.0 else grid[below] / self.low
            change[below] *= share[:, None]
        return change

    def _spline(self, grid: Array, steps: Array) -> Array:
        """Splines at some compressions, without a power below ``low`` (rows, splines) [N]."""
        from scipy.interpolate import BSpline

        spline = BSpline(_padded(self.knots), np.cumsum(steps, axis=0), 3)
        force = spline(np.clip(grid, self.knots[0], self.knots[-1]))
        if not self.low:  # a felt without compression has no force
            force -= steps[0] * np.maximum(1.0 - grid / self.knots[1], 0.0)[:, None] ** 2
        return np.asarray(force)


def monotone_curve(e: Array, force: Array, end: float) -> MonotoneCurve:
    """Monotone smoothing spline, whose stiffness and noise are those of the largest likelihood.

    Coarse samples without noise are interpolated. The noise is a first-order process with a
    standard deviation that changes slowly.

    Parameters
    ----------
    e
        Compression of the samples [m] in the order of the test, (n,); those below 0 are not used.
    force
        Their force [N], (n,).
    end
        Compression at the end of the curve [m].
    """
    from scipy.interpolate import BSpline
    from scipy.ndimage import uniform_filter1d
    from scipy.optimize import nnls

    before = int(np.sum(e < 0.0))
    force, e = force[e >= 0.0], e[e >= 0.0]  # before the contact, samples say nothing about it
    if e[0] > e[-1]:
        force, e = force[::-1], e[::-1]
    low = float(np.min(e))
    low = low if low > LOWEST * end else 0.0
    count = int(np.clip(e.size, 4, INTERVALS))
    knots = low + (end - low) * np.linspace(0.0, 1.0, count + 1) ** 1.5
    knots[-1] = end  # a sample at the end is not beyond it by rounding
    padded = _padded(knots)
    middle = 0.5 * (knots[1:] + knots[:-1])
    unit = np.eye(count + 3)
    bends = BSpline(padded, unit, 3).derivative(3)(middle) * np.diff(knots)[:, None] ** 3
    rows = BSpline.design_matrix(np.minimum(e, end), padded, 3).toarray()
    rows = np.column_stack([rows, force])
    local = np.ones(e.size)
    fit = _smooth(rows, bends)
    width = e.size // PARTS
    if width >= SAMPLES:
        square = uniform_filter1d((force - rows[:, :-1] @ fit.best) ** 2, width, mode="nearest")
        local = np.sqrt(np.maximum(square / np.mean(square), 1e-4)) if square.any() else local
        fit = _smooth(rows / local[:, None], bends)
    rise = np.tril(np.ones((count + 3, count + 3)))
    sizes, directions = np.linalg.eigh(
        np.linalg.solve(rise, np.linalg.solve(rise, fit.covariance).T)
    )
    sizes = np.sqrt(np.maximum(sizes, 1e-14 * sizes[-1]))
    factor = directions.T / sizes[:, None]
    steps, _ = nnls(factor, factor @ np.linalg.solve(rise, fit.best))
    spread = directions * sizes
    scatter = fit.noise * local / np.sqrt(1.0 - fit.correlation**2)
    return MonotoneCurve(knots, steps, low, before, spread, (scatter, fit.correlation))


@dataclass(frozen=True)
class _Smooth:
    """Smoothing spline without limits."""

    best: Array
    """Coefficients [N]."""
    covariance: Array
    """Their covariance [N^2]."""
    noise: float
    """Standard deviation of the innovations of the noise [N]."""
    correlation: float
    """Correlation of successive samples."""


def _smooth(rows: Array, bends: Array) -> _Smooth:
    """Spline whose correlation of the noise has the largest restricted likelihood.

    It is the mean over all stiffnesses, with their likelihoods as weights: few samples tell the
    stiffness badly.

    Parameters
    ----------
    rows
        Basis at each sample, and its force.
    bends
        Third differences of the coefficients, which have a normal distribution.
    """
    from scipy.optimize import minimize

    n, size = rows.shape[0], rows.shape[1] - 1
    now, then = rows[1:], rows[:-1]
    parts = rows[:1].T @ rows[:1], now.T @ now, now.T @ then + then.T @ now, then.T @ then
    penalty = bends.T @ bends
    scale = float(np.trace(parts[1][:-1, :-1]) / np.trace(penalty))
    freedom = max(n - (size - bends.shape[0]), 3)
    most = float(np.arctanh(CORRELATED)) if n >= LEAST_CORRELATED else 0.0

    def fitted(at: Array) -> tuple[float, float, Array, Array]:
        """Criterion, squares of the innovations, and the normal equations in triangular form."""
        inside = np.clip(at, [STIFFNESS[0], 0.0], [STIFFNESS[1], most])
        correlation, weight = float(np.tanh(inside[1])), scale * float(np.exp(inside[0]))
        gram = (1.0 - correlation**2) * parts[0] + parts[1]
        gram = gram - correlation * parts[2] + correlation**2 * parts[3]
        normal = gram[:-1, :-1] + weight * penalty
        normal += 1e-13 * np.trace(normal) / size * np.eye(size)
        factor = np.linalg.cholesky(normal)
        half = np.linalg.solve(factor, gram[:-1, -1])
        squares = max(float(gram[-1, -1] - half @ half), 1e-15 * float(gram[-1, -1])) + 1e-300
        logs = 2.0 * float(np.sum(np.log(np.diag(factor)))) - np.log(1.0 - correlation**2)
        cost = freedom * np.log(squares) + logs - bends.shape[0] * np.log(weight)
        outside = float(np.sum((at - inside) ** 2))
        return float(cost + outside), squares, half, np.asarray(factor, dtype=np.float64)

    grid = np.arange(STIFFNESS[0], STIFFNESS[1] + 1.0, 2.0)
    starts = [np.array([s, z]) for s in grid[::2] for z in (0.0, 0.5, 1.2) if z <= most]
    start = min(starts, key=lambda at: fitted(at)[0])
    found = minimize(
        lambda at: fitted(at)[0],
        start,
        method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 1e-3},
    ).x
    near = []
    for stiffness in (*grid, found[0]):
        cost, squares, half, factor = fitted(np.array([stiffness, found[1]]))
        near.append((cost, squares, np.asarray(np.linalg.solve(factor.T, half)), factor))
    shares = np.exp(0.5 * (min(cost for cost, *_ in near) - np.array([cost for cost, *_ in near])))
    shares /= np.sum(shares)
    best = np.sum([share * c for share, (_, _, c, _) in zip(shares, near, strict=True)], axis=0)
    covariance, variance = np.zeros((size, size)), 0.0
    for share, (_, squares, c, factor) in zip(shares, near, strict=True):
        if share < 1e-6:
            continue
        inverse = np.linalg.inv(factor)
        variance += share * squares / freedom
        covariance += share * squares / (freedom - 2) * inverse.T @ inverse
        covariance += share * np.outer(c - best, c - best)
    correlation = float(np.tanh(np.clip(found[1], 0.0, most)))
    return _Smooth(best, covariance, float(np.sqrt(variance)), correlation)


def _padded(knots: Array) -> Array:
    """Knots with the repetitions of a cubic spline at its ends."""
    return np.concatenate([np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)])
