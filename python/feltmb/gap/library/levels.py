"""Effects on a state of a first-order system: losses and gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feltmb.data import Array
from feltmb.fit import Effect, Named


def overflow(state: str, *, levels: Sequence[float], rate_scale: float, into: str = "") -> Effect:
    """Overflow above a level: the state loses magnitude * max(0, x - level) per second.

    The level is a shape. With ``into``, a share of the loss (second number of the shape) flows into
    another state. If the magnitude is much larger than the rates of the system, the state stays at
    the level.

    Parameters
    ----------
    state
        State that overflows.
    levels
        Levels of the overflow that are tried.
    rate_scale
        Rate of the overflow that one would expect.
    into
        State that receives a share of the loss; empty: none does.
    """
    shares = (0.0, 0.5, 1.0) if into else (0.0,)

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        level, share = shape
        loss = size * np.maximum(x[state] - level, 0.0)
        change = {state: -loss}
        if into:
            change[into] = share * loss
        return change

    return Effect(
        name=f"overflow {state}",
        component=state,
        unit="1/s",
        scale=rate_scale,
        sign=1,
        upper=100.0 * rate_scale,
        mechanism="Above a level the store spills.",
        shapes=tuple((float(level), share) for level in levels for share in shares),
        shape_names=("level [state unit]", "share"),
        remedy="Limit the level, or model the overflow.",
        rate=rate,
    )


def leak(state: str, *, scale: float) -> Effect:
    """A loss proportional to the state."""
    return Effect(
        name=f"leak {state}",
        component=state,
        unit="1/s",
        scale=scale,
        mechanism="The store loses in proportion to its level.",
        remedy="Add the loss.",
        rate=lambda t, x, u, p, size, shape: {state: -size * x[state]},
    )


def power_outflow(state: str, power: float, *, scale: float, unit: str) -> Effect:
    """A loss proportional to a power of the state that the model does not have.

    Parameters
    ----------
    state
        State that loses.
    power
        Power of the state.
    scale
        Magnitude that one would expect.
    unit
        Unit of the magnitude: with the unit m of the state and power 2, ``1/(m s)``.
    """
    return Effect(
        name=f"loss ~ {state}^{power:g}",
        component=state,
        unit=unit,
        scale=scale,
        mechanism=f"The store loses with the power {power:g} of its level.",
        remedy="Use another law of outflow.",
        rate=lambda t, x, u, p, size, shape: {state: -size * np.maximum(x[state], 0.0) ** power},
    )


def constant_rate(state: str, *, scale: float, unit: str) -> Effect:
    """A constant inflow.

    Parameters
    ----------
    state
        State that gains.
    scale
        Magnitude that one would expect.
    unit
        Unit of the rate of the state, for example ``m/s``.
    """
    return Effect(
        name=f"constant inflow {state}",
        component=state,
        unit=unit,
        scale=scale,
        mechanism="Something flows in (or out) all the time.",
        remedy="Add the constant flow.",
        rate=lambda t, x, u, p, size, shape: {state: size + 0.0 * x[state]},
    )
