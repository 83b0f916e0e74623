"""Numbers with as many digits as their interval has something to say of."""

from __future__ import annotations

import math

__all__ = ["digits"]

#: Digits at most.
MOST = 10


def digits(value: float, sd: float, least: int) -> int:
    """Significant digits of a number that show two of its standard deviation, at least some."""
    if not (math.isfinite(value) and math.isfinite(sd) and 0.0 < sd < abs(value)):
        return least
    shown = math.floor(math.log10(abs(value))) - math.floor(math.log10(sd)) + 2
    return min(max(least, shown), MOST)
