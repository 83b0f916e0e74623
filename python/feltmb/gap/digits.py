"""Rounds numbers to the digits that their uncertainty supports."""

from __future__ import annotations

import math

__all__ = ["digits"]

#: Largest number of digits.
MOST = 10


def digits(value: float, sd: float, least: int) -> int:
    """Number of significant digits that resolves two standard deviations, at least ``least``."""
    if not (math.isfinite(value) and math.isfinite(sd) and 0.0 < sd < abs(value)):
        return least
    shown = math.floor(math.log10(abs(value))) - math.floor(math.log10(sd)) + 2
    return min(max(least, shown), MOST)
