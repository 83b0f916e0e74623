"""Fit of the model and search for effects, with the noise that the records turn out to have.

The noise of the sensors may be correlated, or larger than given. What no tested effect explains
counts as noise too, so that effects must be better than it (:mod:`feltmb.gap.discrepancy`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.files import Store
from feltmb.fit.model import Effect, Model
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit, FitSettings, fit_problem, polish, with_variability
from feltmb.fit.starts import from_other_starts
from feltmb.fit.watch import FIT, SEARCH, Say, current
from feltmb.gap.checks import DataChecks
from feltmb.gap.criteria import COLOR_GAIN
from feltmb.gap.discrepancy import (
    color_of_discrepancy,
    converged,
    discrepancy_of,
    larger_than_noise,
    noise_factors,
    only_white,
    with_color,
    with_factor,
)
from feltmb.gap.evidence import full_evidence
from feltmb.gap.judged_data import JudgedData, with_other_noise
from feltmb.gap.lead import lead
from feltmb.gap.misfit import form_of, misfit
from feltmb.gap.options import Options
from feltmb.gap.refine import CandidateSet, refit_at, tighten, worth_of
from feltmb.gap.search import (
    Search,
    at_its_variability,
    in_refined_steps,
    search,
    with_larger_noise,
)
from feltmb.gap.tolerance import evidence_of_release, within_tolerance, without_several

__all__ = ["Investigation", "Task", "investigate"]

#: Number of times that the unexplained residual is estimated again.
ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Task:
    """What is searched, and how."""

    effects: Sequence[Effect]
    """Effects that the model can simulate."""
    options: Options
    settings: FitSettings
    store: Store | None
    """Store of finished optimizations."""
    progress: Say | None


@dataclass(frozen=True, eq=False)
class Investigation:
    """Searches, with the noise of the sensors alone and with the unexplained residual."""

    first: Search
    """Search with the noise of the sensors."""
    found: Search
    """Search with the unexplained residual as a part of the noise; without one, the first one."""
    sensed: JudgedData
    """Data with the noise of the sensors."""
    judged: JudgedData
    """Data with the noise of ``found``."""
    unexplained: bool = False
    """Whether an unexplained residual counts as noise."""

    @property
    def model(self) -> Model:
        """The model as it was fitted."""
        return self.found.model_fit.problem.model


def investigate(model: Model, data: JudgedData, task: Task) -> Investigation:
    """Search for effects, with the noise of the sensors and with what no effect explains."""
    watch = current()
    first = _search(model, data.fitted, task)
    model = first.model_fit.problem.model
    color = None
    if not (data.checks.estimated or watch.stopping()):
        color = _recolored(first, data.fitted, task)
    if color is not None:
        data = data.colored(model, color)
        first = _search(model, data.fitted, task)
        model = first.model_fit.problem.model
    factor = None if watch.stopping() else _rescaled(first, data, task.options.alpha)
    if factor is not None:
        data = data.noisier(model, factor)
        first = with_larger_noise(first, data.fitted, task.settings, progress=task.progress)
        if first.model_fit.problem.model.variability_is_tabulated:  # no fit explained the records
            first = at_its_variability(first, task.settings, progress=task.progress)
        first = _completed(first, task)
    return _with_discrepancy(Investigation(first, first, data, data), task)


def _with_discrepancy(start: Investigation, task: Task) -> Investigation:
    """The investigation with the residual that no effect explains as a part of the noise.

    Effects must then be better than this residual, which shrinks with every effect that is found.
    """
    watch, now, noise = current(), start, None
    for _ in range(ROUNDS):
        new = None
        if not watch.stopping():
            new = discrepancy_of(now.found, start.sensed.fitted, task.settings, task.options.alpha)
        if new is None or (noise is not None and converged(noise, new)):
            break
        noise = new
        judged = start.sensed.with_residual(now.model, new)
        found = _search(now.model, judged.fitted, task, now.found)
        if watch.stopping():  # the previous search is complete
            break
        now = replace(now, found=found, judged=judged, unexplained=True)
    if not now.unexplained or watch.stopping():
        return now
    clean = _explained(start.first, now.found, start.sensed.checks, task)
    return now if clean is None else replace(start, found=clean)


def _search(
    model: Model,
    segmented_records: tuple[SegmentedRecord, ...],
    task: Task,
    known: Search | None = None,
) -> Search:
    """Fit the model and search for effects, with the noise of the segmented records.

    ``known``: a search with much less noise. The fit starts from the fit of that search, and from
    the priors only if the first start does not explain the records. The new search starts with the
    best set of each size of that search.
    """
    settings, progress = task.settings, task.progress
    problem, label = Problem(model, segmented_records, store=task.store), "the model alone"
    watch = current()
    watch.misfit = None  # the noise has changed, and so has the scale
    watch.enter(FIT)
    if known is None:
        fit = fit_problem(problem, settings, progress=progress, label=label)
        led: list[Fit] = []
        if not fit.plausible and not watch.stopping():
            most = task.options.max_effects
            led = lead(problem, task.effects, settings, most=most, progress=progress)
            for alone in (f for f in led if not f.included):
                way = replace(settings, worth=worth_of(led[0]))
                again = polish(problem, replace(alone.point, memo={}), 1.0, way)
                fit = again if again.log_evidence > fit.log_evidence else fit
    else:
        led = _best_of_each_size(known, problem)
        point = replace(known.model_fit.point, memo={})
        brief = replace(settings, restarts=0)
        fit = fit_problem(problem, brief, point=point, progress=progress, label=label)
        if not fit.explains:
            other = fit_problem(problem, brief, progress=progress, label=label)
            fit = other if other.log_evidence > fit.log_evidence else fit
    found = _search_from(fit, led, task, known)
    if watch.stopping():
        return found
    fit = found.model_fit
    freed = without_several(fit, settings)
    best = found.model_evidence if found.best is None else found.best.evidence
    if freed is fit or watch.stopping() or not evidence_of_release(fit, freed) > best:
        return found
    # Several wrong values explain the records better than any set of effects.
    released = _search_from(freed, led, task, known)
    return found if watch.stopping() else released  # the first search is complete


def _search_from(fit: Fit, led: list[Fit], task: Task, known: Search | None) -> Search:
    """Search for effects from a fit of the model."""
    settings, progress, watch = task.settings, task.progress, current()
    if not watch.stopping():
        fit = from_other_starts(fit, settings)
    if known is None:
        near = led[0] if led and led[0].plausible and not fit.explains else None
        way = replace(settings, worth=worth_of(near))
        fit = with_variability(fit, way, near=near)
        led = [f.in_problem(replace(f.problem, model=fit.problem.model)) for f in led]
    watch.fitted(fit.chi2 / fit.dof)
    watch.enter(SEARCH)
    # Against noise that is stated too small, every set of effects seems to gain. The next search
    # has the larger noise.
    in_vain = False
    if known is None and not fit.explains:
        in_vain = only_white(larger_than_noise(fit, task.options.alpha))
    found = search(
        fit,
        task.effects,
        replace(settings, restarts=0),
        most=1 if in_vain else task.options.max_effects,
        width=task.options.width,
        progress=progress,
        led=led,
    )
    if watch.stopping():
        return found
    if known is None and fit.problem.model.variability_is_tabulated:
        # No fit explained the records before the search.
        found = at_its_variability(found, settings, progress=progress)
    return _completed(found, task)


def _completed(found: Search, task: Task) -> Search:
    """A search with the steps that its fits need, compared within the tolerances."""
    settings, progress = task.settings, task.progress
    return within_tolerance(in_refined_steps(found, settings, progress=progress), settings)


def _best_of_each_size(known: Search, problem: Problem) -> list[Fit]:
    """The best set of each size of a search that beats the model, as starts in another problem."""
    best: dict[int, Fit] = {}
    for c in known.sets:
        if c.evidence > known.model_evidence:
            best.setdefault(len(c.names), c.fit)
    return [fit.in_problem(problem.with_candidates(fit.included)) for fit in best.values()]


def _explained(first: Search, found: Search, checks: DataChecks, task: Task) -> Search | None:
    """The first search with the set found with an unexplained residual, if it explains the records.

    If the model is far from the records, linear scores may miss a cause that explains everything.
    """
    if found.best is None:
        return None
    settings = task.settings
    base, near = first.model_fit, found.best.fit
    problem = base.problem.with_candidates(near.included)
    fit = refit_at(problem, replace(near.point, memo={}), base.level, settings, patient=True)
    best = CandidateSet(fit, full_evidence(fit, sum(e.weight for e in task.effects)))
    if first.best is not None and not best.evidence > first.best.evidence:
        return None
    allowed = form_of(best.evidence - first.tight_evidence, task.options.form)
    tight = tighten(fit, settings)
    if misfit(
        fit, tight, alpha=task.options.alpha, estimated=checks.estimated, allowed=allowed
    ).left:
        return None
    others = tuple(c for c in first.sets if c.key != best.key)
    whole = replace(first, sets=(best, *others))
    whole = in_refined_steps(whole, settings, progress=task.progress)
    return within_tolerance(whole, settings)


def _recolored(
    first: Search, segmented_records: tuple[SegmentedRecord, ...], task: Task
) -> dict[str, float] | None:
    """Correlation times [s] of noise that would explain the residual; None: they do not.

    With this noise the model must explain the records. It must also be more likely than white noise
    with an unknown force or signal, and than the best set of effects.
    """
    fit, alpha = first.model_fit, task.options.alpha
    white = misfit(fit, first.tight_fit, alpha=alpha, estimated=False)
    color = color_of_discrepancy(first, segmented_records) if white.left else None
    if color is None:
        return None
    model = fit.problem.model
    colored = tuple(with_color(model, s, color) for s in segmented_records)
    again = fit_problem(Problem(model, colored, store=task.store), task.settings)
    tight = tighten(again, task.settings)
    if misfit(again, tight, alpha=alpha, estimated=False).left:
        return None
    plain = fit.log_evidence + (0.0 if fit.defect_sd.size else white.other)
    if first.best is not None:
        plain = max(plain, first.best.fit.log_evidence)
    gain = again.log_evidence + _log_weights(colored) - plain - _log_weights(segmented_records)
    return color if gain > COLOR_GAIN else None


def _rescaled(first: Search, data: JudgedData, alpha: float) -> dict[str, float] | None:
    """Factors of the noise by output, if the residual is only noise then; else None.

    See :func:`noise_factors`. A residual that exceeds this larger noise as well is not due to the
    given sigma. It is admitted as a discrepancy, whose noise does not depend on the given sigma.
    """
    best = first.best
    fit, tight = (first.model_fit, first.tight_fit) if best is None else (best.fit, None)
    if not misfit(fit, tight, alpha=alpha, estimated=data.checks.estimated).left:
        return None
    factor = noise_factors(first)
    if not factor:
        return None
    model = fit.problem.model
    noisier = tuple(with_factor(model, s, factor) for s in data.fitted)
    fit = with_other_noise(fit, noisier)
    tight = None if tight is None else with_other_noise(tight, noisier)
    left = misfit(fit, tight, alpha=alpha, estimated=data.checks.estimated).left
    return None if left else factor


def _log_weights(segmented_records: Sequence[SegmentedRecord]) -> float:
    """Contribution of the noise standard deviations to a log likelihood."""
    return sum(float(np.sum(np.log(s.weight[s.valid]))) for s in segmented_records)
