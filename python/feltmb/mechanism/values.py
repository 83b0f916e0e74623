"""Changes values in the tables of a file by their dotted path."""

from __future__ import annotations

import copy
import math
import tomllib
from collections.abc import Mapping
from typing import Any

from feltmb.errors import InvalidParameter
from feltmb.units import split_quantity
from feltmb.units.quantity import (
    META_KEYS,
    is_quantity,
    shortened,
)

__all__ = [
    "apply_numbers",
    "apply_values",
    "expand_path",
    "parse_setting",
    "plain_data",
]


def parse_setting(text: str) -> tuple[str, Any]:
    """Split ``"string.modes=80"`` into its path and its value, which is TOML or else text."""
    path, sign, value = text.partition("=")
    if not sign or not path.strip():
        raise InvalidParameter(f"--set {text!r}: expected PATH=VALUE, such as string.modes=80")
    try:
        return path.strip(), tomllib.loads(f"v = {value}")["v"]
    except (ValueError, RecursionError):  # not TOML
        return path.strip(), value.strip()


def expand_path(raw: Mapping[str, Any], path: str) -> list[list[str]]:
    """Paths that match ``path``: ``*`` is any key; a body's name means bodies.NAME."""
    parts = path.split(".")
    if parts[0] not in raw and parts[0] in raw.get("bodies", {}):
        parts = ["bodies", *parts]
    # Coordinate names contain a dot; they are keys of start_pose only.
    if parts[0] == "start_pose" and len(parts) > 2:
        parts = ["start_pose", ".".join(parts[1:])]
    found: list[list[str]] = [[]]
    node_lists: list[Any] = [raw]
    for part in parts:
        next_found, next_nodes = [], []
        for prefix, node in zip(found, node_lists, strict=True):
            if part == "*" and isinstance(node, Mapping):
                for key in node:
                    next_found.append([*prefix, key])
                    next_nodes.append(node[key])
            else:
                next_found.append([*prefix, part])
                next_nodes.append(node.get(part) if isinstance(node, Mapping) else None)
        found, node_lists = next_found, next_nodes
    return found


_AXES = {"x": 0, "y": 1}


def _set_one(raw: dict[str, Any], parts: list[str], value: Any, where: str) -> None:
    node: Any = raw
    for i, part in enumerate(parts[:-1]):
        if isinstance(node, dict) and isinstance(node.get(part), dict):
            node = node[part]
            continue
        if isinstance(node, dict) and part in node and i == len(parts) - 2:
            node[part] = _set_component(node[part], parts[-1], value, where, parts)
            return
        raise InvalidParameter(
            f"{where}: path {'.'.join(parts)!r}: {'.'.join(parts[: i + 1])!r} does not exist"
        )
    last = parts[-1]
    if is_quantity(node) and (last in _AXES or last.isdecimal()):
        node["value"] = _set_component(node["value"], last, value, where, parts)
    elif is_quantity(node) and last not in META_KEYS:
        raise InvalidParameter(f"{where}: path {'.'.join(parts)!r} leads into a quantity")
    elif is_quantity(node.get(last)) and not isinstance(value, (Mapping, str)):
        # A number without a unit keeps the unit of the entry; source and note of the old value are
        # removed.
        unit = node[last].get("unit", "1")
        node[last] = {"value": value, "unit": unit, "note": f"set by {where}"}
    else:
        node[last] = _in_unit_of(node.get(last), copy.deepcopy(value))


def _set_component(old: Any, key: str, value: Any, where: str, parts: list[str]) -> list[Any]:
    index = _AXES.get(key, int(key) if key.isdecimal() else -1)
    if not isinstance(old, list) or not 0 <= index < len(old):
        raise InvalidParameter(f"{where}: path {'.'.join(parts)!r} does not exist")
    new = list(old)
    new[index] = _in_unit_of(old[index], value)
    return new


def _in_unit_of(old: Any, value: Any) -> Any:
    """A bare number with the unit of the text that it replaces: 16 for ``"15 g"`` is ``"16 g"``."""
    if not isinstance(old, str) or isinstance(value, bool) or not isinstance(value, (int, float)):
        return value
    found = split_quantity(old)
    if found is None or not abs(value) < math.inf or abs(value) > 1e300:
        return value
    return f"{float(value)!r} {found[1]}".strip()


def apply_values(raw: Mapping[str, Any], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Tables with changed values by dotted path; ``where`` is the caller's name for messages."""
    if not isinstance(values, Mapping):
        raise InvalidParameter(f"{where}: got {shortened(repr(values))}, expected paths and values")
    out = copy.deepcopy(dict(raw))
    faults = []
    for path, value in values.items():
        try:
            if not isinstance(path, str):
                raise InvalidParameter(f"{where}: path {path!r}: expected a text with dots")
            for parts in expand_path(out, path):
                _set_one(out, parts, value, where)
        except InvalidParameter as error:
            faults.append(str(error))
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


#: Tables of parts whose numbers refer to nothing else in the file.
_TABLES_OF_NUMBERS = ("bodies", "surfaces", "contacts", "springs", "straps", "points")


def apply_numbers(
    raw: Mapping[str, Any], values: Mapping[str, Any]
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Tables with changed numbers, which share the rest, and the changed parts.

    Raises ValueError if a value is not a single number of a part.
    """
    out = dict(raw)
    touched: list[tuple[str, str]] = []
    if not isinstance(values, Mapping) or not all(isinstance(path, str) for path in values):
        raise ValueError("paths and values")
    for path, value in values.items():
        number = value.item() if hasattr(value, "item") else value
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            raise ValueError(path)
        for parts in expand_path(out, path):
            if len(parts) < 3 or parts[0] not in _TABLES_OF_NUMBERS:
                raise ValueError(path)
            table, key = parts[:2]
            if (table, key) not in touched:
                touched.append((table, key))
                out[table] = {**out[table], key: copy.deepcopy(out[table][key])}
            _set_one(out, parts, number, "with_values")
    return out, touched


_DEEPEST = 50  # nested tables and lists


def plain_data(node: Any, depth: int = 0) -> Any:
    """Copy of a file's tables without NumPy objects."""
    if depth > _DEEPEST:
        raise InvalidParameter("tables are nested too deeply")
    if isinstance(node, Mapping):
        return {key: plain_data(value, depth + 1) for key, value in node.items()}
    if isinstance(node, (list, tuple)):
        return [plain_data(value, depth + 1) for value in node]
    return node.tolist() if hasattr(node, "tolist") else node
