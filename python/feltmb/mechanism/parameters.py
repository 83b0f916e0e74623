"""The numbers of a mechanism by dotted path, in SI, and mechanisms with changed values.

A path is the same as for ``--set``: ``bodies.key.mass`` or ``key.mass``, ``contacts.06.loading.a``,
``bodies.key.position.x``, ``contacts.*.alpha``. A changed mechanism is made in a fraction of a
millisecond, because unchanged parts are shared.
"""

from __future__ import annotations

import difflib
import fnmatch
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Protocol, TypeVar

from pydantic import BaseModel, ValidationError

from feltmb import _core
from feltmb.mechanism import Action, MechanismFile, describe, expand_path, parse_setting
from feltmb.mechanism.numbers import Parameter, numbers_below, read_entry, replace_entry
from feltmb.mechanism.values import AXES, is_bare, si_factor, split_operator, unit_in_file
from feltmb.mechanism.workshop import notes_of_turns, plain_values
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.units import conversion_factor, unit_suffix

__all__ = [
    "Parameter",
    "all_parameters",
    "bare_numbers",
    "find_parameters",
    "mechanism_with",
    "notes_of_bare_numbers",
    "notes_of_numbers",
    "notes_of_paths",
    "with_noted_values",
]

#: Tables whose numbers are parameters of the equations of motion.
TABLES = (
    *("gravity", "bodies", "surfaces", "contacts", "springs", "straps", "string", "finger"),
    *("points", "leads"),
)


class _OfFile(Protocol):
    """A mechanism or an actuator, as its file describes it."""

    @property
    def config(self) -> Any: ...

    @property
    def raw(self) -> dict[str, Any]: ...

    def with_values(self, values: Mapping[str, Any]) -> Any: ...


_M = TypeVar("_M", bound=_OfFile)


#: Changed numbers of one setting that are listed.
SHOWN = 3


@checked
def notes_of_numbers(before: _OfFile, after: _OfFile, values: Mapping[str, Any]) -> list[str]:
    """Sentences about changes by an amount or a factor, and about numbers without a unit.

    They state what the numbers became and what they were: changes in the unit of the file, numbers
    without a unit in SI units.

    Parameters
    ----------
    before, after
        The model without and with the values.
    values
        Values by dotted path, as for ``Action.with_values``.
    """
    notes = []
    was = now = None
    for given, value in values.items():
        path, operator = split_operator(given)
        bare = is_bare(value) and operator != "*"
        if not (operator or bare):
            continue
        if was is None:
            was = {p.path: p for p in _numbers_of(before.config)}
            now = _numbers_of(after.config)
        assert now is not None
        texts = []
        at = list(_at(after, path, now))
        for p, unit in at:
            old = was.get(p.path)
            if operator and old is not None:
                factor, name = 1.0 / conversion_factor(unit, p.unit), unit_suffix(unit)
                texts.append(
                    f"{p.path} {old.value * factor:.6g}{name} -> {p.value * factor:.6g}{name}"
                )
            elif p.unit != "1" and (old is None or old.value != p.value):
                before_it = f" (was {old.value:g} {p.unit})" if old is not None else ""
                texts.append(f"{p.path} = {p.value:g} {p.unit}{before_it}")
        if texts:
            more = f"; and {len(texts) - SHOWN} more" if len(texts) > SHOWN else ""
            ruled = bare and any(p.unit != "1" for p, _ in at)
            rule = f". A number without a unit is in SI units{_other_units(at)}" if ruled else ""
            notes.append(f"{'; '.join(texts[:SHOWN])}{more}{rule}")
    return notes


def _other_units(at: Iterable[tuple[Parameter, str]]) -> str:
    """The units of a file that are not SI, as the end of a sentence; "" if there are none."""
    other = dict.fromkeys(u for p, u in at if si_factor(None, u) != 1.0)
    return f"; the file has {', '.join(other)}" if other else ""


@checked
def notes_of_paths(model: _OfFile, values: Mapping[str, Iterable[Any]]) -> list[str]:
    """Sentences about paths with numbers without a unit where the file has another unit than SI.

    Parameters
    ----------
    values
        Values by dotted path, as for ``sweep``.
    """
    numbers = _numbers_of(model.config)
    notes = []
    for given_path, given in values.items():
        path, operator = split_operator(given_path)
        bare = operator != "*" and any(map(is_bare, given))
        at = list(_at(model, path, numbers)) if bare else []
        if other := _other_units(at):
            notes.append(f"{path}: numbers without a unit are in SI units, {at[0][0].unit}{other}")
    return notes


def _at(model: _OfFile, path: str, numbers: list[Parameter]) -> Iterator[tuple[Parameter, str]]:
    """Numbers at a path, each with the unit that the file gives."""
    raw = model.raw
    for parts in expand_path(raw, path):
        unit = unit_in_file(raw, parts[:-1] if parts[-1] == "value" else parts)
        start = ".".join(parts).removesuffix(".value")
        for k, axis in enumerate(AXES):
            start = f"{start[:-2]}.{axis}" if start.endswith(f".{k}") else start
        for p in numbers:
            if p.path == start or p.path.startswith(f"{start}."):
                yield p, unit or p.unit


@checked
def bare_numbers(model: _OfFile) -> list[tuple[Parameter, tuple[str, ...]]]:
    """Numbers of a file without a unit, which are in SI units, with other units of the file.

    The other units are those that the file gives to the same quantity, such as mm for a length in
    m. Zeros and numbers without dimension are omitted.

    Parameters
    ----------
    model
        A mechanism or an actuator.
    """
    raw = model.raw
    bare: list[Parameter] = []
    units: dict[str, dict[str, None]] = {}
    for p in numbers_below(model.config, model.config, [], []):
        unit = None if p.unit == "1" else unit_in_file(raw, p.path.split("."))
        if unit == "" and p.value != 0.0:
            bare.append(p)
        elif unit and conversion_factor(unit, p.unit) != 1.0:
            units.setdefault(p.unit, {})[unit] = None
    return [(p, tuple(units.get(p.unit, ()))) for p in bare]


@checked
def notes_of_bare_numbers(model: _OfFile) -> tuple[list[str], list[str]]:
    """Numbers without a unit as text with their SI unit, and sentences about doubtful ones.

    A number is doubtful if the file gives other units to the same quantity elsewhere.
    """
    plain, doubtful = [], []
    for p, units in bare_numbers(model):
        plain.append(f"{p.path} = {p.value:g} {p.unit}")
        if units:
            doubtful.append(
                f"{plain[-1]}: has no unit, and other numbers of the file are in "
                f"{', '.join(units)}; write the unit"
            )
    return plain, doubtful


@checked
def with_noted_values(
    model: _M, settings: Sequence[str], notify: Callable[[str], None] | None = None
) -> _M:
    """Model of a file with the values of settings; tells what changed numbers became.

    Parameters
    ----------
    model
        A mechanism or an actuator.
    settings
        ``PATH=VALUE``, ``PATH+=AMOUNT``, ``PATH-=AMOUNT`` or ``PATH*=FACTOR``, as for ``--set``.
    notify
        Function that receives the sentences of :func:`notes_of_numbers`; None: they are lost.

    Raises
    ------
    InvalidParameter
        A path does not exist or is given twice, or a value is invalid.
    """
    if not settings:
        return model
    values: dict[str, Any] = {}
    for path, value in map(parse_setting, settings):
        if path == "lead":
            value = [*values.get(path, []), value]
        elif path in values:
            raise InvalidParameter(f"--set {path}: given twice, expected once")
        values[path] = value
    changed: _M = model.with_values(values)
    if notify is not None:
        plain: Mapping[str, Any] = values
        if isinstance(model, Action):
            for text in notes_of_turns(model.config, values):
                notify(text)
            plain = plain_values(model.config, model.raw, values)
        for text in notes_of_numbers(model, changed, plain):
            notify(text)
    return changed


def _numbers_of(config: BaseModel) -> list[Parameter]:
    return list(numbers_below(config, config, [], [], counts=True))


@checked
def all_parameters(action: Action) -> list[Parameter]:
    """Every number that the equations of motion may depend on, in the order of the file.

    Numbers of unused laws and shapes are included; their derivative is zero.
    """
    return list(_listed(action))


@lru_cache(maxsize=16)
def _listed(action: Action) -> tuple[Parameter, ...]:
    out: list[Parameter] = []
    for table in TABLES:
        out += numbers_below(action.config, getattr(action.config, table), [action.config], [table])
    return tuple(out)


@checked
def find_parameters(action: Action, paths: str | Iterable[str]) -> list[Parameter]:
    """Parameters by path. ``*`` means any part of a name, a body's name means ``bodies.NAME``.

    Raises
    ------
    InvalidParameter
        Some paths name no real number; all of them are in the message.
    """
    known = {p.path: p for p in all_parameters(action)}
    out: dict[str, Parameter] = {}
    faults = []
    for given in [paths] if isinstance(paths, str) else list(paths):
        found = _matches(action, known, given)
        if not found:
            near = difflib.get_close_matches(str(given), known, n=3, cutoff=0.5)
            hint = f"; near are {', '.join(near)}" if near else ""
            faults.append(
                f"parameter {shortened(repr(given))} names no real number of {action.name!r}{hint}"
            )
        out.update((path, known[path]) for path in found)
    if faults:
        raise InvalidParameter("\n".join(faults))
    return list(out.values())


def _matches(action: Action, known: Mapping[str, Parameter], given: object) -> list[str]:
    if not isinstance(given, str) or not given:
        return []
    parts = given.split(".")
    if parts[0] not in TABLES and parts[0] in action.config.bodies:
        parts = ["bodies", *parts]
    for i, digit in enumerate(parts):
        if digit in ("0", "1") and i == len(parts) - 1:
            parts[i] = AXES[int(digit)]
    text = ".".join(parts)
    if text in known:
        return [text]
    return [
        path
        for path in known
        if path.count(".") == len(parts) - 1
        and all(fnmatch.fnmatchcase(a, b) for a, b in zip(path.split("."), parts, strict=True))
    ]


# --- mechanisms with changed numbers -------------------------------------------------------------


def _check(config: MechanismFile, path: str) -> None:
    """Check the limits of a number (> 0 and so on) as in a file; raises ValidationError."""
    owner = read_entry(config, path.rpartition(".")[0])
    if isinstance(owner, BaseModel):
        fields = type(owner).model_fields
        set_here = {*owner.model_fields_set, path.rpartition(".")[2]}
        type(owner).model_validate({fields[n].alias or n: getattr(owner, n) for n in set_here})


@checked
def mechanism_with(
    action: Action, values: Mapping[str, float], known: dict[int, Any] | None = None
) -> _core.Mechanism:
    """Mechanism for the core with changed numbers.

    Parameters
    ----------
    values
        Numbers in SI units by full path, as returned by :func:`find_parameters`.
    known
        Cache of parts, kept between calls; one dictionary per action.

    Raises
    ------
    InvalidParameter
        A value is out of range.
    """
    config = action.config
    for path, value in values.items():
        if not math.isfinite(value):
            raise InvalidParameter(f"{path} = {value!r}, must be finite")
        try:
            config = replace_entry(config, path, float(value))
            _check(config, path)
        except ValidationError as error:
            text = error.errors()[0]["msg"]
            raise InvalidParameter(f"{path} = {value:g}: {text}") from None
    return _core.assemble(describe(config, known))
