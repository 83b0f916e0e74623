"""Digest of feltmb as it is installed."""

from __future__ import annotations

import hashlib
import sys
from functools import lru_cache
from pathlib import Path

from feltmb.errors import DataError

__all__ = ["package_digest"]


@lru_cache(maxsize=1)
def package_digest() -> str:
    """SHA-256 of all files of the package, the compiled core and the packaged data with them.

    What other code made must not be taken for a result of this one.

    Raises
    ------
    DataError
        A file cannot be read.
    """
    package = Path(__file__).resolve().parents[1]
    files = {
        str(file.relative_to(package)): file
        for file in package.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    # An editable installation keeps the core in another place.
    core = getattr(sys.modules.get("feltmb._core"), "__file__", None)
    if core is not None:
        files[Path(core).name] = Path(core)
    digest = hashlib.sha256()
    for name in sorted(files):
        try:
            data = files[name].read_bytes()
        except OSError as error:
            raise DataError(f"{files[name]}: cannot be read: {error.strerror}") from None
        digest.update(f"{name} {len(data)} ".encode() + data)
    return digest.hexdigest()
