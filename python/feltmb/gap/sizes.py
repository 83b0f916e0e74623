"""Fitted magnitudes of effects with their intervals, as numbers and as words."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from feltmb.fit.model import Candidate, Effect
from feltmb.fit.solve import NOT_CONVERGED, Fit
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
    converged: bool = True
    """Whether its fit was not ended early."""

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
        """The effect with its magnitude, its 95 % interval, and the fitted numbers of its shape.

        Small lengths are in mm.
        """
        effect = self.candidate.effect
        shown = digits(self.magnitude, self.sd, 3)
        bounded = math.isfinite(self.low) and math.isfinite(self.high)
        # One unit for all numbers: that of the largest one.
        ends = (self.low, self.high) if bounded else ()
        factor, name = readable_unit(max(map(abs, (self.magnitude, *ends))), effect.unit)
        unit = unit_suffix(name or "1")
        text = f"{effect.name} of {factor * self.magnitude:.{shown}g}{unit}"
        low, high = (f"{factor * end:.{shown}g}" for end in (self.low, self.high))
        about = [f"95% from {low} to {high}{unit}" if bounded else "no finite 95% interval"]
        if not self.converged:
            about = [NOT_CONVERGED]
        for number in shape_numbers(effect, self.candidate.shape, self.shape_sd):
            if number.low < number.high:
                found = _NAME_AND_UNIT.fullmatch(number.name)
                name, given = (number.name, "1") if found is None else found.groups()
                factor, better = readable_unit(number.value, given)
                about.append(f"{name} {factor * number.value:.3g}{unit_suffix(better or '1')}")
        return f"{text} ({'; '.join(about)})"


def shape_numbers(effect: Effect, shape: Any, wide: Mapping[int, float]) -> tuple[ShapeNumber, ...]:
    """Numbers of a shape. ``wide``: standard deviations of the logarithms of the fitted numbers."""
    values = shape if isinstance(shape, tuple) else (shape,)
    out = []
    for i, value in enumerate(values):
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            continue
        name = effect.shape_names[i] if i < len(effect.shape_names) else "shape"
        factor = math.exp(min(1.96 * wide.get(i, 0.0), 50.0))
        away = value - effect.shape_zero
        low, high = sorted(effect.shape_zero + x for x in (away / factor, away * factor))
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
            converged=not found.fit.cut,
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
