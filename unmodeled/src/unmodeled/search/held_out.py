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


#: Least number of held-out records whose ratios are compared with each other.
MANY = 5
#: The interval from the blocks of R records is wider by 1 + SHARED / R: the blocks of a record
#: share its discrepancy, of which R records show R examples.
SHARED = 2.0


@dataclass(frozen=True)
class Ratio:
    """Log of the ratio of two rms residuals of held-out records, by record, and its interval."""

    value: float
    """Mean over the records of the log ratio; negative: the first is smaller."""
    low: float = -math.inf
    """Lower end of the 95 % interval."""
    high: float = math.inf
    smaller: int = 0
    """Number of records in which the first is smaller."""
    records: int = 0


def compare(one: Predicted, other: Predicted, noise: Array, share: float) -> Ratio:
    """Log ratio of the rms residuals of two predictions.

    The squares of all channels are added in units of ``noise``, (m,). Each record counts as much as
    another one, so that one which nobody explains does not decide for the others. With five and
    more records the interval is that of Student's t over their ratios. With fewer, it is that of
    blocks of 1 / share samples, by the infinitesimal jackknife (Efron, Biometrika 68, 1981, 589),
    and wider by a factor, because the blocks of a record share its discrepancy.
    """
    length = max(1, round(1.0 / share))
    ratios, variances = [], []
    for a, b in zip(one.residuals, other.residuals, strict=True):
        squares = [((x / noise) ** 2).sum(axis=1) for x in (a, b)]
        edges = np.arange(0, len(a), length)
        blocks = np.column_stack([np.add.reduceat(s, edges) for s in squares])
        sums = blocks.sum(axis=0) + 1e-12
        ratios.append(0.5 * math.log(sums[0] / sums[1]))
        variances.append(float(np.sum((0.5 * np.subtract(*(blocks / sums).T)) ** 2)))
    count, mean = len(ratios), float(np.mean(ratios))
    if count >= MANY:
        from scipy.special import stdtrit

        half = float(stdtrit(count - 1, 0.975)) * float(np.std(ratios, ddof=1)) / math.sqrt(count)
    else:
        half = (1.0 + SHARED / count) * HALF * math.sqrt(sum(variances)) / count
    return Ratio(mean, mean - half, mean + half, sum(r < 0.0 for r in ratios), count)
