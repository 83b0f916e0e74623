"""Standard uncertainty of the transition length of a measured loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from feltmb.felt.loop_uncertainty import Cycles, quantile
from feltmb.fiber.cycles import Branches

Array = NDArray[np.float64]

#: Step of the logarithm of kappa, and change of a part of a branch as a share of its force.
STEP, SHARE = 0.1, 1e-3
#: Number of parts of a branch whose errors move kappa.
PARTS = 9
#: Relative error of kappa by the curves between their knots.
RESOLVED = 0.005
#: Least share of the information about kappa that a loading has if it counts.
INFORMATIVE = 0.02
#: Largest standard uncertainty of the logarithm of kappa for which its linear propagation holds.
LINEAR = 0.5


def transition_uncertainty(
    force: Callable[[float, Array, Array], Array],
    kappa: float,
    grid: Array,
    envelope: tuple[Array, Array],
    rest: Array,
    errors: tuple[Array, Array],
    cycles: Cycles,
    branches: Branches,
    correlation: float,
) -> float:
    """Relative standard uncertainty of kappa [1]; NaN if the test does not determine it.

    The estimate is linear in the errors of the envelope and of the samples. With two or more
    complete cycles, both are from their scatter; with one, from that of the samples.

    Parameters
    ----------
    force
        Force of the law along the test [N], of kappa and of errors of loading and unloading [N].
    kappa
        Transition length that follows the test best [1].
    grid, envelope
        Compression of the rows [m], and forces of loading and unloading there [N].
    rest
        Difference of test and law at each sample [N].
    errors
        Independent errors of loading and unloading, (rows, errors) [N].
    cycles
        Curves of the complete cycles.
    branches
        Reversals and holds of the test.
    correlation
        Correlation of the errors of successive samples [1].
    """
    from scipy.signal import lfilter

    zero = np.zeros(grid.size)
    by_kappa = force(kappa * math.exp(STEP), zero, zero) - force(
        kappa * math.exp(-STEP), zero, zero
    )
    by_kappa /= 2.0 * STEP
    by_kappa[branches.held] = 0.0
    information = float(by_kappa @ by_kappa)
    if not information > 0.0:
        return math.nan
    weight = by_kappa / information
    base = force(kappa, zero, zero)
    # The logarithm of kappa is moved by the means of an error over some parts of each branch.
    nodes = np.linspace(0.0, grid[-1], PARTS)
    parts = [np.interp(grid, nodes, unit) for unit in np.eye(PARTS)]
    width = np.gradient(grid)

    def functional(branch: Array, first: bool) -> Array:
        """Change of the logarithm of kappa by an error of each row of a branch [1/N]."""
        found = np.zeros(grid.size)
        for part in parts:
            change = SHARE * part * branch
            moved = weight @ (force(kappa, *((change, zero) if first else (zero, change))) - base)
            found += part * width * moved / float(width @ change)
        return found

    by_load, by_back = functional(envelope[0], True), functional(envelope[1], False)

    def of_envelope(columns: tuple[Array, Array]) -> float:
        """Variance of the logarithm of kappa by errors of the envelope."""
        return float(np.sum((by_load @ columns[0] + by_back @ columns[1]) ** 2))

    size = weight * math.sqrt(float(np.sum((by_kappa * rest) ** 2)) / information)
    forward = lfilter([1.0], [1.0, -correlation], size)
    backward = lfilter([1.0], [1.0, -correlation], size[::-1])[::-1]
    variance = of_envelope(errors) + float(size @ (forward + backward - size))
    n = len(cycles.loading)
    if n > 1:
        up, down = (
            (c - np.mean(c, axis=0)).T / math.sqrt(n - 1.0)
            for c in (cycles.loading, cycles.unloading)
        )
        between = of_envelope((up, down)) + _between(weight * by_kappa, weight * rest, branches)
        variance = max(variance, quantile(n) ** 2 * between)
    sd = math.hypot(math.sqrt(variance), RESOLVED)
    return sd if sd <= LINEAR else math.nan


def _between(information: Array, score: Array, branches: Branches) -> float:
    """Variance of the sum of the scores, from their scatter between the informative loadings."""
    parts: Sequence[slice] = [
        p for p in branches.by_loading if float(np.sum(information[p])) > INFORMATIVE
    ]
    m = len(parts)
    if m < 2:
        return 0.0
    return m / (m - 1.0) * float(np.sum([np.sum(score[p]) ** 2 for p in parts]))
