"""Noise of sampled records: its standard deviation, and smoothing within it.

Used for measured motion, whose second derivative a mechanism has to follow.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

#: Smallest number of samples for an estimate of noise.
LEAST_SAMPLES = 12
#: Two values within this number of standard deviations of the noise are equal.
REST_NOISE = 5.0
#: Order of the derivative that is white noise; length of the windows of equal intensity [s], and
#: the smallest number of samples in one.
ORDER, WINDOW, LEAST_IN_WINDOW = 3, 8e-3, 8
#: Samples of the longest average; iterations; random vectors for the diagonal of an inverse.
LONGEST_FILTER, ITERATIONS, PROBES = 100, 20, 16


def noise_of_record(value: npt.ArrayLike) -> float:
    """Standard deviation of white noise in an evenly sampled record, in its unit.

    The fourth difference of a smooth motion is almost zero, and that of white noise has 70 times
    the variance of the noise (1 + 16 + 36 + 16 + 1). The median of its absolute value is robust
    against kinks and impacts. Zero for fewer than 12 samples.
    """
    import numpy as np

    values = np.asarray(value, dtype=float)
    return 0.0 if values.size < LEAST_SAMPLES else noise_in_difference(values, 4)


def noise_in_difference(values: Array, order: int) -> float:
    """Standard deviation of white noise that a difference of this order would contain."""
    import numpy as np

    difference = np.abs(np.diff(values, order))
    return float(np.median(difference) / 0.6745 / np.sqrt(float(math.comb(2 * order, order))))


def noise_of_samples(time: npt.ArrayLike, value: npt.ArrayLike, orders: int = 4) -> float:
    """Standard deviation of white noise in samples of a motion, also in few, in their unit.

    Of fewer than 12 samples it is the largest noise that they may have: the smallest rms of their
    divided differences up to the order ``orders`` with a sum of squared coefficients of 1, of which
    there are at least two; else their spread.
    """
    import numpy as np

    t, x = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if x.size >= LEAST_SAMPLES:
        return noise_of_record(x)
    found = [float(np.std(x))] if x.size else [0.0]
    for order in range(1, min(orders, x.size - 2) + 1):
        at = np.arange(x.size - order)[:, None] + np.arange(order + 1)
        apart = t[at][:, :, None] - t[at][:, None, :] + np.eye(order + 1)
        factors = 1.0 / np.prod(apart / np.ptp(t), axis=2)
        factors /= np.linalg.norm(factors, axis=1, keepdims=True)
        found.append(float(np.sqrt(np.mean(np.sum(factors * x[at], axis=1) ** 2))))
    return min(found)


def start_of(values: npt.ArrayLike, noise: float | None = None) -> float:
    """Mean of a record while it is at rest at the beginning, in its unit; NaN if not measured.

    Only the first quarter of the samples within the noise is averaged, because a motion that starts
    slowly has hardly moved then.

    NaN is missing. ``noise``: its standard deviation; default: estimated.
    """
    import numpy as np

    x = np.asarray(values, dtype=float)
    x = x[np.isfinite(x)]
    if not x.size:
        return float("nan")
    still = still_samples(x, noise_of_record(x) if noise is None else noise)
    return float(np.mean(x[: max(1, still // 4)]))


def still_samples(values: npt.ArrayLike, noise: float) -> int:
    """Number of samples before the first one that differs from the start by more than the noise.

    NaN is missing.
    """
    import numpy as np

    x = np.asarray(values, dtype=float)
    beyond = np.abs(x - np.median(x[np.isfinite(x)][:5])) > REST_NOISE * noise
    return int(np.argmax(beyond)) if beyond.any() else x.size


def smooth_record(time: npt.ArrayLike, value: npt.ArrayLike, noise: float) -> Array:
    """A record without its noise, smoothed most where it changes least, at the same times.

    The motion is a Gaussian process: its third derivative is white noise with an intensity q(t)
    that is one number in each window. The windows have equal numbers of samples, which take 8 ms
    on average, and at least 8 samples. The result is the mean of this process given the record. It
    minimizes

        sum (x_i - s_i)^2 / noise^2 + sum (d_i^2 h_i / q(t_i)),

    where d_i is the third divided difference times 6 and h_i a third of the time that it spans.
    The intensities are those of the largest marginal likelihood (fixed-point iteration of MacKay,
    Neural Computation 4, 1992, p. 415). A motion at rest or at a constant acceleration is thus
    averaged over many samples, and a kink over few. One penalty for the whole record would leave
    several times the error in the acceleration of the quiet parts.

    The longest average is over about 100 samples, because of rounding: reduce the sample rate of
    records above 20 kHz first.

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
        The noise is not positive, there are too few samples, the time does not increase, or a
        number is not finite.
    """
    import numpy as np
    from scipy.linalg import cho_solve_banded, cholesky_banded, solve_banded

    t, x = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
    if not (np.isfinite(noise) and noise > 0):
        raise InvalidParameter(f"noise = {noise!r}, must be > 0")
    if t.size < LEAST_SAMPLES:
        raise InvalidParameter(
            f"smoothing: got {t.size} samples, expected at least {LEAST_SAMPLES}"
        )
    if x.shape != t.shape:
        raise InvalidParameter(f"smoothing: got {x.size} values at {t.size} times")
    for name, unusable in (
        ("time does not increase", ~(np.diff(t, prepend=-np.inf) > 0.0)),
        ("time or value is not finite", ~np.isfinite(t + x)),
    ):
        if unusable.any():
            raise InvalidParameter(f"smoothing: {name} at sample {int(np.argmax(unusable))}")
    if noise < np.finfo(float).eps * np.max(np.abs(x)):
        return x.copy()  # below the rounding of the values
    step = float(np.mean(np.diff(t)))
    clock, y = (t - t[0]) / step, (x - x[0]) / noise  # units: a sample, and the noise
    rows = t.size - ORDER
    at = [clock[k : rows + k] for k in range(ORDER + 1)]
    factors = [
        6.0 / np.prod([at[k] - at[j] for j in range(ORDER + 1) if j != k], axis=0)
        for k in range(ORDER + 1)
    ]
    spacing = (at[-1] - at[0]) / ORDER

    count = max(1, min(round(rows * step / WINDOW), rows // LEAST_IN_WINDOW))
    window = (np.arange(rows) * count) // rows
    least = float(min(t.size, LONGEST_FILTER)) ** (-2.0 * ORDER)
    # Where times nearly coincide, the differences are large and almost dependent: the same limit of
    # rounding, relative to their variance, which is 20 (1 + 9 + 9 + 1) for evenly spaced times.
    rounding = float(LONGEST_FILTER) ** (-2.0 * ORDER) * np.sum(np.square(factors), axis=0) / 20.0
    # Covariance of the derivative of the noise.
    noisy = np.zeros((ORDER + 1, rows))
    for lag in range(ORDER + 1):
        for k in range(lag, ORDER + 1):
            noisy[ORDER - lag, lag:] += factors[k][: rows - lag] * factors[k - lag][lag:]
    bent = sum(f * y[k : rows + k] for k, f in enumerate(factors))
    intensity = np.full(count, np.mean(bent**2 * spacing))
    random = np.random.default_rng(0).standard_normal((rows, PROBES))
    multipliers = bent
    for _ in range(ITERATIONS):
        band = noisy.copy()
        band[ORDER] += np.maximum(intensity[window] / spacing, rounding)
        upper = cholesky_banded(band)
        multipliers = cho_solve_banded((upper, False), bent)
        # The mean square of these is the diagonal of the inverse.
        expected = np.mean(solve_banded((0, ORDER), upper, random) ** 2, axis=1)
        ratio = np.bincount(window, multipliers**2, count) / np.bincount(window, expected, count)
        intensity = np.maximum(intensity * ratio, least)
    taken = np.zeros(t.size)
    for k, f in enumerate(factors):
        taken[k : rows + k] += f * multipliers
    return np.asarray(x - noise * taken)
