"""Files of permitted experiments (``limits.toml``) and of sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from feltmb.arguments import checked
from feltmb.fit.limits import FurtherSensor, InputLimits, Limits, PartTest, unknown_names
from feltmb.fit.model import Effect, Model
from feltmb.gap.measured import units_of_tests
from feltmb.gap.tables import TableReader
from feltmb.units.quantity import SI, Schema

__all__ = ["read_limits", "read_sensors"]


class _Input(Schema):
    unit: str = ""
    least: float | str = 0.0
    most: float | str
    rate: float | str | None = None
    acceleration: float | str | None = None
    sigma: float | str = 0.0


class _Part(Schema):
    parameter: str
    sd: float | str
    cost: Annotated[float, Field(gt=0)] = 1.0
    how: str = ""


class _Sensor(Schema):
    sigma: float | str


class _SensorsFile(Schema):
    sensors: dict[str, _Sensor]


class _Further(Schema):
    output: str
    sigma: float | str | None = None
    cost: Annotated[float, Field(gt=0)] = 1.0
    how: str = ""


class _Times(Schema):
    duration: Annotated[float, SI("s"), Field(gt=0)]
    sample_rate: Annotated[float, SI("Hz"), Field(gt=0)] = 2000.0
    rest: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    lead: Annotated[float, SI("s"), Field(ge=0)] = 0.01


class _LimitsFile(_Times):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    about: str = ""
    inputs: dict[str, _Input]
    sensors: dict[str, _Sensor] = Field(default_factory=dict)
    parts: list[_Part] = Field(default_factory=list)
    further_sensors: list[_Further] = Field(default_factory=list)


#: Placeholders for invalid inputs and times, so that the rest can be checked.
_ANY = {"": InputLimits(most=1.0)}
_ANY_TIMES = {"duration": 1.0, "sample_rate": 1000.0, "rest": 0.0, "lead": 0.0}


def _names_in(raw: Mapping[str, Any]) -> tuple[list[str], list[str], list[str], list[str]]:
    """Names of inputs, sensors, parameters and further sensors in a file with possible faults."""
    tables = [t if isinstance(t, dict) else {} for t in (raw.get("inputs"), raw.get("sensors"))]

    def named(table: str, key: str) -> list[str]:
        rows = raw.get(table)
        return [
            row[key]
            for row in (rows if isinstance(rows, list) else [])
            if isinstance(row, dict) and isinstance(row.get(key), str)
        ]

    parts, further = named("parts", "parameter"), named("further_sensors", "output")
    return list(tables[0]), list(tables[1]), parts, further


def _hint(unit: str) -> str:
    return '; hint: the table says its unit, unit = "N"' if unit == "1" else ""


def _per(unit: str, power: int) -> str:
    second = "s" if power == 1 else f"s^{power}"
    return f"1/{second}" if unit == "1" else f"{unit}/{second}"


@checked
def read_limits(path: str | Path, model: Model, effects: Sequence[Effect] | None = ()) -> Limits:
    """Read ``limits.toml``: the limits of experiments with a model.

    Numbers are in SI units, or texts with a unit (``"20 N"``, ``"2 kN/s"``, ``"0.02 mm"``; a share
    may be ``"2 %"``).

    Parameters
    ----------
    path
        TOML file.
    model
        Model of the machine that will be measured.
    effects
        Effects that the model lacks, which a test of a part may measure; None: they are not known
        yet, and tests of parts are not read.

    Returns
    -------
    Limits
        Limits of the inputs, tests of parts, and sensors.

    Raises
    ------
    DataError
        All faults of the file in one message: unknown names, then keys and types, then numbers. The
        numbers of an unknown name are not checked, because their unit is unknown.
    """
    read = TableReader(path, _LimitsFile)
    if effects is None:
        read.raw.pop("parts", None)
    effects = effects or ()
    strange = unknown_names(model, effects, *_names_in(read.raw))
    read.check(strange.values())

    inputs: dict[str, InputLimits | None] = {}
    for name, where, entry in read.entries("inputs"):
        if ("inputs", name) in strange:
            continue
        told = entry.get("unit")
        unit = (told if isinstance(told, str) else "") or model.units.get(name) or "1"

        number = partial(read.number, where, entry)
        change, bend = _per(unit, 1), _per(unit, 2)
        inputs[name] = read.made(
            ("inputs", name),
            f"{where}: ",
            InputLimits,
            least=number("least", unit, 0.0, _hint(unit)),
            most=number("most", unit, hint=_hint(unit)),
            rate=number("rate", change, math.inf, _hint(unit)),
            acceleration=number("acceleration", bend, math.inf, _hint(unit)),
            sigma=number("sigma", unit, 0.0, _hint(unit)),
            unit=unit,
        )
    own = units_of_tests(model, effects)
    parts = []
    for at, where, entry in read.entries("parts"):
        name = entry.get("parameter")
        if isinstance(name, str) and ("parts", name) not in strange:
            known: dict[str, Any] = {k: entry[k] for k in ("cost", "how") if k in entry}
            known["sd"] = read.number(where, entry, "sd", own[name])
            parts.append(read.made(("parts", at), f"{where}: ", PartTest, parameter=name, **known))
    further = []
    for at, where, entry in read.entries("further_sensors"):
        name = entry.get("output")
        if isinstance(name, str) and name in model.outputs:
            known = {k: entry[k] for k in ("cost", "how") if k in entry}
            if "sigma" in entry:
                unit = model.units.get(name) or "1"
                known["sigma"] = read.number(where, entry, "sigma", unit)
            place = ("further_sensors", at)
            further.append(read.made(place, f"{where}: ", FurtherSensor, output=name, **known))
    sensors = _sigmas(read, model, strange)
    given = read.raw.get("inputs")
    found = read.made(
        (),
        "",
        Limits,
        inputs={n: i for n, i in inputs.items() if i} or ({} if given == {} else _ANY),
        parts=tuple(p for p in parts if p is not None),
        sensors={name: sigma for name, sigma in sensors.items() if not math.isnan(sigma)},
        further=tuple(s for s in further if s is not None),
        **_times_in(read.raw),
    )
    read.finish()
    assert found is not None
    return found


def _sigmas(
    read: TableReader, model: Model, strange: Mapping[tuple[str, str], str]
) -> dict[str, float]:
    """Noise of each known output in the tables ``[sensors.OUTPUT]`` [its unit]."""
    return {
        name: read.number(where, entry, "sigma", model.units.get(name) or "1")
        for name, where, entry in read.entries("sensors")
        if ("sensors", name) not in strange
    }


@checked
def read_sensors(path: str | Path, model: Model) -> dict[str, float]:
    """Read ``[sensors.OUTPUT]`` tables with ``sigma``: noise by output [its unit].

    Raises
    ------
    DataError
        All faults of the file at once.
    """
    read = TableReader(path, _SensorsFile)
    table = read.raw.get("sensors")
    strange = unknown_names(model, (), (), table if isinstance(table, dict) else (), (), ())
    read.check(strange.values())
    out = _sigmas(read, model, strange)
    for name, sigma in out.items():
        if sigma <= 0.0:
            read.faults.append(f"sensors.{name}.sigma: got {sigma:g}, expected > 0")
    read.finish()
    return out


def _times_in(raw: Mapping[str, Any]) -> dict[str, float]:
    """Times that a file says, or any where they have faults of their own."""
    try:
        told = {name: raw[name] for name in _Times.model_fields if name in raw}
        return _Times.model_validate(told).model_dump()
    except ValidationError:
        return _ANY_TIMES
