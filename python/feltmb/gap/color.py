"""Estimates the color of a sensor's noise from the parts of its records at rest."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.noise import Noise
from feltmb.gap.criteria import (
    AT_REST,
    COLOR_GAIN,
    FORGOTTEN,
    LEAST_BLOCKS,
    NOISE_ERROR,
    REST_SHARE,
)

__all__ = ["averaged_noise", "color_at_rest", "still_blocks"]

#: Samples of a block, and degrees of the polynomial that represents the motion. The estimated color
#: must not depend on the degree.
BLOCK, DEGREES = 32, (2, 5)
#: Lengths of moving averages [samples] that are tried, and correlation times [samples] of
#: first-order noise that an average must be more likely than. A machine that moves a little looks
#: like first-order noise, but its spectrum has no zeros, unlike that of an average.
AVERAGES = (2, 3, 4, 5, 6)
TIMES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
#: Share of the blocks that gives the first standard deviation of an unknown noise, and how often it
#: is estimated again.
QUIETEST, PASSES = 0.25, 4


def still_blocks(values: Array, sigma: float) -> Array:
    """Blocks of samples that are a parabola plus noise, (k, BLOCK) [unit].

    Parameters
    ----------
    values
        One channel of one record, evenly sampled, (n,) [unit]; NaN is missing.
    sigma
        Standard deviation of its noise [unit].
    """
    return _still(_blocks(values), sigma)


def _blocks(values: Array) -> Array:
    """All blocks of samples without a missing value, (k, BLOCK)."""
    count = values.size // BLOCK
    blocks = values[: count * BLOCK].reshape(count, BLOCK)
    return np.asarray(blocks[np.all(np.isfinite(blocks), axis=1)])


def _still(blocks: Array, sigma: float) -> Array:
    """Blocks that are a parabola plus noise."""
    rms = _rms(blocks)
    return np.asarray(blocks[(rms > AT_REST[0] * sigma) & (rms < AT_REST[1] * sigma)])


def _rms(blocks: Array) -> Array:
    """Root mean square of each block, apart from a parabola, (k,)."""
    return np.asarray(np.sqrt(np.mean((blocks @ _contrasts(DEGREES[0])) ** 2, axis=1)))


def color_at_rest(blocks: Sequence[Array], interval: float, sheet: Noise) -> Noise:
    """Noise as a moving average of samples if blocks at rest show it, else the data sheet.

    Uses the restricted likelihood of the blocks: a polynomial for each block and one common
    variance are eliminated. An average is accepted under two conditions. For every degree of the
    polynomial it is more likely than the noise of the data sheet and than first-order noise of
    several correlation times. Its standard deviation agrees with the data sheet.

    Parameters
    ----------
    blocks
        Result of :func:`still_blocks` for all records of one sensor.
    interval
        Sample interval [s].
    sheet
        Noise according to the data sheet.
    """
    table = np.concatenate(blocks) if blocks else np.zeros((0, BLOCK))
    average = _average(table, interval, sheet)
    if average is None or not 1.0 / NOISE_ERROR < average.sigma / sheet.sigma < NOISE_ERROR:
        return sheet
    return replace(average, sigma=sheet.sigma)


def _average(table: Array, interval: float, sheet: Noise) -> Noise | None:
    """The moving average that blocks show, with its standard deviation; None: they show none."""
    if len(table) < LEAST_BLOCKS:
        return None
    averages = [replace(sheet, correlation_time=0.5 * n * interval, averaged=n) for n in AVERAGES]
    others = [sheet, *(replace(sheet, correlation_time=t * interval) for t in TIMES)]
    won, sds = [], []
    for degree in DEGREES:
        seen = table @ _contrasts(degree)
        found = {n: _likelihood(seen, _covariance(n, interval), degree) for n in averages}
        best = max(averages, key=lambda n: found[n][0])
        most = max(_likelihood(seen, _covariance(n, interval), degree)[0] for n in others)
        if found[best][0] > most + COLOR_GAIN:
            won.append(best)
            sds.append(found[best][1])
    if len(won) < len(DEGREES) or len(set(won)) > 1:
        return None
    return replace(won[0], sigma=sds[0])


def averaged_noise(records: Sequence[Array], interval: float, sheet: Noise) -> Noise | None:
    """Noise of a sensor without a data sheet, if records at rest show a moving average; else None.

    The quietest quarter of all blocks gives a first standard deviation, and the blocks that agree
    with it the final one, by restricted likelihood. Without a data sheet to compare with, motion
    must not be taken for noise. A block is at rest only if the record moves far elsewhere. Third
    differences of the blocks must be as small as those of the average, and samples farther apart
    than the average must be uncorrelated. (Samples of a vibration are not.)

    Parameters
    ----------
    records
        The channel in all records of one sensor, evenly sampled, (n,) each [unit].
    interval
        Sample interval [s].
    sheet
        Its correlation time is one of the alternatives.
    """
    blocks = np.concatenate([_blocks(values) for values in records])
    if len(blocks) < LEAST_BLOCKS:
        return None
    found = replace(sheet, sigma=float(np.quantile(_rms(blocks), QUIETEST)))
    for _ in range(PASSES):
        before = replace(sheet, sigma=found.sigma)
        average = _average(_still(blocks, found.sigma), interval, before)
        if average is None:
            return None
        found = average
    spread = max(float(np.nanstd(values)) for values in records)
    still = _still(blocks, found.sigma)
    if found.sigma > REST_SHARE * spread or not _forgets(still, found):
        return None
    differences = float(np.sqrt(np.mean(np.diff(still, 3, axis=1) ** 2)))
    weights = np.array([-1.0, 3.0, -3.0, 1.0])
    expected = found.sigma * float(
        np.sqrt(weights @ _covariance(found, interval)[:4, :4] @ weights)
    )
    return found if 1.0 / NOISE_ERROR < differences / expected < NOISE_ERROR else None


def _forgets(blocks: Array, noise: Noise) -> bool:
    """Whether samples farther apart than the average are uncorrelated, apart from a parabola."""
    contrasts = _contrasts(DEGREES[0])
    left = blocks @ contrasts @ contrasts.T
    power = float(np.mean(left**2))
    lags = range(noise.averaged + 1, BLOCK // 2)
    return all(abs(float(np.mean(left[:, k:] * left[:, :-k]))) < FORGOTTEN * power for k in lags)


@functools.cache
def _contrasts(degree: int) -> Array:
    """Orthonormal columns orthogonal to all polynomials, (BLOCK, BLOCK - degree - 1).

    A restricted likelihood depends on the samples only through these columns.
    """
    t = np.linspace(-1.0, 1.0, BLOCK)
    return np.asarray(np.linalg.svd(np.vander(t, degree + 1))[0][:, degree + 1 :])


def _covariance(noise: Noise, interval: float) -> Array:
    """Covariance of the samples of a block, relative to the variance."""
    distance = np.abs(np.arange(BLOCK)[:, None] - np.arange(BLOCK)[None, :])
    if noise.averaged > 1:
        return noise.correlation(distance)
    # Beyond these limits the samples are practically uncorrelated, or fully correlated.
    return np.asarray(np.exp(-distance / np.clip(noise.correlation_time / interval, 1e-2, 1e6)))


def _likelihood(seen: Array, cover: Array, degree: int) -> tuple[float, float]:
    """Maximum of the restricted log likelihood of blocks, and its standard deviation."""
    contrasts = _contrasts(degree)
    cover = contrasts.T @ cover @ contrasts
    variance = float(np.sum(seen.T * np.linalg.solve(cover, seen.T))) / seen.size
    log_det = float(np.linalg.slogdet(cover)[1])
    return -0.5 * (seen.size * float(np.log(variance)) + len(seen) * log_det), variance**0.5
