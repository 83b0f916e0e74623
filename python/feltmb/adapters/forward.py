"""Derivatives of a mechanism's segments by forward sensitivities: exact, all columns in one pass.

The variational equation is integrated along the stroke (:mod:`feltmb.run.sensitivity`); what a
parameter does to the equations comes from mechanisms with the parameter shifted. Start states are
departures from a rest pose that moves with the parameters: its part is added by the chain rule.
Effects that bring states of their own (pivots that give, felt that creeps) are left to differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb import _core
from feltmb.adapters.differentiable import DifferentiableMechanism
from feltmb.adapters.drives import follow
from feltmb.adapters.library import Entry
from feltmb.adapters.variants import Variant
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError
from feltmb.fit import Candidate, Sensitivity
from feltmb.fit.watch import simulated

__all__ = ["can_differentiate", "forward_sensitivities"]

#: Shift of a parameter or magnitude as a share of its scale.
SHIFT = 1e-3
#: Local relative error of a column.
TOLERANCE = 1e-3


@dataclass(frozen=True)
class _Column:
    """One number to differentiate by: shifted versions of the mechanism with their weights."""

    name: str
    nodes: tuple[tuple[Variant, float, float], ...]
    scale: float

    def rest(self, pick: Any) -> Array:
        """Derivative of something of the rest by this number."""
        out: Array = sum(w * np.asarray(pick(v)) for v, _, w in self.nodes)  # type: ignore[assignment]
        return out


def can_differentiate(candidate: Candidate) -> bool:
    """Whether the candidate leaves the states of the mechanism as they are."""
    entry = candidate.effect.data
    if not isinstance(entry, Entry):
        return False
    return not entry.hidden and (entry.insertion is None or entry.insertion.kind == "mass")


def forward_sensitivities(
    model: DifferentiableMechanism,
    record: Record,
    theta: Array,
    segments: NDArray[np.intp],
    starts: Array,
    included: tuple[Candidate, ...],
    magnitudes: Array,
    *,
    by_theta: Sequence[int],
    by_starts: bool,
    candidates: tuple[Candidate, ...],
) -> Sensitivity | None:
    """See :meth:`feltmb.fit.Model.sensitivities`; None if a segment or a shift failed.

    All included effects and candidates must satisfy :func:`can_differentiate`, or be included
    effects whose states the model has already (their magnitudes are then differentiated as well).
    """
    try:
        base = model.version(record, theta, included, magnitudes)
        columns = _columns(model, record, base, theta, included, magnitudes, by_theta, candidates)
    except FeltmbError:
        return None
    names = [s.name for s in model.states(included)]
    place = np.array([base.place[name] for name in names], dtype=int)
    held = [] if model.single else model.condensed_places(base)
    directions = np.concatenate([place, np.array(held, dtype=int)]).astype(int)
    drive = model.drives.of(record)
    clock = record.time - record.time[0]
    profile = drive.profile(float(record.time[0]), float(clock[-1]))
    matrix = np.zeros((base.rest.size, directions.size))
    matrix[directions, np.arange(directions.size)] = 1.0
    options = _core.SensitivityOptions()
    simulation = _core.SimulationOptions()
    simulation.rtol = model.rtol
    options.simulation = simulation
    options.tolerance = TOLERANCE
    options.output_rate = (record.samples - 1) / float(clock[-1])
    index = {name: i for i, (name, _, _) in enumerate(_core.observables(base.mechanism))}
    options.outputs = [index[o] for o in model.outputs]
    options.threads = model.workers
    prepared = []
    for (first, last), start in zip(segments, starts, strict=True):
        begin, end = float(clock[first]), float(clock[last])
        if model.single:
            begin, state, memory = 0.0, [], []
        else:
            full = base.rest.copy()
            full[place] += start
            if drive.motion:
                own = drive.profile(float(record.time[first]), end - begin)
                follow(model.action, base, full, own)
            state, memory = list(full), list(base.memory)
        prepared.append(_core.SensitivityWindow(begin, end, state, memory, matrix))
    parameters = [
        _core.SensitivityParameter(
            c.name,
            [
                _core.Perturbed(v.mechanism, profile, False, s, w, 0.0, drive.motion, False)
                for v, s, w in c.nodes
            ],
            c.scale,
        )
        for c in columns
    ]
    if model.single:
        # One run serves all segments.
        last = int(np.argmax(segments[:, 1]))
        prepared = [prepared[last]]
    span = segments[:, 1].max() if model.single else np.sum(segments[:, 1] - segments[:, 0])
    simulated(float(span) / max(record.samples - 1, 1))
    try:
        results = _core.sensitivities(
            base.mechanism, profile, False, parameters, prepared, options, drive.motion, False
        )
    except (FeltmbError, RuntimeError, ValueError):
        return None
    if any(r.run.status != "done" for r in results):
        return None
    return _collect(
        model,
        segments,
        results,
        columns,
        base,
        place,
        directions,
        (len(by_theta), len(included), len(candidates)),
        by_starts=by_starts,
    )


def _columns(
    model: DifferentiableMechanism,
    record: Record,
    base: Variant,
    theta: Array,
    included: tuple[Candidate, ...],
    magnitudes: Array,
    by_theta: Sequence[int],
    candidates: tuple[Candidate, ...],
) -> list[_Column]:
    out = []
    for i in by_theta:
        p = model.parameters[i]
        h = SHIFT * p.size
        nodes = []
        for side in (1.0, -1.0):
            moved = theta.copy()
            moved[i] += side * h
            nodes.append(
                (model.version(record, moved, included, magnitudes), side * h, side * 0.5 / h)
            )
        out.append(_Column(p.name, tuple(nodes), p.size))
    for k, candidate in enumerate(included):
        h = SHIFT * candidate.effect.scale
        low, high = candidate.effect.bounds
        sides = [s for s in (1.0, -1.0) if low <= magnitudes[k] + s * h <= high]
        out.append(_shifted_size(model, record, base, theta, included, magnitudes, k, h, sides))
    for candidate in candidates:
        h = SHIFT * candidate.effect.scale
        low, high = candidate.effect.bounds
        sides = [s for s in (1.0, -1.0) if low <= s * h <= high]
        more = (*included, candidate)
        out.append(
            _shifted_size(
                model,
                record,
                base,
                theta,
                more,
                np.append(magnitudes, 0.0),
                len(included),
                h,
                sides,
            )
        )
    return out


def _shifted_size(
    model: DifferentiableMechanism,
    record: Record,
    base: Variant,
    theta: Array,
    included: tuple[Candidate, ...],
    magnitudes: Array,
    k: int,
    h: float,
    sides: list[float],
) -> _Column:
    nodes = []
    for side in sides:
        moved = magnitudes.copy()
        moved[k] += side * h
        weight = side / (h * len(sides))
        nodes.append((model.version(record, theta, included, moved), side * h, weight))
    if len(sides) == 1:
        nodes.append((base, 0.0, -sides[0] / h))
    return _Column(included[k].name, tuple(nodes), included[k].effect.scale)


def _collect(
    model: DifferentiableMechanism,
    segments: NDArray[np.intp],
    results: Sequence[Any],
    columns: Sequence[_Column],
    base: Variant,
    place: NDArray[np.intp],
    directions: NDArray[np.intp],
    counts: tuple[int, int, int],
    *,
    by_starts: bool,
) -> Sensitivity:
    w, length = len(segments), int(np.max(segments[:, 1] - segments[:, 0])) + 1
    ny, nx, n = len(model.outputs), place.size, len(columns)
    outputs = np.full((w, length, ny), np.nan)
    ends = np.zeros((w, nx))
    d_outputs = np.zeros((w, length, ny, n))
    d_ends = np.zeros((w, nx, n))
    d_starts = np.zeros((w, length, ny, nx if by_starts else 0))
    d_starts_ends = np.zeros((w, nx, nx if by_starts else 0))
    rest = (
        np.stack([c.rest(lambda v: v.rest[directions]) for c in columns], axis=1)
        if n
        else (np.zeros((directions.size, 0)))
    )
    still = np.array([model.at_rest(base, o) for o in model.outputs])
    moving = np.array(
        [[c.rest(lambda v, o=o: model.at_rest(v, o)) for c in columns] for o in model.outputs]
    ).reshape(ny, n)
    for i, (first, last) in enumerate(segments):
        r = results[0] if model.single else results[i]
        skip = int(first) if model.single else 0
        count = int(last - first) + 1
        span = slice(skip, skip + count)
        gradient = np.asarray(r.gradient)[span]
        outputs[i, :count] = np.asarray(r.values)[span] - still
        by_column = gradient[..., :n]
        if not model.single:
            by_column = by_column + np.einsum("tod,dc->toc", gradient[..., n:], rest)
            end = np.asarray(r.end_state)
            final = np.asarray(r.run.end_state)
            ends[i] = final[place] - base.rest[place]
            d_ends[i] = end[place][:, :n] + end[place][:, n:] @ rest - rest[:nx]
            if by_starts:
                d_starts[i, :count] = gradient[..., n : n + nx]
                d_starts_ends[i] = end[place][:, n : n + nx]
        d_outputs[i, :count] = by_column - moving
    a, b, c = counts
    return Sensitivity(
        outputs=outputs,
        ends=ends,
        d_theta=d_outputs[..., :a],
        d_theta_ends=d_ends[..., :a],
        d_magnitudes=d_outputs[..., a : a + b],
        d_magnitudes_ends=d_ends[..., a : a + b],
        d_starts=d_starts,
        d_starts_ends=d_starts_ends,
        d_candidates=d_outputs[..., a + b : a + b + c],
        d_candidates_ends=d_ends[..., a + b : a + b + c],
    )
