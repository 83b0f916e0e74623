"""The rebound speed of a ball on a damped spring and on felt.

The loss of a Hunt-Crossley contact, F = k e^p (1 + d v), increases with the impact speed: (1 + d
v0)/(1 - d v1) = exp(d (v0 + v1)). The loss of felt with memory depends on the largest compression
and not on the speed: v1^2/v0^2 = W_U/W_L of its branches.
"""

import numpy as np
from scipy.optimize import brentq
from show import Found, show

from feltmb.contact import law
from unmodeled.style import BLUE, RED, new_figure, style_axes

MASS, DAMPING = 9e-3, 0.4  # kg, s/m
SPEEDS = np.array([0.25, 0.5, 1.0, 2.0, 3.0])  # m/s


def damped_spring():
    """Law that loses by speed."""
    return law("hunt_crossley", stiffness=2e6, exponent=1.5, damping=DAMPING)


def felt():
    """Law that loses by depth."""
    return law("felt_memory", loading=(5.52e3, 1.58e3, -0.60e3), unloading=(0.19e3, 5.04e3, 3.04e3))


def rebound(contact, speed, step=2e-7):
    """Speed after the impact [m/s]; midpoint rule, the force of the law at the new place."""
    x, v = 0.0, speed
    state = contact.state
    while x >= 0.0:
        middle = float(contact.force(x + 0.5 * step * v, v, state))
        v -= step * middle / MASS
        x += step * v
    return -v


def rebound_of_felt(contact, speed, step=1e-6):
    """The same of a law with memory."""
    x, v = 0.0, speed
    while x >= 0.0:
        v -= step * contact.step(x, step) / MASS
        x += step * v
    return -v


def by_formula(speed):
    """Rebound of Hunt-Crossley [m/s]."""
    d = DAMPING

    def excess(u):
        return np.log1p(d * speed) - np.log1p(-d * u) - d * (speed + u)

    return brentq(excess, 1e-9, min(speed, (1.0 - 1e-9) / d))


def by_branches(speed):
    """Rebound of the felt from its branches [m/s]."""
    contact = felt()
    kinetic = 0.5 * MASS * speed**2
    top = brentq(lambda e: float(contact.core.stored_energy(e)) - kinetic, 1e-7, 5e-3)
    down = np.linspace(0.0, top, 4001)
    way = np.concatenate([down, down[-2::-1]])
    force = contact.path(way, np.arange(way.size) * 1e-6)
    return np.sqrt(-2.0 * np.trapezoid(force[4000:], way[4000:]) / MASS)


def compute() -> Found:
    """Rebound over speed at five speeds."""
    spring = np.array([rebound(damped_spring(), v, 1e-6) for v in SPEEDS]) / SPEEDS
    wool = np.array([rebound_of_felt(felt(), v) for v in SPEEDS]) / SPEEDS
    found = Found("felt, rebound over speed at 1 m/s", float(wool[2]), "")
    found.data.update(spring=spring, wool=wool)
    for i in (0, 2, 4):
        v = SPEEDS[i]
        found.check(f"damped spring at {v:g} m/s", spring[i], by_formula(v) / v, 3e-3)
        found.check(f"felt at {v:g} m/s", wool[i], by_branches(v) / v, 1e-3)
    return found


def draw(found: Found):
    """Rebound against speed."""
    figure = new_figure(5.5, 3.2)
    ax = figure.subplots()
    fine = np.linspace(0.05, 3.0, 60)
    ax.plot(fine, [by_formula(v) / v for v in fine], color=RED, linewidth=1)
    ax.plot(fine, [by_branches(v) / v for v in fine], color=BLUE, linewidth=1)
    ax.plot(SPEEDS, found.data["spring"], "o", color=RED, label="damped spring (Hunt-Crossley)")
    ax.plot(SPEEDS, found.data["wool"], "o", color=BLUE, label="felt that remembers")
    ax.set_ylim(0, 1)
    ax.legend(frameon=False, fontsize=8)
    style_axes(ax, "speed [m/s]", "rebound over speed", "Dots: simulated; lines: closed forms")
    return figure


if __name__ == "__main__":
    show(compute, draw)
