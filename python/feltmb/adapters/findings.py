"""What a diagnosis found or a plan proposes: changed mechanisms, files, and places."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from feltmb.adapters.changes import Chosen, changed_config, read_entry
from feltmb.arguments import checked
from feltmb.data import Array
from feltmb.errors import InvalidParameter
from feltmb.files import write_text
from feltmb.mechanism import Action, MechanismFile, expand_path
from feltmb.mechanism.values import tidy
from feltmb.run.stroke.strokes import Kind, usual_interpolation
from feltmb.units import conversion_factor, split_quantity
from feltmb.units.quantity import is_quantity

__all__ = [
    "action_of_findings",
    "action_with_effects",
    "bodies_at",
    "points_at",
    "write_mechanism",
    "write_planned_stroke",
    "write_planned_torque",
]


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


def write_mechanism(
    path: Path,
    action: Action,
    entries: Chosen,
    *,
    provenance: str,
    besides: Sequence[str] = (),
    force: bool = False,
) -> Path:
    """Write the mechanism of :func:`action_of_findings` as TOML."""
    changed = action_of_findings(action, entries, provenance=provenance, besides=besides)
    return write_text(path, changed.to_toml(), force=force)


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
    numbers = [(e, m, s) for e, m, s in used if e.insertion is None]
    raw, old = action.raw, action.config
    new = changed_config(old, numbers)
    paths = dict.fromkeys(c.path for e, _, _ in numbers for c in e.changes)
    paths |= dict.fromkeys(e.shape_path for e, _, s in numbers if e.shape_path and s is not None)
    for path in paths:
        before, after = read_entry(old, path), read_entry(new, path)
        if before != after:
            _put(raw, path, float(before), float(after), provenance)
    inserted = changed_config(new, [(e, m, s) for e, m, s in used if e.insertion])
    if inserted is not new:
        _put_parts(raw, new, inserted)
    raw["name"] = f"{action.name.removesuffix('_calibrated')}_calibrated"
    raw["about"] = _about(action, used, provenance, besides)
    return Action(raw, action.origin)


def _about(action: Action, used: Chosen, provenance: str, besides: Sequence[str]) -> str:
    """Text about a calibrated mechanism."""
    about = str(action.raw.get("about", "")) or action.name
    about = f"{about.partition('; calibrated by ')[0]}; calibrated by {provenance}"
    found = [f"{e.name} = {m:.6g} {e.unit}".removesuffix(" 1") for e, m, _ in used if e.insertion]
    if found:
        about += f"; inserted: {', '.join(found)}"
    if besides:
        about += f"; not in this file, because they are of the records: {', '.join(besides)}"
    return about


def _put(raw: dict[str, Any], path: str, before: float, after: float, provenance: str) -> None:
    """Replace a number of the file by a value in SI units, converted to the unit in the file."""
    parts = expand_path(raw, path)[0]
    above: Any = None
    node: Any = raw
    for part in parts[:-1]:
        if isinstance(node, dict) and part not in node:
            node[part] = {}  # an entry that is missing in the file has its default
        above, node = node, node[part]
    last = parts[-1]
    if isinstance(node, list):
        node = above[parts[-2]] = {"value": node}
    if is_quantity(node):
        _put_component(node, last, before, after, provenance)
        return
    said = {"source": provenance, "status": "fitted"}
    leaf = node.get(last)
    if is_quantity(leaf):
        number, unit, source = leaf["value"], str(leaf.get("unit", "")), leaf.get("source", "")
        note = _note(number, unit, source, leaf.get("note", ""))
        node[last] = _scaled(float(number), unit, before, after) | said | {"note": note}
    elif isinstance(leaf, str) and (found := split_quantity(leaf)) is not None:
        note = _note(found[0], found[1], "", "")
        node[last] = _scaled(found[0], found[1], before, after) | said | {"note": note}
    elif isinstance(node.get("unit"), list):
        # The values of a curve share one description.
        was = f"{last} before {leaf:.6g}"
        if node.get("source") != provenance:
            was = _note(leaf, "", node.get("source", ""), node.get("note", "")).replace(
                "before", f"{last} before", 1
            )
            node["note"] = was
        else:
            node["note"] = f"{node['note']}; {was}"
        node[last] = tidy(_scaled(float(leaf), "", before, after)["value"])
        node.update(said)
    else:
        source = node.get("source", "") if leaf is not None else ""
        note = _note(before, "", source, "")
        node[last] = {"value": tidy(after)} | said | {"note": note}


def _put_component(
    node: dict[str, Any], axis: str, before: float, after: float, provenance: str
) -> None:
    """One component of a point."""
    index = {"x": 0, "y": 1}.get(axis, int(axis) if axis.isdecimal() else 0)
    values, unit = list(node["value"]), str(node.get("unit", ""))
    was = list(node["value"])
    if unit and before != 0.0 and isinstance(was[index], (int, float)) and was[index]:
        values[index] = tidy(was[index] * (after / before))
    else:
        values[index] = tidy(after / _to_si(unit))
    if node.get("source") != provenance:
        node["note"] = _note(was, unit, node.get("source", ""), node.get("note", ""))
    node.update({"value": values, "source": provenance, "status": "fitted"})


def _to_si(unit: str) -> float:
    """Factor of the unit of a vector, i.e. a position or gravity."""
    for si in ("m", "m/s^2"):
        try:
            return conversion_factor(unit or si, si)
        except InvalidParameter:
            continue
    return 1.0


def _scaled(number: float, unit: str, before: float, after: float) -> dict[str, Any]:
    """The new value in the unit of the file; in SI without a unit if the old value is zero."""
    if number == 0.0 or before == 0.0 or not math.isfinite(before / number):
        return {"value": tidy(after)}
    out: dict[str, Any] = {"value": tidy(number * (after / before))}
    return out | ({"unit": unit} if unit else {})


def _note(number: Any, unit: str, source: str, note: str) -> str:
    """The old value, its source, and its old note."""
    shown = f"{number:.6g}" if isinstance(number, (int, float)) else str(number)
    text = f"before {shown} {unit}".rstrip()
    text += f" ({source})" if source else ""
    return f"{text}; {note}" if note else text


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


# -------------------------------------------------------------------------------- planned inputs


@checked
def write_planned_stroke(
    path: Path, kind: Kind, time: Array, value: Array, *, unit: str, about: str, force: bool = False
) -> Path:
    """Write a stroke file for ``feltmb stroke`` through points.

    Parameters
    ----------
    path
        The file.
    kind
        Kind of the stroke.
    time
        Times [s], the last one is the duration.
    value
        Values [unit].
    unit
        Unit of the values.
    about
        What it is for.
    force
        Whether an existing file is overwritten.
    """
    import tomlkit

    table = {
        "schema": 1,
        "name": path.stem,
        "about": about,
        "source": "planned by feltmb gap plan",
        "kind": kind,
        "duration": float(time[-1]),
        "knots": {
            "unit": ["s", unit],
            "time": [float(f"{t:.9g}") for t in time],
            "value": [float(f"{v:.9g}") for v in value],
            "interpolation": usual_interpolation(kind),
        },
    }
    return write_text(path, tomlkit.dumps(table), force=force)


@checked
def write_planned_torque(path: Path, time: Array, torque: Array, *, force: bool = False) -> Path:
    """Write a torque as CSV, for ``feltmb actuator`` and the controller of a key actuator.

    Parameters
    ----------
    path
        The file.
    time
        Times [s], evenly spaced.
    torque
        Torque of the motor [N m].
    force
        Whether an existing file is overwritten.
    """
    lines = ["time [s],torque [N m]"]
    lines += [f"{t:.9g},{v:.9g}" for t, v in zip(time, torque, strict=True)]
    return write_text(path, "\n".join(lines) + "\n", force=force)


# ------------------------------------------------------------------------------------- places


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
    found = list(_of_paths(config, paths))
    return found or [n for n, b in config.bodies.items() if component.startswith(b.label or n)]


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


def points_at(action: Action, component: str) -> list[tuple[float, float]]:
    """Point where the surfaces of a contact meet at rest [m]; none for other components."""
    from feltmb.run.simulate import evaluate

    number = _contact(action.config, component)
    if number is None:
        return []
    pose = action.rest_pose
    row = evaluate(action, pose, 0.0 * pose).contacts.loc[int(number)]
    return [(float(row["x"]), float(row["y"]))]
