"""Noise of a channel: its standard deviation and its correlation between samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array, Integers, Record, Sensor

__all__ = [
    "Noise",
    "innovations",
    "noise_of",
    "rms_of_measured",
    "rounding_error",
    "sd_of_knots",
]

#: Share of the variance of averaged noise that is assumed white. The spectrum of an average has
#: zeros, and a model is not exact enough to be judged at these frequencies.
WHITE = 0.05
#: Number of previous samples that predict a sample of partly white noise.
REACH = 16
#: Samples on each side of a sample that determine its value without noise; distance in standard
#: deviations of the noise beyond which it disagrees with the measured value.
NEIGHBORS, AGREES = 4, 3.5


@dataclass(frozen=True)
class Noise:
    """Noise of one channel: exponentially correlated, averaged, or partly white.

    The standard deviation is ``sigma``, or grows with the value (:meth:`sd`). Exponentially
    correlated noise has the time constant ``correlation_time``. Averaged noise is the mean of white
    noise over ``averaged`` samples: over n samples, the correlation at a distance of k samples is
    (1 - k / n), except for a twentieth of the variance, which is assumed white.
    """

    sigma: float
    """Standard deviation [unit], if ``relative`` > 0 at the value zero."""
    correlation_time: float = 0.0
    """Time constant of the correlation [s]; 0: white. If ``averaged`` > 1, it only states above
    which frequency the spectrum is not flat."""
    averaged: int = 1
    """Number of evenly spaced samples of the average [1]."""
    white: float = 0.0
    """Share of the variance that is white; the rest has the time constant ``correlation_time``."""
    relative: float = 0.0
    """Standard deviation of a second part, relative to the value [1]. It has the color of the
    first one."""

    def sd(self, values: Array) -> Array:
        """Standard deviation at samples of a signal with these values, without noise [unit]."""
        if self.relative == 0.0:
            return np.full(np.shape(values), self.sigma)
        return np.hypot(self.sigma, self.relative * np.abs(values))

    def sd_of_measured(self, time: Array, measured: Array) -> Array:
        """Standard deviation at measured samples [unit]; NaN is missing.

        The value of a sample is that of a parabola through its neighbors. It does not depend on the
        noise of the sample itself: weights from the measured value would favor samples that are too
        small by chance, and a fit would be low by twice the square of ``relative``. Where neighbors
        and sample disagree, as beside a step, the larger value is used. With constant ``sigma``,
        the values have no influence.

        Parameters
        ----------
        time
            Times of the samples [s], (n,).
        measured
            Measured values [unit], (n,).
        """
        seen = np.flatnonzero(np.isfinite(measured))
        if self.relative == 0.0 or not seen.size:
            return np.full(np.shape(measured), self.sigma)
        own = measured[seen]
        smooth = _from_neighbors(time[seen], own)
        larger = np.maximum(np.abs(smooth), np.abs(own))
        value = np.where(np.abs(smooth - own) <= AGREES * self.sd(larger), smooth, larger)
        return self.sd(np.interp(np.arange(measured.size), seen, value))

    def scaled(self, factor: float) -> Noise:
        """The noise with a standard deviation that is larger by a factor at every value."""
        return replace(self, sigma=factor * self.sigma, relative=factor * self.relative)

    @property
    def reach(self) -> int:
        """Number of previous samples that predict a sample of this noise [1].

        For averages of up to six samples, the weight of slow signals is then correct to 7 %.
        """
        if self.averaged > 1:
            return 8 * math.ceil(self.averaged / 3)
        return REACH if self.mixed else 1

    @property
    def mixed(self) -> bool:
        """Whether the noise is partly white and partly exponentially correlated."""
        return self.averaged == 1 and self.correlation_time > 0.0 and self.white > 0.0

    def correlation(self, distance: Array, interval: float = 0.0) -> Array:
        """Correlation of two samples of averaged or mixed noise, at a distance in samples [1]."""
        if self.mixed:
            memory = np.exp(-np.abs(distance) * interval / self.correlation_time)
            return np.where(distance == 0, 1.0, (1.0 - self.white) * memory)
        share = np.maximum(0.0, 1.0 - np.abs(distance) / self.averaged)
        return np.where(distance == 0, 1.0, (1.0 - WHITE) * share)

    def without_rounding(self, step: float) -> Noise:
        """The noise before values are rounded to multiples of a step; its white part is smaller."""
        total = max(self.sigma**2 - rounding_error(step) ** 2, 0.0)
        fast = max(self.white * self.sigma**2 - rounding_error(step) ** 2, 0.0)
        return replace(self, sigma=math.sqrt(total), white=fast / total if total > 0.0 else 0.0)

    def draw(
        self, time: Array, generator: np.random.Generator, values: Array | None = None
    ) -> Array:
        """Random noise at given times [unit], stationary from the first sample.

        ``values``: those of the signal, on which noise with a ``relative`` part depends.
        """
        if self.relative > 0.0:
            assert values is not None
            plain = replace(self, sigma=1.0, relative=0.0)
            return self.sd(values) * plain.draw(time, generator)
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


def sd_of_knots(record: Record, name: str, spacing: Array | float) -> Array:
    """Standard deviation of the noise of an input at knots, between which it is linear.

    A knot represents an interval D of noise with standard deviation s and correlation time c,
    sampled with step h. Its variance is s^2 (h + 2 c) / D, at most s^2. The integral over the
    interval, to which an inertia responds, then has the correct variance.

    Parameters
    ----------
    name
        Input of the record.
    spacing
        Distance of the knots [s].
    """
    tau = record.input_correlation_time.get(name, 0.0)
    share = (record.interval + 2.0 * tau) / np.maximum(spacing, record.interval)
    return np.asarray(record.input_sigma[name] * np.sqrt(np.minimum(share, 1.0)))


def rounding_error(step: float) -> float:
    """Standard deviation of the rounding error of values that are multiples of a step."""
    return step / math.sqrt(12.0)


def noise_of(sensor: Sensor, sigma: float, quantum: float) -> Noise:
    """Noise of a sensor from its white, colored and quantization parts.

    Parameters
    ----------
    sigma
        Standard deviation of the white noise, without quantization and the stated colored noise
        [unit].
    quantum
        Step of the digitizer [unit].
    """
    fast = sigma**2 + quantum**2 / 12.0
    total = fast + sensor.colored_sigma**2
    share = fast / total if sensor.colored_sigma > 0.0 else 0.0
    return Noise(
        math.sqrt(total), sensor.correlation_time, white=share, relative=sensor.relative_sigma
    )


def rms_of_measured(sd: Array, measured: Array) -> Array:
    """Root mean square of the noise of the samples that were measured, by channel.

    ``sd``: standard deviations, (n, ...); ``measured``: values, of the same shape.
    """
    seen = np.isfinite(measured)
    seen |= ~seen.any(axis=0)  # a channel that was not measured
    return np.asarray(np.sqrt(np.mean(sd**2, axis=0, where=seen)))


def _from_neighbors(time: Array, values: Array) -> Array:
    """Value of each sample according to its neighbors, within their range.

    A parabola by least squares. With fewer neighbors than two times ``NEIGHBORS``, the values.
    """
    width = 2 * NEIGHBORS + 1
    if values.size < width:
        return values
    index = np.arange(values.size)
    window = np.clip(index - NEIGHBORS, 0, values.size - width)[:, None] + np.arange(width)
    other = window != index[:, None]
    away = time[window] - time[:, None]
    away /= np.max(np.abs(away), axis=1, keepdims=True)
    near = values[window]
    sums = [np.sum(other * away**k, axis=1) for k in range(5)]
    matrix = np.stack([np.stack(sums[k : k + 3], axis=-1) for k in range(3)], axis=-2)
    matrix += 1e-9 * np.eye(3)  # times that nearly coincide
    right = np.stack([np.sum(other * away**k * near, axis=1) for k in range(3)], axis=-1)
    found = np.linalg.solve(matrix, right[..., None])[:, 0, 0]
    low = np.min(near, axis=1, where=other, initial=np.inf)
    return np.asarray(np.clip(found, low, np.max(near, axis=1, where=other, initial=-np.inf)))


def innovations(
    noise: Sequence[Noise], position: Integers, time: Array, own_sd: Array
) -> tuple[Integers, Array, Array]:
    """Predict the noise of each sample of a segment from the previous samples.

    Parameters
    ----------
    noise
        Noise by channel.
    position
        Index of a sample in its segment, (W, L, ny); -1: not measured.
    time
        Times of the samples [s], (W, L).
    own_sd
        Standard deviation of the noise of each sample [units of the channels], (W, L, ny).

    Returns
    -------
    tuple
        Indices of the previous valid samples (-1: none); the factor of each, (W, L, ny, p); and 1 /
        standard deviation of the prediction error, 0 if not measured, (W, L, ny).
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
    if any(n.relative > 0.0 for n in noise):  # the correlation is that of noise over its sd
        for k in range(reach):
            at = np.maximum(before[..., k], 0)
            decay[..., k] *= own_sd / np.take_along_axis(own_sd, at, axis=1)
    return before, decay, np.where(valid, 1.0 / (own_sd * sd), 0.0)


def _predicted(
    noise: Noise, position: Integers, before: Integers, interval: float
) -> tuple[Array, Array]:
    """Prediction factors and relative standard deviations for averaged or mixed noise.

    Each pattern of missing samples is solved once.
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
