"""Usual ranges of the numbers of fibers: beyond them, a unit is usually wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass

from unmodeled.arguments import checked
from unmodeled.errors import no_such
from unmodeled.units import unit_suffix


@dataclass(frozen=True)
class UsualRange:
    """Range of a number of the fibers within which the laws were made and compared."""

    what: str
    low: float
    high: float
    unit: str
    why: str

    def caution(self, value: float) -> str:
        """Sentence about a value outside; "" inside."""
        if self.low <= value <= self.high:
            return ""
        unit = unit_suffix(self.unit)
        return (
            f"{self.what} = {value:g}{unit} is outside of {self.low:g} to {self.high:g}{unit} "
            f"({self.why})" + (": check its unit" if unit else "")
        )


#: Densest packing of parallel cylinders.
DENSEST = math.pi / math.sqrt(12.0)

RANGES = {
    "d_f": UsualRange("fiber diameter", 1e-7, 1e-3, "m", "microfibers to bristles; wool 25e-6 m"),
    "length": UsualRange("fiber length", 1e-5, 1.0, "m", "wool 0.03 to 0.15 m"),
    "segment": UsualRange("segment length", 1e-7, 1e-2, "m", "2.5 diameters are usual"),
    "E": UsualRange("fiber modulus", 1e6, 1e12, "Pa", "rubber to carbon; wool 2.5e9 Pa"),
    "mu": UsualRange("friction between fibers", 0.0, 2.0, "1", "wool 0.1 to 0.5"),
    "Wf0": UsualRange("withdrawal force per length", 1e-4, 1e4, "N/m", "felts 0.1 to 100 N/m"),
    "gamma": UsualRange(
        "blocked length over the diameter", 0.1, 100.0, "1", "crossing straight fibers 1 to 2"
    ),
    "v_f": UsualRange(
        "volume fraction", 0.0, DENSEST, "1", "at 0.9069 parallel cylinders have no space left"
    ),
}


@checked
def unusual(**values: float) -> list[str]:
    """Sentences about numbers of fibers that are outside of their usual range.

    The laws are computed with such numbers all the same. A factor of a thousand or a million is
    usually a wrong unit.

    Parameters
    ----------
    **values
        Numbers in SI units by name: ``d_f`` and ``length`` of a fiber [m], ``segment`` of a
        simulated fiber [m], ``E`` [Pa], ``mu`` [-], ``Wf0`` [N/m], ``gamma`` [-], ``v_f`` [-].

    Returns
    -------
    list of str
        One sentence for each, with the range; empty if all are usual.

    Examples
    --------
    A fiber of 25 um is usual, one of 25 mm is not:

    >>> from feltmb import fiber
    >>> fiber.unusual(d_f=25e-6), len(fiber.unusual(d_f=25e-3))
    ([], 1)
    """
    for name in values:
        if name not in RANGES:
            raise no_such("number of fibers", name, RANGES)
    found = [RANGES[name].caution(float(value)) for name, value in values.items()]
    return [text for text in found if text]
