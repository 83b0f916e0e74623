"""Limits of experiments on a machine: numbers that any part may state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

__all__ = ["InputLimits", "Limits", "PartTest"]


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

        See :func:`~unmodeled.experiment.profiles.ease`.
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
        faults = [
            f"{name} = {value!r}, expected finite, > 0"
            for name, value in (("sd", self.sd), ("cost", self.cost))
            if not 0.0 < value < math.inf
        ]
        if faults:
            raise InvalidParameter(f"test of {self.parameter}: " + "; ".join(faults))


@checked
@dataclass(frozen=True, kw_only=True)
class Limits:
    """Permitted experiments."""

    inputs: Mapping[str, InputLimits]
    """Limits by input. One input moves at a time."""
    duration: float
    """Longest experiment [s]."""
    sample_rate: float = 2000.0
    """Sample rate of the record [Hz]."""
    lead: float = 0.01
    """Time at the start of a record before the input moves [s]."""
    parts: tuple[PartTest, ...] = ()
    sensors: Mapping[str, float] = field(default_factory=dict)
    """Noise of each output that is measured [its unit]; empty: the sensors of the records."""
    further: Mapping[str, float] = field(default_factory=dict)
    """Noise of sensors that could be added, by output [its unit]."""

    def __post_init__(self) -> None:
        faults = []
        if not self.inputs:
            faults.append("inputs is empty, expected at least one input")
        for name in ("duration", "sample_rate"):
            if not 0.0 < getattr(self, name) < math.inf:
                faults.append(f"{name} = {getattr(self, name)!r}, expected finite, > 0")
        if not 0.0 <= self.lead < math.inf:
            faults.append(f"lead = {self.lead!r}, expected finite, >= 0")
        if not faults and not 16 <= self.duration * self.sample_rate <= 1e6:
            faults.append(
                f"duration {self.duration:g} s at {self.sample_rate:g} Hz is "
                f"{self.duration * self.sample_rate:g} samples, expected 16 to 1e6"
            )
        if not faults and not self.lead < 0.5 * self.duration:
            faults.append(f"lead = {self.lead:g} s, expected less than half of the duration")
        for what, sensors in (("sensor", self.sensors), ("further sensor", self.further)):
            faults += [
                f"{what} {name}: sigma = {sigma!r}, expected finite, > 0"
                for name, sigma in sensors.items()
                if not 0.0 < sigma < math.inf
            ]
        if faults:
            raise InvalidParameter("limits: " + "; ".join(faults))

    @property
    def input_sigma(self) -> dict[str, float]:
        """Noise of each recorded input that has noise [its unit]."""
        return {n: i.sigma for n, i in self.inputs.items() if i.sigma > 0.0}
