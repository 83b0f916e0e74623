"""Measured data: records, sensors, and their files (CSV, MAT, NetCDF, each with a TOML file)."""

from feltmb.data.files import read, read_record, read_records, write_record
from feltmb.data.frames import records_from_frame
from feltmb.data.joining import Clocks, fit_clocks, join_records
from feltmb.data.records import Array as Array
from feltmb.data.records import InputMode as InputMode
from feltmb.data.records import Integers as Integers
from feltmb.data.records import Record, Sensor, StartPrior
from feltmb.data.records import Reference as Reference
from feltmb.data.records import Role as Role
from feltmb.data.records import evenly_spaced as evenly_spaced
from feltmb.data.sheet import ReadOptions

# The other names are for authors of adapters: feltmb.fit.authoring.
__all__ = [
    "Clocks",
    "ReadOptions",
    "Record",
    "Sensor",
    "StartPrior",
    "fit_clocks",
    "join_records",
    "read",
    "read_record",
    "read_records",
    "records_from_frame",
    "write_record",
]
