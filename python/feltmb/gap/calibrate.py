"""Null distribution of the largest score: asymptotic, corrected by refits of simulated records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Candidate, Effect, Model
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit, FitSettings, finish, polish
from feltmb.fit.watch import Say, current
from feltmb.gap.refine import quicker, refit
from feltmb.gap.score import Scores, all_candidates, family_threshold, score_fit, tail
from feltmb.gap.search import Search

__all__ = ["Null", "calibrate", "largest_statistic"]


@dataclass(frozen=True, eq=False)
class Null:
    """Family-wise null distribution of the largest score T, if no effect is missing."""

    threshold: float
    """Value that the largest T exceeds with probability alpha."""
    maxima: Array
    """Sorted draws of the largest T from the asymptotic distribution."""
    stretch: float
    """Factor between the bootstrap and the asymptotic distribution of the largest T, at least 1."""
    replicates: int

    tested: int
    """Number of candidates that were tested."""

    def p(self, statistic: float) -> float:
        """Family-wise p value of one T."""
        count = int(np.sum(self.maxima * self.stretch >= statistic))
        drawn = (1.0 + count) / (1.0 + self.maxima.size)
        return drawn if count else min(drawn, tail(statistic / self.stretch, self.tested))


def calibrate(
    fit: Fit,
    scores: Scores,
    effects: Sequence[Effect],
    alpha: float,
    replicates: int,
    *,
    seed: int = 0,
    progress: Say | None = None,
) -> Null:
    """Compute the null distribution of the largest score.

    The asymptotic distribution follows from draws b ~ N(0, G).

    It is corrected by a parametric bootstrap. Each replicate is simulated from the fitted model
    with the noise of the sensors. It is then fitted again, with priors whose means are drawn about
    the fitted parameters, and its candidates are scored. The means are drawn because the true
    parameters of a model without the effect differ from the tabulated values as much as the priors
    permit. With unchanged priors, every replicate would repeat the prior deviations that a true
    cause produces.

    The correction is the ratio of the mean largest T of the replicates to the asymptotic mean
    (Bartlett's idea): a mean needs far fewer replicates than a tail. Each replicate is scored
    twice: after its fit, and by the linear model at the fitted parameters. The asymptotic
    distribution describes the second score, so the mean of the differences gives the correction.
    The differences are zero for a linear model, whatever the noise of the replicates.
    """
    threshold, maxima = family_threshold(scores, alpha, seed=seed)
    if replicates < 1 or not scores.tested:
        return Null(threshold, maxima, 1.0, 0, scores.tested)
    generator = np.random.default_rng(seed + 1)
    included = all_candidates(effects)
    settings = FitSettings(iterations=6)
    excess = []
    clean = [outputs for outputs, _, _ in fit.problem.predict(fit.point)]
    for i in range(replicates):
        if progress is not None:
            progress("null bootstrap", i, replicates)
        segmented_records = tuple(
            _noisy(segmented, outputs, linear, generator)
            for segmented, outputs, linear in zip(
                fit.problem.segmented_records, clean, fit.linears, strict=True
            )
        )
        problem = replace(
            fit.problem,
            model=_with_priors_about(fit, generator),
            segmented_records=segmented_records,
            store=None,
        )
        point = replace(fit.point, memo={})
        linear_fit = finish(problem, point, fit.level, fit.defect_sd)
        refitted = polish(problem, point, fit.level, settings)
        excess.append(_largest(refitted, included) - _largest(linear_fit, included))
    stretch = max(1.0, 1.0 + float(np.mean(excess)) / max(float(np.mean(maxima)), 1e-12))
    return Null(threshold * stretch, maxima, stretch, replicates, scores.tested)


def largest_statistic(
    found: Search,
    scores: Scores,
    limit: float,
    settings: FitSettings,
    *,
    confirm: bool,
    progress: Say | None = None,
) -> float:
    """Largest test statistic of all candidates.

    The statistic of a candidate is its score T. T is the predicted decrease of the sum of squares
    by the candidate. If the candidate was refitted, the statistic is the smaller of T and the
    actual decrease (the likelihood ratio) with the same continuity defects, which has the same null
    distribution. They differ if a derivative jumps at the fit: a hammer that is just caught has
    another slope to either side, and T predicts what no fit reaches.

    Parameters
    ----------
    found
        The search with its refitted sets.
    scores
        Scores at the fit of the model.
    limit
        Largest T that the model produces by chance; a larger one refutes it.
    confirm
        Whether candidates that were not refitted, and whose T refutes the model, are refitted now.

    Returns
    -------
    float
        The largest statistic [1].
    """
    statistic = scores.singles()
    fit = found.model_fit
    if not statistic.size:
        return 0.0
    alone = [c for c in found.sets if len(c.names) == 1 and c.fit.level == fit.level]
    # With continuity defects, an unfinished fit may be held back by its start states.
    ended = [c for c in alone if c.fit.converged or not fit.defect_sd.size]
    realized = {c.names[0]: fit.cost - c.fit.cost for c in ended}
    size = scores.one_step()
    while True:
        for i, t in enumerate(scores.candidates):
            statistic[i] = max(0.0, min(statistic[i], realized.get(t.name, np.inf)))
        i = int(np.argmax(statistic))
        t = scores.candidates[i]
        if not confirm or statistic[i] < limit or t.name in realized or current().over():
            return float(statistic[i])
        if progress is not None:
            progress(f"refine: {t.name}", len(realized), 0)
        way = quicker(settings)
        again = refit(fit, (t,), np.array([size[i] * t.effect.scale]), way)
        if again.level != fit.level:
            again = polish(again.problem, replace(again.point, memo={}), fit.level, way)
        if fit.defect_sd.size and not again.converged:
            return float(statistic[i])
        realized[t.name] = fit.cost - again.cost if np.isfinite(again.cost) else 0.0


def _largest(fit: Fit, candidates: tuple[Candidate, ...]) -> float:
    return float(np.max(score_fit(fit, candidates).singles(), initial=0.0))


def _with_priors_about(fit: Fit, generator: np.random.Generator) -> Model:
    """Copy of the model with prior means drawn about the fitted parameters."""
    model = fit.problem.model
    drawn = {}
    for i in fit.problem.free:
        p = model.parameters[i]
        if np.isfinite(p.sd):
            value = fit.point.theta[i] + p.sd * generator.standard_normal()
            drawn[p.name] = replace(p, value=float(np.clip(value, p.lower, p.upper)))
    return model.with_parameters(drawn)


def _noisy(
    segmented: SegmentedRecord, outputs: Array, linear: Linear, generator: np.random.Generator
) -> SegmentedRecord:
    """A simulated segmented record: the model with noise of its outputs and inputs."""
    drawn = generator.standard_normal(segmented.measured.shape)
    if linear.by_input.shape[2]:
        push = generator.standard_normal((segmented.count, linear.by_input.shape[2]))
        drawn += np.einsum("wmi,wi->wm", linear.by_input, push).reshape(drawn.shape)
    innovation = np.divide(
        drawn,
        segmented.weight,
        out=np.zeros_like(segmented.measured),
        where=segmented.weight > 0.0,
    )
    noise = innovation.copy()
    for j in range(1, noise.shape[1] if segmented.decay.any() else 0):
        for k in range(min(j, segmented.before.shape[3])):
            at = np.maximum(segmented.before[:, j : j + 1, :, k], 0)
            previous = np.take_along_axis(noise, at, axis=1)[:, 0]
            noise[:, j] += segmented.decay[:, j, :, k] * previous
    return replace(segmented, measured=np.where(segmented.valid, outputs + noise, np.nan))
