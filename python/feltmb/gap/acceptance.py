"""Held-out proof of the searched sets: posterior, accepted effects and their rivals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from feltmb.data import Array
from feltmb.fit.solve import SAME, Fit, FitSettings
from feltmb.fit.watch import Ended, Say, current
from feltmb.gap.criteria import (
    EXPLAINS_MOST,
    NEAR_BEST,
    NO_EFFECT,
    NOISE_ERROR,
    NOT_LISTED,
    RIVAL,
    WALD,
    contradicted,
    least_odds,
)
from feltmb.gap.evidence import forms_of, full_evidence, other_laws
from feltmb.gap.law_errors import law_errors
from feltmb.gap.misfit import allowance
from feltmb.gap.options import Options
from feltmb.gap.proof import (
    HELD_OUT_LEVEL,
    HeldOut,
    Outcome,
    evaluate,
    expected_gain,
    explained_share,
    held_out_gain,
    second_start,
)
from feltmb.gap.refine import CandidateSet, refit, tighten
from feltmb.gap.search import Search
from feltmb.gap.smooth import smooth_discrepancy

__all__ = ["Accepted", "Posterior", "accept", "posterior", "refutes", "shapley"]

#: Number of sets, in the order of their evidence, beside which an unknown cause is considered.
IN_PLAY = 4


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior probabilities of the model alone, an unknown cause, and every refitted set."""

    none: float
    other: float
    sets: tuple[float, ...]
    """Probability of each set, in the order of ``Search.sets``."""
    inflation: float
    like: str = ""
    """Effect that the likeliest unknown cause acts like, with another law; empty: it does not."""

    def updated(self, other: float, sets: Sequence[float]) -> Posterior:
        """After further records, by their log likelihood ratios to the model alone."""
        with np.errstate(divide="ignore"):
            before = np.log([self.none, self.other, *self.sets])
        after = before + np.array([0.0, other, *sets]) / self.inflation
        return _posterior(after, self.inflation, self.like)


def posterior(search: Search, settings: FitSettings) -> Posterior:
    """Compute the posterior of the model, of the model with an unknown cause, and of the sets.

    An unknown cause is represented by laws of the model that are not exact
    (:func:`~feltmb.gap.law_errors.law_errors`), by continuity defects between the segments, and in
    fits without such defects by a smooth signal in the outputs
    (:func:`~feltmb.gap.smooth.smooth_discrepancy`). "None" is the model without it, or with
    an unknown cause that gains no more than the :func:`~feltmb.gap.misfit.allowance`. It may also
    act beside effects: a true effect explains most, and the unknown cause the rest. It may also act
    like an effect, with another law (:func:`~feltmb.gap.evidence.other_laws`). Laws, defects and
    this share the prior probability of an unknown cause, as far as the records can show them.

    All log evidences are divided by the inflation: the smallest residual sum of squares of all fits
    over its degrees of freedom, at least 1. If even the best fit leaves more than noise, no set may
    get a high probability.
    """
    fits = [search.model_fit, *(c.fit for c in search.sets)]
    tight = search.tightest
    inflation = max(1.0, min(f.chi2 / f.dof for f in fits))
    segments = sum(s.count for s in tight.problem.segmented_records)
    alternatives = 1 + law_errors(tight, settings).tested + (segments > 1)
    share = NOT_LISTED / alternatives
    least = allowance(tight) / inflation

    def gain(fit: Fit) -> float:
        """Gain of log evidence by an unknown cause beside a fit, with the same defects."""
        laws = law_errors(fit, settings)
        if laws.tested:
            return laws.gain / inflation
        # What errors of form of the effects explain is in the evidence of the fit already.
        return (smooth_discrepancy(fit).mean - forms_of(fit).gain) / inflation

    def beside(fit: Fit) -> float:
        """Change of the log evidence of a fit if an unknown cause may act in addition."""
        own = gain(fit)
        return float(np.logaddexp(np.clip(own, 0.0, least), own + math.log(share / NO_EFFECT)))

    exact = search.tight_evidence / inflation
    loose = -math.inf if search.tight_fit is None else search.model_evidence / inflation
    unknown = float(np.logaddexp(exact + gain(tight), loose))
    alone = max(exact, min(unknown, exact + least)) + math.log(NO_EFFECT)
    beyond = unknown + math.log(share)
    sets = [c.evidence / inflation + math.log(1.0 - NO_EFFECT - NOT_LISTED) for c in search.sets]
    # An unknown cause gains most where nothing else explains its part: beside no effects.
    most = max(0.0, unknown - exact)
    best = max(sets, default=-math.inf)
    for k, c in enumerate(search.sets[:IN_PLAY]):
        if sets[k] + most > best - RIVAL:
            sets[k] += beside(c.fit)
    # A set with another law in the place of an effect is the set without this effect, and an
    # unknown cause.
    index = {c.key: k for k, c in enumerate(search.sets)}
    values = [alone, beyond, *sets]
    found: list[tuple[float, int, str]] = []
    for k, c in enumerate(search.sets):
        if sets[k] < best - NEAR_BEST:
            break
        for name, odds in zip(c.names, other_laws(c.fit), strict=True):
            rest = index.get(tuple(n for n in c.key if n != name))
            at = 1 if rest is None else 2 + rest
            like = (c.evidence + odds) / inflation + math.log(share)
            values[at] = np.logaddexp(values[at], like)
            if odds > 0.0:  # it explains the records better than the effect
                found.append((like, at, name))
    largest, at, name = max(found, default=(-math.inf, 1, ""))
    told = name if largest > values[at] - math.log(2.0) else ""
    return _posterior(values, inflation, told)


def _posterior(values: Sequence[float] | Array, inflation: float, like: str = "") -> Posterior:
    """Posterior from log weights: of the model alone, of an unknown cause, and of every set."""
    weights = np.exp(np.asarray(values) - np.max(values))
    none, other, *sets = (float(w) for w in weights / weights.sum())
    return Posterior(none, other, tuple(sets), inflation, like)


@dataclass(frozen=True, eq=False)
class Accepted:
    """Result of the held-out proof."""

    belief: Posterior
    """Posterior of the search, with what held-out records say against rivals of the accepted set;
    with all that they say if they refuse the best set and confirm another one."""
    best: CandidateSet | None
    """The accepted set of effects; None: no effect is accepted."""
    before: Outcome
    after: Outcome
    proof: dict[str, float]
    """Held-out gain of each effect: the accepted set compared with the same set without the
    effect."""
    rivals: tuple[CandidateSet, ...]
    """Other sets that these records cannot distinguish from the accepted set."""
    rejected: tuple[tuple[str, str], ...]
    """Effects of the best set that are not named, with the reason."""
    outcomes: dict[tuple[str, ...], Outcome] = field(default_factory=dict)
    tightest: Fit | None = None
    """The accepted set, fitted with the tightest continuity defects; None: it already has them."""
    complete: bool = True
    """Whether the proof was completed."""

    @property
    def p(self) -> float:
        """Bound on the probability that held-out records gain as much if nothing is missing.

        The mean of a likelihood ratio is 1 under its denominator, so that the probability of a
        ratio above exp(g) is at most exp(-g) (Markov's inequality). Any of the sets that were
        compared could have been accepted. 1 without an accepted set.
        """
        if self.best is None:
            return 1.0
        if not (self.before.simulated and self.after.simulated):
            return 1.0
        total = (self.after.total - self.before.total) / self.belief.inflation
        return min(1.0, max(1, len(self.outcomes) - 1) * math.exp(-max(0.0, total)))


class _Attempt:
    """Sets and parts of sets on the held-out records; each is refitted and evaluated once."""

    def __init__(
        self,
        search: Search,
        held: HeldOut,
        settings: FitSettings,
        inflation: float,
        options: Options,
        *,
        progress: Say | None,
    ):
        self.search, self.held, self.settings = search, held, settings
        self.inflation, self.options = inflation, options
        self.progress = progress
        self.total = search.total
        self.outcomes: dict[tuple[str, ...], Outcome] = {}
        self.tightest: dict[tuple[str, ...], Fit | None] = {}
        self.known = {c.key: c for c in search.sets}
        self.gains: dict[tuple[tuple[str, ...], ...], tuple[float, float]] = {}
        self.alone: dict[str, float] = {}
        """Largest score of each effect when it is tested alone."""
        for scores in (search.scores, search.tight):
            if scores is not None:
                for candidate, value in zip(scores.candidates, scores.singles(), strict=True):
                    self.alone[candidate.name] = max(
                        self.alone.get(candidate.name, 0.0), float(value)
                    )

    @property
    def before(self) -> Outcome:
        """The model alone."""
        return self.outcome(self.search.bare)

    @property
    def odds(self) -> float:
        """Held-out gain that confirms an effect [log evidence]."""
        return least_odds(self.options.credibility)

    def outcome(self, fit: Fit) -> Outcome:
        """Evaluate a fit on the held-out records."""
        key = tuple(sorted(t.name for t in fit.included))
        if key not in self.outcomes:
            if self.progress is not None:
                self.progress("held-out: " + (" + ".join(key) or "model"), len(self.outcomes), 0)
            current().expect(self._expected(key))
            self.outcomes[key] = self._with_second_starts(fit)
        return self.outcomes[key]

    def _expected(self, key: tuple[str, ...]) -> int:
        """Least number of evaluations that are left, with that of the set of this key.

        The best set and its parts without one effect are evaluated.
        """
        best = () if self.search.best is None else self.search.best.key
        parts = {(), best, *(tuple(n for n in best if n != out) for out in best)}
        return len(parts - self.outcomes.keys() - {key}) + 1

    def _with_second_starts(self, fit: Fit) -> Outcome:
        """Evaluate a fit, with the best result so far as its second start.

        A result that is better than all before is the second start of these.
        """
        best = max(self.outcomes.values(), key=_total_of, default=None)
        found = evaluate(self.held, fit, self.settings, like=best)
        if best is not None and _total_of(found) > _total_of(best):
            self.outcomes = {k: second_start(o, found) for k, o in self.outcomes.items()}
        return found

    def without(self, c: CandidateSet, name: str) -> CandidateSet | None:
        """The set without one of its effects; None: no effect remains."""
        kept = [k for k, t in enumerate(c.fit.included) if t.name != name]
        if not kept:
            return None
        key = tuple(sorted(c.fit.included[k].name for k in kept))
        if key not in self.known:
            fit = _part(self.search, c.fit, kept, self.settings)
            self.known[key] = CandidateSet(fit, full_evidence(fit, self.total))
        return self.known[key]

    def part(self, c: CandidateSet, names: Sequence[str]) -> CandidateSet:
        """Part of a set: the given effects only."""
        for name in [n for n in c.names if n not in names]:
            smaller = self.without(c, name)
            assert smaller is not None
            c = smaller
        return c

    def _outcome_without(self, c: CandidateSet, name: str) -> Outcome:
        bare = self.without(c, name)
        return self.before if bare is None else self.outcome(bare.fit)

    def _gaps(self, outcome: Outcome) -> tuple[float, float]:
        """Held-out gaps, open loop and segmented [sigma]."""
        sensed = self.held.sensed
        return outcome.gap(sensed, "open_loop"), outcome.gap(sensed, "segmented")

    def unexplained(self, c: CandidateSet) -> float:
        """Gain of log evidence if unknown forces are added to a set."""
        if c.key not in self.tightest:
            self.tightest[c.key] = tighten(c.fit, self.settings)
        tight = self.tightest[c.key]
        return 0.0 if tight is None else c.fit.log_evidence - tight.log_evidence

    def _gain(self, c: CandidateSet) -> float:
        """Held-out gain of a whole set over the model [units of log evidence]."""
        return self._compared(self.before, self.outcome(c.fit))

    def faults(self, c: CandidateSet) -> tuple[dict[str, float], dict[str, str]]:
        """Held-out gain of each effect over the set without it; reasons against effects."""
        after = self.outcome(c.fit)
        trials = {name: self._compared(self._outcome_without(c, name), after) for name in c.names}
        certain = _certainty(c.fit)
        bad = {}
        for name, gain in trials.items():
            why = self._fault(c, name, gain, certain[name])
            if why:
                bad[name] = why
        return trials, bad

    def _fault(self, c: CandidateSet, name: str, gain: float, certain: float) -> str:
        """Reason to reject an effect of a set; empty: the effect is confirmed."""
        alone = self.alone.get(name, 0.0)
        told = f"held-out gain {_shown(gain)} units of log evidence"
        if certain < WALD and alone < WALD**2:
            # Such an effect only helped the fit of the other parameters out of a local minimum. An
            # effect whose law bends sharply can have a large standard deviation; the score of the
            # model shows it.
            return (
                f"its magnitude is {certain:.1f} of its standard deviations, and its score alone "
                f"{alone:.1f}"
            )
        unknown = self.unexplained(c) / self.inflation
        if 0.0 < unknown > gain and not self._carries(c, name, gain):
            return f"{told}, less than the {_shown(unknown)} that an unknown force would explain"
        without, after = self._outcome_without(c, name), self.outcome(c.fit)
        # The parameter that such an effect increases explains the records as well: only held-out
        # records can show that it is more than this parameter.
        another = (
            any(t.name == name and t.effect.tolerance_parameter for t in c.fit.included)
            and gain <= self.odds
        )
        if another or self._refused(gain, without, after):
            if gain > self.odds:
                return f"{told}, but its prediction of these records is no closer"
            if _follows(after):
                return f"{told}; it follows these records only with larger continuity defects"
            return f"{told}, {self.expected(without, after)[0]:.1f} would be expected of it"
        return ""

    def _refused(self, gain: float, before: Outcome, after: Outcome) -> bool:
        """Whether the held-out records contradict ``after``, or do not show what they must show."""
        if gain > self.odds:
            # Where a set does not explain the records, their density is that of parameters far
            # from the fitted ones. The prediction must be closer, too.
            return not after.explains and all(
                new >= old for old, new in zip(self._gaps(before), self._gaps(after), strict=True)
            )
        if _follows(after):
            return True
        alpha, odds = self.options.alpha, self.odds
        least = least_gain(*self.expected(before, after), alpha=alpha, odds=odds)
        # A true effect that surely shows must improve the prediction. The expected gain of another
        # one omits the difference of S, which is small (two fits differ by SAME without a reason).
        return least >= odds or gain < least - contradicted(alpha) * SAME

    def expected(self, before: Outcome, after: Outcome) -> tuple[float, float]:
        """Held-out gain that a set would have if it were true, and its standard deviation."""
        keys = tuple(tuple(sorted(t.name for t in o.fit.included)) for o in (before, after))
        if keys not in self.gains:
            self.gains[keys] = expected_gain(
                self.held, before, after, self.settings, self.inflation
            )
        return self.gains[keys]

    def _carries(self, c: CandidateSet, name: str, gain: float) -> bool:
        """Whether an effect significantly explains most of a held-out gap above noise."""
        before = self._gaps(self._outcome_without(c, name))
        after = self._gaps(self.outcome(c.fit))
        shares = [
            explained_share(old, new)
            for old, new in zip(before, after, strict=True)
            if NOISE_ERROR < old < np.inf and np.isfinite(new)
        ]
        return gain > self.odds and max(shares, default=0.0) >= EXPLAINS_MOST

    def standing(
        self, first: CandidateSet, proof: dict[str, float], bad: dict[str, str]
    ) -> tuple[CandidateSet | None, dict[str, float]]:
        """Find the largest part of a set in which every effect is confirmed, and its proof.

        The reasons against effects in these parts are added to ``bad``.

        Effects of a set can replace each other. One rejected effect therefore does not decide: of
        the largest confirmed parts, the one with the largest evidence is returned.
        """
        strongest = max(first.names, key=lambda n: proof[n])
        needed = set() if strongest in bad else {strongest}
        # A smaller set leaves more to unknown forces. If unknown forces are better than the whole
        # set, no part can be confirmed. (The exception: effects that can replace each other gain
        # little each over the set without them.)
        unknown = self.unexplained(first) / self.inflation
        if 0.0 < unknown > self._gain(first) and not any(
            self._carries(first, name, proof[name]) for name in first.names
        ):
            return None, proof
        for size in range(len(first.names) - 1, 0, -1):
            standing = []
            for names in itertools.combinations(first.names, size):
                if not needed <= set(names):
                    continue
                part = self.part(first, names)
                if part.evidence < self.search.model_evidence:
                    continue
                found, wrong = self.faults(part)
                for name, why in wrong.items():
                    bad.setdefault(name, why)
                if not wrong:
                    standing.append((part, found))
            if standing:
                return max(standing, key=lambda s: (s[0].evidence, s[0].key))
        return None, proof

    def another(self, first: CandidateSet) -> tuple[CandidateSet | None, dict[str, float]]:
        """Find another set that held-out records confirm, if they refuse the best one.

        An effect that resembles the cause may explain the fitted records best, and others not at
        all. All records together must prefer the other set by the odds of a confirmation.
        """
        others = [c for c in self.search.sets if c.evidence > self.search.model_evidence]
        least = self._total(first) + self.odds
        for c in [c for c in others if c.key != first.key][: self.options.width]:
            if self._total(c) > least:
                proof, wrong = self.faults(c)
                if not wrong:
                    return c, proof
        return None, {}

    def _total(self, c: CandidateSet) -> float:
        """Log evidence of a set for the fitted and the held-out records."""
        return (c.evidence + self.outcome(c.fit).total) / self.inflation

    def belief(self, before: Posterior) -> Posterior:
        """The posterior with the held-out records, for the sets that were compared with them."""
        none = self.before.total
        laws = law_errors(self.search.tightest, self.settings).fit
        other = none
        if laws is not None:
            other = evaluate(self.held, laws, self.settings, like=self.before).total
        known = [self.outcomes.get(c.key) for c in self.search.sets]
        gains = [-math.inf if o is None else o.total - none for o in known]
        return before.updated(max(0.0, other - none), gains)

    def rivals(self, best: CandidateSet) -> list[CandidateSet]:
        """Other sets that the records cannot distinguish from the best set.

        Held-out records may refuse a set in comparison with the model alone. If the best set does
        not explain them, they do not decide between it and the sets that remain.
        """
        told = self.outcome(best.fit).explains
        found = []
        for c in self.search.sets:
            if c.key == best.key or len(c.names) > len(best.names):
                continue
            if (best.evidence - c.evidence) / self.inflation > RIVAL:
                continue
            if self._contradicted(self.outcome(c.fit)):
                continue
            if not told or self._total(best) - self._total(c) <= RIVAL:
                found.append(c)
        return found

    def weighed(self, before: Posterior, best: CandidateSet) -> Posterior:
        """The posterior with what held-out records say against the rivals of an accepted set.

        The model alone is one of them. An unknown cause is not: it could gain on these records too.
        Records that the accepted set does not explain do not tell which of several sets is wrong.
        """
        if not self.outcome(best.fit).explains:
            return before
        own = self.outcome(best.fit).total
        none = min(0.0, self.before.total - own) if self.before.simulated else 0.0
        known = [self.outcomes.get(c.key) for c in self.search.sets]
        sets = [0.0 if o is None else min(0.0, o.total - own) for o in known]
        return before.updated(-none, [value - none for value in sets])

    def _compared(self, old: Outcome, new: Outcome) -> float:
        return held_out_gain(old, new) / self.inflation

    def _contradicted(self, own: Outcome) -> bool:
        """Whether held-out records show less gain over the model than a true set would."""
        return self._refused(self._compared(self.before, own), self.before, own)


def sure_part(
    names: Sequence[str],
    sets: Sequence[CandidateSet],
    belief: Sequence[float],
    credibility: float,
) -> tuple[str, ...]:
    """Largest part of a set with a sufficient probability; the set itself if there is no such part.

    An uncertain effect must not make the certain effects of the same set uncertain. If the records
    clearly need one more effect but do not determine which, the set is returned as it is and the
    report states this.
    """

    def share(part: set[str], *, strictly: bool = False) -> float:
        pairs = zip(sets, belief, strict=True)
        return sum(
            w for c, w in pairs if part < set(c.names) or (part == set(c.names) and not strictly)
        )

    if share(set(names)) >= credibility:
        return tuple(names)
    for size in range(len(names) - 1, 0, -1):
        found = [
            part
            for part in itertools.combinations(names, size)
            if share(set(part)) >= credibility > share(set(part), strictly=True)
        ]
        if found:
            return max(found, key=lambda part: share(set(part)))
    return tuple(names)


def _shown(gain: float) -> str:
    """A gain of log evidence as text."""
    return f"{gain:.1f}" if abs(gain) < 1e3 else f"{gain:.3g}"


def accept(
    search: Search,
    held: HeldOut,
    settings: FitSettings,
    options: Options,
    *,
    progress: Say | None = None,
) -> Accepted:
    """Keep the effects of the best set that held-out records confirm, and find its rivals."""
    belief = posterior(search, settings)
    attempt = _Attempt(
        search,
        held,
        settings,
        belief.inflation,
        options,
        progress=progress,
    )
    try:
        with current().discarding():
            return _compared(search, attempt, belief, options)
    except Ended:
        names = () if search.best is None else search.best.names
        why = f"the held-out proof was not complete ({current().why})"
        # Of an unfinished evaluation only the gap is used.
        before = attempt.outcomes.get(()) or evaluate(held, search.bare, settings)
        return Accepted(
            belief, None, before, before, {}, (), tuple((n, why) for n in names),
            {**attempt.outcomes, (): before}, complete=False,
        )  # fmt: skip


def _compared(search: Search, attempt: _Attempt, belief: Posterior, options: Options) -> Accepted:
    """The effects of the best set that held-out records confirm, and its rivals."""
    attempt.outcome(search.bare)  # the first start of all others
    proof: dict[str, float] = {}
    rejected: list[tuple[str, str]] = []
    all_records = False  # whether ``belief`` contains the held-out records
    best = first = search.best
    if first is not None:
        proof, bad = attempt.faults(first)
        if bad:
            without = "does not stand without " + " and ".join(bad)
            best, proof = attempt.standing(first, proof, bad)
            if best is None:
                best, confirmed = attempt.another(first)
                if best is not None:
                    proof, belief = confirmed, attempt.belief(belief)
                    all_records = True
            kept = () if best is None else best.names
            rejected = [(n, bad.get(n, without)) for n in first.names if n not in kept]
        sure = None
        if best is not None:
            sure = sure_part(best.names, search.sets, belief.sets, options.credibility)
        part = None if best is None or not sure else attempt.part(best, sure)
        if best is not None and part is not None and part.key != best.key:
            found, wrong = attempt.faults(part)
            if not wrong:
                doubt = f"the sets with it have a probability below {options.credibility:g}"
                rejected += [(n, doubt) for n in best.names if n not in part.names]
                best, proof = part, found
    elif search.sets:
        attempt.outcome(search.sets[0].fit)  # evaluated for the report: how close this set comes
    rivals = () if best is None else tuple(attempt.rivals(best))
    return Accepted(
        belief if best is None or all_records else attempt.weighed(belief, best),
        best,
        attempt.before,
        attempt.before if best is None else attempt.outcome(best.fit),
        proof,
        rivals,
        tuple(rejected),
        attempt.outcomes,
        None if best is None else attempt.tightest[best.key],
    )


def _part(search: Search, fit: Fit, kept: Sequence[int], settings: FitSettings) -> Fit:
    """Refit a part of the effects of a fit, starting from the model without effects."""
    included = tuple(fit.included[k] for k in kept)
    return refit(search.bare, included, fit.point.magnitudes[list(kept)], settings)


def _total_of(outcome: Outcome) -> float:
    """Log predictive density; a failed simulation is the worst."""
    return outcome.total if np.isfinite(outcome.total) else -math.inf


def _certainty(fit: Fit) -> dict[str, float]:
    """Magnitude over its posterior standard deviation, for each effect."""
    magnitudes = fit.intervals()[len(fit.problem.free) :]
    return {i.name: abs(i.value) / max(i.sd, 1e-150) for i in magnitudes}


def _follows(outcome: Outcome) -> bool:
    """Whether a model explains held-out records only with larger continuity defects, or not at all.

    They are larger than those of its fit, and than those of other held-out records. Its states then
    follow these records, and its outputs do not tell what an effect would do there.
    """
    fit = outcome.fit
    return not np.isfinite(fit.cost) or bool(
        fit.defect_sd.size and fit.level > 1.01 * max(outcome.model.level, HELD_OUT_LEVEL)
    )


def least_gain(expected: float, sd: float, *, alpha: float, odds: float) -> float:
    """Held-out gain that a true effect exceeds with the probability 1 - alpha [log evidence].

    More than ``odds`` is never required. A small expected gain means that the held-out
    records do not excite the effect, and can neither confirm nor refute it.

    With a standard normal x, the gain is ``expected + sd x + r x^2 / 2 - log(1 + r) / 2``. The last
    two terms are the uncertainty of the magnitude in the prediction: ``r`` is the variance of the
    gain by this uncertainty, divided by that by noise.

    Parameters
    ----------
    expected, sd
        Distribution of the gain (:func:`~feltmb.gap.proof.expected_gain`) [log evidence].
    alpha
        Rate of false alarms.
    odds
        Gain that confirms an effect [log evidence].
    """
    ratio = max(0.0, sd**2 / (2.0 * expected) - 1.0) if expected > 0.0 else 0.0
    far = contradicted(alpha)
    x = far if ratio * far <= sd else sd / ratio
    value = expected - x * sd + 0.5 * ratio * x**2 - 0.5 * math.log1p(ratio)
    return min(odds, value)


def refutes(old: Accepted, new: Accepted, credibility: float) -> bool:
    """Whether held-out records favor the earlier search, by the odds of the credibility."""
    gain = held_out_gain(old.after, new.before)
    return gain < -least_odds(credibility)


def shapley(
    search: Search,
    accepted: Accepted,
    held: HeldOut,
    settings: FitSettings,
    *,
    which: str,
    progress: Say | None = None,
) -> dict[str, float]:
    """Order-free share of every accepted effect in the held-out gap (2^n fits, n <= 4) [sigma]."""
    if accepted.best is None:
        return {}
    fit = accepted.best.fit
    names = [t.name for t in fit.included]
    known = {c.key: c.fit for c in search.sets}
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
            part = known.get(key) or _part(search, fit, kept, settings)
            found = evaluate(
                held,
                part,
                settings,
                like=accepted.outcomes.get(()),
            )
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
