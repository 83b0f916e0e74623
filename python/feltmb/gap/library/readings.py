"""Sign convention of sensor errors, the same for outputs and for recorded inputs.

reading(t) = (1 + gain) truth(t - delay) + offset

A reading that is too large has gain > 0, and a reading that is late has delay > 0, for outputs as
well as inputs. An output of the model is converted to the reading of the sensor before the
comparison. A recorded input is converted back to the true input before it drives the model:
truth(t) = (reading(t + delay) - offset) / (1 + gain).
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
    """True input, computed from a record with a sensor error.

    Parameters
    ----------
    time
        Time of the samples [s].
    reading
        Recorded input [its unit].
    error
        ``gain`` [1], ``offset`` [unit of the input] or ``delay`` [s].
    magnitude
        Magnitude of the error: positive if the reading is too large or late.
    smooth
        Cubic interpolation between samples, for an input without jumps; else linear.
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
