"""The numbers of a checked mechanism or actuator by dotted path, in SI units."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import BaseModel

from feltmb.mechanism.schema import Body, Contact, MechanismFile
from feltmb.mechanism.values import (
    AXES,
    component,
    expand_path,
    is_bare,
    si_factor,
    split_operator,
    unit_in_file,
)
from feltmb.quantities import unit_of
from unmodeled.errors import InvalidParameter, shortened

#: Integers and choices, which have no derivative.
_COUNTS = frozenset({"modes", "count", "axial_shapes", "lateral_shapes"})

#: Size of a parameter with the value zero, by unit; changes are relative to it.
_SIZE_AT_ZERO = {
    "m": 1e-3,
    "rad": 1e-2,
    "kg": 1e-3,
    "s": 1e-4,
    "m/s^2": 1.0,
    "N": 1.0,
    "N m": 1e-3,
    "N/m": 1e3,
    "N m/rad": 1e-3,
    "N s/m": 1e-2,
    "N m s/rad": 1e-5,
    "N s^2/m^2": 1e-2,
    "N m s^2/rad^2": 1e-7,
    "rad/s": 0.1,
    "m/s": 1e-2,
    "kg m^2": 1e-6,
    "1": 0.1,
}


@dataclass(frozen=True)
class Parameter:
    """A real number of a mechanism.

    Attributes
    ----------
    path
        Full dotted path.
    value
        Value in SI units.
    unit
        SI unit of the value; ``1`` for a dimensionless number.
    size
        Reference of relative changes, SI units, > 0: the absolute value, or a small length, angle
        and so on if the value is zero.

    Examples
    --------
    A number of an action, with the unit of its file:

    >>> import feltmb
    >>> action = feltmb.load_action("steinway45")
    >>> action.value("bodies.head.mass")
    Value(value=0.0078, unit='kg')
    """

    path: str
    value: float
    unit: str
    size: float


def _children(node: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(node, BaseModel):
        for name in type(node).model_fields:
            yield name, getattr(node, name)
    elif isinstance(node, Mapping):
        yield from node.items()
    elif isinstance(node, tuple) and len(node) == 2:
        yield from zip(AXES, node, strict=True)


def _unit(config: BaseModel, parents: list[Any], names: list[str]) -> str:
    """SI unit of the field at the end of a chain of names."""
    for depth in range(len(names) - 1, -1, -1):
        owner = parents[depth]
        if not isinstance(owner, BaseModel):
            continue
        field = names[depth]
        unit = unit_of(type(owner), field, _joint(config, parents[: depth + 1]))
        if unit is not None:
            return unit
        if field == "stiffness":  # exponent of a power law
            exponent = getattr(owner, "exponent", 1.0)
            return "N/m" if exponent == 1.0 else f"N/m^{exponent:g}"
        if field == "strike_point":
            return "m"
        break
    return "1"


def _joint(config: BaseModel, owners: list[Any]) -> str:
    """Kind of the joint of a table, from the table or its coordinate, or ``contact``."""
    for owner in reversed(owners):
        if isinstance(owner, Contact):
            return "contact"
        if isinstance(owner, Body):
            return "prismatic" if owner.joint == "prismatic" else "revolute"
        coordinate = getattr(owner, "coordinate", None)
        for body in getattr(config, "bodies", {}).values():
            if coordinate is not None and body.coordinate == coordinate:
                return "prismatic" if body.joint == "prismatic" else "revolute"
    return "revolute"


def numbers_below(
    config: BaseModel, node: Any, parents: list[Any], names: list[str], counts: bool = False
) -> Iterator[Parameter]:
    """Numbers of a table; ``counts``: also whole numbers, which have no derivative."""
    if isinstance(node, bool) or node is None or isinstance(node, str):
        return
    if isinstance(node, (int, float)):
        if counts or (names[-1] not in _COUNTS and isinstance(node, float)):
            unit = _unit(config, parents, names)
            size = abs(node) or _SIZE_AT_ZERO.get(unit, 1.0)
            yield Parameter(".".join(names), float(node), unit, size)
        return
    for name, child in _children(node):
        yield from numbers_below(config, child, [*parents, node], [*names, name], counts)


class Value(NamedTuple):
    """A number, or a vector, in an SI unit; ``1`` if it has no dimension."""

    value: Any
    unit: str


def number_at(config: BaseModel, names: list[str]) -> Value:
    """Number or vector at the parts of a path; ``value``, the number of a quantity, may be one.

    Raises
    ------
    InvalidParameter
        The path does not exist, or is a text, a flag or a table.
    """
    names = [name for name in names if name != "value"]
    path = ".".join(names)
    node: Any = config
    parents: list[Any] = []
    for i, name in enumerate(names):
        known = dict(_children(node))
        if name in ("0", "1") and isinstance(node, tuple):
            name = names[i] = AXES[int(name)]
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
            raise InvalidParameter(
                f"value: path {shortened(path)!r}: {shortened(name)!r} does not exist; "
                f"{shortened(hint, 300)}"
            )
        parents.append(node)
        node = known[name]
    parts = node if isinstance(node, tuple) else (node,)
    if not all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in parts):
        inner = [".".join([path, name]) for name, _ in _children(node)]
        hint = f"a table with {', '.join(inner)}" if inner else repr(node)
        raise InvalidParameter(
            f"value: {shortened(path)} is {shortened(hint, 300)}, expected a number"
        )
    return Value(node, _unit(config, parents, names))


def _child(node: Any, key: str, path: str) -> Any:
    if isinstance(node, BaseModel) and key in type(node).model_fields:
        return getattr(node, key)
    if isinstance(node, Mapping) and key in node:
        return node[key]
    if isinstance(node, tuple) and 0 <= (index := component(key)) < len(node):
        return node[index]
    raise InvalidParameter(f"path {path!r}: {key!r} does not exist")


def _parts(config: MechanismFile, path: str) -> list[str]:
    parts = path.split(".")
    if parts[0] in config.bodies and parts[0] not in MechanismFile.model_fields:
        parts = ["bodies", *parts]
    return parts


def read_entry(config: MechanismFile, path: str) -> Any:
    """Value of an entry of a mechanism file, in SI units, by its dotted path.

    Raises
    ------
    InvalidParameter
        The path does not exist.
    """
    node: Any = config
    for key in _parts(config, path):
        node = _child(node, key, path)
    return node


def replace_entry(config: MechanismFile, path: str, value: Any) -> MechanismFile:
    """Mechanism with one entry replaced (SI units); the rest is neither copied nor checked."""
    out: MechanismFile = _replaced(config, _parts(config, path), value, path)
    return out


def _replaced(node: Any, parts: list[str], value: Any, path: str) -> Any:
    if not parts:
        return value
    key, rest = parts[0], parts[1:]
    new = _replaced(_child(node, key, path), rest, value, path)
    if isinstance(node, BaseModel):
        return node.model_copy(update={key: new})
    if isinstance(node, Mapping):
        return {**node, key: new}
    index = component(key)
    return (*node[:index], new, *node[index + 1 :])


#: Factor by which a changed number may differ from the old one before its unit is doubted.
DOUBTED = 10.0


class BareChange(NamedTuple):
    """A number without a unit in the place of one to which the file gives another unit than SI."""

    was: Value
    text: str
    doubted: bool  # more than ten times, or less than a tenth, of what it was


def bare_changes(
    raw: Mapping[str, Any],
    before: BaseModel,
    after: BaseModel,
    values: Mapping[str, Any],
    known: Mapping[str, BareChange],
) -> dict[str, BareChange]:
    """Changes of the model ``before`` by numbers without a unit, by path, added to those known.

    What the number was is that before the changes that ``known`` has too.
    """
    out = dict(known)
    for given, value in values.items():
        name, operator = split_operator(given)
        for parts in expand_path(raw, name):
            path = ".".join(part for part in parts if part != "value")
            earlier = out.pop(path, None)
            unit = unit_in_file(raw, parts[:-1] if parts[-1] == "value" else parts)
            bare = is_bare(value) and operator != "*"
            if not bare or not unit or si_factor(None, unit) == 1.0:
                continue
            was, now = earlier.was if earlier else number_at(before, parts), number_at(after, parts)
            small, large = sorted(_size(v.value) for v in (was, now))
            text = (
                f"{path} = {_size(now.value):g} {now.unit} (was {_size(was.value):g} {was.unit}"
                f"). A number without a unit is in SI units; the file has {unit}"
            )
            out[path] = BareChange(was, text, large > DOUBTED * small)
    return out


def _size(value: float | tuple[float, ...]) -> float:
    return max(map(abs, value)) if isinstance(value, tuple) else abs(value)
