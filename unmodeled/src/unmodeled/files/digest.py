"""Hashes of the inputs of a result, and of the installed package."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from unmodeled.errors import DataError


def digest_of(*parts: object) -> str:
    """SHA-256 of texts, numbers, arrays, and lists and mappings of them.

    Arrays are hashed by shape and bytes, mappings by their sorted keys, and other objects by their
    ``repr``.
    """
    digest = hashlib.sha256()
    for word in _words(parts):
        digest.update(word)
        digest.update(b"|")
    return digest.hexdigest()


def _words(part: Any) -> Iterator[bytes]:
    if isinstance(part, bytes):
        yield f"bytes {len(part)}".encode()
        yield part
    elif hasattr(part, "tobytes") and hasattr(part, "shape"):
        yield f"array {part.dtype} {part.shape}".encode()
        yield part.tobytes()
    elif isinstance(part, Mapping):
        yield f"mapping {len(part)}".encode()
        for key in sorted(part, key=str):
            yield from _words((key, part[key]))
    elif type(part) in (list, tuple):
        yield f"sequence {len(part)}".encode()
        for each in part:
            yield from _words(each)
    else:
        yield repr(part).encode()


@lru_cache(maxsize=8)
def package_digest(package: str) -> str:
    """SHA-256 of all files of a package, including compiled modules and packaged data.

    Results of another version of the code must not be reused.

    Parameters
    ----------
    package
        Name of an imported package, such as ``"unmodeled"``.

    Raises
    ------
    DataError
        A file cannot be read.
    """
    folder = Path(str(sys.modules[package].__file__)).resolve().parent
    files = {
        str(file.relative_to(folder)): file
        for file in folder.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    # In an editable installation compiled modules are in another folder.
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None) or ""
        if name.startswith(f"{package}.") and not file.endswith(".py") and Path(file).is_file():
            files[Path(file).name] = Path(file)
    digest = hashlib.sha256()
    for name in sorted(files):
        try:
            data = files[name].read_bytes()
        except OSError as error:
            raise DataError(f"{files[name]}: cannot be read: {error.strerror}") from None
        digest.update(f"{name} {len(data)} ".encode() + data)
    return digest.hexdigest()
