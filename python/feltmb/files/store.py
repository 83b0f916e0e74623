"""Finished results in a folder, from which an interrupted computation continues."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.errors import DataError, InvalidParameter, printable
from feltmb.files.access import (
    LARGEST_FILE,
    is_file,
    open_input,
    read_json,
    read_npz,
    write_file,
    write_text,
)

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

__all__ = ["Kept", "Store"]

#: Number of letters of a key in its file name: unique, and short enough for every file system.
NAME_LENGTH = 40


@dataclass(frozen=True)
class Kept:
    """Stored result of a key."""

    data: dict[str, Any]
    """Plain data."""
    arrays: dict[str, Array] = field(default_factory=dict)


class Store:
    """Results by key in a folder, one small file each, which is complete or absent.

    A key is a hash of everything that determines a result. With ``settings``, the hash of
    everything common to all results, it may be any name. A file that was damaged or edited is
    reported and ignored, so that its result is computed again. The checksums are no protection
    against forgery, because new ones can be written. Threads and processes may share a folder.

    Parameters
    ----------
    folder
        Folder; it is created when a result is stored.
    settings
        Hash of everything that all results of the folder depend on; empty: the keys contain
        everything.

    Raises
    ------
    InvalidParameter
        The folder contains results with other settings.
    """

    def __init__(self, folder: Path, settings: str = ""):
        self.folder = folder
        self.settings = settings
        head = folder / "settings.json"
        if settings and is_file(head):
            found = _read(head)
            if found.get("settings") != settings:
                raise InvalidParameter(
                    f"{folder}: holds cases of another model, data, seed or version; expected an "
                    "empty folder, or the same arguments as before"
                )
        elif settings:
            folder.mkdir(parents=True, exist_ok=True)
            write_text(head, json.dumps({"settings": settings}) + "\n")

    def _file(self, key: str) -> Path:
        return self.folder / f"{key[:NAME_LENGTH]}.json"

    def get(self, key: str, files: Mapping[str, Path] | None = None) -> Kept | None:
        """Stored result of a key; None if it is absent or was changed.

        Parameters
        ----------
        files
            Other files that may belong to the result, by the names with which they were stored;
            these files must be unchanged.
        """
        path = self._file(key)
        if not is_file(path):
            return None
        try:
            found = read_json(path)
            if not isinstance(found, dict) or found.pop("sha256", None) != self._checksum(found):
                raise ValueError("its checksum differs")
            if found.pop("key") != key:
                raise ValueError("it is that of another key")
            names, checksums = found.pop("arrays"), found.pop("files")
            own = {what: file for what, file in (files or {}).items() if what in checksums}
            if not all(is_file(file) for file in own.values()):
                return None
            if checksums != _digests(path, bool(names), own):
                raise ValueError("the checksum of a file that belongs to it differs")
            arrays = read_npz(path.with_suffix(".npz")) if names else {}
            return Kept(found, {name: arrays[name] for name in names})
        except (ValueError, KeyError, TypeError, AttributeError) as fault:
            warnings.warn(
                f"{path.name}: the result is computed again: the file is damaged or was edited "
                f"({printable(str(fault))[:200]})",
                RuntimeWarning,
                stacklevel=2,
            )
            return None

    def stored(self) -> list[dict[str, Any]]:
        """Data of all results, without their arrays; files that cannot be read are omitted."""
        return [_read(path) for path in sorted(self.folder.glob("*.json"))]

    def put(
        self,
        key: str,
        data: Mapping[str, Any],
        arrays: Mapping[str, Array] | None = None,
        files: Mapping[str, Path] | None = None,
    ) -> None:
        """Store the result of a key; it is complete when its file exists."""
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self._file(key)
        if arrays:
            import numpy as np

            def write(target: Path) -> None:
                with target.open("wb") as out:
                    np.savez_compressed(out, **arrays)  # type: ignore[arg-type]

            write_file(path.with_suffix(".npz"), write, force=True)
        found = dict(data) | {
            "key": key,
            "arrays": sorted(arrays or {}),
            "files": _digests(path, bool(arrays), files or {}),
        }
        found = json.loads(json.dumps(found, default=str))  # as it will be read
        found["sha256"] = self._checksum(found)
        write_text(path, json.dumps(found, indent=1) + "\n", force=True)

    def _checksum(self, found: dict[str, Any]) -> str:
        text = json.dumps(found, sort_keys=True) + self.settings
        return hashlib.sha256(text.encode()).hexdigest()


def _digests(path: Path, arrays: bool, files: Mapping[str, Path]) -> dict[str, str]:
    """Checksums of the files that belong to a result."""
    beside = {"arrays": path.with_suffix(".npz")} if arrays else {}
    found = {}
    for what, file in (beside | dict(files)).items():
        with open_input(file, most=LARGEST_FILE) as stream:
            found[what] = hashlib.file_digest(stream, "sha256").hexdigest()
    return found


def _read(path: Path) -> dict[str, Any]:
    try:
        found = read_json(path)
    except DataError:
        return {}
    return found if isinstance(found, dict) else {}
