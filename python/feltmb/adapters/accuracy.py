"""Error of simulated forces by the noise of a measured motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from feltmb.adapters.simulator import MechanismSimulator
from feltmb.data import Array, Record
from feltmb.data.smoothing import LEAST_SAMPLES, WINDOW, smooth_record

__all__ = ["with_force_error"]

Mask = NDArray[np.bool_]

#: Number of simulated motions with noise: their rms is then known to a fifth in each window.
DRAWS = 4
#: A key moves where its speed exceeds so many standard deviations of the noise of the speed.
MOVING = 3.0


def with_force_error(
    simulator: MechanismSimulator, record: Record, turn: float | None, notes: list[str]
) -> Record:
    """Carry the noise of a measured motion into the force that the motion needs.

    The force depends on the acceleration of the motion, which is known only as far as the motion is
    sampled and smoothed. The smoothed motion is given new noise and smoothed again, and the force
    of the packaged mechanism is simulated with it. The rms difference of four such forces is the
    error. It is added to the noise of the force sensor (root sum of squares).

    A record has one noise by channel, but the error is several times larger where the motion has a
    kink. Samples with the largest error (rms over 8 ms) are therefore not used: as many as make the
    information of the other n samples, ``n^2 / sum(sigma_i^2)``, a maximum. Two other parts are not
    used: samples after the reversal of the stroke, because the impact shakes the key faster than a
    sampled motion shows; and a key at rest, because the sign of friction is that of a speed, which
    is known there only by its noise.

    Parameters
    ----------
    simulator
        Simulator of the mechanism.
    record
        A record; it is returned unchanged if its input is not a motion with noise, or if no force
        is measured.
    turn
        Time of the reversal of the stroke [s]; None: unknown.
    notes
        A sentence is added for each force that is changed.
    """
    names = [o for o in simulator.outputs if simulator.units[o] == "N" and o in record.outputs]
    sigma = record.input_sigma.get("displacement", 0.0)
    if record.input_mode != "motion" or not names or not sigma > 0.0:
        return record
    if record.samples < LEAST_SAMPLES:
        return record
    width = max(1, round(WINDOW / record.interval))
    errors = _squared_errors(simulator, record, sigma, width)
    if errors is None:
        return record
    square, moving = errors
    outputs, sensors = dict(record.outputs), dict(record.sensors)
    for name in names:
        finite = np.isfinite(outputs[name])
        measured = finite & moving & (record.time <= (np.inf if turn is None else turn))
        own = sensors[name].sigma or 0.0
        if not finite.any():
            continue
        used, error = _most_informative(
            square[:, simulator.outputs.index(name)], measured, own, width
        )
        outputs[name] = np.where(used, outputs[name], np.nan)
        sensors[name] = replace(sensors[name], sigma=math.hypot(own, error))
        left = 1.0 - np.count_nonzero(used) / np.count_nonzero(finite)
        notes.append(
            f"{record.name}: displacement has a noise of {sigma:.2g} m, which causes an error of "
            f"{error:.2g} N (rms) of the simulated {name}: it is added to the noise of the sensor; "
            f"{left:.0%} of the samples are not used: larger errors, rest, or after the impact"
        )
    return replace(record, outputs=outputs, sensors=sensors)


def _squared_errors(
    simulator: MechanismSimulator, record: Record, sigma: float, width: int
) -> tuple[Array, Mask] | None:
    """Mean squared error of the outputs by the noise of a motion, (n, ny), and where it moves.

    None if the mechanism cannot be simulated.
    """
    random = np.random.default_rng(0)
    clean = replace(record, input_sigma={**record.input_sigma, "displacement": 0.0})

    def outputs(displacement: Array) -> Array | None:
        return simulator.as_tabulated(clean.with_inputs({"displacement": displacement}))

    smoothed = simulator.drives.of(record).value
    base, squares, speeds = outputs(smoothed), [], []
    for _ in range(DRAWS):
        noisy = smoothed + sigma * random.standard_normal(record.samples)
        again = smooth_record(record.time, noisy, sigma)
        other = outputs(again)
        if base is not None and other is not None:
            squares.append(np.square(other - base))
            speeds.append(np.square(np.gradient(again - smoothed, record.time)))
    if not squares:
        return None
    noise = np.sqrt(_local_mean(np.mean(speeds, axis=0), width))
    moving = np.abs(np.gradient(smoothed, record.time)) > MOVING * noise
    return np.mean(squares, axis=0), moving


def _local_mean(values: Array, width: int) -> Array:
    """Mean over a window of some samples, shorter at the ends."""
    window = np.ones(min(width, values.size))
    count = np.convolve(np.ones(values.size), window, "same")
    return np.asarray(np.convolve(values, window, "same") / count)


def _most_informative(
    square: Array, measured: Mask, sigma: float, width: int
) -> tuple[Mask, float]:
    """Samples that are used, and their rms error, from the squared error of each sample."""
    local = _local_mean(square, width)
    order = np.argsort(np.where(measured, local, np.inf), kind="stable")[: measured.sum()]
    used = np.zeros(square.size, dtype=bool)
    if order.size:
        total = np.cumsum(local[order] + sigma**2)
        count = np.arange(1, order.size + 1)
        used[order[: int(np.argmax(count**2 / np.maximum(total, 1e-300))) + 1]] = True
    return used, float(np.sqrt(np.mean(square[used]))) if used.any() else 0.0
