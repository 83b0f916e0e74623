"""Number of fiber-to-fiber contacts and the free length between them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]

_NAN = float("nan")


def _orientation(model: str, ratio: float | None, structure: Any | None) -> dict[str, float]:
    if ratio is not None and structure is not None:
        raise InvalidParameter("contacts: give either ratio or structure, and not both")
    if structure is not None:
        if model in ("van_wyk", "van_wyk_tube"):
            raise InvalidParameter(
                f'contacts, model "{model}": structure is not used, expected ratio '
                "(van Wyk's path along axis 3 needs the mean sine of theta)"
            )
        psi = getattr(structure, "obstruction", _NAN)
        psi = psi() if callable(psi) else psi
        return {"f": float(structure.f), "sine": math.pi / 4, "obstruction": float(psi)}
    if ratio is None or ratio == 1:
        return {"f": math.pi / 4, "sine": math.pi / 4, "obstruction": math.pi**2 / 8}
    s = _core.compute_uniaxial_structure(float(ratio))
    psi = s.obstruction() if model == "pan" else math.pi**2 / 8
    return {"f": s.f, "sine": s.sine, "obstruction": psi}


def _evaluate(
    core: Callable[..., float],
    model: str,
    v_f: ArrayLike,
    d_f: ArrayLike,
    ratio: float | None,
    structure: Any | None,
    options: dict[str, Any],
) -> Any:
    given = _orientation(model, ratio, structure)
    v, d = np.broadcast_arrays(np.asarray(v_f, dtype=float), np.asarray(d_f, dtype=float))
    out = np.empty(v.shape)
    for index in np.ndindex(v.shape):
        out[index] = core(model, float(v[index]), float(d[index]), **given, **options)
    return float(out) if out.ndim == 0 else out


@checked
def mean_free_length(
    model: str,
    v_f: ArrayLike,
    d_f: ArrayLike,
    *,
    ratio: float | None = None,
    structure: Any | None = None,
    gamma: float = _NAN,
    Q: float = _NAN,
    diameter_cv: float = 0.0,
    as_printed: bool = False,
) -> Any:
    """Mean distance between neighboring contacts along a fiber.

    Parameters
    ----------
    model
        ``"van_wyk"`` (eq. 3.1), ``"van_wyk_tube"`` (3.2), ``"komori_makishima"`` (3.6),
        ``"pan"`` (3.10), ``"poisson"`` (3.11), ``"binomial"`` (3.15) or ``"toll"`` (3.50).
    v_f
        Volume fraction [-], number or array.
    d_f
        Mean fiber diameter [m], number or array.
    ratio
        R = v_f / v_random of the orientation; default: isotropic.
    structure
        Replaces ``ratio``: averages of any orientation density (``density_structure``).
    gamma
        Blocked fiber length per contact over d_f [-] (binomial only, required there).
    Q
        Constant of the binomial model [-]; default: 8 f / pi (2 if isotropic).
    diameter_cv
        Coefficient of variation of the diameters (komori_makishima, poisson, toll).
    as_printed
        Whether ``van_wyk_tube`` uses the constant printed in eq. 3.2, with which the length is too
        large by (4/pi)^2.

    Returns
    -------
    float or ndarray
        Mean free length [m].

    Raises
    ------
    InvalidParameter
        Arguments are invalid; all of them are in the message.

    Examples
    --------
    Fiber of 25 um between two contacts [um], 10 % of fibers, without a preferred direction:

    >>> from feltmb import fiber
    >>> round(1e6 * float(fiber.mean_free_length("toll", 0.1, 25e-6, ratio=1.0)), 1)
    125.0
    """
    options = {"gamma": gamma, "Q": Q, "diameter_cv": diameter_cv, "as_printed": as_printed}
    return _evaluate(_core.mean_free_length, model, v_f, d_f, ratio, structure, options)


@checked
def contacts_per_volume(
    model: str,
    v_f: ArrayLike,
    d_f: ArrayLike,
    *,
    ratio: float | None = None,
    structure: Any | None = None,
    gamma: float = _NAN,
    Q: float = _NAN,
    diameter_cv: float = 0.0,
    as_printed: bool = False,
    counting: str = "source",
) -> Any:
    """Count the fiber-to-fiber contacts per volume of the assembly.

    Parameters
    ----------
    model, v_f, d_f, ratio, structure, gamma, Q, diameter_cv, as_printed
        See :func:`mean_free_length`.
    counting
        ``"source"``: the count of the model's source, i.e. every contact on both of its fibers for
        ``toll`` (eq. 3.51) and once for all other models; ``"once"`` or ``"ends"`` (both fibers)
        for any model.

    Returns
    -------
    float or ndarray
        Contacts per volume [1/m^3].

    Examples
    --------
    Contacts in a cubic millimeter of fibers of 25 um, 10 % of fibers:

    >>> from feltmb import fiber
    >>> round(1e-9 * float(fiber.contacts_per_volume("toll", 0.1, 25e-6, ratio=1.0)))
    1630
    """
    options = {
        "gamma": gamma,
        "Q": Q,
        "diameter_cv": diameter_cv,
        "as_printed": as_printed,
        "counting": counting,
    }
    return _evaluate(_core.contacts_per_volume, model, v_f, d_f, ratio, structure, options)


@dataclass(frozen=True)
class ContactCount:
    """Distribution of the number of contacts on one fiber."""

    k: NDArray[np.int64]
    """Number of contacts."""
    probability: Array
    """Probability of k contacts [-]."""

    @property
    def mean(self) -> float:
        """Mean number of contacts."""
        return float(np.sum(self.k * self.probability))

    @property
    def variance(self) -> float:
        """Variance of the number of contacts."""
        return float(np.sum((self.k - self.mean) ** 2 * self.probability))


@checked
def contact_count(
    model: str,
    v_f: float,
    d_f: float,
    fiber_length: float,
    *,
    ratio: float = 1.0,
    length_cv: float = 0.0,
    gamma: float = _NAN,
    k_max: int | None = None,
) -> ContactCount:
    """Distribution of the number of contacts on a fiber, over directions and lengths.

    Parameters
    ----------
    model
        ``"poisson"`` (eq. 3.11) or ``"binomial"`` (eq. 3.13).
    v_f, d_f
        Volume fraction [-] and fiber diameter [m].
    fiber_length
        Mean fiber length [m]; a fiber is straight over this length.
    ratio
        Orientation R = v_f / v_random.
    length_cv
        Coefficient of variation of a gamma distribution of fiber lengths.
    gamma
        Blocked length per contact over d_f (binomial).
    k_max
        Largest number in the result; default: all numbers except for a probability of 1e-12.

    Examples
    --------
    Contacts of a fiber of 1 mm and 25 um:

    >>> from feltmb import fiber
    >>> round(float(fiber.contact_count("poisson", 0.1, 25e-6, 1e-3).mean), 2)
    8.0
    """
    if k_max is None:
        mean = 8 * max(v_f, 0.0) * max(fiber_length, 0.0) / (math.pi * max(d_f, 1e-300))
        widest = mean * (1 + 12 * length_cv + 40 * length_cv**2)
        k_max = int(min(99999, math.ceil(widest + 10 * math.sqrt(widest) + 20)))
    if k_max < 0:
        raise InvalidParameter(f"contact count: k_max = {k_max}, must be >= 0")
    p = _core.contact_count_distribution(
        model,
        k_max,
        v_f=v_f,
        d_f=d_f,
        fiber_length=fiber_length,
        ratio=ratio,
        length_cv=length_cv,
        gamma=gamma,
    )
    return ContactCount(np.arange(k_max + 1), p)


@checked
def free_length_survival(
    model: str,
    x: ArrayLike,
    v_f: float,
    d_f: float,
    *,
    ratio: float = 1.0,
    gamma: float = _NAN,
) -> Array:
    """Probability that the length between two neighboring contacts exceeds x [m].

    ``"poisson"``: exponential, averaged over directions; ``"binomial"``: slots of length gamma d_f.

    Parameters
    ----------
    model
        ``poisson`` or ``binomial``.
    x
        Free lengths [m].
    v_f
        Volume fraction [1].
    d_f
        Fiber diameter [m].
    ratio
        Uniaxial compression of an initially random network [1].
    gamma
        Fiber length that a contact blocks, in diameters [1].
    """
    result: Array = _core.free_length_survival(
        model,
        np.asarray(x, dtype=float),
        v_f=v_f,
        d_f=d_f,
        fiber_length=1.0,
        ratio=ratio,
        gamma=gamma,
    )
    return result
