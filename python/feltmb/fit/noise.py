"""Noise of a channel: how large it is, and what one sample of it says of the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Sensor

__all__ = ["Noise", "innovations", "noise_of"]

Integers = NDArray[np.intp]
#: Share of its variance that is taken for white: a mean over samples is blind at some frequencies,
#: and a model is not so exact that what it misses there could be held against it.
WHITE = 0.05
#: Samples before that predict one of noise that is in part white, in part not.
REACH = 16


@dataclass(frozen=True)
class Noise:
    """Noise of one channel, of one of two colors, or white in part.

    Either it forgets itself exponentially, with ``correlation_time``, or it is what is left of
    white noise by a mean over ``averaged`` samples: over n of them the correlation at a distance
    of k samples is (1 - k / n), but for a twentieth of the variance, which is taken for white.
    """

    sigma: float
    """Standard deviation [unit]."""
    correlation_time: float = 0.0
    """Time in which it forgets itself [s]; 0 is white. Where ``averaged`` > 1 it only says beyond
    which frequency the noise is not flat."""
    averaged: int = 1
    """Samples, evenly spaced, whose mean a sample is [1]."""
    white: float = 0.0
    """Share of the variance that is white, beside what forgets itself in ``correlation_time``."""

    @property
    def reach(self) -> int:
        """Samples before that predict one of averaged noise [1].

        Up to an average of six, slow signals then weigh what they should, to 7 %.
        """
        if self.averaged > 1:
            return 8 * math.ceil(self.averaged / 3)
        return REACH if self.mixed else 1

    @property
    def mixed(self) -> bool:
        """Whether a part of it is white and the rest is not."""
        return self.averaged == 1 and self.correlation_time > 0.0 and self.white > 0.0

    def correlation(self, distance: Array, interval: float = 0.0) -> Array:
        """Correlation of two samples of averaged or mixed noise, at a distance in samples [1]."""
        if self.mixed:
            memory = np.exp(-np.abs(distance) * interval / self.correlation_time)
            return np.where(distance == 0, 1.0, (1.0 - self.white) * memory)
        share = np.maximum(0.0, 1.0 - np.abs(distance) / self.averaged)
        return np.where(distance == 0, 1.0, (1.0 - WHITE) * share)

    def draw(self, time: Array, generator: np.random.Generator) -> Array:
        """Noise at given times [unit], stationary from the first sample on."""
        n = time.size
        if self.averaged > 1:
            white = generator.standard_normal(n + self.averaged - 1)
            mean: Array = np.convolve(white, np.ones(self.averaged), "valid")
            return self.sigma / math.sqrt(self.averaged) * mean
        if self.mixed:
            slow = replace(self, sigma=self.sigma * math.sqrt(1.0 - self.white), white=0.0)
            fast = self.sigma * math.sqrt(self.white) * generator.standard_normal(n)
            return np.asarray(slow.draw(time, generator) + fast)
        out = self.sigma * generator.standard_normal(n)
        if self.correlation_time > 0.0 and n > 1:
            before = self.sigma * generator.standard_normal()
            keep = np.exp(-np.diff(time, prepend=2.0 * time[0] - time[1]) / self.correlation_time)
            fresh = np.sqrt(1.0 - keep**2)
            for i in range(n):
                before = out[i] = keep[i] * before + fresh[i] * out[i]
        return out


def noise_of(sensor: Sensor, sigma: float, quantum: float) -> Noise:
    """Noise of a sensor: white, colored and quantum, each by its number.

    Parameters
    ----------
    sigma
        Standard deviation of what is no quantum and not told as colored [unit].
    quantum
        Step of the digitizer [unit].
    """
    fast = sigma**2 + quantum**2 / 12.0
    total = fast + sensor.colored_sigma**2
    share = fast / total if sensor.colored_sigma > 0.0 else 0.0
    return Noise(math.sqrt(total), sensor.correlation_time, white=share)


def innovations(
    noise: Sequence[Noise], position: Integers, time: Array
) -> tuple[Integers, Array, Array]:
    """What the samples before predict of the noise of each sample of a segment.

    Parameters
    ----------
    noise
        By channel.
    position
        (W, L, ny), the index of a sample in its segment; -1 where nothing was measured.
    time
        Clock [s], (W, L).

    Returns
    -------
    tuple
        Positions of the valid samples before (-1: none), the factor of each (W, L, ny, p), and
        1 / standard deviation of what they cannot predict, 0 where nothing was measured
        (W, L, ny).
    """
    valid = position >= 0
    reach = max((n.reach for n in noise), default=1)
    nearest = np.full_like(position, -1)
    nearest[:, 1:] = np.maximum.accumulate(position, axis=1)[:, :-1]
    before = np.full((*position.shape, reach), -1, dtype=np.intp)
    before[..., 0] = nearest
    for k in range(1, reach):
        last = before[..., k - 1]
        further = np.take_along_axis(nearest, np.maximum(last, 0), axis=1)
        before[..., k] = np.where(last >= 0, further, -1)
    decay = np.zeros(before.shape)
    interval = float(np.median(np.diff(time, axis=1))) if time.shape[1] > 1 else 0.0
    sd = np.ones(position.shape)
    for c, own in enumerate(noise):
        if own.averaged > 1 or own.mixed:
            near = before[:, :, c, : own.reach]
            decay[:, :, c, : own.reach], sd[:, :, c] = _predicted(
                own, position[:, :, c], near, interval
            )
        elif own.correlation_time > 0.0:
            seen = before[:, :, c, 0]
            lag = time - np.take_along_axis(time, np.maximum(seen, 0), axis=1)
            memory = np.where(
                (seen >= 0) & valid[:, :, c], np.exp(-lag / own.correlation_time), 0.0
            )
            decay[:, :, c, 0] = memory
            sd[:, :, c] = np.sqrt(1.0 - memory**2)
    sigma = np.array([n.sigma for n in noise])
    return before, decay, np.where(valid, 1.0 / (sigma * sd), 0.0)


def _predicted(
    noise: Noise, position: Integers, before: Integers, interval: float
) -> tuple[Array, Array]:
    """Factors and relative standard deviations of averaged or mixed noise.

    Each pattern of holes is solved once.
    """
    distance = np.where((before >= 0) & (position >= 0)[..., None], position[..., None] - before, 0)
    patterns, which = np.unique(distance.reshape(-1, before.shape[-1]), axis=0, return_inverse=True)
    factors, sd = np.zeros(patterns.shape), np.ones(len(patterns))
    for i, pattern in enumerate(patterns):
        back = pattern[pattern > 0].astype(float)
        if not back.size:
            continue
        common = noise.correlation(back, interval)
        among = noise.correlation(back[:, None] - back[None, :], interval)
        found = np.linalg.solve(among, common)
        factors[i, : back.size] = found
        sd[i] = np.sqrt(1.0 - common @ found)
    which = which.reshape(-1)
    return factors[which].reshape(before.shape), sd[which].reshape(position.shape)
