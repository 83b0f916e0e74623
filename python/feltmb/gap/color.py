"""The color of a sensor's noise, from where its records are at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.noise import Noise

__all__ = ["color_at_rest", "quiet_blocks"]

#: Samples of a block, and the degree of the polynomial that is taken for motion.
BLOCK, DEGREE = 32, 2
#: Rest of a quiet block, in standard deviations of the noise.
QUIET = (0.4, 1.4)
#: Blocks that are needed.
LEAST = 5
#: Log likelihood by which another color must beat that of the data sheet.
SURE = 10.0
#: Correlation times [samples] and averages [samples] that are tried.
TIMES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
AVERAGES = (2, 3, 4, 5, 6, 8)


def quiet_blocks(values: Array, sigma: float) -> Array:
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
    left = blocks - blocks @ _motion() @ _motion().T
    rms = np.sqrt(np.sum(left**2, axis=1) / (BLOCK - DEGREE - 1))
    quiet = (rms > QUIET[0] * sigma) & (rms < QUIET[1] * sigma)
    return np.asarray(blocks[quiet])


def color_at_rest(blocks: Sequence[Array], interval: float, sheet: Noise) -> Noise:
    """Noise with the color of the quiet blocks, or that of the data sheet if it does as well.

    Restricted likelihood of the blocks (a parabola each and one variance are taken out) with first
    order noise of several correlation times and with means over several samples. The size of the
    noise stays that of the sheet.

    Parameters
    ----------
    blocks
        From :func:`quiet_blocks`, of all records of one sensor.
    interval
        Between samples [s].
    sheet
        What the data sheet says.
    """
    table = np.concatenate(blocks) if blocks else np.zeros((0, BLOCK))
    if len(table) < LEAST:
        return sheet
    others = [
        *(replace(sheet, correlation_time=t * interval, averaged=1) for t in TIMES),
        *(replace(sheet, correlation_time=0.5 * n * interval, averaged=n) for n in AVERAGES),
    ]
    found = max(others, key=lambda noise: _likelihood(table, interval, noise))
    gain = _likelihood(table, interval, found) - _likelihood(table, interval, sheet)
    return found if gain > SURE else sheet


def _motion() -> Array:
    """Orthonormal columns that span what is taken for motion, (BLOCK, DEGREE + 1)."""
    t = np.linspace(-1.0, 1.0, BLOCK)
    return np.linalg.qr(np.vander(t, DEGREE + 1))[0]


def _likelihood(table: Array, interval: float, noise: Noise) -> float:
    """Restricted log likelihood of blocks, their common variance at its best value."""
    distance = np.abs(np.arange(BLOCK)[:, None] - np.arange(BLOCK)[None, :])
    if noise.averaged > 1:
        cover = noise.correlation(distance)
    elif noise.correlation_time > 0.0:
        cover = np.exp(-distance * interval / noise.correlation_time)
    else:
        cover = np.eye(BLOCK)
    # Contrasts that no motion touches: their covariance is all that a restricted likelihood sees.
    contrasts = np.linalg.svd(_motion(), full_matrices=True)[0][:, DEGREE + 1 :]
    cover = contrasts.T @ cover @ contrasts
    seen = table @ contrasts
    squares = float(np.sum(seen.T * np.linalg.solve(cover, seen.T)))
    log_det = float(np.linalg.slogdet(cover)[1])
    return float(-0.5 * (seen.size * np.log(squares / seen.size) + len(table) * log_det))
