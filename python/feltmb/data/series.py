"""Series of one length by name: what a measured file holds before it is a record."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from feltmb.data.records import Array
from feltmb.data.tables import Table, read_number
from feltmb.errors import DataError
from feltmb.units import spelled_unit
from feltmb.units.quantity import fault_text, shortened

__all__ = ["MOST_NUMBERS", "Columns", "columns_of", "limit_text", "plain_name"]

MOST_NUMBERS = 20_000_000  # of a file: 160 MB; reading it takes a few times that


def limit_text() -> str:
    """The limit in words."""
    return f"the limit of a measured file is {MOST_NUMBERS} numbers"


def plain_name(name: str) -> str:
    """A name without what differs between ways to write it (``Hammer_Tip X``, ``hammer_tip.x``)."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


@dataclass
class Columns:
    """Series of one length by name."""

    values: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    """As they stand in the file; a column without one is missing here."""
    left_out: dict[str, str] = field(default_factory=dict)
    """What else the file holds, and why it is no series."""
    headings: dict[str, str] = field(default_factory=dict)
    """Whole heading by name, where it says more."""
    source: str = ""
    """Program that wrote the file, as far as it is known by its form."""
    frames: str = ""
    """Column that counts frames of a camera."""
    likelihood: dict[str, str] = field(default_factory=dict)
    """Column of the likelihood [1] by the column that it belongs to."""
    notes: list[str] = field(default_factory=list)
    """What was assumed of the file."""

    def __str__(self) -> str:
        shown = [shortened(name) for name in self.values]
        out = [f"{shortened(name)} ({why})" for name, why in self.left_out.items()]
        text = shortened(", ".join(shown), 600) or "none"
        return text + (f"; left out: {shortened(', '.join(out), 300)}" if out else "")

    def add(self, name: str, shape: tuple[int, ...]) -> bool:
        """Whether an array of this shape is a series; a number alone is passed over."""
        if math.prod(shape) == max(shape, default=1) and shape:
            return True
        if shape:
            self.left_out[name] = " x ".join(map(str, shape))
        return False

    def only_longest(self) -> None:
        """Keep the series that are as long as the longest."""
        longest = max((v.size for v in self.values.values()), default=0)
        for name in [n for n, v in self.values.items() if v.size != longest]:
            self.left_out[name] = f"{self.values.pop(name).size} values"

    def find(self, *names: str) -> str:
        """Column of the first of these names that is there; "" if none.

        As it stands, by its whole heading, or written in another way.
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


def columns_of(path: Path, table: Table, names: Sequence[tuple[str, str]]) -> Columns:
    """The series of a table whose columns have these names and units; unnamed ones are left out.

    Raises
    ------
    DataError
        With the first faults of the table.
    """
    faults: list[str] = []
    if not table.header or all(_is_number(c, table.decimal) for c in table.header):
        faults.append("line 1 holds numbers, expected the names of the columns")
    if table.lines < 2:
        raise DataError(f"{path}: {table.lines} rows of numbers, expected at least 2")
    doubled = _doubled(n for n, _ in names)
    if doubled:
        every = shortened(", ".join(n for n, _ in names), 600)
        faults.append(f"line 1: a column is named twice ({every})")
    width = len(names)
    if table.lines * width > MOST_NUMBERS:
        raise DataError(f"{path}: {table.lines} rows of {width}; {limit_text()}")
    values = np.full((table.lines, width), np.nan)
    read = wrong = 0
    for i, row in enumerate(table.rows):
        read += 1
        if wrong > 10:
            continue
        if len(row) != width:
            if not any(c.strip() for c in row[width:]) and len(row) > width:
                row = row[:width]  # separators at the end of a row
            else:
                faults.append(f"row {i + 1}: {len(row)} cells, expected {width}")
                wrong += 1
                continue
        for j, cell in enumerate(row):
            if not names[j][0]:
                continue
            number = read_number(cell, table.decimal)
            if number is None:
                got = shortened(repr(cell))
                faults.append(f"row {i + 1}, column {shortened(names[j][0])}: {got} is no number")
                wrong += 1
            else:
                values[i, j] = number
    if read < 2 and not faults:
        faults.append(f"{read} rows of numbers, expected at least 2")
    if faults:
        raise DataError(fault_text(str(path), faults, most=10))
    columns = Columns()
    below = table.units or ("",) * width
    for j, ((name, unit), own) in enumerate(zip(names, below, strict=False)):
        if not name:
            continue
        # Rows are fewer than lines where a cell in quotes goes over several.
        columns.values[name] = values[:read, j]
        told = unit or spelled_unit(own) or own.strip("[]() ")
        if told and told != "-":
            columns.units[name] = told
        if j < len(table.header) and table.header[j].strip() != name:
            columns.headings[name] = table.header[j].strip()
    return columns


def _doubled(names: Iterable[str]) -> bool:
    told = [n for n in names if n]
    return len(set(told)) < len(told)


def _is_number(cell: str, decimal: str) -> bool:
    return bool(cell.strip()) and read_number(cell, decimal) is not None
