"""Greedy placement of labels without overlaps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

Point = tuple[float, float]

#: Places on a leader, from the anchor to the label, that should not lie in other labels.
ALONG = tuple(float(t) for t in np.linspace(0.15, 1.0, 7))


def _label_candidates() -> list[tuple[float, float]]:
    """Offsets of a label in multiples of its height, small ones first."""
    out = []
    for radius in (1.3, 1.9, 2.6, 3.5, 4.6, 6.0, 8.0):
        for k in range(16):
            angle = math.pi * (0.25 + k / 8.0)
            out.append((radius * math.cos(angle), radius * math.sin(angle)))
    return out


class Labels:
    """Greedy placement of labels in pixels, without overlaps with labels and obstacles."""

    def __init__(self, obstacles: Array, bounds: tuple[float, float, float, float]):
        self.obstacles = obstacles
        self.bounds = bounds
        self.boxes: list[tuple[float, float, float, float]] = []
        self.leaders: list[tuple[Point, Point]] = []

    def place(
        self, anchors: Array, width: float, height: float, unit: float
    ) -> tuple[Array, Array]:
        """Anchor and center of a label; all anchors are equally good."""
        start = float(anchors[0][0]), float(anchors[0][1])
        best, best_cost = (start, start), math.inf
        for x, y in anchors:
            at = float(x), float(y)
            for dx, dy in _label_candidates():
                # Wide labels are moved sideways by half of their width.
                stretch = 0.5 * (width - height) * np.sign(dx) * min(1.0, abs(dx / (dy or 1e-9)))
                center = at[0] + (dx * unit + float(stretch)), at[1] + dy * unit
                cost = self._cost(at, center, width, height, math.hypot(dx, dy), best_cost)
                if cost < best_cost:
                    best, best_cost = (at, center), cost
        self.boxes.append((*best[1], width, height))
        self.leaders.append(best)
        return np.array(best[0]), np.array(best[1])

    def _cost(
        self, at: Point, center: Point, width: float, height: float, away: float, limit: float
    ) -> float:
        """Cost of a place; no more is added once it is above ``limit``."""
        x0, y0, x1, y1 = self.bounds
        w, h = 0.5 * width + 2.0, 0.5 * height + 2.0
        cost = 1.2 * away
        if not (x0 + w < center[0] < x1 - w and y0 + h < center[1] < y1 - h):
            cost += 500.0
        for bx, by, bw, bh in self.boxes:
            over_x = w + 0.5 * bw - abs(center[0] - bx)
            over_y = h + 0.5 * bh - abs(center[1] - by)
            if over_x > 0 and over_y > 0:
                cost += 200.0 + min(over_x, over_y)
        if cost >= limit:
            return cost
        for t in ALONG:
            px, py = at[0] + t * (center[0] - at[0]), at[1] + t * (center[1] - at[1])
            for bx, by, bw, bh in self.boxes:
                if abs(px - bx) < 0.5 * bw + 1 and abs(py - by) < 0.5 * bh + 1:
                    cost += 30.0
        for a, b in self.leaders:
            if _cross(at, center, a, b):
                cost += 25.0
        if cost >= limit:
            return cost
        inside = (np.abs(self.obstacles[:, 0] - center[0]) < w) & (
            np.abs(self.obstacles[:, 1] - center[1]) < h
        )
        return cost + 1.5 * min(float(np.count_nonzero(inside)), 24.0)


def _cross(a: Point, b: Point, c: Point, d: Point) -> bool:
    def side(p: Point, q: Point, r: Point) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0
