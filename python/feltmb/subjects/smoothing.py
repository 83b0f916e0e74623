"""Smoothed motion of records, kept: a diagnosis asks for each of them thousands of times."""

from __future__ import annotations

import threading
from collections import OrderedDict

from feltmb.data import Array
from feltmb.smoothing import LEAST_SAMPLES, smooth_record

__all__ = ["Smoother"]

#: Smoothed signals that are kept.
KEPT = 256


class Smoother:
    """:func:`feltmb.smoothing.smooth_record` that remembers; may be shared between threads."""

    def __init__(self) -> None:
        self._made: OrderedDict[tuple[bytes, bytes, float], Array] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, time: Array, value: Array, noise: float) -> Array:
        """The smoothed signal; as it is where there are too few samples."""
        if value.size < LEAST_SAMPLES:
            return value
        key = (time.tobytes(), value.tobytes(), noise)
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        made = smooth_record(time, value, noise)
        with self._lock:
            self._made[key] = made
            while len(self._made) > KEPT:
                self._made.popitem(last=False)
        return made
