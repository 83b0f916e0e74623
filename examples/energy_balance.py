"""The first impact on a virgin felt from its energy alone: no engine, no integration in time."""

from __future__ import annotations

import numpy as np

from feltmb.contact import Law


def first_impact(felt: Law, mass: float, speed: float) -> dict[str, float]:
    """Largest compression [m] and force [N], rebound speed [m/s] of a mass that strikes a felt.

    The loading is virgin: its work is the kinetic energy. The felt gives back the work of the
    unloading branch from there.
    """
    from scipy.optimize import brentq

    kinetic = 0.5 * mass * speed**2
    top = brentq(lambda e: float(felt.core.stored_energy(e)) - kinetic, 1e-6, 5e-3)
    down = np.linspace(0.0, top, 20001)
    way = np.concatenate([down, down[-2::-1]])
    force = felt.path(way, np.arange(len(way)) * 1e-6)
    returned = -float(np.trapezoid(force[20000:], way[20000:]))
    return {
        "compression": float(top),
        "force": float(force[20000]),
        "rebound": float(np.sqrt(2 * returned / mass)),
    }
