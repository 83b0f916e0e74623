"""Residuals of a segmented record and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from feltmb.data import Array
from feltmb.fit.model import Candidate, Jobs, Memory, Model, Sensitivity, SensitivityRequest
from feltmb.fit.observe import machine_candidates, observe_all, observe_jobs, observed_sensitivities
from feltmb.fit.segmented_records import SegmentedRecord

__all__ = ["Linear", "Place", "linearize", "predict"]

#: Values above this limit count as diverged; their squares would overflow.
RUNAWAY = 1e100
#: Number of knots of the noise of the inputs within a segment.
INPUT_KNOTS = 6


@dataclass(frozen=True, eq=False)
class Place:
    """Start states (W, nx) and nuisances (nn,) of one segmented record.

    ``memory``: internal memory of the model at the starts, in addition to its states; one item per
    segment.
    """

    starts: Array
    nuisances: Array
    memory: Memory | None = None

    def after(self, ends: Memory | None) -> Memory | None:
        """Memory at the starts of the segments, given ``ends``, the memory at their ends."""
        if ends is None:
            return self.memory
        first = None if self.memory is None else self.memory[0]
        return (first, *ends[:-1])


@dataclass(frozen=True, eq=False)
class InputColumns:
    """Derivatives of one segmented record by its input noise; see :class:`Linear`."""

    by_input: Array
    ends_by_input: Array


@dataclass(frozen=True, eq=False)
class Linear:
    """Whitened residual and derivatives of one record at one point; rows: samples x channels.

    A step d changes the residual to ``residual - J d``, and the continuity defect to
    ``gap - (ends' d - d_next)``.
    """

    residual: Array
    """(W, m)"""
    by_state: Array
    """(W, m, nx)"""
    by_global: Array
    """(W, m, ng): free parameters, magnitudes, candidates, then nuisances of the record."""
    by_input: Array
    """(W, m, mi): standard normal variables that represent the noise of the inputs."""
    gap: Array
    """Continuity defect: end of a segment minus start of the next, (W - 1, nx)."""
    ends_by_state: Array
    """(W, nx, nx)"""
    ends_by_global: Array
    """(W, nx, ng)"""
    ends_by_input: Array
    """(W, nx, mi)"""
    good: Array
    """Whether the simulation of the segment succeeded, (W,)."""
    memory: Memory | None = None
    """Memory of the model at the ends of the segments."""


def _plain(model: Model, segmented: SegmentedRecord, included: tuple[Candidate, ...]) -> bool:
    """Whether the derivatives of the model need no correction by sensors or sensor effects."""
    sensors = [segmented.record.sensors[n] for n in model.outputs if n in segmented.record.sensors]
    return machine_candidates(included) == included and all(
        s.delay == 0.0 and s.gain == 1.0 and s.offset == 0.0 and np.isinf(s.bandwidth)
        for s in sensors
    )


def _with_nuisances(
    segmented: SegmentedRecord, outputs: Array, values: Array
) -> tuple[Array, Array]:
    """Outputs with gains, offsets and delays of the record, and their derivatives (..., nn)."""
    changed = outputs.copy() if len(values) else outputs
    columns = np.zeros((*outputs.shape, len(values)))
    for i, ((kind, c, _), value) in enumerate(zip(segmented.nuisances, values, strict=True)):
        y = outputs[:, :, c]
        if kind == "gain":
            column = y
        elif kind == "offset":
            column = np.ones_like(y)
        else:
            at = np.minimum(
                segmented.segments[:, :1] + np.arange(y.shape[1]), segmented.record.samples - 1
            )
            time = segmented.record.time[at]
            column = np.zeros_like(y)
            step = np.maximum(time[:, 1:] - time[:, :-1], 1e-300)
            slope = np.where(time[:, 1:] > time[:, :-1], np.diff(y, axis=1) / step, 0.0)
            column[:, :-1] -= 0.5 * slope
            column[:, 1:] -= 0.5 * slope
            column[:, 0] *= 2.0
            ends = (np.arange(len(y)), segmented.segments[:, 1] - segmented.segments[:, 0])
            column[ends] *= 2.0
        columns[:, :, c, i] = column
        changed[:, :, c] += value * column
    return changed, columns


def predict(
    model: Model,
    segmented: SegmentedRecord,
    theta: Array,
    included: tuple[Candidate, ...],
    magnitudes: Array,
    place: Place,
) -> tuple[Array, Array, Array]:
    """Outputs (W, L, ny), whitened residual (W, m), continuity defects (W - 1, nx) of a record."""
    run = observe_jobs(
        model,
        segmented.record,
        Jobs.at_point(theta, segmented.segments, place.starts, included, magnitudes, place.memory),
    )
    outputs, _ = _with_nuisances(
        segmented, run.outputs[:, : segmented.measured.shape[1]], place.nuisances
    )
    with np.errstate(over="ignore", invalid="ignore"):
        residual = segmented.whiten(segmented.measured - outputs)
    return outputs, residual.reshape(segmented.count, -1), run.ends[:-1] - place.starts[1:]


def linearize(
    model: Model,
    segmented: SegmentedRecord,
    theta: Array,
    free: list[int],
    included: tuple[Candidate, ...],
    magnitudes: Array,
    place: Place,
    candidates: tuple[Candidate, ...] = (),
    known: Linear | InputColumns | None = None,
) -> Linear:
    """Residual and derivatives by states, free parameters, magnitudes, candidates and nuisances.

    ``known``: derivatives by the input noise of a nearby linearization, which are reused.
    """
    count = segmented.count
    ask = model.sensitivities if _plain(model, segmented, (*included, *candidates)) else None
    if ask is None:
        ask = partial(observed_sensitivities, model)
    # The laws of the model vary between segments in held-out records as well.
    noisy = [i for i, p in enumerate(model.parameters) if p.process_sd > 0.0]
    also = [i for i in noisy if i not in free] if place.starts.shape[1] else []
    with np.errstate(invalid="ignore", over="ignore"):  # failed segments contain NaN
        s = ask(
            SensitivityRequest(
                segmented.record,
                theta,
                segmented.segments,
                place.starts,
                included,
                magnitudes,
                by_theta=[*free, *also],
                by_starts=place.starts.shape[1] > 0,
                candidates=candidates,
                memory=place.memory,
            )
        )
    if known is not None:
        by_input, ends_by_input = np.zeros((*s.outputs.shape, 0)), known.ends_by_input
    else:
        by_input, ends_by_input = _input_noise(
            model, segmented, theta, included, magnitudes, place, s
        )
        by_input, ends_by_input = _with_process_noise(
            model, [*free, *also], s, by_input, ends_by_input
        )
    if also:
        own = slice(0, len(free))
        s = replace(s, d_theta=s.d_theta[..., own], d_theta_ends=s.d_theta_ends[..., own])
    outputs, nuisance = _with_nuisances(segmented, s.outputs, place.nuisances)
    nn = nuisance.shape[3]
    columns = np.concatenate(
        [s.d_starts, s.d_theta, s.d_magnitudes, s.d_candidates, nuisance, by_input], axis=3
    )
    good = np.all(np.isfinite(np.where(segmented.valid, outputs, 0.0)), axis=(1, 2))
    good &= np.all(np.isfinite(s.ends), axis=1)
    columns = _tame(columns)
    rows = segmented.measured.shape[1] * segmented.measured.shape[2]
    white = segmented.whiten(columns).reshape(count, rows, columns.shape[3])
    nx = place.starts.shape[1]
    ng = columns.shape[3] - nx - by_input.shape[3]
    ends_by_global = np.concatenate(
        [s.d_theta_ends, s.d_magnitudes_ends, s.d_candidates_ends, np.zeros((count, nx, nn))],
        axis=2,
    )
    return Linear(
        residual=_tame(segmented.whiten(segmented.measured - outputs).reshape(count, -1)),
        by_state=white[..., :nx],
        by_global=white[..., nx : nx + ng],
        by_input=white[..., nx + ng :] if known is None else known.by_input,
        gap=_tame(s.ends[:-1] - place.starts[1:]),
        ends_by_state=_tame(s.d_starts_ends) if nx else np.zeros((count, 0, 0)),
        ends_by_global=_tame(ends_by_global),
        ends_by_input=_tame(ends_by_input),
        good=good,
        memory=s.memory,
    )


def _with_process_noise(
    model: Model, asked: list[int], s: Sensitivity, by_input: Array, ends_by_input: Array
) -> tuple[Array, Array]:
    """Add standard normal variables for ``process_sd``, the variation of laws by segment."""
    if not s.ends.shape[1]:  # with one segment, nothing can vary between segments
        return by_input, ends_by_input
    sd = np.array([model.parameters[i].process_sd for i in asked])
    some = np.flatnonzero(sd)
    return (
        np.concatenate([by_input, s.d_theta[..., some] * sd[some]], axis=3),
        np.concatenate([ends_by_input, s.d_theta_ends[..., some] * sd[some]], axis=2),
    )


def _tame(values: Array) -> Array:
    """Replace NaN, infinite and diverged values by zero."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) < RUNAWAY, values, 0.0)


def _input_noise(
    model: Model,
    segmented: SegmentedRecord,
    theta: Array,
    included: tuple[Candidate, ...],
    magnitudes: Array,
    place: Place,
    base: Sensitivity,
) -> tuple[Array, Array]:
    """Derivatives of outputs and end states by standard normal variables for the input noise.

    Within a segment, the noise is piecewise linear between knots. A knot represents an interval D
    of noise with standard deviation s and correlation time c, sampled with step h. Its variance is
    s^2 (h + 2 c) / D. The integral over the interval, to which an inertia responds, then has the
    correct variance.
    """
    record = segmented.record
    noisy = [n for n, s in record.input_sigma.items() if s > 0.0]
    nx = place.starts.shape[1]
    if not noisy or nx == 0:
        return (
            np.zeros((*base.outputs.shape, 0)),
            np.zeros((*base.ends.shape, 0)),
        )
    n = record.samples
    phase = np.zeros(n)
    stretch = np.zeros(n)
    for first, last in segmented.segments:
        phase[first:last] = np.arange(last - first) / (last - first) * (INPUT_KNOTS - 1)
        stretch[first:last] = (record.time[last] - record.time[first]) / (INPUT_KNOTS - 1)
    phase[-1], stretch[-1] = INPUT_KNOTS - 1, stretch[-2]
    jobs = Jobs.at_point(
        theta, segmented.segments, place.starts, included, magnitudes, place.memory
    )
    batches = []
    for name in noisy:
        tau = record.input_correlation_time.get(name, 0.0)
        share = (record.interval + 2.0 * tau) / stretch
        sd = record.input_sigma[name] * np.sqrt(np.minimum(share, 1.0))
        for k in range(INPUT_KNOTS):
            hat = np.maximum(0.0, 1.0 - np.abs(phase - k)) * sd
            if k == INPUT_KNOTS - 1:  # the sample that a segment shares with the next one
                hat[segmented.segments[:, 1]] = sd[segmented.segments[:, 1]]
            if k == 0:
                hat[segmented.segments[1:, 0]] = 0.5 * sd[segmented.segments[1:, 0]]
            batches.append((record.with_inputs({name: record.inputs[name] + hat}), jobs))
    runs = observe_all(model, batches)
    return (
        np.stack([run.outputs - base.outputs for run in runs], axis=3),
        np.stack([run.ends - base.ends for run in runs], axis=2),
    )
