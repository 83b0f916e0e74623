"""Caches derivatives while the point changes little: a chord method for expensive models.

Outputs and end states are always computed at the requested point; only the derivatives may come
from a nearby point. A Gauss-Newton iteration then converges to the same point, with a few more
cheap steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit import Model, Sensitivity, SensitivityRequest
from feltmb.fit.latest import Latest

__all__ = ["Kept", "Reuse"]


@dataclass(frozen=True)
class Kept:
    """Cached derivatives and the point at which they were computed."""

    theta: Array
    magnitudes: Array
    starts: Array
    value: Sensitivity


def _key(model: Model, request: SensitivityRequest) -> tuple[object, ...]:
    """Everything except the point that must be equal for cached derivatives to apply."""
    return (
        request.record.excitation,
        request.segments.tobytes(),
        tuple((t.name, t.shape) for t in request.included),
        request.parameters_of(model),
        request.by_starts,
        tuple((t.name, t.shape) for t in request.candidates),
    )


#: Largest changes of parameters, start states and magnitudes for which derivatives are reused, in
#: their scales, and number of points that are kept.
THETA, STARTS, MAGNITUDES, KEPT = 0.5, 2.0, 0.5, 64


class Reuse:
    """Cache of derivatives."""

    def __init__(self) -> None:
        self._kept: Latest[tuple[object, ...], Kept] = Latest(KEPT)

    def clear(self) -> None:
        """Remove all derivatives."""
        self._kept.clear()

    def ask(
        self,
        model: Model,
        request: SensitivityRequest,
        compute: Callable[[Sequence[SensitivityRequest]], list[Sensitivity]],
    ) -> Sensitivity:
        """Values at a point, with derivatives at or near it."""
        theta, magnitudes, starts = request.theta, request.sizes, request.starts
        key = _key(model, request)
        units = (
            np.array([p.size for p in model.parameters]),
            np.array([t.effect.scale for t in request.included]),
            np.array([s.scale for s in model.states(request.included)]),
        )
        kept = self._kept.find(key)
        if kept is not None and self._near(kept, theta, magnitudes, starts, units):
            run = model.simulate(request.record, request.jobs())
            return replace(kept.value, outputs=run.outputs, ends=run.ends)
        value = compute([request])[0]
        self._kept.keep(key, Kept(theta.copy(), magnitudes.copy(), starts.copy(), value))
        return value

    def _near(
        self,
        kept: Kept,
        theta: Array,
        magnitudes: Array,
        starts: Array,
        units: tuple[Array, Array, Array],
    ) -> bool:
        limits = (THETA, MAGNITUDES, STARTS)
        for old, new, unit, limit in zip(
            (kept.theta, kept.magnitudes, kept.starts),
            (theta, magnitudes, starts),
            units,
            limits,
            strict=True,
        ):
            if old.shape != new.shape:
                return False
            if old.size and np.max(np.abs(new - old) / unit) > limit:
                return False
        return True
