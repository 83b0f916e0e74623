"""Two algorithms that find strikes in the samples of a hammer sensor, as examples.

An algorithm is a function of the samples and of the setup that returns the time [s] and the speed
at the string [m/s] of each strike.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd

    from feltmb.keyboard.sensor import Setup

    Array = npt.NDArray[np.float64]

NEAR = 0.9  #: A hammer that turns back beyond this travel has struck.
#: Way before the string on which the hammer is free [m]; error of the speed by noise [1].
FLIGHT, ACCURACY = 2e-3, 2e-3
MARGIN = 6.0  #: Distance of the last sample from the string, as a multiple of the noise.
#: Uncertainty of the largest reading of a strike, share of the full scale [1].
PEAK = 1e-3
#: A unit has no larger errors of gain and place, in standard deviations of its tolerances.
LARGEST = 5.0
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
    """The motion of a free hammer and the errors of the unit, fitted by least squares.

    A hammer that is thrown off has a known deceleration. Time and speed at the string, gain and
    place of the unit at hand are those with which the curve of the sensor gives the last samples
    before the string, the largest travel of the strike, and the reading at rest.

    Parameters
    ----------
    samples
        Counts of the converter, over time [s].
    setup
        Sensor and action.
    """
    sensor, time = setup.sensor, samples.index.to_numpy(float)
    step = (sensor.high - sensor.low) / (2**sensor.bits - 1)
    reading = sensor.low + step * samples["hammer"].to_numpy(float)
    noise = float(np.hypot(sensor.noise, 0.3 * step))
    still = reading[: max(3, round(0.01 * sensor.rate))]
    found = []
    for top in _turns(sensor.followed(samples["hammer"])):
        usual = np.interp(np.interp(1.0, setup.speeds, setup.peaks), sensor.travel, sensor.reading)
        more = np.clip(reading[top] / usual - 1.0, -4.0 * sensor.gain, 4.0 * sensor.gain)
        gain, shift, speed = 1.0 + float(more), 0.0, 1.0
        for _ in range(4):
            travel = sensor.followed((reading / gain - sensor.low) / step) - shift
            rows = _flight(travel[: top + 1], noise, speed, setup)
            if rows.size == 0:
                break
            given = np.array([*reading[rows], reading[top], still.mean()])
            sigma = np.array([*np.full(rows.size, noise), PEAK, noise])
            end, left = float(time[rows[-1]]), time[rows] - time[rows[-1]]

            def errors(p: Array, left: Array = left, given: Array = given,
                       sigma: Array = sigma) -> Array:  # fmt: skip
                """Errors over their standard deviations: of the readings, gain and place."""
                left, speed = 1e-3 * p[0] - left, p[1]
                way = 1.0 - (speed * left + 0.5 * setup.flight * left**2) / setup.reach
                places = np.array([*way, np.interp(speed, setup.speeds, setup.peaks), 0.0])
                read = np.interp(places + sensor.shift * p[3], sensor.travel, sensor.reading)
                return np.array([*((given - (1.0 + sensor.gain * p[2]) * read) / sigma), *p[2:]])

            speed = max(setup.reach * float(travel[rows[-1]] - travel[rows[0]])
                        / (end - float(time[rows[0]])), 0.1)  # fmt: skip
            start = 1e3 * setup.reach * (1.0 - float(travel[rows[-1]])) / speed
            p = least_squares(errors, [start, speed, 0.0, 0.0], method="lm", ftol=1e-6, xtol=1e-6).x
            at, speed = end + 1e-3 * p[0], float(p[1])
            gain, shift = 1.0 + sensor.gain * p[2], sensor.shift * p[3]
        else:
            # Else it turned back before the string: the fit blames the unit.
            if speed > 0.0 and np.abs(p[2:]).max() < LARGEST:
                found.append((at, speed))
    return found


def _flight(travel: Array, noise: float, speed: float, setup: Setup) -> npt.NDArray[np.intp]:
    """Samples of the free flight before the string, of a travel that ends where it turns back."""
    sensor = setup.sensor
    slope = np.interp(1.0, sensor.travel[1:], np.diff(sensor.reading) / np.diff(sensor.travel))
    spread = noise / max(abs(float(slope)), 0.05)
    before = np.flatnonzero(travel < 1.0 - MARGIN * spread)
    if before.size == 0:
        return before
    # As many samples as the noise wants, but from the free flight only, and at least 4.
    wanted = (np.sqrt(12.0 / sensor.rate) * setup.reach * spread / (ACCURACY * abs(speed))) ** (
        2 / 3
    )
    count = max(4, round(min(wanted, FLIGHT / abs(speed)) * sensor.rate))
    return np.arange(max(0, int(before[-1]) - count + 1), int(before[-1]) + 1)
