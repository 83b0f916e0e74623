"""Common parts of the axes of runs: titles, event marks, limits of a time window."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from feltmb.graphics.plot.readings import marked_events, named_events, run_name
from unmodeled.style import GRAY, SMALL, head_line, plain_text, spread_apart

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feltmb.run.results import Run


def head_title(figure: Figure, run: Run, what: str) -> None:
    """Title of a figure: its content and its run."""
    name = run_name(run)
    head_line(figure, f"{what}: {name}" if name else what)


def mark_events(
    ax: Axes,
    run: Run,
    window: tuple[float, float],
    *,
    width: float,
    labels: bool = True,
    only: Iterable[str] | None = None,
) -> None:
    """Draw thin lines at the named events, with names above the axes that do not overlap.

    In a run with several notes, the lines are at the strikes.

    ``window`` in s; ``width`` of the axes in inches, which determines the distance of the names.
    """
    chosen = None if only is None else set(only)
    low, high = window
    events = [
        (t, name)
        for t, name in (marked_events(run) if only is None else named_events(run))
        if low <= t <= high and (chosen is None or name in chosen)
    ]
    if not events:
        return
    fractions = [(t - low) / (high - low) for t, _ in events]
    gap = 1.3 * SMALL / 72.0 / width
    shift = spread_apart(fractions, gap)
    over = shift[-1] - 1.0
    if over > 0:
        shift = spread_apart(
            [min(s, 1.0 - (len(shift) - 1 - i) * gap) for i, s in enumerate(shift)], gap
        )
    for (time, name), x, place in zip(events, fractions, shift, strict=True):
        ax.axvline(1e3 * time, color=GRAY, linewidth=0.6, linestyle=(0, (3, 2)), zorder=1)
        if not labels:
            continue
        ax.plot(
            [x, place, place],
            [1.0, 1.035, 1.045],
            transform=ax.transAxes,
            color=GRAY,
            linewidth=0.6,
            clip_on=False,
        )
        ax.text(
            place,
            1.055,
            plain_text(name.replace("_", " ")),
            transform=ax.transAxes,
            rotation=90,
            ha="center",
            va="bottom",
            fontsize=SMALL,
            color="#444444",
        )


def set_window(ax: Axes, window: tuple[float, float]) -> None:
    """Set the limits of time [s], and of the ordinate from the visible curves."""
    ax.set_xlim(1e3 * window[0], 1e3 * window[1])
    low, high = math.inf, -math.inf
    for line in ax.get_lines():
        x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        if x.size < 3 or line.get_transform() != ax.transData:
            continue
        seen = y[(x >= 1e3 * window[0]) & (x <= 1e3 * window[1])]
        seen = seen[np.isfinite(seen)]
        if seen.size:
            low, high = min(low, float(seen.min())), max(high, float(seen.max()))
    if high >= low:
        pad = 0.06 * (high - low) or max(1e-9, 0.1 * abs(high))
        ax.set_ylim(low - pad, high + pad)


def panel_grid(figure: Figure, count: int, columns: int) -> list[Axes]:
    """Axes of ``count`` panels with ``columns`` panels in a row."""
    rows = -(-count // columns)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes[count:]:
        ax.set_visible(False)
    return list(axes[:count])
