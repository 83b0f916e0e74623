"""Integration of programs: methods as tableaus, in NumPy or by the compiled extension."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array
from unmodeled.ode import compiled
from unmodeled.ode.methods import Method
from unmodeled.ode.program import Program
from unmodeled.ode.scalar import MOST, marched
from unmodeled.ode.tape import ARGUMENTS, FUNCTIONS, NAMES, TABLES, Code


@dataclass(frozen=True, eq=False)
class Lanes:
    """Simulations of one kind, which are integrated together."""

    track: NDArray[np.intp]
    """Place of the times and signals of each simulation, (lanes,)."""
    times: Sequence[Array]
    """Times of the samples [s], (n,)."""
    signals: Sequence[Array]
    """Signals at the halves of the steps after each sample, (n, 2 substeps + 1, signals)."""
    constants: Array
    """(constants of jobs, lanes)"""
    starts: Array
    """(states, lanes)"""
    seeds: Array
    """Derivatives of the first states at the first sample, (smooth, columns)."""


@dataclass(frozen=True, eq=False)
class Runs:
    """Results by simulation."""

    outputs: list[Array]
    """(n, outputs)"""
    derivatives: list[Array]
    """(n, outputs, columns)"""
    states: list[Array]
    """(n, states)"""


#: Rates, (states, lanes), at an instant: ``rates(t, x, signals)``.
Rates = Callable[[Array, Array, Array], Array]
#: Derivatives of the rates by the states there, (lanes, states, states): ``slopes(t, x, signals)``.
Slopes = Callable[[Array, Array, Array], Array]
#: Numbers of derivatives that NumPy computes at once.
BLOCK = 400_000


def run(program: Program, method: Method, substeps: int, lanes: Lanes) -> Runs:
    """Integrate simulations: by the extension if there is one, else in NumPy."""
    if compiled.library() is not None:
        return Runs(*compiled.run(program, method, substeps, lanes))
    return in_numpy(program, method, substeps, lanes)


def in_numpy(program: Program, method: Method, substeps: int, lanes: Lanes) -> Runs:
    """The same as the extension, in NumPy.

    First the states are integrated, step by step. Then the derivatives of the steps of many samples
    are computed together, and only their products are a loop over the samples.
    """
    count, smooth, columns = len(lanes.track), program.smooth, program.columns
    clock = _Clock(lanes)
    path = _path(program, method, substeps, lanes, clock)
    y = np.empty((clock.longest, len(program.output), count))
    dy = np.empty((clock.longest, len(program.output), columns, count))
    s = np.repeat(lanes.seeds[:, :, None], count, axis=2)
    size = max(1, BLOCK // (count * smooth * (smooth + columns)))
    for first in range(0, clock.longest, size):
        j = np.arange(first, min(first + size, clock.longest))
        part = _Part(program, method, substeps, lanes, clock, path, j)
        y[j] = part.outputs
        if not columns:
            continue
        before = np.empty((smooth, columns, len(j), count))
        for i, (by_state, rest) in enumerate(part.changes()):
            before[:, :, i] = s
            s = np.einsum("ikl,kcl->icl", by_state, s) + rest
        dy[j] = part.shown(before)
    return clock.runs(lanes, y, dy, path[:, 0, 0])


def _path(program: Program, method: Method, substeps: int, lanes: Lanes, clock: _Clock) -> Array:
    """States at all stages, (samples, substeps, stages, states, lanes)."""
    if len(lanes.track) <= MOST and not method.gamma:
        times, signals = ([of[r] for r in lanes.track] for of in (lanes.times, lanes.signals))
        rates = _needed(program.rates, program.rate.tolist())
        given = rates, method, substeps, times, signals, lanes.constants, lanes.starts
        if (found := marched(program, *given)) is not None:
            return np.stack([clock.longer(path) for path in found], axis=-1)
    values = _Interpreter(program, lanes.constants, values_only=True)
    blocks = program.blocks if method.gamma else ()
    return _marched(clock, values.rates, values.slopes, blocks, method, substeps, lanes.starts)


def plain(
    rates: Rates,
    outputs: Callable[[Array, Array, Array, Array], Array],
    scales: Array,
    method: Method,
    substeps: int,
    lanes: Lanes,
) -> Runs:
    """Integrate simulations whose rates are functions of Python.

    Parameters
    ----------
    rates
        ``rates(t, x, signals) -> (states, lanes)``.
    outputs
        ``outputs(t, x, signals, rates) -> (outputs, lanes)``.
    scales
        Scales of the states, for differences, (states,).
    method, substeps, lanes
        As for :func:`run`.
    """

    def slopes(t: Array, x: Array, signals: Array) -> Array:
        base, columns = rates(t, x, signals), []
        for i, row in enumerate(x):
            moved = x.copy()
            moved[i] += 1e-6 * (np.abs(row) + scales[i])
            columns.append((rates(t, moved, signals) - base) / (moved[i] - row))
        return np.moveaxis(np.array(columns), -1, 0).swapaxes(1, 2)

    clock = _Clock(lanes)
    blocks = (len(lanes.starts),) if method.gamma else ()
    path = _marched(clock, rates, slopes, blocks, method, substeps, lanes.starts)[:, 0, 0]
    y = np.array(
        [
            outputs(t, x, held[0], rates(t, x, held[0]))
            for t, x, held in zip(clock.time, path, clock.signals, strict=True)
        ]
    )
    return clock.runs(lanes, y, np.zeros((*y.shape[:2], 0, y.shape[2])), path)


def _marched(
    clock: _Clock,
    rates: Rates,
    slopes: Slopes,
    blocks: Sequence[int],
    method: Method,
    substeps: int,
    x: Array,
) -> Array:
    """States at all stages, (samples, substeps, stages, states, lanes).

    ``blocks``: groups of states that are solved for; empty: an explicit method.
    """
    out = np.empty((clock.longest, substeps, len(method.instants), *x.shape), dtype=x.dtype)
    for j in range(clock.longest):
        if j == clock.longest - 1:
            out[j] = x
            break
        h = (clock.time[j + 1] - clock.time[j]) / substeps
        for step in range(substeps):
            ks: list[Array] = []
            for stage, instant in enumerate(method.instants):
                at = 2 * step + instant
                t, held = clock.time[j] + (0.5 * at) * h, clock.signals[j, at]
                inner = out[j, step, stage] = _combined(x, method.inner[stage], ks, h)
                k = rates(t, inner, held)
                if stage == 0 and blocks:
                    matrix = _implicit(method, h, slopes(t, inner, held))
                k = _combined(k, method.carried[stage], ks)
                ks.append(_solved(matrix, k, blocks) if blocks else k)
            x = _combined(x, method.weights, ks, h)
    return out


def _implicit(method: Method, h: Array, slopes: Array) -> Array:
    return np.asarray(np.eye(slopes.shape[-1]) - method.gamma * h[:, None, None] * slopes)


class _Interpreter:
    """Evaluates a program for all lanes with NumPy."""

    def __init__(self, program: Program, constants: Array, values_only: bool = False):
        self.program = program
        self.registers: list[Any] = [0.0] * program.registers
        for place, value in zip(*program.constants, strict=True):
            self.registers[place] = value
        first = 1 + program.states + program.signals
        self.registers[first : first + len(constants)] = constants
        rates = program.rates
        if values_only:
            rates = _needed(rates, [*program.rate, *program.by_state[:, 2]])
        self._rates, self._shown = (self._compiled(c) for c in (rates, program.shown))
        self._run(self._compiled(program.once))

    def _compiled(self, code: Code) -> list[tuple[Any, ...]]:
        rows = []
        for operation, out, *args in code.tolist():
            of = FUNCTIONS[NAMES[operation]]
            if operation in TABLES:
                table = self.program.tables[args[1]]
                rows.append((lambda x, of=of, table=table: of(x, table), out, args[:1]))
            else:
                rows.append((of, out, args[: ARGUMENTS[operation]]))
        return rows

    def _run(self, rows: list[tuple[Any, ...]]) -> None:
        registers = self.registers
        for of, out, args in rows:
            registers[out] = of(*[registers[a] for a in args])

    def rates(self, t: Array, x: Array, signals: Array) -> Array:
        """Rates at an instant; the registers keep what derivatives need."""
        registers = self.registers
        registers[0] = t
        registers[1 : 1 + len(x)] = x
        registers[1 + len(x) : 1 + len(x) + len(signals)] = signals
        self._run(self._rates)
        return self._rows(self.program.rate, x.shape[1])

    def outputs(self, count: int) -> Array:
        """Outputs at the instant of the last rates, (outputs, lanes)."""
        self._run(self._shown)
        return self._rows(self.program.output, count)

    def _rows(self, places: Code, count: int) -> Array:
        out = np.empty((len(places), count))
        for row, place in zip(out, places, strict=True):
            row[:] = self.registers[place]
        return out

    def slopes(self, t: Array, *_: Array) -> Array:
        """Derivatives of the last rates by the states, (lanes, states, states)."""
        size = self.program.states
        out = np.zeros((t.size, size, size))
        for i, k, place in self.program.by_state:
            out[:, i, k] = self.registers[place]
        return out

    def derived(
        self, by_state: Code, by_column: Code, rows: int, s: Array, first: int = 0
    ) -> Array:
        """Derivatives, (rows, columns, lanes), from those of the states, ``s``.

        ``first``: place of the first variable of differentiation among the columns of ``s``.
        """
        out = np.zeros((rows, *s.shape[1:]))
        for i, k, place in by_state:
            if i < rows and k < len(s):
                out[i] += self.registers[place] * s[k]
        for i, k, place in by_column:
            out[i, first + k] += self.registers[place]
        return out


def _needed(code: Code, targets: Sequence[int]) -> Code:
    """The operations on which some registers depend."""
    wanted, rows = set(map(int, targets)), []
    for row in code[::-1].tolist():
        if row[1] in wanted:
            rows.append(row)
            wanted.update(row[2 : 3 if row[0] in TABLES else 2 + ARGUMENTS[row[0]]])
    return np.array(rows[::-1], dtype=np.int32).reshape(-1, 5)


class _Part:
    """Outputs and derivatives at some samples together, on the axis (samples, lanes)."""

    def __init__(
        self,
        program: Program,
        method: Method,
        substeps: int,
        lanes: Lanes,
        clock: _Clock,
        path: Array,
        j: NDArray[np.intp],
    ):
        self.program, self.method, self.shape = program, method, (len(j), len(lanes.track))
        self.interpreter = _Interpreter(program, np.tile(lanes.constants, len(j)))
        self.last = _Interpreter(program, np.tile(lanes.constants, len(j)))
        following = np.minimum(j + 1, clock.longest - 1)
        self.h = ((clock.time[following] - clock.time[j]) / substeps).reshape(-1)
        self.time = clock.time[j].reshape(-1)
        self.held = np.moveaxis(clock.signals[j], 0, 2)  # (halves, signals, samples, lanes)
        self.path = np.moveaxis(path[j], 0, 3)  # (substeps, stages, states, samples, lanes)
        self._at(self.last, 0, 0)
        self.outputs = self._apart(self.last.outputs(self.h.size))

    def _at(self, interpreter: _Interpreter, step: int, stage: int) -> tuple[Array, Array]:
        """Time and states at a stage, where the rates are evaluated."""
        half = 2 * step + self.method.instants[stage]
        x = self.path[step, stage].reshape(self.path.shape[2], -1)
        t, held = self.time + 0.5 * half * self.h, self.held[half]
        interpreter.rates(t, x, held.reshape(len(held), t.size))
        return t, x

    def _apart(self, values: Array) -> Array:
        """The last axis as two, with the samples first."""
        return np.moveaxis(values.reshape(*values.shape[:-1], *self.shape), -2, 0)

    def changes(self) -> Iterator[tuple[Array, Array]]:
        """Derivatives of the states after each sample: by those at it, and by the columns."""
        program, method, interpreter = self.program, self.method, self.interpreter
        smooth, h = program.smooth, self.h
        s = np.zeros((smooth, smooth + program.columns, h.size))
        s[range(smooth), range(smooth)] = 1.0
        for step in range(len(self.path)):
            ds: list[Array] = []
            for stage in range(len(method.instants)):
                t, x = self._at(interpreter, step, stage)
                d = _combined(s, method.inner[stage], ds, h)
                d = interpreter.derived(program.by_state, program.by_column, smooth, d, smooth)
                d = _combined(d, method.carried[stage], ds)
                if stage == 0 and method.gamma:
                    matrix = _implicit(method, h, interpreter.slopes(t, x))
                ds.append(_solved(matrix, d, program.blocks[:1]) if method.gamma else d)
            s = _combined(s, method.weights, ds, h)
        apart = self._apart(s)
        return zip(apart[:, :, :smooth], apart[:, :, smooth:], strict=True)

    def shown(self, s: Array) -> Array:
        """Derivatives of the outputs from those of the states, with samples and lanes last."""
        p = self.program
        flat = s.reshape(*s.shape[:2], -1)
        return self._apart(
            self.last.derived(p.output_by_state, p.output_by_column, len(p.output), flat)
        )


class _Clock:
    """Times and signals of all lanes by sample; those of the end after it."""

    def __init__(self, lanes: Lanes):
        self.longest = max(len(lanes.times[r]) for r in lanes.track)

        self.time = np.stack([self.longer(t) for t in lanes.times], axis=-1)[:, lanes.track]
        """(longest, lanes)"""
        self.signals = np.stack([self.longer(s) for s in lanes.signals], axis=-1)[..., lanes.track]
        """(longest, halves, signals, lanes)"""

    def longer(self, values: Array) -> Array:
        """Values at all samples; those of the end after it."""
        at = np.minimum(np.arange(self.longest), len(values) - 1)
        return np.asarray(values[at])

    def runs(self, lanes: Lanes, *found: Array) -> Runs:
        """Outputs, derivatives and states, with the lanes as the last axis, by lane."""
        counts = [len(lanes.times[r]) for r in lanes.track]
        cut = [[np.ascontiguousarray(v[:n, ..., i]) for i, n in enumerate(counts)] for v in found]
        return Runs(*cut)


def _combined(x: Array, shares: Array, others: Sequence[Array], h: Array | None = None) -> Array:
    """The value x + h sum shares[j] others[j]."""
    parts = [a * v for a, v in zip(shares, others, strict=False) if a != 0.0]
    if not parts:
        return x
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return np.asarray(x + (total if h is None else h * total))


def _solved(matrix: Array, right: Array, blocks: Sequence[int]) -> Array:
    """Solutions for right sides (states, ..., lanes), group by group of the states.

    NaN where the matrix is not finite.
    """
    rows = np.moveaxis(right, -1, 0).reshape(right.shape[-1], len(right), -1)
    out, first = np.empty_like(rows), 0
    for size in blocks:
        own, lead = slice(first, first + size), slice(0, blocks[0])
        if not size:
            continue
        target = rows[:, own]
        if first:
            target = target - matrix[:, own, lead] @ out[:, lead]
        inner = matrix[:, own, own]
        bad = ~np.all(np.isfinite(inner), axis=(1, 2))
        inner = np.where(bad[:, None, None], np.eye(size), inner)
        out[:, own] = np.linalg.solve(inner, target)
        out[bad, own] = np.nan
        first += size
    return np.asarray(np.moveaxis(out.reshape(right.shape[-1], *right.shape[:-1]), 0, -1))
