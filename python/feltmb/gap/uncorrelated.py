"""A residual that is larger than the noise and not correlated in time: noise, or a clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from feltmb.data import Array
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import NOISE_ERROR, unknown_gain
from feltmb.gap.discrepancy import Discrepancy
from feltmb.gap.proof import outputs_by_segment
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

    @property
    def text(self) -> str:
        """Sentence about the cause."""
        start = f"The residual of {self.channel} is not correlated in time"
        larger = f"its noise may be {self.factor:.2g} times the stated one"
        if self.clock_sd == 0.0:
            return f"{start}, so that {larger}."
        factor, unit = readable_unit(self.clock_sd, "s")
        beside = f"; beside it, {larger}" if self.factor > NOISE_ERROR else ""
        return (
            f"{start} and grows with the speed: time stamps with independent errors of "
            f"{factor * self.clock_sd:.2g} {unit} would explain it{beside}."
        )

    @property
    def remedy(self) -> str:
        """What to do about it."""
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

    No effect can explain such a residual. The noise is larger than stated by a factor f, or the
    time stamps have errors. A reading y(t + e) with the error e of its time stamp differs from y(t)
    by e dy/dt, so that its variance is (f sigma)^2 + sd^2 (dy/dt)^2. Errors of time stamps are
    stated if they gain what an unknown cause must gain
    (:func:`~feltmb.gap.criteria.unknown_gain`).

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
        squares, slopes = [], []
        for segmented, joined in zip(problem.segmented_records, outputs, strict=True):
            if name in segmented.record.outputs:
                residual = segmented.record.outputs[name] - joined[:, c]
                slope = np.gradient(joined[:, c], segmented.record.time)
                seen = np.isfinite(residual) & np.isfinite(slope)
                squares.append((residual[seen] / segmented.noise[c].sigma) ** 2)
                slopes.append((slope[seen] / segmented.noise[c].sigma) ** 2)
        found.append(_of(name, white[name], np.concatenate(squares), np.concatenate(slopes), alpha))
    return tuple(found)


def _of(name: str, factor: float, squares: Array, slopes: Array, alpha: float) -> Uncorrelated:
    """The cause, from squared residuals and squared slopes in units of the noise."""
    plain = Uncorrelated(name, factor)
    if not np.any(slopes > 0.0):
        return plain

    def cost(logs: Array) -> float:
        variance = np.exp(logs[0]) + np.exp(logs[1]) * slopes
        return 0.5 * float(np.sum(squares / variance + np.log(variance)))

    # From noise as stated, and from clock errors that explain a tenth of the residual.
    top = np.log(factor**2)
    starts = [(0.0, top), (top, top - np.log(10.0))]
    scale = np.log(np.mean(slopes))
    fits = [minimize(cost, (n, e - scale), method="L-BFGS-B", bounds=[(0.0, top), (None, None)])
            for n, e in starts]  # fmt: skip
    best = min(fits, key=lambda f: f.fun)
    larger = 0.5 * squares.size * (1.0 + np.log(np.mean(squares)))
    if larger - best.fun <= unknown_gain(alpha):
        return plain
    return Uncorrelated(name, *(float(v) for v in np.exp(0.5 * best.x)))
