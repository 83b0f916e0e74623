"""Time shifts of outputs."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from feltmb.data import Array, Record

__all__ = ["delayed", "shifted"]

#: Largest number of samples for which a spline on a uniform clock is applied as a cached matrix;
#: the same delay is needed for many columns.
MATRIX = 400


def shifted(record: Record, y: Array, delays: Array) -> Array:
    """Outputs as a sensor with a delay shows them: y(t - delay), by cubic splines.

    Before the first and after the last sample, the signal is extrapolated by a parabola for one
    sample and linearly beyond.

    Parameters
    ----------
    record
        Record with the times of the samples.
    y
        Outputs, (B, n).
    delays
        Delays [s], (B,).

    Returns
    -------
    Array
        Delayed outputs, (B, n); rows with values that are not finite are unchanged.
    """
    out: Array = np.array(y, dtype=np.float64)
    good = np.all(np.isfinite(out), axis=1)
    n, interval, time = y.shape[1], record.interval, _times(record, y.shape[1])
    for delay in np.unique(delays[good & (delays != 0.0)]):
        rows = np.flatnonzero(good & (delays == delay))
        if record.even and n <= MATRIX:
            out[rows] = out[rows] @ _matrix(n, interval, float(delay)).T
        else:
            out[rows] = _continued(time, out[rows, :, None], time - delay)[:, :, 0]
    return out


def delayed(record: Record, y: Array, delay: float) -> Array:
    """As :func:`shifted` for outputs (n, ...) with one delay, which is needed only once.

    Parameters
    ----------
    record
        Record with the times of the samples.
    y
        Outputs, (n, ...).
    delay
        Delay [s].
    """
    if delay == 0.0 or not np.isfinite(y).all():
        return y
    time = _times(record, len(y))
    found = _continued(time, y.reshape(1, len(y), -1), time - delay)
    return np.asarray(found.reshape(y.shape))


def _times(record: Record, count: int) -> Array:
    """The times of the first samples."""
    return np.asarray(np.arange(count) * record.interval if record.even else record.time[:count])


@lru_cache(maxsize=128)
def _matrix(count: int, interval: float, delay: float) -> Array:
    """Matrix from the samples to the delayed samples."""
    time: Array = np.asarray(np.arange(count) * interval)
    out: Array = _continued(time, np.eye(count)[None], time - delay)[0]
    out.setflags(write=False)
    return out


def _continued(time: Array, values: Array, want: Array) -> Array:
    """Interpolated or extrapolated values (B, n, k) at other times."""
    if time.size < 2:
        return np.repeat(values, want.size, axis=1)
    from scipy.interpolate import CubicSpline

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
