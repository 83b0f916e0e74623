"""The set of causes that the answer shows: what the evidence or the held-out records need.

There is one set. A member stays if the evidence of all records needs it, or if it surely improves
the prediction of records that were not fitted; it leaves if neither holds, if they surely refuse
it, or if its size differs between records by more than what matters. After each removal the rest
is fitted again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import Fitted, best_of, log_odds
from unmodeled.search.held_out import Predicted, Ratio, compare, predict
from unmodeled.search.ledger import SAME
from unmodeled.search.options import Options
from unmodeled.search.problem import STRICT, Problem, spread
from unmodeled.search.progress import Stop, interrupted
from unmodeled.search.score import by_record, index_of
from unmodeled.search.search import Searched, linked, rank, with_all_records, without_one

#: Number of sets that are fitted to all records; probability, or odds to the best one, below which
#: a set is not possible.
PREDICTED, UNLIKELY = 8, 1e-3
#: Number of single causes that are fitted to all records, however probable: a larger set may follow
#: the fitted records better, and predict the others worse.
SINGLE = 4
#: Probability of a set above which the sets without one of its members are fitted.
POSSIBLE = 0.01
#: Log of the ratio of the held-out residuals without and with a member that it must surely exceed.
WORTH = math.log(1.05)

Predictions = dict[tuple[int, ...], Predicted | None]


@dataclass(frozen=True)
class Need:
    """Why a member of a set is needed, or not."""

    evidence: float = math.nan
    """Log odds of the set and the set without it; NaN: that one was not fitted."""
    held_out: Ratio | None = None
    """Held-out residuals without it over those with it; None: they are not known."""
    fails: bool = False
    """Whether the model cannot be simulated without it."""
    differs: float = 1.0
    """Probability that its size is the same in all records, as far as differences matter [1]."""
    left: bool = False
    """Whether it has left the set."""
    over_matters: float = math.nan
    """What it takes away in the held-out records, over what matters [1]."""

    @property
    def predicts(self) -> bool:
        """Whether held-out records surely need it, by more than what matters."""
        return self.fails or (
            self.held_out is not None and self.held_out.low > WORTH and self.over_matters > 1.0
        )

    @property
    def refused(self) -> bool:
        """Whether held-out records are surely predicted worse with it."""
        return self.held_out is not None and self.held_out.high < 0.0


@dataclass(eq=False)
class Chosen:
    """The chosen set, and all sets that it was compared with."""

    searched: Searched
    """Sets fitted without the held-out records."""
    everything: Searched
    """Sets fitted to all records."""
    predicted: Predictions
    best: Fitted
    """The chosen set, fitted to all records."""
    needs: dict[int, Need] = field(default_factory=dict)
    """By cause: of the members of the set, and of those that left it."""
    worse_than_mean: bool = False
    """Whether a set was refused because the mean of a channel predicts it better."""
    calibration_worse: bool = False
    """Whether the calibrated model predicts held-out records surely worse than the tabulated."""

    @property
    def problem(self) -> Problem:
        """The problem of all records."""
        return self.everything.problem

    @property
    def alone(self) -> Fitted:
        """The model without causes."""
        return self.everything.sets[()]


def choose(
    searched: Searched, options: Options, check: Callable[[], None] = lambda: None
) -> Chosen:
    """The set that the answer shows.

    Parameters
    ----------
    searched
        The sets of the search.
    options
        Credibility, and what matters.
    check
        Is called before each simulation of all fits that proceed together; it may raise ``Stop``:
        the answer is then that of the fits so far.
    """
    problem, worse = searched.problem, False
    predicted: Predictions = {}
    strict = replace(problem, discrepancy_samples=STRICT)
    everything = Searched(strict, dict(searched.sets), first=searched.first)
    everything.ended_by = searched.ended_by
    if problem.held_out:
        everything, predicted, worse = _with_held_out(searched, everything, check)
    out = Chosen(searched, everything, predicted, everything.sets[()], calibration_worse=worse)
    if everything.ended_by is None:
        try:
            _pruned_from_all(out, options, check)
        except (Stop, KeyboardInterrupt) as stop:
            everything.ended_by = stop
    if everything.ended_by is not None:
        _best_so_far(out, options)
    searched.ended_by = everything.ended_by
    return out


def _with_held_out(
    searched: Searched, known: Searched, check: Callable[[], None]
) -> tuple[Searched, Predictions, bool]:
    """The most probable sets fitted to all records, and their predictions.

    Third: whether the calibrated model predicts surely worse than the tabulated one.
    """
    problem, sets = searched.problem, list(searched.sets.values())
    some: dict[tuple[int, ...], Fitted] = {(): searched.sets[()]}
    (ranked, weight), strict = rank(problem, sets), rank(known.problem, sets)
    for order, w_of in ((ranked, weight), strict):
        some |= {s.causes: s for s, w in zip(order[:PREDICTED], w_of, strict=False) if w > UNLIKELY}
    some |= {s.causes: s for s in [s for s in ranked if len(s.causes) == 1][:SINGLE]}
    best = ranked[0]
    for s in sets:  # what was exchanged for members of the best set
        apart = {*s.causes} ^ {*best.causes}
        if len(apart) == 2 and apart <= linked(searched.alike, min(apart)):
            some[s.causes] = s
    alone = some[()]
    tabulated = replace(alone, point=replace(alone.point, x=np.zeros_like(alone.point.x)))
    predicted: Predictions = {}
    try:
        *found, before = predict(problem, [*some.values(), tabulated], check)
        predicted = dict(zip(some, found, strict=True))
        everything = with_all_records(searched, list(some.values()), found, check)
    except (Stop, KeyboardInterrupt) as stop:
        known.ended_by = stop
        return known, predicted, False
    after = predicted[()]
    worse = (
        after is not None
        and before is not None
        and compare(after, before, alone.noise, alone.effective).low > 0.0
    )
    return everything, predicted, worse


def _pruned_from_all(out: Chosen, options: Options, check: Callable[[], None]) -> None:
    """From the most probable set to sets that surely predict better, each without its idle members.

    Of several, the most probable one is next; the first that is no better without what it does not
    need ends the climb.
    """
    _fit_smaller(out, check)
    first = best_of(out.problem, list(out.everything.sets.values()))
    best, needs = _pruned(out, first, options, check)
    seen = {best.causes}
    while (rival := _rival(out, best, first, options)) is not None:
        rival, other = _pruned(out, rival, options, check)
        ratio = _ratio(out, best.causes, rival.causes, rival)
        odds = log_odds(out.problem, rival, best)
        better = ratio.low > WORTH and _possible(out, rival, first, options)
        if rival.causes in seen or not (better or (ratio.high >= -WORTH and odds > 0.0)):
            needs = {**other, **needs}
            break
        seen.add(rival.causes)
        best, needs = rival, {**needs, **other}
    if best.causes and _worse_than_constant(out, best):
        best, out.worse_than_mean = out.alone, True
        needs = {i: replace(n, left=True) for i, n in needs.items()}
    out.best, out.needs = best, needs


def _possible(out: Chosen, rival: Fitted, first: Fitted, options: Options) -> bool:
    """Whether a set that predicts better may be chosen in place of the most probable one.

    It adds to it, or is not surely less probable.
    """
    adds = {*first.causes} <= {*rival.causes}
    return adds or log_odds(out.problem, rival, first) > -_sure(options)


def _rival(out: Chosen, best: Fitted, first: Fitted, options: Options) -> Fitted | None:
    """The most probable possible set that surely predicts better; None: there is none.

    The same laws in other records have to be more probable: a size of its own is fitted to a
    record that is held out, too.
    """
    problem = out.problem
    ranked = rank(problem, list(out.everything.sets.values()))[0]
    laws = problem.families_of(best.causes)
    for s in ranked:
        known = out.predicted.get(s.causes) is not None
        if problem.families_of(s.causes) == laws and log_odds(problem, s, best) < 0.0:
            continue
        better = known and _ratio(out, best.causes, s.causes, s).low > WORTH
        if better and _possible(out, s, first, options):
            return s
    return None


def _fit_smaller(out: Chosen, check: Callable[[], None]) -> None:
    """Fit the sets without one member of a possible set from the parameters of this one.

    Possible sets whose held-out records are not known yet are predicted.
    """
    ranked, weight = rank(out.problem, list(out.everything.sets.values()))
    possible = [s for s, w in zip(ranked, weight, strict=True) if w > POSSIBLE]
    for s in possible:
        without_one(out.everything, s, check)
    problem, fitted = out.searched.problem, out.searched.sets
    if problem.held_out:
        known = [s.causes for s in possible if s.causes not in out.predicted]
        new = [fitted[causes] for causes in known if causes in fitted]
        for f, p in zip(new, predict(problem, new, check), strict=True):
            out.predicted[f.causes] = p


def _sure(options: Options) -> float:
    """Log odds of the credibility."""
    return math.log(options.credibility / (1.0 - options.credibility))


def _pruned(
    out: Chosen, now: Fitted, options: Options, check: Callable[[], None]
) -> tuple[Fitted, dict[int, Need]]:
    """A set without the members that are not needed, and why each stays or left."""
    left: dict[int, Need] = {}
    enough = _sure(options)
    while now.members:
        needs = _needs(out, now, options, check)
        leaves = {
            i: n
            for i, n in needs.items()
            if n.differs < SAME
            or n.refused
            or not (n.predicts or n.evidence >= enough or math.isnan(n.evidence))
        }
        if not leaves:
            return now, {**left, **needs}
        out_of = min(leaves, key=lambda i: (leaves[i].differs >= SAME, leaves[i].evidence))
        left[out_of] = replace(leaves[out_of], left=True)
        rest = out.everything.sets.get(tuple(i for i in now.causes if i != out_of))
        if rest is None:  # it cannot be fitted
            return now, {**left, **needs}
        now = rest if leaves[out_of].differs >= SAME else _next(out, rest, left)
    return now, left


def _next(out: Chosen, rest: Fitted, left: Mapping[int, Need]) -> Fitted:
    """The most probable set without what has left: another law may be the same in all records.

    ``rest``: the set without the last member that left.
    """
    sets = [s for s in out.everything.sets.values() if not {*left} & {*s.causes}]
    return best_of(out.problem, [rest, *sets])


def _needs(
    out: Chosen, now: Fitted, options: Options, check: Callable[[], None]
) -> dict[int, Need]:
    """Why each member of a set is needed; the sets without it are fitted and predicted."""
    smaller = without_one(out.everything, now, check)
    if out.searched.problem.held_out:
        _predict_smaller(out, now, check)
    found = {}
    for cause, rest in zip(now.causes, smaller, strict=True):
        if rest is None:
            found[cause] = Need(math.inf, None, fails=True)
            continue
        known = {now.causes, rest.causes} <= {k for k, v in out.predicted.items() if v is not None}
        found[cause] = Need(
            log_odds(out.problem, now, rest),
            _ratio(out, rest.causes, now.causes, now) if known else None,
            differs=differences(out.problem, now, cause, options),
            over_matters=_over_matters(out, rest, now, options) if known else math.nan,
        )
    return found


def _over_matters(out: Chosen, rest: Fitted, now: Fitted, options: Options) -> float:
    """What a member takes away in the held-out records, over what matters [1]."""
    problem = out.searched.problem
    without, with_it = out.predicted[rest.causes], out.predicted[now.causes]
    assert without is not None
    assert with_it is not None
    taken = np.sqrt(np.maximum(without.rms(problem) ** 2 - with_it.rms(problem) ** 2, 0.0))
    return float(np.max(taken / what_matters(out.problem, options)))


def _predict_smaller(out: Chosen, now: Fitted, check: Callable[[], None]) -> None:
    """Fit the set and those without one member to the fitted records, and predict the others."""
    searched = out.searched
    own = searched.sets.get(now.causes)
    if own is None:
        return
    some = [own, *(f for f in without_one(searched, own, check) if f is not None)]
    new = [f for f in some if f.causes not in out.predicted]
    for f, p in zip(new, predict(searched.problem, new, check), strict=True):
        out.predicted[f.causes] = p


def _ratio(out: Chosen, one: tuple[int, ...], other: tuple[int, ...], of: Fitted) -> Ratio:
    """Held-out residuals of one set over those of another one."""
    a, b = out.predicted.get(one), out.predicted.get(other)
    if a is None or b is None:
        return Ratio(math.inf if a is None and b is not None else 0.0)
    return compare(a, b, of.noise, of.effective)


def _worse_than_constant(out: Chosen, best: Fitted) -> bool:
    """Whether the mean of a channel would predict the held-out records better.

    Not if a record shows noise only: at rest, no model is better than the mean.
    """
    predicted, problem = out.predicted.get(best.causes), out.searched.problem
    if predicted is None:
        return False
    least = np.maximum(spread(problem.held_out), 2.0 * problem.noise)
    return bool(np.any(predicted.rms(problem) > least))


def _best_so_far(out: Chosen, options: Options) -> None:
    """The most probable of the sets that were fitted until the search ended."""
    out.best = rank(out.problem, list(out.everything.sets.values()))[0][0]
    for i in out.best.causes:
        rest = out.everything.sets.get(tuple(k for k in out.best.causes if k != i))
        evidence = math.nan if rest is None else log_odds(out.problem, out.best, rest)
        differs = differences(out.problem, out.best, i, options)
        out.needs[i] = Need(evidence, None, differs=differs)
    if out.searched.problem.held_out and not interrupted(out.everything.ended_by):
        lost = {(), out.best.causes} - out.predicted.keys()
        sets = [s for k, s in out.searched.sets.items() if k in lost]
        found = predict(out.searched.problem, sets)  # a few runs after the limit
        out.predicted |= {s.causes: p for s, p in zip(sets, found, strict=True)}


def differences(problem: Problem, fitted: Fitted, cause: int, options: Options) -> float:
    """Probability that a magnitude is the same in all records; 1: differences do not matter.

    Differences that move no channel of a record by more than its noise, or leave less than what
    matters, are none, however many samples show them.
    """
    own = problem.causes[cause]
    if own.local is not None or own.records or len(problem.fit) < 2:
        return 1.0
    from scipy.special import chdtrc

    k = index_of(problem, fitted.members, cause)
    values, covariance = by_record(problem, fitted, k)
    inverse = np.linalg.inv(covariance)
    apart = values - (inverse @ values).sum() / inverse.sum()
    enough = what_matters(problem, options)
    for d, x, o in zip(apart, fitted.linears, problem.fit, strict=True):
        count = np.maximum(o.samples, 1.0)
        moved = np.sqrt(((d * x.by_global[..., k]) ** 2).sum(axis=0) / count)
        in_unit = np.sqrt(((d * x.by_global[..., k] * o.sd) ** 2).sum(axis=0) / count)
        # Sizes of their own would take away no more than what is left.
        left = np.sqrt(((x.residual * o.sd) ** 2).sum(axis=0) / count)
        if np.any((moved > fitted.noise) & (np.minimum(in_unit, left) > enough)):
            return float(chdtrc(len(values) - 1, apart @ inverse @ apart))
    return 1.0


def what_matters(problem: Problem, options: Options) -> Array:
    """Residual from which on it matters by channel [its unit], (m,)."""
    rows = zip(problem.names, problem.units, problem.compared, strict=True)
    return np.array([max(options.matters(*row), 1e-300) for row in rows])
