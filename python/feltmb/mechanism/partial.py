"""Removes faulty entries from the tables of a file, so that the rest can be checked too.

The schema finds faults of single entries, and the core finds faults of the complete mechanism. To
report both at once, the core gets the file without the entries that the schema rejected.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

#: Tables whose entries can be removed; entries that refer to them are removed in turn.
_LOOSE = (
    "surfaces",
    "contacts",
    "springs",
    "straps",
    "points",
    "events",
    "leads",
    "bushings",
    "screws",
)
_SINGLE = ("string", "finger", "reading", "start_pose", "source", "about", "gravity")
_ROUNDS = 20


def without_faults(
    raw: Mapping[str, Any], faults_of: Callable[[Mapping[str, Any]], Sequence[str]]
) -> tuple[dict[str, Any], set[str]] | None:
    """Copy of a mechanism's tables without the faulty entries.

    Parameters
    ----------
    raw
        Tables of a mechanism file.
    faults_of
        Function that returns the faults of such tables, each as ``path: text``.

    Returns
    -------
    (dict, set of str) or None
        The tables, and the dotted paths that were removed; None if no valid rest is found.
    """
    rest = copy.deepcopy(dict(raw))
    dropped: set[str] = set()
    for _ in range(_ROUNDS):
        faults = faults_of(rest)
        if not faults:
            return rest, dropped
        before = len(dropped)
        for fault in faults:
            _drop(rest, fault.partition(": ")[0], dropped)
        if len(dropped) == before:
            return None
    return None


def _drop(rest: dict[str, Any], where: str, dropped: set[str]) -> None:
    """Remove the entry to which a path leads, as little of it as possible."""
    match = re.match(r"(\w+)\.?(.*)", where)
    if match is None:
        return
    table, path = match.groups()
    node = rest.get(table)
    if table in _SINGLE or not isinstance(node, Mapping):
        if table in ("schema", "name"):
            rest[table] = 1 if table == "schema" else "without faults"
            dropped.add(table)
        elif table in rest and table != "bodies":
            del rest[table]
            dropped.add(table)
        return
    assert isinstance(node, dict)
    # Names may contain dots: the longest name with which the path begins.
    name = path
    while name and name not in node:
        name = name.rpartition(".")[0]
    if not name:
        return
    inner = path[len(name) + 1 :]
    if table == "bodies" and isinstance(node[name], dict):
        # References to a body remain valid: only the faulty entry is removed, and its default
        # applies.
        field = inner.partition(".")[0]
        if field in node[name]:
            del node[name][field]
        else:
            node[name] = {"joint": "weld"}
        dropped.add(f"bodies.{name}.{field}")
    elif table in _LOOSE:
        del node[name]
        dropped.add(f"{table}.{name}")
