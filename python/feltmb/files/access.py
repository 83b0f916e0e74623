"""Files: read with clear errors, written whole or not at all, never overwritten unasked."""

from __future__ import annotations

import os
import secrets
import shutil
import tomllib
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from feltmb.errors import FeltmbError, FileExists, InvalidParameter

__all__ = [
    "NPZ_FAULTS",
    "check_writable",
    "is_file",
    "plain_text",
    "read_toml",
    "write_file",
    "write_text",
]

LARGEST_TOML = 10_000_000  # bytes
#: What numpy raises for a damaged file of arrays (.npz).
NPZ_FAULTS = (OSError, ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, zlib.error,
              NotImplementedError)  # fmt: skip


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of a TOML file; one clear error if it cannot be read."""
    try:
        size = path.stat().st_size
        if size > LARGEST_TOML:
            raise InvalidParameter(f"{path}: {size} bytes; the limit of a TOML file is 10 MB")
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise InvalidParameter(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InvalidParameter(f"{path}: is no UTF-8 text (byte {error.start})") from None
    except tomllib.TOMLDecodeError as error:
        raise InvalidParameter(f"{path}: is no TOML: {error}") from None
    except ValueError as error:  # such as an integer of thousands of digits
        raise InvalidParameter(f"{path}: a value cannot be read: {error}") from None
    except RecursionError:
        raise InvalidParameter(f"{path}: tables are nested too deeply") from None


def plain_text(value: object) -> str:
    """Text from a file as one that can be printed and written: bytes decoded, no control letters.

    What is no Unicode, such as half a surrogate pair, becomes a question mark.
    """
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    text = text.encode("utf-8", "replace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that no file can have, or a closed folder, is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def why_missing(path: Path) -> str:
    """What to say of a path that is no file."""
    try:
        if path.is_dir():
            return "is a folder, expected a file"
        if path.exists():
            return "is a device or a pipe, expected a file"
    except OSError:
        pass
    return "there is no such file"


def check_writable(path: Path, *, force: bool) -> None:
    """Raise before long work if ``path`` could not be written at its end."""
    try:
        if path.is_dir():
            raise FileExists(f"{path}: is a folder, expected the name of a file")
        if path.exists():
            if not path.is_file():
                raise FileExists(f"{path}: is a device, expected the name of a file")
            if not force:
                raise FileExists(
                    f"{path}: exists already; give another name, or --force to replace it"
                )
        folder = next(f for f in path.absolute().parents if f.exists())
    except OSError as error:
        raise FeltmbError(f"{path}: cannot be written: {error.strerror or error}") from None
    if not folder.is_dir():
        raise FeltmbError(f"{path}: cannot be written: {folder} is a file, expected a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FeltmbError(f"{path}: cannot be written: the folder {folder} is not writable")


def write_file(path: Path, write: Callable[[Path], None], *, force: bool = False) -> Path:
    """Write under a hidden temporary folder beside the target and rename into place.

    A process killed in between leaves the hidden folder, never a file that a listing of the
    target's folder (``glob("*.json")``, which finds hidden files too) takes for a result.

    Parameters
    ----------
    path
        Target. Its folder is made if missing.
    write
        Called with the temporary path.
    force
        Replace an existing file.
    """
    path = Path(path)
    check_writable(path, force=force)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Not mkdtemp, whose folders are private: results are for everyone that the umask allows,
        # and the umask of a process with threads cannot be read.
        new = path.parent / f".feltmb{secrets.token_hex(8)}"
        new.mkdir()
        temporary = new
        write(temporary / path.name)
        (temporary / path.name).replace(path)
    except OSError as error:
        raise FeltmbError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
    return path


def write_text(path: Path, text: str, *, force: bool = False) -> Path:
    """Write a UTF-8 text; see :func:`write_file`."""

    def write(target: Path) -> None:
        target.write_text(text, encoding="utf-8")

    return write_file(path, write, force=force)
