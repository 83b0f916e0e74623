"""Files: read with clear errors, written whole or not at all, never overwritten unasked."""

from __future__ import annotations

import difflib
import io
import json
import os
import re
import secrets
import shutil
import stat
import tomllib
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from feltmb.errors import DataError, FeltmbError, FileExists, InvalidParameter

__all__ = [
    "LARGEST_TABLE",
    "NPZ_FAULTS",
    "beside",
    "check_folder",
    "check_suffix",
    "check_writable",
    "is_file",
    "make_folder",
    "named_file",
    "open_input",
    "plain_text",
    "read_input",
    "read_json",
    "read_npz",
    "read_text",
    "read_toml",
    "write_file",
    "write_text",
]

LARGEST_TOML = 10_000_000  # bytes
LARGEST_TABLE = 200_000_000  # bytes of a CSV file
LARGEST_JSON = 100_000_000  # bytes
LARGEST_FILE = 4_000_000_000  # bytes of a NetCDF file
LARGEST_ARRAYS = 1_000_000_000  # bytes of the arrays in one .npz file
MOST_EXTENDS = 20  # files that extend one another
DEEPEST_KEY = 50  # parts of a dotted key
#: What numpy raises for a damaged file of arrays (.npz).
NPZ_FAULTS = (OSError, ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, zlib.error,
              NotImplementedError, MemoryError)  # fmt: skip


def open_input(
    path: Path, *, most: int, error: type[InvalidParameter] = DataError
) -> io.BufferedReader:
    """Open a file from outside for reading: a regular one of at most ``most`` bytes.

    A pipe is not waited for and a device is not read: the kind is looked at once the file is open,
    so that nobody can exchange it in between.

    Raises
    ------
    error
        There is no such file, it is no regular file, or it is too large.
    """
    flags = ("O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY", "O_BINARY")  # those that the system has
    try:
        handle = os.open(path, os.O_RDONLY | sum(getattr(os, flag, 0) for flag in flags))
    except (OSError, ValueError) as fault:  # ValueError: a name with a null character
        reason = getattr(fault, "strerror", None) or fault
        why = f"cannot be read: {reason}" if is_file(path) else why_missing(path)
        raise error(f"{path}: {why}") from None
    found = os.fstat(handle)
    if not stat.S_ISREG(found.st_mode) or found.st_size > most:
        os.close(handle)
        if not stat.S_ISREG(found.st_mode):
            raise error(f"{path}: {why_missing(path)}")
        raise error(f"{path}: {found.st_size} bytes; the limit is {most} bytes")
    return os.fdopen(handle, "rb")


def read_input(path: Path, *, most: int, error: type[InvalidParameter] = DataError) -> bytes:
    """Content of a file from outside; see :func:`open_input`."""
    with open_input(path, most=most, error=error) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            data = file.read(size + 1)
        except OSError as fault:
            raise error(f"{path}: cannot be read: {fault.strerror or fault}") from None
    if len(data) > size:  # a file that grows, or one of the system that states no size
        raise error(f"{path}: is longer than the {size} bytes that it states")
    return data


def read_text(path: Path, *, most: int, error: type[InvalidParameter] = DataError) -> str:
    """UTF-8 text of a file from outside; see :func:`open_input`."""
    try:
        return read_input(path, most=most, error=error).decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise error(f"{path}: is no UTF-8 text (byte {fault.start})") from None


def read_json(path: Path, *, most: int = LARGEST_JSON) -> Any:
    """Content of a JSON file; see :func:`open_input`."""
    text = read_text(path, most=most)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as fault:
        raise DataError(f"{path}: is no JSON: {fault}") from None


def read_npz(path: Path, *, most: int = LARGEST_ARRAYS) -> dict[str, Any]:
    """Arrays of a ``.npz`` file, which together take at most ``most`` bytes.

    Raises
    ------
    DataError
        As :func:`open_input`, or the file is damaged.
    """
    import numpy as np

    with open_input(path, most=most) as file:
        try:
            with zipfile.ZipFile(file) as packed:
                size = sum(entry.file_size for entry in packed.infolist())
            if size > most:
                raise DataError(f"{path}: arrays of {size} bytes; the limit is {most} bytes")
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files}
        except DataError:
            raise
        except NPZ_FAULTS as fault:
            raise DataError(f"{path}: is damaged: {fault or type(fault).__name__}") from None


def named_file(folder: Path, name: str, where: str) -> str | Path:
    """What a file names: the name of something packaged, or a path as in :func:`beside`."""
    is_path = bool(Path(name).suffix) or len(Path(name).parts) > 1
    return beside(folder, name, where) if is_path else name


def beside(folder: Path, name: str, where: str) -> Path:
    """Path of a file that another file names: in the folder of that one, or below it.

    A mechanism from elsewhere thus names nothing but what came with it.

    Raises
    ------
    InvalidParameter
        The name leads out of the folder; ``where`` says in which file and entry it stands.
    """
    path = Path(name)
    if path.is_absolute() or path.drive or ".." in path.parts:
        raise InvalidParameter(
            f"{where}: got {name[:200]!r}, expected a path in the folder of this file or below it"
        )
    return folder / path


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of a TOML file; one clear error if it cannot be read."""
    text = read_text(path, most=LARGEST_TOML, error=InvalidParameter)
    depth = _longest_key(text)
    if depth > DEEPEST_KEY:
        raise InvalidParameter(
            f"{path}: tables are nested too deeply: a key has {depth} parts with dots between, "
            f"the limit is {DEEPEST_KEY}"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InvalidParameter(f"{path}: is no TOML: {error}") from None
    except ValueError as error:  # such as an integer of thousands of digits
        raise InvalidParameter(f"{path}: a value cannot be read: {error}") from None
    except RecursionError:
        raise InvalidParameter(f"{path}: tables are nested too deeply") from None


# Strings and comments as TOML has them, each to its end or that of its line or text. Possessive:
# whatever the text, it is gone over once.
_PARTS = re.compile(
    r'''(?:"""(?:[^"\\]|\\.|"(?!""))*+(?:""")?'''
    r"""|'''(?:[^']|'(?!''))*+(?:''')?"""
    r"""|"(?:[^"\\\n]|\\.)*+"?"""
    r"""|'[^'\n]*+'?|[A-Za-z0-9_-]++)"""
    r"""(?P<dot>[ \t]*+\.)?|\#[^\n]*+""",
    re.DOTALL,
)


def _longest_key(text: str) -> int:
    """Parts of the longest chain of words with dots between them.

    The reader of the standard library takes a time with the square of it.
    """
    longest = here = 0
    for match in _PARTS.finditer(text):
        here += 1
        if match["dot"] is None:
            longest = max(longest, here)
            here = 0
    return max(longest, here)


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
    except (OSError, ValueError):
        return False


def why_missing(path: Path) -> str:
    """What to say of a path that is no file."""
    try:
        if path.is_dir():
            return "is a folder, expected a file"
        if path.exists():
            return "is a device or a pipe, expected a file"
    except (OSError, ValueError):
        pass
    return "there is no such file"


#: Endings that name a file: a folder that bears one is a mistake.
_FILES = (
    *(".csv", ".gif", ".h5", ".html", ".jpg", ".json", ".mp3", ".nc", ".npz", ".pdf", ".png"),
    *(".svg", ".toml", ".txt", ".wav", ".xlsx"),
)


def check_suffix(path: Path, *suffixes: str) -> None:
    """Raise if a file of this name cannot be written: what its ending says is what it holds."""
    if path.suffix.lower() not in suffixes:
        got = path.suffix or "a name without ending"
        known = " or ".join(filter(None, [", ".join(suffixes[:-1]), suffixes[-1]]))
        raise InvalidParameter(f"{path}: cannot write {got}, expected {known}")


def check_folder(path: Path) -> None:
    """Raise if the name of a folder is that of a file."""
    if path.suffix.lower() in _FILES and not path.is_dir():
        raise InvalidParameter(f"{path}: is the name of a file, expected that of a folder")


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
                    f"{path}: exists already; give another name, or --force (in Python "
                    "force=True) to replace it"
                )
        folder = next(f for f in path.absolute().parents if f.exists())
        if folder != path.absolute().parent and folder.is_dir():
            raise InvalidParameter(_no_folder(path.parent))
    except OSError as error:
        raise FeltmbError(f"{path}: cannot be written: {error.strerror or error}") from None
    if not folder.is_dir():
        raise FeltmbError(f"{path}: cannot be written: {folder} is a file, expected a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FeltmbError(f"{path}: cannot be written: the folder {folder} is not writable")


def _no_folder(folder: Path) -> str:
    """What to say of a folder that is not there: what is missing of its path, and what is near."""
    missing = folder.absolute()
    while not missing.parent.exists():
        missing = missing.parent
    try:
        near = difflib.get_close_matches(
            missing.name, [f.name for f in missing.parent.iterdir() if f.is_dir()], n=1
        )
    except OSError:
        near = []
    hint = f"did you mean {near[0]!r}?" if near else "create it first, or correct the path"
    where = "" if missing == folder.absolute() else f" ({missing.name!r} is missing)"
    return f"{folder}: there is no such folder{where}; {hint}"


def make_folder(folder: str | Path) -> Path:
    """A folder that was named for results: made, if it alone is missing.

    Raises
    ------
    InvalidParameter
        The folder that it would lie in is missing as well: a mistyped path.
    """
    folder = Path(folder)
    try:
        if folder.exists() and not folder.is_dir():
            raise InvalidParameter(f"{folder}: is a file, expected a folder")
        if not folder.absolute().parent.exists():
            raise InvalidParameter(_no_folder(folder.parent))
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise FeltmbError(f"{folder}: cannot be made: {error.strerror or error}") from None
    return folder


def write_file(path: Path, write: Callable[[Path], None], *, force: bool = False) -> Path:
    """Write under a hidden temporary folder beside the target and rename into place.

    A process killed in between leaves the hidden folder, never a file that a listing of the
    target's folder (``glob("*.json")``, which finds hidden files too) takes for a result.

    Parameters
    ----------
    path
        Target, in a folder that exists; :func:`make_folder` makes one.
    write
        Called with the temporary path.
    force
        Replace an existing file.
    """
    path = Path(path)
    check_writable(path, force=force)
    temporary: Path | None = None
    try:
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
