"""Published hammers of pianos by note: mass, stiffness and exponent of their felt.

Only numbers whose source could be read are here. The source of each is a copy or a quotation, which
its text names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

KEYS = 88


@dataclass(frozen=True)
class Hammer:
    """A hammer whose felt follows F = K e^p, e its compression."""

    name: str
    stiffness: float
    """K [N/m^p]."""
    exponent: float
    """p [1]."""
    mass: float | None
    """Of the hammer [kg]; None: the source does not tell it."""
    source: str

    @property
    def law(self) -> dict[str, str | float]:
        """Value of ``contacts.NN.law`` in a mechanism file: the power law, without a loss."""
        return {
            "name": "hunt_crossley",
            "stiffness": self.stiffness,
            "exponent": self.exponent,
            "damping": 0.0,
        }

    @checked
    def contact(self, speed: float, mass: float | None = None) -> tuple[float, float]:
        """Largest force [N] and duration [s] of a free blow on a rigid surface at ``speed`` [m/s].

        F = (p + 1)^(p/(p+1)) K^(1/(p+1)) (m v^2 / 2)^(p/(p+1)); the duration is 2 e_max / v times
        the integral of (1 - s^(p+1))^(-1/2) from 0 to 1.
        """
        m = self.mass if mass is None else mass
        if m is None or not (m > 0.0 and speed > 0.0):
            raise InvalidParameter(
                f"hammer {self.name}: mass {m} kg, speed {speed} m/s, expected numbers > 0"
            )
        p = self.exponent
        largest = (0.5 * m * speed**2 * (p + 1.0) / self.stiffness) ** (1.0 / (p + 1.0))
        a = 1.0 / (p + 1.0)
        integral = math.sqrt(math.pi) * a * math.gamma(a) / math.gamma(a + 0.5)
        return self.stiffness * largest**p, 2.0 * largest / speed * integral


#: Hammers with a name.
HAMMERS: dict[str, Hammer] = {
    "chaigne_askenfelt_C4": Hammer(
        "chaigne_askenfelt_C4",
        4.5e9,
        2.5,
        2.97e-3,
        "A. Chaigne, A. Askenfelt, J. Acoust. Soc. Am. 95 (1994) 1112 and 1631, note C4, as quoted "
        "by two public simulations of that string",
    ),
}


@checked
def hammer(name: str) -> Hammer:
    """Hammer by its name in :data:`HAMMERS`, or of a key: ``stulov:1`` (A0) to ``stulov:88``.

    Of a key n: K = 183 exp(0.045 n) N/mm^p, p = 3.7 + 0.015 n (A. Stulov, in J. O. Smith, Physical
    Audio Signal Processing, "Nonlinear Spring Model").

    Raises
    ------
    InvalidParameter
        There is no such hammer.

    Examples
    --------
    A published hammer:

    >>> from feltmb import contact
    >>> contact.hammer("chaigne_askenfelt_C4").mass
    0.00297
    """
    if name in HAMMERS:
        return HAMMERS[name]
    kind, _, key = name.partition(":")
    if kind != "stulov" or not key.isdecimal() or not 1 <= int(key) <= KEYS:
        raise InvalidParameter(
            f"hammer {name!r} is unknown; expected {', '.join(HAMMERS)}, or stulov:1 to "
            f"stulov:{KEYS}, the number of the key"
        )
    n = int(key)
    p = 3.7 + 0.015 * n
    return Hammer(
        name,
        183.0 * math.exp(0.045 * n) * 1e3**p,
        p,
        None,
        "A. Stulov, fit over the keyboard, quoted by J. O. Smith, Physical Audio Signal Processing",
    )
