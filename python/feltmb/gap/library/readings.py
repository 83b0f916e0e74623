"""The record of an input is the reading of a sensor: one convention for all channels.

reading(t) = (1 + gain) truth(t - delay) + offset

A channel that reads too much has gain > 0, one that is late delay > 0, whether it shows an output
or an input. An output is compared as the sensor would show it; an input that drives the model is
taken back to what acted, truth(t) = (reading(t + delay) - offset) / (1 + gain).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from feltmb.data import Array

__all__ = ["ReadingError", "acting"]

ReadingError = Literal["delay", "gain", "offset"]


def acting(
    time: Array, reading: Array, error: ReadingError, size: float, *, smooth: bool = False
) -> Array:
    """What acted, of an input whose record has an error of the sensor.

    Parameters
    ----------
    time
        Of the samples [s].
    reading
        Recorded input, its unit.
    error
        ``gain`` [1], ``offset`` [unit of the input] or ``delay`` [s].
    magnitude
        Of the error: positive where the sensor reads too much or late.
    smooth
        Cubic between the samples, for an input without jumps; linear else.
    """
    if size == 0.0:
        return reading
    if error == "gain":
        return np.asarray(reading / (1.0 + size))
    if error == "offset":
        return np.asarray(reading - size)
    moments = np.clip(time + size, time[0], time[-1])
    if smooth:
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(time, reading)(moments))
    return np.asarray(np.interp(moments, time, reading))
