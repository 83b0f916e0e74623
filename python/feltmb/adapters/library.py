"""Library of effects and tolerances: TOML tables, expanded for one mechanism.

A table defines one effect, or, with ``for``, one effect for each joint, contact, beam and so on.
The results are :class:`Entry` objects: plain data that :class:`~feltmb.adapters.model` can apply.
"""

from __future__ import annotations

import difflib
import fnmatch
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from feltmb import params
from feltmb.adapters import felt
from feltmb.adapters.changes import Change, read_entry
from feltmb.adapters.insertions import Insertion
from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.files import MOST_EXTENDS, beside, is_file, read_toml
from feltmb.mechanism import Action, MechanismFile
from feltmb.units.quantity import (
    SI,
    Schema,
    SIVector,
    fault_text,
    parse_scalar,
    validated,
)

__all__ = ["Condition", "Entry", "Library", "Signal", "Until", "load_library"]

Each = Literal[
    "",
    "body",
    "joint",
    "pivot",
    "contact",
    "rubbing contact",
    "beam",
    "rigid beam",
    "spring",
    "strap",
    "string",
    "point",
    "channel",
    "finger",
]
Kind = Literal["force", "kinematic", "state", "parameter", "sensor", "input", "drift"]


class _ChangeTable(Schema):
    path: str
    scale: float = 0.0
    exp: float = 0.0
    add: float = 0.0


class _InsertTable(Schema):
    kind: Literal["clearance", "compliance", "hinge", "mass", "bending"]
    body: str
    damping: float | None = None
    seating: Annotated[float, SI("N")] | None = None
    point: Annotated[tuple[float, float], SIVector("m")] | str | None = None
    part: str | None = None
    carries: tuple[str, ...] | None = None
    share: float | None = None
    end: Annotated[tuple[float, float], SIVector("m")] | None = None


class _SignalTable(Schema):
    kind: Literal["delay", "gain", "offset", "tilt"]
    channels: str = ""


class _InputTable(Schema):
    kind: Literal["delay", "gain", "offset"]


class _ConditionTable(Schema):
    name: str
    reference: float
    per: Annotated[float, Field(gt=0)] = 1.0
    logarithmic: bool = False


class _MagnitudeOf(Schema):
    path: str
    times: Annotated[float, Field(gt=0)]
    or_weight: Annotated[float, Field(gt=0)] | None = None
    """If the entry is zero: share of the weight on a slider, or of its moment on a hinge."""


class _ShapeTable(Schema):
    path: str
    values: Annotated[list[float], Field(min_length=1)]
    unit: str = "1"


class _Table(Schema):
    """One effect or tolerance of the file."""

    each: Annotated[Each, Field(alias="for")] = ""
    label: str = ""
    component: str = ""
    mechanism: str = ""
    kind: Kind = "parameter"
    unit: str = "1"
    magnitude: float | str | None = None
    magnitude_of: _MagnitudeOf | None = None
    magnitude_by_input: dict[str, float] = {}
    sd: float | str | None = None
    sign: Literal[-1, 0, 1] = 0
    lower: float | None = None
    upper: float | None = None
    step: Annotated[float, Field(gt=0, le=1)] | None = None
    changes: list[_ChangeTable] = []
    felt: Literal["", "stiffness", "hardening", "thickness"] = ""
    felt_all: float = 0.0
    joints_all: float = 0.0
    insert: _InsertTable | None = None
    sensor: _SignalTable | None = None
    input: _InputTable | None = None
    condition: _ConditionTable | None = None
    shape: _ShapeTable | None = None
    remedy: str = ""
    source: str = ""
    note: str = ""
    part: str = ""


class _UntilTable(Schema):
    output: str
    after_turn: Annotated[float, SI("s"), Field(ge=0)]


class _Defaults(Schema):
    channels: list[str] = []
    until: _UntilTable | None = None
    without_tolerances: list[str] = []


class LibraryFile(Schema):
    """A file of effects and tolerances."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    about: str = ""
    extends: str | None = None
    channels: dict[str, list[str]] = {}
    defaults: _Defaults = _Defaults()
    tolerances: dict[str, _Table] = {}
    effects: dict[str, _Table] = {}


@dataclass(frozen=True, kw_only=True)
class Signal:
    """A distortion of measured channels or of the input."""

    kind: Literal["delay", "gain", "offset", "tilt"]
    channels: str = ""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """A drift: a condition of the record determines a factor of the magnitude."""

    name: str
    reference: float
    per: float = 1.0
    logarithmic: bool = False

    def factor(self, conditions: Mapping[str, float | str]) -> float:
        """Factor of the magnitude in a record; 0 if the record does not state the condition."""
        value = conditions.get(self.name)
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            return 0.0
        if not self.logarithmic:
            return (value - self.reference) / self.per
        if value <= 0.0 or self.reference <= 0.0:
            return 0.0
        return math.log10(value / self.reference) / self.per


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One effect or tolerance of a mechanism: changes per unit of magnitude, and texts."""

    name: str
    kind: Kind
    component: str
    mechanism: str
    unit: str
    magnitude: float
    """Effect: expected magnitude; tolerance: standard deviation [unit]."""
    sign: Literal[-1, 0, 1] = 0
    lower: float = -math.inf
    upper: float = math.inf
    step: float = 0.05
    changes: tuple[Change, ...] = ()
    insertion: Insertion | None = None
    sensor: Signal | None = None
    input: Signal | None = None
    condition: Condition | None = None
    shape_path: str = ""
    shapes: tuple[float | None, ...] = (None,)
    shape_unit: str = ""
    remedy: str = ""
    source: str = ""
    part: str = ""
    """Name in a report: the subject of "... is 10 % lighter than tabulated"."""


@dataclass(frozen=True)
class Until:
    """Part of a record that is used if records are simulated as a whole."""

    output: str
    """Output whose first reversal is the end of the stroke."""
    after_turn: float
    """Time after the reversal that is used [s]."""


@dataclass(frozen=True, kw_only=True)
class Library:
    """Effects, tolerances and channels of a mechanism."""

    name: str
    tolerances: tuple[Entry, ...]
    effects: tuple[Entry, ...]
    channels: Mapping[str, tuple[str, ...]]
    default_channels: tuple[str, ...]
    until: Until | None
    origin: str

    def effect(self, name: str) -> Entry:
        """Effect by name; an unknown name raises InvalidParameter with the nearest names."""
        return _chosen(self.effects, [name], "effects", self.name)[0]

    def select(self, names: Sequence[str] = ()) -> tuple[Entry, ...]:
        """Effects by name, or pattern with ``*``; without names, or with ``all``, all of them."""
        return _chosen(self.effects, names or ("all",), "effects", self.name)

    def choose_tolerances(self, names: Sequence[str]) -> tuple[Entry, ...]:
        """Tolerances by name, pattern or ``all``; ``none`` for none."""
        if list(names) == ["none"]:
            return ()
        return _chosen(self.tolerances, names, "tolerances", self.name)

    def outputs(self, channels: Sequence[str] = ()) -> tuple[str, ...]:
        """Outputs by channel names; a name with a dot is an output."""
        out: list[str] = []
        faults = []
        for name in channels or self.default_channels:
            if name in self.channels:
                out += self.channels[name]
            elif "." in name:
                out.append(name)
            else:
                known = ", ".join(self.channels)
                faults.append(
                    f"channel {name!r} is unknown; known are {known or 'POINT.x, POINT.y'}"
                )
        if faults:
            raise InvalidParameter("\n".join(faults))
        return tuple(dict.fromkeys(out))


def _chosen(
    entries: Sequence[Entry], names: Sequence[str], what: str, library: str
) -> tuple[Entry, ...]:
    from fnmatch import fnmatchcase

    known = {e.name: e for e in entries}
    out: dict[str, Entry] = {}
    faults = []
    for name in names:
        if name == "all":
            found = list(entries)
        elif any(c in name for c in "*?["):
            found = [e for e in entries if fnmatchcase(e.name, name)]
            if not found:
                faults.append(f"{what} {name!r}: no name of library {library!r} matches")
        elif name in known:
            found = [known[name]]
        else:
            near = difflib.get_close_matches(name, list(known), n=3, cutoff=0.4)
            hint = f"; near: {', '.join(near)}" if near else ""
            faults.append(f"{what[:-1]} {name!r} is not in library {library!r}{hint}")
            continue
        out |= {e.name: e for e in found}
    if faults:
        raise InvalidParameter("\n".join(faults))
    return tuple(out.values())


def _resolve(name_or_path: str | Path, user: Path | None = None) -> Path:
    text = str(name_or_path)
    if text in params.names("effects"):
        return params.folder("effects") / f"{text}.toml"
    path = Path(text) if user is None else beside(user.parent, text, f"{user.name}: extends")
    if is_file(path):
        return path
    known = ", ".join(params.names("effects"))
    raise InvalidParameter(
        f"library {text!r} is unknown; packaged are {known}; or give the path of a TOML file"
    )


def _read(path: Path, seen: tuple[Path, ...] = ()) -> LibraryFile:
    own = validated(LibraryFile, read_toml(path), path.name)
    if own.extends is None:
        return own
    if len(seen) >= MOST_EXTENDS:
        raise InvalidParameter(f"{path.name}: more than {MOST_EXTENDS} files extend one another")
    base_path = _resolve(own.extends, path)
    if base_path.resolve() in [p.resolve() for p in (*seen, path)]:
        raise InvalidParameter(f"{path.name}: extends {own.extends!r}, which leads back to itself")
    base = _read(base_path, (*seen, path))
    # What the base leaves out is not a tolerance that this file defines by the same name.
    defined = [re.sub(r"\{\w+\}", "*", name) for name in own.tolerances]
    out = base.defaults.without_tolerances
    kept = [n for n in out if not any(fnmatch.fnmatchcase(n, d) for d in defined)]
    defaults = {"without_tolerances": kept}
    defaults |= {k: getattr(own.defaults, k) for k in own.defaults.model_fields_set}
    return own.model_copy(
        update={
            "channels": base.channels | own.channels,
            "tolerances": base.tolerances | own.tolerances,
            "effects": base.effects | own.effects,
            "defaults": base.defaults.model_copy(update=defaults),
        }
    )


def _library_of(name: str) -> str:
    """The packaged library of a mechanism, or of the mechanism of which it is a variant."""
    packaged = params.names("effects")
    fitting = [n for n in packaged if name == n or name.startswith(f"{n}_")]
    return max(fitting, key=len, default="mechanism")


@checked
def load_library(action: Action, name_or_path: str | Path | None = None) -> Library:
    """Effects and tolerances of a mechanism.

    Parameters
    ----------
    name_or_path
        Packaged library or TOML file. Default: the packaged library with the name of the mechanism,
        or of the mechanism of which it is a variant (``steinway45_felt``), else ``mechanism``,
        which suits any mechanism.

    Raises
    ------
    InvalidParameter
        Faults of the file, all in one message, or a path that the mechanism does not have.
    """
    if name_or_path is None:
        name_or_path = _library_of(action.name)
    path = _resolve(name_or_path)
    file = _read(path)
    config = action.config
    outputs = file.channels
    faults: list[str] = []
    tolerances = [
        e
        for e in _entries(config, file.tolerances, outputs, faults, tolerance=True)
        if e.name not in file.defaults.without_tolerances
    ]
    effects = list(_entries(config, file.effects, outputs, faults, tolerance=False))
    until = file.defaults.until
    if until is not None:
        point, _, axis = until.output.rpartition(".")
        if axis not in ("x", "y") or (point not in config.points and file.name == action.name):
            faults.append(
                f"defaults.until.output: got {until.output!r}, expected POINT.x or POINT.y of "
                f"{', '.join(config.points) or 'a mechanism with tracking points'}"
            )
        if point not in config.points:
            until = None  # another mechanism has other strokes
    if faults:
        raise InvalidParameter(fault_text(path.name, list(dict.fromkeys(faults))))
    return Library(
        name=file.name,
        tolerances=tuple(tolerances),
        effects=tuple(effects),
        channels={k: tuple(v) for k, v in outputs.items()},
        default_channels=tuple(file.defaults.channels) or tuple(_all_points(config)),
        until=None if until is None else Until(until.output, until.after_turn),
        origin=path.name,
    )


def _all_points(config: MechanismFile) -> Iterator[str]:
    for name in config.points:
        yield from (f"{name}.x", f"{name}.y")


def _each(
    config: MechanismFile, each: Each, channels: Mapping[str, list[str]]
) -> Iterator[dict[str, str]]:
    """Substitutions for each item to which a template applies."""
    words = {"input_unit": "{input_unit}"}
    if each == "":
        yield words
    elif each in ("body", "joint", "pivot"):
        for name, body in config.bodies.items():
            moves = body.joint != "weld"
            heavy = body.mass > 0.0
            if (each == "body" and not heavy) or (each != "body" and not moves):
                continue
            above = config.bodies.get(body.parent)
            slides = above is not None and above.joint == "prismatic" and above.mass == 0.0
            if each == "pivot" and (body.joint != "revolute" or slides):
                continue  # the pivot of a slider has a translation already
            angular = body.joint == "revolute"
            yield words | {
                "name": name,
                "label": body.label or name,
                "joint_force": "N m" if angular else "N",
                "joint_motion": "rad" if angular else "m",
            }
    elif each in ("contact", "rubbing contact"):
        for name, contact in config.contacts.items():
            if not contact.enabled or (each != "contact" and contact.friction.amplitude == 0.0):
                continue
            yield words | {"name": name, "label": contact.label or f"contact {name}"}
    elif each == "beam":
        for name, body in config.bodies.items():
            if body.kind == "beam" and not body.rigid:
                yield words | {"name": name, "label": body.label or name}
    elif each == "rigid beam":
        for name, body in config.bodies.items():
            if body.kind == "beam" and body.rigid and body.young_modulus and body.second_moment:
                yield words | {"name": name, "label": body.label or name}
    elif each in ("spring", "strap"):
        table: Mapping[str, Any] = getattr(config, f"{each}s")
        for name, part in table.items():
            if part.enabled:
                yield words | {"name": name, "label": name.replace("_", " ")}
    elif each == "string":
        if config.string is not None and config.string.kind == "modal":
            yield words
    elif each == "point":
        for name in config.points:
            yield words | {"name": name}
    elif each == "channel":
        for name in channels:
            yield words | {"name": name}
    elif each == "finger" and config.finger is not None:
        yield words | {
            "finger_body": config.finger.body,
            "finger_point": "finger",
        }


def _put(text: str, words: Mapping[str, str]) -> str:
    for key, word in words.items():
        text = text.replace("{" + key + "}", word)
    return text


def _entries(
    config: MechanismFile,
    tables: Mapping[str, _Table],
    channels: Mapping[str, list[str]],
    faults: list[str],
    *,
    tolerance: bool,
) -> Iterator[Entry]:
    section = "tolerances" if tolerance else "effects"
    for template, table in tables.items():
        for words in _each(config, table.each, channels):
            name = _put(template, words)
            try:
                entry = _entry(config, name, table, words, tolerance=tolerance)
            except InvalidParameter as error:
                faults.append(f"{section}.{name}: {error}")
                continue
            if entry is not None:
                yield entry


def _number(text: float | str, unit: str) -> float:
    if isinstance(text, (int, float)):
        return float(text)
    try:
        return parse_scalar(text, unit)
    except ValueError as error:
        raise InvalidParameter(str(error)) from None


def _magnitude(config: MechanismFile, table: _Table, words: Mapping[str, str], unit: str) -> float:
    given = [table.magnitude, table.magnitude_of, table.sd, table.magnitude_by_input or None]
    if sum(g is not None for g in given) != 1:
        raise InvalidParameter(
            "give exactly one of magnitude, magnitude_of, magnitude_by_input (effects), sd"
        )
    if table.magnitude_of is not None:
        of = table.magnitude_of
        entry = abs(float(read_entry(config, _put(of.path, words))))
        if entry == 0.0 and of.or_weight is not None:
            entry = of.or_weight * _weight_on(config, words["name"])
        return of.times * entry
    if table.magnitude_by_input:
        return table.magnitude_by_input["force"]
    value = table.magnitude if table.magnitude is not None else table.sd
    assert value is not None
    return _number(value, unit)


def _weight_on(config: MechanismFile, name: str) -> float:
    """Weight of the bodies that a joint carries [N], times the arm of its body on a hinge [N m]."""
    carried = {name}
    while more := {b for b, body in config.bodies.items() if body.parent in carried} - carried:
        carried |= more
    weight = math.hypot(*config.gravity) * sum(config.bodies[b].mass for b in carried)
    body = config.bodies[name]
    return weight if body.joint == "prismatic" else weight * math.hypot(*body.center_of_mass)


def _entry(
    config: MechanismFile,
    name: str,
    table: _Table,
    words: Mapping[str, str],
    *,
    tolerance: bool,
) -> Entry | None:
    unit = _put(table.unit, words)
    magnitude = _magnitude(config, table, words, unit if "{" not in unit else "1")
    if magnitude == 0.0:
        return None  # nothing to scale: for example, this joint has no friction
    changes = [
        Change(path=_put(c.path, words), scale=c.scale, exp=c.exp, add=c.add) for c in table.changes
    ]
    if table.felt:
        found = felt.changes(config, words["name"], table.felt)
        if found is None:
            return None
        changes += found
    if table.felt_all:
        touching = [number for number, contact in config.contacts.items() if contact.enabled]
        if not touching:
            return None
        for number in touching:
            changes += felt.changes(config, number, "stiffness", table.felt_all) or []
    if table.joints_all:
        changes += [
            Change(path=f"bodies.{b}.friction.amplitude", scale=table.joints_all)
            for b, body in config.bodies.items()
            if body.joint != "weld"
        ]
    for change in changes:
        read_entry(config, change.path)
    shapes: tuple[float | None, ...] = (None,)
    if table.shape is not None:
        shapes = tuple(table.shape.values)
        read_entry(config, _put(table.shape.path, words))
    insertion = _insertion(config, table.insert, words)
    ways = [changes, insertion, table.sensor, table.input]
    if sum(bool(w) for w in ways) != 1:
        raise InvalidParameter("give exactly one of changes or felt, insert, sensor, input")
    if tolerance and not changes:
        raise InvalidParameter("a tolerance moves entries of the mechanism: give changes or felt")
    label = _put(table.label, words)
    return Entry(
        name=name,
        kind=table.kind,
        component=_put(table.component, words) or label,
        mechanism=_put(table.mechanism, words) or label,
        unit=unit,
        magnitude=abs(magnitude),
        sign=table.sign,
        lower=-math.inf if table.lower is None else table.lower,
        upper=math.inf if table.upper is None else table.upper,
        step=0.05 if table.step is None else table.step,
        changes=tuple(changes),
        insertion=insertion,
        sensor=Signal(kind=table.sensor.kind, channels=_put(table.sensor.channels, words))
        if table.sensor
        else None,
        input=Signal(kind=table.input.kind) if table.input else None,
        condition=Condition(**table.condition.model_dump()) if table.condition else None,
        shape_path=_put(table.shape.path, words) if table.shape else "",
        shapes=shapes,
        shape_unit=_put(table.shape.unit, words) if table.shape else "",
        remedy=_put(table.remedy, words),
        source=table.source,
        part=_put(table.part, words),
    )


def _insertion(
    config: MechanismFile, table: _InsertTable | None, words: Mapping[str, str]
) -> Insertion | None:
    if table is None:
        return None
    given: dict[str, Any] = {
        k: v for k, v in table.model_dump().items() if v is not None and k != "point"
    }
    given["body"] = _put(table.body, words)
    if given["body"] not in config.bodies:
        raise InvalidParameter(f"insert: body {given['body']!r} is missing")
    point = table.point
    if isinstance(point, str):
        assert config.finger is not None
        point = config.finger.point
    if point is not None:
        given["point"] = point
    return Insertion(**given)
