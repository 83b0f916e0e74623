"""What a mechanism holds at the end of a segment beside the states that are estimated.

The modes of strings, the states of laws, coordinates that follow statically, and the compressions
that felts remember: a segment that starts in the middle of a contact needs them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feltmb.adapters.variants import Variant
from feltmb.data import Array

__all__ = ["Remembered", "start_state"]


@dataclass(frozen=True, eq=False)
class Remembered:
    """Departures from rest at the end of a run, and the compressions that felts remember there."""

    named: Mapping[str, float]
    """Of coordinates, rates and states of laws, by name [their units]."""
    modes: Array
    """Of the modes of strings [m, m/s]."""
    compressions: tuple[float, ...]
    """By contact [m]."""

    @classmethod
    def of(cls, variant: Variant, result: Any) -> Remembered:
        """What a run of a version of the mechanism leaves behind."""
        departures = np.asarray(result.end_state) - variant.rest
        return cls(
            {name: float(departures[k]) for name, k in variant.place.items()},
            departures[len(variant.place) :],
            tuple(result.end_largest_compression),
        )

    def put(self, variant: Variant, full: Array) -> None:
        """Add to a full state at rest what is remembered, of the states that both have."""
        for name, k in variant.place.items():
            full[k] += self.named.get(name, 0.0)
        if self.modes.size == full.size - len(variant.place):
            full[len(variant.place) :] += self.modes


def start_state(
    variant: Variant, names: Sequence[str], departures: Array, held: Remembered | None
) -> tuple[Array, list[float]]:
    """Full state and remembered compressions at the start of a segment.

    Parameters
    ----------
    names, departures
        Estimated states and what they depart from rest [their units].
    held
        What the segment before left behind; None: all else is at rest.
    """
    full = variant.rest.copy()
    if held is not None:
        held.put(variant, full)
    for name, value in zip(names, departures, strict=True):
        k = variant.place.get(name)
        if k is not None:
            full[k] = variant.rest[k] + value
    return full, list(variant.memory if held is None else held.compressions)
