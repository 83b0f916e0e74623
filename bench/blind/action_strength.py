"""How far a withheld effect exceeds what the tolerances can compensate.

The scales of :mod:`blind.action_calibration` choose magnitudes before there is a case: one
linearization at drawing values, columns of the model. Where an effect is nearly the same as a
tolerance, or large, they promise more than any engine could see. Here the tolerances of the
generator's own machine are fitted to what the effect does, without noise, so that nothing of the
engine and nothing of its model's run is in it:

    nc^2 = min over p, z of |W (y(with) - y(p) - D z)|^2 + |(p - p0) / sd|^2 + |z|^2,

p0 the case's own tolerances, D run-to-run variability, W the whitening by the camera's noise.
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
    view: Mapping[str, Array]
    segmented: SegmentedRecord
    columns: Array
    """Whitened derivatives by tolerances, in standard deviations."""
    variability: Array
    """Whitened derivatives by this record's run-to-run variability, in standard deviations."""


@functools.cache
def _fixed() -> tuple[Any, ...]:
    from feltmb.adapters import mechanism_model

    action, base, library, outputs = truth.setup()
    model = mechanism_model(action, shooting="single", rtol=1e-6, workers=1)[0]
    return base, library, outputs, model


def noncentralities(case: truth.Case) -> list[float | None]:
    """Noncentrality of every part of a case, without the other parts [1].

    An upper bound, because the fit may end above its minimum. None if it could not be computed.
    """
    if not case.parts:
        return []
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


def _view(case: truth.Case, name: str, length: float | None = None) -> dict[str, Array]:
    base, library, outputs, _ = _fixed()
    return truth.record(base, library, case, name, outputs, rtol=1e-7, ideal=True, length=length)[0]


def _stacked(view: Mapping[str, Array]) -> Array:
    return np.stack([view[o] for o in _fixed()[2]], axis=-1)


def _stroke(bare: truth.Case, name: str) -> _Stroke:
    _, _, outputs, model = _fixed()
    view = _view(bare, name)
    length = view["force"].size / truth.RATE
    record = to_record(name, view, outputs)
    segmented = whole_segmented(model, record)
    variability = model.with_variability([record], truth.VARIATION).variabilities[name].columns
    white = segmented.whiten(variability[None]).reshape(-1, variability.shape[2])
    return _Stroke(name, length, view, segmented, _columns(bare, name, length, segmented), white)


def _columns(case: truth.Case, name: str, length: float, segmented: SegmentedRecord) -> Array:
    """Whitened derivatives of a stroke by all tolerances, at the tolerances of the case."""
    base = _stacked(_view(case, name, length))
    columns = []
    for e in _fixed()[1].tolerances:
        at = case.tolerances.get(e.name, 0.0)
        step = STEP * e.magnitude if at <= 0.0 else -STEP * e.magnitude
        moved = replace(case, tolerances={**case.tolerances, e.name: at + step})
        change = (_stacked(_view(moved, name, length)) - base) * (e.magnitude / step)
        columns.append(segmented.whiten(change[None]).reshape(-1))
    return np.column_stack(columns)


def _strength(case: truth.Case, bare: truth.Case, strokes: list[_Stroke]) -> float:
    _, library, _, model = _fixed()
    targets = []
    for s in strokes:
        moved = _view(case, s.name, s.length)
        answer = answer_to_force(model, s.segmented.record, moved["force"])
        targets.append(_stacked(moved) - answer)
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
            s.segmented.whiten((y - _stacked(_view(at(p), s.name, s.length)))[None]).reshape(-1)
            for s, y in zip(strokes, targets, strict=True)
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
            columns = np.vstack([_columns(at(p), s.name, s.length, s.segmented) for s in strokes])
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
