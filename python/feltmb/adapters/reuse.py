"""Derivatives kept while the point moves little: a chord method for expensive models.

Outputs and end states are always computed anew at the point that is asked for; only their
derivatives may come from a point nearby. A Gauss-Newton iteration converges with them as well, to
the same point, in a few more cheap steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Record
from feltmb.fit import Candidate, Jobs, Model, Sensitivity
from feltmb.fit.latest import Latest

__all__ = ["Kept", "Question", "Reuse"]


@dataclass(frozen=True)
class Kept:
    """Derivatives and where they were taken."""

    theta: Array
    magnitudes: Array
    starts: Array
    value: Sensitivity


@dataclass(frozen=True)
class Question:
    """What derivatives are asked for, and where."""

    record: Record
    segments: NDArray[np.intp]
    theta: Array
    starts: Array
    included: tuple[Candidate, ...]
    magnitudes: Array
    by_theta: tuple[int, ...]
    by_starts: bool
    candidates: tuple[Candidate, ...]

    def key(self) -> tuple[object, ...]:
        """What must be the same for kept derivatives to be an answer."""
        return (
            self.record.name,
            hash(tuple(v.tobytes() for v in self.record.inputs.values())),
            self.segments.tobytes(),
            tuple((t.name, t.shape) for t in self.included),
            self.by_theta,
            self.by_starts,
            tuple((t.name, t.shape) for t in self.candidates),
        )


class Reuse:
    """Store of derivatives by question.

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
        question: Question,
        compute: Callable[[], Sensitivity],
    ) -> Sensitivity:
        """Derivatives at or near a point, values at it."""
        q = question
        theta, magnitudes, starts = q.theta, q.magnitudes, q.starts
        key = q.key()
        units = (
            np.array([p.size for p in model.parameters]),
            np.array([t.effect.scale for t in q.included]),
            np.array([s.scale for s in model.states(q.included)]),
        )
        kept = self._kept.find(key)
        if kept is not None and self._near(kept, theta, magnitudes, starts, units):
            self.hits += 1
            run = model.simulate(
                q.record, Jobs.at_point(theta, q.segments, starts, q.included, magnitudes)
            )
            return replace(kept.value, outputs=run.outputs, ends=run.ends)
        self.misses += 1
        value = compute()
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
