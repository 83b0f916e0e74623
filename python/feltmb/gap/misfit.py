"""Whether a fit leaves more than noise, whatever causes it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from feltmb.fit.solve import Fit
from feltmb.gap.criteria import EXCESS, FORM, MISFIT_RATIO, OTHER_EVIDENCE
from feltmb.gap.smooth import smooth_discrepancy

__all__ = ["Misfit", "form_of", "misfit"]


def form_of(explained: float) -> float:
    """What such effects leave is their form up to this [units of log evidence]."""
    return FORM**2 * max(0.0, explained)


@dataclass(frozen=True)
class Misfit:
    """What a fit leaves."""

    left: bool
    """Whether that is more than noise."""
    excess: float
    """Sum of squares beyond its expectation, in standard deviations."""
    other: float
    """Log evidence for something unknown."""


def misfit(
    fit: Fit, tight: Fit | None, *, estimated: bool, bar: float = EXCESS, explained: float = 0.0
) -> Misfit:
    """What a fit leaves, and whether that is more than noise.

    ``explained`` is the gain of log evidence of the effects in the fit. What is left must be more
    than ``criteria.FORM`` of that motion: no law is right to the last digit, nor is an integrator.

    The unknown are forces at every segment's joint, or, where a fit has no continuity defects, a
    smooth signal in every output. Where the noise itself was estimated from the records, an excess
    within a third of it is not held against the model.
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
