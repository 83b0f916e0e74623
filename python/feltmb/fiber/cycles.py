"""Loading and unloading of a compression test with one or several cycles."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Smallest change of the volume fraction between reversals, as a share of its range. Smaller
#: changes are noise of the thickness.
LEAST_CYCLE = 0.05
#: Distance from a largest volume fraction within which it is held, as a share of the range.
HELD = 0.01
#: Number of samples at a reversal that are no hold.
MOST_AT_TURN = 8


@dataclass(frozen=True)
class Branches:
    """Samples of a test that belong to the envelopes."""

    kept: NDArray[np.intp]
    """Indices of the samples."""
    loading: NDArray[np.bool_]
    """Whether each of them is on the loading branch."""
    cycles: int
    """Number of loadings."""
    held: NDArray[np.intp]
    """Indices of the samples of a hold at the largest volume fraction, in its order."""


def find_branches(v_f: Array) -> Branches:
    """Assign the samples of a test to the loading and unloading envelopes, by its reversals.

    The loading envelope consists of the samples of each loading that are beyond all earlier
    reversals, because a felt follows inner loops below them. The unloading envelope begins at the
    largest volume fraction and ends at the next reversal. The other samples are on inner loops.
    While the largest volume fraction is held, the pressure relaxes: these samples are neither
    loading nor unloading.

    Parameters
    ----------
    v_f
        Volume fraction of each sample in the order of the test [1].
    """
    turns = _reversals(v_f)
    loading, unloading = [], [np.zeros(0, dtype=np.intp)]
    highest, cycles = -np.inf, 0
    held = _held(v_f, turns)
    for a, b in itertools.pairwise(turns):
        part = np.arange(a if a == 0 else a + 1, b + 1)
        if v_f[b] >= v_f[a]:
            cycles += 1
            loading.append(part[v_f[part] > highest])
            highest = max(highest, v_f[b])
        elif v_f[a] == np.max(v_f):
            unloading.append(part)
    # Of equal maxima the last one counts: the felt has then softened.
    kept = np.concatenate([*loading, unloading[-1]])
    rising = np.arange(kept.size) < sum(p.size for p in loading)
    order = np.argsort(kept, kind="stable")
    order = order[~np.isin(kept[order], held)]
    return Branches(kept[order], rising[order], cycles, held)


def _held(v_f: Array, turns: list[int]) -> NDArray[np.intp]:
    """Samples between the first and the last one at the largest volume fraction, if it is held.

    It is held if there are more than twice as many samples in a band below it as in the three next
    bands of this width. A steady or sinusoidal test of any number of samples has no hold.
    """
    # Of equal values, the last one is the reversal.
    top, band = int(np.flatnonzero(v_f == np.max(v_f))[-1]), HELD * float(np.ptp(v_f))

    begin = max((t for t in turns if t < top), default=0)
    end = min((t for t in turns if t > top), default=v_f.size - 1)
    below = v_f[top] - v_f[begin : end + 1]
    near = begin + np.flatnonzero(below <= band)
    next_to = int(np.sum(below <= 4.0 * band)) - near.size
    if near.size <= max(2 * next_to, MOST_AT_TURN):
        return np.zeros(0, dtype=np.intp)
    at_level = near[v_f[near] >= np.median(v_f[near])]
    return np.arange(at_level[0] + 1, at_level[-1] + 1)


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
