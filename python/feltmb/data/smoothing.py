"""Noise of sampled records: its standard deviation, and smoothing within it.

Used for measured motion, whose second derivative a mechanism has to follow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

__all__ = ["LEAST_SAMPLES", "NEAR", "noise_of_record", "smooth_record", "start_of"]

#: Smallest number of samples for an estimate of noise.
LEAST_SAMPLES = 12
#: Two values within this number of standard deviations of the noise are equal.
NEAR = 5.0
#: Range of the logarithm of the penalty (with the sample interval as unit of time), and its
#: accuracy.
_WEAKEST, _STRONGEST, _CLOSE = -6.0, 12.0, 0.02


def noise_of_record(value: npt.ArrayLike) -> float:
    """Standard deviation of white noise in an evenly sampled record, in its unit.

    The fourth difference of a smooth motion is almost zero, and that of white noise has 70 times
    the variance of the noise (1 + 16 + 36 + 16 + 1). The median of its absolute value is robust
    against kinks and impacts. Zero for fewer than 12 samples.
    """
    import numpy as np

    values = np.asarray(value, dtype=float)
    if values.size < LEAST_SAMPLES:
        return 0.0
    fourth = np.diff(values, 4)
    return float(np.median(np.abs(fourth)) / 0.6745 / np.sqrt(70.0))


def start_of(values: npt.ArrayLike, noise: float | None = None) -> float:
    """Mean of a record while it is at rest at the beginning, in its unit; NaN if not measured.

    Only the first quarter of the samples within the noise is averaged, because a motion that starts
    slowly has hardly moved then.

    Parameters
    ----------
    values
        The record; NaN is missing.
    noise
        Standard deviation of its noise; default: estimated.
    """
    import numpy as np

    x = np.asarray(values, dtype=float)
    x = x[np.isfinite(x)]
    if not x.size:
        return float("nan")
    noise = noise_of_record(x) if noise is None else noise
    beyond = np.abs(x - np.median(x[:5])) > NEAR * noise
    still = int(np.argmax(beyond)) if beyond.any() else x.size
    return float(np.mean(x[: max(1, still // 4)]))


def smooth_record(time: npt.ArrayLike, value: npt.ArrayLike, noise: float) -> Array:
    """Cubic smoothing spline through a record, at the same times.

    It minimizes ``sum (x_i - s(t_i))^2 + lambda int s''(t)^2 dt``. lambda is the largest value for
    which the root mean square of the removed part does not exceed the noise. The result does not
    depend on the sample rate and changes continuously with the record.

    Parameters
    ----------
    time
        Times [s], increasing.
    value
        The record, at least 12 samples.
    noise
        Standard deviation of its noise, in its unit, > 0.

    Raises
    ------
    InvalidParameter
        The noise is not positive, or there are too few samples.
    """
    import numpy as np

    t, x = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if not (np.isfinite(noise) and noise > 0):
        raise InvalidParameter(f"noise = {noise!r}, must be > 0")
    if t.size < LEAST_SAMPLES:
        raise InvalidParameter(
            f"smoothing: got {t.size} samples, expected at least {LEAST_SAMPLES}"
        )
    from scipy.interpolate import make_smoothing_spline

    clock = (t - t[0]) / float(np.mean(np.diff(t)))

    def spline(decades: float) -> Array:
        return np.asarray(make_smoothing_spline(clock, x, lam=10.0**decades)(clock))

    low, high = _WEAKEST, _STRONGEST
    while high - low > _CLOSE:
        middle = 0.5 * (low + high)
        taken = float(np.sqrt(np.mean((x - spline(middle)) ** 2)))
        low, high = (middle, high) if taken <= noise else (low, middle)
    return spline(low)
