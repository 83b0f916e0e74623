"""Sign convention of sensor errors, the same for outputs and for recorded inputs.

reading(t) = gain truth(t - delay) + offset

A reading that is too large has a gain error > 0 (gain = 1 + error), and a reading that is late has
a delay > 0, for outputs as well as inputs. An output of the model is converted to the reading of
the sensor before the comparison. A recorded input is converted back to the true input before it
drives the model.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ReadingError = Literal["delay", "gain", "offset"]


def true_input(
    time: Array,
    reading: Array,
    *,
    delay: float = 0.0,
    bandwidth: float = math.inf,
    gain: float = 1.0,
    offset: float = 0.0,
    smooth: bool = False,
    before: float | None = None,
) -> Array:
    """True input from the reading ``gain * low_pass(truth)(t - delay) + offset`` of a sensor.

    The low-pass is inverted with the slope of the reading, which increases the noise. After the
    record, the input is constant.

    Parameters
    ----------
    time
        Time of the samples [s].
    reading
        Recorded input [its unit].
    delay
        Delay [s]; positive: the reading is late.
    bandwidth
        Corner frequency of a first-order low-pass [Hz].
    gain, offset
        Gain [1] and offset [unit of the input].
    smooth
        Cubic interpolation between samples, for an input without jumps; else linear.
    before
        True input one sample before the record and earlier [its unit]; default: that of the first
        sample.
    """
    out = (reading - offset) / gain
    if math.isfinite(bandwidth):
        out = out + np.gradient(out, time) / (2.0 * math.pi * bandwidth)
    if delay != 0.0:
        moments = time + delay
        if before is not None:
            time = np.concatenate([[2.0 * time[0] - time[1]], time])
            out = np.concatenate([[before], out])
        moments = np.clip(moments, time[0], time[-1])
        if smooth:
            from scipy.interpolate import CubicSpline

            out = CubicSpline(time, out)(moments)
        else:
            out = np.interp(moments, time, out)
    return np.asarray(out)


def acting(
    time: Array, reading: Array, error: ReadingError, size: float, *, smooth: bool = False
) -> Array:
    """True input, computed from a record with one error of its sensor; see :func:`true_input`.

    Parameters
    ----------
    time
        Time of the samples [s].
    reading
        Recorded input [its unit].
    error
        ``gain`` [1], ``offset`` [unit of the input] or ``delay`` [s].
    size
        Size of the error: positive if the reading is too large or late; 0: the reading is returned
        unchanged.
    smooth
        Cubic interpolation between samples.
    """
    if size == 0.0:
        return reading
    if error == "gain":
        return true_input(time, reading, gain=1.0 + size)
    if error == "offset":
        return true_input(time, reading, offset=size)
    return true_input(time, reading, delay=size, smooth=smooth)
