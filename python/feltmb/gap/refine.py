"""Nonlinear refits of sets of effects that the linear scores rank high."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.model import Candidate
from feltmb.fit.problem import Point, Problem
from feltmb.fit.solve import (
    Fit,
    FitSettings,
    at_level,
    chained,
    finish,
    fit_problem,
    polish,
    relaxed,
)
from feltmb.gap.criteria import NEAR_BEST, RIVAL

__all__ = [
    "CandidateSet",
    "annealed",
    "freed",
    "from_priors",
    "quicker",
    "refit",
    "refit_at",
    "short_of",
    "taken_over",
    "tempered",
    "tighten",
    "worth_of",
]

#: Continuity defects that let parameters return to their priors, as a share of the spread of the
#: states.
LOOSE = 0.1
#: Factors of the noise of tempered fits: the first for :func:`tempered`, all for :func:`annealed`.
TEMPERED = (30.0, 10.0, 3.0)
#: Note of a model fit that left a wrong local minimum because it was started from an effect.
REFITTED = "fitted again from the fit with an effect"


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """A set of effects with its fit."""

    fit: Fit
    evidence: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(t.name for t in self.fit.included)

    @property
    def key(self) -> tuple[str, ...]:
        """Sorted names, which identify the set."""
        return tuple(sorted(self.names))


def worth_of(best: Fit | None) -> float:
    """Sum of squares above which another fit cannot be a rival of the best one.

    Infinite if the best set does not explain the records, so that every set is tried.
    """
    return np.inf if best is None or not best.plausible else best.cost + 2.0 * NEAR_BEST


def quicker(settings: FitSettings) -> FitSettings:
    """Settings for fits that are only compared with each other.

    Differences of log evidence below 1 do not matter for a ranking: 0.05 is accurate enough.
    """
    return settings.coarser(0.1, iterations=15)


def refit(
    base: Fit, included: tuple[Candidate, ...], magnitudes: Array, settings: FitSettings
) -> Fit:
    """Nonlinear fit with included effects, started from ``base``; tightened as long as that helps.

    If a fit reaches less than half of the improvement that the linear model at its start predicts,
    it is repeated. With continuity defects, the states of the segments hold it back: the new fit
    starts with loose defects and the predicted magnitudes. Without them, ``base`` is in another
    local minimum: the new fit starts from the priors, and new effects at their expected magnitude.
    """
    problem = base.problem.with_candidates(included)
    start, before, promised = _reachable(problem, base, included, magnitudes)
    first = polish(problem, start, base.level, settings)
    short = short_of(promised, before - first.cost)
    if first.defect_sd.size:
        fit = _tightened(first, base.level, settings)
        if not short:
            return fit
        again = refit_at(problem, replace(start, magnitudes=magnitudes, memo={}), LOOSE, settings)
        return again if again.log_evidence > fit.log_evidence else fit
    if not short:
        return first
    known = {t.name for t in base.included}
    expected = [
        m if t.name in known else float(np.clip(np.copysign(t.effect.scale, m), *t.effect.bounds))
        for t, m in zip(included, magnitudes, strict=True)
    ]
    way = replace(settings, restarts=0, worth=min(settings.worth, first.cost))
    again = fit_problem(problem, way, point=problem.start(np.array(expected)))
    return again if again.cost < first.cost else first


def short_of(promised: float, reached: float) -> bool:
    """Whether a fit reaches less than half of the gain that a linear model promised."""
    return reached <= 0.5 * promised - 1.0


def refit_at(
    problem: Problem, point: Point, level: float, settings: FitSettings, *, patient: bool = False
) -> Fit:
    """Fit from a good start; tighten the continuity defects as long as that helps.

    ``patient``: a tighter level gets all iterations before it counts as no improvement.
    """
    return _tightened(polish(problem, point, level, settings), level, settings, patient=patient)


def _tightened(fit: Fit, level: float, settings: FitSettings, *, patient: bool = False) -> Fit:
    """The fit with tighter continuity defects, as long as that helps."""
    if not fit.defect_sd.size:
        return fit
    problem = fit.problem
    levels = list(settings.levels)
    at = min(range(len(levels)), key=lambda i: abs(np.log(levels[i] / level)))
    quick = replace(settings, iterations=min(settings.iterations, 4))
    for tighter in levels[at + 1 :]:
        attempt = polish(problem, fit.point, tighter, quick)
        if patient and not attempt.converged:
            attempt = polish(problem, attempt.point, tighter, settings)
        if attempt.log_evidence < fit.log_evidence - 0.5:
            break
        fit = attempt
    if fit.converged or fit.level == level:
        return fit
    return polish(problem, fit.point, fit.level, settings)


def _reachable(
    problem: Problem, base: Fit, included: tuple[Candidate, ...], magnitudes: Array
) -> tuple[Point, float, float]:
    """Start point from ``base``; sum of squares without new effects, and its predicted reduction.

    Both are those of start states that fit the other numbers, to first order. New magnitudes are
    reduced if the linear step is too large.
    """
    old = {t.name: s for t, s in zip(base.included, base.point.magnitudes, strict=True)}
    kept = np.array([old.get(t.name, 0.0) for t in included])
    plain = base.problem.carry(base.point, included, kept)
    defect_sd = base.level * problem.scale(plain)
    linears = problem.linear(plain)
    best, least = plain, problem.cost_at(plain, defect_sd, linears)[0]
    normal = problem.normal(plain, linears, defect_sd)
    promised = problem.step(plain, normal, 0.0)[1]
    before = relaxed(problem, plain, normal)
    for share in (1.0, 0.3, 0.1):
        point = replace(plain, magnitudes=kept + share * (magnitudes - kept), memo={})
        cost = problem.cost(point, defect_sd, linears)[0]
        if cost < 4.0 * least:
            return point, before, promised
        if cost < least:
            best, least = point, cost
    return best, before, promised


def from_priors(fit: Fit, settings: FitSettings) -> Fit:
    """Repeat a doubtful fit with its parameters at their priors and its segments unchanged.

    A fit is doubtful if it did not converge, or if its parameters are far from their priors. Such
    parameters may still have the values that the model without the effect needed.
    """
    problem = fit.problem
    known = [i for i in problem.free if np.isfinite(problem.model.parameters[i].sd)]
    if problem.frozen or not fit.defect_sd.size or not known:
        return fit
    if fit.converged and fit.within_priors:
        return fit
    theta = fit.point.theta.copy()
    theta[known] = problem.start().theta[known]
    again = refit_at(problem, replace(fit.point, theta=theta, memo={}), LOOSE, settings)
    return again if again.log_evidence > fit.log_evidence else fit


def taken_over(fit: Fit) -> Point:
    """Start point of the model without effects, taken from the fit of a set.

    If an effect of the set increases a parameter, the parameter is changed so that it replaces the
    effect to first order.
    """
    problem, matrix = fit.problem, fit.normal.matrix
    point = problem.carry(fit.point, (), np.zeros(0))
    theta = point.theta.copy()
    for k, (candidate, size) in enumerate(zip(fit.included, fit.point.magnitudes, strict=True)):
        for c, i in enumerate(problem.free):
            p = problem.model.parameters[i]
            seen = matrix[c, c] - p.sd**-2.0
            if p.name == candidate.effect.tolerance_parameter and seen > 0.0:
                moved = theta[i] + size * matrix[c, len(problem.free) + k] / seen
                theta[i] = np.clip(moved, p.lower, p.upper)
    return replace(point, theta=theta)


def tighten(fit: Fit, settings: FitSettings) -> Fit | None:
    """The fit with the tightest defects; None if it has them or cannot be simulated with them."""
    if not fit.defect_sd.size or fit.level <= settings.levels[-1]:
        return None
    problem, tightest = fit.problem, settings.levels[-1]
    point = fit.point
    way = settings.coarser(0.3, iterations=12)
    for level in settings.levels[:-1]:
        if level < 0.99 * fit.level:  # a single step would make the simulation fail at impacts
            point = at_level(problem, point, level, None, way, 12).point
    tight = polish(problem, point, tightest, replace(settings, chain=True))

    def doubtful() -> bool:
        # If the loose fit does not explain the records, the result of the tight one does not
        # matter.
        return fit.explains and not tight.log_evidence > fit.log_evidence - RIVAL

    def other(start: Point) -> None:
        nonlocal tight
        again = polish(problem, start, tightest, settings)
        if again.cost < tight.cost or not np.isfinite(tight.cost):
            tight = again

    # A segment in a local minimum can look like an unknown force. Two other starts may avoid this:
    # one simulation through all segments, which has no defects at first, and a slower tightening.
    if doubtful():
        other(chained(problem, fit.point))
    if doubtful():
        point, level = fit.point, fit.level
        while (level := level / np.sqrt(10.0)) > 1.5 * tightest:
            point = at_level(problem, point, level, None, settings, settings.iterations).point
        other(point)
    return tight if np.isfinite(tight.cost) else None


def tempered(fit: Fit, settings: FitSettings) -> Fit | None:
    """The parameters that fit the records with ``TEMPERED[0]`` times their noise, as a start.

    With a tempered likelihood, the parameters stay nearer to their priors and follow the records
    only roughly. So they have taken up less of a missing effect, and they are rarely at a jump of
    the sum of squares, where no step along an effect reduces it. The sum of squares of the result,
    its scores and its evidence are those of the actual noise.

    For fits without continuity defects: free start states follow the records anyway. None if no
    parameter has a prior, so that the noise does not matter.
    """
    problem = fit.problem
    if problem.frozen or not fit.prior_deviation.size:
        return None
    point = _at_noise(problem, fit.point, TEMPERED[0], settings)
    return finish(problem, replace(point, memo={}), fit.level, fit.defect_sd)


def annealed(
    base: Fit, included: tuple[Candidate, ...], magnitudes: Array, settings: FitSettings
) -> Fit:
    """Nonlinear fit with included effects, from a tempered fit to the actual noise in stages.

    At a jump of the sum of squares, for example where a part is just caught, a fit to the actual
    noise may end. With a larger noise the priors weigh more: the parameters first leave the values
    that the fit without the effect needed, and the jump.
    """
    problem = base.problem.with_candidates(included)
    point, _, _ = _reachable(problem, base, included, magnitudes)
    for factor in TEMPERED:
        point = _at_noise(problem, point, factor, settings)
    return polish(problem, replace(point, memo={}), base.level, settings)


def _at_noise(problem: Problem, point: Point, factor: float, settings: FitSettings) -> Point:
    """Parameters that fit the records with a multiple of their noise."""
    noisy = tuple(replace(s, weight=s.weight / factor) for s in problem.segmented_records)
    way = replace(settings, worth=np.inf)
    tempered = replace(problem, segmented_records=noisy)
    return polish(tempered, replace(point, memo={}), 1.0, way).point


def freed(model: Fit, fits: Sequence[Fit], settings: FitSettings) -> Fit | None:
    """The model fitted again from the fits with effects, if that gives a better fit.

    If the model alone is in a local minimum, an effect may look like a cause only because it leads
    out of it. Therefore the model without the effect is also started from there; if the effect is a
    real cause, this does not help.
    """
    best = model
    for led in fits:
        bare = led.problem.carry(led.point, (), np.zeros(0))
        way = replace(settings, worth=best.cost)
        fit = refit_at(model.problem, bare, led.level, way)
        if fit.log_evidence > best.log_evidence + 1.0:
            best = fit
    if best is model:
        return None
    return replace(best, notes=(*model.notes, REFITTED))
