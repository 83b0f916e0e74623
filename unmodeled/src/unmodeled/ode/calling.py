"""Calls of user functions; an exception in them is reported with its place in the user's code."""

from __future__ import annotations

import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from unmodeled.errors import Error, InvalidParameter
from unmodeled.ode.tape import NotTraceable


@contextmanager
def calling(what: str) -> Iterator[None]:
    """Turn an exception in the block into one message: ``with calling("model arm: its rates"):``.

    Raises
    ------
    InvalidParameter
        For any exception except :class:`~unmodeled.errors.Error`, whose messages are already
        complete.
    """
    try:
        yield
    except Error:
        raise
    except (Exception, NotTraceable) as error:
        raise InvalidParameter(f"{what} raises {explained(error)}") from error


def explained(error: BaseException) -> str:
    """Text of an exception, with its line in the user's code and its most likely cause."""
    text = f"{type(error).__name__}: {error}{_line_of(error)}"
    if "truth value of an array" in text or "only length-1 arrays" in text:
        return text + " (it is called with whole arrays: use np.where, np.maximum, np.sin)"
    undefined = isinstance(error, ArithmeticError) or "domain" in text or "nonnegative" in text
    if undefined:
        return text + (
            " (return NaN for undefined values: such a trial counts as failed; fits evaluate "
            "extreme parameters)"
        )
    return text


def _line_of(error: BaseException) -> str:
    """Line and file of the innermost call in code that is not installed; empty: there is none."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path.suffix == ".py" and not installed(path):
            return f" (line {frame.lineno} of {path.name})"
    return ""


def installed(path: Path) -> bool:
    """Whether a file belongs to this package or to an installed one."""
    installed = {Path(__file__).parents[1], Path(sysconfig.get_paths()["stdlib"])}
    inside = installed & {*path.parents} or {*path.parts} & {"site-packages", "dist-packages"}
    return bool(inside)


def line_of(function: Any) -> str:
    """Line and file of a function of the user, also in one that calls it; empty: not known."""
    waiting, seen = [function], set()
    while waiting:
        one = waiting.pop(0)
        one = getattr(one, "__func__", getattr(one, "func", one))
        if id(one) in seen or not callable(one):
            continue
        seen.add(id(one))
        code = getattr(one, "__code__", None) or getattr(type(one).__call__, "__code__", None)
        if code is not None and not installed(Path(code.co_filename)):
            return f" (line {code.co_firstlineno} of {Path(code.co_filename).name})"
        waiting += [c.cell_contents for c in getattr(one, "__closure__", None) or ()]
    return ""
