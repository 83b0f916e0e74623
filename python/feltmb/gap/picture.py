"""Figure of a report for notebooks; the command line has figures of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feltmb.gap.findings import Findings
from feltmb.style import BLUE, GRAY, ORANGE, SMALL, new_figure, side_legend, style_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["held_out_gaps"]


def held_out_gaps(report: Findings) -> Figure:
    """Bars of the gap of each channel on held-out records, in units of its noise."""
    rows = [r for r in report.how_far.rows if r.metric == report.how_far.metric]
    figure = new_figure(7.4, 1.2 + 0.55 * max(1, len(rows)))
    ax = figure.add_subplot()
    stages = (
        ("as tabulated", [r.tabulated / r.noise for r in rows], GRAY),
        ("calibrated", [r.before / r.noise for r in rows], ORANGE),
        ("with named effects", [r.after / r.noise for r in rows], BLUE),
    )
    for k, (label, gaps, color) in enumerate(stages):
        places = [i + 0.26 * (k - 1) for i in range(len(rows))]
        ax.barh(places, gaps, height=0.24, color=color, label=label)
    ax.axvline(1.0, color="black", linewidth=0.8)
    ax.set_yticks(range(len(rows)), [r.channel for r in rows])
    ax.invert_yaxis()
    side_legend(ax, fontsize=SMALL)
    title = f"Held-out gap ({report.how_far.metric}) of each channel; the line is the noise"
    style_axes(ax, "gap / noise [1]", "", title)
    return figure
