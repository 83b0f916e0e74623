"""Two readings of a tolerance: all parameters deviate, or few do and the others keep their values.

The numbers of a new machine deviate from a drawing by about their standard deviations (*drawn*).
After a repair, the machine is the tabulated one but for few changes (*kept*). Both are priors of
one mixture:

    drawn:  x_k ~ N(0, 1) for all k
    kept:   x_k ~ N(0, 1) with probability 1/n, else N(0, NARROW^2), for each of n parameters

with x in standard deviations. The likelihood of a fitted set is normal near its fit, so that the
evidence of each configuration (which parameters have the wide prior) is a closed form; single
changes of a configuration cost one division each (the matrix determinant lemma). All sizes,
probabilities and intervals are those of the mixture of the configurations.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import CHANCE, Fitted, NormalEquations, precision, prior_of, system
from unmodeled.search.linear import local_of
from unmodeled.search.options import Tolerances
from unmodeled.search.problem import NARROW, Problem

#: Configurations that are less probable than the best one by this factor are omitted.
NEGLIGIBLE = 1e-4
#: Largest number of configurations from which further ones are tried.
BEAM = 40
#: Posterior over prior standard deviation above which a parameter alone is hardly known, and below
#: which a product of powers is known [1].
ALONE, TOGETHER = 0.5, 0.3
#: Probability outside an interval [1].
OUTSIDE = 0.05


@dataclass(frozen=True, eq=False)
class Configuration:
    """Posterior of the global unknowns if some parameters have the wide prior."""

    wide: frozenset[int]
    """Indices of the parameters, among the global unknowns; all tested ones: *drawn*."""
    log_prior: float
    log_evidence: float
    """With its prior."""
    mean: Array
    """(g,)"""
    covariance: Array
    """(g, g)"""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Mixture of the posteriors of all configurations that are not negligible."""

    tested: tuple[int, ...]
    """Indices of the parameters with a tolerance."""
    configurations: tuple[Configuration, ...]
    """The most probable first."""

    @cached_property
    def weight(self) -> Array:
        """Probability of each configuration [1]."""
        log = np.array([c.log_evidence for c in self.configurations])
        own = np.exp(log - log.max())
        return np.asarray(own / own.sum())

    def with_likelihood(self, matrix: Array, right: Array, prior: Array) -> Posterior:
        """The same configurations and weights, with means and covariances of another likelihood.

        ``matrix``, ``right``, ``prior``: as for :func:`mixture`.
        """
        out = []
        for c in self.configurations:
            own = _prior(prior, self.tested, c.wide)
            covariance = np.asarray(np.linalg.inv(matrix + np.diag(own)))
            out.append(replace(c, mean=covariance @ right, covariance=covariance))
        return replace(self, configurations=tuple(out))

    @property
    def drawn(self) -> float:
        """Probability that all parameters deviate by their tolerances [1]."""
        return float(
            sum(
                w
                for c, w in zip(self.configurations, self.weight, strict=True)
                if len(c.wide) == len(self.tested)
            )
        )

    @cached_property
    def mean(self) -> Array:
        """Means of the global unknowns, (g,)."""
        return np.asarray(self.weight @ [c.mean for c in self.configurations])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the global unknowns, (g, g)."""
        apart = np.array([c.mean for c in self.configurations]) - self.mean
        inside = sum(
            w * c.covariance for w, c in zip(self.weight, self.configurations, strict=True)
        )
        return np.asarray(inside + (self.weight * apart.T) @ apart)

    def interval(self, k: int, given: Iterable[int] = ()) -> tuple[float, float, float]:
        """Mean and 95 % interval of an unknown, by default over all configurations.

        Parameters
        ----------
        k
            Index of the unknown.
        given
            Only configurations count in which these parameters have the wide prior.
        """
        needed = set(given)
        some = [i for i, c in enumerate(self.configurations) if needed <= c.wide]
        some = some or list(range(len(self.configurations)))
        weight = self.weight[some] / self.weight[some].sum()
        mean = np.array([self.configurations[i].mean[k] for i in some])
        variance = np.array([self.configurations[i].covariance[k, k] for i in some])
        sd = np.sqrt(np.maximum(variance, 1e-300))
        return float(weight @ mean), *_quantiles(weight, mean, sd)

    def sets(self) -> list[frozenset[int]]:
        """Parameters that changed, by configuration; none if all deviate by their tolerances."""
        whole = len(self.tested)
        return [c.wide if len(c.wide) < whole else frozenset() for c in self.configurations]


def posterior(problem: Problem, fitted: Fitted, tolerances: Tolerances) -> Posterior:
    """Posterior of the global unknowns of a fitted set under both readings of the tolerances.

    What the fit has taken up of a discrepancy is not seen. It may be larger than what is left, so
    that the discrepancy counts as half a sample: of the numbers 1/4, 1/2, 0.7 and 1, it has the
    least interval score on the imperfect machines of the yardstick.
    """
    own = equations(problem, fitted)
    x = fitted.point.x
    prior = prior_of(replace(problem, narrow=frozenset()), fitted.members).weights(x)
    released = problem.released(fitted.members)
    tested = tuple(
        k
        for k, i in enumerate(problem.free)
        if (p := problem.model.parameters[i]).of_the_machine
        and math.isfinite(p.sd)
        and p.before is None  # a test of the part has measured it
        and not released[k]
    )
    # Differences below a discrepancy that chance allows do not decide which parameters changed.
    rough = equations(problem, fitted, CHANCE)
    found = mixture(rough.matrix, rough.matrix @ x + rough.right, prior, tested, tolerances)
    return found.with_likelihood(own.matrix, own.matrix @ x + own.right, prior)


def equations(problem: Problem, fitted: Fitted, chance: float = -1.0) -> NormalEquations:
    """Normal equations of a set, with the weights that intervals need.

    ``chance``: multiple of what chance allows that counts as discrepancy, see :func:`precision`.
    """
    samples = np.maximum(problem.samples, 1.0)
    left = np.maximum(fitted.noise / np.maximum(white(problem, fitted), 1.0), 1.0) ** 2
    weight = left * precision(left, 1.0 / (fitted.effective * samples), 0.5, chance) / samples
    return system(
        problem,
        problem.fit,
        fitted.members,
        fitted.point,
        fitted.linears,
        fitted.noise,
        weight,
    )


def white(problem: Problem, fitted: Fitted) -> Array:
    """Noise of each sensor from the residual of a set, in units of the noise so far [1], (m,).

    It is the part of the residual that neighboring samples do not share, so that a residual which
    is white is noise.
    """
    from unmodeled.data.smoothing import noise_of_samples

    of_records = [
        [
            noise_of_samples(o.record.time[o.valid[:, c]], x.residual[o.valid[:, c], c], 1)
            for c in range(fitted.noise.size)
        ]
        for x, o in zip(fitted.linears, problem.fit, strict=True)
    ]
    return np.asarray(np.sqrt(np.mean(np.square(of_records), axis=0)))


def mixture(
    matrix: Array,
    right: Array,
    prior: Array,
    tested: Sequence[int],
    tolerances: Tolerances = "auto",
) -> Posterior:
    """Posterior of unknowns with a normal likelihood exp(-x' A x / 2 + b' x).

    Parameters
    ----------
    matrix, right
        A, (g, g), and b, (g,).
    prior
        Weights of the wide priors, (g,).
    tested
        Indices of the parameters with a tolerance.
    tolerances
        ``"drawn"`` or ``"kept"``: only this reading; ``"auto"``: both, with equal odds.
    """
    n = len(tested)
    all_wide = frozenset(tested)
    odds = -math.log(max(n - 1, 1))  # of one parameter that changes: probability 1/n
    none = n * math.log1p(-1.0 / n) if n > 1 else math.log(0.5) if n else 0.0

    def solved(wide: frozenset[int], log_prior: float) -> Configuration:
        own = _prior(prior, tested, wide)
        covariance = np.linalg.inv(matrix + np.diag(own))
        mean = covariance @ right
        evidence = 0.5 * float(right @ mean) + 0.5 * float(np.linalg.slogdet(covariance)[1])
        evidence -= (n - len(wide)) * math.log(NARROW)
        return Configuration(wide, log_prior, evidence + log_prior, mean, np.asarray(covariance))

    drawn = solved(all_wide, 0.0)
    if tolerances == "drawn" or n == 0:
        return Posterior(tuple(tested), (drawn,))
    found: dict[frozenset[int], Configuration] = {}
    queue = [solved(frozenset(), none)]
    least = math.log(NEGLIGIBLE)
    while queue:
        found |= {c.wide: c for c in queue}
        best = max(c.log_evidence for c in found.values())
        some = sorted(queue, key=lambda c: -c.log_evidence)[:BEAM]
        further: dict[frozenset[int], float] = {}
        for c in some:
            if c.log_evidence < best + least:
                continue
            gains = _widened(c, prior, [k for k in tested if k not in c.wide])
            for k, gain in gains.items():
                if c.log_evidence + gain + odds > best + least and len(c.wide) + 1 < n:
                    wide = c.wide | {k}
                    further[wide] = max(further.get(wide, -math.inf), gain)
        new = [w for w in sorted(further, key=lambda w: -further[w]) if w not in found][:BEAM]
        queue = [solved(w, none + odds * len(w)) for w in new]
    kept = list(found.values())
    if tolerances == "auto":
        kept.append(drawn)
    kept.sort(key=lambda c: -c.log_evidence)
    top = kept[0].log_evidence
    return Posterior(tuple(tested), tuple(c for c in kept if c.log_evidence > top + least))


def _prior(prior: Array, tested: Sequence[int], wide: Collection[int]) -> Array:
    """Weights of the priors of a configuration, (g,)."""
    own = prior.copy()
    own[[k for k in tested if k not in wide]] /= NARROW**2
    return own


def _widened(c: Configuration, prior: Array, further: Sequence[int]) -> dict[int, float]:
    """Gain of log evidence if one more parameter has the wide prior, without its odds."""
    out = {}
    for k in further:
        variance, mean = float(c.covariance[k, k]), float(c.mean[k])
        less = -prior[k] * (NARROW**-2 - 1.0)  # change of the weight of the prior
        rest = max(1.0 + less * variance, 1e-300)
        out[k] = -0.5 * math.log(rest) - 0.5 * less * mean**2 / rest + math.log(NARROW)
    return out


def _quantiles(weight: Array, mean: Array, sd: Array) -> tuple[float, float]:
    """Ends of the central interval of a mixture of normal distributions, by bisection."""
    from scipy.special import ndtr

    def at(share: float) -> float:
        low, high = float(np.min(mean - 9.0 * sd)), float(np.max(mean + 9.0 * sd))
        for _ in range(60):
            middle = 0.5 * (low + high)
            below = float(weight @ ndtr((middle - mean) / sd))
            low, high = (middle, high) if below < share else (low, middle)
        return 0.5 * (low + high)

    return at(0.5 * OUTSIDE), at(1.0 - 0.5 * OUTSIDE)


@dataclass(frozen=True)
class Combination:
    """Powers of parameters whose product is known better than each of them."""

    parameters: tuple[int, ...]
    """Indices among the global unknowns."""
    exponents: tuple[int, ...]
    value: float
    """Relative deviation of the product from the tabulated one [1]."""
    low: float
    """Lower end of the 95 % interval [1]."""
    high: float
    sd: float
    """Standard deviation of its prior [1]."""


def combination(own: Posterior, spread: Array, told: Collection[int]) -> Combination | None:
    """The product of powers of two or three parameters that is known best, if it deviates.

    Each of them alone is hardly known (posterior above 0.7 of its prior), and the product is
    (below 0.3 of its prior).

    Parameters
    ----------
    own
        Posterior of the global unknowns.
    spread
        Standard deviation of each global unknown over its tabulated value [1]; 0: it is no positive
        number with a tolerance, (g,).
    told
        Parameters that are told by themselves.
    """
    sd = np.sqrt(np.diag(own.covariance))
    some = [k for k in own.tested if spread[k] > 0.0 and sd[k] > ALONE and k not in told]
    best, least = None, TOGETHER
    for count in (2, 3):
        powers = [
            e for e in product((1, -1, 2, -2), repeat=count) if e[0] > 0 and min(map(abs, e)) == 1
        ]
        for members in combinations(some, count):
            at = list(members)
            covariance = own.covariance[np.ix_(at, at)]
            for e in powers:
                weight = np.array(e) * spread[at]
                prior = float(np.linalg.norm(weight))
                known = math.sqrt(max(float(weight @ covariance @ weight), 0.0))
                if known < 0.9 * least * prior:  # a third parameter must be worth it
                    best, least = (members, e, weight, prior), known / prior
    if best is None:
        return None
    members, e, weight, prior = best
    at = list(members)
    means = np.array([float(weight @ c.mean[at]) for c in own.configurations])
    sds = [
        math.sqrt(float(weight @ c.covariance[np.ix_(at, at)] @ weight)) for c in own.configurations
    ]
    low, high = (math.expm1(v) for v in _quantiles(own.weight, means, np.array(sds)))
    if low <= 0.0 <= high:
        return None
    return Combination(members, e, math.expm1(float(own.weight @ means)), low, high, prior)


def in_each_record(
    problem: Problem, fitted: Fitted, kind: str, index: int, covariance: Array
) -> tuple[list[float], float]:
    """Values that an error of a sensor has in each record, and the variance of their rms."""
    at = [
        [(q.kind, q.index) for q in local_of(problem, fitted.members, o)].index((kind, index))
        for o in problem.fit
    ]
    values = [float(v[k]) for v, k in zip(fitted.point.local, at, strict=True)]
    rms = math.sqrt(sum(v * v for v in values) / len(values))
    own = equations(problem, fitted)
    # The rms depends on the values, and these on the unknowns that all records have.
    variance, shared = 0.0, np.zeros(covariance.shape[0])
    for v, k, (inner, coupling, _) in zip(values, at, own.locals, strict=True):
        slope = v / (len(values) * rms) if rms > 0.0 else 0.0
        of_record = np.linalg.solve(inner, np.column_stack([np.eye(len(inner))[k], coupling]))[k]
        variance += slope**2 * float(of_record[0])
        shared += slope * of_record[1:]
    return values, variance + float(shared @ covariance @ shared)
