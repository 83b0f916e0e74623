"""Outputs seen earlier or later, segment by segment."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from feltmb.data import Array, Record

__all__ = ["shifted"]

#: Samples of a neighbor that a segment takes along beyond the lag: a spline forgets what is
#: farther.
CONTEXT = 12
#: Samples up to which a spline on an even clock is applied as a matrix, which is kept: the same lag
#: is asked for column by column.
MATRIX = 400


def shifted(record: Record, y: Array, segments: NDArray[Any], delays: Array) -> Array:
    """Outputs as a sensor that lags shows them: y(t - delay).

    Cubic splines within the segments. A segment sees into those before and after it that share a
    sample with it and follow in the list: it goes on as they do, from its own value at the seam, so
    that a gap between them makes no step. Elsewhere, and beyond the neighbor, the motion goes on as
    a parabola for one sample and straight from there.

    Parameters
    ----------
    y
        Outputs of the segments, (B, L, k) or (B, L).
    segments
        First and last sample, (B, 2).
    delays
        Lag of every segment [s], (B,).

    Returns
    -------
    Array
        The same shape; segments with a value that is not a number stay as they are.
    """
    if not y.size or not np.any(delays):
        return y.copy()
    flat = y.reshape(y.shape[0], y.shape[1], -1).astype(np.float64)
    out = flat.copy()
    last = segments[:, 1] - segments[:, 0]
    inside = np.arange(y.shape[1]) <= last[:, None]
    whole = np.all(np.isfinite(flat) | ~inside[:, :, None], axis=(1, 2))
    # How many samples of its neighbors a segment sees.
    tied = np.zeros(len(last) + 1, dtype=bool)
    tied[1:-1] = segments[:-1, 1] == segments[1:, 0]
    tied[1:-1] &= (delays[:-1] == delays[1:]) & whole[:-1] & whole[1:]
    reach = CONTEXT + np.ceil(np.abs(delays) / record.interval).astype(np.intp)
    before = np.where(tied[:-1], np.minimum(reach, np.roll(last, 1)), 0)
    after = np.where(tied[1:], np.minimum(reach, np.roll(last, -1)), 0)
    first = before if record.even else segments[:, 0]

    # Segments of one length on one clock are one spline.
    groups: dict[tuple[int, int, int, int, float], list[int]] = {}
    keys = zip(*(v.tolist() for v in (last, before, after, first, delays)), strict=True)
    for b, key in enumerate(keys):
        if key[-1] != 0.0 and whole[b]:
            groups.setdefault(key, []).append(b)
    for (end, ahead, behind, begin, delay), group in groups.items():
        jobs = np.array(group)
        parts = [flat[jobs, : end + 1]]
        if ahead:
            at = last[jobs - 1][:, None] - ahead + np.arange(ahead)
            step = flat[jobs, 0] - flat[jobs - 1, last[jobs - 1]]
            parts.insert(0, flat[jobs[:, None] - 1, at] + step[:, None])
        if behind:
            step = flat[jobs, end] - flat[jobs + 1, 0]
            parts.append(flat[jobs + 1, 1 : behind + 1] + step[:, None])
        values = np.concatenate(parts, axis=1)
        span = np.arange(begin - ahead, begin + end + behind + 1)
        if record.even and span.size <= MATRIX:
            matrix = _matrix(ahead, end, behind, record.interval, delay)
            out[jobs, : end + 1] = np.moveaxis(np.tensordot(values, matrix, (1, 1)), 1, 2)
            continue
        time = span * record.interval if record.even else record.time[span]
        want = time[ahead : ahead + end + 1] - delay
        out[jobs, : end + 1] = _continued(time, values, want)
    return out.reshape(y.shape)


@lru_cache(maxsize=128)
def _matrix(before: int, end: int, after: int, interval: float, delay: float) -> Array:
    """What takes samples of a segment and its neighbors to the delayed ones of the segment."""
    size = before + end + 1 + after
    time = np.arange(size) * interval
    out: Array = _continued(time, np.eye(size)[None], time[before : before + end + 1] - delay)[0]
    out.setflags(write=False)
    return out


def _continued(time: NDArray[Any], values: Array, want: NDArray[Any]) -> Array:
    """Values (B, n, k) at other times."""
    if time.size < 2:
        return np.repeat(values, want.size, axis=1)
    spline = CubicSpline(time, values, axis=1)
    out = np.asarray(spline(np.clip(want, time[0], time[-1])))
    for end, beyond in ((time[0], want - time[0]), (time[-1], want - time[-1])):
        over = np.minimum(beyond, 0.0) if end == time[0] else np.maximum(beyond, 0.0)
        if not np.any(over):
            continue
        step = abs(time[1] - time[0]) if end == time[0] else abs(time[-1] - time[-2])
        bent = np.clip(over, -step, step)
        rate, bend = (np.asarray(spline(end, n))[:, None, :] for n in (1, 2))
        straight = over[None, :, None]
        curved = (bent * over - 0.5 * bent**2)[None, :, None]
        out = out + rate * straight + bend * curved
    return np.asarray(out)
