"""The return of a carriage that is pushed against a felt stop.

The first impact meets virgin felt. The compression e follows from the energy: the integral of (F_L
- push) de is the work of the push on the free path. The carriage returns along the unloading
branch from e. The area between the branches is heat.
"""

from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from show import Found, placed, show

import feltmb
from feltmb.contact import law
from unmodeled.style import BLUE, RED, new_figure, style_axes

STOP = Path(__file__).with_name("falling_mass.toml")
PUSH, DISTANCE = 5.0, 0.010  # N, m


def back_by_branches():
    """Distance to which the carriage comes back [m], from the branches alone."""
    felt = law("felt_memory", loading=(5.52e3, 1.58e3, -0.60e3), unloading=(0.19e3, 5.04e3, 3.04e3))
    stored = felt.core.stored_energy
    top = brentq(lambda e: float(stored(e)) - PUSH * (DISTANCE + e), 1e-6, 5e-3)
    down = np.linspace(0.0, top, 8001)
    way = np.concatenate([down, down[-2::-1]])
    force = felt.path(way, np.arange(way.size) * 1e-6)
    returned = -np.trapezoid(force[8000:], way[8000:])
    return (returned - PUSH * top) / PUSH


def compute() -> Found:
    """The carriage is the mass of the other example, lying: no gravity, a push of 5 N."""
    machine = feltmb.load_action(STOP).with_values({"gravity": [0.0, -1e-6]})
    push = feltmb.ramp_stroke(PUSH, 0.0, 1e-6, duration=0.6)
    run = feltmb.simulate(
        machine, push, start=placed(machine, [DISTANCE], [0.0]), rtol=1e-9, output_rate=2e4
    )
    x = run["foot.y"]
    first = int(np.argmax(x < 0.0))
    gone = first + int(np.argmax(x[first:] > 0.0))
    again = gone + int(np.argmax(x[gone:] < 0.0))
    back = x[gone:again].max()
    found = Found("comes back after the first impact to", 1e3 * back, "mm of 10")
    found.data["run"] = run
    found.check("comes back to [m]", back, back_by_branches(), 1e-3)
    found.check("energy accounted for", 1.0 + run.energy["residual_relative"], 1.0, 1e-4)
    return found


def draw(found: Found):
    """Distance by time, and the path in force and compression."""
    run = found.data["run"]
    figure = new_figure(7.0, 3.0)
    left, right = figure.subplots(1, 2)
    left.plot(1e3 * run.time, 1e3 * run["foot.y"], color=BLUE)
    left.axhline(found.value, color=RED, linewidth=0.8, linestyle="--")
    title = f"A felt stop: {found.value:.1f} of 10 mm come back"
    style_axes(left, "time [ms]", "distance from the felt [mm]", title)
    x, force = 1e3 * run["contact01.compression"], run["contact01.force"]
    near = x > 0
    right.plot(x[near], force[near], color=BLUE, linewidth=0.8)
    style_axes(right, "compression [mm]", "force [N]", "Each impact makes its own branch")
    return figure


if __name__ == "__main__":
    show(compute, draw)
