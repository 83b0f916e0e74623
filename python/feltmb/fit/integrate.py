"""Integration of the equations of an ``Equations`` for all jobs simultaneously."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.calling import calling
from feltmb.fit.coordinates import Named, Rate
from feltmb.fit.model import Batch, Candidate
from feltmb.fit.resolution import BETWEEN

__all__ = [
    "GAMMA",
    "Clock",
    "Law",
    "System",
    "Trajectory",
    "advanced",
    "integrate",
    "selected",
    "solved",
]

#: Number of evaluations of the rates in a step, by method.
STAGES = {"rk4": 4, "rosenbrock": 2}
#: Coefficient of ROS2.
GAMMA = 1.0 - np.sqrt(0.5)


@dataclass(frozen=True, eq=False)
class Clock:
    """Time and inputs of jobs by sample, (longest, B); constant after the end of a record."""

    time: Array
    signals: list[Array]
    bends: list[Array]
    """Second derivatives of the cubic splines through the inputs; empty: not needed."""

    @classmethod
    def of(
        cls,
        model: Any,
        batches: Sequence[Batch],
        longest: int,
        inputs: Sequence[Mapping[str, Array]] | None = None,
    ) -> Clock:
        """Times and inputs of all jobs of several batches; ``inputs``: instead of the recorded."""
        times: list[Array] = []
        signals: list[list[Array]] = [[] for _ in model.inputs]
        bends: list[list[Array]] = [[] for _ in model.inputs]
        for k, (record, jobs) in enumerate(batches):
            at = np.minimum(np.arange(longest), record.samples - 1)
            at = np.repeat(at[:, None], jobs.count, axis=1)
            times.append(record.time[at])
            given = record.inputs if inputs is None else inputs[k]
            values = [given[n] if n in given else 0.0 * record.time for n in model.inputs]
            for i, value in enumerate(values):
                signals[i].append(value[at])
            if model.hold in ("spline", "between"):
                for i, bend in enumerate(_bends(record, values)):
                    bends[i].append(bend[at])
        return cls(
            np.hstack(times),
            [np.hstack(parts) for parts in signals],
            [np.hstack(parts) for parts in bends if parts],
        )

    def first(self, jobs: int) -> Clock:
        """Those of the first jobs."""
        parts = ([v[:, :jobs] for v in of] for of in (self.signals, self.bends))
        return Clock(self.time[:, :jobs], *parts)

    def held(self, model: Any, j: Any, share: Array, p: Named) -> list[Array]:
        """Inputs in the intervals that begin at the samples j, at these shares of the intervals.

        ``signal[j]`` and ``share`` are broadcast together.
        """
        nxt = np.minimum(j + 1, len(self.time) - 1)
        columns = []
        for i, (name, signal) in enumerate(zip(model.inputs, self.signals, strict=True)):
            value = signal[j] + 0.0 * share
            if model.hold != "zero":
                value = value + share * (signal[nxt] - signal[j])
            if self.bends:
                rest, square = 1.0 - share, (self.time[nxt] - self.time[j]) ** 2 / 6.0
                bent = square * (
                    (rest**3 - rest) * self.bends[i][j] + (share**3 - share) * self.bends[i][nxt]
                )
                value = value + (p[BETWEEN + name] * bent if model.hold == "between" else bent)
            columns.append(value)
        return columns

    def inputs(self, model: Any, j: int, shares: Array, p: Named) -> list[Named]:
        """Inputs of the jobs between samples j and j + 1, at these shares of the interval."""
        columns = self.held(model, j, shares[:, None], p)
        if not columns:
            return [Named._of({})] * len(shares)
        names = model.inputs
        return [Named._of(dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True)]


def _bends(record: Record, signals: Sequence[Array]) -> list[Array]:
    """Second derivatives, at the samples, of the cubic splines through the inputs."""
    from scipy.interpolate import CubicSpline

    return [np.asarray(CubicSpline(record.time, s)(record.time, 2)) for s in signals]


class Law:
    """The rate of an effect that acts on consecutive jobs, and the rows of the states it changes.

    Parameters
    ----------
    names
        States of the model.
    candidate
        Effect and shape.
    memory
        Row of its first hidden state.
    jobs
        First job, and end.
    """

    def __init__(
        self, names: Sequence[str], candidate: Candidate, memory: int, jobs: tuple[int, int]
    ):
        self.candidate, self.jobs = candidate, jobs
        hidden = [h.name for h in candidate.effect.hidden]
        self.memory = {name: memory + j for j, name in enumerate(hidden)}
        self._rows = {**{n: i for i, n in enumerate(names)}, **self.memory}
        self._calling = calling(f"effect {candidate.name}: its rate")

    def changes(
        self, t: Array, x: Any, named: Named, u: Named, p: Named, magnitude: Array, shape: Any
    ) -> list[tuple[int, Any]]:
        """Row of a state and change of its rate, for every state that the effect changes.

        ``x``: rows of states; ``named``: those of the model by name.
        """
        effect = self.candidate.effect
        own: Any = effect.rate
        seen = named
        if self.memory:
            held = {name: x[row] for name, row in self.memory.items()}
            seen = Named._of({**named._values, **held})
        with self._calling:
            change: Any = own(t, seen, u, p, magnitude, shape)
        if not isinstance(change, Mapping):
            raise InvalidParameter(
                f"effect {effect.name}: rate returned {type(change).__name__}, expected a "
                "dictionary of rates by name of the state"
            )
        found = []
        for name, value in change.items():
            row = self._rows.get(name)
            if row is None:
                raise InvalidParameter(
                    f"effect {effect.name}: rate changes {name!r}, which is no state; known are "
                    f"{', '.join(self._rows)}"
                )
            if np.shape(value) not in ((), (1,), t.shape):
                raise _wrong_shape(f"effect {effect.name}", name, value, t.size)
            found.append((row, value))
        return found


def _wrong_shape(of: str, state: str, value: Any, count: int) -> InvalidParameter:
    return InvalidParameter(
        f"{of}: rate of {state} has shape {np.shape(value)}, expected a number or one value a "
        f"job, ({count},)"
    )


class System:
    """Rates of the states of jobs, with the included effects of each.

    All arrays have one entry per job, or n entries per job: first those of the first job, then
    those of the second one.
    """

    def __init__(self, model: Any, batches: Sequence[Batch]):
        self.model = model
        self.names = [s.name for s in model._states]
        self.rows = {n: i for i, n in enumerate(self.names)}
        self.count = sum(jobs.count for _, jobs in batches)
        self.size = max(len(model.states(jobs.included)) for _, jobs in batches)
        self.most = max(len(jobs.included) for _, jobs in batches)
        self.laws: list[tuple[int, Law]] = []
        """Effects, and their places among the included ones of their jobs."""
        self.scales = np.ones((self.size, self.count))
        self.magnitudes = np.zeros((self.most, self.count))
        """Magnitudes of the included effects, (most, B)."""
        theta = np.vstack([jobs.theta for _, jobs in batches])
        self.p = Named({q.name: theta[:, i] for i, q in enumerate(model.parameters)})
        self._calling = calling(f"model {model.name}: its rates function")
        at = 0
        known: dict[object, tuple[int, int]] = {}
        for _, jobs in batches:
            end, included = at + jobs.count, jobs.included
            states = model.states(included)
            self.scales[: len(states), at:end] = np.array([[s.scale] for s in states])
            key = tuple((id(t.effect), repr(t.shape)) for t in included)
            if included:
                self.magnitudes[: len(included), at:end] = jobs.magnitudes.T
            if key in known and known[key][1] == at:  # the batch before has the same effects
                known[key] = (known[key][0], end)
            else:
                self._close(known)
                known = {key: (at, end)}
                self._waiting = included
            at = end
        self._close(known)

    def _close(self, known: Mapping[Any, tuple[int, int]]) -> None:
        """Add the laws of consecutive jobs with the same included effects."""
        for span in known.values():
            row = len(self.names)
            for k, candidate in enumerate(self._waiting):
                self.laws.append((k, self.law(candidate, row, span)))
                row += len(candidate.effect.hidden)

    def law(self, candidate: Candidate, memory: int, jobs: tuple[int, int] | None = None) -> Law:
        """The law of a candidate for some jobs, by default for all."""
        taken = [h.name for h in candidate.effect.hidden if h.name in self.rows]
        if taken:
            raise InvalidParameter(
                f"effect {candidate.name}: its hidden state {taken[0]!r} has the name "
                f"of a state of model {self.model.name}; rename one of them"
            )
        return Law(self.names, candidate, memory, jobs or (0, self.count))

    def view(self, x: Any) -> Named:
        """States of the model by name."""
        return Named._of(dict(zip(self.names, x, strict=False)))

    def rates(self, t: Array, x: Array, u: Named, p: Named, magnitudes: Array) -> Array:
        """Rates of all states, (size, n)."""
        named, model, base = self.view(x), self.model, len(self.names)
        out = np.empty_like(x)
        with self._calling:
            own_rates = tuple(model._rates(t, named, u, p))
        if len(own_rates) != base:
            raise InvalidParameter(
                f"model {model.name}: rates returned {len(own_rates)} values, expected one for "
                f"each state: {', '.join(self.names)}"
            )
        for i, value in enumerate(own_rates):
            if np.shape(value) not in ((), (1,), t.shape):
                raise _wrong_shape(f"model {model.name}", self.names[i], value, t.size)
            out[i] = value
        out[base:] = 0.0
        for k, law in self.laws:
            if law.jobs == (0, self.count):
                for row, value in law.changes(
                    t, x, named, u, p, magnitudes[k], law.candidate.shape
                ):
                    out[row] += value
                continue
            own = slice(*(e * (t.size // self.count) for e in law.jobs))
            y = x[:, own]
            for row, value in law.changes(
                t[own],
                y,
                self.view(y),
                selected(u, own),
                selected(p, own),
                magnitudes[k, own],
                law.candidate.shape,
            ):
                out[row, own] += value
        return out

    def outputs(
        self, t: Array, x: Array, u: Named, p: Named, slopes: Array | None, names: Sequence[str]
    ) -> Array:
        """These outputs, (outputs, n); ``slopes``: rates of the states, if an output needs them."""
        named = self.view(x)
        out = np.empty((len(names), t.size))
        for o, name in enumerate(names):
            of = self.model._outputs[name]
            if isinstance(of, str):
                out[o] = named[of]
            elif isinstance(of, Rate):
                assert slopes is not None
                out[o] = slopes[self.rows[of.state]]
            else:
                with calling(f"model {self.model.name}: its output {name}"):
                    out[o] = of(t, named, u, p)
        return out


def selected(values: Named, own: slice) -> Named:
    """Values of some instants or jobs."""
    return Named._of({name: value[own] for name, value in values._values.items()})


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Results of an integration, with the states at which it evaluated the rates."""

    equations: System
    clock: Clock
    runs: list[Array]
    """Outputs by batch, (B, n, ny)."""
    samples: Array
    """States at the samples, (longest, states, jobs); empty if not wanted."""
    stages: Array
    """States of the stages, (longest - 1, substeps, stages, states, jobs)."""


def integrate(model: Any, batches: Sequence[Batch], keep: int = 0) -> Trajectory:
    """Integrate with fixed steps between the samples; the class describes the methods.

    Parameters
    ----------
    model
        The model.
    batches
        Records and jobs; either with unknown forces of equal knots, or with none. It is faster if
        those with the same included effects follow each other.
    keep
        Number of jobs whose states are kept.
    """
    longest = max(record.samples for record, _ in batches)
    clock = Clock.of(model, batches, longest)
    equations = System(model, batches)
    p, magnitudes = equations.p, equations.magnitudes
    forces = None
    if batches[0][1].forces is not None:
        forces = np.concatenate([jobs.forces for _, jobs in batches if jobs.forces is not None])
    count = equations.count
    x, at = np.zeros((equations.size, count)), 0
    for _, jobs in batches:
        x[: jobs.starts.shape[1], at : at + jobs.count] = jobs.starts.T
        at += jobs.count
    outputs = np.full((longest, count, len(model.outputs)), np.nan)
    coordinates = {c.name: c for c in model.coordinates}
    knots = 0 if forces is None else forces.shape[2]
    job = np.arange(count)
    begin = clock.time[0]
    span = clock.time[-1] - begin

    def rates(t: Array, x: Array, u: Named) -> Array:
        out = equations.rates(t, x, u, p, magnitudes)
        if forces is not None:
            named = equations.view(x)
            place = np.clip((t - begin) / span, 0.0, 1.0) * (knots - 1)
            left = np.minimum(place.astype(np.intp), knots - 2)
            share = place - left
            for j, port in enumerate(model.ports):
                force = (1.0 - share) * forces[job, j, left]
                force = force + share * forces[job, j, left + 1]
                if port.name in coordinates:
                    pushed = coordinates[port.name]._push(force, t, named, u, p)
                else:
                    pushed = {model._port_states[port.name]: force}
                for state, value in pushed.items():
                    out[equations.rows[state]] += value
        return out

    shows_rates = any(isinstance(of, Rate) for of in model._outputs.values())
    substeps = model.substeps or 1
    halves = np.arange(2 * substeps + 1) / (2 * substeps)
    samples, kept = [], []
    for j in range(longest):
        t = clock.time[j]
        u = clock.inputs(model, j, halves if j < longest - 1 else halves[:1], p)
        slopes = rates(t, x, u[0]) if shows_rates else None
        outputs[j] = equations.outputs(t, x, u[0], p, slopes, model.outputs).T
        if keep:
            samples.append(x[:, :keep])
        if j == longest - 1:
            break
        h = (clock.time[j + 1] - t) / substeps
        half = 0.5 * h
        for s in range(substeps):
            u0, um, u1 = u[2 * s : 2 * s + 3]
            t0 = t + s * h
            instants = [(t0, u0), (t0 + half, um), (t0 + half, um), (t0 + h, u1)]
            if model.method == "rosenbrock":
                instants = instants[::3]
            x, stages = advanced(
                lambda k, y, at=instants: rates(at[k][0], y, at[k][1]),  # type: ignore[misc]
                model.method,
                h,
                x,
                equations.scales,
            )
            if keep:
                kept.append([stage[:, :keep].copy() for stage in stages])
    runs, at = [], 0
    for record, jobs in batches:
        own = slice(at, at + jobs.count)
        runs.append(np.ascontiguousarray(np.moveaxis(outputs[: record.samples, own], 0, 1)))
        at += jobs.count
    stages_of = np.array(kept).reshape(longest - 1, substeps, STAGES[model.method], len(x), keep)
    return Trajectory(equations, clock, runs, np.array(samples), stages_of)


def advanced(
    rates: Callable[[int, Array], Array], method: str, h: Array, x: Array, scales: Array
) -> tuple[Array, tuple[Array, ...]]:
    """States after one step, (states, jobs), and at its stages; ``rates(stage, x)``.

    ``"rosenbrock"`` is ROS2 (Verwer et al. 1999). It is L-stable and keeps order 2 with any
    approximate Jacobian; here it is computed by finite differences.
    """
    k1 = rates(0, x)
    if method == "rk4":
        half = 0.5 * h
        x2 = x + half * k1
        k2 = rates(1, x2)
        x3 = x + half * k2
        k3 = rates(2, x3)
        x4 = x + h * k3
        return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(3, x4)), (x, x2, x3, x4)
    nx, count = x.shape
    jacobian = np.empty((count, nx, nx))
    for i in range(nx):
        step = 1e-6 * (np.abs(x[i]) + scales[i])
        moved = x.copy()
        moved[i] += step
        jacobian[:, :, i] = ((rates(0, moved) - k1) / step).T
    matrix = np.eye(nx) - GAMMA * h[:, None, None] * jacobian
    k1 = solved(matrix, k1.T[:, :, None])[:, :, 0].T
    x1 = x + h * k1
    k2 = solved(matrix, (rates(1, x1) - 2.0 * k1).T[:, :, None])[:, :, 0].T
    return x + h * (1.5 * k1 + 0.5 * k2), (x, x1)


def solved(matrix: Array, right: Array) -> Array:
    """Solutions of linear systems; NaN where the matrix is not finite."""
    bad = ~np.all(np.isfinite(matrix), axis=(-2, -1))
    out = np.linalg.solve(np.where(bad[..., None, None], np.eye(matrix.shape[-1]), matrix), right)
    out[bad] = np.nan
    return np.asarray(out)
