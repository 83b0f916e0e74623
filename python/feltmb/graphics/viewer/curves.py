"""Curves over time without a simulation: measured, or from another program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from unmodeled.arguments import checked
from unmodeled.chain import true_value
from unmodeled.data import ReadOptions, Record
from unmodeled.data.columns import read_columns
from unmodeled.data.files import read_each, read_sheet
from unmodeled.data.mapping import clock_column, unit_of_column
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.units import to_si
from unmodeled.units.quantity import fault_text

Array = npt.NDArray[np.float64]

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
    notes : tuple of str
        Assumptions of the reader.

    Raises
    ------
    DataError
        Lengths differ, times do not increase, or there is nothing to show.
    """

    name: str
    time: Array
    values: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

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
    """Factor and SI unit of a unit; an unknown unit is kept."""
    try:
        return to_si(unit)
    except InvalidParameter:
        return 1.0, unit


@checked
def read_curves(path: str | Path, options: ReadOptions | None = None) -> Curves:
    """Read a file with the columns ``time [ms]`` and, for example, ``hammer_tip.vx [m/s]``.

    With a TOML file of the same name, or with options, the file is read as a measured record
    (:func:`unmodeled.data.read_record`): names, columns, units, scales and origins. Gain, offset
    and delay of a sensor that the TOML file states are removed, so that the curve is that of the
    machine. Otherwise every column is a curve. Units are converted to SI. An empty cell is missing.

    Parameters
    ----------
    path
        File, in the formats of measured records.
    options
        Options of reading, which replace the TOML file or the header.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message, with line numbers.
    """
    found = read_each_run(Path(path), options)
    if len(found) > 1:
        raise DataError(f"{path}: holds {len(found)} runs, expected one; feltmb view shows all")
    return found[0]


@checked
def read_each_run(path: Path, options: ReadOptions | None = None) -> tuple[Curves, ...]:
    """Curves of each run of a file; see :func:`read_curves`."""
    options = options or ReadOptions()
    if read_sheet(path) is None and options == ReadOptions():
        return (_plain_curves(path),)
    (records,) = read_each([path], options=options)
    return tuple(_of_record(record) for record in records)


def _of_record(record: Record) -> Curves:
    """Curves of a record, without the errors of the sensors that are known."""
    values, units = dict(record.inputs), dict(record.input_units)
    for name, reading in record.outputs.items():
        sensor = record.sensors[name]
        known = {fault: size for fault, size in sensor.known.items() if fault != "lag"}
        truth = true_value(record, reading, known)
        moments = record.time + sensor.delay
        within = (moments >= record.time[0]) & (moments <= record.time[-1])
        values[name] = np.where(within, truth, np.nan)
        units[name] = sensor.unit
    return Curves(record.name, record.time, values, units, tuple(record.notes))


def _plain_curves(path: Path) -> Curves:
    """Every column of a file as a curve."""
    columns = read_columns(path, strict=False)
    faults = columns.faults()
    clock = clock_column(columns, guess=False)
    if not clock:
        faults.append(
            f"expected a column time [s]; there are {columns} (--column time=COLUMN or "
            "--frame-rate, in Python ReadOptions)"
        )
    if len(columns.values) > MOST_COLUMNS:
        faults.append(f"{len(columns.values)} columns; the limit is {MOST_COLUMNS}")
    values, units = {}, {}
    for name, column in columns.values.items():
        factor, units[name] = _si_unit(unit_of_column(columns, name) or "1")
        values[name] = column * factor
    if clock and units.pop(clock) not in ("s", "1"):
        faults.append(f"column {clock}: unit {columns.units[clock]!r}, expected a unit of time")
    if not faults:
        time = values.pop(clock)
        wrong = ~np.isfinite(time) | (np.diff(time, prepend=-np.inf) <= 0.0)
        faults += [f"{columns.place(int(i))}: time does not grow" for i in np.flatnonzero(wrong)]
        faults += [
            f"{columns.place(int(i))}: {name} is infinite, expected a finite number or none"
            for name, column in values.items()
            for i in np.flatnonzero(np.isinf(column))
        ]
    if faults:
        raise DataError(fault_text(str(path), faults, most=20))
    return Curves(path.stem, time, values, units)
