"""Library of effects and tolerances: TOML tables, expanded for one mechanism.

A table defines one effect, or, with ``for``, one effect for each joint, contact, beam and so on.
The results are :class:`~feltmb.adapters.changes.Entry` objects.
"""

from __future__ import annotations

import fnmatch
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field
from scipy.optimize import brentq

from feltmb import params
from feltmb.adapters.changes import Change, Entry, EntryKeys
from feltmb.mechanism import Action, Body, Contact, Curve, MechanismFile
from feltmb.mechanism.numbers import read_entry
from feltmb.quantities import SI
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.files import MOST_EXTENDS, read_toml
from unmodeled.units.quantity import Schema, fault_text, parse_scalar, validated

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


class _MagnitudeOf(Schema):
    path: str
    times: Annotated[float, Field(gt=0)]
    or_weight: Annotated[float, Field(gt=0)] | None = None
    """If the entry is zero: share of the weight on a slider, or of its moment on a hinge."""


class _Table(EntryKeys):
    """One effect or tolerance of the file, or one for each part of a kind."""

    each: Annotated[Each, Field(alias="for")] = ""
    label: str = ""
    magnitude: float | str | None = None
    magnitude_of: _MagnitudeOf | None = None
    sd: float | str | None = None
    felt: Literal["", "stiffness", "hardening", "thickness"] = ""
    felt_all: float = 0.0
    joints_all: float = 0.0
    note: str = ""


class Until(Schema):
    """Part of a record that is used if records are simulated as a whole."""

    output: str
    """Output whose first reversal is the end of the stroke."""
    after_turn: Annotated[float, SI("s"), Field(ge=0)]
    """Time after the reversal that is used [s]."""


class _Defaults(Schema):
    channels: list[str] = []
    until: Until | None = None
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
class Library:
    """Effects, tolerances and channels of a mechanism."""

    name: str
    tolerances: tuple[Entry, ...]
    effects: tuple[Entry, ...]
    channels: Mapping[str, tuple[str, ...]]
    default_channels: tuple[str, ...]
    until: Until | None

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
    known = {e.name: e for e in entries}
    out: dict[str, Entry] = {}
    faults = []
    for name in names:
        if name == "all":
            selected = list(entries)
        elif any(c in name for c in "*?["):
            selected = [e for e in entries if fnmatch.fnmatchcase(e.name, name)]
            if not selected:
                faults.append(f"{what} {name!r}: no name of library {library!r} matches")
        elif name in known:
            selected = [known[name]]
        else:
            near = near_names(name, known)
            faults.append(f"{what[:-1]} {name!r} is not in library {library!r}{near}")
            continue
        out |= {e.name: e for e in selected}
    if faults:
        raise InvalidParameter("\n".join(faults))
    return tuple(out.values())


def _read(path: Path, before: tuple[Path, ...] = ()) -> LibraryFile:
    file = validated(LibraryFile, read_toml(path), path.name)
    if file.extends is None:
        return file
    if len(before) >= MOST_EXTENDS:
        raise InvalidParameter(f"{path.name}: more than {MOST_EXTENDS} files extend one another")
    base_path = params.find(file.extends, "effects", "library", beside=path.parent)
    if base_path.resolve() in [p.resolve() for p in (*before, path)]:
        raise InvalidParameter(f"{path.name}: extends {file.extends!r}, which leads back to itself")
    base = _read(base_path, (*before, path))
    # What the base leaves out is not a tolerance that this file defines by the same name.
    defined = [re.sub(r"\{\w+\}", "*", name) for name in file.tolerances]
    out = base.defaults.without_tolerances
    kept = [n for n in out if not any(fnmatch.fnmatchcase(n, d) for d in defined)]
    defaults = {"without_tolerances": kept}
    defaults |= {k: getattr(file.defaults, k) for k in file.defaults.model_fields_set}
    return file.model_copy(
        update={
            "channels": base.channels | file.channels,
            "tolerances": base.tolerances | file.tolerances,
            "effects": base.effects | file.effects,
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

    Examples
    --------
    What may be off in the packaged upright:

    >>> import feltmb
    >>> from feltmb import adapters
    >>> library = adapters.load_library(feltmb.load_action("steinway45"))
    >>> len(library.effects) > 20
    True
    """
    if name_or_path is None:
        name_or_path = _library_of(action.name)
    path = params.find(name_or_path, "effects", "library")
    file = _read(path)
    config = action.config
    outputs = file.channels
    faults: list[str] = []
    # An entry by its own name, which comes later, takes the place of one for each part of a kind.
    tolerances = {
        e.name: e
        for e in _entries(config, file.tolerances, outputs, faults, tolerance=True)
        if e.name not in file.defaults.without_tolerances
    }
    effects = {e.name: e for e in _entries(config, file.effects, outputs, faults, tolerance=False)}
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
        tolerances=tuple(tolerances.values()),
        effects=tuple(effects.values()),
        channels={k: tuple(v) for k, v in outputs.items()},
        default_channels=tuple(file.defaults.channels)
        or tuple(f"{name}.{axis}" for name in config.points for axis in "xy"),
        until=until,
    )


def _slides(config: MechanismFile, body: Body) -> bool:
    """Whether a body is on a slider without mass, so that its pivot has a translation already."""
    above = config.bodies.get(body.parent)
    return above is not None and above.joint == "prismatic" and above.mass == 0.0


#: Table of a mechanism, and the condition of its items, by the ``for`` of a table of a library.
_TABLES: Mapping[Each, tuple[str, Callable[[Any], bool]]] = {
    "body": ("bodies", lambda b: b.mass > 0.0),
    "joint": ("bodies", lambda b: b.joint != "weld"),
    "pivot": ("bodies", lambda b: b.joint == "revolute"),
    "contact": ("contacts", lambda c: c.enabled),
    "rubbing contact": ("contacts", lambda c: c.enabled and c.friction.amplitude != 0.0),
    "beam": ("bodies", lambda b: b.kind == "beam" and not b.rigid),
    "rigid beam": ("bodies", lambda b: b.kind == "beam" and b.rigid and bool(
        b.young_modulus and b.second_moment)),
    "spring": ("springs", lambda s: s.enabled),
    "strap": ("straps", lambda s: s.enabled),
}  # fmt: skip


def _names(config: MechanismFile, channels: Iterable[str]) -> Mapping[Each, Iterable[str]]:
    """Names of the items to which a table applies, by its ``for``."""
    string = config.string
    found: dict[Each, Iterable[str]] = {
        "": [""],
        "string": [""] if string is not None and string.kind == "modal" else [],
        "point": config.points,
        "channel": channels,
        "finger": [] if config.finger is None else [config.finger.body],
    }
    for each, (table, holds) in _TABLES.items():
        found[each] = [n for n, item in getattr(config, table).items() if holds(item)]
    found["pivot"] = [n for n in found["pivot"] if not _slides(config, config.bodies[n])]
    return found


def _words(config: MechanismFile, each: Each, name: str) -> dict[str, str]:
    """Substitutions for an item to which a table applies."""
    if each in ("contact", "rubbing contact"):
        return {"name": name, "label": config.contacts[name].label or f"contact {name}"}
    body = config.bodies.get(name)
    if body is None or each in ("spring", "strap", "point", "channel"):
        return {"name": name, "label": name.replace("_", " ")}
    angular = body.joint == "revolute"
    return {
        "name": name,
        "label": body.label or name,
        "joint_force": "N m" if angular else "N",
        "joint_motion": "rad" if angular else "m",
    }


T = TypeVar("T")


def _filled(node: T, words: Mapping[str, str]) -> T:
    """A table with words in the place of ``{name}`` and so on."""
    out: Any = node
    if isinstance(node, str):
        for key, word in words.items():
            out = out.replace("{" + key + "}", word)
    elif isinstance(node, Schema):
        out = node.model_copy(update={k: _filled(v, words) for k, v in node})
    elif isinstance(node, list | tuple):
        out = type(node)(_filled(v, words) for v in node)
    return out  # type: ignore[no-any-return]


def _entries(
    config: MechanismFile,
    tables: Mapping[str, _Table],
    channels: Mapping[str, list[str]],
    faults: list[str],
    *,
    tolerance: bool,
) -> Iterator[Entry]:
    section, items = "tolerances" if tolerance else "effects", _names(config, channels)
    for template, table in tables.items():
        for item in items[table.each]:
            words = _words(config, table.each, item)
            name = _filled(template, words)
            try:
                entry = _entry(config, name, _filled(table, words), item)
                if entry is not None and tolerance and not entry.changes:
                    raise InvalidParameter(
                        "a tolerance moves entries of the mechanism: give changes or felt"
                    )
            except InvalidParameter as error:
                faults.append(f"{section}.{name}: {error}")
                continue
            if entry is not None:
                yield entry


def _magnitude(config: MechanismFile, table: _Table, item: str) -> float:
    given = [v for v in (table.magnitude, table.magnitude_of, table.sd) if v is not None]
    if len(given) != 1:
        raise InvalidParameter("give exactly one of magnitude, magnitude_of (effects), sd")
    of = given[0]
    if isinstance(of, _MagnitudeOf):
        entry = abs(float(read_entry(config, of.path)))
        if entry == 0.0 and of.or_weight is not None:
            entry = of.or_weight * _weight_on(config, item)
        return of.times * entry
    try:
        return abs(of if isinstance(of, float) else parse_scalar(of, table.unit))
    except ValueError as error:
        raise InvalidParameter(str(error)) from None


def _weight_on(config: MechanismFile, name: str) -> float:
    """Weight of the bodies that a joint carries [N], times the arm of its body on a hinge [N m]."""
    carried = {name}
    while more := {b for b, body in config.bodies.items() if body.parent in carried} - carried:
        carried |= more
    weight = math.hypot(*config.gravity) * sum(config.bodies[b].mass for b in carried)
    body = config.bodies[name]
    return weight if body.joint == "prismatic" else weight * math.hypot(*body.center_of_mass)


def _entry(config: MechanismFile, name: str, table: _Table, item: str) -> Entry | None:
    """The entry of a filled table for an item; None: the item has nothing that it changes."""
    magnitude = _magnitude(config, table, item)
    changes = _changes(config, table, item)
    if magnitude == 0.0 or changes is None:  # for example, this joint has no friction
        return None
    for path in (*(c.path for c in changes), *([table.shape.path] if table.shape else [])):
        read_entry(config, path)
    if table.insert is not None and table.insert.body not in config.bodies:
        raise InvalidParameter(f"insert: body {table.insert.body!r} is missing")
    ways = [changes, table.insert, table.sensor, table.input]
    if sum(bool(w) for w in ways) != 1:
        raise InvalidParameter("give exactly one of changes or felt, insert, sensor, input")
    given = {key: getattr(table, key) for key in EntryKeys.model_fields}
    given |= {key: given[key] or table.label for key in ("component", "mechanism")}
    given |= {"name": name, "magnitude": magnitude, "changes": tuple(changes)}
    return Entry.model_construct(**given)


def _changes(config: MechanismFile, table: _Table, item: str) -> list[Change] | None:
    """Changes of a table; None: its felt is none, or has no such law."""
    changes = list(table.changes)
    if table.felt:
        of_felt = felt_changes(config, item, table.felt)
        if of_felt is None:
            return None
        changes += of_felt
    if table.felt_all:
        touching = [number for number, contact in config.contacts.items() if contact.enabled]
        if not touching:
            return None
        for number in touching:
            changes += felt_changes(config, number, "stiffness", table.felt_all) or []
    if table.joints_all:
        changes += [
            Change(path=f"bodies.{b}.friction.amplitude", scale=table.joints_all)
            for b, body in config.bodies.items()
            if body.joint != "weld"
        ]
    return changes


#: Force that is unchanged when the hardening of a felt changes [N].
REFERENCE_FORCE = 5.0


def felt_changes(
    config: MechanismFile, contact: str, what: str, times: float = 1.0
) -> list[Change] | None:
    """Changes of the entries of a contact; None if its law does not have them.

    Parameters
    ----------
    what
        ``stiffness``: both curves are multiplied by 1 + times * magnitude. ``hardening``: the
        exponents b of both curves are multiplied by 1 + magnitude; their a is changed so that a
        exp(b e) is constant at the depth at which the loading curve gives 5 N. ``thickness``: the
        thickness of the felt is reduced by magnitude [m].
    """
    node = config.contacts[contact]
    if what == "thickness":
        return _thickness(config, node)
    if node.law == "hunt_crossley":
        path = f"contacts.{contact}.hunt_crossley.stiffness"
        return [Change(path=path, scale=times)] if what == "stiffness" else None
    if node.loading is None or node.unloading is None:
        return None
    out = []
    depth = _depth(node.loading)
    for branch in ("loading", "unloading"):
        path = f"contacts.{contact}.{branch}"
        if what == "stiffness":
            out += [Change(path=f"{path}.{k}", scale=times) for k in "ac"]
        else:
            b = getattr(node, branch).b
            out += [
                Change(path=f"{path}.a", exp=-b * depth),
                Change(path=f"{path}.b", scale=1.0),
            ]
    return out


def _depth(curve: Curve) -> float:
    """Compression at which the loading curve gives the reference force [m]."""

    def excess(e: float) -> float:
        power = min(curve.b * e, 40.0)
        return curve.a * e * math.exp(power) + curve.c * e - REFERENCE_FORCE

    deep = 1e-5
    while excess(deep) < 0.0 and deep < 1.0:
        deep *= 1.5
    return float(brentq(excess, 1e-7, deep)) if excess(deep) > 0.0 else 1e-3


def _thickness(config: MechanismFile, node: Contact) -> list[Change] | None:
    """Reduce the radius of the circle of the pair; with radius zero, move its line instead."""
    for name in node.surfaces:
        surface = config.surfaces[name]
        if surface.kind == "circle" and surface.radius:
            return [Change(path=f"surfaces.{name}.radius", add=-1.0)]
    for name in node.surfaces:
        surface = config.surfaces[name]
        if surface.kind == "line" and surface.normal is not None:
            return [
                Change(path=f"surfaces.{name}.point.{axis}", add=-n)
                for axis, n in zip("xy", surface.normal, strict=True)
                if n != 0.0
            ]
    return None
