"""Integration of programs: methods as tableaus, in NumPy or by the compiled extension."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array
from unmodeled.fit import compiled
from unmodeled.fit.program import Program
from unmodeled.fit.tape import FUNCTIONS, NAMES, TABLES, Code

__all__ = ["METHODS", "Lanes", "Method", "Runs", "plain", "run"]


@dataclass(frozen=True, eq=False)
class Method:
    """A linearly implicit Runge-Kutta method.

    ``(1 - gamma h J) k_i = f(x + h sum a_ij k_j) + sum g_ij k_j``, and the step is h sum b_i k_i.
    J is the derivative of the rates at the first stage.
    """

    inner: Array
    """a"""
    carried: Array
    """g"""
    weights: Array
    """b"""
    instants: tuple[int, ...]
    """Times of the stages, in halves of a step."""
    gamma: float = 0.0


_GAMMA = 1.0 - np.sqrt(0.5)
METHODS = {
    "rk4": Method(
        np.array([[0.0] * 4, [0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        np.zeros((4, 4)),
        np.array([1.0, 2.0, 2.0, 1.0]) / 6.0,
        (0, 1, 1, 2),
    ),
    # ROS2 (Verwer et al. 1999): L-stable, of order 2 with any approximate J.
    "rosenbrock": Method(
        np.array([[0.0, 0.0], [1.0, 0.0]]),
        np.array([[0.0, 0.0], [-2.0, 0.0]]),
        np.array([1.5, 0.5]),
        (0, 2),
        float(_GAMMA),
    ),
}


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


def run(program: Program, method: Method, substeps: int, lanes: Lanes) -> Runs:
    """Integrate simulations: by the extension if there is one, else in NumPy."""
    if compiled.library() is not None:
        return Runs(*compiled.run(program, method, substeps, lanes))
    return _in_numpy(program, method, substeps, lanes)


class _Interpreter:
    """Evaluates a program for all lanes with NumPy."""

    def __init__(self, program: Program, lanes: Lanes):
        self.program = program
        self.registers: list[Any] = [0.0] * program.registers
        for place, value in zip(*program.constants, strict=True):
            self.registers[place] = value
        first = 1 + program.states + program.signals
        self.registers[first : first + program.constants_of_jobs] = lanes.constants
        self._rates, self._shown = (self._compiled(c) for c in (program.rates, program.shown))
        self._run(self._compiled(program.once))

    def _compiled(self, code: Code) -> list[tuple[Any, ...]]:
        rows = []
        for operation, out, a, b, c in code.tolist():
            of = FUNCTIONS[NAMES[operation]]
            if operation in TABLES:
                table = self.program.tables[b]
                rows.append((lambda x, of=of, table=table: of(x, table), out, (a,)))
            else:
                rows.append((of, out, (a, b, c)[: 3 if of is FUNCTIONS["where"] else _arity(of)]))
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

    def matrix(self, count: int) -> Array:
        """Derivatives of the rates by the states, (lanes, states, states)."""
        size = self.program.states
        out = np.zeros((count, size, size))
        for i, k, place in self.program.by_state:
            out[:, i, k] = self.registers[place]
        return out

    def slopes(self, by_state: Code, by_column: Code, rows: int, s: Array) -> Array:
        """Derivatives, (rows, columns, lanes), from those of the states, ``s``."""
        out = np.zeros((rows, *s.shape[1:]))
        for i, k, place in by_state:
            if i < rows and k < len(s):
                out[i] += self.registers[place] * s[k]
        for i, k, place in by_column:
            out[i, k] += self.registers[place]
        return out


def _arity(of: Any) -> int:
    return int(getattr(of, "nin", 2))


def _in_numpy(program: Program, method: Method, substeps: int, lanes: Lanes) -> Runs:
    """The same as the extension, in NumPy."""
    interpreter = _Interpreter(program, lanes)
    smooth, columns, count = program.smooth, program.columns, len(lanes.track)
    clock = _Clock(lanes, substeps)
    x = lanes.starts.copy()
    s = np.repeat(lanes.seeds[:, :, None], count, axis=2)
    p = program
    y, dy, path = [], [], []
    for j in range(clock.longest):
        k = interpreter.rates(clock.time[j], x, clock.signals[j, 0])
        y.append(interpreter.outputs(count))
        dy.append(interpreter.slopes(p.output_by_state, p.output_by_column, len(y[-1]), s))
        path.append(x)
        if j == clock.longest - 1:
            break
        h = (clock.time[j + 1] - clock.time[j]) / substeps
        for step in range(substeps):
            ks: list[Array] = []
            ds: list[Array] = []
            for stage, instant in enumerate(method.instants):
                at = 2 * step + instant
                if step or stage:
                    inner = _combined(x, method.inner[stage], ks, h)
                    t = clock.time[j] + (0.5 * at) * h
                    k = interpreter.rates(t, inner, clock.signals[j, at])
                if stage == 0 and method.gamma:
                    matrix = np.eye(p.states) - method.gamma * h[:, None, None] * (
                        interpreter.matrix(count)
                    )
                k = _combined(k, method.carried[stage], ks)
                ks.append(_solved(matrix, k, p.blocks) if method.gamma else k)
                if columns:
                    d = _combined(s, method.inner[stage], ds, h)
                    d = interpreter.slopes(p.by_state, p.by_column, smooth, d)
                    d = _combined(d, method.carried[stage], ds)
                    ds.append(_solved(matrix, d, p.blocks[:1]) if method.gamma else d)
            x = _combined(x, method.weights, ks, h)
            s = _combined(s, method.weights, ds, h) if columns else s
    return clock.runs(lanes, y, dy, path)


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
    clock = _Clock(lanes, substeps)
    x = lanes.starts.copy()
    y, path = [], []
    for j in range(clock.longest):
        k = rates(clock.time[j], x, clock.signals[j, 0])
        y.append(outputs(clock.time[j], x, clock.signals[j, 0], k))
        path.append(x)
        if j == clock.longest - 1:
            break
        h = (clock.time[j + 1] - clock.time[j]) / substeps
        for step in range(substeps):
            ks: list[Array] = []
            for stage, instant in enumerate(method.instants):
                at = 2 * step + instant
                t, signals = clock.time[j] + (0.5 * at) * h, clock.signals[j, at]
                inner = _combined(x, method.inner[stage], ks, h)
                if step or stage:
                    k = rates(t, inner, signals)
                if stage == 0 and method.gamma:
                    columns = []
                    for i, row in enumerate(inner):
                        moved = inner.copy()
                        moved[i] += 1e-6 * (np.abs(row) + scales[i])
                        columns.append((rates(t, moved, signals) - k) / (moved[i] - row))
                    slopes = np.moveaxis(np.array(columns), -1, 0).swapaxes(1, 2)
                    matrix = np.eye(len(x)) - method.gamma * h[:, None, None] * slopes
                k = _combined(k, method.carried[stage], ks)
                ks.append(_solved(matrix, k, (len(x),)) if method.gamma else k)
            x = _combined(x, method.weights, ks, h)
    return clock.runs(lanes, y, [np.zeros((*v.shape[:1], 0, v.shape[1])) for v in y], path)


class _Clock:
    """Times and signals of all lanes by sample; those of the end after it."""

    def __init__(self, lanes: Lanes, substeps: int):
        del substeps
        self.longest = max(len(lanes.times[r]) for r in lanes.track)

        def longer(values: Array) -> Array:
            at = np.minimum(np.arange(self.longest), len(values) - 1)
            return np.asarray(values[at])

        self.time = np.stack([longer(t) for t in lanes.times], axis=-1)[:, lanes.track]
        """(longest, lanes)"""
        self.signals = np.stack([longer(s) for s in lanes.signals], axis=-1)[..., lanes.track]
        """(longest, halves, signals, lanes)"""

    def runs(self, lanes: Lanes, y: list[Array], dy: list[Array], path: list[Array]) -> Runs:
        """Results by lane."""
        found = [np.array(v) for v in (y, dy, path)]
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
