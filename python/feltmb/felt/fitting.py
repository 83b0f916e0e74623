"""A felt from the loop of a contact, if only force and compression are known.

The two-step procedure (:func:`feltmb.felt.identify`) needs a specimen, i.e. pressure as a function
of volume fraction. A loop that was measured at a contact, for example the curve fits of Table A.12,
gives force as a function of compression. Pressure and volume fraction follow from the area and the
thickness, and the friction from an assumed share.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb import _core
from feltmb.contact.layer import Area
from feltmb.fiber.material import Branch, FeltMaterial
from feltmb.mechanism import Contact, core_law
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]


#: Largest gamma v_f at the end of a loop; above it, pressure grows faster than for any felt (e^24
#: at Q = 2).
_MOST_STEEP = 4.0


@dataclass(frozen=True)
class ContactFit:
    """Result of :func:`fit_contact`."""

    material: FeltMaterial
    thickness: float
    """Thickness without load [m], given or fitted."""
    rms_loading: float
    """Root mean square residual of loading relative to the largest force [-]."""
    rms_unloading: float
    """Root mean square residual of unloading relative to the largest force [-]."""
    friction_share: float
    """Ratio of friction to pressure in loading, at half of the largest force [-]."""
    compression: Array
    """Compression [m]."""
    loading: Array
    """Fitted loop: force of loading [N]."""
    unloading: Array
    """Fitted loop: force of unloading [N]."""
    fitted_loading: Array
    """Loop of the felt: force of loading [N]."""
    fitted_unloading: Array
    """Loop of the felt: force of unloading [N]."""
    warnings: tuple[str, ...] = ()


@checked
def contact_loop(contact: object, *, name: str, points: int = 80) -> tuple[Array, Array, Array]:
    """Loop of a contact, if it has one: compression [m], loading and unloading force [N].

    For the curve fits of eq. 4.21, the loop ends where the branches meet. Unloading is limited to
    values between 0 and loading and is otherwise unchanged.

    Parameters
    ----------
    contact
        Contact of a mechanism.
    name
        Name of the contact in messages.
    points
        Number of points of each branch.

    Raises
    ------
    InvalidParameter
        The contact has no loop.
    """
    if not isinstance(contact, Contact) or contact.loading is None or contact.unloading is None:
        raise InvalidParameter(
            f"{name}: has no loading and unloading curves; expected a contact with the fits of "
            "eq. 4.21, such as steinway45:06"
        )
    envelope = core_law(contact.model_copy(update={"law": "felt_memory"})).fields["envelope"]
    e = envelope.closing * np.linspace(0.0, 1.0, points + 1)[1:]
    load = np.asarray(envelope.loading(e), dtype=float)
    curve = contact.unloading
    back = np.asarray(_core.ExponentialCurve(curve.a, curve.b, curve.c).force(e), dtype=float)
    return e, load, np.clip(back, 0.0, load)


def _withdrawal(
    base: FeltMaterial, branch: Branch, v_half: float, share: float
) -> tuple[float, float]:
    """Withdrawal force for a share of friction at one volume fraction, and the actual share.

    The share is small when few contacts slide, and also when the withdrawal force is small. Of two
    forces with the same share, the smaller one is returned, with which sliding starts early.
    """
    from scipy.optimize import brentq

    def excess(log_force: float) -> float:
        felt = _with(base, branch, branch, 10.0**log_force, v_half * (1 + 1e-9))
        row = felt.branch("loading", [v_half])
        return float(row.friction[0] / row.pressure[0]) - share

    scale = math.log10(branch.K_p * base.fiber.diameter)
    grid = scale + np.linspace(-7.0, 1.0, 17)
    values = [excess(x) for x in grid]
    above = next((i for i, value in enumerate(values) if value > 0), None)
    if not above:
        best = int(np.argmax(values))
        return 10.0 ** float(grid[best]), values[best] + share
    return 10.0 ** float(brentq(excess, grid[above - 1], grid[above], xtol=1e-9)), share


def _with(
    base: FeltMaterial, loading: Branch, unloading: Branch, withdrawal: float, v_f_max: float
) -> FeltMaterial:
    fiber = base.fiber.model_copy(update={"withdrawal_force": withdrawal})
    return base.model_copy(
        update={
            "fiber": fiber,
            "loading": loading,
            "unloading": unloading,
            "v_f_max": v_f_max,
            "critical_angles": None,
        }
    )


def _loop_faults(e: Array, load: Array, back: Array) -> Iterator[str]:
    """Why compressions and forces are no loop."""
    if not (len(e) == len(load) == len(back) and len(e) >= 8):
        yield f"got {len(e)} compressions, {len(load)} and {len(back)} forces, expected equal, >= 8"
    elif not (np.isfinite([e, load, back]).all() and e[0] > 0 and np.all(np.diff(e) > 0)):
        yield "compression must be finite, > 0 and grow"
    elif not load.max() > 0:
        yield "loading force must be > 0 somewhere"


def _with_unloading(
    felt: FeltMaterial, v: Array, surface: Array, back: Array, top: float
) -> tuple[FeltMaterial, bool]:
    """Felt with the elastic law of unloading that fits its forces; whether it is at a limit."""
    from scipy.optimize import least_squares

    assert felt.loading is not None
    base = felt.loading

    def unloading_of(x: Array) -> FeltMaterial:
        branch = Branch(K_p=math.exp(x[0]), gamma=math.exp(x[1]))
        return felt.with_branches(base, branch, float(v[-1]))

    def rest(x: Array) -> Array:
        # The end of the loop has the weight of ten samples: there the branches meet.
        out = (surface * unloading_of(x).pressure("unloading", v) - back) / top
        return np.append(out, 3.0 * out[-1])

    steepest = _MOST_STEEP / float(v[-1])
    fits = [
        least_squares(
            rest,
            [math.log(base.K_p * factor), math.log(min(base.gamma * stretch, 0.99 * steepest))],
            bounds=([-20.0, math.log(0.05)], [60.0, math.log(steepest)]),
        )
        for factor, stretch in ((0.3, 1.3), (0.05, 2.5), (0.005, 4.0))
    ]
    chosen = min(fits, key=lambda f: float(f.cost))
    return unloading_of(chosen.x), bool(any(chosen.active_mask))


@checked
def fit_contact(
    compression: ArrayLike,
    loading: ArrayLike,
    unloading: ArrayLike,
    area: Area,
    *,
    fibers: FeltMaterial,
    thickness: float | None = None,
    gamma: float = math.pi / 2,
    friction_share: float = 0.1,
    name: str = "felt",
    about: str = "",
) -> ContactFit:
    """Find a felt whose layer has the loop of a contact.

    Loading: least squares in force for ``K_p`` and the thickness, where ``gamma`` is fixed at its
    geometric value pi/2 (random fibers); with a given thickness, for ``K_p`` and ``gamma``. The
    withdrawal force follows from the share of friction. Unloading: least squares for its ``K_p``
    and ``gamma`` with the same friction.

    Parameters
    ----------
    compression, loading, unloading
        The loop [m, N, N], from a compression > 0 to its end, increasing.
    area
        Area law of the contact.
    fibers
        Felt with the data of the fibers and ``v_f0``; its elastic laws are not used.
    thickness
        Thickness without load [m]; fitted if not given.
    gamma
        gamma of loading if the thickness is fitted [-].
    friction_share
        Ratio of friction to pressure in loading at half of the largest force [-], in (0, 1).

    Returns
    -------
    ContactFit
        The felt, the thickness and the residuals. ``warnings`` names values at a limit.

    Raises
    ------
    InvalidParameter
        Arguments are invalid; all of them are in the message.
    """
    from scipy.optimize import minimize_scalar

    e, load, back = (np.asarray(x, dtype=float).ravel() for x in (compression, loading, unloading))
    v0 = fibers.v_f0
    given = {"thickness": thickness, "gamma": gamma}
    faults = [*_loop_faults(e, load, back)]
    faults += [
        f"{what} = {value:g}, must be finite and > 0"
        for what, value in given.items()
        if value is not None and not (math.isfinite(value) and value > 0)
    ]
    if not 0 < friction_share < 1:
        faults.append(f"friction_share = {friction_share:g}, must be > 0 and < 1")
    if not faults and thickness is not None and not e[-1] / thickness < 1.0 - v0 / 0.98:
        faults.append(
            f"thickness = {thickness:g} m, must be > {e[-1] / (1.0 - v0 / 0.98):.6g} m: the loop "
            f"ends at {e[-1]:.6g} m, where v_f stays below 0.98"
        )
    if faults:
        raise InvalidParameter("\n".join(f"fit_contact: {fault}" for fault in faults))
    surface = area.area(e)
    top = float(load.max())
    half = int(np.searchsorted(load, 0.5 * load[-1]))

    def fit_loading(h: float, g: float) -> tuple[FeltMaterial, float, Array]:
        v = v0 / (1.0 - e / h)
        one = Branch(K_p=1e6, gamma=g)
        withdrawal, share = _withdrawal(fibers, one, float(v[half]), friction_share)
        felt = _with(fibers, one, one, withdrawal, float(v[-1]))
        force = surface * felt.pressure("loading", v)
        # Pressure is linear in K_p and the withdrawal force together.
        factor = float(force @ load / (force @ force))
        branch = Branch(K_p=1e6 * factor, gamma=g)
        return (
            _with(fibers, branch, branch, withdrawal * factor, float(v[-1])),
            share,
            force * factor,
        )

    def left(x: float) -> float:
        h, g = (e[-1] / x, gamma) if thickness is None else (thickness, math.exp(x))
        return float(np.mean((fit_loading(h, g)[2] - load) ** 2)) / top**2

    if thickness is None:
        low, high = 0.03, 1.0 - v0 / min(0.9, 5.0 * v0)  # strain
    else:
        low, high = math.log(0.2), math.log(_MOST_STEEP * (1.0 - e[-1] / thickness) / v0)
    grid = np.linspace(low, high, 24)
    best = int(np.argmin([left(float(x)) for x in grid]))
    bracket = (float(grid[max(best - 1, 0)]), float(grid[min(best + 1, 23)]))
    found = float(minimize_scalar(left, bounds=bracket, method="bounded").x)
    warnings = []
    if best in (0, 23):
        what = "strain at the end of the loop" if thickness is None else "gamma of loading"
        warnings.append(f"{what} is at the end of its range: the loop does not determine it")
    h, g = (e[-1] / found, gamma) if thickness is None else (thickness, math.exp(found))
    felt, share, force = fit_loading(h, g)
    if share < 0.99 * friction_share:
        warnings.append(f"friction reaches {100 * share:.3g} % of the pressure only")
    v = v0 / (1.0 - e / h)
    made, bounded = _with_unloading(felt, v, surface, back, top)
    if bounded:
        warnings.append("the elastic law of unloading is at the end of its range")
    made = made.model_copy(update={"name": name, "about": about, "source": {}})
    back_fit = surface * made.pressure("unloading", v)
    return ContactFit(
        material=made,
        thickness=h,
        rms_loading=math.sqrt(float(np.mean((force - load) ** 2))) / top,
        rms_unloading=math.sqrt(float(np.mean((back_fit - back) ** 2))) / top,
        friction_share=share,
        compression=e,
        loading=load,
        unloading=back,
        fitted_loading=force,
        fitted_unloading=back_fit,
        warnings=tuple(warnings),
    )
