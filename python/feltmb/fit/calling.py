"""Calls of functions that a user wrote: what they raise is told with where it came from."""

from __future__ import annotations

from types import TracebackType

from feltmb.errors import FeltmbError, InvalidParameter

__all__ = ["calling"]


class calling:
    """``with calling("model arm: its rates"): ...``: what is raised within becomes one message.

    Raises
    ------
    InvalidParameter
        For any exception of the user's but those of feltmb, which say all themselves.
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
            raise InvalidParameter(f"{self._what} raises {_told(error)}") from error


def _told(error: Exception) -> str:
    """An error with what it mostly comes from."""
    text = f"{type(error).__name__}: {error}"
    if "truth value of an array" in text or "only length-1 arrays" in text:
        return text + " (it is called with whole arrays: use np.where, np.maximum, np.sin)"
    if isinstance(error, (ValueError, ArithmeticError)):
        return text + " (where there is no answer let it return NaN: a fit tries values far off)"
    return text
