"""The model with what a diagnosis found: fitted parameters and named causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.fit.model import Candidate, Effect, Model
from feltmb.gap.beside import simulated
from feltmb.gap.records import same_number
from feltmb.gap.result import Result

__all__ = ["Explained", "explained_model"]


@dataclass(frozen=True, eq=False)
class Explained:
    """A model with fitted parameters and named effects."""

    original: Model
    theta: Array
    """Values of its parameters [their units]."""
    included: tuple[Candidate, ...]
    magnitudes: Array
    """Magnitudes of the included effects [their units]."""
    provenance: str

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each parameter by name."""
        return {p.name: float(v) for p, v in zip(self.original.parameters, self.theta, strict=True)}

    @property
    def effects(self) -> dict[str, float]:
        """Magnitude of each effect by name."""
        return {t.name: float(v) for t, v in zip(self.included, self.magnitudes, strict=True)}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Effects that are no numbers of the model, such as those of sensors."""
        return tuple(self.original.numbers(self.theta, self.included, self.magnitudes)[1])

    @checked
    def simulate(self, record: Record) -> dict[str, Array]:
        """Simulate a whole record; returns the outputs by name.

        A start state that is not known is the one that fits the beginning of the record best.

        Parameters
        ----------
        record
            Record whose inputs drive the model.
        """
        return simulated(self.original, record, self.theta, self.included, self.magnitudes)

    @checked
    def write(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the model to a file: a mechanism, an MJCF file, or its numbers (TOML).

        Parameters
        ----------
        path
            File to be written.
        force
            False: an existing file is not overwritten.

        Raises
        ------
        InvalidParameter
            The file has another ending, or its format cannot represent an effect.
        """
        return self.original.write(
            Path(path),
            self.theta,
            self.included,
            self.magnitudes,
            provenance=self.provenance,
            force=force,
        )


@checked
def explained_model(model: Model, effects: Sequence[Effect], result: Result) -> Explained:
    """The model with the fitted parameters and the named effects of its diagnosis.

    Parameters
    ----------
    model
        The model that was diagnosed.
    effects
        The effects that were tested.
    result
        Report of the diagnosis.
    """
    fitted = {p.name: p.value for p in result.parameters}
    by_name = {e.name: e for e in effects}
    named = [
        n
        for n in result.named
        if n.cause in by_name and same_number(model, by_name[n.cause]) is None
    ]
    return Explained(
        model,
        np.array([fitted.get(p.name, p.value) for p in model.parameters]),
        tuple(Candidate(by_name[n.cause], n.shape) for n in named),
        np.array([n.magnitude for n in named]),
        f"feltmb gap diagnose of {', '.join(result.records)}",
    )
