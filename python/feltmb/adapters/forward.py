"""Derivatives of the segments of a mechanism by forward sensitivities, all in one pass.

The variational equation is integrated together with the stroke (:mod:`feltmb.run.sensitivity`). The
derivative of the equations by a parameter follows from mechanisms with a shifted parameter. Start
states are deviations from the rest pose, which depends on the parameters; the chain rule adds this
dependence. Effects with states of their own (compliant pivots, creeping felt) are left to finite
differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb import _core
from feltmb.adapters.differentiable import DifferentiableMechanism
from feltmb.adapters.drives import Drive, follow
from feltmb.adapters.library import Entry
from feltmb.adapters.remembered import Remembered, start_state
from feltmb.adapters.sampling import at_times, output_rate
from feltmb.adapters.variants import Variant
from feltmb.data import Array
from feltmb.errors import FeltmbError
from feltmb.fit import Candidate, Sensitivity, SensitivityRequest
from feltmb.fit.watch import simulated

__all__ = ["can_differentiate", "forward_sensitivities"]

#: Shift of a parameter or magnitude as a share of its scale. The errors by curvature and by
#: rounding of the rest pose are then below 1e-5 of a derivative.
SHIFT = 1e-5
#: Share of a change of the inputs by which the input is shifted. A motion enters the equations
#: through the place of the finger, which is not linear.
INPUT_SHIFT = 1e-4
#: Relative tolerance of a derivative. Before a strike, nine of ten derivatives are correct to 1e-3
#: of their largest value.
TOLERANCE = 3e-3


@dataclass(frozen=True)
class _Node:
    """A version of the mechanism with its input, at one shift of a variable."""

    variant: Variant
    drive: Drive
    shift: float
    weight: float


@dataclass(frozen=True)
class _Column:
    """One variable of differentiation: shifted versions of the mechanism with their weights."""

    name: str
    nodes: tuple[_Node, ...]
    scale: float

    def derivative(self, pick: Callable[[_Node], Any]) -> Array:
        """Derivative of a quantity of a version by this variable."""
        out: Array = sum(n.weight * np.asarray(pick(n)) for n in self.nodes)  # type: ignore[assignment]
        return out


def can_differentiate(candidate: Candidate) -> bool:
    """Whether the candidate adds no states to the mechanism."""
    entry = candidate.effect.data
    if not isinstance(entry, Entry):
        return False
    return not entry.hidden and (entry.insertion is None or entry.insertion.kind == "mass")


def forward_sensitivities(
    model: DifferentiableMechanism, request: SensitivityRequest
) -> Sensitivity | None:
    """See :meth:`feltmb.fit.Model.sensitivities`; None if a segment or a shift failed.

    All included effects and candidates must satisfy :func:`can_differentiate`. Included effects
    whose states are part of the model are permitted as well; derivatives by their magnitudes are
    then computed too.
    """
    record, segments, starts = request.record, request.segments, request.starts
    by_theta, by_starts = request.parameters_of(model), request.by_starts
    try:
        base = model.version(record, request.theta, request.included, request.sizes)
        drive = model.drives.of(record)
        columns = _columns(model, request, base, drive)
        columns += _input_columns(model, request, base, drive)
    except FeltmbError:
        return None
    states = () if model.single else model.states(request.included)
    names, scales = [s.name for s in states], [s.scale for s in states]
    place = np.array([base.place[name] for name in names], dtype=int)
    clock = record.time - record.time[0]

    def whole(used: Drive) -> _core.Input:
        return _core.Input(used.profile(float(record.time[0]), float(clock[-1])), used.kind)

    drive_in = whole(drive)
    options = _core.SensitivityOptions()
    simulation = _core.SimulationOptions()
    simulation.rtol = model.rtol
    options.simulation = simulation
    options.tolerance = TOLERANCE
    options.output_rate = output_rate(clock)
    index = {name: i for i, (name, _, _) in enumerate(_core.observables(base.mechanism))}
    options.outputs = [index[o] for o in model.outputs]
    options.threads = model.workers

    def start_of(
        v: Variant, start: Array, own: Any, held: Remembered | None
    ) -> tuple[Array, list[float]]:
        """Full state and remembered compressions at the start of a segment."""
        full, compressions = start_state(v, names, start, held)
        if drive.motion:
            follow(model.action, v, full, own)
        return full, compressions

    prepared = []
    held_at = request.memory or (None,) * len(segments)
    for (first, last), start, held in zip(segments, starts, held_at, strict=True):
        begin, end = float(clock[first]), float(clock[last])
        if model.single:
            first, begin, start = 0, 0.0, np.zeros(place.size)
            if not drive.motion:  # the core finds the rest pose
                prepared.append(_core.SensitivitySegment(begin, end))
                continue
        window = float(record.time[first]), end - begin
        own = drive.profile(*window)
        state, compressions = start_of(base, start, own, held)

        def moved(
            n: _Node,
            start: Array = start,
            window: tuple[float, float] = window,
            own: Any = own,
            held: Remembered | None = held,
        ) -> Array:
            profile = own if n.drive is drive else n.drive.profile(*window)
            return start_of(n.variant, start, profile, held)[0]

        moves = np.zeros((state.size, len(columns)))
        for c, column in enumerate(columns):
            moves[:, c] = column.derivative(moved)
        directions = np.zeros((state.size, place.size if by_starts else 0))
        for i in range(directions.shape[1]):
            if not drive.motion:
                directions[place[i], i] = 1.0
                continue
            h = 1e-3 * scales[i]
            ahead, behind = (start + side * h * np.eye(place.size)[i] for side in (1.0, -1.0))
            fore, aft = (start_of(base, side, own, held)[0] for side in (ahead, behind))
            directions[:, i] = (fore - aft) / (2 * h)
        prepared.append(
            _core.SensitivitySegment(begin, end, list(state), compressions, directions, moves)
        )
    parameters = [
        _core.SensitivityParameter(
            c.name,
            [
                _core.Perturbed(
                    n.variant.mechanism,
                    drive_in if n.drive is drive else whole(n.drive),
                    n.shift,
                    n.weight,
                )
                for n in c.nodes
            ],
            c.scale,
        )
        for c in columns
    ]
    if model.single:
        # One run for all segments.
        last = int(np.argmax(segments[:, 1]))
        prepared = [prepared[last]]
    span = segments[:, 1].max() if model.single else np.sum(segments[:, 1] - segments[:, 0])
    simulated(float(span) / max(record.samples - 1, 1))
    try:
        results = _core.sensitivities(base.mechanism, drive_in, parameters, prepared, options)
    except (FeltmbError, RuntimeError, ValueError):
        return None
    if any(r.run.status != "done" for r in results):
        return None
    return _collect(
        model,
        clock,
        segments,
        results,
        columns,
        base,
        place,
        model.single and not drive.motion,
        (len(by_theta), len(request.included), len(request.candidates)),
        by_starts=by_starts,
    )


def _columns(
    model: DifferentiableMechanism, request: SensitivityRequest, base: Variant, drive: Drive
) -> list[_Column]:
    """Variables with one-sided differences: their curvature error is below 1e-5 of a derivative."""
    theta, included, magnitudes = request.theta, request.included, request.sizes

    def column(
        name: str,
        moved: Array,
        more: tuple[Candidate, ...],
        sizes: Array,
        shift: float,
        scale: float,
    ) -> _Column:
        version = model.version(request.record, moved, more, sizes)
        return _between(name, _Node(version, drive, shift, 1.0 / shift), base, drive, scale)

    def side(value: float, h: float, upper: float) -> float:
        return h if value + h <= upper else -h

    out = []
    for i in request.parameters_of(model):
        p = model.parameters[i]
        shift = side(theta[i], SHIFT * p.size, p.upper)
        moved = theta.copy()
        moved[i] += shift
        out.append(column(p.name, moved, included, magnitudes, shift, p.size))
    for k, candidate in enumerate((*included, *request.candidates)):
        known = k < len(included)
        more = included if known else (*included, candidate)
        sizes = magnitudes.copy() if known else np.append(magnitudes, 0.0)
        place = k if known else -1
        scale = candidate.effect.scale
        shift = side(float(sizes[place]), SHIFT * scale, candidate.effect.bounds[1])
        sizes[place] += shift
        out.append(column(candidate.name, theta, more, sizes, shift, scale))
    return out


def _input_columns(
    model: DifferentiableMechanism, request: SensitivityRequest, base: Variant, drive: Drive
) -> list[_Column]:
    """Changes of the inputs as variables; a noisy motion is smoothed before and after a change."""
    record = request.record
    out = []
    for k, change in enumerate(request.input_changes):
        added = {name: record.inputs[name] + value for name, value in change.items()}
        whole = model.drives.of(record.with_inputs(added)).value - drive.value
        near = replace(drive, value=drive.value + INPUT_SHIFT * whole)
        node = _Node(base, near, INPUT_SHIFT, 1.0 / INPUT_SHIFT)
        out.append(_between(f"input change {k}", node, base, drive, 1.0))
    return out


def _between(name: str, node: _Node, base: Variant, drive: Drive, scale: float) -> _Column:
    """A one-sided difference between a shifted version and the base."""
    return _Column(name, (node, _Node(base, drive, 0.0, -node.weight)), scale)


def _collect(
    model: DifferentiableMechanism,
    clock: Array,
    segments: NDArray[np.intp],
    results: Sequence[Any],
    columns: Sequence[_Column],
    base: Variant,
    place: NDArray[np.intp],
    from_rest: bool,
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
    still = np.array([model.at_rest(base, o) for o in model.outputs])
    rest, moving = np.zeros((nx, n)), np.zeros((ny, n))
    if from_rest:
        moving = (
            np.asarray(results[0].gradient)[0]
            * (np.array(model.outputs) != "finger.force")[:, None]
        )
    else:
        for k, column in enumerate(columns):
            rest[:, k] = column.derivative(lambda n: n.variant.rest[place])
            moving[:, k] = column.derivative(
                lambda n: [model.at_rest(n.variant, o) for o in model.outputs]
            )
    spans = [(0, int(np.max(segments[:, 1])))] if model.single else segments
    shown = [
        [at_times(r.time, np.asarray(v), clock[first : last + 1]) for v in (r.values, r.gradient)]
        for r, (first, last) in zip(results, spans, strict=True)
    ]
    for i, (first, last) in enumerate(segments):
        r = results[0] if model.single else results[i]
        count = int(last - first) + 1
        values, gradient = shown[0 if model.single else i]
        skip = int(first) if model.single else 0
        gradient = gradient[skip : skip + count]
        outputs[i, :count] = values[skip : skip + count] - still
        by_column = gradient[..., :n]
        if not model.single:
            end = np.asarray(r.end_state)
            final = np.asarray(r.run.end_state)
            ends[i] = final[place] - base.rest[place]
            d_ends[i] = end[place][:, :n] - rest
            if by_starts:
                d_starts[i, :count] = gradient[..., n : n + nx]
                d_starts_ends[i] = end[place][:, n : n + nx]
        d_outputs[i, :count] = by_column - moving
    a, b, c = counts
    return Sensitivity(
        memory=None if model.single else tuple(Remembered.of(base, r.run) for r in results),
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
        d_inputs=d_outputs[..., a + b + c :],
        d_inputs_ends=d_ends[..., a + b + c :],
    )
