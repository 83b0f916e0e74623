"""Where a tolerance ends: what a parameter may be off before that is called a cause."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from feltmb.fit.model import VARIABILITY, Effect, Model, Parameter
from feltmb.fit.solve import Fit, FitSettings, polish
from feltmb.gap.criteria import TOLERATED
from feltmb.gap.search import Search

__all__ = ["besides_tolerances", "beyond_prior", "prior_deviations_told", "within_tolerance"]

#: Note of a model whose parameters were held within their tolerance.
HELD = "parameters held within their tolerance"


def beyond_prior(fit: Fit) -> dict[str, float]:
    """Parameters beyond their tolerance, and their deviation in standard deviations.

    Those of run-to-run variability are no numbers of the machine and are left out.
    """
    out = {}
    for i in fit.problem.free:
        p = fit.problem.model.parameters[i]
        if not 0.0 < p.sd < math.inf or p.component == VARIABILITY:
            continue
        far = (float(fit.point.theta[i]) - p.value) / p.sd
        if abs(far) > TOLERATED:
            out[p.name] = far
    return out


def besides_tolerances(fit: Fit, effects: Sequence[Effect]) -> list[Effect]:
    """Effects except those that only increase a parameter within its tolerance.

    The score of such an effect is what its parameter is off, which ``TOLERATED`` judges.
    """
    far = beyond_prior(fit)
    return [e for e in effects if not e.tolerance_parameter or e.tolerance_parameter in far]


def prior_deviations_told(fit: Fit) -> str:
    """Text about parameters far from their priors; empty: there are none."""
    far = beyond_prior(fit)
    if not far:
        return ""
    told = ", ".join(f"{name} by {z:.2g}" for name, z in far.items())
    return f"parameters are far from their priors (in prior standard deviations): {told}"


def within_tolerance(found: Search, settings: FitSettings) -> Search:
    """The search, with the model held within the tolerance that its best set goes beyond.

    A let-off button of which 0.2 mm are regulation is a parameter; the fit of the model moves it
    as far as the records ask. The effect "let-off button" is then as likely as the prior of the
    parameter says, but held-out records are predicted as well without it. They are to be compared
    with what the model can do within ``TOLERATED`` standard deviations.
    """
    best = found.best
    if best is None:
        return found
    far = beyond_prior(found.model_fit)
    names = {t.effect.tolerance_parameter for t in best.fit.included} & far.keys()
    if not names:
        return found
    before = found.model_fit
    model = _held(before.problem.model, names)
    problem = replace(before.problem, model=model)
    theta = np.clip(
        before.point.theta,
        [p.lower for p in model.parameters],
        [p.upper for p in model.parameters],
    )
    quick = settings.coarser(0.1, iterations=15)
    fit = polish(problem, replace(before.point, theta=theta, memo={}), before.level, quick)
    if not np.isfinite(fit.cost):
        return found
    return replace(found, held=replace(fit, levels=before.levels, notes=(*before.notes, HELD)))


def _held(model: Model, names: Collection[str]) -> Model:
    """The model with narrower limits of some parameters."""
    out = copy.copy(model)
    out.parameters = tuple(_limited(p) if p.name in names else p for p in model.parameters)
    return out


def _limited(p: Parameter) -> Parameter:
    return replace(
        p,
        lower=max(p.lower, p.value - TOLERATED * p.sd),
        upper=min(p.upper, p.value + TOLERATED * p.sd),
    )
