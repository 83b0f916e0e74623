"""Monotone curve through the samples of one branch of a loop, with the errors of its forces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

__all__ = ["MonotoneCurve", "monotone_curve"]

Array = NDArray[np.float64]

#: Most knots of the curve of a branch.
KNOTS = 40
#: Lowest sample of a branch, as a share of the compression, that needs no extrapolation.
LOWEST = 0.02
#: Range of the exponent of an extrapolated branch.
EXPONENTS = (1.0, 10.0)
#: Parts of a branch within which the scatter counts as constant.
PARTS = 8
#: Most pieces of the spline about which the scatter is determined.
PIECES = 10
#: Largest correlation of successive samples.
CORRELATED = 0.98


@dataclass(frozen=True)
class MonotoneCurve:
    """Force of one branch, which starts at zero and never falls."""

    e: Array
    """Compression of the samples [m], in the order of the test."""
    force: Array
    """Their force [N]."""
    knots: Array
    """Compressions between which the fitted force is linear [m]; the first one is 0."""
    steps: Array
    """Rise of the force from knot to knot [N], at least 0."""
    low: float
    """Compression below which the curve is a power of the compression [m], or 0."""
    before: int = 0
    """Number of samples before the contact, which are not used."""

    @cached_property
    def scatter(self) -> tuple[Array, float]:
        """Standard deviation of each sample [N], and the correlation of successive ones."""
        return _scatter(self.e, self.force)

    def at(self, grid: Array) -> Array:
        """Force at some compressions [N]."""
        from scipy.interpolate import PchipInterpolator

        fitted = PchipInterpolator(self.knots, np.concatenate([[0.0], np.cumsum(self.steps)]))
        curve = np.asarray(fitted(grid))
        low, near = self.low, min(2.0 * self.low, float(self.knots[-1]))
        if low and fitted(low) > 0.0 and near > low:
            power = np.log(fitted(near) / fitted(low)) / np.log(near / low)
            below = grid < low
            curve[below] = fitted(low) * (grid[below] / low) ** np.clip(power, *EXPONENTS)
        return curve

    def chords(self, grid: Array) -> Array:
        """Force at some compressions, linear between the knots as in the least squares [N].

        Unlike the smooth curve, it is not below the samples where the force is convex.
        """
        linear = np.interp(grid, self.knots, np.concatenate([[0.0], np.cumsum(self.steps)]))
        return np.where(grid < self.low, self.at(grid), linear)

    def errors(self, grid: Array, *, chords: bool = False) -> Array:
        """Independent errors of the curve, from the scatter of the samples (rows, errors) [N].

        Each column is one standard deviation of an error at all compressions of the grid. Steps at
        their limit of zero count as known.
        """
        from scipy.signal import lfilter

        free = self.steps > 0.0
        if not free.any():
            return np.zeros((grid.size, 0))
        basis = _rise(self.e, self.knots)[:, free]
        local, decay = self.scatter
        scaled = local[:, None] * basis
        forward = lfilter([1.0], [1.0, -decay], scaled, axis=0)
        backward = lfilter([1.0], [1.0, -decay], scaled[::-1], axis=0)[::-1]
        inverse = np.linalg.pinv(basis.T @ basis, hermitian=True)
        spread = inverse @ (scaled.T @ (forward + backward - scaled)) @ inverse
        small = 1e-6 * float(np.sum(self.steps)) + 1e-300
        form = MonotoneCurve.chords if chords else MonotoneCurve.at
        own = form(self, grid)
        weights = np.column_stack(
            [
                (form(replace(self, steps=self.steps + small * unit), grid) - own) / small
                for unit in np.eye(self.steps.size)[free]
            ]
        )
        sizes, directions = np.linalg.eigh(spread)
        return np.asarray(weights @ directions * np.sqrt(np.maximum(sizes, 0.0)))


def monotone_curve(e: Array, force: Array, end: float) -> MonotoneCurve:
    """Monotone curve with the least squares through zero.

    Parameters
    ----------
    e
        Compression of the samples [m], (n,); those below 0 are not used.
    force
        Their force [N], (n,).
    end
        Compression at the end of the curve [m].
    """
    from scipy.optimize import nnls

    before = int(np.sum(e < 0.0))
    force, e = force[e >= 0.0], e[e >= 0.0]  # before the contact, samples say nothing about it
    low = float(np.min(e))
    low = low if low > LOWEST * end else 0.0
    count = int(np.clip(e.size // 4, 4, KNOTS))
    knots = low + (end - low) * np.linspace(0.0, 1.0, count + 1) ** 1.5
    if low:
        knots = np.concatenate([[0.0], knots])
    # A triangular factor has the same least squares in as many rows as there are knots.
    factor = np.asarray(np.linalg.qr(np.column_stack([_rise(e, knots), force]), mode="r"))
    steps, _ = nnls(factor[:, :-1], factor[:, -1])
    return MonotoneCurve(e, force, knots, steps, low, before)


def _rise(e: Array, knots: Array) -> Array:
    """Share of the step from knot to knot that each compression has passed, (n, steps)."""
    return np.clip((e[:, None] - knots[:-1]) / np.diff(knots), 0.0, 1.0)


def _scatter(e: Array, force: Array) -> tuple[Array, float]:
    """Standard deviation of each sample [N], and the correlation of successive ones.

    The noise is a first-order process with a standard deviation that changes slowly. Its
    correlation maximizes the restricted likelihood beside a cubic spline with few pieces: a
    flexible curve would take up the noise that is correlated over some samples.
    """
    from scipy.interpolate import BSpline
    from scipy.ndimage import uniform_filter1d
    from scipy.optimize import minimize_scalar

    pieces = int(np.clip(e.size // 16, 1, PIECES))
    inner = np.linspace(float(np.min(e)), float(np.max(e)), pieces + 1)
    ends = np.repeat(inner[0], 3), np.repeat(inner[-1], 3)
    basis = BSpline.design_matrix(e, np.concatenate([ends[0], inner, ends[1]]), 3).toarray()
    n, fitted = basis.shape
    rest = force - basis @ np.linalg.lstsq(basis, force, rcond=None)[0]
    square = uniform_filter1d(rest**2, max(n // PARTS, 3), mode="nearest")
    local = np.sqrt(np.maximum(square, 1e-6 * np.mean(square) + 1e-300))
    rows = np.column_stack([basis, force]) / local[:, None]
    free = max(n - fitted, 1)

    def innovations(correlation: float) -> tuple[float, float]:
        """Variance of the innovations, and the criterion."""
        first = np.sqrt(1.0 - correlation**2) * rows[:1]
        white = np.concatenate([first, rows[1:] - correlation * rows[:-1]])
        size = np.abs(np.diag(np.linalg.qr(white, mode="r"))) + 1e-12
        variance = float(size[-1]) ** 2 / free
        logs = 2.0 * float(np.sum(np.log(size[:-1]))) - np.log(1.0 - correlation**2)
        return variance, free * np.log(variance) + logs

    found = minimize_scalar(
        lambda z: innovations(np.tanh(z))[1],
        bounds=(0.0, np.arctanh(CORRELATED)),
        method="bounded",
        options={"xatol": 0.02},
    )
    correlation = float(np.tanh(found.x))
    factor = np.sqrt(innovations(correlation)[0] / (1.0 - correlation**2))
    return factor * local, correlation
