"""Fitted magnitudes of effects with their intervals, as numbers and as words."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from feltmb.fit.model import Candidate, Effect
from feltmb.fit.solve import Fit
from feltmb.gap.acceptance import Accepted
from feltmb.gap.digits import digits
from feltmb.gap.findings import ShapeNumber
from feltmb.gap.refine import CandidateSet
from feltmb.gap.search import Search
from feltmb.gap.spread import Spread, spread, with_refused
from feltmb.units import readable_unit, unit_suffix

__all__ = ["Size", "Sizes", "shape_numbers", "where_refitted"]

#: Name and unit of a number of a shape, as in "half width [rad]".
_NAME_AND_UNIT = re.compile(r"(.*) \[(.*)\]")


@dataclass(frozen=True)
class Size:
    """Fitted magnitude of an effect."""

    candidate: Candidate
    """With its fitted shape."""
    magnitude: float
    """[unit]"""
    sd: float
    """[unit]"""
    shape_sd: Mapping[int, float]
    """Standard deviations of the logarithms of the numbers of the shape that move, by place."""

    @property
    def low(self) -> float:
        """Lower end of the 95 % interval, within the limits of the effect [unit]."""
        return float(max(self.magnitude - 1.96 * self.sd, self.candidate.effect.bounds[0]))

    @property
    def high(self) -> float:
        """Upper end [unit]."""
        return float(min(self.magnitude + 1.96 * self.sd, self.candidate.effect.bounds[1]))

    @property
    def text(self) -> str:
        """The effect with its magnitude, the fitted numbers of its shape, and their intervals.

        Small lengths are in mm.
        """
        effect = self.candidate.effect
        ends = (self.magnitude, self.low, self.high)
        parts = [f"{effect.name} of {_with_interval(*ends, self.sd, effect.unit)}"]
        for number in shape_numbers(effect, self.candidate.shape, self.shape_sd):
            if number.low < number.high:
                found = _NAME_AND_UNIT.fullmatch(number.name)
                name, unit = (number.name, "1") if found is None else found.groups()
                sd = (number.high - number.low) / (2.0 * 1.96)
                ends = (number.value, number.low, number.high)
                parts.append(f"{name} {_with_interval(*ends, sd, unit)}")
        return ", ".join(parts)


def _with_interval(value: float, low: float, high: float, sd: float, unit: str) -> str:
    """A number with its 95 % interval, in one unit."""
    shown = digits(value, sd, 3)
    bounded = math.isfinite(low) and math.isfinite(high)
    # One unit for all numbers: that of the largest one.
    factor, name = readable_unit(max(map(abs, (value, low, high) if bounded else (value,))), unit)
    suffix = unit_suffix(name or "1")
    text = f"{factor * value:.{shown}g}{suffix}"
    if not bounded:
        return f"{text} (no finite 95% interval)"
    return f"{text} (95% from {factor * low:.{shown}g} to {factor * high:.{shown}g}{suffix})"


def shape_numbers(effect: Effect, shape: Any, wide: Mapping[int, float]) -> tuple[ShapeNumber, ...]:
    """Numbers of a shape. ``wide``: standard deviations of the logarithms of the fitted numbers."""
    values = shape if isinstance(shape, tuple) else (shape,)
    out = []
    for i, value in enumerate(values):
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            continue
        name = effect.shape_names[i] if i < len(effect.shape_names) else "shape"
        factor = math.exp(min(1.96 * wide.get(i, 0.0), 50.0))
        low, high = sorted((value / factor, value * factor))
        out.append(ShapeNumber(name=name, value=float(value), low=float(low), high=float(high)))
    return tuple(out)


@dataclass(eq=False)
class Sizes:
    """Magnitudes in the accepted set, and in the best set that holds each other effect."""

    search: Search
    accepted: Accepted
    form: float
    """Relative error of the force of a law (``Options.form``) [1]."""
    _spreads: dict[tuple[Fit, bool], Spread] = field(default_factory=dict)

    def of(self, name: str, *, shapes: bool = True) -> Size | None:
        """Magnitude of an effect; None: it is in no set that was fitted.

        ``shapes``: whether its interval contains the uncertainty of the shapes.
        """
        found = where_refitted(self.search, self.accepted, name)
        if found is None:
            return None
        own, k = self.spread(found.fit, shapes=shapes), found.names.index(name)
        at = len(found.fit.problem.free) + k
        return Size(
            candidate=found.fit.included[k],
            magnitude=float(found.fit.point.magnitudes[k]),
            sd=math.sqrt(max(float(own.total[at, at]), 0.0)),
            shape_sd={i: v for (j, i), v in own.shapes.items() if j == k},
        )

    def spread(self, fit: Fit, *, shapes: bool = True) -> Spread:
        """Uncertainty of a fit, computed once; of the accepted set with the refused effects."""
        if (fit, shapes) not in self._spreads:
            found = spread(fit, self.form, shapes=shapes)
            accepted, first = self.accepted.best, self.search.best
            if accepted is not None and first is not None and accepted.fit is fit is not first.fit:
                found = with_refused(found, fit, first.fit)
            self._spreads[fit, shapes] = found
        return self._spreads[fit, shapes]

    def text(self, name: str) -> str:
        """An effect with its magnitude, unit and interval; its name alone where there is none."""
        found = self.of(name)
        return name if found is None else found.text

    def mechanism(self, name: str) -> str:
        """What the effect is, in the words of the library; may be empty."""
        found = self.of(name)
        return "" if found is None else found.candidate.effect.mechanism


def where_refitted(search: Search, accepted: Accepted, name: str) -> CandidateSet | None:
    """The accepted set if the effect is in it, else the best set that holds it."""
    if accepted.best is not None and name in accepted.best.names:
        return accepted.best
    return next((c for c in search.sets if name in c.names), None)
