"""Curves over time without a simulation: measured, or from another program."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from feltmb.errors import DataError, InvalidParameter
from feltmb.files import read_text
from feltmb.units import conversion_factor
from feltmb.units.quantity import fault_text, split_heading

Array = npt.NDArray[np.float64]

__all__ = ["Curves", "read_curves"]

LARGEST_FILE = 100_000_000  # bytes
MOST_COLUMNS = 1000
LONGEST = 1e9  # s


@dataclass(frozen=True)
class Curves:
    """Named curves with a common time axis.

    Attributes
    ----------
    name : str
        Name for people.
    time : ndarray (n,)
        Times [s], increasing.
    values : dict
        Output -> samples (n,) in SI units; NaN is missing. A curve is compared with the output of a
        run that has the same name.
    units : dict
        Output -> SI unit; an output without one has the unit 1.

    Raises
    ------
    DataError
        Lengths differ, times do not increase, or there is nothing to show.
    """

    name: str
    time: Array
    values: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = np.asarray(self.time, dtype=float).ravel()
        values = {str(k): np.asarray(v, dtype=float).ravel() for k, v in self.values.items()}
        faults = []
        if time.size < 2 or not np.all(np.isfinite(time)) or not np.all(np.diff(time) > 0):
            faults.append(f"time: {time.size} samples, expected two or more finite times that grow")
        elif np.abs(time).max() > LONGEST:
            faults.append(f"time: {np.abs(time).max():g} s; the limit is {LONGEST:g} s")
        if not values:
            faults.append("there is no curve")
        for name, column in values.items():
            if column.size != time.size:
                faults.append(f"{name}: {column.size} samples, the clock has {time.size}")
        if faults:
            raise DataError(fault_text(self.name, faults, most=20))
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "values", values)


def _si_unit(unit: str) -> tuple[float, str]:
    """Factor and SI unit of a unit; an unknown unit, such as V, is kept."""
    for si in ("1", "m", "s", "rad", "N", "J", "m/s", "rad/s", "m/s^2", "rad/s^2", "Pa", "Hz"):
        try:
            return conversion_factor(unit, si), si
        except InvalidParameter:
            continue
    return 1.0, unit


def read_curves(path: str | Path) -> Curves:
    """Read a CSV file with a header such as ``time [ms],hammer_tip.vx [m/s]`` and numbers.

    Units are converted to SI. Lines that begin with ``#`` are ignored; an empty cell is missing.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message, with line numbers.
    """
    path = Path(path)
    text = read_text(path, most=LARGEST_FILE)
    lines = [
        (number, line)
        for number, line in enumerate(io.StringIO(text, newline=None), start=1)
        if line.strip() and not line.startswith("#")
    ]
    names, units, factors, faults = _header(lines[0][1] if lines else "")
    rows = []
    for number, line in lines[1:]:
        try:
            cells = next(csv.reader([line.replace("\0", "")]), [])
        except csv.Error as error:  # for example a cell of more than 131 072 letters
            faults.append(f"line {number}: {error}")
            continue
        if names and len(cells) != len(names):
            faults.append(f"line {number}: {len(cells)} cells, expected {len(names)}")
            continue
        row = []
        for name, cell in zip(names, cells, strict=False):
            row.append(_number(cell))
            if row[-1] is None:
                faults.append(f"line {number}: {name} is {cell.strip()[:40]!r}, expected a number")
        rows.append([math.nan if x is None else x for x in row])
    if len(rows) < 2 and not faults:
        faults.append(f"{len(rows)} rows of numbers, expected 2 or more")
    if faults:
        raise DataError(fault_text(str(path), faults, most=20))
    table = np.array(rows) * np.array(factors)
    bad = np.flatnonzero(~np.isfinite(table[:, 0]) | (np.diff(table[:, 0], prepend=-np.inf) <= 0))
    if bad.size:
        where = [f"line {lines[1 + int(i)][0]}: time does not grow" for i in bad]
        raise DataError(fault_text(str(path), where, most=20))
    return Curves(
        path.stem,
        table[:, 0],
        {name: table[:, k] for k, name in enumerate(names) if k > 0},
        {name: units[k] for k, name in enumerate(names) if k > 0},
    )


def _number(cell: str) -> float | None:
    """Value of a cell: NaN if empty, None if not a finite number."""
    if not cell.strip():
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _header(line: str) -> tuple[list[str], list[str], list[float], list[str]]:
    """Names, SI units and factors of the columns, and the faults of the header."""
    wanted = "expected a header such as 'time [s],hammer_tip.vx [m/s]'"
    try:
        cells = next(csv.reader([line.replace("\0", "")]), [])
    except csv.Error as error:
        return [], [], [], [f"header: {error}"]
    if len(cells) > MOST_COLUMNS:
        return [], [], [], [f"header: {len(cells)} columns; the limit is {MOST_COLUMNS}"]
    names, units, factors, faults = [], [], [], []
    for k, cell in enumerate(cells):
        name, stated = split_heading(cell)
        if not name or "[" in name or "]" in f"{name}{stated or ''}":
            faults.append(f"header: column {k + 1} is {cell.strip()[:40]!r}, {wanted}")
        factor, unit = _si_unit(stated or "1")
        if k == 0:
            if name.lower() != "time" or unit != "s":
                faults.append(f"header: the first column is {cell.strip()[:40]!r}, {wanted}")
        elif name in names:
            faults.append(f"header: column {name[:40]!r} comes twice")
        names.append(name)
        units.append(unit)
        factors.append(factor)
    if len(cells) < 2 and not faults:
        faults.append(f"header: got {line.strip()[:60]!r}, {wanted}")
    return names, units, factors, faults
