"""MIDI velocity of a hammer speed, by a stated curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data.tables import read_number, read_table, text_lines
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import LARGEST_TABLE, read_input
from unmodeled.units import split_column
from unmodeled.units.quantity import factor_to

#: Fewest measured pairs of a curve.
FEWEST = 8
#: Instruments of which no curve is known, and what is.
_SE = "; goebl is the map that was chosen for recordings with one"
UNKNOWN = {"disklavier": "", "boesendorfer": _SE, "bösendorfer": _SE, "se": _SE, "se290": _SE}


@dataclass(frozen=True)
class VelocityCurve:
    """Velocity over the logarithm of the hammer speed: a line, or a line through each two points.

    The default is 52 + 25 log2(v), v in m/s, the map that Goebl chose for his recordings with a
    Boesendorfer SE290 [1]_: velocity 1 at 0.24 m/s, 127 at 8 m/s. Softer strikes, which pianists
    made down to 0.18 m/s [2]_, have velocity 1 too.

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
    .. [2] W. Goebl, R. Bresin, A. Galembo, Touch and temporal behavior of grand piano actions,
       J. Acoust. Soc. Am. 118 (2005), 1154-1165. Both were read in quotations, not in print.
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

    @property
    def ends(self) -> str:
        """Range of the curve, and what becomes of other speeds."""
        return (
            f"the velocity curve goes from {self.velocity(self.speeds[0])} at {self.speeds[0]:.2f} "
            f"m/s to {self.velocity(self.speeds[-1])} at {self.speeds[-1]:.1f} m/s; beyond, the "
            "velocity is that of the end"
        )


@checked
def measured_curve(speeds: Sequence[float], velocities: Sequence[float]) -> VelocityCurve:
    """Velocity curve of measured pairs: the rising steps that fit them best.

    Parameters
    ----------
    speeds
        Speeds of the hammer at the string [m/s], in any order.
    velocities
        MIDI velocities that the instrument gave [1].
    """
    from scipy.optimize import isotonic_regression

    if len(speeds) < FEWEST or len(speeds) != len(velocities):
        raise InvalidParameter(
            f"velocity curve: got {len(speeds)} speeds and {len(velocities)} velocities, expected "
            f"pairs, at least {FEWEST}"
        )
    strange = [v for v in speeds if not 0.0 < v < 20.0] + [
        n for n in velocities if not 1 <= n < 128
    ]
    if strange:
        raise InvalidParameter(
            f"velocity curve: got {strange[0]:g}, expected speeds above 0 and below 20 m/s, and "
            "velocities of 1 to 127"
        )
    # Strikes of one velocity have one mean speed: rising steps of single pairs would follow noise.
    level, where = np.unique(np.asarray(velocities, float), return_inverse=True)
    count = np.bincount(where)
    middle = np.bincount(where, np.log(speeds)) / count
    rising = np.asarray(isotonic_regression(middle, weights=count).x)
    steps = np.unique(rising)
    means = [np.average(level[rising == s], weights=count[rising == s]) for s in steps]
    return VelocityCurve(np.exp(steps).tolist(), [float(m) for m in means])


def read_curve(name: str) -> VelocityCurve:
    """Velocity curve by its name, or from a CSV file of measured pairs.

    ``goebl`` is the default. A file has the columns ``speed [m/s]`` and ``velocity``.

    Raises
    ------
    InvalidParameter
        The curve is not known: that of a Disklavier is not.
    DataError
        The file holds something else.
    """
    if name.lower() in UNKNOWN:
        raise InvalidParameter(
            f"--curve {name}: the curve of this instrument is unknown, no source with numbers was "
            f"found{UNKNOWN[name.lower()]}; measure pairs: --curve FILE.csv with the columns speed "
            "[m/s] and velocity"
        )
    if name.lower() == "goebl":
        return VelocityCurve()
    path = Path(name)
    if path.suffix.lower() != ".csv":
        raise InvalidParameter(
            f"--curve {name}: expected goebl, SPEED=VELOCITY, or a CSV file of measured pairs"
        )
    table = read_table(text_lines(read_input(path, most=LARGEST_TABLE), path))
    heads = [split_column(head) for head in table.header]
    names = [n.lower() for n, _ in heads]
    if not {"speed", "velocity"} <= set(names):
        raise DataError(
            f"{path}: got the columns {', '.join(table.header) or 'none'}; expected "
            "speed [m/s] and velocity"
        )
    at = names.index("speed"), names.index("velocity")
    factor = factor_to(heads[at[0]][1] or "m/s", "m/s")
    rows = [
        (line, [read_number(cells[i], table.decimal) if i < len(cells) else None for i in at])
        for line, cells in table.rows
    ]
    for line, pair in rows:
        if None in pair:
            raise DataError(f"{path}: line {line}: expected two numbers, a speed and a velocity")
    speeds, velocities = np.array([pair for _, pair in rows], float).reshape(-1, 2).T.tolist()
    return measured_curve([factor * v for v in speeds], velocities)
