"""Held-out records: what a set of causes gains where it was not fitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import Fitted, weights
from unmodeled.search.fit import PARTS, fit_local, run_in_lockstep
from unmodeled.search.linear import Point, local_of
from unmodeled.search.problem import Problem

#: Half width of a 95 % interval in standard deviations.
HALF = 1.96


@dataclass(frozen=True, eq=False)
class Predicted:
    """Held-out records with a set of causes; only unknowns of the records are fitted."""

    point: Point
    residuals: tuple[Array, ...]
    """By record, in units of the noise of the sensors, (n, m)."""

    def rms(self, problem: Problem) -> Array:
        """Rms of the residual by channel [its unit], (m,)."""
        squares = sum(
            ((x * o.sd) ** 2).sum(axis=0)
            for x, o in zip(self.residuals, problem.held_out, strict=True)
        )
        samples = sum(o.samples for o in problem.held_out)
        return np.asarray(np.sqrt(squares / np.maximum(samples, 1.0)))


def predict(
    problem: Problem, sets: Sequence[Fitted], step: Callable[[], None] = lambda: None
) -> list[Predicted | None]:
    """Predict the held-out records with fitted sets; None: the simulation fails.

    ``step`` is called before each simulation of all fits.
    """
    runs = []
    for s in sets:
        start = Point(
            s.point.x,
            tuple(np.zeros(len(local_of(problem, s.members, o))) for o in problem.held_out),
        )
        parts = PARTS if _unknown_starts(problem) else ()
        runs.append(
            fit_local(
                problem,
                problem.held_out,
                s.members,
                start,
                s.noise,
                weights(problem, s, s),
                parts=parts,
            )
        )
    return [
        None if f is None else Predicted(f.point, f.residuals)
        for f in run_in_lockstep(problem, runs, step)
    ]


def _unknown_starts(problem: Problem) -> bool:
    return any(q.unknown for o in problem.held_out for q in o.local)


def compare(
    one: Predicted, other: Predicted, noise: Array, share: float
) -> tuple[float, float, float]:
    """Log ratio of the rms residuals of two predictions, with a 95 % interval from blocks.

    The squares of all channels are added in units of ``noise``, (m,). Blocks have 1 / share
    samples, so that they are nearly independent; the variance is that of the infinitesimal
    jackknife (Efron, Biometrika 68, 1981, 589). Negative: the first prediction is better.
    """
    length = max(1, round(1.0 / share))
    pairs = []
    for a, b in zip(one.residuals, other.residuals, strict=True):
        squares = [((x / noise) ** 2).sum(axis=1) for x in (a, b)]
        edges = np.arange(0, len(a), length)
        pairs.append(np.column_stack([np.add.reduceat(s, edges) for s in squares]))
    blocks = np.concatenate(pairs)
    sums = blocks.sum(axis=0) + 1e-12
    ratio = 0.5 * math.log(sums[0] / sums[1])
    half = HALF * float(np.linalg.norm(0.5 * np.subtract(*(blocks / sums).T)))
    return ratio, ratio - half, ratio + half
