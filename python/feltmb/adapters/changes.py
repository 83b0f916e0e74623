"""Changes of a validated mechanism by dotted path, in SI units, without copies of the rest.

A *change* states how a magnitude changes one entry: the entry is multiplied by
``1 + scale * magnitude`` or ``exp(exp * magnitude)``, or ``add * magnitude`` is added. Several
changes of one entry are combined: factors are multiplied first, then the summands are added. If the
result equals the old value, the entry is not replaced, so that magnitude zero gives exactly the old
mechanism.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from feltmb.errors import InvalidParameter
from feltmb.mechanism import MechanismFile

__all__ = ["Change", "apply_changes", "read_entry", "replace_entry"]

_AXES = {"x": 0, "y": 1}


@dataclass(frozen=True, kw_only=True)
class Change:
    """Change of one entry of a mechanism file by a magnitude."""

    path: str
    """Dotted path, ``surfaces.Gp10.point.y``; the name of a body stands for ``bodies.NAME``."""
    scale: float = 0.0
    """The entry is multiplied by 1 + scale * magnitude [1 / unit of the magnitude]."""
    exp: float = 0.0
    """The entry is multiplied by exp(exp * magnitude) [1 / unit of the magnitude]."""
    add: float = 0.0
    """add * magnitude is added to the entry [its SI unit / unit of the magnitude]."""


def _steps(config: MechanismFile, path: str) -> list[str]:
    parts = path.split(".")
    if parts[0] in config.bodies and parts[0] not in MechanismFile.model_fields:
        parts = ["bodies", *parts]
    return parts


def _child(node: Any, key: str, path: str) -> Any:
    if isinstance(node, BaseModel) and key in type(node).model_fields:
        return getattr(node, key)
    if isinstance(node, Mapping) and key in node:
        return node[key]
    if isinstance(node, tuple):
        index = _AXES.get(key, int(key) if key.isdecimal() else -1)
        if 0 <= index < len(node):
            return node[index]
    raise InvalidParameter(f"path {path!r}: {key!r} does not exist")


def read_entry(config: MechanismFile, path: str) -> Any:
    """Value of an entry in SI units.

    Raises
    ------
    InvalidParameter
        The path does not exist.
    """
    node: Any = config
    for key in _steps(config, path):
        node = _child(node, key, path)
    return node


def _replaced(node: Any, parts: list[str], value: Any, path: str) -> Any:
    if not parts:
        return value
    key, rest = parts[0], parts[1:]
    if isinstance(node, Mapping) and key not in node and not rest:
        return {**node, key: value}
    new = _replaced(_child(node, key, path), rest, value, path)
    if isinstance(node, BaseModel):
        return node.model_copy(update={key: new})
    if isinstance(node, Mapping):
        return {**node, key: new}
    index = _AXES.get(key, int(key) if key.isdecimal() else -1)
    return (*node[:index], new, *node[index + 1 :])


def replace_entry(config: MechanismFile, path: str, value: Any) -> MechanismFile:
    """Mechanism with one entry replaced (SI units); the rest is neither copied nor checked."""
    out: MechanismFile = _replaced(config, _steps(config, path), value, path)
    return out


def apply_changes(
    config: MechanismFile, changes: Iterable[tuple[Change, float]]
) -> tuple[MechanismFile, dict[str, float]]:
    """Apply changes with their magnitudes; return the new mechanism and the changed entries."""
    factors: dict[str, float] = {}
    sums: dict[str, float] = {}
    for change, magnitude in changes:
        factor = (1.0 + change.scale * magnitude) * math.exp(change.exp * magnitude)
        factors[change.path] = factors.get(change.path, 1.0) * factor
        sums[change.path] = sums.get(change.path, 0.0) + change.add * magnitude
    moved = {}
    for path, factor in factors.items():
        if factor == 1.0 and sums[path] == 0.0:
            continue
        base = read_entry(config, path)
        if isinstance(base, bool) or not isinstance(base, (int, float)):
            raise InvalidParameter(f"path {path!r} is {base!r}, expected a number")
        moved[path] = base * factor + sums[path]
        config = replace_entry(config, path, moved[path])
    return config, moved
