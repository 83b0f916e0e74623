"""Derives the verdict from the results of the diagnosis; it claims no more than they prove."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from feltmb.fit.model import OF_RECORDS
from feltmb.fit.solve import SAME, Fit
from feltmb.gap.acceptance import Accepted, Posterior
from feltmb.gap.checks import DataChecks
from feltmb.gap.criteria import (
    EXPLAINS_MOST,
    LARGE_MOVE,
    NO_GAP_RATIO,
    least_odds,
    refuted,
    unknown_gain,
)
from feltmb.gap.findings import (
    Calibrated,
    Closest,
    GivenValue,
    HowFar,
    Verdict,
    Where,
    listed,
    sentence,
)
from feltmb.gap.misfit import Misfit, form_of, misfit
from feltmb.gap.options import Options
from feltmb.gap.proof import explained_share
from feltmb.gap.score import Scores
from feltmb.gap.search import Search
from feltmb.gap.sizes import Sizes
from feltmb.gap.tabulated import of_the_machine
from feltmb.gap.tolerance import prior_deviations_told
from feltmb.gap.uncorrelated import Uncorrelated
from feltmb.units import readable_unit, unit_suffix

__all__ = ["Decision", "Facts", "decide", "first_scored"]

#: Advice if only the held-out records show a gap.
FIT_OTHERS = "They excite effects that the others do not. Fit some of them, and hold out others."


@dataclass(frozen=True, eq=False)
class Facts:
    """Everything that the verdict depends on."""

    checks: DataChecks
    search: Search
    accepted: Accepted
    belief: Posterior
    p: float
    """Family-wise p of the largest score."""
    options: Options
    how_far: HowFar
    where: Where
    rest: Fit | None
    """The accepted model, fitted with the tightest continuity defects."""
    first: Search
    """The search with only the noise of the sensors."""
    misfit: Misfit
    """Unexplained residual of the model in the search ``first``."""
    sizes: Sizes
    """Magnitudes of the fitted effects."""
    leftover: float
    """Largest score of the other effects after acceptance, relative to its family-wise
    threshold."""
    unexplained: bool
    """Whether an unexplained residual was added to the noise when effects were judged."""
    apart: bool = False
    """Whether the fit changed the parameters, jointly, by more than noise would."""
    calibrated: tuple[Calibrated, ...] = ()
    """Parameters that the fit changed."""
    given: tuple[GivenValue, ...] = ()
    """Tests of parts, and effects that are a part of the model."""
    closest: Closest | None = None
    """The tested set with the smallest gap on the held-out records."""
    enough: bool = False
    """Whether the fitted model is within ``Options.good_enough``."""
    enough_left: bool = False
    """Whether the model with the accepted effects is within ``Options.good_enough``."""
    uncorrelated: tuple[Uncorrelated, ...] = ()
    """Channels whose residual is not correlated in time."""
    only_noise: bool = False
    """Whether nothing that is correlated in time is left."""
    beyond: float | None = None
    """Sum of squares over its expectation of the accepted model, fitted to the held-out records
    alone, if they show a gap then; else None."""


@dataclass(frozen=True)
class Decision:
    """The verdict and its text."""

    verdict: Verdict
    statement: str
    named: tuple[str, ...]
    one_of: tuple[str, ...]
    confidence: float
    belief: Posterior
    closest: Closest | None = None
    """The closest tested set, and why it is not proven; only if no effect is named."""


def decide(facts: Facts) -> Decision:
    """Derive the verdict from the facts; docs/explanation/gap.md states the rules."""
    search, accepted = facts.search, facts.accepted
    p = facts.p
    # The largest score is linear. It misses effects that act only beyond a size.
    hint = min(p, accepted.p) < facts.options.alpha
    best = accepted.best
    gap = not facts.enough and (_refuted(facts) or (hint and best is not None))
    if gap and (_refuted(facts) or facts.unexplained):
        # Here, "nothing" stands for the unexplained residual without an effect. That is an unknown
        # cause.
        facts = replace(facts, belief=_with_a_gap(facts.belief))
    if not gap and facts.beyond is not None:
        # The held-out records contradict what the fitted records say about a gap.
        with_set = f" with {listed(best.names)}" if best is not None else ""
        return _silent(
            replace(facts, belief=_with_a_gap(facts.belief)),
            Verdict.UNKNOWN,
            "The records of the fit show no gap, but the held-out ones do: fitted to them alone "
            f"the model{with_set} leaves {facts.beyond:.3g} times the sum of squares of noise. "
            + (facts.where.one_record.text if facts.where.one_record else FIT_OTHERS),
        )
    if not gap:
        likely = 1.0 - facts.belief.none >= facts.options.credibility
        if (hint or likely) and not facts.enough:
            sign = f"family-wise p = {min(p, accepted.p):.2g}"
            if not hint:
                sign = f"probability that nothing is missing: {facts.belief.none:.2g}"
            reason = _refusals(accepted) or sign
            return _too_weak(facts, f" ({reason})")
        return _calibrated(facts)
    if best is None and not facts.first.model_fit.converged and not hint:
        return _silent(
            facts,
            Verdict.TOO_WEAK,
            "The fit of the model did not converge, also from other starts. A stuck fit is not "
            "taken for a gap. Use narrower priors, or shorter segments.",
        )
    if best is None and _only_noise(facts):
        return _data_problem(facts)
    if best is None:
        text = f"There is a gap ({_signs(facts)}), but no tested effect is proven to explain it."
        text += _closest(facts.closest)
        if facts.closest is None and search.sets:
            text += " None of them is closer to the held-out records than the model."
        elif facts.closest is None:
            text += first_scored(search.scores)
        refused = _refusals(accepted)
        if refused and (facts.closest is None or not facts.closest.why):
            text += f" Not confirmed: {refused}."
        text += _noise(facts) or _place(facts)
        out = _silent(facts, Verdict.UNKNOWN, _another(facts) + text)
        return replace(out, closest=facts.closest)
    if _in_fitted_records_only(facts):
        what = "it" if len(best.names) == 1 else "them"
        why = (
            f": nearest {listed(best.names)}. The scores of the fitted records are sure, but no "
            f"record has more than noise without {what}, and held-out records do not confirm {what}"
        )
        return _too_weak(facts, why)
    return _name(facts)


def _in_fitted_records_only(facts: Facts) -> bool:
    """Whether the model explains all records to their noise and held-out ones confirm no effect.

    A small error of the start or of a sensor in the fitted records has a large score, too.
    Parameters outside their priors are evidence of their own.
    """
    within = not facts.misfit.left and facts.search.model_fit.within_priors
    small = within and facts.how_far.no_gap
    most = max(facts.accepted.proof.values(), default=0.0)
    return small and most < least_odds(facts.options.credibility)


def _only_noise(facts: Facts) -> bool:
    """Whether nothing correlated in time is left, and no effect is certain beside this noise."""
    return facts.only_noise and facts.p > refuted(facts.options.alpha)


def _data_problem(facts: Facts, refused: tuple[str, ...] = ()) -> Decision:
    """Decision if the records have larger noise than stated, or errors of time stamps."""
    moved = _moved(facts)
    text = (
        f"{moved}{' ' if moved else ''}The records, not the machine: what is left is "
        f"{_ratio(facts.first):.3g} times the sum of squares of noise.{_noise(facts)}"
    )
    return _silent(facts, Verdict.DATA_PROBLEM, text, refused)


def _noise(facts: Facts) -> str:
    """Sentences about channels whose residual is not correlated in time."""
    return "".join(f" {u.text}" for u in facts.uncorrelated)


def _with_a_gap(belief: Posterior) -> Posterior:
    """The posterior if more than noise is left without effects: this is an unknown cause."""
    return replace(belief, none=0.0, other=belief.none + belief.other)


#: Statement about parameters of which none moved for certain by itself.
TOGETHER = (
    "No single parameter for certain, but all of them together close the gap that the tabulated "
    "numbers leave."
)


def _calibrated(facts: Facts) -> Decision:
    """Decision without a gap: the model as tabulated, or with calibrated parameters."""
    fit = facts.search.model_fit
    ratio = f"sum of squares {fit.chi2 / fit.dof:.2f} of its expectation"
    rest = f"{ratio}, largest score family-wise p = {facts.p:.2g}"
    what = "less than the specified good_enough" if facts.enough else f"noise ({rest})"
    told = prior_deviations_told(fit)
    but = f" But {told}." if told else ""
    sure = [r for r in facts.calibrated if r.sure]
    if not facts.apart and not sure:
        by_chance = ""
        if facts.calibrated:
            by_chance = (
                f" {len(facts.calibrated)} of {len(of_the_machine(fit))} parameters moved by more"
                " than two standard deviations of their estimates, which noise alone can cause."
            )
        having = " and ".join(g.text for g in facts.given if g.differs)
        own = f", with {having}" if having else ""
        text = f"The model explains the records as it is tabulated{own}: what is left is {what}."
        return _silent(facts, Verdict.NO_GAP, text + by_chance + but)
    text = _moved(facts)
    if not sure:
        text = f"{TOGETHER} {text}".strip()
    having = " and ".join(g.text for g in facts.given if g.differs)
    own = f" The model has {having}." if having else ""
    nothing = f"Nothing {'else ' if having else ''}is missing: what is left is {what}."
    text = f"{_another(facts, complete=True)}{text}{own} {nothing}"
    return _silent(facts, Verdict.CALIBRATED, text + but)


def _moved(facts: Facts) -> str:
    """Sentences about the parameters that calibration changed; empty: no significant change."""
    sure = [r for r in facts.calibrated if r.sure]
    if not facts.apart and not sure:
        return ""
    moved = sure or list(facts.calibrated)
    if not moved:
        return ""
    # What exceeds its tolerance tells more of the machine than what closes the gap.
    beyond = sorted((r for r in moved if r.beyond), key=lambda r: -abs(r.prior_deviations or 0.0))
    large = [r for r in moved if r.share >= LARGE_MOVE and not r.beyond]
    large = [*beyond[: 3 if large else 4], *large][:4] or moved[:1]
    text = "; ".join(r.text + r.notes for r in large) + "."
    others = [r for r in moved if r not in large]
    if others:
        less = max(r.share for r in others) <= min(r.share for r in large)
        what = ", by less of the gap" if less else ""
        text += f" {len(others)} more parameter{'s' if len(others) > 1 else ''} moved{what}."
    return text


def _another(facts: Facts, *, complete: bool = False) -> str:
    """Sentence: this may be another machine, because several parameters exceed their tolerances.

    ``complete``: apart from these parameters, no effect is missing.
    """
    far = [r for r in facts.calibrated if r.beyond]
    if len(far) < 2:
        return ""
    count = f"{len(far)} parameters are beyond their tolerances"
    other = "another machine, or another state of it (parts, regulation)"
    if complete:
        return (
            f"The model as a whole is not the machine that was measured: {count}. The records are "
            f"of {other}, or these parameters compensate an effect that is not in the library. "
        )
    return (
        f"{count}: the records may be of {other}, or these parameters compensate what the model "
        "lacks. "
    )


def first_scored(scores: Scores) -> str:
    """Sentence about the candidate with the largest score, if none was refitted."""
    singles = scores.singles()
    if not np.max(singles, initial=0.0) > 0.0:
        return ""
    first = int(np.argmax(singles))
    effect = scores.candidates[first].effect
    size = float(scores.one_step()[first]) * effect.scale
    factor, shown = readable_unit(size, effect.unit)
    return (
        f" No effect was refitted. By its score, the first candidate is {effect.name} of "
        f"{factor * size:.3g}{unit_suffix(shown)}."
    )


def _closest(closest: Closest | None) -> str:
    """Sentence about the closest tested set."""
    if closest is None:
        return ""
    rows = []
    for name, size, unit in zip(closest.effects, closest.magnitudes, closest.units, strict=True):
        factor, shown = readable_unit(size, unit)
        rows.append(f"{name} of {factor * size:.3g}{unit_suffix(shown)}")
    sizes = ", ".join(rows)
    text = f" The closest is {sizes}: {closest.closing('it', 'the held-out gap', 'would close')}"
    if not closest.why:
        return f"{text}."
    return f"{text}{'; it' if closest.no_gap else ', but'} is not proven: {closest.why}."


def _refuted(facts: Facts) -> bool:
    """Whether the records refute the model, whatever the cause."""
    return facts.misfit.left or facts.p <= refuted(facts.options.alpha)


def _silent(facts: Facts, verdict: Verdict, text: str, refused: Collection[str] = ()) -> Decision:
    """A decision that names no effect.

    Sets with an effect that held-out records refuse, or with one of ``refused``, are no
    explanation: their probability is that of an unknown cause.
    """
    bad = {*refused, *(name for name, _ in facts.accepted.rejected)}
    sums = zip(facts.search.sets, facts.belief.sets, strict=True)
    kept = tuple(0.0 if bad & set(c.names) else w for c, w in sums)
    unknown = facts.belief.other + sum(facts.belief.sets) - sum(kept)
    belief = replace(facts.belief, other=unknown, sets=kept)
    confidence = {
        Verdict.NO_GAP: belief.none,
        Verdict.CALIBRATED: belief.none,
        Verdict.UNKNOWN: belief.other,
        Verdict.DATA_PROBLEM: belief.other,
        Verdict.TOO_WEAK: 1.0 - belief.none,
    }[verdict]
    return Decision(verdict, text, (), (), confidence, belief)


def _name(facts: Facts) -> Decision:
    accepted = facts.accepted
    best = accepted.best
    assert best is not None
    data = {t.name for t in best.fit.included if t.effect.kind in OF_RECORDS}
    sets = [set(best.names), *(set(r.names) for r in accepted.rivals)]
    sure = tuple(n for n in best.names if all(n in s for s in sets))
    # If rivals are as good as the best set, rounding must not determine their order.
    as_good = [set(r.names) for r in accepted.rivals if r.evidence > best.evidence - SAME]
    first = set(best.names).union(*as_good)
    unsure = sorted(set().union(*sets) - set(sure), key=lambda n: (n not in first, n))
    sure, unsure = _probable(facts, sure, unsure)
    sums = list(zip(facts.search.sets, facts.belief.sets, strict=True))
    if sure:
        confidence = sum(w for c, w in sums if all(n in c.names for n in sure))
    else:
        confidence = sum(w for c, w in sums if set(c.names) & set(unsure))
    # If the sure effects alone may be all, the others are a possibility and not a statement.
    beside = sum(w for c, w in sums if set(sure) < set(c.names) and set(unsure) & set(c.names))
    possible: list[str] = []
    if sure and (set(sure) in sets or beside < facts.options.credibility):
        possible, unsure = unsure, []
    if confidence < facts.options.credibility:
        why = f"posterior {confidence:.2f}, expected {facts.options.credibility:g} at least"
        return _unsure(facts, sure or tuple(unsure), why)
    far = facts.how_far
    after = misfit(
        best.fit,
        facts.rest,
        alpha=facts.options.alpha,
        estimated=facts.checks.estimated,
        allowed=form_of(best.evidence - facts.search.tight_evidence, facts.options.form),
    )
    fitted = after.left or facts.unexplained
    # If more than noise is left, an effect that explains less than remains may only resemble the
    # cause; unless what remains is not correlated in time, which no cause in the machine is.
    resembles = fitted and not (facts.enough_left or facts.only_noise)
    # A gap that grows within the uncertainty of the fitted parameters refutes nothing.
    grows = _widens(far) and not accepted.after.explains
    if grows or (resembles and _explained(far) < EXPLAINS_MOST):
        why = (
            f"the held-out gap grows{_band(far)}"
            if grows
            else "more than noise is left, and it explains less of the squared gap than remains"
        )
        return _unsure(facts, sure or tuple(unsure), why, refused=sure or tuple(unsure))
    # A score that remains beside unsure effects is theirs.
    scored = facts.leftover > 1.0 and not (unsure or possible)
    left = (fitted or scored or facts.beyond is not None) and not facts.enough_left
    closed = _closing(facts, sure or tuple(unsure))
    if left:
        what = "that held-out records confirm" if accepted.rejected else "tested"
        rest = f" What is left is {_largest_residual(facts)}; nothing {what} explains it."
        if not fitted and facts.beyond is not None:
            rest = (
                " What is left of the fitted records is noise, but the held-out ones show more: "
                f"fitted to them alone, {facts.beyond:.3g} times the sum of squares of noise "
                f"remains. {FIT_OTHERS}"
            )
        elif not fitted:
            rest = (
                " What is left is no larger than noise, but another effect still has a score of "
                f"{facts.leftover:.2g} times its threshold; nothing {what} explains it."
            )
    else:
        rest = " What is left is noise."
    told, others = listed(map(facts.sizes.text, sure)), listed(map(facts.sizes.text, unsure))
    if not sure:
        verdict = Verdict.ONE_OF
        text = f"One of {others}; these records cannot tell which. {closed}"
    elif all(n in data for n in (*sure, *unsure, *possible)) and not left:
        # With an unexplained residual, the text must not state that the machine is as modeled.
        verdict = Verdict.DATA_PROBLEM
        drive = any(t.effect.kind == "input" for t in best.fit.included)
        cause = "The records or the drive" if drive else "The records"
        text = f"{cause}, not the machine: {told}. {closed}"
    else:
        verdict = Verdict.NAMED_RESIDUAL if left or unsure else Verdict.NAMED
        where = "records show" if all(n in data for n in sure) else "model lacks"
        text = f"The {where}: {told}. {closed}"
    if sure and unsure:
        text += f" In addition, one of {others}, which these records cannot tell apart."
        rest = rest if left else " What is left with it is noise."
    if possible:
        which = ("one of " if len(possible) > 1 else "") + listed(map(facts.sizes.text, possible))
        text += f" These records do not determine whether {which} acts in addition."
    if left and sure:
        rest += " The named effects may imitate a cause that the library does not have."
    if left:
        rest += _noise(facts)
    if left and (far_off := prior_deviations_told(best.fit, facts.sizes.spread(best.fit))):
        rest += f" In addition, {far_off}: they may compensate a part of the gap."
    for name in sure:
        if words := facts.sizes.mechanism(name):
            rest += f" {name}: {words}"
    text = _another(facts) + text
    return Decision(verdict, text + rest, sure, tuple(unsure), confidence, facts.belief)


def _probable(
    facts: Facts, sure: tuple[str, ...], unsure: list[str]
) -> tuple[tuple[str, ...], list[str]]:
    """Split the effects of the best set if all of them together are not probable enough.

    The most probable effects whose joint probability suffices remain sure. The others of the most
    probable sets, together as probable as a name must be, are unsure.
    """
    sums = list(zip(facts.search.sets, facts.belief.sets, strict=True))
    enough = facts.options.credibility

    def joint(names: Iterable[str]) -> float:
        return sum(w for c, w in sums if set(names) <= set(c.names))

    if joint(sure) >= enough:
        return sure, unsure
    kept: list[str] = []
    for name in sorted(sure, key=lambda n: -joint([n])):
        if joint([*kept, name]) < enough:
            break
        kept.append(name)
    if not kept:
        return sure, unsure
    others = [n for n in sure if n not in kept] + unsure
    total = 0.0
    for c, w in sorted(sums, key=lambda x: -x[1]):
        if total >= enough:
            break
        if not set(kept) <= set(c.names):
            continue
        total += w
        others += [n for n in c.names if n not in kept]
    return tuple(n for n in sure if n in kept), list(dict.fromkeys(others))


def _widens(far: HowFar) -> bool:
    """Whether the gap on held-out records grows significantly."""
    return far.high < 0.0 and far.after > NO_GAP_RATIO * far.before


def _explained(far: HowFar) -> float:
    """Share of the squared held-out gap that is explained; 1 if it is hardly above the noise."""
    if not NO_GAP_RATIO < far.before < math.inf:
        return 1.0
    return explained_share(far.before, far.after)


def _band(far: HowFar) -> str:
    """95 % interval of the closed share, if it contains a growth of the gap."""
    return f", {far.band_text}" if far.low < 0.0 else ""


def _closing(facts: Facts, names: tuple[str, ...]) -> str:
    """Sentence: the change of the held-out gap by these effects."""
    far = facts.how_far
    if not math.isfinite(far.before):
        return "The model cannot simulate the held-out records to their end."
    gains = {n: g for n, g in facts.accepted.proof.items() if n in names}
    odds = least_odds(facts.options.credibility)
    weak = [n for n in names if n in gains and gains[n] < odds]
    doubt = ""
    if weak:
        one = len(weak) == 1
        least = f"{min(gains[n] for n in weak):.2g} units of log evidence"
        doubt = (
            f"Held-out records hardly show {listed(weak)} "
            f"({least}{'' if one else ' or more each'}): "
            f"they neither confirm nor contradict {'it' if one else 'them'}. "
            f"Hold out a record in which {'it acts' if one else 'they act'}."
        )
        if len(weak) == len(gains):
            return doubt
        doubt = f" {doubt}"
    shown = [n for n in names if n in gains and n not in weak]
    if not shown and far.no_gap:
        return f"{sentence(far.closing('it', 'the held-out gap'))}{doubt}"
    closes = f"closes {far.closed_text} of the held-out gap{_band(far)}."
    if not shown or (not far.no_gap and far.low > 0.0):
        return f"It {closes}{doubt}"
    by = "or more by each" if len(shown) > 1 else f"by {shown[0] if weak else 'it'}"
    least = f"{min(gains[n] for n in shown):.2g} units of log evidence {by}"
    if far.no_gap:
        return f"Held-out records, whose gap is hardly above their noise, gain {least}.{doubt}"
    return f"Held-out records gain {least}; it {closes}{doubt}"


def _unsure(
    facts: Facts, hinted: tuple[str, ...], why: str, refused: tuple[str, ...] = ()
) -> Decision:
    """Decision if the best set is not certain enough to be named; ``refused``: it is refuted."""
    if _refuted(facts) and _only_noise(facts):
        return _data_problem(facts, hinted)
    if _refuted(facts):
        text = (
            f"There is a gap ({_signs(facts)}), but no effect is sure; nearest {listed(hinted)} "
            f"({why})."
        )
        closest = facts.closest and replace(facts.closest, why=facts.closest.why or why)
        if closest is not None and set(closest.effects) == set(hinted):
            text = f"There is a gap ({_signs(facts)}), but no effect is sure."
        text += _closest(closest) + (_noise(facts) or _place(facts))
        return replace(_silent(facts, Verdict.UNKNOWN, text, refused), closest=closest)
    return _too_weak(facts, f": nearest {listed(hinted)} ({why})", refused)


def _too_weak(facts: Facts, why: str, refused: tuple[str, ...] = ()) -> Decision:
    """Decision if a cause is likely, but not proven; ``why`` follows "cannot prove it"."""
    moved = _moved(facts)
    text = (
        f"{moved}{' ' if moved else ''}There may be something{' more' if moved else ''}, but these "
        f"records cannot prove it{why}. The model is not refuted."
    )
    return _silent(facts, Verdict.TOO_WEAK, text, refused)


def _signs(facts: Facts) -> str:
    """Evidence for a gap, as text: only what shows it."""
    ratio = f"the sum of squares is {_ratio(facts.first):.3g} times that of noise"
    signs = [ratio] if facts.misfit.far else []
    other = facts.misfit.other
    if other > unknown_gain(facts.options.alpha):
        if facts.first.bare.defect_sd.size:
            signs.append(f"unknown forces would gain {other:.3g} units of log evidence")
        else:
            signs.append(
                f"a smooth signal is more probable than noise, log Bayes factor {other:.3g}"
            )
    if facts.p <= refuted(facts.options.alpha):
        signs.append(f"p of the largest score is {facts.p:.1g}")
    return "; ".join(signs) or ratio


def _ratio(search: Search) -> float:
    fit = search.tight_fit or search.bare
    return fit.chi2 / fit.dof


def _largest_residual(facts: Facts) -> str:
    """Largest held-out residual of a channel relative to its noise, as text."""
    rows = [r for r in facts.how_far.rows if r.metric == facts.how_far.metric and r.noise > 0.0]
    if not rows:
        return "more than noise"
    worst = max(rows, key=lambda r: r.after / r.noise)
    return f"{worst.after / worst.noise:.3g} times the noise of {worst.channel}"


def _refusals(accepted: Accepted) -> str:
    return "; ".join(f"{name} ({why})" for name, why in accepted.rejected)


def _place(facts: Facts) -> str:
    """Sentences about the place of an unknown cause, and about what it resembles."""
    text = ""
    where = facts.where
    strong = [c for c in where.components if c.significant]
    if strong:
        text = f" {strong[0].text}."
    if name := facts.belief.like:
        text += (
            f" A cause that acts like {name}, but with another law, explains the fitted records "
            f"better than {name}: its magnitude would differ between records, or parts of them."
        )
    return " ".join([text, *where.hints]) if where.hints else text
