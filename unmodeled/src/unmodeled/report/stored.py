"""What case.json and report.json hold: values as JSON types, and the schemas of both files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit.model import Effect, Parameter, UserUnit
from unmodeled.fit.priors import Exposed
from unmodeled.units.quantity import Schema

#: Format and version of case.json.
FORMAT, VERSION = "unmodeled case", 1

T = TypeVar("T")
_STORED = {c.__name__: c for c in (Parameter, Exposed, Effect, UserUnit)}
_NUMBERS = ("inf", "-inf", "nan")


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
    return float(value) if isinstance(value, str) and value in _NUMBERS else value


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


class StoredEffect(Schema):
    """An included effect."""

    effect: str
    shape: Any


class StoredModel(Schema):
    """How the model is made again."""

    name: str
    made_by: Literal["Simulator", "fmu", "load_model", "mujoco"] | None
    file: str
    object: str
    arguments: dict[str, Any]
    included: list[StoredEffect]
    parameters: list[dict[str, Any]]
    outside: list[str] = Field(default_factory=list)
    """Files of the model that were outside its folder."""


class StoredRecord(Schema):
    """A record and its file."""

    file: str
    name: str
    inputs: list[str]
    outputs: list[str]


class StoredCandidate(Schema):
    """What can be disputed of an effect."""

    name: str
    component: str = ""
    unit: str = ""
    scale: Any = None
    sign: Any = None
    lower: Any = None
    upper: Any = None
    weight: Any = None
    shapes: Any = None


class Stored(Schema):
    """Content of case.json."""

    format: Literal["unmodeled case"]
    version: Literal[1]
    made_with: dict[str, str]
    model: StoredModel
    candidates: list[StoredCandidate]
    records: list[StoredRecord]
    hold_out: Any
    options: dict[str, Any]
    not_stored: list[str]
    sha256: dict[str, str]


# ----------------------------------------------------------------------------------- report.json


def _number(value: Any) -> Any:
    """NaN is None in JSON, and an infinite number a text."""
    if value is None or (isinstance(value, str) and value in _NUMBERS):
        return math.nan if value is None else float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("expected a number")
    return value


Number = Annotated[float, BeforeValidator(_number)]


class _Read(BaseModel):
    """Base of the parts of an answer that are compared; others are left aside."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class _Estimate(_Read):
    unit: str
    low: Number
    high: Number


class Cause(_Estimate):
    """A named cause."""

    cause: str
    magnitude: Number
    probability: Number


class Fitted(_Estimate):
    """A parameter."""

    name: str
    value: Number


class Channel(_Read):
    """Residuals of a channel."""

    name: str
    unit: str
    tabulated: Number
    calibrated: Number
    explained: Number
    noise: Number


class Answer(_Read):
    """What is compared of report.json."""

    verdict: str
    named: list[Cause]
    classes: list[list[Cause]]
    parameters: list[Fitted]
    channels: list[Channel]
    nothing: Number
    held_out_gain: Annotated[list[Number], Field(min_length=1)] | None
    complete: bool = True
