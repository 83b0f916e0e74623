"""Profiles of an input: smooth, within limits, with a few parameters.

All profiles except the chirp are smooth steps between levels. No step is shorter than the limits of
rate and acceleration permit, so that every profile is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feltmb.data import Array
from feltmb.fit.limits import InputLimits, Limits

__all__ = ["FAMILIES", "Family", "Profile", "ease"]

#: Moves of a profile: begin [s], length [s], height [unit].
Moves = list[tuple[float, float, float]]
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


@dataclass(frozen=True)
class Family:
    """Profiles of one kind; ``make`` gets a number in [0, 1] for each parameter."""

    name: str
    knobs: tuple[str, ...]
    make: Callable[[Sequence[float], InputLimits, Limits], Profile | None]


def _between(u: float, low: float, high: float) -> float:
    """Value between low and high, uniform in the logarithm."""
    return float(low * (max(high, low) / low) ** u)


class _Path:
    """A sequence of levels."""

    def __init__(self, own: InputLimits, limits: Limits):
        self.own, self.limits = own, limits
        self.value, self.time = own.start, limits.lead
        self.moves: Moves = []

    def least(self, level: float) -> float:
        """Shortest duration of a move to a level [s]: from the limits, and at least two samples."""
        step = 2.0 / self.limits.sample_rate
        return max(self.own.shortest(level - self.value), step)

    def go(self, level: float, length: float) -> None:
        """Move to a level, not faster than permitted."""
        length = max(length, self.least(level))
        self.moves.append((self.time, length, level - self.value))
        self.time += length
        self.value = level

    def wait(self, length: float) -> None:
        """Stay at the level."""
        self.time += length

    def profile(
        self, family: str, numbers: Mapping[str, float], *, tail: float | None = None
    ) -> Profile | None:
        """The completed profile; None if it takes longer than permitted."""
        longest = self.limits.duration
        if self.time > longest * (1.0 + 1e-9):
            return None
        end = longest if tail is None else min(self.time + tail, longest)
        return Profile(
            family=family,
            numbers=numbers,
            start=self.own.start,
            moves=tuple(self.moves),
            end=end,
        )


def _level(u: float, own: InputLimits) -> float:
    """A level for u in [0, 1], on both sides of the start if possible, else away from it."""
    up, down = own.most - own.start, own.start - own.least
    if up > 0.0 and down > 0.0:
        at = 2.0 * u - 1.0
        return own.start + (up if at >= 0.0 else down) * at
    return own.start + (up if up > 0.0 else -down) * (0.1 + 0.9 * u)


def _step(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    path = _Path(own, limits)
    level = _level(u[0], own)
    rise = _between(u[1], path.least(level), 0.5 * limits.duration)
    path.go(level, rise)
    path.wait(TAIL * limits.duration)
    return path.profile("step", {"level": level, "rise": rise}, tail=0.25 * limits.duration)


def _pulse(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    path = _Path(own, limits)
    level = _level(u[0], own)
    least = path.least(level)
    rise = _between(u[1], least, 0.4 * limits.duration)
    hold = u[2] * 0.25 * limits.duration
    path.go(level, rise)
    path.wait(hold)
    path.go(own.start, rise)
    return path.profile(
        "pulse", {"level": level, "rise": rise, "hold": hold}, tail=TAIL * limits.duration
    )


def _repeat(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    path = _Path(own, limits)
    level = _level(u[0], own)
    rise = _between(u[1], path.least(level), 0.08 * limits.duration)
    hold = 0.02 * limits.duration + u[2] * 0.13 * limits.duration
    back = own.start + (1.0 - u[3]) * 0.6 * (level - own.start)
    path.go(level, rise)
    path.wait(hold)
    path.go(back, rise)
    path.wait(hold)
    path.go(level, rise)
    path.wait(hold)
    numbers = {"level": level, "rise": rise, "hold": hold, "between": back}
    return path.profile("repeated pulse", numbers, tail=TAIL * limits.duration)


def _two_levels(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    path = _Path(own, limits)
    first, second = _level(u[0], own), _level(u[1], own)
    left = limits.duration - limits.lead
    stay = 0.05 * left + 0.7 * u[2] * left
    path.go(first, path.least(first) + 0.02 * u[3] * left)
    path.wait(stay)
    path.go(second, path.least(second) + 0.02 * u[3] * left)
    numbers = {"level": first, "hold": stay, "then": second}
    return path.profile("two steps", numbers)


def _chirp(u: Sequence[float], own: InputLimits, limits: Limits) -> Profile | None:
    span = own.most - own.least
    amplitude = 0.5 * span * (0.05 + 0.95 * u[0])
    mean = own.least + amplitude + u[1] * (span - 2.0 * amplitude)
    begin, stop = limits.lead, limits.duration
    moves: Moves = []
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
    f.name: f
    for f in (
        Family("step", ("level", "rise"), _step),
        Family("pulse", ("level", "rise", "hold"), _pulse),
        Family("repeated pulse", ("level", "rise", "hold", "return"), _repeat),
        Family("two steps", ("level", "then", "hold", "rise"), _two_levels),
        Family("chirp", ("amplitude", "mean", "from", "to"), _chirp),
    )
}
