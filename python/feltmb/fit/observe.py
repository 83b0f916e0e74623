"""From the machine to the record: input effects, sensor effects, known sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feltmb.data import Array, Record, Sensor
from feltmb.fit.nominal import Lanes, Nominal, Simulated, Term

__all__ = ["machine_terms", "observe_lanes"]


def machine_terms(terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Terms that the nominal itself must simulate."""
    return tuple(t for t in terms if t.effect.excite is None and t.effect.observe is None)


def observe_lanes(nominal: Nominal, record: Record, lanes: Lanes) -> Simulated:
    """Simulate lanes as the sensors of the record would show them.

    Input effects change the inputs before, sensor effects and the known part of the sensors (gain,
    delay, low-pass, offset) change the outputs after the nominal's own simulation.
    """
    inner = [k for k, t in enumerate(lanes.terms) if t in machine_terms(lanes.terms)]
    excite = [k for k, t in enumerate(lanes.terms) if t.effect.excite is not None]
    observe = [k for k, t in enumerate(lanes.terms) if t.effect.observe is not None]
    plain = replace(
        lanes,
        terms=tuple(lanes.terms[k] for k in inner),
        sizes=lanes.sizes[:, inner] if lanes.terms else lanes.sizes,
    )
    if not excite:
        run = nominal.simulate(record, plain)
    else:
        run = _excited(nominal, record, lanes, plain, excite)
    outputs = run.outputs
    for k in observe:
        term = lanes.terms[k]
        assert term.effect.observe is not None
        outputs = term.effect.observe(record, outputs, lanes.windows, lanes.sizes[:, k], term.shape)
    return Simulated(outputs=_sensed(nominal, record, lanes, outputs), ends=run.ends)


def _excited(
    nominal: Nominal, record: Record, lanes: Lanes, plain: Lanes, excite: list[int]
) -> Simulated:
    """Lanes with input effects: one simulation for each different set of sizes."""
    sizes, which = np.unique(lanes.sizes[:, excite], axis=0, return_inverse=True)
    which = which.reshape(-1)
    outputs = np.full((lanes.count, lanes.longest, len(nominal.outputs)), np.nan)
    ends = np.full((lanes.count, lanes.starts.shape[1]), np.nan)
    for v, row in enumerate(sizes):
        changed = record
        for k, size in zip(excite, row, strict=True):
            term = lanes.terms[k]
            assert term.effect.excite is not None
            if size != 0.0:
                changed = changed.with_inputs(term.effect.excite(changed, size, term.shape))
        rows = np.flatnonzero(which == v)
        part = replace(
            plain,
            theta=plain.theta[rows],
            windows=plain.windows[rows],
            starts=plain.starts[rows],
            sizes=plain.sizes[rows] if plain.terms else plain.sizes,
            forces=None if plain.forces is None else plain.forces[rows],
        )
        run = nominal.simulate(changed, part)
        outputs[rows, : run.outputs.shape[1]] = run.outputs
        ends[rows] = run.ends
    return Simulated(outputs=outputs, ends=ends)


def _sensed(nominal: Nominal, record: Record, lanes: Lanes, outputs: Array) -> Array:
    """Known part of the sensors."""
    changed = outputs
    for o, name in enumerate(nominal.outputs):
        sensor = record.sensors.get(name)
        if sensor is None:
            continue
        y = changed[:, :, o]
        new = y
        if np.isfinite(sensor.bandwidth):
            new = _low_pass(record, lanes, new, sensor)
        if sensor.delay != 0.0:
            new = _delayed(record, lanes, new, sensor.delay)
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


def _delayed(record: Record, lanes: Lanes, y: Array, delay: float) -> Array:
    """Shift within the windows; straight continuation where a window begins or ends."""
    time = _times(record, lanes, y.shape[1])
    out = np.empty_like(y)
    for b in range(y.shape[0]):
        last = lanes.windows[b, 1] - lanes.windows[b, 0]
        t, v = time[b, : last + 1], y[b, : last + 1]
        want = t - delay
        out[b] = np.nan
        inside = np.interp(want, t, v)
        low, high = want < t[0], want > t[-1]
        inside[low] = v[0] + (v[1] - v[0]) / (t[1] - t[0]) * (want[low] - t[0])
        inside[high] = v[-1] + (v[-1] - v[-2]) / (t[-1] - t[-2]) * (want[high] - t[-1])
        out[b, : last + 1] = inside
    return out


def _low_pass(record: Record, lanes: Lanes, y: Array, sensor: Sensor) -> Array:
    """First-order low-pass, exact for a signal that is linear between samples."""
    time = _times(record, lanes, y.shape[1])
    rate = 2.0 * np.pi * sensor.bandwidth
    out = np.empty_like(y)
    slope = (y[:, 1] - y[:, 0]) / np.maximum(time[:, 1] - time[:, 0], 1e-300)
    out[:, 0] = y[:, 0] - slope / rate  # as if the signal had always had this slope
    for j in range(1, y.shape[1]):
        h = np.maximum(time[:, j] - time[:, j - 1], 0.0)
        decay = np.exp(-rate * h)
        ramp = np.divide(y[:, j] - y[:, j - 1], h, out=np.zeros_like(h), where=h > 0.0)
        steady = y[:, j] - ramp / rate
        out[:, j] = steady + (out[:, j - 1] - (y[:, j - 1] - ramp / rate)) * decay
    return out
