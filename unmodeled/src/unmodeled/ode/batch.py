"""Simulations of equations, and their derivatives, for all jobs of all records together.

Rates, outputs and effects are traced once (:mod:`unmodeled.ode.tape`). The jobs of one kind, which
have the same effects and the same variables of differentiation, are one program
(:mod:`unmodeled.ode.program`) and are integrated together (:mod:`unmodeled.ode.step`). What cannot
be traced runs as functions of Python.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MethodType
from typing import Any

import numpy as np

from unmodeled.chain.splines import Spline
from unmodeled.data import Array, Record
from unmodeled.models.coordinates import Rate
from unmodeled.models.model import (
    Batch,
    Candidate,
    Jobs,
    Model,
    Sensitivity,
    SensitivityRequest,
    changed_jobs,
    difference_sensitivities,
    sensitivity_of,
)
from unmodeled.ode.methods import METHODS
from unmodeled.ode.plain import Plain
from unmodeled.ode.program import program_of
from unmodeled.ode.reads import changed, read_by, written
from unmodeled.ode.step import Lanes, Runs, plain, run
from unmodeled.ode.tape import NotTraceable, Traced
from unmodeled.ode.traces import (
    OWN,
    Key,
    Part,
    ProgramKind,
    System,
    Traces,
    Untrue,
    effect_part,
    floats_of,
    form_of,
    own_parts,
    own_trace,
    untraced_reason,
)
from unmodeled.ode.witness import (
    Motion,
    compare,
    effect_points,
    points_along,
    points_of,
)

#: Largest difference between a simulated change and its prediction, relative to the change.
SMALL = 0.1

# -------------------------------------------------------------------------------------- signals


class _Tracks:
    """Times and signals of records, each of which is computed once."""

    def __init__(self, system: System, traces: Traces):
        self.system, self.known = system, traces.signals
        self.times: list[Array] = []
        self.signals: list[Array] = []
        self._places: dict[Record, int] = {}
        self.shares = np.arange(2 * system.substeps + 1) / (2 * system.substeps)

    def of(
        self,
        record: Record,
        changes: Sequence[Mapping[str, Array]] = (),
        forces: Array | None = None,
    ) -> int:
        """Place of the signals of a record, with changes of inputs or unknown forces."""
        changed = [(n, change[n]) for change in changes for n in self.names(change)]
        further = self.between(record, changed)
        if forces is not None:
            further += self._forces(record, forces)
        if not further and record in self._places:
            return self._places[record]
        system = self.system
        key = system.hold, system.substeps, system.inputs
        held = self.known.setdefault(record, {})
        if key not in held:
            signals = [(n, record.inputs[n]) for n in system.inputs]
            held[key] = self._stacked(record, self.between(record, signals))
        own = held[key]
        if further:
            own = np.concatenate([own, self._stacked(record, further)], axis=-1)
        else:
            self._places[record] = len(self.times)
        self.times.append(np.ascontiguousarray(record.time, dtype=np.float64))
        self.signals.append(own)
        return len(self.times) - 1

    def _stacked(self, record: Record, columns: Sequence[Array]) -> Array:
        none = np.zeros((record.samples, self.shares.size, 0))
        return np.stack(columns, axis=-1) if columns else none

    def names(self, change: Mapping[str, Array]) -> tuple[str, ...]:
        """Inputs of the model that a change changes."""
        return tuple(n for n in self.system.inputs if n in change)

    def between(self, record: Record, signals: Sequence[tuple[str, Array]]) -> list[Array]:
        """Inputs, or their changes, after each sample, (n, halves); what bends them apart."""
        hold, share = self.system.hold, self.shares
        if not signals:
            return []
        values = np.array([v for _, v in signals])
        following = np.append(values[:, 1:], values[:, -1:], axis=1)
        out = values[..., None] + 0.0 * share
        if hold != "zero":
            out += share * (following - values)[..., None]
        if hold not in ("spline", "other", "between"):
            return [*out]
        bends = Spline(record.time, values)(record.time, 2)
        ahead, rest = np.append(bends[:, 1:], bends[:, -1:], axis=1)[..., None], 1.0 - share
        square = np.append(np.diff(record.time), 0.0)[:, None] ** 2 / 6.0
        bent = square * ((rest**3 - rest) * bends[..., None] + (share**3 - share) * ahead)
        if hold != "spline":  # most samples repeat the one before: a switch may hold it
            own = np.array([record.inputs[n] for n, _ in signals])
            steps = 2.0 * np.mean(np.diff(own, axis=1) == 0.0, axis=1) > 1.0
            bent[steps] = -(share * (following - values)[..., None])[steps]
        if hold != "between":
            return [*(out + bent)]
        return [part for pair in zip(out, bent, strict=True) for part in pair]

    def _forces(self, record: Record, forces: Array) -> list[Array]:
        """Unknown forces, (ports, knots), after each sample."""
        step = np.append(np.diff(record.time), 0.0)
        elapsed = record.time[:, None] - record.time[0] + self.shares * step[:, None]
        span = record.time[-1] - record.time[0]
        place = np.clip(elapsed / span, 0.0, 1.0) * (forces.shape[1] - 1)
        left = np.minimum(place.astype(np.intp), forces.shape[1] - 2)
        share = place - left
        return [(1.0 - share) * f[left] + share * f[left + 1] for f in forces]

    def lanes(self, track: Sequence[int], constants: Any, starts: Any, seeds: Array) -> Lanes:
        """Lanes on tracks, with only those that they use."""
        used = sorted(set(track))
        return Lanes(
            np.array([used.index(i) for i in track], dtype=np.intp),
            [self.times[i] for i in used],
            [self.signals[i] for i in used],
            np.ascontiguousarray(constants, dtype=np.float64),
            np.ascontiguousarray(starts, dtype=np.float64),
            seeds,
        )


# ----------------------------------------------------------------------------------- simulations


def simulated(
    system: System, traces: Traces, batches: Sequence[Batch]
) -> list[tuple[Array, Array]]:
    """Outputs (B, n, ny) and states (B, n, nx) of jobs.

    Raises
    ------
    InvalidParameter
        A function of the model fails.
    """
    if not batches:
        return []
    _compare(system, traces, batches, [t for _, jobs in batches for t in jobs.included])
    return _simulated(system, traces, batches)


def _simulated(
    system: System, traces: Traces, batches: Sequence[Batch]
) -> list[tuple[Array, Array]]:
    groups: dict[Any, list[int]] = {}
    for i, (_, jobs) in enumerate(batches):
        forms = tuple(form_of(system, traces, t) for t in jobs.included)
        groups.setdefault((forms, jobs.forces is not None), []).append(i)
    found: dict[int, tuple[Array, Array]] = {}
    tracks = _Tracks(system, traces)
    for (forms, forces), group in groups.items():
        own = [batches[i] for i in group]
        if untraced_reason(system, traces, forms) is None:
            kind = _kind(system, included=forms, forces=forces)
            runs = _run_jobs(system, traces, kind, own, tracks)
        else:
            runs = _plain(system, traces, own, tracks)
        first = 0
        for i, (_, jobs) in zip(group, own, strict=True):
            rows = slice(first, first + jobs.count)
            found[i] = np.array(runs.outputs[rows]), np.array(runs.states[rows])
            first += jobs.count
    return [found[i] for i in range(len(batches))]


#: Largest number of records that are tried before a fit, and of their samples.
RECORDS, LONGEST = 4, 1500


def _compare(
    system: System, traces: Traces, batches: Sequence[Batch], candidates: Sequence[Candidate]
) -> None:
    """Compare functions with their traces when they are first used.

    Raises
    ------
    InvalidParameter
        They differ, or a function has a state of its own.
    """
    keys: dict[Any, list[Any]] = {OWN: _functions(system)}
    keys |= {t.effect: [t.effect.rate] for t in candidates}
    now = {k: read_by(of) for k, of in keys.items()}
    if any(k in traces.read and changed(now[k], *traces.read[k]) for k in keys):
        traces.forget()
    points = traces.points
    if points is None:
        motions = [_pilot(system, traces, *batch) for batch in batches[:RECORDS]]
        if not any(np.isfinite(m.states).all(axis=1).any() for m in motions):
            return
        traces.compared.clear()
        points = points_of(system, motions)
    if OWN not in traces.compared:
        traces.compared[OWN] = compare(own_parts(system), own_trace(system, traces), points)
        traces.points = points
    for candidate in candidates:
        form = form_of(system, traces, candidate)
        key = form.effect, form.text
        if key not in traces.compared:
            own = effect_part(candidate, symbols=bool(form.numbers))
            at = effect_points(points, candidate)
            traces.compared[key] = compare([own], traces.effects[key], at)
    for key in keys.keys() - traces.read.keys():
        traces.read[key] = now[key], written(now[key], read_by(keys[key]))


def doubts(system: System, traces: Traces, batches: Sequence[Batch]) -> tuple[str, ...]:
    """What functions give otherwise along the motions of the first jobs: the first sentence."""
    runs = _simulated(system, traces, batches)
    try:
        for (record, jobs), (_, path) in zip(batches, runs, strict=True):
            motion = Motion(record, jobs, path[0])
            at = points_along(system, motion, [s.name for s in system.all_states(jobs.included)])
            _still(traces, OWN, own_parts(system), own_trace(system, traces), at)
            for size, t in zip(jobs.magnitudes[0], jobs.included, strict=True):
                form = form_of(system, traces, t)
                values: dict[Key, float] = {("size",): size}
                values |= {("shape", k): v for k, v in enumerate(floats_of(form, t.shape))}
                further = {k: np.full(len(at["t",]), v) for k, v in values.items()}
                own, key = effect_part(t, symbols=bool(form.numbers)), (form.effect, form.text)
                _still(traces, key, [own], traces.effects[key], at | further)
    except Untrue as error:
        return (f"the numbers below are not those of the model's functions: {error}",)
    return ()


def _still(
    traces: Traces,
    key: Any,
    parts: Sequence[Part],
    traced: Traced | NotTraceable,
    at: Mapping[Key, Array],
) -> None:
    """Compare functions, and whether they still take arrays if they did."""
    found, before = compare(parts, traced, at), traces.compared.get(key, ())
    for part, now, then in zip(parts, found, before, strict=False):
        if then and not now:
            raise Untrue(f"{part.what} gives other values for arrays of jobs")


def _functions(system: System) -> list[Any]:
    """Functions of a model; a port may have one for its inertia."""
    shown = [of for of in system.outputs.values() if not isinstance(of, str | Rate)]
    return [system.rates, *shown, *(p for p in system.ports.values() if isinstance(p, MethodType))]


def _pilot(system: System, traces: Traces, record: Record, jobs: Jobs) -> Motion:
    """Motion of the first job without effects."""
    part = record if record.samples <= LONGEST else record.cut(0, LONGEST)
    start = jobs.starts[:1, : len(system.states)]
    ((_, path),) = _simulated(system, traces, [(part, Jobs(theta=jobs.theta[:1], starts=start))])
    return Motion(part, jobs, path[0])


def _kind(system: System, **fields: Any) -> ProgramKind:
    return ProgramKind(
        system.parameters, system.hold == "between", system.method == "rosenbrock", **fields
    )


def _track_of(tracks: _Tracks, batch: Batch) -> list[int]:
    """Tracks of the jobs of a batch."""
    record, jobs = batch
    if jobs.forces is None:
        return [tracks.of(record)] * jobs.count
    return [tracks.of(record, forces=f) for f in jobs.forces]


def _starts_of(jobs: Jobs) -> Array:
    """Start states, (nx, B)."""
    return np.asarray(jobs.starts, dtype=np.float64).T


def _run_jobs(
    system: System, traces: Traces, kind: ProgramKind, batches: Sequence[Batch], tracks: _Tracks
) -> Runs:
    program = program_of(system, traces, kind)
    track = [i for b in batches for i in _track_of(tracks, b)]
    constants = []
    for _, jobs in batches:
        shapes = [floats_of(f, t.shape) for f, t in zip(kind.included, jobs.included, strict=True)]
        numbers = np.array([v for s in shapes for v in s])
        constants.append(
            np.hstack([jobs.theta, jobs.magnitudes, np.tile(numbers, (jobs.count, 1))])
        )
    lanes = tracks.lanes(
        track,
        np.vstack(constants).T,
        np.hstack([_starts_of(jobs) for _, jobs in batches]),
        np.zeros((program.smooth, 0)),
    )
    return run(program, METHODS[system.method], system.substeps, lanes)


# ---------------------------------------------------------------------------------- derivatives


def sensitivities(
    model: Model, system: System, traces: Traces, requests: Sequence[SensitivityRequest]
) -> list[Sensitivity]:
    """Outputs and derivatives, one result per request.

    Those of rates that jump or cannot be traced are differences of simulations.
    """
    if not requests:
        return []
    batches = [(r.record, r.jobs()) for r in requests]
    _compare(system, traces, batches, [t for r in requests for t in (*r.included, *r.candidates)])
    found = _by_programs(model, system, traces, requests)
    for i in _jumping(model, system, traces, requests, {i: s for i, (s, _) in found.items()}):
        del found[i]
    jumps = [i for i in range(len(requests)) if i not in found]
    rest = difference_sensitivities(model, [requests[i] for i in jumps]) if jumps else []
    whole = {i: _completed(model, requests[i], inner, s) for i, (s, inner) in found.items()}
    whole |= dict(zip(jumps, rest, strict=True))
    return [whole[i] for i in range(len(requests))]


def _by_programs(
    model: Model, system: System, traces: Traces, requests: Sequence[SensitivityRequest]
) -> dict[int, tuple[Sensitivity, SensitivityRequest]]:
    """Derivatives of the requests that are programs, with the part of the request that is one."""
    tracks = _Tracks(system, traces)
    groups: dict[ProgramKind, dict[int, SensitivityRequest]] = {}
    for i, request in enumerate(requests):
        if traceable := _traceable(model, system, traces, tracks, request):
            kind, inner = traceable
            groups.setdefault(kind, {})[i] = inner
    found = {}
    for kind, group in groups.items():
        runs = _run_requests(system, traces, kind, [*group.values()], tracks)
        for (i, inner), y, d in zip(group.items(), runs.outputs, runs.derivatives, strict=True):
            found[i] = sensitivity_of(model, inner, y, d), inner
    return found


def _traceable(
    model: Model, system: System, traces: Traces, tracks: _Tracks, request: SensitivityRequest
) -> tuple[ProgramKind, SensitivityRequest] | None:
    """The part of a request that is a program, and its kind; None: its rates are not traced."""
    forms = tuple(form_of(system, traces, t) for t in request.included)
    if untraced_reason(system, traces, forms) is not None:
        return None
    tried = [(t, form_of(system, traces, t)) for t in request.candidates]
    good = [(t, f) for t, f in tried if untraced_reason(system, traces, (f,)) is None]
    changes = request.shape_changes
    if not all(forms[c.effect].numbers for c in changes):
        changes = ()
    kind = _kind(
        system,
        included=forms,
        derivatives=True,
        candidates=tuple(f for _, f in good),
        by_theta=request.parameters_of(model),
        by_starts=request.by_starts,
        changes=tuple(tracks.names(c) for c in request.input_changes),
        turned=tuple(c.effect for c in changes),
    )
    traced = tuple(t for t, _ in good)
    return kind, replace(request, candidates=traced, shape_changes=changes)


def _run_requests(
    system: System,
    traces: Traces,
    kind: ProgramKind,
    requests: Sequence[SensitivityRequest],
    tracks: _Tracks,
) -> Runs:
    program = program_of(system, traces, kind)
    constants, starts = [], []
    for r in requests:
        row = [*r.theta, *r.sizes]
        for form, t in zip(
            (*kind.included, *kind.candidates), (*r.included, *r.candidates), strict=True
        ):
            row += floats_of(form, t.shape)
        for change in r.shape_changes:
            form = kind.included[change.effect]
            ends = [np.array(floats_of(form, s)) for s in (change.upper, change.lower)]
            row += list((ends[0] - ends[1]) / change.width)
        constants.append(row)
        hidden = [h.start for t in r.candidates for h in t.effect.hidden]
        starts.append([*r.start, *hidden])
    seeds = np.zeros((program.smooth, program.columns))
    if kind.by_starts:
        first = len(kind.by_theta) + len(kind.included)
        seeds[:, first : first + program.smooth] = np.eye(program.smooth)
    lanes = tracks.lanes(
        [tracks.of(r.record, r.input_changes) for r in requests],
        np.array(constants).reshape(len(requests), -1).T,
        np.array(starts).T,
        seeds,
    )
    return run(program, METHODS[system.method], system.substeps, lanes)


def _completed(
    model: Model,
    request: SensitivityRequest,
    inner: SensitivityRequest,
    s: Sensitivity,
) -> Sensitivity:
    """Derivatives with those that are differences of simulations."""
    if len(inner.candidates) < len(request.candidates):
        traced = {id(t) for t in inner.candidates}
        left = [k for k, t in enumerate(request.candidates) if id(t) not in traced]
        fewer = replace(
            request,
            candidates=tuple(request.candidates[k] for k in left),
            by_theta=(),
            by_starts=False,
            input_changes=(),
            shape_changes=(),
        )
        (other,) = difference_sensitivities(model, [fewer])
        columns = np.zeros((*s.outputs.shape, len(request.candidates)))
        columns[..., left] = other.d_candidates
        columns[..., [k for k in range(columns.shape[-1]) if k not in left]] = s.d_candidates
        s = replace(s, d_candidates=columns)
    if len(inner.shape_changes) < len(request.shape_changes):
        s = replace(s, d_shapes=None)
    return s


# ---------------------------------------------------------------------------------------- jumps


def _jumping(
    model: Model,
    system: System,
    traces: Traces,
    requests: Sequence[SensitivityRequest],
    found: Mapping[int, Sensitivity],
) -> list[int]:
    """Requests whose derivatives miss a jump of a rate, such as that of np.sign.

    The difference of two more simulations, with changed parameters, magnitudes and start states,
    is compared with its prediction.
    """
    tested = []
    for i in sorted(found):
        forms = [form_of(system, traces, t) for t in requests[i].included]
        parts = [own_trace(system, traces), *(traces.effects[f.effect, f.text] for f in forms)]
        if any(isinstance(t, Traced) and t.jumps for t in parts):
            tested.append(i)
    moves = [_moves(model, requests[i]) for i in tested]
    batches = [(requests[i].record, jobs) for i, (jobs, _) in zip(tested, moves, strict=True)]
    runs = _simulated(system, traces, batches)
    return [
        i
        for i, (two, _), (_, changes) in zip(tested, runs, moves, strict=True)
        if not _predicts(system, found[i], two, changes)
    ]


def _moves(model: Model, request: SensitivityRequest) -> tuple[Jobs, Array]:
    """Two simulations with opposite changes of parameters, magnitudes and start states.

    Also returns the differences between the two, in the order of the variables of differentiation.
    At a limit, both change the value to the permitted side.
    """
    jobs, columns = changed_jobs(model, request)
    table = np.hstack([jobs.theta, jobs.magnitudes, jobs.starts])
    # A known start has no rows: it does not change.
    pairs = np.array([[row for row, _ in entry] or [0, 0] for entry in columns]).reshape(-1, 2)
    pairs = np.random.default_rng(0).permuted(pairs, axis=1)
    changes = table[pairs] - table[0]  # (columns, 2, all)
    ends = np.cumsum([jobs.theta.shape[1], jobs.magnitudes.shape[1]])
    theta, sizes, starts = np.split(table[0] + changes.sum(axis=0), ends, axis=1)
    two = replace(jobs, theta=theta, magnitudes=sizes, starts=starts)
    return two, (changes[:, 0] - changes[:, 1]).sum(axis=1)


def _predicts(system: System, s: Sensitivity, two: Array, changes: Array) -> bool:
    """Whether the derivatives predict the difference of the outputs of two changed simulations.

    Outputs that are rates show each steep part of a rate itself. They are left out if there are
    others.
    """
    columns = np.concatenate([s.d_theta, s.d_magnitudes, s.d_starts], axis=-1)
    change = two[0] - two[1]
    error = change - columns @ changes
    good = np.isfinite(change)
    if np.any(good & ~np.isfinite(error)):
        return False
    change, error, y = (np.where(good, v, 0.0) for v in (change, error, s.outputs))
    allowed = SMALL**2 * np.sum(change**2, axis=0) + 1e-18 * np.sum(y**2, axis=0)
    agrees = np.sum(error**2, axis=0) <= allowed
    steady = [o for o, of in enumerate(system.outputs.values()) if not isinstance(of, Rate)]
    return bool(np.all(agrees[steady] if steady else agrees))


# ----------------------------------------------------------------- functions that cannot be traced


def _plain(system: System, traces: Traces, batches: Sequence[Batch], tracks: _Tracks) -> Runs:
    """Integrate functions of Python."""
    out: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
    for record, jobs in batches:
        own = Plain(system, traces, jobs)
        lanes = tracks.lanes(
            _track_of(tracks, (record, jobs)),
            np.zeros((0, jobs.count)),
            _starts_of(jobs),
            np.zeros((0, 0)),
        )
        scales = np.array([s.scale for s in system.all_states(jobs.included)])
        runs = plain(own.rates, own.outputs, scales, METHODS[system.method], system.substeps, lanes)
        for all_of, part in zip(out, (runs.outputs, runs.derivatives, runs.states), strict=True):
            all_of.extend(part)
    return Runs(*out)
