"""A nominal from a right-hand side in Python, integrated for all lanes at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.nominal import (
    Effect,
    Lanes,
    Nominal,
    Parameter,
    Port,
    Simulated,
    State,
    Term,
)

__all__ = ["Coordinate", "Named", "OdeNominal"]


class Named:
    """Values by name: ``x.q`` or ``x["q"]``; arrays with one entry a lane, (B,)."""

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[str, Any]):
        self._values = values

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __getattr__(self, name: str) -> Any:
        try:
            return self._values[name]
        except KeyError:
            raise AttributeError(f"no {name!r}; known are {', '.join(self._values)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self._values


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """A coordinate of a second-order system: generic effects act on it.

    A force F [unit] on it changes its acceleration by F / inertia.
    """

    name: str
    position: str
    """State that holds the position."""
    speed: str
    """State that holds the speed."""
    inertia: str | float | Callable[[Any, Named, Named, Named], Array] = 1.0
    """Name of a parameter, a number, or a function (t, x, u, p) -> (B,)."""
    unit: str = "N"
    scale: float = 1.0
    """Natural size of a force on it [unit]."""

    def acceleration(self, force: Any, t: Any, x: Named, u: Named, p: Named) -> Any:
        """Acceleration that a force gives."""
        if isinstance(self.inertia, str):
            return force / p[self.inertia]
        if callable(self.inertia):
            return force / self.inertia(t, x, u, p)
        return force / self.inertia


class OdeNominal(Nominal):
    """States with rates dx/dt = f(t, x, u, p), written for whole arrays.

    Parameters
    ----------
    states, parameters
        Their names must differ.
    rates
        ``rates(t, x, u, p)`` returns the rates in the order of the states, each a number or (B,).
        ``x.q``, ``u.force``, ``p.mass`` are arrays with one entry a lane.
    outputs
        Name -> name of a state, or function ``(t, x, u, p) -> (B,)``.
    inputs
        Names of the inputs that it reads; a record must have them.
    coordinates
        Coordinates of a second-order system; each is also a port for unknown forces.
    ports
        Name -> state whose rate an unknown quantity may change, for systems of first order.
    method
        ``"rk4"``: classical Runge-Kutta, ``substeps`` steps a sample.
        ``"rosenbrock"``: linearly implicit of order 2 (L-stable), for stiff systems.
    hold
        Input between samples: ``"linear"``; ``"zero"`` (held at the value of the last sample, as a
        converter does); ``"spline"`` (cubic, for a smooth signal that was sampled sparsely: a
        straight line weakens what has less than ten samples a period).
    """

    def __init__(
        self,
        *,
        states: Sequence[State],
        rates: Callable[[Any, Named, Named, Named], Any],
        outputs: Mapping[str, str | Callable[[Any, Named, Named, Named], Any]],
        parameters: Sequence[Parameter] = (),
        inputs: Sequence[str] = (),
        coordinates: Sequence[Coordinate] = (),
        ports: Mapping[str, str] | None = None,
        method: Literal["rk4", "rosenbrock"] = "rk4",
        substeps: int = 1,
        hold: Literal["linear", "zero", "spline"] = "linear",
        name: str = "model",
        window: float | None = None,
        chaotic: bool = False,
    ):
        self.name = name
        self.parameters = tuple(parameters)
        self.outputs = tuple(outputs)
        self.window = window
        self.chaotic = chaotic
        self.inputs = tuple(inputs)
        self.coordinates = tuple(coordinates)
        self.substeps = substeps
        self.hold = hold
        self.method = method
        self._states = tuple(states)
        self._rates = rates
        self._outputs = dict(outputs)
        units = {s.name: s.unit for s in states}
        self.units = {k: units[v] for k, v in outputs.items() if isinstance(v, str) and v in units}
        self._port_states = {c.name: c.speed for c in coordinates} | dict(ports or {})
        self._port_coordinates = {c.name: c for c in coordinates}
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
            if isinstance(of, str) and of not in names:
                faults.append(f"output {output}: {of!r} is no state; known are {', '.join(names)}")
        for c in self.coordinates:
            faults.extend(
                f"coordinate {c.name}: {n!r} is no state; known are {', '.join(names)}"
                for n in (c.position, c.speed)
                if n not in names
            )
        for port, state in self._port_states.items():
            if state not in names:
                faults.append(f"port {port}: {state!r} is no state; known are {', '.join(names)}")
        if self.substeps < 1:
            faults.append(f"substeps = {self.substeps}, expected >= 1")
        if faults:
            raise InvalidParameter(f"model {self.name}: " + "; ".join(faults))

    def states(self, terms: Sequence[Term] = ()) -> tuple[State, ...]:
        """States, then hidden ones of the terms."""
        return self._states + tuple(h for t in terms for h in t.effect.hidden)

    def accepts(self, effect: Effect) -> bool:
        """Effects with a ``rate``, besides sensor and input effects."""
        return effect.rate is not None or super().accepts(effect)

    def simulate(self, record: Record, lanes: Lanes) -> Simulated:
        """See :class:`~feltmb.fit.Nominal`."""
        missing = [n for n in self.inputs if n not in record.inputs]
        if missing:
            raise InvalidParameter(
                f"record {record.name}: model {self.name} needs the input {', '.join(missing)}; "
                f"there is {', '.join(record.inputs) or 'none'}"
            )
        with np.errstate(all="ignore"):
            return _integrate(self, record, lanes)


def _integrate(model: OdeNominal, record: Record, lanes: Lanes) -> Simulated:
    """Fixed steps between the samples; see the class for the methods."""
    count, longest = lanes.count, lanes.longest
    first, last = lanes.windows[:, 0], lanes.windows[:, 1]
    p = Named({q.name: lanes.theta[:, i] for i, q in enumerate(model.parameters)})
    names = [s.name for s in model._states]
    base = len(names)
    states = model.states(lanes.terms)
    x = np.ascontiguousarray(lanes.starts.T)
    outputs = np.full((count, longest, len(model.outputs)), np.nan)
    ends = np.full((count, len(states)), np.nan)
    signals = [record.inputs[n] for n in model.inputs]
    inverse = {n: i for i, n in enumerate(names)}
    ports = [
        (inverse[model._port_states[q.name]], model._port_coordinates.get(q.name))
        for q in model.ports
    ]
    knots = 0 if lanes.forces is None else lanes.forces.shape[2]
    span = record.time[last] - record.time[first]

    def view(x: Array) -> Named:
        return Named({n: x[i] for i, n in enumerate(names)})

    def rates(t: Array, x: Array, u: Named) -> Array:
        named = view(x)
        out = np.empty_like(x)
        own_rates = tuple(model._rates(t, named, u, p))
        if len(own_rates) != base:
            raise InvalidParameter(
                f"model {model.name}: rates returned {len(own_rates)} values, expected one for "
                f"each state: {', '.join(names)}"
            )
        for i, value in enumerate(own_rates):
            out[i] = value
        at = base
        for k, term in enumerate(lanes.terms):
            own = term.effect.hidden
            seen = named
            if own:
                out[at : at + len(own)] = 0.0
                seen = Named({**named._values, **{h.name: x[at + j] for j, h in enumerate(own)}})
            assert term.effect.rate is not None
            size = lanes.sizes[:, k]
            change: Any = term.effect.rate(t, seen, u, p, size, term.shape)
            if not isinstance(change, Mapping):
                raise InvalidParameter(
                    f"effect {term.name}: rate returned {type(change).__name__}, expected a "
                    "dictionary of rates by name of the state"
                )
            hidden = {h.name: at + j for j, h in enumerate(own)}
            for name, value in change.items():
                row = inverse.get(name, hidden.get(name))
                if row is None:
                    raise InvalidParameter(
                        f"effect {term.name}: rate changes {name!r}, which is no state; known are "
                        f"{', '.join([*names, *hidden])}"
                    )
                if np.shape(value) not in ((), (1,), (count,)):
                    raise InvalidParameter(
                        f"effect {term.name}: rate of {name} has shape {np.shape(value)}, expected "
                        f"a number or one value a lane, ({count},)"
                    )
                out[row] += value
            at += len(own)
        if lanes.forces is not None:
            place = np.clip((t - record.time[first]) / span, 0.0, 1.0) * (knots - 1)
            left = np.minimum(place.astype(np.intp), knots - 2)
            share = place - left
            lane = np.arange(count)
            for j, (state, coordinate) in enumerate(ports):
                force = (1.0 - share) * lanes.forces[lane, j, left]
                force = force + share * lanes.forces[lane, j, left + 1]
                if coordinate is not None:
                    force = coordinate.acceleration(force, t, named, u, p)
                out[state] += force
        return out

    bends = _bends(record, signals) if model.hold == "spline" else []

    def inputs_at(at: Array, nxt: Array, share: float) -> Named:
        values = {}
        for i, (name, signal) in enumerate(zip(model.inputs, signals, strict=True)):
            value = signal[at]
            if model.hold != "zero":
                value = value + share * (signal[nxt] - signal[at])
            if bends:
                rest, square = 1.0 - share, (record.time[nxt] - record.time[at]) ** 2 / 6.0
                value = value + square * (
                    (rest**3 - rest) * bends[i][at] + (share**3 - share) * bends[i][nxt]
                )
            values[name] = value
        return Named(values)

    end = record.samples - 1
    for j in range(longest):
        at = np.minimum(first + j, end)
        nxt = np.minimum(at + 1, end)
        t = record.time[at]
        u = inputs_at(at, nxt, 0.0)
        named = view(x)
        for o, name in enumerate(model.outputs):
            of = model._outputs[name]
            outputs[:, j, o] = named[of] if isinstance(of, str) else of(t, named, u, p)
        done = last - first == j
        if done.any():
            ends[done] = x.T[done]
        if j == longest - 1:
            break
        h = (record.time[nxt] - t) / model.substeps
        for s in range(model.substeps):
            a, b = s / model.substeps, (s + 1) / model.substeps
            u0, u1 = inputs_at(at, nxt, a), inputs_at(at, nxt, b)
            um = inputs_at(at, nxt, 0.5 * (a + b))
            t0 = t + s * h
            if model.method == "rk4":
                k1 = rates(t0, x, u0)
                k2 = rates(t0 + 0.5 * h, x + 0.5 * h * k1, um)
                k3 = rates(t0 + 0.5 * h, x + 0.5 * h * k2, um)
                k4 = rates(t0 + h, x + h * k3, u1)
                x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            else:
                x = _rosenbrock(rates, states, t0, h, x, u0, u1)
    return Simulated(outputs=outputs, ends=ends)


def _bends(record: Record, signals: Sequence[Array]) -> list[Array]:
    """Second derivatives of the cubic splines through the inputs, at the samples."""
    from scipy.interpolate import CubicSpline

    return [np.asarray(CubicSpline(record.time, s)(record.time, 2)) for s in signals]


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

    It is L-stable and keeps order 2 with any approximate Jacobian; here that by differences.
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
