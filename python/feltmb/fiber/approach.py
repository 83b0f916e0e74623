"""First contact of a compression test, and the force before it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Least number of samples of an approach, or of a branch.
LEAST = 8
#: Force that counts as contact: multiples of its scatter, and share of its range.
TOUCH = 2.0, 1e-3
#: Force of an approach that counts: multiples of its standard error, and share of the range.
SURE, OFFSET = 3.0, 2e-4
#: Width of the median filter, which removes samples that the load cell lost.
OUTLIERS = 5
#: Largest stiffness of a free approach, as a share of the mean stiffness of loading.
FREE = 0.2
#: Shares of the range of the force that may belong to the toe of a loading. The largest one counts
#: whose misfit is below this multiple of the scatter.
TOES, MISFIT = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001), 2.0
#: Powers of the terms of a toe, and shares of its compression at which others change their power.
POWERS, BENDS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0), (0.02, 1.0, 10)
#: Largest rate of the exponential of a smooth toe, over its compression.
STEEPEST = 20.0
#: Confidence of the interval of a zero, number of zeros tried, samples behind the last one.
LEVEL, PLACES, LAST = 0.95, 61, 3
#: Least standard deviation of the samples, as a share of the range of the force of the toe.
FLOOR = 4e-4
#: Misfit that counts as none, as a share of this range.
EXACT = 5e-5
#: Most samples of a toe; of more, means of neighbors are taken.
MOST = 400


def scatter_of(force: Array) -> float:
    """Standard deviation of the noise of a smooth force, from its third differences [its unit].

    Parameters
    ----------
    force
        Force in the order of the displacement, (n,). Fewer than four samples show no noise: 0.
    """
    if force.size < 4:
        return 0.0
    return 1.4826 * float(np.median(np.abs(np.diff(force, 3)))) / float(np.sqrt(20.0))


@dataclass(frozen=True)
class FirstContact:
    """First contact of a loading."""

    zero: float
    """Displacement at the first contact [that of the samples]."""
    low: float
    """Lower end of its interval of 95 %."""
    high: float
    """Upper end."""
    level: float
    """Force of the approach; 0 if it is within its error, or if there is no approach."""

    @property
    def sd(self) -> float:
        """Standard uncertainty of the zero."""
        return max(self.high - self.zero, self.zero - self.low) / 1.96


def free_approach(x: Array, force: Array, zero: float | None = None) -> FirstContact:
    """First contact of a loading, and the force of the free approach before it.

    Parameters
    ----------
    x
        Displacement of the samples of loading, compression positive [any unit], (n,).
    force
        Their force or pressure [any unit], (n,).
    zero
        Displacement at the first contact if it is known.
    """
    from scipy.ndimage import median_filter
    from scipy.optimize import isotonic_regression

    order = np.argsort(x, kind="stable")
    x, force = x[order], force[order]
    curve = isotonic_regression(median_filter(force, OUTLIERS, mode="nearest")).x
    scatter = scatter_of(force)
    small = max(TOUCH[0] * scatter, TOUCH[1] * float(np.ptp(curve)))
    free = x < zero if zero is not None else curve <= curve[0] + 2.0 * small
    level = 0.0
    if np.sum(free) >= LEAST:
        rise, span = float(np.ptp(curve[free])), float(np.ptp(x[free]))
        if rise * float(np.ptp(x)) < FREE * float(np.ptp(curve)) * span:
            # Its second half may belong to a soft contact.
            level = float(np.median(force[free][: max(LEAST, int(np.sum(free)) // 2)]))
    found = None
    if zero is None:
        before = np.flatnonzero(curve <= level + small)
        guess = float(x[before[-1]] if before.size else x[0])
        kept = np.abs(force - curve) <= max(5.0 * scatter, TOUCH[1] * float(np.ptp(curve)))
        approach = bool(level) or int(np.sum(x < guess)) >= LEAST
        found = first_contact(x[kept], force[kept], approach=approach)
        zero = guess if found is None else found.zero
        free = x < zero if approach else free
    error = max(SURE * scatter / np.sqrt(max(1, np.sum(free))), OFFSET * float(np.ptp(curve)))
    if found is None:
        found = FirstContact(zero, zero, zero, level)
    return replace(found, level=level if abs(level) > error else 0.0)


def first_contact(x: Array, force: Array, *, approach: bool) -> FirstContact | None:
    """First contact of a loading by two models of its toe; None without samples.

    The interval rests on the samples and on one assumption: the force is a sum, with positive
    weights, of terms that grow with a power of the compression between 1 and 6, or with the sixth
    and further on with the first power. Steeper felts are such sums at small forces only: the toe
    ends where they follow the samples. A surface of loose fibers on a stiffer felt, van Wyk's law,
    exponential and power laws are such sums. The weights are those of the least squares at each
    possible zero, and the interval is that of their profile likelihood. The estimate within it is
    that of a smooth toe, ``force = b + K e^p exp(c e)`` with ``e = x - zero``. The
    interval may begin before the first sample, where a test begins in contact; the estimate does
    not.

    Parameters
    ----------
    x
        Displacement of the samples, in ascending order, (n,).
    force
        Their force, (n,).
    approach
        Whether samples are before the contact: only then the force b is fitted.
    """
    found = None
    for share in TOES:
        toe = _toe(x, force, share)
        if toe is None:
            break
        found, misfit = _of_toe(*toe, approach=approach)
        if misfit < MISFIT:
            break
    return found


def _of_toe(x: Array, force: Array, *, approach: bool) -> tuple[FirstContact, float]:
    """First contact by one toe, and its misfit in those of the scatter."""
    from scipy.optimize import brentq, nnls
    from scipy.stats import f as fisher

    n, span = x.size, float(x[-1] - x[0])
    floor = FLOOR * float(np.ptp(force))

    def fitted(zero: float) -> tuple[float, Array, Array]:
        """Squares of what is left, what is left, and the weights."""
        terms = _terms(x - zero)
        if approach:
            terms = np.column_stack([terms, np.ones(n), -np.ones(n)])
        terms /= np.linalg.norm(terms, axis=0)
        weights, left = nnls(terms, force)
        return float(left) ** 2, force - terms @ weights, weights

    grid = np.linspace(float(x[0]) - span, float(x[-LAST]), PLACES)
    fits = [fitted(zero) for zero in grid]
    costs = np.array([cost for cost, *_ in fits])
    cost, left, weights = fits[int(np.argmin(costs))]
    free = max(n - 1 - int(np.sum(weights > 0.0)), 1)
    follow = float(np.clip(left[1:] @ left[:-1] / max(cost, 1e-300), 0.0, 0.9))
    variance = max(cost / free, floor**2) * (1.0 + follow) / (1.0 - follow)
    # With the zero, the shape of the toe moves too.
    limit = cost + 2.0 * variance * float(fisher.ppf(LEVEL, 2, free))
    within = np.flatnonzero(costs <= limit)

    def end(inner: int, outer: int) -> float:
        if not 0 <= outer < grid.size:
            return float(grid[inner])
        pair = grid[inner], grid[outer]
        return float(brentq(lambda z: fitted(z)[0] - limit, *pair, xtol=1e-4 * span))

    low, high = end(within[0], within[0] - 1), end(within[-1], within[-1] + 1)
    first = float(x[0])
    zero = (
        smooth_zero(x, force, (max(low, first), high), approach=approach) if high > first else first
    )
    misfit = float(np.sqrt(cost / free)) / max(scatter_of(force), EXACT * float(np.ptp(force)))
    return FirstContact(zero, low, max(high, first), 0.0), misfit


def _toe(x: Array, force: Array, share: float) -> tuple[Array, Array] | None:
    """Loading up to a share of its force; of many samples, the means of neighbors.

    None without enough samples for a smaller share.
    """
    rise = np.maximum.accumulate(force) - force[0]
    end = int(np.searchsorted(rise, share * np.ptp(force), side="right"))
    beyond = np.flatnonzero(rise > 0.1 * share * np.ptp(force))
    if beyond.size and share == TOES[0]:
        end = max(end, int(beyond[min(LEAST, beyond.size) - 1]) + 1)
    x, force = x[:end], force[:end]
    if x.size < LEAST or not x[-1] > x[0] or (share < TOES[0] and np.sum(beyond < end) < LEAST):
        return None
    step = -(-x.size // MOST)
    cut = x.size // step * step
    x, force = (v[:cut].reshape(-1, step).mean(axis=1) for v in (x, force))
    return x, force


def _terms(e: Array) -> Array:
    """Forces at compressions, each a term of a toe (n, terms)."""
    e = np.maximum(e, 0.0)
    share = e[:, None] / max(float(np.max(e)), 1e-300)
    bent = np.maximum(share / np.geomspace(*BENDS), 1e-12)
    low, high = POWERS[0], POWERS[-1]
    return np.hstack([share ** np.array(POWERS), 1.0 / (bent**-low + bent**-high)])


def smooth_zero(x: Array, force: Array, ends: tuple[float, float], *, approach: bool) -> float:
    """Zero of ``b + K e^p exp(c e)`` with the least squares."""
    from scipy.optimize import least_squares

    span = float(x[-1] - x[0])
    given = force - force.mean() if approach else force

    def rest(p: Array) -> Array:
        e = np.maximum(x - p[0], 0.0) / span
        shape = e ** p[1] * np.exp(p[2] * e)
        if approach:
            shape = shape - shape.mean()
        factor = max(float(shape @ given) / max(float(shape @ shape), 1e-300), 0.0)
        return np.asarray(given - factor * shape)

    room = 1e-9 * span
    low, high = ends[0] - room, ends[1] + room
    fits = [
        least_squares(
            rest,
            [ends[0] + share * (ends[1] - ends[0]), 2.0, 0.5],
            bounds=([low, POWERS[0], 0.0], [high, POWERS[-1], STEEPEST]),
            x_scale=[0.1 * span, 1.0, 1.0],
        )
        for share in (0.3, 0.7)
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(np.clip(best.x[0], *ends))
