"""Friction hysteresis of a fiber mass: sliding and sticking contacts (thesis 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]


def _area(y: Array, x: Array) -> float:
    return float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(x)))


@dataclass(frozen=True)
class CarnabyPan:
    """One compression loop; arrays over the same volume fractions.

    Loading goes from ``v_f0`` to the last entry, and unloading goes back; both are envelopes.
    """

    v_f: Array
    """Volume fraction [-]."""
    C: Array
    """Mean contact force in the direction of compression [N]; equal in both branches."""
    theta_cr: Array
    """Critical angle [rad]: fibers closer to the compression axis slide."""
    r_sc: Array
    """Proportion of sliding contacts [-]."""
    C_s_loading: Array
    """Mean force of a sliding contact, loading [N]."""
    C_s_unloading: Array
    """Mean force of a sliding contact, unloading [N]."""
    sigma_el: Array
    """Stress of the sticking contacts [Pa]."""
    P_loading: Array
    """Pressure, loading [Pa]."""
    P_unloading: Array
    """Pressure, unloading [Pa]."""
    form: str = "repaired"
    """``"repaired"`` or ``"printed"``."""

    @property
    def loading_work(self) -> float:
        """Work of loading per volume of fiber, the integral of P dv/v^2 [J/m^3]."""
        return _area(self.P_loading / self.v_f**2, self.v_f)

    @property
    def loss(self) -> float:
        """Share of the loading work that is dissipated in the loop [-]."""
        back = _area(self.P_unloading / self.v_f**2, self.v_f)
        return 1.0 - back / self.loading_work


@checked
def critical_angle(w: ArrayLike, mu: float) -> Array:
    """Critical angle of sliding [rad], thesis eq. 3.66.

    Parameters
    ----------
    w
        Ratio of withdrawal force to contact force, Wf0 lambda / C [-].
    mu
        Friction coefficient between fibers [-].

    Returns
    -------
    ndarray
        ``acos(w / sqrt(1 + mu^2)) - atan(mu)``; 0 for w >= 1, where no contact slides. The limit
        for large forces is ``atan(1 / mu)``.
    """
    return np.asarray(_core.critical_angle(np.asarray(w, dtype=float), mu), dtype=float)


def _check_form(where: str, form: str) -> None:
    if form not in ("repaired", "printed"):
        raise InvalidParameter(f'{where}: form = "{form}", must be repaired or printed')


@checked
def carnaby_pan(
    v_f: ArrayLike,
    mu: float,
    Wf0: float,
    E: float,
    d_f: float,
    v_f0: float,
    gamma: float,
    k_bend: float,
    Q: float = 2.0,
    *,
    form: str = "repaired",
) -> CarnabyPan:
    """Loop of a fiber mass with friction between its fibers, for given volume fractions.

    The contact force follows from bending, dC/dv = k_bend E I K_3 / (M_3 lambda^2 v), eq. 3.74
    with the strain of a cell; R = v_f / v_f0 (random without load).

    Parameters
    ----------
    v_f
        Volume fractions [-], increasing, from ``v_f0`` to below 1.
    mu
        Friction coefficient between fibers [-], >= 0.
    Wf0
        Withdrawal force per length of fiber without load [N/m], > 0.
    E
        Young's modulus of the fiber [Pa].
    d_f
        Fiber diameter [m].
    v_f0
        Volume fraction without load [-].
    gamma
        Blocked length per contact divided by the fiber diameter [-].
    k_bend
        Beam constant K_p of eq. 3.74 [-], 24 for clamped ends; not the pressure K_p of eq. 3.64.
    Q
        Constant of eq. 3.15 [-]; 2 for random directions in space.
    form
        ``"repaired"``: both caps of the sphere slide, and C_s is the average over the sliding
        contacts, eqs 3.67 and 3.68. ``"printed"``, for comparison: one cap, no division by the
        proportion, pressure as a sum of increments that is continuous at the reversal (eqs 3.73,
        3.77). Its unloading branch is above its loading branch wherever the sliding forces
        increase.

    Returns
    -------
    CarnabyPan
        Arrays ``C, theta_cr, r_sc, C_s_loading, C_s_unloading, sigma_el, P_loading, P_unloading``.

    Raises
    ------
    InvalidParameter
        Arguments are out of range; all of them are in the message.

    Notes
    -----
    Source: thesis 3.3, eqs 3.58-3.77, after G. A. Carnaby and N. Pan.
    """
    _check_form("carnaby_pan", form)
    v = np.atleast_1d(np.asarray(v_f, dtype=float))
    if v.ndim != 1:
        raise InvalidParameter(f"carnaby_pan: v_f has {v.ndim} dimensions, expected 1")
    loop = _core.carnaby_pan(v, mu, Wf0, E, d_f, v_f0, gamma, k_bend, Q, form)
    return CarnabyPan(**loop, form=form)


@checked
def carnaby_pan_march(
    C: ArrayLike,
    mu: float,
    Wf0: float,
    E: float,
    d_f: float,
    v_f0: float,
    gamma: float,
    k_bend: float,
    Q: float = 2.0,
    *,
    form: str = "repaired",
    substeps: int = 8,
) -> CarnabyPan:
    """Loop of :func:`carnaby_pan` for given contact forces, as in thesis section 3.3.1.

    Parameters
    ----------
    C
        Contact forces [N], increasing, >= 0.
    mu, Wf0, E, d_f, v_f0, gamma, k_bend, Q, form
        As in :func:`carnaby_pan`.
    substeps
        Number of fourth-order Runge-Kutta steps between consecutive forces.

    Returns
    -------
    CarnabyPan
        Loop with the volume fractions ``v_f`` that belong to the forces.
    """
    _check_form("carnaby_pan_march", form)
    c = np.atleast_1d(np.asarray(C, dtype=float))
    if c.ndim != 1:
        raise InvalidParameter(f"carnaby_pan_march: C has {c.ndim} dimensions, expected 1")
    loop = _core.carnaby_pan_march(c, mu, Wf0, E, d_f, v_f0, gamma, k_bend, Q, form, int(substeps))
    return CarnabyPan(**loop, form=form)
