"""Measured data: records, sensors, and their files (CSV, MAT, NetCDF, each with a TOML file)."""

from feltmb.data.files import read, read_record, read_records, write_record
from feltmb.data.frames import records_from_frame
from feltmb.data.joining import Clocks, fit_clocks, join_records
from feltmb.data.records import (
    Array,
    InputMode,
    Integers,
    Record,
    Reference,
    Role,
    Sensor,
    StartPrior,
    evenly_spaced,
)
from feltmb.data.sheet import ReadOptions

__all__ = [
    "Array",
    "Clocks",
    "InputMode",
    "Integers",
    "ReadOptions",
    "Record",
    "Reference",
    "Role",
    "Sensor",
    "StartPrior",
    "evenly_spaced",
    "fit_clocks",
    "join_records",
    "read",
    "read_record",
    "read_records",
    "records_from_frame",
    "write_record",
]
