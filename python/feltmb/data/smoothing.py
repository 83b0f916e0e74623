"""Noise of sampled records: how large it is, and a smooth curve within it.

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

#: Fewer samples say nothing about noise.
LEAST_SAMPLES = 12
#: Standard deviations of the noise within which a value is where another one is.
NEAR = 5.0
#: Decades of the penalty that are searched, on a clock of samples, and how closely.
_WEAKEST, _STRONGEST, _CLOSE = -6.0, 12.0, 0.02


def noise_of_record(value: npt.ArrayLike) -> float:
    """Standard deviation of white noise on an evenly sampled record, in its unit.

    The fourth difference of a smooth motion nearly vanishes; that of white noise has 70 times the
    noise's variance (1 + 16 + 36 + 16 + 1). The median of its size keeps kinks and impacts out.
    Zero for fewer than 12 samples.
    """
    import numpy as np

    values = np.asarray(value, dtype=float)
    if values.size < LEAST_SAMPLES:
        return 0.0
    fourth = np.diff(values, 4)
    return float(np.median(np.abs(fourth)) / 0.6745 / np.sqrt(70.0))


def start_of(values: npt.ArrayLike, noise: float | None = None) -> float:
    """Mean of the still beginning of a record, in its unit; NaN if nothing was measured.

    Only the first quarter of what lies within the noise is averaged: a motion that begins slowly
    has hardly moved there.

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

    It minimizes ``sum (x_i - s(t_i))^2 + lambda int s''(t)^2 dt`` with the largest lambda for which
    what it takes away is no more than the noise in root mean square: smoothing ends where the noise
    does, whatever the rate of the samples is, and changes continuously with the record.

    Parameters
    ----------
    time
        [s], growing.
    value
        The record, at least 12 samples.
    noise
        Standard deviation of its noise, in its unit, > 0.

    Raises
    ------
    InvalidParameter
        Noise that is not positive, or too few samples.
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
