"""From scores to refitted sets: what the linear ranking promises is tried in full."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.nominal import Effect, Term
from feltmb.fit.solve import Fit, FitSettings, polish
from feltmb.gap.score import Scores, all_terms, prior_of, score_fit, screen_sets

__all__ = ["Candidate", "Search", "full_evidence", "refit", "search"]

Progress = Callable[[str, int, int], None]


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
    point = base.problem.carry(base.point, terms, sizes)
    fit = polish(problem, point, base.level, settings)
    if not fit.gap_sd.size:
        return fit
    levels = list(settings.levels)
    at = min(range(len(levels)), key=lambda i: abs(np.log(levels[i] / base.level)))
    quick = replace(settings, iterations=min(settings.iterations, 4))
    for level in levels[at + 1 :]:
        trial = polish(problem, fit.point, level, quick)
        if trial.log_evidence < fit.log_evidence - 0.5:
            break
        fit = trial
    return fit if fit.converged else polish(problem, fit.point, fit.level, settings)


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
    tight_fit: Fit | None = None,
    progress: Progress | None = None,
) -> Search:
    """Screen, refit the survivors, then add, drop and swap until nothing helps."""
    total = sum(e.weight for e in effects)
    terms = all_terms(effects)
    quick = replace(settings, iterations=15)
    done: dict[tuple[str, ...], Candidate] = {}
    failed: dict[str, str] = {}

    def attempt(base: Fit, chosen: tuple[Term, ...], sizes: Array) -> Candidate | None:
        if progress is not None:
            progress("refine: " + " + ".join(t.name for t in chosen), len(done), 0)
        fit = refit(base, chosen, sizes, quick)
        key = tuple(sorted(t.name for t in chosen))
        if not np.isfinite(fit.cost):
            failed[" + ".join(key)] = "could not be simulated"
            return None
        candidate = Candidate(fit, full_evidence(fit, total))
        if key not in done or candidate.evidence > done[key].evidence:
            done[key] = candidate
        return candidate

    scores = score_fit(nominal, terms)
    tight = None if tight_fit is None else score_fit(tight_fit, terms)
    tried: set[tuple[tuple[str, int], ...]] = set()

    def survivors(base: Fit, at: Scores, count: int) -> list[tuple[tuple[Term, ...], Array]]:
        """Best sets by linear evidence, added to what the base holds."""
        out = []
        have = {t.name for t in base.terms}
        seen: set[tuple[str, ...]] = set()
        for s in screen_sets(at, largest=max(1, min(3, most - len(base.terms)))):
            new = tuple(at.terms[i] for i in s.index)
            key = tuple(sorted(t.name for t in new))
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
            mark = tuple(sorted((t.name, t.effect.shapes.index(t.shape)) for t in chosen))
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
        names: list[str] = []
        for i in np.argsort(-single, kind="stable"):
            t = at.terms[i]
            if t.name in names or single[i] <= 4.0:
                continue
            names.append(t.name)
            if (t.name,) not in done:
                attempt(nominal, (t,), np.array([size[i] * t.effect.scale]))
            if len(names) >= width:
                break
    start = full_evidence(nominal, total)
    for _ in range(2 * most):
        if not done:
            break
        best = max(done.values(), key=lambda c: c.evidence)
        if best.evidence < start:
            break
        before = best.evidence
        left = tuple(t for t in terms if t.name not in best.names)
        if left and len(best.fit.terms) < most:
            run(best.fit, score_fit(best.fit, left), 3)
        for k, term in enumerate(best.fit.terms):  # drop one, or put another in its place
            if len(best.fit.terms) < 2:
                break
            rest = tuple(t for t in best.fit.terms if t is not term)
            if tuple(sorted(t.name for t in rest)) not in done:
                attempt(best.fit, rest, np.delete(best.fit.point.sizes, k))
        if max(c.evidence for c in done.values()) <= before + 1e-9:
            break
    if done:  # the winner must not be a stuck fit
        best = max(done.values(), key=lambda c: c.evidence)
        if best.fit.chi2 > best.fit.dof + 4.0 * np.sqrt(2.0 * best.fit.dof):
            fit = polish(
                best.fit.problem, best.fit.point, best.fit.level, replace(settings, chain=True)
            )
            again = Candidate(fit, full_evidence(fit, total))
            if again.evidence > best.evidence:
                done[best.key] = again
    ordered = tuple(sorted(done.values(), key=lambda c: (-c.evidence, c.key)))
    return Search(nominal, scores, tight, tight_fit, ordered, start, tuple(failed.items()))
