"""Memory of a law along a measured motion, exact for straight lines between the samples."""

from __future__ import annotations

import numpy as np

from feltmb.data import Array

__all__ = ["relaxed_along", "slip_along"]

#: Grid of deflections, as shares of the yield deflection; it ends where the slip is complete.
DEFLECTIONS = np.concatenate([np.linspace(0.0, 0.9, 181), 1.0 - np.geomspace(0.1, 1e-9, 400)[1:]])


def slip_along(position: Array, stretch: float, sharpness: float) -> Array:
    """Slip z of a spring in series with a slip, for a measured position q, (n,).

    With the deflection g = (q - z) / b, the motion makes ``dg = dq / b`` while ``|g|`` shrinks, and
    ``dg = (1 - |g|^n) dq / b`` while it grows (see :func:`~feltmb.gap.library.hysteresis`). Both
    are one function G of the path length: ``G(g) + dq / b`` is the new G. The slip starts relaxed,
    z = q.

    Parameters
    ----------
    position
        Measured position q, (n,) [m or rad].
    stretch
        Deflection b of full slip [m or rad], > 0.
    sharpness
        Sharpness n of its onset, > 0.
    """
    if position.size < 2:
        return np.array(position, dtype=np.float64)
    from scipy.special import hyp2f1

    table = DEFLECTIONS * hyp2f1(
        1.0, 1.0 / sharpness, 1.0 + 1.0 / sharpness, DEFLECTIONS**sharpness
    )
    steps = np.diff(position) / stretch
    sign = np.where(steps < 0.0, -1.0, 1.0)
    # One run from each reversal of the motion to the next.
    starts = np.flatnonzero(np.diff(sign, prepend=0.0))
    deflection = np.zeros(position.size)
    for first, last in zip(starts, [*starts[1:], steps.size], strict=True):
        ahead = sign[first] * deflection[first]
        length = ahead if ahead <= 0.0 else float(np.interp(ahead, DEFLECTIONS, table))
        length = length + np.cumsum(np.abs(steps[first:last]))
        grown = np.interp(length, table, DEFLECTIONS)
        deflection[first + 1 : last + 1] = sign[first] * np.where(length < 0.0, length, grown)
    return np.asarray(position - stretch * deflection)


def relaxed_along(time: Array, position: Array, relaxation: float) -> Array:
    """Position z of the damper of a Maxwell branch, for a measured position q, (n,).

    dz/dt = (q - z) / tau, and it starts relaxed, z = q.

    Parameters
    ----------
    time
        Times of the samples, (n,) [s].
    position
        Measured position q, (n,) [m or rad].
    relaxation
        Relaxation time tau [s], > 0.
    """
    spans = np.diff(time) / relaxation
    kept = np.exp(-spans)
    added = -np.expm1(-spans) / spans * np.diff(position)
    stretch = np.zeros(position.size)
    for i, (k, a) in enumerate(zip(kept.tolist(), added.tolist(), strict=True)):
        stretch[i + 1] = k * stretch[i] + a
    return np.asarray(position - stretch)
