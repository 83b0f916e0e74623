"""Files of permitted experiments (``limits.toml``), and their check against a model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.fit.limits import InputLimits, Limits, PartTest
from feltmb.fit.model import Effect, Model
from feltmb.gap.measured import TableReader, no_test_of, units_of_tests
from feltmb.units.quantity import SI, Schema

__all__ = ["check_limits", "read_limits"]


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


class _Times(Schema):
    duration: Annotated[float, SI("s"), Field(gt=0)]
    sample_rate: Annotated[float, SI("Hz"), Field(gt=0)] = 2000.0
    lead: Annotated[float, SI("s"), Field(ge=0)] = 0.01


class _LimitsFile(_Times):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    about: str = ""
    inputs: dict[str, _Input]
    sensors: dict[str, _Sensor] = Field(default_factory=dict)
    further_sensors: dict[str, _Sensor] = Field(default_factory=dict)
    parts: list[_Part] = Field(default_factory=list)


#: Placeholders for invalid inputs and times, so that the rest can be checked.
_ANY = {"": InputLimits(most=1.0)}
_ANY_TIMES = {"duration": 1.0, "sample_rate": 1000.0, "lead": 0.0}
#: Tables of sensors.
SENSORS = ("sensors", "further_sensors")


def check_limits(limits: Limits, model: Model, effects: Sequence[Effect] = ()) -> None:
    """Refuse limits with names that the model does not have, or effects that no test measures."""
    faults = _unknown_names(
        model,
        effects,
        {
            "inputs": limits.inputs,
            "sensors": limits.sensors,
            "further_sensors": limits.further,
            "parts": [t.parameter for t in limits.parts],
        },
    )
    if faults:
        raise InvalidParameter("limits: " + "; ".join(faults.values()))


def _unknown_names(
    model: Model, effects: Sequence[Effect], names: Mapping[str, Iterable[str]]
) -> dict[tuple[str, str], str]:
    """Messages about names that the model does not have, by table and name."""
    inputs = list(model.inputs) + [i for own in model.input_modes.values() for i in own]
    faults = {}
    for i in names["inputs"]:
        if inputs and i not in inputs:
            faults["inputs", i] = (
                f"input {i}: no input of {model.name}; there are {', '.join(inputs)}"
            )
    for table in SENSORS:
        for s in names[table]:
            if s not in model.outputs:
                faults[table, s] = (
                    f"{table.replace('_', ' ').removesuffix('s')} {s}: no output of {model.name}; "
                    f"there are {', '.join(model.outputs)}"
                )
    for t in names["parts"]:
        if why := no_test_of(t, model, effects):
            faults["parts", t] = f"part {t}: {why}"
    return faults


def _names_in(raw: Mapping[str, Any]) -> dict[str, list[str]]:
    """Names by table in a file with possible faults."""
    found = {
        t: list(own) if isinstance(own := raw.get(t), dict) else [] for t in ("inputs", *SENSORS)
    }
    rows = raw.get("parts")
    found["parts"] = [
        row["parameter"]
        for row in (rows if isinstance(rows, list) else [])
        if isinstance(row, dict) and isinstance(row.get("parameter"), str)
    ]
    return found


@checked
def read_limits(path: str | Path, model: Model, effects: Sequence[Effect] = ()) -> Limits:
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
        Effects that the model lacks, which a test of a part may measure.

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
    strange = _unknown_names(model, effects, _names_in(read.raw))
    read.check(strange.values())
    inputs = {
        name: _input(read, name, where, entry, model)
        for name, where, entry in read.entries("inputs")
        if ("inputs", name) not in strange
    }
    own = units_of_tests(model, effects)
    parts = []
    for at, where, entry in read.entries("parts"):
        name = entry.get("parameter")
        if isinstance(name, str) and ("parts", name) not in strange:
            known: dict[str, Any] = {k: entry[k] for k in ("cost", "how") if k in entry}
            known["sd"] = read.number(where, entry, "sd", own[name])
            parts.append(read.made(("parts", at), f"{where}: ", PartTest, parameter=name, **known))
    sensors, further = (
        {
            name: sigma
            for name, where, entry in read.entries(table)
            if (table, name) not in strange
            and not math.isnan(
                sigma := read.number(where, entry, "sigma", model.units.get(name) or "1")
            )
        }
        for table in SENSORS
    )
    given = read.raw.get("inputs")
    found = read.made(
        (),
        "",
        Limits,
        inputs={n: i for n, i in inputs.items() if i} or ({} if given == {} else _ANY),
        parts=tuple(p for p in parts if p is not None),
        sensors=sensors,
        further=further,
        **_times_in(read.raw),
    )
    read.finish()
    assert found is not None
    return found


def _input(
    read: TableReader, name: str, where: str, entry: dict[str, Any], model: Model
) -> InputLimits | None:
    """Limits of one input; None: they have a fault."""
    told = entry.get("unit")
    unit = (told if isinstance(told, str) else "") or model.units.get(name) or "1"
    hint = '; hint: the table says its unit, unit = "N"' if unit == "1" else ""
    number = partial(read.number, where, entry)
    return read.made(
        ("inputs", name),
        f"{where}: ",
        InputLimits,
        least=number("least", unit, 0.0, hint),
        most=number("most", unit, hint=hint),
        rate=number("rate", f"{unit}/s", math.inf, hint),
        acceleration=number("acceleration", f"{unit}/s^2", math.inf, hint),
        sigma=number("sigma", unit, 0.0, hint),
        unit=unit,
    )


def _times_in(raw: Mapping[str, Any]) -> dict[str, float]:
    """Times that a file says, or any where they have faults of their own."""
    try:
        told = {name: raw[name] for name in _Times.model_fields if name in raw}
        return _Times.model_validate(told).model_dump()
    except ValidationError:
        return _ANY_TIMES
