"""First contact of a compression test, and the force before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST", "TOUCH", "free_approach", "scatter_of"]

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


def scatter_of(force: Array) -> float:
    """Standard deviation of the noise of a smooth force, from its third differences [its unit].

    Parameters
    ----------
    force
        Force in the order of the displacement, (n,).
    """
    return 1.4826 * float(np.median(np.abs(np.diff(force, 3)))) / float(np.sqrt(20.0))


def free_approach(x: Array, force: Array, zero: float | None = None) -> tuple[float, float]:
    """Displacement at the first contact, and the force of a free approach.

    The approach is free where the monotone curve through loading stays within the scatter of its
    first force, if its stiffness is small there.

    Parameters
    ----------
    x
        Displacement of the samples of loading, compression positive [any unit], (n,).
    force
        Their force or pressure [any unit], (n,).
    zero
        Displacement at the first contact if it is known.

    Returns
    -------
    float
        Displacement at the first contact: where the force leaves that of the approach.
    float
        Force of the approach; 0 if it is within its error, or if there is no approach.
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
    if zero is None:
        before = np.flatnonzero(curve <= level + small)
        zero = float(x[before[-1]] if before.size else x[0])
    error = max(SURE * scatter / np.sqrt(max(1, np.sum(free))), OFFSET * float(np.ptp(curve)))
    return zero, level if abs(level) > error else 0.0
