"""Tests whether a fit leaves more than noise, whatever the cause."""

from __future__ import annotations

from dataclasses import dataclass

from feltmb.fit.solve import Fit
from feltmb.gap.criteria import (
    ALLOWED_REST,
    FORM_LEFT,
    NOISE_ERROR,
    squares_of_noise,
    unknown_gain,
)
from feltmb.gap.smooth import smooth_discrepancy

__all__ = ["Misfit", "allowance", "form_of", "misfit"]


def form_of(explained: float, form: float) -> float:
    """Log evidence that errors in the form of the fitted effects can produce.

    Parameters
    ----------
    explained
        Gain of log evidence by these effects.
    form
        Relative error of the force of their laws (``Options.form``) [1].
    """
    return (FORM_LEFT * form) ** 2 * max(0.0, explained)


def allowance(fit: Fit) -> float:
    """Log evidence that an unknown cause may gain without being a gap.

    A residual with the variance s^2, next to noise of the variance 1, gains about n s^2 / 2 over n
    samples. No model is exact: enough samples make any residual significant. A residual below
    ``criteria.ALLOWED_REST`` of the noise is no gap.
    """
    return 0.5 * ALLOWED_REST**2 * float(fit.dof)


@dataclass(frozen=True)
class Misfit:
    """Residual of a fit compared with noise."""

    left: bool
    """Whether the residual is more than noise."""
    far: bool
    """Whether the sum of squares alone shows this."""
    other: float
    """Log evidence for an unknown cause."""


def misfit(
    fit: Fit, tight: Fit | None, *, alpha: float, estimated: bool, allowed: float = 0.0
) -> Misfit:
    """Test whether the residual of a fit is more than noise.

    The limits follow from the rate of false alarms ``alpha``
    (:func:`~feltmb.gap.criteria.squares_of_noise`, :func:`~feltmb.gap.criteria.unknown_gain`).
    ``allowed`` is the log evidence that errors in the form of the effects in the fit can produce
    (:func:`form_of`). The residual must exceed it.

    The unknown cause is represented by forces at the joint of every segment; in a fit without
    continuity defects, it is a smooth signal in every output. It must gain more than the
    :func:`allowance`. If the noise was estimated from the records, it may be wrong by a third: a
    residual below ``criteria.NOISE_ERROR`` times the noise is attributed to it.
    """
    reference = tight if tight is not None else fit
    if estimated and reference.chi2 / reference.dof < NOISE_ERROR**2:
        return Misfit(False, False, 0.0)
    other = 0.0
    if tight is not None and tight is not fit:
        other = fit.log_evidence - tight.log_evidence
    elif not reference.defect_sd.size:
        other = smooth_discrepancy(reference).largest
    above = reference.chi2 > squares_of_noise(alpha, reference.dof)
    far = bool(above and 0.5 * (reference.chi2 - reference.dof) > allowed)
    unknown = other > max(unknown_gain(alpha), allowance(reference)) + allowed
    return Misfit(bool(far or unknown), far, float(other))
