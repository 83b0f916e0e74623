"""Numbers of a shape, such as a width or a time, that are fitted with the magnitude."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from feltmb.data import Array, Record
from feltmb.fit.model import Candidate, Effect

__all__ = ["by_number", "movable", "moved", "spread_of"]

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


def by_number(candidate: Candidate, place: int, magnitude: float) -> Candidate | None:
    """An effect whose magnitude is the logarithm of one number of a shape, over its spread.

    Its derivative at zero is the derivative by this unknown. None: the derivative needs differences
    of simulations.
    """
    effect, shape, spread = candidate.effect, candidate.shape, spread_of(candidate.effect, place)
    step = 0.02 / spread
    own = [h.name for h in effect.hidden]

    def at(value: Any) -> Any:
        return moved(effect, shape, {place: value * spread})

    if (rate := effect.rate) is not None:
        # Each side of the difference has its own copy of the hidden states.
        copies = [{n: f"{n} at {place} {side} of {effect.name}" for n in own} for side in "+-"]

        def change(t: Any, x: Any, u: Any, p: Any, value: Any, _: Any) -> Mapping[str, Any]:
            total: dict[str, Any] = {}
            for sign, names in zip((1.0, -1.0), copies, strict=True):
                seen = _Renamed(x, names) if names else x
                found = rate(t, seen, u, p, 0.0 * value + magnitude, at(sign * step))
                for state, v in found.items():
                    if state in names:
                        total[names[state]] = v
                    else:
                        total[state] = total.get(state, 0.0) + sign * value * v / (2.0 * step)
            return total

        hidden = tuple(replace(h, name=names[h.name]) for names in copies for h in effect.hidden)
        return Candidate(_plain(effect, rate=change, hidden=hidden))
    if (regressor := effect.regressor) is not None:

        def column(record: Record, _: Any) -> Array:
            up, down = (regressor(record, at(sign * step)) for sign in (1.0, -1.0))
            return magnitude * (up - down) / (2.0 * step)

        return Candidate(_plain(effect, regressor=column))
    return None


class _Renamed:
    """Values by name, some of which have another name."""

    def __init__(self, values: Any, names: Mapping[str, str]):
        self._all, self._names = values, names

    def __getitem__(self, name: str) -> Any:
        return self._all[self._names.get(name, name)]

    __getattr__ = __getitem__


def _plain(effect: Effect, **function: Any) -> Effect:
    """An effect of any sign with a scale of 1, and with another function."""
    return replace(
        effect,
        name=f"{effect.name}, shape",
        scale=1.0,
        sign=0,
        lower=-math.inf,
        upper=math.inf,
        shapes=(None,),
        shape_names=(),
        tolerance_parameter="",
        **function,
    )
