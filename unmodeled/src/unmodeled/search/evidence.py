"""Evidence of a set of causes, if every model is a little wrong.

The noise of a channel is the larger one of that of its sensor and the rms of what the set leaves.
What a wrong model leaves is correlated, so that the log likelihood counts *effective* samples:

    log E = -sum_c w_c n_c (log f_c + mean(r_c^2) / (2 f_c^2))
            - P(x) / 2 - log det(J'(w/f^2)J + W) / 2

with the residuals r in units of the noise of the sensors, the noise f of each channel in the same
unit, the weights w of a sample (:func:`weights`), and the prior P with the weights W. It is a
tempered likelihood with Laplace's approximation. With a right model and white noise w is 1.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from unmodeled.data import Array
from unmodeled.search.linear import Linear, Point, count_global, local_of
from unmodeled.search.problem import RELEASED, Members, Observed, Problem

#: Degrees of freedom of the Student t prior of magnitudes.
DEGREES = 4.0
#: Scale of the prior of the sizes that a cause has by record, in the expected size [1]. With one
#: degree of freedom, how much records differ is known to two orders of magnitude.
OWN_SCALE = 0.1
#: Share of what chance allows that counts as discrepancy: the records cannot exclude it [1].
CHANCE = 0.1


@dataclass(frozen=True, eq=False)
class Fitted:
    """A set of causes, fitted together with the parameters."""

    members: Members
    point: Point
    linears: tuple[Linear, ...]
    noise: Array
    """Noise of each channel in units of the noise of its sensor [1], (m,), at least 1."""
    serial: int = field(init=False, default_factory=itertools.count().__next__)
    """Number of the fit: no other one has it."""

    @property
    def causes(self) -> tuple[int, ...]:
        """Indices of the causes."""
        return tuple(m.cause for m in self.members)

    @cached_property
    def effective(self) -> float:
        """Effective share of the samples for the likelihood [1]."""
        return effective_share(self.linears, self.noise)

    @cached_property
    def evidence_known(self) -> dict[tuple[int, bytes], tuple[Problem, float]]:
        """Log evidence by problem and weights: most comparisons are made again in the next step."""
        return {}

    @property
    def residuals(self) -> tuple[Array, ...]:
        """By record, in units of the noise of the sensors, (n, m)."""
        return tuple(x.residual for x in self.linears)

    @cached_property
    def squares(self) -> Array:
        """Sum of the squared residuals by channel, (m,)."""
        return np.asarray(sum((x.residual**2).sum(axis=0) for x in self.linears))


def effective_share(linears: Sequence[Linear], noise: Array) -> float:
    """Share of independent samples of the residuals of records, in units of a noise by channel.

    1 / (1 + 2 max(a, b)): a, sum of the autocorrelations up to the first pair that is not positive
    (Geyer, Statistical Science 7, 1992, 473), for slow residuals; b, sum of their squares
    (Bartlett 1946), for narrow bands, where the autocorrelation changes its sign.
    """
    lengths = [len(x.residual) for x in linears]
    longest, count = max(lengths), noise.size * sum(lengths)
    size = 1 << int(2 * longest - 1).bit_length()  # with zeros, so that the ends do not meet
    spectrum = np.asarray(sum(x.spectrum(size) for x in linears)) @ noise**-2
    power = float(sum((x.residual**2).sum(axis=0) for x in linears) @ noise**-2)
    if power == 0.0 or longest < 4:
        return 1.0
    rho = np.fft.irfft(spectrum, size)[1 : max(2, longest // 2)] / power
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0.0)
    slow = float(pairs[: ends[0] if len(ends) else None].sum())
    band = float(np.maximum(rho**2 - 1.0 / count, 0.0).sum())
    return 1.0 / (1.0 + 2.0 * max(slow, band, 0.0))


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of the global unknowns of a set: normal, or Student t for causes."""

    weight: Array
    """Square of the unit over the scale of the prior, (g,)."""
    heavy: Array
    """Whether the prior is Student t, (g,)."""

    def penalty(self, x: Array) -> float:
        """-2 log density, up to a constant."""
        z = self.weight * x**2
        heavy = (DEGREES + 1.0) * np.log1p(z / DEGREES)
        return float(np.where(self.heavy, heavy, z).sum())

    def weights(self, x: Array) -> Array:
        """Weights w with half the gradient of the penalty = w x."""
        z = self.weight * x**2
        softer = (DEGREES + 1.0) / DEGREES / (1.0 + z / DEGREES)
        return np.asarray(self.weight * np.where(self.heavy, softer, 1.0))


def prior_of(problem: Problem, members: Members) -> Prior:
    """Prior of the global unknowns of a set."""
    released = problem.released(members)
    effects = len(problem.effects_of(members))
    shapes = count_global(problem, members) - len(problem.free) - effects
    weight = np.where(released, problem.prior / RELEASED**2, problem.prior)
    return Prior(
        np.concatenate([weight, np.ones(effects + shapes)]),
        np.concatenate([released, np.ones(effects, bool), np.zeros(shapes, bool)]),
    )


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of the global unknowns, with the local ones eliminated."""

    matrix: Array
    """Without the prior, (g, g)."""
    right: Array
    """(g,)"""
    further: Array
    """Products of further effects and global unknowns, (c, g)."""
    own: Array
    """Products of further effects with each other, (c, c)."""
    gain: Array
    """Products of further effects and the residual, (c,)."""
    locals: tuple[tuple[Array, Array, Array], ...]
    """By record: matrix with prior, its coupling to global unknowns, right side."""
    log_det: float
    """Log determinant of the matrices of the local unknowns."""


def system(
    problem: Problem,
    records: Sequence[Observed],
    members: Members,
    point: Point,
    linears: Sequence[Linear],
    noise: Array,
    share: float | Array,
    damping: float = 0.0,
    soft: Mapping[tuple[str, int], float] | None = None,
) -> NormalEquations:
    """Normal equations at a point: share J'J / noise^2 and the priors of the local unknowns.

    ``share``: weight of a sample, for all channels or by channel. ``soft``: see :func:`softness`;
    None: that of these records.
    """
    g = linears[0].by_global.shape[2]
    counts = [x.by_local.shape[2] for x in linears]
    weighted, log_det = np.asarray(share / noise**2), 0.0
    softer = softness(problem, records, members, point) if soft is None else soft
    blocks: dict[int, tuple[Array, Array, Array]] = {}
    total = 0.0
    for n in dict.fromkeys(counts):  # records with as many unknowns together
        rows = [r for r, count in enumerate(counts) if count == n]
        size = linears[rows[0]].gram.shape[1]
        grams = np.array([linears[r].gram for r in rows]).reshape(len(rows), weighted.size, -1)
        gram = (weighted @ grams).reshape(len(rows), size, size)
        local = slice(g, g + n)
        own_local = [local_of(problem, members, records[r]) for r in rows]
        plain = np.array([[q.weight for q in own] for own in own_local])
        weight = plain
        if softer:
            weight = plain * [[softer.get((q.kind, q.index), 1.0) for q in o] for o in own_local]
        inner, target = gram[:, local, local].copy(), gram[:, local, -1]
        diagonal = np.einsum("rnn->rn", inner)
        diagonal += weight * (1.0 + damping) + damping * diagonal
        target -= weight * np.array([point.local[r] for r in rows])
        own = gram.sum(axis=0)
        if n:
            coupling = gram[:, local]
            solved = np.linalg.solve(inner, coupling)
            own -= np.einsum("rnk,rnl->kl", coupling, solved)
            log_det += float(np.linalg.slogdet(inner)[1].sum() - np.log(plain).sum())
        total = total + np.delete(np.delete(own, local, axis=0), local, axis=1)
        blocks |= {r: (inner[i], gram[i, local, :g], target[i]) for i, r in enumerate(rows)}
    own = np.asarray(total)
    a, e = slice(0, g), slice(g, -1)
    locals_ = tuple(blocks[r] for r in range(len(counts)))
    return NormalEquations(
        own[a, a], own[a, -1], own[e, a], own[e, e], own[e, -1], locals_, log_det
    )


def misfit(samples: Array, squares: Array) -> Array:
    """Negative log likelihood of all samples, with the noise that they leave, by channel, (m,).

    The noise is at least that of the sensor (1).
    """
    mean = squares / np.maximum(samples, 1.0)
    return np.asarray(
        0.5 * samples * np.where(mean > 1.0, 1.0 + np.log(np.maximum(mean, 1.0)), mean)
    )


def local_penalty(
    problem: Problem, records: Sequence[Observed], members: Members, point: Point
) -> float:
    """Penalty of the unknowns of all records.

    That of a cause is a Student t of all its values together (:func:`penalty_of_records`).
    """
    total = float(
        sum(
            (np.array([q.weight for q in local_of(problem, members, o)]) * values**2).sum()
            for o, values in zip(records, point.local, strict=True)
        )
    )
    for squares, count in _causes_of_records(problem, records, members, point).values():
        total += penalty_of_records(squares, count) - squares
    return total


def penalty_of_records(squares: float, count: int) -> float:
    """-2 log density of the sizes that a cause has by record, relative to a normal prior at 0.

    They have a common variance that is not known. With its prior, they are a Student t together:
    the first record tells how large they are, and the others cost less than if each were unknown.

    Parameters
    ----------
    squares
        Sum of the squares of the sizes, in the expected one.
    count
        Their number.
    """
    from scipy.special import gammaln

    half = 0.5 * (1 + count)
    constant = gammaln(half) - gammaln(0.5) + count * math.log(math.sqrt(2.0) / OWN_SCALE)
    return float((1 + count) * math.log1p(squares / OWN_SCALE**2) - 2.0 * constant)


def _causes_of_records(
    problem: Problem, records: Sequence[Observed], members: Members, point: Point
) -> dict[tuple[str, int], tuple[float, int]]:
    """Sum of the squares of the values that a cause has in records, and their number."""
    keys, found = {(q.kind, q.index) for q in problem.locals_of(members)}, {}
    for key in keys:
        values = [
            float(v)
            for o, own in zip(records, point.local, strict=True)
            for q, v in zip(local_of(problem, members, o), own, strict=True)
            if (q.kind, q.index) == key
        ]
        found[key] = sum(v * v for v in values), len(values)
    return found


def softness(
    problem: Problem,
    records: Sequence[Observed],
    members: Members,
    point: Point,
    *,
    begins: bool = False,
) -> dict[tuple[str, int], float]:
    """Factors of the weights of the causes of records: half the gradient of their penalty.

    ``begins``: whether sizes that are zero are not fitted yet, so that they tell no variance.
    """
    found = _causes_of_records(problem, records, members, point)
    return {
        key: 1.0 if begins and not squares else (1 + n) / (OWN_SCALE**2 + squares)
        for key, (squares, n) in found.items()
    }


def weights(problem: Problem, one: Fitted, other: Fitted) -> Array:
    """Weight of a sample by channel in the comparison of two sets, (m,).

    A set leaves noise, and a discrepancy that no cause of the list has. The noise is random, and
    counts the effective share of its samples. The discrepancy is not: another record of the same
    motion repeats it, and one law that is wrong moves many channels. It counts as D samples of all
    channels (``problem.discrepancy_samples``, and one for each start that is not known, which takes
    up one), however long the records and however many the channels are, so that small differences
    between models that are both wrong decide nothing (a coarsened likelihood: Miller and Dunson,
    Journal of the American Statistical Association 114, 2019, 1113). The variances of an estimate
    by both add, so that the effective number N of samples of a channel is

        f^2 / N = 1 / (q n) + m d^2 / D,    m = (sum d^2)^2 / sum d^4

    with the noise f that the better set leaves, in units of the noise of the sensor, and the
    discrepancy d^2 = f^2 - 1, and a share of what chance allows: below that, the records cannot
    exclude a discrepancy. The number m of channels that share it is 1 if one channel has all of it,
    and the number of all channels if they have equal parts.
    """
    share = max(one.effective, other.effective)
    samples = np.maximum(problem.samples, 1.0)
    square = np.minimum(one.noise, other.noise) ** 2
    discrepancy_samples = problem.discrepancy_samples_with_starts
    return (
        square * precision(square, 1.0 / (share * samples), discrepancy_samples, CHANCE) / samples
    )


def precision(
    square: Array, random: Array, discrepancy_samples: float, chance: float = -1.0
) -> Array:
    """Inverse variance of an estimate by a noise and a discrepancy together, by channel, (m,).

    Parameters
    ----------
    square
        Mean square of what a set leaves, in units of the square of the noise of the sensor.
        All channels, which share one discrepancy.
    random
        Inverse number of independent samples.
    discrepancy_samples
        Number of samples as which the discrepancy counts.
    chance
        Multiple of what chance allows that is added to the discrepancy [1].
    """
    discrepancy = np.maximum(square - 1.0 + 2.0 * chance * np.sqrt(2.0 * random), 0.0)
    sharing = discrepancy.sum() ** 2 / max(float(np.sum(discrepancy**2)), 1e-300)
    return np.asarray(1.0 / (random + sharing * discrepancy / discrepancy_samples))


def log_odds(problem: Problem, one: Fitted, other: Fitted) -> float:
    """Log of the posterior odds of two sets."""
    if one is other:
        return 0.0
    weight = weights(problem, one, other)
    return log_evidence(problem, one, weight) - log_evidence(problem, other, weight)


def best_of(problem: Problem, sets: Sequence[Fitted]) -> Fitted:
    """The set that no other one beats, in the order in which they were fitted."""
    best = sets[0]
    for s in sets[1:]:
        if log_odds(problem, s, best) > 0.0:
            best = s
    return best


def log_evidence(problem: Problem, fitted: Fitted, weight: Array) -> float:
    """Log evidence of a fitted set and its prior odds, up to a constant of the records.

    ``weight``: that of a sample by channel, (m,).
    """
    key = id(problem), weight.tobytes()
    if key not in fitted.evidence_known:
        fitted.evidence_known[key] = problem, _log_evidence(problem, fitted, weight)
    return fitted.evidence_known[key][1]


def _log_evidence(problem: Problem, fitted: Fitted, weight: Array) -> float:
    members, point = fitted.members, fitted.point
    left = problem.samples * np.log(fitted.noise) + 0.5 * fitted.squares / fitted.noise**2
    prior, x = prior_of(problem, members), point.x
    own = system(problem, problem.fit, members, point, fitted.linears, fitted.noise, weight)
    hessian = own.matrix + np.diag(prior.weights(x))
    known = prior.weight > 1e-4
    occam = own.log_det + float(np.linalg.slogdet(hessian)[1])
    occam -= float(np.log(prior.weight[known]).sum())
    penalty = prior.penalty(x) + local_penalty(problem, problem.fit, members, point)
    return float(
        problem.log_odds_of([m.cause for m in members])
        - weight @ left
        - 0.5 * penalty
        - 0.5 * occam
        + _one_sided(problem, members, point, hessian)
    )


def _one_sided(problem: Problem, members: Members, point: Point, hessian: Array) -> float:
    """Log of the share of the posterior on the permitted side, over that of the prior, one half."""
    from scipy.special import log_ndtr

    covariance = np.linalg.inv(hessian)
    at, total = len(problem.free), 0.0
    for m in members:
        cause = problem.causes[m.cause]
        if cause.effect is None:
            continue
        if cause.one_sided:
            sign = 1.0 if cause.bounds[0] == 0.0 else -1.0
            z = sign * point.x[at] / np.sqrt(max(covariance[at, at], 1e-300))
            total += float(np.log(2.0) + log_ndtr(z))
        at += 1
    return total
