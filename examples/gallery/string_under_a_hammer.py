"""A hammer on a string: until the first echo returns, the string acts as a dashpot of 2 Z.

On a long string F = 2 Z v with the impedance Z = sqrt(T mu), until the wave from the near end
returns after 2 x/c. The string is note 40 of the thesis. A mass of 9 g strikes it at an eighth of
its length. There are 200 modes and no damping.
"""

from pathlib import Path

import numpy as np
from show import Found, placed, show

import feltmb
from unmodeled.style import BLUE, RED, new_figure, style_axes

TENSION, DENSITY, LENGTH = 654.0, 5.98e-3, 0.6315  # N, kg/m, m
STRIKE, SPEED = LENGTH / 8.0, 2.0  # m, m/s
MACHINE = Path(__file__).with_name("hammer_and_string.toml")


def compute() -> Found:
    """The impact, with the string's motion at the struck place from its modes."""
    action = feltmb.load_action(MACHINE).with_values({"string.damping_ratio": 0.0})
    run = feltmb.simulate(
        action,
        feltmb.ramp_stroke(0.0, duration=0.006),
        start=placed(action, [-1e-9], [SPEED]),
        rtol=1e-8,
        output_rate=2e5,
    )
    force = run["contact01.force"]
    touching = run.time[force > 0.0]
    string = run["nose.x"] - run["contact01.compression"]  # while they touch
    speed = np.gradient(string, run.time)
    echo = 2.0 * STRIKE / np.sqrt(TENSION / DENSITY)
    early = (run.time > 0.3 * echo) & (run.time < 0.9 * echo)
    impedance = float((force[early] * speed[early]).sum() / (speed[early] ** 2).sum())
    found = Found("hammer and string touch for", 1e3 * (touching[-1] - touching[0]), "ms")
    found.data.update(run=run, echo=echo, speed=speed)
    found.check("force over speed [kg/s]", impedance, 2.0 * np.sqrt(TENSION * DENSITY), 0.03)
    return found


def draw(found: Found):
    """Force, and what the dashpot of the long string would give."""
    run, echo, speed = (found.data[k] for k in ("run", "echo", "speed"))
    figure = new_figure(6.0, 3.2)
    ax = figure.subplots()
    t = 1e3 * run.time
    near = run["contact01.force"] > 0.0
    ax.plot(t, run["contact01.force"], color=BLUE, label="force of the hammer")
    dashpot = 2.0 * np.sqrt(TENSION * DENSITY) * speed
    ax.plot(t[near], dashpot[near], color=RED, linewidth=0.9, label="2 Z times the string's speed")
    ax.axvline(1e3 * echo, color=RED, linewidth=0.7, linestyle="--")
    ax.text(1e3 * echo, 0.0, " first echo", fontsize=8, color=RED, va="bottom")
    ax.legend(frameon=False, fontsize=8)
    title = f"Until the echo a string is a dashpot; they touch for {found.value:.1f} ms"
    style_axes(ax, "time [ms]", "force [N]", title)
    return figure


if __name__ == "__main__":
    show(compute, draw)
