"""Derivatives of a mechanism's segments: forward sensitivities, or differences where they fail.

Differences are one-sided, all jobs in one threaded batch. Steps are chosen against the noise of an
adaptive integrator, which is about 0.1 um: a tenth of a tolerance, a fifth of the scale of a
state, the step of an effect. What this costs in curvature is a few percent of a derivative, which a
Gauss-Newton step and a score forgive. Forward sensitivities are exact but cost about twice as much
(docs/gap-action.md); ``model.forward`` chooses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from feltmb.adapters.differentiable import DifferentiableMechanism
from feltmb.adapters.forward import can_differentiate, forward_sensitivities
from feltmb.data import Array, Record
from feltmb.fit import Candidate, Jobs, Memory, Sensitivity

__all__ = ["difference_sensitivities", "sensitivities"]

#: Step of a parameter as a share of its scale.
THETA_STEP = 0.1
#: Step of a state as a share of its scale.
START_STEP = 0.2


def sensitivities(
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
    memory: Memory | None = None,
) -> Sensitivity:
    """See :meth:`feltmb.fit.Model.sensitivities`."""
    smooth = tuple(t for t in candidates if can_differentiate(t))
    rough = tuple(t for t in candidates if not can_differentiate(t))
    if memory is not None and not model.forward:
        memory = None  # differences start every segment as at rest
    fixed = all(can_differentiate(t) or s != 0.0 for t, s in zip(included, magnitudes, strict=True))
    found = None
    if fixed and model.forward:
        found = forward_sensitivities(
            model,
            record,
            theta,
            segments,
            starts,
            included,
            magnitudes,
            by_theta=by_theta,
            by_starts=by_starts,
            candidates=smooth,
            memory=memory,
        )
    if found is None:
        return difference_sensitivities(
            model,
            record,
            theta,
            segments,
            starts,
            included,
            magnitudes,
            by_theta=by_theta,
            by_starts=by_starts,
            candidates=candidates,
        )
    if not rough:
        return found
    d_rough, d_rough_ends = _candidates(
        model,
        record,
        theta,
        segments,
        starts,
        included,
        magnitudes,
        rough,
        found.outputs,
        found.ends,
        memory,
    )
    order = [*smooth, *rough]
    back = [order.index(t) for t in candidates]
    return replace(
        found,
        d_candidates=np.concatenate([found.d_candidates, d_rough], axis=3)[..., back],
        d_candidates_ends=np.concatenate([found.d_candidates_ends, d_rough_ends], axis=2)[
            ..., back
        ],
    )


def difference_sensitivities(
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
) -> Sensitivity:
    """See :meth:`feltmb.fit.Model.sensitivities`."""
    count = len(segments)
    states = model.states(included)
    nx, ny, k = len(states), len(model.outputs), len(included)
    theta, magnitudes = np.asarray(theta, dtype=float), np.asarray(magnitudes, dtype=float)
    rows: list[tuple[Array, Array, Array]] = [(theta, magnitudes, np.zeros(nx))]
    steps: list[float] = []

    def side(value: float, step: float, low: float, high: float) -> float:
        return step if value + step <= high or value - step < low else -step

    for i in by_theta:
        p = model.parameters[i]
        step = side(theta[i], THETA_STEP * p.size, p.lower, p.upper)
        moved = theta.copy()
        moved[i] += step
        rows.append((moved, magnitudes, np.zeros(nx)))
        steps.append(step)
    for i, candidate in enumerate(included):
        low, high = candidate.effect.bounds
        step = side(magnitudes[i], candidate.effect.step * candidate.effect.scale, low, high)
        moved = magnitudes.copy()
        moved[i] += step
        rows.append((theta, moved, np.zeros(nx)))
        steps.append(step)
    if by_starts:
        for i, state in enumerate(states):
            moved = np.zeros(nx)
            moved[i] = START_STEP * state.scale
            rows.append((theta, magnitudes, moved))
            steps.append(moved[i])
    versions = len(rows)
    jobs = Jobs(
        theta=np.repeat(np.array([r[0] for r in rows]), count, axis=0),
        segments=np.tile(segments, (versions, 1)),
        starts=np.tile(starts, (versions, 1)) + np.repeat([r[2] for r in rows], count, axis=0),
        included=included,
        magnitudes=np.repeat(np.array([r[1] for r in rows]).reshape(versions, k), count, axis=0),
    )
    run = model.simulate(record, jobs)
    outputs = run.outputs.reshape(versions, count, -1, ny)
    ends = run.ends.reshape(versions, count, nx)
    scale = np.array(steps).reshape(-1, 1, 1)
    d_outputs = np.moveaxis((outputs[1:] - outputs[0]) / scale[..., None], 0, -1)
    d_ends = np.moveaxis((ends[1:] - ends[0]) / scale, 0, -1)
    d_candidates, d_candidates_ends = _candidates(
        model,
        record,
        theta,
        segments,
        starts,
        included,
        magnitudes,
        candidates,
        outputs[0],
        ends[0],
    )
    a, b = len(by_theta), len(by_theta) + k
    return Sensitivity(
        outputs=outputs[0],
        ends=ends[0],
        d_theta=d_outputs[..., :a],
        d_theta_ends=d_ends[..., :a],
        d_magnitudes=d_outputs[..., a:b],
        d_magnitudes_ends=d_ends[..., a:b],
        d_starts=d_outputs[..., b:],
        d_starts_ends=d_ends[..., b:],
        d_candidates=d_candidates,
        d_candidates_ends=d_candidates_ends,
    )


def _candidates(
    model: DifferentiableMechanism,
    record: Record,
    theta: Array,
    segments: NDArray[np.intp],
    starts: Array,
    included: tuple[Candidate, ...],
    magnitudes: Array,
    candidates: tuple[Candidate, ...],
    outputs: Array,
    ends: Array,
    memory: Memory | None = None,
) -> tuple[Array, Array]:
    """Derivatives of candidates at zero; hidden states run on from segment to segment."""
    d_outputs = np.zeros((*outputs.shape, len(candidates)))
    d_ends = np.zeros((*ends.shape, len(candidates)))
    count, nx = len(segments), starts.shape[1]

    def one(c: int) -> None:
        candidate = candidates[c]
        step = candidate.effect.step * candidate.effect.scale
        if candidate.effect.bounds[1] < step:
            step = -step
        all_candidates = (*included, candidate)
        row = np.append(magnitudes, step)
        if model.single:
            jobs = Jobs(
                theta=np.tile(theta, (count, 1)),
                segments=segments,
                starts=starts,
                included=all_candidates,
                magnitudes=np.tile(row, (count, 1)),
            )
            d_outputs[..., c] = (model.simulate(record, jobs).outputs - outputs) / step
            return
        hidden = np.array([s.start for s in candidate.effect.hidden])
        for w in range(count):
            jobs = Jobs(
                theta=theta[None, :],
                segments=segments[w][None, :],
                starts=np.concatenate([starts[w], hidden])[None, :],
                included=all_candidates,
                magnitudes=row[None, :],
                memory=None if memory is None else memory[w : w + 1],
            )
            run = model.simulate(record, jobs)
            length = int(segments[w, 1] - segments[w, 0]) + 1
            d_outputs[w, :length, :, c] = (run.outputs[0, :length] - outputs[w, :length]) / step
            d_ends[w, :, c] = (run.ends[0, :nx] - ends[w]) / step
            hidden = run.ends[0, nx:]

    model.in_parallel(one, range(len(candidates)))
    return d_outputs, d_ends
