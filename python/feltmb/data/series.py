"""Series of equal length by name: the content of a measured file before it becomes a record."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feltmb.data.records import Array
from feltmb.data.tables import Table, read_number
from feltmb.errors import DataError
from feltmb.units import spelled_unit
from feltmb.units.quantity import fault_text, shortened

__all__ = ["MOST_NUMBERS", "Columns", "columns_of", "limit_text", "plain_name"]

MOST_NUMBERS = 20_000_000  # limit for a file: 160 MB; reading needs a few times as much


def limit_text() -> str:
    """The limit as text."""
    return f"the limit of a measured file is {MOST_NUMBERS} numbers"


def plain_name(name: str) -> str:
    """A name without differences of notation (``Hammer_Tip X``, ``hammer_tip.x``)."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


@dataclass
class Columns:
    """Series of equal length by name."""

    values: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    """Units as stated in the file; only columns with a unit are included."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Other content of the file, and why it is not a series."""
    headings: dict[str, str] = field(default_factory=dict)
    """Complete heading by name, if it contains more than the name."""
    source: str = ""
    """Program that wrote the file, if its format identifies it."""
    frames: str = ""
    """Column with the frame number of a camera."""
    likelihood: dict[str, str] = field(default_factory=dict)
    """Column of the likelihood [1], by the column to which it belongs."""
    notes: list[str] = field(default_factory=list)
    """Assumptions about the file."""
    lines: NDArray[np.intp] | None = None
    """Line of the file by row, counted from 1; None: the file has no lines."""

    def __str__(self) -> str:
        shown = [shortened(name) for name in self.values]
        out = [f"{shortened(name)} ({why})" for name, why in self.left_out.items()]
        text = shortened(", ".join(shown), 600) or "none"
        return text + (f"; left out: {shortened(', '.join(out), 300)}" if out else "")

    def place(self, row: int) -> str:
        """Place of a row in the file, as text: its line, or its number from 1."""
        return f"row {row + 1}" if self.lines is None else f"line {self.lines[row]}"

    def add(self, name: str, shape: tuple[int, ...]) -> bool:
        """Whether an array has the shape of a series; other arrays are noted in ``left_out``."""
        if math.prod(shape) == max(shape, default=1) and shape:
            return True
        if shape:
            self.left_out[name] = " x ".join(map(str, shape))
        return False

    def only_longest(self) -> None:
        """Keep only the series with the largest length."""
        longest = max((v.size for v in self.values.values()), default=0)
        for name in [n for n, v in self.values.items() if v.size != longest]:
            self.left_out[name] = f"{self.values.pop(name).size} values"

    def find(self, *names: str) -> str:
        """Column of the first of these names that exists; "" if there is none.

        The name may be equal, equal to the complete heading, or written in another notation.
        """
        for name in names:
            if name in self.values:
                return name
            for column, heading in self.headings.items():
                if name.strip() == heading:
                    return column
        for name in names:
            alike = [c for c in self.values if plain_name(c) == plain_name(name)]
            if len(alike) == 1 and plain_name(name):
                return alike[0]
        for name in names:
            ends = [c for c in self.values if c.rpartition(".")[2] == name]
            if len(ends) == 1:  # the only point of a tracker
                return ends[0]
        return ""


def columns_of(
    path: Path,
    table: Table,
    names: Sequence[tuple[str, str]],
    told: list[str] | None = None,
) -> Columns:
    """The series of a table with the given names and units; columns without a name are omitted.

    The faults of the rows are added to ``told``, and what they concern is NaN.

    Raises
    ------
    DataError
        There is no header, or the rows have faults, and ``told`` is not given; the message lists
        the first ones.
    """
    faults: list[str] = [] if told is None else told
    if not table.header or all(_is_number(c, table.decimal) for c in table.header):
        raise DataError(
            f"{path}: line {table.line} holds numbers, expected the names of the columns"
        )
    if table.lines < 2:
        faults.append(f"{table.lines} rows of numbers, expected at least 2")
    doubled = _doubled(n for n, _ in names)
    if doubled:
        every = shortened(", ".join(n for n, _ in names), 600)
        faults.append(f"line {table.line}: a column is named twice ({every})")
    width = len(names)
    if table.lines * width > MOST_NUMBERS:
        raise DataError(f"{path}: {table.lines} rows of {width}; {limit_text()}")
    values = np.full((table.lines, width), np.nan)
    numbers = np.zeros(table.lines, dtype=np.intp)
    read = wrong = 0
    for i, (line, row) in enumerate(table.rows):
        numbers[i] = line
        read += 1
        if wrong > 10:
            continue
        if len(row) != width:
            if not any(c.strip() for c in row[width:]) and len(row) > width:
                row = row[:width]  # separators at the end of a row
            else:
                faults.append(f"line {line}: {len(row)} cells, expected {width}")
                wrong += 1
                continue
        for j, cell in enumerate(row):
            if not names[j][0]:
                continue
            number = read_number(cell, table.decimal)
            if number is None:
                got = shortened(repr(cell))
                faults.append(f"line {line}, column {shortened(names[j][0])}: {got} is no number")
                wrong += 1
            else:
                values[i, j] = number
    if read < 2 and not faults:
        faults.append(f"{read} rows of numbers, expected at least 2")
    if faults and told is None:
        raise DataError(fault_text(str(path), faults, most=10))
    columns = Columns(lines=numbers[:read])
    below = table.units or ("",) * width
    for j, ((name, unit), own) in enumerate(zip(names, below, strict=False)):
        if not name:
            continue
        # There are fewer rows than lines if a quoted cell contains line breaks.
        columns.values[name] = values[:read, j]
        stated = unit or spelled_unit(own) or own.strip("[]() ")
        if stated and stated != "-":
            columns.units[name] = stated
        if j < len(table.header) and table.header[j].strip() != name:
            columns.headings[name] = table.header[j].strip()
    return columns


def _doubled(names: Iterable[str]) -> bool:
    named = [n for n in names if n]
    return len(set(named)) < len(named)


def _is_number(cell: str, decimal: str) -> bool:
    return bool(cell.strip()) and read_number(cell, decimal) is not None
