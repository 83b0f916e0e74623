"""Effects on a state of a first-order system: losses and gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array
from unmodeled.errors import InvalidParameter
from unmodeled.fit import Effect, Named, State
from unmodeled.models.subject import Subject


def _on(state: str, name: str, label: str, **fields: Any) -> Effect:
    about = Subject("state", label, state, state, label)
    return Effect(name=name, component=state, label=label, subject=about, **fields)


@checked
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

    return _on(
        state,
        f"overflow {state}",
        "an overflow",
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


@checked
def leak(state: str, *, scale: float) -> Effect:
    """A loss proportional to the state.

    Examples
    --------
    An outflow in proportion to the volume V of a tank, about 0.01 1/s:

    >>> from unmodeled import library
    >>> library.leak("V", scale=0.01).unit
    '1/s'
    """
    return _on(
        state,
        f"leak {state}",
        "a leak",
        unit="1/s",
        scale=scale,
        mechanism="The store loses in proportion to its level.",
        remedy="Add the loss.",
        rate=lambda t, x, u, p, size, shape: {state: -size * x[state]},
    )


@checked
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
    return _on(
        state,
        f"loss ~ {state}^{power:g}",
        f"a loss ~ {state}^{power:g}",
        unit=unit,
        scale=scale,
        mechanism=f"The store loses with the power {power:g} of its level.",
        remedy="Use another law of outflow.",
        rate=lambda t, x, u, p, size, shape: {state: -size * np.maximum(x[state], 0.0) ** power},
    )


@checked
def product_loss(state: str, one: str, other: str, *, scale: float, unit: str = "1/s") -> Effect:
    """A loss in proportion to two states: prey that meets predators, a reaction of two substances.

    The state loses ``magnitude one other`` per second, and gains with a negative magnitude.

    Parameters
    ----------
    state
        State that loses.
    one, other
        The two states; one of them may be the state itself.
    scale
        Magnitude that one would expect.
    unit
        Unit of the magnitude: with states in mol/m^3, ``m^3/(mol s)``.
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        return {state: -size * x[one] * x[other]}

    return _on(
        state,
        f"loss ~ {one} {other} {state}",
        f"a loss ~ {one} {other}",
        unit=unit,
        scale=scale,
        mechanism=f"The store loses in proportion to the product of {one} and {other}.",
        remedy="Add the product of both states to the balance.",
        rate=rate,
    )


@checked
def exchange(
    state: str, ambient: str, power: float = 1.0, *, scale: float, unit: str = "1/s"
) -> Effect:
    """An exchange with the surroundings that the model does not have, or has with another law.

    With the difference d = state - ambient, the state loses ``magnitude d |d|^(power - 1)`` per
    second: heat that a warm body loses to the air of a room, or a substance that passes a membrane.
    The state gains if it is below the ambient value.

    Parameters
    ----------
    state
        State that exchanges.
    ambient
        Input of the model in the unit of the state, such as the temperature of the room.
    power
        Power of the difference, > 0: 1 for conduction and forced convection, about 1.25 for the
        free convection of air, 2 for turbulent flow through an opening.
    scale
        Magnitude that one would expect.
    unit
        Unit of the magnitude: with the unit degC of the state and power 2, ``1/(degC s)``.

    Raises
    ------
    InvalidParameter
        The power is not finite or not above zero.
    """
    if not 0.0 < power < np.inf:
        raise InvalidParameter(f"exchange: power = {power!r}, expected a finite number > 0")

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        difference = x[state] - u[ambient]
        return {state: -size * np.sign(difference) * np.abs(difference) ** power}

    law = "" if power == 1.0 else f"^{power:g}"
    return _on(
        state,
        f"exchange ~ ({state} - {ambient}){law}",
        f"an exchange ~ ({state} - {ambient}){law}",
        unit=unit,
        scale=scale,
        mechanism=f"{state} approaches {ambient} at a rate ~ |{state} - {ambient}|{law}.",
        remedy="Add the exchange with the surroundings, or use another law of it.",
        rate=rate,
    )


@checked
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
    return _on(
        state,
        f"constant inflow {state}",
        "a constant inflow",
        unit=unit,
        scale=scale,
        mechanism="Something flows in (or out) all the time.",
        remedy="Add the constant flow.",
        rate=lambda t, x, u, p, size, shape: {state: size + 0.0 * x[state]},
    )


@checked
def second_store(state: str, *, scale: float, size: float, times: Sequence[float]) -> Effect:
    """A hidden store behind a state: dx/dt gains magnitude (w - x), dw/dt = (x - w) / tau.

    Parameters
    ----------
    state
        State with a store behind it, such as the air of a room before its walls.
    scale
        Rate of the exchange that one would expect [1/s].
    size
        Typical value of the state [its unit], near which the store begins a record.
    times
        Time constants tau of the store that are tried [s].
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, tau: Any) -> Mapping[str, Array]:
        apart = x[state] - x["store.level"]
        return {state: -size * apart, "store.level": apart / tau}

    return _on(
        state,
        f"second store {state}",
        "a second store",
        unit="1/s",
        scale=scale,
        sign=1,
        kind="state",
        mechanism=f"Behind {state} is another store, with which it exchanges.",
        shapes=tuple(times),
        shape_names=("time [s]",),
        remedy="Add a second store to the model.",
        hidden=(State(name="store.level", hidden=True, scale=size),),
        rate=rate,
    )
