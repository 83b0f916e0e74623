"""Energy method of Komori-Itoh and Lee-Carnaby: fiber segments that bend to arcs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from unmodeled.arguments import checked

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EnergyCurve:
    """Compression of a mass of arc segments; arrays over the strains."""

    strain: Array
    """Engineering compression along axis 3 [-]."""
    lateral_stretch: Array
    """Lateral stretch [-]."""
    v_f: Array
    """Volume fraction [-]."""
    pressure: Array
    """Stress along axis 3, compression positive [Pa]."""
    bending: Array
    """Energy stored in bending segments [J per m^3 of fiber]."""
    straightening: Array
    """Energy stored in straightening segments [J/m^3]."""
    slipping: Array
    """Energy stored in slipping (now straight) segments [J/m^3]."""
    slip_work: Array
    """Work dissipated by slipping, which is not stored [J/m^3]."""
    bending_share: Array
    """Share of the segments that bend [-]."""
    straightening_share: Array
    """Share of the segments that straighten [-]."""
    slipping_share: Array
    """Share of the segments that slip [-]."""

    @property
    def stored(self) -> Array:
        """Total stored energy, eq. 2.6 [J per m^3 of fiber]."""
        return self.bending + self.straightening + self.slipping


@checked
def compress_arcs(
    strain: ArrayLike,
    *,
    E: float,
    v_f0: float,
    scheme: str = "confined",
    chord_ratio: float = 1.0,
    ratio: float = 1.0,
    length_shape: float = 0.0,
    slip_stress: float = 0.0,
) -> EnergyCurve:
    """Compress a mass of fiber segments that bend to arcs of constant length (thesis 2.2.1).

    Parameters
    ----------
    strain
        Engineering compression along axis 3 [-], 0 <= strain < 1.
    E
        Fiber modulus [Pa].
    v_f0
        Volume fraction at rest [-].
    scheme
        ``"isotropic"``, ``"confined"`` (lateral dimensions held) or ``"simple"`` (no lateral
        stress; needs crimp or a slip stress).
    chord_ratio
        Ratio of chord to arc length of a segment at rest [-]; 1 is straight (Komori-Itoh, stress
        jumps at the onset because segments must buckle).
    ratio
        Orientation at rest, R = v_f0 / v_random.
    length_shape
        Shape of a gamma distribution of segment lengths, > 1; 0 for equal lengths.
    slip_stress
        Slip force of a straightened segment divided by d_f^2 [Pa].

    Raises
    ------
    InvalidParameter
        Arguments are invalid; all of them are in the message.
    Error
        Simple compression has no equilibrium for these segments.
    """
    table = _core.compress_energy(
        scheme,
        np.atleast_1d(np.asarray(strain, dtype=float)),
        E=E,
        v_f0=v_f0,
        chord_ratio=chord_ratio,
        ratio=ratio,
        length_shape=length_shape,
        slip_stress=slip_stress,
    )
    return EnergyCurve(*(np.ascontiguousarray(column) for column in table.T))
