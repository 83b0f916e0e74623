"""Permitted experiments: limits of inputs, and tests of single parts (``limits.toml``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError

from feltmb.arguments import checked
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import read_toml
from feltmb.fit.model import Model
from feltmb.units.quantity import SI, Schema, fault_lines, fault_text, parse_scalar

__all__ = ["InputLimits", "Limits", "PartTest", "read_limits"]

T = TypeVar("T")


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
    """Parameter of the model that the test measures."""
    sd: float
    """Standard deviation of the parameter after the test [unit of the parameter]."""
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
        if faults:
            raise InvalidParameter("limits: " + "; ".join(faults))

    def check(self, model: Model) -> None:
        """Check that the model has the inputs, outputs and parameters that the limits name.

        Raises
        ------
        InvalidParameter
            Names of inputs, outputs or parameters that the model does not have, all in one message.
        """
        faults = _strangers(model, self.inputs, self.sensors, [t.parameter for t in self.parts])
        if faults:
            raise InvalidParameter("limits: " + "; ".join(faults.values()))


def _strangers(
    model: Model, inputs: Iterable[str], sensors: Iterable[str], parts: Iterable[str]
) -> dict[tuple[str, str], str]:
    """Names in the limits that the model does not have, by table."""
    known = [p.name for p in model.parameters]
    faults = {
        ("parts", t): f"part {t}: no parameter of {model.name}; there are {', '.join(known)}"
        for t in parts
        if t not in known
    }
    for s in sensors:
        if s not in model.outputs:
            there = ", ".join(model.outputs)
            faults["sensors", s] = f"sensor {s}: no output of {model.name}; there are {there}"
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


class _LimitsFile(Schema):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    about: str = ""
    duration: Annotated[float, SI("s"), Field(gt=0)]
    sample_rate: Annotated[float, SI("Hz"), Field(gt=0)] = 2000.0
    rest: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    lead: Annotated[float, SI("s"), Field(ge=0)] = 0.01
    inputs: dict[str, _Input]
    sensors: dict[str, _Sensor] = Field(default_factory=dict)
    parts: list[_Part] = Field(default_factory=list)


#: Placeholder for an invalid input, so that the rest can be checked.
_ANY = {"": InputLimits(most=1.0)}


def _names_in(raw: Mapping[str, Any]) -> tuple[list[str], list[str], list[str]]:
    """Names of inputs, sensors and parameters in a file, which may have other faults."""
    tables = [t if isinstance(t, dict) else {} for t in (raw.get("inputs"), raw.get("sensors"))]
    rows = raw.get("parts")
    parts = [
        row["parameter"]
        for row in (rows if isinstance(rows, list) else [])
        if isinstance(row, dict) and isinstance(row.get("parameter"), str)
    ]
    return list(tables[0]), list(tables[1]), parts


#: Units of rates of an input without a stated unit.
_BARE = ("1/s", "1/s^2")


def _per(unit: str, power: int) -> str:
    second = "s" if power == 1 else f"s^{power}"
    return f"1/{second}" if unit == "1" else f"{unit}/{second}"


@checked
def read_limits(path: str | Path, model: Model) -> Limits:
    """Read ``limits.toml``: the limits of experiments with a model.

    Numbers are in SI units, or texts with a unit (``"20 N"``, ``"2 kN/s"``, ``"0.02 mm"``; a share
    may be ``"2 %"``).

    Raises
    ------
    DataError
        All faults of the file in one message; unknown names come first. The numbers of an unknown
        name are not checked, because their unit is unknown.
    """
    path = Path(path)
    raw = read_toml(path)
    strange = _strangers(model, *_names_in(raw))
    faults = list(strange.values())
    try:
        file = _LimitsFile.model_validate(raw)
    except ValidationError as error:
        faults += fault_lines(error, _LimitsFile)
        raise DataError(fault_text(path.name, faults)) from None

    def number(where: str, value: float | str | None, unit: str, missing: float = 0.0) -> float:
        if value is None:
            return missing
        try:
            return in_unit(value, unit)
        except (ValueError, InvalidParameter) as error:
            hint = '; hint: the table says its unit, unit = "N"' if unit in ("1", *_BARE) else ""
            faults.append(f"{where}: {error}{hint}")
            return math.nan

    def made(where: str, kind: Callable[..., T], **values: Any) -> T | None:
        if any(isinstance(v, float) and math.isnan(v) for v in values.values()):
            return None  # already in the message
        try:
            return kind(**values)
        except InvalidParameter as error:
            faults.append(f"{where}{error}")
            return None

    inputs: dict[str, InputLimits | None] = {}
    for name, i in file.inputs.items():
        if ("inputs", name) in strange:
            continue
        unit = i.unit or model.units.get(name) or "1"
        where = f"inputs.{name}"
        inputs[name] = made(
            f"{where}: ",
            InputLimits,
            least=number(f"{where}.least", i.least, unit),
            most=number(f"{where}.most", i.most, unit),
            rate=number(f"{where}.rate", i.rate, _per(unit, 1), math.inf),
            acceleration=number(f"{where}.acceleration", i.acceleration, _per(unit, 2), math.inf),
            sigma=number(f"{where}.sigma", i.sigma, unit),
            unit=unit,
        )
    own = {p.name: p.unit for p in model.parameters}
    parts = [
        made(
            f"parts[{k}]: ",
            PartTest,
            parameter=p.parameter,
            sd=number(f"parts[{k}].sd", p.sd, own[p.parameter]),
            cost=p.cost,
            how=p.how,
        )
        for k, p in enumerate(file.parts)
        if ("parts", p.parameter) not in strange
    ]
    sensors = {
        name: number(f"sensors.{name}.sigma", s.sigma, model.units.get(name) or "1")
        for name, s in file.sensors.items()
        if ("sensors", name) not in strange
    }
    found = made(
        "",
        Limits,
        inputs={name: i for name, i in inputs.items() if i is not None} or _ANY,
        duration=file.duration,
        sample_rate=file.sample_rate,
        rest=file.rest,
        lead=file.lead,
        parts=tuple(p for p in parts if p is not None),
        sensors={name: sigma for name, sigma in sensors.items() if not math.isnan(sigma)},
    )
    if faults or found is None:
        raise DataError(fault_text(path.name, faults))
    return found


def in_unit(value: float | str, unit: str) -> float:
    """Convert a number, or a text with a unit, to an SI unit; shares may be in percent.

    Raises
    ------
    ValueError
        The value is not a number with such a unit.
    """
    if isinstance(value, str) and value.strip().endswith("%") and unit == "1":
        return 0.01 * parse_scalar(value.strip().removesuffix("%").strip(), "1")
    return parse_scalar(value, unit)
