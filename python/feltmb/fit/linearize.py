"""Residuals of segmented records and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Record
from feltmb.fit.model import (
    Candidate,
    Model,
    Sensitivity,
    SensitivityRequest,
)
from feltmb.fit.noise import sd_of_knots
from feltmb.fit.observe import machine_candidates, observed_sensitivities
from feltmb.fit.segmented_records import SegmentedRecord

__all__ = ["RUNAWAY", "Linear", "Place", "linearize", "varying", "with_nuisances"]

#: Values above this limit count as diverged; their squares would overflow.
RUNAWAY = 1e100
#: Number of knots of the noise of the inputs within a segment.
INPUT_KNOTS = 6


@dataclass(frozen=True, eq=False)
class Place:
    """Start states (W, nx) and nuisances (nn,) of one segmented record."""

    starts: Array
    nuisances: Array


@dataclass(frozen=True, eq=False)
class InputColumns:
    """Derivatives of one segmented record by its input noise; see :class:`Linear`."""

    by_input: Array
    ends_by_input: Array


@dataclass(frozen=True, eq=False)
class Linear:
    """Whitened residual and derivatives of one record at one point; rows: samples x channels.

    A step d changes the residual to ``residual - J d``, and the continuity defect to
    ``defect - (ends' d - d_next)``.
    """

    residual: Array
    """(W, m)"""
    by_state: Array
    """(W, m, nx)"""
    by_global: Array
    """(W, m, ng): free parameters, magnitudes, candidates, then nuisances of the record."""
    by_input: Array
    """(W, m, mi): standard normal variables that represent the noise of the inputs, then the
    deviations of parameters between segments (:func:`varying`)."""
    defect: Array
    """Continuity defect: end of a segment minus start of the next, (W - 1, nx)."""
    ends_by_state: Array
    """(W, nx, nx)"""
    ends_by_global: Array
    """(W, nx, ng)"""
    ends_by_input: Array
    """(W, nx, mi)"""
    good: Array
    """Whether the simulation of the segment succeeded, (W,)."""


def with_nuisances(
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


def varying(model: Model, free: Sequence[int]) -> list[int]:
    """Parameters that vary between segments, in the order of their columns in ``by_input``."""
    noisy = [i for i, p in enumerate(model.parameters) if p.process_sd > 0.0]
    return [*(i for i in free if i in noisy), *(i for i in noisy if i not in free)]


def linearize(
    model: Model,
    segmented_records: Sequence[SegmentedRecord],
    theta: Array,
    free: list[int],
    included: tuple[Candidate, ...],
    magnitudes: Array,
    places: Sequence[Place],
    candidates: tuple[Candidate, ...] = (),
    known: Sequence[Linear | InputColumns] | None = None,
) -> list[Linear]:
    """Residual and derivatives by states, free parameters, magnitudes, candidates and nuisances.

    ``known``: derivatives by the input noise of nearby linearizations, which are reused.
    """
    has_states = bool(model.states(machine_candidates(included)))
    # The laws of the model vary between segments in held-out records as well.
    also = [i for i in varying(model, free) if i not in free] if has_states else []
    noisy = known is None and has_states  # without states, noise is a part of the variability
    requests = [
        SensitivityRequest(
            segmented.record,
            theta,
            segmented.segments,
            place.starts,
            included,
            magnitudes,
            by_theta=[*free, *also],
            by_starts=has_states,
            candidates=candidates,
            input_changes=tuple(_input_noise(segmented.record, segmented.segments))
            if noisy
            else (),
        )
        for segmented, place in zip(segmented_records, places, strict=True)
    ]
    with np.errstate(invalid="ignore", over="ignore"):  # failed segments contain NaN
        found = observed_sensitivities(model, requests)
    if known is None:
        noise = [_noise(model, r, s) for r, s in zip(requests, found, strict=True)]
    else:
        noise = [(np.zeros((*s.outputs.shape, 0)), np.zeros((*s.ends.shape, 0))) for s in found]
    linears = [
        _linear(segmented, place, s, len(free), *own)
        for segmented, place, s, own in zip(segmented_records, places, found, noise, strict=True)
    ]
    if known is None:
        return linears
    return [
        replace(x, by_input=near.by_input, ends_by_input=near.ends_by_input)
        for x, near in zip(linears, known, strict=True)
    ]


def _linear(
    segmented: SegmentedRecord,
    place: Place,
    s: Sensitivity,
    free: int,
    by_input: Array,
    ends_by_input: Array,
) -> Linear:
    """Whitened residual and derivatives of one record; ``free``: number of free parameters."""
    count = segmented.count
    outputs, nuisance = with_nuisances(segmented, s.outputs, place.nuisances)
    nn = nuisance.shape[3]
    columns = np.concatenate(
        [s.d_starts, s.d_theta[..., :free], s.d_magnitudes, s.d_candidates, nuisance, by_input],
        axis=3,
    )
    good = np.all(np.isfinite(np.where(segmented.valid, outputs, 0.0)), axis=(1, 2))
    good &= np.all(np.isfinite(s.ends), axis=1)
    columns = _tame(columns)
    rows = segmented.measured.shape[1] * segmented.measured.shape[2]
    white = segmented.whiten(columns).reshape(count, rows, columns.shape[3])
    nx = place.starts.shape[1]
    ng = columns.shape[3] - nx - by_input.shape[3]
    ends_by_global = np.concatenate(
        [
            s.d_theta_ends[..., :free],
            s.d_magnitudes_ends,
            s.d_candidates_ends,
            np.zeros((count, nx, nn)),
        ],
        axis=2,
    )
    return Linear(
        residual=_tame(segmented.whiten(segmented.measured - outputs).reshape(count, -1)),
        by_state=white[..., :nx],
        by_global=white[..., nx : nx + ng],
        by_input=white[..., nx + ng :],
        defect=_tame(s.ends[:-1] - place.starts[1:]),
        ends_by_state=_tame(s.d_starts_ends) if nx else np.zeros((count, 0, 0)),
        ends_by_global=_tame(ends_by_global),
        ends_by_input=_tame(ends_by_input),
        good=good,
    )


def _tame(values: Array) -> Array:
    """Replace NaN, infinite and diverged values by zero."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) < RUNAWAY, values, 0.0)


def _noise(model: Model, request: SensitivityRequest, found: Sensitivity) -> tuple[Array, Array]:
    """Derivatives of outputs and ends by standard normal variables for the noise of a record.

    Noise of the inputs, then ``process_sd``, the variation of laws by segment.
    """
    assert found.d_inputs is not None
    assert found.d_inputs_ends is not None
    if not found.ends.shape[1]:  # without states there are no segments between which a law varies
        return found.d_inputs, found.d_inputs_ends
    sd = np.array([model.parameters[i].process_sd for i in request.parameters_of(model)])
    own = np.flatnonzero(sd)
    return (
        np.concatenate([found.d_inputs, found.d_theta[..., own] * sd[own]], axis=3),
        np.concatenate([found.d_inputs_ends, found.d_theta_ends[..., own] * sd[own]], axis=2),
    )


def _input_noise(record: Record, segments: NDArray[np.intp]) -> list[Mapping[str, Array]]:
    """Changes of the inputs by one standard deviation, one per standard normal variable.

    Within a segment, the noise is piecewise linear between knots; see
    :func:`~feltmb.fit.noise.sd_of_knots`.
    """
    n = record.samples
    phase = np.zeros(n)
    stretch = np.zeros(n)
    for first, last in segments:
        phase[first:last] = np.arange(last - first) / (last - first) * (INPUT_KNOTS - 1)
        stretch[first:last] = (record.time[last] - record.time[first]) / (INPUT_KNOTS - 1)
    phase[-1], stretch[-1] = INPUT_KNOTS - 1, stretch[-2]
    changes: list[Mapping[str, Array]] = []
    for name, sigma in record.input_sigma.items():
        if not sigma > 0.0:
            continue
        sd = sd_of_knots(record, name, stretch)
        for k in range(INPUT_KNOTS):
            hat = np.maximum(0.0, 1.0 - np.abs(phase - k)) * sd
            if k == INPUT_KNOTS - 1:  # the sample that a segment shares with the next one
                hat[segments[:, 1]] = sd[segments[:, 1]]
            if k == 0:
                hat[segments[1:, 0]] = 0.5 * sd[segments[1:, 0]]
            changes.append({name: hat})
    return changes
