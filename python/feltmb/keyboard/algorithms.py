"""Two algorithms that find strikes in the samples of a hammer sensor, as examples.

An algorithm is a function of the samples and of the setup that returns the time [s] and the speed
at the string [m/s] of each strike.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd

    from feltmb.keyboard.sensor import Setup

    Array = npt.NDArray[np.float64]

NEAR = 0.9  #: A hammer that turns back beyond this travel has struck.
#: Way before the string on which the hammer is free [m]; error of the speed by noise [1].
FLIGHT, ACCURACY = 2e-3, 2e-3
MARGIN = 6.0  #: Distance of the last sample from the string, as a multiple of the noise.
AWAY = 0.03  #: It has turned back when it is this far below its largest travel.


def _turns(travel: Array) -> list[int]:
    """Indices of the largest travel of each strike."""
    found: list[int] = []
    top, rising = 0, False
    for i, x in enumerate(travel):
        past = x - travel[top] if rising else travel[top] - x
        if past > 0.0:
            top = i
        elif past < -AWAY:  # it has turned back; the next strike begins when it rises again
            if rising and travel[top] > NEAR:
                found.append(top)
            top, rising = i, not rising
    return found


def largest_derivative(samples: pd.DataFrame, setup: Setup) -> list[tuple[float, float]]:
    """The largest difference over 1 ms in the last 30 ms before the hammer turns back.

    Parameters
    ----------
    samples
        Counts of the converter, over time [s].
    setup
        Sensor and action.
    """
    time, rate = samples.index.to_numpy(float), setup.sensor.rate
    travel = setup.reach * setup.sensor.followed(samples["hammer"].to_numpy())
    width, last = max(1, round(1e-3 * rate)), round(30e-3 * rate)
    speed = np.zeros_like(travel)
    speed[width:] = (travel[width:] - travel[:-width]) * rate / width
    return [
        (float(time[i]), float(speed[max(0, i - last) : i + 1].max()))
        for i in _turns(travel / setup.reach)
    ]


def model_based(samples: pd.DataFrame, setup: Setup) -> list[tuple[float, float]]:
    """The motion of a free hammer, fitted to the last travel before the string.

    A hammer that is thrown off has a known deceleration; time and speed at the string are those
    of the parabola through the last samples before it. The gain of the unit is corrected so that
    the largest travel is that of a strike at this speed.

    Parameters
    ----------
    samples
        Counts of the converter, over time [s].
    setup
        Sensor and action.
    """
    time = samples.index.to_numpy(float)
    counts = samples["hammer"].to_numpy(float)
    sensor = setup.sensor
    most = 2**sensor.bits - 1
    dark = np.median(counts[: max(3, round(0.01 * sensor.rate))])
    rest = (np.interp(0.0, sensor.travel, sensor.reading) - sensor.low) / (sensor.high - sensor.low)
    counts = counts - dark + most * rest
    found = []
    for top in _turns(sensor.followed(counts)):
        speed, gain, at = 1.0, 1.0, float(time[top])
        for _ in range(4):
            travel = setup.reach * sensor.followed(counts * gain)
            fitted = _flight(time, travel, top, setup, speed)
            if fitted is None:
                break
            at, speed = fitted
            peak = np.interp(speed, setup.speeds, setup.peaks)
            wanted = np.interp(peak, sensor.travel, sensor.reading) - sensor.low
            window = counts[max(0, top - 2) : top + 3]
            if len(sensor.branches) == 1:
                gain = (
                    wanted / (sensor.high - sensor.low) * most / float(np.sort(window)[-3:].mean())
                )
        else:
            found.append((at, speed))
    return found


def _flight(
    time: Array, travel: Array, top: int, setup: Setup, speed: float
) -> tuple[float, float] | None:
    """Time and speed at the string of the parabola through the samples just before it."""
    sensor = setup.sensor
    slope = np.interp(1.0, sensor.travel[1:], np.diff(sensor.reading) / np.diff(sensor.travel))
    step = (sensor.high - sensor.low) / (2**sensor.bits - 1)
    noise = np.hypot(sensor.noise, 0.3 * step) * setup.reach / max(abs(float(slope)), 0.05)
    before = np.flatnonzero(travel[: top + 1] < setup.reach - MARGIN * noise)
    if before.size == 0:
        return None
    end = int(before[-1])
    # As many samples as the noise wants, but from the free flight only, and at least 4.
    wanted = (np.sqrt(12.0 / sensor.rate) * noise / (ACCURACY * speed)) ** (2.0 / 3.0)
    count = max(4, round(min(wanted, FLIGHT / speed) * sensor.rate))
    rows = np.arange(max(0, end - count + 1), end + 1)
    t = time[rows] - time[end]
    known = travel[rows] + 0.5 * setup.flight * t**2
    slope, offset = np.polyfit(t, known, 1)
    # reach = offset + slope t - flight t^2 / 2
    root = slope**2 - 2.0 * setup.flight * (setup.reach - offset)
    if slope <= 0.0:
        return None
    if root <= 0.0:  # it would turn back before the string, by the errors of the sensor
        return float(time[end]), float(slope)
    at = 2.0 * (setup.reach - offset) / (slope + np.sqrt(root))
    return float(time[end] + at), float(np.sqrt(root))
