"""Effects and parameters of :mod:`feltmb.fit` from entries of a library."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from feltmb.adapters.library import Entry
from feltmb.adapters.signals import excite_by, observe_by
from feltmb.arguments import checked
from feltmb.fit import Effect, Parameter

__all__ = ["effect_of", "parameter_of"]


@checked
def effect_of(
    entry: Entry,
    outputs: Sequence[str],
    channels: Mapping[str, Sequence[str]],
    *,
    tolerance_parameter: str = "",
    tolerance_ratio: float = 1.0,
) -> Effect:
    """Make an effect from an entry of a library.

    Parameters
    ----------
    outputs
        Outputs of the model, on which sensor effects act.
    channels
        Outputs by channel name.
    tolerance_parameter
        Tolerance that changes the same values.
    tolerance_ratio
        Change of this tolerance that acts as a magnitude of 1 does [unit of the tolerance per unit
        of the effect].
    """
    observe: Any = None
    excite: Any = None
    data: Any = entry
    if entry.sensor is not None:
        observe, data = observe_by(entry.sensor, outputs, channels), None
    elif entry.input is not None:
        excite, data = excite_by(entry.input), None
    return Effect(
        name=entry.name,
        component=entry.component,
        unit=entry.unit.replace("{input_unit}", "N"),
        scale=entry.magnitude,
        sign=entry.sign,
        mechanism=entry.mechanism,
        kind=entry.kind,
        shapes=entry.shapes,
        remedy=entry.remedy,
        lower=entry.lower,
        upper=entry.upper,
        step=entry.step,
        observe=observe,
        excite=excite,
        tolerance_parameter=tolerance_parameter,
        tolerance_ratio=tolerance_ratio,
        data=data,
    )


def parameter_of(entry: Entry) -> Parameter:
    """Make a parameter from a tolerance of a library; zero is the tabulated value."""
    return Parameter(
        name=entry.name,
        value=0.0,
        sd=entry.magnitude,
        unit=entry.unit,
        lower=max(entry.lower, -0.9 if entry.unit == "1" else -math.inf),
        upper=entry.upper,
        component=entry.component,
    )
