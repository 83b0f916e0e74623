"""Permitted experiments: limits of inputs, tests of parts, sensors (``limits.toml``)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.fit.model import Effect, Model
from feltmb.gap.measured import no_test_of, units_of_tests
from feltmb.gap.tables import TableReader
from feltmb.units.quantity import SI, Schema

__all__ = ["FurtherSensor", "InputLimits", "Limits", "PartTest", "read_limits", "read_sensors"]


@checked
@dataclass(frozen=True, kw_only=True)
class InputLimits:
    """Limits of one input. It starts at 0, or at the limit closest to 0."""

    least: float = 0.0
    """Smallest value [unit]."""
    most: float
    """Largest value [unit]."""
    rate: float = math.inf
    """Largest rate of change [unit/s]."""
    acceleration: float = math.inf
    """Largest second derivative [unit/s^2]."""
    unit: str = "1"
    sigma: float = 0.0
    """Standard deviation of the noise of the recorded input [unit]."""

    def __post_init__(self) -> None:
        faults = []
        if not (math.isfinite(self.least) and math.isfinite(self.most) and self.least < self.most):
            faults.append(
                f"least = {self.least:g}, most = {self.most:g}, expected finite numbers, least < "
                "most"
            )
        for name in ("rate", "acceleration"):
            if not getattr(self, name) > 0.0:
                faults.append(f"{name} = {getattr(self, name)!r}, expected > 0")
        if not 0.0 <= self.sigma < math.inf:
            faults.append(f"sigma = {self.sigma!r}, expected finite, >= 0")
        if faults:
            raise InvalidParameter("limits of an input: " + "; ".join(faults))

    @property
    def start(self) -> float:
        """Value at the start [unit]."""
        return min(max(0.0, self.least), self.most)

    def shortest(self, change: float) -> float:
        """Shortest duration of a smooth step of this height [s].

        See :func:`~feltmb.gap.profiles.ease`.
        """
        height = abs(change)
        return max(1.875 * height / self.rate, math.sqrt(5.7735 * height / self.acceleration))


@checked
@dataclass(frozen=True, kw_only=True)
class PartTest:
    """A test of one part by itself, for example weighing, compression, torque, or spring rate."""

    parameter: str
    """Parameter of the model, or effect, that the test measures."""
    sd: float
    """Standard deviation of the parameter or magnitude after the test [its unit]."""
    cost: float = 1.0
    """Cost of the test, in experiments."""
    how: str = ""

    def __post_init__(self) -> None:
        if not 0.0 < self.sd < math.inf:
            raise InvalidParameter(
                f"test of {self.parameter}: sd = {self.sd!r}, expected finite, > 0"
            )
        if not 0.0 < self.cost < math.inf:
            raise InvalidParameter(
                f"test of {self.parameter}: cost = {self.cost!r}, expected finite, > 0"
            )


@checked
@dataclass(frozen=True, kw_only=True)
class FurtherSensor:
    """Sensor that can be added: for an output that is not measured yet, or with less noise.

    All later experiments are measured with it.
    """

    output: str
    """Output of the model that it measures."""
    sigma: float | None = None
    """Noise [unit of the output]. None: for an output that is measured already, a third of its
    noise; for another output, the noise of the noisiest sensor with the same unit."""
    cost: float = 1.0
    """Cost, which is paid once [experiments]."""
    how: str = ""

    def __post_init__(self) -> None:
        faults = []
        if self.sigma is not None and not 0.0 < self.sigma < math.inf:
            faults.append(f"sigma = {self.sigma!r}, expected finite, > 0")
        if not 0.0 < self.cost < math.inf:
            faults.append(f"cost = {self.cost!r}, expected finite, > 0")
        if faults:
            raise InvalidParameter(f"further sensor of {self.output}: " + "; ".join(faults))


@checked
@dataclass(frozen=True, kw_only=True)
class Limits:
    """Permitted experiments."""

    inputs: Mapping[str, InputLimits]
    """Limits by input. One input moves at a time; by default it is the first one."""
    duration: float
    """Longest experiment [s]."""
    sample_rate: float = 2000.0
    """Sample rate of the record [Hz]."""
    rest: float = 0.0
    """Pause before the next experiment, for the operator or the machine [s]."""
    lead: float = 0.01
    """Time at the start of a record before the input moves [s]."""
    parts: tuple[PartTest, ...] = ()
    sensors: Mapping[str, float] = field(default_factory=dict)
    """Noise of each output that can be measured [its unit]; empty: the sensors of the records."""
    further: tuple[FurtherSensor, ...] = ()
    """Sensors that can be added, each at its cost."""

    def __post_init__(self) -> None:
        faults = []
        if not self.inputs:
            faults.append("inputs is empty, expected at least one input")
        for name in ("duration", "sample_rate"):
            if not 0.0 < getattr(self, name) < math.inf:
                faults.append(f"{name} = {getattr(self, name)!r}, expected finite, > 0")
        for name in ("rest", "lead"):
            if not 0.0 <= getattr(self, name) < math.inf:
                faults.append(f"{name} = {getattr(self, name)!r}, expected finite, >= 0")
        if not faults and not 16 <= self.duration * self.sample_rate <= 1e6:
            faults.append(
                f"duration {self.duration:g} s at {self.sample_rate:g} Hz is "
                f"{self.duration * self.sample_rate:g} samples, expected 16 to 1e6"
            )
        if not faults and not self.lead < 0.5 * self.duration:
            faults.append(f"lead = {self.lead:g} s, expected less than half of the duration")
        for name, sigma in self.sensors.items():
            if not 0.0 < sigma < math.inf:
                faults.append(f"sensor {name}: sigma = {sigma!r}, expected finite, > 0")
        for offer in dict.fromkeys(self.further):
            if self.further.count(offer) > 1:
                faults.append(f"further sensor {offer.output}: is stated twice")
        if faults:
            raise InvalidParameter("limits: " + "; ".join(faults))

    @property
    def input_sigma(self) -> dict[str, float]:
        """Noise of each recorded input that has noise [its unit]."""
        return {n: i.sigma for n, i in self.inputs.items() if i.sigma > 0.0}

    def check(self, model: Model, effects: Sequence[Effect] = ()) -> None:
        """Check that the model has the inputs, outputs and parameters that the limits name.

        ``effects``: effects that the model lacks, which a test of a part may measure.

        Raises
        ------
        InvalidParameter
            Names of inputs, outputs or parameters that the model does not have, and effects that
            no test can measure, all in one message.
        """
        faults = _strangers(
            model,
            effects,
            self.inputs,
            self.sensors,
            [t.parameter for t in self.parts],
            [s.output for s in self.further],
        )
        if faults:
            raise InvalidParameter("limits: " + "; ".join(faults.values()))

    def without_tests(self, names: Iterable[str]) -> Limits:
        """Limits without the tests of these parameters and effects."""
        made = set(names)
        return replace(self, parts=tuple(t for t in self.parts if t.parameter not in made))


def _strangers(
    model: Model,
    effects: Sequence[Effect],
    inputs: Iterable[str],
    sensors: Iterable[str],
    parts: Iterable[str],
    further: Iterable[str],
) -> dict[tuple[str, str], str]:
    """Names in the limits that the model does not have, by table."""
    reasons = {t: no_test_of(t, model, effects) for t in parts}
    faults = {("parts", t): f"part {t}: {why}" for t, why in reasons.items() if why}
    outputs = ", ".join(model.outputs)
    for table, what, names in (
        ("sensors", "sensor", sensors),
        ("further_sensors", "further sensor", further),
    ):
        for s in names:
            if s not in model.outputs:
                faults[table, s] = f"{what} {s}: no output of {model.name}; there are {outputs}"
    own = list(getattr(model, "inputs", ()))
    own += [i for names in model.input_modes.values() for i in names]
    for i in inputs:
        if own and i not in own:
            there = ", ".join(own)
            faults["inputs", i] = f"input {i}: no input of {model.name}; there are {there}"
    return faults


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
    strange = _strangers(model, effects, *_names_in(read.raw))
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
    strange = _strangers(model, (), (), table if isinstance(table, dict) else (), (), ())
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
