"""Finished optimizations on disk, so that a cut-off run resumes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from feltmb.data import Array
from feltmb.files import NPZ_FAULTS, write_file

__all__ = ["Cache"]


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
        """Arrays of a result, or None if there is none or its file is damaged."""
        path = self.folder / f"{key}.npz"
        try:
            with np.load(path, allow_pickle=False) as data:
                return {k: data[k] for k in data.files}
        except NPZ_FAULTS:
            return None

    def put(self, key: str, arrays: dict[str, Array]) -> None:
        """Keep the arrays of a result."""

        def write(path: Path) -> None:
            with path.open("wb") as file:
                np.savez(file, **arrays)  # type: ignore[arg-type]

        self.folder.mkdir(parents=True, exist_ok=True)
        write_file(self.folder / f"{key}.npz", write, force=True)
