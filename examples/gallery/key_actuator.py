"""The finger force of a motor that presses a felt stop with a flexible arm (thesis, chapter 5).

The arm is a beam on a rotating hub. With a very heavy hub and without a tip mass, its frequency is
that of a cantilever in closed form. The energy balance closes.
"""

import numpy as np
from show import Found, show

from feltmb.action.actuator import load_actuator, simulate_actuator
from unmodeled.style import BLUE, RED, new_figure, style_axes


def compute() -> Found:
    """Both arms under the same torque."""
    wood = load_actuator("wood").with_damper("one-sided", 0.05)
    aluminum = load_actuator("aluminum").with_damper("one-sided", 0.05)
    runs = {
        name: simulate_actuator(a, duration=0.2, output_rate=2e5)
        for name, a in (("wood", wood), ("aluminum", aluminum))
    }
    found = Found("peak force of the wooden finger", runs["wood"].summary["peak_finger_force"], "N")
    found.data["runs"] = runs
    for name, run in runs.items():
        balance = 1.0 + run.energy["residual_relative"]
        found.check(f"{name}: energy accounted for", balance, 1.0, 1e-3)
    # A hub that cannot turn, no tip: Euler and Bernoulli's 1.8751^2 sqrt(EI/m)/L^2.
    arm = wood.with_values({"hub.inertia": 1e3, "tip.mass": 1e-12})
    data = arm.config.arm
    per_length = data.density * data.area
    clamped = (
        1.875104**2
        / (2 * np.pi * data.length**2)
        * np.sqrt(data.young_modulus * data.second_moment / per_length)
    )
    found.check("first frequency, clamped, no tip [Hz]", arm.frequencies(2)[0], clamped, 1e-3)
    return found


def draw(found: Found):
    """Force of the finger by time."""
    figure = new_figure(6.0, 3.2)
    ax = figure.subplots()
    for (name, run), color in zip(found.data["runs"].items(), (BLUE, RED), strict=True):
        ax.plot(1e3 * run.time, run["finger.force"], color=color, linewidth=0.9, label=name)
    ax.legend(frameon=False, fontsize=8)
    peak = found.data["runs"]["aluminum"].summary["peak_finger_force"]
    ax.set_xlim(20, 80)
    title = f"The finger meets its stop: {found.value:.0f} N with wood, {peak:.0f} N with aluminum"
    style_axes(ax, "time [ms]", "force of the finger [N]", title)
    return figure


if __name__ == "__main__":
    show(compute, draw)
