"""Reads tests of single parts, ``[measured.NAME]``, from a TOML file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, ValidationError, ValidationInfo

from unmodeled.errors import DataError, InvalidParameter, shown
from unmodeled.files import read_toml
from unmodeled.units.quantity import Schema, fault_lines, fault_text, parse_scalar

T = TypeVar("T")


def _in_stated_unit(node: object, info: ValidationInfo) -> float:
    """A number, or a text with a unit, in the SI unit of its key; shares may be in percent."""
    assert info.context is not None
    unit, text = info.context[str(info.field_name)], node.strip() if isinstance(node, str) else ""
    percent = unit == "1" and text.endswith("%")
    try:
        value = parse_scalar(text.removesuffix("%").strip() if percent else node, unit)
    except (ValueError, InvalidParameter) as error:
        got = "" if str(error).startswith("got") else f"got {shown(node)}; "
        raise ValueError(f"{got}{error}") from None
    return 0.01 * value if percent else value


#: Number of a table in the unit that the model states.
InStatedUnit = Annotated[float, BeforeValidator(_in_stated_unit)]


class _Entry(Schema):
    value: InStatedUnit
    sd: InStatedUnit
    how: str = ""


class _MeasuredFile(Schema):
    measured: dict[str, dict[str, Any]]


def read(
    path: Path, kind: Callable[..., T], units: Mapping[str, str], why_not: Callable[[str], str]
) -> tuple[T, ...]:
    """Tests of the parameters and effects with these units, made by ``kind``.

    ``why_not``: reason why a test cannot give a number; empty: it can.
    """
    raw = read_toml(path)
    tables = raw.get("measured")
    rows = tables.items() if isinstance(tables, dict) else ()
    entries = {name: entry for name, entry in rows if isinstance(entry, dict)}
    whys = {name: why_not(name) for name in entries}
    faults = [f"measured.{name}: {why}" for name, why in whys.items() if why]
    out = []
    for name, entry in entries.items():
        if whys[name]:
            continue
        try:
            read = _Entry.model_validate(entry, context=dict.fromkeys(("value", "sd"), units[name]))
            out.append(kind(parameter=name, **read.model_dump()))
        except ValidationError as error:
            faults += [f"measured.{name}.{line}" for line in fault_lines(error, _Entry)]
        except InvalidParameter as error:
            faults.append(f"measured.{name}: {error}")
    try:
        _MeasuredFile.model_validate(raw)
    except ValidationError as error:
        faults += fault_lines(error, _MeasuredFile)
    if faults:
        raise DataError(fault_text(path.name, faults))
    return tuple(out)
