"""Exceptions. Every message states what, where, the value, the expectation, a hint."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable, Sequence

__all__ = [
    "MOST_LETTERS",
    "DataError",
    "Error",
    "FileExists",
    "InvalidParameter",
    "ModelError",
    "message",
    "no_such",
    "printable",
    "shown",
]

MOST_LETTERS = 4000  # largest number of letters of a message
_LONGEST_LINE = 1000
_LONG_NAME = re.compile(r"(\S{140})\S{11,}(\S{50})")  # more than 200 letters without a space

#: Characters that control a terminal, change the direction of text, or are invisible.
_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\ufff9-\ufffb\ud800-\udfff\U000e0000-\U000e007f]"
)


def printable(text: str) -> str:
    r"""Text with control characters and invisible characters written as ``\u001b``.

    Line breaks and tabs are kept. In a TOML or JSON text, the escapes have their meaning.
    """
    return _COMMANDS.sub(
        lambda m: f"\\u{ord(m[0]):04x}" if ord(m[0]) < 0x10000 else f"\\U{ord(m[0]):08x}", text
    )


def message(text: str) -> str:
    """A message that can be shown: printable, and with long names and long texts shortened."""
    if len(text) <= 10 * MOST_LETTERS:
        text = _LONG_NAME.sub(r"\1...\2", text)
    if len(text) > 10 * MOST_LETTERS:
        lines = printable(text[: 2 * MOST_LETTERS]).splitlines()
    else:
        lines = printable(text).splitlines()
        if len(text) <= MOST_LETTERS and all(len(line) <= _LONGEST_LINE for line in lines):
            return printable(text)
    shown: list[str] = []
    room = MOST_LETTERS
    for line in lines:
        # The end of the message describes the fault of the long name at its beginning.
        cut = line if len(line) <= _LONGEST_LINE else f"{line[:690]} ... {line[-300:]}"
        room -= len(cut) + 1
        if room < 0:
            break
        shown.append(cut)
    if len(shown) < len(lines) or len(text) > 10 * MOST_LETTERS:
        shown.append(f"... (cut: the message has {len(text)} characters)")
    return "\n".join(shown)


class Error(RuntimeError):
    """Base class of all exceptions that are raised intentionally.

    Messages contain names and values of any files. They are made harmless for a terminal and cut to
    `MOST_LETTERS` characters.

    Attributes
    ----------
    code : str
        Cause in a word, for programs; "other" if there is no word for it.
    """

    code = "other"

    def __init__(self, *args: object):
        super().__init__(*(message(a) if isinstance(a, str) else a for a in args))


class InvalidParameter(Error, ValueError):
    """A parameter, a file's content or an argument is outside its permitted range."""

    code = "invalid_parameter"


class DataError(InvalidParameter):
    """A measured or tabulated file cannot be used."""


class ModelError(Error):
    """A model cannot compute a requested result, for example a rest pose."""


class FileExists(Error):
    """A file would be overwritten without permission."""


_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 80


def no_such(what: str, name: object, known: Iterable[str]) -> InvalidParameter:
    """Error for an unknown name, with similar known names.

    Parameters
    ----------
    what
        Kind of the object, such as ``"channel"``.
    name
        The unknown name.
    known
        Known names.
    """
    return InvalidParameter(f"there is no {what} {shown(name)}{near_names(name, known)}")


def near_names(name: object, known: Iterable[str]) -> str:
    """The end of a message: known names that are similar to an unknown one; empty if none is."""
    import difflib

    if not isinstance(name, str):
        return ""
    listed = list(known)
    near = difflib.get_close_matches(name, listed, n=3)
    near = near or [k for k in listed if len(name) > 2 and name in k][:3]
    return f"; near are {', '.join(near)}" if near else ""


def shortened(text: str, most: int = 80) -> str:
    """Text for a message, shortened if it would fill the screen."""
    return text if len(text) <= most else text[: most - 3] + "..."


def merged(notes: Sequence[str]) -> list[str]:
    """Notes or faults ``subject: text``; those with one text are one about several subjects."""
    same: dict[str, list[str]] = {}
    for note in notes:
        subject, colon, text = note.partition(": ")
        same.setdefault(text if colon else note, []).extend([subject] * bool(colon))
    named = {t: shortened(", ".join(dict.fromkeys(s)), 200) for t, s in same.items()}
    return [f"{subjects}: {text}" if subjects else text for text, subjects in named.items()]


def shown(value: object) -> str:
    r"""A value as short text in one line, for messages.

    Examples
    --------
    A value in a message, with control characters made visible:

    >>> from unmodeled.errors import shown
    >>> shown("0.3 s"), shown("\x1b[31m")
    ("'0.3 s'", "'\\x1b[31m'")
    """
    try:
        return " ".join(_REPR.repr(value).split())
    except Exception:  # a number with thousands of digits, or a foreign repr that fails
        return f"an object of type {type(value).__name__}"


def which_column(name: str = "NAME", column: str = "COLUMN") -> str:
    """Hint about a signal whose column is not known, or about a column without a signal."""
    return f"--column {name}={column} says which it is, in Python columns of ReadOptions"
