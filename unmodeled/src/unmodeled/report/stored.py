"""What case.json and report.json hold: the schemas of both files."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from unmodeled.report.values import NUMBERS
from unmodeled.units.quantity import Schema


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
    if value is None or (isinstance(value, str) and value in NUMBERS):
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
