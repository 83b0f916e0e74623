"""Effects that change the same values of a mechanism as a tolerance, in the same direction.

Example: a let-off button that is 0.2 mm from its tabulated position is within the regulation; at
1.5 mm it is a cause. To first order, both are the same direction, and only the magnitude separates
them. The derivative of such an effect is therefore computed from the derivative of the tolerance.
Separate finite differences would differ by nonlinear terms, which would look like a signature of
the effect alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from feltmb.adapters.changes import read_entry
from feltmb.adapters.library import Entry
from feltmb.mechanism import MechanismFile

__all__ = ["Alias", "alias_of"]

#: Largest relative difference of the ratios of two equal directions.
SAME = 1e-9


@dataclass(frozen=True)
class Alias:
    """An effect and the tolerance that changes the same values."""

    index: int
    """Index of the tolerance."""
    tolerance: Entry
    effect: Entry
    config: MechanismFile

    def ratio(self, departure: float, magnitude: float) -> float:
        """Derivative by the effect divided by the derivative by the tolerance, at given values."""
        by_effect = _slopes(self.config, self.effect, magnitude, self.tolerance, departure)
        by_tolerance = _slopes(self.config, self.tolerance, departure, self.effect, magnitude)
        path = max(by_tolerance, key=lambda p: abs(by_tolerance[p]))
        return by_effect[path] / by_tolerance[path]


def alias_of(config: MechanismFile, effect: Entry, tolerances: Sequence[Entry]) -> Alias | None:
    """Tolerance that changes the same values as an effect; None: there is none.

    Parameters
    ----------
    config
        The mechanism.
    effect
        An entry of its library.
    tolerances
        Tolerances that are estimated.
    """
    if not _plain(effect):
        return None
    for i, tolerance in enumerate(tolerances):
        paths = {c.path for c in effect.changes}
        if not _plain(tolerance) or paths != {c.path for c in tolerance.changes}:
            continue
        ours = _slopes(config, effect, 0.0, tolerance, 0.0)
        theirs = _slopes(config, tolerance, 0.0, effect, 0.0)
        moved = [p for p in ours if ours[p] != 0.0 or theirs[p] != 0.0]
        if not moved or any(theirs[p] == 0.0 for p in moved):
            continue
        ratios = [ours[p] / theirs[p] for p in moved]
        if max(ratios) - min(ratios) <= SAME * max(abs(r) for r in ratios) and ratios[0] != 0.0:
            return Alias(i, tolerance, effect, config)
    return None


def _plain(entry: Entry) -> bool:
    """Whether an entry only changes values, equally in every record."""
    return (
        bool(entry.changes)
        and entry.insertion is None
        and entry.sensor is None
        and entry.input is None
        and entry.condition is None
        and not entry.shape_path
    )


def _slopes(
    config: MechanismFile, entry: Entry, magnitude: float, other: Entry, other_size: float
) -> dict[str, float]:
    """Derivatives of the changed values by the magnitude of an entry, with the other applied."""
    out: dict[str, float] = {}
    for path in {c.path: None for c in entry.changes}:
        own = [c for c in entry.changes if c.path == path]
        beside = [c for c in other.changes if c.path == path]
        factor = math.prod(
            (1.0 + c.scale * other_size) * math.exp(c.exp * other_size) for c in beside
        )
        factor *= math.prod((1.0 + c.scale * magnitude) * math.exp(c.exp * magnitude) for c in own)
        by_factor = sum(c.scale / (1.0 + c.scale * magnitude) + c.exp for c in own)
        value = float(read_entry(config, path))
        out[path] = value * factor * by_factor + sum(c.add for c in own)
    return out
