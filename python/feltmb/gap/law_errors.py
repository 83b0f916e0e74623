"""Evidence that a law of the model itself is not exact.

A force whose law differs from that of the machine in a way that no parameter can express needs
another value of its parameter in every part of a record. The error of form of the law of the
parameter p is therefore represented by deviations from p that are independent between segments,

    p_w = p + q u d_w,    d_w ~ N(0, 1),

with u the prior standard deviation of p (or its scale, if it has no prior) and q unknown. The log
Bayes factor of such an error against the exact law is averaged over the fitted parameters and over
a few values of q, because nobody knows which law is not exact, and by how much. A linear model
gives the average; the best case is fitted again, and corrects it. Further laws are added, beside
the best ones, while this average becomes larger.

The model with an error of form is the strongest alternative to an effect of the library. It stands
for every cause that the library does not have and that acts where a law of the model acts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from feltmb.data import Array
from feltmb.fit.latest import cached_for_first
from feltmb.fit.linearize import varying
from feltmb.fit.model import Model, Parameter
from feltmb.fit.solve import Fit, FitSettings, polish
from feltmb.fit.watch import current
from feltmb.gap.evidence import full_evidence, linear_evidence
from feltmb.gap.findings import VaryingLaw

__all__ = ["LawErrors", "law_errors"]

#: Values of q.
SHARES = (0.1, 0.3, 1.0)
#: Largest number of laws with an error.
MOST = 3
#: Mean square of a residual above which differences of sums of squares are rounding.
FAR = 1e8


@dataclass(frozen=True)
class LawErrors:
    """Errors of form of the laws of a model, compared with exact laws."""

    gain: float
    """Log Bayes factor of errors of form, averaged over laws and sizes [1]; minus infinity if they
    cannot be tested."""
    laws: tuple[VaryingLaw, ...] = ()
    """Laws with an error, the one that explains most first; empty: the records show none."""
    fit: Fit | None = None
    """The model with these errors, fitted again; None: the records show none."""

    @property
    def tested(self) -> bool:
        """Whether errors of form can be tested."""
        return self.gain > -math.inf


@cached_for_first
def law_errors(fit: Fit, settings: FitSettings) -> LawErrors:
    """Compare a fit with the same model whose laws have errors of form.

    They cannot be tested if nothing can vary between segments (no states, or one segment), if no
    parameter is fitted, or if the fit is so far from the records that the gain would be rounding.

    Parameters
    ----------
    fit
        A fit with or without effects, with the tightest continuity defects: looser ones absorb
        errors of form as well.
    settings
        Settings of the fit.

    Returns
    -------
    LawErrors
        The gain, and the laws with an error; after a stop, those that were found before it.
    """
    laws = [p for p in _free(fit) if p.of_the_machine and _unit(p) > 0.0]
    segments = max((s.count for s in fit.problem.segmented_records), default=0)
    if not laws or not fit.defect_sd.size or segments < 2:
        return LawErrors(-math.inf)
    if not np.isfinite(fit.log_evidence) or not fit.chi2 < FAR * fit.dof:
        return LawErrors(-math.inf)
    way = replace(settings, worth=math.inf)
    now, gain, found = fit, 0.0, list[VaryingLaw]()
    with current().keeping():
        while len(found) < MOST and not current().must_end():
            names = {law.parameter for law in found}
            tried = _screened(now, [p for p in laws if p.name not in names])
            if not tried:
                break
            best, linear = max(tried, key=lambda t: t[1])
            step = float(logsumexp([value for _, value in tried])) - math.log(len(tried))
            if step > 0.0:
                problem = replace(
                    now.problem,
                    model=_varied(now.problem.model, {best.parameter: best.sd}),
                    state_scale=fit.defect_sd / fit.level,
                )
                fitted = polish(problem, replace(now.point, memo={}), now.level, way)
                step += full_evidence(fitted, 1.0) - full_evidence(now, 1.0) - linear
                if not (0.0 <= fitted.cost < math.inf and math.isfinite(step)):
                    step = 0.0  # the refit diverged
            if not step > 0.0:
                gain = gain if found or math.isnan(step) else step
                break
            now, gain = fitted, gain + step
            found.append(best)
    return LawErrors(gain, tuple(found), now if found else None)


def _free(fit: Fit) -> list[Parameter]:
    return [fit.problem.model.parameters[i] for i in fit.problem.free]


def _unit(parameter: Parameter) -> float:
    """Unit of the deviations: the prior standard deviation, or else the scale [unit]."""
    return parameter.sd if math.isfinite(parameter.sd) else parameter.size


def _varied(model: Model, sd: Mapping[str, float]) -> Model:
    """The model with additional deviations of parameters between segments [their units]."""
    old = {p.name: p for p in model.parameters}
    return model.with_parameters(
        {n: replace(old[n], process_sd=math.hypot(old[n].process_sd, s)) for n, s in sd.items()}
    )


def _screened(fit: Fit, laws: Sequence[Parameter]) -> list[tuple[VaryingLaw, float]]:
    """All sizes of the errors of every law, with the gain of log evidence in the linear model."""
    units = {p.name: _unit(p) for p in laws}
    problem = replace(fit.problem, model=_varied(fit.problem.model, units))
    point = replace(fit.point, memo={})
    linears = problem.linear(point)
    which = varying(problem.model, problem.free)
    order = [problem.model.parameters[i].name for i in which]
    whole = np.array([problem.model.parameters[i].process_sd for i in which])
    given = np.array([fit.problem.model.parameters[i].process_sd for i in which])
    inputs = linears[0].by_input.shape[2] - len(order)

    def evidence(sd: Array) -> float:
        scale = np.concatenate([np.ones(inputs), sd / whole])
        kept = np.flatnonzero(scale)
        mixed = [
            replace(
                x,
                by_input=x.by_input[..., kept] * scale[kept],
                ends_by_input=x.ends_by_input[..., kept] * scale[kept],
            )
            for x in linears
        ]
        return linear_evidence(problem, point, mixed, fit.defect_sd)

    without = evidence(given)
    out = []
    for p in laws:
        for share in SHARES:
            sd = given.copy()
            k = order.index(p.name)
            sd[k] = math.hypot(sd[k], share * units[p.name])
            law = VaryingLaw(parameter=p.name, label=p.title, unit=p.unit, sd=share * units[p.name])
            out.append((law, evidence(sd) - without))
    return out
