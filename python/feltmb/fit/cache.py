"""Finished optimizations on disk, so that a cut-off run resumes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from feltmb.data import Array
from feltmb.errors import DataError
from feltmb.files import read_npz, write_file

__all__ = ["Cache"]


_CHECKSUM = "sha256"


def _digest(arrays: dict[str, Array]) -> str:
    return Cache.key(*(part for name in sorted(arrays) for part in (name, arrays[name])))


class Cache:
    """Results by a digest of what they depend on; one small file each."""

    def __init__(self, folder: Path):
        self.folder = folder

    @staticmethod
    def key(*parts: object) -> str:
        """Digest of texts, numbers and arrays."""
        digest = hashlib.sha256()
        for part in parts:
            if isinstance(part, np.ndarray):
                digest.update(np.ascontiguousarray(part).tobytes())
                digest.update(str(part.shape).encode())
            else:
                digest.update(repr(part).encode())
            digest.update(b"|")
        return digest.hexdigest()

    def get(self, key: str) -> dict[str, Array] | None:
        """Arrays of a result, or None if there is none or its file is damaged or was edited."""
        try:
            arrays = read_npz(self.folder / f"{key}.npz")
        except DataError:
            return None
        checksum = str(arrays.pop(_CHECKSUM, ""))
        return arrays if checksum == _digest(arrays) else None

    def put(self, key: str, arrays: dict[str, Array]) -> None:
        """Keep the arrays of a result."""

        def write(path: Path) -> None:
            with path.open("wb") as file:
                np.savez(file, **{**arrays, _CHECKSUM: np.array(_digest(arrays))})  # type: ignore[arg-type]

        self.folder.mkdir(parents=True, exist_ok=True)
        write_file(self.folder / f"{key}.npz", write, force=True)
