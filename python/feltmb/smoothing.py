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

__all__ = ["noise_of_record", "smooth_record"]

#: Fewer samples say nothing about noise.
_LEAST = 12


def noise_of_record(value: npt.ArrayLike) -> float:
    """Standard deviation of white noise on an evenly sampled record, in its unit.

    The fourth difference of a smooth motion nearly vanishes; that of white noise has 70 times the
    noise's variance (1 + 16 + 36 + 16 + 1). The median of its size keeps kinks and impacts out.
    Zero for fewer than 12 samples.
    """
    import numpy as np

    values = np.asarray(value, dtype=float)
    if values.size < _LEAST:
        return 0.0
    fourth = np.diff(values, 4)
    return float(np.median(np.abs(fourth)) / 0.6745 / np.sqrt(70.0))


def smooth_record(time: npt.ArrayLike, value: npt.ArrayLike, noise: float) -> Array:
    """Quintic smoothing spline through a record, at the same times.

    Parameters
    ----------
    time
        [s], growing.
    value
        The record, at least 12 samples.
    noise
        Standard deviation of its noise, in its unit, > 0: the spline has the fewest knots with
        which the sum of the squared deviations stays below N noise^2 (P. Dierckx, FITPACK).

    Raises
    ------
    InvalidParameter
        Noise that is not positive, or too few samples.
    """
    import warnings

    import numpy as np

    t, x = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if not (np.isfinite(noise) and noise > 0):
        raise InvalidParameter(f"noise = {noise!r}, must be > 0")
    if t.size < _LEAST:
        raise InvalidParameter(f"smoothing: got {t.size} samples, expected at least {_LEAST}")
    from scipy.interpolate import UnivariateSpline

    with warnings.catch_warnings():
        # FITPACK says when it cannot reach the sum exactly; the caller sees the deviation.
        warnings.simplefilter("ignore")
        spline = UnivariateSpline(t, x, w=np.full(t.size, 1.0 / noise), k=5, s=float(t.size))
    return np.asarray(spline(t))
