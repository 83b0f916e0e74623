"""Motions of the records beside the model as it is and with the changes, and where they show it."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array
from unmodeled.pictures.curves import POINTS, Alternative, Motion, Motions, thinned
from unmodeled.pictures.laws import in_the_set
from unmodeled.search.evidence import Fitted
from unmodeled.search.linear import EvaluationRequest, Linear, Point, evaluate, local_of
from unmodeled.search.problem import Observed, Problem, rms_of
from unmodeled.search.result import Change
from unmodeled.search.score import index_of

#: Largest number of motions; periods that the chosen part shows, and its smallest number of
#: samples.
MOTIONS, PERIODS, SHORTEST = 24, 4, 40
#: Number of changes up to which all their subsets are simulated; else each one is left out, of
#: the first ones.
SUBSETS, FIRST = 4, 8
#: Largest number of values of all curves, and smallest number of points of a curve.
VALUES, FEWEST = 200_000, 100
#: Square of a residual, in the motion of its channel, above which it counts no more.
FAR = 4.0


def motions_of(
    problem: Problem,
    alone: Fitted,
    best: Fitted,
    changes: Sequence[Change] = (),
    held_out: Collection[str] = (),
) -> Motions | None:
    """The part of a record in which the changes take away most, and all records by channel.

    None: no record shows a channel.

    Parameters
    ----------
    problem
        The problem.
    alone, best
        Fits of the model alone and of the set of the answer.
    changes
        Changes that may be left out.
    held_out
        Names of records that were not fitted.
    """
    changes = in_the_set(problem, best, changes)
    with np.errstate(all="ignore"):
        whole = list(_whole(problem, _tabulated(problem, alone), best, held_out))[:MOTIONS]
        if not whole:
            return None
        parts = [_part(m) for _, _, m in whole]
        place = max(range(len(whole)), key=lambda k: parts[k][0])
        cuts = [(*whole[place], parts[place][1]), *((*w, slice(None)) for w in whole)]
        names, asked = _asked(problem, best, changes)
        few = VALUES // (len(cuts) * (len(asked) + 3))
        shown = [_thin(m, part, min(max(few, FEWEST), POINTS)) for _, _, m, part in cuts]
        found = []
        points = [point for _, point in asked]
        for (kept, _), linears in zip(asked, _at(problem, best, points), strict=True):
            left = rms_of(problem.fit, (x.residual for x in linears))
            curves = [
                _model(problem.fit[r], linears[r], c)[part][keep]
                for (r, c, _, part), (_, keep) in zip(cuts, shown, strict=True)
            ]
            left_by = {n: float(v) for n, v in zip(problem.names, left, strict=True)}
            found.append(Alternative(kept, left_by, tuple(curves)))
    chosen, *rest = (m for m, _ in shown)
    labels = tuple(_label(c) for n in names for c in changes if c.name == n)
    return Motions(chosen, tuple(rest), names, labels, tuple(found))


def _label(change: Change) -> str:
    """Name for people: what changes, or the name of what is added."""
    article, _, thing = change.title.partition(" ")
    return thing if article.lower() == "the" else change.name


def _tabulated(problem: Problem, alone: Fitted) -> Sequence[Linear]:
    """Residuals of the model as it is; starts that are not known are those of the fit."""
    local = tuple(
        np.array([v if q.weight < 1e-4 else 0.0 for q, v in zip(o.local, values, strict=True)])
        for o, values in zip(problem.fit, alone.point.local, strict=True)
    )
    point = replace(alone.point, x=np.zeros_like(alone.point.x), local=local)
    return evaluate(problem, [EvaluationRequest((), point, problem.fit, derivatives=False)])[0]


def _at(problem: Problem, best: Fitted, points: Sequence[Point]) -> list[list[Linear]]:
    asks = [EvaluationRequest(best.members, p, problem.fit, derivatives=False) for p in points]
    return evaluate(problem, asks) if asks else []


def _own(o: Observed, c: int) -> slice:
    """The part of a record in which a channel was measured."""
    at = np.flatnonzero(o.valid[: o.end, c])
    return slice(int(at[0]), int(at[-1]) + 1)


def _model(o: Observed, linear: Linear, c: int) -> Array:
    """A channel of the model in this part; between measured samples, it is interpolated."""
    own = _own(o, c)
    at = np.flatnonzero(o.valid[own, c])
    values = (o.measured[own, c] - linear.residual[own, c] * o.sd[own, c])[at]
    return np.interp(np.arange(own.stop - own.start), at, values)


def _whole(
    problem: Problem, before: Sequence[Linear], best: Fitted, held_out: Collection[str]
) -> Iterator[tuple[int, int, Motion]]:
    """Record, channel, and motion."""
    for r, o in enumerate(problem.fit):
        for c, (name, unit) in enumerate(zip(problem.names, problem.units, strict=True)):
            if o.valid[: o.end, c].sum() < 2:
                continue
            own = _own(o, c)
            measured = np.where(o.valid[own, c], o.measured[own, c], np.nan)
            model = [_model(o, x[r], c) for x in (before, best.linears)]
            held, moves = o.record.name in held_out, float(problem.motion[c])
            time = o.record.time[own]
            yield r, c, Motion(o.record.name, name, unit, held, moves, time, measured, *model)


def _part(m: Motion) -> tuple[float, slice]:
    """The largest mean gain by the changes in a part as long as some periods, and this part.

    The gain is that of the squared residual, in squares of the motion of the channel.
    """
    scale = m.motion or 1.0
    before, after = (
        np.minimum(np.nan_to_num((m.measured - x) / scale, nan=FAR) ** 2, FAR)
        for x in (m.tabulated, m.changed)
    )
    gain = np.where(np.isfinite(m.measured), before - after, 0.0)
    about = m.measured[np.isfinite(m.measured)]
    about = about - about.mean()
    turns = np.sign(about[np.abs(about) > 0.3 * float(np.std(about))])
    periods = 0.5 * float((np.diff(turns) != 0.0).sum())
    n = len(gain)
    width = int(np.clip(n * PERIODS / max(periods, 1.0), min(SHORTEST, n), n))
    sums = np.convolve(gain, np.ones(width), "valid")
    at = int(np.argmax(sums))
    return float(sums[at]) / width, slice(at, at + width)


def _thin(m: Motion, part: slice, points: int) -> tuple[Motion, NDArray[np.intp]]:
    """A part of a motion with few points, and their indices in the part."""
    curves = [v[part] for v in (m.measured, m.tabulated, m.changed)]
    keep = thinned(curves, points)
    measured, tabulated, changed = (v[keep] for v in curves)
    time = m.time[part][keep]
    return replace(m, time=time, measured=measured, tabulated=tabulated, changed=changed), keep


def _asked(
    problem: Problem, best: Fitted, changes: Sequence[Change]
) -> tuple[tuple[str, ...], list[tuple[tuple[bool, ...], Point]]]:
    """Names of the changes that a set has, and points of the set with some of them."""
    outs = ((c.name, _without(problem, best, c.name)) for c in changes)
    own = [(name, out) for name, out in outs if out is not None][:FIRST]
    count = len(own)
    every = [(True,) * count]
    kept = (
        list(itertools.product((True, False), repeat=count))
        if count <= SUBSETS
        else every + [tuple(k != out for k in range(count)) for out in range(count)]
    )
    asked = []
    for mask in kept if count else []:
        point = best.point
        for (_, (unknowns, local)), stays in zip(own, mask, strict=True):
            if not stays:
                x = point.x.copy()
                x[unknowns] = 0.0
                values = tuple(
                    np.where(where, 0.0, v) for where, v in zip(local, point.local, strict=True)
                )
                point = Point(x, values)
        asked.append((mask, point))
    return tuple(n for n, _ in own), asked


def _without(
    problem: Problem, best: Fitted, name: str
) -> tuple[list[int], list[NDArray[np.bool_]]] | None:
    """The unknowns of a set, and of each record, that a change moves; None: there are none."""
    nothing = [np.zeros(len(v), dtype=bool) for v in best.point.local]
    index = next((i for i in best.causes if problem.causes[i].name == name), None)
    if index is None:
        free = [problem.model.parameters[i].name for i in problem.free]
        alias = next((c.parameter for c in problem.causes if c.name == name), None)
        if name in free:
            return [free.index(name)], nothing
        return None if alias is None else ([problem.free.index(alias)], nothing)
    local = problem.causes[index].local
    if local is None:
        return [index_of(problem, best.members, index)], nothing
    of = [
        np.array([(q.kind, q.index) == (local.kind, local.index)
                  for q in local_of(problem, best.members, o)], dtype=bool)
        for o in problem.fit
    ]  # fmt: skip
    return [], of
