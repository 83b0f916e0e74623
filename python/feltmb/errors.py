"""Exceptions of feltmb. Every message says what, where, got, expected, hint."""

from __future__ import annotations

from typing import Any

__all__ = [
    "DataError",
    "FeltmbError",
    "FileExists",
    "IntegrationError",
    "InvalidParameter",
    "ModelError",
]


class FeltmbError(RuntimeError):
    """Root of all exceptions that feltmb raises on purpose."""


class InvalidParameter(FeltmbError, ValueError):
    """A parameter, a file's content or an argument is outside its permitted range."""


class DataError(InvalidParameter):
    """A measured or tabulated file cannot be used as it is."""


class ModelError(FeltmbError):
    """A model cannot do what was asked of it, for example reach a rest pose."""


class FileExists(FeltmbError):
    """A file would be overwritten without leave to do so."""


class IntegrationError(FeltmbError):
    """The solver stopped early.

    Attributes
    ----------
    partial : feltmb.Run
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
