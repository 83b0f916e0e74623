"""The only reader of external HDF5 files, including NetCDF 4 and MAT 7.3.

An HDF5 file can refer to other files (external links, external storage, virtual datasets) and state
sizes without containing the data. Both are checked before data are read. HDF5 reads the texts of a
file from global heaps; a damaged length there causes an infinite loop in version 2.0, which Python
cannot stop, so that the heaps are checked before the library reads the file. Other damage of the
format is reported by the library. Only the content of the file itself is read.
"""

from __future__ import annotations

import math
import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unmodeled.files.access import LARGEST_FILE, open_input, plain_text

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

#: Exceptions of h5py for a damaged file.
HDF5_FAULTS = (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError,
               NotImplementedError, MemoryError)  # fmt: skip

MOST_ENTRIES = (
    100_000  # number of entries at the top level of a file, and of attributes of one entry
)
MOST_LEVELS = 8  # of groups in groups
MOST_TEXTS = 1_000_000  # number of texts in the global heaps of a file
MOST_CHUNKS = 400_000  # number of chunks of all datasets of a file

_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_HEADER = 16  # size in bytes of the header of a heap and of each of its objects
_SMALLEST = 4096  # bytes of a heap


class Hdf5File:
    """Content of an open file at its top level.

    Attributes
    ----------
    left_out : dict of str to str
        Entries that are not datasets of this file, with reasons; complete after :meth:`datasets`.
    """

    def __init__(self, file: Any, most_bytes: int):
        self._file = file
        self._room = most_bytes
        self._names = 0
        self._chunks = 0  # of the datasets so far
        self.most_bytes = most_bytes
        self.left_out: dict[str, str] = {}

    def attributes(self) -> dict[str, Any]:
        """Numbers and texts of the file by name."""
        return {k: v for k in self._file.attrs if (v := self._attribute(self._file, k)) is not None}

    def datasets(self, *, groups: bool = False) -> Iterator[Hdf5Dataset]:
        """Datasets in the order of the file; ``groups``: also those in groups, ``group.name``."""
        yield from self._within(self._file, "", MOST_LEVELS if groups else 0)

    def _within(self, group: Any, before: str, levels: int) -> Iterator[Hdf5Dataset]:
        import h5py

        self._names += len(group)
        if self._names > MOST_ENTRIES:
            raise ValueError(f"{self._names} entries; the limit is {MOST_ENTRIES}")
        for key in group:
            name = before + plain_text(key)
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                self.left_out[name] = "a link to another place"
                continue
            item = group[key]
            if isinstance(item, h5py.Group) and levels:
                yield from self._within(item, f"{name}.", levels - 1)
            elif not isinstance(item, h5py.Dataset):
                self.left_out[name] = "a group"
            elif item.external:
                self.left_out[name] = "stored in another file"
            elif item.is_virtual:
                self.left_out[name] = "a view of other datasets"
            else:
                yield Hdf5Dataset(self, name, item)

    def _attribute(self, item: Any, key: str) -> Any:
        """Number, text or small array of an attribute; None if it is missing or of another type."""
        import h5py

        if key not in item.attrs:
            return None
        kind = item.attrs.get_id(key)
        if kind.shape is None or not (
            kind.dtype.kind in "fiubSU" or h5py.check_string_dtype(kind.dtype) is not None
        ):
            return None
        self.take(math.prod(kind.shape) * kind.dtype.itemsize, f"attribute {shown(key)}")
        value = item.attrs[key]
        if getattr(value, "size", 0) == 1:
            value = value.ravel()[0]
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        # Invalid text could neither be printed nor written again.
        return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value

    def take(self, size: int, what: str) -> None:
        """Count bytes before they are read.

        Raises
        ------
        ValueError
            The stated sizes exceed the limit.
        """
        self._room -= size
        if self._room < 0:
            raise ValueError(
                f"{what}: the file claims more than {self.most_bytes} bytes, which is the limit"
            )

    def count_chunks(self, number: int, what: str) -> None:
        """Count chunks: the library lists them all, also those that the file does not contain.

        Raises
        ------
        ValueError
            There are more than the limit.
        """
        self._chunks += number
        if self._chunks > MOST_CHUNKS:
            raise ValueError(f"{what}: {number} chunks; the limit of a file is {MOST_CHUNKS}")


class Hdf5Dataset:
    """A dataset that is stored in the file itself."""

    def __init__(self, file: Hdf5File, name: str, item: Any):
        self._file = file
        self._item = item
        self.name = name
        self.shape: tuple[int, ...] | None = item.shape
        self.dtype: np.dtype[Any] = item.dtype

    @property
    def is_numbers(self) -> bool:
        """Whether it holds real numbers."""
        return self.shape is not None and self.dtype.kind in "fiu"

    def attribute(self, key: str) -> Any:
        """Number, text or small array of an attribute; None if it is missing or of another type."""
        return self._file._attribute(self._item, key)

    def read(self) -> npt.NDArray[Any]:
        """The numbers as an array.

        Raises
        ------
        ValueError
            The dataset is larger than the limit.
        """
        import numpy as np

        assert self.shape is not None
        what = f"dataset {shown(self.name)}"
        size = math.prod(self.shape)
        if (chunks := self._item.chunks) is not None and size:
            number = math.prod(-(-n // c) for n, c in zip(self.shape, chunks, strict=True))
            self._file.count_chunks(number, what)
            size = max(size, math.prod(chunks))  # the library holds one whole chunk in memory
        self._file.take(size * self.dtype.itemsize, what)
        return np.asarray(self._item)


def shown(name: str) -> str:
    """Name for a message."""
    text = plain_text(name)
    return text if len(text) <= 80 else text[:77] + "..."


@contextmanager
def open_hdf5(path: Path, *, most_bytes: int, track_order: bool = False) -> Iterator[Hdf5File]:
    """Open a file for reading.

    Parameters
    ----------
    most_bytes
        Largest number of bytes that may be read, unpacked.
    track_order
        Whether datasets are listed in the order of their creation.

    Raises
    ------
    DataError
        It is not a regular file, or it is too large.
    ValueError
        The file is empty, or one of its global heaps is damaged.
    """
    import h5py

    with open_input(path, most=LARGEST_FILE) as stream:
        if stream.seek(0, 2) == 0:
            raise ValueError("the file is empty")
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            _check_heaps(data)
        stream.seek(0)
        # By the open file instead of its name: the file cannot be exchanged in between.
        with h5py.File(stream, "r", track_order=track_order) as file:
            yield Hdf5File(file, most_bytes)


def _check_heaps(data: mmap.mmap | bytes) -> None:
    """Check the global heaps. Heaps of a valid file do not overlap, so that the work is limited."""
    room = min(MOST_TEXTS, len(data) // _HEADER)
    at = data.find(_SIGNATURE)
    while at >= 0:
        if at + _HEADER <= len(data):
            (size,) = struct.unpack_from("<Q", data, at + 8)
            if size < _SMALLEST or size % 8 or at + size > len(data):
                raise ValueError(f"global heap at byte {at} has a length of {size}")
            room -= _check_objects(data, at, at + size, room)
        at = data.find(_SIGNATURE, at + 8)


def _check_objects(data: mmap.mmap | bytes, heap: int, end: int, room: int) -> int:
    """Check the objects of a heap and return their number; index 0 is the free space at its end."""
    at = heap + _HEADER
    count = 0
    while at + _HEADER <= end:
        index, size = struct.unpack_from("<H6xQ", data, at)
        step = size if index == 0 else _HEADER + (size + 7) // 8 * 8
        if step < _HEADER or at + step > end:
            raise ValueError(f"global heap at byte {heap} has an object of {size} bytes")
        count += 1
        if count > room:
            raise ValueError(
                f"global heap at byte {heap}: the heaps overlap, or hold more than {MOST_TEXTS} "
                "texts"
            )
        at += step
    return count
