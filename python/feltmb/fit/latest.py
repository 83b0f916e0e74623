"""The last few things that were made, by a key."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

__all__ = ["Latest"]

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Latest(Generic[K, V]):
    """Keeps what was asked for last; may be shared between threads.

    ``functools.lru_cache`` makes a value from its key alone, and counts values, not their sizes.

    Parameters
    ----------
    most
        What all values may have together; the last is kept in any case.
    size
        What one value has; default: 1.
    """

    def __init__(self, most: int, size: Callable[[V], int] = lambda _: 1):
        self._most = most
        self._size = size
        self._total = 0
        self._made: OrderedDict[K, V] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """How many are kept."""
        return len(self._made)

    def find(self, key: K) -> V | None:
        """What a key stands for; None where it is not kept."""
        with self._lock:
            if key not in self._made:
                return None
            self._made.move_to_end(key)
            return self._made[key]

    def keep(self, key: K, value: V) -> None:
        """Keep what a key stands for, in place of what it stood for; forget the oldest."""
        with self._lock:
            if key in self._made:
                self._total -= self._size(self._made.pop(key))
            self._made[key] = value
            self._total += self._size(value)
            while self._total > self._most and len(self._made) > 1:
                self._total -= self._size(self._made.popitem(last=False)[1])

    def get(self, key: K, make: Callable[[], V]) -> V:
        """What a key stands for, made where it is not kept.

        Two threads that request the same value at the same time may both compute it.
        """
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        made = make()
        self.keep(key, made)
        return made

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._made.clear()
            self._total = 0
