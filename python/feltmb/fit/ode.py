"""A model from a right-hand side in Python, integrated for all jobs simultaneously."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.fit.calling import calling
from feltmb.fit.coordinates import Coordinate, Coupling, Named, Rate
from feltmb.fit.model import (
    Batch,
    Candidate,
    Effect,
    Jobs,
    Model,
    Parameter,
    Port,
    Ready,
    Simulated,
    State,
)
from feltmb.fit.resolution import BETWEEN, Stepped, refined, resolved
from feltmb.fit.watch import simulated
from feltmb.units import to_si

__all__ = ["OdeModel"]


@checked
class OdeModel(Stepped):
    """States with rates dx/dt = f(t, x, u, p), as a function of arrays.

    Parameters
    ----------
    states, parameters
        Their names must differ.
    rates
        ``rates(t, x, u, p)`` returns the rates in the order of the states, each a number or (B,).
        ``x.q``, ``u.force``, ``p.mass`` are arrays with one entry per job.
    outputs
        Name -> name of a state; or ``Rate("v")``, the rate of a state including effects; or a
        function ``(t, x, u, p) -> (B,)``, which gets the states of the model without effects.
    inputs
        Names of the inputs that the rates use; a record must contain them. With their units, as
        ``{"valve": "%"}``, files in other units are converted to these.
    coordinates
        Coordinates of a second-order system, and couplings between them; each is also a port for
        unknown forces.
    ports
        Name -> state whose rate an unknown quantity may change, for systems of first order.
    method
        ``"rk4"``: classical Runge-Kutta, ``substeps`` steps per sample. ``"rosenbrock"``: linearly
        implicit of order 2 (L-stable), for stiff systems.
    substeps
        Steps per sample. None: a fit or a diagnosis uses as few as keep the error below the noise
        of the sensors (1 to 16); otherwise one.
    hold
        Input between samples: ``"linear"``; ``"zero"`` (constant at the value of the last sample,
        as for a digital-to-analog converter); ``"spline"`` (cubic, for a smooth signal that was
        sampled sparsely: linear interpolation attenuates signals with less than ten samples per
        period). ``"auto"``: linear; if a fit or a diagnosis could detect the difference to a
        spline, it has a parameter ``between.INPUT``, 0: linear, 1: spline.
    """

    def __init__(
        self,
        *,
        states: Sequence[State],
        rates: Callable[[Any, Named, Named, Named], Any],
        outputs: Mapping[str, str | Rate | Callable[[Any, Named, Named, Named], Any]],
        parameters: Sequence[Parameter] = (),
        inputs: Sequence[str] | Mapping[str, str] = (),
        coordinates: Sequence[Coordinate | Coupling] = (),
        ports: Mapping[str, str] | None = None,
        method: Literal["rk4", "rosenbrock"] = "rk4",
        substeps: int | None = None,
        hold: Literal["auto", "linear", "zero", "spline"] = "auto",
        name: str = "model",
        segment: float | None = None,
        chaotic: bool = False,
    ):
        self.name = name
        self.parameters = tuple(parameters)
        self.outputs = tuple(outputs)
        self.segment = segment
        self.chaotic = chaotic
        self.inputs = tuple(inputs)
        self.coordinates = tuple(coordinates)
        self.substeps = substeps
        self.hold: Literal["auto", "linear", "zero", "spline", "between"] = hold
        self.method = method
        self._resolved = self._free_steps = False
        self._states = tuple(states)
        self._rates = rates
        self._outputs = dict(outputs)
        units = {s.name: s.unit for s in states}
        self.units = {k: units[v] for k, v in outputs.items() if isinstance(v, str) and v in units}
        self.units |= {
            k: _per_second(units[v.state])
            for k, v in outputs.items()
            if isinstance(v, Rate) and units.get(v.state, "1") != "1"
        }
        if isinstance(inputs, Mapping):
            self.units |= inputs
        self._port_states = dict(ports or {})
        self.ports = tuple(
            Port(
                name=c.name,
                component=c.name,
                unit=c.unit,
                scale=c.scale,
                position=c.position,
                speed=c.speed,
            )
            for c in coordinates
        ) + tuple(
            Port(name=n, component=n, unit=f"{s.unit}/s", scale=s.scale, position=state)
            for n, state in (ports or {}).items()
            for s in self._states
            if s.name == state
        )
        self._check()

    def _check(self) -> None:
        names = [s.name for s in self._states]
        everything = [*names, *(p.name for p in self.parameters), *self.inputs]
        faults = [
            f"{n!r} is used twice" for n in dict.fromkeys(everything) if everything.count(n) > 1
        ]
        for output, of in self._outputs.items():
            state = of.state if isinstance(of, Rate) else of
            if isinstance(state, str) and state not in names:
                faults.append(
                    f"output {output}: {state!r} is no state; known are {', '.join(names)}"
                )
        for c in self.coordinates:
            faults.extend(
                f"coordinate {c.name}: {n!r} is no state; known are {', '.join(names)}"
                for part in c.parts
                for n in (part.position, part.speed)
                if n not in names
            )
        own = [p.name for p in self.parameters]
        faults += [
            f"coordinate {part.name}: inertia {part.inertia!r} is no parameter; known are "
            f"{', '.join(own) or 'none'}"
            for c in self.coordinates
            for part in c.parts
            if isinstance(part.inertia, str) and part.inertia not in own
        ]
        units = {s.name: s.unit for s in self._states}
        faults += [
            f"coordinate {part.name}: its position {part.position} has the unit {unit}, but a "
            f"force in {part.unit} moves it in {part.travel_unit}: expected the unit of the force "
            f"(unit='N m' for a torque), or position_unit={unit!r}"
            for c in self.coordinates
            for part in c.parts
            if (unit := units.get(part.position, "1")) != "1"
            and not _same_kind(unit, part.travel_unit)
        ]
        for port, state in self._port_states.items():
            if state not in names:
                faults.append(f"port {port}: {state!r} is no state; known are {', '.join(names)}")
        ports = [p.name for p in self.ports]
        faults += [
            f"{n!r} names two coordinates or ports"
            for n in dict.fromkeys(ports)
            if ports.count(n) > 1
        ]
        faults += [
            f"coupling {c.name}: lies between {c.first.name} and itself"
            for c in self.coordinates
            if isinstance(c, Coupling) and c.first.speed == c.second.speed
        ]
        if self.substeps is not None and not (
            isinstance(self.substeps, int | np.integer) and self.substeps >= 1
        ):
            faults.append(f"substeps = {self.substeps!r}, expected a whole number >= 1, or None")
        for what, given, known in (
            ("method", self.method, ("rk4", "rosenbrock")),
            ("hold", self.hold, ("auto", "linear", "zero", "spline")),
        ):
            if given not in known:
                faults.append(f"{what} = {given!r}, expected one of {', '.join(known)}")
        if faults:
            raise InvalidParameter(f"model {self.name}: " + "; ".join(faults))

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """States, followed by the hidden states of the included effects."""
        return self._states + tuple(h for t in included for h in t.effect.hidden)

    def ready(self, records: Sequence[Record]) -> Ready:
        """Choose the substeps and the interpolation of the inputs for the records."""
        if self._resolved:
            return Ready(self, tuple(records))
        try:
            out, notes = resolved(self, records)
        except FeltmbError:  # the first simulation of the user reports it better
            return Ready(self, tuple(records))
        out._resolved, out._free_steps = True, self.substeps is None
        parts = {part.name: part for c in self.coordinates for part in c.parts}
        notes += [text for part in parts.values() if (text := part.without_inertia)]
        return Ready(out, tuple(records), tuple(notes))

    def refined(self, batches: Sequence[Batch]) -> Model:
        """Copy with more substeps, if they were not specified and these jobs need them."""
        return refined(self, batches) if self._free_steps else self

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has a ``rate``, or is a sensor or input effect."""
        return effect.rate is not None or super().accepts(effect)

    def simulate(self, record: Record, jobs: Jobs) -> Simulated:
        """See :class:`~feltmb.fit.Model`."""
        return self._simulated([(record, jobs)])[0]

    def simulate_all(self, batches: Sequence[Batch]) -> list[Simulated]:
        """Simulate batches; jobs with the same included effects are integrated together."""
        if type(self).simulate is not OdeModel.simulate:  # a subclass overrides ``simulate``
            return super().simulate_all(batches)
        return self._simulated(batches)

    def _simulated(self, batches: Sequence[Batch]) -> list[Simulated]:
        for record, _ in batches:
            missing = [n for n in self.inputs if n not in record.inputs]
            if missing:
                raise InvalidParameter(
                    f"record {record.name}: model {self.name} needs the input "
                    f"{', '.join(missing)}; there is {', '.join(record.inputs) or 'none'}"
                )
        for record, jobs in batches:
            samples = float(np.sum(jobs.segments[:, 1] - jobs.segments[:, 0]))
            simulated(samples / max(record.samples - 1, 1))
        groups: dict[object, list[int]] = {}
        for i, (_, jobs) in enumerate(batches):
            included = tuple((id(t.effect), repr(t.shape)) for t in jobs.included)
            knots = None if jobs.forces is None else jobs.forces.shape[2]
            groups.setdefault((included, knots), []).append(i)
        runs: dict[int, Simulated] = {}
        with np.errstate(all="ignore"):
            for group in groups.values():
                runs.update(zip(group, _integrate(self, [batches[i] for i in group]), strict=True))
        return [runs[i] for i in range(len(batches))]


@dataclass(frozen=True, eq=False)
class _Clock:
    """Time and inputs of jobs by sample, (longest, B); constant after the end of a record."""

    time: Array
    signals: list[Array]
    bends: list[Array]
    """Second derivatives of the cubic splines through the inputs; empty: not needed."""

    @classmethod
    def of(cls, model: OdeModel, batches: Sequence[Batch], longest: int) -> _Clock:
        """Times and inputs of all jobs of several batches."""
        times: list[Array] = []
        signals: list[list[Array]] = [[] for _ in model.inputs]
        bends: list[list[Array]] = [[] for _ in model.inputs]
        for record, jobs in batches:
            at = np.minimum(jobs.segments[:, 0] + np.arange(longest)[:, None], record.samples - 1)
            times.append(record.time[at])
            values = [record.inputs[n] for n in model.inputs]
            for k, value in enumerate(values):
                signals[k].append(value[at])
            if model.hold in ("spline", "between"):
                for k, bend in enumerate(_bends(record, values)):
                    bends[k].append(bend[at])
        return cls(
            np.hstack(times),
            [np.hstack(parts) for parts in signals],
            [np.hstack(parts) for parts in bends if parts],
        )

    def inputs(self, model: OdeModel, j: int, shares: Array, p: Named) -> list[Named]:
        """Inputs of the jobs between samples j and j + 1, at these shares of the interval."""
        nxt = min(j + 1, len(self.time) - 1)
        share = shares[:, None]
        columns = []
        for i, (name, signal) in enumerate(zip(model.inputs, self.signals, strict=True)):
            value = np.repeat(signal[j][None, :], len(shares), axis=0)
            if model.hold != "zero":
                value = value + share * (signal[nxt] - signal[j])
            if self.bends:
                rest, square = 1.0 - share, (self.time[nxt] - self.time[j]) ** 2 / 6.0
                bent = square * (
                    (rest**3 - rest) * self.bends[i][j] + (share**3 - share) * self.bends[i][nxt]
                )
                value = value + (p[BETWEEN + name] * bent if model.hold == "between" else bent)
            columns.append(value)
        if not columns:
            return [Named._of({})] * len(shares)
        names = model.inputs
        return [Named._of(dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True)]


def _integrate(model: OdeModel, batches: Sequence[Batch]) -> list[Simulated]:
    """Integrate with fixed steps between the samples; the class describes the methods.

    All batches have the same included effects, and unknown forces either with equal knots or none.
    """
    longest = max(jobs.longest for _, jobs in batches)
    clock = _Clock.of(model, batches, longest)
    theta = np.vstack([jobs.theta for _, jobs in batches])
    segments = np.vstack([jobs.segments for _, jobs in batches])
    included = batches[0][1].included
    magnitudes = (
        np.vstack([jobs.magnitudes for _, jobs in batches])
        if included
        else np.zeros((len(theta), 0))
    )
    forces = None
    if batches[0][1].forces is not None:
        forces = np.concatenate([jobs.forces for _, jobs in batches if jobs.forces is not None])
    x = np.ascontiguousarray(np.vstack([jobs.starts for _, jobs in batches]).T, dtype=np.float64)
    count = x.shape[1]
    last = segments[:, 1] - segments[:, 0]
    p = Named({q.name: theta[:, i] for i, q in enumerate(model.parameters)})
    names = [s.name for s in model._states]
    base = len(names)
    states = model.states(included)
    outputs = np.full((longest, count, len(model.outputs)), np.nan)
    ends = np.full((count, len(states)), np.nan)
    inverse = {n: i for i, n in enumerate(names)}
    coordinates = {c.name: c for c in model.coordinates}
    knots = 0 if forces is None else forces.shape[2]
    job = np.arange(count)
    begin = clock.time[0]
    span = clock.time[last, job] - begin

    ours = calling(f"model {model.name}: its rates function")
    theirs = [calling(f"effect {t.name}: its rate") for t in included]
    effects: list[tuple[str, Any, dict[str, int]]] = []
    shapes = [t.shape for t in included]
    at = base
    for candidate in included:
        hidden = [h.name for h in candidate.effect.hidden]
        taken = [name for name in hidden if name in inverse]
        if taken:
            raise InvalidParameter(
                f"effect {candidate.name}: its hidden state {taken[0]!r} has the name "
                "of a state of "
                f"model {model.name}; rename one of them"
            )
        rows = {name: at + j for j, name in enumerate(hidden)}
        effects.append((candidate.name, candidate.effect.rate, rows))
        at += len(hidden)

    def view(x: Array) -> Named:
        return Named._of(dict(zip(names, x, strict=False)))

    permitted = ((), (1,), (count,))

    def wrong_shape(of: str, state: str, value: Any) -> InvalidParameter:
        return InvalidParameter(
            f"{of}: rate of {state} has shape {np.shape(value)}, expected a number or one value a "
            f"job, ({count},)"
        )

    def rates(t: Array, x: Array, u: Named) -> Array:
        named = view(x)
        out = np.empty_like(x)
        with ours:
            own_rates = tuple(model._rates(t, named, u, p))
        if len(own_rates) != base:
            raise InvalidParameter(
                f"model {model.name}: rates returned {len(own_rates)} values, expected one for "
                f"each state: {', '.join(names)}"
            )
        for i, value in enumerate(own_rates):
            if np.shape(value) not in permitted:
                raise wrong_shape(f"model {model.name}", names[i], value)
            out[i] = value
        out[base:] = 0.0
        for k, (effect, own, memory) in enumerate(effects):
            seen = named
            if memory:
                held = {name: x[row] for name, row in memory.items()}
                seen = Named._of({**named._values, **held})
            with theirs[k]:
                change: Any = own(t, seen, u, p, magnitudes[:, k], shapes[k])
            if not isinstance(change, Mapping):
                raise InvalidParameter(
                    f"effect {effect}: rate returned {type(change).__name__}, expected a "
                    "dictionary of rates by name of the state"
                )
            for name, value in change.items():
                row = inverse.get(name, memory.get(name))
                if row is None:
                    raise InvalidParameter(
                        f"effect {effect}: rate changes {name!r}, which is no state; known are "
                        f"{', '.join([*names, *memory])}"
                    )
                if np.shape(value) not in permitted:
                    raise wrong_shape(f"effect {effect}", name, value)
                out[row] += value
        if forces is not None:
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
                    out[inverse[state]] += value
        return out

    shows_rates = any(isinstance(of, Rate) for of in model._outputs.values())
    ending = set(last.tolist())
    substeps = model.substeps or 1
    halves = np.arange(2 * substeps + 1) / (2 * substeps)
    for j in range(longest):
        t = clock.time[j]
        u = clock.inputs(model, j, halves if j < longest - 1 else halves[:1], p)
        named = view(x)
        slopes = rates(t, x, u[0]) if shows_rates else None
        for o, name in enumerate(model.outputs):
            of = model._outputs[name]
            if isinstance(of, str):
                outputs[j, :, o] = named[of]
            elif isinstance(of, Rate):
                assert slopes is not None
                outputs[j, :, o] = slopes[inverse[of.state]]
            else:
                with calling(f"model {model.name}: its output {name}"):
                    outputs[j, :, o] = of(t, named, u[0], p)
        if j in ending:
            ends[last == j] = x.T[last == j]
        if j == longest - 1:
            break
        h = (clock.time[j + 1] - t) / substeps
        half = 0.5 * h
        for s in range(substeps):
            u0, um, u1 = u[2 * s : 2 * s + 3]
            t0 = t + s * h
            if model.method == "rk4":
                k1 = rates(t0, x, u0)
                k2 = rates(t0 + half, x + half * k1, um)
                k3 = rates(t0 + half, x + half * k2, um)
                k4 = rates(t0 + h, x + h * k3, u1)
                x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            else:
                x = _rosenbrock(rates, states, t0, h, x, u0, u1)
    out, at = [], 0
    for _, jobs in batches:
        own = slice(at, at + jobs.count)
        part = np.ascontiguousarray(np.moveaxis(outputs[: jobs.longest, own], 0, 1))
        out.append(Simulated(outputs=part, ends=ends[own]))
        at += jobs.count
    return out


def _bends(record: Record, signals: Sequence[Array]) -> list[Array]:
    """Second derivatives, at the samples, of the cubic splines through the inputs."""
    from scipy.interpolate import CubicSpline

    return [np.asarray(CubicSpline(record.time, s)(record.time, 2)) for s in signals]


def _same_kind(one: str, other: str) -> bool:
    """Whether values in two units can be converted into each other; unknown units can."""
    try:
        return to_si(one)[1] == to_si(other)[1]
    except InvalidParameter:
        return True


def _per_second(unit: str) -> str:
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s"


GAMMA = 1.0 - np.sqrt(0.5)


def _rosenbrock(
    rates: Callable[[Array, Array, Named], Array],
    states: Sequence[State],
    t: Array,
    h: Array,
    x: Array,
    u0: Named,
    u1: Named,
) -> Array:
    """One step of ROS2 (Verwer et al. 1999).

    It is L-stable and keeps order 2 with any approximate Jacobian; here it is computed by finite
    differences.
    """
    nx, count = x.shape
    f0 = rates(t, x, u0)
    jacobian = np.empty((count, nx, nx))
    for i, state in enumerate(states):
        step = 1e-6 * (np.abs(x[i]) + state.scale)
        moved = x.copy()
        moved[i] += step
        jacobian[:, :, i] = ((rates(t, moved, u0) - f0) / step).T
    matrix = np.eye(nx) - GAMMA * h[:, None, None] * jacobian
    bad = ~np.all(np.isfinite(matrix), axis=(1, 2))
    matrix[bad] = np.eye(nx)
    k1 = np.linalg.solve(matrix, f0.T[:, :, None])[:, :, 0].T
    f1 = rates(t + h, x + h * k1, u1)
    k2 = np.linalg.solve(matrix, (f1 - 2.0 * k1).T[:, :, None])[:, :, 0].T
    new = x + h * (1.5 * k1 + 0.5 * k2)
    new[:, bad] = np.nan
    return new
