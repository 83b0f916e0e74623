"""Alkhagen and Toll's granular rate theory in tensor form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter


@checked
def granular_stress(
    path: ArrayLike,
    *,
    v_random: float,
    E: float,
    k_b: float = 1.0,
    k_t: float = 1.0,
    beta: float = 0.0,
    transverse: bool = False,
    substeps: int = 4,
    nodes: int = 24,
) -> NDArray[np.float64]:
    """Cauchy stress along a path of deformation gradients (eqs. 3.39, 3.53).

    Parameters
    ----------
    path
        Deformation gradients since the random state, shape (n, 3, 3); the stress is zero at the
        first one.
    v_random
        Volume fraction at F = I [-].
    E
        Fiber modulus [Pa].
    k_b, k_t, beta
        Bending and torsion constants and crimp ratio [-].
    transverse
        Whether the term of the transverse compliance (eq. 3.52) is included; eq. 3.53 neglects it.
    substeps
        Number of Runge-Kutta steps between two given gradients.
    nodes
        Number of polar nodes of the orientation average; use more for strong anisotropy.

    Returns
    -------
    ndarray
        Stress [Pa], shape (n, 3, 3), tension positive; pressure is ``-stress[:, 2, 2]``.

    Examples
    --------
    Stress along the axis [Pa] while a felt is pressed by 20 %:

    >>> import numpy as np
    >>> from feltmb import fiber
    >>> path = [np.diag([1.0, 1.0, height]) for height in (1.0, 0.9, 0.8)]
    >>> stress = fiber.granular_stress(path, v_random=0.1, E=2.5e9)
    >>> stress.shape, bool(stress[-1, 2, 2] < 0.0)
    ((3, 3, 3), True)
    """
    given = np.asarray(path, dtype=float)
    if given.ndim != 3 or given.shape[1:] != (3, 3):
        raise InvalidParameter(
            f"granular rate theory: path has shape {given.shape}, expected (n, 3, 3)"
        )
    result: NDArray[np.float64] = _core.granular_stress_path(
        list(given),
        v_random,
        E=E,
        k_b=k_b,
        k_t=k_t,
        beta=beta,
        transverse=transverse,
        substeps=substeps,
        nodes=nodes,
    )
    return result
