"""Contact laws of the core: schemas of their tables, and laws made from values.

The header of a law (``cpp/include/feltmb/contact/laws``) has the only list of its fields with unit,
limits and default; everything here follows from it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, create_model, model_validator

from feltmb import _core
from feltmb.quantities import SI, Count, JointSI
from unmodeled.errors import InvalidParameter
from unmodeled.units import conversion_factor, number_and_unit
from unmodeled.units.quantity import META_KEYS, Schema, parse_scalar

Model = TypeVar("Model", bound=BaseModel)
Struct = TypeVar("Struct")


@dataclass(frozen=True)
class LawField:
    """A field of a law or of another structure of the core."""

    name: str
    kind: str
    """``number``, ``count``, ``curve``, ``envelope``, ``text``, ``parameters``, ``list``,
    ``function``."""
    unit: str
    """SI unit; several, separated by `` | ``: for a revolute joint, a prismatic joint, and a
    contact."""
    meaning: str
    low: float | None
    high: float | None
    low_open: bool
    high_open: bool
    required: bool
    default: Any
    in_contact: bool = False
    """Whether it is an entry of the contact itself instead of the table of the law."""


@dataclass(frozen=True)
class LawInfo:
    """A law with one of its names."""

    name: str
    about: str
    table: str
    """Table of the law in a mechanism file; empty if it needs none."""
    fields: tuple[LawField, ...]

    def needed(self, node: Mapping[str, Any]) -> list[str]:
        """Entries of a contact that the law requires, in a raw table."""
        own = node.get(self.table)
        tabulated = isinstance(own, Mapping) and "envelope" in own
        keys: list[str] = []
        for field in self.fields:
            if field.kind == "envelope":
                keys += [] if tabulated else _CURVES
            elif field.required:
                keys.append(field.name if field.in_contact else self.table)
        return list(dict.fromkeys(keys))


_CURVES = ["loading", "unloading"]

#: Entries of a table that are not fields of a law.
_OF_TABLE = ("note", "closing_compression")

#: Laws of the core by name.
CORE_LAWS: dict[str, LawInfo] = {
    law["name"]: LawInfo(**{**law, "fields": tuple(LawField(**f) for f in law["fields"])})
    for law in _core.contact_laws()
}

#: Name of each law in mechanism files, and its description. Laws that need a function are excluded:
#: a file must not make feltmb run code.
LAWS: dict[str, str] = {
    name: law.about
    for name, law in CORE_LAWS.items()
    if not any(field.kind == "function" for field in law.fields)
} | {"micromechanical": "felt_memory whose loop follows from the fibers, thickness and area"}


def _curve(node: object) -> object:
    """Accept ``unit = [..]`` for the three coefficients of eq. 4.21."""
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


class Curve(Schema):
    """F(e) = a e exp(b e) + c e, thesis eq. 4.21."""

    a: Annotated[float, SI("N/m")]
    b: Annotated[float, SI("1/m"), Field(ge=0)]
    c: Annotated[float, SI("N/m")]

    @property
    def core(self) -> _core.ExponentialCurve:
        """The curve as an object of the C++ core."""
        return _core.ExponentialCurve(self.a, self.b, self.c)


class EnvelopeTable(Schema):
    """A measured or computed loop: both branches at equal compressions."""

    unit: list[str] = Field(default_factory=lambda: ["m", "N"])
    compression: list[float]
    loading: list[float]
    unloading: list[float]

    @property
    def core(self) -> _core.Envelope:
        """The envelope as an object of the core."""
        if len(self.unit) != 2:
            raise InvalidParameter(
                f"memory.envelope.unit: got {self.unit!r}, expected two, such as ['mm', 'N']"
            )
        length, force = conversion_factor(self.unit[0], "m"), conversion_factor(self.unit[1], "N")
        return _core.Envelope.from_table(
            [v * length for v in self.compression],
            [v * force for v in self.loading],
            [v * force for v in self.unloading],
        )


_POWER_UNIT = re.compile(r"(.*)/(\w+?)(?:\^([\d.]+|p))?")


def _power_unit(node: object) -> str:
    """Unit of the stiffness of a power law as it is written; empty: none, so SI."""
    if isinstance(node, Mapping):
        return str(node.get("unit", ""))
    found = number_and_unit(node) if isinstance(node, str) else None
    return found[1] if found else ""


def _power_of(unit: str) -> str:
    """Power of the length in N/mm^4.3: 4.3, p, or 1 without one."""
    match = _POWER_UNIT.fullmatch(unit.strip())
    return (match.group(3) or "1") if match else ""


def power_stiffness(node: object) -> float:
    """Stiffness of a power law [N/m^p], such as ``"164000 N/mm^4.3"``.

    ``N/m^p`` stands for SI. In any other unit the power must be a number, that of the law.

    Raises
    ------
    ValueError
        The unit is not that of a force over a power of a length.
    """
    unit = _power_unit(node)
    power = _power_of(unit)
    if unit and (not power or (power == "p" and unit != "N/m^p")):
        raise ValueError(
            f"got unit {unit!r}, expected 'N/m^p', or one such as 'N/mm^4.3' with the exponent of "
            "the law"
        )
    if unit and power != "p":
        return parse_scalar(node, f"N/m^{power}")
    if isinstance(node, Mapping):
        node = {k: v for k, v in node.items() if k != "unit"}
    elif isinstance(node, str):
        node = node.replace(unit, "")  # N/m^p: the number is in SI
    return parse_scalar(node, "1")


def power_faults(law: LawInfo, given: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Stiffnesses of raw parameters whose unit has another power than their law."""
    for field, after in zip(law.fields, law.fields[1:], strict=False):
        power = _power_of(_power_unit(given.get(field.name)))
        if field.unit != "N/m^p" or power in ("", "p"):
            continue
        try:
            exponent = parse_scalar(given.get(after.name, after.default), "1")
        except ValueError:
            continue  # its own fault
        if abs(float(power) - exponent) > 1e-9:
            yield (
                field.name,
                f"its unit has the power {power} of a length, expected {exponent:g}, that of "
                f"{after.name}",
            )


_CURVE_FIELD: Any = Annotated[Curve, BeforeValidator(_curve)]

#: Annotations of the entries that are not numbers.
_KINDS: dict[str, Any] = {
    "curve": _CURVE_FIELD,
    "text": str,
    "parameters": dict[str, Annotated[float, SI("1")]],
    "list": list[float],
}


def _number(field: LawField) -> Any:
    """Annotation of a number: its unit and limits."""
    limits: dict[str, Any] = {}
    if field.low is not None:
        limits["gt" if field.low_open else "ge"] = field.low
    if field.high is not None:
        limits["lt" if field.high_open else "le"] = field.high
    if field.kind == "count":
        return Annotated[int, Count(), Field(**limits)]
    power = field.unit == "N/m^p"
    several = " | " in field.unit
    unit = (
        BeforeValidator(power_stiffness)
        if power
        else JointSI(*field.unit.split(" | "))
        if several
        else SI(field.unit)
    )
    return Annotated[float, unit, Field(**limits)]


def _in_table(field: LawField) -> Iterator[tuple[str, Any]]:
    """Entries of a law's own table for a field."""
    if field.kind == "envelope":
        yield "closing_compression", (Annotated[float, SI("m"), Field(gt=0)] | None, None)
        yield field.name, (EnvelopeTable | None, None)
    else:
        annotation = _KINDS[field.kind] if field.kind in _KINDS else _number(field)
        described: Any = Annotated[annotation, Field(description=field.meaning)]
        yield field.name, (described, ... if field.required else field.default)


def _in_contact(field: LawField) -> Iterator[tuple[str, Any]]:
    """Entries of a contact for a field."""
    if field.kind == "envelope":
        yield from ((key, (_CURVE_FIELD | None, None)) for key in _CURVES)
    elif field.in_contact and field.kind == "curve":
        yield field.name, (_CURVE_FIELD | None, None)
    elif field.in_contact:
        annotation: Any = Annotated[_number(field), Field(description=field.meaning)]
        missing = annotation | None, None
        yield field.name, missing if field.required else (annotation, field.default)


def _table_fields(*laws: LawInfo) -> dict[str, Any]:
    """Entries of the table that laws share, in groups: the law with most entries is first."""
    entries: dict[str, Any] = {}
    for law in sorted(laws, key=lambda law: -len(law.fields)):
        for field in law.fields:
            if not field.in_contact:
                entries |= {k: v for k, v in _in_table(field) if k not in entries}
    return entries


def _extended(model: type[Model], entries: dict[str, Any]) -> type[Model]:
    made = create_model(
        model.__name__,
        __base__=model,
        __module__=model.__module__,
        __doc__=model.__doc__,
        **entries,
    )
    made.__qualname__ = model.__qualname__
    return made


def with_fields(law: str) -> Callable[[type[Model]], type[Model]]:
    """Class decorator: adds the numbers of a law to a schema."""
    numbers = [f for f in CORE_LAWS[law].fields if f.kind == "number"]
    entries = {key: value for field in numbers for key, value in _in_table(field)}
    return lambda model: _extended(model, entries)


def with_numbers(struct: Any, needed: Iterable[str] = ()) -> Callable[[type[Model]], type[Model]]:
    """Class decorator: adds the numbers of a struct of the core that the schema does not have.

    ``needed``: numbers that are required, in addition to those without a default.
    """
    fields = [LawField(**number) for number in struct.number_fields()]
    entries = {
        f.name: (
            Annotated[_number(f), Field(description=f.meaning)],
            ... if f.required or f.name in needed else f.default,
        )
        for f in fields
    }

    def add(model: type[Model]) -> type[Model]:
        return _extended(model, {k: v for k, v in entries.items() if k not in model.model_fields})

    return add


def to_core(struct: type[Struct], table: Any, **more: Any) -> Struct:
    """Structure of the core from a checked table: the common fields, and ``more``."""
    own: Iterable[str] = type(table).model_fields
    known: Any = struct
    shared = {name: getattr(table, name) for name in known.field_names() if name in own}
    return struct(**{k: v for k, v in shared.items() if v is not None} | more)


def with_laws(**more: Any) -> Callable[[type[Model]], type[Model]]:
    """Class decorator: adds ``law``, the entries and tables of all laws, and ``more``."""
    entries = {"law": (Literal[tuple(LAWS)], "felt_memory"), **_choice_fields(), **more}
    return lambda model: _extended(model, entries)


def _choice_fields() -> dict[str, Any]:
    """Entries of a contact that select a law: its own entries, and the tables of the laws."""
    entries: dict[str, Any] = {}
    by_table: dict[str, list[LawInfo]] = {}
    for law in (CORE_LAWS[name] for name in LAWS if name in CORE_LAWS):
        for field in law.fields:
            entries |= {k: v for k, v in _in_contact(field) if k not in entries}
        if law.table:
            by_table.setdefault(law.table, []).append(law)
    for table, laws in by_table.items():
        fields = {**_table_fields(*laws), "note": (str, "")}
        names = ", ".join(law.name for law in laws)
        made = create_model(
            "".join(part.capitalize() for part in table.split("_")) + "Parameters",
            __base__=Schema,
            __module__=__name__,
            __doc__=f"{laws[0].about}." if len(laws) == 1 else f"Options of {names}.",
            __validators__=_with_power(laws[0]),
            **fields,
        )
        globals()[made.__name__] = made  # needed by pickle
        free = all(value[1] is not ... for value in fields.values())
        entries[table] = (made, made()) if free else (made | None, None)
    return entries


def _with_power(law: LawInfo) -> dict[str, Any]:
    """Validator of a table: units of stiffnesses have the power of the law."""
    if not any(field.unit == "N/m^p" for field in law.fields):
        return {}

    def check(node: Any) -> Any:
        if isinstance(node, Mapping):
            for name, text in power_faults(law, node):
                raise ValueError(f"{name}: {text}")
        return node

    return {"check_power": model_validator(mode="before")(check)}


def core_envelope(loading: Any, unloading: Any, closing: float | None) -> _core.Envelope:
    """Envelope from a pair of curves; ``closing`` [m] is required if they never meet."""
    return _core.Envelope.from_curves(loading, unloading, closing or 0.0)


def make_core(name: str, contact: Any) -> _core.ContactLaw:
    """Law of the core from the entries of a checked contact.

    Raises
    ------
    InvalidParameter
        The entries contradict each other.
    """
    law = CORE_LAWS[name]
    table: Any = getattr(contact, law.table) if law.table else None
    values: dict[str, Any] = {}
    own = {field.name for field in law.fields}
    for key, entry in ({} if table is None else type(table).model_fields).items():
        if key not in own and key not in _OF_TABLE and getattr(table, key) != entry.default:
            raise InvalidParameter(
                f"{law.table}.{key}: the law {name} has no such option; its options are "
                f"{', '.join(f.name for f in law.fields if f.kind == 'number')}"
            )
    for field in law.fields:
        value = getattr(contact if field.in_contact else table, field.name)
        if field.kind == "envelope":
            value = (
                value.core
                if value is not None
                else core_envelope(
                    contact.loading.core, contact.unloading.core, table.closing_compression
                )
            )
        elif field.kind == "curve":
            value = value.core
        values[field.name] = value
    return _core.ContactLaw(name, **values)
