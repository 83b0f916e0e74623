"""State of a mechanism at the end of a segment, apart from the estimated states.

It contains the modes of strings, the states of laws, static coordinates, and the compressions that
felts remember. A segment that starts during a contact needs them.
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
    """Deviations from rest at the end of a run, and the compressions that felts remember."""

    named: Mapping[str, float]
    """Deviations of coordinates, rates and states of laws, by name [their units]."""
    modes: Array
    """Deviations of the modes of strings [m, m/s]."""
    compressions: tuple[float, ...]
    """Remembered compressions by contact [m]."""

    @classmethod
    def of(cls, variant: Variant, result: Any) -> Remembered:
        """State at the end of a run of a version of the mechanism."""
        departures = np.asarray(result.end_state) - variant.rest
        return cls(
            {name: float(departures[k]) for name, k in variant.place.items()},
            departures[len(variant.place) :],
            tuple(result.end_largest_compression),
        )

    def put(self, variant: Variant, full: Array) -> None:
        """Add the remembered deviations to a full state at rest, for the states that both have."""
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
        Names of the estimated states, and their deviations from rest [their units].
    held
        State at the end of the previous segment; None: all other states are at rest.
    """
    full = variant.rest.copy()
    if held is not None:
        held.put(variant, full)
    for name, value in zip(names, departures, strict=True):
        k = variant.place.get(name)
        if k is not None:
            full[k] = variant.rest[k] + value
    return full, list(variant.memory if held is None else held.compressions)
