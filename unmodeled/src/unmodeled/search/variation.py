"""Noise of inputs and variation from record to record, as unknowns of each record.

The covariance of the outputs that they cause is computed by linearization. Its largest modes become
patterns with standard normal coefficients, so that they are no evidence for any cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.fit.noise import sd_of_knots
from unmodeled.fit.observe import observed_sensitivities
from unmodeled.search.evidence import Fitted
from unmodeled.search.fit import empty_point
from unmodeled.search.linear import EvaluationRequest, Point, request_at
from unmodeled.search.problem import Local, Members, Observed, Problem

#: Largest number of knots of the noise of an input, and of modes of a record.
KNOTS, MODES = 120, 25
#: Smallest size of a mode, in standard deviations of the noise over all samples of a record.
SMALLEST = 0.3


def varies(problem: Problem) -> bool:
    """Whether inputs have noise or parameters vary from record to record."""
    model = problem.model
    return any(p.process_sd > 0.0 for p in model.parameters) or any(
        s > 0.0 for o in problem.fit for s in o.record.input_sigma.values()
    )


def with_variation(problem: Problem, fitted: Fitted | None = None) -> Problem:
    """The problem with the modes of all records, linearized at a fitted set or at the prior."""
    members: Members = () if fitted is None else fitted.members
    x = empty_point(problem, members, ()).x if fitted is None else fitted.point.x
    return replace(
        problem,
        fit=_with_modes(problem, problem.fit, members, x),
        held_out=_with_modes(problem, problem.held_out, members, x),
    )


def _with_modes(
    problem: Problem, records: Sequence[Observed], members: Members, x: Array
) -> tuple[Observed, ...]:
    varying = [i for i, p in enumerate(problem.model.parameters) if p.process_sd > 0.0]
    sd = np.array([problem.model.parameters[i].process_sd for i in varying])
    plain = [
        replace(o, local=tuple(q for q in o.local if q.kind != "mode"), modes=None) for o in records
    ]
    point = Point(x, empty_point(problem, members, plain).local)
    ask = EvaluationRequest(members, point, tuple(plain), by_global=False)
    requests = [
        replace(
            request_at(problem, ask, r),
            by_theta=varying,
            by_starts=False,
            input_changes=tuple(_changes(o.record)),
        )
        for r, o in enumerate(plain)
    ]
    out = []
    with np.errstate(all="ignore"):
        found = observed_sensitivities(problem.model, requests)
    for o, s in zip(plain, found, strict=True):
        columns = list(problem.channels)
        patterns = s.d_theta[:, columns] * sd
        if s.d_inputs is not None:
            patterns = np.concatenate([patterns, s.d_inputs[:, columns]], axis=2)
        out.append(_with(o, np.nan_to_num(patterns, posinf=0.0, neginf=0.0)))
    return tuple(out)


def _with(observed: Observed, patterns: Array) -> Observed:
    """A record with the largest modes of patterns, (n, m, k)."""
    n, m, k = patterns.shape
    scaled = np.where(observed.valid[..., None], patterns / observed.sd[..., None], 0.0)
    if k == 0 or not scaled.any():
        return observed
    left, size, _ = np.linalg.svd(scaled.reshape(n * m, k), full_matrices=False)
    count = min(int((size > SMALLEST).sum()), MODES)
    modes = (left[:, :count] * size[:count]).reshape(n, m, count) * observed.sd[..., None]
    local = tuple(Local("mode", j, 0.0, 1.0) for j in range(count))
    return replace(observed, local=(*observed.local, *local), modes=modes)


def _changes(record: Record) -> list[Mapping[str, Array]]:
    """Changes of the inputs by one standard deviation of their noise, one for each knot."""
    count = min(KNOTS, max(record.samples // 2, 2))
    middles = np.linspace(record.time[0], record.time[-1], count)
    spacing = float(middles[1] - middles[0])
    changes: list[Mapping[str, Array]] = []
    for name, sigma in record.input_sigma.items():
        if not sigma > 0.0:
            continue
        sd = float(sd_of_knots(record, name, spacing))
        for middle in middles:
            hat = np.maximum(0.0, 1.0 - np.abs(record.time - middle) / spacing)
            changes.append({name: sd * hat})
    return changes
