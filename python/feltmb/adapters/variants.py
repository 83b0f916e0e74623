"""Versions of a mechanism: entries applied, assembled, at rest; kept while in use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from feltmb import _core
from feltmb.adapters.changes import Change, apply_changes, replace_entry
from feltmb.adapters.insertions import Insertion, insert
from feltmb.adapters.latest import Latest
from feltmb.adapters.library import Entry
from feltmb.errors import FeltmbError
from feltmb.mechanism import Action, MechanismFile, describe

__all__ = ["Variant", "Workshop", "changed_config"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Variant:
    """One mechanism, its rest and where its states are."""

    mechanism: _core.Mechanism
    rest: Array
    """Full state [q, v, law states, eta, d eta/dt] at rest."""
    memory: Array
    """Compressions that the contacts remember at rest [m]."""
    place: Mapping[str, int]
    """State name -> index in the full state."""
    points: Mapping[str, tuple[float, float]]
    """Where the tracking points are at rest [m]."""
    finger_reference: float


def changed_config(
    config: MechanismFile,
    entries: Sequence[tuple[Entry, float, float | None]],
    conditions: Mapping[str, float | str],
) -> MechanismFile:
    """Mechanism with entries of given magnitudes and shapes; unchanged where all are zero."""
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


def _name_states(mechanism: _core.Mechanism) -> dict[str, int]:
    """Names of the mechanical and law states; string modes and condensed coordinates too."""
    n = len(mechanism.coordinates)
    place = {name: k for k, name in enumerate(mechanism.coordinates)}
    place |= {f"{name}.rate": n + k for k, name in enumerate(mechanism.coordinates)}
    place |= {name: 2 * n + k for k, name in enumerate(mechanism.law_state_names)}
    return place


class Workshop:
    """Builds variants and keeps the last ones; safe to use from several threads."""

    def __init__(self, action: Action, keep: int = 600):
        self.action = action
        self._made: Latest[bytes, Variant | None] = Latest(keep)

    def variant(
        self,
        key: bytes,
        entries: Sequence[tuple[Entry, float, float | None]],
        conditions: Mapping[str, float | str],
    ) -> Variant | None:
        """Variant of a key; None if these numbers make no mechanism or no rest."""

        def make() -> Variant | None:
            try:
                return self.build(changed_config(self.action.config, entries, conditions))
            except FeltmbError:
                return None

        return self._made.get(key, make)

    def build(self, config: MechanismFile) -> Variant:
        """Assemble a configuration and find its rest.

        Raises
        ------
        InvalidParameter, ModelError
            These numbers make no mechanism, or it finds no rest.
        """
        mechanism = _core.assemble(describe(config))
        rest = _core.find_equilibrium(mechanism)
        q = np.asarray(rest["q"])
        modes = mechanism.total_modes
        state = np.concatenate([q, np.zeros(q.size), rest["law"], rest["eta"], np.zeros(modes)])
        points = {}
        for index, name in enumerate(mechanism.point_names):
            x, y = _core.point_position(mechanism, index, q)
            points[name] = (float(x), float(y))
        reference = 0.0
        if config.finger is not None:
            reference = float(_core.finger_place(mechanism, q))
        return Variant(
            mechanism=mechanism,
            rest=state,
            memory=np.asarray(rest["largest_compression"]),
            place=_name_states(mechanism),
            points=points,
            finger_reference=reference,
        )
