"""Score tests of all candidate causes from one fit, with all other unknowns projected out.

Let r be the whitened residual, S its derivatives by parameters, states and nuisances, E_k the
derivative by the magnitude of a candidate (times its scale), and M = I - S (S'S)^-1 S'. Then

    b = E' M r,   G = E' M E,   T_k = b_k^2 / G_kk,   T_A = b_A' G_AA^-1 b_A

T is chi-square distributed if the candidate is absent. phi_A = G_AA^-1 b_A is the magnitude after
one step, and sqrt(G_kk) the noncentrality per scale. States are eliminated segment by segment
(feltmb.fit.filter). The remaining algebra is small, so that thousands of sets cost milliseconds.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats
from scipy.linalg import eigh

from feltmb.data import Array
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Candidate, Effect
from feltmb.fit.problem import solve_scaled
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import FITTED_SHAPE

__all__ = [
    "NO_SIGNATURE",
    "ScoredSet",
    "Scores",
    "all_candidates",
    "family_threshold",
    "prior_of",
    "refuting_score",
    "score_fit",
    "screen_sets",
    "tail",
]

#: Share of a signature that must remain after the projection for a test; below it is rounding.
LEAST_SURVIVING = 1e-7
#: Squared norm of a signature of one scale, in noise variances, that counts as zero.
NO_SIGNATURE = 1e-12
#: Smallest eigenvalue of the correlations of signatures of a set that can be separated.
DEPENDENT = 1e-4


@dataclass(frozen=True, eq=False)
class Scores:
    """Score tests of candidates at one fit; magnitudes in units of the scales."""

    candidates: tuple[Candidate, ...]
    b: Array
    gram: Array
    raw: Array
    """Diagonal of E'E after elimination of the states only."""
    segment_scores: Array
    """Contributions of the segments of all segmented records to b, (segments, k)."""
    segment_grams: Array
    """Contributions to the diagonal of G, (segments, k)."""
    inflation: float
    """Ratio of the residual sum of squares to its degrees of freedom, at least 1."""

    @property
    def strength(self) -> Array:
        """Noncentrality at magnitude = scale, sqrt(G_kk)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.gram), 0.0)))

    @property
    def tested(self) -> int:
        """Number of candidates that can be tested."""
        return int(np.sum(self.testable))

    @property
    def total_weight(self) -> float:
        """Sum of the weights of the effects, each counted once for all its shapes."""
        return sum({t.name: t.effect.weight for t in self.candidates}.values())

    @property
    def testable(self) -> Array:
        """Whether enough of the signature remains after the projection."""
        diagonal = np.diag(self.gram)
        return np.asarray((diagonal > LEAST_SURVIVING * self.raw) & (diagonal > NO_SIGNATURE))

    def among(self, effects: Sequence[Effect]) -> Scores:
        """Scores of a part of the candidates."""
        kept = [i for i, t in enumerate(self.candidates) if any(t.effect is e for e in effects)]
        return replace(
            self,
            candidates=tuple(self.candidates[i] for i in kept),
            b=self.b[kept],
            gram=self.gram[np.ix_(kept, kept)],
            raw=self.raw[kept],
            segment_scores=self.segment_scores[:, kept],
            segment_grams=self.segment_grams[:, kept],
        )

    def one_step(self) -> Array:
        """Magnitudes after one step, one candidate at a time, permitted signs only [scales]."""
        diagonal = np.where(self.testable, np.diag(self.gram), np.inf)
        size = self.b / diagonal
        for i, t in enumerate(self.candidates):
            low, high = t.effect.bounds
            size[i] = np.clip(size[i], low / t.effect.scale, high / t.effect.scale)
        return np.asarray(size)

    def singles(self) -> Array:
        """T of each candidate; 0 if its sign is not permitted."""
        size = self.one_step()
        return np.asarray(np.maximum(2.0 * size * self.b - size**2 * np.diag(self.gram), 0.0))

    def evidence(self) -> Array:
        """Predicted log evidence of each candidate alone, with its prior; limits are kept."""
        size = np.abs(self.one_step())
        width = np.maximum(1.0, size)
        gram = np.where(self.testable, np.diag(self.gram), 0.0)
        prior = np.array([prior_of((t,), self.total_weight) for t in self.candidates])
        # The prior of a magnitude with a sign is a half of a normal distribution.
        prior += np.where([t.effect.sign != 0 for t in self.candidates], math.log(2.0), 0.0)
        prior -= 0.5 * (size / width) ** 2
        return np.asarray(0.5 * self.singles() - 0.5 * np.log1p(gram * width**2) + prior)

    def robust(self) -> Array:
        """T with the cluster-robust variance over segments."""
        size = self.one_step()
        left = self.segment_scores - self.segment_grams * size
        count = max(len(left), 2)
        variance = np.sum(left**2, axis=0) * count / (count - 1)
        gain = np.where(size != 0.0, self.b**2, 0.0)
        return np.asarray(np.divide(gain, variance, out=np.zeros_like(gain), where=variance > 0.0))

    def correlation(self) -> Array:
        """G_kl / sqrt(G_kk G_ll); candidates with the value 1 cannot be distinguished."""
        size = np.where(self.testable, self.strength, np.inf)
        out = self.gram / np.outer(size, size)
        np.fill_diagonal(out, 1.0)
        return np.asarray(np.clip(out, -1.0, 1.0))


@dataclass(frozen=True)
class ScoredSet:
    """A set of candidates with its linear score test."""

    index: tuple[int, ...]
    magnitudes: tuple[float, ...]
    """Magnitudes after one step [scales]."""
    statistic: float
    evidence: float
    """Log Bayes factor relative to the model, prior of the set included."""


def all_candidates(effects: Sequence[Effect], without: Sequence[str] = ()) -> tuple[Candidate, ...]:
    """Candidates of all effects with all their shapes."""
    return tuple(Candidate(e, s) for e in effects if e.name not in without for s in e.shapes)


def score_fit(
    fit: Fit,
    candidates: tuple[Candidate, ...],
    *,
    without: int | None = None,
    linears: list[Linear] | None = None,
) -> Scores:
    """Score tests of candidates at a fit.

    Parameters
    ----------
    candidates
        Candidates that are tested.
    without
        Index of an included effect that is removed to first order: the scores are those of the
        other effects, at parameters that are fitted again in the linear model. The removed effect
        is the first candidate of the result. The linear model holds at the fit with this effect, so
        that it is better for effects with a similar signature than scores at a fit without it.
    linears
        Linearization at the fit with these candidates; None: it is computed.
    """
    problem = fit.problem
    if linears is None:
        linears = problem.linear(fit.point, candidates)
    normal = problem.normal(fit.point, linears, fit.defect_sd)
    known = len(problem.free) + len(problem.included)
    e = np.arange(known, known + len(candidates))
    # A parameter at a limit that would have to cross it cannot absorb a signature.
    open_ = np.flatnonzero(~problem.pressed(fit.point, normal))
    right, moved = normal.right, 0.0
    if without is not None:
        at, moved = len(problem.free) + without, float(fit.point.magnitudes[without])
        open_, e = open_[open_ != at], np.concatenate([[at], e])
        candidates = (problem.included[without], *candidates)
        right = right + moved * normal.matrix[:, at]
    k = len(candidates)
    s = np.concatenate([open_, np.arange(normal.shared, normal.right.size)])
    scale = np.array([t.effect.scale for t in candidates])
    h_ss = normal.matrix[np.ix_(s, s)]
    h_se = normal.matrix[np.ix_(s, e)]
    absorb = solve_scaled(h_ss, h_se)
    delta = solve_scaled(h_ss, right[s])
    gram = normal.matrix[np.ix_(e, e)] - h_se.T @ absorb
    b = right[e] - h_se.T @ delta
    raw = np.diag(normal.matrix)[e] * scale**2
    scores, grams = [], []
    place = {int(c): i for i, c in enumerate(s)}
    tested = {int(c): i for i, c in enumerate(e)}
    chi2 = 0.0
    for chain, own in zip(normal.chains, normal.columns, strict=True):
        width = own.size + 1
        mix = np.zeros((width, k + 1))
        for column, g in enumerate(own):
            if int(g) in tested:
                mix[column, tested[int(g)]] = 1.0
            elif int(g) in place:
                mix[column, :k] = -absorb[place[int(g)]]
                mix[column, k] = -delta[place[int(g)]]
            if without is not None and g == e[0]:
                mix[column, k] = moved
        mix[-1, k] = 1.0
        for segment in chain.grams:
            part = segment @ mix
            scores.append(mix[:, :k].T @ part[:, k] * scale)
            grams.append(np.einsum("ij,ij->j", mix[:, :k], part[:, :k]) * scale**2)
            chi2 += float(mix[:, k] @ part[:, k])
    return Scores(
        candidates=candidates,
        b=b * scale,
        gram=0.5 * (gram + gram.T) * np.outer(scale, scale),
        raw=raw,
        segment_scores=np.array(scores).reshape(len(scores), k),
        segment_grams=np.array(grams).reshape(len(grams), k),
        inflation=max(1.0, chi2 / fit.dof),
    )


def set_evidence(b: Array, gram: Array, magnitudes: Array, inflation: float) -> float:
    """Log Bayes factor of a set relative to none, with prior sd = max(scale, magnitude).

    A scale that is declared too small thus costs less than the square of its error. One that is too
    large costs the usual logarithm.
    """
    width = np.maximum(1.0, np.abs(magnitudes))
    inner = np.eye(b.size) + gram * np.outer(width, width) / inflation
    scaled = b * width / inflation
    _, log_det = np.linalg.slogdet(inner)
    return float(-0.5 * log_det + 0.5 * scaled @ np.linalg.solve(inner, scaled))


def fitted_numbers(candidate: Candidate) -> int:
    """Number of values of a shape that were fitted, i.e. differ from every shape in the list."""
    shapes = [s if isinstance(s, tuple) else (s,) for s in candidate.effect.shapes]
    own = candidate.shape if isinstance(candidate.shape, tuple) else (candidate.shape,)
    listed = {repr(s) for s in shapes}
    if repr(own) in listed:
        return 0
    return sum(repr(v) not in {repr(s[k]) for s in shapes if len(s) > k} for k, v in enumerate(own))


def prior_of(included: Sequence[Candidate], total_weight: float) -> float:
    """Log prior of a set, from the weights of its effects and the number of their shapes."""
    value = 0.0
    for t in included:
        value += math.log(t.effect.weight / total_weight) - math.log(len(t.effect.shapes))
        value -= FITTED_SHAPE * fitted_numbers(t)
    return value


#: Number of ranked effects from which pairs and triples are formed.
PAIRS_FROM, TRIPLES_FROM = 60, 16


def screen_sets(scores: Scores, *, largest: int = 3) -> list[ScoredSet]:
    """All single effects and promising pairs and triples, sorted by evidence."""
    usable = np.flatnonzero(scores.testable)
    if usable.size == 0:
        return []
    total = scores.total_weight
    single = scores.singles()
    found: list[ScoredSet] = []

    def consider(index: tuple[int, ...]) -> None:
        i = list(index)
        b, gram = scores.b[i], scores.gram[np.ix_(i, i)]
        magnitudes = solve_scaled(gram, b)
        for j, size in zip(i, magnitudes, strict=True):
            low, high = scores.candidates[j].effect.bounds
            scale = scores.candidates[j].effect.scale
            if not low / scale <= size <= high / scale or size == 0.0:
                return  # at its limit: a smaller set is equivalent
        length = np.sqrt(np.diag(gram))
        rho = gram / np.outer(length, length)
        if len(i) > 1 and np.linalg.eigvalsh(rho)[0] < DEPENDENT:
            return  # cannot be distinguished
        statistic = float(b @ magnitudes)
        prior = prior_of([scores.candidates[j] for j in i], total)
        evidence = set_evidence(b, gram, magnitudes, scores.inflation) + prior
        found.append(ScoredSet(index, tuple(float(v) for v in magnitudes), statistic, evidence))

    for j in usable:
        consider((int(j),))
    # A pair may be significant although none of its effects is. Partners are therefore chosen by T,
    # and by T given the best effect.
    best = int(usable[np.argmax(single[usable])])
    pivot = scores.gram[best, best]
    rest_b = scores.b - scores.gram[:, best] * scores.b[best] / pivot
    rest_g = np.diag(scores.gram) - scores.gram[:, best] ** 2 / pivot
    own = rest_g > 1e-6 * np.diag(scores.gram)
    given = np.where(own, rest_b**2 / np.where(own, rest_g, 1.0), 0.0)
    order = usable[np.argsort(-np.maximum(single, given)[usable], kind="stable")]
    if largest >= 2:
        for pair in itertools.combinations(sorted(order[:PAIRS_FROM].tolist()), 2):
            if scores.candidates[pair[0]].effect is not scores.candidates[pair[1]].effect:
                consider(pair)
    if largest >= 3:
        top = order[:TRIPLES_FROM].tolist()
        for s in sorted(found, key=lambda s: -s.evidence)[:20]:
            top.extend(s.index)
        for triple in itertools.combinations(sorted(set(top)), 3):
            if len({id(scores.candidates[j].effect) for j in triple}) == 3:
                consider(triple)
    found.sort(key=lambda s: (-s.evidence, s.index))
    return found


def tail(statistic: float, tested: int) -> float:
    """Bound of the family-wise p beyond the draws: the sum of the p of all candidates [1].

    Parameters
    ----------
    statistic
        One T.
    tested
        Number of candidates that were tested.
    """
    return tested * float(stats.chi2.sf(statistic, 1))


def refuting_score(maxima: Array, tested: int, p: float) -> float:
    """T that the largest one exceeds by chance with the probability p.

    Parameters
    ----------
    maxima
        Draws of the largest T without an effect.
    tested
        Number of candidates that were tested.
    p
        Probability, > 0; below the resolution of the draws :func:`tail` gives the limit.
    """
    if p * maxima.size >= 1.0:
        return float(np.quantile(maxima, 1.0 - p))
    return float(stats.chi2.isf(p / max(tested, 1), 1))


def family_threshold(
    scores: Scores, alpha: float, *, draws: int = 20000, seed: int = 0
) -> tuple[float, Array]:
    """Value that the largest T of all candidates exceeds with probability alpha under the null.

    Also returns the sorted maxima of the draws b ~ N(0, G), with permitted signs only.
    """
    usable = np.flatnonzero(scores.testable)
    if usable.size == 0:
        return math.inf, np.zeros(1)
    rho = scores.correlation()[np.ix_(usable, usable)]
    values, vectors = eigh(rho)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    signs = np.array([scores.candidates[i].effect.sign for i in usable])
    generator = np.random.default_rng(seed)
    maxima = np.zeros(draws)
    for at in range(0, draws, 2000):
        z = generator.standard_normal((min(2000, draws - at), usable.size)) @ root.T
        z = np.where((signs != 0) & (np.sign(z) != signs), 0.0, z)
        maxima[at : at + len(z)] = np.max(z**2, axis=1)
    maxima.sort()
    return refuting_score(maxima, usable.size, alpha), maxima
