"""Search for the set of effects that explains the records: screen, refit, add, drop, swap."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Batch, Candidate, Effect, Jobs, Model
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import SAME, Fit, FitSettings, finish, model_with_variability, polish
from feltmb.fit.starts import from_other_starts
from feltmb.fit.watch import Say, current
from feltmb.gap.criteria import FAINT_SCORE, NEAR_BEST, RIVAL
from feltmb.gap.evidence import full_evidence
from feltmb.gap.refine import (
    CandidateSet,
    annealed,
    freed,
    from_priors,
    quicker,
    refit,
    refit_at,
    short_of,
    tempered,
    tighten,
    worth_of,
)
from feltmb.gap.score import Scores, all_candidates, score_fit, screen_sets
from feltmb.gap.shape import between, movable, off_grid

__all__ = ["Search", "at_its_variability", "in_refined_steps", "search", "with_larger_noise"]


#: Tolerance of the sum of squares by which a set may exceed a set that it contains; half of it is
#: log evidence.
NESTED = 1.0
#: Number of times that a search may start again from a better fit of the model.
RESEEDS = 3
#: Note of a model that is best with the tightest defects, although tightening had left that fit.
CLOSED = "continuity defects closed again"


@dataclass(frozen=True, eq=False)
class Search:
    """Result of the search over sets of effects."""

    model_fit: Fit
    scores: Scores
    """Scores at the continuity defects of the model fit."""
    tight: Scores | None
    """Scores at the tightest continuity defects; None if the model fit already has them."""
    tight_fit: Fit | None
    sets: tuple[CandidateSet, ...]
    """Refitted sets, sorted by evidence, best first."""
    model_evidence: float
    failed: tuple[tuple[str, str], ...]
    total: float
    """Sum of the prior weights of all tested effects."""
    limited: Fit | None = None
    """The model fitted within the tolerance that the best set exceeds; None if it exceeds none."""
    skipped: tuple[str, ...] = ()
    """Effects of sets that were not refitted because the search was stopped."""

    @property
    def bare(self) -> Fit:
        """The best fit of the model without effects."""
        return self.limited or self.model_fit

    @property
    def tightest(self) -> Fit:
        """The fit of the model with the tightest continuity defects that it has."""
        return self.tight_fit or self.model_fit

    @property
    def tight_evidence(self) -> float:
        """Log evidence of the model with the tightest continuity defects."""
        if self.tight_fit is None:
            return self.model_evidence
        value = full_evidence(self.tight_fit, 1.0)
        return value if np.isfinite(value) else -np.inf

    @property
    def best(self) -> CandidateSet | None:
        """Best refitted set that is better than the model; None: there is none."""
        if self.sets and self.sets[0].evidence > self.model_evidence:
            return self.sets[0]
        return None


def search(
    model: Fit,
    effects: Sequence[Effect],
    settings: FitSettings,
    *,
    most: int = 4,
    width: int = 4,
    progress: Say | None = None,
    led: Sequence[Fit] = (),
) -> Search:
    """Screen the candidates, refit the best ones, then add, drop and swap until nothing helps.

    ``most``: largest number of effects in a set. ``width``: number of ranked sets, and of ranked
    single effects, that are refitted. ``led``: fits of :func:`~feltmb.gap.lead.lead`. The search
    starts again, at most ``RESEEDS`` times, if a set leads the model out of a wrong local minimum.
    """
    reseeds = RESEEDS
    while True:
        better: Fit | None = tighten(model, settings)
        if better is not None:
            better = from_other_starts(better, settings)
        hunt = _Hunt(model, better, effects, settings, most, width, progress)
        for fit in led:
            if fit.included:
                # Converged as well as the sets that it is compared with.
                way = replace(hunt.quick, worth=hunt._worth())
                hunt._keep(refit_at(fit.problem, fit.point, fit.level, way))
        if better is not None and reseeds and better.log_evidence > model.log_evidence + 1.0:
            # Tightening had left the local minimum that has the tightest defects.
            notes = (*model.notes, CLOSED)
            better = replace(better, notes=notes)
        else:
            better = hunt.run(may_restart=reseeds > 0)
        if better is None:
            return hunt.found()
        model, reseeds = better, reseeds - 1


def in_refined_steps(
    found: Search, settings: FitSettings, *, progress: Say | None = None
) -> Search:
    """The search with its best sets fitted again, if they need a smaller step of the integrator.

    A step that is small enough for the model may be too large for an effect, for example dry
    friction. The search would attribute its error to one more cause.
    """
    while found.best is not None and not current().stopping():
        coarse = found.best.fit.problem.model
        model = coarse.refined(_jobs(found.best.fit, settings))
        if model is coarse:
            break
        # Smaller steps change the fitted shapes, which may need smaller steps again.
        found = _again(found, _with_model(model), settings, "refined steps", progress)
    return found


def at_its_variability(
    found: Search, settings: FitSettings, *, progress: Say | None = None
) -> Search:
    """The search with the run-to-run variability at the parameters of its fits.

    These are the parameters of the model alone, if it explains the records, else of the best set.
    """
    best = found.best
    alone = found.model_fit.explains
    fit = found.model_fit if alone or best is None else best.fit
    if not fit.explains or current().stopping():
        return found
    model = model_with_variability(fit)
    if model is fit.problem.model:
        return found
    what = "run-to-run variability"
    return _again(found, _with_model(model), settings, what, progress, rescore=alone)


def with_larger_noise(
    found: Search,
    segmented_records: tuple[SegmentedRecord, ...],
    settings: FitSettings,
    *,
    progress: Say | None = None,
) -> Search:
    """The search with its best sets fitted again to records with somewhat larger noise.

    The larger noise leaves nothing to explain. So no other set can be needed, but a smaller one may
    be enough.
    """

    def other(problem: Problem) -> Problem:
        return replace(problem, segmented_records=segmented_records)

    return _again(found, other, settings, "larger noise", progress, rescore=True)


def _with_model(model: Model) -> Callable[[Problem], Problem]:
    return lambda problem: replace(problem, model=model)


def _again(
    found: Search,
    other: Callable[[Problem], Problem],
    settings: FitSettings,
    what: str,
    progress: Say | None,
    *,
    rescore: bool = False,
) -> Search:
    """The search with its best sets fitted again to another problem."""
    effects = list({t.effect.name: t.effect for t in found.scores.candidates}.values())

    def again(fit: Fit, way: FitSettings) -> Fit:
        problem = other(fit.problem)
        new = polish(problem, replace(fit.point, memo={}), fit.level, way)
        return replace(new, notes=fit.notes)

    best, way, quick = found.best, settings, quicker(settings)
    ready: dict[tuple[str, ...], Fit] = {}
    if best is not None and not found.model_fit.explains:
        ready[best.key] = again(best.fit, quick)
        way = replace(settings, worth=worth_of(ready[best.key]))
    tight = None if found.tight_fit is None else again(found.tight_fit, way)
    hunt = _Hunt(again(found.model_fit, way), tight, effects, settings, 0, 0, progress)
    hunt.scores, hunt.tight = found.scores, found.tight
    if rescore:
        hunt.scores = score_fit(hunt.model_fit, hunt.candidates)
        hunt.tight = None if tight is None else score_fit(tight, hunt.candidates)
    hunt.start = full_evidence(hunt.model_fit, hunt.total)
    hunt.failed.update(found.failed)
    hunt.skipped.update(dict.fromkeys(found.skipped))

    def moved(c: CandidateSet) -> CandidateSet:
        problem = other(c.fit.problem)
        if not rescore:
            return CandidateSet(c.fit.in_problem(problem), c.evidence)
        fit = finish(problem, replace(c.fit.point, memo={}), c.fit.level, c.fit.defect_sd)
        return CandidateSet(fit, full_evidence(fit, hunt.total))

    # Larger sets may only compensate the error of large steps; they are built again from the best
    # set.
    for c in found.sets:
        small = len(c.names) <= len(found.sets[0].names)
        if small and c.evidence > found.sets[0].evidence - NEAR_BEST:
            hunt._tell(f"{what}: " + " + ".join(c.names))
            fit = ready.get(c.key) or again(c.fit, quick)
            hunt.done[c.key] = CandidateSet(fit, full_evidence(fit, hunt.total))
        elif len(c.names) == 1:
            hunt.done[c.key] = moved(c)
    if hunt.done:
        hunt._shrink()
        hunt._shape(hunt._best())
        hunt._vary(hunt._best())
        hunt._finish()
        hunt._exchange()
        hunt._nest()
    return hunt.found()


def _jobs(fit: Fit, settings: FitSettings) -> list[Batch]:
    """Simulations that correspond to a fit; whole records if the continuity defects are closed.

    In a whole record, the error of the steps accumulates over the segments.
    """
    included, magnitudes = fit.machine_effects
    places = list(zip(fit.problem.segmented_records, fit.point.places, strict=True))
    model = fit.problem.model

    def jobs(segments: NDArray[np.intp], starts: Array) -> Jobs:
        return Jobs.at_point(fit.point.theta, segments, starts, included, magnitudes)

    if fit.level <= settings.levels[-1] and not model.chaotic:
        whole = [
            (s.record, jobs(s.segments[[0, -1], [0, 1]][None, :], place.starts[:1]))
            for s, place in places
        ]
        if all(np.isfinite(run.ends).all() for run in model.simulate_all(whole)):
            return whole
    return [(s.record, jobs(s.segments, place.starts)) for s, place in places]


class _Hunt:
    """One search that starts from one fit of the model."""

    def __init__(
        self,
        model: Fit,
        tight: Fit | None,
        effects: Sequence[Effect],
        settings: FitSettings,
        most: int,
        width: int,
        progress: Say | None,
    ) -> None:
        self.model_fit, self.tight_fit = model, tight
        self.settings, self.most, self.width, self.progress = settings, most, width, progress
        self.quick = quicker(settings)
        self.effects = effects
        self.total = sum(e.weight for e in effects)
        self.candidates = all_candidates(effects)
        self.done: dict[tuple[str, ...], CandidateSet] = {}
        self.failed: dict[str, str] = {}
        self.skipped: dict[str, None] = {}
        self.tried: set[tuple[tuple[str, str], ...]] = set()
        # Fits whose shapes were examined, by set.
        self.shaped: dict[tuple[str, ...], Fit] = {}
        self.explained = False
        self.near: Fit | None = None
        self.annealed: set[str] = set()
        self.led_from: list[Fit] = []
        self.linearized: tuple[Fit, list[Linear]] | None = None

    def run(self, *, may_restart: bool) -> Fit | None:
        """Run the search; return a better fit of the model if the search found one."""
        self._tell("score")
        self.start = full_evidence(self.model_fit, self.total)
        every = dict.fromkeys(e.name for e in self.effects)
        if not self._scored():
            self.skipped.update(every)
            return None
        fits = [self.model_fit] + ([] if self.tight_fit is None else [self.tight_fit])
        self.explained = all(f.explains for f in fits)
        self.near = self._nearby()
        # ``near`` was fitted in ``lead``, and the model was fitted from there already.
        may_restart = may_restart and self.near is None
        if current().stopping() and not self.done:
            self.skipped.update(every)
            return None
        self._screen()
        if current().stopping():
            return None
        first = len(self.done)
        if may_restart and (better := self._stuck()) is not None:
            return better
        self._climb()
        self._finish()
        self._exchange()
        self._nest()
        if may_restart and len(self.done) > first:
            return self._stuck()
        return None

    def _stuck(self) -> Fit | None:
        """A better fit of the model for a new search; a slightly better one is taken over here.

        Scores at a fit without continuity defects hardly change if it gains less than ``RIVAL``.
        """
        better = self._freed()
        if better is None or better.defect_sd.size:
            return better
        if better.log_evidence > self.model_fit.log_evidence + RIVAL:
            return better
        self.model_fit = better
        self.start = full_evidence(better, self.total)
        return None

    def found(self) -> Search:
        """Result of the search."""
        ordered = tuple(sorted(self.done.values(), key=lambda c: (-c.evidence, c.key)))
        return Search(
            self.model_fit,
            self.scores,
            self.tight,
            self.tight_fit,
            ordered,
            self.start,
            tuple(self.failed.items()),
            self.total,
            skipped=tuple(self.skipped),
        )

    def _tell(self, what: str) -> None:
        if self.progress is not None:
            self.progress(what, len(self.done), 0)

    def _best(self) -> CandidateSet:
        return max(self.done.values(), key=lambda c: c.evidence)

    def _keep(self, fit: Fit) -> CandidateSet:
        """Store a fit unless its set has a better one."""
        current().fitted(fit.chi2 / fit.dof)
        found = CandidateSet(fit, full_evidence(fit, self.total))
        known = self.done.get(found.key)
        if known is None or found.evidence > known.evidence:
            self.done[found.key] = found
        return found

    def _scored(self) -> bool:
        """Score the candidates; False: a stop left time only for those of fitted sets."""

        def score(candidates: tuple[Candidate, ...]) -> None:
            self.scores = score_fit(self.model_fit, candidates)
            self.tight = None if self.tight_fit is None else score_fit(self.tight_fit, candidates)

        scored: bool = False
        with current().finishing():
            score(self.candidates)
            scored = True
        if not scored:
            fitted = {name for c in self.done.values() for name in c.names}
            score(tuple(t for t in self.candidates if t.effect.name in fitted))
        return scored

    def _attempt(self, base: Fit, chosen: tuple[Candidate, ...], magnitudes: Array) -> None:
        """Refit a set, starting from a similar fit."""
        if current().stopping():
            self.skipped.update((t.name, None) for t in chosen)
            return
        self._tell("refine: " + " + ".join(t.name for t in chosen))
        fit = refit(base, chosen, magnitudes, replace(self.quick, worth=self._worth()))
        if len(chosen) == 1:
            fit = from_priors(fit, self.quick)
        if np.isfinite(fit.cost):
            self._keep(fit)
        else:
            self.failed[" + ".join(_key(chosen))] = "could not be simulated"

    def _worth(self) -> float:
        """Sum of squares above which a fit cannot be a rival of the best set."""
        return worth_of(self._best().fit if self.done else None)

    def _screen(self) -> None:
        """Refit the sets and the single effects with the largest linear evidence."""
        near, scores = self.model_fit, self.scores
        if self.near is not None:
            near, scores = self.near, score_fit(self.near, self.candidates)
        elif not near.defect_sd.size:
            self._anneal()
        if self.explained and not near.defect_sd.size:
            # The scores of a model that explains the records are valid except at jumps of its
            # derivatives. Sets of effects whose own fits contradict their scores are not fitted.
            self._singles(near, scores)
            left = [e for e in self.effects if not self._contradicted(e, scores)]
            self._extend(near, scores.among(left), self.width)
            return
        self._extend(near, scores, self.width)
        if self.tight is not None and self.tight_fit is not None:
            base = replace(self.tight_fit, level=self.model_fit.level)
            self._extend(base, self.tight, self.width)
        for at in (scores, self.tight):
            if at is not None:
                self._singles(near, at)

    def _anneal(self) -> None:
        """Fit the best single effects of a tempered fit that the scores at the model fit hide."""
        if current().stopping():
            return
        self._tell("tempered fit")
        base = tempered(self.model_fit, self.quick)
        if base is None:
            return
        at = score_fit(base, self.candidates)
        single, size, promised = at.singles(), at.one_step(), at.evidence()
        # An annealed fit costs three refits: it must promise a gain.
        hidden = promised > np.maximum(0.0, self.scores.evidence() + 2.0 * SAME)
        for i in np.argsort(-single, kind="stable"):
            t = at.candidates[i]
            if not hidden[i] or t.name in self.annealed or promised[i] < self._far_below(base):
                continue
            if current().stopping():
                self.skipped[t.name] = None
                return
            self._tell(f"refine: {t.name}")
            current().expect(self.width)  # as many sets follow
            self.annealed.add(t.name)
            way = replace(self.quick, worth=min(self._worth(), self.model_fit.cost))
            fit = annealed(base, (t,), np.array([size[i] * t.effect.scale]), way)
            gain = self.model_fit.cost - fit.cost
            if gain > 0.0:
                self._keep(fit)
            elif current().stopping():  # unfinished, so that it is not compared with other sets
                self.skipped[t.name] = None
            # Far from the fit, the linear model may be wrong: its other promises are not pursued.
            if short_of(single[i], gain) or len(self.annealed) == self.width:
                return

    def _singles(self, near: Fit, at: Scores) -> None:
        """Refit the best single effects, so that similar effects are compared equally."""
        single, size = at.singles(), at.one_step()
        least = self._least(near, at)
        promised = {t.name: -np.inf for t in at.candidates}
        for s in screen_sets(at, largest=1):
            name = at.candidates[s.index[0]].name
            promised[name] = max(promised[name], s.evidence)
        names: list[str] = []
        for i in np.argsort(-single, kind="stable"):
            t = at.candidates[i]
            if t.name in names or single[i] <= FAINT_SCORE or promised[t.name] < least:
                continue
            names.append(t.name)
            # An annealed fit that reaches less than is promised here is in another local minimum.
            again = t.name in self.annealed and self._contradicted(t.effect, at)
            if again or (t.name,) not in self.done:
                self.tried.add(_mark((t,)))
                current().expect(1 + self.width - len(names))
                self._attempt(near, (t,), np.array([size[i] * t.effect.scale]))
            if len(names) >= self.width:
                break

    def _contradicted(self, effect: Effect, at: Scores) -> bool:
        """Whether the fit of an effect alone reaches less than half of the gain of its score."""
        known = self.done.get((effect.name,))
        if known is None:
            return False
        scores = zip(at.candidates, at.singles(), strict=True)
        promised = max(value for t, value in scores if t.name == effect.name)
        return short_of(promised, self.model_fit.cost - known.fit.cost)

    def _nearby(self) -> Fit | None:
        """The model with the parameters of a set that explains the records, if the model does not.

        Scores at a poor fit of the model say little about the cause.
        """
        if self.explained or not self.done or not self._best().fit.plausible:
            return None
        best, base = self._best().fit, self.model_fit
        bare = best.problem.carry(best.point, (), np.zeros(0))
        return finish(base.problem, bare, best.level, best.defect_sd[: len(base.defect_sd)])

    def _least(self, base: Fit, at: Scores) -> float:
        """Linear evidence below which an addition to a fit is not refitted."""
        if base is self.near:  # a set explains the records: refit only its rivals
            return max((s.evidence for s in screen_sets(at, largest=1)), default=0.0) - NEAR_BEST
        if self.explained:
            return max(-RIVAL, self._far_below(base))
        return -RIVAL if base.included and base.plausible else -np.inf

    def _far_below(self, base: Fit) -> float:
        """Gain over a base below which a set cannot be an alternative to the best one.

        As ``worth_of``, this does not limit fits with continuity defects.
        """
        if base.defect_sd.size or not self.done:
            return -np.inf
        own = full_evidence(base, self.total) if base.included else self.start
        return self._best().evidence - own - NEAR_BEST

    def _extend(self, base: Fit, at: Scores, count: int) -> None:
        """Refit a base with the additions that have the largest linear evidence."""
        new = [c for c in self._survivors(base, at, count) if _mark(c[0]) not in self.tried]
        for k, (chosen, magnitudes) in enumerate(new):
            self.tried.add(_mark(chosen))
            current().expect(len(new) - k)
            self._attempt(base, chosen, magnitudes)

    def _survivors(
        self, base: Fit, at: Scores, count: int
    ) -> list[tuple[tuple[Candidate, ...], Array]]:
        """Additions to a base with the largest linear evidence, as sets with magnitudes."""
        out = []
        have = {t.name for t in base.included}
        seen: set[tuple[str, ...]] = set()
        least = self._least(base, at)
        # Additions to a set that explains the records are searched at the fit of that set, not
        # here.
        whole = set(self._best().names) if base is self.near else None
        # Linear scores are valid here for sets that are not larger than that set.
        most = self.most - len(base.included) if whole is None else len(whole)
        for s in screen_sets(at, largest=max(1, min(3, most))):
            if s.evidence < least:
                break
            new = tuple(at.candidates[i] for i in s.index)
            key = _key(new)
            if key in seen or any(n in have for n in key):
                continue
            if whole is not None and whole <= set(key):
                continue
            seen.add(key)
            magnitudes = np.array(s.magnitudes) * np.array([t.effect.scale for t in new])
            out.append(
                ((*base.included, *new), np.concatenate([base.point.magnitudes, magnitudes]))
            )
            if len(out) >= count:
                break
        return out

    def _freed(self) -> Fit | None:
        """The model started from the best sets, if that gives a better fit."""
        best = sorted(self.done.values(), key=lambda c: -c.evidence)[:2]
        fits = [c.fit for c in best if c.evidence > self.start]
        fits = [fit for fit in fits if not any(fit is other for other in self.led_from)]
        self.led_from += fits
        return freed(self.model_fit, fits, self.quick)

    def _climb(self) -> None:
        """Fit shapes, add, drop and swap effects until nothing helps."""
        alone = sorted(
            (c for c in self.done.values() if len(c.names) == 1), key=lambda c: -c.evidence
        )
        for c in alone[:2]:
            if c.evidence > self.start:
                self._shape(c)
        for _ in range(2 * self.most):
            if current().stopping() or not self.done or self._best().evidence < self.start:
                break
            self._shape(self._best())
            best = self._best()
            before = best.evidence
            left, linears = self._left(best)
            if left and len(best.names) < self.most:
                self._extend(best.fit, score_fit(best.fit, left, linears=linears), 3)
                best = self._best()
            if best.evidence <= before + SAME:
                self._vary(best)
                if self._best().evidence <= best.evidence:
                    break

    def _left(self, best: CandidateSet) -> tuple[tuple[Candidate, ...], list[Linear] | None]:
        """Candidates that are not in a set, and the linearization of its fit with them."""
        left = tuple(t for t in self.candidates if t.name not in best.names)
        if not left:
            return (), None
        if self.linearized is None or self.linearized[0] is not best.fit:
            self.linearized = (best.fit, best.fit.problem.linear(best.fit.point, left))
        return left, self.linearized[1]

    def _vary(self, best: CandidateSet) -> None:
        """Refit the best set without each of its effects, and with another effect in its place.

        Scores at a poor fit of the model may have missed such an effect. Each exchange is therefore
        predicted by the linear model of the best fit, relative to the effect that is removed.
        """
        left, linears = self._left(best) if self.width else ((), None)
        for k, candidate in enumerate(best.fit.included):
            rest = tuple(t for t in best.fit.included if t is not candidate)
            others = np.delete(best.fit.point.magnitudes, k)
            if rest and _short(self.done.get(_key(rest)), best, k):
                current().expect(len(best.fit.included) - k)
                self._attempt(best.fit, rest, others)
            if not left:
                continue
            at = score_fit(best.fit, left, without=k, linears=linears)
            size, gain = at.one_step(), at.evidence()
            tried: set[str] = set()
            for i in 1 + np.argsort(-gain[1:], kind="stable"):
                new = at.candidates[i]
                if gain[i] < gain[0] - NEAR_BEST or len(tried) == self.width:
                    break
                if new.name in tried or size[i] == 0.0:
                    continue
                tried.add(new.name)
                known = self.done.get(_key((*rest, new)))
                if known is None or not _holds(known, rest):
                    magnitude = size[i] * new.effect.scale
                    current().expect(1)
                    self._attempt(best.fit, (*rest, new), np.append(others, magnitude))

    def _shrink(self) -> None:
        """Remove effects from the best set as long as that helps."""
        while True:
            best = self._best()
            for k in range(len(best.fit.included) if len(best.fit.included) > 1 else 0):
                rest = tuple(t for i, t in enumerate(best.fit.included) if i != k)
                self._attempt(best.fit, rest, np.delete(best.fit.point.magnitudes, k))
            if self._best() is best:
                return

    def _shape(self, c: CandidateSet) -> None:
        """Fit the shapes of a set, if the values of the lists may be too coarse."""
        if self.shaped.get(c.key) is c.fit or not any(movable(t.effect) for t in c.fit.included):
            return
        if current().stopping():
            return
        self.shaped[c.key] = c.fit
        tightest = self.settings.levels[-1]
        loose = not c.fit.explains or (c.fit.defect_sd.size and c.fit.level > tightest)
        if not loose and not off_grid(c.fit):
            return
        self._tell("shapes: " + " + ".join(c.names))
        brief = replace(self.quick, iterations=6)

        def make(near: Fit, new: tuple[Candidate, ...]) -> Fit:
            point = near.problem.carry(near.point, new, near.point.magnitudes)
            return polish(near.problem.with_candidates(new), point, near.level, brief)

        fit = between(c.fit, make, lambda f: full_evidence(f, self.total))
        again = self._keep(refit_at(fit.problem, fit.point, fit.level, self.quick))
        # Smaller continuity defects determine the shape better.
        if again.evidence > c.evidence and again.fit.level < c.fit.level:
            self._shape(again)
        else:
            self.shaped[c.key] = self.done[c.key].fit

    def _finish(self) -> None:
        """Check whether the best set is in a local minimum."""
        if not self.done or current().stopping():
            return
        fit = self._best().fit
        if not fit.explains:
            fit = polish(fit.problem, fit.point, fit.level, replace(self.settings, chain=True))
        fit = refit_at(fit.problem, fit.point, fit.level, self.settings, patient=True)
        fit = from_priors(fit, self.quick)
        better = from_other_starts(fit, self.quick)
        self._keep(better)
        if better is fit:
            return
        # The other sets get the start states that were found.
        others = sorted(self.done.values(), key=lambda c: -c.evidence)
        for c in [c for c in others if c.key != _key(fit.included)][: self.width]:
            start = fit.problem.carry(better.point, c.fit.included, c.fit.point.magnitudes)
            start = replace(start, theta=c.fit.point.theta, memo={})
            self._keep(polish(c.fit.problem, start, c.fit.level, self.quick))

    def _exchange(self) -> None:
        """Refit rivals of the best set that are worse than the linear model of its fit predicts.

        The best set was fitted with the most care. A difference to a set with nearly the same
        signal may otherwise be that of the fits.
        """
        best: CandidateSet | None = None
        seen: set[tuple[tuple[str, ...], tuple[str, ...]]] = set()
        left: list[tuple[float, tuple[Candidate, ...], Array]] = []
        while self.done and self._best().evidence > self.start and not current().stopping():
            if self._best() is not best:
                best = self._best()
                left = sorted(self._behind(best), key=lambda b: b[0])
            left = [b for b in left if (best.key, _key(b[1])) not in seen]
            if not left:
                return
            _, chosen, magnitudes = left.pop()
            seen.add((best.key, _key(chosen)))
            current().expect(1 + len(left))
            self._tell("exchange: " + " + ".join(t.name for t in chosen))
            start = best.fit.problem.carry(best.fit.point, chosen, magnitudes)
            problem, level = best.fit.problem.with_candidates(chosen), best.fit.level
            way = replace(self.settings, worth=self._worth())
            self._keep(refit_at(problem, replace(start, memo={}), level, way, patient=True))

    def _behind(self, best: CandidateSet) -> Iterator[tuple[float, tuple[Candidate, ...], Array]]:
        """Rivals with one other effect than the best set that are below their predicted evidence.

        With the difference, the set, and its predicted magnitudes.
        """
        for k, old in enumerate(best.fit.included):
            rest = tuple(t for t in best.fit.included if t is not old)
            others = np.delete(best.fit.point.magnitudes, k)
            keys = {_key((*rest, t)): t.name for t in self.candidates if t.name not in best.names}
            known = [self.done[key] for key in keys if key in self.done]
            new = [next(t for t in c.fit.included if t.name == keys[c.key]) for c in known]
            if not new:
                continue
            at = score_fit(best.fit, tuple(new), without=k)
            gain = at.evidence()
            promised = best.evidence + gain - gain[0]
            for c, t, value, size in zip(known, new, promised[1:], at.one_step()[1:], strict=True):
                if value > best.evidence - RIVAL and c.evidence < value - SAME:
                    magnitudes = np.append(others, size * t.effect.scale)
                    yield value - c.evidence, (*rest, t), magnitudes

    def _nest(self) -> None:
        """Refit every set whose sum of squares exceeds that of a set that it contains.

        An effect of magnitude zero must change nothing, so that a larger set can always be as good.
        The refit starts from the smaller set. If the larger set is still worse, it has an effect
        that is not the model at magnitude zero. The set is removed and reported.
        """
        for c in sorted(self.done.values(), key=lambda c: (len(c.names), c.key)):
            inner = min(self._held_by(c), key=lambda fit: fit.cost, default=None)
            if inner is None or c.fit.cost <= inner.cost + NESTED or current().stopping():
                continue
            self._tell("refine from within: " + " + ".join(c.names))
            size = dict(zip((t.name for t in inner.included), inner.point.magnitudes, strict=True))
            problem, included = c.fit.problem, c.fit.included
            start = inner.problem.carry(
                inner.point, included, np.array([size.get(t.name, 0.0) for t in included])
            )
            way = replace(self.quick, worth=self._worth())
            fit = polish(problem, replace(start, memo={}), c.fit.level, way)
            if fit.cost <= inner.cost + NESTED:
                self.done[c.key] = CandidateSet(fit, full_evidence(fit, self.total))
                continue
            del self.done[c.key]
            self.failed[" + ".join(c.names)] = (
                f"ends at {fit.cost:.6g}, above {inner.cost:.6g} of "
                f"{' + '.join(t.name for t in inner.included) or 'the model alone'}, which it "
                "contains: at magnitude zero it changes the model"
            )

    def _held_by(self, c: CandidateSet) -> list[Fit]:
        """Fits of the model and of sets that a set contains, with equal continuity defects."""
        own = {t.name: repr(t.shape) for t in c.fit.included}
        fits = [self.model_fit, *(other.fit for other in self.done.values())]
        return [
            fit
            for fit in fits
            if len(fit.included) < len(own)
            and np.array_equal(fit.defect_sd, c.fit.defect_sd[: fit.defect_sd.size])
            and fit.problem.segmented_records is c.fit.problem.segmented_records
            and all(own.get(t.name) == repr(t.shape) for t in fit.included)
        ]


def _key(included: Sequence[Candidate]) -> tuple[str, ...]:
    return tuple(sorted(t.name for t in included))


def _mark(included: Sequence[Candidate]) -> tuple[tuple[str, str], ...]:
    """Names and shapes of a set, sorted."""
    return tuple(sorted((t.name, repr(t.shape)) for t in included))


def _holds(c: CandidateSet, included: Sequence[Candidate]) -> bool:
    """Whether a set contains candidates with exactly these shapes."""
    shapes = {t.name: repr(t.shape) for t in c.fit.included}
    return all(shapes.get(t.name) == repr(t.shape) for t in included)


def _short(known: CandidateSet | None, best: CandidateSet, k: int) -> bool:
    """Whether the best set without its candidate k must still be fitted from the best set.

    This holds if there is no such fit yet. It also holds if the known fit is worse than the best
    fit predicts to first order: half the square of the magnitude over its standard deviation is
    lost. Such a fit is in another local minimum.
    """
    if known is None:
        return True
    size = best.fit.intervals()[k - len(best.fit.included)]
    loss = 0.5 * (size.value / size.sd) ** 2 if size.sd > 0.0 else np.inf
    return known.evidence < best.evidence - loss - 2.0 * SAME
