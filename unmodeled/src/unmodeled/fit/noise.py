"""Noise of a channel: its standard deviation at each sample."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from unmodeled.data import Array, Record, Sensor

#: Samples on each side of a sample that determine its value without noise; distance in standard
#: deviations of the noise beyond which it disagrees with the measured value.
NEIGHBORS, AGREES = 4, 3.5


@dataclass(frozen=True)
class Noise:
    """Noise of one channel, white, exponentially correlated, or a sum of both.

    The standard deviation is ``sigma``, or grows with the value (:meth:`sd`).
    """

    sigma: float
    """Standard deviation [unit], if ``relative`` > 0 at the value zero."""
    correlation_time: float = 0.0
    """Time constant of the correlation [s]; 0: white."""
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
        """
        seen = np.flatnonzero(np.isfinite(measured))
        if self.relative == 0.0 or not seen.size:
            return np.full(np.shape(measured), self.sigma)
        own = measured[seen]
        smooth = _from_neighbors(time[seen], own)
        larger = np.maximum(np.abs(smooth), np.abs(own))
        value = np.where(np.abs(smooth - own) <= AGREES * self.sd(larger), smooth, larger)
        return self.sd(np.interp(np.arange(measured.size), seen, value))

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
        if self.correlation_time > 0.0 and self.white > 0.0:
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

    ``spacing``: distance of the knots [s].
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
    fast = sigma**2 + rounding_error(quantum) ** 2
    total = fast + sensor.colored_sigma**2
    share = fast / total if sensor.colored_sigma > 0.0 else 0.0
    return Noise(math.sqrt(total), sensor.correlation_time, share, sensor.relative_sigma)


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
