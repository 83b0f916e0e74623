"""Backlash of a drive: what arrives rests until the signal has crossed the play."""

from __future__ import annotations

from typing import Any

import numpy as np

from unmodeled.chain import Array, Fault, Run, Signal, register
from unmodeled.errors import InvalidParameter


class Backlash(Fault):
    """What arrives stays within size of the signal, and rests as long as it can (play operator).

    It begins with the first value of the signal.
    """

    name, unit, stated, drive = "backlash", "", False, True
    input = (
        "What arrives follows the input with a play, as a sticking valve or a worn linkage does.",
        "Remove the play, or model it.",
    )

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.array([self._followed(row, float(size))[0] for row in y])

    def by_size(self, run: Run, y: Array, size: float, shape: Any = None) -> Array:
        return np.array([self._followed(row, float(size))[1] for row in y])

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        last = self._followed(y[0], float(size))[2]
        return np.where(last < 0, 0.0, change[:, np.maximum(last, 0)])

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        raise InvalidParameter(f"{self.name} = {size:g}: what rests is lost, and is not removed")

    def _followed(self, values: Array, size: float) -> tuple[Array, Array, Array]:
        """What arrives, its derivative by the size, and the sample that moved it last; -1: none."""
        now, slope, last = float(values[0]), 0.0, -1
        out = []
        for k, v in enumerate(values.tolist()):
            if v - size > now or v + size < now or (size == 0.0 and v != now):
                slope = -1.0 if v > now else 1.0
                now, last = v + slope * size, k
            out.append((now, slope, last))
        arrived, slopes, moved = zip(*out, strict=True)
        return np.array(arrived), np.array(slopes), np.array(moved)

    def fields(self, signal: Signal) -> dict[str, Any]:
        return {"scale": 0.05 * float(np.std(signal.values) or 1.0), "sign": 1, "step": 1.0}


register(Backlash())
