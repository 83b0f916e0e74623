"""Compression laws: pressure, tangent and stored energy over volume fraction or strain."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]


def models() -> dict[str, Any]:
    """Describe every compression law: name -> title, source, validity, parameters."""
    return {d.name: d for d in _core.law_descriptions()}


@checked
def law(model: str, **params: float) -> _core.CompressionLaw:
    """Make a law with the methods ``pressure``, ``slope``, ``energy`` and ``volume_fraction``.

    Parameters
    ----------
    model
        ``"van_wyk"``, ``"neckar"``, ``"stamm"``, ``"toll_planar"``, ``"narter"``,
        ``"alkhagen_toll"``, ``"binomial"``, ``"bending_chain"``, ``"komori_itoh"``,
        ``"komori_itoh_renewed"`` or ``"lee_carnaby"``.
    params
        Parameters in SI units, with the names of the thesis:
        ``k_p E v_f0 v_fm w_f f gamma K_E K_p Q k_b k_t beta v_random chord_ratio``; ``models()``
        describes them with meaning and range.

    Raises
    ------
    InvalidParameter
        Parameters are unknown, missing or out of range; all of them are in the message.

    Examples
    --------
    Van Wyk's pressure [Pa] of wool at a volume fraction of 20 %:

    >>> from feltmb import fiber
    >>> wool = fiber.law("van_wyk", k_p=0.01, E=2.5e9, v_f0=0.1)
    >>> round(float(wool.pressure(0.2)))
    175000
    """
    return _core.CompressionLaw(model, {k: float(v) for k, v in params.items()})


def _fraction(made: Any, v_f: ArrayLike | None, strain: ArrayLike | None) -> Array:
    if (v_f is None) == (strain is None):
        raise InvalidParameter("compression law: give either v_f or strain, and not both")
    if v_f is not None:
        return np.asarray(v_f, dtype=float)
    e = np.asarray(strain, dtype=float)
    if not np.all(e < 1.0):
        raise InvalidParameter(
            f"compression law: strain = {float(np.max(e)):.6g}, must be < 1 (engineering strain, "
            "compression positive)"
        )
    return np.asarray(made.v_f0 / (1.0 - e))


def _result(values: Array) -> Any:
    return float(values) if values.ndim == 0 else values


@checked
def pressure(
    model: str,
    v_f: ArrayLike | None = None,
    *,
    strain: ArrayLike | None = None,
    threads: int = 0,
    **params: float,
) -> Any:
    """Pressure of a compression law.

    Parameters
    ----------
    model
        Name of the law, see :func:`law`.
    v_f
        Volume fraction [-], number or array, 0 < v_f <= 1.
    strain
        Replaces ``v_f``: engineering strain of compression, ``v_f = v_f0 / (1 - strain)``.
    threads
        Number of threads; 0: all cores (long arrays only).
    params
        Parameters of the law in SI units.

    Returns
    -------
    float or ndarray
        Pressure [Pa], compression positive; 0 at and below ``v_f0``.
    """
    made = law(model, **params)
    return _result(made.pressure(_fraction(made, v_f, strain), threads))
