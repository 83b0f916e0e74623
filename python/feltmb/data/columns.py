"""Named columns of numbers in CSV, MAT (version 5 or 7.3) and NetCDF files.

Nothing from a file is taken on trust: sizes are looked at before anything is read, and whatever a
library says of a damaged file becomes one message.
"""

from __future__ import annotations

import csv
import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.data.records import Array
from feltmb.errors import DataError
from feltmb.files import is_file, plain_text, why_missing
from feltmb.files.hdf5 import HDF5_FAULTS, open_hdf5
from feltmb.units.quantity import fault_text, shortened

__all__ = ["MOST_NUMBERS", "Columns", "read_columns"]

MOST_NUMBERS = 50_000_000  # of a file: 400 MB
LARGEST_TEXT = 500_000_000  # bytes of a CSV file
_HEADER = re.compile(r"^\s*(.*?)\s*(?:\[\s*(.*?)\s*\])?\s*$", re.DOTALL)
_MISSING = ("", "nan", "NaN", "NA")
_MAT_NUMBERS = {"double", "single"} | {f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)}


@dataclass
class Columns:
    """Series of one length by name."""

    values: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    """As they stand in the file; a column without one is missing here."""
    left_out: dict[str, str] = field(default_factory=dict)
    """What else the file holds, and why it is no series."""

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


def read_columns(path: Path) -> Columns:
    """Read all series of a file.

    Raises
    ------
    DataError
        The file cannot be read, holds no series, or is beyond the limits of size.
    """
    kind = path.suffix.lower()
    readers = {".csv": _read_csv, ".txt": _read_csv, ".mat": _read_mat, ".nc": _read_netcdf}
    if kind not in readers:
        raise DataError(f"{path}: cannot read {kind or 'this'}; expected .csv, .mat or .nc")
    if not is_file(path):
        raise DataError(f"{path}: {why_missing(path)}")
    columns = readers[kind](path)
    if kind in (".mat", ".nc"):
        columns.only_longest()
        if max((v.size for v in columns.values.values()), default=0) < 2:
            raise DataError(f"{path}: holds no series; there are {columns}")
    return columns


# ---------------------------------------------------------------- CSV


def _read_csv(path: Path) -> Columns:
    try:
        size = path.stat().st_size
        if size > LARGEST_TEXT:
            raise DataError(f"{path}: {size} bytes; the limit is {LARGEST_TEXT}")
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is no UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 3:
        raise DataError(f"{path}: {len(lines)} lines, expected a header and at least 2 samples")
    separator = max(",;\t", key=lines[0].count)
    try:
        rows = list(csv.reader(lines, delimiter=separator))
    except csv.Error as error:
        raise DataError(f"{path}: is no table: {error}") from None
    faults: list[str] = []
    columns = Columns()
    names = []
    for cell in rows[0]:
        match = _HEADER.match(cell)
        assert match is not None
        names.append(match[1])
        if match[2]:
            columns.units[match[1]] = match[2]
    if len(set(names)) < len(names):
        faults.append(f"line 1: a column is named twice ({', '.join(names)})")
    if all(_is_number(c) for c in rows[0]):
        faults.append("line 1 holds numbers, expected the names of the columns")
    if (len(rows) - 1) * len(names) > MOST_NUMBERS:
        raise DataError(f"{path}: {len(rows) - 1} rows of {len(names)}; {_limit()}")
    values = np.full((len(rows) - 1, len(names)), np.nan)
    for i, row in enumerate(rows[1:]):
        if len(row) != len(names):
            faults.append(f"row {i + 1}: {len(row)} cells, expected {len(names)}")
            continue
        for j, cell in enumerate(row):
            if cell.strip() in _MISSING:
                continue
            try:
                values[i, j] = float(cell)
            except ValueError:
                got = shortened(repr(cell))
                faults.append(f"row {i + 1}, column {shortened(names[j])}: {got} is no number")
    if faults:
        raise DataError(fault_text(str(path), faults, most=10))
    columns.values = {n: values[:, j] for j, n in enumerate(names) if n}
    return columns


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _limit() -> str:
    return f"the limit of a measured file is {MOST_NUMBERS} numbers"


# ---------------------------------------------------------------- MAT


def _read_mat(path: Path) -> Columns:
    import h5py

    if h5py.is_hdf5(path):
        return _read_hdf5(path, "MAT")
    from scipy.io import loadmat, whosmat

    columns = Columns()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as two arrays of one name
            listed = whosmat(str(path))
            wanted, total = [], 0
            for name, shape, kind in listed:
                if kind not in _MAT_NUMBERS:
                    columns.left_out[plain_text(name)] = kind
                elif columns.add(plain_text(name), shape):
                    wanted.append(name)
                    total += math.prod(shape)
            content = loadmat(str(path), variable_names=wanted) if total <= MOST_NUMBERS else {}
            for name in content.keys() & set(wanted):
                values = np.asarray(content[name], dtype=np.float64).ravel()
                columns.values[plain_text(name)] = values
    except Exception as error:  # scipy states no set of what it raises for a damaged file
        reason = shortened(plain_text(str(error) or type(error).__name__), 200)
        raise DataError(f"{path}: cannot be read as MAT: {reason}") from None
    if total > MOST_NUMBERS:
        raise DataError(f"{path}: {total} numbers; {_limit()}")
    return columns


# ---------------------------------------------------------------- NetCDF


def _read_netcdf(path: Path) -> Columns:
    return _read_hdf5(path, "NetCDF 4")


def _read_hdf5(path: Path, kind: str) -> Columns:
    try:
        with open_hdf5(path) as file:
            return _series(file)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    except HDF5_FAULTS as error:
        reason = shortened(plain_text(str(error)), 200)
        raise DataError(f"{path}: cannot be read as {kind}: {reason}") from None


def _datasets(file: Any) -> Iterator[tuple[str, Any]]:
    """Arrays that the file itself holds: a link could lead into any other file."""
    import h5py

    for name in file:
        if isinstance(file.get(name, getlink=True), h5py.HardLink):
            item = file[name]
            if isinstance(item, h5py.Dataset) and not item.external and not item.is_virtual:
                yield plain_text(str(name)), item


def _series(file: Any) -> Columns:
    columns = Columns()
    total = 0
    faults: list[str] = []
    for name, item in _datasets(file):
        if item.shape is None or item.dtype.kind not in "fiu":
            columns.left_out[name] = "no numbers"
            continue
        if not columns.add(name, item.shape):
            continue
        total += item.size
        if total > MOST_NUMBERS:
            raise DataError(f"more than {MOST_NUMBERS} numbers; {_limit()}")
        values = np.array(item, dtype=np.float64).ravel()
        for key in ("_FillValue", "missing_value"):
            fill = _attribute(item, name, key, faults)
            if fill is not None:
                values[values == fill] = np.nan
        gain = _attribute(item, name, "scale_factor", faults)
        shift = _attribute(item, name, "add_offset", faults)
        with np.errstate(over="ignore"):  # an infinite number is told of by the record
            columns.values[name] = values * (1.0 if gain is None else gain) + (shift or 0.0)
        unit = item.attrs.get("units")
        if unit is not None:
            columns.units[name] = plain_text(unit)
    if faults:
        raise DataError("; ".join(faults))
    return columns


def _attribute(item: Any, name: str, key: str, faults: list[str]) -> float | None:
    """Number of an attribute, None if it is not there."""
    value = item.attrs.get(key)
    if value is None:
        return None
    flat = np.ravel(value)
    if flat.size == 1 and flat.dtype.kind in "fiu":
        return float(flat[0])
    faults.append(f"{name}: {key} = {shortened(repr(value))}, expected a number")
    return None
