"""Fewer samples of curves, with a bound on what is lost."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

__all__ = ["extremes", "knots", "thin_outline"]


def knots(time: Array, values: Array, tolerance: float, most: int) -> Indices:
    """Samples between which straight lines come near all others.

    Splits every stretch where its error is largest (Ramer, Douglas and Peucker).

    Parameters
    ----------
    time
        (n,), growing.
    values
        (n, m), finite.
    tolerance
        Largest error of any column, unless ``most`` samples are not enough.
    most
        Largest number of samples to keep.

    Returns
    -------
    ndarray of int
        Growing; the first and the last sample are always kept.
    """
    n = len(time)
    if n <= 2:
        return np.arange(n)
    kept = np.array([0, n - 1])
    while len(kept) < most:
        # All stretches at once; the kept samples have no error and split nothing again.
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
    """Samples that keep the least and the largest value of each of ``most`` / 2 stretches."""
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
    """Fewer points of a plane curve; those left out lie within ``tolerance`` of what remains."""
    return np.asarray(points)[
        _corners(np.ascontiguousarray(points, dtype=float).tobytes(), tolerance)
    ]


@lru_cache(maxsize=1024)
def _corners(raw: bytes, tolerance: float) -> npt.NDArray[np.bool_]:
    """Which points remain; most outlines of a mechanism are those of the one before."""
    points = np.frombuffer(raw).reshape(-1, 2)
    n = len(points)
    kept = np.unique([0, n - 1])
    while len(kept) < n:
        # All stretches at once, as in knots; here distances in the plane count.
        stretch = np.repeat(np.arange(len(kept) - 1), np.diff(kept))
        ends = points[kept]
        d = np.diff(ends, axis=0)
        off, along = points[:-1] - ends[stretch], d[stretch]
        square = np.maximum(np.einsum("ij,ij->i", d, d), 1e-30)
        share = np.clip(np.einsum("ij,ij->i", off, along) / square[stretch], 0.0, 1.0)
        rest = off - share[:, None] * along
        away = np.hypot(rest[:, 0], rest[:, 1])
        worst = np.maximum.reduceat(away, kept[:-1])
        there = np.flatnonzero((away > tolerance) & (away == worst[stretch]))
        if len(there) == 0:
            break
        _, first = np.unique(stretch[there], return_index=True)
        kept = np.sort(np.append(kept, there[first]))
    keep = np.zeros(n, dtype=bool)
    keep[kept] = True
    return keep
