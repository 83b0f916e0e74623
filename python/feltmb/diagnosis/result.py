"""Results of a diagnosis: numbers and codes, no sentences."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from feltmb.data import Array

__all__ = [
    "Channel",
    "Named",
    "ParameterValue",
    "Reason",
    "Result",
    "SetOfCauses",
    "Verdict",
]


class Verdict(Enum):
    """What a diagnosis says."""

    NO_GAP = "no gap"
    """The tabulated model already agrees with the records."""
    CALIBRATED = "calibrated"
    """With parameters within their tolerances, the model agrees."""
    NAMED = "named"
    """One or more causes are named."""
    ONE_OF = "one of"
    """One of a class of causes is missing; the records do not tell which one."""
    UNKNOWN = "unknown"
    """A material residual remains, and no cause explains it."""


class Reason(Enum):
    """Why a verdict is what it is."""

    WITHIN_NOISE = "residual within twice the noise of the sensor"
    WITHIN_GOOD_ENOUGH = "residual within what is good enough"
    NOISE_NOT_STATED = "no noise of the sensor is stated"
    DIFFERS_BETWEEN_RECORDS = "the magnitude differs between records"
    BELOW_RESIDUAL = "the action is smaller than the unexplained residual"
    NO_HELD_OUT_GAIN = "held-out records are not predicted better"
    CALIBRATION_PREDICTS_WORSE = "the calibrated model predicts held-out records worse"
    NOT_COMPLETE = "the search was ended before its end"


@dataclass(frozen=True)
class Channel:
    """Residuals of one output, as rms in its unit; NaN: no held-out record shows it."""

    name: str
    unit: str
    noise: float
    """Noise of the sensor; NaN: not stated."""
    motion: float
    """Rms of the measured values about their mean, by record."""
    tabulated: float
    """Residual of the tabulated model."""
    calibrated: float
    """Residual after a fit of the parameters."""
    explained: float
    """Residual with the named causes, or with the most probable set."""
    held_out_calibrated: float = float("nan")
    held_out_explained: float = float("nan")
    good_enough: float = 0.0
    """Residual that does not matter."""

    @property
    def material(self) -> bool:
        """Whether the unexplained residual matters: beyond the noise and good_enough."""
        known = 0.0 if math.isnan(self.noise) else self.noise
        return self.explained > max(2.0 * known, self.good_enough)


@dataclass(frozen=True)
class ParameterValue:
    """A fitted parameter of the model."""

    name: str
    title: str
    unit: str
    tabulated: float
    sd: float
    """Standard deviation of the prior."""
    value: float
    low: float
    """Lower end of the 95 % interval."""
    high: float


@dataclass(frozen=True)
class Named:
    """A cause with its magnitude in the set in which it is most probable."""

    cause: str
    component: str
    unit: str
    magnitude: float
    low: float
    """Lower end of the 95 % interval."""
    high: float
    probability: float
    """Posterior probability that it is missing [1]."""
    shape: Any = None
    shape_names: tuple[str, ...] = ()
    by_record: tuple[float, ...] = ()
    """Magnitude in each fitted record by itself."""
    same: float = 1.0
    """Probability of such differences between records if the magnitude is one number [1]."""
    parameter: bool = False
    """Whether it is a parameter outside its tolerance; the magnitude is its value."""
    mechanism: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class SetOfCauses:
    """One fitted set of causes."""

    causes: tuple[str, ...]
    probability: float
    residual: tuple[float, ...]
    """Rms of the residual by channel [its unit]."""
    magnitudes: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a diagnosis."""

    verdict: Verdict
    reasons: tuple[Reason, ...]
    channels: tuple[Channel, ...]
    named: tuple[Named, ...]
    classes: tuple[tuple[Named, ...], ...]
    """Each class: one of its members is missing."""
    parameters: tuple[ParameterValue, ...]
    """Fitted parameters, with the named causes."""
    sets: tuple[SetOfCauses, ...]
    """Fitted sets, the most probable first."""
    held_out_gain: tuple[float, float, float] | None = None
    """Ratio of the rms residuals of held-out records with and without the told causes, with its
    95 % interval [1]; None: nothing is told."""
    nothing: float = 1.0
    """Posterior probability that no listed cause is missing [1]."""
    not_tried: tuple[str, ...] = ()
    """Causes that no fitted set contains, most promising first."""
    complete: bool = True
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    residuals: tuple[Array, ...] = field(default=(), repr=False)
    """Residual of the told set by fitted record [units of the channels], (n, m)."""
