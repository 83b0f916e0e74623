"""Tests whether a fit leaves more than noise, whatever the cause."""

from __future__ import annotations

import math
from dataclasses import dataclass

from feltmb.fit.solve import Fit
from feltmb.gap.criteria import EXCESS, FORM, MISFIT_RATIO, OTHER_EVIDENCE
from feltmb.gap.smooth import smooth_discrepancy

__all__ = ["Misfit", "form_of", "misfit"]


def form_of(explained: float) -> float:
    """Log evidence that errors in the form of the fitted effects can produce."""
    return FORM**2 * max(0.0, explained)


@dataclass(frozen=True)
class Misfit:
    """Residual of a fit compared with noise."""

    left: bool
    """Whether the residual is more than noise."""
    excess: float
    """Sum of squares minus its expectation, in standard deviations."""
    other: float
    """Log evidence for an unknown cause."""


def misfit(
    fit: Fit, tight: Fit | None, *, estimated: bool, bar: float = EXCESS, explained: float = 0.0
) -> Misfit:
    """Test whether the residual of a fit is more than noise.

    ``explained`` is the gain of log evidence by the effects in the fit. The residual must exceed
    what a model-form error of ``criteria.FORM`` of that motion produces, because neither a law nor
    an integrator is exact.

    The unknown cause is represented by forces at the joint of every segment; in a fit without
    continuity defects, it is a smooth signal in every output. If the noise was estimated from the
    records, it may be wrong by a third: a ratio of the sum of squares to its expectation below
    ``criteria.MISFIT_RATIO`` is attributed to it.
    """
    reference = tight if tight is not None else fit
    if estimated and reference.chi2 / reference.dof < MISFIT_RATIO:
        return Misfit(False, 0.0, 0.0)
    beyond = reference.chi2 - reference.dof
    excess = beyond / math.sqrt(2.0 * reference.dof)
    other = 0.0
    if tight is not None and tight is not fit:
        other = fit.log_evidence - tight.log_evidence
    elif not reference.gap_sd.size:
        other = smooth_discrepancy(reference)
    form = form_of(explained)
    far = excess > bar and 0.5 * beyond > form
    return Misfit(bool(far or other > OTHER_EVIDENCE + form), float(excess), float(other))
