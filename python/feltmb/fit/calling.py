"""Calls of user functions; an exception in them is reported with its place in the user's code."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path
from types import TracebackType

from feltmb.errors import FeltmbError, InvalidParameter

__all__ = ["calling", "explained"]


class calling:
    """Turn an exception in the block into one message: ``with calling("model arm: its rates"):``.

    Raises
    ------
    InvalidParameter
        For any exception except those of feltmb, whose messages are already complete.
    """

    __slots__ = ("_what",)

    def __init__(self, what: str):
        self._what = what

    def __enter__(self) -> None:
        return None

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, FeltmbError):
            raise InvalidParameter(f"{self._what} raises {explained(error)}") from error


def explained(error: Exception) -> str:
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


def _line_of(error: Exception) -> str:
    """Line and file of the innermost call in code that is not installed; empty: there is none."""
    installed = {Path(__file__).parents[1], Path(sysconfig.get_paths()["stdlib"])}
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        inside = installed & {*path.parents} or {*path.parts} & {"site-packages", "dist-packages"}
        if path.suffix == ".py" and not inside:
            return f" (line {frame.lineno} of {path.name})"
    return ""
