"""First-order low-pass of signals that are linear between samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from feltmb.data import Array
from feltmb.data.records import evenly_spaced

__all__ = ["low_passed"]


def low_passed(
    clock: Array,
    y: Array,
    segments: NDArray[Any],
    constants: Array,
    starts: Array | None = None,
) -> Array:
    """Outputs as a sensor with a first-order lag shows them: constant * d(out)/dt = y - out.

    The filter of a segment starts with a given value. Otherwise, if the segment starts at the last
    sample of the segment before it in the list, it continues with the filter state of that segment.
    Any other segment starts as if the signal always had its first slope.

    Parameters
    ----------
    clock
        Times of the samples [s], (n,).
    y
        Outputs of the segments, (B, L).
    segments
        First and last sample, (B, 2).
    constants
        Time constant of every segment [s], (B,), >= 0; 0: the output is unchanged.
    starts
        First value of each segment's filter [unit of y], (B,); NaN: not given.

    Returns
    -------
    Array
        Filtered outputs, (B, L).
    """
    out = np.array(y, dtype=np.float64)
    if y.shape[1] < 2:
        return out
    at = np.minimum(segments[:, :1] + np.arange(y.shape[1]), clock.size - 1)
    time = np.asarray(clock[at])
    filtered = _even if evenly_spaced(clock) else _uneven
    for constant in np.unique(constants[constants > 0.0]):
        rows = np.flatnonzero(constants == constant)
        step = time[rows, 1] - time[rows, 0]
        first = y[rows, 0] - constant * (y[rows, 1] - y[rows, 0]) / np.maximum(step, 1e-300)
        out[rows] = filtered(time[rows], y[rows], constant, first)
    for b in np.flatnonzero(constants > 0.0):
        if starts is not None and np.isfinite(starts[b]):
            start = starts[b]
        elif b > 0 and segments[b - 1, 1] == segments[b, 0]:
            end = segments[b - 1, 1] - segments[b - 1, 0]
            start = y[b, 0] + out[b - 1, end] - y[b - 1, end]
        else:
            continue
        if np.isfinite(start):
            # What remains of a change of the first filter state.
            out[b] += (start - out[b, 0]) * np.exp(-(time[b] - time[b, 0]) / constants[b])
    return out


def _even(time: Array, y: Array, constant: float, first: Array) -> Array:
    """Filter on an even clock, from its first value."""
    step = float(time[0, 1] - time[0, 0])
    decay, share = np.exp(-step / constant), constant / step
    new = 1.0 + share * np.expm1(-step / constant)
    old = -np.expm1(-step / constant) - new
    start = (first - new * y[:, 0])[:, None]
    return np.asarray(lfilter([new, old], [1.0, -decay], y, axis=1, zi=start)[0])


def _uneven(time: Array, y: Array, constant: float, first: Array) -> Array:
    """Filter on any clock, from its first value."""
    out = np.empty_like(y)
    out[:, 0] = first
    for j in range(1, y.shape[1]):
        h = np.maximum(time[:, j] - time[:, j - 1], 0.0)
        ramp = np.divide(y[:, j] - y[:, j - 1], h, out=np.zeros_like(h), where=h > 0.0)
        before = out[:, j - 1] - (y[:, j - 1] - constant * ramp)
        out[:, j] = y[:, j] - constant * ramp + before * np.exp(-h / constant)
    return out
