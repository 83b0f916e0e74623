"""A model from a right-hand side in Python, traced and integrated for all jobs together."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.data.smoothing import noise_of_record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.fit.couplings import STEP, Found, Slopes, Values, couplings_in
from unmodeled.fit.noise import Noise
from unmodeled.fit.priors import (
    Bounds,
    Priors,
    Unknowns,
    in_si,
    sized,
    stated,
)
from unmodeled.models.coordinates import (
    Coordinate,
    Coupling,
    Named,
    Rate,
    force_unit,
    has_si_forces,
    values_of,
)
from unmodeled.models.model import (
    BETWEEN,
    INTERPOLATION,
    Batch,
    Candidate,
    Effect,
    Jobs,
    Model,
    Parameter,
    Port,
    Ready,
    Sensitivity,
    SensitivityRequest,
    State,
    prior_jobs,
    start_in,
    twice,
)
from unmodeled.ode.batch import LONGEST, RECORDS, doubts, sensitivities, simulated
from unmodeled.ode.plain import along
from unmodeled.ode.tape import NotTraceable, Traced
from unmodeled.ode.traces import Key, System, Traces, Untrue, arguments, own_trace, untraced
from unmodeled.units import same_unit, to_si

#: What an output is: a state by its name, its rate, or a function.
Output = str | Rate | Callable[[Any, Named, Named, Named], Any]


@checked
class Equations(Model):
    """States with rates dx/dt = f(t, x, u, p), as a function of arrays.

    Parameters
    ----------
    rates
        ``rates(t, x, u, p)`` returns the rates in the order of the states. It is traced: called
        with symbols as ``x.q``, ``u.force``, ``p.mass``, on which operators and the functions of
        NumPy for numbers work. If it cannot be traced, it is called with arrays of all jobs, (B,),
        or with numbers, which takes longer and is told.
    states
        Name -> unit, or ``(start, sd of the start, unit)``; with the unit alone, the start is
        unknown. Or a list of :class:`State`. The rates get a state in this unit.
    parameters, unknown, bounds
        As for :class:`Simulator`: of units that are not SI, those of the states, and products of
        them, stay, as do those of inputs and outputs. The names of states, inputs and parameters
        must differ.
    outputs
        Name -> name of a state; or ``Rate("v")``, the rate of a state including effects; or a
        function ``(t, x, u, p) -> (B,)``, which gets the states of the model without effects; with
        its unit, ``(voltage, "V")``, files in other units are converted to it.
        Default: every state by its name.
    inputs
        Names of the inputs that the rates use; a record must contain them. With their units, as
        ``{"valve": "%"}``, files in other units are converted to these. Default: those that the
        rates read in a trial.
    coordinates
        Coordinates of a mechanical system, and couplings between them; each is also a port for
        unknown forces. Default: every state whose rate is another state, and every other state in
        m/s, rad/s, mm/s or deg/s, which is a speed without a position; the inertia is the parameter
        in kg or kg m^2 that divides all forces. And a coupling between each two of them whose
        rates show a force that acts on both.
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
        spline, it has a parameter ``between.INPUT``, 0: linear, 1: spline; of an input that mostly
        repeats its last sample, 1: constant.

    Examples
    --------
    A mass on a spring, 2 kg and 40 N/m, which are known to 5 %:

    >>> from unmodeled import Equations
    >>> def rates(t, x, u, p):
    ...     return x.v, (u.force - p.k * x.x) / p.m
    >>> model = Equations(
    ...     rates,
    ...     states={"x": "m", "v": "m/s"},
    ...     parameters={"m": (2.0, 0.1, "kg"), "k": (40.0, 2.0, "N/m")},
    ... )
    >>> [(p.name, p.value, p.unit) for p in model.parameters]
    [('m', 2.0, 'kg'), ('k', 40.0, 'N/m')]
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
        outputs: Mapping[str, Output | tuple[Output, str]] | None = None,
        bounds: Bounds = None,
        coordinates: Sequence[Coordinate | Coupling] | None = None,
        ports: Mapping[str, str] | None = None,
        method: Literal["rk4", "rosenbrock"] = "rk4",
        substeps: int | None = None,
        hold: Literal["auto", "linear", "zero", "spline"] = "auto",
        name: str = "model",
    ):
        self.name = name
        self._states = states_of(states)
        pairs = {n: of[1] for n, of in (outputs or {}).items() if isinstance(of, tuple)}
        channels = {**(inputs if isinstance(inputs, Mapping) else {}), **pairs}
        kept = [s.unit for s in self._states]
        given = stated(rates, parameters, unknown, bounds, name, channels, kept)
        self.parameters, neutral, self._unsized = given.parameters, given.neutral, given.unsized
        self.converted = given.converted
        self._converted = given.notes
        self._function, self._rates = rates, with_unknown(rates, neutral)
        self.effects = tuple(by_rates(rates, e, neutral) for e in given.effects)
        self._unscaled = isinstance(states, Mapping)
        found = trial(self._rates, self._states, self.parameters, inputs)
        if outputs is None:
            outputs = {s.name: s.name for s in self._states}
        self.outputs = tuple(outputs)
        self.inputs = tuple(found.inputs if inputs is None else inputs)
        self._inferred = coordinates is None
        self._coupled = found.coupled
        self.coordinates = tuple(found.places if coordinates is None else coordinates)
        if self._inferred and self._unscaled and ports is None:
            ports = self._states_without_place()
        self.substeps = substeps
        self.hold: Literal["auto", "linear", "zero", "spline", "other", "between"] = hold
        self.method = method
        self._resolved = False
        self._outputs: dict[str, Output] = {
            n: of[0] if isinstance(of, tuple) else of for n, of in outputs.items()
        }
        self._unknown = tuple(neutral)
        self.units = _units_of(self._outputs, self._states)
        self.units |= given.units
        self._port_states = dict(ports or {})
        self._make_ports()
        self._check()
        #: What is traced of the functions; copies with other values share it.
        self._traces = Traces()

    def _states_without_place(self) -> dict[str, str]:
        """States that belong to no coordinate, as ports."""
        own = {n for c in self.coordinates for n in (c.position, c.speed)}
        return {s.name: s.name for s in self._states if s.name not in own}

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
        faults = [*self._faults_of_names(), *self._faults_of_coordinates()]
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

    def _faults_of_names(self) -> Iterator[str]:
        """Names that are used twice, or that are no states."""
        names = [s.name for s in self._states]
        everything = [*names, *(p.name for p in self.parameters), *self._unknown, *self.inputs]
        yield from (f"{n!r} is used twice" for n in twice(everything))
        ports = twice([p.name for p in self.ports])
        yield from (f"{n!r} names two coordinates or ports" for n in ports)
        for what, state in self._states_of_parts():
            if state not in names:
                yield f"{what}: {state!r} is no state; known are {', '.join(names)}"

    def _states_of_parts(self) -> Iterator[tuple[str, str]]:
        """Parts of the model in words, and the states that they name."""
        for name, of in self._outputs.items():
            if isinstance(of, str | Rate):
                yield f"output {name}", of.state if isinstance(of, Rate) else of
        for c in self.coordinates:
            used = (n for part in c.parts for n in (part.position, part.speed) if n)
            yield from ((f"coordinate {c.name}", n) for n in used)
        yield from ((f"port {port}", state) for port, state in self._port_states.items())

    def _faults_of_coordinates(self) -> Iterator[str]:
        """Inertias, units and ends of coordinates and couplings that do not fit the model."""
        own = [p.name for p in self.parameters]
        units = {s.name: s.unit for s in self._states}
        for part in (part for c in self.coordinates for part in c.parts):
            unit = units.get(part.position, "1")
            if isinstance(part.inertia, str) and part.inertia not in own:
                yield (
                    f"coordinate {part.name}: inertia {part.inertia!r} is no parameter; known are "
                    f"{', '.join(own) or 'none'}"
                )
            if unit != "1" and not _same_kind(unit, part.travel_unit):
                yield (
                    f"coordinate {part.name}: its position {part.position} has the unit {unit}, "
                    f"but a force in {part.unit} moves it in {part.travel_unit}: expected the unit "
                    f"of the force (unit='N m' for a torque), or position_unit={unit!r}"
                )
        for c in self.coordinates:
            if isinstance(c, Coupling) and c.first.speed == c.second.speed:
                yield f"coupling {c.name}: lies between {c.first.name} and itself"

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """States, followed by the hidden states of the included effects."""
        return self._states + tuple(h for t in included for h in t.effect.hidden)

    def tabulated(self) -> Equations:
        """See :class:`~unmodeled.fit.Model`."""
        out = copy.copy(self)
        out._unsized = frozenset()
        return out

    def ready(self, records: Sequence[Record]) -> Ready:
        """Choose the substeps and the interpolation of the inputs for the records."""
        if self._resolved:
            return Ready(self, tuple(records))
        self._check_rates(records)
        in_si(self, self._function, records)
        self._traces.points = None  # those of all records
        try:
            self._check_inputs(records)
            out, notes = resolved(self._scaled(records), records)
            notes += untraced(out._system, out._traces)
            out.effects, sizes = sized(out, out.effects, self._unsized, records)
        except Untrue:
            raise
        except Error:  # the first simulation of the user reports it better
            return Ready(self, tuple(records))
        out._resolved = True
        notes += [*self._converted, *sizes]
        notes += self._inferred * list(self._about_coordinates())
        parts = {part.name: part for c in self.coordinates for part in c.parts}
        notes += [text for part in parts.values() if (text := part.without_inertia)]
        return Ready(out, tuple(records), tuple(notes))

    def _about_coordinates(self) -> Iterator[str]:
        """Notes about the coordinates and couplings that were found in the rates."""
        listed = [
            f"{c.name} ({f'speed {c.speed}' if c.position else 'no position'}, "
            f"inertia {c.inertia or 'none'})"
            for c in self.coordinates
            if isinstance(c, Coordinate)
        ]
        coupled = [
            f"{c.name} (ratio {c.ratio:g}{f', sizes at {c.first.name}' * (abs(c.ratio) != 1.0)}"
            f"{', assumed' * (c.name in self._coupled.assumed)}, "
            f"inertias {c.first.inertia or 1} and {c.second.inertia}"
            f"{' times as large' * (c.first.inertia is None)})"
            for c in self.coordinates
            if isinstance(c, Coupling)
        ]
        if listed:
            yield f"coordinates, from the rates: {', '.join(listed)}"
        if coupled:
            yield f"couplings, from the rates: {', '.join(coupled)}"
        if untold := self._coupled.untold:
            yield (
                f"the rates do not tell the ratio of the coupling {', '.join(untold)}: what acts "
                "there is tested where coordinates= has a Coupling"
            )
        elif len(listed) > 1 and not coupled:
            yield (
                "no force couples the coordinates; what acts between two of them is tested where "
                "coordinates= has a Coupling"
            )

    def _check_rates(self, records: Sequence[Record]) -> None:
        """Refuse rates that are NaN where every record begins, with the tabulated parameters."""
        fault = ""
        for record in records:
            x = {s.name: np.float64(start_in(s, record)[0]) for s in self._states}
            p = {q.name: np.float64(q.value) for q in self.parameters}
            try:
                u = {n: np.float64(record.inputs[n][0]) for n in self.inputs}
                with np.errstate(all="ignore"):
                    rates = tuple(self._rates(record.time[0], Named(x), Named(u), Named(p)))
                bad = [n for n, v in zip(x, rates, strict=True) if not np.isfinite(v)]
            except (Exception, NotTraceable):  # a simulation reports it
                return
            if not bad:
                return
            at = ", ".join(f"{k} = {v:g}" for k, v in {**x, **u, **p}.items())
            fault = fault or f"{', '.join(bad)} at t = {record.time[0]:g} s and {at}"
        if fault:
            raise InvalidParameter(
                f"model {self.name}: it gives no finite outputs: its rate of {fault}, where record "
                f"{records[0].name} begins, is no finite number, expected one. If a state has no "
                "meaning at zero, give its start: states={'h': (1.0, 0.1, 'm')}"
            )

    def _scaled(self, records: Sequence[Record]) -> Equations:
        """Copy with scales from the records where the short forms state none."""
        if not self._unscaled:
            return self
        out = copy.copy(self)
        paths = [self.motion(*batch)[0] for batch in ((r, prior_jobs(self, r)) for r in records)]
        shown = {v: k for k, v in self._outputs.items() if isinstance(v, str)}

        def scale(state: State, paths: Sequence[Array]) -> float:
            """Largest spread of a state in the records: measured, or else simulated."""
            name = shown.get(state.name)
            seen = [r.outputs[name] for r in records if name and name in r.outputs] or paths
            spread = [float(np.nanstd(v)) for v in seen if np.isfinite(v).any()]
            return max(spread, default=0.0) or 1.0

        out._states = tuple(
            replace(s, scale=scale(s, [path[:, i] for path in paths]))
            for i, s in enumerate(self._states)
        )
        if self._inferred:
            out.coordinates = tuple(
                replace(c, scale=self._push(c, records, paths)) for c in self.coordinates
            )
        out._make_ports()
        return out

    def _push(
        self, place: Coordinate | Coupling, records: Sequence[Record], paths: Sequence[Array]
    ) -> float:
        """Typical force on a coordinate, its inertia times its acceleration, or in a coupling."""
        names = [s.name for s in self._states]
        inertia = {p.name: abs(p.value) for p in self.parameters}

        def size(record: Record, path: Array) -> float:
            if isinstance(place, Coupling):
                x = Named(dict(zip(names, path.T, strict=True)))
                return float(np.std(self.force_in(place, record, x)))
            rate = np.gradient(path[:, names.index(place.speed)], record.time)
            return inertia.get(str(place.inertia), 1.0) * float(np.std(rate))

        force = max(size(*of) for of in zip(records, paths, strict=True))
        return force if 0.0 < force < np.inf else 1.0

    def force_in(self, coupling: Coupling, record: Record, x: Named) -> Array:
        """Force that the tabulated model has in a coupling along a path, (n,).

        It is what is missing in the acceleration of the first coordinate where the second one is
        moved to it.

        Parameters
        ----------
        coupling
            Coupling of two coordinates of the model.
        record
            Record whose inputs act.
        x
            States along the record by name, each (n,).
        """
        first, second = coupling.parts
        (q, v), states = first.motion(x), dict(values_of(x))
        states[second.speed] = v / coupling.ratio
        if coupling.position:
            states[coupling.position] = 0.0 * v
        elif second.position:
            states[second.position] = q / coupling.ratio
        with np.errstate(all="ignore"):
            pushed = first.push(np.float64(1.0), *arguments(self._given(record, x)))[first.speed]
            there, moved = (
                self._along(record, values)[first.speed] for values in (x, Named(states))
            )
            return np.asarray((there - moved) / pushed)

    def drive_of(self, place: Coordinate) -> Callable[..., Any] | None:
        """Force that the inputs cause on a coordinate, of (t, x, u, p): the torque of a motor.

        It is the sum of the terms of its acceleration that depend on inputs; None: there are none,
        or the rates cannot be traced.
        """
        traced = own_trace(self._system, self._traces)
        if not isinstance(traced, Traced):
            return None
        tape, rate = traced.tape, traced.values["rate", place.speed]
        node = tape.terms_with(rate, {("u", n) for n in self.inputs})

        def force(t: Any, x: Named, u: Named, p: Named) -> Any:
            named = (("x", x), ("u", u), ("p", p))
            at = {(k, n): v for k, of in named for n, v in values_of(of).items()} | {("t",): t}
            pushed = place.push(1.0, t, x, u, p)[place.speed]
            return tape.evaluated([node], at)[node] / pushed

        return None if node == tape.zero else force

    def is_parameter(self, effect: Effect, record: Record, x: Named) -> bool:
        """Whether an effect acts along a path as a change of a parameter with a tolerance does.

        The rates change in proportion: a linear spring beside one whose stiffness is a parameter.

        Parameters
        ----------
        effect
            Effect with a rate.
        record
            Record whose inputs act.
        x
            States along the record by name, each (n,).
        """
        if effect.rate is None or effect.hidden or effect.shapes != (None,):
            return False
        at = {**self._given(record, x), ("size",): 1.0}
        change = along(self._system, self._traces, at, record.samples, effect)
        none = np.zeros(record.samples)
        own = np.stack([change.get(("rate", s.name), none) for s in self._states])
        if not own.any():
            return False
        for q in (q for q in self.parameters if q.sd > 0.0 and not q.name.startswith(BETWEEN)):
            step = STEP * (abs(q.value) or q.size)
            ends = [self._along(record, x, {q.name: q.value + s}) for s in (step, -step)]
            slope = np.stack([ends[0][s.name] - ends[1][s.name] for s in self._states])
            share = np.vdot(own, slope) / np.vdot(own, own)
            if slope.any() and np.linalg.norm(slope - share * own) <= STEP * np.linalg.norm(slope):
                return True
        return False

    def _given(
        self, record: Record, x: Named, changed: Mapping[str, float] | None = None
    ) -> dict[Key, Any]:
        """States, inputs of a record, and tabulated parameters but for those that are changed."""
        p = {q.name: q.value for q in self.parameters if not q.name.startswith(BETWEEN)}
        named = (
            ("x", values_of(x)),
            ("u", {n: record.inputs[n] for n in self.inputs}),
            ("p", p | dict(changed or {})),
        )
        return {("t",): record.time} | {(k, n): v for k, of in named for n, v in of.items()}

    def _along(
        self, record: Record, x: Named, changed: Mapping[str, float] | None = None
    ) -> dict[str, Array]:
        """Rates by state along a path."""
        at = self._given(record, x, changed)
        found = along(self._system, self._traces, at, record.samples)
        return {s.name: found["rate", s.name] for s in self._states}

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has a ``rate``, or is a sensor or input effect."""
        return effect.rate is not None or super().accepts(effect)

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~unmodeled.fit.Model`."""
        return self._simulated([(record, jobs)])[0]

    def simulate_all(self, batches: Sequence[Batch]) -> list[Array]:
        """Simulate batches; jobs with the same included effects are integrated together."""
        if type(self).simulate is not Equations.simulate:  # a subclass overrides ``simulate``
            return super().simulate_all(batches)
        return self._simulated(batches)

    def motion(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~unmodeled.fit.Model`."""
        self._check_batches([(record, jobs)])
        with np.errstate(all="ignore"):
            return simulated(self._system, self._traces, [(record, jobs)])[0][1]

    def doubts(self, batches: Sequence[Batch]) -> tuple[str, ...]:
        """See :class:`~unmodeled.fit.Model`."""
        with np.errstate(all="ignore"):
            return doubts(self._system, self._traces, batches)

    def sensitivities(self, requests: Sequence[SensitivityRequest]) -> list[Sensitivity]:
        """Derivatives along the tape of the rates, or by differences if the rates jump."""
        for request in requests:
            request.check(self)
        own = (Equations.simulate, Equations.simulate_all)
        if (type(self).simulate, type(self).simulate_all) != own:  # a subclass overrides them
            return super().sensitivities(requests)
        self._check_inputs([r.record for r in requests])
        with np.errstate(all="ignore"):
            return sensitivities(self, self._system, self._traces, requests)

    def _simulated(self, batches: Sequence[Batch]) -> list[Array]:
        self._check_batches(batches)
        with np.errstate(all="ignore"):
            return [y for y, _ in simulated(self._system, self._traces, batches)]

    def forces_in(self, unit: str) -> dict[str, Callable[..., Any]]:
        """Outputs that are functions with the unit of a force, such as the torque of a motor."""
        return {
            n: of
            for n, of in self._outputs.items()
            if not isinstance(of, str | Rate) and same_unit(self.units.get(n) or "1", unit)
        }

    @property
    def _system(self) -> System:
        """What is integrated."""
        coordinates = {c.name: c for c in self.coordinates}

        def push(port: str) -> Callable[..., Mapping[str, Any]]:
            if port in coordinates:
                return coordinates[port].push
            return lambda force, *_: {self._port_states[port]: force}

        return System(
            self.name,
            self._states,
            self._rates,
            self._outputs,
            self.inputs,
            tuple(p.name for p in self.parameters),
            {port.name: push(port.name) for port in self.ports},
            self.hold,
            self.method,
            self.substeps or 1,
        )


def _units_of(outputs: Mapping[str, Any], states: Sequence[State]) -> dict[str, str]:
    """Units of the outputs that are states, or rates of states."""
    units = {s.name: s.unit for s in states}
    found = {}
    for name, of in outputs.items():
        if isinstance(of, str) and of in units:
            found[name] = units[of]
        elif isinstance(of, Rate) and units.get(of.state, "1") != "1":
            found[name] = _per_second(units[of.state])
    return found


def _same_kind(one: str, other: str) -> bool:
    """Whether values in two units can be converted into each other; unknown units can."""
    try:
        return to_si(one)[1] == to_si(other)[1]
    except InvalidParameter:
        return True


def _per_second(unit: str) -> str:
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s"


# --------------------------------------------------------------------------- steps between samples


#: Noncentrality below which steps are small enough; above it, specified ones cause a warning, and
#: the interpolation of an input is estimated.
FINE = 1.0
#: Smallest estimated noise of a channel, as a share of its motion [1].
LEAST_NOISE = 1e-3
#: Largest number of substeps.
MOST = 16


def resolved(model: Equations, records: Sequence[Record]) -> tuple[Equations, list[str]]:
    """A copy with sufficient substeps; the interpolation of inputs is estimated if detectable.

    Also returns notes for the report.
    """
    out = copy.copy(model)
    notes: list[str] = []
    seen = [_part(r) for r in records[:RECORDS] if all(n in r.inputs for n in model.inputs)]
    more = sum(r.samples for r in records) / max(1, sum(r.samples for r in seen))

    def difference_in_noise(one: Equations, other: Equations) -> float:
        jobs = [(r, prior_jobs(other, r)) for r in seen]
        return float(np.sqrt(more * _noise_distance(one, other, jobs)))

    if model.substeps is None:
        out.substeps, noisy = _substeps(out, 1, difference_in_noise)
        advice = "method='rosenbrock' suits stiff systems"
    else:
        noisy = difference_in_noise(out, _with_substeps(out, 2 * model.substeps))
        advice = "increase them, or use None to choose them automatically"
    if noisy > FINE:
        notes.append(
            f"model {model.name}: substeps = {out.substeps}: half the step changes the outputs by "
            f"{noisy:.3g} times their noise, which can look like an effect; {advice}"
        )
    if model.hold == "auto":
        straight, smooth = copy.copy(out), copy.copy(out)
        straight.hold, smooth.hold = "linear", "other"
        out.hold = "linear"
        if model.inputs and difference_in_noise(straight, smooth) > FINE:
            out.hold = "between"
            out.parameters = model.parameters + tuple(
                Parameter(
                    name=f"{BETWEEN}{n}",
                    value=0.5,
                    sd=0.5,
                    lower=-1.0,
                    upper=2.0,
                    component=INTERPOLATION,
                    label=f"interpolation of {n} between samples",
                )
                for n in model.inputs
            )
    return out, notes


def _part(record: Record) -> Record:
    return record if record.samples <= LONGEST else record.cut(0, LONGEST)


def _with_substeps(model: Equations, substeps: int) -> Equations:
    out = copy.copy(model)
    out.substeps = substeps
    return out


def _substeps(
    model: Equations,
    substeps: int,
    difference_in_noise: Callable[[Equations, Equations], float],
) -> tuple[int, float]:
    """Smallest doubled number of substeps whose error is not detectable, and the error."""
    while True:
        noisy = difference_in_noise(
            _with_substeps(model, substeps), _with_substeps(model, 2 * substeps)
        )
        if noisy <= FINE or substeps >= MOST:
            return substeps, noisy
        substeps *= 2


def _estimated_noise(values: Array) -> float:
    """Noise of a channel from its values: at least a small share of its motion."""
    known = values[np.isfinite(values)]
    return max(noise_of_record(known), LEAST_NOISE * float(np.std(known))) if known.size else 0.0


def _noise_distance(one: Model, other: Model, batches: Sequence[Batch]) -> float:
    """Sum of squares of the difference of two models in noise; infinite if one of them fails.

    Noise that is not stated is estimated from the record.
    """
    total = 0.0
    runs = zip(batches, one.simulate_all(batches), other.simulate_all(batches), strict=True)
    for (record, _), a, b in runs:
        for c, name in enumerate(one.outputs):
            sensor = record.sensors.get(name)
            if name not in record.outputs or sensor is None:
                continue
            if sigma := sensor.sigma or _estimated_noise(record.outputs[name]):
                y, z = a[0, :, c], b[0, :, c]
                with np.errstate(over="ignore", invalid="ignore"):
                    noise = Noise(sigma, relative=sensor.relative_sigma)
                    part = (y - z) / noise.sd(y)
                    part[~np.isfinite(y) & ~np.isfinite(z)] = 0.0  # both simulations fail
                    total += float(np.sum(np.where(np.isfinite(part), part, np.inf) ** 2))
    return total


# ------------------------------------------------------------------------------------- short forms


Rates = Callable[[Any, Named, Named, Named], Any]
#: Number of random points of a trial.
POINTS = 4


def states_of(given: Sequence[State] | Mapping[str, Any]) -> tuple[State, ...]:
    """States from units by name, or from ``(start, sd of the start, unit)``.

    Raises
    ------
    InvalidParameter
        A state has another form.
    """
    if not isinstance(given, Mapping):
        return tuple(given)
    found = []
    for name, item in given.items():
        parts = (0.0, math.inf, item) if isinstance(item, str) else item
        try:
            start, sd, unit = parts
            found.append(State(name=name, unit=unit, start=float(start), start_sd=float(sd)))
        except (TypeError, ValueError, InvalidParameter):
            raise InvalidParameter(
                f"state {name}: got {item!r}, expected its unit, such as 'm', or (start, standard "
                "deviation of the start, unit)"
            ) from None
    return tuple(found)


def with_unknown(rates: Rates, neutral: Mapping[str, float]) -> Rates:
    """The rates with the unknown effects at the values without them."""
    if not neutral:
        return rates
    return lambda t, x, u, p: rates(t, x, u, Named({**values_of(p), **neutral}))


def by_rates(rates: Rates, effect: Effect, neutral: Mapping[str, float]) -> Effect:
    """An effect that is a parameter of the rates: it adds their difference."""
    name = effect.data

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Any]:
        del shape
        values = {**values_of(p), **neutral}
        without = rates(t, x, u, Named(values))
        values[name] = neutral[name] + size
        own = rates(t, x, u, Named(values))
        return {s: b - a for s, a, b in zip(values_of(x), without, own, strict=False)}

    return replace(effect, rate=rate)


class _Read(Named):
    """Inputs of a trial: any name has random values, and is noted."""

    __slots__ = ("_draw", "place")

    def __init__(self, draw: Callable[[], Array]):
        self._values: dict[str, Any] = {}
        self._draw = draw
        self.place = 0
        """Point whose values are read."""

    def __getitem__(self, name: str) -> Any:
        return self._values.setdefault(name, self._draw())[self.place]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self[name]


@dataclass(frozen=True)
class Trial:
    """What the rates are found to be at random points."""

    inputs: tuple[str, ...] = ()
    coordinates: tuple[Coordinate, ...] = ()
    coupled: Found = field(default_factory=Found)

    @property
    def places(self) -> tuple[Coordinate | Coupling, ...]:
        """Coordinates and couplings."""
        return (*self.coordinates, *self.coupled.couplings)


class _Points:
    """Rates at random points of states, inputs and parameters."""

    def __init__(
        self,
        rates: Rates,
        states: Sequence[State],
        parameters: Sequence[Parameter],
        inputs: Iterable[str] | None,
    ):
        random = np.random.default_rng(0)

        def draw() -> Array:
            return random.uniform(0.5, 1.5, POINTS)

        self.rates, self.names = rates, [s.name for s in states]
        self.x = {s.name: s.start + s.scale * draw() for s in states}
        self.p = {q.name: q.value * (1.0 + 0.02 * (draw() - 1.0)) for q in parameters}
        self.u = _Read(draw)
        if inputs is not None:
            self.u._values.update({n: draw() for n in inputs})

    def at(self, x: Values, p: Values) -> Values:
        """Rates at all points, by state."""
        rows = []
        with np.errstate(all="ignore"):
            for self.u.place in range(POINTS):
                named = (Named({n: v[self.u.place] for n, v in of.items()}) for of in (x, p))
                found = self.rates(np.float64(0.0), next(named), self.u, next(named))
                rows.append([float(v) for v in found])
        return dict(zip(self.names, np.array(rows).T, strict=True))


def trial(
    rates: Rates,
    states: Sequence[State],
    parameters: Sequence[Parameter],
    inputs: Iterable[str] | None,
) -> Trial:
    """Evaluate the rates at random points; rates that fail there tell nothing.

    ``inputs``: their names; None: all that the rates read.
    """
    points = _Points(rates, states, parameters, inputs)
    masses = {q.name: q.unit for q in parameters if _massive(q)}
    x, p = points.x, points.p
    try:
        base = points.at(x, p)
        heavy = {m: points.at(x, {**p, m: 2.0 * p[m]}) for m in masses}
    except (Exception, NotTraceable):  # it needs other values; a simulation tells
        return Trial(tuple(values_of(points.u)))

    found = _coordinates(states, x, base, heavy)
    try:
        tabulated = Slopes(points.at, x, {q.name: np.full(POINTS, q.value) for q in parameters})
        coupled = couplings_in(found, tabulated, Slopes(points.at, x, p), masses)
    except (Exception, NotTraceable):  # as above
        coupled = Found()
    return Trial(tuple(values_of(points.u)), tuple(found), coupled)


def _coordinates(
    states: Sequence[State], x: Values, base: Values, heavy: Mapping[str, Values]
) -> list[Coordinate]:
    """States whose rate is another state, and other speeds; a mass that is doubled halves rates."""

    def coordinate(position: State | None, speed: State) -> Coordinate:
        rate = base[speed.name]
        halved = [
            m
            for m, other in heavy.items()
            if np.allclose(2.0 * other[speed.name], rate, atol=0.0) and rate.any()
        ]
        return _coordinate(position, speed, halved)

    found = []
    for q in states:
        speeds = [v for v in states if v is not q and np.array_equal(base[q.name], x[v.name])]
        found += [coordinate(q, v) for v in speeds if len(speeds) == 1]
    used = {n for c in found for n in (c.position, c.speed)}
    free = [v for v in states if v.name not in used and _travel_unit(v.unit)]
    return [*found, *(coordinate(None, v) for v in free)]


def _massive(parameter: Parameter) -> bool:
    return any(same_unit(parameter.unit, unit) for unit in ("kg", "kg m^2"))


def _travel_unit(speed: str) -> str:
    """Unit of the travel of a speed in m/s, mm/s, rad/s or deg/s; "" if it is no such speed."""
    unit, _, per = speed.rpartition("/")
    return unit if per == "s" and any(_same_kind(unit, of) for of in ("m", "rad")) else ""


def _coordinate(position: State | None, speed: State, inertias: Sequence[str]) -> Coordinate:
    """Coordinate of two states, or of a speed; with one inertia, forces on it are forces."""
    unit = position.unit if position else _travel_unit(speed.unit)
    inertia = inertias[0] if len(inertias) == 1 and has_si_forces(unit) else None
    return Coordinate(
        name=(position or speed).name,
        position=position.name if position else "",
        speed=speed.name,
        inertia=inertia,
        unit=force_unit(unit, inertia),
        position_unit=unit,
    )
