"""Counters and angles that wrap: found by their jumps."""

from __future__ import annotations

import math

import numpy as np

from unmodeled.chain.scales import unwrapped
from unmodeled.data.records import Array

#: Periods of counters with a number of bits.
_COUNTERS = {float(2**bits): f"a counter of {bits} bits" for bits in (8, 10, 12, 14, 16, 24, 32)}
#: Periods of angles, in the units of a record.
_ANGLES = {360.0: "an angle in degrees", 2.0 * math.pi: "an angle", math.pi: "an axis without sign"}
#: Smallest range of the values, and largest one, in periods.
_FILLED, _BEYOND = 0.9, 1.001
#: Number of equal parts of the range, and the smallest share of them that holds values: a signal
#: with a few levels does not wrap.
_LEVELS, _USED = 16, 0.6
#: Largest share of the steps that are jumps; steps without them, in periods; and the step in place
#: of a jump, in steps beside it.
_MOST, _SMOOTH, _LIKE = 0.2, 0.3, 1.5


def wrap_of(values: Array, unit: str = "1") -> tuple[float, str] | None:
    """Period of a counter or an angle that wraps [unit], and words; None: it is neither.

    The values fill one period of a usual size, and jump from one end to the other while they move
    on beyond it.
    """
    values = values[np.isfinite(values)]
    if values.size < 8:
        return None
    low, high, steps = float(values.min()), float(values.max()), np.diff(values)
    for period, words in (_COUNTERS | _ANGLES).items():
        if not _FILLED * period <= high - low <= _BEYOND * period:
            continue
        if period in (2.0 * math.pi, math.pi) and unit != "rad":
            continue
        spare = (_BEYOND - 1.0) * period
        if not any(low > b - spare and high < b + period + spare for b in (-0.5 * period, 0.0)):
            continue
        jump = np.flatnonzero(np.abs(steps) > 0.5 * period)
        smooth = np.diff(unwrapped(values, period))
        used = np.unique(((values - low) / (high - low) * _LEVELS).astype(int).clip(0, _LEVELS - 1))
        scatter = 3.0 * float(np.median(np.abs(np.diff(smooth))))
        near = np.pad(np.abs(smooth), 1, mode="edge")
        beside = np.maximum(near[:-2], near[2:])[jump]
        steady = np.abs(smooth[jump]) <= _LIKE * beside + scatter
        if (
            0 < jump.size <= _MOST * steps.size
            and np.max(np.abs(smooth)) < _SMOOTH * period
            and used.size >= _USED * _LEVELS
            and steady.all()
        ):
            return period, words
    return None
