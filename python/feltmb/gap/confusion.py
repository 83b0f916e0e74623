"""Probability of confusing two candidates: that the evidence prefers the wrong one.

Let a be the true cause with the magnitude m, so that the data are y = m E_a + noise with unit
variance. Both magnitudes are fitted. The evidence then prefers b if |z_b| > |z_a|, with the signals
z = E'y / |E|. Their means are m lambda and m lambda rho, with the strength lambda = |E_a| and the
correlation rho of the two signatures. z_a - z_b and z_a + z_b are independent and normal, with the
variances 2 (1 - rho) and 2 (1 + rho); b is preferred if their signs differ:

    p = Phi(-m lambda sqrt((1 - rho) / 2)),   q = Phi(-m lambda sqrt((1 + rho) / 2))
    P(b | a) = p (1 - q) + q (1 - p)

The result does not depend on the scale of b, because the prior of a magnitude is at least as wide
as the magnitude (:func:`feltmb.gap.score.set_evidence`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats
from scipy.sparse import csgraph

from feltmb.data import Array
from feltmb.gap.criteria import CONFUSED, DETECTABLE

__all__ = ["confused_groups", "confusion", "confusion_if_detected"]


def confusion(gram: Array, magnitudes: Array) -> Array:
    """Probability of mistaking a candidate (row) for another (column), (k, k) [1].

    Parameters
    ----------
    gram
        Gram matrix of the signatures, parameters projected out, (k, k).
    magnitudes
        Magnitude of each candidate, if it is the true cause [scales], (k,).
    """
    strength = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length = np.where(strength > 0.0, strength, np.inf)
    rho = np.clip(np.abs(gram / np.outer(length, length)), 0.0, 1.0)
    signal = (np.abs(magnitudes) * strength)[:, None]
    p, q = (stats.norm.cdf(-signal * np.sqrt(0.5 * (1.0 + s * rho))) for s in (-1.0, 1.0))
    return np.asarray(p + q - 2.0 * p * q)


def confusion_if_detected(gram: Array, magnitudes: Array) -> Array:
    """The same at magnitudes that are at least detectable; 0 for candidates without a signature.

    Below the smallest detectable magnitude all effects would be confused with each other. Such a
    probability would say nothing about their signatures.
    """
    strength = np.sqrt(np.maximum(np.diag(gram), 0.0))
    shown = strength > 0.0
    least = DETECTABLE / np.where(shown, strength, np.inf)
    out = confusion(gram, np.maximum(np.abs(magnitudes), least))
    out[np.logical_not(np.outer(shown, shown))] = 0.0
    np.fill_diagonal(out, 0.0)
    return out


def confused_groups(names: Sequence[str], chance: Array) -> tuple[tuple[str, ...], ...]:
    """Group the effects that are confused with each other, directly or through a third effect.

    Parameters
    ----------
    names
        Name of each candidate. All shapes of an effect have the same name; candidates that are not
        tested have an empty name.
    chance
        Probability of mistaking one candidate for another, see :func:`confusion_if_detected`.
    """
    count, label = csgraph.connected_components(chance > CONFUSED, directed=False)
    groups = [
        {n for n, own in zip(names, label, strict=True) if n and own == k} for k in range(count)
    ]
    return tuple(sorted({tuple(sorted(group)) for group in groups if len(group) > 1}))
