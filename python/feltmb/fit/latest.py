"""Cache of the most recently used values by key."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

__all__ = ["Latest"]

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Latest(Generic[K, V]):
    """A cache of recently used values that several threads may use.

    Unlike ``functools.lru_cache``, it can limit the sum of the sizes of the values, and a value
    need not be computed from its key alone.

    Parameters
    ----------
    most
        Largest sum of the sizes of all values; the last value is kept in any case.
    size
        Function that gives the size of a value; default: 1.
    """

    def __init__(self, most: int, size: Callable[[V], int] = lambda _: 1):
        self._most = most
        self._size = size
        self._total = 0
        self._made: OrderedDict[K, V] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Number of stored values."""
        return len(self._made)

    def find(self, key: K) -> V | None:
        """Value of a key; None if it is not stored."""
        with self._lock:
            if key not in self._made:
                return None
            self._made.move_to_end(key)
            return self._made[key]

    def keep(self, key: K, value: V) -> None:
        """Store a value, replacing an older value of the key; remove the oldest values."""
        with self._lock:
            if key in self._made:
                self._total -= self._size(self._made.pop(key))
            self._made[key] = value
            self._total += self._size(value)
            while self._total > self._most and len(self._made) > 1:
                self._total -= self._size(self._made.popitem(last=False)[1])

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Value of a key; it is computed if it is not stored.

        Two threads that request the same value at the same time may both compute it.
        """
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        made = make()
        self.keep(key, made)
        return made
