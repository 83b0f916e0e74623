"""Events that tracked points show: start and end of the key's motion, reversal of the hammer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from feltmb.data import Array
from feltmb.mechanism import Reading

__all__ = ["first_turn", "landmarks"]

#: Displacement above which a part counts as moving [m].
START = 1e-4
#: Share of its largest displacement that a part must reach, and lose again, before a reversal
#: counts.
REACHED, RETURNED = 0.5, 0.1
#: Width of the median filter that removes bad samples.
BAD = 5


def first_turn(time: Array, values: Array) -> float | None:
    """Time of the first reversal of a motion [s]; None: it hardly moves, or does not reverse.

    Parameters
    ----------
    time, values
        Times (n,) [s] and displacements from rest [m]; NaN is missing. One or two consecutive bad
        samples are ignored.
    """
    from scipy.ndimage import median_filter

    seen = np.isfinite(values)
    clock, travel = time[seen], median_filter(np.abs(values[seen]), BAD)
    if travel.size == 0 or np.max(travel) < 10 * START:
        return None
    far = float(np.max(travel))
    highest = np.maximum.accumulate(travel)
    back = (highest >= REACHED * far) & (travel < highest - RETURNED * far)
    if not np.any(back):
        return None
    return float(clock[np.argmax(travel[: int(np.argmax(back))])])


def landmarks(
    time: Array, outputs: Mapping[str, Array], reading: Reading
) -> list[tuple[str, float]]:
    """Names and times [s] of the events in the channels, sorted by time.

    Parameters
    ----------
    time
        Times (n,) [s].
    outputs
        Displacements from rest [m] by output name; NaN is missing.
    reading
        Names of the points of the key and of the hammer.
    """
    found: list[tuple[str, float]] = []
    key = outputs.get(f"{reading.key_point}.y")
    if key is not None and np.isfinite(key).sum() > 10:
        start = _crossing(time, -key, START)
        if start is not None:
            found.append(("key_start", start))
        lowest = np.nanmin(key)
        landing = _crossing(time, -key, -0.97 * lowest) if lowest < -10 * START else None
        if landing is not None:
            found.append(("key_landing", landing))
    striker = reading.striker
    hammer = None if striker is None else outputs.get(f"{striker.point}.{striker.axis}")
    if hammer is not None and np.isfinite(hammer).sum() > 10:
        start = _crossing(time, np.abs(hammer), START)
        if start is not None:
            found.append(("hammer_start", start))
        if np.nanmax(np.abs(hammer)) > 10 * START:
            turn = int(np.nanargmax(np.abs(hammer)))
            found.append(("hammer_turn", float(time[turn])))
    return sorted(found, key=lambda item: item[1])


def _crossing(time: Array, values: Array, level: float) -> float | None:
    """First time at which values rise through a level, by linear interpolation."""
    above = np.flatnonzero(values > level)
    if above.size == 0 or above[0] == 0:
        return None
    i = int(above[0])
    low, high = values[i - 1], values[i]
    if not np.isfinite(low):
        return float(time[i])
    return float(time[i - 1] + (time[i] - time[i - 1]) * (level - low) / (high - low))
