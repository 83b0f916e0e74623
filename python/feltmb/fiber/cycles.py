"""Loading and unloading of a compression test with one or several cycles."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class Branches:
    """Samples of a test that belong to the envelopes."""

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


def find_branches(v_f: Array) -> Branches:
    """Assign the samples of a test to the loading and unloading envelopes, by its reversals.

    The loading envelope consists of the samples of each loading that are beyond all earlier
    reversals, because a felt follows inner loops below them. The unloading envelope begins at the
    largest volume fraction and ends at the next reversal. The other samples are on inner loops.
    While a volume fraction is held, the pressure relaxes: these samples are neither loading nor
    unloading.

    Parameters
    ----------
    v_f
        Volume fraction of each sample in the order of the test [1].
    """
    turns = _reversals(v_f)
    loading, unloading = [], [np.zeros(0, dtype=np.intp)]
    highest, starts = -np.inf, []
    for a, b in itertools.pairwise(turns):
        part = np.arange(a if a == 0 else a + 1, b + 1)
        if v_f[b] >= v_f[a]:
            starts.append(int(part[0]))
            loading.append(part[v_f[part] > highest])
            highest = max(highest, v_f[b])
        elif v_f[a] == np.max(v_f):
            unloading.append(part)
    # Of equal maxima the last one counts: the felt has then softened.
    kept = np.concatenate([*loading, unloading[-1]])
    rising = np.arange(kept.size) < sum(p.size for p in loading)
    order = np.argsort(kept, kind="stable")
    branches = Branches(kept[order], rising[order], starts, _find_holds(v_f, turns), turns)
    free = ~np.isin(branches.kept, branches.held)
    return replace(branches, kept=branches.kept[free], loading=branches.loading[free])


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
