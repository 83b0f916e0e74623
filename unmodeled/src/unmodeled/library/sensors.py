"""Sensor effects: gain, nonlinearity, offset, delay and lag of a channel."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.fit import Effect
from unmodeled.fit.observe import continued, low_passed, shifted


def curve(values: Array, shape: str) -> Array:
    """|x| for an "odd" bend x |x|, x for an "even" one x^2."""
    return np.abs(values) if shape == "odd" else values


def _sensor(
    outputs: Sequence[str],
    name: str,
    label: str,
    change: Callable[[Array, Array, Record, Any], Array],
    **fields: Any,
) -> Effect:
    """Effect on one channel with the given ``change`` of its values.

    Signature: ``change(values (B, n), magnitudes (B,), record, shape)``.
    """
    channel = list(outputs).index(name)

    def observe(record: Record, values: Array, magnitudes: Array, shape: Any) -> Array:
        out = values.copy()
        out[:, :, channel] = change(values[:, :, channel], magnitudes, record, shape)
        return out

    return Effect(
        name=f"{label} {name}", component=f"sensor {name}", kind="sensor", observe=observe, **fields
    )


def sensor_gain(outputs: Sequence[str], name: str) -> Effect:
    """The channel shows (1 + magnitude) times the output."""
    return _sensor(
        outputs,
        name,
        "gain of sensor",
        lambda y, size, r, shape: (1.0 + size[:, None]) * y,
        scale=0.05,
        mechanism="The sensor has another gain.",
        remedy="Calibrate the sensor.",
    )


def sensor_bend(outputs: Sequence[str], name: str, *, level: float) -> Effect:
    """The channel shows ``y + m y^2 / level`` ("even") or ``y + m y |y| / level`` ("odd").

    m is the magnitude.

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    level
        Reading at which a magnitude of 1 doubles the reading.
    """
    return _sensor(
        outputs,
        name,
        "nonlinearity of sensor",
        lambda y, size, r, shape: y + size[:, None] * y * curve(y, shape) / level,
        scale=0.05,
        shapes=("odd", "even"),
        mechanism="The sensor is not linear.",
        remedy="Calibrate the sensor over its range.",
    )


def sensor_offset(outputs: Sequence[str], name: str, *, unit: str, scale: float) -> Effect:
    """The channel shows the output plus the magnitude.

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    unit
        Unit of the channel.
    scale
        Offset that one would expect [unit].
    """
    return _sensor(
        outputs,
        name,
        "offset of sensor",
        lambda y, size, r, shape: y + size[:, None],
        unit=unit,
        scale=scale,
        mechanism="The sensor has an offset.",
        remedy="Zero the sensor.",
    )


def sensor_saturation(
    outputs: Sequence[str],
    name: str,
    *,
    highest: Sequence[float],
    lowest: Sequence[float],
    unit: str = "1",
) -> Effect:
    """The channel grows less beyond a reading: a sensor at the end of its range.

    With the magnitude m in [0, 1], the channel shows y - m max(y - level, 0) for a highest reading,
    and y + m max(level - y, 0) for a lowest one. m = 1 is a hard limit.

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    highest, lowest
        Readings that are tried as the end of its range [unit]. Others above and below the middle of
        all of them are fitted.
    unit
        Unit of the channel.
    """
    middle = 0.5 * (max((*highest, *lowest)) + min((*highest, *lowest)))

    def beyond(y: Array, shape: tuple[str, float]) -> Array:
        end, level = shape
        return np.maximum(y - level, 0.0) if end == "highest" else np.minimum(y - level, 0.0)

    return _sensor(
        outputs,
        name,
        "saturation of sensor",
        lambda y, size, r, shape: y - size[:, None] * beyond(y, shape),
        scale=0.3,
        sign=1,
        upper=1.0,
        shapes=(*(("highest", v) for v in highest), *(("lowest", v) for v in lowest)),
        shape_names=("end", "reading" if unit == "1" else f"reading [{unit}]"),
        shape_zero=middle,
        mechanism="The sensor is at the end of its range.",
        remedy="Move the sensor, or use one with a larger range.",
    )


def sensor_delay(outputs: Sequence[str], name: str, *, scale: float) -> Effect:
    """The channel is late by the magnitude [s].

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    scale
        Delay that one would expect [s].
    """
    return _sensor(
        outputs,
        name,
        "delay of sensor",
        lambda y, size, r, shape: shifted(r, y, size),
        unit="s",
        scale=scale,
        mechanism="The sensor is late.",
        remedy="Synchronize the clocks.",
    )


def clock_rate() -> Effect:
    """The clock of all channels runs by another rate than that of the model and its inputs.

    At the time t of a record, counted from its first sample, the channels show the outputs at the
    time (1 + magnitude) t.
    """

    def observe(record: Record, values: Array, magnitudes: Array, shape: Any) -> Array:
        del shape
        out, time = values.copy(), record.time[: values.shape[1]]
        good = np.isfinite(values).all(axis=(1, 2)) & (magnitudes != 0.0)
        for size in np.unique(magnitudes[good]):
            rows = good & (magnitudes == size)
            out[rows] = continued(time, values[rows], time + size * (time - time[0]))
        return out

    return Effect(
        name="clock of the sensors",
        component="clock",
        kind="sensor",
        observe=observe,
        scale=0.01,
        mechanism="The clock of the records runs by another rate than the time of the model.",
        remedy="Compare the clock with another one over a long time.",
    )


def _first_reading(record: Record, name: str, constant: float) -> float:
    """Reading at the first sample, by a line over a quarter of a time constant; NaN: none."""
    reading = record.outputs.get(name, np.zeros(0))
    near = (record.time - record.time[0] <= 0.25 * constant)[: reading.size]
    near[:1] = True
    near &= np.isfinite(reading)
    if near.sum() < 3:
        return float(reading[0]) if reading.size else float("nan")
    time = record.time[near] - record.time[0]
    return float(np.polynomial.Polynomial.fit(time, reading[near], 1)(0.0))


def sensor_lag(outputs: Sequence[str], name: str, *, scale: float) -> Effect:
    """The channel follows with the time constant ``magnitude`` [s]: a first-order low-pass.

    magnitude * d(reading)/dt = output - reading. A record begins at rest, so that its first reading
    is the output. A record with an unknown start (:attr:`StartPrior.known`) begins with its own
    first reading, which is estimated from a line through the first readings; with a time constant
    much shorter than a sample, it begins as if the output always had its first slope.

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    scale
        Time constant that one would expect [s].
    """

    def change(y: Array, constants: Array, record: Record, shape: Any) -> Array:
        del shape
        starts = y[:, 0].copy()
        if record.start is not None and not record.start.known and record.samples > 1:
            step = max(float(record.time[1] - record.time[0]), 1e-300)
            for b in np.flatnonzero(constants > 0.0):
                constant = float(constants[b])
                # Without a jump at zero: the share of a first value after a sample.
                share = math.exp(-step / constant)
                steady = y[b, 0] - constant * (y[b, 1] - y[b, 0]) / step
                starts[b] = steady + share * (_first_reading(record, name, constant) - steady)
        return low_passed(record.time, y, constants, starts)

    return _sensor(
        outputs,
        name,
        "lag of sensor",
        change,
        unit="s",
        scale=scale,
        sign=1,
        mechanism="The sensor follows slowly, as a thermometer or a filtered signal does.",
        remedy="Use a faster sensor, or state its bandwidth.",
    )
