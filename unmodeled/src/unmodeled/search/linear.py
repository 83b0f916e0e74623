"""Residuals of records and their derivatives at a point, for several sets of causes at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from unmodeled.chain import Link, fault_of, faults, through
from unmodeled.data import Array
from unmodeled.fit.observe import machine_candidates, observe_all, observed_sensitivities
from unmodeled.models.model import (
    Candidate,
    Effect,
    Sensitivity,
    SensitivityRequest,
    ShapeChange,
    State,
    reshaped,
    start_in,
)
from unmodeled.search.problem import Local, Members, Observed, Problem

#: Derivatives by one scale of an unknown that exceed the motion of the channel so many times count
#: as diverged: the integrator is near its limit of stability there.
STEEP = 100.0
#: Step of a difference by the logarithm of a number of a shape.
SHAPE_STEP = 0.02


@dataclass(frozen=True, eq=False)
class Point:
    """Values of the unknowns of a set, counted in their scales."""

    x: Array
    """Global unknowns: free parameters, magnitudes of effects, numbers of shapes (logarithm)."""
    local: tuple[Array, ...]
    """Unknowns of each record."""


@dataclass(frozen=True, eq=False)
class EvaluationRequest:
    """A point at which residuals are wanted, with or without derivatives."""

    members: Members
    point: Point
    records: tuple[Observed, ...]
    further: Members = ()
    """Effects that are not in the set: derivatives by their magnitudes at zero."""
    derivatives: bool = True
    by_global: bool = True
    rough: bool = False
    """Whether errors of the derivatives of some percent do not matter."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Residual of one record and its derivatives, in units of the noise of the sensors.

    A step d of the unknowns changes the residual to ``residual - J d``. Values that were not
    measured are 0.
    """

    residual: Array
    """(n, m)"""
    by_global: Array
    """(n, m, g)"""
    by_local: Array
    """(n, m, l)"""
    by_further: Array
    """(n, m, c)"""

    @cached_property
    def gram(self) -> Array:
        """Products of all columns and the residual by channel, (m, k, k), k = g + l + c + 1."""
        columns = np.concatenate(
            [self.by_global, self.by_local, self.by_further, self.residual[..., None]], axis=2
        )
        by_channel = np.moveaxis(columns, 1, 0)
        return np.asarray(np.swapaxes(by_channel, 1, 2) @ by_channel)

    @cached_property
    def spectra(self) -> dict[int, Array]:
        """Power of the residual by frequency and channel, by the length of the transform."""
        return {}

    def spectrum(self, length: int) -> Array:
        """Power of the residual by frequency and channel, (k, m)."""
        if length not in self.spectra:
            self.spectra[length] = np.abs(np.fft.rfft(self.residual, length, axis=0)) ** 2
        return self.spectra[length]

    @property
    def failed(self) -> bool:
        """Whether the simulation has failed."""
        return not bool(np.all(np.isfinite(self.residual)))


def magnitudes_at(
    problem: Problem, members: Members, x: Array, observed: Observed | None = None
) -> Array:
    """Magnitudes of the effects of a set in a record [their units]."""
    scales, at = problem.scales_in(members, observed), len(problem.free)
    return scales * x[at : at + len(scales)]


def _places(problem: Problem, members: Members) -> list[tuple[int, int]]:
    """Effect of the set and number of its shape, for each fitted number of a shape."""
    return [(k, p) for k, e in enumerate(problem.effects_of(members)) for p in movable(e)]


def shapes_of(problem: Problem, members: Members, x: Array) -> tuple[Candidate, ...]:
    """The effects of a set with their fitted shapes."""
    candidates = problem.candidates(members)
    at = len(problem.free) + len(candidates)
    steps: list[dict[int, float]] = [{} for _ in candidates]
    for j, (k, place) in enumerate(_places(problem, members)):
        steps[k][place] = float(x[at + j]) * spread_of(candidates[k].effect, place)
    return tuple(
        Candidate(c.effect, moved(c.effect, c.shape, step)) if step else c
        for c, step in zip(candidates, steps, strict=True)
    )


def unknowns_of(problem: Problem, members: Members) -> list[tuple[str, int, int]]:
    """The global unknowns of a set in their order: kind, parameter or cause, number of a shape."""
    own = [m.cause for m in members if problem.causes[m.cause].effect is not None]
    return [
        *(("parameter", i, 0) for i in problem.free),
        *(("magnitude", i, 0) for i in own),
        *(("shape", own[k], place) for k, place in _places(problem, members)),
    ]


def count_global(problem: Problem, members: Members) -> int:
    """Number of global unknowns of a set."""
    return len(problem.free) + len(problem.effects_of(members)) + len(_places(problem, members))


def theta_at(problem: Problem, x: Array) -> Array:
    """Values of all parameters [their units], (p,)."""
    theta = problem.tabulated.copy()
    theta[problem.free] += problem.unit * x[: len(problem.free)]
    return theta


def local_of(problem: Problem, members: Members, observed: Observed) -> tuple[Local, ...]:
    """Unknowns of a record, with those of a set and the start of its hidden states."""
    key = tuple(m.cause for m in members), id(observed)
    if key not in problem.locals_known:
        problem.locals_known[key] = observed, _local_of(problem, members, observed)
    return problem.locals_known[key][1]


def _local_of(problem: Problem, members: Members, observed: Observed) -> tuple[Local, ...]:
    own = len(problem.model.states())
    states = problem.model.states(machine_candidates(problem.candidates(members)))
    hidden = [
        Local("start", i, s.start, s.scale, _weight_of(s))
        for i, s in enumerate(states)
        if i >= own and not _starts_at_rest(observed, s)
    ]
    shown = np.atleast_1d(observed.valid.any(axis=0))
    further = (q for q in problem.locals_of(members) if q.kind == "own" or shown[q.index])
    return (*observed.local, *further, *hidden)


def _starts_at_rest(observed: Observed, state: State) -> bool:
    """Whether the start of a hidden state is known: the record begins where the model begins."""
    start = observed.record.start
    return state.start_sd == 0.0 and (start is None or start.known)


def _weight_of(state: State) -> float:
    sd = state.start_sd if 0.0 < state.start_sd < np.inf else state.scale
    return float((state.scale / sd) ** 2)


def evaluate(problem: Problem, asks: Sequence[EvaluationRequest]) -> list[list[Linear]]:
    """Residuals, and derivatives where they are wanted, by record of each request.

    All simulations of all requests are one call of the model, so that a model that simulates many
    jobs together is called once.
    """
    derived = [ask for ask in asks if ask.derivatives]
    plain = [ask for ask in asks if not ask.derivatives]
    found: dict[int, list[Linear]] = {}
    with np.errstate(all="ignore"):
        for ask, own in zip(derived, _derived(problem, derived), strict=True):
            found[id(ask)] = own
        for ask, own in zip(plain, _plain(problem, plain), strict=True):
            found[id(ask)] = own
    return [found[id(ask)] for ask in asks]


def start_states(problem: Problem, ask: EvaluationRequest, r: int) -> Array:
    """Start states of the model and of the effects of a set [their units], (nx,)."""
    observed, values = ask.records[r], ask.point.local[r]
    states = problem.model.states(machine_candidates(problem.candidates(ask.members)))
    start = np.array([start_in(s, observed.record)[0] for s in states], dtype=np.float64)
    for local, value in zip(local_of(problem, ask.members, observed), values, strict=True):
        if local.kind == "start":
            start[local.index] = local.mean + local.scale * value
    return start


def request_at(problem: Problem, ask: EvaluationRequest, r: int) -> SensitivityRequest:
    """The simulation of a record at a point, and the derivatives that are wanted."""
    x, observed = ask.point.x, ask.records[r]
    included = shapes_of(problem, ask.members, x)
    return SensitivityRequest(
        observed.record,
        theta_at(problem, x),
        start_states(problem, ask, r),
        included,
        magnitudes_at(problem, ask.members, x, observed) + _own_sizes(problem, ask, r),
        by_theta=[*problem.free, *_moved_only(problem, ask.members)]
        if ask.by_global
        else [e.moves for e in problem.effects_of(ask.members) if e.moves is not None],
        by_starts=any(q.kind == "start" for q in local_of(problem, ask.members, observed)),
        candidates=problem.candidates(ask.further),
        shape_changes=tuple(
            c for c in _shape_changes(problem, ask) if included[c.effect].effect.rate is not None
        ),
        rough=ask.rough,
    )


def _own_sizes(problem: Problem, ask: EvaluationRequest, r: int) -> Array:
    """What the magnitudes of the effects of a set are in a record beside those of all records."""
    own = [m.cause for m in ask.members if problem.causes[m.cause].effect is not None]
    out, local = np.zeros(len(own)), local_of(problem, ask.members, ask.records[r])
    for q, value in zip(local, ask.point.local[r], strict=True):
        if q.kind == "own":
            out[own.index(q.index)] += q.scale * value
    return out


def _moved_only(problem: Problem, members: Members) -> list[int]:
    """Parameters that effects of a set move, besides those that are fitted."""
    moved = [e.moves for e in problem.effects_of(members)]
    return [i for i in moved if i is not None and i not in problem.free]


def _plain(problem: Problem, asks: Sequence[EvaluationRequest]) -> list[list[Linear]]:
    requests = [request_at(problem, ask, r) for ask in asks for r in range(len(ask.records))]
    batches = [(request.record, request.jobs()) for request in requests]
    runs = iter(observe_all(problem.model, batches))
    out = []
    for ask in asks:
        own = []
        for r, o in enumerate(ask.records):
            outputs = next(runs)[0][:, list(problem.channels)]
            nothing = np.zeros((*outputs.shape, 0))
            readings, _, _ = _sensed(problem, ask, r, outputs, nothing)
            own.append(Linear(_residual(o, readings), nothing, nothing, nothing))
        out.append(own)
    return out


def _derived(problem: Problem, asks: Sequence[EvaluationRequest]) -> list[list[Linear]]:
    requests = [request_at(problem, ask, r) for ask in asks for r in range(len(ask.records))]
    found_all = observed_sensitivities(problem.model, requests) if requests else []
    by_shapes = iter(_by_shapes(problem, asks, requests, found_all))
    found = iter(found_all)
    out = []
    for ask in asks:
        found_of = []
        for r, o in enumerate(ask.records):
            scales, further = (problem.scales_in(m, o) for m in (ask.members, ask.further))
            s, columns = next(found), list(problem.channels)
            shape_columns = next(by_shapes)[:, columns]
            local = local_of(problem, ask.members, o)
            own = [m.cause for m in ask.members if problem.causes[m.cause].effect is not None]
            places = [own.index(q.index) for q in local if q.kind == "own"]
            by_outputs = [s.d_starts[:, columns], s.d_candidates[:, columns] * further]
            by_outputs += [s.d_magnitudes[:, columns][..., places]]
            if ask.by_global:
                by_outputs += [s.d_theta[:, columns, : len(problem.free)] * problem.unit]
                by_outputs += [s.d_magnitudes[:, columns] * scales, shape_columns]
            ends = np.cumsum([part.shape[2] for part in by_outputs[:3]])
            readings, by_readings, by_local = _sensed(
                problem, ask, r, s.outputs[:, columns], np.concatenate(by_outputs, axis=2)
            )
            by_starts, by_further, by_own, by_global = np.split(by_readings, ends, axis=2)
            sizes = iter(np.moveaxis(by_own, 2, 0))
            for j, q in enumerate(local):
                if q.kind in ("start", "own"):
                    column = by_starts[:, :, q.index] if q.kind == "start" else next(sizes)
                    by_local[:, :, j] = column * q.scale
            found_of.append(
                Linear(
                    _residual(o, readings),
                    _scaled(problem, o, by_global),
                    _scaled(problem, o, by_local),
                    _scaled(problem, o, by_further),
                )
            )
        out.append(found_of)
    return out


def _shape_changes(problem: Problem, ask: EvaluationRequest) -> list[ShapeChange]:
    """Central differences by the unknowns of shapes."""
    if not ask.by_global:
        return []
    out, effects = [], problem.effects_of(ask.members)
    included = shapes_of(problem, ask.members, ask.point.x)
    for k, place in _places(problem, ask.members):
        effect, shape = effects[k], included[k].shape
        lower, upper = (moved(effect, shape, {place: sign * SHAPE_STEP}) for sign in (-1.0, 1.0))
        out.append(ShapeChange(k, lower, upper, 2.0 * SHAPE_STEP / spread_of(effect, place)))
    return out


def _by_shapes(
    problem: Problem,
    asks: Sequence[EvaluationRequest],
    requests: Sequence[SensitivityRequest],
    found: Sequence[Sensitivity],
) -> Iterator[Array]:
    """Outputs by the unknowns of shapes, (n, ny, s), by request.

    Those that the model does not differentiate are differences of simulations.
    """
    batches = []
    known: list[tuple[Array | None, list[ShapeChange], list[bool]]] = []
    all_changes = [_shape_changes(problem, ask) for ask in asks for _ in ask.records]
    for request, s, changes in zip(requests, found, all_changes, strict=True):
        exact = [s.d_shapes is not None and c in request.shape_changes for c in changes]
        known.append((s.d_shapes, changes, exact))
        for change in (c for c, done in zip(changes, exact, strict=True) if not done):
            for shape in (change.upper, change.lower):
                other = reshaped(request.included, change.effect, shape)
                batches.append((request.record, replace(request, included=other).jobs()))
    runs = iter(observe_all(problem.model, batches) if batches else [])
    for s, (d_shapes, changes, exact) in zip(found, known, strict=True):
        columns = np.zeros((*s.outputs.shape, len(changes)))
        if d_shapes is not None:
            columns[..., exact] = d_shapes
        for j, change in enumerate(changes):
            if not exact[j]:
                columns[..., j] = (next(runs)[0] - next(runs)[0]) / change.width
        yield columns


def _sensed(
    problem: Problem, ask: EvaluationRequest, r: int, outputs: Array, columns: Array
) -> tuple[Array, Array, Array]:
    """Readings with the errors of the sensors of a record, and their derivatives.

    The derivatives are those of the outputs, ``columns``, and by the unknowns of the record.
    """
    observed, values = ask.records[r], ask.point.local[r]
    local = local_of(problem, ask.members, observed)
    order = {name: i for i, name in enumerate(faults())}
    faulty = [j for j, q in enumerate(local) if q.kind in order]
    own = sorted(faulty, key=lambda j: order[local[j].kind])
    links = [
        (Link(fault, q.channels), float(values[j]) * q.scale, None)
        for j in own
        for q in (local[j],)
        for alone in (problem.names[q.channels[0]] if len(q.channels) == 1 else "",)
        for fault in (fault_of(q.kind).at(alone),)
    ]
    count = columns.shape[2]
    readings, columns = through(links, observed.record, outputs, columns)
    by_local = np.zeros((*outputs.shape, len(local)))
    by_local[..., own] = columns[..., count:] * np.array([local[j].scale for j in own])
    for j, (q, value) in enumerate(zip(local, values, strict=True)):
        if q.kind == "mode":
            assert observed.modes is not None
            by_local[..., j] = observed.modes[:, :, q.index]
            readings = readings + value * by_local[..., j]
    return readings, columns[..., :count], by_local


def _residual(observed: Observed, readings: Array) -> Array:
    """Residual in units of the noise; NaN where the simulation failed."""
    left = (observed.measured - readings) / observed.sd
    squares = left * left * left.size  # their sum must be a number, too
    return np.where(observed.valid, np.where(np.isfinite(squares), left, np.nan), 0.0)


def _scaled(problem: Problem, observed: Observed, columns: Array) -> Array:
    """Derivatives in units of the noise, 0 where nothing was measured or the values diverge."""
    limit = STEEP * np.maximum(problem.motion, problem.noise)[:, None]
    good = observed.valid[..., None] & (np.abs(columns) < limit)
    return np.where(good, columns / observed.sd[..., None], 0.0)


# ------------------------------------------------------------------------------- numbers of shapes


#: Smallest standard deviation of the logarithm of a number of a shape.
NARROW = 0.35


@lru_cache(maxsize=1000)
def movable(effect: Effect) -> tuple[int, ...]:
    """Indices of the numbers of a shape that may take any value: (0,) if the shape is one number.

    These are floats on one side of ``effect.shape_zero``, of which the list has two or more values.
    Integers, zeros, texts and constants are not fitted.
    """
    rows = [s if isinstance(s, tuple) else (s,) for s in effect.shapes]
    if len({len(r) for r in rows}) != 1:
        return ()
    zero = effect.shape_zero
    found = []
    for k, column in enumerate(zip(*rows, strict=True)):
        if not all(isinstance(v, float) and 0.0 < abs(v - zero) < math.inf for v in column):
            continue
        if len(set(column)) > 1 and len({math.copysign(1.0, v - zero) for v in column}) == 1:
            found.append(k)
    return tuple(found)


@lru_cache(maxsize=1000)
def spread_of(effect: Effect, place: int) -> float:
    """Standard deviation of the prior of the logarithm of one number of a shape [1].

    It is half of the range of the listed values, but not less than ``NARROW``.
    """
    rows = [s if isinstance(s, tuple) else (s,) for s in effect.shapes]
    logs = [math.log(abs(r[place] - effect.shape_zero)) for r in rows]
    return max(0.5 * (max(logs) - min(logs)), NARROW)


def moved(effect: Effect, shape: Any, steps: dict[int, float]) -> Any:
    """The shape with some of its numbers multiplied by exp(step), counted from ``shape_zero``."""
    if not steps:
        return shape
    zero = effect.shape_zero
    row = list(shape) if isinstance(shape, tuple) else [shape]
    for place, step in steps.items():
        row[place] = zero + (row[place] - zero) * math.exp(step)
    return tuple(row) if isinstance(shape, tuple) else row[0]
