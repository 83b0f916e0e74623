"""What a diagnosis found: changed mechanisms, files, and places."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from feltmb.adapters.changes import Chosen, changed_config
from feltmb.mechanism import Action, MechanismFile, expand_path
from feltmb.mechanism.numbers import read_entry
from feltmb.mechanism.values import component, si_factor, tidy
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.units import split_quantity, unit_suffix
from unmodeled.units.quantity import is_quantity


@checked
def action_with_effects(action: Action, entries: Chosen) -> Action:
    """Mechanism with tolerances and effects of given magnitudes.

    Parameters
    ----------
    entries
        (entry, magnitude [its unit], shape or None); sensor and input effects do not change a
        mechanism.

    Returns
    -------
    Action
        The mechanism in SI units. Notes and sources of the file are removed, because they describe
        the old values. If nothing changed, the original object is returned.
    """
    config = changed_config(action.config, entries)
    if config is action.config:
        return action
    raw = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    return Action(raw, action.origin)


def action_of_findings(
    action: Action,
    entries: Chosen,
    *,
    provenance: str,
    besides: Sequence[str] = (),
) -> Action:
    """Mechanism with tolerances and effects of given magnitudes, in the units of its file.

    Parameters
    ----------
    entries
        (entry, magnitude [its unit], shape or None).
    provenance
        Source of every changed value. The old value becomes its note.
    besides
        Sensor and input effects, which are not part of a mechanism; ``about`` mentions them.

    Raises
    ------
    InvalidParameter
        An effect depends on a condition of the record, such as its temperature.
    """
    used = [(e, m, s) for e, m, s in entries if m != 0.0]
    drifting = [e.name for e, _, _ in used if e.condition is not None]
    if drifting:
        raise InvalidParameter(
            f"{action.name}: {', '.join(drifting)} depend on a condition of the record, expected "
            "effects that are the same in every record; take them out first"
        )
    numbers = [(e, m, s) for e, m, s in used if e.insert is None]
    raw, old = action.raw, action.config
    new = changed_config(old, numbers)
    paths = dict.fromkeys(c.path for e, _, _ in numbers for c in e.changes)
    paths |= dict.fromkeys(e.shape.path for e, _, s in numbers if e.shape and s is not None)
    for path in paths:
        after = read_entry(new, path)
        if after != read_entry(old, path):
            _put(raw, old, path, float(after), provenance)
    inserted = changed_config(new, [(e, m, s) for e, m, s in used if e.insert])
    if inserted is not new:
        _put_parts(raw, new, inserted)
    raw["name"] = f"{action.name.removesuffix('_calibrated')}_calibrated"
    raw["about"] = _about(action, used, provenance, besides)
    return Action(raw, action.origin)


def _about(action: Action, used: Chosen, provenance: str, besides: Sequence[str]) -> str:
    """Text about a calibrated mechanism."""
    about = str(action.raw.get("about", "")) or action.name
    about = f"{about.partition('; calibrated by ')[0]}; calibrated by {provenance}"
    inserted = [f"{e.name} = {m:.6g} {e.unit}".removesuffix(" 1") for e, m, _ in used if e.insert]
    if inserted:
        about += f"; inserted: {', '.join(inserted)}"
    if besides:
        about += f"; not in this file, because they are of the records: {', '.join(besides)}"
    return about


def _put(
    raw: dict[str, Any], config: MechanismFile, path: str, after: float, provenance: str
) -> None:
    """Replace a number of the file, in its unit there; its note tells what it was.

    ``config`` and ``after`` are in SI units. The components of a point share one note, and so do
    the coefficients of a curve.
    """
    *tables, last = expand_path(raw, path)[0]
    before = float(read_entry(config, path))
    above: Any = None
    node: Any = raw
    for name in tables:
        above, node = node, node.setdefault(name, {})  # a missing entry has its default
    if not node and component(last) >= 0:  # so has a missing point
        node = list(read_entry(config, ".".join(tables)))
    if isinstance(node, list):
        node = above[tables[-1]] = {"value": node}
    shares = is_quantity(node) or isinstance(node.get("unit"), list)
    if not shares:
        node[last] = node = _quantity(node.get(last))
    values: Any = node
    key: Any = last if shares else "value"
    if shares and is_quantity(node):
        values, key = node["value"], component(last)
    old, unit = values[key], node.get("unit", "")
    unit = unit if isinstance(unit, str) else ""
    if isinstance(old, (int, float)) and old * before != 0.0:
        values[key] = tidy(old * (after / before))
    else:
        values[key] = tidy(after / si_factor(None, unit))
    shown = f"{before if old is None else old:.6g}" if not isinstance(old, str) else old
    notes = [f"{last} before" if shares else "before", shown + unit_suffix(unit or "1")]
    notes, earlier = [" ".join(notes)], node.get("note", "")
    if node.get("source") == provenance:
        notes.insert(0, earlier)
    else:
        notes[0] += f" ({node['source']})" if node.get("source") else ""
        notes.append(earlier)
    node.pop("sd", None)  # of the old value
    comment = {"source": provenance, "status": "fitted", "note": "; ".join(filter(None, notes))}
    node.update(comment)


def _quantity(leaf: Any) -> dict[str, Any]:
    """Value and unit of an entry of a file as a table."""
    if is_quantity(leaf):
        return dict(leaf)
    quantity = split_quantity(leaf) if isinstance(leaf, str) else None
    return {"value": leaf} if quantity is None else {"value": quantity[0], "unit": quantity[1]}


def _put_parts(raw: dict[str, Any], old: MechanismFile, new: MechanismFile) -> None:
    """Write the parts that an insertion changed or added, in SI units."""
    options: Mapping[str, Any] = {"mode": "json", "by_alias": True, "exclude_none": True}
    before, after = old.model_dump(**options), new.model_dump(**options)
    for table, parts in after.items():
        if not isinstance(parts, dict) or parts == before.get(table):
            if parts != before.get(table):
                raw[table] = copy.deepcopy(parts)
            continue
        mine = raw.setdefault(table, {})
        for key, value in parts.items():
            if value != before.get(table, {}).get(key):
                mine[key] = copy.deepcopy(value)
        for key in set(before.get(table, {})) - set(parts):
            mine.pop(key, None)


# ------------------------------------------------------------------------------------- places


#: Entries of a body that belong to its joint, and number of contacts up to which a change is local.
JOINT, LOCAL = ("friction", "position"), 4


def _contact(config: MechanismFile, component: str) -> str | None:
    number = re.match(r"contact (\d+)", component)
    return number.group(1) if number and number.group(1) in config.contacts else None


def bodies_at(config: MechanismFile, component: str, paths: Iterable[str] = ()) -> list[str]:
    """Bodies of a component of a report, or those of the changed entries.

    Parameters
    ----------
    component
        Text of an effect, such as ``contact 03, key capstan - whippen`` or ``hammer head``.
    paths
        Dotted paths of the entries that the effect changes.
    """
    number = _contact(config, component)
    if number is not None:
        return [config.surfaces[name].body for name in config.contacts[number].surfaces]
    bodies = list(_of_paths(config, paths))
    return bodies or [n for n, b in config.bodies.items() if component.startswith(b.label or n)]


def _of_paths(config: MechanismFile, paths: Iterable[str]) -> Iterator[str]:
    for path in paths:
        table, name, *_ = path.split(".")
        if table == "bodies":
            yield name
        elif table == "surfaces":
            yield config.surfaces[name].body
        elif table == "contacts":
            yield from (config.surfaces[s].body for s in config.contacts[name].surfaces)
        elif table == "springs":
            coordinate = config.springs[name].coordinate
            yield from (n for n, b in config.bodies.items() if b.coordinate == coordinate)
        elif table == "straps":
            yield from (config.straps[name].body_a, config.straps[name].body_b)


def points_at(
    action: Action, component: str, paths: Iterable[str] = ()
) -> list[tuple[float, float]]:
    """Points at rest [m] of what changes: contacts and joints; () if it is a whole part.

    Parameters
    ----------
    component
        Text of an effect, such as ``contact 03, key capstan - whippen`` or ``whippen joint``.
    paths
        Dotted paths of the entries that the effect changes: of contacts or their surfaces, such as
        a screw of the frame, or of the joint of a body.
    """
    from feltmb import _core
    from feltmb.run.simulate import evaluate

    config, paths, pose = action.config, [*paths], action.rest_pose
    numbers = _contacts_at(config, component, paths)
    if len(numbers) > LOCAL:
        return []
    found: list[tuple[float, float]] = []
    if numbers:
        contacts = evaluate(action, pose, 0.0 * pose).contacts
        rows = [contacts.loc[int(n)] for n in numbers]
        found = [(float(row["x"]), float(row["y"])) for row in rows]
    poses = _core.body_poses(action.mechanism, pose)
    joints = [poses[name] for name in _joints_at(config, component, paths) if name in poses]
    return found + [(float(x), float(y)) for x, y, _ in joints]


def _contacts_at(config: MechanismFile, component: str, paths: Sequence[str]) -> list[str]:
    """Numbers of the contacts of a component, or of the changed contacts and surfaces."""
    if (number := _contact(config, component)) is not None:
        return [number]
    own = {p.split(".")[1] for p in paths if p.startswith("contacts.")}
    surfaces = {p.split(".")[1] for p in paths if p.startswith("surfaces.")}
    return [n for n, c in config.contacts.items() if n in own or surfaces.intersection(c.surfaces)]


def _joints_at(config: MechanismFile, component: str, paths: Sequence[str]) -> list[str]:
    """Bodies whose joint a change is at: its friction, its position, or the spring there."""
    split = [p.split(".") for p in paths]
    own = [p[1] for p in split if p[0] == "bodies" and p[2] in JOINT]
    springs = [config.springs[p[1]].coordinate for p in split if p[0] == "springs"]
    own += [n for n, b in config.bodies.items() if b.coordinate in springs]
    at = component.removesuffix(" joint").removesuffix(" pivot")
    if at != component:
        own += [n for n, b in config.bodies.items() if at == (b.label or n)]
    return [*dict.fromkeys(own)]
