"""Distinguishes a parameter within its tolerance from a parameter error that is a cause."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from feltmb.fit.model import Effect, Model, Parameter
from feltmb.fit.problem import Point
from feltmb.fit.solve import Fit, FitSettings, Interval, limit_of_noise, polish
from feltmb.gap.criteria import RIVAL, TOLERATED
from feltmb.gap.evidence import full_evidence
from feltmb.gap.misfit import misfit
from feltmb.gap.refine import CandidateSet, quicker, taken_over, tighten
from feltmb.gap.score import score_fit
from feltmb.gap.search import Search
from feltmb.gap.spread import Spread

__all__ = [
    "besides_tolerances",
    "beyond_prior",
    "beyond_tolerance",
    "by_few_numbers",
    "evidence_of_release",
    "more_of_tolerances",
    "of_the_machine",
    "prior_deviations_told",
    "refuted_tolerances",
    "released",
    "sd_of_change",
    "within_tolerance",
    "without_several",
]

#: Note of a model whose parameters were limited to their tolerance.
LIMITED = "parameters limited to their tolerance"


def sd_of_change(found: Interval, tolerance: float) -> float:
    """Standard deviation of the change of a parameter by a fit, if its tolerance is right [unit].

    With the tolerance s and the posterior standard deviation sd, the change is normal with the
    variance s^2 - sd^2 = s^2 contraction. Errors in the form of laws add their own variance.
    """
    return math.hypot(tolerance * math.sqrt(max(found.contraction, 0.0)), found.form_sd)


def beyond_tolerance(found: Interval, tolerance: float) -> bool:
    """Whether a parameter exceeds its tolerance.

    The change must not be compared with the tolerance alone (:func:`sd_of_change`): if the prior is
    as narrow as the information of the records, it halves the change. A change smaller than the
    tolerance never exceeds it.
    """
    change = abs(found.value - found.prior)
    return change > max(tolerance, TOLERATED * sd_of_change(found, tolerance))


def of_the_machine(
    fit: Fit, wide: Spread | None = None
) -> list[tuple[int, int, Parameter, Interval]]:
    """Free parameters that are properties of the machine: position among the free ones, index.

    Parameters of run-to-run variability and of inputs between samples are not. ``wide``: the
    uncertainty of the fit with its shapes and errors of form.
    """
    parameters = fit.problem.model.parameters
    intervals = fit.intervals() if wide is None else fit.intervals(wide.covariance, wide.by_form)
    return [
        (k, i, parameters[i], interval)
        for k, (i, interval) in enumerate(zip(fit.problem.free, intervals, strict=False))
        if parameters[i].of_the_machine
    ]


def beyond_prior(fit: Fit, wide: Spread | None = None) -> dict[str, float]:
    """Parameters of the machine beyond their tolerance: change in prior standard deviations."""
    return {
        p.name: (found.value - p.value) / p.sd
        for _, _, p, found in of_the_machine(fit, wide)
        if 0.0 < p.sd < math.inf and beyond_tolerance(found, p.sd)
    }


def besides_tolerances(fit: Fit, effects: Sequence[Effect]) -> list[Effect]:
    """Effects except those that only change a parameter within its tolerance.

    The score of such an effect measures the error of its parameter, which is compared with
    ``TOLERATED`` instead.
    """
    far = beyond_prior(fit)
    return [e for e in effects if not e.tolerance_parameter or e.tolerance_parameter in far]


def prior_deviations_told(fit: Fit, wide: Spread | None = None) -> str:
    """Text about parameters far from their priors; empty: there are none."""
    far = beyond_prior(fit, wide)
    if not far:
        return ""
    told = ", ".join(f"{name} by {z:.2g}" for name, z in far.items())
    return f"parameters are far from their priors (in prior standard deviations): {told}"


def within_tolerance(found: Search, settings: FitSettings) -> Search:
    """The search with the model limited to the tolerance that its best set exceeds.

    Example: the position of a let-off button, regulated to 0.2 mm, is a parameter. The fit of the
    model changes it as far as the records require. The effect "let-off button" then gets the
    probability that the prior of the parameter implies, but without it held-out records are
    predicted equally well. The effect must be compared with the model limited to ``TOLERATED``
    standard deviations.
    """
    best = found.best
    if best is None:
        return found
    far = beyond_prior(found.model_fit)
    names = {t.effect.tolerance_parameter for t in best.fit.included} & far.keys()
    if not names:
        return found
    before = found.model_fit
    model = _within_tolerance(before.problem.model, names)
    problem = replace(before.problem, model=model)
    theta = np.clip(
        before.point.theta,
        [p.lower for p in model.parameters],
        [p.upper for p in model.parameters],
    )
    quick = quicker(settings)
    fit = polish(problem, replace(before.point, theta=theta, memo={}), before.level, quick)
    if not np.isfinite(fit.cost):
        return found
    return replace(found, limited=replace(fit, notes=(*before.notes, LIMITED)))


def released(
    found: Search, settings: FitSettings, *, alpha: float, estimated: bool
) -> Search | None:
    """The search with the model fitted without the tolerances that the records contradict.

    A wrong prior must not bias the reported value: with a tolerance of 20 % and records that
    determine a friction to 22 %, 200 % would become 90 %. An effect that does not exist must not
    compensate this error either. None in three cases: no parameter exceeds its tolerance; the model
    without the tolerances does not explain the records; other effects explain them as well.
    """
    far = beyond_prior(found.model_fit)
    start, freed = found.model_fit, set(far)
    if more_of_tolerances(found.best, far):
        assert found.best is not None
        start = found.best.fit
        freed = {t.effect.tolerance_parameter for t in start.included}
    if not freed or not found.model_fit.explains:
        return None
    fit = without_tolerances(found.model_fit, freed, taken_over(start), settings)
    if not np.isfinite(fit.cost):
        return None
    tight = tighten(fit, settings)
    if misfit(fit, tight, alpha=alpha, estimated=estimated).left:
        return None
    own, level = full_evidence(fit, 1.0), evidence_of_release(found.model_fit, fit)
    if start is not found.model_fit:  # the best set is an equivalent explanation
        assert found.best is not None
        level = max(level, found.best.evidence)
    others = [c for c in found.sets if not _moves(c.fit, freed)]
    # A set that also changes these parameters is no rival; an addition to them that helps is one.
    for c in found.sets:
        if c.fit is not start and c.evidence > level - (0.0 if _moves(c.fit, freed) else RIVAL):
            return None
    left = tuple(t for t in found.scores.candidates if t.effect.tolerance_parameter not in freed)
    return replace(
        found,
        model_fit=fit,
        scores=score_fit(fit, left),
        tight_fit=tight,
        tight=None if tight is None else score_fit(tight, left),
        sets=tuple(replace(c, evidence=c.evidence - level + own) for c in others),
        model_evidence=own,
        limited=None,
    )


def evidence_of_release(limited: Fit, freed: Fit) -> float:
    """Log evidence of a fit without some tolerances, comparable with that of a set of effects.

    The change of a parameter counts as the magnitude of an effect, one of as many as there are
    parameters. ``limited``: the fit with all tolerances.
    """
    known = limited.problem.model.parameters
    level = full_evidence(freed, 1.0)
    for p, x in zip(known, freed.point.theta, strict=True):
        if p.name in freed.problem.refuted and math.isfinite(p.sd):
            level -= 0.5 + math.log(max(1.0, abs(x - p.value) / p.sd)) + math.log(len(known))
    return level


def by_few_numbers(fit: Fit, most: int) -> bool:
    """Whether a fit explains the records, with only some parameters beyond their tolerances.

    The other parameters must be within their joint prior. A fit that changes all parameters
    imitates a missing cause.
    """
    few = beyond_prior(fit)
    if not fit.explains or not 0 < len(few) <= most:
        return False
    far = fit.prior_deviation
    rest = far.size - len(few)
    left = float(np.sum(far**2)) - sum(z**2 for z in few.values())
    return left < limit_of_noise(rest)


def without_several(fit: Fit, settings: FitSettings) -> Fit:
    """The fit of the model; without tolerances if the records contradict several of them.

    The records then belong to another machine, or to another state of it, or an effect is missing
    that these parameters imitate. Only a search for effects can tell which.
    """
    far = beyond_prior(fit)
    # Continuity defects could explain the records instead of the model.
    torn = fit.defect_sd.size > 0 and fit.level > settings.levels[-1]
    if len(far) < 2 or torn or not fit.explains:
        return fit
    freed = without_tolerances(fit, far, fit.point, settings)
    return freed if freed.explains else fit


def without_tolerances(
    fit: Fit, names: Collection[str], start: Point, settings: FitSettings
) -> Fit:
    """Fit of the model without priors for some parameters."""
    model = fit.problem.model
    model = model.with_parameters(
        {p.name: replace(p, sd=math.inf, scale=p.size) for p in model.parameters if p.name in names}
    )
    refuted = (*fit.problem.refuted, *(n for n in names if n not in fit.problem.refuted))
    problem = replace(fit.problem, model=model, refuted=refuted)
    new = polish(problem, replace(start, memo={}), fit.level, settings)
    return replace(new, notes=(*fit.notes, *_refutation(model, names)))


def refuted_tolerances(fit: Fit) -> list[str]:
    """Text about tolerances and tests that a fit does not use; empty: it uses all of them."""
    return _refutation(fit.problem.model, fit.problem.refuted)


def _refutation(model: Model, names: Collection[str]) -> list[str]:
    tested = {p.name for p in model.parameters if p.before is not None}
    parts = [
        f"{what} of {', '.join(sorted(some))}"
        for what, some in (("tolerance", {*names} - tested), ("test", {*names} & tested))
        if some
    ]
    if not parts:
        return []
    return [f"the records refute the {' and the '.join(parts)}: the fit does not use it"]


def more_of_tolerances(best: CandidateSet | None, far: Collection[str]) -> bool:
    """Whether a set only has effects that change parameters beyond their tolerance."""
    included = () if best is None else best.fit.included
    return bool(included) and all(t.effect.tolerance_parameter in far for t in included)


def _moves(fit: Fit, names: Collection[str]) -> bool:
    return any(t.effect.tolerance_parameter in names for t in fit.included)


def _within_tolerance(model: Model, names: Collection[str]) -> Model:
    """The model with limits at the tolerance for some parameters."""
    return model.with_parameters({p.name: _limited(p) for p in model.parameters if p.name in names})


def _limited(p: Parameter) -> Parameter:
    return replace(
        p,
        lower=max(p.lower, p.value - TOLERATED * p.sd),
        upper=min(p.upper, p.value + TOLERATED * p.sd),
    )
