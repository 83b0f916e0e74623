"""Reduces the number of samples of curves, with a limited error."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


def knots(time: Array, values: Array, tolerance: float, most: int) -> Indices:
    """Indices of samples between which linear interpolation approximates all others.

    Every interval is split at its largest error (Ramer, Douglas and Peucker).

    Parameters
    ----------
    time
        Times, (n,), increasing.
    values
        Values, (n, m), finite.
    tolerance
        Largest error of any column; it may be larger if ``most`` samples are not sufficient.
    most
        Largest number of samples.

    Returns
    -------
    ndarray of int
        Increasing indices; the first and the last sample are always included.
    """
    n = len(time)
    if n <= 2:
        return np.arange(n)
    kept = np.array([0, n - 1])
    while len(kept) < most:
        # All intervals at once; selected samples have no error and do not split again.
        lines = np.column_stack(
            [np.interp(time, time[kept], values[kept, k]) for k in range(values.shape[1])]
        )
        away = np.abs(values - lines).max(axis=1)
        away[kept] = 0.0
        worst = np.maximum.reduceat(away, kept[:-1])
        stretch = np.repeat(np.arange(len(kept) - 1), np.diff(kept))
        there = np.flatnonzero((away[:-1] > tolerance) & (away[:-1] == worst[stretch]))
        _, first = np.unique(stretch[there], return_index=True)
        found = there[first]
        if len(found) == 0:
            break
        room = most - len(kept)
        if len(found) > room:
            found = found[np.argsort(-away[found], kind="stable")[:room]]
        kept = np.sort(np.append(kept, found))
    return np.asarray(kept)


def extremes(values: Array, most: int) -> Indices:
    """Indices of the smallest and the largest value of each of ``most`` / 2 intervals."""
    n = len(values)
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, max(1, most // 2) + 1).astype(int)
    found = {0, n - 1}
    for a, b in itertools.pairwise(edges):
        part = values[a:b]
        if np.any(np.isfinite(part)):
            found |= {int(a + np.nanargmin(part)), int(a + np.nanargmax(part))}
    return np.array(sorted(found))


def thin_outline(points: Array, tolerance: float) -> Array:
    """Fewer points of a plane curve; omitted points are within ``tolerance`` of the result."""
    return np.asarray(points)[
        _corners(np.ascontiguousarray(points, dtype=float).tobytes(), tolerance)
    ]


@lru_cache(maxsize=1024)
def _corners(raw: bytes, tolerance: float) -> npt.NDArray[np.bool_]:
    """Indices of the selected points; cached, because most outlines of a mechanism are repeated."""
    points = np.frombuffer(raw).reshape(-1, 2)
    n = len(points)
    kept = np.unique([0, n - 1])
    while len(kept) < n:
        # All intervals at once, as in knots, with distances in the plane.
        stretch = np.repeat(np.arange(len(kept) - 1), np.diff(kept))
        ends = points[kept]
        d = np.diff(ends, axis=0)
        off, along = points[:-1] - ends[stretch], d[stretch]
        square = np.maximum(np.einsum("ij,ij->i", d, d), 1e-30)
        share = np.clip(np.einsum("ij,ij->i", off, along) / square[stretch], 0.0, 1.0)
        rest = off - share[:, None] * along
        away = np.hypot(rest[:, 0], rest[:, 1])
        away[kept[:-1]] = 0.0  # with rounding of large numbers, it would be selected for ever
        worst = np.maximum.reduceat(away, kept[:-1])
        there = np.flatnonzero((away > tolerance) & (away == worst[stretch]))
        if len(there) == 0:
            break
        _, first = np.unique(stretch[there], return_index=True)
        kept = np.sort(np.append(kept, there[first]))
    keep = np.zeros(n, dtype=bool)
    keep[kept] = True
    return keep
