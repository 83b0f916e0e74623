"""Points of curves and outlines of plane figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def arc_points(center: Array, radius: float, low: float, high: float) -> Array:
    """Points of an arc; the polygon differs from it by less than 1 um."""
    step = 2.0 * math.acos(max(0.0, 1.0 - 1e-6 / max(radius, 2e-6)))
    count = max(9, math.ceil(abs(high - low) / step) + 1)
    angle = np.linspace(low, high, count)
    return center + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def wrap_angle(angle: float, about: float) -> float:
    """The same angle [rad], within pi of ``about``."""
    return about + math.remainder(angle - about, 2.0 * math.pi)


def capsule(a: Array, ra: float, b: Array, rb: float) -> Array:
    """Outline of the convex hull of two discs."""
    return _capsule(float(a[0]), float(a[1]), float(ra), float(b[0]), float(b[1]), float(rb))


@lru_cache(maxsize=1024)
def _capsule(ax: float, ay: float, ra: float, bx: float, by: float, rb: float) -> Array:
    """Cached, because most capsules of a mechanism are repeated; the result must not be changed."""
    out = _hull(np.array([ax, ay]), ra, np.array([bx, by]), rb)
    out.flags.writeable = False
    return out


def _hull(a: Array, ra: float, b: Array, rb: float) -> Array:
    d = b - a
    length = float(np.hypot(*d))
    if length <= abs(ra - rb) + 1e-12:
        center, radius = (a, ra) if ra >= rb else (b, rb)
        angle = np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False)
        return center + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    along = math.atan2(d[1], d[0])
    half = math.acos((ra - rb) / length)
    first = np.linspace(along + half, along + 2.0 * math.pi - half, 24)
    second = np.linspace(along - half, along + half, 24)
    return np.vstack(
        [
            a + ra * np.column_stack([np.cos(first), np.sin(first)]),
            b + rb * np.column_stack([np.cos(second), np.sin(second)]),
        ]
    )


def dense_outline(outline: Array, step: float) -> Array:
    """Closed outline with a largest point distance of ``step``, so that it can be bent."""
    way = np.diff(np.vstack([outline, outline[:1]]), axis=0)
    count = np.maximum(1, np.ceil(np.hypot(way[:, 0], way[:, 1]) / step)).astype(int)
    side = np.repeat(np.arange(len(way)), count)
    number = np.arange(len(side)) - np.repeat(np.cumsum(count) - count, count)
    out: Array = outline[side] + (number * (1.0 / count[side]))[:, None] * way[side]
    return out


def round_box(low: Array, high: Array, radius: float) -> Array:
    """Rectangle with rounded corners."""
    corners = []
    for x, y, start in (
        (high[0], high[1], 0.0),
        (low[0], high[1], 0.5),
        (low[0], low[1], 1.0),
        (high[0], low[1], 1.5),
    ):
        angle = np.linspace(start, start + 0.5, 7) * math.pi
        sx, sy = (1.0 if x == high[0] else -1.0), (1.0 if y == high[1] else -1.0)
        center = np.array([x - sx * radius, y - sy * radius])
        corners.append(center + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.vstack(corners)


def shortest_tree(points: Sequence[Array], first: int) -> list[tuple[int, int]]:
    """Edges of the shortest tree through the points that includes the edge from 0 to ``first``."""
    if len(points) < 2:
        return []
    inside, edges = {0, first}, [(0, first)]
    while len(inside) < len(points):
        a, b = min(
            ((i, j) for i in inside for j in range(len(points)) if j not in inside),
            key=lambda e: float(np.hypot(*(points[e[0]] - points[e[1]]))),
        )
        edges.append((a, b))
        inside.add(b)
    return edges


def spiral(radius: float) -> Array:
    """Points of the symbol of a torsion spring around the origin [m]."""
    angle = np.linspace(0.0, 5.0 * math.pi, 90)
    r = radius * (0.45 + 0.55 * angle / angle[-1])
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])
