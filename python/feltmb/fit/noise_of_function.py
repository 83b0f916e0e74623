"""Numerical noise of a black-box function, and suitable steps of finite differences."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from feltmb.data import Array

__all__ = ["Step", "choose_step", "difference_offsets", "noise_of_function"]

#: Smallest noise relative to the spread of the outputs: rounding.
ROUNDING = 1e-15
#: Permitted relative error of a derivative by forward differences.
GOOD = 0.02
#: Smallest and largest step relative to the scale of the parameter.
SMALLEST, LARGEST = 1e-5, 0.3


def difference_offsets(
    at: float, step: float, low: float, high: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Two changes of a number, and their weights in a derivative of second order.

    The weights apply to differences from the value without a change. If a limit excludes one side,
    both changes are on the other one.
    """
    if at + step <= high and at - step >= low:
        return (step, 0.5 / step), (-step, -0.5 / step)
    side = step if at + 2.0 * step <= high else -step
    return (side, 2.0 / side), (2.0 * side, -0.5 / side)


@dataclass(frozen=True)
class Step:
    """Step of a finite difference by one parameter."""

    size: float
    """[unit of the parameter]"""
    central: bool

    def offsets(self, at: float, low: float, high: float) -> tuple[tuple[float, float], ...]:
        """Changes of the parameter within its limits, and their weights in the derivative."""
        h = self.size
        if not self.central:
            side = h if at + h <= high else -h
            return ((side, 1.0 / side),)
        return difference_offsets(at, h, low, high)


def noise_of_function(values: Array) -> float:
    """Standard deviation of the noise of equally spaced values, (m + 1, ...), by ECnoise.

    Differences of a smooth function decrease with their order, but those of noise do not: order k
    has the variance sigma^2 (2k)! / (k!)^2. The result is taken from the first order at which three
    estimates agree within a factor of four (J. J. More and S. M. Wild, "Estimating computational
    noise", SIAM J. Sci. Comput. 33, 2011); all outputs and samples are averaged. If no estimates
    agree, the function is still smooth at the last order, and the result is an upper limit.
    """
    table, gamma, sigmas = values, 1.0, []
    for k in range(1, len(values)):
        table = np.diff(table, axis=0)
        gamma *= 0.5 * k / (2 * k - 1)
        sigmas.append(math.sqrt(gamma * float(np.mean(table**2))))
    for i in range(len(sigmas) - 2):
        three = sigmas[i : i + 3]
        if max(three) <= 4.0 * min(three):
            return max(sigmas[i], ROUNDING)
    return max(sigmas[-1], ROUNDING)


def choose_step(
    base: Array, near: Array, far: Array, step: float, noise: float, scale: float, both: bool
) -> Step:
    """Step with the smallest error, from values at 0, ``step``, -``step`` (or 2 ``step``).

    A forward difference has the error 2 noise / h + h |f''| / 2, which is smallest at h = 2
    sqrt(noise / |f''|). A central difference has the error noise / h + h^2 |f'''| / 6, where |f'''|
    is estimated as |f''|^2 / |f'|.
    """
    if not (np.all(np.isfinite(near)) and np.all(np.isfinite(far))):
        return Step(0.1 * abs(step), central=True)

    def norm(x: Array) -> float:
        return float(np.sqrt(np.mean(x**2)))

    h = abs(step)
    slope = norm(near - far) / (2.0 * h) if both else norm(near - base) / h
    bend = norm(near - 2.0 * base + far) if both else norm(far - 2.0 * near + base)
    if slope == 0.0:
        return Step(h, central=True)
    bend = max(bend, 4.0 * noise) / h**2  # a change below the noise may still exist
    forward = float(np.clip(2.0 * math.sqrt(noise / bend), SMALLEST * scale, LARGEST * scale))
    if 2.0 * noise / forward + 0.5 * forward * bend <= GOOD * slope:
        return Step(forward, central=False)
    central = (3.0 * noise * slope / bend**2) ** (1.0 / 3.0)
    return Step(float(np.clip(central, SMALLEST * scale, LARGEST * scale)), central=True)
