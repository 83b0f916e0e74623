"""Tests of single parts as data, for example the weight or the stiffness of one part.

::

    [measured."felt.04"]
    value = "3 %"
    sd = "2 %"
    how = "compression test of 2026-11-20"

    [measured.string_distance]
    value = "1.9 mm"
    sd = "0.1 mm"

The first is a parameter of the model, and the test replaces its tolerance. The second is an effect
that the model lacks. With a measured magnitude it becomes a parameter of the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from feltmb.arguments import checked
from feltmb.errors import DataError, InvalidParameter, near_names
from feltmb.files import read_toml, write_text
from feltmb.fit.inclusion import including
from feltmb.fit.model import Effect, Model, Parameter
from feltmb.units.quantity import Schema, fault_lines, fault_text, parse_scalar

__all__ = [
    "Measured",
    "TableReader",
    "in_unit",
    "measured_toml",
    "no_test_of",
    "read_measured",
    "with_measured",
]

#: Number of known names in a message.
MOST_NAMES = 20


@checked
@dataclass(frozen=True, kw_only=True)
class Measured:
    """Result of a separate test of a part: the value of a parameter, or the magnitude of an effect.

    The value of a parameter replaces its tolerance. An effect becomes a parameter.
    """

    parameter: str
    """Name of the parameter or of the effect."""
    value: float
    """[unit of the parameter]"""
    sd: float
    """Standard deviation [unit of the parameter]."""
    how: str = ""

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise InvalidParameter(
                f"measured {self.parameter}: value = {self.value!r}, expected a finite number"
            )
        if not 0.0 < self.sd < math.inf:
            raise InvalidParameter(
                f"measured {self.parameter}: sd = {self.sd!r}, expected finite, > 0"
            )


class _Entry(Schema):
    value: float | str
    sd: float | str
    how: str = ""


class _MeasuredFile(Schema):
    measured: dict[str, _Entry]


@checked
def read_measured(
    path: str | Path, model: Model, effects: Sequence[Effect] = ()
) -> tuple[Measured, ...]:
    """Read ``[measured.NAME]`` tables with ``value``, ``sd`` and ``how``.

    Numbers are in the unit of the parameter or effect, or texts with a unit; a share may be
    ``"3 %"``.

    Parameters
    ----------
    path
        TOML file.
    model
        Model whose parameters were measured.
    effects
        Effects that the model lacks, whose magnitudes may have been measured too.

    Returns
    -------
    tuple of Measured
        Tests in the order of the file.

    Raises
    ------
    DataError
        All faults of the file in one message: unknown names, then keys and types, then numbers. The
        numbers of an unknown name are not checked, because their unit is unknown.
    """
    read = TableReader(path, _MeasuredFile)
    units = units_of_tests(model, effects)
    table = read.raw.get("measured")
    read.check(
        f"measured.{name}: {why}"
        for name in (table if isinstance(table, dict) else {})
        if (why := no_test_of(name, model, effects))
    )
    out = []
    for name, where, entry in read.entries("measured"):
        if name not in units:
            continue
        value, sd = (read.number(where, entry, key, units[name]) for key in ("value", "sd"))
        how = {"how": entry["how"]} if "how" in entry else {}
        out.append(
            read.made(
                ("measured", name),
                f"{where}: ",
                Measured,
                parameter=name,
                value=value,
                sd=sd,
                **how,
            )
        )
    read.finish()
    return tuple(m for m in out if m is not None)


def hint_of_names(name: str, known: Iterable[str]) -> str:
    """The end of a message: names that are similar to an unknown one, or the first of all."""
    names = list(dict.fromkeys(known))
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return near_names(name, names) or f"; there are {', '.join(names[:MOST_NAMES])}{more}"


def no_test_of(name: str, model: Model, effects: Sequence[Effect] = ()) -> str:
    """Reason why a test of a part by itself cannot give a parameter or effect; empty: it can."""
    parameters = [p.name for p in model.parameters]
    known = {e.name: e for e in effects}
    if name in parameters:
        return ""
    if name not in known:
        kind = "parameter or tested effect" if known else "parameter"
        return f"no {kind} of {model.name}{hint_of_names(name, [*parameters, *known])}"
    effect = known[name]
    if effect.observe is not None or effect.excite is not None:
        return (
            "an effect of the records and not of the machine: correct the records by the measured "
            "value, and leave the effect out"
        )
    if effect.tolerance_parameter in parameters:
        return f"it changes the same number as {effect.tolerance_parameter}: give that parameter"
    return ""


def known_by_test(effect: Effect, model: Model) -> str:
    """Parameter whose test measured what an effect changes; empty: none.

    The test measured the number as it is, with the effect. The effect is then no cause besides it.
    """
    tested = {p.name for p in model.parameters if p.before is not None}
    return effect.tolerance_parameter if effect.tolerance_parameter in tested else ""


def open_effects(effects: Sequence[Effect], model: Model) -> list[Effect]:
    """Effects that the model can simulate and that no test has measured."""
    return [
        e
        for e in effects
        if (model.accepts(e) or e.observe or e.excite) and not known_by_test(e, model)
    ]


def units_of_tests(model: Model, effects: Sequence[Effect] = ()) -> dict[str, str]:
    """Unit by name of all parameters and effects.

    An effect with the name of a parameter changes the same number: the parameter is meant.
    """
    return {e.name: e.unit for e in effects} | {p.name: p.unit for p in model.parameters}


@checked
def with_measured(
    model: Model, measured: Sequence[Measured], effects: Sequence[Effect] = ()
) -> Model:
    """Copy of the model with the values and uncertainties of tests of parts.

    Several tests of one parameter are combined.

    Parameters
    ----------
    model
        Model of the machine.
    measured
        Tests of its parameters, and of ``effects``.
    effects
        Effects that the model lacks. Those that were measured become parameters of the model, with
        the measured magnitude and its standard deviation as the prior. Of an effect with several
        shapes, the first counts. A diagnosis of this model does not test them as causes.

    Returns
    -------
    feltmb.fit.Model
        The model itself if nothing was measured.

    Raises
    ------
    InvalidParameter
        A parameter or effect that does not exist, or a value beyond its limits. An effect of a
        sensor or an input, for which the records must be corrected, or one that changes the same
        number as a parameter, which must be given instead.
    """
    parameters = {p.name: p for p in model.parameters}
    known = {e.name: e for e in effects}
    by_name: dict[str, list[Measured]] = {}
    for m in measured:
        by_name.setdefault(m.parameter, []).append(m)
    reasons = {name: no_test_of(name, model, effects) for name in by_name}
    faults = [f"{name}: {why}" for name, why in reasons.items() if why]
    magnitudes: dict[str, tuple[float, float]] = {}
    changed: dict[str, Parameter] = {}
    for name, tests in by_name.items():
        if reasons[name]:
            continue
        value, sd = _combined(tests)
        if name in parameters:
            p = parameters[name]
            (lower, upper), unit = (p.lower, p.upper), p.unit
            changed[name] = replace(p, sd=sd, before=p.before or p)
        else:
            (lower, upper), unit = known[name].bounds, known[name].unit
            magnitudes[name] = value, sd
        if not lower <= value <= upper:
            faults.append(
                f"{name}: got {value:g} {unit}, expected a value in [{lower:g}, {upper:g}]"
            )
        elif name in changed:
            changed[name] = replace(changed[name], value=value)
    if faults:
        raise InvalidParameter("measured: " + "; ".join(faults))
    out = model.with_parameters(changed) if changed else model
    if not magnitudes:
        return out
    values, sds = zip(*magnitudes.values(), strict=True)
    out = including(out, [known[name] for name in magnitudes], values, sds)
    unknown = {p.name: replace(p, value=0.0, sd=math.inf) for p in out.own}
    return out.with_parameters({p.name: replace(p, before=unknown[p.name]) for p in out.own})


def _combined(tests: Sequence[Measured]) -> tuple[float, float]:
    """Mean of tests of one number, weighted by their accuracy, and its standard deviation."""
    best = min(m.sd for m in tests)
    weights = [(best / m.sd) ** 2 for m in tests]  # at most 1, so that no square overflows
    value = sum(w * m.value for w, m in zip(weights, tests, strict=True)) / sum(weights)
    return value, best / math.sqrt(sum(weights))


@checked
def measured_toml(measured: Sequence[Measured], path: str | Path, *, force: bool = False) -> Path:
    """Write tests of parts to a file that :func:`read_measured` can read.

    Parameters
    ----------
    measured
        Tests of parts.
    path
        File to be written.
    force
        Replace a file that exists.

    Returns
    -------
    pathlib.Path
        The file.
    """
    import tomlkit

    tables = {
        m.parameter: {k: getattr(m, k) for k in ("value", "sd", "how") if getattr(m, k) != ""}
        for m in measured
    }
    return write_text(Path(path), tomlkit.dumps({"measured": tables}), force=force)


# -------------------------------------------------------------------------------- tables of a file


T = TypeVar("T")


class TableReader:
    """Collects the faults of a file: names, then keys and kinds, then numbers.

    A fault of one entry does not hide those of another. If the model does not have the name of an
    entry, only the name is reported, because the unit of its numbers is unknown.
    """

    def __init__(self, path: str | Path, schema: type[BaseModel]):
        self.path = Path(path)
        self.raw: dict[str, Any] = read_toml(self.path)
        self.faults: list[str] = []
        self._schema = schema
        self._bad: set[tuple[Any, ...]] = set()

    def check(self, strange: Iterable[str]) -> None:
        """Collect names that the model does not have, and faults of the schema."""
        self.faults += strange
        try:
            self._schema.model_validate(self.raw)
        except ValidationError as error:
            self.faults += fault_lines(error, self._schema)
            self._bad = {tuple(item["loc"]) for item in error.errors(include_url=False)}

    def entries(self, table: str) -> Iterator[tuple[Any, str, dict[str, Any]]]:
        """Key or place, name in a message, and content of the tables below a name."""
        found = self.raw.get(table)
        rows: Iterable[tuple[Any, Any]] = found.items() if isinstance(found, dict) else ()
        for key, entry in enumerate(found) if isinstance(found, list) else rows:
            if isinstance(entry, dict):
                yield key, f"{table}.{key}", entry

    def number(
        self,
        where: str,
        entry: dict[str, Any],
        key: str,
        unit: str,
        missing: float = math.nan,
        hint: str = "",
    ) -> float:
        """A number in an SI unit; nan where it has a fault.

        ``missing``: where the entry does not say it; nan: the schema asks for it.
        """
        value = entry.get(key)
        if value is None:
            return missing
        wild = isinstance(value, float) and not math.isfinite(value)
        if wild or not isinstance(value, (int, float, str)):
            return math.nan  # a fault of the schema
        try:
            return in_unit(value, unit)
        except (ValueError, InvalidParameter) as error:
            self.faults.append(f"{where}.{key}: got {value!r}; {error}{hint}")
            return math.nan

    def made(
        self, place: tuple[Any, ...], where: str, kind: Callable[..., T], **values: Any
    ) -> T | None:
        """An object of an entry; None where the entry has a fault.

        ``place``: of the entry in the file; empty: the whole file.
        """
        told = any(isinstance(v, float) and math.isnan(v) for v in values.values())
        if told or (place and any(b[: len(place)] == place for b in self._bad)):
            return None
        try:
            return kind(**values)
        except InvalidParameter as error:
            self.faults.append(f"{where}{error}")
            return None

    def finish(self) -> None:
        """End the reading.

        Raises
        ------
        DataError
            All faults that were found.
        """
        if self.faults:
            raise DataError(fault_text(self.path.name, self.faults))


def in_unit(value: float | str, unit: str) -> float:
    """A number, or a text with a unit, in an SI unit; shares may be in percent.

    Raises
    ------
    ValueError
        It is none.
    """
    if isinstance(value, str) and value.strip().endswith("%") and unit == "1":
        return 0.01 * parse_scalar(value.strip().removesuffix("%").strip(), "1")
    return parse_scalar(value, unit)
