"""Search for the sets of causes that explain the records: add, drop, exchange.

Every smaller set gets the same chance as a larger one: it is also fitted from the parameters of the
larger set. A cause is then never named because the fit without it had not converged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from unmodeled.data import Array
from unmodeled.errors import InvalidParameter
from unmodeled.search.evidence import Fitted, best_of, log_odds
from unmodeled.search.fit import (
    CONVERGED,
    PARTS,
    POOR,
    Start,
    empty_point,
    first_step,
    fit_local,
    fit_sets,
    noise_left,
    run_in_lockstep,
)
from unmodeled.search.held_out import Predicted
from unmodeled.search.linear import (
    EvaluationRequest,
    Linear,
    Point,
    evaluate,
    local_of,
    shapes_of,
    unknowns_of,
)
from unmodeled.search.options import Options
from unmodeled.search.problem import STRICT, Member, Members, Observed, Problem
from unmodeled.search.progress import ENDS, Limit, Stop, interrupted
from unmodeled.search.score import (
    NEARLY,
    Directions,
    Score,
    alike_before,
    directions,
    equivalents,
    index_of,
    nearly_alike,
    pairs,
    parameters_by_record,
    scores,
)
from unmodeled.search.steps import RADIUS

#: Log evidence that a larger set must gain; an exchange must gain what a fit may miss.
WORTH = 0.5
#: Largest deviation of a parameter, in standard deviations, at which the tabulated model is near.
MOVED = 1.0


#: Members, the fit from which the fit of a set begins, and scores of what that one lacks.
Job = tuple[Members, Fitted, Sequence[Score]]


@dataclass(eq=False)
class Searched:
    """All fitted sets of a search."""

    problem: Problem
    sets: dict[tuple[int, ...], Fitted] = field(default_factory=dict)
    tried: set[tuple[tuple[int, ...], int]] = field(default_factory=set)
    first: list[Score] = field(default_factory=list)
    """Scores at the fit of the model alone."""
    directions: Directions | None = None
    """Directions at this fit."""
    alike: list[frozenset[int]] = field(default_factory=list)
    """Pairs of causes with the same columns in a set."""
    grown: bool = False
    """Whether the search tried all that it would add to the best set."""
    rounds: int = 0
    """Rounds of simulations that the search took."""
    ended_by: BaseException | None = None
    """``Stop`` or ``KeyboardInterrupt``, if one ended the search before its end."""
    answer: tuple[Problem, Fitted, Fitted] | None = None
    """What the verdict tells: the problem, the model alone, and the set of the answer."""

    def ranked(self) -> tuple[list[Fitted], Array]:
        """Sets in the order of their posterior probability, and these probabilities."""
        return rank(self.problem, list(self.sets.values()))


def rank(problem: Problem, sets: Sequence[Fitted]) -> tuple[list[Fitted], Array]:
    """Sets in the order of their posterior probability, and these probabilities."""
    best = best_of(problem, sets)
    values = np.array([log_odds(problem, s, best) for s in sets])
    order = np.argsort(-values, kind="stable")
    weight = np.exp(values[order] - values[order[0]])
    return [sets[k] for k in order], weight / weight.sum()


def search(
    problem: Problem,
    options: Options,
    tell: Callable[[str], None] = lambda _: None,
    step: Callable[[], None] = lambda: None,
) -> Searched:
    """Search the sets of causes.

    ``tell`` is called with the stage, and ``step`` before each simulation.

    Raises
    ------
    InvalidParameter
        The model alone cannot be simulated.
    """
    begin = time.monotonic()
    now = model_alone(problem, step)
    found = Searched(problem)
    _keep(found, [now])

    def limit(stage: str) -> Limit:
        most = None if options.rounds is None else round(ENDS[stage] * options.rounds)
        return Limit(begin + ENDS[stage] * options.seconds, step, most=most)

    own, last = limit("search"), limit("exchange")
    try:
        _Climb(found, now, options, own).run(tell)
    except (Stop, KeyboardInterrupt) as stop:
        found.ended_by = stop
        if not interrupted(stop):
            _keep_smaller(found)
    if not interrupted(found.ended_by):  # the limit of time tells no cause from its equivalents
        last.steps = own.steps
        try:
            _exchange_alike(problem, found, last)
        except (Stop, KeyboardInterrupt) as stop:
            found.ended_by = stop
    found.rounds = max(own.steps, last.steps)
    return found


def _keep(found: Searched, fits: Sequence[Fitted | None]) -> None:
    """Keep the best fit of every set."""
    for fitted in fits:
        if fitted is None:
            continue
        old = found.sets.get(fitted.causes)
        if old is None or log_odds(found.problem, fitted, old) > 0.0:
            found.sets[fitted.causes] = fitted


def _keep_smaller(found: Searched) -> None:
    """Keep the sets with one cause less than the best one, and with none, also as they are there.

    At the limit of time they were not fitted from its parameters: a cause whose set without it is
    as good with these is not needed.
    """
    problem, now = found.problem, found.ranked()[0][0]
    if not now.members:
        return
    less = [tuple(m for m in now.members if m is not out) for out in now.members]
    asked = [
        EvaluationRequest(rest, start_from(problem, rest, now).points[0], problem.fit)
        for rest in dict.fromkeys([*less, ()])
    ]
    for ask, linears in zip(asked, evaluate(problem, asked), strict=True):
        if not any(x.failed for x in linears):
            noise = noise_left(problem, linears)
            _keep(found, [Fitted(ask.members, ask.point, tuple(linears), noise)])


def model_alone(
    problem: Problem, step: Callable[[], None] = lambda: None, rough: bool = False
) -> Fitted:
    """Fit of the model without causes.

    If the first step does not gain what it promises, or a start is not known, growing parts of the
    records are fitted: the end of a record depends more strongly on the unknowns than its
    beginning, so that a fit of whole records from poor values may end far from the best one.

    ``rough``: whether the end of the fit does not matter.

    Raises
    ------
    InvalidParameter
        The model cannot be simulated.
    """
    point, fitted = empty_point(problem, (), problem.fit), None
    hidden = any(q.unknown for o in problem.fit for q in o.local)
    try:
        known = None if hidden else run_in_lockstep(problem, [first_step(problem, point)], step)[0]
        start = Start((), (point,), () if known is None else known)
        for part in (*(PARTS if known is None else ()), 1.0):
            cut = replace(problem, fit=tuple(o.first(part) for o in problem.fit))
            begin = [replace(start, points=(point,))]
            fitted = fit_sets(cut, begin, step, rough=rough or part < 1.0)[0]
            if fitted is not None:
                point = fitted.point
    except Stop as stop:  # there is nothing to answer with
        raise stop.__cause__ or stop from None
    if fitted is None:
        raise InvalidParameter(
            f"model {problem.model.name}: its simulation gives no finite outputs for the "
            "tabulated parameters, expected a model that can follow the records"
        )
    return fitted


def _tabulated(problem: Problem, alone: Fitted, step: Callable[[], None]) -> Fitted | None:
    """The tabulated model with fitted starts; None: it fails, or the fit has hardly moved."""
    if float(np.abs(alone.point.x).max(initial=0.0)) < MOVED:
        return None
    point = replace(alone.point, x=np.zeros_like(alone.point.x))
    every = np.ones(len(problem.channels))
    run = fit_local(problem, problem.fit, (), point, alone.noise, every, parts=PARTS)
    local: Fitted | None = run_in_lockstep(problem, [run], step)[0]
    if local is None:
        return None
    linears = evaluate(problem, [EvaluationRequest((), local.point, problem.fit)])[0]
    if any(x.failed for x in linears):
        return None
    return Fitted((), local.point, tuple(linears), noise_left(problem, linears))


def start_from(
    problem: Problem, members: Members, origin: Fitted, added: Sequence[Score] = ()
) -> Start:
    """Start of the fit of a set from the fit of another one.

    Parameters
    ----------
    problem, members
        The problem and the set.
    origin
        Fit of the other set.
    added
        Scores of the causes that the other set lacks.
    """
    base, new = origin.point, unknowns_of(problem, members)
    kept = {m.cause for m in members if m in origin.members}
    old = {
        key: j
        for j, key in enumerate(unknowns_of(problem, origin.members))
        if key[0] == "parameter" or key[1] in kept
    }
    x = np.array([base.x[old[key]] if key in old else 0.0 for key in new])
    same = kept == set(origin.causes) and all(
        local_of(problem, members, o) == local_of(problem, origin.members, o) for o in problem.fit
    )
    known: tuple[Linear, ...] = ()
    if len(added) == 1 and same and abs(added[0].step) <= RADIUS:
        known = _extended(problem, origin, added[0], [old.get(key, -1) for key in new], new)
    if not known:
        for s in added:
            if problem.causes[s.cause].local is None:
                x[index_of(problem, members, s.cause)] += s.step
    values = tuple(
        _carried(problem, o, origin.members, v, members)
        for o, v in zip(problem.fit, base.local, strict=True)
    )
    points = [Point(x, values)]
    if added and origin.effective < POOR:
        # A model that is far off moves its parameters: also from the tabulated ones, and with the
        # expected magnitude.
        plain = np.where([key[0] == "parameter" for key in new], 0.0, x)
        for s in added:
            if problem.causes[s.cause].effect is not None:
                low, high = problem.causes[s.cause].bounds
                at = index_of(problem, members, s.cause)
                plain[at] = np.clip(np.sign(s.step) or 1.0, low, high)
        points.append(Point(plain, values))
    return Start(members, tuple(points), known)


def _extended(
    problem: Problem,
    origin: Fitted,
    added: Score,
    old: Sequence[int],
    new: Sequence[tuple[str, int, int]],
) -> tuple[Linear, ...]:
    """Residuals and derivatives of a set with one more cause at the magnitude zero.

    ``old``: place of each unknown in the other set, -1: it is new. (): they are not known.
    """
    if problem.causes[added.cause].effect is not None and not added.columns:
        return ()
    out = []
    for r, linear in enumerate(origin.linears):
        columns = np.zeros((*linear.residual.shape, len(new)))
        for k, (at, key) in enumerate(zip(old, new, strict=True)):
            if at >= 0:
                columns[..., k] = linear.by_global[..., at]
            elif key[0] == "magnitude":
                columns[..., k] = added.columns[r]
        nothing = np.zeros((*linear.residual.shape, 0))
        out.append(Linear(linear.residual, columns, linear.by_local, nothing))
    return tuple(out)


def _carried(
    problem: Problem, observed: Observed, old: Members, values: Array, new: Members
) -> Array:
    """Unknowns of a record in a set, with the values that they have in another set.

    Hidden states have the numbers of their set, so that another set begins with their priors.
    """
    own = len(problem.model.states())
    known = {
        (q.kind, q.index): v
        for q, v in zip(local_of(problem, old, observed), values, strict=True)
        if old == new or q.kind != "start" or q.index < own
    }
    return np.array([known.get((q.kind, q.index), 0.0) for q in local_of(problem, new, observed)])


def _with(origin: Fitted, *added: Score) -> Members:
    """A set with more causes."""
    new = (Member(s.cause, s.shape) for s in added)
    return tuple(sorted((*origin.members, *new), key=lambda m: m.cause))


def refit(
    found: Searched, jobs: Sequence[Job], check: Callable[[], None] = lambda: None
) -> list[Fitted | None]:
    """Fit sets from others, each once from each, and keep the best fit of every set."""
    todo, problem = [], found.problem
    for members, origin, added in jobs:
        key = tuple(m.cause for m in members)
        if (key, origin.serial) in found.tried or found.sets.get(key) is origin:
            continue
        found.tried.add((key, origin.serial))
        todo.append(start_from(problem, members, origin, added))
    rivals = [best_of(problem, list(found.sets.values()))] if found.sets else []
    try:
        _keep(found, fit_sets(problem, todo, check, rivals))
    except Stop as stop:
        _keep(found, stop.fits)
        raise
    return [found.sets.get(tuple(m.cause for m in members)) for members, _, _ in jobs]


def linked(alike: Sequence[frozenset[int]], cause: int) -> set[int]:
    """Causes that stand for a cause, also by way of others."""
    found: set[int] = {cause}
    while more := {k for pair in alike if pair & found for k in pair} - found:
        found |= more
    return found


def without_one(
    found: Searched, fitted: Fitted, check: Callable[[], None] = lambda: None
) -> list[Fitted | None]:
    """Add every set with one cause less, fitted from the parameters of the larger set."""
    jobs: list[Job] = [
        (tuple(m for m in fitted.members if m is not out), fitted, ()) for out in fitted.members
    ]
    return refit(found, jobs, check)


def with_all_records(
    found: Searched,
    sets: Sequence[Fitted],
    predicted: Sequence[Predicted | None],
    check: Callable[[], None] = lambda: None,
) -> Searched:
    """The sets, fitted to all records, so that the held-out ones decide by the same likelihood.

    A set that cannot follow the held-out records is omitted. Then every smaller set gets the chance
    to start from the parameters of the best one. If the time is up, the fits are used as they are.

    Raises
    ------
    Stop
        The time is up before the model alone was compared with all records.
    """
    problem = found.problem
    everything = replace(
        problem, fit=(*problem.fit, *problem.held_out), held_out=(), discrepancy_samples=STRICT
    )
    out = Searched(everything, first=found.first, ended_by=found.ended_by)
    pairs = [(s, p) for s, p in zip(sets, predicted, strict=True) if p is not None]
    held = evaluate(
        problem, [EvaluationRequest(s.members, p.point, problem.held_out) for s, p in pairs]
    )
    starts = [
        Start(
            s.members,
            (Point(s.point.x, (*s.point.local, *p.point.local)),),
            (*s.linears, *further),
        )
        for (s, p), further in zip(pairs, held, strict=True)
    ]
    try:
        _keep(out, fit_sets(everything, starts, check))
    except Stop as stop:
        _keep(out, stop.fits)
        if () not in out.sets:
            raise
        out.ended_by = stop
        _keep_smaller(out)
        return out
    if () not in out.sets:
        raise InvalidParameter(
            f"model {problem.model.name}: its simulation of the held-out records gives no finite "
            "outputs, expected a model that can follow all records"
        )
    best = best_of(everything, list(out.sets.values()))
    smaller = [s for s in out.sets.values() if set(s.causes) < set(best.causes)]
    try:
        refit(out, [(s.members, best, ()) for s in smaller], check)
        _add_held_out_scopes(found, out, best_of(everything, list(out.sets.values())), check)
        without_one(out, best_of(everything, list(out.sets.values())), check)
    except Stop as stop:
        out.ended_by = stop
        _keep_smaller(out)
    return out


def _add_held_out_scopes(
    found: Searched, out: Searched, best: Fitted, check: Callable[[], None]
) -> None:
    """Add causes that act in held-out records only, where the best set follows all but these."""
    problem, everything = found.problem, out.problem
    left = [
        float(np.max((x.residual**2).sum(axis=0) / np.maximum(o.samples, 1.0)))
        for o, x in zip(everything.fit, best.linears, strict=True)
    ]
    shown = {o.number for o in problem.fit}
    own = [v for o, v in zip(everything.fit, left, strict=True) if o.number in shown]
    others = [v for o, v in zip(everything.fit, left, strict=True) if o.number not in shown]
    if not others or not max(others) > max(2.0**2, sum(own)):
        return
    check()
    seen = directions(everything, best)
    ranked = scores(everything, best, seen)
    new = [s for s in ranked if (r := everything.causes[s.cause].records) and not r & shown]
    jobs: list[Job] = [(_with(best, s), best, (s,)) for s in new[:4]]
    fits = [f for f in refit(out, jobs, check) if f is not None]
    if not fits:
        return
    now = best_of(everything, fits)
    (cause,) = {*now.causes} - {*best.causes}
    alike = [s for s, _ in equivalents(everything, now, seen, cause)]
    found.alike += [frozenset((cause, s.cause)) for s in alike]
    refit(out, [(_with(best, s), now, (s,)) for s in alike], check)


def _choose(problem: Problem, ranked: Sequence[Score], tries: int) -> list[Score]:
    """The first causes by score, and those that are nearly as good; errors of records: a half.

    Of the causes of some records, the first two, and their laws in all records: their equivalents
    are found later.
    """
    scoped = [s.cause for s in ranked if problem.causes[s.cause].family >= 0][2:]
    ranked = [s for s in ranked if s.cause not in scoped]
    best = max((s.gain for s in ranked), default=0.0)
    count = max(tries, sum(s.gain > NEARLY * best for s in ranked))
    of_records = [s.cause for s in ranked if problem.causes[s.cause].of_records]
    too_many = set(of_records[(count + 1) // 2 :])
    chosen = [s for s in ranked if s.cause not in too_many][:count]
    laws = {problem.causes[s.cause].family for s in chosen} - {s.cause for s in chosen}
    return [*chosen, *(s for s in ranked if s.cause in laws)]


class _Climb:
    """Adds the best of some causes, drops those that are not needed any more, and so on.

    When nothing more gains, each cause of the set is exchanged for those that resemble it.
    """

    def __init__(
        self, found: Searched, now: Fitted, options: Options, check: Callable[[], None]
    ) -> None:
        self.found, self.now, self.options, self.check = found, now, options, check
        self.problem = found.problem
        self._strict = replace(found.problem, discrepancy_samples=STRICT)
        self._scored: dict[int, tuple[list[Score], Directions]] = {}

    def run(self, tell: Callable[[str], None]) -> None:
        """The whole climb; ``tell`` is called with the stage."""
        tell("search")
        while len(self.now.members) < self.options.max_effects:
            before = self.now
            if not self._add():
                break
            self._drop(before)
            if self.now.causes == before.causes and self._gain(self.now, before) <= 0.0:
                break
        self.found.grown = True
        while self.now.members:
            tell("exchange")
            if not self._exchange():
                break
        if self.now.members:
            self._fit([((), self.now, ())])

    def _gain(self, s: Fitted, over: Fitted) -> float:
        return log_odds(self.problem, s, over)

    def _fit(self, jobs: Sequence[Job]) -> list[Fitted]:
        return [f for f in refit(self.found, jobs, self.check) if f is not None]

    def _less(self, origin: Fitted) -> list[Fitted]:
        return [f for f in without_one(self.found, origin, self.check) if f is not None]

    def _in_all_records(self, origin: Fitted) -> list[Fitted]:
        """The sets in which a cause of some records, or of each by itself, acts in all of them.

        They are fitted from this set, and from those with one cause less: what differs between
        records may have led far from the fit in which nothing does.
        """
        problem, x, jobs = self.problem, origin.point.x, list[Job]()
        effects = [m for m in origin.members if problem.causes[m.cause].effect is not None]
        sizes = {m.cause: float(x[index_of(problem, origin.members, m.cause)]) for m in effects}
        for member, found in zip(effects, shapes_of(problem, origin.members, x), strict=True):
            cause = problem.causes[member.cause]
            if cause.family < 0 or cause.family in origin.causes:
                continue
            law = Member(cause.family, found.shape)
            sizes[law.cause] = sizes[member.cause] if cause.common else 0.0
            rest = (m for m in origin.members if m is not member)
            members = tuple(sorted((*rest, law), key=lambda m: m.cause))

            def score(m: Member) -> Score:
                return Score(m.cause, m.shape, 0.0, sizes.get(m.cause, 0.0))

            jobs.append((members, origin, (score(law),)))
            for last in members:
                less = self.found.sets.get(tuple(m.cause for m in members if m is not last))
                if less is not None and less.members:
                    jobs.append((members, less, (score(last),)))
        return self._fit(jobs)

    def _scores(self, fitted: Fitted) -> tuple[list[Score], Directions]:
        """What a set may lack, the best first, and the directions at its fit."""
        if fitted.serial not in self._scored:
            self.check()
            seen = directions(self.problem, fitted, self.found.directions)
            self.found.directions = self.found.directions or seen
            self._scored[fitted.serial] = scores(self.problem, fitted, seen), seen
        return self._scored[fitted.serial]

    def _tried(self, fitted: Fitted) -> list[Job]:
        """Single causes, pairs, and parameters of each record that a set may lack."""
        ranked, seen = self._scores(fitted)
        if fitted.effective > NEARLY:  # of noise, a cause takes away what it does to first order
            causes = self.problem.causes
            ranked = [s for s in ranked if s.gain + causes[s.cause].log_odds > 0.0]
        added: list[tuple[Score, ...]] = [
            (s,) for s in _choose(self.problem, ranked, self.options.tries)
        ]
        if self.options.max_effects - len(fitted.members) > 1:
            added += pairs(self.problem, fitted, seen, ranked)[: self.options.tries]
            most = self.options.max_effects - len(fitted.members)
            if together := parameters_by_record(self.problem, fitted, seen, most):
                added.append(together)
        return [(_with(fitted, *some), fitted, some) for some in added]

    def _sure(self, s: Fitted) -> bool:
        """Whether a set with a cause of some records has the strict evidence: others go on."""
        new = {*s.causes} - {*self.now.causes}
        scoped = any(self.problem.causes[i].family >= 0 for i in new)
        return not scoped or log_odds(self._strict, s, self.now) > WORTH

    def _add(self) -> bool:
        """Take the best larger set; False: none gains."""
        jobs, first = self._tried(self.now), not self.found.first
        self.found.first = self.found.first or self._scores(self.now)[0]
        fits = self._fit(jobs)
        if first:
            plain = _tabulated(self.problem, self.now, self.check)
            fits += [] if plain is None else self._fit(self._tried(plain))
        fits = [f for f in fits if self._sure(f)]
        if not fits or self._gain(best := best_of(self.problem, fits), self.now) < WORTH:
            return False
        self.now = best
        return True

    def _drop(self, before: Fitted) -> None:
        """Leave out causes that gain nothing any more, and scopes that gain nothing."""
        while self.now.members and (
            smaller := [*self._less(self.now), *self._in_all_records(self.now)]
        ):
            best = best_of(self.problem, smaller)
            if self._gain(best, self.now) < (WORTH if best.causes == before.causes else 0.0):
                return
            self.now = best

    def _exchange(self) -> bool:
        """Exchange one cause for one that resembles it; False: no exchange gains."""
        for out in self.now.members:
            rest = next((f for f in self._less(self.now) if out.cause not in f.causes), None)
            if rest is None:
                continue
            nearest = [s for s in self._scores(rest)[0][:3] if s.cause != out.cause]
            fits = self._fit([(_with(rest, s), rest, (s,)) for s in nearest])
            if fits and self._gain(best := best_of(self.problem, fits), self.now) > CONVERGED:
                self.now = best
                return True
        return False


def _exchange_alike(problem: Problem, found: Searched, check: Callable[[], None]) -> None:
    """Fit every cause and parameter with the same column as a member of the best set in its place.

    If the time is up before the fits, the causes with the same column are not in the answer.
    """
    now = found.ranked()[0][0]
    if not now.members:
        return
    check()
    alone, known = found.sets.get(()), None
    if alone is not None and found.directions is not None:
        known = nearly_alike(problem, alone, found.directions, now.causes)
    seen, jobs = directions(problem, now, only=known), []
    for member in now.members:
        if problem.causes[member.cause].local is not None:
            continue
        rest = tuple(m for m in now.members if m is not member)
        alike = {s.cause: s for s, _ in equivalents(problem, now, seen, member.cause)}
        if alone is not None and found.directions is not None and rest:
            size = float(now.point.x[index_of(problem, now.members, member.cause)])
            before = alike_before(problem, alone, found.directions, member, size)
            alike = {s.cause: s for s in before if s.cause not in now.causes} | alike
        for score in alike.values():
            found.alike.append(frozenset((member.cause, score.cause)))
            members = (*rest, Member(score.cause, score.shape))
            jobs.append((tuple(sorted(members, key=lambda m: m.cause)), now, (score,)))
    refit(found, jobs, check)
