"""From scores to refitted sets: what the linear ranking promises is tried in full."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.nominal import Effect, Term
from feltmb.fit.problem import Point, Problem
from feltmb.fit.solve import Fit, FitSettings, at_level, chained, polish
from feltmb.gap.score import Scores, all_terms, prior_of, score_fit, screen_sets
from feltmb.gap.shape import between, movable, off_grid

__all__ = ["Candidate", "Search", "full_evidence", "refit", "search", "tighten"]

Progress = Callable[[str, int, int], None]

#: Share of the evidence gained so far below which a further effect ends the search: it would not be
#: told from an error in the form of a larger one.
SMALL = 0.02
#: Nats by which a fit may fall short of what a larger set foretells before it is made again.
SHORT = 1.0
#: Gaps, as a share of the spread of the states, that let parameters come back from their priors.
LOOSE = 0.1
#: Share of the best set's gain of evidence from which the shape of a single effect is fitted.
NEAR = 0.5
#: Correlation of traces from which an effect is tried in the place of another, and how many are.
ALIKE, SWAPS = 0.7, 3
#: Linear log evidence below which a set is not refitted where the nominal explains the records.
PROMISE = -3.0
#: Log evidence that tight gaps may cost before their fit is tried from another start.
DOUBT = 3.0
#: Note of a nominal that an effect led out of a wrong valley.
REFITTED = "fitted again from the fit with an effect"
#: Note of a nominal that does best with the tightest gaps, though the descent left them.
CLOSED = "gaps closed again"


def full_evidence(fit: Fit, total_weight: float) -> float:
    """Log evidence of a fit: states, parameters and sizes integrated out, prior of the set.

    The prior of a size is N(0, max(scale, size)^2).
    """
    matrix = fit.normal.matrix.copy()
    value = fit.log_evidence
    at = len(fit.problem.free)
    for k, term in enumerate(fit.terms):
        width = max(term.effect.scale, abs(float(fit.point.sizes[k])))
        matrix[at + k, at + k] += 1.0 / width**2
        value -= float(np.log(width)) + 0.5 * (float(fit.point.sizes[k]) / width) ** 2
        if term.effect.sign != 0:
            value += float(np.log(2.0))
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    eigen = np.linalg.eigvalsh(matrix / np.outer(size, size))
    log_det = float(np.sum(np.log(np.maximum(eigen, 1e-12)))) + 2.0 * float(np.sum(np.log(size)))
    # The priors of the parameters are the same for all fits to the same records.
    return value - 0.5 * log_det + prior_of(fit.terms, total_weight)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A refitted set."""

    fit: Fit
    evidence: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(t.name for t in self.fit.terms)

    @property
    def key(self) -> tuple[str, ...]:
        """Names in a fixed order."""
        return tuple(sorted(self.names))


def refit(base: Fit, terms: tuple[Term, ...], sizes: Array, settings: FitSettings) -> Fit:
    """Nonlinear fit with terms, warm-started; the gap level is made tighter while that helps."""
    problem = base.problem.with_terms(terms)
    return refit_at(problem, _reachable(problem, base, terms, sizes), base.level, settings)


def refit_at(
    problem: Problem, point: Point, level: float, settings: FitSettings, *, patient: bool = False
) -> Fit:
    """Fit from a good start; the gap level is made tighter while that helps.

    ``patient``: a tighter level is given all iterations before it is said not to help.
    """
    fit = polish(problem, point, level, settings)
    if not fit.gap_sd.size:
        return fit
    levels = list(settings.levels)
    at = min(range(len(levels)), key=lambda i: abs(np.log(levels[i] / level)))
    quick = replace(settings, iterations=min(settings.iterations, 4))
    for tighter in levels[at + 1 :]:
        trial = polish(problem, fit.point, tighter, quick)
        if patient and not trial.converged:
            trial = polish(problem, trial.point, tighter, settings)
        if trial.log_evidence < fit.log_evidence - 0.5:
            break
        fit = trial
    if fit.converged or fit.level == level:
        return fit
    return polish(problem, fit.point, fit.level, settings)


def _reachable(problem: Problem, base: Fit, terms: tuple[Term, ...], sizes: Array) -> Point:
    """The warm start; its new sizes are cut back where one linear step promised too much."""
    old = {t.name: s for t, s in zip(base.terms, base.point.sizes, strict=True)}
    kept = np.array([old.get(t.name, 0.0) for t in terms])
    gap_sd = base.level * problem.scale(base.problem.carry(base.point, terms, kept))
    plain = base.problem.carry(base.point, terms, kept)
    linears = problem.linear(plain)
    best, least = plain, problem.cost_at(plain, gap_sd, linears)[0]
    for share in (1.0, 0.3, 0.1):
        point = base.problem.carry(base.point, terms, kept + share * (sizes - kept))
        cost = problem.cost(point, gap_sd, linears)[0]
        if cost < 4.0 * least:
            return point
        if cost < least:
            best, least = point, cost
    return best


@dataclass(frozen=True, eq=False)
class Search:
    """What the search over sets found."""

    nominal: Fit
    scores: Scores
    """At the nominal's own gap level."""
    tight: Scores | None
    """At the tightest level, if that is another one."""
    tight_fit: Fit | None
    candidates: tuple[Candidate, ...]
    """Refitted sets, best evidence first."""
    nominal_evidence: float
    failed: tuple[tuple[str, str], ...]

    @property
    def best(self) -> Candidate | None:
        """Best refitted set that beats the nominal, if there is one."""
        if self.candidates and self.candidates[0].evidence > self.nominal_evidence:
            return self.candidates[0]
        return None


def search(
    nominal: Fit,
    effects: Sequence[Effect],
    settings: FitSettings,
    *,
    most: int = 4,
    width: int = 4,
    progress: Progress | None = None,
    reseeds: int = 3,
) -> Search:
    """Screen, refit the survivors, then add, drop and swap until nothing helps.

    ``reseeds``: times that the search may begin again because a set has led the nominal out of a
    wrong valley.
    """
    tight_fit = tighten(nominal, settings)
    if tight_fit is not None and reseeds and tight_fit.log_evidence > nominal.log_evidence + 1.0:
        # The descent of the gaps had left the valley in which they close.
        return search(
            replace(tight_fit, levels=nominal.levels, notes=(*nominal.notes, CLOSED)),
            effects,
            settings,
            most=most,
            width=width,
            progress=progress,
            reseeds=reseeds - 1,
        )
    total = sum(e.weight for e in effects)
    terms = all_terms(effects)
    # Sets are ranked by whole nats: a twentieth of one is near enough.
    quick = replace(settings, iterations=15, decrement=max(settings.decrement, 0.1))
    brief = replace(quick, iterations=6)
    done: dict[tuple[str, ...], Candidate] = {}
    failed: dict[str, str] = {}

    def attempt(base: Fit, chosen: tuple[Term, ...], sizes: Array) -> Candidate | None:
        if progress is not None:
            progress("refine: " + " + ".join(t.name for t in chosen), len(done), 0)
        fit = refit(base, chosen, sizes, quick)
        if len(chosen) == 1:
            fit = _from_priors(fit, quick)
        key = _key(chosen)
        if not np.isfinite(fit.cost):
            failed[" + ".join(key)] = "could not be simulated"
            return None
        candidate = Candidate(fit, full_evidence(fit, total))
        if key not in done or candidate.evidence > done[key].evidence:
            done[key] = candidate
        return candidate

    scores = score_fit(nominal, terms)
    tight = None if tight_fit is None else score_fit(tight_fit, terms)
    fits = (nominal, *([] if tight_fit is None else [tight_fit]))
    least = PROMISE if all(f.explains for f in fits) else -np.inf
    tried: set[tuple[tuple[str, str], ...]] = set()

    def survivors(base: Fit, at: Scores, count: int) -> list[tuple[tuple[Term, ...], Array]]:
        """Best sets by linear evidence, added to what the base holds."""
        out = []
        have = {t.name for t in base.terms}
        seen: set[tuple[str, ...]] = set()
        for s in screen_sets(at, largest=max(1, min(3, most - len(base.terms)))):
            if s.evidence < least:
                break
            new = tuple(at.terms[i] for i in s.index)
            key = _key(new)
            if key in seen or any(n in have for n in key):
                continue
            seen.add(key)
            sizes = np.array(s.sizes) * np.array([t.effect.scale for t in new])
            out.append(((*base.terms, *new), np.concatenate([base.point.sizes, sizes])))
            if len(out) >= count:
                break
        return out

    def run(base: Fit, at: Scores, count: int) -> None:
        for chosen, sizes in survivors(base, at, count):
            mark = tuple(sorted((t.name, repr(t.shape)) for t in chosen))
            if mark not in tried:
                tried.add(mark)
                attempt(base, chosen, sizes)

    run(nominal, scores, width)
    if tight is not None and tight_fit is not None:
        run(replace(tight_fit, level=nominal.level), tight, width)
    # The best singles are always among the refitted, so that a class is judged on equal terms.
    for at, base in ((scores, nominal), (tight, tight_fit)):
        if at is None or base is None:
            continue
        single, size = at.singles(), at.one_step()
        promised = {t.name: -np.inf for t in at.terms}
        for s in screen_sets(at, largest=1):
            name = at.terms[s.index[0]].name
            promised[name] = max(promised[name], s.evidence)
        names: list[str] = []
        for i in np.argsort(-single, kind="stable"):
            t = at.terms[i]
            if t.name in names or single[i] <= 4.0 or promised[t.name] < least:
                continue
            names.append(t.name)
            if (t.name,) not in done:
                attempt(nominal, (t,), np.array([size[i] * t.effect.scale]))
            if len(names) >= width:
                break
    start = full_evidence(nominal, total)

    def freed() -> Fit | None:
        best = sorted(done.values(), key=lambda c: -c.evidence)[:2] if reseeds else []
        return _reseeded(nominal, [c for c in best if c.evidence > start], quick)

    def anew(fit: Fit) -> Search:
        return search(
            fit,
            effects,
            settings,
            most=most,
            width=width,
            progress=progress,
            reseeds=reseeds - 1,
        )

    settled: set[tuple[str, ...]] = set()

    def moved(c: Candidate) -> None:
        """Fit the shapes of a set where those of the lists may not be enough."""
        if c.key in settled or not any(movable(t.effect) for t in c.fit.terms):
            return
        settled.add(c.key)
        loose = not c.fit.explains or (c.fit.gap_sd.size and c.fit.level > settings.levels[-1])
        if not loose and not off_grid(c.fit):
            return
        if progress is not None:
            progress("shapes: " + " + ".join(c.names), len(done), 0)

        def make(near: Fit, new: tuple[Term, ...]) -> Fit:
            point = near.problem.carry(near.point, new, near.point.sizes)
            return polish(near.problem.with_terms(new), point, near.level, brief)

        fit = between(c.fit, make, lambda f: full_evidence(f, total))
        fit = refit_at(fit.problem, fit.point, fit.level, quick)
        again = Candidate(fit, full_evidence(fit, total))
        if again.evidence > c.evidence:
            done[c.key] = again
            if fit.level < c.fit.level:  # tighter gaps see more of the shape
                settled.discard(c.key)
                moved(again)

    first = len(done)
    other = freed()
    if other is not None:
        return anew(other)
    alone = sorted((c for c in done.values() if len(c.names) == 1), key=lambda c: -c.evidence)
    for c in alone[:2]:
        if c.evidence - start > NEAR * (max(d.evidence for d in done.values()) - start) > 0.0:
            moved(c)
    for _ in range(2 * most):
        best = max(done.values(), key=lambda c: c.evidence, default=None)
        if best is None or best.evidence < start:
            break
        moved(best)
        best = max(done.values(), key=lambda c: c.evidence)
        before = best.evidence
        left = tuple(t for t in terms if t.name not in best.names)
        if left and len(best.fit.terms) < most:
            run(best.fit, score_fit(best.fit, left), 3)
            best = max(done.values(), key=lambda c: c.evidence)
        if best.evidence <= before + max(1e-9, SMALL * (before - start)):
            # Nothing more to add: does the set need all of its effects?
            for k, term in enumerate(best.fit.terms):
                rest = tuple(t for t in best.fit.terms if t is not term)
                if rest and _short(done.get(_key(rest)), best, k):
                    attempt(best.fit, rest, np.delete(best.fit.point.sizes, k))
                # Could another effect stand in its place? A screen at a poor nominal may have
                # overlooked it.
                for like, share in _alike(tight or scores, term):
                    swapped = (*rest, like)
                    if like.name in best.names or _key(swapped) in done:
                        continue
                    size = np.clip(share * best.fit.point.sizes[k], *like.effect.bounds)
                    if size == 0.0:
                        continue
                    attempt(best.fit, swapped, np.append(np.delete(best.fit.point.sizes, k), size))
            if max(c.evidence for c in done.values()) <= best.evidence:
                break
    if done:  # the winner must not be a stuck fit
        best = max(done.values(), key=lambda c: c.evidence)
        fit = best.fit
        if not fit.explains:
            fit = polish(fit.problem, fit.point, fit.level, replace(settings, chain=True))
        fit = refit_at(fit.problem, fit.point, fit.level, settings, patient=True)
        fit = _from_priors(fit, quick)
        again = Candidate(fit, full_evidence(fit, total))
        if again.evidence > best.evidence:
            done[best.key] = again
    other = freed() if len(done) > first else None
    if other is not None:
        return anew(other)
    ordered = tuple(sorted(done.values(), key=lambda c: (-c.evidence, c.key)))
    return Search(nominal, scores, tight, tight_fit, ordered, start, tuple(failed.items()))


def _key(terms: Sequence[Term]) -> tuple[str, ...]:
    return tuple(sorted(t.name for t in terms))


def _alike(scores: Scores, term: Term) -> list[tuple[Term, float]]:
    """Effects whose trace is most like that of a term, and their size for one of it."""
    own = [i for i, t in enumerate(scores.terms) if t.name == term.name]
    i = max(
        own, key=lambda j: (repr(scores.terms[j].shape) == repr(term.shape), scores.strength[j])
    )
    rho = np.abs(scores.correlation()[i])
    found: dict[str, int] = {}
    for j in np.argsort(-rho, kind="stable"):
        t = scores.terms[j]
        if rho[j] < ALIKE or len(found) == SWAPS:
            break
        if t.name != term.name and scores.testable[j]:
            found.setdefault(t.name, int(j))
    unit = 1.0 / scores.terms[i].effect.scale
    return [
        (
            scores.terms[j],
            float(scores.gram[i, j] / scores.gram[j, j]) * scores.terms[j].effect.scale * unit,
        )
        for j in found.values()
    ]


def _short(known: Candidate | None, best: Candidate, k: int) -> bool:
    """Whether the best set without its term k is still to be fitted from there.

    So it is where its known fit falls short of what the best one foretells to first order: half the
    square of the size over its deviation is lost. Such a fit is stuck in another valley.
    """
    if known is None:
        return True
    size = best.fit.intervals()[k - len(best.fit.terms)]
    loss = 0.5 * (size.value / size.sd) ** 2 if size.sd > 0.0 else np.inf
    return known.evidence < best.evidence - loss - SHORT


def _from_priors(fit: Fit, settings: FitSettings) -> Fit:
    """A doubtful fit once more, its parameters back at their priors, its windows where they are.

    Doubtful is a fit that did not converge, or whose parameters lie far from their priors: they may
    still hold what the nominal without the effect needed.
    """
    problem = fit.problem
    known = [i for i in problem.free if np.isfinite(problem.nominal.parameters[i].sd)]
    if problem.frozen or not fit.gap_sd.size or not known:
        return fit
    strained = float(np.sum(fit.strain**2)) > len(known) + 4.0 * np.sqrt(2.0 * len(known))
    if fit.converged and not strained:
        return fit
    theta = fit.point.theta.copy()
    theta[known] = problem.start().theta[known]
    again = refit_at(problem, replace(fit.point, theta=theta, memo={}), LOOSE, settings)
    return again if again.log_evidence > fit.log_evidence else fit


def tighten(fit: Fit, settings: FitSettings) -> Fit | None:
    """The fit with the tightest gaps; None where it has them, or cannot be simulated with them."""
    if not fit.gap_sd.size or fit.level <= settings.levels[-1]:
        return None
    problem, tightest = fit.problem, settings.levels[-1]
    point = fit.point
    way = replace(settings, iterations=12, decrement=max(settings.decrement, 0.3))
    for level in settings.levels[:-1]:
        if level < 0.99 * fit.level:  # all at once would tear a motion that hits something
            point = at_level(problem, point, level, None, way, 12).point
    tight = polish(problem, point, tightest, replace(settings, chain=True))

    def doubtful() -> bool:
        # Where the loose gaps explain nothing, there is a gap whatever the tight ones do.
        return fit.explains and not tight.log_evidence > fit.log_evidence - DOUBT

    def other(start: Point) -> None:
        nonlocal tight
        again = polish(problem, start, tightest, settings)
        if again.cost < tight.cost or not np.isfinite(tight.cost):
            tight = again

    # What looks like an unknown force may be a window that is stuck: one simulation through all
    # windows knows no gaps to begin with, and a slower descent may not tear.
    if doubtful():
        other(chained(problem, fit.point))
    if doubtful():
        point, level = fit.point, fit.level
        while (level := level / np.sqrt(10.0)) > 1.5 * tightest:
            point = at_level(problem, point, level, None, settings, settings.iterations).point
        other(point)
    return tight if np.isfinite(tight.cost) else None


def _reseeded(nominal: Fit, sets: Sequence[Candidate], settings: FitSettings) -> Fit | None:
    """The nominal fitted again from where sets of effects are, if it gets further from there.

    A nominal that is stuck makes any effect look like a cause that merely opens another way down;
    taken from there without the effect, it must do as badly as before.
    """
    best = nominal
    for c in sets:
        bare = c.fit.problem.carry(c.fit.point, (), np.zeros(0))
        way = replace(settings, worth=best.cost)
        fit = refit_at(nominal.problem, bare, c.fit.level, way)
        if fit.log_evidence > best.log_evidence + 1.0:
            best = fit
    if best is nominal:
        return None
    return replace(best, levels=nominal.levels, notes=(*nominal.notes, REFITTED))
