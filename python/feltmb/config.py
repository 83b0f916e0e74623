"""Mechanisms as data: TOML file, validated description, immutable model.

The only place that knows the file format of mechanisms. ``load_action`` reads a packaged data set
or a file, :class:`Action` holds it, ``Action.with_values`` changes numbers by their dotted path.
"""

from __future__ import annotations

import copy
import hashlib
import json
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, ValidationError

from feltmb import _core, params
from feltmb.errors import InvalidParameter
from feltmb.files import is_file, read_toml
from feltmb.layer import LayerParameters
from feltmb.material import load_material
from feltmb.mending import mended
from feltmb.quantity import (
    META_KEYS,
    SI,
    Schema,
    SIVector,
    fault_lines,
    fault_text,
    is_quantity,
    parse_scalar,
    shortened,
)
from feltmb.units import conversion_factor

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

__all__ = ["Action", "load_action", "packaged_actions", "parse_setting"]

SCHEMA_VERSION = 1
LawName = Literal[
    "guarded", "printed", "mean", "hunt_crossley", "stulov", "felt_memory", "micromechanical"
]
LAWS: tuple[str, ...] = get_args(LawName)


def _curve(node: object) -> object:
    """Accept ``unit = [..]`` for the three coefficients of eq. 4.21 at once."""
    if not isinstance(node, Mapping):
        return node
    units = ("N/m", "1/m", "N/m")
    given = node.get("unit", units)
    if not isinstance(given, (list, tuple)) or len(given) != 3:
        raise ValueError(f"got unit {given!r}, expected three, such as {list(units)}")
    out = {key: node[key] for key in node if key not in META_KEYS}
    for key, unit in zip("abc", given, strict=True):
        if key in out and not isinstance(out[key], (Mapping, str)):
            out[key] = {"value": out[key], "unit": unit}
    return out


def _drop_meta(node: object) -> object:
    """Let a table carry its own source, status and note."""
    if not isinstance(node, Mapping):
        return node
    return {k: v for k, v in node.items() if k not in ("source", "status", "note", "printed")}


class Curve(Schema):
    """F(e) = a e exp(b e) + c e, thesis eq. 4.21."""

    a: Annotated[float, SI("N/m")]
    b: Annotated[float, SI("1/m"), Field(ge=0)]
    c: Annotated[float, SI("N/m")]


class HuntCrossleyParameters(Schema):
    """F = k e^p (1 + d de/dt)."""

    stiffness: Annotated[float, Field(gt=0), BeforeValidator(lambda n: _power_stiffness(n))]
    exponent: Annotated[float, SI("1"), Field(ge=1)] = 1.5
    damping: Annotated[float, SI("s/m"), Field(ge=0)] = 0.0


class StulovParameters(Schema):
    """F = F0 max(0, e^p - amplitude g), tau0 dg/dt = e^p - g."""

    stiffness: Annotated[float, Field(gt=0), BeforeValidator(lambda n: _power_stiffness(n))]
    exponent: Annotated[float, SI("1"), Field(ge=1)] = 2.5
    amplitude: Annotated[float, SI("1"), Field(ge=0, lt=1)] = 0.0
    time: Annotated[float, SI("s"), Field(gt=0)] = 1e-5


class EnvelopeTable(Schema):
    """A measured or computed loop: both branches at the same compressions."""

    unit: list[str] = ["m", "N"]
    compression: list[float]
    loading: list[float]
    unloading: list[float]


class MemoryParameters(Schema):
    """Options of the law with memory; the curves come from loading and unloading, or a table."""

    kappa: Annotated[float, SI("1"), Field(gt=0, le=2)] = 0.2
    closing_compression: Annotated[float, SI("m"), Field(gt=0)] | None = None
    envelope: EnvelopeTable | None = None
    recovery_time: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    creep_stiffness: Annotated[float, SI("N/m"), Field(ge=0)] = 0.0
    creep_damping: Annotated[float, SI("N s/m"), Field(ge=0)] = 0.0
    rate_amplitude: Annotated[float, SI("1"), Field(ge=0)] = 0.0
    rate_time: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    note: str = ""


def _power_stiffness(node: object) -> float:
    """Stiffness of a power law; its unit N/m^p depends on the exponent, so only N and m scale."""
    if isinstance(node, Mapping) and isinstance(node.get("unit"), str):
        unit = node["unit"]
        if not unit.startswith("N/m^") and unit != "N/m":
            raise ValueError(f"got unit {unit!r}, expected 'N/m^p' with the exponent p of the law")
        return parse_scalar({k: v for k, v in node.items() if k != "unit"}, "1")
    return parse_scalar(node, "1")


class FrictionParameters(Schema):
    """Coulomb friction of thesis eq. A.1, with viscous, quadratic and Stribeck terms."""

    amplitude: Annotated[
        float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("1", "N", "N m")))
    ] = 0.0
    b1: Annotated[float, SI("1"), Field(ge=0)] = 0.0
    b2: Annotated[float, SI("1"), Field(ge=0)] = 0.0
    threshold_speed: Annotated[
        float, Field(gt=0), BeforeValidator(lambda n: _one_of(n, ("m/s", "rad/s")))
    ] = 1e-3
    viscous: Annotated[
        float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("N m s/rad", "N s/m", "s/m")))
    ] = 0.0
    quadratic: Annotated[
        float,
        Field(ge=0),
        BeforeValidator(lambda n: _one_of(n, ("N m s^2/rad^2", "N s^2/m^2", "s^2/m^2"))),
    ] = 0.0
    stribeck: Annotated[
        float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("1", "N", "N m")))
    ] = 0.0
    stribeck_speed: Annotated[
        float, Field(gt=0), BeforeValidator(lambda n: _one_of(n, ("m/s", "rad/s")))
    ] = 0.1


def _one_of(node: object, units: tuple[str, ...]) -> float:
    """Friction amplitudes and speeds are linear or angular: a quantity in any of ``units``."""
    for si in units:
        try:
            return parse_scalar(node, si)
        except ValueError as error:
            if "does not measure" not in str(error):
                raise
    unit = node["unit"] if isinstance(node, Mapping) else node
    raise ValueError(f"got unit {unit!r}, expected a unit of {', '.join(units)}")


Friction = Annotated[FrictionParameters, BeforeValidator(_drop_meta)]


class Body(Schema):
    """A rigid body or a uniform beam, and the joint to its parent."""

    label: str = ""
    note: str = ""
    kind: Literal["rigid", "beam"] = "rigid"
    parent: str = "ground"
    joint: Literal["revolute", "prismatic", "weld"] = "revolute"
    coordinate: str = ""
    position: Annotated[tuple[float, float], SIVector("m")] = (0.0, 0.0)
    axis: Annotated[tuple[float, float], SIVector("1")] = (0.0, 1.0)
    angle: Annotated[float, SI("rad")] = 0.0
    friction: Friction = FrictionParameters()
    mass: Annotated[float, SI("kg"), Field(ge=0)] = 0.0
    center_of_mass: Annotated[tuple[float, float], SIVector("m")] = (0.0, 0.0)
    inertia: Annotated[float, SI("kg m^2"), Field(ge=0)] = 0.0
    rigid: bool = True
    length: Annotated[float, SI("m"), Field(gt=0)] | None = None
    density: Annotated[float, SI("kg/m^3"), Field(gt=0)] | None = None
    area: Annotated[float, SI("m^2"), Field(gt=0)] | None = None
    young_modulus: Annotated[float, SI("Pa"), Field(gt=0)] | None = None
    second_moment: Annotated[float, SI("m^4"), Field(gt=0)] | None = None
    shapes: Literal["polynomial", "clamped_free", "craig_bampton"] = "polynomial"
    axial_shapes: Annotated[int, Field(ge=0, le=12)] = 1
    lateral_shapes: Annotated[int, Field(ge=1, le=12)] = 2
    damping_time: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    condense_axial: bool = True


class Surface(Schema):
    """A contact surface fixed to a body."""

    body: str
    kind: Literal["line", "circle", "concave", "hybrid"]
    point: Annotated[tuple[float, float], SIVector("m")]
    normal: Annotated[tuple[float, float], SIVector("1")] | None = None
    radius: Annotated[float, SI("m"), Field(ge=0)] | None = None
    arc: Annotated[tuple[float, float], SIVector("rad")] | None = None
    note: str = ""


class LawChoice(Schema):
    """A contact law with the parameters of all that may be chosen."""

    law: LawName = "felt_memory"
    alpha: Annotated[float, SI("s/m"), Field(gt=0)] = 100.0
    hysteresis: Annotated[float, SI("1"), Field(ge=0)] = 1.0
    loading: Annotated[Curve, BeforeValidator(_curve)] | None = None
    unloading: Annotated[Curve, BeforeValidator(_curve)] | None = None
    hunt_crossley: HuntCrossleyParameters | None = None
    stulov: StulovParameters | None = None
    memory: MemoryParameters = MemoryParameters()
    micromechanical: LayerParameters | None = None


class Contact(LawChoice):
    """Two surfaces, a law and friction."""

    label: str = ""
    note: str = ""
    surfaces: tuple[str, str]
    enabled: bool = True
    friction: Friction = FrictionParameters()


class Spring(Schema):
    """Spring on the coordinate of a joint, with damping and play if wanted."""

    label: str = ""
    coordinate: str
    stiffness: Annotated[
        float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("N m/rad", "N/m")))
    ]
    rest_angle: Annotated[float, BeforeValidator(lambda n: _one_of(n, ("rad", "m")))]
    damping: Annotated[
        float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("N m s/rad", "N s/m")))
    ] = 0.0
    clearance: Annotated[
        float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("rad", "m")))
    ] = 0.0
    seating: Annotated[float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("N m", "N")))] = (
        0.0
    )
    enabled: bool = True


class Dashpot(Schema):
    """Dashpot on a joint's coordinate, on one side of its motion only if so wanted."""

    label: str = ""
    coordinate: str
    coefficient: Annotated[
        float, Field(ge=0), BeforeValidator(lambda n: _one_of(n, ("N m s/rad", "N s/m")))
    ]
    side: Literal["both", "positive", "negative"] = "both"
    enabled: bool = True


class Strap(Schema):
    """One-sided cubic strap, thesis eq. 4.5."""

    label: str = ""
    body_a: str
    point_a: Annotated[tuple[float, float], SIVector("m")]
    body_b: str
    point_b: Annotated[tuple[float, float], SIVector("m")]
    free_length: Annotated[float, SI("m"), Field(gt=0)]
    k1: Annotated[float, SI("N/m")] = 0.0
    k2: Annotated[float, SI("N/m^2")] = 0.0
    k3: Annotated[float, SI("N/m^3")] = 0.0
    enabled: bool = True


def _strike_point(node: object) -> object:
    return node if node == "moving" else parse_scalar(node, "m")


class String(Schema):
    """Stiff string of thesis Table 4.1."""

    kind: Literal["modal", "rigid_stop"] = "modal"
    surface: str
    modes: Annotated[int, Field(ge=1, le=5000)] = 40
    diameter: Annotated[float, SI("m"), Field(gt=0)]
    tension: Annotated[float, SI("N"), Field(gt=0)]
    length: Annotated[float, SI("m"), Field(gt=0)]
    linear_density: Annotated[float, SI("kg/m"), Field(gt=0)]
    young_modulus: Annotated[float, SI("Pa"), Field(ge=0)]
    damping_ratio: Annotated[float, SI("1"), Field(ge=0, lt=1)] = 0.0
    anchor: Annotated[float, SI("m"), Field(ge=0)] = 0.0
    direction: Annotated[tuple[float, float], SIVector("1")] = (0.0, -1.0)
    strike_point: Annotated[Literal["moving"] | float, BeforeValidator(_strike_point)] = "moving"
    note: str = ""


class Pad(HuntCrossleyParameters):
    """Finger pad between a prescribed finger motion and the key."""

    law: Literal["hunt_crossley"] = "hunt_crossley"


class Finger(Schema):
    """Where the player's finger meets the mechanism."""

    body: str
    point: Annotated[tuple[float, float], SIVector("m")]
    direction: Annotated[tuple[float, float], SIVector("1")] = (0.0, -1.0)
    pad: Pad = Pad(stiffness=1.1e5, exponent=1.5, damping=1.0)


class Motor(Schema):
    """A motor on a revolute joint, which drives the mechanism instead of a finger."""

    coordinate: str
    contact: int | None = None
    note: str = ""


class Point(Schema):
    """Tracking point."""

    body: str
    point: Annotated[tuple[float, float], SIVector("m")]
    label: str = ""


class NamedEvent(Schema):
    """A contact change or a travel of a tracking point that gets a name."""

    contact: int | list[int] | None = None
    change: Literal["opens", "closes"] | None = None
    point: str | None = None
    direction: Annotated[tuple[float, float], SIVector("1")] = (0.0, 1.0)
    travel: Annotated[float, SI("m"), Field(gt=0)] | None = None
    which: Literal["first", "last"] = "first"
    before: str | None = None
    after: str | None = None
    within: Annotated[float, SI("s"), Field(gt=0)] | None = None


class SummaryRoles(Schema):
    """Which contacts and points the summary of a run reads."""

    strike_contact: int | None = None
    let_off_contact: int | None = None
    check_contacts: list[int] = []
    key_point: str | None = None


class Source(Schema):
    """Where a data set comes from."""

    cite: str = ""
    status: str = ""
    note: str = ""


class MechanismFile(Schema):
    """A mechanism file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    about: str = ""
    source: Source = Source()
    gravity: Annotated[tuple[float, float], SIVector("m/s^2")] = (0.0, -9.81)
    bodies: dict[str, Body]
    surfaces: dict[str, Surface] = {}
    contacts: dict[str, Contact] = {}
    springs: dict[str, Spring] = {}
    dashpots: dict[str, Dashpot] = {}
    straps: dict[str, Strap] = {}
    string: String | None = None
    finger: Finger | None = None
    motor: Motor | None = None
    points: dict[str, Point] = {}
    start_pose: dict[str, float] = {}
    events: dict[str, NamedEvent] = {}
    summary: SummaryRoles = SummaryRoles()


# --- reading -------------------------------------------------------------------------------------


def packaged_actions() -> list[str]:
    """Names of the data sets of mechanisms that come with the package."""
    return params.names()


def _resolve(name_or_path: str | Path) -> Path:
    text = str(name_or_path)
    if text in packaged_actions():
        return params.folder() / f"{text}.toml"
    path = Path(text)
    if is_file(path):
        return path
    if path.suffix == ".toml" or len(path.parts) != 1:
        raise InvalidParameter(f"mechanism {shortened(repr(text))}: there is no such file")
    known = ", ".join(packaged_actions())
    raise InvalidParameter(
        f"mechanism {shortened(repr(text))} is unknown; packaged are {known}; "
        "or give the path of a TOML file"
    )


def load_raw(
    path: Path, resolve: Callable[[str], Path], seen: tuple[Path, ...] = ()
) -> dict[str, Any]:
    """Tables of a file, on top of those that it extends; ``resolve`` finds a base by its name."""
    raw = _felts_in_place(read_toml(path), path.parent)
    if "extends" not in raw:
        return raw
    unknown = sorted(set(raw) - {"schema", "name", "about", "source", "extends", "values"})
    if unknown:
        raise InvalidParameter(
            f"{path}: a file with 'extends' holds name, about, source and [values] only; "
            f"got {', '.join(unknown)}"
        )
    base = raw["extends"]
    if not isinstance(base, str):
        raise InvalidParameter(f"{path}: extends: got {base!r}, expected a name or a path")
    base_path = path.parent / base if base.endswith(".toml") else resolve(base)
    if base_path.resolve() in [p.resolve() for p in (*seen, path)]:
        raise InvalidParameter(f"{path}: extends {base!r}, which leads back to itself")
    merged = load_raw(base_path, resolve, (*seen, path))
    for key in ("name", "about", "source"):
        if key in raw:
            merged[key] = raw[key]
    values = raw.get("values", {})
    if not isinstance(values, Mapping):
        raise InvalidParameter(f"{path}: values: expected a table of dotted paths")
    for key, value in values.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            inner = f"{key}.{next(iter(value), 'KEY')}"
            raise InvalidParameter(
                f'{path}: values.{key}: got a table; write paths in quotes, such as "{inner}" = ...'
            )
    return apply_values(merged, values, str(path))


def _felts_in_place(raw: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Felts that a file names by a path beside it become tables: the mechanism is then whole."""

    def whole(node: Any) -> Any:
        if not isinstance(node, Mapping):
            return node
        out = {key: whole(value) for key, value in node.items()}
        felt = out.get("felt")
        if isinstance(felt, str) and felt.endswith(".toml"):
            out["felt"] = load_material(folder / felt).model_dump(
                mode="json", by_alias=True, exclude_none=True
            )
        return out

    out = dict(raw)
    for key in ("contacts", "values"):
        if isinstance(raw.get(key), Mapping):
            out[key] = whole(raw[key])
    return out


def load_action(name_or_path: str | Path) -> Action:
    """Read a mechanism: the name of a packaged data set, or the path of a TOML file.

    Raises
    ------
    InvalidParameter
        Listing all faults of the file at once.
    """
    path = _resolve(name_or_path)
    return Action(load_raw(path, _resolve), origin=path.name)


# --- changing values -----------------------------------------------------------------------------


def parse_setting(text: str) -> tuple[str, Any]:
    """Split ``"string.modes=80"`` into its path and its value, read as TOML, else as text."""
    path, sign, value = text.partition("=")
    if not sign or not path.strip():
        raise InvalidParameter(f"--set {text!r}: expected PATH=VALUE, such as string.modes=80")
    try:
        return path.strip(), tomllib.loads(f"v = {value}")["v"]
    except (ValueError, RecursionError):  # no TOML
        return path.strip(), value.strip()


def _expand(raw: Mapping[str, Any], path: str) -> list[list[str]]:
    """Paths that ``path`` names: ``*`` matches any key; a body's name stands for bodies.NAME."""
    parts = path.split(".")
    if parts[0] not in raw and parts[0] in raw.get("bodies", {}):
        parts = ["bodies", *parts]
    # Coordinates hold a dot; they are keys of start_pose only.
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
        # A bare number keeps the unit of the entry; what was said of the old number is void.
        unit = node[last].get("unit", "1")
        node[last] = {"value": value, "unit": unit, "note": f"set by {where}"}
    else:
        node[last] = copy.deepcopy(value)


def _set_component(old: Any, key: str, value: Any, where: str, parts: list[str]) -> list[Any]:
    index = _AXES.get(key, int(key) if key.isdecimal() else -1)
    if not isinstance(old, list) or not 0 <= index < len(old):
        raise InvalidParameter(f"{where}: path {'.'.join(parts)!r} does not exist")
    new = list(old)
    new[index] = value
    return new


def apply_values(raw: Mapping[str, Any], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Tables with other values by dotted path; ``where`` names the caller in messages."""
    if not isinstance(values, Mapping):
        raise InvalidParameter(f"{where}: got {shortened(repr(values))}, expected paths and values")
    out = copy.deepcopy(dict(raw))
    faults = []
    for path, value in values.items():
        try:
            if not isinstance(path, str):
                raise InvalidParameter(f"{where}: path {path!r}: expected a text with dots")
            for parts in _expand(out, path):
                _set_one(out, parts, value, where)
        except InvalidParameter as error:
            faults.append(str(error))
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


#: Tables of parts whose numbers refer to nothing else in the file.
_TABLES_OF_NUMBERS = ("bodies", "surfaces", "contacts", "springs", "straps", "points")


def _apply_numbers(
    raw: Mapping[str, Any], values: Mapping[str, Any]
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Tables with other numbers, sharing the rest, and the parts touched.

    ValueError if one of the values is more than a number of a part.
    """
    out = dict(raw)
    touched: list[tuple[str, str]] = []
    if not isinstance(values, Mapping) or not all(isinstance(path, str) for path in values):
        raise ValueError("paths and values")
    for path, value in values.items():
        number = value.item() if hasattr(value, "item") else value
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            raise ValueError(path)
        for parts in _expand(out, path):
            if len(parts) < 3 or parts[0] not in _TABLES_OF_NUMBERS:
                raise ValueError(path)
            table, key = parts[:2]
            if (table, key) not in touched:
                touched.append((table, key))
                out[table] = {**out[table], key: copy.deepcopy(out[table][key])}
            _set_one(out, parts, number, "with_values")
    return out, touched


# --- checking ------------------------------------------------------------------------------------


_DEEPEST = 50  # tables and lists within one another


def plain_data(node: Any, depth: int = 0) -> Any:
    """Copy of a file's tables that holds nothing of NumPy."""
    if depth > _DEEPEST:
        raise InvalidParameter("tables are nested too deeply")
    if isinstance(node, Mapping):
        return {key: plain_data(value, depth + 1) for key, value in node.items()}
    if isinstance(node, (list, tuple)):
        return [plain_data(value, depth + 1) for value in node]
    return node.tolist() if hasattr(node, "tolist") else node


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
    """Events that must have happened, or not, before ``name`` is known."""
    behind: set[str] = set()
    ahead = [name]
    while ahead:
        node = events.get(ahead.pop())
        for key in ("after", "before"):
            other = node.get(key) if isinstance(node, Mapping) else None
            if isinstance(other, str) and other not in behind:
                behind.add(other)
                ahead.append(other)
    return behind


def _reference_faults(raw: Mapping[str, Any]) -> list[str]:
    """Names that point nowhere; looked for in the raw file so that they join the other faults."""
    faults: list[str] = []
    bodies = {"ground", *_table(raw, "bodies")}
    surfaces = set(_table(raw, "surfaces"))
    points = set(_table(raw, "points"))
    given = [b.get("coordinate") for b in _table(raw, "bodies").values() if isinstance(b, Mapping)]
    coordinates = {c for c in given if isinstance(c, str) and c}
    numbers = set()

    def need(name: object, known: set[Any], where: str, what: str) -> None:
        if isinstance(name, str) and name not in known:
            listed = ", ".join(sorted(map(str, known))) or "none"
            faults.append(f"{where}: {what} {name!r} is missing; {what} names are {listed}")

    for key in _table(raw, "contacts"):
        if not (key.isascii() and key.isdigit()) or not 2 <= len(key) <= 4:
            faults.append(f"contacts.{key}: expected a number of two digits, such as contacts.06")
        else:
            numbers.add(int(key))
    for table, fields in (
        ("bodies", ("parent",)),
        ("surfaces", ("body",)),
        ("points", ("body",)),
        ("straps", ("body_a", "body_b")),
    ):
        for name, node in _table(raw, table).items():
            for field in fields:
                if isinstance(node, Mapping):
                    need(node.get(field), bodies, f"{table}.{name}.{field}", "body")
    for name, node in _table(raw, "contacts").items():
        listed = node.get("surfaces") if isinstance(node, Mapping) else None
        for surface in listed if isinstance(listed, list) else []:
            need(surface, surfaces, f"contacts.{name}.surfaces", "surface")
    for table in ("springs", "dashpots"):
        for name, node in _table(raw, table).items():
            if isinstance(node, Mapping):
                where = f"{table}.{name}.coordinate"
                need(node.get("coordinate"), coordinates, where, "coordinate")
    for name in _table(raw, "start_pose"):
        need(name, coordinates, "start_pose", "coordinate")
    need(_table(raw, "string").get("surface"), surfaces, "string.surface", "surface")
    need(_table(raw, "finger").get("body"), bodies, "finger.body", "body")
    motor = _table(raw, "motor")
    need(motor.get("coordinate"), coordinates, "motor.coordinate", "coordinate")
    if isinstance(motor.get("contact"), int) and motor["contact"] not in numbers:
        faults.append(f"motor.contact: there is no contact {motor['contact']}")
    events = set(_table(raw, "events"))
    for name, node in _table(raw, "events").items():
        if not isinstance(node, Mapping):
            continue
        where = f"events.{name}"
        need(node.get("point"), points, f"{where}.point", "point")
        need(node.get("before"), events, f"{where}.before", "event")
        need(node.get("after"), events, f"{where}.after", "event")
        listed = node.get("contact")
        for number in listed if isinstance(listed, list) else [listed]:
            if isinstance(number, int) and number not in numbers:
                faults.append(f"{where}.contact: there is no contact {number}")
        if ("contact" in node) == ("point" in node):
            faults.append(f"{where}: give either contact and change, or point and travel")
        elif "contact" in node and "change" not in node:
            faults.append(f"{where}: a contact event needs change = 'opens' or 'closes'")
        elif "point" in node and "travel" not in node:
            faults.append(f"{where}: a point event needs travel")
        if name in _events_behind(name, _table(raw, "events")):
            faults.append(f"{where}: waits for itself through 'after' and 'before'")
    summary = _table(raw, "summary")
    for key in ("strike_contact", "let_off_contact"):
        if isinstance(summary.get(key), int) and summary[key] not in numbers:
            faults.append(f"summary.{key}: there is no contact {summary[key]}")
    listed = summary.get("check_contacts")
    for number in listed if isinstance(listed, list) else []:
        if isinstance(number, int) and number not in numbers:
            faults.append(f"summary.check_contacts: there is no contact {number}")
    need(summary.get("key_point"), points, "summary.key_point", "point")
    return faults


_OWN_OUTPUTS = (
    *("time", "end_state", "end_memory", "finger.force", "finger.displacement", "motor.torque"),
    *("string.strike", "string.bridge_force", "string.eta"),
    *(f"energy.{part}" for part in ("kinetic", "gravity", "elastic", "contact", "string")),
)


def _output_faults(raw: Mapping[str, Any]) -> list[str]:
    """Names of outputs that no file can hold, or that two of them would share."""
    bodies = [b for b in _table(raw, "bodies").values() if isinstance(b, Mapping)]
    names = {str(b["coordinate"]) for b in bodies if isinstance(b.get("coordinate"), str)}
    outputs = [*_OWN_OUTPUTS, *names, *(f"{name}.rate" for name in names)]
    for table, parts in (
        ("points", ("x", "y", "vx", "vy")),
        ("straps", ("force",)),
    ):
        outputs += [f"{name}.{part}" for name in _table(raw, table) for part in parts]
    for key in _table(raw, "contacts"):
        parts = ("force", "compression", "rate", "friction")
        outputs += [f"contact{key}.{part}" for part in parts]
    faults = [
        f"output {name!r}: the name of a coordinate, point or strap must hold no '/'"
        for name in outputs
        if "/" in name or "\0" in name
    ]
    twice = {name for name in outputs if outputs.count(name) > 1}
    return faults + [
        f"output {name!r} would be given twice; rename the coordinate, point or strap"
        for name in sorted(twice)
    ]


#: Where the parameters of a law stand in a contact; others stand in the contact itself.
_LAW_TABLE = {
    "hunt_crossley": "hunt_crossley",
    "stulov": "stulov",
    "felt_memory": "memory",
    "micromechanical": "micromechanical",
    "guarded": "memory",
    "printed": "memory",
}
_LAW_CURVES = ("loading", "unloading", "alpha", "hysteresis")


def spread_laws(raw: dict[str, Any], faults: list[str]) -> dict[str, Any]:
    """``law = { name = ..., ... }`` as ``law = name`` with the parameters where they belong."""
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
        curves = {k: own.pop(k) for k in _LAW_CURVES if k in own}
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
    """A fault in the parameters of ``law = { ... }``, at the place where they were written."""
    where = line.split(":")[0].split(".")
    if len(where) > 3 and where[2] in _LAW_TABLE.values():
        node = contacts.get(where[1])
        if isinstance(node, Mapping) and isinstance(node.get("law"), Mapping):
            return line.replace(f".{where[1]}.{where[2]}.", f".{where[1]}.law.", 1)
    return line


def _pair_radii(config: MechanismFile, contact: Contact) -> tuple[float | None, float | None]:
    """Relative radius of a pair of surfaces and, on a string, that of the string [m]."""
    pair = [config.surfaces[name] for name in contact.surfaces if name in config.surfaces]
    curvature = sum(
        0.0 if s.kind == "line" else (-1.0 if s.kind == "concave" else 1.0) / (s.radius or math.inf)
        for s in pair
    )
    on_string = config.string is not None and config.string.surface in contact.surfaces
    wire = 0.5 * config.string.diameter if config.string is not None and on_string else None
    return (1.0 / curvature if curvature > 0.0 else None), wire


def _with_radii(config: MechanismFile) -> MechanismFile:
    """Radii that the areas of layers leave out are those of the pair."""
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


def missing_law_faults(node: Mapping[str, Any], where: str) -> list[str]:
    """What the law chosen in a raw table needs and does not find there."""
    law = node.get("law", "felt_memory")
    memory = node.get("memory")
    tabulated = isinstance(memory, Mapping) and "envelope" in memory
    needed = {
        "hunt_crossley": ["hunt_crossley"],
        "stulov": ["stulov"],
        "felt_memory": [] if tabulated else ["loading", "unloading"],
        "micromechanical": ["micromechanical"],
    }.get(str(law), ["loading", "unloading"])
    return [
        f"{where}.{key}: is missing; law {law!r} needs it"
        for key in needed
        if law in LAWS and key not in node
    ]


def _law_faults(raw: Mapping[str, Any]) -> list[str]:
    faults = []
    for name, node in _table(raw, "contacts").items():
        if isinstance(node, Mapping):
            faults += missing_law_faults(node, f"contacts.{name}")
    for name, node in _table(raw, "surfaces").items():
        if not isinstance(node, Mapping):
            continue
        kind = node.get("kind")
        geometry = {"line": ["normal"], "hybrid": ["radius", "arc"]}.get(str(kind), ["radius"])
        if kind in ("line", "circle", "concave", "hybrid"):
            for key in geometry:
                if key not in node:
                    faults.append(f"surfaces.{name}.{key}: is missing; kind {kind!r} needs it")
    for name, node in _table(raw, "bodies").items():
        if not isinstance(node, Mapping):
            continue
        if node.get("kind") == "beam":
            for key in ("length", "density", "area"):
                if node.get(key) is None:
                    faults.append(f"bodies.{name}.{key}: is missing; kind 'beam' needs it")
            if node.get("rigid") is False:
                for key in ("young_modulus", "second_moment"):
                    if node.get(key) is None:
                        faults.append(f"bodies.{name}.{key}: is missing; a flexible beam needs it")
        if node.get("joint", "revolute") != "weld" and "coordinate" not in node:
            faults.append(f"bodies.{name}.coordinate: is missing; a joint that moves needs a name")
    return faults


def _parse(raw: Mapping[str, Any]) -> tuple[list[str], MechanismFile | None]:
    """What is wrong with single entries and with the names between them; the checked tables."""
    faults: list[str] = []
    raw_laws, raw = _table(raw, "contacts"), spread_laws(dict(raw), faults)
    parsed: MechanismFile | None = None
    try:
        parsed = MechanismFile.model_validate(raw)
    except ValidationError as error:
        faults += [_as_written(line, raw_laws) for line in fault_lines(error, MechanismFile)]
    faults += _reference_faults(raw)
    faults += _law_faults(raw)
    faults += _output_faults(raw)
    for path in _paths_of_none(raw):
        if not any(f.startswith(f"{path}:") for f in faults):
            faults.append(f"{path}: got None, expected a value; leave the key out for its default")
    # Radii come from the pair, which a fault may have left without any.
    return list(dict.fromkeys(faults)), parsed if faults or parsed is None else _with_radii(parsed)


def _assemble(config: MechanismFile) -> tuple[list[str], Any]:
    """What is wrong with the whole, as the core tells it; the mechanism of the core."""
    description, faults = _describe(config)
    try:
        mechanism = _core.assemble(description)
    except InvalidParameter as error:
        lines = str(error).splitlines()
        found = [line.strip() for line in lines[1:]] or lines
        if faults:  # contacts are left out of the description
            found = [f for f in found if "no contact uses its surface" not in f]
        return faults + found, None
    return faults, mechanism


def _hidden_faults(raw: Mapping[str, Any]) -> list[str]:
    """Faults that the core finds in what the schema lets pass of a faulty file."""
    found = mended(raw, lambda tables: _parse(tables)[0])
    if found is None:
        return []
    rest, dropped = found
    parsed = _parse(rest)[1]
    if parsed is None:
        return []
    bodies = {path.split(".")[1] for path in dropped if path.startswith("bodies.")}
    # A body that lost an entry may lack a mass only because of that.
    return [
        f
        for f in _assemble(parsed)[0]
        if not any(f'"{name}"' in f for name in bodies)
        and not (bodies and ("moves no mass" in f or "no body has a joint" in f))
        and "no contact uses its surface" not in f
    ]


def _validate(raw: Mapping[str, Any], origin: str) -> tuple[MechanismFile, Any]:
    """The checked file and the mechanism of the core."""
    faults, config = _parse(raw)
    mechanism = None
    if faults or config is None:
        faults += _hidden_faults(raw)
    else:
        faults, mechanism = _assemble(config)
    if faults or config is None:
        raise InvalidParameter(fault_text(origin, list(dict.fromkeys(faults))))
    return config, mechanism


# --- from the file to the core -------------------------------------------------------------------


def _core_friction(f: FrictionParameters) -> _core.Friction:
    return _core.Friction(
        amplitude=f.amplitude,
        b1=f.b1,
        b2=f.b2,
        threshold_speed=f.threshold_speed,
        viscous=f.viscous,
        quadratic=f.quadratic,
        stribeck=f.stribeck,
        stribeck_speed=f.stribeck_speed,
    )


def _core_hunt_crossley(p: HuntCrossleyParameters) -> _core.HuntCrossley:
    return _core.HuntCrossley(stiffness=p.stiffness, exponent=p.exponent, damping=p.damping)


def core_law(contact: LawChoice) -> Any:
    """Law parameters of a contact for the core."""
    if contact.law == "hunt_crossley":
        assert contact.hunt_crossley is not None
        return _core_hunt_crossley(contact.hunt_crossley)
    if contact.law == "stulov":
        assert contact.stulov is not None
        st = contact.stulov
        return _core.Stulov(
            stiffness=st.stiffness, exponent=st.exponent, amplitude=st.amplitude, time=st.time
        )
    if contact.law == "micromechanical":
        assert contact.micromechanical is not None
        return _core_memory(contact.micromechanical, contact.micromechanical.envelope)
    if contact.law == "felt_memory" and contact.memory.envelope is not None:
        return _core_memory(contact.memory, _table_envelope(contact.memory.envelope))
    assert contact.loading is not None
    assert contact.unloading is not None
    loading = _core.ExponentialCurve(contact.loading.a, contact.loading.b, contact.loading.c)
    unloading = _core.ExponentialCurve(
        contact.unloading.a, contact.unloading.b, contact.unloading.c
    )
    if contact.law == "mean":
        return _core.MeanCurve(loading=loading, unloading=unloading)
    if contact.law == "felt_memory":
        closing = contact.memory.closing_compression or 0.0
        return _core_memory(contact.memory, _core.Envelope.from_curves(loading, unloading, closing))
    return _core.ExponentialPair(
        loading=loading,
        unloading=unloading,
        alpha=contact.alpha,
        guarded=contact.law == "guarded",
        hysteresis=contact.hysteresis,
        rate_amplitude=contact.memory.rate_amplitude,
        rate_time=contact.memory.rate_time,
    )


def _table_envelope(table: EnvelopeTable) -> _core.Envelope:
    if len(table.unit) != 2:
        raise InvalidParameter(
            f"memory.envelope.unit: got {table.unit!r}, expected two, such as ['mm', 'N']"
        )
    length, force = conversion_factor(table.unit[0], "m"), conversion_factor(table.unit[1], "N")
    return _core.Envelope.from_table(
        [v * length for v in table.compression],
        [v * force for v in table.loading],
        [v * force for v in table.unloading],
    )


def _core_memory(
    p: MemoryParameters | LayerParameters, envelope: _core.Envelope
) -> _core.FeltMemory:
    return _core.FeltMemory(
        envelope=envelope,
        kappa=p.kappa,
        recovery_time=p.recovery_time,
        creep_stiffness=p.creep_stiffness,
        creep_damping=p.creep_damping,
        rate_amplitude=p.rate_amplitude,
        rate_time=p.rate_time,
    )


def _core_body(name: str, b: Body) -> _core.BodyDescription:
    d = _core.BodyDescription()
    d.name = name
    d.parent = b.parent
    d.joint = getattr(_core.JointKind, b.joint)
    d.position = b.position
    d.axis = b.axis
    d.angle = b.angle
    d.coordinate = b.coordinate
    d.friction = _core_friction(b.friction)
    d.mass = b.mass
    d.center_of_mass = b.center_of_mass
    d.inertia = b.inertia
    if b.kind == "beam":
        # A rigid uniform rod: slender, the rotary inertia of its section neglected.
        assert b.length is not None
        assert b.density is not None
        assert b.area is not None
        if not b.rigid:
            assert b.young_modulus is not None
            assert b.second_moment is not None
            beam = _core.BeamDescription()
            beam.length = b.length
            beam.linear_density = b.density * b.area
            beam.axial_stiffness = b.young_modulus * b.area
            beam.bending_stiffness = b.young_modulus * b.second_moment
            beam.shapes = getattr(_core.ShapeSet, b.shapes)
            beam.axial_shapes = b.axial_shapes
            beam.lateral_shapes = b.lateral_shapes
            beam.damping_time = b.damping_time
            beam.condense_axial = b.condense_axial
            d.beam = beam
            return d
        d.mass = b.density * b.area * b.length
        d.center_of_mass = (0.5 * b.length, 0.0)
        d.inertia = d.mass * b.length**2 / 12.0
    return d


def _core_string(s: String) -> _core.StringDescription:
    d = _core.StringDescription()
    d.name = "string"
    d.surface = s.surface
    d.rigid = s.kind == "rigid_stop"
    d.parameters = _core.StringParameters(
        diameter=s.diameter,
        tension=s.tension,
        length=s.length,
        linear_density=s.linear_density,
        young_modulus=s.young_modulus,
        damping_ratio=s.damping_ratio,
        modes=s.modes,
    )
    d.anchor = s.anchor
    d.direction = s.direction
    d.moving_strike_point = s.strike_point == "moving"
    if s.strike_point != "moving":
        d.strike_position = float(s.strike_point)
    return d


def _core_surface(name: str, s: Surface) -> _core.SurfaceDescription:
    d = _core.SurfaceDescription()
    d.name = name
    d.body = s.body
    d.kind = getattr(_core.SurfaceKind, s.kind)
    d.point = s.point
    if s.normal is not None:
        d.normal = s.normal
    if s.radius is not None:
        d.radius = s.radius
    if s.arc is not None:
        d.arc = s.arc
    return d


def _core_contact(key: str, c: Contact) -> _core.ContactDescription:
    d = _core.ContactDescription()
    d.number = int(key)
    d.label = c.label
    d.surface_a, d.surface_b = c.surfaces
    d.law = core_law(c)
    d.friction = _core_friction(c.friction)
    d.enabled = c.enabled
    return d


def _core_spring(name: str, s: Spring) -> _core.TorsionSpringDescription:
    d = _core.TorsionSpringDescription()
    d.name = name
    d.coordinate = s.coordinate
    d.stiffness = s.stiffness
    d.rest_angle = s.rest_angle
    d.damping = s.damping
    d.clearance = s.clearance
    d.seating = s.seating
    return d


def _core_dashpot(name: str, s: Dashpot) -> _core.DashpotDescription:
    d = _core.DashpotDescription()
    d.name = name
    d.coordinate = s.coordinate
    d.coefficient = s.coefficient
    d.side = {"both": 0, "positive": 1, "negative": -1}[s.side]
    return d


def _core_strap(name: str, s: Strap) -> _core.StrapDescription:
    d = _core.StrapDescription()
    d.name = name
    d.body_a, d.point_a = s.body_a, s.point_a
    d.body_b, d.point_b = s.body_b, s.point_b
    d.free_length = s.free_length
    d.coefficients = (s.k1, s.k2, s.k3)
    return d


def _core_point(name: str, p: Point) -> _core.TrackingPointDescription:
    d = _core.TrackingPointDescription()
    d.name = name
    d.body = p.body
    d.point = p.point
    return d


def describe(
    config: MechanismFile, known: dict[int, tuple[Any, Any]] | None = None
) -> _core.MechanismDescription:
    """Plain description of a validated file for the core.

    Parameters
    ----------
    known
        Parts made before, by the identity of the part of the file that they came from; what is
        missing is added. Files that share parts are then described in a fraction of the time.
    """
    description, faults = _describe(config, known)
    if faults:
        raise InvalidParameter("\n".join(faults))
    return description


def _describe(
    config: MechanismFile, known: dict[int, tuple[Any, Any]] | None = None
) -> tuple[_core.MechanismDescription, list[str]]:
    """Description without the contacts whose laws cannot be made, and why they cannot."""

    def each(table: Mapping[str, Any], make: Callable[[str, Any], Any]) -> list[Any]:
        if known is None:
            return [make(name, node) for name, node in table.items()]
        out = []
        for name, node in table.items():
            if id(node) not in known:
                made = make(name, node)
                if made is None:
                    continue
                known[id(node)] = (node, made)
            out.append(known[id(node)][1])
        return out

    d = _core.MechanismDescription()
    d.name = config.name
    d.gravity = config.gravity
    d.bodies = each(config.bodies, _core_body)
    d.surfaces = each(config.surfaces, _core_surface)
    faults: list[str] = []

    def contact(key: str, c: Contact) -> Any:
        try:
            return _core_contact(key, c)
        except InvalidParameter as error:
            faults.append(f"contacts.{key}: {error}")
            return None

    d.contacts = [c for c in each(config.contacts, contact) if c is not None]
    d.springs = each({k: s for k, s in config.springs.items() if s.enabled}, _core_spring)
    d.dashpots = each({k: s for k, s in config.dashpots.items() if s.enabled}, _core_dashpot)
    d.straps = each({k: s for k, s in config.straps.items() if s.enabled}, _core_strap)
    if config.string is not None:
        d.strings = [_core_string(config.string)]
    d.points = each(config.points, _core_point)
    if config.finger is not None:
        fd = _core.FingerDescription()
        fd.body = config.finger.body
        fd.point = config.finger.point
        fd.direction = config.finger.direction
        fd.pad = _core_hunt_crossley(config.finger.pad)
        d.finger = fd
    if config.motor is not None:
        md = _core.MotorDescription()
        md.coordinate = config.motor.coordinate
        md.contact = config.motor.contact or 0
        d.motor = md
    d.start_pose = list(config.start_pose.items())
    return d, faults


# --- the public object ---------------------------------------------------------------------------


class Action:
    """A mechanism read from data. Immutable; safe to share between threads.

    Parameters
    ----------
    raw
        The tables of a mechanism file.
    origin
        Name used in messages, usually the file's.
    """

    def __init__(self, raw: Mapping[str, Any], origin: str = "mechanism"):
        try:
            self._raw = plain_data(raw)
        except InvalidParameter as error:
            raise InvalidParameter(f"{origin}: {error}") from None
        self.origin = origin
        self.config, self.mechanism = _validate(self._raw, origin)

    def __repr__(self) -> str:
        return f"Action({self.name!r}, {len(self.coordinates)} coordinates, hash {self.hash[:12]})"

    def __reduce__(self) -> tuple[Any, ...]:
        return (Action, (self._raw, self.origin))

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self.config.name

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the mechanical coordinates in the order of q."""
        return tuple(self.mechanism.coordinates)

    @property
    def raw(self) -> dict[str, Any]:
        """The tables of the file, with units and sources; a copy."""
        return copy.deepcopy(self._raw)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all parameters in SI units, without names for people, notes, sources."""
        tables = self.config.model_dump(mode="json", exclude={"name", "about", "source"})
        for table in ("motor", "dashpots"):
            if not tables[table]:
                del tables[table]  # as before there were any: results keep their hash
        text = json.dumps(_without_texts(tables), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def with_values(self, values: Mapping[str, Any]) -> Action:
        """Copy with other values by dotted path.

        Parameters
        ----------
        values
            ``{"string.modes": 80}``. A bare number is taken in the unit that the file gives for
            that entry; a text may carry its own, ``"10.5 mm"``. ``*`` stands for any key
            (``"contacts.*.law"``), the name of a body for ``bodies.NAME`` (``"shank.rigid"``),
            ``.x .y`` or ``.0 .1`` for a component of a point.

        Raises
        ------
        InvalidParameter
            A path that does not exist, or a value out of range.
        """
        return self._with_numbers(values) or Action(
            apply_values(self._raw, values, "with_values"), self.origin
        )

    def _with_numbers(self, values: Mapping[str, Any]) -> Action | None:
        """Copy that shares all that did not change; None where a whole check is called for."""
        try:
            raw, touched = _apply_numbers(self._raw, values)
            config = self.config
            for table, key in touched:
                model = type(getattr(config, table)[key])
                parts = {**getattr(config, table), key: model.model_validate(raw[table][key])}
                config = config.model_copy(update={table: parts})
            mechanism = _core.assemble(describe(config, dict(self._described)))
        except (ValidationError, InvalidParameter, ValueError, TypeError, KeyError):
            return None  # the way through the file says what is wrong
        changed = Action.__new__(Action)
        changed._raw, changed.origin = raw, self.origin
        changed.config, changed.mechanism = config, mechanism
        return changed

    @cached_property
    def _described(self) -> dict[int, tuple[Any, Any]]:
        """Parts of the description by the part of the file that they came from."""
        known: dict[int, tuple[Any, Any]] = {}
        describe(self.config, known)
        return known

    def to_toml(self) -> str:
        """Text of a file that loads as this mechanism."""
        import tomlkit

        return tomlkit.dumps(self._raw)

    @cached_property
    def _equilibrium(self) -> dict[str, Any]:
        return dict(_core.find_equilibrium(self.mechanism))

    @property
    def rest_pose(self) -> npt.NDArray[np.float64]:
        """Coordinates at rest under gravity [rad, m], found by an equilibrium solve."""
        pose: npt.NDArray[np.float64] = self._equilibrium["q"].copy()
        return pose

    @property
    def rest_iterations(self) -> int:
        """Iterations that the equilibrium solve took."""
        return int(self._equilibrium["iterations"])

    def quantities(self) -> Iterator[tuple[str, Any, str, str]]:
        """Every number of the file: dotted path, value, unit, source or status."""
        yield from _walk(self._raw, "")


def _without_texts(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {
            key: _without_texts(value)
            for key, value in node.items()
            if key not in ("label", "note") or not isinstance(value, str)
        }
    return node


def _walk(node: Any, path: str) -> Iterator[tuple[str, Any, str, str]]:
    if is_quantity(node):
        source = str(node.get("source", ""))
        if node.get("status"):
            source = f"{source} ({node['status']})" if source else str(node["status"])
        yield path, node["value"], str(node.get("unit", "1")), source
    elif isinstance(node, Mapping):
        if isinstance(node.get("unit"), list):
            for key, unit in zip("abc", node["unit"], strict=False):
                if key in node:
                    yield f"{path}.{key}", node[key], str(unit), str(node.get("source", ""))
            return
        for key, value in node.items():
            yield from _walk(value, f"{path}.{key}" if path else str(key))
    elif isinstance(node, (int, float)) and not isinstance(node, bool) and math.isfinite(node):
        yield path, node, "", ""


__all__ += [
    "LawChoice",
    "apply_values",
    "core_law",
    "describe",
    "load_raw",
    "missing_law_faults",
    "plain_data",
    "spread_laws",
]
