"""Values of case.json as JSON types, and objects made from them again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit.priors import Exposed
from unmodeled.models.model import Effect, Parameter, UserUnit

#: Format and version of case.json.
FORMAT, VERSION = "unmodeled case", 1

T = TypeVar("T")
_STORED = {c.__name__: c for c in (Parameter, Exposed, Effect, UserUnit)}
NUMBERS = ("inf", "-inf", "nan")


def as_stored(value: Any) -> Any:
    """A value as JSON types: every bit of a number, infinite ones as texts.

    Raises
    ------
    TypeError
        It is something else, such as a function.
    """
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(k): as_stored(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [as_stored(v) for v in value]
    if type(value) in _STORED.values() and is_dataclass(value):
        own = {
            f.name: v
            for f in fields(value)
            if (v := getattr(value, f.name)) is not f.default and v != f.default
        }
        return {"class": type(value).__name__} | {k: as_stored(v) for k, v in own.items()}
    raise TypeError(f"{type(value).__name__} cannot be stored")


def as_made(value: Any) -> Any:
    """The value of :func:`as_stored`; lists become tuples."""
    if isinstance(value, dict):
        own = {k: as_made(v) for k, v in value.items()}
        return _STORED[own.pop("class")](**own) if "class" in own else own
    if isinstance(value, list):
        return tuple(as_made(v) for v in value)
    return float(value) if isinstance(value, str) and value in NUMBERS else value


def made(where: str, make: Callable[..., T], *given: Any, **named: Any) -> T:
    """The result of a function of what a file states.

    Raises
    ------
    DataError
        The function fails, whatever the reason: ``where`` names the place in the file.
    """
    try:
        return make(*given, **named)
    except InvalidParameter as error:
        raise DataError(f"{where}: {error}") from None
    except Exception as error:
        raise DataError(f"{where}: is not what was stored: {error!r}") from None


# ------------------------------------------------------------------------------------- case.json
