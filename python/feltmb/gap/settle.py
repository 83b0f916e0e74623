"""From searched sets to accepted effects: held-out proof, classes, posterior."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from feltmb.fit.solve import Fit, FitSettings
from feltmb.gap.proof import HeldOut, Outcome, Paired, compare, evaluate
from feltmb.gap.refine import Candidate, Search, full_evidence, refit, tighten

__all__ = ["Accepted", "Posterior", "accept", "posterior", "shapley"]

Progress = Callable[[str, int, int], None]

#: Gain of log predictive density that held-out records must show: ten to one.
LEAST_GAIN = math.log(10.0)


#: Share of the remaining held-out gap that makes more than small print of an effect where an
#: unknown rest was admitted.
CLOSES = 0.05
#: Standard deviations by which a size must differ from zero, or the score of the effect alone.
WALD = 3.0


@dataclass(frozen=True, eq=False)
class Posterior:
    """Probabilities of nothing, something unknown, and every refitted set."""

    none: float
    other: float
    sets: tuple[float, ...]
    """By candidate of the search, in its order."""
    inflation: float

    def trusted(self, share: float) -> Posterior:
        """The same where only a share of what the sets have is theirs, the rest is unknown."""
        lost = (1.0 - share) * sum(self.sets)
        sets = tuple(share * w for w in self.sets)
        return replace(self, other=self.other + lost, sets=sets)


def posterior(search: Search, *, none: float = 0.5, other: float = 0.1) -> Posterior:
    """Weigh the nominal as it is, the nominal with unknown forces, and the refitted sets.

    "Unknown" is the nominal with gaps between its windows; "none" the nominal without. Evidence is
    divided by the residual sum of squares over its degrees of freedom of the best fit: a model
    that is wrong in a way that no set repairs must not be sure about sets.
    """
    fits = [search.nominal, *(c.fit for c in search.candidates)]
    inflation = max(1.0, min(f.chi2 / f.dof for f in fits))
    floor = search.nominal_evidence if search.tight_fit is None else _tight_evidence(search)
    values = [floor / inflation + math.log(none)]
    values.append(
        search.nominal_evidence / inflation + math.log(other)
        if search.tight_fit is not None
        else -math.inf
    )
    share = math.log(1.0 - none - other)
    values += [c.evidence / inflation + share for c in search.candidates]
    top = max(values)
    weights = np.exp(np.array(values) - top)
    weights /= weights.sum()
    return Posterior(
        float(weights[0]), float(weights[1]), tuple(float(w) for w in weights[2:]), inflation
    )


def _tight_evidence(search: Search) -> float:
    assert search.tight_fit is not None
    value = full_evidence(search.tight_fit, 1.0)
    return value if math.isfinite(value) else -math.inf


@dataclass(frozen=True, eq=False)
class Accepted:
    """What stood the held-out proof."""

    candidate: Candidate | None
    """The set of effects that is kept; None: nothing."""
    before: Outcome
    after: Outcome
    proof: dict[str, Paired]
    """By effect of the best set: gain that it brings over the set without it."""
    rivals: tuple[Candidate, ...]
    """Other sets that these records cannot tell from it."""
    rejected: tuple[tuple[str, str], ...]
    """Effects that the fit wanted and held-out records refused, with the reason."""
    outcomes: dict[tuple[str, ...], Outcome] = field(default_factory=dict)
    tightest: Fit | None = None
    """The set fitted with the tightest gaps; None where it has them already."""


def accept(
    search: Search,
    held: HeldOut,
    settings: FitSettings,
    inflation: float,
    *,
    windowed_level: float,
    least_share: float,
    unknown_rest: bool = False,
    seed: int,
    progress: Progress | None = None,
) -> Accepted:
    """Keep the effects of the best set that held-out records confirm, and find its rivals.

    ``unknown_rest``: a rest was admitted as noise. Then there is no law that could be right to the
    last digit, and small print is told by the share of the remaining gap that it closes as well.
    """
    total = sum(t.effect.weight for t in {t.effect.name: t for t in search.scores.terms}.values())
    outcomes: dict[tuple[str, ...], Outcome] = {}
    known = {c.key: c for c in search.candidates}

    def outcome(fit: Fit) -> Outcome:
        key = tuple(sorted(t.name for t in fit.terms))
        if key not in outcomes:
            if progress is not None:
                progress("held out: " + (" + ".join(key) or "nominal"), len(outcomes), 0)
            outcomes[key] = evaluate(held, fit, settings, windowed_level=windowed_level)
        return outcomes[key]

    def candidate_without(c: Candidate, name: str) -> Candidate | None:
        terms = tuple(t for t in c.fit.terms if t.name != name)
        if not terms:
            return None
        key = tuple(sorted(t.name for t in terms))
        if key not in known:
            sizes = np.array(
                [s for t, s in zip(c.fit.terms, c.fit.point.sizes, strict=True) if t.name != name]
            )
            fit = refit(search.nominal, terms, sizes, settings)
            known[key] = Candidate(fit, full_evidence(fit, total))
        return known[key]

    def closes(c: Candidate, name: str, after: Outcome) -> float:
        """Share of the held-out gap without an effect that it closes."""
        bare = candidate_without(c, name)
        without = before if bare is None else outcome(bare.fit)
        shares = []
        for which in ("open_loop", "windowed"):
            old, new = without.gap(held.sensed, which), after.gap(held.sensed, which)
            if np.isfinite(old) and np.isfinite(new) and old > 1.0:
                shares.append((old - new) / (old - 1.0))
        return max(shares, default=0.0)

    tightest: dict[tuple[str, ...], Fit | None] = {}

    def unexplained(c: Candidate) -> float:
        """Log evidence that unknown forces still bring to a set."""
        if c.key not in tightest:
            tightest[c.key] = tighten(c.fit, settings)
        tight = tightest[c.key]
        return 0.0 if tight is None else c.fit.log_evidence - tight.log_evidence

    alone: dict[str, float] = {}
    for scores in (search.scores, search.tight):
        if scores is not None:
            for term, value in zip(scores.terms, scores.singles(), strict=True):
                alone[term.name] = max(alone.get(term.name, 0.0), float(value))

    before = outcome(search.nominal)
    proof: dict[str, Paired] = {}
    rejected: list[tuple[str, str]] = []

    def faults(c: Candidate) -> tuple[dict[str, Paired], dict[str, str]]:
        """Gain by effect over the set without it, and why some do not stand."""
        after = outcome(c.fit)
        trials, bad = {}, {}
        for name in c.names:
            bare = candidate_without(c, name)
            base = before if bare is None else outcome(bare.fit)
            trials[name] = compare(base, after, held.shots, inflation, seed=seed)
        most = max(t.gain for t in trials.values())
        unknown = unexplained(c) / inflation
        certain = _certainty(c.fit)
        for name, paired in trials.items():
            if certain[name] < WALD and alone.get(name, 0.0) < WALD**2:
                # What it brought was another way down for the other parameters. An effect that
                # bends so sharply that its size is loose still shows in the score of the nominal.
                bad[name] = (
                    f"its size is {certain[name]:.1f} of its standard deviations, and its score "
                    f"alone {alone.get(name, 0.0):.1f}"
                )
            elif paired.gain < unknown:
                bad[name] = (
                    f"held-out gain {paired.gain:.1f} nats, less than the {unknown:.1f} that an "
                    "unknown force would still explain"
                )
            elif paired.gain < least_share * most and not (
                unknown_rest and closes(c, name, after) >= CLOSES
            ):
                bad[name] = (
                    f"held-out gain {paired.gain:.1f} nats beside {most:.0f}: no more than an "
                    "error in the form of the larger effect would bring"
                )
            elif not _improves(paired, inflation):
                bad[name] = f"held-out gain {paired.gain:.1f} nats, p = {paired.p:.2g}"
        return trials, bad

    best = search.best
    if best is not None:
        proof, bad = faults(best)
        if bad:
            # Effects of a set can stand in for each other, so that the first refusal must not
            # decide: of the largest subsets that stand, the one with the best evidence is kept.
            first, why = best, bad
            strongest = max(first.names, key=lambda n: proof[n].gain)
            needed = set() if strongest in bad else {strongest}
            best = None
            # A smaller set leaves more to unknown forces: where they beat every effect, it is over.
            hopeless = max(t.gain for t in proof.values()) < unexplained(first) / inflation
            for size in range(0 if hopeless else len(first.names) - 1, 0, -1):
                standing = []
                for names in itertools.combinations(first.names, size):
                    if not needed <= set(names):
                        continue
                    part: Candidate | None = first
                    for name in set(first.names) - set(names):
                        assert part is not None
                        part = candidate_without(part, name)
                    assert part is not None
                    if part.evidence < search.nominal_evidence:
                        continue
                    found, wrong = faults(part)
                    if not wrong:
                        standing.append((part, found))
                if standing:
                    best, proof = max(standing, key=lambda s: (s[0].evidence, s[0].key))
                    break
            kept = () if best is None else best.names
            rejected = [
                (n, why.get(n, "does not stand without " + " and ".join(why)))
                for n in first.names
                if n not in kept
            ]
    after = before if best is None else outcome(best.fit)
    rivals = []
    if best is not None:
        for c in search.candidates:
            if c.key == best.key or len(c.names) > len(best.names):
                continue
            if c.evidence / inflation < best.evidence / inflation - math.log(20.0):
                continue
            if not _improves(compare(before, outcome(c.fit), held.shots, inflation), inflation):
                continue
            if _improves(compare(outcome(c.fit), after, held.shots, inflation), inflation):
                continue  # the best one predicts better than it
            rivals.append(c)
    return Accepted(
        best,
        before,
        after,
        proof,
        tuple(rivals),
        tuple(rejected),
        outcomes,
        None if best is None else tightest[best.key],
    )


def _certainty(fit: Fit) -> dict[str, float]:
    """Size over its standard deviation, by effect."""
    sizes = fit.intervals()[len(fit.problem.free) :]
    return {i.name: abs(i.value) / max(i.sd, 1e-150) for i in sizes}


def _improves(paired: Paired, inflation: float) -> bool:
    """Enough gain; and, where the noise model is doubtful, spread over the windows as well."""
    return paired.gain > LEAST_GAIN and paired.p < (0.4 if inflation < 1.3 else 0.05)


def shapley(
    search: Search,
    accepted: Accepted,
    held: HeldOut,
    settings: FitSettings,
    *,
    which: str,
    windowed_level: float,
    progress: Progress | None = None,
) -> dict[str, float]:
    """Order-free share of every accepted effect in the held-out gap (2^n fits, n <= 4) [sigma]."""
    if accepted.candidate is None:
        return {}
    fit = accepted.candidate.fit
    names = [t.name for t in fit.terms]
    known = {c.key: c.fit for c in search.candidates}
    value: dict[frozenset[str], float] = {}
    subsets = [
        frozenset(s) for r in range(len(names) + 1) for s in itertools.combinations(names, r)
    ]
    for subset in subsets:
        key = tuple(sorted(subset))
        found = accepted.outcomes.get(key)
        if found is None:
            if progress is not None:
                progress("waterfall: " + " + ".join(key), len(value), len(subsets))
            kept = [k for k, n in enumerate(names) if n in subset]
            part = known.get(key) or refit(
                search.nominal,
                tuple(fit.terms[k] for k in kept),
                fit.point.sizes[kept],
                settings,
            )
            found = evaluate(held, part, settings, windowed_level=windowed_level)
        value[subset] = found.gap(held.sensed, which)
    n = len(names)
    out = {}
    for name in names:
        share = 0.0
        for subset in subsets:
            if name in subset:
                continue
            weight = (
                math.factorial(len(subset)) * math.factorial(n - len(subset) - 1)
            ) / math.factorial(n)
            share += weight * (value[subset] - value[subset | {name}])
        out[name] = share
    return out
