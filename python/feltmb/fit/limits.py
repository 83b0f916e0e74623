"""Permitted experiments on a machine: limits of inputs, tests of parts, sensors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter, near_names
from feltmb.fit.model import Effect, Model

__all__ = [
    "FurtherSensor",
    "InputLimits",
    "Limits",
    "PartTest",
    "hint_of_names",
    "no_test_of",
    "unknown_names",
]

#: Number of known names in a message.
MOST_NAMES = 20


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

        See :func:`~feltmb.experiment.profiles.ease`.
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
        faults = unknown_names(
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


def unknown_names(
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
    own = list(model.inputs)
    own += [i for names in model.input_modes.values() for i in names]
    for i in inputs:
        if own and i not in own:
            there = ", ".join(own)
            faults["inputs", i] = f"input {i}: no input of {model.name}; there are {there}"
    return faults


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
