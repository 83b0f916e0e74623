"""Parameters and unknown effects of a model from short forms: ``{"mass": (2.0, 0.1, "kg")}``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter, near_names
from feltmb.fit.model import Effect, Parameter
from feltmb.units import conversion_factor

__all__ = [
    "Bounds",
    "Exposed",
    "Priors",
    "Unknowns",
    "check_bounds",
    "from_file",
    "parameters_of",
    "unknown_effects",
]

#: Parameters with their priors: ``(value, sd, unit)`` by name, or a list of :class:`Parameter`.
Priors = Sequence[Parameter] | Mapping[str, Any]
#: Effects that are parameters: unit, ``(value without it, expected size, unit)``,
#: :class:`Exposed`, or an :class:`Effect`.
Unknowns = Mapping[str, Any] | None
#: Lower and upper bound by name.
Bounds = Mapping[str, Any] | None


@checked
@dataclass(frozen=True, kw_only=True)
class Exposed:
    """An effect that is a parameter of the function, with its neutral value in the model."""

    scale: float
    """Expected deviation from the neutral value if the effect exists [unit]."""
    unit: str = "1"
    component: str = ""
    """Part of the machine; default: the name of the parameter."""
    sign: Literal[-1, 0, 1] = 0
    """+1: only values >= the neutral one; -1: only values <= the neutral one; 0: any."""
    neutral: float = 0.0
    """Value without the effect [unit]."""
    mechanism: str = ""
    """One sentence that describes the mechanism in the machine."""
    remedy: str = ""
    """Recommended remedy."""
    lower: float = -math.inf
    upper: float = math.inf
    """Upper limit of the parameter [unit]."""

    def effect(self, name: str) -> Effect:
        """The effect; its magnitude is the deviation from the neutral value."""
        return Effect(
            name=name,
            component=self.component or name,
            unit=self.unit,
            scale=self.scale,
            sign=self.sign,
            mechanism=self.mechanism,
            remedy=self.remedy,
            lower=self.lower - self.neutral,
            upper=self.upper - self.neutral,
            data=name,
        )


FORM = "expected (value, standard deviation, unit), such as (2.0, 0.1, 'kg'); sd 0 fixes it"


def _numbers(values: Any) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


def _range(name: str, bounds: Bounds) -> tuple[float, float]:
    given = (bounds or {}).get(name, (-math.inf, math.inf))
    pair = tuple(given) if isinstance(given, list | tuple) else ()
    if len(pair) != 2 or not _numbers(pair) or not pair[0] <= pair[1]:
        raise InvalidParameter(f"bounds of {name}: got {given!r}, expected (lowest, highest)")
    return float(pair[0]), float(pair[1])


def from_file(name: str, prior: Any, value: float | None, unit: str) -> Any:
    """A prior in the unit of a file, whose value None is the value of the file."""
    if not isinstance(prior, list | tuple):
        return prior
    parts = list(prior)
    if len(parts) == 3 and unit and parts[2] not in ("1", unit):
        try:
            factor = conversion_factor(parts[2], unit)
        except InvalidParameter as error:
            raise InvalidParameter(f"parameter {name}: {error}") from None
        parts[:2] = [v if v is None else factor * v for v in parts[:2]]
    if parts[:1] == [None] and value is not None:
        parts[0] = value
    if len(parts) in (2, 3):
        parts[2:] = [unit or (parts[2] if len(parts) == 3 else "1")]
    return tuple(parts)


def check_bounds(bounds: Bounds, known: Sequence[str], model: str) -> None:
    """Refuse bounds of a name that is no parameter."""
    for name in bounds or {}:
        if name not in known:
            raise InvalidParameter(
                f"model {model}: bounds of {name}, which is no parameter{near_names(name, known)}; "
                f"there are {', '.join(known) or 'none'}"
            )


def parameters_of(given: Priors, bounds: Bounds = None) -> tuple[Parameter, ...]:
    """Parameters with their priors.

    Parameters
    ----------
    given
        Name -> ``(value, sd, unit)``, ``(value, sd)`` or a value without a prior; or parameters.
    bounds
        Name -> lowest and highest value.

    Raises
    ------
    InvalidParameter
        A prior has another form.
    """
    if not isinstance(given, Mapping):
        return tuple(given)
    found = []
    for name, prior in given.items():
        parts = tuple(prior) if isinstance(prior, list | tuple) else (prior,)
        unit = parts[2] if len(parts) == 3 else "1"
        if not 1 <= len(parts) <= 3 or not _numbers(parts[:2]) or not isinstance(unit, str):
            raise InvalidParameter(f"parameter {name}: got {prior!r}, {FORM}")
        low, high = _range(name, bounds)
        sd = float(parts[1]) if len(parts) > 1 else math.inf
        found.append(
            Parameter(name=name, value=float(parts[0]), sd=sd, unit=unit, lower=low, upper=high)
        )
    return tuple(found)


def unknown_effects(
    given: Unknowns, bounds: Bounds = None
) -> tuple[tuple[Effect, ...], dict[str, float], frozenset[str]]:
    """Effects that are parameters of a function, their neutral values, and those without a size.

    Parameters
    ----------
    given
        Name -> unit, ``(neutral value, expected size, unit)`` or an effect.
    bounds
        Name -> lowest and highest value of the parameter.

    Raises
    ------
    InvalidParameter
        An item has another form.
    """
    effects, neutral, without = [], {}, set()
    for name, item in (given or {}).items():
        if isinstance(item, Exposed):
            effects.append(item.effect(name))
            neutral[name] = item.neutral
            continue
        if isinstance(item, Effect):
            effects.append(replace(item, data=name))
            neutral[name] = 0.0
            continue
        parts = (0.0, 0.0, item) if isinstance(item, str) else item
        parts = tuple(parts) if isinstance(parts, list | tuple) else ()
        right = len(parts) == 3 and _numbers(parts[:2]) and isinstance(parts[2], str)
        if not right or not 0.0 <= parts[1] < math.inf or not math.isfinite(parts[0]):
            raise InvalidParameter(
                f"unknown {name}: got {item!r}, expected its unit, such as 'N', or (value without "
                "the effect, expected size, unit)"
            )
        at, size, unit = parts
        low, high = (b - at for b in _range(name, bounds))
        if not low <= 0.0 <= high:
            raise InvalidParameter(f"bounds of {name}: they do not hold {at:g}, the value without")
        neutral[name] = float(at)
        if not size:
            without.add(name)
        effects.append(
            Effect(
                name=name,
                component=name,
                unit=unit,
                scale=size or 1.0,
                sign=1 if low == 0.0 else -1 if high == 0.0 else 0,
                lower=low,
                upper=high,
                data=name,
            )
        )
    return tuple(effects), neutral, frozenset(without)
