"""Time shifts of outputs, segment by segment."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from feltmb.data import Array, Record

__all__ = ["shifted"]

#: Number of samples of a neighbor that a segment uses in addition to the delay; a spline hardly
#: depends on samples farther away.
CONTEXT = 12
#: Largest number of samples for which a spline on a uniform clock is applied as a cached matrix;
#: the same delay is needed for many columns.
MATRIX = 400


def shifted(record: Record, y: Array, segments: NDArray[Any], delays: Array) -> Array:
    """Outputs as a sensor with a delay shows them: y(t - delay).

    Cubic splines within the segments. A segment also uses the neighbors in the list that share a
    sample with it. A neighbor is moved to the value of the segment at the common sample, so that a
    continuity defect makes no step. Without a neighbor, the signal is extrapolated by a parabola
    for one sample and linearly beyond.

    Parameters
    ----------
    y
        Outputs of the segments, (B, L, k) or (B, L).
    segments
        First and last sample, (B, 2).
    delays
        Delay of every segment [s], (B,).

    Returns
    -------
    Array
        Delayed outputs of the same shape; segments with values that are not finite are unchanged.
    """
    if not y.size or not np.any(delays):
        return y.copy()
    flat = y.reshape(y.shape[0], y.shape[1], -1).astype(np.float64)
    out = flat.copy()
    last = segments[:, 1] - segments[:, 0]
    inside = np.arange(y.shape[1]) <= last[:, None]
    whole = np.all(np.isfinite(flat) | ~inside[:, :, None], axis=(1, 2))
    # Number of samples of its neighbors that a segment uses.
    tied = np.zeros(len(last) + 1, dtype=bool)
    tied[1:-1] = segments[:-1, 1] == segments[1:, 0]
    tied[1:-1] &= (delays[:-1] == delays[1:]) & whole[:-1] & whole[1:]
    reach = CONTEXT + np.ceil(np.abs(delays) / record.interval).astype(np.intp)
    before = np.where(tied[:-1], np.minimum(reach, np.roll(last, 1)), 0)
    after = np.where(tied[1:], np.minimum(reach, np.roll(last, -1)), 0)
    first = before if record.even else segments[:, 0]

    # Segments of equal length on equal clocks have the same spline.
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
    """Matrix from the samples of a segment and its neighbors to the delayed samples."""
    size = before + end + 1 + after
    time = np.arange(size) * interval
    out: Array = _continued(time, np.eye(size)[None], time[before : before + end + 1] - delay)[0]
    out.setflags(write=False)
    return out


def _continued(time: NDArray[Any], values: Array, want: NDArray[Any]) -> Array:
    """Interpolated or extrapolated values (B, n, k) at other times."""
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
