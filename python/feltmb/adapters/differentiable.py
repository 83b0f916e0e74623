"""Interface of a model whose derivatives are computed by this package."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

from feltmb.adapters.drives import Drives
from feltmb.adapters.variants import Variant
from feltmb.data import Array, Record
from feltmb.fit import Candidate, Model
from feltmb.mechanism import Action

__all__ = ["DifferentiableMechanism"]


class DifferentiableMechanism(Model):
    """A model of a mechanism that can be changed, integrated and differentiated."""

    action: Action
    """The mechanism with its tabulated values."""
    drives: Drives
    """Inputs of the mechanism in a record."""
    rtol: float
    """Relative tolerance of the integrator [1]."""
    workers: int
    """Number of threads."""

    @abstractmethod
    def version(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Variant:
        """The mechanism with given parameters and magnitudes, under the conditions of a record."""

    @abstractmethod
    def as_tabulated(self, record: Record) -> Array | None:
        """Outputs (n, ny) of the tabulated mechanism over a whole record; None if it failed."""

    @abstractmethod
    def at_rest(self, variant: Variant, output: str) -> float:
        """Value of an output at rest: position of the tracking point [m]; 0 for a force."""

    @abstractmethod
    def in_parallel(self, work: Callable[[Any], None], tasks: Sequence[Any]) -> None:
        """Run the tasks on the threads of the model; results do not depend on their number."""
