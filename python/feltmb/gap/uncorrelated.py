"""A residual that is larger than the noise and not correlated in time: noise, or a clock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feltmb.data import Array
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import NOISE_ERROR, unknown_gain
from feltmb.gap.discrepancy import Discrepancy
from feltmb.gap.proof import outputs_by_segment
from feltmb.gap.scatter import growth
from feltmb.units import readable_unit

__all__ = ["Uncorrelated", "uncorrelated"]


@dataclass(frozen=True)
class Uncorrelated:
    """A channel whose residual is not correlated in time, and what would cause it."""

    channel: str
    factor: float
    """Noise over the stated one [1]."""
    clock_sd: float = 0.0
    """Standard deviation of independent errors of the time stamps, beside this noise [s]; 0: larger
    noise is as likely."""
    relative: float = 0.0
    """Noise in proportion to the value, beside this noise [1]; 0: larger noise is as likely."""

    @property
    def text(self) -> str:
        """Sentence about the cause."""
        start = f"The residual of {self.channel} is not correlated in time"
        larger = f"its noise may be {self.factor:.2g} times the stated one"
        if self.clock_sd == self.relative == 0.0:
            return f"{start}, so that {larger}."
        factor, unit = readable_unit(self.clock_sd, "s")
        beside = f"; beside it, {larger}" if self.factor > NOISE_ERROR else ""
        if self.relative > 0.0:
            return (
                f"{start} and grows with the value: noise of {100.0 * self.relative:.2g} % of the "
                f"value would explain it{beside}."
            )
        return (
            f"{start} and grows with the speed: time stamps with independent errors of "
            f"{factor * self.clock_sd:.2g} {unit} would explain it{beside}."
        )

    @property
    def remedy(self) -> str:
        """What to do about it."""
        if self.relative > 0.0:
            return (
                f"If the sensor of {self.channel} has noise in proportion to its value, state "
                f"relative_sigma = {self.relative:.2g} beside its sigma; else find the source."
            )
        if self.clock_sd == 0.0:
            return (
                f"Find the source of the noise of {self.channel}, or state its true standard "
                "deviation (sigma)."
            )
        return (
            f"Take the times of {self.channel} from the clock of its device, or state a standard "
            "deviation (sigma) that contains their errors."
        )


def uncorrelated(
    fit: Fit, larger: Mapping[str, Discrepancy], alpha: float
) -> tuple[Uncorrelated, ...]:
    """Channels whose residual is larger than the noise and not correlated in time.

    No effect can explain such a residual. The noise is larger than stated by a factor f, it grows
    with the value, or the time stamps have errors. A reading y(t + e) with the error e of its time
    stamp differs from y(t) by e dy/dt, so that its variance is (f sigma)^2 + sd^2 (dy/dt)^2; that
    of noise in proportion to the value is (f sigma)^2 + r^2 y^2. Either is stated if it gains what
    an unknown cause must gain (:func:`~feltmb.gap.criteria.unknown_gain`). Errors of time stamps
    must also gain that much over noise in proportion to the value: a decay is as fast as it is
    large.

    Parameters
    ----------
    fit
        Fit that leaves the residual.
    larger
        Its residuals that are larger than the noise
        (:func:`~feltmb.gap.discrepancy.larger_than_noise`).
    alpha
        Rate of false alarms (``Options.alpha``) [1].
    """
    problem = fit.problem
    white = {n: d.factor for n, d in larger.items() if d.correlation_time == 0.0}
    outputs = outputs_by_segment(fit) if white else []
    found = []
    for c, name in enumerate(problem.model.outputs):
        if name not in white:
            continue
        squares, slopes, levels, own = [], [], [], []
        for segmented, joined in zip(problem.segmented_records, outputs, strict=True):
            if name in segmented.record.outputs:
                residual = segmented.record.outputs[name] - joined[:, c]
                slope = np.gradient(joined[:, c], segmented.record.time)
                seen, sd = np.isfinite(residual) & np.isfinite(slope), segmented.sd[:, c]
                squares.append((residual / sd)[seen] ** 2)
                slopes.append((slope / sd)[seen] ** 2)
                levels.append((joined[:, c] / sd)[seen] ** 2)
                own.append(segmented.noise[c].relative)
        power, slope, level = (np.concatenate(parts) for parts in (squares, slopes, levels))
        found.append(_of(name, white[name], power, slope, level, max(own), alpha))
    return tuple(found)


def _of(
    name: str,
    factor: float,
    squares: Array,
    slopes: Array,
    levels: Array,
    stated: float,
    alpha: float,
) -> Uncorrelated:
    """The cause, from squared residuals, slopes and values in units of the noise.

    ``stated``: relative noise of the sensor [1], which the factor multiplies, too.
    """
    by_slope, by_level = (
        growth(squares, shape, (1.0, factor**2)) if np.any(shape > 0.0) else (1.0, 0.0, 0.0)
        for shape in (slopes, levels)
    )
    bar = unknown_gain(alpha)
    if by_slope[2] > bar + max(by_level[2], 0.0):
        return Uncorrelated(name, math.sqrt(by_slope[0]), math.sqrt(by_slope[1]))
    relative = math.sqrt(by_level[0] * stated**2 + by_level[1])
    if by_level[2] > bar and relative <= 1.0:  # no sensor has more
        return Uncorrelated(name, math.sqrt(by_level[0]), relative=relative)
    return Uncorrelated(name, factor)
