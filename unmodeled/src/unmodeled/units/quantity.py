"""Numbers with units in files: parsing, and error messages of one form.

A quantity is a number in SI, a text ``"10.5 mm"`` or
a table ``{ value, unit, source, status, note, printed, sd }``.
"""

from __future__ import annotations

import difflib
import math
import numbers
import re
from collections.abc import Mapping, Sequence
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, Union, cast, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from unmodeled.errors import Error, InvalidParameter, printable, shortened, shown
from unmodeled.units.names import conversion_factor

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

S = TypeVar("S", bound=BaseModel)

META_KEYS = frozenset({"value", "unit", "source", "status", "note", "printed", "sd"})
STATUS = ("measured", "published", "digitised", "assumed", "fitted", "computed", "regulated")
# Possessive (++, *+): without backtracking, the time is proportional to the length.
_TEXT = re.compile(r"\s*+([-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?)(.*)", re.DOTALL)
_FORBIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


class _Refusing(ModelMetaclass):
    """Base of schemas that raise :class:`InvalidParameter` when they are called with values.

    The validation of a whole file (``model_validate``) keeps the exception of pydantic, to list the
    faults.
    """

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        try:
            return super().__call__(*args, **kwargs)
        except ValidationError as error:
            faults = fault_lines(error, cast("type[BaseModel]", cls))
            raise InvalidParameter(fault_text(cls.__name__, faults)) from None


class Schema(BaseModel, metaclass=_Refusing):
    """Base of all file schemas: unknown keys and non-finite numbers are faults, values frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_disguise(cls, value: object, info: ValidationInfo) -> object:
        """Reject values that pydantic would convert to another type, such as "80" to 80."""
        _check_letters(value)
        field = cls.model_fields[str(info.field_name)]
        if not any(isinstance(m, BeforeValidator) for m in field.metadata):
            _check_kind(field.annotation, value)
        return value


def _check_letters(value: object) -> None:
    """Raise ValueError for control characters in a text or in the name of a table.

    They have no use in names or remarks, and would reach file names, labels and pages.
    """
    if isinstance(value, str):
        match = _FORBIDDEN.search(value)
        if match is not None:
            raise ValueError(
                f"got {shortened(repr(value))}, which holds the control character "
                f"U+{ord(match[0]):04X}; expected printable text"
            )
    elif isinstance(value, Mapping):
        for key in value:
            _check_letters(key)
    elif isinstance(value, (list, tuple)):
        for item in value:
            if isinstance(item, str):
                _check_letters(item)


def _check_kind(annotation: Any, value: object) -> None:
    """Raise ValueError if a flag, a number or a text is given instead of another of these types."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        for kind in _only_kind(inner, value):
            _check_kind(kind, value)
    elif origin is Annotated:
        if not any(isinstance(a, BeforeValidator) for a in inner[1:]):
            _check_kind(inner[0], value)
    elif origin is list and isinstance(value, (list, tuple)):
        for item in value:
            _check_kind(inner[0], item)
    elif origin is dict and isinstance(value, Mapping):
        for key, item in value.items():
            try:
                _check_kind(inner[1], item)
            except ValueError as error:
                raise ValueError(f"{key}: {error}") from None
    elif annotation is bool and not isinstance(value, bool):
        raise ValueError(f"got {shown(value)}, expected true or false")
    elif annotation in (int, float) and isinstance(value, (bool, str)):
        what = "a whole number" if annotation is int else "a number"
        raise ValueError(f"got {shown(value)}, expected {what}")


def _only_kind(kinds: Sequence[Any], value: object) -> list[Any]:
    """The type of a union that a value must have; empty: there are several, or it may be None."""
    lists = isinstance(value, list)
    kinds = [a for a in kinds if a is not NoneType]
    kinds = [a for a in kinds if (get_origin(a) is list) == lists] or kinds
    return kinds if len(kinds) == 1 and value is not None else []


def is_quantity(node: object) -> bool:
    """Whether a node of a file is a quantity table."""
    return isinstance(node, Mapping) and "value" in node and set(node) <= META_KEYS


def finite_number(value: object) -> float:
    """A real number as a float; raises ValueError with the fault."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):  # includes NumPy's
        raise ValueError(f"got {shown(value)}, expected a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"got {shown(value)}, expected a finite number")
    return number


def factor_to(unit: object, si_unit: str) -> float:
    """Factor from a unit of a file to ``si_unit``; raises ValueError with the fault."""
    if not isinstance(unit, str):
        raise ValueError(f"got unit {shown(unit)}, expected a text such as {si_unit!r}")
    if unit == si_unit:  # or a non-mechanical unit, such as the unit of a power of a user's model
        return 1.0
    try:
        return conversion_factor(unit, si_unit)
    except InvalidParameter as error:
        raise ValueError(str(error)) from None


def check_table(node: Mapping[str, Any]) -> None:
    """Raise ValueError if a table is no quantity."""
    unknown = sorted(set(node) - META_KEYS, key=str)
    if unknown:
        raise ValueError(
            f"unknown key {', '.join(map(str, unknown))} in a quantity; "
            f"known are {', '.join(sorted(META_KEYS))}"
        )
    if "value" not in node:
        raise ValueError("a quantity needs the key 'value'")
    status = node.get("status")
    if status is not None and status not in STATUS:
        raise ValueError(f"status {shown(status)} is none of {', '.join(STATUS)}")


def parse_scalar(node: object, si_unit: str) -> float:
    """Value of a quantity in ``si_unit``; raises ValueError with the fault."""
    if isinstance(node, str):
        match = _TEXT.match(node)
        if match is None:
            unit = "" if si_unit == "1" else f" with a unit of {si_unit}"
            raise ValueError(f"got {shown(node)}, expected a finite number{unit}")
        unit = match.group(2).strip()
        if re.match(r",\d", unit):
            raise ValueError(f"got {shown(node)}, expected a decimal point")
        return finite_number(float(match.group(1))) * (factor_to(unit, si_unit) if unit else 1.0)
    if isinstance(node, Mapping):
        check_table(node)
        return finite_number(node["value"]) * factor_to(node.get("unit", si_unit), si_unit)
    return finite_number(node)


_LIMITS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than": ("lt", "<"),
    "less_than_equal": ("le", "<="),
}


def keys_of(model: type[BaseModel]) -> str:
    """Keys of a table as text: the required ones, and the others.

    A key has the units of the annotation of its field that has the attribute ``units``.
    """
    keys: dict[bool, list[str]] = {True: [], False: []}
    for name, field in model.model_fields.items():
        marks = [*field.metadata, *(m for a in get_args(field.annotation) for m in get_args(a))]
        units = next((list(dict.fromkeys(m.units)) for m in marks if hasattr(m, "units")), [])
        unit = "" if units in ([], ["1"]) else f" [{' or '.join(units)}]"
        keys[field.is_required()].append(f"{field.alias or name}{unit}")
    texts = [f"required: {', '.join(keys[True])}"] if keys[True] else []
    texts += [f"optional: {', '.join(keys[False])}"] if keys[False] else []
    return shortened("; ".join(texts), 500)


def table_at(model: type[BaseModel], loc: tuple[Any, ...]) -> type[BaseModel] | None:
    """Schema of the table that contains ``loc``; None if any name is permitted."""
    current: Any = model
    for part in loc[:-1]:
        if isinstance(current, type) and issubclass(current, BaseModel):
            field = current.model_fields.get(str(part))
            current = field.annotation if field is not None else None
        else:
            arguments = getattr(current, "__args__", ())
            current = arguments[-1] if arguments else None
        while current is not None and not isinstance(current, type):
            inner = [a for a in getattr(current, "__args__", ()) if a is not type(None)]
            if getattr(current, "__origin__", None) is dict:
                break
            current = inner[0] if inner else None
    return current if isinstance(current, type) and issubclass(current, BaseModel) else None


def _fields_at(model: type[BaseModel], loc: tuple[Any, ...]) -> list[str]:
    """Names of the fields of the table that contains ``loc``; empty if any name is permitted."""
    table = table_at(model, loc)
    return [f.alias or name for name, f in table.model_fields.items()] if table else []


def _plain_input(node: object) -> str:
    """Input without the surrounding table."""
    if is_quantity(node):
        assert isinstance(node, Mapping)
        unit = node.get("unit", "")
        return f"{shown(node['value'])} {'' if unit == '1' else unit}".strip()
    return shown(node)


MOST_FAULTS = 100
"""Largest number of faults of a file in a message; for the others, only their number is stated."""


def fault_text(origin: str, faults: Sequence[str], most: int = MOST_FAULTS) -> str:
    """Message that lists the faults of a file, at most ``most`` of them."""
    count = "1 fault" if len(faults) == 1 else f"{len(faults)} faults"
    shown = [shortened(printable(f), 1000) for f in faults[:most]]
    if len(faults) > most:
        shown.append(f"... and {len(faults) - most} more")
    return f"{origin}: {count}\n" + "\n".join(f"  {f}" for f in shown)


def validated(model: type[S], raw: object, origin: str, error: type[Error] = InvalidParameter) -> S:
    """Tables as objects of the schema; otherwise one error with all faults."""
    try:
        return model.model_validate(raw)
    except ValidationError as fault:
        raise error(fault_text(origin, fault_lines(fault, model))) from None


#: Faults of a value that is no finite number.
_NO_NUMBER = ("float_type", "finite_number")


def fault_lines(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """One line for each fault: place, value, expectation, hint.

    Lines after :data:`MOST_FAULTS`, which are not shown, only have the place, because hints take
    time.
    """
    lines: list[str] = []
    items = error.errors(include_url=False)
    neither = [i["loc"][:-1] for i in items if i["type"] in _NO_NUMBER and i["loc"][-1] == "float"]
    for item in items:
        if item["loc"][-1:] == ("str",) and item["loc"][:-1] in neither:
            continue  # the fault of a number or text is listed once
        loc = tuple(p for p in item["loc"] if p != "function-before")
        kind = item["type"]
        number_or_text = loc[-1:] == ("float",) and kind in _NO_NUMBER
        where = ".".join(str(p) for p in (loc[:-1] if number_or_text else loc)) or "file"
        if len(lines) >= MOST_FAULTS:
            lines.append(f"{where}: {kind}")
            continue
        if number_or_text:
            kind = "number_or_text"
        lines.append(f"{where}: {_text_of_fault(kind, item, where, loc, model)}")
    return [shortened(line, 1000) for line in lines]


#: Fault by its type in pydantic: ``got`` is the input, ``ctx`` the numbers of the limit.
_TEXTS_OF_FAULTS = {
    "number_or_text": "got {got}, expected a finite number or a text",
    "literal_error": "got {got}, expected {ctx[expected]}",
    "value_error": "{ctx[error]}",
    **dict.fromkeys(("model_type", "dict_type"), "got {got}, expected a table"),
    **dict.fromkeys(("list_type", "tuple_type"), "got {got}, expected a list"),
    **{
        kind: f"got {{got}}, must be {sign} {{ctx[{key}]:g}}"
        for kind, (key, sign) in _LIMITS.items()
    },
}


def _text_of_fault(
    kind: str, item: Mapping[str, Any], where: str, loc: tuple[Any, ...], model: type[BaseModel]
) -> str:
    """What is wrong, what was expected, and a hint."""
    if kind == "missing":
        table = table_at(model, loc)
        return "is missing" + (f"; {keys_of(table)}" if table else "")
    if kind == "extra_forbidden":
        known = _fields_at(model, loc)
        near = difflib.get_close_matches(str(loc[-1]), known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"
        return "unknown key" + (hint if known else "")
    got = _plain_input(item.get("input"))
    if kind not in _TEXTS_OF_FAULTS:
        return f"got {got}: {item['msg'].lower()}"
    text = _TEXTS_OF_FAULTS[kind].format(got=got, ctx=item.get("ctx", {}))
    if kind in ("list_type", "tuple_type") and "{" in got:
        text += f"; hint: [[{where}]] in place of [{where}]"
    return text
