"""What short forms of equations leave out: states, inputs and coordinates, found by a trial."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feltmb.data import Array
from feltmb.errors import InvalidParameter
from feltmb.fit.coordinates import Coordinate, Named
from feltmb.fit.model import Effect, Parameter, State
from feltmb.units import same_unit

__all__ = ["Trial", "by_rates", "states_of", "trial", "with_unknown"]

Rates = Callable[[Any, Named, Named, Named], Any]
#: Number of random points of a trial, and relative difference that is none [1].
POINTS, EQUAL = 4, 1e-9


def states_of(given: Sequence[State] | Mapping[str, Any]) -> tuple[State, ...]:
    """States from units by name, or from ``(start, sd of the start, unit)``.

    Raises
    ------
    InvalidParameter
        A state has another form.
    """
    if not isinstance(given, Mapping):
        return tuple(given)
    found = []
    for name, item in given.items():
        parts = (0.0, math.inf, item) if isinstance(item, str) else item
        try:
            start, sd, unit = parts
            found.append(State(name=name, unit=unit, start=float(start), start_sd=float(sd)))
        except (TypeError, ValueError, InvalidParameter):
            raise InvalidParameter(
                f"state {name}: got {item!r}, expected its unit, such as 'm', or (start, standard "
                "deviation of the start, unit)"
            ) from None
    return tuple(found)


def with_unknown(rates: Rates, neutral: Mapping[str, float]) -> Rates:
    """The rates with the unknown effects at the values without them."""
    if not neutral:
        return rates
    return lambda t, x, u, p: rates(t, x, u, Named._of({**p._values, **neutral}))


def by_rates(rates: Rates, effect: Effect, neutral: Mapping[str, float]) -> Effect:
    """An effect that is a parameter of the rates: it adds their difference."""
    name = effect.data

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Any]:
        del shape
        values = {**p._values, **neutral}
        without = rates(t, x, u, Named._of(values))
        values[name] = neutral[name] + size
        own = rates(t, x, u, Named._of(values))
        return {s: b - a for s, a, b in zip(x._values, without, own, strict=False)}

    return replace(effect, rate=rate)


class _Read(Named):
    """Inputs of a trial: any name has random values, and is noted."""

    __slots__ = ("_draw", "read")

    def __init__(self, draw: Callable[[], Array]):
        self._values: dict[str, Any] = {}
        self._draw = draw

    def __getitem__(self, name: str) -> Any:
        return self._values.setdefault(name, self._draw())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self._values.setdefault(name, self._draw())


@dataclass(frozen=True)
class Trial:
    """What the rates are found to be at random points."""

    inputs: tuple[str, ...] = ()
    coordinates: tuple[Coordinate, ...] = ()


def trial(
    rates: Rates,
    states: Sequence[State],
    parameters: Sequence[Parameter],
    inputs: Iterable[str] | None,
) -> Trial:
    """Evaluate the rates at random points; rates that fail there tell nothing.

    Parameters
    ----------
    rates
        The rates.
    states, parameters
        States and parameters of the model.
    inputs
        Names of the inputs; None: all that the rates read.
    """
    random = np.random.default_rng(0)

    def draw() -> Array:
        return random.uniform(0.5, 1.5, POINTS)

    x = {s.name: s.start + s.scale * draw() for s in states}
    p = {q.name: q.value * (1.0 + 0.02 * (draw() - 1.0)) for q in parameters}
    u = _Read(draw) if inputs is None else Named({n: draw() for n in inputs})

    def at(values: Mapping[str, Any]) -> list[Array]:
        with np.errstate(all="ignore"):
            found = rates(np.zeros(POINTS), Named(x), u, Named(values))
        return [np.zeros(POINTS) + np.asarray(v, dtype=np.float64) for v in found]

    try:
        base = at(p)
        heavy = {q.name: at({**p, q.name: 2.0 * p[q.name]}) for q in parameters if _massive(q)}
    except Exception:  # a rate that needs other values; the first simulation reports its faults
        return Trial(tuple(u._values) if isinstance(u, _Read) else ())
    found = []
    for q, rate in zip(states, base, strict=False):
        speeds = [i for i, v in enumerate(states) if v is not q and np.array_equal(rate, x[v.name])]
        if len(speeds) == 1:
            i = speeds[0]
            inertias = [
                name
                for name, other in heavy.items()
                if np.allclose(2.0 * other[i], base[i], rtol=EQUAL, atol=0.0) and base[i].any()
            ]
            found.append(_coordinate(q, states[i], inertias))
    return Trial(tuple(u._values) if isinstance(u, _Read) else (), tuple(found))


def _massive(parameter: Parameter) -> bool:
    return any(same_unit(parameter.unit, unit) for unit in ("kg", "kg m^2"))


def _coordinate(position: State, speed: State, inertias: Sequence[str]) -> Coordinate:
    """Coordinate of two states; with one inertia, forces on it are forces."""
    unit = "1" if position.unit == "1" else position.unit
    turns = same_unit(unit, "rad")
    inertia = inertias[0] if len(inertias) == 1 else None
    force = ("N m" if turns else "N") if inertia else f"{unit}/s^2"
    return Coordinate(
        name=position.name,
        position=position.name,
        speed=speed.name,
        inertia=inertia,
        unit=force,
        position_unit=unit,
    )
