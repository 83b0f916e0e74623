"""Files of permitted experiments (``limits.toml``), and their check against a model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.fit.limits import InputLimits, Limits, PartTest
from unmodeled.fit.measured import InStatedUnit, TableReader, no_test_of, units_of_tests
from unmodeled.fit.model import Effect, Model
from unmodeled.units.quantity import SI, Schema

__all__ = ["check_limits", "read_limits"]


class _Input(Schema):
    unit: str = ""
    least: InStatedUnit = 0.0
    most: InStatedUnit
    rate: InStatedUnit = math.inf
    acceleration: InStatedUnit = math.inf
    sigma: InStatedUnit = 0.0


class _Part(Schema):
    parameter: str
    sd: InStatedUnit
    cost: Annotated[float, Field(gt=0)] = 1.0
    how: str = ""


class _Sensor(Schema):
    sigma: InStatedUnit


class _LimitsFile(Schema):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    about: str = ""
    duration: Annotated[float, SI("s"), Field(gt=0)]
    sample_rate: Annotated[float, SI("Hz"), Field(gt=0)] = 2000.0
    lead: Annotated[float, SI("s"), Field(ge=0)] = 0.01
    inputs: dict[str, dict[str, Any]]
    sensors: dict[str, dict[str, Any]] = Field(default_factory=dict)
    further_sensors: dict[str, dict[str, Any]] = Field(default_factory=dict)
    parts: list[dict[str, Any]] = Field(default_factory=list)


#: Placeholder for invalid inputs, so that the rest can be checked.
_ANY = {"": InputLimits(most=1.0)}
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
        All faults of the file in one message: unknown names, then those of each table. The table of
        an unknown name is not checked, because the unit of its numbers is unknown.
    """
    read = TableReader(path)
    names = {table: [key for key, _, _ in read.entries(table)] for table in ("inputs", *SENSORS)}
    tests = [(where, entry, entry.get("parameter")) for _, where, entry in read.entries("parts")]
    names["parts"] = [name for _, _, name in tests if isinstance(name, str)]
    strange = _unknown_names(model, effects, names)
    read.faults += strange.values()
    inputs: dict[str, InputLimits | None] = {}
    for name, where, entry in read.entries("inputs"):
        if ("inputs", name) not in strange:
            units = _units_of_input(entry, model.units.get(name) or "1")
            inputs[name] = read.made(where, entry, _Input, InputLimits, units, unit=units["most"])
    own = units_of_tests(model, effects)
    parts = [
        read.made(where, entry, _Part, PartTest, {"sd": own.get(str(name), "1")})
        for where, entry, name in tests
        if ("parts", name) not in strange
    ]
    sigmas: dict[tuple[str, Any], dict[str, float] | None] = {
        (table, name): read.made(
            where, entry, _Sensor, dict, {"sigma": model.units.get(name) or "1"}
        )
        for table in SENSORS
        for name, where, entry in read.entries(table)
        if (table, name) not in strange
    }
    sensors, further = (
        {name: v["sigma"] for (of, name), v in sigmas.items() if of == table and v}
        for table in SENSORS
    )

    def limits(**file: Any) -> Limits:
        known = {name: v for name, v in inputs.items() if v is not None}
        return Limits(
            inputs=known or ({} if file["inputs"] == {} else _ANY),
            parts=tuple(p for p in parts if p is not None),
            sensors=sensors,
            further=further,
            **{name: file[name] for name in ("duration", "sample_rate", "lead")},
        )

    found = read.made("", read.raw, _LimitsFile, limits)
    read.finish()
    assert found is not None
    return found


def _units_of_input(entry: Mapping[str, Any], unit: str) -> dict[str, str]:
    """Units of the limits of an input, from its own unit or else that of the model."""
    told = entry.get("unit")
    unit = (told if isinstance(told, str) else "") or unit
    hint = '; hint: the table says its unit, unit = "N"' if unit == "1" else ""
    own = dict.fromkeys(("least", "most", "sigma"), unit)
    return own | {"rate": f"{unit}/s", "acceleration": f"{unit}/s^2", "hint": hint}
