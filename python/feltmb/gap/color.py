"""The color of a sensor's noise, from where its records are at rest."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.noise import Noise
from feltmb.gap.criteria import AT_REST, COLOR_GAIN, LEAST_BLOCKS, SAME_SPREAD

__all__ = ["color_at_rest", "still_blocks"]

#: Samples of a block, and degrees of the polynomial that is taken for motion: the color must not
#: depend on it.
BLOCK, DEGREES = 32, (2, 5)
#: Averages [samples] that are tried, and the correlation times [samples] that they must beat: a
#: machine that moves a little looks like noise that forgets itself, but is not blind at the
#: frequencies where an average is.
AVERAGES = (2, 3, 4, 5, 6)
TIMES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)


def still_blocks(values: Array, sigma: float) -> Array:
    """Blocks of samples that a parabola explains but for noise, (k, BLOCK) [unit].

    Parameters
    ----------
    values
        One channel of one record, evenly sampled, (n,) [unit]; NaN is missing.
    sigma
        Standard deviation of its noise [unit].
    """
    count = values.size // BLOCK
    blocks = values[: count * BLOCK].reshape(count, BLOCK)
    blocks = blocks[np.all(np.isfinite(blocks), axis=1)]
    left = blocks @ _contrasts(DEGREES[0])
    rms = np.sqrt(np.mean(left**2, axis=1))
    low_noise = (rms > AT_REST[0] * sigma) & (rms < AT_REST[1] * sigma)
    return np.asarray(blocks[low_noise])


def color_at_rest(blocks: Sequence[Array], interval: float, sheet: Noise) -> Noise:
    """Noise as the mean over several samples that blocks at rest show, or that of the data sheet.

    Restricted likelihood of the blocks (a polynomial each and one variance are taken out). An
    average is accepted under two conditions. It is more likely than the noise of the data sheet and
    than first-order noise of several correlation times, for every degree of the polynomial. It has
    the standard deviation of the data sheet.

    Parameters
    ----------
    blocks
        From :func:`still_blocks`, of all records of one sensor.
    interval
        Between samples [s].
    sheet
        What the data sheet says.
    """
    table = np.concatenate(blocks) if blocks else np.zeros((0, BLOCK))
    if len(table) < LEAST_BLOCKS:
        return sheet
    averages = [replace(sheet, correlation_time=0.5 * n * interval, averaged=n) for n in AVERAGES]
    others = [sheet, *(replace(sheet, correlation_time=t * interval) for t in TIMES)]
    won = []
    for degree in DEGREES:
        seen = table @ _contrasts(degree)
        found = {n: _likelihood(seen, _covariance(n, interval), degree) for n in averages}
        best = max(averages, key=lambda n: found[n][0])
        most = max(_likelihood(seen, _covariance(n, interval), degree)[0] for n in others)
        value, sd = found[best]
        if value > most + COLOR_GAIN and sheet.sigma / SAME_SPREAD < sd < sheet.sigma * SAME_SPREAD:
            won.append(best)
    return won[0] if len(won) == len(DEGREES) and len(set(won)) == 1 else sheet


@functools.cache
def _contrasts(degree: int) -> Array:
    """Orthonormal columns that no polynomial touches, (BLOCK, BLOCK - degree - 1).

    Their covariance is all that a restricted likelihood sees.
    """
    t = np.linspace(-1.0, 1.0, BLOCK)
    return np.asarray(np.linalg.svd(np.vander(t, degree + 1))[0][:, degree + 1 :])


def _covariance(noise: Noise, interval: float) -> Array:
    """Covariance of the samples of a block, in units of the variance."""
    distance = np.abs(np.arange(BLOCK)[:, None] - np.arange(BLOCK)[None, :])
    if noise.averaged > 1:
        return noise.correlation(distance)
    # Beyond these samples are as good as uncorrelated, or move as one.
    return np.asarray(np.exp(-distance / np.clip(noise.correlation_time / interval, 1e-2, 1e6)))


def _likelihood(seen: Array, cover: Array, degree: int) -> tuple[float, float]:
    """Restricted log likelihood of blocks, and the standard deviation at which it is largest."""
    contrasts = _contrasts(degree)
    cover = contrasts.T @ cover @ contrasts
    variance = float(np.sum(seen.T * np.linalg.solve(cover, seen.T))) / seen.size
    log_det = float(np.linalg.slogdet(cover)[1])
    return -0.5 * (seen.size * float(np.log(variance)) + len(seen) * log_det), variance**0.5
