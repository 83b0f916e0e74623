"""Programs: the tapes of rates, effects and outputs, put together for simulations of one kind."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array
from unmodeled.models.coordinates import Rate
from unmodeled.models.model import BETWEEN, difference_offsets
from unmodeled.ode.methods import Method
from unmodeled.ode.tape import NAMES, TABLES, Code, Fragment, Target, Traced
from unmodeled.ode.traces import (
    Form,
    Key,
    ProgramKind,
    System,
    Traces,
    own_trace,
    port_trace,
    traced_of,
)


@dataclass(eq=False)
class Program:
    """Operations on registers that give rates, outputs, and what their derivatives need.

    The first registers are the time, the states, the signals and the constants of a job.
    """

    states: int
    smooth: int
    """Number of the first states, whose derivatives are carried along."""
    columns: int
    """Number of variables of differentiation."""
    signals: int
    constants_of_jobs: int
    registers: int
    constants: tuple[NDArray[np.int32], Array]
    """Registers of constants, and their values."""
    once: Code
    """Operations (code, register, three arguments) on constants of a job."""
    rates: Code
    """Those of each stage."""
    shown: Code
    """Those of each sample, after those of a stage."""
    tables: tuple[Array, ...]
    rate: Code
    """Registers of the rates, (states,)."""
    by_state: Code
    """Derivatives of rates: state, state, register, (m, 3)."""
    by_column: Code
    """Derivatives of rates: state, column, register, (m, 3)."""
    output: Code
    """Registers of the outputs."""
    output_by_state: Code
    output_by_column: Code
    blocks: tuple[int, ...]
    """Sizes of groups of states; each depends on itself and on the first group only."""
    plan: Any = None
    """The same as the extension reads it."""
    marches: dict[Method, Any] = field(default_factory=dict)
    """The same as generated functions, by method."""


class _Assembly:
    """A program that is put together."""

    def __init__(self, states: int, signals: int, constants: int):
        self.counts = states, signals, constants
        self.states = list(range(1, 1 + states))
        self.signals = list(range(1 + states, 1 + states + signals))
        first = 1 + states + signals
        self.jobs = list(range(first, first + constants))
        """Registers."""
        self.registers = first + constants
        self._known: dict[float, int] = {}
        self._places: list[int] = []
        self._values: list[float] = []
        self._parts: dict[str, list[Code]] = {"once": [], "rates": [], "shown": []}
        self.tables: list[Array] = []

    def constant(self, value: float) -> int:
        """Register of a constant."""
        if value not in self._known:
            self._known[value] = self._fresh([value])[0]
        return self._known[value]

    def _fresh(self, values: Sequence[float]) -> list[int]:
        places = list(range(self.registers, self.registers + len(values)))
        self.registers += len(values)
        self._places += places
        self._values += map(float, values)
        return places

    def add(self, name: str, *args: int, part: str = "rates") -> int:
        """Register of one more operation."""
        row = [NAMES.index(name), self.registers, *args, 0, 0][:5]
        self.registers += 1
        self._parts[part].append(np.array([row], dtype=np.int32))
        return self.registers - 1

    def total(self, registers: Sequence[int], part: str = "rates") -> int:
        """Register of a sum."""
        out = registers[0]
        for other in registers[1:]:
            out = self.add("add", out, other, part=part)
        return out

    def place(
        self, fragment: Fragment, at: Mapping[Any, int], part: str = "rates"
    ) -> dict[Target, int]:
        """Append a fragment whose inputs are these registers; the registers of its targets."""
        known = [at[key] for key in fragment.inputs] + self._fresh(list(fragment.constants))
        count = len(fragment.operations)
        place = np.array([*known, *range(self.registers, self.registers + count)], dtype=np.int32)
        self.registers += count
        code = fragment.operations
        rows = np.empty((count, 5), dtype=np.int32)
        rows[:, 0], rows[:, 1] = code[:, 0], place[len(known) :]
        rows[:, 2:] = place[code[:, 1:]] if place.size else 0
        if fragment.tables:
            tables = np.isin(code[:, 0], TABLES)
            rows[tables, 3] = code[tables, 2] + len(self.tables)
            self.tables += fragment.tables
        self._parts["once"].append(rows[~fragment.moving])
        self._parts[part].append(rows[fragment.moving])
        return {t: int(place[r]) for t, r in fragment.targets.items()}

    def entries(self, of: Mapping[tuple[int, int], Sequence[int]], part: str) -> Code:
        """Sums of registers by row and column."""
        rows = [(i, k, self.total(r, part)) for (i, k), r in of.items()]
        return np.array(rows, dtype=np.int32).reshape(-1, 3)

    def code(self, part: str) -> Code:
        """Operations of a part."""
        return np.concatenate([np.zeros((0, 5), dtype=np.int32), *self._parts[part]])

    @property
    def constants(self) -> tuple[NDArray[np.int32], Array]:
        """Registers of constants, and their values."""
        return np.array(self._places, dtype=np.int32), np.array(self._values)


@dataclass(eq=False)
class _Sums:
    """Registers that are added up: values by row, derivatives by row and state or variable."""

    values: dict[int, list[int]] = field(default_factory=dict)
    by_state: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    by_column: dict[tuple[int, int], list[int]] = field(default_factory=dict)


class _Builder:
    """Puts the program of a kind together."""

    def __init__(self, system: System, traces: Traces, kind: ProgramKind):
        self.system, self.traces, self.kind = system, traces, kind
        forms, count = (*kind.included, *kind.candidates), len(kind.included)
        self.base_rows = {n: i for i, n in enumerate(system.names)}
        self.rows, first = [], len(system.states)
        for form in forms:
            names = [h.name for h in form.effect.hidden]
            self.rows.append({n: first + i for i, n in enumerate(names)})
            first += len(names)
        hidden = [len(rows) for rows in self.rows]
        self.smooth = len(system.states) + sum(hidden[:count])
        self.blocks = (self.smooth, *hidden[count:])
        self._take_registers([f.numbers for f in forms])
        self.rates, self.shown = _Sums(), _Sums()
        self.by_size = len(kind.by_theta)
        self.by_candidate = self.by_size + count + self.smooth * kind.by_starts
        self.by_change = self.by_candidate + len(kind.candidates)
        self.by_turn = self.by_change + len(kind.changes)
        self.columns = (self.by_turn + len(kind.turned)) * kind.derivatives

    def _take_registers(self, numbers: Sequence[int]) -> None:
        """Give registers to constants of jobs and to signals; ``numbers``: of each shape."""
        system, kind = self.system, self.kind
        turned = [numbers[k] for k in kind.turned]
        each = 2 if kind.between else 1
        signals = each * (len(system.inputs) + sum(map(len, kind.changes)))
        ports = len(system.ports) * kind.forces
        constants = len(kind.parameters) + len(kind.included) + sum(numbers) + sum(turned)
        a = self.assembly = _Assembly(sum(self.blocks), signals + ports, constants)
        jobs, waves = iter(a.jobs), iter(a.signals)
        self.p = dict(zip(kind.parameters, jobs, strict=False))
        self.sizes = [next(jobs) for _ in kind.included]
        self.shapes = [list(itertools.islice(jobs, n)) for n in numbers]
        self.turns = [list(itertools.islice(jobs, n)) for n in turned]
        self.bends: dict[str, int] = {}
        self.u = {n: self._held(n, waves, self.bends) for n in system.inputs}
        self.changes = [{n: self._held(n, waves, {}) for n in names} for names in kind.changes]
        self.forces = list(waves)

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
        own = traced_of(own_trace(self.system, self.traces))
        at = self._registers({})
        self._use(own, at, self.base_rows, "rate", {})
        for k, form in enumerate(self.kind.included):
            self._include(k, form)
        for name, register in zip(self.system.ports, self.forces, strict=False):
            port = port_trace(self.system, self.traces, name)
            self._use(port, {**at, ("force",): register}, self.base_rows, "rate", {})
        for k, form in enumerate(self.kind.candidates):
            self._try(k, form)
        a = self.assembly
        terms = [self.rates.values.get(i) for i in range(len(a.states))]
        rate = [a.total(r) if r else a.constant(0.0) for r in terms]
        output = self._outputs(own, at, rate)
        derived = self.rates.by_state if self.kind.derivatives or self.kind.implicit else {}
        state, column = a.entries(derived, "rates"), a.entries(self.rates.by_column, "rates")
        by_state, by_column = {}, {}
        if self.kind.derivatives:
            by_state, by_column = self.shown.by_state, self.shown.by_column
        shown = a.entries(by_state, "shown"), a.entries(by_column, "shown")
        states, signals, constants = a.counts
        return Program(
            states=states,
            smooth=self.smooth,
            columns=self.columns,
            signals=signals,
            constants_of_jobs=constants,
            registers=a.registers,
            constants=a.constants,
            once=a.code("once"),
            rates=a.code("rates"),
            shown=a.code("shown"),
            tables=tuple(a.tables),
            rate=np.array(rate, dtype=np.int32),
            output=np.array(output, dtype=np.int32),
            by_state=state,
            by_column=column,
            output_by_state=shown[0],
            output_by_column=shown[1],
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
    ) -> None:
        """Add the values of a tape to the rates or outputs, with derivatives."""
        part = "rates" if what == "rate" else "shown"
        columns = {**self._columns(), **further}
        own = [t for t in traced.values if t[0] == what]
        wanted: list[Target] = [(t, None) for t in own]
        if self.kind.derivatives or (self.kind.implicit and what == "rate"):
            wanted += [(t, k) for t in own for k in traced.keys(t) if k[0] == "x" or k in columns]
        got = self.assembly.place(traced.fragment(wanted), at, part)
        into = self.rates if what == "rate" else self.shown
        for ((_, name), key), register in got.items():
            row = rows[name]
            if key is None:
                into.values.setdefault(row, []).append(register)
                continue
            if key[0] == "x":
                into.by_state.setdefault((row, at[key] - 1), []).append(register)
            for column, factor in columns.get(key, ()):
                scaled = register
                if factor is not None:
                    scaled = self.assembly.add("multiply", register, factor, part=part)
                into.by_column.setdefault((row, column), []).append(scaled)

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
        traced = traced_of(self.traces.effects[form.effect, form.text])
        self._use(traced, at, {**self.base_rows, **self.rows[k]}, "rate", further)

    def _try(self, k: int, form: Form) -> None:
        """Add the derivative by the magnitude of a candidate at zero, and its hidden states."""
        place, a = len(self.kind.included) + k, self.assembly
        at = self._registers(self.rows[place])
        at |= {("shape", m): r for m, r in enumerate(self.shapes[place])}
        zero = {**at, ("size",): a.constant(0.0)}
        traced = traced_of(self.traces.effects[form.effect, form.text])
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
                self._push(name, column, register)
            elif key is None:
                self.rates.values.setdefault(rows[name], []).append(register)
            else:
                self.rates.by_state.setdefault((rows[name], zero[key] - 1), []).append(register)
        effect = form.effect
        offsets = difference_offsets(0.0, effect.step * effect.scale, *effect.bounds)
        for size, weight in () if linear else offsets:
            own = {**at, ("size",): a.constant(size)}
            got = a.place(traced.fragment([(t, None) for t in pushed]), own)
            for ((_, name), _), register in got.items():
                self._push(name, column, a.add("multiply", register, a.constant(weight)))

    def _push(self, name: str, column: int, register: int) -> None:
        """Add to the derivative of the rate of a state."""
        self.rates.by_column.setdefault((self.base_rows[name], column), []).append(register)

    def _outputs(self, own: Traced, at: Mapping[Key, int], rate: Sequence[int]) -> list[int]:
        """Registers of the outputs; their derivatives are added to those that are shown."""
        self._use(own, at, {n: o for o, n in enumerate(self.system.outputs)}, "output", {})
        shown, rates = self.shown, self.rates
        out: list[int] = []
        one = self.assembly.constant(1.0)
        for o, of in enumerate(self.system.outputs.values()):
            if isinstance(of, str):
                i = self.base_rows[of]
                out.append(self.assembly.states[i])
                shown.by_state[o, i] = [one]
            elif isinstance(of, Rate):
                i = self.base_rows[of.state]
                out.append(rate[i])
                shown.by_state |= {(o, k): r for (row, k), r in rates.by_state.items() if row == i}
                shown.by_column |= {
                    (o, k): r for (row, k), r in rates.by_column.items() if row == i
                }
            else:
                out += shown.values[o]
        return out


def program_of(system: System, traces: Traces, kind: ProgramKind) -> Program:
    """The program of a kind of simulations."""
    if kind not in traces.programs:
        traces.programs[kind] = _Builder(system, traces, kind).program()
    found: Program = traces.programs[kind]
    return found
