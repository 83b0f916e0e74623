"""Likelihood profile of the magnitude of a named effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.solve import Fit, FitSettings, polish
from feltmb.fit.watch import current
from feltmb.gap.findings import Profile

__all__ = ["profile_of"]

#: Magnitudes at which everything else is fitted again, in posterior standard deviations from the
#: fit.
PLACES = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)
#: Square root of the rise of the sum of squares at the ends of a 95 % interval.
ENDS = 1.96


def profile_of(
    fit: Fit,
    effect: str,
    settings: FitSettings,
    progress: Callable[[str, int, int], None] | None = None,
) -> Profile:
    """Fix the magnitude of an included effect at some values and fit everything else again.

    S(m) is the least sum of squares (priors included) for the magnitude m. The profile is S(m) -
    S(fit); m is within the 95 % interval if the profile is below 1.96^2 (Wilks 1938). The linear
    model of the fit predicts a parabola. If the profile differs from it, the true interval differs
    from the interval by standard deviations.

    Parameters
    ----------
    fit
        A fit in which the effect is included.
    effect
        Name of the effect.
    settings
        Settings of the fits.
    progress
        ``progress(text, done, count)`` is called for each fit.
    """
    k = [t.name for t in fit.included].index(effect)
    candidate, at = fit.included[k], float(fit.point.magnitudes[k])
    row = len(fit.problem.free) + k
    sd = float(np.sqrt(max(fit.covariance[row, row], 0.0)))
    wanted = np.clip(at + sd * np.array(PLACES), *candidate.effect.bounds)
    values = [float(v) for v in np.unique(wanted) if np.isfinite(v) and v != at]
    problem = replace(fit.problem, fixed=(k,), store=None)
    found = [(at, 0.0)]
    complete = True
    # Outwards, each value starting from the neighboring fit.
    for side in (sorted(v for v in values if v > at), sorted(v for v in values if v < at)[::-1]):
        point = fit.point
        for value in side:
            if current().over():
                complete = False
                break
            if progress is not None:
                progress(f"profile of {effect}", len(found) - 1, len(values))
            moved = point.magnitudes.copy()
            moved[k] = value
            again = polish(problem, replace(point, magnitudes=moved, memo={}), fit.level, settings)
            found.append((value, float(again.cost - fit.cost)))
            point = again.point
    found.sort()
    sizes, rises = (np.array(c) for c in zip(*found, strict=True))
    low, high = _ends(sizes, rises, at, candidate.effect.bounds)
    return Profile(
        effect=effect,
        unit=candidate.effect.unit,
        magnitude=at,
        sd=sd,
        values=tuple(float(v) for v in sizes),
        rises=tuple(float(r) for r in rises),
        low=low,
        high=high,
        complete=complete,
    )


def _ends(
    sizes: Array, rises: Array, at: float, bounds: tuple[float, float]
) -> tuple[float, float]:
    """Magnitudes at the ends of the interval, by interpolation of the signed root of the rise.

    The root is linear for a parabola.
    """
    roots = np.sign(sizes - at) * np.sqrt(np.maximum(rises, 0.0))
    ends = []
    for sign, limit in ((-1.0, bounds[0]), (1.0, bounds[1])):
        beyond = sign * (sizes - at) >= 0.0
        own = np.argsort(sign * sizes[beyond])
        r, v = sign * roots[beyond][own], sizes[beyond][own]
        over = np.flatnonzero(r >= ENDS)
        if not over.size:  # not reached: the end is a limit of the magnitude, or unknown
            ends.append(float(limit) if v[-1] == limit else sign * np.inf)
            continue
        i = over[0]
        share = (ENDS - r[i - 1]) / (r[i] - r[i - 1])
        ends.append(float(v[i - 1] + share * (v[i] - v[i - 1])))
    return ends[0], ends[1]
