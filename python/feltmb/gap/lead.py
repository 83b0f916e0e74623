"""Start of a search if the model is far off: sets of effects are fitted to growing records.

If a mechanism releases a part earlier or later than the machine did, its motion is no longer nearly
linear in any parameter. A model that lacks a cause then converges to a point at which no score
indicates that cause. The search therefore follows time. The beginnings of the records are fitted
first. When the model no longer explains a longer beginning, the effects are scored with the fit of
the shorter one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.fit.model import Effect
from feltmb.fit.problem import Point, Problem
from feltmb.fit.solve import Fit, FitSettings, finish, fit_problem, polish
from feltmb.fit.watch import Say, current
from feltmb.gap.criteria import NEAR_BEST
from feltmb.gap.evidence import full_evidence
from feltmb.gap.refine import CandidateSet, taken_over, worth_of
from feltmb.gap.score import all_candidates, score_fit, screen_sets
from feltmb.gap.tolerance import by_few_numbers

__all__ = ["lead"]

#: Iterations of each set in each stage, and number of sets that enter the next stage.
ITERATIONS, WIDTH = 8, 3
#: Last stages as shares of the records, and the ratio of sum of squares to number of samples below
#: which a motion counts as near the records.
HORIZONS, NEAR = (0.5, 0.65, 0.8, 0.9), 4.0
#: Growth factor of the records up to the first of these stages, and the shortest share.
GROWTH, SHORTEST = 1.5, 0.1
NO_DEFECTS = np.zeros(0)

Key = tuple[str, ...]


def lead(
    problem: Problem,
    effects: Sequence[Effect],
    settings: FitSettings,
    *,
    most: int = 4,
    progress: Say | None = None,
) -> list[Fit]:
    """Fits to the whole records, largest evidence first; the fit of the model alone is included.

    Empty if the tabulated model is already near the records, if continuity defects keep its states
    near them, or if a parameter has no prior.
    """
    model, start = problem.model, problem.start()
    if model.states() or not problem.has_priors:
        return []
    tabulated = problem.cost_at(start, NO_DEFECTS, problem.linear(start))[0]
    if tabulated < NEAR * problem.samples:
        return []
    total = sum(e.weight for e in effects)
    begins: dict[Key, tuple[Problem, Point]] = {(): (problem, start)}
    alone, repeated = start, settings.restarts == 0
    stage = _Stage(problem, {}, effects, settings)
    shares = _shares(problem, start)
    for i, share in enumerate(shares):
        if progress is not None:
            progress("along the records", i, len(shares))
        stage = _Stage(_until(problem, share), begins, effects, settings)
        stage.widen(most)
        if not repeated and () in stage.found and not stage.best(1)[0].fit.plausible:
            # Nothing explains these beginnings: perhaps the model alone is in a local minimum.
            stage.repeat()
            repeated = True
        if () in stage.found:
            alone = stage.found[()].fit.point
        if current().stopping():
            return []
        begins = {c.key: (c.fit.problem, c.fit.point) for c in stage.best(WIDTH)}
    best = stage.best(1)[0].fit
    limited = replace(settings, worth=worth_of(best))
    if () not in stage.found:
        # Start the model alone from the best set, and from its own last fit.
        fits = [
            polish(problem, replace(p, memo={}), 1.0, limited) for p in (taken_over(best), alone)
        ]
        if min(f.cost for f in fits) > tabulated:  # both local minima are worse than no fit
            fits.append(polish(problem, replace(start, memo={}), 1.0, limited))
        stage.keep(max(fits, key=lambda f: f.log_evidence))
    elif stage.found[()].fit.cost > limited.worth:
        stage.keep(polish(problem, replace(taken_over(best), memo={}), 1.0, limited))
    out = [c.fit for c in stage.found.values()]
    return sorted(out, key=lambda f: -full_evidence(f, total))


def _until(problem: Problem, share: float) -> Problem:
    """The problem with only the first part of each record."""
    if share >= 1.0:
        return problem
    records = tuple(s.until(round(share * s.record.samples)) for s in problem.segmented_records)
    return replace(problem, segmented_records=records)


def _shares(problem: Problem, start: Point) -> list[float]:
    """Shares of the records for the stages. At the end of the first one, the motion is near."""
    shares = [*HORIZONS, 1.0]
    while shares[0] > SHORTEST:
        first = _until(problem, shares[0])
        point = replace(start, memo={})
        if first.cost_at(point, NO_DEFECTS, first.linear(point))[0] < NEAR * first.samples:
            break
        shares.insert(0, shares[0] / GROWTH)
    return shares


class _Stage:
    """Sets of effects that are fitted to the beginnings of the records."""

    def __init__(
        self,
        problem: Problem,
        begins: dict[Key, tuple[Problem, Point]],
        effects: Sequence[Effect],
        settings: FitSettings,
    ) -> None:
        self.problem, self.begins = problem, dict(begins)
        self.candidates = all_candidates(effects)
        self.total = sum(e.weight for e in effects)
        self.way = replace(settings.coarser(0.3, iterations=ITERATIONS), restarts=0)
        self.found: dict[Key, CandidateSet] = {}
        for base, point in begins.values():
            self._fit(self._here(base), point)

    def best(self, count: int) -> list[CandidateSet]:
        """The best sets whose evidence is near the largest one."""
        ranked = sorted(self.found.values(), key=lambda c: -np.nan_to_num(c.evidence, nan=-np.inf))
        near = (c for c in ranked[1:count] if c.evidence > ranked[0].evidence - NEAR_BEST)
        return [ranked[0], *near]

    def widen(self, most: int) -> None:
        """Add effects to the best set until it explains the records, or until no effect helps."""
        while True:
            (best,) = self.best(1)
            if best.fit.plausible or len(best.names) >= most or current().stopping():
                return
            if by_few_numbers(best.fit, most):  # the fit to the whole records decides
                return
            # Score at the fit to the shorter records, which were explained; the present fit may be
            # astray.
            problem, point = self.begins[best.key]
            base = self._here(problem)
            at = finish(base, replace(point, memo={}), 1.0, NO_DEFECTS)
            scores = score_fit(at, tuple(t for t in self.candidates if t.name not in best.names))
            tried: set[str] = set()
            for s in screen_sets(scores, largest=1):
                t = scores.candidates[s.index[0]]
                if s.evidence < 0.0 or len(tried) >= WIDTH:
                    break
                if t.name in tried:
                    continue
                tried.add(t.name)
                key = tuple(sorted((*best.names, t.name)))
                if key in self.found:
                    continue
                wider = base.with_candidates((*base.included, t))
                begin = base.carry(point, wider.included, np.append(point.magnitudes, 0.0))
                self.begins[key] = (wider, begin)
                self._fit(wider, begin)
            if self.best(1)[0] is best:
                return

    def repeat(self) -> None:
        """Fit the model alone also from its priors."""
        problem = self._here(self.begins[()][0])
        self.keep(fit_problem(problem, replace(self.way, restarts=1)))

    def keep(self, fit: Fit) -> None:
        """Store a fit unless its set has a better one."""
        value = full_evidence(fit, self.total)
        new = CandidateSet(fit, value if np.isfinite(value) else -np.inf)
        known = self.found.get(new.key)
        if known is None or new.evidence > known.evidence:
            self.found[new.key] = new

    def _here(self, problem: Problem) -> Problem:
        return self.problem.with_candidates(problem.included)

    def _fit(self, problem: Problem, point: Point) -> None:
        start = replace(point, memo={})
        if problem.included:
            worth = worth_of(self.best(1)[0].fit) if self.found else np.inf
            fit = polish(problem, start, 1.0, replace(self.way, worth=worth))
        else:  # the model alone gets the chance to follow the longer records step by step
            fit = fit_problem(problem, self.way, point=start)
        self.keep(fit)
