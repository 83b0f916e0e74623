"""Simulation including the measurement: input effects, sensor effects, known sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.chain import Link, fault_of, through
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter
from unmodeled.models.model import (
    Batch,
    Candidate,
    Jobs,
    Model,
    Sensitivity,
    SensitivityRequest,
    difference_offsets,
    difference_sensitivities,
)
from unmodeled.ode.calling import calling


def machine_candidates(included: tuple[Candidate, ...]) -> tuple[Candidate, ...]:
    """Candidates that the model itself must simulate: no parameter, sensor or input effects."""
    return tuple(
        t
        for t in included
        if t.effect.excite is None and t.effect.observe is None and t.effect.moves is None
    )


def _moved(included: Sequence[Candidate], sizes: Array, theta: Array) -> Array:
    """Parameters, (B, p), with the magnitudes, (B, k), of the effects that move them."""
    moved = [(k, t.effect.moves) for k, t in enumerate(included) if t.effect.moves is not None]
    if moved:
        theta = np.array(theta, dtype=np.float64)
        for k, i in moved:
            theta[:, i] += sizes[:, k]
    return theta


def observe(
    model: Model,
    record: Record,
    theta: Array,
    start: Array,
    included: tuple[Candidate, ...] = (),
    magnitudes: Array | None = None,
) -> Array:
    """Sensor readings, (n, ny), of one simulation of a record from a start state, (nx,)."""
    sizes = np.zeros(len(included)) if magnitudes is None else magnitudes
    jobs = Jobs(theta=theta[None], starts=start[None], included=included, magnitudes=sizes[None])
    return np.asarray(observe_all(model, [(record, jobs)])[0][0])


def motion(model: Model, record: Record, jobs: Jobs) -> Array | None:
    """States over a record, (n, nx), of a single job with its input effects; None: it has none."""
    ((_, batch),) = excited(record, jobs)
    path = model.motion(*batch)
    return None if path is None else path[0]


def observe_all(model: Model, batches: Sequence[Batch]) -> list[Array]:
    """Simulate jobs and convert the outputs, (B, n, ny), to the readings of the sensors.

    Input effects change the inputs before the simulation of the model. Sensor effects and the known
    part of the sensors (gain, delay, low-pass, offset) change the outputs after it.
    """
    if not batches:
        return []
    split = [excited(record, jobs) for record, jobs in batches]
    with calling(f"model {model.name}: its simulation"):
        runs = iter(model.simulate_all([batch for parts in split for _, batch in parts]))
    return [
        _observed(model, record, jobs, [(rows, next(runs)) for rows, _ in parts])
        for (record, jobs), parts in zip(batches, split, strict=True)
    ]


def _observed(
    model: Model, record: Record, jobs: Jobs, parts: list[tuple[NDArray[np.intp], Array]]
) -> Array:
    """Sensor readings of jobs that were simulated in parts, given as (rows, outputs)."""
    outputs = parts[0][1]
    if len(parts) > 1:
        outputs = np.full((jobs.count, *outputs.shape[1:]), np.nan)
        for rows, run in parts:
            outputs[rows] = run
    for k, candidate in enumerate(jobs.included):
        if candidate.effect.observe is not None:
            outputs = _seen(candidate, record, outputs, jobs.magnitudes[:, k])
    for link, size, _ in _sensors(model, record):
        outputs = link(record, outputs, np.full(jobs.count, size))
    return outputs


def _seen(candidate: Candidate, record: Record, outputs: Array, magnitudes: Array) -> Array:
    """Apply a sensor effect to a copy of the outputs, which it may change in place."""
    assert candidate.effect.observe is not None
    # Failed jobs contain NaN or infinity.
    with calling(f"effect {candidate.name}: its observe"), np.errstate(all="ignore"):
        seen = candidate.effect.observe(record, outputs.copy(), magnitudes, candidate.shape)
    if np.shape(seen) != outputs.shape:
        raise InvalidParameter(
            f"effect {candidate.name}: observe returned shape {np.shape(seen)}, expected that of "
            f"the outputs, {outputs.shape}"
        )
    return np.asarray(seen)


def _changed(candidate: Candidate, record: Record, size: float) -> Record:
    """A record with inputs changed by an input effect."""
    excite = candidate.effect.excite
    assert excite is not None
    with calling(f"effect {candidate.name}: its excite"):
        return record.with_changed_inputs(lambda whole: excite(whole, size, candidate.shape))


def excited(record: Record, jobs: Jobs) -> list[tuple[NDArray[np.intp], Batch]]:
    """Split jobs by the magnitudes of their input effects, and apply these to the record.

    Returns for each set of magnitudes the rows, the record with changed inputs, and its jobs.
    """
    inner = [k for k, t in enumerate(jobs.included) if t in machine_candidates(jobs.included)]
    excite = [k for k, t in enumerate(jobs.included) if t.effect.excite is not None]
    plain = replace(
        jobs,
        theta=_moved(jobs.included, jobs.magnitudes, jobs.theta),
        included=tuple(jobs.included[k] for k in inner),
        magnitudes=jobs.magnitudes[:, inner] if jobs.included else jobs.magnitudes,
    )
    if not excite:
        return [(np.arange(jobs.count), (record, plain))]
    magnitudes, which = np.unique(jobs.magnitudes[:, excite], axis=0, return_inverse=True)
    parts = []
    for v, row in enumerate(magnitudes):
        changed = record
        for k, size in zip(excite, row, strict=True):
            candidate = jobs.included[k]
            assert candidate.effect.excite is not None
            if size != 0.0:
                changed = _changed(candidate, changed, size)
        rows = np.flatnonzero(which.reshape(-1) == v)
        part = replace(
            plain,
            theta=plain.theta[rows],
            starts=plain.starts[rows],
            magnitudes=plain.magnitudes[rows] if plain.included else plain.magnitudes,
            forces=None if plain.forces is None else plain.forces[rows],
        )
        parts.append((rows, (changed, part)))
    return parts


def _sensors(model: Model, record: Record) -> list[tuple[Link, float, None]]:
    """Known errors of the sensors of the outputs, with their sizes."""
    return [
        (Link(fault_of(fault), (o,)), size, None)
        for o, name in enumerate(model.outputs)
        if name in record.sensors
        for fault, size in record.sensors[name].known.items()
    ]


def observed_sensitivities(
    model: Model, requests: Sequence[SensitivityRequest]
) -> list[Sensitivity]:
    """Derivatives of the sensor readings, one result per request.

    The model differentiates its outputs, also by changes of its inputs. These derivatives are
    transformed with the sensors and sensor effects, which is cheap.
    """
    inner = [_of_machine(request) for request in requests]
    with calling(f"model {model.name}: its simulation"):
        found = _with_input_changes(model, inner, model.sensitivities(inner))
    return [_readings(model, request, s) for request, s in zip(requests, found, strict=True)]


def _of_machine(request: SensitivityRequest) -> SensitivityRequest:
    """The request without sensor effects, and with the inputs as the input effects change them.

    Derivatives by the magnitudes of input effects are requested as changes of the inputs. They
    follow those of the request, first for the included effects, then for the candidates.
    """
    machine = machine_candidates(request.included)
    sizes = [size for t, size in zip(request.included, request.sizes, strict=True) if t in machine]
    record = _acting(request.record, request.included, request.sizes)
    changes = [_through_effects(request, record, change) for change in request.input_changes]
    by_size = [_by_size(request, record, candidate) for candidate in _input_effects(request)]
    return replace(
        request,
        record=record,
        theta=_moved(request.included, request.sizes[None], np.asarray(request.theta)[None])[0],
        included=machine,
        magnitudes=np.array(sizes),
        candidates=machine_candidates(request.candidates),
        input_changes=(*changes, *by_size),
        shape_changes=tuple(
            replace(c, effect=machine.index(request.included[c.effect]))
            for c in request.shape_changes
        ),
    )


def _through_effects(
    request: SensitivityRequest, acting: Record, change: Mapping[str, Array]
) -> Mapping[str, Array]:
    """A change of the recorded inputs as the included input effects pass it on.

    ``acting``: the record with the inputs at the magnitudes of the request.
    """
    if acting is request.record:
        return change
    moved = [request.record.with_inputs(_added(request.record, change, s)) for s in (1.0, -1.0)]
    up, down = (_acting(record, request.included, request.sizes) for record in moved)
    return _weighted(acting, [(up, 0.5), (down, -0.5)])


def _weighted(acting: Record, others: Sequence[tuple[Record, float]]) -> Mapping[str, Array]:
    """Sum of the weighted differences of the inputs of other records from ``acting``."""
    return {
        name: sum((w * (r.inputs[name] - value) for r, w in others), np.zeros_like(value))
        for name, value in acting.inputs.items()
    }


def _input_effects(request: SensitivityRequest) -> list[Candidate]:
    """Input effects of a request: included ones, then candidates."""
    everything = (*request.included, *request.candidates)
    return [t for t in everything if t.effect.excite is not None and t.effect.observe is None]


def _acting(
    record: Record, included: Sequence[Candidate], sizes: Sequence[float] | Array
) -> Record:
    """The record with the inputs as the input effects change them, in the order of the effects."""
    for candidate, size in zip(included, sizes, strict=True):
        if candidate.effect.excite is not None and size != 0.0:
            record = _changed(candidate, record, float(size))
    return record


def _by_size(
    request: SensitivityRequest, acting: Record, candidate: Candidate
) -> Mapping[str, Array]:
    """Change of the inputs by a natural step (:func:`_step`) of the magnitude of an input effect.

    ``acting``: the record with the inputs at the magnitudes of the request.
    """
    included, sizes = request.included, request.sizes
    if candidate not in included:
        included, sizes = (*included, candidate), np.append(sizes, 0.0)
    at = included.index(candidate)
    others = []
    for offset, weight in _offsets(candidate, float(sizes[at])):
        moved = sizes.copy()
        moved[at] += offset
        other = _acting(request.record, included, moved)
        others.append((other, weight * _step(candidate)))
    return _weighted(acting, others)


def _step(candidate: Candidate) -> float:
    """Step of finite differences by the magnitude of an effect [its unit]."""
    return candidate.effect.step * candidate.effect.scale


def _offsets(candidate: Candidate, at: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Two changes of a magnitude, each with its weight in the derivative."""
    return difference_offsets(at, _step(candidate), *candidate.effect.bounds)


def _with_input_changes(
    model: Model, requests: Sequence[SensitivityRequest], found: Sequence[Sensitivity]
) -> list[Sensitivity]:
    """Add derivatives by changes of the inputs where the model did not compute them."""
    out = list(found)
    lacking = [i for i, s in enumerate(found) if s.d_inputs is None]
    fewer = [
        replace(requests[i], by_theta=(), by_starts=False, candidates=(), shape_changes=())
        for i in lacking
    ]
    for i, s in zip(lacking, difference_sensitivities(model, fewer), strict=True):
        out[i] = replace(out[i], d_inputs=s.d_inputs)
    return out


def _added(record: Record, change: Mapping[str, Array], sign: float) -> dict[str, Array]:
    return {name: record.inputs[name] + sign * value for name, value in change.items()}


class _Differences:
    """An ``observe`` of a user as a link: with derivatives by differences."""

    def __init__(self, candidate: Candidate):
        self.candidate = candidate

    def __call__(self, run: Record, outputs: Array, sizes: Array, _: object) -> Array:
        return _seen(self.candidate, run, outputs, sizes)

    def by_size(self, run: Record, outputs: Array, size: float, _: object) -> Array:
        """Derivative of the readings by the magnitude, (n, ny)."""
        offsets = _offsets(self.candidate, size)
        moved = np.array([size, *(size + offset for offset, _ in offsets)])
        shown, *others = _seen(self.candidate, run, np.tile(outputs, (3, 1, 1)), moved)
        weighted = zip(offsets, others, strict=True)
        return np.asarray(sum(weight * (other - shown) for (_, weight), other in weighted))

    def push(self, run: Record, outputs: Array, size: float, _: object, columns: Array) -> Array:
        """Derivatives of the readings from those of the outputs."""
        spread = float(np.nanmax(np.abs(outputs), initial=0.0)) or 1.0
        directions = np.moveaxis(columns, 2, 0)
        largest = np.nanmax(np.abs(directions), axis=(1, 2), initial=0.0)[:, None, None]
        steps = np.where(largest > 0.0, 1e-4 * spread / (largest + (largest == 0.0)), 1.0)
        moved = np.concatenate([outputs + steps * directions, outputs - steps * directions])
        shown = _seen(self.candidate, run, moved, np.full(len(moved), size))
        up, down = np.split(shown, 2)
        return np.asarray(np.moveaxis((up - down) / (2.0 * steps), 0, 2))


def _readings(model: Model, request: SensitivityRequest, s: Sensitivity) -> Sensitivity:
    """Derivatives of the readings from those of the outputs, ``s``."""
    record, included, candidates = request.record, request.included, request.candidates
    everything = [*zip(included, map(float, request.sizes), strict=True)]
    everything += [(t, 0.0) for t in candidates]
    seen = [(t, size) for t, size in everything if t.effect.observe is not None]
    links: list[tuple[Any, float, Any]] = []
    for t, size in seen:
        observe = t.effect.observe
        links.append((observe if isinstance(observe, Link) else _Differences(t), size, t.shape))
    assert s.d_inputs is not None
    inner = [s.d_theta, s.d_magnitudes, s.d_starts, s.d_candidates, s.d_inputs]
    inner += [] if s.d_shapes is None else [s.d_shapes]
    ends = np.cumsum([part.shape[-1] for part in inner])
    columns = np.concatenate(inner, axis=2)
    outputs, columns = through(links, record, s.outputs, columns)
    known = _sensors(model, record)
    count = columns.shape[2]
    outputs, columns = through(known, record, outputs, columns)
    theta, sizes, starts, at_zero, inputs, *shapes = np.split(columns[..., :count], ends, axis=2)
    by_sensor = shapes.pop()
    own, of_inputs = len(request.input_changes), _input_effects(request)
    by_theta = request.parameters_of(model)

    def by_magnitudes(wanted: tuple[Candidate, ...], machine: Array) -> Array:
        """Derivatives by the magnitudes of effects; ``machine``: by those of the machine."""
        out, of_machine = np.zeros((*outputs.shape, len(wanted))), machine_candidates(wanted)
        for k, t in enumerate(wanted):
            if t in of_machine:
                out[..., k] = machine[..., of_machine.index(t)]
            elif t.effect.moves is not None:
                if t.effect.moves in by_theta:
                    out[..., k] = theta[..., by_theta.index(t.effect.moves)]
            elif t in of_inputs:
                out[..., k] = inputs[..., own + of_inputs.index(t)] / _step(t)
            else:
                out[..., k] = by_sensor[..., [c for c, _ in seen].index(t)]
        return out

    return Sensitivity(
        outputs=outputs,
        d_theta=theta,
        d_magnitudes=by_magnitudes(included, sizes),
        d_starts=starts,
        d_candidates=by_magnitudes(candidates, at_zero),
        d_inputs=inputs[..., :own],
        d_shapes=shapes[0] if shapes else None,
    )
