"""Run-to-run variability: differences from stroke to stroke without a cause.

They are the noise of the measured input, small changes of felt and friction, and the discretization
error. Directions above the noise of the sensors become parameters of their own record with the
prior N(0, 1), with a linear influence on its outputs:

    y_r(theta, phi, z_r) = y(theta, phi) + D_r z_r,    D_r D_r' = covariance of the variability.
"""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feltmb.adapters.derivatives import Derivatives, SimulatedPoint
from feltmb.adapters.drives import DISPLACEMENT
from feltmb.adapters.library import Entry
from feltmb.data import Array, Record
from feltmb.fit import Candidate
from feltmb.fit.noise import sd_of_knots

__all__ = ["RunVariability", "variability_of"]

#: Tolerances of felt and friction, which vary from stroke to stroke.
VARYING = ("felt.*", "joint_friction.*", "contact_friction.*")
#: Directions with a noncentrality below this are omitted, if there are more than this number: at
#: other parameters, other directions can matter.
LEAST_VARIABILITY, FEWEST_DIRECTIONS = 0.3, 12
#: Change of parameters in prior standard deviations, and relative change of magnitudes, up to which
#: the directions are not computed again.
NEAR = 0.2
#: Distance of the knots of input noise [s]: a camera sees averages over a longer time, an encoder
#: at the finger does not (a null case of the blind bench loses 17 units of log evidence at 8 ms).
KNOTS, KNOTS_AT_FINGER = 8e-3, 4e-3


@dataclass(frozen=True, eq=False)
class RunVariability:
    """Directions of the variability of a record: (n, ny, k), each with a factor N(0, 1)."""

    record: Record
    columns: Array
    variation: float
    """Relative standard deviation of felt and friction from stroke to stroke [1]."""
    theta: Array
    """Parameters of the mechanism at which they hold."""
    effects: tuple[tuple[str, float | None], ...]
    """Names and shapes of the included effects with which they hold."""
    magnitudes: Array
    """Magnitudes of these effects."""

    @property
    def count(self) -> int:
        """Number of directions."""
        return int(self.columns.shape[2])

    def covers(self, record: Record) -> bool:
        """Whether the stroke is the input of a record, or starts with it."""
        n = min(record.samples, self.record.samples)
        known = [self.record.time, *self.record.inputs.values()]
        given = [record.time, *record.inputs.values()]
        return self.record.inputs.keys() == record.inputs.keys() and all(
            np.array_equal(a[:n], b[:n]) for a, b in zip(known, given, strict=True)
        )

    def over(self, record: Record) -> Array:
        """Directions over a record that covers the stroke; zero after the time of their data."""
        columns = self.columns[: record.samples]
        more = record.samples - len(columns)
        return np.pad(columns, ((0, more), (0, 0), (0, 0))) if more else columns


def variability_of(
    derivatives: Derivatives,
    record: Record,
    variation: float,
    theta: Array,
    included: tuple[Candidate, ...],
    magnitudes: Array,
    count: int | None = None,
) -> RunVariability | None:
    """The largest directions of the variability of a record; None: the simulation failed.

    Parameters
    ----------
    derivatives
        Derivatives of the mechanism.
    record
        A record with the noise of its sensors and inputs.
    variation
        Relative standard deviation of felt and friction from stroke to stroke [1].
    theta, included, magnitudes
        Where the directions are computed.
    count
        Number of directions; None: all that matter beside the noise of the sensors.
    """
    simulator = derivatives.simulator
    base = simulator.motion(record, theta, included, magnitudes)
    if base is None:
        return None
    which = []
    if variation > 0.0:
        which = [i for i, e in enumerate(simulator.tolerances) if _is_law(e)]
    changes = [
        change
        for name, sigma in record.input_sigma.items()
        if sigma > 0.0 and name in record.inputs
        for change in _input_noise(record, name)
    ]
    point = SimulatedPoint(record, theta, included, magnitudes, base)
    by, _, by_noise = derivatives.at(point, which, (), tuple(changes))
    columns = [variation * by[..., i] for i in range(len(which))]
    columns += [by_noise[..., k] for k in range(len(changes))]
    motions = [s.motion(record, theta, included, magnitudes) for s in simulator.refined]
    columns += [np.full_like(base, np.nan) if m is None else m - base for m in motions]
    stacked = np.stack(columns, axis=-1) if columns else np.zeros((*base.shape, 0))
    if count is not None and not np.all(np.isfinite(stacked)):
        return None
    largest = _largest(np.nan_to_num(stacked), _noise_of(record, simulator.outputs), count)
    names = tuple((c.name, c.shape) for c in included)
    return RunVariability(record, largest, variation, theta.copy(), names, magnitudes.copy())


def _largest(columns: Array, noise: Array, count: int | None) -> Array:
    """The directions (n, ny, k) in which the variability is largest beside the noise."""
    if not columns.shape[2]:
        return columns
    flat = (columns / noise[None, :, None]).reshape(-1, columns.shape[2])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    if count is None:
        seen = values > 1e-12 * values[-1]
        count = min(
            int(np.sum(seen)),
            max(FEWEST_DIRECTIONS, int(np.sum(values > LEAST_VARIABILITY**2))),
        )
    return np.asarray(columns @ vectors[:, ::-1][:, :count])


def _noise_of(record: Record, outputs: Sequence[str]) -> Array:
    """Noise of the outputs; infinite if there is no sensor or its noise is unknown."""
    sigma = [record.sensors[o].sigma if o in record.sensors else None for o in outputs]
    return np.array([math.inf if s is None or not s < math.inf else s for s in sigma])


def _is_law(entry: Entry) -> bool:
    """Whether a tolerance scales a law of felt or friction."""
    return entry.unit == "1" and any(fnmatch.fnmatch(entry.name, v) for v in VARYING)


def _input_noise(record: Record, name: str) -> list[Mapping[str, Array]]:
    """Changes of an input by one standard deviation of noise, one per knot."""
    length = float(record.time[-1] - record.time[0])
    apart = KNOTS_AT_FINGER if DISPLACEMENT in record.outputs else KNOTS
    knots = np.linspace(0.0, length, max(2, math.ceil(length / apart) + 1))
    clock = record.time - record.time[0]
    hats = np.maximum(0.0, 1.0 - np.abs(clock - knots[:, None]) / knots[1])
    sd = sd_of_knots(record, name, float(knots[1]))
    return [{name: sd * hat} for hat in hats]
