"""Loading and unloading of a compression test: those of one of its cycles."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]

#: Smallest change of the volume fraction between reversals, as a share of its range. Smaller
#: changes are noise of the thickness.
LEAST_CYCLE = 0.05
#: Widths of the band of volume fractions of a hold, as shares of the range.
HELD = (0.03, 0.01, 0.003, 0.001)
#: Smallest width of a band, in steps between the volume fractions of the samples.
LEAST_STEPS = 0.9
#: Distance of the bands that are tried, as a share of their width.
STEP_OF_BAND = 0.25
#: Number of samples at a reversal that are no hold.
MOST_AT_TURN = 8
#: A complete cycle goes from the lowest part of the range to the highest one and back.
LOWEST, HIGHEST = 0.3, 0.95


@dataclass(frozen=True)
class Branches:
    """Samples of one cycle of a test: its loading, and the unloading after it."""

    kept: NDArray[np.intp]
    """Indices of the samples."""
    loading: NDArray[np.bool_]
    """Whether each of them is on the loading branch."""
    starts: list[int]
    """First sample of each loading."""
    holds: list[tuple[int, int]]
    """First and last sample of each hold. All of its samples but the first are left out."""
    turns: list[int]
    """First sample, reversals, and last sample."""
    chosen: int
    """Number of the cycle, from 1."""
    loops: dict[int, tuple[int, int, int]]
    """First sample, largest compression and last sample of each cycle with an unloading."""

    @property
    def cycles(self) -> int:
        """Number of loadings."""
        return len(self.starts)

    @property
    def by_loading(self) -> list[slice]:
        """Samples of each loading with the unloading after it."""
        limits = [0, *self.starts[1:], self.turns[-1] + 1]
        return [slice(a, b) for a, b in itertools.pairwise(limits)]

    @property
    def held(self) -> NDArray[np.intp]:
        """Indices of the samples that are left out because they belong to a hold."""
        runs = [np.arange(first + 1, last + 1) for first, last in self.holds]
        return np.concatenate([np.zeros(0, dtype=np.intp), *runs])


def find_branches(v_f: Array, cycle: int | None = None) -> Branches:
    """Assign the samples of one cycle of a test to loading and unloading, by its reversals.

    The cycle is the first complete one, else the first that reaches the largest compression but
    for 5 % of the range. While a volume fraction is held, the pressure relaxes: these samples are
    neither loading nor unloading.

    Parameters
    ----------
    v_f
        Volume fraction of each sample in the order of the test [1].
    cycle
        Number of the cycle to use, from 1.

    Raises
    ------
    InvalidParameter
        There is no such cycle, or it has no unloading.
    """
    turns = _reversals(v_f)
    parts = list(itertools.pairwise(turns))
    rises = [i for i, (a, b) in enumerate(parts) if v_f[b] >= v_f[a]] or [0]
    starts = [parts[i][0] + (parts[i][0] > 0) for i in rises]
    loops = {k: (*parts[i], parts[i + 1][1]) for k, i in enumerate(rises, 1) if i + 1 < len(parts)}
    if cycle is not None and cycle not in loops:
        raise InvalidParameter(
            f"cycle = {cycle}: the test has {len(loops)} cycles with an unloading"
            + (f", expected one of {', '.join(map(str, loops))}" if loops else "")
        )
    low, high = np.min(v_f) + np.array([LOWEST, HIGHEST]) * np.ptp(v_f)
    reached = [k for k, (_, b, _) in loops.items() if v_f[b] >= high]
    complete = [k for k in reached if max(v_f[loops[k][0]], v_f[loops[k][2]]) <= low]
    chosen = cycle or next(iter((*complete, *reached, *loops)), 1)
    first, top, last = loops.get(chosen, (*parts[rises[chosen - 1]], turns[-1]))
    kept = np.arange(first + (first > 0), last + 1)
    holds = _find_holds(v_f, turns)
    branches = Branches(kept, kept <= top, starts, holds, turns, chosen, loops)
    free = ~np.isin(kept, branches.held)
    return replace(branches, kept=kept[free], loading=branches.loading[free])


def _find_holds(v_f: Array, turns: list[int]) -> list[tuple[int, int]]:
    """First and last sample of each hold, in the order of the test.

    Between two reversals, a hold is a band of volume fractions with more than twice as many
    samples as the three next bands on each side of it together. A steady or sinusoidal test, or
    one with steady force, has no hold: near an extremum of a sine, one band has as many samples
    as the three next ones, however wide the bands are. A wide band shows holds with noise, sagging
    and creeping, and a narrow one those that are short beside the motion.
    """
    size = float(np.ptp(v_f))
    levels = np.unique(v_f)
    if levels.size < 2:
        return []
    step = float(np.median(np.diff(levels)))  # that of the converter, if its steps are coarse
    holds: list[tuple[int, int]] = []
    for a, b in itertools.pairwise(turns):
        begin = a if a == 0 else a + 1
        for band in (held * size for held in HELD):
            if band < LEAST_STEPS * step and band < HELD[0] * size:
                break
            found = _bands_with_holds(v_f[begin : b + 1], band)
            holds += [(begin + first, begin + last) for first, last in found]
    return _joined(sorted(holds))


def _bands_with_holds(part: Array, band: float) -> list[tuple[int, int]]:
    """First and last sample of each hold of a part without reversals, by bands of one width."""
    values = np.sort(part)
    lower = values[0] + STEP_OF_BAND * band * np.arange(
        1 + math.ceil(np.ptp(part) / band / STEP_OF_BAND)
    )
    limits = np.searchsorted(values, lower[:, None] + band * np.array([-3.0, 0.0, 1.0, 4.0]))
    inside = limits[:, 2] - limits[:, 1]
    next_to = limits[:, 3] - limits[:, 0] - inside
    free = inside > np.maximum(2 * next_to, MOST_AT_TURN)
    found = []
    while free.any():
        best = int(np.argmax(np.where(free, inside, 0)))
        within = np.flatnonzero((part >= lower[best]) & (part < lower[best] + band))
        # The motion to the level and from it crosses the band as it crosses the next ones.
        motion = math.ceil(next_to[best] / 6)
        first = int(within[0]) + (motion if within[0] > 0 else 0)
        last = int(within[-1]) - (motion if within[-1] < part.size - 1 else 0)
        found.append((first, last))
        free &= np.abs(lower - lower[best]) >= band
    return found


def _joined(holds: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The holds; those that overlap, or are on the two sides of a reversal, are joined to one."""
    joined: list[tuple[int, int]] = []
    for first, last in holds:
        if joined and first <= joined[-1][1] + 1:
            joined[-1] = (joined[-1][0], max(last, joined[-1][1]))
        else:
            joined.append((first, last))
    return joined


def _reversals(v_f: Array) -> list[int]:
    """First sample, reversals that exceed the noise, and last sample."""
    least = LEAST_CYCLE * float(np.ptp(v_f))
    turns, extreme, rising = [0], 0, True
    for i in range(1, v_f.size):
        change = v_f[i] - v_f[extreme]
        if (change >= 0.0) == rising:
            extreme = i
        elif abs(change) > least:
            if extreme > 0:
                turns.append(extreme)
            extreme, rising = i, not rising
    return [*turns, v_f.size - 1]
