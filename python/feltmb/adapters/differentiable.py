"""What the derivatives of a mechanism ask of its model."""

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
    """A model of a mechanism whose versions can be made, integrated and differentiated."""

    action: Action
    """The mechanism with its tabulated numbers."""
    drives: Drives
    """What presses the mechanism in a record."""
    rtol: float
    """Relative tolerance of the integrator [1]."""
    single: bool
    """Whether a record is one segment that starts at rest."""
    workers: int
    """Threads."""

    @abstractmethod
    def version(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Variant:
        """The mechanism of parameters and magnitudes under the conditions of a record."""

    @abstractmethod
    def at_rest(self, variant: Variant, output: str) -> float:
        """Value of an output at rest: where the tracking point is [m]; 0 for a force."""

    @abstractmethod
    def in_parallel(self, work: Callable[[Any], None], tasks: Sequence[Any]) -> None:
        """Run the tasks on the threads of the model; results do not depend on their number."""
