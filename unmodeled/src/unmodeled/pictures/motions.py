"""Motions of the records beside the model as it is and with the changes, and where they show it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from unmodeled.data import Array
from unmodeled.pictures.curves import Motion, thinned
from unmodeled.search.evidence import Fitted
from unmodeled.search.linear import EvaluationRequest, Linear, evaluate, local_of
from unmodeled.search.problem import Problem

#: Largest number of motions; periods that the chosen part shows, and its smallest number of
#: samples.
MOTIONS, PERIODS, SHORTEST = 24, 4, 40


def motions(
    problem: Problem, alone: Fitted, best: Fitted, held_out: Collection[str] = ()
) -> tuple[Motion, ...]:
    """The part of a record in which the changes take away most, then all records by channel.

    Parameters
    ----------
    problem
        The problem.
    alone, best
        Fits of the model alone and of the set of the answer.
    held_out
        Names of records that were not fitted.
    """
    whole = list(_whole(problem, tabulated_at(problem, alone), best, held_out))
    if not whole:
        return ()
    scale = dict(zip(problem.names, np.maximum(problem.motion, problem.noise), strict=True))
    best_gain, first = -np.inf, whole[0]
    for m in whole:
        gain, part = _part(m, float(scale[m.channel]))
        if gain > best_gain:
            best_gain, first = gain, part
    return tuple(_thin(m) for m in (first, *whole[:MOTIONS]))


def tabulated_at(problem: Problem, alone: Fitted) -> Sequence[Linear]:
    """Residuals of the model as it is; starts that are not known are those of the fit."""
    local = tuple(
        np.array([v if q.weight < 1e-4 else 0.0 for q, v in zip(o.local, values, strict=True)])
        for o, values in zip(problem.fit, alone.point.local, strict=True)
    )
    point = replace(alone.point, x=np.zeros_like(alone.point.x), local=local)
    ask = EvaluationRequest((), point, problem.fit, derivatives=False)
    assert all(
        len(local_of(problem, (), o)) == len(v) for o, v in zip(problem.fit, local, strict=True)
    )
    return evaluate(problem, [ask])[0]


def _whole(
    problem: Problem, before: Sequence[Linear], best: Fitted, held_out: Collection[str]
) -> list[Motion]:
    out = []
    for o, a, b in zip(problem.fit, before, best.linears, strict=True):
        own = slice(o.end)
        for c, (name, unit) in enumerate(zip(problem.names, problem.units, strict=True)):
            valid = o.valid[own, c]
            if valid.sum() < 2:
                continue
            time, at = o.record.time[own], np.flatnonzero(valid)
            measured = np.where(valid, o.measured[own, c], np.nan)
            # The model is known where something was measured; between, it is interpolated.
            model = [
                np.interp(
                    np.arange(len(time)), at, (measured - x.residual[own, c] * o.sd[own, c])[at]
                )
                for x in (a, b)
            ]
            held = o.record.name in held_out
            out.append(Motion(o.record.name, name, unit, held, time, measured, *model))
    return out


def _part(m: Motion, scale: float) -> tuple[float, Motion]:
    """The part with the largest mean gain by the changes, in squares of a scale, and this gain.

    It is as long as some periods of the motion.
    """
    before, after = ((m.measured - x) / scale for x in (m.tabulated, m.changed))
    gain = np.nan_to_num(np.minimum(before**2, 4.0) - np.minimum(after**2, 4.0))
    n, known = len(gain), m.measured[np.isfinite(m.measured)]
    about = known - known.mean()
    quiet = 0.3 * float(np.std(about))
    turns = about[np.abs(about) > quiet]
    periods = 0.5 * float((np.diff(np.sign(turns)) != 0.0).sum())
    width = int(np.clip(n * PERIODS / max(periods, 1.0), min(SHORTEST, n), n))
    sums = np.convolve(gain, np.ones(width), "valid")
    at = int(np.argmax(sums))
    return float(sums[at]) / width, _cut(m, slice(at, at + width))


def _cut(m: Motion, part: slice) -> Motion:
    curves: list[Array] = [m.time, m.measured, m.tabulated, m.changed]
    time, measured, tabulated, changed = (v[part] for v in curves)
    return replace(m, time=time, measured=measured, tabulated=tabulated, changed=changed)


def _thin(m: Motion) -> Motion:
    keep = thinned([m.measured, m.tabulated, m.changed])
    return replace(
        m,
        time=m.time[keep],
        measured=m.measured[keep],
        tabulated=m.tabulated[keep],
        changed=m.changed[keep],
    )
