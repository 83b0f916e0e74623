"""Finds all faults of a mechanism file at once."""

from __future__ import annotations

import difflib
import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from feltmb import _core
from feltmb.contact.tables import CORE_LAWS, LAWS
from feltmb.mechanism.partial import without_faults
from feltmb.mechanism.schema import Contact, MechanismFile
from feltmb.mechanism.to_core import describe_with_faults
from feltmb.mechanism.workshop import faults as workshop_faults
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.units.quantity import MOST_FAULTS, fault_lines, fault_text, keys_of, table_at


def _paths_of_none(node: Any, path: str = "") -> Iterator[str]:
    if node is None:
        yield path
    elif isinstance(node, Mapping):
        for key, value in node.items():
            yield from _paths_of_none(value, f"{path}.{key}" if path else str(key))


def _table(raw: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    node = raw.get(key)
    return node if isinstance(node, Mapping) else {}


def _events_behind(name: str, events: Mapping[str, Any]) -> set[str]:
    """Events on which the event ``name`` depends, by ``after``, ``before`` or ``unless``."""
    behind: set[str] = set()
    ahead = [name]
    while ahead:
        node = events.get(ahead.pop())
        for key in ("after", "before", "unless"):
            other = node.get(key) if isinstance(node, Mapping) else None
            if isinstance(other, str) and other not in behind:
                behind.add(other)
                ahead.append(other)
    return behind


#: Places of names in a file, and what they name; ``*`` is every entry of a table. A place may hold
#: a list of names, or a table whose keys are names.
_REFERENCES = (
    ("bodies.*.parent", "body"),
    ("surfaces.*.body", "body"),
    ("points.*.body", "body"),
    ("leads.*.body", "body"),
    ("bushings.*.body", "body"),
    ("straps.*.body_a", "body"),
    ("straps.*.body_b", "body"),
    ("contacts.*.surfaces", "surface"),
    ("springs.*.coordinate", "coordinate"),
    ("dashpots.*.coordinate", "coordinate"),
    ("start_pose", "coordinate"),
    ("string.surface", "surface"),
    ("string.other_surfaces", "surface"),
    ("finger.body", "body"),
    ("motor.coordinate", "coordinate"),
    ("motor.contact", "contact"),
    ("events.*.point", "point"),
    ("events.*.before", "event"),
    ("events.*.after", "event"),
    ("events.*.unless", "event"),
    ("events.*.contact", "contact"),
    ("reading.strike_contact", "contact"),
    ("reading.let_off_contact", "contact"),
    ("reading.check_contacts", "contact"),
    ("reading.key_point", "point"),
    ("reading.striker.point", "point"),
    ("reading.touch.*", "event"),
    ("reading.rows.*.at", "event"),
    ("reading.rows.*.after", "event"),
    ("reading.rows.*.before", "event"),
    ("reading.rows.*.between", "event"),
)


def _found(node: Any, parts: Sequence[str], where: str = "") -> Iterator[tuple[str, Any]]:
    """Path and value of each place that a pattern of :data:`_REFERENCES` means."""
    if not parts:
        yield where, node
    elif isinstance(node, Mapping):
        for key in node if parts[0] == "*" else parts[:1]:
            if key in node:
                yield from _found(node[key], parts[1:], f"{where}.{key}" if where else key)


def _reference_faults(raw: Mapping[str, Any]) -> list[str]:
    """References to names that do not exist, in the raw file, to report them with other faults."""
    faults: list[str] = []
    numbers = set()
    for key in _table(raw, "contacts"):
        if not (key.isascii() and key.isdigit()) or not 2 <= len(key) <= 4:
            faults.append(f"contacts.{key}: expected a number of two digits, such as contacts.06")
        else:
            numbers.add(int(key))
    given = [name for _, name in _found(raw, ("bodies", "*", "coordinate"))]
    known: dict[str, set[Any]] = {
        "body": {"ground", *_table(raw, "bodies")},
        "surface": set(_table(raw, "surfaces")),
        "point": set(_table(raw, "points")),
        "event": set(_table(raw, "events")),
        "coordinate": {c for c in given if isinstance(c, str) and c},
        "contact": numbers,
    }
    for place, what in _REFERENCES:
        for where, value in _found(raw, place.split(".")):
            for name in value if isinstance(value, (list, Mapping)) else [value]:
                if not _is_missing(name, what, known[what]):
                    continue
                if what == "contact":
                    faults.append(f"{where}: there is no contact {name}")
                elif name or not where.startswith("leads."):  # "": a lead of the key
                    listed = shortened(", ".join(sorted(map(str, known[what]))), 300) or "none"
                    faults.append(f"{where}: {what} {name!r} is missing; {what} names are {listed}")
    return [*faults, *_event_faults(_table(raw, "events")), *_row_faults(raw)]


def _is_missing(name: object, what: str, known: set[Any]) -> bool:
    """Whether a name does not exist; what is no name at all is a fault of its type."""
    return isinstance(name, (int, float) if what == "contact" else str) and name not in known


def _event_faults(events: Mapping[str, Any]) -> Iterator[str]:
    """Events that are not one of both kinds, or that wait for themselves."""
    for name, node in events.items():
        where, keys = f"events.{name}", node if isinstance(node, Mapping) else None
        if keys is None:
            continue
        if ("contact" in keys) == ("point" in keys):
            yield f"{where}: give either contact and change, or point and travel"
        elif "contact" in keys and "change" not in keys:
            yield f"{where}: a contact event needs change = 'opens' or 'closes'"
        elif "point" in keys and "travel" not in keys:
            yield f"{where}: a point event needs travel"
        if name in _events_behind(name, events):
            yield f"{where}: waits for itself through 'after', 'before' or 'unless'"


#: Keys of a row of ``[reading]`` that say what it is: a value with take or at an event, or a time.
_KINDS_OF_ROW = ({"output", "take"}, {"output", "at"}, {"at"}, {"between"})


def _row_faults(raw: Mapping[str, Any]) -> Iterator[str]:
    """Rows of the summary without a clear meaning, or with a name that is taken."""
    for where, node in _found(raw, ("reading", "rows", "*")):
        if not isinstance(node, Mapping):
            continue
        name = where.rpartition(".")[2]
        if {"output", "take", "at", "between"}.intersection(node) not in _KINDS_OF_ROW:
            yield (
                f"{where}: expected output with take or at = EVENT, or a time: at = EVENT alone "
                "or between = [EVENT, EVENT]"
            )
        if name in _OWN_ROWS or name.removesuffix("_time") in _table(raw, "events"):
            yield f"{where}: the summary has a number of this name; choose another"


#: Values of a summary that follow from the roles of contacts and points.
_OWN_ROWS = (
    *("impact_time", "impact_speed", "rebound_speed", "impact_duration", "let_off_gap"),
    *("max_impact_force", "max_impact_force_time", "check_gap", "check_gap_swing", "key_travel"),
)


def _reading_faults(config: MechanismFile, outputs: Collection[str]) -> list[str]:
    """Outputs in ``[reading]`` that the mechanism does not have."""
    reading = config.reading
    named = [(f"reading.rows.{name}.output", row.output) for name, row in reading.rows.items()]
    named += [
        (f"reading.views.{name}.curves", curve.output)
        for name, view in reading.views.items()
        for curve in view.rows
    ]
    faults = []
    for where, output in named:
        if output is None or output in outputs:
            continue
        near = difflib.get_close_matches(output, outputs, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        faults.append(f"{where}: there is no output {output!r}{hint}")
    return faults


#: Names in the file of a run in addition to the outputs.
_IN_FILES = ("time", "end_state", "end_memory", "string.eta")


def output_faults(outputs: Sequence[str]) -> list[str]:
    """Output names that a file cannot contain, or that are used twice."""
    faults = [
        f"output {name!r}: the name of a coordinate, point or strap must hold no '/'"
        for name in outputs
        if "/" in name or "\0" in name
    ]
    twice = {name for name, count in Counter([*_IN_FILES, *outputs]).items() if count > 1}
    return faults + [
        f"output {name!r} would be given twice; rename the coordinate, point or strap"
        for name in sorted(twice)
    ]


#: Places of the parameters of a law in a contact; all others are entries of the contact.
_LAW_TABLE = {name: law.table for name, law in CORE_LAWS.items() if name in LAWS and law.table} | {
    "micromechanical": "micromechanical"
}


#: Parameters of laws that are entries of the contact.
_IN_CONTACT = list(
    dict.fromkeys(
        key
        for law in CORE_LAWS.values()
        for field in law.fields
        for key in (["loading", "unloading"] if field.kind == "envelope" else [field.name])
        if field.in_contact or field.kind == "envelope"
    )
)


@checked
def spread_laws(raw: dict[str, Any], faults: list[str]) -> dict[str, Any]:
    """Convert ``law = { name = ..., ... }`` to ``law = name`` and its parameters."""
    contacts = {}
    for key, node in _table(raw, "contacts").items():
        law = node.get("law") if isinstance(node, Mapping) else None
        if not isinstance(law, Mapping):
            contacts[key] = node
            continue
        own = {k: v for k, v in law.items() if k != "name"}
        name = law.get("name")
        if name is None:
            faults.append(
                f"contacts.{key}.law: is missing its name, such as "
                '{ name = "felt_memory", kappa = 0.2 }'
            )
            name = "felt_memory"
        curves = {k: own.pop(k) for k in _IN_CONTACT if k in own}
        table = _LAW_TABLE.get(str(name))
        inner = {}
        if table is not None:
            old = node.get(table)
            inner = {table: {**(old if isinstance(old, Mapping) else {}), **own}}
        elif own:
            faults += [f"contacts.{key}.law.{k}: unknown key of law {name!r}" for k in own]
        contacts[key] = {**node, **curves, **inner, "law": name}
    return {**raw, "contacts": contacts} if contacts else raw


def _as_written(line: str, contacts: Mapping[str, Any]) -> str:
    """A fault in the parameters of ``law = { ... }``, with the path in the file."""
    where = line.split(":")[0].split(".")
    if len(where) > 3 and where[2] in _LAW_TABLE.values():
        node = contacts.get(where[1])
        if isinstance(node, Mapping) and isinstance(node.get("law"), Mapping):
            return line.replace(f".{where[1]}.{where[2]}.", f".{where[1]}.law.", 1)
    return line


def _pair_radii(config: MechanismFile, contact: Contact) -> tuple[float | None, float | None]:
    """Relative radius of a pair of surfaces and, for a string, the radius of the string [m]."""
    pair = [config.surfaces[name] for name in contact.surfaces if name in config.surfaces]
    curvature = sum(
        0.0
        if s.kind in ("line", "segment")
        else (-1.0 if s.kind in ("concave", "concave_arc") else 1.0) / (s.radius or math.inf)
        for s in pair
    )
    string = config.string
    lines = [] if string is None else [string.surface, *string.other_surfaces]
    on_string = any(line in contact.surfaces for line in lines)
    wire = 0.5 * string.diameter if string is not None and on_string else None
    return (1.0 / curvature if curvature > 0.0 else None), wire


def _pair_fault(config: MechanismFile, key: str) -> str | None:
    """Fault of a pair that no contact supports; it replaces faults about missing radii."""
    contact = config.contacts[key]
    pair = [(config.surfaces[n].kind, n) for n in contact.surfaces if n in config.surfaces]
    if len(pair) != 2 or any(kind == "circle" for kind, _ in pair):
        return None
    (kind, name), (other, second) = pair
    return (
        f"contacts.{key}: a {kind} ({name}) cannot meet a {other} ({second}); one of the pair must "
        "be a circle"
    )


def _with_radii(config: MechanismFile) -> MechanismFile:
    """The tables of layers, with missing radii of areas taken from the pair."""
    contacts = {}
    for key, contact in config.contacts.items():
        layer = contact.micromechanical
        contacts[key] = contact
        if layer is None:
            continue
        radius, wire = _pair_radii(config, contact)
        own = {
            "crossed_cylinders": {"radius_a": radius, "radius_b": wire},
            "circle_on_layer": {"radius": radius},
            "sphere_on_layer": {"radius": radius},
        }.get(layer.area.kind, {})
        update = {k: v for k, v in own.items() if getattr(layer.area, k) is None}
        area = layer.area.model_copy(update=update)
        contacts[key] = contact.model_copy(
            update={"micromechanical": layer.model_copy(update={"area": area})}
        )
    return config.model_copy(update={"contacts": contacts})


@checked
def missing_law_faults(node: Mapping[str, Any], where: str) -> list[str]:
    """Entries that the law of a raw table needs and that are missing."""
    law = node.get("law", "felt_memory")
    if law == "micromechanical":
        needed = ["micromechanical"]
    elif isinstance(law, str) and law in LAWS:
        needed = CORE_LAWS[law].needed(node)
    else:
        return []
    faults = []
    for key in needed:
        if key not in node:
            table = table_at(Contact, (key, ""))
            keys = f"; {keys_of(table)}" if table is not None else ""
            faults.append(f"{where}.{key}: is missing; law {law!r} needs it{keys}")
    return faults


#: Required entries of each kind of surface, besides its point.
_GEOMETRY = {
    "line": ("normal",),
    "circle": ("radius",),
    "concave": ("radius",),
    "hybrid": ("radius", "arc"),
    "segment": ("end",),
    "concave_arc": ("radius", "arc"),
}
#: All such entries, and further permitted ones of each kind.
_ALL_GEOMETRY, _MAY_HAVE = ("normal", "radius", "arc", "end"), {"segment": ("radius",)}


def _law_faults(raw: Mapping[str, Any]) -> list[str]:
    """Entries that the law of a contact, the kind of a surface or the kind of a body needs."""
    faults: list[str] = []
    for table, check in (
        ("contacts", missing_law_faults),
        ("surfaces", _surface_faults),
        ("bodies", _body_faults),
    ):
        for name, node in _table(raw, table).items():
            if isinstance(node, Mapping):
                faults += check(node, f"{table}.{name}")
    return faults


def _surface_faults(node: Mapping[str, Any], where: str) -> Iterator[str]:
    kind = node.get("kind")
    needed = _GEOMETRY.get(str(kind), ())
    yield from (
        f"{where}.{key}: is missing; kind {kind!r} needs it" for key in needed if key not in node
    )
    allowed = (*(needed or _ALL_GEOMETRY), *_MAY_HAVE.get(str(kind), ()))
    for key in _ALL_GEOMETRY:
        if node.get(key) is not None and key not in allowed:
            have = [k for k, own in _GEOMETRY.items() if key in (*own, *_MAY_HAVE.get(k, ()))]
            others = ", ".join(map(repr, have))
            yield f"{where}.{key}: kind {kind!r} has no {key}; these have: {others}"


def _body_faults(node: Mapping[str, Any], where: str) -> Iterator[str]:
    if node.get("kind") == "beam":
        needed = dict.fromkeys(("length", "density", "area"), "kind 'beam'")
        if node.get("rigid") is False:
            needed |= dict.fromkeys(("young_modulus", "second_moment"), "a flexible beam")
        for key, what in needed.items():
            if node.get(key) is None:
                yield f"{where}.{key}: is missing; {what} needs it"
    if node.get("joint", "revolute") != "weld" and "coordinate" not in node:
        yield f"{where}.coordinate: is missing; a joint that moves needs a name"


def _parse(raw: Mapping[str, Any]) -> tuple[list[str], MechanismFile | None]:
    """Faults of single entries and of references between them; and the checked tables."""
    faults: list[str] = []
    raw_laws, raw = _table(raw, "contacts"), spread_laws(dict(raw), faults)
    parsed: MechanismFile | None = None
    try:
        parsed = MechanismFile.model_validate(raw)
    except ValidationError as error:
        faults += [_as_written(line, raw_laws) for line in fault_lines(error, MechanismFile)]
    faults += _reference_faults(raw)
    faults += _law_faults(raw)
    for path in _paths_of_none(raw):
        if not any(f.startswith(f"{path}:") for f in faults):
            faults.append(f"{path}: got None, expected a value; leave the key out for its default")
    # Radii come from the pair, which may be missing because of a fault.
    return list(dict.fromkeys(faults)), parsed if faults or parsed is None else _with_radii(parsed)


def _assemble(config: MechanismFile) -> tuple[list[str], Any]:
    """Faults of the complete mechanism, as the core reports them; and the mechanism of the core."""
    description, faults = describe_with_faults(config)
    keys = [f.partition(":")[0].removeprefix("contacts.") for f in faults]
    faults = [
        (_pair_fault(config, key) if key in config.contacts else None) or fault
        for key, fault in zip(keys, faults, strict=True)
    ]
    try:
        mechanism = _core.assemble(description)
    except InvalidParameter as error:
        lines = str(error).splitlines()
        found = [line.strip() for line in lines[1:]] or lines
        if faults:  # contacts are omitted from the description
            found = [f for f in found if "no contact uses its surface" not in f]
        return faults + found, None
    if not faults:
        outputs = [name for name, _, _ in _core.observables(mechanism)]
        faults = output_faults(outputs) + _reading_faults(config, outputs)
        faults += workshop_faults(config)
    return faults, mechanism


def _hidden_faults(raw: Mapping[str, Any]) -> list[str]:
    """Faults that the core finds in the valid part of a faulty file."""
    found = without_faults(raw, lambda tables: _parse(tables)[0])
    if found is None:
        return []
    rest, dropped = found
    parsed = _parse(rest)[1]
    if parsed is None:
        return []
    bodies = {path.split(".")[1] for path in dropped if path.startswith("bodies.")}
    # A body without its faulty entry may lack a mass only for this reason.
    return [
        f
        for f in _assemble(parsed)[0]
        if not any(f'"{name}"' in f for name in bodies)
        and not (bodies and ("moves no mass" in f or "no body has a joint" in f))
        and "no contact uses its surface" not in f
    ]


def validate(raw: Mapping[str, Any], origin: str) -> tuple[MechanismFile, Any]:
    """Check a file; return it with the mechanism of the core."""
    faults, config = _parse(raw)
    mechanism = None
    if faults or config is None:
        if len(faults) < MOST_FAULTS:  # more would not be reported
            faults += _hidden_faults(raw)
    else:
        faults, mechanism = _assemble(config)
    if faults or config is None:
        raise InvalidParameter(fault_text(origin, list(dict.fromkeys(faults))))
    return config, mechanism
