"""Standard uncertainties of a measured loop: from the scatter of its cycles, or of its samples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from feltmb.arguments import checked
from feltmb.felt.monotone import MonotoneCurve, monotone_curve
from feltmb.fiber.approach import LEAST, TOUCH
from feltmb.fiber.cycles import Branches

__all__ = [
    "Cycles",
    "LoopUncertainty",
    "complete_cycles",
    "envelope_errors",
    "loop_uncertainty",
    "offset_error",
    "quantile",
]

Array = NDArray[np.float64]

#: A complete cycle goes from the lowest part of the compression to the highest one and back.
LOWEST, HIGHEST = 0.3, 0.95
#: Standard error of a median over that of a mean.
MEDIAN = 1.25
#: Force that hides the first contact, in multiples of the one that counts as contact.
HIDDEN = 3.0
#: Probability of an interval of plus and minus one standard uncertainty.
COVERED = 0.6827


@checked
@dataclass(frozen=True)
class LoopUncertainty:
    """Standard uncertainties of a measured loop: intervals of ± one of them cover 68 %.

    With two or more complete cycles, they are from the scatter of one cycle to the next, by
    Student's t: the envelope is that of one cycle. With one, they are from the scatter of the
    samples about the curves, with the correlation of successive samples, and do not contain the
    variation from cycle to cycle. They do not contain what all samples have in common, such as a
    gain of the load cell.
    """

    loading: Array
    """Standard uncertainty of the loading force at each row of the envelope [N]."""
    unloading: Array
    """The same of unloading [N]."""
    loss: float
    """Standard uncertainty of the lost share of the loading work [1]."""
    zero: float
    """Standard uncertainty of the first contact [m]: how far the force hides it; 0 if it is given.
    Those of the forces are at the same displacement and do not contain it."""
    cycles: int
    """Number of complete cycles."""
    kappa: float = math.nan
    """The same of ``kappa`` of the law [1]; NaN if the test does not determine it. ``wiping_out``
    is one of two numbers, and has none."""

    @property
    def source(self) -> str:
        """Where the uncertainties are from, as text."""
        if self.cycles > 1:
            return f"from the scatter between {self.cycles} complete cycles"
        return (
            "from the scatter of the samples about the curves; the test has "
            f"{'one complete cycle' if self.cycles else 'no complete cycle'}, so that they do not "
            "contain the variation from cycle to cycle"
        )


@dataclass(frozen=True)
class Cycles:
    """Forces of the complete cycles of a test at the rows of its envelope."""

    loading: Array
    """(cycles, rows) [N]"""
    unloading: Array
    """(cycles, rows) [N]"""
    same: bool
    """Whether loading and unloading of the envelope are from the same cycle."""


def complete_cycles(e: Array, force: Array, branches: Branches, grid: Array, load: Array) -> Cycles:
    """Curves of each complete cycle, as far as the largest compression of the test.

    Beyond its own end, a cycle grows as the loading of the test. Unloading is scaled to the largest
    compression and to the force of loading there, as in the law with memory.

    Parameters
    ----------
    e, force
        Compression [m] and force [N] of each sample of the test.
    branches
        Reversals and holds of the test.
    grid, load
        Rows of the envelope: compression [m] and force of loading [N].
    """
    used = e >= 0.0
    used[branches.held] = False
    first, end = max(float(np.min(e)), 0.0), float(grid[-1])
    low, high = (first + share * (end - first) for share in (LOWEST, HIGHEST))
    up, down, falls = [], [], []
    for a, b, c in zip(branches.turns, branches.turns[1:], branches.turns[2:], strict=False):
        sides = [part[used[part]] for part in (np.arange(a, b + 1), np.arange(b, c + 1))]
        if e[b] < high or max(e[a], e[c]) > low or min(s.size for s in sides) < LEAST:
            continue
        falls.append((b, c))
        top = float(e[b])
        rise, fall = (monotone_curve(e[s], force[s], top) for s in sides)
        grown = load / np.interp(top, grid, load)
        up.append(rise.at(np.minimum(grid, top)) * np.where(grid > top, grown, 1.0))
        down.append(fall.at(grid * (top / end)) * grown[-1])
    shape = (len(up), grid.size)
    start = np.min(branches.kept[~branches.loading])
    same = bool(falls and falls[0][0] <= start <= falls[0][1])
    return Cycles(np.reshape(up, shape), np.reshape(down, shape), same)


def loop_uncertainty(
    grid: Array,
    load: Array,
    back: Array,
    curves: tuple[MonotoneCurve, MonotoneCurve],
    meeting: Array,
    cycles: Cycles,
    *,
    given: bool,
    offset: float,
) -> LoopUncertainty:
    """Standard uncertainties of an envelope.

    Parameters
    ----------
    grid, load, back
        Rows of the envelope: compression [m] and forces of both branches [N].
    curves
        Fitted curves of loading and unloading.
    meeting
        Share of the distance between the ends of the curves by which each row of unloading is
        raised [1].
    cycles
        Curves of the complete cycles.
    given
        Whether the displacement at the first contact was given.
    offset
        Standard error of the force of the approach that was subtracted [N].
    """
    width = np.gradient(grid)
    width[[0, -1]] *= 0.5  # weights of the trapezoidal rule at its ends
    work = float(width @ load), float(width @ back)
    n = len(cycles.loading)
    errors = envelope_errors(grid, curves, meeting, offset)
    slope = width * work[1] / work[0] ** 2, -width / work[0]  # of the loss
    # The law differs from the curves: they meet, and the share of unloading rises.
    up, down = (w @ curve.errors(grid) for w, curve in zip(slope, curves, strict=True))
    moved = sum(
        w @ (law - curve.at(grid))
        for w, law, curve in zip(slope, (load, back), curves, strict=True)
    )
    lost = np.array([*up, *down, (slope[0] + slope[1]) @ errors[0][:, -1], moved])
    bends = [np.pad(np.abs(np.diff(branch, 2)) / 8.0, 1) for branch in (load, back)]
    lost = np.append(lost, sum(np.abs(w) @ bend for w, bend in zip(slope, bends, strict=True)))
    sd = [np.linalg.norm(v, axis=-1) for v in (*errors, lost)]
    # Between its rows, the table is straight for some readers.
    sd[:2] = [np.hypot(own, bend) for own, bend in zip(sd, bends, strict=False)]
    if n > 1:
        # The envelope has loading of one cycle, and unloading of the same or of another one.
        factor = quantile(n)
        works = cycles.loading @ slope[0], cycles.unloading @ slope[1]
        scatter = [np.std(v, axis=0, ddof=1) for v in (cycles.loading, cycles.unloading, *works)]
        of_loss = np.std(works[0] + works[1], ddof=1) if cycles.same else np.hypot(*scatter[2:])
        found = (*scatter[:2], of_loss)
        sd = [np.maximum(own, factor * between) for own, between in zip(sd, found, strict=True)]
    zero = 0.0
    if not given:
        first = curves[0].noise
        small = max(TOUCH[0] * first, TOUCH[1] * float(load[-1]))
        zero = float(np.interp(HIDDEN * small, load, grid))
    return LoopUncertainty(sd[0], sd[1], float(sd[2]), float(zero), n)


def envelope_errors(
    grid: Array, curves: tuple[MonotoneCurve, MonotoneCurve], meeting: Array, offset: float
) -> tuple[Array, Array]:
    """Independent errors of loading and unloading (rows, errors) [N]; the last is the offset's."""
    up, down = (curve.errors(grid) for curve in curves)
    common = np.where(grid > 0.0, offset, 0.0)[:, None]
    # Unloading meets loading at the end, and has its error there.
    return (
        np.hstack([up, np.zeros_like(down), common]),
        np.hstack([np.outer(meeting, up[-1]), down - np.outer(meeting, down[-1]), common]),
    )


def quantile(cycles: int) -> float:
    """Half width of an interval of Student's t, in standard deviations of the cycles."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * COVERED, cycles - 1))


def offset_error(loading: MonotoneCurve) -> float:
    """Standard error of the force of the approach [N]: a median of correlated samples."""
    decay = loading.scatter[1]
    count = max(LEAST, loading.before // 2)
    return float(MEDIAN * loading.noise * np.sqrt((1.0 + decay) / (1.0 - decay) / count))
