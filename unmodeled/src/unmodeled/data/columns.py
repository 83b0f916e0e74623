"""Named columns of numbers in text, MAT (version 5 or 7.3), HDF5 files and tables of programs.

Sizes are checked before data are read. Any exception of a library about a damaged file becomes one
message.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from unmodeled.data.formats import add_block, read_frame, read_messages, reading
from unmodeled.data.instruments import add_stated, read_tdms, without_monitor, workbook_lines
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
_MAT_NUMBERS = {"double", "single"} | {f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)}


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
    columns.only_longest()
    columns.pair_likelihood()
    if strict and (faults := columns.faults()):
        raise DataError(fault_text(str(path), faults, most=10))
    if max((v.size for v in columns.values.values()), default=0) < 2:
        raise DataError(f"{path}: holds no series; there are {columns}")
    return columns


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
    from scipy.io import loadmat, whosmat

    columns = Columns()
    with reading(path, "MAT"):
        _check_elements(data)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for example two arrays with the same name
            listed = whosmat(io.BytesIO(data))
            wanted, total = [], 0
            for name, shape, kind in listed:
                if kind not in _MAT_NUMBERS:
                    columns.left_out[plain_text(name)] = kind
                elif columns.add(plain_text(name), shape):
                    wanted.append(name)
                    total += math.prod(shape)
            few = total <= MOST_NUMBERS
            content = loadmat(io.BytesIO(data), variable_names=wanted) if few else {}
            for name in content.keys() & set(wanted):
                values = np.asarray(content[name], dtype=np.float64).ravel()
                columns.values[plain_text(name)] = values
    if total > MOST_NUMBERS:
        raise DataError(f"{path}: {total} numbers; {limit_text()}")
    return columns


_MAT_PLAIN = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18}  # numbers and texts
_MATRIX, _PACKED = 14, 15
_NESTED = {1, 2, 3, 16, 17}  # classes of arrays that contain arrays
MOST_ELEMENTS = 1_000_000


def _check_elements(data: bytes) -> None:
    """Check the elements of a MAT file of version 5 before scipy reads it.

    Scipy crashes at a data type that does not exist, also in an array that is not wanted, and it
    reads an element over the end of its array. Sizes inside compressed data may be wrong. The data
    are therefore unpacked in parts and counted.
    """
    if len(data) < 128 or data[124:128] not in (b"\x00\x01IM", b"\x01\x00MI"):
        return
    order = "<" if data[126:128] == b"IM" else ">"
    counted = itertools.count(1)
    at, total = 128, 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        at += 8
        content = memoryview(data)[at : at + size]
        if kind == _PACKED:
            unpacker, rest, parts = zlib.decompressobj(), bytes(content), bytearray()
            while rest and not unpacker.eof:
                parts += unpacker.decompress(rest, 1 << 20)
                rest = unpacker.unconsumed_tail
                if total + len(parts) > 8 * MOST_NUMBERS + len(data):
                    raise ValueError(f"unpacks to more than {total} bytes; {limit_text()}")
            total += len(parts)
            if len(parts) < 8:
                raise ValueError(f"the variable at byte {at} is damaged")
            kind, inner = struct.unpack_from(order + "II", parts)
            content = memoryview(parts)[8:]
            if inner > len(content):
                raise ValueError(f"the variable at byte {at} ends too early")
            content = content[:inner]
        if kind != _MATRIX:
            raise ValueError(f"byte {at}: data type {kind}, expected an array (14)")
        _check_array(content, order, counted, at)
        at += size


def _check_array(content: memoryview, order: str, counted: Iterator[int], place: int) -> None:
    """Check the data types and sizes of the elements of an array."""
    open_arrays = [content]
    while open_arrays:
        array = open_arrays.pop()
        at, nested = 0, False
        while at + 8 <= len(array):
            if next(counted) > MOST_ELEMENTS:
                raise ValueError(f"more than {MOST_ELEMENTS} elements, which is the limit")
            kind, size = struct.unpack_from(order + "II", array, at)
            begin = at + 8
            if kind >> 16:  # a small element: size and type in four bytes
                kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
            small = begin == at + 4
            if kind not in _MAT_PLAIN and not (kind == _MATRIX and nested and not small):
                raise ValueError(
                    f"variable at byte {place}: an element has data type {kind}, which does not "
                    "exist there"
                )
            if begin + size > len(array) or (small and size > 4):
                raise ValueError(f"variable at byte {place}: an element exceeds its array")
            if at == 0 and size:
                (flags,) = struct.unpack_from(order + "I", array, begin) if size >= 4 else (0,)
                nested = flags & 0xFF in _NESTED
            if kind == _MATRIX:
                open_arrays.append(array[begin : begin + size])
            at = at + 8 if small else begin + size + -size % 8


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
        if not table and not columns.add(name, item.shape):
            continue
        total += math.prod(item.shape)
        if total > MOST_NUMBERS:
            raise DataError(f"more than {MOST_NUMBERS} numbers; {limit_text()}")
        values = np.array(item.read(), dtype=np.float64)
        if table and add_block(columns, name, values):
            continue
        values = values.ravel()
        for key in ("_FillValue", "missing_value"):
            fill = _attribute(item, key, faults)
            if fill is not None:
                values[values == fill] = np.nan
        gain = _attribute(item, "scale_factor", faults)
        shift = _attribute(item, "add_offset", faults)
        with np.errstate(over="ignore"):  # the record reports infinite values
            if gain is not None:
                values *= gain
            if shift is not None:
                values += shift
        columns.values[name] = values
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
    ".mcap": read_messages,
    ".tdms": read_tdms,
}
#: Endings of the files that can be read.
MEASURED_FILES = (*_TABLES, *READERS)
