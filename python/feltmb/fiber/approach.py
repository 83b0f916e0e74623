"""First contact of a compression test, and the force before it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST", "TOUCH", "FirstContact", "first_contact", "free_approach", "scatter_of"]

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
#: Shares of the range of the force below which the toe of a loading may be a power law.
TOES = 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0
#: Exponents of the toe, and levels of confidence of its beginning.
EXPONENTS, LEVEL, WIDE = (1.0, 6.0), 0.95, 0.99
#: Most samples of a toe; of more, means of neighbors are taken.
MOST = 1000


def scatter_of(force: Array) -> float:
    """Standard deviation of the noise of a smooth force, from its third differences [its unit].

    Parameters
    ----------
    force
        Force in the order of the displacement, (n,).
    """
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
    exponent: float = math.nan
    """Exponent of the toe [1]; NaN if there is no model of it."""

    @property
    def sd(self) -> float:
        """Standard uncertainty of the zero."""
        return (self.high - self.low) / 3.92


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
        found = first_contact(x[kept], force[kept], float(x[0]), approach=approach)
        zero = guess if found is None else found.zero
        free = x < zero if approach else free
    error = max(SURE * scatter / np.sqrt(max(1, np.sum(free))), OFFSET * float(np.ptp(curve)))
    if found is None:
        found = FirstContact(zero, zero, zero, level)
    return replace(found, level=level if abs(level) > error else 0.0)


def first_contact(x: Array, force: Array, least: float, *, approach: bool) -> FirstContact | None:
    """First contact by a model of the toe, ``force = b + K (x - zero)^p``; None without samples.

    The interval is that of the profile likelihood, with the correlation of successive samples. Of
    the parts of the loading up to several forces, the largest counts whose estimate is within wide
    intervals of all smaller ones: no felt is a power law over its whole range. The interval
    contains that of the next smaller part.

    Parameters
    ----------
    x
        Displacement of the samples, in ascending order, (n,).
    force
        Their force, (n,).
    least
        Smallest zero.
    approach
        Whether samples are before the contact: only then the force b is fitted.
    """
    floor = 0.1 * TOUCH[1] * float(np.ptp(force))
    top = np.maximum.accumulate(force)
    found: list[tuple[FirstContact, FirstContact]] = []
    for share in TOES:
        end = int(np.searchsorted(top, force[0] + share * np.ptp(force), side="right"))
        beyond = int(np.sum(force[:end] > force[0] + 0.1 * share * np.ptp(force)))
        if beyond < LEAST and share < 1.0:
            continue
        toe = _toe(x[:end], force[:end], least, floor, approach)
        if toe is None or any(not wide.low <= toe[0].zero <= wide.high for _, wide in found):
            break
        found.append(toe)
    if not found:
        return None
    last = [part for part, _ in found[-2:]]
    return replace(last[-1], low=min(p.low for p in last), high=max(p.high for p in last))


def _toe(
    x: Array, force: Array, least: float, floor: float, approach: bool
) -> tuple[FirstContact, FirstContact] | None:
    """First contact of one part of a loading, with its interval and a wide one.

    ``floor``: least standard deviation of the samples.
    """
    from scipy.optimize import brentq, minimize_scalar
    from scipy.stats import f as fisher

    step = -(-x.size // MOST)
    if step > 1:
        cut = x.size // step * step
        x, force = (v[:cut].reshape(-1, step).mean(axis=1) for v in (x, force))
    n, span = x.size, float(x[-1] - x[0])
    fitted = 4 if approach else 3
    if n < fitted + 2 or not span > 0.0:
        return None

    other = force - force.mean() if approach else force

    def rest(zero: float, exponent: float) -> Array:
        basis = (np.maximum(x - zero, 0.0) / span) ** exponent
        if approach:
            basis -= basis.mean()
        return np.asarray(other - basis * max(float(basis @ other) / float(basis @ basis), 0.0))

    def cost_of(zero: float, exponent: float) -> float:
        left = rest(zero, exponent)
        return float(left @ left)

    def squares(zero: float) -> tuple[float, float]:
        at = minimize_scalar(
            lambda p: cost_of(zero, p), bounds=EXPONENTS, method="bounded",
            options={"xatol": 1e-3},
        )  # fmt: skip
        return float(at.fun), float(at.x)

    last = float(x[-LEAST // 2])
    grid = np.linspace(least, last, 41)[:-1]
    costs = [squares(z)[0] for z in grid]
    best = int(np.argmin(costs))
    ends = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    at = minimize_scalar(
        lambda z: squares(z)[0], bounds=ends, method="bounded", options={"xatol": 1e-5 * span}
    )
    zero, cost = (
        (float(at.x), float(at.fun)) if at.fun <= costs[best] else (grid[best], costs[best])
    )
    exponent = squares(zero)[1]
    left = rest(zero, exponent)
    follow = float(np.clip(left[1:] @ left[:-1] / max(float(left @ left), 1e-300), 0.0, 0.9))
    variance = max(cost / (n - fitted), floor**2) * (1.0 + follow) / (1.0 - follow)
    places, levels = np.append(grid, zero), np.append(costs, cost)
    order = np.argsort(places, kind="stable")
    places, levels = places[order], levels[order]
    made = []
    for confidence in (LEVEL, WIDE):
        limit = cost + variance * float(fisher.ppf(confidence, 1, n - fitted))
        within = np.flatnonzero(levels <= limit)
        sides: list[float] = []
        for inner, outer in ((within[0], within[0] - 1), (within[-1], within[-1] + 1)):
            if not 0 <= outer < places.size:
                sides.append(float(places[inner]))
                continue
            sides.append(
                float(
                    brentq(
                        lambda z, limit=limit: squares(z)[0] - limit,
                        *(places[inner], places[outer]),
                        xtol=1e-4 * span,
                    )
                )
            )
        made.append(FirstContact(zero, min(*sides, zero), max(*sides, zero), 0.0, exponent))
    return made[0], made[1]
