"""Columns of compression tests: text files of testing machines, with units in the header."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feltmb.data.tables import are_units, numbered_rows, read_number, style_of, text_lines
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import LARGEST_TABLE, plain_text, read_text
from feltmb.units import conversion_factor, dimension_text, spelled_unit, split_column
from feltmb.units.quantity import shortened

__all__ = ["CompressionColumns", "listed_faults", "read_columns"]

Array = NDArray[np.float64]

#: column -> SI unit of the computed quantity
_UNITS = {
    "v_f": "1",
    "strain": "1",
    "thickness": "m",
    "displacement": "m",
    "pressure": "Pa",
    "force": "N",
    "branch": "1",
}
#: column -> other names, in lower case
_NAMES = {
    "thickness": "gap height dicke höhe",
    "displacement": "extension travel position compression weg traverse standardweg",
    "strain": "dehnung stauchung",
    "pressure": "stress druck spannung",
    "force": "load kraft standardkraft",
}
_COLUMNS = {word: key for key, words in _NAMES.items() for word in words.split()}
_FRACTIONS = ("v_f", "strain", "thickness")
_LOADS = ("pressure", "force")
#: Number of lines above the header that may be a preamble.
_PREAMBLE = 200


@dataclass(frozen=True)
class CompressionColumns:
    """Compression and load of a test, in the order of the file."""

    compression: str
    """v_f, strain, thickness or displacement."""
    load: str
    """pressure or force."""
    x: Array
    """Values of the compression [1 or m]."""
    loads: Array
    """Values of the load [Pa or N], compression positive."""
    branches: list[str]
    """Words loading and unloading; empty if the file has no column for them."""
    faults: list[str]
    """Faults of rows. If there are any, the arrays are incomplete."""


def listed_faults(faults: Sequence[str], most: int = 20) -> str:
    """Faults of a file as lines of a message."""
    more = [f"... and {len(faults) - most} more"] if len(faults) > most else []
    return "\n".join([*(plain_text(shortened(f, 1000)) for f in faults[:most]), *more])


def _column_of(title: str) -> tuple[str, str]:
    """Column of a heading, or its name if it is none, and the unit that it states."""
    name, unit = split_column(title.replace("(", "[").replace(")", "]"))
    key = name.lower().replace(" ", "_")
    return _COLUMNS.get(key, key), unit


def _header_of(table: Sequence[tuple[int, list[str]]]) -> int:
    """Index of the first row with a compression and a load; 0 if there is none."""
    for i, (_, cells) in enumerate(table[:_PREAMBLE]):
        keys = {_column_of(cell.strip())[0] for cell in cells}
        if keys & {*_FRACTIONS, "displacement"} and keys & set(_LOADS):
            return i
    return 0


def read_columns(file: Path) -> CompressionColumns:
    """Read the columns of a test.

    Raises
    ------
    DataError
        The header has faults; all of them are in the message.
    """
    data = read_text(file, most=LARGEST_TABLE).encode()
    lines = text_lines(data, file).where(lambda line: not line.lstrip().startswith("#"))
    faults: list[str] = []

    def fault(message: str) -> None:
        faults.append(f"{file}: {message}")

    if not len(lines):
        raise DataError(f"{file}: is empty, expected a header line with units and data")
    try:
        separator, decimal = style_of(lines)
        table = list(numbered_rows(lines, separator))
    except csv.Error as error:  # for example a cell of more than 131 072 letters
        raise DataError(f"{file}: {error}") from None
    start = _header_of(table)
    number, header = table[start][0], [h.strip() for h in table[start][1]]
    # The units may be in a line of their own.
    below = [c.strip() for c in table[start + 1][1]] if start + 1 < len(table) else []
    units = below if len(below) == len(header) and are_units(below) else []
    columns: dict[str, tuple[int, float]] = {}
    for position, title in enumerate(header):
        key, stated = _column_of(title)
        unit = stated or (spelled_unit(units[position]) or units[position] if units else "")
        if key not in _UNITS:
            continue
        if key in columns:
            fault(f'line {number}: column "{key}" appears twice, expected once')
        try:
            columns[key] = (position, conversion_factor(unit, _UNITS[key]))
        except InvalidParameter:
            si = _UNITS[key]
            expected = "-, %" if si == "1" else dimension_text(si)
            fault(
                f'line {number}: column "{title}" has unit "{unit}", expected one of {expected} '
                f'(write it as "{key} [{expected.split(", ")[0]}]")'
            )
            continue
    fractions = [c for c in _FRACTIONS if c in columns]
    if not fractions and "displacement" in columns:
        fractions = ["displacement"]
    loads = [c for c in _LOADS if c in columns]
    seen = shortened(", ".join(f'"{h}"' for h in header), 300)
    if len(fractions) != 1 and not faults:
        fault(
            f"line {number}: columns {seen}, expected exactly one of v_f, strain, thickness, or a "
            "displacement"
        )
    if len(loads) != 1 and not faults:
        fault(f"line {number}: columns {seen}, expected exactly one of pressure, force")
    if faults:
        raise DataError(listed_faults(faults))

    fraction, load = fractions[0], loads[0]
    rows: list[tuple[float, float]] = []
    branches: list[str] = []
    for number, cells in table[start + (2 if units else 1) :]:
        values = []
        for key in (fraction, load):
            position, scale = columns[key]
            cell = cells[position].strip() if position < len(cells) else ""
            value = read_number(cell, decimal)
            if value is None or not cell:
                sign = "comma" if decimal == "," else "point"
                hint = (
                    f" (decimal {sign} expected)" if re.fullmatch(r"-?\d++[,.]\d++", cell) else ""
                )
                fault(f'line {number}: {key} = "{cell}", expected a number{hint}')
                continue
            if not math.isfinite(value):
                fault(f"line {number}: {key} = {cell}, expected a finite number")
                continue
            values.append(value * scale)
        if "branch" in columns:
            position = columns["branch"][0]
            word = cells[position].strip().lower() if position < len(cells) else ""
            if word not in ("loading", "unloading"):
                fault(f'line {number}: branch = "{word}", expected loading or unloading')
            branches.append(word)
        if len(values) == 2:
            rows.append((values[0], values[1]))
    if len(rows) < 3 and not faults:
        fault(f"{len(rows)} samples, expected at least 3")
    given = np.array(rows).reshape(-1, 2)
    x, p = given[:, 0], given[:, 1]
    if not faults and not np.max(p) > max(0.0, -np.min(p)):
        fault(
            f"{load} from {np.min(p):.4g} to {np.max(p):.4g} {_UNITS[load]}, expected compression "
            "to be positive"
        )
    elif fraction == "displacement" and not faults and np.sum((x - np.mean(x)) * p) < 0.0:
        fault("displacement decreases with the load, expected compression to be positive")
    return CompressionColumns(fraction, load, x, p, branches, faults)
