"""Standard uncertainties of a measured loop: from the scatter of its cycles, or of its samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from feltmb.felt.monotone import MonotoneCurve, monotone_curve
from feltmb.fiber.approach import LEAST
from feltmb.fiber.cycles import HIGHEST, LOWEST, Branches
from unmodeled.arguments import checked

Array = NDArray[np.float64]

#: Points for the work of a cycle, and least samples of a branch for it.
WORK_POINTS, LEAST_SAMPLES = 201, 4
#: Standard error of a median over that of a mean.
MEDIAN = 1.25
#: Largest ratio of the speeds of cycles that count as equal.
SAME_SPEED = 2.0
#: Probability of an interval of plus and minus one standard uncertainty.
COVERED = 0.6827


@checked
@dataclass(frozen=True)
class LoopUncertainty:
    """Standard uncertainties of a measured loop: intervals of ± one of them cover 68 %.

    With two or more complete cycles, those of the forces are from the scatter of one cycle to the
    next, by Student's t. With one, they are from the scatter of the samples about the curves, with
    the correlation of successive samples and with what may lie between them, as is always that of
    the loss, which is that of one cycle. They do not contain what all samples have in common, such
    as a gain of the load cell.
    """

    loading: Array
    """Standard uncertainty of the loading force at each row of the envelope [N]."""
    unloading: Array
    """The same of unloading [N]."""
    loss: float
    """Standard uncertainty of the lost share of the loading work [1]; 0 if it is given."""
    zero: float
    """Standard uncertainty of the first contact [m], whatever its toe; 0 if it is given. Those of
    the forces are at the same displacement and do not contain it."""
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


@checked
@dataclass(frozen=True)
class CycleLoss:
    """Loss of one cycle: its loading with the unloading after it, where both have samples."""

    number: int
    """Number of the cycle, from 1."""
    low: float
    """Smallest compression with samples of both branches [m]."""
    top: float
    """Largest compression [m]."""
    force: float
    """Force there [N]."""
    loss: float
    """Share of the loading work that is lost [1]."""
    sd: float
    """Its standard uncertainty, from the scatter of the samples and the load cell's drift [1]."""
    speed: float = math.nan
    """Mean speed of its loading [m/s]; NaN without a clock."""


@dataclass(frozen=True)
class Cycles:
    """Cycles of a test."""

    loading: Array
    """Force of the complete ones at the rows of the envelope, (cycles, rows) [N]."""
    unloading: Array
    """(cycles, rows) [N]"""
    losses: tuple[CycleLoss, ...]
    """Losses of all of them."""


def complete_cycles(
    e: Array,
    force: Array,
    branches: Branches,
    grid: Array,
    load: Array,
    *,
    time: Array | None = None,
    drift: float = 0.0,
) -> Cycles:
    """Curves of each complete cycle, as far as the largest compression of the loop, and losses.

    Beyond its own end, a cycle grows as the loading of the loop. Unloading is scaled to the largest
    compression and to the force of loading there, as in the law with memory. Cycles with another
    speed than the loop are no repetitions.

    Parameters
    ----------
    e, force
        Compression [m] and force [N] of each sample of the test.
    branches
        Reversals and holds of the test.
    grid, load
        Rows of the envelope: compression [m] and force of loading [N].
    time
        Time of each sample [s].
    drift
        Standard error of the force of unloading relative to that of loading [N].
    """
    speeds = {
        number: math.nan if time is None else float((e[b] - e[a]) / max(time[b] - time[a], 1e-300))
        for number, (a, b, _) in branches.loops.items()
    }
    own = speeds.get(branches.chosen, math.nan)
    used = e >= 0.0
    used[branches.held] = False
    first, end = max(float(np.min(e)), 0.0), float(grid[-1])
    low, high = (first + share * (end - first) for share in (LOWEST, HIGHEST))
    up, down, losses = [], [], []
    for number, (a, b, c) in branches.loops.items():
        sides = [part[used[part]] for part in (np.arange(a, b + 1), np.arange(b, c + 1))]
        if min(s.size for s in sides) < LEAST_SAMPLES or not e[b] > 0.0:
            continue
        top = float(e[b])
        rise, fall = (monotone_curve(e[s], force[s], top) for s in sides)
        begin, speed = max(float(np.min(e[s])) for s in sides), speeds[number]
        losses.append(replace(_loss(number, rise, fall, begin, top, drift), speed=speed))
        if speed > SAME_SPEED * own or own > SAME_SPEED * speed:
            continue
        if e[b] < high or max(e[a], e[c]) > low or min(s.size for s in sides) < LEAST:
            continue
        grown = load / np.interp(top, grid, load)
        up.append(rise.at(np.minimum(grid, top)) * np.where(grid > top, grown, 1.0))
        down.append(fall.at(np.minimum(grid * (top / end), top)) * grown[-1])
    shape = (len(up), grid.size)
    return Cycles(np.reshape(up, shape), np.reshape(down, shape), tuple(losses))


def _loss(
    number: int, rise: MonotoneCurve, fall: MonotoneCurve, low: float, top: float, drift: float
) -> CycleLoss:
    """Loss of the loop of two curves."""
    grid = np.linspace(low, top, WORK_POINTS)
    width = np.gradient(grid)
    width[[0, -1]] *= 0.5
    work = [float(width @ curve.at(grid)) for curve in (rise, fall)]
    force = float(rise.at(grid)[-1])
    if not work[0] > 0.0:
        return CycleLoss(number, low, top, force, math.nan, math.nan)
    slopes = width * work[1] / work[0] ** 2, -width / work[0]
    errors = [w @ curve.errors(grid) for w, curve in zip(slopes, (rise, fall), strict=True)]
    errors.append(np.array([float(np.sum(slopes[1])) * drift]))
    sd = float(np.linalg.norm(np.concatenate(errors)))
    return CycleLoss(number, low, top, force, 1.0 - work[1] / work[0], sd)


def loop_uncertainty(
    grid: Array,
    load: Array,
    back: Array,
    curves: tuple[MonotoneCurve, MonotoneCurve],
    meeting: Array,
    cycles: Cycles,
    *,
    zero: float,
    offset: tuple[float, float],
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
    zero
        Standard uncertainty of the first contact [m].
    offset
        Standard errors of the force of the approach that was subtracted, and of the force of
        unloading relative to that of loading [N].
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
    common = [sum(w @ e[:, k] for w, e in zip(slope, errors, strict=True)) for k in (-2, -1)]
    lost = np.array([*up, *down, *common, moved])
    bends = [np.pad(np.abs(np.diff(branch, 2)) / 8.0, 1) for branch in (load, back)]
    lost = np.append(lost, sum(np.abs(w) @ bend for w, bend in zip(slope, bends, strict=True)))
    sd = [np.linalg.norm(v, axis=-1) for v in (*errors, lost)]
    # Between its rows, the table is straight for some readers.
    sd[:2] = [np.hypot(own, bend) for own, bend in zip(sd, bends, strict=False)]
    if n > 1:
        factor = quantile(n)
        scatter = [np.std(v, axis=0, ddof=1) for v in (cycles.loading, cycles.unloading)]
        sd[:2] = [np.maximum(own, factor * v) for own, v in zip(sd, scatter, strict=False)]
    return LoopUncertainty(sd[0], sd[1], float(sd[2]), zero, n)


def envelope_errors(
    grid: Array,
    curves: tuple[MonotoneCurve, MonotoneCurve],
    meeting: Array,
    offset: tuple[float, float],
) -> tuple[Array, Array]:
    """Independent errors of both branches (rows, errors) [N]; the last two are those of offset."""
    up, down = (curve.errors(grid) for curve in curves)
    common, drift = (np.where(grid > 0.0, sd, 0.0)[:, None] for sd in offset)
    # Unloading meets loading at the end, and has its error there.
    return (
        np.hstack([up, np.zeros_like(down), common, 0.0 * drift]),
        np.hstack([np.outer(meeting, up[-1]), down - np.outer(meeting, down[-1]), common, drift]),
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
