"""Units of products in the usual notation."""

from __future__ import annotations

import re

__all__ = ["product"]

_TOKEN = re.compile(r"^([^\d^][^^]*?)(?:\^?(-?\d+(?:\.\d+)?))?$")


def product(*powers: tuple[str, float]) -> str:
    """Unit of a product of units with powers, for example ``s/rad`` -> 1/s.

    Each base unit appears once.

    A text that is not a unit is kept unchanged.
    """
    exponents: dict[str, float] = {}
    for unit, power in powers:
        for sign, part in zip((1.0, -1.0), unit.split("/", 1), strict=False):
            for token in part.replace("/", " ").replace("*", " ").split():
                if token == "1":
                    continue
                match = _TOKEN.match(token)
                name, own = (match[1], float(match[2] or 1.0)) if match else (token, 1.0)
                exponents[name] = exponents.get(name, 0.0) + sign * power * own
    above = [_raised(n, e) for n, e in exponents.items() if e > 0.0]
    below = [_raised(n, -e) for n, e in exponents.items() if e < 0.0]
    text = " ".join(above) or "1"
    return f"{text}/{' '.join(below)}" if below else text


def _raised(name: str, exponent: float) -> str:
    return name if exponent == 1.0 else f"{name}^{exponent:g}"
