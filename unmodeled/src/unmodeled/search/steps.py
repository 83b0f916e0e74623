"""A step of a fit: its direction within bounds, how far it is trusted, and old derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import NormalEquations, Prior
from unmodeled.search.linear import Point

#: Largest change of a global unknown in the first step, in its scale; it follows the success.
RADIUS = 2.0
#: Share of the promised gain above which derivatives are used again [1].
AS_PROMISED = 0.5
#: Trials of a step, and how many shorter ones are tried with derivatives of an earlier point:
#: these cost ten times as much as a trial, and a step often fails at a kink that they do not show.
TRIALS, STALE = 7, 2


@dataclass(frozen=True, eq=False)
class Move:
    """A step of global and local unknowns."""

    own: NormalEquations
    prior: Prior
    x: Array
    """Global unknowns before it."""
    step: Array
    local: list[Array]
    damping: float

    @property
    def length(self) -> float:
        """Largest change of a global unknown, in its scale."""
        return float(np.abs(self.step).max(initial=0.0))

    @cached_property
    def promised(self) -> float:
        """Gain that it promises, to second order [log posterior]; local unknowns follow."""
        own, step = self.own, self.step
        slope = own.right - self.prior.weights(self.x) * self.x
        inner = sum(float(t @ np.linalg.solve(matrix, t)) for matrix, _, t in own.locals)
        return float(slope @ step) - 0.5 * float(step @ own.matrix @ step) + 0.5 * inner

    def of(self, point: Point) -> Point:
        """The point after it."""
        pairs = zip(point.local, self.local, strict=True)
        return Point(point.x + self.step, tuple(a + b for a, b in pairs))


@dataclass(frozen=True, eq=False)
class Box:
    """Lower and upper limits of the global unknowns: a step ends within them."""

    low: Array
    high: Array

    def inside(self, x: Array) -> Array:
        """The nearest point within the limits."""
        return np.asarray(np.clip(x, self.low, self.high))

    def move(self, own: NormalEquations, prior: Prior, x: Array, damping: float) -> Move:
        """Step from normal equations. A limit that it passes is reached; the others adapt to it."""
        weight = prior.weights(x)
        matrix = own.matrix + np.diag(weight * (1.0 + damping) + damping * np.diag(own.matrix))
        right = own.right - weight * x
        step, held = np.zeros(x.size), np.zeros(x.size, dtype=bool)
        for _ in range(6):
            inner = ~held
            if inner.any():
                target = right[inner] - matrix[np.ix_(inner, held)] @ step[held]
                step[inner] = np.linalg.solve(matrix[np.ix_(inner, inner)], target)
            beyond = inner & ((x + step < self.low) | (x + step > self.high))
            if not beyond.any():
                break
            step[beyond] = self.inside(x + step)[beyond] - x[beyond]
            held |= beyond
        step = self.inside(x + step) - x
        local = [
            np.asarray(np.linalg.solve(inner, target - coupling @ step))
            for inner, coupling, target in own.locals
        ]
        return Move(own, prior, x, np.asarray(step), local, damping)


@dataclass
class TrustRadius:
    """How far a step may go: as far as the last ones were of use."""

    radius: float = RADIUS
    """Largest change of a global unknown, in its scale."""
    far: bool = False
    """Whether it limits steps that succeed: the fit is on its way."""

    def within(self, move: Callable[[float], Move]) -> Move:
        """The step with the least damping with which it is short enough."""
        damping = 1e-3
        for _ in range(20):
            found = move(damping)
            if found.length <= 1.1 * self.radius:
                break
            damping = max(damping, 0.03) * min(found.length / self.radius, 10.0)
        return found

    def accepted(self, move: Move) -> None:
        """Trust a step that gained, and one of twice its length."""
        self.far = move.damping > 1e-3 and self.radius >= RADIUS
        self.radius = max(self.radius, 2.0 * move.length)

    def rejected(self, move: Move) -> None:
        """Try a shorter one."""
        self.radius = 0.4 * move.length


@dataclass
class Freshness:
    """Whether the derivatives of a fit are those of its point.

    Those that are not cheap are used again while steps gain what they promise; the last point of a
    fit has its own.
    """

    cheap: bool
    """Whether they take about as long as a simulation."""
    stale: bool = False
    """Whether they are those of an earlier point, corrected."""
    failed: bool = False
    """Whether a trial of this step failed."""

    @property
    def asked(self) -> bool:
        """Whether a trial asks for derivatives: a first one is mostly accepted, and needs them."""
        return self.cheap and not self.failed

    def accepted(self, gain: float, promised: float) -> None:
        """A step gained."""
        self.failed = False
        self.stale = not self.cheap and gain > AS_PROMISED * promised

    def rejected(self) -> None:
        """A step did not gain."""
        self.failed = True

    def renewed(self) -> None:
        """They are those of the point."""
        self.stale = False

    def due(self, trial: int) -> bool:
        """Whether the next trial needs those of the point."""
        return self.stale and trial == STALE
