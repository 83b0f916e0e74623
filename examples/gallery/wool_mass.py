"""Compression and release of a wool mass: van Wyk's law, and the loss by friction.

Van Wyk's law is P = k E (v^3 - v0^3). The loop results from fibers that slide on each other
(thesis eq. 3.65). If no fiber slides, there is no loop.
"""

import numpy as np
from show import Found, show

from feltmb import fiber
from unmodeled.style import BLUE, GREEN, RED, new_figure, style_axes

V0, E, DIAMETER = 0.132, 2.5e9, 25e-6  # -, Pa, m
SLIDING = {"mu": 0.35, "E": E, "d_f": DIAMETER, "v_f0": V0, "gamma": 1.3, "k_bend": 0.64}


def compute() -> Found:
    """Three laws over the same range."""
    v = np.linspace(V0, 0.33, 400)
    loop = fiber.carnaby_pan(v, Wf0=0.8, **SLIDING)
    stuck = fiber.carnaby_pan(v, Wf0=1e6, **SLIDING)
    cube = fiber.pressure("van_wyk", v, k_p=0.00195, E=E, v_f0=V0)
    found = Found("work lost in a wool mass", 100 * loop.loss, "%")
    found.data.update(v=v, loop=loop, stuck=stuck, cube=cube)
    # Work per volume of fiber: integral of P dv/v^2, both ways.
    up = np.trapezoid(loop.P_loading / v**2, v)
    down = np.trapezoid(loop.P_unloading / v**2, v)
    found.check("work lost, from the branches", loop.loss, 1.0 - down / up, 2e-3)
    found.check("van Wyk at the end [Pa]", cube[-1], 0.00195 * E * (v[-1] ** 3 - V0**3), 1e-9)
    found.check("what comes back if no fiber slides", 1.0 - stuck.loss, 1.0, 1e-9)
    return found


def draw(found: Found):
    """Pressure against volume fraction."""
    v, loop = found.data["v"], found.data["loop"]
    figure = new_figure(5.5, 3.4)
    ax = figure.subplots()
    ax.fill_between(v, 1e-3 * loop.P_unloading, 1e-3 * loop.P_loading, color=BLUE, alpha=0.15)
    ax.plot(v, 1e-3 * loop.P_loading, color=BLUE, label="sliding fibers, loading")
    ax.plot(v, 1e-3 * loop.P_unloading, color=RED, label="sliding fibers, unloading")
    ax.plot(v, 1e-3 * found.data["cube"], color=GREEN, linewidth=1, label="van Wyk, no loss")
    ax.legend(frameon=False, fontsize=8)
    title = f"Friction takes {found.value:.0f} % of the work"
    style_axes(ax, "volume fraction [-]", "pressure [kPa]", title)
    return figure


if __name__ == "__main__":
    show(compute, draw)
