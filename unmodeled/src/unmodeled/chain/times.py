"""Errors of the time of a sensor or an input: clock, delay, lag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from unmodeled.chain import Array, Fault, Run, Signal, register
from unmodeled.chain.splines import Spline

#: Shapes of a late input: what acted before the record.
BEFORE = ("constant", "zero")
#: Fields of an effect with these shapes.
LATE = {"shapes": BEFORE, "shape_names": ("input before the record",), "step": 0.5}
#: Step of a derivative along the imaginary axis.
IMAGINARY = 1e-30j


def _starts_from_zero(run: Run, before: Any) -> bool:
    """Whether the input was zero before the record; one that starts during a motion was not."""
    return before == "zero" and (run.start is None or run.start.known)


def _with_sample_before(run: Run, y: Array, before: Any) -> tuple[Array, Array]:
    """Times and values with one sample before the first one."""
    first = np.zeros_like(y[:, :1]) if _starts_from_zero(run, before) else y[:, :1]
    earlier = [2.0 * run.time[0] - run.time[1]]
    return np.concatenate([earlier, run.time]), np.concatenate([first, y], axis=1)


@dataclass(frozen=True)
class Delay(Fault):
    """reading(t) = y(t - size), by cubic splines.

    What a late sensor shows of the time before a record, the model does not know: the signal went
    on as it begins, or it was constant, whichever is nearer to the readings. A delay is removed by
    linear interpolation, because an input may jump; with the shape "smooth" by splines. If an input
    acts later, a record does not contain what acts at its begin: with the shape "zero", the machine
    was at rest.
    """

    channel: str = ""
    """Channel of a record whose readings count before its begin."""
    name, unit, place, common, always = "delay", "s", 2.0, True, True
    sensor = ("The sensor is late.", "Synchronize the clocks.")
    input = (
        "The input acts later or earlier than recorded: the clocks differ, or the drive is slow "
        "to act.",
        "Synchronize the clocks, or model the delay of the drive.",
    )
    each = "delay", "Synchronize the clocks in each record."

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        parts = [at_times(run.time, v[None], self._moments(run, v[None], size)) for v in y]
        return np.concatenate(parts) if parts else y

    def by_size(self, run: Run, y: Array, size: float, shape: Any = None) -> Array:
        moments = self._moments(run, y, size)
        rates = at_times(run.time, y, moments, rate=True)
        return np.where(moments > run.time - size, 0.0, -rates)

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        return at_times(run.time, change, self._moments(run, y, size))

    def _moments(self, run: Run, y: Array, size: Any) -> Array:
        """Times whose values a signal (1, n) shows: before the record also its begin, (n,)."""
        moments = run.time - size
        readings = run.outputs.get(self.channel, np.zeros(0)) if self.channel else np.zeros(0)
        before = (moments < run.time[0])[: readings.size]
        before &= np.isfinite(readings[: before.size])
        if not before.any():
            return np.asarray(moments)
        at = np.flatnonzero(before)
        moving = at_times(run.time, y, moments)[0, at] - readings[at]
        steady = y[0, 0] - readings[at]
        rests = float(steady @ steady) < float(moving @ moving)
        return np.maximum(moments, run.time[0]) if rests else np.asarray(moments)

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        time, values = run.time, reading
        if shape in BEFORE:
            time, values = _with_sample_before(run, reading, shape)
        moments = np.clip(run.time + size, time[0], time[-1])
        if shape == "smooth":
            return at_times(time, values, moments)
        return np.array([np.interp(moments, time, row) for row in values])

    def fields(self, signal: Signal) -> dict[str, Any]:
        return {"scale": signal.interval, **(LATE if signal.is_input else {})}

    def of(self, signal: Signal) -> Delay:
        return self if signal.is_input else self.at(signal.name)

    def at(self, channel: str) -> Delay:
        return Delay(channel)


class Clock(Fault):
    """reading(t) = y(t + size t), with the time counted from the first sample.

    No clock is off by more than a tenth: a larger size is one.
    """

    name, place, common = "clock", 0.0, True
    each = "clock", "Compare the clocks of the records with another one over a long time."
    most = 0.1

    def _moments(self, run: Run, y: Array, size: float) -> tuple[Array, Array]:
        time = run.time[: y.shape[1]]
        return time, time + np.clip(size, -self.most, self.most) * (time - time[0])

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        time, moments = self._moments(run, y, size)
        return at_times(time, y, moments)

    def by_size(self, run: Run, y: Array, size: float, shape: Any = None) -> Array:
        time, moments = self._moments(run, y, size)
        if abs(size) > self.most:
            return 0.0 * y
        return np.asarray((time - time[0]) * at_times(time, y, moments, rate=True))

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return self.act(run, reading, -size / (1.0 + size))


@dataclass(frozen=True)
class Lag(Fault):
    """size d(reading)/dt = y - reading: a first-order low-pass with a time constant.

    The reading begins as if the signal always had its first slope. As an effect, it begins at
    rest, with the first value; in a record with an unknown start with its own first reading, which
    is estimated from a line through the first readings. An input of a drive that lags begins with
    its first value, or ("zero") with nothing.
    """

    channel: str = ""
    """Channel of a record whose first reading counts."""
    name, unit, place, drive = "lag", "s", 1.0, True
    sensor = (
        "The sensor follows slowly, as a thermometer or a filtered signal does.",
        "Use a faster sensor, or state its bandwidth.",
    )
    input = (
        "The drive follows its input slowly.",
        "Measure what acts on the machine, or model the drive.",
    )

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        if np.real(size) <= 0.0:
            return y
        if shape in BEFORE:
            time, values = _with_sample_before(run, y, shape)
            return low_passed(time, values, size, values[:, 0])[:, 1:]
        return low_passed(run.time, y, size, self._first(run, y, size))

    def _first(self, run: Run, y: Array, size: Any) -> Any:
        """First values of the filters; None: the first slope lasted."""
        if not self.channel:
            return None
        if run.start is None or run.start.known or y.shape[1] < 2:
            return y[:, 0]
        reading = run.outputs.get(self.channel, np.zeros(0))
        step = max(float(run.time[1] - run.time[0]), 1e-300)
        # Without a jump at zero: the share of a first value after a sample.
        steady = y[:, 0] - size * (y[:, 1] - y[:, 0]) / step
        return steady + np.exp(-step / size) * (_first_reading(run, reading, size) - steady)

    def by_size(self, run: Run, y: Array, size: float, shape: Any = None) -> Array:
        least = 1e-6 * float(np.median(np.diff(run.time)))
        own = self.act(run, y, max(size, least) + IMAGINARY, shape)
        return np.asarray(np.imag(own) / IMAGINARY.imag)

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return reading + size * np.gradient(reading, run.time, axis=1)

    def noise(self, run: Run, size: float) -> float:
        interval = float(np.median(np.diff(run.time)))
        return float(np.hypot(1.0, size / (np.sqrt(2.0) * interval)))

    def fields(self, signal: Signal) -> dict[str, Any]:
        return {"scale": 3.0 * signal.interval, "sign": 1, **(LATE if signal.is_input else {})}

    def of(self, signal: Signal) -> Lag:
        return Lag(signal.name)


def _first_reading(run: Run, reading: Array, constant: Any) -> float:
    """Reading at the first sample, by a line over a quarter of a time constant; NaN: none."""
    near = (run.time - run.time[0] <= 0.25 * np.real(constant))[: reading.size]
    near[:1] = True
    near &= np.isfinite(reading)
    if near.sum() < 3:
        return float(reading[0]) if reading.size else float("nan")
    time = run.time[near] - run.time[0]
    return float(np.polynomial.Polynomial.fit(time, reading[near], 1)(0.0))


def at_times(time: Array, y: Array, want: Array, rate: bool = False) -> Array:
    """Values of signals (b, n) at other times (m,), or their rates, by cubic splines.

    Before the first and after the last sample, a signal is extrapolated by a parabola for one
    sample and linearly beyond. Signals with values that are not finite are unchanged.
    """
    out: Array = np.array(y, dtype=np.float64)
    good = np.isfinite(out).all(axis=1)
    if time.size < 2 or not good.any():
        return out if out.shape[1] == want.size else np.repeat(out[:, :1], want.size, axis=1)
    spline = Spline(time, out[good])
    inside = np.clip(want, time[0], time[-1])
    over = want - inside
    bent = np.clip(over, time[0] - time[1], time[-1] - time[-2])
    found, far = spline(inside, int(rate)), np.flatnonzero(over)
    bend = spline(inside[far], 2)
    if rate:
        found[:, far] += bend * bent[far]
    else:
        slope = spline(inside[far], 1)
        found[:, far] += slope * over[far] + bend * (bent * over - 0.5 * bent**2)[far]
    if out.shape[1] != want.size:
        out = np.full((len(out), want.size), np.nan)
    out[good] = found
    return out


def low_passed(time: Array, y: Array, constant: Any, first: Any = None) -> Array:
    """Signals (b, n) after a first-order lag: constant * d(out)/dt = y - out.

    Parameters
    ----------
    time
        Times of the samples [s], (n,).
    y
        Signals, linear between samples, (b, n).
    constant
        Time constant [s], > 0.
    first
        First values of the filters [unit of y], (b,). None, and NaN: as if the signal always had
        its first slope.
    """
    if y.shape[1] < 2:
        return y
    from scipy.linalg import solve_banded  # starts ten times as fast as scipy.signal

    step = np.maximum(np.diff(time), 0.0)
    if np.allclose(step, np.median(step), rtol=1e-6, atol=0.0):  # whatever the rounding of a clock
        step[:] = step[0]
    slow = y[:, 0] - constant * (y[:, 1] - y[:, 0]) / max(step[0], 1e-300)
    first = slow if first is None else np.where(np.isfinite(first), first, slow)
    steps = step / constant
    loss = -np.expm1(-steps)
    new = 1.0 - np.divide(loss, steps, out=np.ones_like(steps), where=np.real(steps) > 0.0)
    # out[j] - (1 - loss) * out[j - 1] = new * y[j] + (loss - new) * y[j - 1]
    right = np.concatenate([first[:, None], new * y[:, 1:] + (loss - new) * y[:, :-1]], axis=1)
    bands = np.ones((2, y.shape[1]), dtype=loss.dtype)
    bands[1, :-1] = loss - 1.0
    return np.asarray(solve_banded((1, 0), bands, right.T, check_finite=False).T)


for _fault in (Delay(), Lag(), Clock()):
    register(_fault)
