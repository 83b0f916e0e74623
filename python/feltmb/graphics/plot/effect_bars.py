"""Figure of the influence of small parameter changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from unmodeled.arguments import checked
from unmodeled.style import BLUE, ORANGE, new_figure, reader_unit, style_axes

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@checked
def effects(change: pd.Series, unit: str) -> Figure:
    """Bars of the change caused by one percent more of each parameter, sorted by size.

    Parameters
    ----------
    change
        Changes by parameter, SI units; the name of the series is the name of the value.
    unit
        SI unit of the value.
    """
    factor, shown = reader_unit(unit)
    figure = new_figure(6.4, 1.2 + 0.2 * len(change))
    ax = figure.add_subplot()
    values = [factor * float(v) for v in change]
    colors = [BLUE if v >= 0 else ORANGE for v in values]
    ax.barh(range(len(values)), values, color=colors, height=0.7)
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.set_yticks(range(len(values)), [str(name) for name in change.index])
    ax.invert_yaxis()
    title = f"{str(change.name).replace('_', ' ')}: change for 1 % more of each parameter"
    style_axes(ax, f"change [{shown}]", "", title)
    return figure
