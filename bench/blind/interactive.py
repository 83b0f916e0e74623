"""What a machine of the interactive blind bench does: it holds truths and answers requests."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from feltmb import gap
from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter

__all__ = ["NULLS", "Asked", "Interactive", "drawn_size", "role_of"]

#: Share of the cases without a withheld effect.
NULLS = 0.2


@dataclass(frozen=True)
class Asked:
    """One request: a force over time for a machine with a sealed truth."""

    case: Any
    name: str
    values: Array
    """Force at the frames of the limits [N]."""
    number: int
    """Number of the requested record from 1; records of even numbers are held out."""


class Interactive(ABC):
    """A machine with sealed truths, and the model that a diagnosis has of it.

    A truth is a dataclass with ``number``, ``seed`` and ``parts``; a part has ``name`` and
    ``size``.
    """

    name: str
    model: gap.Model
    effects: Sequence[gap.Effect]
    limits: gap.Limits
    families: Sequence[str] = ()
    """Families of profiles that may be requested; empty: all."""
    together: int
    """Number of cases whose requests are simulated together."""

    @property
    def driven(self) -> str:
        """Name of the input."""
        (name,) = self.limits.inputs
        return name

    def input_of(self, record: Record) -> Array:
        """Values of the input in a planned record."""
        return record.inputs[self.driven]

    @abstractmethod
    def draw(self, seed: int, number: int) -> Any:
        """A truth with one effect of plausible magnitude, at any signal-to-noise ratio, or none."""

    @abstractmethod
    def defaults(self, cases: Sequence[Any]) -> list[list[Record]]:
        """Records of each case before any experiment."""

    @abstractmethod
    def default(self, k: int) -> tuple[str, Array]:
        """Name and force of the default stroke number k, counted cyclically."""

    @abstractmethod
    def simulated(self, asked: Sequence[Asked]) -> list[Record]:
        """Noisy records of requests that are within the limits."""

    @abstractmethod
    def true_value(self, case: Any, parameter: str) -> float:
        """Value of a parameter of the model in a truth [its unit]."""

    def part(self, case: Any, test: gap.PartTest, number: int) -> gap.Measured:
        """Result of a test of a part."""
        rng = np.random.default_rng([*case.seed, 4, number])
        value = self.true_value(case, test.parameter) + test.sd * rng.standard_normal()
        limits = {p.name: (p.lower, p.upper) for p in self.model.parameters}
        limits |= {e.name: e.bounds for e in self.effects}
        value = float(np.clip(value, *limits[test.parameter]))  # no gauge shows negative friction
        return gap.Measured(parameter=test.parameter, value=value, sd=test.sd, how=test.how)

    def records(self, asked: Sequence[Asked]) -> list[Record]:
        """Noisy records of requests.

        Raises
        ------
        InvalidParameter
            A request is not within the limits.
        """
        own = self.limits.inputs[self.driven]
        for a in asked:
            rate = np.abs(np.diff(a.values)) * self.limits.sample_rate
            if a.values.min() < own.least - 1e-9 or a.values.max() > own.most + 1e-9:
                raise InvalidParameter(f"{a.name}: force beyond {own.least:g} to {own.most:g} N")
            if rate.max() > 1.001 * own.rate:
                raise InvalidParameter(f"{a.name}: {rate.max():g} N/s, expected <= {own.rate:g}")
        return self.simulated(asked) if asked else []


def drawn_size(scale: float, rng: np.random.Generator) -> float:
    """A magnitude from half to twice the expected one, evenly in its logarithm."""
    return scale * float(np.exp(rng.uniform(np.log(0.5), np.log(2.0))))


def role_of(asked: Asked) -> Literal["fit", "held_out"]:
    """Role of a requested record."""
    return "held_out" if asked.number % 2 == 0 else "fit"
