"""Derivatives of the segments of a mechanism, integrated together with the motion.

One-sided differences are only used for effects with states of their own at magnitude zero: for a
candidate in this module, and for an included effect in :mod:`feltmb.fit`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feltmb.adapters.differentiable import DifferentiableMechanism
from feltmb.adapters.forward import can_differentiate, forward_sensitivities
from feltmb.data import Array
from feltmb.fit import Jobs, Sensitivity, SensitivityRequest

__all__ = ["sensitivities"]


def sensitivities(
    model: DifferentiableMechanism, request: SensitivityRequest
) -> Sensitivity | None:
    """See :meth:`feltmb.fit.Model.sensitivities`; None if the integration cannot give them."""
    sizes = zip(request.included, request.sizes, strict=True)
    if not all(can_differentiate(t) or s for t, s in sizes):
        return None
    candidates = request.candidates
    smooth = tuple(t for t in candidates if can_differentiate(t))
    rough = tuple(t for t in candidates if not can_differentiate(t))
    found = forward_sensitivities(model, replace(request, candidates=smooth))
    if found is None or not rough:
        return found
    d_rough, d_rough_ends = _candidates(
        model, replace(request, candidates=rough), found.outputs, found.ends
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


def _candidates(
    model: DifferentiableMechanism, request: SensitivityRequest, outputs: Array, ends: Array
) -> tuple[Array, Array]:
    """Derivatives of candidates at zero; hidden states continue from segment to segment."""
    record, theta, segments, starts = (
        request.record,
        request.theta,
        request.segments,
        request.starts,
    )
    candidates, memory = request.candidates, request.memory
    d_outputs = np.zeros((*outputs.shape, len(candidates)))
    d_ends = np.zeros((*ends.shape, len(candidates)))
    count, nx = len(segments), starts.shape[1]

    def one(c: int) -> None:
        candidate = candidates[c]
        step = candidate.effect.step * candidate.effect.scale
        if candidate.effect.bounds[1] < step:
            step = -step
        all_candidates = (*request.included, candidate)
        row = np.append(request.sizes, step)
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
