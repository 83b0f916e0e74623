"""Fields of the files of feltmb: annotations whose values have a unit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from pydantic import BaseModel, BeforeValidator

from unmodeled.errors import shortened, shown
from unmodeled.units.quantity import check_table, factor_to, finite_number, parse_scalar


def _parse_vector(node: object, si_unit: str, length: int) -> tuple[float, ...]:
    factor = 1.0
    if isinstance(node, Mapping):
        check_table(node)
        factor = factor_to(node.get("unit", si_unit), si_unit)
        node = node["value"]
    if isinstance(node, str) or not isinstance(node, Sequence) or len(node) != length:
        raise ValueError(f"got {shown(node)}, expected {length} numbers")
    values = [
        parse_scalar(v, si_unit) if isinstance(v, str) else finite_number(v) * factor for v in node
    ]
    return tuple(_limited(value, si_unit) for value in values)


#: Largest value by SI unit. Differences of longer lengths would lose the size of a small part.
_LARGEST = {"m": 1e6}


def _limited(value: float, si_unit: str) -> float:
    most = _LARGEST.get(si_unit, math.inf)
    if abs(value) > most:
        raise ValueError(f"got {value:g} {si_unit}, expected at most {most:g} {si_unit}")
    return value


@dataclass(frozen=True)
class InUnit(BeforeValidator):
    """Validator that stores the SI units of which a value has one."""

    units: tuple[str, ...] = ()


def SI(si_unit: str) -> BeforeValidator:
    """Annotation of a float field: any accepted form is converted to ``si_unit``."""
    return InUnit(lambda node: _limited(parse_scalar(node, si_unit), si_unit), units=(si_unit,))


def _parse_count(node: object) -> int:
    """Integer, bare or as a table with its source; raises ValueError with the fault."""
    value: object = node
    if isinstance(node, Mapping):
        check_table(node)
        if node.get("unit", "1") != "1":
            raise ValueError(f"got unit {node['unit']!r}, expected a count: no unit, or '1'")
        value = node["value"]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value // 1:
        raise ValueError(f"got {shortened(repr(value))}, expected a whole number")
    return int(value)


def Count() -> BeforeValidator:
    """Annotation of an int field that may have a source: an integer or a quantity table."""
    return BeforeValidator(_parse_count)


def SIVector(si_unit: str, length: int = 2) -> BeforeValidator:
    """Annotation of a field of ``length`` floats in ``si_unit``."""
    return InUnit(lambda node: _parse_vector(node, si_unit, length), units=(si_unit,))


def JointSI(revolute: str, prismatic: str, contact: str | None = None) -> BeforeValidator:
    """Annotation of a field whose unit depends on its joint or contact."""
    units = (revolute, prismatic, prismatic if contact is None else contact)

    def parse(node: object) -> float:
        for si in units:
            try:
                return parse_scalar(node, si)
            except ValueError as error:
                if "does not measure" not in str(error):
                    raise
        unit = node["unit"] if isinstance(node, Mapping) else node
        known = ", ".join(dict.fromkeys(units))
        raise ValueError(f"got unit {shown(unit)}, expected a unit of {known}")

    return InUnit(parse, units=units)


def unit_of(model: type[BaseModel], field: str, joint: str = "revolute") -> str | None:
    """SI unit of a field annotated by :func:`SI`, :func:`SIVector` or :func:`JointSI`; else None.

    ``joint``: what the field belongs to: ``revolute``, ``prismatic`` or ``contact``.
    """
    info = model.model_fields[field]
    marks = [*info.metadata, *(m for arg in get_args(info.annotation) for m in get_args(arg))]
    units = next((mark.units for mark in marks if isinstance(mark, InUnit)), ())
    if not units:
        return None
    return units[("revolute", "prismatic", "contact").index(joint) if len(units) > 1 else 0]
