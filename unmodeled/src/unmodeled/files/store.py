"""Finished results in a folder, from which an interrupted computation continues."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from unmodeled.errors import printable
from unmodeled.files.access import LARGEST_FILE, is_file, open_input, read_json, write_text

#: Number of letters of a key in its file name: unique, and short enough for every file system.
NAME_LENGTH = 40


class Store:
    """Results by key in a folder, one small file each, which is complete or absent.

    A key is a hash of everything that determines a result. A file that was damaged or edited is
    reported and ignored, so that its result is computed again. The checksums are no protection
    against forgery, because new ones can be written. Threads and processes may share a folder.

    Parameters
    ----------
    folder
        Folder; it is created when a result is stored.
    """

    def __init__(self, folder: Path):
        self.folder = folder

    def _file(self, key: str) -> Path:
        return self.folder / f"{key[:NAME_LENGTH]}.json"

    def get(self, key: str, files: Mapping[str, Path] | None = None) -> dict[str, Any] | None:
        """Stored data of a key; None if they are absent or were changed.

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
            entry = read_json(path)
            if not isinstance(entry, dict) or entry.pop("sha256", None) != _checksum(entry):
                raise ValueError("its checksum differs")
            if entry.pop("key") != key:
                raise ValueError("it is that of another key")
            checksums = entry.pop("files")
            kept = {what: file for what, file in (files or {}).items() if what in checksums}
            if not all(is_file(file) for file in kept.values()):
                return None
            if checksums != _digests(kept):
                raise ValueError("the checksum of a file that belongs to it differs")
            return entry
        except (ValueError, KeyError, TypeError, AttributeError) as fault:
            warnings.warn(
                f"{path.name}: the result is computed again: the file is damaged or was edited "
                f"({printable(str(fault))[:200]})",
                RuntimeWarning,
                stacklevel=2,
            )
            return None

    def put(
        self, key: str, data: Mapping[str, Any], files: Mapping[str, Path] | None = None
    ) -> None:
        """Store the data of a key; they are complete when their file exists."""
        self.folder.mkdir(parents=True, exist_ok=True)
        entry = dict(data) | {"key": key, "files": _digests(files or {})}
        entry = json.loads(json.dumps(entry, default=str))  # as it will be read
        entry["sha256"] = _checksum(entry)
        write_text(self._file(key), json.dumps(entry, indent=1) + "\n", force=True)


def _checksum(entry: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()


def _digests(files: Mapping[str, Path]) -> dict[str, str]:
    """Checksums of the files that belong to a result."""
    digests = {}
    for what, file in files.items():
        with open_input(file, most=LARGEST_FILE) as stream:
            digests[what] = hashlib.file_digest(stream, "sha256").hexdigest()
    return digests
