"""Samples of a simulation at the times of a record, whose clock need not be even."""

from __future__ import annotations

import math

import numpy as np

from feltmb.data import Array, evenly_spaced

__all__ = ["at_times", "output_rate"]

#: Output samples per short interval of a record with an uneven clock. A tenth of its intervals are
#: shorter.
FINER, SHORT = 8.0, 0.1


def output_rate(time: Array) -> float:
    """Rate of the outputs of a simulation from which :func:`at_times` takes the samples [Hz].

    With an even clock, every output is a sample.
    """
    if evenly_spaced(time):
        return (time.size - 1) / float(time[-1] - time[0])
    duration = float(time[-1] - time[0])
    step = float(np.quantile(np.diff(time), SHORT))
    return math.ceil(FINER * duration / step) / duration


def at_times(simulated: Array, values: Array, time: Array) -> Array:
    """Values (n, ...) at the times of the samples, from values at the times of the simulation.

    They are returned unchanged if the clock of the samples is even, else interpolated by cubic
    polynomials.
    """
    if simulated.size == time.size and evenly_spaced(time):
        return values
    from scipy.interpolate import CubicHermiteSpline

    slope = np.gradient(values, simulated, axis=0)
    found: Array = CubicHermiteSpline(simulated, values, slope, axis=0)(time)
    return found
