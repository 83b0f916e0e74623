"""Models without states: linear in their parameters, or functions of the inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.calling import calling
from feltmb.fit.coordinates import Named
from feltmb.fit.model import Candidate, Effect, Jobs, Model, Parameter, State

__all__ = ["FunctionModel", "LinearModel"]


@checked
class FunctionModel(Model):
    """Outputs that depend on the inputs at the same sample only, without memory.

    Parameters
    ----------
    outputs
        Name -> function ``(record, p) -> (n,)``; ``p.name`` is a parameter as a number.
    """

    cheap_derivatives = True
    any_inputs = True

    def __init__(
        self,
        *,
        outputs: Mapping[str, Callable[[Record, Named], Array]],
        parameters: Sequence[Parameter],
        name: str = "model",
    ):
        self.name = name
        self.parameters = tuple(parameters)
        self.outputs = tuple(outputs)
        self._outputs = dict(outputs)

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """The model has no states."""
        del included
        return ()

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has a ``regressor``, or is a sensor or input effect."""
        return effect.regressor is not None or super().accepts(effect)

    def whole(self, record: Record, theta: Array) -> Array:
        """Outputs of a whole record, (n, ny)."""
        if theta.shape != (len(self.parameters),):
            raise InvalidParameter(
                f"model {self.name}: theta has shape {theta.shape}, expected "
                f"{(len(self.parameters),)}"
            )
        p = Named({q.name: theta[i] for i, q in enumerate(self.parameters)})
        try:
            outputs: Array = np.column_stack([f(record, p) for f in self._outputs.values()])
        except KeyError as error:
            known = ", ".join(record.inputs) or "none"
            text = (
                f"model {self.name}: its functions raise KeyError: {error}; "
                f"the inputs of record {record.name} are {known}"
            )
            raise InvalidParameter("; ".join((text, *record.notes))) from error
        return outputs

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~feltmb.fit.Model`."""
        columns: list[Array] = []
        for candidate in jobs.included:
            assert candidate.effect.regressor is not None
            with calling(f"effect {candidate.name}: its regressor"):
                column = candidate.effect.regressor(record, candidate.shape)
            columns.append(self._place(candidate, column))
        distinct, which = np.unique(jobs.theta, axis=0, return_inverse=True)
        outputs = np.array([self.whole(record, theta) for theta in distinct])[which.reshape(-1)]
        for k, column in enumerate(columns):
            outputs = outputs + jobs.magnitudes[:, k, None, None] * column
        return outputs

    def _place(self, candidate: Candidate, column: Any) -> Array:
        """Regressor of an effect as (n, ny), on the output ``effect.data`` or the only output."""
        values: Array = np.asarray(column, dtype=np.float64)
        if values.ndim == 2:
            return values
        output = (
            candidate.effect.data if isinstance(candidate.effect.data, str) else self.outputs[0]
        )
        if output not in self.outputs:
            raise InvalidParameter(
                f"effect {candidate.name}: {output!r} is no output of {self.name} "
                f"({', '.join(self.outputs)})"
            )
        out = np.zeros((values.size, len(self.outputs)))
        out[:, self.outputs.index(output)] = values
        return out


@checked
class LinearModel(FunctionModel):
    """One output that is linear in its parameters: y = sum over j of p_j column_j(record).

    Parameters
    ----------
    columns
        Name of a parameter -> function of the record that returns its column, (n,).
    """

    def __init__(
        self,
        *,
        output: str,
        columns: Mapping[str, Callable[[Record], Array]],
        parameters: Sequence[Parameter] = (),
        name: str = "model",
    ):
        given = {p.name: p for p in parameters}
        unknown = sorted(set(given) - set(columns))
        if unknown:
            raise InvalidParameter(f"model {name}: parameter {', '.join(unknown)} has no column")
        ordered = [given.get(n, Parameter(name=n, value=0.0)) for n in columns]
        self.columns = dict(columns)

        def value(record: Record, p: Named) -> Array:
            total: Array = sum(
                (p[n] * np.asarray(f(record)) for n, f in self.columns.items()),
                np.zeros(record.samples),
            )
            return total

        super().__init__(outputs={output: value}, parameters=ordered, name=name)
