"""Contribution of each part of the model to the string force: one part is omitted at a time."""

from show import Found, show

import feltmb
from unmodeled.style import BLUE, GRAY, new_figure, style_axes

PARTS = {
    "all parts": {},
    "rigid shank": {"shank.rigid": True},
    "rigid backcheck wire": {"wire.rigid": True},
    "string does not yield": {"string.kind": "rigid_stop"},
    "felt without memory": {"contacts.*.law": "mean"},
    "jack slips without friction": {"contacts.04.friction.amplitude": 0.0},
}


def compute() -> Found:
    """A forte impact for each."""
    action = feltmb.load_action("steinway45")
    forces = {}
    for name, values in PARTS.items():
        run = feltmb.simulate(action.with_values(values), "forte", ledger=False)
        forces[name] = run.summary["max_impact_force"]
    share = forces["string does not yield"] / forces["all parts"]
    found = Found("force on a string that does not yield, over that on the string", share, "")
    found.data["forces"] = forces
    # Felt on a wall: energy of the hammer, as the string takes nothing.
    again = feltmb.simulate(
        action.with_values(PARTS["string does not yield"]), "forte", rtol=1e-8, ledger=False
    )
    found.check(
        "force on the stop, tighter [N]",
        forces["string does not yield"],
        again.summary["max_impact_force"],
        2e-3,
    )
    return found


def draw(found: Found):
    """Bars of the largest force."""
    forces = found.data["forces"]
    figure = new_figure(6.5, 2.8)
    ax = figure.subplots()
    names = list(forces)[::-1]
    ax.barh(
        names,
        [forces[n] for n in names],
        color=[BLUE if n == "all parts" else GRAY for n in names],
        height=0.6,
    )
    for i, name in enumerate(names):
        ax.text(
            forces[name],
            i,
            f" {forces[name]:.1f}" if forces[name] else " no impact: it leaves too early",
            va="center",
            fontsize=8,
        )
    style_axes(ax, "largest force on the string, forte [N]", "", "Leave one part out")
    return figure


if __name__ == "__main__":
    show(compute, draw)
