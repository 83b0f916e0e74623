"""First-order gains of causes that a set lacks, with all other unknowns projected out."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.chain import fault_of
from unmodeled.data import Array
from unmodeled.search.evidence import (
    DEGREES,
    Fitted,
    NormalEquations,
    penalty_of_records,
    prior_of,
    softness,
    system,
    weights,
)
from unmodeled.search.linear import EvaluationRequest, Linear, Point, evaluate
from unmodeled.search.problem import RELEASED, Member, Members, Problem

#: Number of causes whose derivatives are computed at a further fit.
LIKELY = 24
#: Weight of the prior of a magnitude in a score: where a model is far off, the causes are large.
WEAK = 1e-3
#: Largest magnitude at which a fit begins, in expected magnitudes [1].
MOST = 50.0
#: Cosine above which two causes are one.
ALIKE = 0.98
#: Share of the gain of the best cause from which others are tried too, and cosine at another fit
#: from which two causes may be one.
NEARLY = 0.8


@dataclass(frozen=True)
class Score:
    """A cause that a set lacks."""

    cause: int
    shape: Any
    gain: float
    """Gain to first order [log evidence], parameters refitted."""
    step: float
    """Magnitude to first order, in expected magnitudes [1]; within the bounds of the cause."""
    columns: tuple[Array, ...] = ()
    """Derivatives of the residuals by the magnitude, by record, (n, m); (): they are not used,
    because their sign is wrong."""
    further: int = -1
    """Index in ``Directions.further``; -1: it is no effect."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Derivatives of the residuals by the magnitudes of causes that a set lacks."""

    further: Members
    """The causes, each with all shapes."""
    by_further: tuple[Array, ...]
    """By record, (n, m, c)."""


def directions(
    problem: Problem,
    fitted: Fitted,
    near: Directions | None = None,
    only: Collection[int] | None = None,
) -> Directions:
    """Directions of the causes that a set lacks.

    Parameters
    ----------
    problem, fitted
        The problem and the set.
    near
        Directions at another fit. If derivatives are not cheap, only those of the causes are
        computed that gain most with these: they differ little between fits.
    only
        The laws whose directions are wanted; None: all.
    """
    inside = problem.families_of(fitted.causes)
    further = tuple(
        Member(i, shape)
        for i, cause in enumerate(problem.causes)
        if cause.effect is not None and cause.family < 0 and i not in inside
        if only is None or i in only
        for shape in cause.effect.shapes
    )
    if near is not None and not problem.model.cheap_derivatives:
        laws = {m.cause for m in further}
        ranked = (problem.families_of([s.cause]) & laws for s in scores(problem, fitted, near))
        likely = [*dict.fromkeys(i for one in ranked for i in one)][:LIKELY]
        further = tuple(m for m in further if m.cause in likely)
    ask = EvaluationRequest(
        fitted.members, fitted.point, problem.fit, further, by_global=False, rough=True
    )
    linears = evaluate(problem, [ask])[0]
    return Directions(further, tuple(x.by_further for x in linears))


@dataclass(frozen=True, eq=False)
class _Products:
    """Slopes and curvatures by the magnitudes of causes, all other unknowns projected out."""

    slope: Array
    """(c,)"""
    curvature: Array
    """(c, c)"""
    squares: Array
    """The same with the other unknowns as they are, without a prior of the magnitudes."""
    normal: tuple[Array, Array, Array]
    """Normal equations of the set: matrix, right side, weights of the prior."""
    inverse: Any
    linears: list[Linear]


def _products(problem: Problem, fitted: Fitted, seen: Directions) -> _Products:
    linears = [
        replace(x, by_further=y) for x, y in zip(fitted.linears, seen.by_further, strict=True)
    ]
    # All samples count: the rank is that of the residual that a cause takes away, and where few
    # samples are effective, the prior of its magnitude would hide it.
    own = system(problem, problem.fit, fitted.members, fitted.point, linears, fitted.noise, 1.0)
    x = fitted.point.x
    weight = prior_of(problem, fitted.members).weights(x)
    inverse = np.linalg.inv(own.matrix + np.diag(weight))
    slope = own.gain - own.further @ inverse @ (own.right - weight * x)
    curvature = own.own - own.further @ inverse @ own.further.T + WEAK * np.eye(len(slope))
    return _Products(slope, curvature, own.own, (own.matrix, own.right, weight), inverse, linears)


def scores(problem: Problem, fitted: Fitted, seen: Directions) -> list[Score]:
    """The best shape of each cause that a set lacks, largest gain first.

    The slope of a one-sided effect excludes nothing: at a fit whose parameters took up its action
    it may have the wrong sign.
    """
    found = _products(problem, fitted, seen)
    slope, diagonal = found.slope, np.diag(found.curvature)
    best: dict[int, Score] = {}
    inside_set = problem.families_of(fitted.causes)
    for j, (m, b, a) in enumerate(zip(seen.further, slope, diagonal, strict=True)):
        if m.cause in inside_set or not (np.isfinite(b) and a > 0.0):
            continue
        low, high = problem.causes[m.cause].bounds
        step = float(b / a)
        inside = low <= step <= high and step != 0.0
        start = float(np.clip(step if inside else 1.0, max(low, -MOST), min(high, MOST)))
        gain = 0.5 * float(b * b / a)
        if m.cause not in best or gain > best[m.cause].gain:
            columns = tuple(y[:, :, j].copy() for y in seen.by_further) if inside else ()
            best[m.cause] = Score(m.cause, m.shape, gain, start, columns, j)
    best |= _released(problem, fitted, *found.normal)
    best |= _in_each_record(problem, fitted)
    best |= _in_some_records(problem, fitted, seen, found, best)
    return sorted(best.values(), key=lambda s: -s.gain)


def pairs(
    problem: Problem, fitted: Fitted, seen: Directions, ranked: Sequence[Score]
) -> list[tuple[Score, Score]]:
    """Pairs of effects that take away more together than the best one, best first.

    Their gain is that of orthogonal least squares; no simulation is needed.
    """
    own = [s for s in ranked if s.further >= 0]
    if len(own) < 2:
        return []
    products = _products(problem, fitted, seen)
    at = [s.further for s in own]
    b, a = products.slope[at], products.curvature[np.ix_(at, at)]
    d = np.diag(a)
    with np.errstate(all="ignore"):
        apart = np.outer(d, d) - a**2
        step = (b[:, None] * d[None, :] - b[None, :] * a) / apart
        gain = 0.5 * (step * b[:, None] + step.T * b[None, :])
        gain[apart < (1.0 - ALIKE**2) * np.outer(d, d)] = -np.inf
    total = 0.5 * float((fitted.squares / fitted.noise**2).sum())
    least = max(s.gain for s in own)
    # What a single cause leaves has to shrink by a half.
    found = [
        (gain[i, j], i, j)
        for i, j in zip(*np.triu_indices(len(own), 1), strict=True)
        if np.isfinite(gain[i, j]) and total - gain[i, j] < 0.5 * (total - least)
    ]
    out = []
    for _, i, j in sorted(found, reverse=True):
        two = [(own[i], float(step[i, j])), (own[j], float(step[j, i]))]
        limits = [problem.causes[s.cause].bounds for s, _ in two]
        if all(low <= v <= high for (low, high), (_, v) in zip(limits, two, strict=True)):
            first, second = (
                replace(s, step=float(np.clip(v, -MOST, MOST)), columns=()) for s, v in two
            )
            out.append((first, second))
    return out


def equivalents(
    problem: Problem, fitted: Fitted, seen: Directions, member: int
) -> list[tuple[Score, float]]:
    """Causes whose column is parallel to that of a member of a set, the others projected out.

    Returns
    -------
    list
        Causes and parameters with the magnitudes that replace the member, and the cosine.
    """
    columns, others_of = _alike_columns(problem, fitted, seen, member)
    linears = [replace(x, by_further=y) for x, y in zip(fitted.linears, columns, strict=True)]
    own = system(problem, problem.fit, fitted.members, fitted.point, linears, fitted.noise, 1.0)
    x = fitted.point.x
    weight = prior_of(problem, fitted.members).weights(x)
    a = index_of(problem, fitted.members, member)
    whole = np.block([[own.matrix, own.further.T], [own.further, own.own]])
    g = x.size
    parameters = [
        (g_index, i)
        for i, cause in enumerate(problem.causes)
        if cause.parameter is not None
        and i not in fitted.causes
        and problem.causes[member].family < 0
        and (g_index := problem.free.index(cause.parameter)) != a
    ]
    tried = [(g + j, m.cause, m.shape) for j, m in enumerate(others_of)]
    tried += [(k, i, None) for k, i in parameters]
    best: dict[int, tuple[Score, float]] = {}
    for k, cause, shape in tried:
        others = [i for i in range(g) if i not in (a, k)]
        pair = [a, k]
        cross = whole[np.ix_(pair, others)]
        inner = whole[np.ix_(others, others)] + np.diag(weight[others])
        left = whole[np.ix_(pair, pair)] - cross @ np.linalg.solve(inner, cross.T)
        if not (left[0, 0] > 0.0 and left[1, 1] > 0.0):
            continue
        cosine = float(left[0, 1] / np.sqrt(left[0, 0] * left[1, 1]))
        if abs(cosine) > max(ALIKE, abs(best[cause][1]) if cause in best else 0.0):
            step = float(np.clip(x[a] * left[0, 1] / left[1, 1], -5.0 * MOST, 5.0 * MOST))
            best[cause] = Score(cause, shape, 0.0, step), cosine
    if problem.causes[member].family >= 0:
        (shape,) = (m.shape for m in fitted.members if m.cause == member)
        alike = [(Score(member, shape, 0.0, float(x[a])), 1.0), *best.values()]
        for score, cosine in alike:
            for cause in _same_when_fitted(problem, score.cause):
                best[cause] = replace(score, cause=cause), cosine
    return sorted(best.values(), key=lambda f: -abs(f[1]))


def nearly_alike(
    problem: Problem, fitted: Fitted, seen: Directions, members: Sequence[int]
) -> set[int] | None:
    """Laws that may resemble members of a set at another fit; None: any, for all that is known.

    ``fitted``, ``seen``: a fit without the members, and the directions there.
    """
    rows = {m: [j for j, f in enumerate(seen.further) if f.cause == m] for m in members}
    if problem.model.cheap_derivatives or not all(rows.values()):
        return None
    found, own = _products(problem, fitted, seen), [j for some in rows.values() for j in some]
    alike = np.zeros(len(seen.further), dtype=bool)
    for squares in (found.curvature, found.squares):
        size = np.sqrt(np.maximum(np.diag(squares), 0.0))
        alike |= (np.abs(squares[own]) >= NEARLY * np.outer(size[own], size)).any(axis=0)
    return {f.cause for f, is_alike in zip(seen.further, alike, strict=True) if is_alike}


def alike_before(
    problem: Problem, fitted: Fitted, seen: Directions, member: Member, size: float
) -> list[Score]:
    """Causes whose column is parallel to that of a member where neither of them acts yet.

    At a fit with the member, what does the same as the whole of it has the column of its last
    part: a lag of all sensors that of a delay, beside a lag of all inputs.

    Parameters
    ----------
    problem, fitted, seen
        A fit without the member, and the directions there.
    member
        The member.
    size
        Its magnitude, in expected magnitudes [1].
    """
    cross = _products(problem, fitted, seen).curvature
    own = next((j for j, f in enumerate(seen.further) if f == member), None)
    if own is None:
        return []
    found: dict[int, tuple[float, Score]] = {}
    for k, further in enumerate(seen.further):
        cosine = abs(cross[own, k]) / math.sqrt(cross[own, own] * cross[k, k])
        if further.cause != member.cause and cosine > max(
            ALIKE, found[further.cause][0] if further.cause in found else 0.0
        ):
            step = float(np.clip(size * cross[own, k] / cross[k, k], -5.0 * MOST, 5.0 * MOST))
            found[further.cause] = cosine, Score(further.cause, further.shape, 0.0, step)
    return [score for _, score in found.values()]


def _same_when_fitted(problem: Problem, member: int) -> list[int]:
    """The law of a member in other records of which the same ones are fitted."""
    found = problem.causes[member]

    def fitted(shares: tuple[float, ...]) -> list[float]:
        return [shares[o.number] for o in problem.fit]

    return [
        causes[found.family]
        for shares, causes in problem.scopes.items()
        if found.shares and shares and shares != found.shares and found.family in causes
        if fitted(shares) == fitted(found.shares)
    ]


def _alike_columns(
    problem: Problem, fitted: Fitted, seen: Directions, member: int
) -> tuple[Sequence[Array], Members]:
    """Derivatives by what may resemble a member: in its records, if it acts in some only."""
    found = problem.causes[member]
    if found.family < 0:
        return seen.by_further, seen.further
    causes = problem.scopes[found.shares]
    rows = [row for row in _rows(problem, seen) if causes.get(row.law, member) != member]
    columns = [
        np.stack([row.column(fitted, seen, r) * found.acts_in(o) for row in rows], axis=2)
        for r, o in enumerate(problem.fit)
    ]
    return columns, tuple(Member(causes[row.law], row.shape) for row in rows)


def index_of(problem: Problem, members: Members, cause: int) -> int:
    """Index of a cause among the global unknowns of a set."""
    found = problem.causes[cause]
    if found.parameter is not None:
        return problem.free.index(found.parameter)
    effects = [m.cause for m in members if problem.causes[m.cause].effect is not None]
    return len(problem.free) + effects.index(cause)


def _released(
    problem: Problem, fitted: Fitted, matrix: Array, right: Array, weight: Array
) -> dict[int, Score]:
    """Scores of parameters that may be outside their tolerances."""
    x, found = fitted.point.x, {}
    prior = prior_of(problem, fitted.members)
    base = _gain(matrix, right, weight, x)
    for i, cause in enumerate(problem.causes):
        if cause.parameter is None or i in fitted.causes:
            continue
        k = problem.free.index(cause.parameter)
        wider = weight.copy()
        wider[k] = (DEGREES + 1.0) / DEGREES * prior.weight[k] / RELEASED**2
        gain = _gain(matrix, right, wider, x) - base + 0.5 * (weight[k] - wider[k]) * x[k] ** 2
        found[i] = Score(i, None, float(gain), 0.0)
    return found


def _in_each_record(problem: Problem, fitted: Fitted) -> dict[int, Score]:
    """Scores of errors of a sensor in each record: at most their gain, the other unknowns fixed."""
    found = {}
    for i, cause in enumerate(problem.causes):
        if cause.local is None or cause.effect is not None or i in fitted.causes:
            continue
        fault, gain = fault_of(cause.local.kind), 0.0
        for o, linear in zip(problem.fit, fitted.linears, strict=True):
            time, slope, weight = o.record.time, 0.0, 1.0
            for c in cause.local.channels:
                readings = o.measured[:, c] - linear.residual[:, c] * o.sd[:, c]
                valid = o.valid[:, c]
                if valid.any():
                    readings = np.interp(time, time[valid], readings[valid])
                pattern = fault.by_size(o.record, readings[None], 0.0)[0]
                column = np.where(valid, cause.local.scale * pattern / o.sd[:, c], 0.0)
                column /= fitted.noise[c]
                slope += float(column @ linear.residual[:, c]) / fitted.noise[c]
                weight += float(column @ column)
            gain += 0.5 * slope**2 / weight
        found[i] = Score(i, None, gain, 0.0)
    return found


def _in_some_records(
    problem: Problem,
    fitted: Fitted,
    seen: Directions,
    found: _Products,
    everywhere: Mapping[int, Score],
) -> dict[int, Score]:
    """The best scope of each law, if it gains more than the law in all records.

    All members of a set that act in some records act in the same ones: what makes records differ
    happened once. Else, differences of three records could explain anything. In its records, one
    has to take a third of the squares: a model that is a little wrong differs everywhere.

    ``everywhere``: scores of the laws in all records.
    """
    known = {problem.causes[i].shares for i in fitted.causes} - {()}
    scopes = {s: causes for s, causes in problem.scopes.items() if not known or s in known}
    rows = _rows(problem, seen)
    inside = problem.families_of(fitted.causes)
    if not scopes or not rows:
        return {}
    parts = _by_part(problem, fitted, found, rows)
    _, right, weight = found.normal
    down = found.inverse @ (right - weight * fitted.point.x)
    best: dict[int, tuple[float, Score]] = {}
    left = _halves(fitted)

    def keep(
        row: _Row, i: int, value: float, acts: Sequence[float], step: float, taken: float
    ) -> None:
        """Keep a scope of a law if it is the best one."""
        if taken < float(left[np.array(acts) != 0.0].sum()) / 3.0:
            return
        value += problem.causes[i].log_odds - problem.causes[row.law].log_odds
        rival = everywhere[row.law].gain if row.law in everywhere else 0.0
        if value > max(rival, best[row.law][0] if row.law in best else 0.0):
            columns = tuple(row.column(fitted, seen, r) * on for r, on in enumerate(acts))
            own = columns if problem.causes[i].local is None else ()
            best[row.law] = value, Score(i, row.shape, value, step, own)

    for shares, causes in scopes.items():
        if not shares:
            continue
        acts = [shares[o.number] for o in problem.fit]
        if len(set(acts)) < 2:
            continue
        gain, further, own = (
            sum(part[k] * on**power for part, on in zip(parts, acts, strict=True))
            for k, power in enumerate((1, 1, 2))
        )
        slope = np.asarray(gain - further @ down)
        square = own - np.einsum("cg,cg->c", further @ found.inverse, further) + WEAK
        for row, b, a in zip(rows, slope, np.asarray(square), strict=True):
            if row.law not in causes or row.law in inside or not a > 0.0:
                continue
            i, step = causes[row.law], float(b / a)
            low, high = problem.causes[i].bounds
            if np.isfinite(step) and low <= step <= high:
                taken = 0.5 * float(b * b / a)
                keep(row, i, taken, acts, float(np.clip(step, -MOST, MOST)), taken)
    each = {} if known else problem.scopes.get((), {})
    for k, row in enumerate(rows):
        if row.law in each and row.law not in inside:
            own_parts = [(g[k : k + 1], f[k : k + 1], o[k].reshape(1, 1)) for g, f, o in parts]
            total = float(left.sum())
            taken, value = _each_its_own(own_parts, total, down, found.inverse)
            keep(row, each[row.law], value, [1.0] * len(parts), 0.0, taken)
    return {s.cause: s for _, s in best.values()}


def _each_its_own(
    parts: Sequence[tuple[Array, Array, Array]], total: float, down: Array, inverse: Array
) -> tuple[float, float]:
    """Laws with sizes of their own in each record.

    Parameters
    ----------
    parts
        By record: products with the residual, (k,), with the unknowns of the set, (k, g), and of
        the laws with each other, (k, k).
    total
        Half of the squares of the residual.
    down, inverse
        Step and inverse of the normal equations of the set.

    Returns
    -------
    tuple
        Halves of the squares that they take away, and the gain of one size for all records with
        the same log evidence. The noise is what is left, so that many sizes cost less where they
        leave little of it. Both are 0 if the laws have no such sizes.
    """
    gain, further = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    square = np.eye(gain.size) - further @ inverse @ further.T
    size = len(parts[0][0])
    for r, (*_, own) in enumerate(parts):
        at = slice(r * size, (r + 1) * size)
        square[at, at] += own
    slope = gain - further @ down
    sign, log_det = np.linalg.slogdet(square)
    if not (sign > 0.0 and np.isfinite(log_det)):
        return 0.0, 0.0
    sizes = np.linalg.solve(square, slope)
    taken = 0.5 * float(slope @ sizes)
    if not 0.0 < taken < total:
        return 0.0, 0.0
    by_law = (sizes.reshape(len(parts), -1) ** 2).sum(axis=0)
    cost = 0.5 * (float(log_det) + sum(penalty_of_records(s, len(parts)) for s in by_law))
    return taken, total - (total - taken) * math.exp(cost / total)


def parameters_by_record(
    problem: Problem, fitted: Fitted, seen: Directions, most: int
) -> tuple[Score, ...]:
    """Parameters with values of their own in each record, together: records of other specimens.

    ``most``: number of those that take most by themselves. (): they gain nothing together, or
    there are less than two.
    """
    each = problem.scopes.get((), {})
    laws = [
        i
        for i, cause in enumerate(problem.causes)
        if cause.parameter is not None and i in each and {i, each[i]}.isdisjoint(fitted.causes)
    ]
    if min(len(laws), most) < 2:
        return ()
    found = _products(problem, fitted, seen)
    rows = [row for row in _rows(problem, seen) if row.ratio and row.law in laws]
    free, ratio = np.array([r.place for r in rows]), np.array([r.ratio for r in rows])
    _, right, weight = found.normal
    down, total = found.inverse @ (right - weight * fitted.point.x), float(_halves(fitted).sum())
    parts = []
    for own in _systems(problem, fitted, found.linears):
        squares = own.matrix[np.ix_(free, free)] * np.outer(ratio, ratio)
        parts.append((ratio * own.right[free], ratio[:, None] * own.matrix[free], squares))

    def gain(some: Sequence[int]) -> float:
        of = [(g[[*some]], f[[*some]], o[np.ix_(some, some)]) for g, f, o in parts]
        return _each_its_own(of, total, down, found.inverse)[1]

    some = sorted(range(len(rows)), key=lambda k: -gain([k]))[:most]
    members, value = [each[rows[k].law] for k in some], gain(some)
    if value + problem.log_odds_of(members) <= 0.0:
        return ()
    return tuple(Score(i, None, value, 0.0) for i in members)


def _halves(fitted: Fitted) -> Array:
    """Half of the squares of the residuals, in units of the noise that is left, by record."""
    return np.array([0.5 * ((x.residual / fitted.noise) ** 2).sum() for x in fitted.linears])


@dataclass(frozen=True)
class _Row:
    """A law whose scopes are scored, with one of its shapes; or a parameter."""

    law: int
    shape: Any
    place: int
    """Index among the further directions, or of a parameter among the free ones."""
    ratio: float = 0.0
    """Scale of the difference of a parameter in its unit; 0: it is an effect."""

    def column(self, fitted: Fitted, seen: Directions, r: int) -> Array:
        """Derivative of the residuals of a record by the magnitude, (n, m)."""
        if not self.ratio:
            return seen.by_further[r][:, :, self.place]
        return np.asarray(fitted.linears[r].by_global[:, :, self.place] * self.ratio)


def _rows(problem: Problem, seen: Directions) -> list[_Row]:
    """Laws and parameters whose scopes are scored."""
    rows = [_Row(m.cause, m.shape, j) for j, m in enumerate(seen.further)]
    for i, cause in enumerate(problem.causes):
        if (p := cause.parameter) is not None:
            k = problem.free.index(p)
            ratio = RELEASED * problem.model.parameters[p].sd / float(problem.unit[k])
            rows.append(_Row(i, None, k, ratio))
    return rows


def _by_part(
    problem: Problem, fitted: Fitted, found: _Products, rows: Sequence[_Row]
) -> list[tuple[Array, Array, Array]]:
    """By record: products of the columns of all rows with the residual, the set and themselves."""
    free = np.array([row.place for row in rows if row.ratio], dtype=int)
    ratio = np.array([row.ratio for row in rows if row.ratio])
    out = []
    for own in _systems(problem, fitted, found.linears):
        out.append(
            (
                np.concatenate([own.gain, ratio * own.right[free]]),
                np.concatenate([own.further, ratio[:, None] * own.matrix[free]]),
                np.concatenate([np.diag(own.own), ratio**2 * np.diag(own.matrix)[free]]),
            )
        )
    return out


def _systems(
    problem: Problem, fitted: Fitted, linears: Sequence[Linear], share: float | Array = 1.0
) -> Iterator[NormalEquations]:
    """Normal equations of each record by itself; ``share``: weight of a sample."""
    members, soft = fitted.members, softness(problem, problem.fit, fitted.members, fitted.point)
    for o, local, linear in zip(problem.fit, fitted.point.local, linears, strict=True):
        point = Point(fitted.point.x, (local,))
        yield system(problem, (o,), members, point, (linear,), fitted.noise, share, soft=soft)


def _gain(matrix: Array, right: Array, weight: Array, x: Array) -> float:
    """Reduction of the cost by the best step, to second order."""
    slope = right - weight * x
    return float(0.5 * slope @ np.linalg.solve(matrix + np.diag(weight), slope))


def by_record(problem: Problem, fitted: Fitted, k: int) -> tuple[Array, Array]:
    """Magnitude of one effect in each record by itself, to first order, and its covariance.

    A true effect has the same magnitude in every record; an imitation of something that no
    candidate has changes with the motion. No simulation is needed.

    Returns
    -------
    tuple
        Values of the unknown in its scale, (records,), and their covariance.
    """
    prior = prior_of(problem, fitted.members)
    weight = prior.weights(fitted.point.x)
    g, count = fitted.point.x.size, len(problem.fit)
    others = np.delete(np.arange(g), k)
    size = g - 1 + count
    matrix, right = np.zeros((size, size)), np.zeros(size)
    matrix[: g - 1, : g - 1] += np.diag(weight[others])
    right[: g - 1] -= weight[others] * fitted.point.x[others]
    matrix[g - 1 :, g - 1 :] += WEAK * np.eye(count)
    share = weights(problem, fitted, fitted)
    for r, own in enumerate(_systems(problem, fitted, fitted.linears, share)):
        at = np.append(np.arange(g - 1), g - 1 + r)
        order = np.append(others, k)
        matrix[np.ix_(at, at)] += own.matrix[np.ix_(order, order)]
        right[at] += own.right[order]
    covariance = np.linalg.inv(matrix)
    step = covariance @ right
    by = slice(g - 1, None)
    values: Array = fitted.point.x[k] + step[by]
    return values, np.array(covariance[by, by])
