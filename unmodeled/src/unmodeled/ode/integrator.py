"""Equations without a fit: rates of NumPy are traced once, many jobs run with derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter
from unmodeled.models.coordinates import Rate
from unmodeled.models.model import (
    Candidate,
    Jobs,
    Model,
    Parameter,
    SensitivityRequest,
    State,
    twice,
)
from unmodeled.ode.batch import sensitivities, simulated
from unmodeled.ode.traces import System, Traces, untraced


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Outputs of jobs, and their derivatives."""

    outputs: Array
    """(B, n, outputs)"""
    by_parameters: Array
    """(B, n, outputs, p)"""
    by_starts: Array
    """By the states at the first sample, (B, n, outputs, nx)."""


class _Numbers(Model):
    """Equations at some values of their parameters."""

    def __init__(self, system: System, traces: Traces, values: Array):
        self.name, self.inputs = system.name, system.inputs
        self.outputs = tuple(system.outputs)
        self.system, self.traces = system, traces
        self.parameters = tuple(
            Parameter(name=n, value=float(v))
            for n, v in zip(system.parameters, values, strict=True)
        )

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        return self.system.all_states(included)

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        with np.errstate(all="ignore"):
            return simulated(self.system, self.traces, [(record, jobs)])[0][0]


@checked
class Integrator:
    """States with rates dx/dt = f(t, x, u, p), integrated for many jobs together.

    The rates are called with symbols and become a list of operations, with their derivatives. What
    cannot be traced (:attr:`notes`) runs as functions of Python, with derivatives by differences.

    Parameters
    ----------
    rates
        ``rates(t, x, u, p)`` returns the rates in the order of the states, with operators and the
        functions of NumPy for numbers: ``x.angle``, ``u.torque``, ``p.mass``.
    states, parameters, inputs
        Names of the states, parameters and inputs.
    outputs
        Name -> name of a state, or a function ``(t, x, u, p)``, or ``Rate("v")``; default: the
        states.
    method
        ``"rk4"``: classical Runge-Kutta. ``"rosenbrock"``: linearly implicit of order 2 (L-stable),
        for stiff systems.
    substeps
        Steps between two times, >= 1.
    hold
        Inputs between two times: ``"linear"``, ``"zero"`` (as at the last time), or ``"spline"``.

    Examples
    --------
    Two springs, 40 and 90 N/m, each with a mass of 1 kg that is let go at 0.1 m:

    >>> import numpy as np
    >>> from unmodeled.ode import Integrator
    >>> def rates(t, x, u, p):
    ...     return x.v, -p.k * x.q
    >>> spring = Integrator(rates, states=["q", "v"], parameters=["k"])
    >>> time = np.linspace(0.0, 1.0, 101)
    >>> found = spring.derivatives(time, [[40.0], [90.0]], [[0.1, 0.0], [0.1, 0.0]])
    >>> np.round(found.outputs[:, -1, 0], 6)  # 0.1 cos(sqrt(k) t) [m]
    array([ 0.099914, -0.099808])
    >>> np.round(found.by_parameters[:, -1, 0, 0], 7)  # [m per N/m]
    array([-0.000327 ,  0.0003268])
    """

    def __init__(
        self,
        rates: Callable[[Any, Any, Any, Any], Any],
        *,
        states: Sequence[str],
        parameters: Sequence[str] = (),
        inputs: Sequence[str] = (),
        outputs: Mapping[str, str | Rate | Callable[[Any, Any, Any, Any], Any]] | None = None,
        method: Literal["rk4", "rosenbrock"] = "rk4",
        substeps: int = 1,
        hold: Literal["linear", "zero", "spline"] = "linear",
        name: str = "equations",
    ):
        faults = [f"{n!r} is used twice" for n in twice([*states, *parameters, *inputs])]
        shown = {n: n for n in states} if outputs is None else dict(outputs)
        wanted = {n: of.state if isinstance(of, Rate) else of for n, of in shown.items()}
        faults += [
            f"output {n}: {of!r} is no state; known are {', '.join(states)}"
            for n, of in wanted.items()
            if isinstance(of, str) and of not in states
        ]
        if substeps < 1:
            faults.append(f"substeps = {substeps}, expected a whole number >= 1")
        if faults:
            raise InvalidParameter(f"{name}: " + "; ".join(faults))
        self._system = System(
            *(name, tuple(State(name=n) for n in states), rates, shown, tuple(inputs)),
            *(tuple(parameters), {}, hold, method, substeps),
        )
        self._traces = Traces()

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about functions that cannot be traced, with their lines."""
        return tuple(untraced(self._system, self._traces))

    def run(
        self,
        time: Array,
        parameters: Array,
        starts: Array,
        inputs: Mapping[str, Array] | None = None,
    ) -> Array:
        """Outputs of jobs, (B, n, outputs); NaN: a job left the range of numbers.

        Parameters
        ----------
        time
            Times [s], strictly increasing, (n,).
        parameters
            In the order of their names, (B, p), or (p,) for all jobs.
        starts
            States at the first time, (B, nx), or (nx,) for all jobs.
        inputs
            Inputs at these times by name, each (n,).

        Raises
        ------
        InvalidParameter, DataError
            An array has another shape, an input is missing, or a function fails.
        """
        record, jobs = self._jobs(time, parameters, starts, inputs)
        return self._model(jobs).simulate(record, jobs)

    def derivatives(
        self,
        time: Array,
        parameters: Array,
        starts: Array,
        inputs: Mapping[str, Array] | None = None,
    ) -> Derivatives:
        """Outputs of jobs, and their derivatives by parameters and starts.

        Parameters
        ----------
        time, parameters, starts, inputs
            As for :meth:`run`.
        """
        record, jobs = self._jobs(time, parameters, starts, inputs)
        requests = [
            SensitivityRequest(record, theta, start)
            for theta, start in zip(jobs.theta, jobs.starts, strict=True)
        ]
        with np.errstate(all="ignore"):
            found = sensitivities(self._model(jobs), self._system, self._traces, requests)
        return Derivatives(
            np.array([s.outputs for s in found]),
            np.array([s.d_theta for s in found]),
            np.array([s.d_starts for s in found]),
        )

    def _model(self, jobs: Jobs) -> Model:
        return _Numbers(self._system, self._traces, jobs.theta[0])

    def _jobs(
        self, time: Array, parameters: Array, starts: Array, inputs: Mapping[str, Array] | None
    ) -> tuple[Record, Jobs]:
        system = self._system
        given = {"parameters": (parameters, system.parameters), "starts": (starts, system.names)}
        arrays = {}
        for what, (values, names) in given.items():
            arrays[what] = np.atleast_2d(np.asarray(values, dtype=np.float64))
            if arrays[what].ndim != 2 or arrays[what].shape[1] != len(names):
                raise InvalidParameter(
                    f"{system.name}: {what} has shape {np.shape(values)}, expected (jobs, "
                    f"{len(names)}): {', '.join(names) or 'none'}"
                )
        theta, start = arrays.values()
        count = max(len(theta), len(start))
        if {len(theta), len(start)} - {1, count}:
            raise InvalidParameter(
                f"{system.name}: parameters of {len(theta)} jobs and starts of {len(start)}, "
                "expected as many"
            )
        inputs = inputs or {}
        if missing := [n for n in system.inputs if n not in inputs]:
            raise InvalidParameter(
                f"{system.name}: input {', '.join(missing)} is missing; there is "
                f"{', '.join(inputs) or 'none'}"
            )
        nothing = {n: np.full(len(time), np.nan) for n in system.outputs}
        record = Record(name=system.name, time=time, inputs=dict(inputs), outputs=nothing)
        own = (np.broadcast_to(a, (count, a.shape[1])) for a in (theta, start))
        return record, Jobs(theta=np.array(next(own)), starts=np.array(next(own)))
