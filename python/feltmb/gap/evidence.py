"""Log evidence of a fit with effects, whose laws are not exactly those of the machine.

The law of an effect in the library is rarely that of the cause in the machine. An effect whose law
differs from it needs another magnitude in every part of a record. The error of form of the effect k
is therefore represented by deviations from its magnitude s that are independent between segments,

    s_w = s + q |s| d_w,    d_w ~ N(0, 1),

where the law is exact (q = 0) or not (q = ``criteria.FORM_ERROR``), with equal probability. The log
evidence is averaged over these alternatives for all effects. The gain over exact laws is computed
in the linear model at the fit. Without such an allowance, an effect of the wrong kind can be
preferred to one of the right kind whose law is not exact, and the residual of a strong effect seems
to need a second effect.

A cause that the library does not have may act like one of its effects. It then needs deviations
that are larger (``criteria.OTHER_LAW``).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from feltmb.data import Array
from feltmb.fit.latest import cached_for_first
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Candidate
from feltmb.fit.problem import Normal, Point, Problem
from feltmb.fit.solve import Fit, evidence_at, relaxed
from feltmb.gap.criteria import FORM_ERROR, OTHER_LAW
from feltmb.gap.score import prior_of

__all__ = ["Forms", "forms_of", "full_evidence", "linear_evidence", "other_laws", "with_form"]


def full_evidence(fit: Fit, total_weight: float) -> float:
    """Log evidence of a fit, including the prior of its set of effects.

    States, parameters and magnitudes are integrated out. The prior of a magnitude is N(0,
    max(scale, magnitude)^2). The laws of the effects may have errors of form (:func:`forms_of`).
    """
    value = fit.log_evidence
    for candidate, size in zip(fit.included, fit.point.magnitudes, strict=True):
        width = _width(candidate, size)
        value -= float(np.log(width)) + 0.5 * (float(size) / width) ** 2
        if candidate.effect.sign != 0:
            value += float(np.log(2.0))
    # All fits to the same records have the same priors of the parameters.
    volume = _posterior_volume(fit.problem, fit.point, fit.normal)
    return value + volume + prior_of(fit.included, total_weight) + forms_of(fit).gain


@dataclass(frozen=True, eq=False)
class Forms:
    """Alternatives for the laws of the effects in a fit: exact, or with an error of form."""

    inexact: tuple[NDArray[np.intp], ...]
    """Indices of the effects with an error of form, for each alternative; the first: none."""
    gains: Array
    """Log Bayes factor of each alternative to exact laws [1]."""

    @property
    def gain(self) -> float:
        """Log Bayes factor of the average over all alternatives [1]."""
        return float(logsumexp(self.gains)) - math.log(len(self.gains))

    @property
    def log_weights(self) -> Array:
        """Log posterior probability of each alternative [1]."""
        return np.asarray(self.gains - logsumexp(self.gains))


@cached_for_first
def forms_of(fit: Fit) -> Forms:
    """Compare errors of form of the effects in a fit with exact laws.

    Only exact laws are considered if nothing can vary between segments: without effects, or with
    one segment. A model without states has one segment a record.
    """
    segments = sum(s.count for s in fit.problem.segmented_records)
    exact = Forms((np.zeros(0, dtype=np.intp),), np.zeros(1))
    if not fit.included or segments < 2:
        return exact
    if not np.isfinite(fit.log_evidence):
        return exact
    flags = itertools.product((False, True), repeat=len(fit.included))
    inexact = tuple(np.flatnonzero(f) for f in flags)
    values = np.array([_evidence_with(fit, which, FORM_ERROR) for which in inexact])
    return Forms(inexact, values - values[0]) if np.all(np.isfinite(values)) else exact


def other_laws(fit: Fit) -> Array:
    """Log Bayes factor of another law in the place of each effect of a fit, over the effect.

    Another law is that of a cause that the library does not have and that acts like the effect. The
    laws of the other effects are exact. Minus infinity if nothing can vary between segments.
    """
    forms = forms_of(fit)
    if len(forms.gains) == 1:
        return np.full(len(fit.included), -np.inf)
    exact = _evidence_with(fit, forms.inexact[0], 0.0)
    return np.array(
        [
            logsumexp([_evidence_with(fit, np.array([k]), q) for q in OTHER_LAW])
            - math.log(len(OTHER_LAW))
            - exact
            - forms.gain
            for k in range(len(fit.included))
        ]
    )


def _evidence_with(fit: Fit, inexact: NDArray[np.intp], share: float) -> float:
    """Log evidence in the linear model of a fit whose effects deviate by a share."""
    problem, point = fit.problem, fit.point
    linears = with_form(problem, point, problem.linear(point), inexact, share)
    return linear_evidence(problem, point, linears, fit.defect_sd)


def with_form(
    problem: Problem,
    point: Point,
    linears: list[Linear],
    inexact: NDArray[np.intp],
    share: float,
) -> list[Linear]:
    """Derivatives with the deviations of the magnitudes of inexact effects between segments.

    ``share``: standard deviation of the deviations, relative to the magnitude [1].
    """
    if not inexact.size:
        return linears
    columns = len(problem.free) + inexact
    sd = share * np.abs(point.magnitudes[inexact])

    def added(by_input: Array, by_global: Array) -> Array:
        return np.concatenate([by_input, by_global[..., columns] * sd], axis=-1)

    return [
        replace(
            x,
            by_input=added(x.by_input, x.by_global),
            ends_by_input=added(x.ends_by_input, x.ends_by_global),
        )
        for x in linears
    ]


def linear_evidence(
    problem: Problem, point: Point, linears: Sequence[Linear], defect_sd: Array
) -> float:
    """Log evidence in a linear model of the records, up to the prior of its effects.

    Parameters and magnitudes are integrated out.
    """
    normal = problem.normal(point, linears, defect_sd)
    gain = normal.gain(problem.newton(point, normal))
    cost = relaxed(problem, point, normal) - gain
    volume = _posterior_volume(problem, point, normal)
    return evidence_at(problem, normal, cost, defect_sd, linears) + volume


def _posterior_volume(problem: Problem, point: Point, normal: Normal) -> float:
    """Log of the volume of the posterior of parameters and magnitudes, up to a constant."""
    matrix = normal.matrix.copy()
    at = len(problem.free)
    for k, candidate in enumerate(problem.included):
        matrix[at + k, at + k] += 1.0 / _width(candidate, point.magnitudes[k]) ** 2
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    eigen = np.linalg.eigvalsh(matrix / np.outer(size, size))
    log_det = float(np.sum(np.log(np.maximum(eigen, 1e-12)))) + 2.0 * float(np.sum(np.log(size)))
    return -0.5 * log_det


def _width(candidate: Candidate, magnitude: float) -> float:
    """Prior standard deviation of a magnitude [unit of the effect]."""
    return max(candidate.effect.scale, abs(float(magnitude)))
