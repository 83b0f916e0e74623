"""Tables of a faulty file without their faults, so that the rest of it can be checked too.

The schema finds what is wrong with single entries, the core what is wrong with the whole. To tell
both at once, the core gets the file without the entries that the schema refused.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

__all__ = ["without_faults"]

#: Tables whose entries can be left out; what refers to them is left out in turn.
_LOOSE = ("surfaces", "contacts", "springs", "straps", "points", "events")
_SINGLE = ("string", "finger", "reading", "start_pose", "source", "about", "gravity")
_ROUNDS = 20


def without_faults(
    raw: Mapping[str, Any], faults_of: Callable[[Mapping[str, Any]], Sequence[str]]
) -> tuple[dict[str, Any], set[str]] | None:
    """Copy of a mechanism's tables without what is at fault.

    Parameters
    ----------
    raw
        Tables of a mechanism file.
    faults_of
        Faults of such tables, each ``path: text``.

    Returns
    -------
    (dict, set of str) or None
        The tables and the dotted paths that were left out; None if no sound rest is found.
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
    """Leave out the entry that a path leads into, as little of it as may be."""
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
    # Names may hold dots: the longest one that the path begins with.
    name = path
    while name and name not in node:
        name = name.rpartition(".")[0]
    if not name:
        return
    inner = path[len(name) + 1 :]
    if table == "bodies" and isinstance(node[name], dict):
        # What refers to a body stays: only the entry at fault goes, for its default.
        field = inner.partition(".")[0]
        if field in node[name]:
            del node[name][field]
        else:
            node[name] = {"joint": "weld"}
        dropped.add(f"bodies.{name}.{field}")
    elif table in _LOOSE:
        del node[name]
        dropped.add(f"{table}.{name}")
