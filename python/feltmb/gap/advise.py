"""Probability of confusing two candidates, given the records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.sparse import csgraph

from feltmb.data import Array
from feltmb.gap.criteria import CONFUSED, DETECTABLE
from feltmb.gap.score import Scores
from feltmb.gap.search import Search

__all__ = ["confused", "confused_groups", "confusion", "confusion_at", "linked_groups"]


def confused(gram: Array, magnitudes: Array) -> Array:
    """Probability of mistaking one candidate for another, (k, k), from their Gram matrix.

    P = Phi(-1/2 sqrt(2 (1 - |rho|)) |phi| lambda), where lambda is the strength of a signature, rho
    the correlation of the two signatures and phi the magnitude; the argument is half their distance
    in noise standard deviations. ``magnitudes`` are in scales, (k,).
    """
    strength = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length = np.where(strength > 0.0, strength, np.inf)
    rho = np.clip(np.abs(gram / np.outer(length, length)), 0.0, 1.0)
    distance = np.sqrt(2.0 * (1.0 - rho)) * (np.abs(magnitudes) * strength)[:, None]
    return np.asarray(stats.norm.cdf(-0.5 * distance))


def confusion_at(scores: Scores, magnitudes: Array) -> Array:
    """Probability of confusing two candidates (larger of both directions), magnitudes [scales]."""
    chance = confused(scores.gram, magnitudes)
    out = np.maximum(chance, chance.T)
    np.fill_diagonal(out, 0.0)
    unseen = np.logical_not(scores.testable)
    out[unseen, :] = 0.0
    out[:, unseen] = 0.0
    return np.asarray(out)


def confusion(scores: Scores, search: Search) -> Array:
    """Probability of confusing candidates at refitted, or else smallest detectable, magnitudes.

    Below the smallest detectable magnitude all effects would be confused with each other. Such a
    probability would say nothing about their signatures.
    """
    strength = np.maximum(scores.strength, 1e-300)
    magnitudes = np.maximum(np.abs(scores.one_step()), DETECTABLE / strength)
    for c in search.sets[:1]:
        for candidate, size in zip(c.fit.included, c.fit.point.magnitudes, strict=True):
            for i, t in enumerate(scores.candidates):
                if t.name == candidate.name:
                    magnitudes[i] = max(abs(float(size)) / t.effect.scale, DETECTABLE / strength[i])
    return confusion_at(scores, magnitudes)


def confused_groups(names: Sequence[str], chance: Array) -> tuple[tuple[str, ...], ...]:
    """Group the effects that are confused with each other, directly or through a third effect.

    Parameters
    ----------
    names
        Name of each candidate. All shapes of an effect have the same name; candidates that are not
        tested have an empty name.
    chance
        Probability of mistaking one candidate for another, see :func:`confusion`.
    """
    groups = linked_groups(names, chance > CONFUSED)
    return tuple(sorted({tuple(sorted(group)) for group in groups}))


def linked_groups(names: Sequence[str], linked: NDArray[np.bool_]) -> list[tuple[str, ...]]:
    """Groups of two or more names of candidates that are linked, directly or through others."""
    count, label = csgraph.connected_components(linked, directed=False)
    groups = [
        tuple(dict.fromkeys(n for n, own in zip(names, label, strict=True) if n and own == k))
        for k in range(count)
    ]
    return [group for group in groups if len(group) > 1]
