"""Measured data: records, sensors, and their files (CSV, MAT, NetCDF, each with a TOML file)."""

from typing import TYPE_CHECKING

from unmodeled.data.joining import Clocks, fit_clocks, join_records
from unmodeled.data.records import Array as Array
from unmodeled.data.records import InputMode as InputMode
from unmodeled.data.records import Integers as Integers
from unmodeled.data.records import Record, Sensor, StartPrior
from unmodeled.data.records import Reference as Reference
from unmodeled.data.records import Role as Role
from unmodeled.data.records import evenly_spaced as evenly_spaced
from unmodeled.data.writing import write_record
from unmodeled.lazy import lazy_import

if TYPE_CHECKING:
    from unmodeled.data.files import read, read_record, read_records
    from unmodeled.data.frames import records_from_frame
    from unmodeled.data.sheet import ReadOptions

# The other names are for authors of adapters: unmodeled.models.
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

#: Module of the names that are imported at their first use: a diagnosis needs no reader of files.
_LAZY = {
    **dict.fromkeys(("read", "read_record", "read_records"), "files"),
    "records_from_frame": "frames",
    "ReadOptions": "sheet",
}


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return lazy_import(f"unmodeled.data.{_LAZY[name]}:{name}")
