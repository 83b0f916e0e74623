"""Measured files that were dropped on a local page, and their columns."""

from __future__ import annotations

import hashlib
import itertools
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from unmodeled.data.columns import MEASURED_FILES, read_columns
from unmodeled.data.series import Columns
from unmodeled.errors import Error, InvalidParameter

#: Largest number of uploaded files; the oldest one is removed.
MOST_FILES = 12
#: Largest number of numbers of the uploaded files, which are kept in memory.
MOST_KEPT = 60_000_000


class _Upload(NamedTuple):
    name: str
    path: Path
    columns: Columns
    data: bytes
    """Digest of the file."""


def plain_name(name: str) -> str:
    """Name of an uploaded file without folders and without unusual letters."""
    return re.sub(r"[^\w .+-]", "_", Path(name.replace("\\", "/")).name)[-80:] or "record"


@dataclass
class Uploads:
    """Uploaded files, in a separate folder with names of the server, and their columns."""

    folder: Path
    _files: dict[str, _Upload] = field(default_factory=dict)
    _sheets: dict[str, bytes] = field(default_factory=dict)
    _numbers: Any = field(default_factory=lambda: itertools.count(1))

    def add(self, name: str, data: bytes) -> dict[str, Any]:
        """Store a file and return its columns; a file that is there already is not stored again.

        A TOML file describes the file of the same name, whichever comes first.

        Raises
        ------
        InvalidParameter
            The file has an unsupported format.
        DataError
            The file cannot be read.
        """
        plain = plain_name(name)
        kind, stem = Path(plain).suffix.lower(), Path(plain).stem
        if kind == ".toml":
            self._sheets[stem] = data
            while len(self._sheets) > MOST_FILES:
                del self._sheets[next(iter(self._sheets))]
            described = [f.path for f in self._files.values() if f.path.stem == stem]
            for path in described:
                path.with_suffix(".toml").write_bytes(data)
            return {"describes": [path.name for path in described]}
        if kind not in MEASURED_FILES:
            raise InvalidParameter(
                f"{plain}: expected a file {', '.join(MEASURED_FILES)}, or its .toml"
            )
        digest = hashlib.sha256(data).digest()
        for known, found in self._files.items():
            if (found.name, found.data) == (plain, digest):
                return self._entry(known)
        key = f"r{next(self._numbers)}"
        (self.folder / key).mkdir()
        path = self.folder / key / plain
        path.write_bytes(data)
        if stem in self._sheets:
            path.with_suffix(".toml").write_bytes(self._sheets[stem])
        try:
            columns = read_columns(path)
        except Error as error:
            path.unlink()
            raise type(error)(str(error).replace(str(path), plain)) from None
        room = MOST_KEPT - _size(columns)
        while self._files and (
            len(self._files) >= MOST_FILES
            or sum(_size(f.columns) for f in self._files.values()) > room
        ):
            self.remove(next(iter(self._files)))
        self._files[key] = _Upload(plain, path, columns, digest)
        return self._entry(key)

    def _entry(self, key: str) -> dict[str, Any]:
        name, columns = self._files[key].name, self._files[key].columns
        heads = [[c, columns.units.get(c, "")] for c in columns.values]
        return {"file": key, "name": name, "columns": heads}

    def remove(self, key: str) -> None:
        """Remove a file."""
        if (found := self._files.pop(key, None)) is not None:
            found.path.unlink(missing_ok=True)

    def named(self, text: str) -> str:
        """A message without the folder of the files."""
        return re.sub(re.escape(str(self.folder)) + r"/r\d+/", "", text)

    def listing(self) -> list[dict[str, Any]]:
        """Files with their columns."""
        return [self._entry(key) for key in self._files]

    def kept(self, keys: list[str]) -> dict[Path, Columns]:
        """Paths and columns of files by key."""
        files = dict(self._files)  # another thread may add one
        missing = [k for k in keys if k not in files]
        if missing or not keys:
            raise InvalidParameter(
                f"file {missing[0]!r} is not here any more; drop it again"
                if missing
                else "drop a measured file first"
            )
        return {files[k].path: files[k].columns for k in keys}


def _size(columns: Columns) -> int:
    """Number of numbers and texts."""
    return sum(v.size for v in columns.values.values()) + sum(map(len, columns.texts.values()))
