"""How far a withheld effect exceeds what the tolerances can compensate.

The scales of :mod:`blind.action_calibration` choose magnitudes before there is a case: one
linearization at drawing values, columns of the model. Where an effect is nearly the same as a
tolerance, or large, they promise more than any engine could see. Here the tolerances of the
generator's own machine are fitted to what the effect does, without noise, so that nothing of the
engine and nothing of its model's run is in it:

    nc^2 = min over p, z of |W (y(with) - y(p) - D z)|^2 + |(p - p0) / sd|^2 + |z|^2,

p0 the case's own tolerances, D run-to-run variability, W the whitening by the sensors' noise. In
the view "motion" the key front of y(p) follows the motion that it has with the effect.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from blind import action_truth as truth
from blind.action_calibration import answer_to_force, to_record, whole_segmented
from feltmb.data import Array
from feltmb.fit.segmented_records import SegmentedRecord

__all__ = ["noncentralities"]

#: Step of a tolerance for its derivative, in standard deviations.
STEP = 0.25
#: Steps of the fit along the same columns, each one run of every stroke, and how often columns are
#: taken anew where it stops.
ITERATIONS, RENEWALS = 20, 2


@dataclass(frozen=True, eq=False)
class _Stroke:
    """One stroke without the effect, with the tolerances of the case."""

    name: str
    length: float
    segmented: SegmentedRecord
    columns: Array
    """Whitened derivatives by tolerances, in standard deviations."""
    variability: Array
    """Whitened derivatives by this record's run-to-run variability, in standard deviations."""


@functools.cache
def _fixed(view: str) -> tuple[Any, ...]:
    from feltmb.adapters import mechanism_model

    action, base, library, outputs = truth.setup()
    channels = truth.watched(view, outputs)
    model = mechanism_model(action, channels=channels, rtol=1e-6, workers=1)[0]
    return base, library, outputs, model


#: Motion of the key front: time [s], displacement [m].
Motion = tuple[Array, Array]


def noncentralities(case: truth.Case) -> list[float | None]:
    """Noncentrality of every part of a case, without the other parts [1].

    An upper bound, because the fit may end above its minimum. None if it could not be computed. In
    the view "whole" only the part until shortly after the blow counts: what follows is chaotic, and
    the number is what the view "force" would have.
    """
    if not case.parts:
        return []
    if case.view == "whole":
        case = replace(case, view="force")
    bare = replace(case, parts=())
    try:
        strokes = [_stroke(bare, name) for name in truth.FIT]
    except Exception:  # not a valid mechanism: the case has no records either
        return [None for _ in case.parts]
    out: list[float | None] = []
    for part in case.parts:
        try:
            out.append(_strength(replace(case, parts=(part,)), bare, strokes))
        except Exception:
            out.append(None)
    return out


def _run(
    case: truth.Case, name: str, length: float | None = None, motion: Motion | None = None
) -> tuple[dict[str, Array], Motion]:
    """Ideal view of a stroke, and the motion of the key front in it."""
    base, library, outputs, _ = _fixed(case.view)
    view, run = truth.record(
        base, library, case, name, outputs, rtol=1e-7, ideal=True, length=length, motion=motion
    )
    return view, truth.motion_of(run)


def _view(
    case: truth.Case, name: str, length: float | None = None, motion: Motion | None = None
) -> Array:
    """Ideal outputs of a stroke; ``motion`` is that of the key front, if it is the input."""
    return _stacked(case, _run(case, name, length, motion)[0])


def _stacked(case: truth.Case, view: Mapping[str, Array]) -> Array:
    return np.stack([view[o] for o in truth.watched(case.view, _fixed(case.view)[2])], axis=-1)


def _stroke(bare: truth.Case, name: str) -> _Stroke:
    model = _fixed(bare.view)[3]
    view, motion = _run(bare, name)
    length = len(next(iter(view.values()))) / truth.RATE
    record = to_record(name, view)
    segmented = whole_segmented(model, record)
    variability = model.with_variability([record], truth.VARIATION).variabilities[name].columns
    white = segmented.whiten(variability[None]).reshape(-1, variability.shape[2])
    driven = motion if bare.view == "motion" else None
    columns = _columns(bare, name, length, segmented, driven)
    return _Stroke(name, length, segmented, columns, white)


def _columns(
    case: truth.Case, name: str, length: float, segmented: SegmentedRecord, motion: Motion | None
) -> Array:
    """Whitened derivatives of a stroke by all tolerances, at the tolerances of the case."""
    base = _view(case, name, length, motion)
    columns = []
    for e in _fixed(case.view)[1].tolerances:
        at = case.tolerances.get(e.name, 0.0)
        step = STEP * e.magnitude if at <= 0.0 else -STEP * e.magnitude
        moved = replace(case, tolerances={**case.tolerances, e.name: at + step})
        change = (_view(moved, name, length, motion) - base) * (e.magnitude / step)
        columns.append(segmented.whiten(change[None]).reshape(-1))
    return np.column_stack(columns)


def _strength(case: truth.Case, bare: truth.Case, strokes: list[_Stroke]) -> float:
    _, library, _, model = _fixed(case.view)
    targets: list[Array] = []
    driven: list[Motion | None] = []
    for s in strokes:
        moved, motion = _run(case, s.name, s.length)
        if case.view == "motion":
            targets.append(_stacked(case, moved))
            driven.append(motion)
        else:
            answer = answer_to_force(model, s.segmented.record, moved["force"])
            targets.append(_stacked(case, moved) - answer)
            driven.append(None)
    magnitudes = np.array([e.magnitude for e in library.tolerances])
    names = [e.name for e in library.tolerances]
    own = np.array([bare.tolerances.get(n, 0.0) for n in names])
    count = magnitudes.size
    variability = _diagonal([s.variability for s in strokes])
    clean = np.linalg.inv(variability.T @ variability + np.eye(variability.shape[1]))

    def at(p: Array) -> truth.Case:
        return replace(bare, tolerances=dict(zip(names, own + p * magnitudes, strict=True)))

    def residual(p: Array) -> Array:
        parts = [
            s.segmented.whiten((y - _view(at(p), s.name, s.length, m))[None]).reshape(-1)
            for s, y, m in zip(strokes, targets, driven, strict=True)
        ]
        return np.concatenate(parts)

    def cost(r: Array, p: Array) -> float:
        pull = variability.T @ r  # the variability is linear: it is eliminated at every point
        return float(r @ r - pull @ clean @ pull + p @ p)

    p = np.zeros(count)
    r = residual(p)
    best = cost(r, p)
    columns = np.vstack([s.columns for s in strokes])
    for renewal in range(1 + RENEWALS):
        if renewal:
            columns = np.vstack(
                [
                    _columns(at(p), s.name, s.length, s.segmented, m)
                    for s, m in zip(strokes, driven, strict=True)
                ]
            )
        before = best
        root = np.hstack([columns, variability])
        height = np.linalg.inv(root.T @ root + np.eye(root.shape[1]))
        share = 1.0
        for _ in range(ITERATIONS):
            z = clean @ (variability.T @ r)
            left = np.concatenate([columns.T @ (r - variability @ z) - p, np.zeros(z.size)])
            moved = p + share * (height @ left)[:count]
            try:
                other = residual(moved)
                value = cost(other, moved)
            except Exception:  # these values define no valid mechanism
                value = math.inf
            if value < best:
                done = best - value < 1e-3 * best + 0.05
                p, r, best = moved, other, value
                share = min(1.0, 2.0 * share)
                if done:
                    break
            else:
                share *= 0.4
                if share < 0.02:
                    break
        if before - best < 0.02 * best + 0.1:
            break
    return math.sqrt(max(best, 0.0))


def _diagonal(blocks: list[Array]) -> Array:
    """Blocks along the diagonal of an otherwise empty matrix."""
    out = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    row, column = 0, 0
    for b in blocks:
        out[row : row + b.shape[0], column : column + b.shape[1]] = b
        row, column = row + b.shape[0], column + b.shape[1]
    return out
