"""TOML files: keys, units, limits and defaults of the schemas."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator
from pydantic_core import PydanticUndefined

from reference.attributes import field_texts

LIMITS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


def schemas() -> list[tuple[str, str, type[BaseModel]]]:
    """Title, purpose and schema of each kind of file."""
    from feltmb.action.actuator.model import ActuatorFile
    from feltmb.action.regulate import Targets
    from feltmb.adapters.library import LibraryFile
    from feltmb.fiber.material import FeltMaterial
    from feltmb.keyboard import Sensor
    from feltmb.mechanism import MechanismFile
    from feltmb.run.stroke.files import StrokeFile
    from unmodeled.data.sheet import Sheet

    return [
        ("Mechanism", "[Mechanism files](../mechanism_files.md) explain the keys.", MechanismFile),
        ("Stroke", "[Strokes](../mechanism_files.md#strokes).", StrokeFile),
        ("Felt", "[Felt](../../explanation/felt.md#a-felt).", FeltMaterial),
        ("Actuator", "[The key actuator](../../explanation/actuator.md).", ActuatorFile),
        ("Targets of a regulation", "[Regulation](../../howto/regulate_an_action.md).", Targets),
        (
            "Sensor of a keyboard",
            "[Sensors](../../howto/test_key_sensors.md#a-sensor-in-one-stroke).",
            Sensor,
        ),
        (
            "Record",
            "The TOML beside a measured file: [records](../../explanation/gap.md#records).",
            Sheet,
        ),
        (
            "Library of effects",
            "[Effects of the action](../gap-effects.md#your-own-library).",
            LibraryFile,
        ),
    ]


def page() -> str:
    """Text of the page."""
    lines = [
        "# TOML files",
        "",
        "Every key of every kind of file. *required*: there is no default. A number with a unit",
        'may be written `0.012`, `"12 g"` or `{ value = 12.0, unit = "g", source = "..." }`; a',
        "number without one is in the SI unit of the table. Unknown keys are faults.",
        "",
    ]
    lines += laws()
    for title, about, model in schemas():
        lines += [f"## {title}", "", about, ""]
        for path, table in tables(model, "", set()):
            lines += section(path, table)
    return "\n".join(lines).rstrip() + "\n"


def laws() -> list[str]:
    """Table of the contact laws: what each needs, and where its keys are."""
    from feltmb.contact import LAWS
    from feltmb.contact.tables import CORE_LAWS

    lines = [
        "## Contact laws",
        "",
        "A contact selects a law by `law`; its keys are in the tables of the contact below.",
        "",
        "| law | about | needs | keys |",
        "|---|---|---|---|",
    ]
    for name, about in LAWS.items():
        law = CORE_LAWS.get(name)
        needs = law.needed({}) if law is not None else [name]
        table = law.table if law is not None else name
        keys = [f"`[contacts.NAME.{key}]`" for key in dict.fromkeys([*needs, table]) if key]
        keys = [k.replace("unloading", "loading") for k in keys]  # the same curve
        needed = ", ".join(f"`{key}`" for key in needs)
        lines.append(f"| `{name}` | {about} | {needed} | {', '.join(dict.fromkeys(keys))} |")
    return [*lines, ""]


def tables(
    model: type[BaseModel], path: str, seen: set[type]
) -> Iterator[tuple[str, type[BaseModel]]]:
    """A table and the tables in it, each schema once per file."""
    yield path, model
    seen.add(model)
    for name, field in model.model_fields.items():
        key = field.alias or name
        for below, many in inner_models(field.annotation):
            if below not in seen:
                inside = f"{path}.{key}" if path else key
                yield from tables(below, f"{inside}.NAME" if many else inside, seen)


def inner_models(annotation: Any, many: bool = False) -> Iterator[tuple[type[BaseModel], bool]]:
    """Schemas in an annotation by name, and whether there may be several."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, many
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from inner_models(get_args(annotation)[0], many)
    elif origin is not None:
        for inner in get_args(annotation):
            yield from inner_models(inner, many or origin in (dict, list, tuple))


def section(path: str, model: type[BaseModel]) -> list[str]:
    """One table of a file as a table of the page."""
    text = " ".join((inspect.getdoc(model) or "").split("\n\n")[0].split())
    head = f"### `[{path}]`" if path else "### Top level"
    texts = field_texts(model)
    lines = [
        head,
        "",
        text,
        "",
        "| key | is | unit | limits | default | |",
        "|---|---|---|---|---|---|",
    ]
    for name, field in model.model_fields.items():
        marks = [*field.metadata, *inner_marks(field.annotation)]
        cells = [
            f"`{field.alias or name}`",
            kind(field.annotation),
            ", ".join(unit_of(marks)),
            ", ".join(limits(marks)),
            default(field),
            texts.get(name, field.description or ""),
        ]
        lines.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
    return [*lines, ""]


def inner_marks(annotation: Any) -> list[Any]:
    """Marks of ``Annotated`` inside an annotation, such as one of ``X | None``."""
    if get_origin(annotation) is Annotated:
        return list(get_args(annotation)[1:])
    return [m for inner in get_args(annotation) for m in inner_marks(inner)]


def kind(annotation: Any) -> str:
    """Permitted input, for people."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return kind(inner[0])
    if origin is Literal:
        return ", ".join(f'`"{v}"`' if isinstance(v, str) else f"`{v}`" for v in inner)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(kind(i) for i in inner if i is not NoneType))
    if origin is dict:
        return f"tables by name: {kind(inner[1])}" if models_in(inner[1]) else "table by name"
    if origin in (list, tuple):
        items = [i for i in inner if i is not Ellipsis]
        if origin is tuple and Ellipsis not in inner and len(items) > 1:
            return f"list of {len(items)}, {kind(items[0])}"
        return f"list of {kind(items[0])}" if items else "list"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    names = {float: "number", int: "whole number", str: "text", bool: "true, false"}
    return names.get(annotation, "anything")


def models_in(annotation: Any) -> bool:
    """Whether an annotation contains a schema."""
    return any(True for _ in inner_models(annotation))


def unit_of(marks: list[Any]) -> list[str]:
    """SI units that a field accepts."""
    for mark in marks:
        if units := getattr(mark, "units", ()):
            return ["-" if unit == "1" else unit for unit in dict.fromkeys(units)]
        if isinstance(mark, BeforeValidator):
            try:  # a field with several dimensions describes which one applies
                mark.func({"value": 1.0, "unit": "Pa"})  # type: ignore[call-arg]
            except (ValueError, TypeError, KeyError) as error:
                found = re.search(r"expected a unit of ([^(]*)$", str(error))
                if found:
                    return ["-" if u == "1" else u for u in found.group(1).strip().split(", ")]
    return []


def limits(marks: list[Any]) -> list[str]:
    """Limits of a number."""
    found = []
    for mark in [m for outer in marks for m in (outer, *getattr(outer, "metadata", ()))]:
        for name, sign in LIMITS:
            value = getattr(mark, name, None)
            if isinstance(value, (int, float)):
                found.append(f"{sign} {value:g}")
        for name, text in (("min_length", "at least"), ("max_length", "at most")):
            value = getattr(mark, name, None)
            if isinstance(value, int):
                found.append(f"{text} {value}")
    return list(dict.fromkeys(found))


def default(field: Any) -> str:
    """Default as it is written in a file."""
    if field.is_required():
        return "*required*"
    value = field.default
    if value is PydanticUndefined or value is None or isinstance(value, BaseModel):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:g}" if math.isfinite(value) else ""
    if isinstance(value, str):
        return f'`"{value}"`' if value else ""
    if isinstance(value, (tuple, list)) and value:
        return "[" + ", ".join(f'"{v}"' if isinstance(v, str) else f"{v:g}" for v in value) + "]"
    return ""
