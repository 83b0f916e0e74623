"""Numbers of a shape, such as a width or a time, that are fitted with the magnitude."""

from __future__ import annotations

import math
from typing import Any

from feltmb.fit.model import Effect

__all__ = ["movable", "moved", "spread_of"]

#: Standard deviation of the logarithm of a number of a shape, at least and at most.
NARROW, WIDE = 0.35, 1.2


def movable(effect: Effect) -> tuple[int, ...]:
    """Indices of the numbers of a shape that may take any value: (0,) if the shape is one number.

    These are floats on one side of ``effect.shape_zero``, of which the list has two or more values.
    Integers, zeros, texts and constants are not fitted.
    """
    rows = [s if isinstance(s, tuple) else (s,) for s in effect.shapes]
    if len({len(r) for r in rows}) != 1:
        return ()
    zero = effect.shape_zero
    found = []
    for k, column in enumerate(zip(*rows, strict=True)):
        if not all(isinstance(v, float) and 0.0 < abs(v - zero) < math.inf for v in column):
            continue
        if len(set(column)) > 1 and len({math.copysign(1.0, v - zero) for v in column}) == 1:
            found.append(k)
    return tuple(found)


def spread_of(effect: Effect, place: int) -> float:
    """Standard deviation of the prior of the logarithm of one number of a shape [1].

    It is half of the range of the listed values.
    """
    rows = [s if isinstance(s, tuple) else (s,) for s in effect.shapes]
    logs = [math.log(abs(r[place] - effect.shape_zero)) for r in rows]
    return min(max(0.5 * (max(logs) - min(logs)), NARROW), WIDE)


def moved(effect: Effect, shape: Any, steps: dict[int, float]) -> Any:
    """The shape with some of its numbers multiplied by exp(step), counted from ``shape_zero``."""
    if not steps:
        return shape
    zero = effect.shape_zero
    row = list(shape) if isinstance(shape, tuple) else [shape]
    for place, step in steps.items():
        row[place] = zero + (row[place] - zero) * math.exp(step)
    return tuple(row) if isinstance(shape, tuple) else row[0]
