"""Joint uncertainty of parameters, magnitudes and fitted shapes, with the error of form of laws.

A fitted shape is a number of the model like a magnitude, and the two are often correlated: a wider
clearance with a lower stiffness may fit as well. The derivative by the logarithm of the shape is
computed as a difference of residuals.

No law of force is exact. If the force of a law is wrong by a share ``form``, its magnitude is wrong
by as much, and everything that is correlated with the magnitude compensates: a spring becomes
stiffer if the law that hardens it is too weak.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.model import LAWS
from feltmb.fit.solve import Fit, inverse_scaled
from feltmb.gap.shape import by_shapes, movable

__all__ = ["Spread", "spread", "together", "with_refused"]

#: Prior standard deviation of the logarithm of a shape; the lists of shapes span a few factors.
WIDE = 1.0
#: Least correlation of two numbers that are told to be hardly separate, and most pairs of them.
TOGETHER, PAIRS = 0.8, 12


@dataclass(frozen=True, eq=False)
class Spread:
    """Uncertainty of the free parameters, the magnitudes and the shapes of a fit."""

    covariance: Array
    """Covariance of the free parameters and then the magnitudes, (n, n), with the shapes
    uncertain."""
    by_form: Array
    """Covariance that the errors of form of the included laws and refused effects add, (n, n)."""
    shapes: dict[tuple[int, int], float]
    """(candidate, index of the number in its shape) -> standard deviation of its logarithm [1]."""

    @property
    def total(self) -> Array:
        """Covariance with the errors of form, (n, n)."""
        return np.asarray(self.covariance + self.by_form)


def spread(fit: Fit, form: float = 0.0, *, shapes: bool = True) -> Spread:
    """Uncertainty of a fit whose shapes can take any value and whose laws have an error of form.

    The error of form of a law with the magnitude m is independent of the noise and of other laws,
    and has the standard deviation ``form m``. It changes the magnitude by itself, and every other
    number x by cov(x, m) / var(m) times itself, as a fit with another given magnitude would.

    Parameters
    ----------
    fit
        Fit with or without effects.
    form
        Relative error of the force of a law (``Options.form``) [1].
    shapes
        Whether shapes are uncertain, which costs two simulations for each of their numbers.
    """
    count = len(fit.problem.free)
    shared = count + len(fit.included)
    places = [(k, i) for k, c in enumerate(fit.included) for i in movable(c.effect) if shapes]
    matrix = fit.normal.matrix
    if places:
        linears = by_shapes(fit, places)
        matrix = fit.problem.normal(fit.point, linears, fit.defect_sd).matrix.copy()
        for j in range(len(places)):
            matrix[shared + j, shared + j] += 1.0 / WIDE**2
    everything = inverse_scaled(matrix)
    covariance = everything[:shared, :shared]
    by_form = np.zeros_like(covariance)
    for k, candidate in enumerate(fit.included):
        column = covariance[:, count + k]
        variance = column[count + k]
        if candidate.effect.kind in LAWS and 0.0 < variance < np.inf:
            change = form * fit.point.magnitudes[k] * column / variance
            by_form += np.outer(change, change)
    sd = np.sqrt(np.maximum(np.diag(everything), 0.0))
    return Spread(covariance, by_form, {p: float(sd[shared + j]) for j, p in enumerate(places)})


def with_refused(wide: Spread, fit: Fit, larger: Fit) -> Spread:
    """The uncertainty of a fit, with its differences from the fit of a larger set.

    The further effects of this set are refused, but they, or an error of form that resembles them,
    may act.

    Parameters
    ----------
    wide
        Uncertainty of ``fit``.
    fit
        Fit of the accepted set.
    larger
        Fit of the set with the largest evidence.
    """
    count = len(fit.problem.free)
    change = np.zeros(len(wide.covariance))
    if larger.problem.free == fit.problem.free:
        free = list(fit.problem.free)
        change[:count] = larger.point.theta[free] - fit.point.theta[free]
    others = {t.name: k for k, t in enumerate(larger.included)}
    for k, t in enumerate(fit.included):
        if t.name in others:
            at = others[t.name]
            change[count + k] = larger.point.magnitudes[at] - fit.point.magnitudes[k]
    return replace(wide, by_form=wide.by_form + np.outer(change, change))


def together(fit: Fit) -> list[tuple[str, str, float]]:
    """Pairs of fitted numbers that the records hardly separate: names and correlation [1]."""
    names = [i.name for i in fit.intervals()]
    covariance = fit.covariance
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    seen = np.isfinite(sd) & (sd > 0.0)
    scale = np.where(seen, sd, np.inf)
    rho = np.where(np.outer(seen, seen), covariance, 0.0) / np.outer(scale, scale)
    pairs = [
        (names[i], names[j], float(rho[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(rho[i, j]) >= TOGETHER
    ]
    return sorted(pairs, key=lambda p: (-abs(p[2]), p[:2]))[:PAIRS]
