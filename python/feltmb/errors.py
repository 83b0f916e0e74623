"""Exceptions of feltmb. Every message says what, where, got, expected, hint."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable
from typing import Any

__all__ = [
    "MOST_LETTERS",
    "DataError",
    "FeltmbError",
    "FileExists",
    "IntegrationError",
    "InvalidParameter",
    "ModelError",
    "no_such",
    "printable",
    "shown",
]

MOST_LETTERS = 4000  # of a message
_LONGEST_LINE = 1000

#: Letters that command a terminal, that turn the direction of what follows, or that are not seen.
_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\ufff9-\ufffb\ud800-\udfff\U000e0000-\U000e007f]"
)


def printable(text: str) -> str:
    r"""Text with the letters that no screen shows, or that command it, written as ``\u001b``.

    Lines and tabs stay. In a TOML or JSON text the escapes mean what they stand for.
    """
    return _COMMANDS.sub(
        lambda m: f"\\u{ord(m[0]):04x}" if ord(m[0]) < 0x10000 else f"\\U{ord(m[0]):08x}", text
    )


def _message(text: str) -> str:
    """A message that can be shown: printable, and cut with a note where it would fill screens."""
    if len(text) > 10 * MOST_LETTERS:
        lines = printable(text[: 2 * MOST_LETTERS]).splitlines()
    else:
        lines = printable(text).splitlines()
        if len(text) <= MOST_LETTERS and all(len(line) <= _LONGEST_LINE for line in lines):
            return printable(text)
    shown: list[str] = []
    room = MOST_LETTERS
    for line in lines:
        # Its end says what is wrong with the long name at its begin.
        cut = line if len(line) <= _LONGEST_LINE else f"{line[:690]} ... {line[-300:]}"
        room -= len(cut) + 1
        if room < 0:
            break
        shown.append(cut)
    if len(shown) < len(lines) or len(text) > 10 * MOST_LETTERS:
        shown.append(f"... (cut: the message has {len(text)} characters)")
    return "\n".join(shown)


class FeltmbError(RuntimeError):
    """Root of all exceptions that feltmb raises on purpose.

    Messages quote names and values of files from anywhere: here they become harmless to a terminal
    and are cut to `MOST_LETTERS` characters.
    """

    def __init__(self, *args: object):
        super().__init__(*(_message(a) if isinstance(a, str) else a for a in args))


class InvalidParameter(FeltmbError, ValueError):
    """A parameter, a file's content or an argument is outside its permitted range."""


class DataError(InvalidParameter):
    """A measured or tabulated file cannot be used as it is."""


class ModelError(FeltmbError):
    """A model cannot compute a requested result, for example a rest pose."""


class FileExists(FeltmbError):
    """A file would be overwritten without leave to do so."""


class IntegrationError(FeltmbError):
    """The solver stopped early, or its result is not reliable.

    Attributes
    ----------
    partial : feltmb.Run or feltmb.actuator.ActuatorRun
        The run as far as it came, complete up to ``time``.
    time : float
        Time reached [s].
    state, contact : str
        The state with the largest error at the failure, and the stiffest contact acting on it.
    """

    def __init__(self, message: str, *, partial: Any, time: float, state: str, contact: str):
        super().__init__(message)
        self.partial = partial
        self.time = time
        self.state = state
        self.contact = contact


_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 80


def no_such(what: str, name: object, known: Iterable[str]) -> InvalidParameter:
    """Error for an unknown name, with similar known names.

    Parameters
    ----------
    what
        Kind of thing that was asked for, such as ``"channel"``.
    name
        Name that was asked for.
    known
        Names that there are.
    """
    import difflib

    near = difflib.get_close_matches(name, list(known), n=3) if isinstance(name, str) else []
    hint = f"; near are {', '.join(near)}" if near else ""
    return InvalidParameter(f"there is no {what} {shown(name)}{hint}")


def shown(value: object) -> str:
    """A value as short text in one line, for messages."""
    try:
        return " ".join(_REPR.repr(value).split())
    except Exception:  # a number of thousands of digits, or a foreign repr that fails
        return f"an object of type {type(value).__name__}"
