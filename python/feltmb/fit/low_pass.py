"""First-order low-pass of signals that are linear between samples."""

from __future__ import annotations

import numpy as np

from feltmb.data import Array
from feltmb.data.records import evenly_spaced

__all__ = ["low_passed"]


def low_passed(clock: Array, y: Array, constants: Array, starts: Array | None = None) -> Array:
    """Outputs as a sensor with a first-order lag shows them: constant * d(out)/dt = y - out.

    The filter starts with a given value, else as if the signal always had its first slope.

    Parameters
    ----------
    clock
        Times of the samples [s], (n,).
    y
        Outputs, (B, n).
    constants
        Time constants [s], (B,), >= 0; 0: the output is unchanged.
    starts
        First values of the filters [unit of y], (B,); NaN: not given.

    Returns
    -------
    Array
        Filtered outputs, (B, n).
    """
    out = np.array(y, dtype=np.float64)
    if y.shape[1] < 2:
        return out
    filtered = _even if evenly_spaced(clock) else _uneven
    for constant in np.unique(constants[constants > 0.0]):
        rows = np.flatnonzero(constants == constant)
        step = clock[1] - clock[0]
        first = y[rows, 0] - constant * (y[rows, 1] - y[rows, 0]) / max(step, 1e-300)
        if starts is not None:
            first = np.where(np.isfinite(starts[rows]), starts[rows], first)
        out[rows] = filtered(clock, y[rows], constant, first)
    return out


def _even(time: Array, y: Array, constant: float, first: Array) -> Array:
    """Filter on an even clock, from its first value."""
    from scipy.linalg import solve_banded  # starts ten times as fast as scipy.signal

    step = float(time[1] - time[0])
    decay, share = np.exp(-step / constant), constant / step
    new = 1.0 + share * np.expm1(-step / constant)
    old = -np.expm1(-step / constant) - new
    # out[j] - decay * out[j - 1] = new * y[j] + old * y[j - 1]
    right = new * y
    right[:, 1:] += old * y[:, :-1]
    right[:, 0] = first
    bands = np.array([np.ones(time.size), np.full(time.size, -decay)])
    return np.asarray(solve_banded((1, 0), bands, right.T, check_finite=False).T)


def _uneven(time: Array, y: Array, constant: float, first: Array) -> Array:
    """Filter on any clock, from its first value."""
    out = np.empty_like(y)
    out[:, 0] = first
    for j in range(1, y.shape[1]):
        h = max(float(time[j] - time[j - 1]), 0.0)
        ramp = (y[:, j] - y[:, j - 1]) / h if h > 0.0 else np.zeros(len(y))
        before = out[:, j - 1] - (y[:, j - 1] - constant * ramp)
        out[:, j] = y[:, j] - constant * ramp + before * np.exp(-h / constant)
    return out
