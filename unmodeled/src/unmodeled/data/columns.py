"""Named columns of numbers in text, MAT (version 5 or 7.3), HDF5 files and tables of programs.

Sizes are checked before data are read. Any exception of a library about a damaged file becomes one
message.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from unmodeled.data.bags import read_messages
from unmodeled.data.formats import (
    MOST_COLUMNS,
    add_block,
    read_frame,
    read_json_table,
    reading,
)
from unmodeled.data.instruments import add_stated, read_tdms, without_monitor, workbook_lines
from unmodeled.data.mat import mat_variables
from unmodeled.data.records import Array
from unmodeled.data.series import MOST_NUMBERS, Columns, columns_of, limit_text
from unmodeled.data.tables import read_number, read_table, text_lines
from unmodeled.data.trackers import read_tracked
from unmodeled.errors import DataError, shortened
from unmodeled.files import LARGEST_TABLE, plain_text, read_input
from unmodeled.files.hdf5 import HDF5_FAULTS, Hdf5Dataset, Hdf5File, open_hdf5
from unmodeled.units import split_column
from unmodeled.units.quantity import fault_text

_TEXTS = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm", ".mot", ".sto", ".tra")
#: Tables of text cells: texts, and workbooks.
_TABLES = (*_TEXTS, ".xlsx")

#: Name of a first column without a name, and headings that are no names (the second is of pandas).
FIRST = "column 1"
_UNNAMED = re.compile(r"\s*|Unnamed: ?0")

LARGEST_MAT = 500_000_000  # bytes of a MAT file of version 5


def read_columns(path: Path, *, strict: bool = True, numbered: bool = False) -> Columns:
    """Read all series of a file.

    ``strict``: refuse a text with faults in any row; else :meth:`Columns.faults` tells them.
    ``numbered``: the columns of a text without a header are called 1, 2, ...

    Raises
    ------
    DataError
        The file cannot be read, has no series, exceeds the size limits, or has faults in its rows.
    """
    kind = path.suffix.lower()
    if kind in _TABLES:
        columns = _read_text(path, numbered=numbered)
        columns.pair_likelihood()
        if strict and (faults := columns.faults()):
            raise DataError(fault_text(str(path), faults, most=10))
        return columns
    if kind not in READERS:
        expected = ", ".join(MEASURED_FILES)
        raise DataError(f"{path}: cannot read {kind or 'this'}; expected {expected}")
    columns = READERS[kind](path)
    columns.split_names()
    _split_matrices(columns)
    columns.only_longest()
    columns.pair_likelihood()
    if strict and (faults := columns.faults()):
        raise DataError(fault_text(str(path), faults, most=10))
    if max((v.size for v in columns.values.values()), default=0) < 2:
        raise DataError(f"{path}: holds no series; there are {columns}")
    return columns


def _split_matrices(columns: Columns) -> None:
    """A matrix with one side as long as the clock becomes a series for each row of the other."""
    clocks = [columns.values[n] for n in columns.called("time")]
    length = max((v.size for v in clocks or columns.values.values()), default=0)
    for name, values in columns.matrices.items():
        along = [axis for axis, n in enumerate(values.shape) if n == length]
        rows = values if along == [0] else values.T
        if len(along) == 1 and length > 1 and add_block(columns, name, rows):
            columns.left_out.pop(name, None)


# ---------------------------------------------------------------- text


def _read_text(path: Path, *, numbered: bool) -> Columns:
    notes: list[str] = []
    if path.suffix.lower() == ".xlsx":
        lines, notes = workbook_lines(path)
    else:
        lines = text_lines(read_input(path, most=LARGEST_TABLE), path)
    try:
        tracked = read_tracked(path, lines)
    except csv.Error as error:
        raise DataError(f"{path}: is no table: {error}") from None
    if tracked is not None:
        return tracked
    lines = lines.where(lambda line: not line.startswith("#"))
    if len(lines) < 3:
        text = "1 line" if len(lines) == 1 else f"{len(lines)} lines"
        raise DataError(f"{path}: {text}, expected a header and at least 2 samples")
    try:
        table = read_table(without_monitor(lines), tests=True)
        row = next(table.rows, (0, list[str]()))
        table = replace(table, rows=itertools.chain([row], table.rows))
        numbers = [bool(c.strip()) and read_number(c, table.decimal) is not None
                   for c in table.header]  # fmt: skip
        headless = all(numbers) or (numbered and len(numbers) != len(row[1]))
        if headless and not numbered:
            raise DataError(
                f"{path}: line {table.line} holds numbers, expected the names of the columns; "
                "columns without names have the numbers 1, 2, ... (--column NAME=2, with "
                "--unit NAME=UNIT, or column in the TOML beside the file)"
            )
        if headless:
            return columns_of(path, table, [(str(j + 1), "") for j in range(len(row[1]))])
        names = [split_column(plain_text(c)) for c in table.header]
        unnamed = bool(names) and _UNNAMED.fullmatch(names[0][0]) is not None
        if unnamed:
            names[0] = FIRST, names[0][1]
        columns = columns_of(path, table, names)
    except csv.Error as error:
        raise DataError(f"{path}: is no table: {error}") from None
    columns.notes += notes
    add_stated(columns, table)
    if unnamed:
        columns.take_unnamed(FIRST)
    return columns


# ---------------------------------------------------------------- MAT


_HDF5 = b"\x89HDF\r\n\x1a\n"


def _read_mat(path: Path) -> Columns:
    data = read_input(path, most=LARGEST_MAT)
    if any(data[at : at + 8] == _HDF5 for at in (0, 512, 1024, 2048)):  # after a user block
        return _read_hdf5(path, "MAT")
    columns = Columns()
    with reading(path, "MAT"):
        for name, values, why in mat_variables(data):
            name = plain_text(name)
            if name in columns.values or name in columns.left_out:
                raise ValueError(f"{name} is there twice")
            if why:
                columns.left_out[name] = why
            elif columns.add(name, values.shape):
                columns.values[name] = values.ravel()
            elif values.ndim == 2:
                columns.matrices[name] = values
    return columns


# ---------------------------------------------------------------- NetCDF and HDF5


def _read_netcdf(path: Path) -> Columns:
    return _read_hdf5(path, "NetCDF 4")


def _read_groups(path: Path) -> Columns:
    return _read_hdf5(path, "HDF5", groups=True)


def _read_hdf5(path: Path, kind: str, *, groups: bool = False) -> Columns:
    try:
        with open_hdf5(path, most_bytes=8 * MOST_NUMBERS) as file:
            return _series(file, groups=groups)
    except DataError as error:
        text = str(error)
        raise DataError(text if text.startswith(f"{path}: ") else f"{path}: {text}") from None
    except HDF5_FAULTS as error:
        reason = shortened(plain_text(str(error)), 200)
        raise DataError(f"{path}: cannot be read as {kind}: {reason}") from None


def _unpacked(values: Array, item: Hdf5Dataset, faults: list[str]) -> Array:
    """Values by the attributes of a packed series."""
    fills = [_attribute(item, key, faults) for key in ("_FillValue", "missing_value")]
    for fill in fills:
        if fill is not None:
            values[values == fill] = np.nan
    gain = _attribute(item, "scale_factor", faults)
    shift = _attribute(item, "add_offset", faults)
    with np.errstate(over="ignore"):  # the record reports infinite values
        values = values if gain is None else values * gain
        return values if shift is None else values + shift


def _series(file: Hdf5File, *, groups: bool) -> Columns:
    """Series of a file; ``groups``: also those in groups, and the columns of tables (n, k)."""
    columns = Columns()
    total = 0
    faults: list[str] = []
    for item in file.datasets(groups=groups):
        name = item.name
        if not item.is_numbers or item.shape is None:
            columns.left_out[name] = "no numbers"
            continue
        table = groups and len(item.shape) == 2 and 1 < item.shape[1] < item.shape[0]
        series = table or columns.add(name, item.shape)
        size = math.prod(item.shape)
        matrix = len(item.shape) == 2 and 1 < min(item.shape) <= MOST_COLUMNS
        if not series and not (matrix and total + size <= MOST_NUMBERS):
            continue
        total += size
        if total > MOST_NUMBERS:
            raise DataError(f"more than {MOST_NUMBERS} numbers; {limit_text()}")
        values = np.array(item.read(), dtype=np.float64)
        if not series:
            columns.matrices[name] = values
        if not series or (table and add_block(columns, name, values)):
            continue
        values = values.ravel()
        columns.values[name] = _unpacked(values, item, faults)
        unit = item.attribute("units")
        if unit is not None:
            columns.units[name] = plain_text(unit)
    columns.left_out |= file.left_out
    if faults:
        raise DataError("; ".join(faults))
    return columns


def _attribute(item: Hdf5Dataset, key: str, faults: list[str]) -> float | None:
    """Number of an attribute; None if it does not exist."""
    value = item.attribute(key)
    if value is None:
        return None
    flat = np.ravel(value)
    if flat.size == 1 and flat.dtype.kind in "fiu":
        return float(flat[0])
    faults.append(f"{item.name}: {key} = {shortened(repr(value))}, expected a number")
    return None


#: Reader by the ending of the file, for all but text.
READERS: dict[str, Callable[[Path], Columns]] = {
    ".mat": _read_mat,
    ".nc": _read_netcdf,
    ".h5": _read_groups,
    ".hdf5": _read_groups,
    ".parquet": read_frame,
    ".feather": read_frame,
    ".json": read_json_table,
    ".jsonl": read_json_table,
    ".mcap": read_messages,
    ".db3": read_messages,
    ".tdms": read_tdms,
}
#: Endings of the files that can be read.
MEASURED_FILES = (*_TABLES, *READERS)
