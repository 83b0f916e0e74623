"""HDF5 files from outside, which NetCDF 4 and MAT 7.3 are too: opened after a look at their heaps.

HDF5 reads the texts of a file from global heaps. A damaged length there lets version 2.0 go round
for ever, and nothing in Python can stop it; so heaps are walked before the library sees them.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import Any

__all__ = ["HDF5_FAULTS", "open_hdf5"]

#: What h5py raises for a damaged file.
HDF5_FAULTS = (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError)

_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_HEADER = 16  # bytes, of a heap and of each of its objects
_SMALLEST = 4096  # bytes of a heap


def open_hdf5(path: Path, **options: Any) -> Any:
    """Open a file for reading, a context manager.

    Raises
    ------
    ValueError
        The file is empty, or one of its global heaps is damaged.
    """
    import h5py

    if path.stat().st_size == 0:
        raise ValueError("the file is empty")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        _check_heaps(data)
    return h5py.File(path, "r", **options)


def _check_heaps(data: mmap.mmap | bytes) -> None:
    at = data.find(_SIGNATURE)
    while at >= 0:
        if at + _HEADER <= len(data):
            (size,) = struct.unpack_from("<Q", data, at + 8)
            if size < _SMALLEST or size % 8 or at + size > len(data):
                raise ValueError(f"global heap at byte {at} has a length of {size}")
            _check_objects(data, at, at + size)
        at = data.find(_SIGNATURE, at + 8)


def _check_objects(data: mmap.mmap | bytes, heap: int, end: int) -> None:
    """Walk the objects of a heap; index 0 is the free space at its end."""
    at = heap + _HEADER
    while at + _HEADER <= end:
        index, size = struct.unpack_from("<H6xQ", data, at)
        step = size if index == 0 else _HEADER + (size + 7) // 8 * 8
        if step < _HEADER or at + step > end:
            raise ValueError(f"global heap at byte {heap} has an object of {size} bytes")
        at += step
