"""Changes values in the tables of a file by their dotted path."""

from __future__ import annotations

import copy
import difflib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.files import parse_toml
from unmodeled.units import conversion_factor, split_quantity, to_si
from unmodeled.units.quantity import META_KEYS, is_quantity, parse_scalar

#: Path and operator of a change; ``contacts.*`` ends with a wildcard, not with an operator.
_CHANGE = re.compile(r"(.*[^.\s])\s*([-+*])=\s*", re.DOTALL)


def split_operator(path: str) -> tuple[str, str]:
    """Path and operator of ``"PATH +="``, ``-=`` or ``*=``; ``""`` for a path alone."""
    match = _CHANGE.fullmatch(path)
    return (match[1].strip(), match[2]) if match else (path, "")


@checked
def parse_setting(text: str) -> tuple[str, Any]:
    """Split ``"string.modes=80"`` into its path and its value, which is TOML or else text.

    The path of a change, ``"string.modes+=10"``, is ``"string.modes +="``.
    """
    path, sign, value = text.partition("=")
    if not sign or not path.strip(" \t+-*"):
        raise InvalidParameter(f"--set {text!r}: expected PATH=VALUE, such as string.modes=80")
    name, operator = split_operator(path + sign)
    name = f"{name} {operator}=" if operator else path.strip()
    try:
        return name, parse_toml(f"v = {value}", name)["v"]
    except InvalidParameter:  # not TOML
        return name, value.strip()


@checked
def expand_path(raw: Mapping[str, Any], path: str) -> list[list[str]]:
    """Paths that match ``path``: ``*`` is any key; a body's name means bodies.NAME."""
    parts = path.split(".")
    if parts[0] not in raw and parts[0] in raw.get("bodies", {}):
        parts = ["bodies", *parts]
    # Coordinate names contain a dot; they are keys of start_pose only.
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


#: Components of a point.
AXES = ("x", "y")


def component(key: str) -> int:
    """Place of a component of a point, ``x`` or ``0``; -1 for other names."""
    return AXES.index(key) if key in AXES else int(key) if key.isdecimal() else -1


def _change(raw: dict[str, Any], path: str, value: Any, where: str) -> None:
    """Set the value of a path, or change it by an amount or a factor."""
    path, operator = split_operator(path)
    value = plain_data(value)
    for parts in expand_path(raw, path):
        if parts[-1] == "value" and len(parts) > 1 and is_quantity(_at(raw, parts[:-1])):
            parts.pop()  # the number of a quantity is the quantity
        owner = _owner(raw, parts, where, value)
        old, unit = _entry(owner, parts, where)
        new = (
            _changed(old, unit, operator, value, owner, parts, where)
            if operator
            else in_unit_of_file(old, unit, value)
        )
        note = f"set by {where}"
        if not operator and new != value:
            note += f", in SI: {value!r}"
        _set_one(owner, parts, new, where, note)


def _at(raw: Mapping[str, Any], parts: list[str]) -> Any:
    node: Any = raw
    for part in parts:
        node = node.get(part) if isinstance(node, Mapping) else None
    return node


#: Entries of tables with a list of units: place of the unit in the list.
_UNIT_OF = {"a": 0, "b": 1, "c": 2, "time": 0, "value": 1,
            "compression": 0, "loading": 1, "unloading": 1}  # fmt: skip


def _entry(owner: Any, parts: list[str], where: str) -> tuple[Any, str | None]:
    """Value at the end of a path as the file has it, and its unit; None: the file has none."""
    last = parts[-1]
    if is_quantity(owner) and component(last) >= 0:
        return owner["value"][_component(owner["value"], where, parts)], owner.get("unit")
    if not isinstance(owner, dict):
        return owner[_component(owner, where, parts)], None
    if is_quantity(owner.get(last)):
        return owner[last]["value"], owner[last].get("unit")
    units, place = owner.get("unit"), _UNIT_OF.get(last, -1)
    if isinstance(units, (list, tuple)) and 0 <= place < len(units):
        return owner.get(last), units[place]
    return owner.get(last), None


def in_unit_of_file(old: Any, unit: str | None, value: Any) -> Any:
    """A number in SI units, or a list of them, as a number in the unit of the file.

    Parameters
    ----------
    old
        Entry of the file: a number, a text with a unit, or a list of them.
    unit
        Unit of the entry, if it is not a text; None: SI.
    value
        Other values, such as a text with a unit, are returned as they are.
    """
    if isinstance(value, list):
        same = isinstance(old, list) and len(old) == len(value)
        return [
            in_unit_of_file(o, unit, v)
            for o, v in zip(old if same else [None] * len(value), value, strict=True)
        ]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return value
    factor = si_factor(old, unit)
    if factor == 1.0 or not abs(value) < 1e300:
        return value
    short = tidy(value / factor)  # without digits of rounding errors, if that is the same number
    return short if short * factor == value else value / factor


def si_factor(old: Any, unit: str | None) -> float:
    """Factor from the unit of an entry of a file to SI; 1 for a unit that is not known."""
    found = split_quantity(old) if isinstance(old, str) else None
    unit = found[1] if found is not None else unit
    try:
        return to_si(unit)[0] if unit else 1.0
    except InvalidParameter:  # such as N/m^p
        return 1.0


def _owner(raw: dict[str, Any], parts: list[str], where: str, value: Any = None) -> Any:
    """The table, quantity or list that contains the last part of a path."""
    node: Any = raw
    for i, part in enumerate(parts[:-1]):
        is_table = isinstance(node, dict) and isinstance(node.get(part), dict)
        is_list = isinstance(node, dict) and part in node and i == len(parts) - 2
        if not (is_table or is_list):
            raise _missing(raw, parts, i, where)
        node = node[part]
    last = parts[-1]
    if node is raw and last not in raw and not isinstance(value, Mapping) and _near(raw, last):
        raise _missing(raw, parts, 0, where)
    return node


def _missing(raw: dict[str, Any], parts: list[str], i: int, where: str) -> InvalidParameter:
    near = _near(raw, parts[i])
    return InvalidParameter(
        f"{where}: path {'.'.join(parts)!r}: {'.'.join(parts[: i + 1])!r} does not exist"
        + (f"; did you mean {' or '.join(near[:4])}?" if near else "")
    )


def _near(raw: Mapping[str, Any], name: str) -> list[str]:
    """Parts of a machine with a similar name, or with the name in their label."""
    wanted = _letters(name)
    labels = {part: label for part, label in _parts(raw) if label}
    found = [p for p, _ in _parts(raw) if p.rpartition(".")[2] == name]
    found += [p for p, label in labels.items() if wanted and wanted in _letters(label)]
    if not found:
        names = {p.rpartition(".")[2]: p for p, _ in _parts(raw)}
        found = [names[n] for n in difflib.get_close_matches(name, names, n=2, cutoff=0.75)]
    return [f"{p} ({labels[p]})" if p in labels else p for p in dict.fromkeys(found)]


def _parts(raw: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Parts of a machine, such as ``surfaces.Kp2``, with their labels."""
    for table, parts in raw.items():
        if isinstance(parts, Mapping) and not is_quantity(parts):
            for key, part in parts.items():
                if isinstance(part, Mapping) and not is_quantity(part):
                    # A screw is changed by its name alone.
                    name = key if table == "screws" else f"{table}.{key}"
                    yield name, "" if table == "screws" else str(part.get("label", ""))


def _letters(text: str) -> str:
    return "".join(c for c in text.lower() if c.isalnum())


def _set_one(owner: Any, parts: list[str], value: Any, where: str, note: str) -> None:
    """Replace the last part of a path; ``value`` is in the unit of the file."""
    last = parts[-1]
    # Source and note of an old value are removed; a number without a unit keeps the unit.
    if is_quantity(owner) and component(last) >= 0:
        text = split_quantity(value) if isinstance(value, str) else None
        if text is not None and text[1] and "unit" in owner:
            with suppress(InvalidParameter):  # the check of the file reports the fault
                value = tidy(text[0] * conversion_factor(text[1], owner["unit"]))
        _set_component(owner["value"], value, where, parts)
        for key in META_KEYS - {"value", "unit"}:
            owner.pop(key, None)
        owner["note"] = f"{last} {note}"
    elif not isinstance(owner, dict):
        _set_component(owner, value, where, parts)
    elif is_quantity(owner) and last not in META_KEYS:
        raise InvalidParameter(f"{where}: path {'.'.join(parts)!r} leads into a quantity")
    elif is_quantity(owner.get(last)) and not isinstance(value, (Mapping, str)):
        owner[last] = {"value": value, "unit": owner[last].get("unit", "1"), "note": note}
    else:
        owner[last] = _in_unit_of(owner.get(last), copy.deepcopy(value))


def _component(old: Any, where: str, parts: list[str]) -> int:
    key = parts[-1]
    index = component(key)
    if not isinstance(old, list) or not 0 <= index < len(old):
        raise InvalidParameter(f"{where}: path {'.'.join(parts)!r} does not exist")
    return index


def _set_component(old: Any, value: Any, where: str, parts: list[str]) -> None:
    index = _component(old, where, parts)
    old[index] = _in_unit_of(old[index], value)


def _changed(
    old: Any,
    unit: str | None,
    operator: str,
    value: Any,
    owner: Mapping[str, Any],
    parts: list[str],
    where: str,
) -> Any:
    """Value of a path after a change: in the unit of the entry, or a text with its unit."""
    last = parts[-1]
    what = f"{where}: {'.'.join(parts)} {operator}="
    if old is None:
        near = difflib.get_close_matches(last, owner, n=1)
        raise InvalidParameter(
            f"{what}: the file has no such number; "
            + (f"did you mean {near[0]!r}?" if near else "expected an entry of the file, or =")
        )
    if isinstance(old, Mapping):
        numbers = ", ".join(key for key, v in old.items() if not isinstance(v, str))
        raise InvalidParameter(f"{what}: is a table, expected one of its numbers: {numbers}")
    try:
        if not isinstance(old, list):
            return _combined(old, unit, operator, value)
        listed = isinstance(value, list)
        if len(value) != len(old) if listed else operator != "*":
            raise ValueError(
                f"got {shortened(repr(value))}, expected a component, such as "
                f"{'.'.join(parts)}.x, or a list of {len(old)} numbers"
            )
        amounts = value if listed else [value] * len(old)
        return [_combined(o, unit, operator, a) for o, a in zip(old, amounts, strict=True)]
    except (ValueError, InvalidParameter) as error:
        raise InvalidParameter(f"{what}: {error}") from None


def _combined(old: Any, unit: str | None, operator: str, value: Any) -> Any:
    """A number with an amount or a factor; raises ValueError with the fault."""
    found = split_quantity(old) if isinstance(old, str) else None
    if found is not None:
        old, unit = found[0], found[1] or None
    if isinstance(old, bool) or not isinstance(old, (int, float)):
        raise ValueError(f"the value is {shortened(repr(old))}, expected a number")
    if operator == "*":
        return tidy(old * parse_scalar(value, "1"))
    sign = 1 if operator == "+" else -1
    split = split_quantity(value) if isinstance(value, str) else None
    amount, given = split or (value, "")
    if isinstance(amount, bool) or not isinstance(amount, (int, float)):
        raise ValueError(
            f"got {shortened(repr(value))}, expected a number, with or without a unit"
            + (f" such as {unit}" if unit else "")
        )
    if not given:
        return tidy(old + sign * amount / si_factor(None, unit))
    if given == "%" != unit:
        raise ValueError(f"got {value!r}, expected an amount; for a share write *=, such as *=110%")
    if unit is not None:
        return tidy(old + sign * amount * conversion_factor(given, unit))
    factor, si = to_si(given)  # a number without a unit is in the SI unit of its field
    return f"{tidy(old + sign * amount * factor)!r} {si}"


def tidy(value: float) -> float:
    """A number without its last digits, which contain rounding errors."""
    return value if isinstance(value, int) else float(f"{value:.12g}")


def _in_unit_of(old: Any, value: Any) -> Any:
    """A bare number with the unit of the text that it replaces: 16 for ``"15 g"`` is ``"16 g"``.

    The same holds for each component of a list.
    """
    if isinstance(old, list) and isinstance(value, list) and len(old) == len(value):
        return [_in_unit_of(o, v) for o, v in zip(old, value, strict=True)]
    if not isinstance(old, str) or isinstance(value, bool) or not isinstance(value, (int, float)):
        return value
    found = split_quantity(old)
    if found is None or not abs(value) < math.inf or abs(value) > 1e300:
        return value
    return f"{float(value)!r} {found[1]}".strip()


@checked
def apply_values(raw: Mapping[str, Any], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Tables with changed values by dotted path; ``where`` is the caller's name for messages."""
    if not isinstance(values, Mapping):
        raise InvalidParameter(f"{where}: got {shortened(repr(values))}, expected paths and values")
    check_values(values, where)
    out = copy.deepcopy(dict(raw))
    faults = []
    for path, value in values.items():
        try:
            if not isinstance(path, str):
                raise InvalidParameter(f"{where}: path {path!r}: expected a text with dots")
            _change(out, path, value, where)
        except InvalidParameter as error:
            faults.append(str(error))
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


def check_values(values: Mapping[Any, Any], where: str) -> None:
    """Refuse values that cannot be copied, such as a generator, which no file can hold."""
    faults = []
    for path, value in values.items():
        try:
            copy.deepcopy(value)
        except Exception:  # of any kind, because a class can forbid it as it likes
            got = f"got {shortened(repr(value))}, expected a number, a text, a list or a table"
            faults.append(f"{where}: {path}: {got}")
    if faults:
        raise InvalidParameter("\n".join(faults))


def unit_in_file(raw: Mapping[str, Any], parts: Sequence[str]) -> str | None:
    """Unit that a file gives for an entry; "": it has none; None: the entry is not in the file."""
    node: Any = raw
    unit = ""
    for part in parts:
        if is_quantity(node) or isinstance(node, list):  # a component
            values = node["value"] if is_quantity(node) else node
            index = component(part)
            node = values[index] if isinstance(values, list) and index < len(values) else None
        elif isinstance(node, Mapping):
            three = node.get("unit")  # of a curve with the coefficients a, b, c
            if isinstance(three, list) and part in "abc":
                unit = str(three["abc".index(part)])
            node = node.get(part)
        else:
            return None
        if isinstance(node, str):
            unit = (split_quantity(node) or (0.0, ""))[1]
        elif is_quantity(node):
            unit = str(node.get("unit", ""))
    return None if node is None else unit


def is_bare(value: Any) -> bool:
    """Whether a value is a number without a unit, or a list of such numbers."""
    if isinstance(value, (list, tuple)):
        return bool(value) and all(is_bare(v) for v in value)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


#: Tables of parts whose numbers refer to nothing else in the file.
_TABLES_OF_NUMBERS = ("bodies", "surfaces", "contacts", "springs", "straps", "points")


def apply_numbers(
    raw: Mapping[str, Any], values: Mapping[str, Any]
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Tables with changed numbers, which share the rest, and the changed parts.

    Raises ValueError if a value is not a single number of a part, bare or with a unit.
    """
    out = dict(raw)
    touched: list[tuple[str, str]] = []
    if not isinstance(values, Mapping) or not all(isinstance(path, str) for path in values):
        raise ValueError("paths and values")
    for path, value in values.items():
        number = value.item() if hasattr(value, "item") else value
        measured = isinstance(number, str) and (split_quantity(number) or ("", ""))[1]
        if not measured and (isinstance(number, bool) or not isinstance(number, (int, float))):
            raise ValueError(path)
        for parts in expand_path(out, split_operator(path)[0]):
            if len(parts) < 3 or parts[0] not in _TABLES_OF_NUMBERS:
                raise ValueError(path)
            table, key = parts[:2]
            if (table, key) not in touched:
                touched.append((table, key))
                out[table] = {**out[table], key: copy.deepcopy(out[table][key])}
        _change(out, path, number, "with_values")
    return out, touched


_DEEPEST = 50  # nested tables and lists


@checked
def plain_data(node: Any, depth: int = 0) -> Any:
    """Copy of a file's tables without NumPy objects."""
    if depth > _DEEPEST:
        raise InvalidParameter("tables are nested too deeply")
    if isinstance(node, Mapping):
        return {key: plain_data(value, depth + 1) for key, value in node.items()}
    if isinstance(node, (list, tuple)):
        return [plain_data(value, depth + 1) for value in node]
    return node.tolist() if hasattr(node, "tolist") else node
