"""Figures of actuator runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.action.actuator.model import ActuatorRun, degrees
from unmodeled.style import CYCLE, GRAY, NORMAL, head_line, new_figure, side_legend, style_axes

if TYPE_CHECKING:
    from feltmb.action.actuator.matching import Match

#: name -> (label, factor from SI, outputs with their names)
PANELS: dict[str, tuple[str, Mapping[str, str]]] = {
    "angle": ("hub angle [deg]", {"hub.angle": ""}),
    "deflection": ("tip deflection [mm]", {"tip.deflection": ""}),
    "travel": ("tip travel [mm]", {"tip.travel": ""}),
    "finger": ("finger force [N]", {"finger.force": "finger on the key"}),
    "stop": ("stop force [N]", {"stop.force": ""}),
    "forces": (
        "force on the tip [N]",
        {"finger.force": "finger on the key", "stop.force": "stop", "action.force": "action"},
    ),
}


def _shown(run: ActuatorRun, name: str) -> Any:
    unit = run.units[run.names.index(name)]
    values = run[name]
    return degrees(values) if unit == "rad" else 1e3 * values if unit == "m" else values


def compare_runs(
    runs: Mapping[str, ActuatorRun],
    panels: Sequence[str] = ("angle", "deflection", "finger"),
    title: str = "",
    *,
    end: float | None = None,
) -> Any:
    """Plot runs in common axes, with one row for each panel of :data:`PANELS`; ``end`` in s."""
    figure = new_figure(7.4, 0.5 + 2.1 * len(panels))
    axes = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
    for ax, panel in zip(axes, panels, strict=True):
        label, outputs = PANELS[panel]
        for i, (name, run) in enumerate(runs.items()):
            for j, (output, text) in enumerate(outputs.items()):
                one = len(runs) == 1
                ax.plot(
                    1e3 * run.time,
                    _shown(run, output),
                    color=CYCLE[(j if one else i) % len(CYCLE)],
                    linewidth=1.1 if j or len(outputs) == 1 else 2.6,
                    alpha=1.0 if j or len(outputs) == 1 else 0.4,
                    label=text if one else name,
                )
                if output in ("finger.force", "stop.force") and "peak_stop_force" in run.summary:
                    # The largest force of the stop is between two samples; the finger force
                    # includes it.
                    ax.plot(
                        1e3 * run.summary["peak_stop_force_time"],
                        run.summary["peak_stop_force"],
                        marker="_",
                        markersize=7,
                        color=CYCLE[(j if one else i) % len(CYCLE)],
                    )
        style_axes(ax, "", label)
        if len(runs) > 1 or len(outputs) > 1:
            side_legend(ax)
    axes[-1].set_xlabel("time [ms]", fontsize=NORMAL)
    if end is not None:
        axes[-1].set_xlim(0.0, 1e3 * end)
    if title:
        head_line(figure, title, weight="normal")
    return figure


def plot_run(run: ActuatorRun, title: str = "") -> Any:
    """Plot hub angle, tip deflection and forces of one run."""
    return compare_runs({"": run}, ("angle", "deflection", "forces"), title)


def plot_match(found: Match) -> Any:
    """Plot the target, the finger force before and after the fit, and the torque."""
    figure = new_figure(7.4, 4.8)
    axes = figure.subplots(2, 1, sharex=True)
    for values, label, color in (
        (found.force_start, "before", GRAY),
        (found.force, "fitted", CYCLE[0]),
        (found.target, "target", "#000000"),
    ):
        axes[0].plot(1e3 * found.time, values, label=label, color=color, linewidth=1.3)
    axes[0].lines[-1].set_linestyle("--")
    side_legend(axes[0])
    fine = np.linspace(0.0, found.time[-1], 500)
    axes[1].plot(1e3 * fine, found.torque.at(fine), color=CYCLE[1], linewidth=1.3)
    style_axes(axes[0], "", "finger force [N]", f"rms deviation {found.rms:.3g} N, means over 1 ms")
    style_axes(axes[1], "time [ms]", "torque [N m]")
    return figure
