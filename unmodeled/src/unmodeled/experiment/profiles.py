"""Profiles of an input: smooth, within limits, with a few parameters.

All profiles except the chirp are smooth steps between levels. No step is shorter than the limits of
rate and acceleration permit, so that every profile is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unmodeled.data import Array
from unmodeled.fit.limits import InputLimits, Limits

__all__ = ["FAMILIES", "Family", "Profile", "ease"]

#: Time of a record after the last move, as a share of the longest experiment.
TAIL = 0.25
#: Number of points of a step in a file of knots.
KNOTS = 9


def ease(share: Array) -> Array:
    """Smooth step from 0 to 1: rate and acceleration are 0 at both ends (quintic).

    Its largest slope is 1.875, its largest curvature 5.7735.
    """
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s * s * s * (10.0 + s * (6.0 * s - 15.0)))


@dataclass(frozen=True, kw_only=True)
class Profile:
    """An input as a function of time."""

    family: str
    numbers: Mapping[str, float]
    """Parameters of the profile in SI units, for people."""
    start: float
    """Initial value [unit]."""
    moves: tuple[tuple[float, float, float], ...]
    wave: tuple[float, float, float, float, float] | None = None
    """Amplitude [unit], first and last frequency [Hz], start and end of the chirp [s]."""
    end: float
    """Length of the record [s]."""

    def at(self, time: Array) -> Array:
        """Values at times [s]."""
        value = np.full(time.shape, self.start)
        for begin, length, height in self.moves:
            value = value + height * ease((time - begin) / length)
        if self.wave is not None:
            amplitude, first, last, begin, stop = self.wave
            t = np.clip(time - begin, 0.0, stop - begin)
            phase = first * t + 0.5 * (last - first) / (stop - begin) * t**2
            fade = 0.1 * (stop - begin)
            window = ease(t / fade) * ease((stop - begin - t) / fade)
            value = value + amplitude * window * np.sin(2.0 * math.pi * phase)
        return np.asarray(value)

    def knots(self) -> tuple[Array, Array]:
        """Times [s] and values of knots; a monotone cubic through them follows the profile."""
        parts = [np.array([0.0, self.end])]
        parts += [np.linspace(b, b + length, KNOTS) for b, length, _ in self.moves]
        if self.wave is not None:
            _, first, last, begin, stop = self.wave
            count = max(40, math.ceil(40 * (stop - begin) * max(first, last)))
            parts.append(np.linspace(begin, stop, count))
        time = np.unique(np.round(np.minimum(np.concatenate(parts), self.end), 7))
        return time, self.at(time)


class Family(NamedTuple):
    """Profiles of one kind; ``make`` gets a number in [0, 1] for each knob."""

    knobs: tuple[str, ...]
    make: Callable[[Sequence[float], InputLimits, Limits], Profile | None]


def _between(u: float, low: float, high: float) -> float:
    """Value between low and high, uniform in the logarithm."""
    return float(low * (max(high, low) / low) ** u)


def _least(change: float, own: InputLimits, limits: Limits) -> float:
    """Shortest duration of a move [s]: from the limits, and at least two samples."""
    return max(own.shortest(change), 2.0 / limits.sample_rate)


def _steps(
    family: str,
    own: InputLimits,
    limits: Limits,
    steps: Sequence[tuple[float, float, float]],
    numbers: Mapping[str, float],
    tail: float = TAIL,
) -> Profile | None:
    """Moves to levels, each with its duration and the time at the level, not faster than permitted.

    None: they take longer than permitted. ``tail``: time after them, as a share of the longest
    experiment.
    """
    value, time, moves = own.start, limits.lead, []
    for level, length, hold in steps:
        length = max(length, _least(level - value, own, limits))
        moves.append((time, length, level - value))
        value, time = level, time + length + hold
    if time > limits.duration * (1.0 + 1e-9):
        return None
    end = min(time + tail * limits.duration, limits.duration)
    return Profile(family=family, numbers=numbers, start=own.start, moves=tuple(moves), end=end)


def _level(u: float, own: InputLimits) -> float:
    """A level for u in [0, 1], on both sides of the start if possible, else away from it."""
    up, down = own.most - own.start, own.start - own.least
    if up > 0.0 and down > 0.0:
        at = 2.0 * u - 1.0
        return own.start + (up if at >= 0.0 else down) * at
    return own.start + (up if up > 0.0 else -down) * (0.1 + 0.9 * u)


def _step(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    level = _level(u[0], own)
    rise = _between(u[1], _least(level - own.start, own, limits), 0.5 * limits.duration)
    steps = [(level, rise, TAIL * limits.duration)]
    return _steps("step", own, limits, steps, {"level": level, "rise": rise})


def _pulse(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    level = _level(u[0], own)
    rise = _between(u[1], _least(level - own.start, own, limits), 0.4 * limits.duration)
    hold = u[2] * 0.25 * limits.duration
    steps = [(level, rise, hold), (own.start, rise, 0.0)]
    return _steps("pulse", own, limits, steps, {"level": level, "rise": rise, "hold": hold})


def _repeat(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    level = _level(u[0], own)
    rise = _between(u[1], _least(level - own.start, own, limits), 0.08 * limits.duration)
    hold = 0.02 * limits.duration + u[2] * 0.13 * limits.duration
    back = own.start + (1.0 - u[3]) * 0.6 * (level - own.start)
    steps = [(at, rise, hold) for at in (level, back, level)]
    numbers = {"level": level, "rise": rise, "hold": hold, "between": back}
    return _steps("repeated pulse", own, limits, steps, numbers)


def _two_levels(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    first, second = _level(u[0], own), _level(u[1], own)
    left = limits.duration - limits.lead
    stay, more = 0.05 * left + 0.7 * u[2] * left, 0.02 * u[3] * left
    steps = [
        (first, _least(first - own.start, own, limits) + more, stay),
        (second, _least(second - first, own, limits) + more, 0.0),
    ]
    numbers = {"level": first, "hold": stay, "then": second}
    return _steps("two steps", own, limits, steps, numbers, tail=1.0)


def _chirp(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    span = own.most - own.least
    amplitude = 0.5 * span * (0.05 + 0.95 * u[0])
    mean = own.least + amplitude + u[1] * (span - 2.0 * amplitude)
    begin, stop = limits.lead, limits.duration
    moves = []
    if mean != own.start:
        length = max(own.shortest(mean - own.start), 4.0 / limits.sample_rate)
        moves.append((begin, length, mean - own.start))
        begin += length
    if stop - begin < 0.2 * limits.duration:
        return None
    slowest = 1.0 / (stop - begin)
    # Window and phase together stay within twice the largest rate of a plain sine.
    fastest = min(
        0.05 * limits.sample_rate,
        0.5 * own.rate / (2.0 * math.pi * amplitude),
        math.sqrt(0.5 * own.acceleration / amplitude) / (2.0 * math.pi),
    )
    if fastest < slowest:
        return None
    first, last = _between(u[2], slowest, fastest), _between(u[3], slowest, fastest)
    return Profile(
        family="chirp",
        numbers={"amplitude": amplitude, "mean": mean, "from": first, "to": last},
        start=own.start,
        moves=tuple(moves),
        wave=(amplitude, first, last, begin, stop),
        end=stop,
    )


#: Families of profiles by name.
FAMILIES: dict[str, Family] = {
    "step": Family(("level", "rise"), _step),
    "pulse": Family(("level", "rise", "hold"), _pulse),
    "repeated pulse": Family(("level", "rise", "hold", "return"), _repeat),
    "two steps": Family(("level", "then", "hold", "rise"), _two_levels),
    "chirp": Family(("amplitude", "mean", "from", "to"), _chirp),
}
