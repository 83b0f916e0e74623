"""Measured data: records, sensors, and their files (CSV, MAT, NetCDF with a TOML beside them)."""

from feltmb.data.files import read_record, read_records, write_record
from feltmb.data.records import Array, InputMode, Record, Role, Sensor, StartPrior

__all__ = [
    "Array",
    "InputMode",
    "Record",
    "Role",
    "Sensor",
    "StartPrior",
    "read_record",
    "read_records",
    "write_record",
]
