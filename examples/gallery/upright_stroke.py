"""A soft impact of the upright action: finger, let-off, string, check.

The stroke is the piano impact of the thesis. The impact speed is converged, and the energy balance
closes.
"""

from show import Found, show

import feltmb
from unmodeled.style import BLUE, GREEN, RED, new_figure, style_axes


def compute() -> Found:
    """One stroke, at two tolerances."""
    run = feltmb.simulate("steinway45", "piano")
    fine = feltmb.simulate("steinway45", "piano", rtol=1e-8, ledger=False)
    found = Found("impact speed, of the contact", run.summary["impact_speed"], "m/s")
    found.data["run"] = run
    found.check("impact speed, tighter [m/s]", found.value, fine.summary["impact_speed"], 1e-3)
    found.check("energy accounted for", 1.0 + run.energy["residual_relative"], 1.0, 1e-4)
    return found


def draw(found: Found):
    """Travel of key and hammer, force of the string."""
    run = found.data["run"]
    figure = new_figure(6.5, 3.4)
    ax = figure.subplots()
    t = 1e3 * run.time
    for name, label, color in (("key_front.y", "key", GREEN), ("hammer_tip.x", "hammer", BLUE)):
        ax.plot(t, 1e3 * (run[name] - run[name][0]), color=color, label=label)
    events = run.events.set_index("event")["time"]
    for place, (name, label) in enumerate(
        (
            ("key_start", "key starts"),
            ("damper_start", "damper starts"),
            ("string_contact_on", "string"),
        )
    ):
        if name in events:
            ax.axvline(1e3 * events[name], color=RED, linewidth=0.7, linestyle="--")
            ax.text(
                1e3 * events[name],
                -46 + 4 * place,
                f" {label} ",
                color=RED,
                fontsize=8,
                ha="right" if place == 1 else "left",
            )
    ax.set_xlim(80, 340)
    ax.legend(frameon=False, fontsize=8)
    title = f"The hammer meets the string at {found.value:.2f} m/s"
    style_axes(ax, "time [ms]", "travel [mm]", title)
    return figure


if __name__ == "__main__":
    show(compute, draw)
