"""Measured data: records, sensors, and their files (CSV, MAT, NetCDF, each with a TOML file)."""

from feltmb.data.files import read_record, read_records, write_record
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
    "InputMode",
    "Integers",
    "ReadOptions",
    "Record",
    "Reference",
    "Role",
    "Sensor",
    "StartPrior",
    "evenly_spaced",
    "read_record",
    "read_records",
    "write_record",
]
