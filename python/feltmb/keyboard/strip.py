"""A strip of all keys at true length, with the places of the leads to be added."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from feltmb.keyboard.balance import Balance

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: Width of a key in the strip: an octave of 164.5 mm by 12; edges and span along a key [mm].
PITCH, EDGE = 164.5 / 12, 12.0
BEHIND, BEFORE = 215.0, 235.0
INCH = 25.4


def draw_strip(balance: Balance, work: pd.DataFrame) -> Figure:
    """Strip to be printed at true size: keys side by side, the balance pin, the leads of a list.

    Distances along the keys are those of the list. The keys are drawn with one width.

    Parameters
    ----------
    balance
        Weights that were analyzed.
    work
        What :func:`list_of_work` returned.
    """
    from matplotlib.patches import Circle, Rectangle

    from unmodeled.style import BLUE, GRAY, ORANGE, PALE, new_figure

    count = len(balance.frame)
    leads = work[work["part"] == "lead"]
    behind = BEHIND if (leads["place"] < 0).any() else 3 * EDGE
    width, height = count * PITCH + 2 * EDGE, behind + BEFORE + 2 * EDGE
    figure = new_figure(width / INCH, height / INCH)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-EDGE, width - EDGE), ylim=(BEFORE + EDGE, -behind - EDGE))
    axes.axis("off")
    for place, (key, row) in enumerate(balance.frame.iterrows()):
        left = place * PITCH
        axes.add_patch(
            Rectangle((left, -behind), PITCH, behind + BEFORE, lw=0.5, edgecolor=GRAY,
                      facecolor=PALE if row["sharp"] else "white")
        )  # fmt: skip
        for y in (BEFORE - 4.0, -behind + 8.0):
            axes.text(left + PITCH / 2, y, f"{key}\n{row['note']}", ha="center", va="center",
                      fontsize=7)  # fmt: skip
    axes.plot([0.0, count * PITCH], [0.0, 0.0], color=GRAY, lw=0.8)
    axes.text(0.0, -1.0, "balance pin", fontsize=7, va="bottom", ha="left")
    for lead in leads.itertuples():
        x, y = (lead.key - 0.5) * PITCH, 1e3 * lead.place
        added = lead.change > 0
        # A lead of that mass with the length of a key's width of 10 mm: density 11.3 g/cm3.
        radius = math.sqrt(1e3 * abs(lead.change) / (11.3 * 10.0 * math.pi))
        axes.add_patch(Circle((x, y), radius, fill=added, color=BLUE if added else ORANGE))
        times = f"{lead.count:.0f} x " if lead.count > 1 else ""
        axes.text(x, y + radius + 1.0, f"{times}{lead.change:+.1f} g\n{abs(y):.0f}", fontsize=6,
                  ha="center", va="top")  # fmt: skip
    axes.plot([0.0, 100.0], [BEFORE + 6.0] * 2, color="black", lw=1.0)
    axes.text(102.0, BEFORE + 6.0, f"100 mm at true size. {balance.keyboard.name}: filled, lead to "
              "be added; ring, to be taken out, or added as far behind the pin; mass and distance "
              "from the balance pin in mm", fontsize=8, va="center")  # fmt: skip
    return figure
