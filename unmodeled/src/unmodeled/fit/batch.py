"""Simulations of equations, and their derivatives, for all jobs of all records together.

Rates, outputs and effects are traced once (:mod:`unmodeled.fit.tape`). The jobs of one kind, which
have the same effects and the same variables of differentiation, are one program
(:mod:`unmodeled.fit.program`) and are integrated together (:mod:`unmodeled.fit.step`). What cannot
be traced runs as functions of Python.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.fit.calling import calling, explained
from unmodeled.fit.coordinates import Named, Rate
from unmodeled.fit.model import (
    BETWEEN,
    Batch,
    Candidate,
    Effect,
    Jobs,
    Model,
    Sensitivity,
    SensitivityRequest,
    State,
    changed_jobs,
    difference_offsets,
    difference_sensitivities,
    reshaped,
    sensitivity_of,
)
from unmodeled.fit.program import Assembly, Program
from unmodeled.fit.step import METHODS, Lanes, Runs, plain, run
from unmodeled.fit.tape import NotTraceable, Symbol, Tape, Target, Traced

__all__ = ["System", "Traces", "sensitivities", "simulated", "untraced"]

#: Largest difference between a simulated change and its prediction, relative to the change.
SMALL = 0.1
#: Numbers of results that are computed at once.
BLOCK = 20_000_000

Key = tuple[Any, ...]
Push = Callable[[Any, Any, Named, Named, Named], Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class System:
    """What the integration needs of a model of equations."""

    name: str
    states: tuple[State, ...]
    rates: Callable[[Any, Named, Named, Named], Any]
    outputs: Mapping[str, str | Rate | Callable[[Any, Named, Named, Named], Any]]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    ports: Mapping[str, Push]
    """Rates of states that an unknown force at a port causes."""
    hold: str
    method: str
    substeps: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(s.name for s in self.states)

    def all_states(self, included: Sequence[Candidate]) -> tuple[State, ...]:
        """States, followed by the hidden states of effects."""
        return self.states + tuple(h for t in included for h in t.effect.hidden)


@dataclass(frozen=True)
class Form:
    """An effect and the parts of its shape that are no floats: what its tape depends on."""

    effect: Effect
    text: str
    numbers: int
    """Number of floats of the shape, which are inputs of the tape."""


@dataclass(frozen=True)
class Kind:
    """What simulations have in common that are one program."""

    parameters: tuple[str, ...]
    between: bool
    implicit: bool
    included: tuple[Form, ...] = ()
    forces: bool = False
    derivatives: bool = False
    candidates: tuple[Form, ...] = ()
    by_theta: tuple[int, ...] = ()
    by_starts: bool = False
    changes: tuple[tuple[str, ...], ...] = ()
    """Inputs of each change of the inputs."""
    turned: tuple[int, ...] = ()
    """Effect of each change of a shape."""


@dataclass
class Traces:
    """What was traced of a system, and its programs; copies of a model share it."""

    effects: dict[tuple[Effect, str], Traced | NotTraceable] = field(default_factory=dict)
    programs: dict[Kind, Program] = field(default_factory=dict)
    own: Traced | NotTraceable | None = None
    ports: dict[str, Traced] = field(default_factory=dict)
    signals: WeakKeyDictionary[Record, dict[Any, Array]] = field(default_factory=WeakKeyDictionary)
    """Signals of records between their samples, as long as the records exist."""


# ------------------------------------------------------------------------------------- tracing


def untraced(system: System, traces: Traces, effects: Sequence[Effect] = ()) -> list[str]:
    """Sentences about functions that cannot be traced, with their lines."""
    found = [("its rates and outputs", _own(system, traces))]
    for effect in effects:
        if effect.rate is not None:
            form = _form(system, traces, Candidate(effect, effect.shapes[0]))
            found.append((f"effect {effect.name}", traces.effects[effect, form.text]))
    return [
        f"model {system.name}: {what} cannot be traced: {t}; they run as functions of Python, "
        "which takes longer"
        for what, t in found
        if isinstance(t, NotTraceable)
    ]


def _twice(of: Callable[[], Traced], what: str) -> Traced | NotTraceable:
    """The trace of a function; the reason if it cannot be traced.

    Raises
    ------
    InvalidParameter
        Two calls differ, or the values are of no use.
    """
    try:
        with np.errstate(all="ignore"):
            one, other = of(), of()
    except Error:
        raise
    except NotTraceable as error:
        return NotTraceable(explained(error).removeprefix("NotTraceable: "))
    except Exception as error:
        return NotTraceable(explained(error))
    if one.tape.nodes != other.tape.nodes or one.values != other.values:
        raise InvalidParameter(
            f"{what} differ between two equal calls: expected a function of its arguments alone, "
            "without random numbers, counters or other states of its own"
        )
    return one


def _own(system: System, traces: Traces) -> Traced | NotTraceable:
    """Trace of rates and outputs."""

    def trace() -> Traced:
        tape = Tape()
        t, x, u, p = _arguments(system, tape)
        named = [("rate", n) for n in system.names]
        nodes = tape.called(lambda: dict(zip(named, _rates(system, t, x, u, p), strict=True)))
        for name, of in system.outputs.items():
            if not isinstance(of, str | Rate):
                shown = functools.partial(of, t, x, u, p)
                nodes |= tape.called(lambda n=name, y=shown: {("output", n): y()})  # type: ignore[misc]
        return Traced.of(tape, nodes)

    if traces.own is None:
        traces.own = _twice(trace, f"model {system.name}: its rates or outputs")
    return traces.own


def _arguments(system: System, tape: Tape) -> tuple[Symbol, Named, Named, Named]:
    """Symbols of time, states, inputs and parameters."""

    def named(kind: str, names: Sequence[str]) -> Named:
        return Named._of({n: tape.input((kind, n)) for n in names})

    return (
        tape.input(("t",)),
        named("x", system.names),
        named("u", system.inputs),
        named("p", [n for n in system.parameters if not n.startswith(BETWEEN)]),
    )


def _form(system: System, traces: Traces, candidate: Candidate) -> Form:
    """Form of a candidate, whose effect is then traced."""
    effect, shape = candidate.effect, candidate.shape
    parts = shape if isinstance(shape, tuple) else (shape,)
    floats = [v for v in parts if isinstance(v, float)]
    free = repr(tuple("float" if isinstance(v, float) else v for v in parts))
    known = traces.effects.get((effect, free))
    if floats and not isinstance(known, NotTraceable):
        if known is None:
            known = traces.effects[effect, free] = _effect(system, candidate, symbols=True)
        if isinstance(known, Traced):
            return Form(effect, free, len(floats))
    text = repr(shape)
    if (effect, text) not in traces.effects:
        traces.effects[effect, text] = _effect(system, candidate, symbols=False)
    return Form(effect, text, 0)


def _floats(form: Form, shape: Any) -> list[float]:
    """Numbers of a shape that are inputs of the tape."""
    parts = shape if isinstance(shape, tuple) else (shape,)
    return [v for v in parts if isinstance(v, float)] if form.numbers else []


def _effect(system: System, candidate: Candidate, symbols: bool) -> Traced | NotTraceable:
    """Trace of the rate of an effect."""
    _check_names(system, candidate)

    def trace() -> Traced:
        tape, shape = Tape(), candidate.shape
        t, x, u, p = _arguments(system, tape)
        if symbols:
            parts = list(shape) if isinstance(shape, tuple) else [shape]
            places = [i for i, v in enumerate(parts) if isinstance(v, float)]
            for k, i in enumerate(places):
                parts[i] = tape.input(("shape", k))
            shape = tuple(parts) if isinstance(shape, tuple) else parts[0]
        hidden = {h.name: tape.input(("x", h.name)) for h in candidate.effect.hidden}
        seen = Named._of({**x._values, **hidden})
        size = tape.input(("size",))

        def changes() -> dict[Any, Any]:
            found = _changes(candidate, t, seen, u, p, size, shape)
            return {("rate", n): v for n, v in found.items()}

        return Traced.of(tape, tape.called(changes))

    return _twice(trace, f"effect {candidate.name}: its rates")


def _port(system: System, traces: Traces, name: str) -> Traced:
    """Trace of the rates that a force at a port causes."""
    if name not in traces.ports:
        tape = Tape()
        t, x, u, p = _arguments(system, tape)
        pushed = system.ports[name](tape.input(("force",)), t, x, u, p)
        nodes = {("rate", n): tape.of(v) for n, v in pushed.items()}
        traces.ports[name] = Traced.of(tape, nodes)
    return traces.ports[name]


# ----------------------------------------------------------------------------- calls of functions


def _rates(system: System, t: Any, x: Named, u: Named, p: Named) -> tuple[Any, ...]:
    """Rates of the model, one for each state."""
    found = tuple(system.rates(t, x, u, p))
    if len(found) != len(system.states):
        raise InvalidParameter(
            f"model {system.name}: rates returned {len(found)} values, expected one for "
            f"each state: {', '.join(system.names)}"
        )
    return found


def _changes(
    candidate: Candidate,
    t: Any,
    x: Named,
    u: Named,
    p: Named,
    size: Any,
    shape: Any,
) -> Mapping[str, Any]:
    """Changes of the rates by an effect, by name of the state."""
    effect: Any = candidate.effect
    change = effect.rate(t, x, u, p, size, shape)
    if not isinstance(change, Mapping):
        raise InvalidParameter(
            f"effect {effect.name}: rate returned {type(change).__name__}, expected a "
            "dictionary of rates by name of the state"
        )
    for name in change:
        if name not in x:
            raise InvalidParameter(
                f"effect {effect.name}: rate changes {name!r}, which is no state; known are "
                f"{', '.join(x._values)}"
            )
    return change


def _check_names(system: System, candidate: Candidate) -> None:
    """Refuse hidden states with the name of a state of the model."""
    taken = [h.name for h in candidate.effect.hidden if h.name in system.names]
    if taken:
        raise InvalidParameter(
            f"effect {candidate.name}: its hidden state {taken[0]!r} has the name "
            f"of a state of model {system.name}; rename one of them"
        )


# ---------------------------------------------------------------------------- programs of a kind


class _Builder:
    """Puts the program of a kind together."""

    def __init__(self, system: System, traces: Traces, kind: Kind):
        self.system, self.traces, self.kind = system, traces, kind
        base, forms = len(system.states), (*kind.included, *kind.candidates)
        hidden = [len(f.effect.hidden) for f in forms]
        self.smooth = base + sum(hidden[: len(kind.included)])
        self.blocks = (self.smooth, *hidden[len(kind.included) :])
        inputs, each = len(system.inputs), 2 if kind.between else 1
        signals = each * (inputs + sum(map(len, kind.changes)))
        constants = len(kind.parameters) + len(kind.included) + sum(f.numbers for f in forms)
        constants += sum(kind.included[k].numbers for k in kind.turned)
        ports = len(system.ports) if kind.forces else 0
        a = self.assembly = Assembly(sum(self.blocks), signals + ports, constants)
        jobs, waves = iter(a.jobs), iter(a.signals)
        self.p = {n: next(jobs) for n in kind.parameters}
        self.sizes = [next(jobs) for _ in kind.included]
        self.shapes = [[next(jobs) for _ in range(f.numbers)] for f in forms]
        self.turns = [[next(jobs) for _ in range(kind.included[k].numbers)] for k in kind.turned]
        self.bends: dict[str, int] = {}
        self.u = {n: self._held(n, waves, self.bends) for n in system.inputs}
        self.changes = [{n: self._held(n, waves, {}) for n in names} for names in kind.changes]
        self.forces = list(waves)
        first, self.rows = base, []
        for form in forms:
            names = [h.name for h in form.effect.hidden]
            self.rows.append({n: first + i for i, n in enumerate(names)})
            first += len(names)
        self.base_rows = {n: i for i, n in enumerate(system.names)}
        self.rate: list[list[int]] = [[] for _ in a.states]
        self.by_state: dict[tuple[int, int], list[int]] = {}
        self.by_column: dict[tuple[int, int], list[int]] = {}
        starts = self.smooth if kind.by_starts else 0
        self.by_size = len(kind.by_theta)
        self.by_candidate = self.by_size + len(kind.included) + starts
        self.by_change = self.by_candidate + len(kind.candidates)
        self.by_turn = self.by_change + len(kind.changes)
        columns = self.by_turn + len(kind.turned)
        self.columns = columns if kind.derivatives else 0

    def _held(self, name: str, waves: Iterator[int], bends: dict[str, int]) -> int:
        """Register of an input between samples."""
        straight = next(waves)
        if not self.kind.between:
            return straight
        bends[name] = next(waves)
        bent = self.assembly.add("multiply", self.p[BETWEEN + name], bends[name])
        return self.assembly.add("add", straight, bent)

    def program(self) -> Program:
        """The program."""
        own = _traced(_own(self.system, self.traces))
        at = self._registers({})
        self._use(own, at, self.base_rows, "rate", {})
        for k, form in enumerate(self.kind.included):
            self._include(k, form)
        for name, register in zip(self.system.ports, self.forces, strict=False):
            port = _port(self.system, self.traces, name)
            self._use(port, {**at, ("force",): register}, self.base_rows, "rate", {})
        for k, form in enumerate(self.kind.candidates):
            self._try(k, form)
        a = self.assembly
        rate = [a.total(r) if r else a.constant(0.0) for r in self.rate]
        output, by_state, by_column = self._outputs(own, at, rate)
        smooth = self.kind.derivatives or self.kind.implicit
        return a.program(
            rate,
            self.by_state if smooth else {},
            self.by_column,
            output,
            by_state,
            by_column,
            smooth=self.smooth,
            columns=self.columns,
            blocks=self.blocks,
        )

    def _registers(self, rows: Mapping[str, int]) -> dict[Key, int]:
        states = self.assembly.states
        at: dict[Key, int] = {("t",): 0}
        at |= {("x", n): states[i] for n, i in {**self.base_rows, **rows}.items()}
        at |= {("u", n): r for n, r in self.u.items()}
        return at | {("p", n): r for n, r in self.p.items()}

    def _columns(self) -> dict[Key, list[tuple[int, int | None]]]:
        """Columns of the inputs of all tapes, each with the register of a factor."""
        if not self.kind.derivatives:
            return {}
        out: dict[Key, list[tuple[int, int | None]]] = {}
        for column, i in enumerate(self.kind.by_theta):
            name = self.kind.parameters[i]
            if not name.startswith(BETWEEN):
                out.setdefault(("p", name), []).append((column, None))
            elif self.kind.between:
                own = name.removeprefix(BETWEEN)
                out.setdefault(("u", own), []).append((column, self.bends[own]))
        for column, changed in enumerate(self.changes, self.by_change):
            for name, register in changed.items():
                out.setdefault(("u", name), []).append((column, register))
        return out

    def _use(
        self,
        traced: Traced,
        at: Mapping[Key, int],
        rows: Mapping[str, int],
        what: str,
        further: Mapping[Key, list[tuple[int, int | None]]],
    ) -> dict[tuple[int, Any], int]:
        """Add the values of a tape to the rates, or return its outputs, with derivatives."""
        part = "rates" if what == "rate" else "shown"
        columns = {**self._columns(), **further}
        wanted: list[Target] = []
        derive = self.kind.derivatives or (self.kind.implicit and what == "rate")
        for target in traced.values:
            if target[0] == what:
                wanted.append((target, None))
                if derive:
                    wanted += [
                        (target, k) for k in traced.keys(target) if k[0] == "x" or k in columns
                    ]
        got = self.assembly.place(traced.fragment(wanted), at, part)
        values: dict[tuple[int, Any], int] = {}
        for ((_, name), key), register in got.items():
            row = rows[name]
            if key is None:
                values[row, None] = register
                if what == "rate":
                    self.rate[row].append(register)
            elif key[0] == "x":
                place = at[key] - 1
                values[row, ("x", place)] = register
                if what == "rate":
                    self.by_state.setdefault((row, place), []).append(register)
            for column, factor in columns.get(key, ()) if key is not None else ():
                own = register
                if factor is not None:
                    own = self.assembly.add("multiply", register, factor, part=part)
                values[row, ("column", column)] = own
                if what == "rate":
                    self.by_column.setdefault((row, column), []).append(own)
                else:
                    self.shown_columns.setdefault((row, column), []).append(own)
        return values

    def _include(self, k: int, form: Form) -> None:
        """Add an included effect."""
        at = self._registers(self.rows[k])
        at["size",] = self.sizes[k]
        at |= {("shape", m): r for m, r in enumerate(self.shapes[k])}
        further: dict[Key, list[tuple[int, int | None]]] = {}
        if self.kind.derivatives:
            further["size",] = [(self.by_size + k, None)]
            for c, (effect, turns) in enumerate(zip(self.kind.turned, self.turns, strict=True)):
                for m, register in enumerate(turns):
                    if effect == k:
                        own = further.setdefault(("shape", m), [])
                        own.append((self.by_turn + c, register))
        traced = _traced(self.traces.effects[form.effect, form.text])
        self._use(traced, at, {**self.base_rows, **self.rows[k]}, "rate", further)

    def _try(self, k: int, form: Form) -> None:
        """Add the derivative by the magnitude of a candidate at zero, and its hidden states."""
        place, a = len(self.kind.included) + k, self.assembly
        at = self._registers(self.rows[place])
        at |= {("shape", m): r for m, r in enumerate(self.shapes[place])}
        zero = {**at, ("size",): a.constant(0.0)}
        traced = _traced(self.traces.effects[form.effect, form.text])
        rows, column = self.rows[place], self.by_candidate + k
        hidden: list[Target] = [(t, None) for t in traced.values if t[1] in rows]
        if self.kind.implicit:
            hidden += [(t, i) for t, _ in hidden for i in traced.keys(t) if i[0] == "x"]
        pushed = [t for t in traced.values if t[1] in self.base_rows]
        by_size: list[Target] = [(t, ("size",)) for t in pushed]
        linear = not traced.depends(by_size, ("size",))
        got = a.place(traced.fragment([*hidden, *by_size] if linear else hidden), zero)
        for ((_, name), key), register in got.items():
            if key == ("size",):
                self.by_column.setdefault((self.base_rows[name], column), []).append(register)
            elif key is None:
                self.rate[rows[name]].append(register)
            else:
                self.by_state.setdefault((rows[name], zero[key] - 1), []).append(register)
        if linear:
            return
        effect = form.effect
        for size, weight in difference_offsets(0.0, effect.step * effect.scale, *effect.bounds):
            own = {**at, ("size",): a.constant(size)}
            got = a.place(traced.fragment([(t, None) for t in pushed]), own)
            for ((_, name), _), register in got.items():
                term = a.add("multiply", register, a.constant(weight))
                self.by_column.setdefault((self.base_rows[name], column), []).append(term)

    def _outputs(
        self, own: Traced, at: Mapping[Key, int], rate: Sequence[int]
    ) -> tuple[list[int], dict[tuple[int, int], list[int]], dict[tuple[int, int], list[int]]]:
        """Registers of the outputs, and their derivatives by states and columns."""
        places = {n: o for o, n in enumerate(self.system.outputs)}
        self.shown_columns: dict[tuple[int, int], list[int]] = {}
        by_state: dict[tuple[int, int], list[int]] = {}
        found = self._use(own, at, places, "output", {})
        out: list[int] = []
        one = self.assembly.constant(1.0)
        for o, of in enumerate(self.system.outputs.values()):
            if isinstance(of, str):
                i = self.base_rows[of]
                out.append(self.assembly.states[i])
                by_state[o, i] = [one]
            elif isinstance(of, Rate):
                i = self.base_rows[of.state]
                out.append(rate[i])
                if self.kind.derivatives:
                    rows = ((self.by_state, by_state), (self.by_column, self.shown_columns))
                    for entries, target in rows:
                        target |= {(o, k): r for (row, k), r in entries.items() if row == i}
            else:
                out.append(found[o, None])
        for (o, key), register in found.items():
            if key is not None and key[0] == "x":
                by_state.setdefault((o, key[1]), []).append(register)
        if not self.kind.derivatives:
            return out, {}, {}
        return out, by_state, self.shown_columns


def _traced(of: Traced | NotTraceable) -> Traced:
    if isinstance(of, NotTraceable):
        raise of
    return of


def _program(system: System, traces: Traces, kind: Kind) -> Program:
    if kind not in traces.programs:
        traces.programs[kind] = _Builder(system, traces, kind).program()
    return traces.programs[kind]


# -------------------------------------------------------------------------------------- signals


class _Tracks:
    """Times and signals of records, each of which is computed once."""

    def __init__(self, system: System, traces: Traces):
        self.system, self.known = system, traces.signals
        self.times: list[Array] = []
        self.signals: list[Array] = []
        self._places: dict[Record, int] = {}
        self.shares = np.arange(2 * system.substeps + 1) / (2 * system.substeps)

    def of(
        self,
        record: Record,
        changes: Sequence[Mapping[str, Array]] = (),
        forces: Array | None = None,
    ) -> int:
        """Place of the signals of a record, with changes of inputs or unknown forces."""
        further = [
            column
            for change in changes
            for n in self.names(change)
            for column in self.between(record, np.asarray(change[n]))
        ]
        if forces is not None:
            further += self._forces(record, forces)
        if not further and record in self._places:
            return self._places[record]
        system = self.system
        key = system.hold, system.substeps, system.inputs
        held = self.known.setdefault(record, {})
        if key not in held:
            held[key] = self._stacked(
                record,
                [v for n in system.inputs for v in self.between(record, record.inputs[n])],
            )
        own = held[key]
        if further:
            own = np.concatenate([own, self._stacked(record, further)], axis=-1)
        else:
            self._places[record] = len(self.times)
        self.times.append(np.ascontiguousarray(record.time, dtype=np.float64))
        self.signals.append(own)
        return len(self.times) - 1

    def _stacked(self, record: Record, columns: Sequence[Array]) -> Array:
        none = np.zeros((record.samples, self.shares.size, 0))
        return np.stack(columns, axis=-1) if columns else none

    def names(self, change: Mapping[str, Array]) -> tuple[str, ...]:
        """Inputs of the model that a change changes."""
        return tuple(n for n in self.system.inputs if n in change)

    def between(self, record: Record, values: Array) -> list[Array]:
        """A signal after each sample, (n, halves); its part by a spline apart if it is one."""
        hold, share = self.system.hold, self.shares
        following = np.append(values[1:], values[-1:])
        out = values[:, None] + 0.0 * share
        if hold != "zero":
            out += share * (following - values)[:, None]
        if hold not in ("spline", "between"):
            return [out]
        from scipy.interpolate import CubicSpline

        bends = np.asarray(CubicSpline(record.time, values)(record.time, 2))
        ahead, rest = np.append(bends[1:], bends[-1:]), 1.0 - share
        square = np.append(np.diff(record.time), 0.0)[:, None] ** 2 / 6.0
        bent = square * ((rest**3 - rest) * bends[:, None] + (share**3 - share) * ahead[:, None])
        return [out, bent] if hold == "between" else [out + bent]

    def _forces(self, record: Record, forces: Array) -> list[Array]:
        """Unknown forces, (ports, knots), after each sample."""
        step = np.append(np.diff(record.time), 0.0)
        elapsed = record.time[:, None] - record.time[0] + self.shares * step[:, None]
        span = record.time[-1] - record.time[0]
        place = np.clip(elapsed / span, 0.0, 1.0) * (forces.shape[1] - 1)
        left = np.minimum(place.astype(np.intp), forces.shape[1] - 2)
        share = place - left
        return [(1.0 - share) * f[left] + share * f[left + 1] for f in forces]

    def lanes(self, track: Sequence[int], constants: Any, starts: Any, seeds: Array) -> Lanes:
        """Lanes on tracks, with only those that they use."""
        used = sorted(set(track))
        return Lanes(
            np.array([used.index(i) for i in track], dtype=np.intp),
            [self.times[i] for i in used],
            [self.signals[i] for i in used],
            np.ascontiguousarray(constants, dtype=np.float64),
            np.ascontiguousarray(starts, dtype=np.float64),
            seeds,
        )


# ----------------------------------------------------------------------------------- simulations


def simulated(
    system: System, traces: Traces, batches: Sequence[Batch]
) -> list[tuple[Array, Array]]:
    """Outputs (B, n, ny) and states (B, n, nx) of jobs.

    Raises
    ------
    InvalidParameter
        A function of the model fails.
    """
    groups: dict[Any, list[int]] = {}
    for i, (_, jobs) in enumerate(batches):
        forms = tuple(_form(system, traces, t) for t in jobs.included)
        groups.setdefault((forms, jobs.forces is not None), []).append(i)
    found: dict[int, tuple[Array, Array]] = {}
    tracks = _Tracks(system, traces)
    for (forms, forces), group in groups.items():
        own = [batches[i] for i in group]
        if _reason(system, traces, forms) is None:
            kind = _kind(system, included=forms, forces=forces)
            runs = _run_jobs(system, traces, kind, own, tracks)
        else:
            runs = _plain(system, own, tracks)
        first = 0
        for i, (_, jobs) in zip(group, own, strict=True):
            rows = slice(first, first + jobs.count)
            found[i] = np.array(runs.outputs[rows]), np.array(runs.states[rows])
            first += jobs.count
    return [found[i] for i in range(len(batches))]


def _reason(system: System, traces: Traces, forms: Sequence[Form]) -> NotTraceable | None:
    """Why simulations with effects cannot be traced; None: they can."""
    for traced in (_own(system, traces), *(traces.effects[f.effect, f.text] for f in forms)):
        if isinstance(traced, NotTraceable):
            return traced
    return None


def _kind(system: System, **fields: Any) -> Kind:
    return Kind(
        system.parameters, system.hold == "between", system.method == "rosenbrock", **fields
    )


def _track_of(tracks: _Tracks, batch: Batch) -> list[int]:
    """Tracks of the jobs of a batch."""
    record, jobs = batch
    if jobs.forces is None:
        return [tracks.of(record)] * jobs.count
    return [tracks.of(record, forces=f) for f in jobs.forces]


def _starts_of(jobs: Jobs) -> Array:
    """Start states, (nx, B)."""
    return np.asarray(jobs.starts, dtype=np.float64).T


def _run_jobs(
    system: System, traces: Traces, kind: Kind, batches: Sequence[Batch], tracks: _Tracks
) -> Runs:
    program = _program(system, traces, kind)
    track = [i for b in batches for i in _track_of(tracks, b)]
    constants = []
    for _, jobs in batches:
        shapes = [_floats(f, t.shape) for f, t in zip(kind.included, jobs.included, strict=True)]
        numbers = np.array([v for s in shapes for v in s])
        sizes = jobs.magnitudes if jobs.included else np.zeros((jobs.count, 0))
        constants.append(np.hstack([jobs.theta, sizes, np.tile(numbers, (jobs.count, 1))]))
    lanes = tracks.lanes(
        track,
        np.vstack(constants).T,
        np.hstack([_starts_of(jobs) for _, jobs in batches]),
        np.zeros((program.smooth, 0)),
    )
    return run(program, METHODS[system.method], system.substeps, lanes)


# ---------------------------------------------------------------------------------- derivatives


def sensitivities(
    model: Model, system: System, traces: Traces, requests: Sequence[SensitivityRequest]
) -> list[Sensitivity | None]:
    """Outputs and derivatives, one result per request.

    None: the rates jump or cannot be traced, so that the request needs differences of simulations.
    """
    found: list[Sensitivity | None] = [None] * len(requests)
    groups: dict[Kind, list[int]] = {}
    left: dict[int, list[int]] = {}
    tracks = _Tracks(system, traces)
    inner: dict[int, SensitivityRequest] = {}
    for i, request in enumerate(requests):
        forms = tuple(_form(system, traces, t) for t in request.included)
        if _reason(system, traces, forms) is not None:
            continue
        tried = [_form(system, traces, t) for t in request.candidates]
        good = [k for k, f in enumerate(tried) if _reason(system, traces, (f,)) is None]
        if len(good) < len(tried):
            left[i] = [k for k in range(len(tried)) if k not in good]
        turned = tuple(c.effect for c in request.shape_changes)
        by_numbers = all(forms[k].numbers for k in turned)
        inner[i] = replace(
            request,
            candidates=tuple(request.candidates[k] for k in good),
            shape_changes=request.shape_changes if by_numbers else (),
        )
        kind = _kind(
            system,
            included=forms,
            derivatives=True,
            candidates=tuple(tried[k] for k in good),
            by_theta=request.parameters_of(model),
            by_starts=request.by_starts,
            changes=tuple(tracks.names(c) for c in request.input_changes),
            turned=turned if by_numbers else (),
        )
        groups.setdefault(kind, []).append(i)
    for kind, group in groups.items():
        own = [inner[i] for i in group]
        runs = _run_requests(system, traces, kind, own, tracks)
        for k, i in enumerate(group):
            found[i] = sensitivity_of(model, inner[i], runs.outputs[k], runs.derivatives[k])
    _test(model, system, traces, requests, found)
    for i, s in enumerate(found):
        if s is not None:
            found[i] = _completed(model, requests[i], inner[i], left.get(i, []), s)
    return found


def _run_requests(
    system: System,
    traces: Traces,
    kind: Kind,
    requests: Sequence[SensitivityRequest],
    tracks: _Tracks,
) -> Runs:
    program = _program(system, traces, kind)
    constants, starts = [], []
    for r in requests:
        row = [*r.theta, *r.sizes]
        for form, t in zip(
            (*kind.included, *kind.candidates), (*r.included, *r.candidates), strict=True
        ):
            row += _floats(form, t.shape)
        for change in r.shape_changes:
            form = kind.included[change.effect]
            ends = [np.array(_floats(form, s)) for s in (change.upper, change.lower)]
            row += list((ends[0] - ends[1]) / change.width)
        constants.append(row)
        hidden = [h.start for t in r.candidates for h in t.effect.hidden]
        starts.append([*r.start, *hidden])
    seeds = np.zeros((program.smooth, program.columns))
    if kind.by_starts:
        first = len(kind.by_theta) + len(kind.included)
        seeds[:, first : first + program.smooth] = np.eye(program.smooth)
    lanes = tracks.lanes(
        [tracks.of(r.record, r.input_changes) for r in requests],
        np.array(constants).reshape(len(requests), -1).T,
        np.array(starts).T,
        seeds,
    )
    return run(program, METHODS[system.method], system.substeps, lanes)


def _completed(
    model: Model,
    request: SensitivityRequest,
    inner: SensitivityRequest,
    left: Sequence[int],
    s: Sensitivity,
) -> Sensitivity:
    """Derivatives with those that are differences of simulations."""
    if left:
        fewer = replace(
            request,
            candidates=tuple(request.candidates[k] for k in left),
            by_theta=(),
            by_starts=False,
            input_changes=(),
            shape_changes=(),
        )
        (other,) = difference_sensitivities(model, [fewer])
        columns = np.zeros((*s.outputs.shape, len(request.candidates)))
        columns[..., list(left)] = other.d_candidates
        columns[..., [k for k in range(columns.shape[-1]) if k not in left]] = s.d_candidates
        s = replace(s, d_candidates=columns)
    if len(inner.shape_changes) < len(request.shape_changes):
        batches = [
            (
                request.record,
                replace(request, included=reshaped(request.included, c.effect, v)).jobs(),
            )
            for c in request.shape_changes
            for v in (c.upper, c.lower)
        ]
        runs = [y[0] for y in model.simulate_all(batches)]
        columns = np.stack(
            [
                (runs[2 * k] - runs[2 * k + 1]) / c.width
                for k, c in enumerate(request.shape_changes)
            ],
            axis=-1,
        )
        s = replace(s, d_shapes=columns)
    return s


# ---------------------------------------------------------------------------------------- jumps


def _test(
    model: Model,
    system: System,
    traces: Traces,
    requests: Sequence[SensitivityRequest],
    found: list[Sensitivity | None],
) -> None:
    """Remove derivatives that miss a jump of a rate, such as that of np.sign.

    The difference of two more simulations, with changed parameters, magnitudes and start states,
    is compared with its prediction.
    """
    tested = []
    for i, request in enumerate(requests):
        forms = [_form(system, traces, t) for t in request.included]
        parts = [_own(system, traces), *(traces.effects[f.effect, f.text] for f in forms)]
        if found[i] is not None and any(isinstance(t, Traced) and t.jumps for t in parts):
            tested.append(i)
    moves = [_moves(model, requests[i]) for i in tested]
    batches = [(requests[i].record, jobs) for i, (jobs, _) in zip(tested, moves, strict=True)]
    runs = simulated(system, traces, batches)
    for i, (two, _), (_, changes) in zip(tested, runs, moves, strict=True):
        s = found[i]
        assert s is not None
        if not _predicts(system, requests[i], s, two, changes):
            found[i] = None


def _moves(model: Model, request: SensitivityRequest) -> tuple[Jobs, Array]:
    """Two simulations with opposite changes of parameters, magnitudes and start states.

    Also returns the differences between the two, in the order of the variables of differentiation.
    At a limit, both change the value to the permitted side.
    """
    jobs, columns = changed_jobs(model, request)
    table = np.hstack([jobs.theta, jobs.magnitudes, jobs.starts])
    pairs = np.array([[row for row, _ in entry] for entry in columns]).reshape(-1, 2)
    pairs = np.random.default_rng(0).permuted(pairs, axis=1)
    changes = table[pairs] - table[0]  # (columns, 2, all)
    ends = np.cumsum([jobs.theta.shape[1], jobs.magnitudes.shape[1]])
    theta, sizes, starts = np.split(table[0] + changes.sum(axis=0), ends, axis=1)
    two = replace(jobs, theta=theta, magnitudes=sizes, starts=starts)
    return two, (changes[:, 0] - changes[:, 1]).sum(axis=1)


def _predicts(
    system: System, request: SensitivityRequest, s: Sensitivity, two: Array, changes: Array
) -> bool:
    """Whether the derivatives predict the difference of the outputs of two changed simulations.

    Outputs that are rates show each steep part of a rate itself. They are left out if there are
    others.
    """
    del request
    columns = np.concatenate([s.d_theta, s.d_magnitudes, s.d_starts], axis=-1)
    change = two[0] - two[1]
    error = change - columns @ changes
    good = np.isfinite(change)
    if np.any(good & ~np.isfinite(error)):
        return False
    change, error, y = (np.where(good, v, 0.0) for v in (change, error, s.outputs))
    allowed = SMALL**2 * np.sum(change**2, axis=0) + 1e-18 * np.sum(y**2, axis=0)
    agrees = np.sum(error**2, axis=0) <= allowed
    steady = [o for o, of in enumerate(system.outputs.values()) if not isinstance(of, Rate)]
    return bool(np.all(agrees[steady] if steady else agrees))


# ----------------------------------------------------------------- functions that cannot be traced


def _plain(system: System, batches: Sequence[Batch], tracks: _Tracks) -> Runs:
    """Integrate functions of Python: with arrays of all jobs, or else job by job."""
    out: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
    for record, jobs in batches:
        own = _Plain(system, jobs)
        lanes = tracks.lanes(
            _track_of(tracks, (record, jobs)),
            np.zeros((0, jobs.count)),
            _starts_of(jobs),
            np.zeros((0, 0)),
        )
        scales = np.array([s.scale for s in system.all_states(jobs.included)])
        runs = plain(own.rates, own.outputs, scales, METHODS[system.method], system.substeps, lanes)
        for all_of, part in zip(out, (runs.outputs, runs.derivatives, runs.states), strict=True):
            all_of.extend(part)
    return Runs(*out)


class _Plain:
    """Rates and outputs of jobs, by calls of the functions."""

    def __init__(self, system: System, jobs: Jobs):
        self.system, self.jobs, self.one_by_one = system, jobs, False
        for candidate in jobs.included:
            _check_names(system, candidate)

    def _each(
        self, names: Sequence[str], of: Callable[..., Sequence[Any]], t: Array, *columns: Array
    ) -> Array:
        """Values of a function of arrays, or of numbers if it does not take arrays."""
        if not self.one_by_one:
            try:
                return self._checked(names, of(t, *columns), t.size)
            except (TypeError, ValueError) as error:
                if isinstance(error, Error) and error.__cause__ is None:
                    raise
                self.one_by_one = True
        rows = [of(t[b], *(c[..., b] for c in columns)) for b in range(t.size)]
        try:
            return np.array(rows, dtype=np.float64).reshape(t.size, len(names)).T
        except (TypeError, ValueError):  # which of them is no number
            return np.concatenate([self._checked(names, row, 1) for row in rows], axis=1)

    def _checked(self, names: Sequence[str], values: Sequence[Any], count: int) -> Array:
        """Rates or outputs, each of which is a real number or one for each job."""
        out = np.empty((len(values), count))
        for row, name, value in zip(out, names, values, strict=True):
            if np.iscomplexobj(value):
                fault = "is complex, expected a real number"
            elif np.shape(value) not in ((), (1,), (count,)):
                fault = f"has shape {np.shape(value)}, expected a number or one value a job"
            else:
                row[:] = value
                continue
            raise InvalidParameter(f"model {self.system.name}: {name} {fault}, ({count},)")
        return out

    def _named(self, x: Array, u: Array, p: Array) -> tuple[Named, Named, Named]:
        system = self.system
        held = dict(zip(system.inputs, u, strict=False))
        if system.hold == "between":
            own = dict(zip(system.parameters, p, strict=True))
            held = {
                n: u[2 * i] + own[BETWEEN + n] * u[2 * i + 1] for i, n in enumerate(system.inputs)
            }
        return (
            Named._of(dict(zip(system.names, x, strict=False))),
            Named._of(held),
            Named._of(dict(zip(system.parameters, p, strict=True))),
        )

    def rates(self, t: Array, x: Array, signals: Array) -> Array:
        """Rates of all states, (states, jobs)."""
        system, jobs = self.system, self.jobs

        def of(t: Any, x: Array, u: Array, p: Array, sizes: Array) -> list[Any]:
            named, held, values = self._named(x, u, p)
            with calling(f"model {system.name}: its rates function"):
                out = [*_rates(system, t, named, held, values)]
            out += [0.0] * (len(x) - len(out))
            first = len(system.states)
            for k, candidate in enumerate(jobs.included):
                names = [h.name for h in candidate.effect.hidden]
                places = {n: first + i for i, n in enumerate(names)}
                first += len(names)
                seen = Named._of({**named._values, **{n: x[i] for n, i in places.items()}})
                places |= {n: i for i, n in enumerate(system.names)}
                with calling(f"effect {candidate.name}: its rate"):
                    found = _changes(candidate, t, seen, held, values, sizes[k], candidate.shape)
                for name, value in found.items():
                    out[places[name]] = out[places[name]] + value
            pushes = system.ports.values() if jobs.forces is not None else ()
            forces = u[len(u) - len(pushes) :]
            for push, force in zip(pushes, forces, strict=True):
                for name, value in push(force, t, named, held, values).items():
                    place = system.names.index(name)
                    out[place] = out[place] + value
            return out

        names = [f"the rate of {s.name}" for s in system.all_states(jobs.included)]
        return self._each(names, of, t, x, signals, jobs.theta.T, jobs.magnitudes.T)

    def outputs(self, t: Array, x: Array, signals: Array, slopes: Array) -> Array:
        """Outputs, (outputs, jobs)."""
        system = self.system

        def of(t: Any, x: Array, u: Array, p: Array, slopes: Array) -> list[Any]:
            named, held, values = self._named(x, u, p)
            out: list[Any] = []
            for name, show in system.outputs.items():
                if isinstance(show, Rate):
                    out.append(slopes[system.names.index(show.state)])
                elif isinstance(show, str):
                    out.append(named[show])
                else:
                    with calling(f"model {system.name}: its output {name}"):
                        out.append(show(t, named, held, values))
            return out

        names = [f"output {n}" for n in system.outputs]
        return self._each(names, of, t, x, signals, self.jobs.theta.T, slopes)
