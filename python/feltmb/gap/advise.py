"""What these records can tell apart, and what to measure next."""

from __future__ import annotations

import numpy as np
from scipy import stats

from feltmb.data import Array
from feltmb.fit.nominal import Nominal
from feltmb.gap.refine import Search
from feltmb.gap.report import Advice
from feltmb.gap.score import Scores
from feltmb.gap.settle import Accepted

#: Standardized size that is seen in nine of ten records at one false alarm in a hundred.
SHOWS = 3.7

__all__ = ["advise", "confusion", "confusion_at"]


def confusion_at(scores: Scores, sizes: Array) -> Array:
    """Probability to take one candidate for another, (k, k), at given sizes [scales].

    P = Phi(-1/2 sqrt(2 (1 - |rho|)) |phi| lambda), the distance of the two signatures in noise.
    """
    rho = np.abs(scores.correlation())
    signal = np.abs(sizes) * scores.strength
    distance = np.sqrt(np.maximum(2.0 * (1.0 - rho), 0.0)) * signal[:, None]
    chance = stats.norm.cdf(-0.5 * distance)
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


def advise(search: Search, accepted: Accepted, nominal: Nominal) -> tuple[Advice, ...]:
    """Which of the records at hand separates what is confused best: more of that kind.

    The signatures are summed record by record; the record whose windows separate a confused pair
    best says what kind of experiment to repeat, and how often.
    """
    if accepted.candidate is None or not accepted.rivals:
        return ()
    scores = search.tight if search.tight is not None else search.scores
    del nominal
    out = []
    mine = set(accepted.candidate.names)
    for rival in accepted.rivals[:3]:
        a = sorted(mine - set(rival.names))
        b = sorted(set(rival.names) - mine)
        if not a or not b:
            continue
        i = next(k for k, t in enumerate(scores.terms) if t.name == a[0])
        j = next(k for k, t in enumerate(scores.terms) if t.name == b[0])
        size = abs(float(accepted.candidate.fit.point.sizes[accepted.candidate.names.index(a[0])]))
        signal = size / scores.terms[i].effect.scale * float(scores.strength[i])
        rho = abs(float(scores.correlation()[i, j]))
        gap = float(np.sqrt(max(2.0 * (1.0 - rho), 0.0))) * signal
        now = float(stats.norm.cdf(-0.5 * gap))
        if gap <= 1e-6:
            text = (
                f"{a[0]} and {b[0]} leave the same trace in these records at any noise; "
                "another sensor or another kind of input is needed"
            )
            out.append(
                Advice(text=text, separates=(a[0], b[0]), confusion_now=0.5, confusion_then=0.5)
            )
            continue
        times = float(np.ceil((2.0 * stats.norm.isf(0.05) / gap) ** 2))
        then = float(stats.norm.cdf(-0.5 * gap * np.sqrt(max(times, 2.0))))
        name = _best_record(search, i, j)
        text = (
            f"record {max(times, 2.0):.0f} times as much of the kind of {name}, or lower the noise "
            f"by {np.sqrt(max(times, 2.0)):.1f}, to separate {a[0]} from {b[0]}"
        )
        out.append(
            Advice(text=text, separates=(a[0], b[0]), confusion_now=now, confusion_then=then)
        )
    return tuple(out)


def _best_record(search: Search, i: int, j: int) -> str:
    """Record whose windows show one candidate most unlike the other."""
    scores = search.tight if search.tight is not None else search.scores
    shots = search.nominal.problem.shots
    value = np.zeros(len(shots))
    for row, (shot, _) in enumerate(scores.window_of):
        a, b = scores.window_grams[row, i], scores.window_grams[row, j]
        value[shot] += (np.sqrt(max(a, 0.0)) - np.sqrt(max(b, 0.0))) ** 2
    return shots[int(np.argmax(value))].record.name
