"""Cubic splines (``scipy.interpolate`` takes longer to import than most fits take)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Spline:
    """Cubic splines through signals (b, n), with one cubic in the first and last two intervals.

    Two samples give a line, and three a parabola.
    """

    def __init__(self, time: Array, y: Array):
        self.time, self.y, self.h = time, y, np.diff(time)
        self.rates = self._rates(np.diff(y, axis=1) / self.h)
        means = np.diff(y, axis=1) / self.h
        self.third = (self.rates[:, :-1] + self.rates[:, 1:] - 2.0 * means) / self.h**2
        self.second = (means - self.rates[:, :-1]) / self.h - self.third * self.h

    def _rates(self, means: Array) -> Array:
        """Rates at the samples from the mean rates between them."""
        h, n = self.h, self.time.size
        if n == 2:
            return np.repeat(means, 2, axis=1)
        if n == 3:
            bend = (means[:, 1:] - means[:, :1]) / (h[0] + h[1])
            return np.asarray(means[:, :1] + bend * np.array([-h[0], h[0], h[0] + 2.0 * h[1]]))
        from scipy.linalg import solve_banded

        first, last = h[0] + h[1], h[-2] + h[-1]
        bands = np.zeros((3, n))
        bands[0, 1], bands[0, 2:] = first, h[:-1]
        bands[1, 0], bands[1, 1:-1], bands[1, -1] = h[1], 2.0 * (h[:-1] + h[1:]), h[-2]
        bands[2, :-2], bands[2, -2] = h[1:], last
        right = np.empty_like(self.y)
        right[:, 1:-1] = 3.0 * (h[1:] * means[:, :-1] + h[:-1] * means[:, 1:])
        right[:, 0] = (h[0] + 2.0 * first) * h[1] * means[:, 0] + h[0] ** 2 * means[:, 1]
        right[:, 0] /= first
        right[:, -1] = h[-1] ** 2 * means[:, -2] + (2.0 * last + h[-1]) * h[-2] * means[:, -1]
        right[:, -1] /= last
        return np.asarray(solve_banded((1, 1), bands, right.T, check_finite=False).T)

    def __call__(self, want: Array, order: int = 0) -> Array:
        """Values, or derivatives of order 1 or 2, at times within the samples, (b, m)."""
        i = np.clip(np.searchsorted(self.time, want, side="right") - 1, 0, self.h.size - 1)
        t, second, third = want - self.time[i], self.second[:, i], self.third[:, i]
        if order == 2:
            return np.asarray(2.0 * second + 6.0 * third * t)
        if order == 1:
            return np.asarray(self.rates[:, i] + t * (2.0 * second + 3.0 * third * t))
        return np.asarray(self.y[:, i] + t * (self.rates[:, i] + t * (second + t * third)))
