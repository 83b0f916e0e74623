"""A model from a right-hand side in Python, integrated for all jobs simultaneously."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.fit.coordinates import Coordinate, Coupling, Named, Rate
from feltmb.fit.integrate import integrate
from feltmb.fit.model import (
    Batch,
    Candidate,
    Effect,
    Jobs,
    Port,
    Ready,
    Sensitivity,
    SensitivityRequest,
    State,
)
from feltmb.fit.priors import (
    Bounds,
    Priors,
    Unknowns,
    check_bounds,
    parameters_of,
    unknown_effects,
)
from feltmb.fit.resolution import Stepped, resolved
from feltmb.fit.short import by_rates, states_of, trial, with_unknown
from feltmb.fit.sizes import sized
from feltmb.fit.variational import variational_sensitivities
from feltmb.units import to_si

__all__ = ["Equations"]


@checked
class Equations(Stepped):
    """States with rates dx/dt = f(t, x, u, p), as a function of arrays.

    Parameters
    ----------
    rates
        ``rates(t, x, u, p)`` returns the rates in the order of the states, each a number or (B,).
        ``x.q``, ``u.force``, ``p.mass`` are arrays with one entry per job.
    states
        Name -> unit, or ``(start, sd of the start, unit)``; with the unit alone, the start is
        unknown. Or a list of :class:`State`.
    parameters, unknown, bounds
        As for :class:`Simulator`. The names of states, inputs and parameters must differ.
    outputs
        Name -> name of a state; or ``Rate("v")``, the rate of a state including effects; or a
        function ``(t, x, u, p) -> (B,)``, which gets the states of the model without effects.
        Default: every state by its name.
    inputs
        Names of the inputs that the rates use; a record must contain them. With their units, as
        ``{"valve": "%"}``, files in other units are converted to these. Default: those that the
        rates read in a trial.
    coordinates
        Coordinates of a second-order system, and couplings between them; each is also a port for
        unknown forces. Default: every state whose rate is another state, with the parameter in kg
        or kg m^2 that divides all forces as its inertia.
    ports
        Name -> state whose rate an unknown quantity may change, for systems of first order.
        Default: every state that belongs to no coordinate, if the coordinates have their default.
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

    cheap_derivatives = True

    def __init__(
        self,
        rates: Callable[[Any, Named, Named, Named], Any],
        *,
        states: Sequence[State] | Mapping[str, Any],
        parameters: Priors = (),
        unknown: Unknowns = None,
        inputs: Sequence[str] | Mapping[str, str] | None = None,
        outputs: Mapping[str, str | Rate | Callable[[Any, Named, Named, Named], Any]] | None = None,
        bounds: Bounds = None,
        coordinates: Sequence[Coordinate | Coupling] | None = None,
        ports: Mapping[str, str] | None = None,
        method: Literal["rk4", "rosenbrock"] = "rk4",
        substeps: int | None = None,
        hold: Literal["auto", "linear", "zero", "spline"] = "auto",
        name: str = "model",
    ):
        self.name = name
        self.parameters = parameters_of(parameters, bounds)
        self.effects, neutral, self._unsized = unknown_effects(unknown, bounds)
        check_bounds(bounds, [*(p.name for p in self.parameters), *neutral], name)
        self._rates = with_unknown(rates, neutral)
        self.effects = tuple(by_rates(rates, e, neutral) for e in self.effects)
        self._states = states_of(states)
        self._unscaled = isinstance(states, Mapping)
        found = trial(self._rates, self._states, self.parameters, inputs)
        outputs = {s.name: s.name for s in self._states} if outputs is None else outputs
        inputs = found.inputs if inputs is None else inputs
        self.outputs = tuple(outputs)
        self.inputs = tuple(inputs)
        self._inferred = coordinates is None
        if coordinates is None:
            coordinates = found.coordinates
            own = {n for c in coordinates for n in (c.position, c.speed)}
            if ports is None and self._unscaled:
                ports = {s.name: s.name for s in self._states if s.name not in own}
        self.coordinates = tuple(coordinates)
        self.substeps = substeps
        self.hold: Literal["auto", "linear", "zero", "spline", "between"] = hold
        self.method = method
        self._resolved = False
        #: By included effects: whether the variational equations predict changes of the outputs.
        self._smooth: dict[object, bool] = {}
        #: Last motion by record and included effects, once the model is prepared for a fit.
        self._motions: dict[object, Array] | None = None
        self._outputs = dict(outputs)
        self._unknown = tuple(neutral)
        units = {s.name: s.unit for s in self._states}
        self.units = {k: units[v] for k, v in outputs.items() if isinstance(v, str) and v in units}
        self.units |= {
            k: _per_second(units[v.state])
            for k, v in outputs.items()
            if isinstance(v, Rate) and units.get(v.state, "1") != "1"
        }
        if isinstance(inputs, Mapping):
            self.units |= inputs
        self._port_states = dict(ports or {})
        self._make_ports()
        self._check()

    def _make_ports(self) -> None:
        self.ports = tuple(
            Port(
                name=c.name,
                component=c.name,
                unit=c.unit,
                scale=c.scale,
                position=c.position,
                speed=c.speed,
            )
            for c in self.coordinates
        ) + tuple(
            Port(name=n, component=n, unit=f"{s.unit}/s", scale=s.scale, position=state)
            for n, state in self._port_states.items()
            for s in self._states
            if s.name == state
        )

    def _check(self) -> None:
        names = [s.name for s in self._states]
        own = [p.name for p in self.parameters]
        everything = [*names, *own, *self._unknown, *self.inputs]
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
            own = copy.copy(self._scaled(records))
            own._motions = {}
            out, notes = resolved(own, records)
            out.effects, sizes = sized(out, out.effects, self._unsized, records)
        except FeltmbError:  # the first simulation of the user reports it better
            return Ready(self, tuple(records))
        out._resolved = True
        notes += sizes
        if self._inferred and self.coordinates:
            listed = [
                f"{c.name} (speed {c.speed}, inertia {c.inertia or 'none'})"
                for c in self.coordinates
                if isinstance(c, Coordinate)
            ]
            notes.append(f"coordinates, from the rates: {', '.join(listed)}")
        parts = {part.name: part for c in self.coordinates for part in c.parts}
        notes += [text for part in parts.values() if (text := part.without_inertia)]
        return Ready(out, tuple(records), tuple(notes))

    def _scaled(self, records: Sequence[Record]) -> Equations:
        """Copy with scales from the records where the short forms state none."""
        if not self._unscaled:
            return self
        out = copy.copy(self)
        paths = []
        for r in records:
            start = [(r.start.mean if r.start else {}).get(s.name, s.start) for s in self._states]
            theta = np.array([[p.value for p in self.parameters]])
            paths.append(self.motion(r, Jobs(theta=theta, starts=np.array([start])))[0])
        shown = {v: k for k, v in self._outputs.items() if isinstance(v, str)}
        sizes = {}
        for i, s in enumerate(self._states):
            seen = [r.outputs[shown[s.name]] for r in records if shown.get(s.name) in r.outputs]
            values = seen or [path[:, i] for path in paths]
            spread = [float(np.nanstd(v)) for v in values if np.isfinite(v).any()]
            sizes[s.name] = max(spread, default=0.0) or 1.0
        out._states = tuple(replace(s, scale=sizes[s.name]) for s in self._states)
        if self._inferred:
            names = [s.name for s in self._states]
            tabulated = {p.name: abs(p.value) for p in self.parameters}
            pushes = {}
            for c in (c for c in self.coordinates if isinstance(c, Coordinate)):
                i = names.index(c.speed)
                rate = max(
                    float(np.std(np.gradient(path[:, i], r.time)))
                    for r, path in zip(records, paths, strict=True)
                )
                push = tabulated.get(str(c.inertia), 1.0) * rate
                pushes[c.name] = push if 0.0 < push < np.inf else 1.0
            out.coordinates = tuple(
                replace(c, scale=pushes.get(c.name, c.scale)) for c in self.coordinates
            )
        out._make_ports()
        return out

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has a ``rate``, or is a sensor or input effect."""
        return effect.rate is not None or super().accepts(effect)

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~feltmb.fit.Model`."""
        return self._simulated([(record, jobs)])[0]

    def simulate_all(self, batches: Sequence[Batch]) -> list[Array]:
        """Simulate batches; jobs with the same included effects are integrated together."""
        if type(self).simulate is not Equations.simulate:  # a subclass overrides ``simulate``
            return super().simulate_all(batches)
        return self._simulated(batches)

    def motion(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~feltmb.fit.Model`."""
        with np.errstate(all="ignore"):
            found = integrate(self, [(record, jobs)], keep=1)
        return np.moveaxis(found.samples, -1, 0)

    def sensitivities(self, requests: Sequence[SensitivityRequest]) -> list[Sensitivity]:
        """Derivatives from the variational equations, or by differences if the rates jump."""
        for request in requests:
            request.check(self)
        own = (Equations.simulate, Equations.simulate_all)
        if (type(self).simulate, type(self).simulate_all) != own:  # a subclass overrides them
            return super().sensitivities(requests)
        self._check_inputs([(r.record, r.jobs()) for r in requests])
        with np.errstate(all="ignore"):
            found = variational_sensitivities(self, requests)
        jump = [i for i, s in enumerate(found) if s is None]
        if jump:
            rest = super().sensitivities([requests[i] for i in jump])
            for i, s in zip(jump, rest, strict=True):
                found[i] = s
        return [s for s in found if s is not None]

    def _simulated(self, batches: Sequence[Batch]) -> list[Array]:
        self._check_inputs(batches)
        groups: dict[object, list[int]] = {}
        for i, (_, jobs) in enumerate(batches):
            groups.setdefault(None if jobs.forces is None else jobs.forces.shape[2], []).append(i)
        runs: dict[int, Array] = {}
        with np.errstate(all="ignore"):
            for group in groups.values():  # jobs with the same effects follow each other
                first: dict[object, int] = {}
                for i in group:
                    first.setdefault(_effects_of(batches[i][1]), i)
                group.sort(key=lambda i: first[_effects_of(batches[i][1])])
                found = integrate(self, [batches[i] for i in group]).runs
                runs.update(zip(group, found, strict=True))
        return [runs[i] for i in range(len(batches))]

    def _check_inputs(self, batches: Sequence[Batch]) -> None:
        """Check that the records have the inputs."""
        for record, _ in batches:
            missing = [n for n in self.inputs if n not in record.inputs]
            if missing:
                raise InvalidParameter(
                    f"record {record.name}: model {self.name} needs the input "
                    f"{', '.join(missing)}; there is {', '.join(record.inputs) or 'none'}"
                )


def _effects_of(jobs: Jobs) -> tuple[tuple[int, str], ...]:
    """Key of the included effects with their shapes."""
    return tuple((id(t.effect), repr(t.shape)) for t in jobs.included)


def _same_kind(one: str, other: str) -> bool:
    """Whether values in two units can be converted into each other; unknown units can."""
    try:
        return to_si(one)[1] == to_si(other)[1]
    except InvalidParameter:
        return True


def _per_second(unit: str) -> str:
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s"
