"""Versions of a mechanism: entries applied, assembled, and at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb import _core
from feltmb.adapters.changes import Change, apply_changes, replace_entry
from feltmb.adapters.insertions import Insertion, insert
from feltmb.adapters.library import Entry
from feltmb.mechanism import MechanismFile, describe

__all__ = ["Variant", "Workshop", "changed_config"]

Array = NDArray[np.float64]

#: Number of cached part definitions: versions of a mechanism share most of theirs.
PARTS = 5000


class Variant:
    """One mechanism and its rest pose.

    The rest pose is computed when it is needed.

    Parameters
    ----------
    mechanism
        Mechanism, assembled for the core.
    finger
        Whether it has a finger.

    Raises
    ------
    ModelError
        The mechanism has no rest pose; raised by every attribute that needs it.
    """

    def __init__(self, mechanism: _core.Mechanism, *, finger: bool):
        self.mechanism = mechanism
        self._finger = finger

    @property
    def states(self) -> tuple[int, int, int]:
        """Numbers of coordinates, of states of laws, and of modes of strings."""
        m = self.mechanism
        return len(m.coordinates), len(m.law_state_names), m.total_modes

    @cached_property
    def _found(self) -> Mapping[str, Any]:
        return _core.find_equilibrium(self.mechanism)

    @cached_property
    def rest(self) -> Array:
        """Full state [q, v, law states, eta, d eta/dt] at rest."""
        q = np.asarray(self._found["q"])
        modes = np.zeros(self.mechanism.total_modes)
        found = (self._found["law"], self._found["eta"])
        return np.concatenate([q, np.zeros(q.size), *found, modes])

    @cached_property
    def memory(self) -> Array:
        """Compressions that the contacts remember at rest [m]."""
        return np.asarray(self._found["largest_compression"])

    @cached_property
    def points(self) -> Mapping[str, tuple[float, float]]:
        """Positions of the tracking points at rest [m]."""
        points = {}
        for index, name in enumerate(self.mechanism.point_names):
            x, y = _core.point_position(self.mechanism, index, self._found["q"])
            points[name] = (float(x), float(y))
        return points

    @cached_property
    def finger_reference(self) -> float:
        """Position of the finger along its direction at rest [m]; 0 without a finger."""
        if not self._finger:
            return 0.0
        return float(_core.finger_place(self.mechanism, self._found["q"]))


def changed_config(
    config: MechanismFile,
    entries: Sequence[tuple[Entry, float, float | None]],
    conditions: Mapping[str, float | str],
) -> MechanismFile:
    """Mechanism with entries of given magnitudes and shapes; unchanged if all are zero."""
    changes: list[tuple[Change, float]] = []
    insertions: list[tuple[Insertion, float]] = []
    for entry, magnitude, shape in entries:
        if entry.condition is not None:
            magnitude = magnitude * entry.condition.factor(conditions)
        if magnitude == 0.0:
            continue
        changes += [(change, magnitude) for change in entry.changes]
        if entry.shape_path and shape is not None:
            config = replace_entry(config, entry.shape_path, shape)
        if entry.insertion is not None:
            insertions.append((entry.insertion, magnitude))
    config, _ = apply_changes(config, changes)
    for insertion, magnitude in insertions:
        config = insert(config, insertion, magnitude)
    return config


class Workshop:
    """Builds variants, with the parts that they share; usable from several threads."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, Any]] = {}

    def build(self, config: MechanismFile) -> Variant:
        """Assemble a configuration and compute its rest pose.

        Raises
        ------
        InvalidParameter, ModelError
            These values define no valid mechanism, or it has no rest pose.
        """
        variant = self.assemble(config)
        _ = variant.rest
        return variant

    def assemble(self, config: MechanismFile) -> Variant:
        """Assemble a configuration; its rest pose is computed when it is needed.

        Raises
        ------
        InvalidParameter
            These values define no valid mechanism.
        """
        if len(self._known) > PARTS:
            self._known = {}
        return Variant(
            _core.assemble(describe(config, self._known)), finger=config.finger is not None
        )
