"""Laws of the imperfect machines: smooth, with memory, or measured ones; none is the library's."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

__all__ = ["bristle", "bump", "dead", "iwan", "smooth_sign", "soft_clip"]


def smooth_sign(v: Any, v0: float) -> Any:
    """Sign of a speed that is linear below about v0; algebraic, not tanh."""
    return v / np.sqrt(v * v + v0 * v0)


def soft_clip(u: Any, e: Any) -> Any:
    """A drive whose output approaches 1 / e."""
    return u / np.sqrt(np.sqrt(1.0 + (e * u) ** 4))


def dead(u: Any, e: Any) -> Any:
    """A value that loses e when it is large, and nearly all of itself when it is small."""
    return u - e * u / (np.sqrt(u * u + e * e) + 1e-300)


def bump(q: Any, begin: float, width: float) -> Any:
    """Progressive stop: 0 below ``begin``, exponential beyond, e - 1 after one width."""
    return np.expm1(np.minimum(np.maximum(q - begin, 0.0) / width, 6.0))


def bristle(v: Any, z: Any, stretch: float, stribeck: float, excess: float) -> tuple[Any, Any]:
    """Friction of bristles (Canudas de Wit et al. 1995): force per unit, and rate of the bristle.

    z is the deflection over ``stretch``; the sliding force is 1, at rest 1 + excess.
    """
    level = 1.0 + excess * np.exp(-((v / stribeck) ** 2))
    rate = (v - np.abs(v) * z / level) / stretch
    return z + 0.3 * stretch * rate / stribeck, rate


def iwan(v: Any, z: Any, stretch: float) -> Any:
    """Rate of one element of a chain of Iwan (1966), in units of its slip."""
    return v / stretch * (1.0 - np.abs(z) * 0.5 * (1.0 + np.sign(v * z)))
