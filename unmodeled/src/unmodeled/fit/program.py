"""Programs: the tapes of rates, effects and outputs, put together for simulations of one kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array
from unmodeled.fit.tape import NAMES, TABLES, Code, Fragment, Target

__all__ = ["Assembly", "Program"]


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


class Assembly:
    """A program that is put together.

    Parameters
    ----------
    states, signals, constants
        Numbers of states, of signals, and of constants of a job.
    """

    def __init__(self, states: int, signals: int, constants: int):
        self.counts = states, signals, constants
        self.states = list(range(1, 1 + states))
        self.signals = list(range(1 + states, 1 + states + signals))
        first = 1 + states + signals
        self.jobs = list(range(first, first + constants))
        """Registers."""
        self._next = first + constants
        self._constants: dict[float, int] = {}
        self._places: list[int] = []
        self._values: list[float] = []
        self._parts: dict[str, list[Code]] = {"once": [], "rates": [], "shown": []}
        self._tables: list[Array] = []

    def constant(self, value: float) -> int:
        """Register of a constant."""
        if value not in self._constants:
            self._constants[value] = self._fresh([value])[0]
        return self._constants[value]

    def _fresh(self, values: Sequence[float]) -> list[int]:
        places = list(range(self._next, self._next + len(values)))
        self._next += len(values)
        self._places += places
        self._values += map(float, values)
        return places

    def add(self, name: str, *args: int, part: str = "rates") -> int:
        """Register of one more operation."""
        row = [NAMES.index(name), self._next, *args, 0, 0][:5]
        self._next += 1
        self._parts[part].append(np.array([row], dtype=np.int32))
        return self._next - 1

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
        place = np.array([*known, *range(self._next, self._next + count)], dtype=np.int32)
        self._next += count
        code = fragment.operations
        rows = np.empty((count, 5), dtype=np.int32)
        rows[:, 0], rows[:, 1] = code[:, 0], place[len(known) :]
        rows[:, 2:] = place[code[:, 1:]] if place.size else 0
        if fragment.tables:
            tables = np.isin(code[:, 0], TABLES)
            rows[tables, 3] = code[tables, 2] + len(self._tables)
            self._tables += fragment.tables
        self._parts["once"].append(rows[~fragment.moving])
        self._parts[part].append(rows[fragment.moving])
        return {t: int(place[r]) for t, r in fragment.targets.items()}

    def program(
        self,
        rate: Sequence[int],
        by_state: Mapping[tuple[int, int], Sequence[int]],
        by_column: Mapping[tuple[int, int], Sequence[int]],
        output: Sequence[int],
        output_by_state: Mapping[tuple[int, int], Sequence[int]],
        output_by_column: Mapping[tuple[int, int], Sequence[int]],
        *,
        smooth: int,
        columns: int,
        blocks: Sequence[int],
    ) -> Program:
        """The program; derivatives are sums of registers by row and column."""

        def entries(of: Mapping[tuple[int, int], Sequence[int]], part: str) -> Code:
            rows = [(i, k, self.total(r, part)) for (i, k), r in of.items()]
            return np.array(rows, dtype=np.int32).reshape(-1, 3)

        matrices = (
            entries(by_state, "rates"),
            entries(by_column, "rates"),
            np.array(output, dtype=np.int32),
            entries(output_by_state, "shown"),
            entries(output_by_column, "shown"),
        )
        code = {
            name: np.concatenate([np.zeros((0, 5), dtype=np.int32), *rows])
            for name, rows in self._parts.items()
        }
        states, signals, constants = self.counts
        return Program(
            states,
            smooth,
            columns,
            signals,
            constants,
            self._next,
            (np.array(self._places, dtype=np.int32), np.array(self._values)),
            code["once"],
            code["rates"],
            code["shown"],
            tuple(self._tables),
            np.array(rate, dtype=np.int32),
            *matrices,
            tuple(blocks),
        )
