"""Outputs seen earlier or later, window by window."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from feltmb.data import Array, Record

__all__ = ["shifted"]

#: Samples of a neighbor that a window takes along beyond the lag: a spline forgets what is farther.
CONTEXT = 12


def shifted(record: Record, y: Array, windows: NDArray[Any], delays: Array) -> Array:
    """Outputs as a sensor that lags shows them: y(t - delay).

    Cubic splines within the windows. A window sees into those before and after it that share a
    sample with it and follow in the list: it goes on as they do, from its own value at the seam, so
    that a gap between them makes no step. Elsewhere, and beyond the neighbor, the motion goes on as
    a parabola for one sample and straight from there.

    Parameters
    ----------
    y
        Outputs of the windows, (B, L, k) or (B, L).
    windows
        First and last sample, (B, 2).
    delays
        Lag of every window [s], (B,).

    Returns
    -------
    Array
        The same shape; windows with a value that is not a number stay as they are.
    """
    if not y.size or not np.any(delays):
        return y.copy()
    flat = y.reshape(y.shape[0], y.shape[1], -1).astype(np.float64)
    out = flat.copy()
    last = windows[:, 1] - windows[:, 0]
    whole = [bool(np.all(np.isfinite(flat[b, : n + 1]))) for b, n in enumerate(last)]
    uniform = np.allclose(np.diff(record.time), record.interval, rtol=1e-6, atol=0.0)

    def seen(b: int, own: int) -> int:
        """Samples that window ``own`` sees of its neighbor b."""
        if not 0 <= b < len(last) or not whole[b] or delays[b] != delays[own]:
            return 0
        first, second = min(b, own), max(b, own)
        if windows[first, 1] != windows[second, 0]:
            return 0
        reach = CONTEXT + int(np.ceil(abs(delays[own]) / record.interval))
        return int(min(reach, last[b]))

    # Windows of one length on one clock are one spline.
    groups: dict[tuple[int, int, int, int, float], list[int]] = {}
    for b, delay in enumerate(delays):
        if delay != 0.0 and whole[b]:
            before, after = seen(b - 1, b), seen(b + 1, b)
            first = before if uniform else int(windows[b, 0])
            groups.setdefault((int(last[b]), before, after, first, float(delay)), []).append(b)
    for (end, before, after, first, delay), group in groups.items():
        lanes = np.array(group)
        parts = [flat[lanes, : end + 1]]
        if before:
            at = last[lanes - 1][:, None] - before + np.arange(before)
            step = flat[lanes, 0] - flat[lanes - 1, last[lanes - 1]]
            parts.insert(0, flat[lanes[:, None] - 1, at] + step[:, None])
        if after:
            step = flat[lanes, end] - flat[lanes + 1, 0]
            parts.append(flat[lanes + 1, 1 : after + 1] + step[:, None])
        span = np.arange(first - before, first + end + after + 1)
        time = span * record.interval if uniform else record.time[span]
        want = time[before : before + end + 1] - delay
        out[lanes, : end + 1] = _continued(time, np.concatenate(parts, axis=1), want)
    return out.reshape(y.shape)


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
