"""A model beside one record: simulation, difference, factor, correlation, delay."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from feltmb.data import Array, Record, StartPrior
from feltmb.fit.model import Candidate, Model
from feltmb.fit.noise import rms_of_measured
from feltmb.fit.observe import observe
from feltmb.gap.problem import Observed
from feltmb.gap.records import noise_of_channel

__all__ = ["Compared", "row_of", "simulated"]

#: Longest delay that is tried, as a share of the record; share of the squared difference that a
#: delay must take away [1].
LONGEST, MOST = 0.25, 0.5
NO_DELAY = math.nan, math.nan

#: Share of the record to which an unknown start is fitted; standard deviation, in scales of the
#: state, from which it is unknown [1].
BEGINNING, UNKNOWN = 0.2, 0.3


@dataclass(frozen=True)
class Compared:
    """One channel of one record beside the tabulated model."""

    record: str
    channel: str
    unit: str
    samples: int
    """Number of samples that the record and the model both have [1]."""
    motion: float
    """Rms of the record about its mean [unit]."""
    noise: float
    """Noise of the sensor [unit]."""
    stated: bool
    """Whether the noise is stated; else it is estimated from the record."""
    rms: float
    """Rms of record minus model [unit]."""
    factor: float
    """Record over model, about their means, by least squares [1]."""
    offset: float
    """Mean of the record less that of the model times the factor [unit]."""
    correlation: float
    """Correlation of record and model [1]."""
    delay: float
    """Delay of the record if it explains at least half of the squared difference [s]; else NaN."""
    delayed: float
    """Share of the squared difference that remains with this delay [1]; NaN without it."""

    @property
    def share(self) -> float:
        """Difference as a share of the motion [1]."""
        return self.rms / self.motion if self.motion > 0.0 else math.nan

    @property
    def in_noise(self) -> float:
        """Difference as a multiple of the noise [1]."""
        return self.rms / self.noise if self.noise > 0.0 else math.nan


def simulated(
    model: Model,
    record: Record,
    theta: Array | None = None,
    included: tuple[Candidate, ...] = (),
    magnitudes: Array | None = None,
) -> dict[str, Array]:
    """Outputs of the model at the times of a record, by name.

    A start state that is not known is the one that fits the beginning of the record best.

    Parameters
    ----------
    model
        Model of the machine.
    record
        Measured run.
    theta
        Values of the parameters; None: the tabulated ones.
    included
        Effects that act.
    magnitudes
        Their magnitudes [their units].
    """
    theta = np.array([p.value for p in model.parameters]) if theta is None else theta
    states, prior = model.states(included), record.start or StartPrior()
    start = np.array([prior.mean.get(s.name, s.start) for s in states])
    sd = [prior.sd.get(s.name, s.start_sd) if prior.known else math.inf for s in states]
    free = [i for i, s in enumerate(states) if sd[i] > UNKNOWN * s.scale]

    def run(part: Record, x: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(observe(model, part, theta, x, included, magnitudes))[: part.samples]

    measured, values = record.output_array(model.outputs), run(record, start)
    if free:
        scale = {i: states[i].scale for i in free}
        other = run(record, _fitted_start(run, record, measured, start, scale))
        # A start that hides a wrong unit does not follow the rest of the record.
        if np.isfinite(other).all() and _unlike(measured, other) <= 2.0 * _unlike(measured, values):
            values = other
    return {name: values[:, i] for i, name in enumerate(model.outputs)}


def _fitted_start(
    run: Callable[[Record, Array], Array],
    record: Record,
    measured: Array,
    start: Array,
    free: Mapping[int, float],
) -> Array:
    """Start states that fit the beginning of a record best, or the given ones.

    ``free``: scale of each state that is not known, by its index.
    """
    from scipy.optimize import least_squares

    part = Observed(record, measured, np.isfinite(measured), measured).first(BEGINNING)
    valid, scale = part.valid, np.array([*free.values()])
    if not valid.any():
        return start
    size = np.array([np.std(y[np.isfinite(y)]) or 1.0 if np.isfinite(y).any() else 1.0
                     for y in measured.T])  # fmt: skip

    def at(x: Array) -> Array:
        new = start.copy()
        new[[*free]] += scale * x
        return new

    def residual(x: Array) -> Array:
        gap = ((run(part.record, at(x)) - part.measured) / size)[valid]
        return np.asarray(np.nan_to_num(gap, nan=1e6).clip(-1e6, 1e6))

    with np.errstate(all="ignore"):
        found = least_squares(residual, np.zeros(len(free)), diff_step=1e-5, max_nfev=20)
        return at(found.x) if np.abs(residual(found.x)).max() < 1e6 else start


def _pair(x: Array, y: Array) -> tuple[Array, Array]:
    """Values about their means where both are numbers."""
    both = np.isfinite(x) & np.isfinite(y)
    x, y = x[both], y[both]
    return (x - x.mean(), y - y.mean()) if x.size > 2 else (np.zeros(0), np.zeros(0))


def _unlike(measured: Array, outputs: Array) -> float:
    """Mean over the channels of the share that no factor of the model explains [1]."""
    shares = []
    for a, b in zip(measured.T, outputs.T, strict=True):
        x, y = _pair(a, b)
        with np.errstate(all="ignore"):
            product = float(x @ x) * float(y @ y)
            shares.append(1.0 - float(x @ y) ** 2 / product if 0.0 < product < 1e300 else 1.0)
    return float(np.mean(shares))


def row_of(record: Record, name: str, model: Array) -> Compared:
    """Numbers of one channel of a record beside the outputs of the model.

    Parameters
    ----------
    record
        Measured run.
    name
        Name of the channel.
    model
        Its values in the model at the times of the record.
    """
    measured, sensor = record.outputs[name], record.sensors[name]
    noise = noise_of_channel(record, name).sd_of_measured(record.time, measured)
    sigma = float(rms_of_measured(noise, measured))
    with np.errstate(over="ignore", invalid="ignore"):
        gap = measured - model
        both = np.isfinite(gap)
        rms = float(np.sqrt(np.mean(gap[both] ** 2))) if both.any() else math.nan
        x, y = _pair(measured, model)
        xy, xx, yy = float(x @ y), float(x @ x), float(y @ y)
    moves = xx > 0.0 and math.isfinite(yy) and yy > 0.0
    factor = xy / yy if moves else math.nan
    return Compared(
        record.name,
        name,
        sensor.unit,
        int(both.sum()),
        float(np.sqrt(xx / x.size)) if x.size else 0.0,
        sigma,
        sensor.sigma is not None,
        rms,
        factor,
        float(np.mean(measured[both]) - factor * np.mean(model[both])) if moves else math.nan,
        xy / math.sqrt(xx * yy) if moves else math.nan,
        *(_delay(record.time, measured, model) if moves and rms > sigma else NO_DELAY),
    )


def _delay(time: Array, measured: Array, model: Array) -> tuple[float, float]:
    """Delay with which the model explains most [s], and the share of the difference that remains.

    NaN if the delay explains less than half of the squared difference.
    """
    both = np.isfinite(measured) & np.isfinite(model)
    count = int(min(time.size, 4096))
    if both.sum() < 8:
        return NO_DELAY
    clock = np.linspace(time[0], time[-1], count)
    x = np.interp(clock, time[both], measured[both])
    y = np.interp(clock, time[both], model[both])
    most = int(LONGEST * count)
    padded = np.concatenate([np.full(most, y[0]), y, np.full(most, y[-1])])
    # Sums of squares of all delays at once: x^2 - 2 x y + y^2, with the product by convolution.
    length = 1 << (padded.size + count).bit_length()
    spectrum = np.fft.rfft(padded, length) * np.fft.rfft(x[::-1], length)
    product = np.fft.irfft(spectrum, length)[count - 1 : padded.size]
    squares = np.concatenate([[0.0], np.cumsum(padded**2)])
    cost = float(x @ x) - 2.0 * product + squares[count:] - squares[:-count]
    best = int(np.argmin(cost))
    if best in (0, 2 * most) or not cost[best] < (1.0 - MOST) * cost[most]:
        return NO_DELAY
    a, b, c = cost[best - 1 : best + 2]
    bend = a - 2.0 * b + c
    between = 0.5 * (a - c) / bend if bend > 0.0 else 0.0
    left = (b - 0.125 * (a - c) ** 2 / bend if bend > 0.0 else b) / cost[most]
    return float((most - best - between) * (clock[1] - clock[0])), max(0.0, float(left))
