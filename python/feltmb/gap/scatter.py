"""Tests whether the scatter of samples grows with their value, without a model."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from feltmb.data import Array
from feltmb.fit.noise import Noise
from feltmb.gap.criteria import GROWS, NOT_WHITE, unknown_gain

__all__ = ["grows_with_value", "growth"]

#: Orders of the differences that must show the same noise: a motion does not look alike in both.
ORDERS = 4, 8
#: Groups of samples of similar values, and the smallest number of differences in one.
GROUPS, LEAST = 4, 24
#: Largest relative noise that is looked for [1]. A signal that is random itself scatters more.
MOST = 0.3
#: Limits of the ratio of the root mean square to the standard deviation from the median, which is
#: about 1 for normal numbers. It is less for a vibration, and more for a motion now and then.
NORMAL = 0.75, 1.4
#: Sum of the squared correlations of overlapping fourth differences of white noise: so many count
#: as one.
OVERLAP = sum((math.comb(8, 4 + k) / math.comb(8, 4)) ** 2 for k in range(-4, 5))


def growth(squares: Array, shape: Array, limits: tuple[float, float]) -> tuple[float, float, float]:
    """Fit the variance ``a + b shape`` to squares of independent normal numbers.

    Parameters
    ----------
    squares
        Squares of the numbers, (n,).
    shape
        What the variance may grow with, >= 0, (n,).
    limits
        Smallest and largest a, > 0.

    Returns
    -------
    tuple
        a, b, and the gain of the log likelihood over one variance.
    """

    def cost(logs: Array) -> float:
        variance = np.exp(logs[0]) + np.exp(logs[1]) * shape
        return 0.5 * float(np.sum(squares / variance + np.log(variance)))

    plain = 0.5 * squares.size * (1.0 + math.log(float(np.mean(squares))))
    scale, least, most = (math.log(v) for v in (float(np.mean(shape)), *limits))
    # From the smallest constant, and from a growth that explains a tenth of the variance.
    fits = [
        minimize(cost, (a, b - scale), method="L-BFGS-B", bounds=[(least, most), (-60.0, 60.0)])
        for a, b in ((least, most), (most, most - math.log(10.0)))
    ]
    best = min(fits, key=lambda f: float(f.fun))
    a, b = np.exp(best.x)
    return float(a), float(b), plain - float(best.fun)


def grows_with_value(
    samples: Sequence[Array], noise: Sequence[Noise], alpha: float
) -> tuple[float, float] | None:
    """Constant and relative standard deviation of the scatter [unit, 1]; None: it does not grow.

    White noise has the same size in differences of the fourth and of the eighth order. It must in
    each of four groups of similar values, because otherwise it is a motion. A variance that grows
    with the square of the value must be far more likely than one variance, it must leave normal
    numbers, and the scatter of the largest values must exceed the noise that is used.

    Parameters
    ----------
    samples
        The channel in all records of a sensor, evenly sampled, each (n,) [unit]; NaN is missing.
    noise
        The noise that is used, by record.
    alpha
        Rate of false alarms (``Options.alpha``).
    """
    tables = [_differences(values) for values in samples]
    used = np.concatenate(
        [n.sd(level) for n, (_, _, level) in zip(noise, tables, strict=True)] or [np.zeros(0)]
    )
    low, high, level = (np.concatenate([t[k] for t in tables] or [np.zeros(0)]) for k in range(3))
    if level.size < GROUPS * LEAST:
        return None
    groups = np.array_split(np.argsort(level, kind="stable"), GROUPS)
    small, large = (np.array([_rms(x[at]) for at in groups]) for x in (low, high))
    least, most = NOT_WHITE
    if not np.all((small > 0.0) & (large > least * small) & (large < most * small)):
        return None
    top = groups[-1]
    if not small[-1] > GROWS * max(small[0], _rms(used[top])):
        return None
    a, b, gain = growth((low / small[-1]) ** 2, level**2, (1e-4, 1.0))
    if gain / OVERLAP <= unknown_gain(alpha):
        return None
    left = low[top] / np.sqrt(a + b * level[top] ** 2)
    normal = float(np.median(np.abs(left))) / 0.6745  # 0: most values are equal
    relative = float(small[-1]) * math.sqrt(b)
    if relative > MOST or not NORMAL[0] * normal < _rms(left) < NORMAL[1] * normal:
        return None
    return float(max(small[-1] * math.sqrt(a), 0.1 * small[0])), relative


def _differences(values: Array) -> tuple[Array, Array, Array]:
    """Differences of both orders around the same samples, and the size of their values."""
    reach = ORDERS[1] // 2
    if values.size <= 2 * reach:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    scaled = [np.diff(values, k) / math.sqrt(math.comb(2 * k, k)) for k in ORDERS]
    inner = reach - ORDERS[0] // 2
    low, high = scaled[0][inner : scaled[0].size - inner], scaled[1]
    level = np.abs(np.convolve(values, np.ones(2 * reach + 1) / (2 * reach + 1), "valid"))
    seen = np.isfinite(high) & np.isfinite(level)
    return low[seen], high[seen], level[seen]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
