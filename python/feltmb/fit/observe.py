"""From the machine to the record: input effects, sensor effects, known sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Record, Sensor
from feltmb.errors import InvalidParameter
from feltmb.fit.calling import calling
from feltmb.fit.model import Job, Lanes, Model, Sensitivity, Simulated, Term
from feltmb.fit.shift import shifted

__all__ = ["machine_terms", "observe_all", "observe_lanes", "observed_sensitivities"]


#: All windows.
ALL = slice(None)


def machine_terms(terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Terms that the model itself must simulate."""
    return tuple(t for t in terms if t.effect.excite is None and t.effect.observe is None)


def observe_lanes(model: Model, record: Record, lanes: Lanes) -> Simulated:
    """Simulate lanes as the sensors of the record would show them; see :func:`observe_all`."""
    return observe_all(model, [(record, lanes)])[0]


def observe_all(model: Model, jobs: Sequence[Job]) -> list[Simulated]:
    """Simulate lanes as the sensors of their records would show them.

    Input effects change the inputs before, sensor effects and the known part of the sensors (gain,
    delay, low-pass, offset) change the outputs after the model's own simulation.
    """
    excited = [_excited(record, lanes) for record, lanes in jobs]
    runs = iter(model.simulate_all([job for parts in excited for _, job in parts]))
    return [
        _observed(model, record, lanes, [(rows, next(runs)) for rows, _ in parts])
        for (record, lanes), parts in zip(jobs, excited, strict=True)
    ]


def _observed(
    model: Model, record: Record, lanes: Lanes, parts: list[tuple[NDArray[np.intp], Simulated]]
) -> Simulated:
    """What the sensors show of lanes that were simulated in parts: which rows, and their run."""
    if len(parts) == 1:
        outputs, ends = parts[0][1].outputs, parts[0][1].ends
    else:
        outputs = np.full((lanes.count, lanes.longest, len(model.outputs)), np.nan)
        ends = np.full((lanes.count, lanes.starts.shape[1]), np.nan)
        for rows, run in parts:
            outputs[rows, : run.outputs.shape[1]] = run.outputs
            ends[rows] = run.ends
    for k, term in enumerate(lanes.terms):
        if term.effect.observe is None:
            continue
        outputs = _seen(term, record, outputs, lanes.windows, lanes.sizes[:, k])
    return Simulated(outputs=_sensed(model, record, lanes, outputs), ends=ends)


def _seen(
    term: Term, record: Record, outputs: Array, windows: NDArray[np.intp], sizes: Array
) -> Array:
    """What a sensor effect makes of outputs, which it may change in place: they are a copy."""
    assert term.effect.observe is not None
    # Lanes that failed hold NaN or infinity.
    with calling(f"effect {term.name}: its observe"), np.errstate(all="ignore"):
        seen = term.effect.observe(record, outputs.copy(), windows, sizes, term.shape)
    if np.shape(seen) != outputs.shape:
        raise InvalidParameter(
            f"effect {term.name}: observe returned shape {np.shape(seen)}, expected that of "
            f"the outputs, {outputs.shape}"
        )
    return seen


def _changed(term: Term, record: Record, size: float) -> Record:
    """A record with the inputs that an input effect makes."""
    assert term.effect.excite is not None
    with calling(f"effect {term.name}: its excite"):
        return record.with_inputs(term.effect.excite(record, size, term.shape))


def _excited(record: Record, lanes: Lanes) -> list[tuple[NDArray[np.intp], Job]]:
    """Lanes as the machine sees them, by each different set of sizes of the input effects.

    Which rows, and what is to be simulated: the record with the changed inputs.
    """
    inner = [k for k, t in enumerate(lanes.terms) if t in machine_terms(lanes.terms)]
    excite = [k for k, t in enumerate(lanes.terms) if t.effect.excite is not None]
    plain = replace(
        lanes,
        terms=tuple(lanes.terms[k] for k in inner),
        sizes=lanes.sizes[:, inner] if lanes.terms else lanes.sizes,
    )
    if not excite:
        return [(np.arange(lanes.count), (record, plain))]
    sizes, which = np.unique(lanes.sizes[:, excite], axis=0, return_inverse=True)
    parts = []
    for v, row in enumerate(sizes):
        changed = record
        for k, size in zip(excite, row, strict=True):
            term = lanes.terms[k]
            assert term.effect.excite is not None
            if size != 0.0:
                changed = _changed(term, changed, size)
        rows = np.flatnonzero(which.reshape(-1) == v)
        part = replace(
            plain,
            theta=plain.theta[rows],
            windows=plain.windows[rows],
            starts=plain.starts[rows],
            sizes=plain.sizes[rows] if plain.terms else plain.sizes,
            forces=None if plain.forces is None else plain.forces[rows],
        )
        parts.append((rows, (changed, part)))
    return parts


def _sensed(
    model: Model,
    record: Record,
    lanes: Lanes,
    outputs: Array,
    going_on: NDArray[np.bool_] | None = None,
) -> Array:
    """Known part of the sensors."""
    changed = outputs
    for o, name in enumerate(model.outputs):
        sensor = record.sensors.get(name)
        if sensor is None:
            continue
        y = changed[:, :, o]
        new = y
        if np.isfinite(sensor.bandwidth):
            new = _low_pass(record, lanes, new, sensor, going_on)
        if sensor.delay != 0.0:
            new = shifted(record, new, lanes.windows, np.full(lanes.count, sensor.delay))
        if sensor.gain != 1.0 or sensor.offset != 0.0:
            new = sensor.gain * new + sensor.offset
        if new is not y:
            if changed is outputs:
                changed = outputs.copy()
            changed[:, :, o] = new
    return changed


def _times(record: Record, lanes: Lanes, length: int) -> Array:
    at = np.minimum(lanes.windows[:, :1] + np.arange(length), record.samples - 1)
    return np.asarray(record.time[at])


def _low_pass(
    record: Record,
    lanes: Lanes,
    y: Array,
    sensor: Sensor,
    going_on: NDArray[np.bool_] | None = None,
) -> Array:
    """First-order low-pass, exact for a signal that is linear between samples.

    A window that follows another in the list from the sample that both share goes on with what the
    filter held there; any other starts as if the signal had always had its first slope.
    ``going_on``: windows that go on with what windows held that are not among the lanes; the filter
    then starts with their first value.
    """
    time = _times(record, lanes, y.shape[1])
    rate = 2.0 * np.pi * sensor.bandwidth
    out = np.empty_like(y)
    slope = (y[:, 1] - y[:, 0]) / np.maximum(time[:, 1] - time[:, 0], 1e-300)
    out[:, 0] = y[:, 0] - slope / rate
    for j in range(1, y.shape[1]):
        h = np.maximum(time[:, j] - time[:, j - 1], 0.0)
        decay = np.exp(-rate * h)
        ramp = np.divide(y[:, j] - y[:, j - 1], h, out=np.zeros_like(h), where=h > 0.0)
        steady = y[:, j] - ramp / rate
        out[:, j] = steady + (out[:, j - 1] - (y[:, j - 1] - ramp / rate)) * decay
    if going_on is not None:
        change = np.where(going_on, y[:, 0] - out[:, 0], 0.0)
        return np.asarray(out + change[:, None] * np.exp(-rate * (time - time[:, :1])))
    for b in range(1, len(y)):
        end = lanes.windows[b - 1, 1] - lanes.windows[b - 1, 0]
        if lanes.windows[b - 1, 1] != lanes.windows[b, 0] or not np.isfinite(out[b - 1, end]):
            continue
        held = y[b, 0] + out[b - 1, end] - y[b - 1, end]
        out[b] += (held - out[b, 0]) * np.exp(-rate * (time[b] - time[b, 0]))
    return out


def observed_sensitivities(
    model: Model,
    record: Record,
    theta: Array,
    windows: NDArray[np.intp],
    starts: Array,
    terms: tuple[Term, ...],
    sizes: Array,
    *,
    by_theta: Sequence[int],
    by_starts: bool,
    candidates: tuple[Term, ...],
) -> Sensitivity:
    """Derivatives of what the sensors show.

    The model differentiates its machine; its columns go through the map of the sensors and
    sensor effects, which is cheap. Only input effects need simulations of their own.
    """
    count = len(windows)
    inner = [k for k, t in enumerate(terms) if t in machine_terms(terms)]
    machine = machine_terms(candidates)
    changed = record
    for k, term in enumerate(terms):
        if term.effect.excite is not None and sizes[k] != 0.0:
            changed = _changed(term, changed, float(sizes[k]))
    s = model.sensitivities(
        changed,
        theta,
        windows,
        starts,
        tuple(terms[k] for k in inner),
        sizes[inner],
        by_theta=by_theta,
        by_starts=by_starts,
        candidates=machine,
    )
    lanes = Lanes(theta=np.tile(theta, (count, 1)), windows=windows, starts=starts)
    observing = [(t, float(sizes[k])) for k, t in enumerate(terms) if t.effect.observe is not None]

    follows = np.append(False, windows[:-1, 1] == windows[1:, 0])

    def show(outputs: Array, extra: tuple[Term, float] | None = None, rows: slice = ALL) -> Array:
        """Outputs of the windows of these rows as the record would hold them."""
        part = replace(lanes, theta=lanes.theta[rows], windows=windows[rows], starts=starts[rows])
        for term, size in [*observing, *([extra] if extra else [])]:
            outputs = _seen(term, record, outputs, part.windows, np.full(part.count, size))
        return _sensed(model, record, part, outputs, None if rows == ALL else follows[rows])

    shown = show(s.outputs)
    spread = float(np.nanmax(np.abs(s.outputs))) if s.outputs.size else 1.0

    def push(columns: Array, rows: slice = ALL) -> Array:
        """Derivatives through the map of the sensors."""
        out, base = np.empty_like(columns), s.outputs[rows]
        for i in range(columns.shape[3]):
            largest = float(np.nanmax(np.abs(columns[..., i]))) if columns.size else 0.0
            step = 1e-4 * (spread or 1.0) / largest if largest > 0.0 else 1.0
            up, down = (show(base + h * columns[..., i], rows=rows) for h in (step, -step))
            out[..., i] = (up - down) / (2.0 * step)
        return out

    def push_alone(columns: Array) -> Array:
        """The same for columns that are a window's own: what it sees of others has none of them."""
        out = np.empty_like(columns)
        for rows in (slice(0, None, 2), slice(1, None, 2)):  # no two neighbors
            out[rows] = push(columns[rows], rows)
        return out

    def offsets(term: Term, at: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Two changes of a size, and their weights in the derivative."""
        step = term.effect.step * term.effect.scale
        low, high = term.effect.bounds
        if at + step <= high and at - step >= low:
            return (step, -step), (0.5 / step, -0.5 / step)
        side = step if at + 2.0 * step <= high else -step
        return (side, 2.0 * side), (2.0 / side, -0.5 / side)

    def job(term: Term, size: float, active: int | None) -> Job:
        """All windows with one input effect at another size."""
        all_terms = terms if active is not None else (*terms, term)
        row = sizes.copy() if active is not None else np.append(sizes, size)
        if active is not None:
            row[active] = size
        return record, replace(lanes, terms=all_terms, sizes=np.tile(row, (count, 1)))

    asked: list[tuple[Term, float, int | None]] = [
        (term, float(sizes[k]), k) for k, term in enumerate(terms)
    ]
    asked += [(term, 0.0, None) for term in candidates]
    asked = [a for a in asked if a[0].effect.excite is not None and a[0].effect.observe is None]
    runs = observe_all(
        model,
        [job(term, at + o, active) for term, at, active in asked for o in offsets(term, at)[0]],
    )
    simulated = {
        (id(term), active): runs[2 * i : 2 * i + 2] for i, (term, _, active) in enumerate(asked)
    }

    def outer(term: Term, at: float, active: int | None) -> tuple[Array, Array]:
        y, x = np.zeros_like(shown), np.zeros_like(s.ends)
        for i, (offset, weight) in enumerate(zip(*offsets(term, at), strict=True)):
            if term.effect.observe is None:
                run = simulated[id(term), active][i]
                y += weight * (run.outputs[:, : shown.shape[1]] - shown)
                x += weight * (run.ends - s.ends)
                continue
            if active is None:
                value = show(s.outputs, (term, at + offset))
            else:
                value = _swapped(show, observing, term, at + offset, s.outputs)
            y += weight * (value - shown)
        return y, x

    d_sizes = np.zeros((*shown.shape, len(terms)))
    d_sizes_ends = np.zeros((*s.ends.shape, len(terms)))
    pushed = push(s.d_sizes)
    for k, term in enumerate(terms):
        if k in inner:
            d_sizes[..., k] = pushed[..., inner.index(k)]
            d_sizes_ends[..., k] = s.d_sizes_ends[..., inner.index(k)]
        else:
            d_sizes[..., k], d_sizes_ends[..., k] = outer(term, float(sizes[k]), k)
    d_candidates = np.zeros((*shown.shape, len(candidates)))
    d_candidates_ends = np.zeros((*s.ends.shape, len(candidates)))
    pushed = push(s.d_candidates)
    at = 0
    for k, term in enumerate(candidates):
        if machine_terms((term,)):
            d_candidates[..., k] = pushed[..., at]
            d_candidates_ends[..., k] = s.d_candidates_ends[..., at]
            at += 1
        else:
            d_candidates[..., k], d_candidates_ends[..., k] = outer(term, 0.0, None)
    return Sensitivity(
        outputs=shown,
        ends=s.ends,
        d_theta=push(s.d_theta),
        d_theta_ends=s.d_theta_ends,
        d_sizes=d_sizes,
        d_sizes_ends=d_sizes_ends,
        d_starts=push_alone(s.d_starts),
        d_starts_ends=s.d_starts_ends,
        d_candidates=d_candidates,
        d_candidates_ends=d_candidates_ends,
    )


def _swapped(
    show: Callable[..., Array],
    observing: list[tuple[Term, float]],
    term: Term,
    size: float,
    outputs: Array,
) -> Array:
    """What is shown with another size of one sensor effect that is part of the model."""
    at = next(i for i, (t, _) in enumerate(observing) if t is term)
    kept = observing[at]
    observing[at] = (term, size)
    try:
        return show(outputs)
    finally:
        observing[at] = kept
