"""The first force peak of a mass that falls on a felt pad follows from the energy alone.

The law of the pad is `felt_memory`. Its loading on virgin felt is F = a e exp(b e) + c e. The work
of gravity, m g (h + e) = a/b^2 ((b e - 1) exp(b e) + 1) + c e^2/2, gives the largest compression
and force.
"""

import math
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from show import Found, placed, show

import feltmb
from unmodeled.style import BLUE, RED, new_figure, style_axes

PAD = Path(__file__).with_name("falling_mass.toml")
MASS, HEIGHT, GRAVITY = 0.2, 0.05, 9.81  # kg, m, m/s^2
A, B, C = 5.52e3, 1.58e3, -0.60e3  # N/m, 1/m, N/m


def force(e):
    """Of the virgin felt [N]."""
    return A * e * np.exp(B * e) + C * e


def work(e):
    """Its integral [J]."""
    return A / B**2 * ((B * e - 1.0) * math.exp(B * e) + 1.0) + 0.5 * C * e**2


def compute() -> Found:
    """Simulate the fall and hold it against the balance."""
    machine = feltmb.load_action(PAD)
    start = placed(machine, [HEIGHT], [0.0])
    free = feltmb.ramp_stroke(0.0, duration=0.6)
    run = feltmb.simulate(machine, free, start=start, rtol=1e-9, output_rate=5e4)
    top = brentq(lambda e: work(e) - MASS * GRAVITY * (HEIGHT + e), 1e-6, 5e-3)
    found = Found("peak force", float(run["contact01.force"].max()), "N", {"run": run, "top": top})
    found.check("peak force [N]", found.value, force(top), 2e-4)
    found.check("compression [m]", float(run["contact01.compression"].max()), top, 2e-4)
    return found


def draw(found: Found):
    """Height and force by time, the peak by energy as a line."""
    run = found.data["run"]
    figure = new_figure(7.0, 3.0)
    left, right = figure.subplots(1, 2)
    t = 1e3 * run.time
    left.plot(t, 1e3 * run["foot.y"], color=BLUE)
    style_axes(
        left, "time [ms]", "height [mm]", "It bounces: each impact costs a third of the energy"
    )
    near = run["contact01.compression"] > 0
    right.plot(1e3 * run["contact01.compression"][near], run["contact01.force"][near], color=BLUE)
    right.axhline(force(found.data["top"]), color=RED, linewidth=0.8, linestyle="--")
    title = f"Peak {found.value:.0f} N; dashed: by energy"
    style_axes(right, "compression [mm]", "force [N]", title)
    return figure


if __name__ == "__main__":
    show(compute, draw)
