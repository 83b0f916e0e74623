"""Measured data: records, sensors, and their files (CSV, MAT, NetCDF, each with a TOML file)."""

from unmodeled.data.files import read, read_record, read_records, write_record
from unmodeled.data.frames import records_from_frame
from unmodeled.data.joining import Clocks, fit_clocks, join_records
from unmodeled.data.records import Array as Array
from unmodeled.data.records import InputMode as InputMode
from unmodeled.data.records import Integers as Integers
from unmodeled.data.records import Record, Sensor, StartPrior
from unmodeled.data.records import Reference as Reference
from unmodeled.data.records import Role as Role
from unmodeled.data.records import evenly_spaced as evenly_spaced
from unmodeled.data.sheet import ReadOptions

# The other names are for authors of adapters: unmodeled.fit.authoring.
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
