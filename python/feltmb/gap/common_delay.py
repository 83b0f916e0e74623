"""A common delay of all outputs against the inputs, from the beginnings of the records.

A trigger of a camera that is 4 ms late makes parts look softer, heavier, or subject to more
friction. Where a motion begins, few parameters matter, and the linear model of the tolerances is
valid. A shift of the clock changes the records only, so that one linearization is enough for all
shifts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from feltmb.data import Array, Integers
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Model
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import limit_of_noise
from feltmb.gap.criteria import DELAY_LEAVES
from feltmb.units import readable_unit

__all__ = ["common_delay"]

#: Share of its largest motion after which an output ends the beginning of its record; least number
#: of samples of a beginning.
BEGINNING, LEAST = 0.1, 8
#: Longest delay, as a share of a record.
LONGEST = 0.1


def common_delay(model: Model, records: Sequence[SegmentedRecord]) -> str:
    """Sentence about a common delay of all outputs of all records; empty if there is none.

    It is told if the tabulated model, with all changes that the tolerances permit, does not explain
    the beginnings of the records, and if one delay leaves little of that. Only mechanisms
    whose parameters have priors are tested.

    Parameters
    ----------
    model
        The prepared model.
    records
        Its segmented records.
    """
    # Derivatives of a simulator by a user cost one run for each parameter.
    if not (model.from_rest and math.isfinite(model.longest_run)):
        return ""
    records = [s for s in records if s.record.before is None and len(s.record.inputs)]
    parts = [s.until(_beginning(s)) for s in records]
    problem = Problem(model, tuple(parts))
    if not parts or not problem.has_priors:
        return ""
    point = problem.start()
    linears = problem.linear(point)
    if not all(np.all(x.good) for x in linears):
        return ""
    seen = [outputs for outputs, _, _ in problem.predict(point)]
    names = tuple(model.outputs)
    starts = [
        _Beginning(whole, part, outputs, linear, names)
        for whole, part, outputs, linear in zip(records, parts, seen, linears, strict=True)
    ]
    together = _Beginnings(problem, starts)
    own = together.misfit(0.0)
    count = float(problem.samples)
    if own < limit_of_noise(count):
        return ""
    step = max(s.record.interval for s in records)
    longest = LONGEST * min(float(np.ptp(s.record.time)) for s in records)
    # Whole sampling intervals: between samples, an interpolation would have less noise.
    most = int(longest / step)
    misfits = np.array([together.misfit(k * step) for k in range(-most, most + 1)])
    best = int(np.argmin(misfits))
    if best in (0, most, 2 * most):
        return ""
    delay = step * (best - most)
    if not misfits[best] - count < DELAY_LEAVES * (own - count):
        return ""
    for one in starts:
        known, shifted = map(_Beginnings(problem, [one]).misfit, (0.0, delay))
        if shifted > max(known, limit_of_noise(float(np.sum(one.part.samples)))):
            return ""
    factor, unit = readable_unit(abs(delay), "s")
    word = "late" if delay > 0.0 else "early"
    inputs = ", ".join(dict.fromkeys(n for s in records for n in s.record.inputs))
    return (
        f"all outputs are about {factor * abs(delay):.2g} {unit} {word} against {inputs} where the "
        "motion of each record begins: are they on one clock? Shift the outputs in the files, or "
        "parts may get wrong values"
    )


def _beginning(segmented: SegmentedRecord) -> int:
    """Number of samples until an output has moved by a share of its largest motion."""
    ends = []
    for values in segmented.record.outputs.values():
        there = np.flatnonzero(np.isfinite(values))
        if not there.size:
            continue
        moved = np.abs(values[there] - np.median(values[there[:LEAST]]))
        ends.append(int(there[np.argmax(moved > BEGINNING * np.max(moved))]))
    return max(LEAST, min(ends, default=0))


@dataclass(frozen=True, eq=False)
class _Beginning:
    """The first part of a record, with the model and its derivatives there."""

    whole: SegmentedRecord
    part: SegmentedRecord
    outputs: Array
    """Of the model, (W, L, ny)."""
    linear: Linear
    names: tuple[str, ...]
    """Outputs of the model."""

    def residual(self, delay: float) -> Array:
        """Whitened residual of the record without a delay [s], (m,)."""
        record = self.whole.record
        place = self.part.segments[:, :1] + np.arange(self.outputs.shape[1])
        at = record.time[np.minimum(place, record.samples - 1)] + delay
        measured = np.full(self.outputs.shape, np.nan)
        for k, name in enumerate(self.names):
            values = record.outputs.get(name)
            if values is not None and (there := np.isfinite(values)).any():
                measured[..., k] = np.interp(at, record.time[there], values[there])
        gap = measured - self.outputs
        return np.asarray(self.part.whiten(np.where(self.part.valid, gap, 0.0))).ravel()


class _Beginnings:
    """Sum of squares with the most likely parameters and nuisances of the linear model."""

    def __init__(self, problem: Problem, starts: Sequence[_Beginning]):
        everything = problem.model.parameters
        prior = [everything[i].sd for i in problem.free]
        self._size = len(prior) + sum(len(s.part.nuisances) for s in starts)
        self._parts: list[tuple[_Beginning, Integers, Array]] = []
        matrix, at = np.eye(self._size), len(prior)
        for s in starts:
            own = [sd for _, _, sd in s.part.nuisances]
            columns = np.r_[np.arange(len(prior)), at : at + len(own)]
            at += len(own)
            by = s.linear.by_global
            jacobian = by.reshape(-1, by.shape[2]) * np.array([*prior, *own])
            self._parts.append((s, columns, jacobian))
            matrix[np.ix_(columns, columns)] += jacobian.T @ jacobian
        self._factor = cho_factor(matrix)

    def misfit(self, delay: float) -> float:
        """Sum of squares of the records without a delay [s]."""
        right, total = np.zeros(self._size), 0.0
        for s, columns, jacobian in self._parts:
            gap = s.residual(delay)
            total += float(gap @ gap)
            right[columns] += gap @ jacobian
        return total - float(right @ cho_solve(self._factor, right))
