"""MIDI velocity of a hammer speed, by a stated curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from unmodeled.errors import InvalidParameter


@dataclass(frozen=True)
class VelocityCurve:
    """Velocity over the logarithm of the hammer speed: a line, or a line through each two points.

    The default is 52 + 25 log2(v), v in m/s, the map that Goebl chose for his recordings with a
    Boesendorfer SE290 [1]_: velocity 1 at 0.24 m/s, 127 at 8 m/s.

    Attributes
    ----------
    speeds : sequence of float
        Speeds of the hammer at the string [m/s], increasing.
    velocities : sequence of float
        Their MIDI velocities [1], increasing.

    References
    ----------
    .. [1] W. Goebl, The role of timing and intensity in the production and perception of melody in
       expressive piano performance, doctoral thesis, University of Graz, 2003, eq. (3.2).
    """

    speeds: Sequence[float] = (2.0 ** (-51 / 25), 2.0**3)
    velocities: Sequence[float] = (1.0, 127.0)

    def __post_init__(self) -> None:
        for name, values in (("speeds", self.speeds), ("velocities", self.velocities)):
            rising = all(b > a for a, b in pairwise(values))
            if len(values) < 2 or len(self.speeds) != len(self.velocities) or not rising:
                raise InvalidParameter(
                    f"velocity curve: {name} = {list(values)}, expected at least two increasing "
                    "numbers, as many speeds as velocities"
                )
        if self.speeds[0] <= 0.0 or self.velocities[0] < 1.0 or self.velocities[-1] > 127.0:
            raise InvalidParameter(
                f"velocity curve: got speeds from {self.speeds[0]:g} m/s and velocities from "
                f"{self.velocities[0]:g} to {self.velocities[-1]:g}; expected above 0, and 1 to 127"
            )

    def velocity(self, speed: float) -> int:
        """MIDI velocity, 1 to 127, of a speed [m/s]."""
        found = np.interp(math.log(max(speed, 1e-9)), np.log(self.speeds), self.velocities)
        return int(np.clip(np.rint(found), 1, 127))

    def speed(self, velocity: float) -> float:
        """Speed of the hammer [m/s] of a MIDI velocity."""
        return float(np.exp(np.interp(velocity, self.velocities, np.log(self.speeds))))
