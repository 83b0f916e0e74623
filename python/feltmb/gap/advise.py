"""What records can tell apart."""

from __future__ import annotations

import numpy as np
from scipy import stats

from feltmb.data import Array
from feltmb.gap.score import Scores
from feltmb.gap.search import Search

#: Standardized size that is seen in nine of ten records at one false alarm in a hundred.
SHOWS = 3.7

__all__ = ["confused", "confusion", "confusion_at"]


def confused(gram: Array, sizes: Array) -> Array:
    """Probability to take one candidate for another, (k, k), from their Gram matrix.

    P = Phi(-1/2 sqrt(2 (1 - |rho|)) |phi| lambda), the distance of the two signatures in noise;
    ``sizes`` in scales, (k,).
    """
    strength = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length = np.where(strength > 0.0, strength, np.inf)
    rho = np.clip(np.abs(gram / np.outer(length, length)), 0.0, 1.0)
    distance = np.sqrt(2.0 * (1.0 - rho)) * (np.abs(sizes) * strength)[:, None]
    return np.asarray(stats.norm.cdf(-0.5 * distance))


def confusion_at(scores: Scores, sizes: Array) -> Array:
    """The larger chance of two candidates to be taken for each other, at given sizes [scales]."""
    chance = confused(scores.gram, sizes)
    out = np.maximum(chance, chance.T)
    np.fill_diagonal(out, 0.0)
    unseen = np.logical_not(scores.testable)
    out[unseen, :] = 0.0
    out[:, unseen] = 0.0
    return np.asarray(out)


def confusion(scores: Scores, search: Search) -> Array:
    """The same at the refitted sizes, or else at the smallest size that shows at all.

    Effects that are too weak to be seen would all be confused with each other; that says nothing
    about their signatures.
    """
    strength = np.maximum(scores.strength, 1e-300)
    sizes = np.maximum(np.abs(scores.one_step()), SHOWS / strength)
    for c in search.candidates[:1]:
        for term, size in zip(c.fit.terms, c.fit.point.sizes, strict=True):
            for i, t in enumerate(scores.terms):
                if t.name == term.name:
                    sizes[i] = max(abs(float(size)) / t.effect.scale, SHOWS / strength[i])
    return confusion_at(scores, sizes)
