"""Events that tracked points show by themselves: key start, key landing, turn of the hammer."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from feltmb.data import Array
from feltmb.mechanism import Reading

__all__ = ["first_turn", "landmarks"]

#: Travel at which a part counts as moving [m].
START = 1e-4
#: Share of its largest travel that a part has to reach, and to give back, before its turn counts.
REACHED, RETURNED = 0.5, 0.1
#: Width of the median that takes bad samples away.
BAD = 5


def first_turn(time: Array, values: Array) -> float | None:
    """When a part first turns back from where it went [s]; None: it hardly moves, or never does.

    Parameters
    ----------
    time, values
        (n,) [s] and displacement from rest [m]; NaN is missing. One or two bad samples in a row
        are passed over.
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
    """Names and times [s] of what the channels show, in order of time.

    Parameters
    ----------
    time
        (n,) [s]
    outputs
        Displacements from rest [m] by output name; NaN is missing.
    reading
        Which points are the key and what strikes.
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
    """First time at which values rise through a level, by straight lines between samples."""
    above = np.flatnonzero(values > level)
    if above.size == 0 or above[0] == 0:
        return None
    i = int(above[0])
    low, high = values[i - 1], values[i]
    if not np.isfinite(low):
        return float(time[i])
    return float(time[i - 1] + (time[i] - time[i - 1]) * (level - low) / (high - low))
