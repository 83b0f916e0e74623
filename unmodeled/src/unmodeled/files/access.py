"""File access: clear errors; files are written completely or not at all; no unasked overwriting."""

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
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from unmodeled.errors import DataError, Error, FileExists, InvalidParameter

LARGEST_TOML = 10_000_000  # bytes
LARGEST_TABLE = 200_000_000  # bytes of a CSV file
LARGEST_JSON = 100_000_000  # bytes
LARGEST_FILE = 4_000_000_000  # bytes of a NetCDF file
LARGEST_ARRAYS = 1_000_000_000  # bytes of the arrays in one .npz file
MOST_EXTENDS = 20  # number of files that extend one another
DEEPEST_KEY = 50  # number of parts of a dotted key
MOST_WORDS = 300_000  # number of keys, numbers and texts of a TOML file
#: Exceptions of numpy for a damaged file of arrays (.npz).
NPZ_FAULTS = (OSError, ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, zlib.error,
              RuntimeError, MemoryError)  # fmt: skip


def open_input(
    path: Path, *, most: int, error: type[InvalidParameter] = DataError
) -> io.BufferedReader:
    """Open an external file for reading: a regular file of at most ``most`` bytes.

    The function does not wait for a pipe and does not read a device. The kind of the file is
    checked after opening, so that the file cannot be exchanged in between.

    Raises
    ------
    error
        The file does not exist, is not a regular file, or is too large.
    """
    flags = ("O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY", "O_BINARY")  # flags that the system has
    try:
        handle = os.open(path, os.O_RDONLY | sum(getattr(os, flag, 0) for flag in flags))
    except (OSError, ValueError) as fault:  # ValueError: the name has a null character
        reason = getattr(fault, "strerror", None) or fault
        why = f"cannot be read: {reason}" if is_file(path) else why_missing(path)
        raise error(f"{path}: {why}") from None
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode) or status.st_size > most:
        os.close(handle)
        if not stat.S_ISREG(status.st_mode):
            raise error(f"{path}: {why_missing(path)}")
        raise error(f"{path}: {status.st_size} bytes; the limit is {most} bytes")
    return os.fdopen(handle, "rb")


def read_input(path: Path, *, most: int, error: type[InvalidParameter] = DataError) -> bytes:
    """Content of an external file; see :func:`open_input`."""
    with open_input(path, most=most, error=error) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            data = file.read(size + 1)
        except OSError as fault:
            raise error(f"{path}: cannot be read: {fault.strerror or fault}") from None
    if len(data) > size:  # a growing file, or a system file without a size
        raise error(f"{path}: is longer than the {size} bytes that it states")
    return data


def read_text(path: Path, *, most: int, error: type[InvalidParameter] = DataError) -> str:
    """UTF-8 text of an external file; see :func:`open_input`."""
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
    """Arrays of a ``.npz`` file, with at most ``most`` bytes together.

    Raises
    ------
    DataError
        As for :func:`open_input`, or the file is damaged.
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
    """A reference in a file: the name of a packaged item, or a path as in :func:`beside`."""
    is_path = bool(Path(name).suffix) or len(Path(name).parts) > 1
    return beside(folder, name, where) if is_path else name


def beside(folder: Path, name: str, where: str) -> Path:
    """Path of a file that another file refers to; it must be in the same folder or below.

    A downloaded mechanism or case can therefore only refer to files that came with it, also if it
    holds links to others.

    Raises
    ------
    InvalidParameter
        The name leads out of the folder; ``where`` names the file and entry, for the message.
    """
    path = Path(name)
    inside = not (path.is_absolute() or path.drive or ".." in path.parts)
    try:
        inside = inside and (folder / path).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # an impossible name, a link to itself
        inside = False
    if not inside:
        raise InvalidParameter(
            f"{where}: got {name[:200]!r}, expected a path in the folder of this file or below it"
        )
    return folder / path


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of a TOML file; one clear error if the file cannot be read."""
    return parse_toml(read_text(path, most=LARGEST_TOML, error=InvalidParameter), str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Tables of a TOML text of any origin, in time proportional to its length.

    Raises
    ------
    InvalidParameter
        The text is no TOML, or exceeds a limit; ``where`` names it in the message.
    """
    depth, words = _longest_key(text)
    if depth > DEEPEST_KEY:
        raise InvalidParameter(
            f"{where}: tables are nested too deeply: a key has {depth} parts with dots between, "
            f"the limit is {DEEPEST_KEY}"
        )
    if words > MOST_WORDS:
        raise InvalidParameter(
            f"{where}: {words} keys, numbers and texts; the limit is {MOST_WORDS}"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InvalidParameter(f"{where}: is no TOML: {error}") from None
    except ValueError as error:  # for example an integer with thousands of digits
        raise InvalidParameter(f"{where}: a value cannot be read: {error}") from None
    except RecursionError:
        raise InvalidParameter(f"{where}: tables are nested too deeply") from None


# Strings and comments of TOML, each up to its end, or else to the end of its line or of the text.
# The quantifiers are possessive: any text is scanned once.
_PARTS = re.compile(
    r'''(?:"""(?:[^"\\]|\\.|"(?!""))*+(?:""")?'''
    r"""|'''(?:[^']|'(?!''))*+(?:''')?"""
    r"""|"(?:[^"\\\n]|\\.)*+"?"""
    r"""|'[^'\n]*+'?|[A-Za-z0-9_-]++)"""
    r"""(?P<dot>[ \t]*+\.)?|\#[^\n]*+""",
    re.DOTALL,
)


def _longest_key(text: str) -> tuple[int, int]:
    """Number of parts of the longest dotted name, and number of all keys, numbers and texts.

    The time of the parser in the standard library grows with its square.
    """
    longest = here = words = 0
    for match in _PARTS.finditer(text):
        here += 1
        words += 1
        if match["dot"] is None:
            longest = max(longest, here)
            here = 0
    return max(longest, here), words


def plain_text(value: object) -> str:
    """Text of a file as printable text: bytes are decoded, control characters are replaced.

    Invalid Unicode, for example half a surrogate pair, becomes a question mark.
    """
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    text = text.encode("utf-8", "replace").decode()
    return "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def is_file(path: Path) -> bool:
    """Whether a file exists; False for an impossible name or an inaccessible folder."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether a folder exists; False for an impossible name or an inaccessible folder."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def why_missing(path: Path) -> str:
    """Reason why a path is not a file."""
    try:
        if path.is_dir():
            return "is a folder, expected a file"
        if path.exists():
            return "is a device or a pipe, expected a file"
    except (OSError, ValueError):
        pass
    return "there is no such file"


#: Suffixes of files; a folder with such a suffix is a mistake.
_FILES = (
    *(".csv", ".gif", ".h5", ".html", ".jpg", ".json", ".mp3", ".nc", ".npz", ".pdf", ".png"),
    *(".htm", ".svg", ".toml", ".txt", ".wav", ".xlsx"),
)


def check_suffix(path: Path, *suffixes: str) -> None:
    """Raise an error if the suffix of a file does not match the content; .htm is .html."""
    suffix = path.suffix.lower()
    if (".html" if suffix == ".htm" else suffix) not in suffixes:
        got = path.suffix or "a name without ending"
        known = " or ".join(filter(None, [", ".join(suffixes[:-1]), suffixes[-1]]))
        raise InvalidParameter(f"{path}: cannot write {got}, expected {known}")


def check_folder(path: Path) -> None:
    """Raise an error if the name of a folder is the name of a file."""
    if path.suffix.lower() in _FILES and not is_folder(path):
        raise InvalidParameter(f"{path}: is the name of a file, expected that of a folder")


def check_writable(path: Path, *, force: bool) -> None:
    """Raise an error before a long computation if ``path`` could not be written at its end."""
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
        raise Error(f"{path}: cannot be written: {error.strerror or error}") from None
    if not folder.is_dir():
        raise Error(f"{path}: cannot be written: {folder} is a file, expected a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise Error(f"{path}: cannot be written: the folder {folder} is not writable")


def _no_folder(folder: Path) -> str:
    """Message about a missing folder: the missing part of its path, and similar names."""
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
    """Make a folder for results, if its parent folder exists.

    Raises
    ------
    InvalidParameter
        The parent folder is missing as well, which indicates a typing error.
    """
    folder = Path(folder)
    try:
        if folder.exists() and not folder.is_dir():
            raise InvalidParameter(f"{folder}: is a file, expected a folder")
        if not folder.absolute().parent.exists():
            raise InvalidParameter(_no_folder(folder.parent))
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise Error(f"{folder}: cannot be made: {error.strerror or error}") from None
    return folder


def write_file(path: Path, write: Callable[[Path], None], *, force: bool = False) -> Path:
    """Write to a hidden temporary folder next to the target and rename the file.

    If the process is killed, only the hidden folder remains. A listing of the target's folder
    (``glob("*.json")``, which also finds hidden files) never shows an incomplete file.

    Parameters
    ----------
    path
        Target, in a folder that exists; :func:`make_folder` makes one.
    write
        Function that writes; it is called with the temporary path.
    force
        Whether an existing file is replaced.
    """
    path = Path(path)
    check_writable(path, force=force)
    temporary: Path | None = None
    try:
        # Not mkdtemp, whose folders are private: results must have the permissions of the umask,
        # which cannot be read in a process with threads.
        new = path.parent / f".unmodeled{secrets.token_hex(8)}"
        new.mkdir()
        temporary = new
        write(temporary / path.name)
        (temporary / path.name).replace(path)
    except OSError as error:
        raise Error(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
    return path


@contextmanager
def whole_folder(
    folder: Path, *, force: bool = False, replaced: Iterable[Path] = ()
) -> Iterator[Path]:
    """A hidden folder beside ``folder``, whose files get their places in it when the block ends.

    If the block fails or is interrupted, ``folder`` is as it was.

    Parameters
    ----------
    folder
        Folder of results, which exists.
    force
        Whether existing files are replaced; else none is written if one exists.
    replaced
        Files of ``folder`` that are removed unless the block wrote them again.
    """
    hidden = folder.absolute().parent / f".unmodeled{secrets.token_hex(8)}"
    new = hidden / (folder.name or "results")
    try:
        new.mkdir(parents=True)
        yield new
        written = {p.relative_to(new): p for p in sorted(new.rglob("*"))}
        for place, path in written.items():
            target = beside(folder, str(place), str(folder))
            if not path.is_dir() and target.parent.is_dir():
                check_writable(target, force=force)
        for path in replaced:
            if path.relative_to(folder) not in written:
                path.unlink(missing_ok=True)
        for place, path in written.items():
            if path.is_dir():
                (folder / place).mkdir(exist_ok=True)
            else:
                path.replace(folder / place)
    except OSError as error:
        raise Error(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def write_text(path: Path, text: str, *, force: bool = False) -> Path:
    """Write a UTF-8 text; see :func:`write_file`."""

    def write(target: Path) -> None:
        target.write_text(text, encoding="utf-8")

    return write_file(path, write, force=force)
