"""Derivatives kept while the point moves little: a chord method for expensive models.

Outputs and end states are always computed anew at the point that is asked for; only their
derivatives may come from a point nearby. A Gauss-Newton iteration converges with them as well, to
the same point, in a few more cheap steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit import Model, Sensitivity, SensitivityRequest
from feltmb.fit.latest import Latest

__all__ = ["Kept", "Reuse"]


@dataclass(frozen=True)
class Kept:
    """Derivatives and where they were taken."""

    theta: Array
    magnitudes: Array
    starts: Array
    value: Sensitivity


def _key(model: Model, request: SensitivityRequest) -> tuple[object, ...]:
    """What must be the same for kept derivatives to be an answer."""
    return (
        request.record.name,
        hash(tuple(v.tobytes() for v in request.record.inputs.values())),
        request.segments.tobytes(),
        tuple((t.name, t.shape) for t in request.included),
        request.parameters_of(model),
        request.by_starts,
        tuple((t.name, t.shape) for t in request.candidates),
    )


class Reuse:
    """Store of derivatives by what is asked for.

    Parameters
    ----------
    theta_sd
        Distance of the parameters over which derivatives are kept, in their scales.
    start_scale
        The same of the start states, in theirs.
    size_scale
        The same of the magnitudes of effects, in their scales.
    """

    def __init__(
        self,
        theta_sd: float = 0.5,
        start_scale: float = 2.0,
        size_scale: float = 0.5,
        keep: int = 64,
    ):
        self.theta_sd = theta_sd
        self.start_scale = start_scale
        self.size_scale = size_scale
        self._kept: Latest[tuple[object, ...], Kept] = Latest(keep)
        self.hits = 0
        self.misses = 0

    def clear(self) -> None:
        """Forget all derivatives."""
        self._kept.clear()

    def ask(
        self,
        model: Model,
        request: SensitivityRequest,
        compute: Callable[[SensitivityRequest], Sensitivity],
    ) -> Sensitivity:
        """Derivatives at or near a point, values at it."""
        theta, magnitudes, starts = request.theta, request.sizes, request.starts
        key = _key(model, request)
        units = (
            np.array([p.size for p in model.parameters]),
            np.array([t.effect.scale for t in request.included]),
            np.array([s.scale for s in model.states(request.included)]),
        )
        kept = self._kept.find(key)
        if kept is not None and self._near(kept, theta, magnitudes, starts, units):
            self.hits += 1
            run = model.simulate(request.record, request.jobs())
            return replace(kept.value, outputs=run.outputs, ends=run.ends)
        self.misses += 1
        value = compute(request)
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
        limits = (self.theta_sd, self.size_scale, self.start_scale)
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
