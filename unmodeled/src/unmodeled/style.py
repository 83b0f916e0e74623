"""Style of the figures: colors, sizes, units for people, axes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text


__all__ = [
    "BLACK",
    "BLUE",
    "CYCLE",
    "DPI",
    "FILLS",
    "GRAY",
    "GREEN",
    "INK",
    "LARGE",
    "NORMAL",
    "ORANGE",
    "PAD",
    "PALE",
    "PURPLE",
    "RAIL",
    "READER_UNITS",
    "RED",
    "SKY",
    "SMALL",
    "SURFACE",
    "YELLOW",
    "body_fill",
    "fit_text",
    "head_line",
    "new_figure",
    "plain_text",
    "reader_unit",
    "side_legend",
    "spread_apart",
    "style_axes",
]

#: Colors of Okabe and Ito, which are distinct for all common types of color vision.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#222222",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)


CYCLE = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, BLACK)


GRAY = "#777777"


PALE = "#D9D9D9"


DPI = 150


SMALL, NORMAL, LARGE = 7.0, 8.5, 10.5


#: Light fill colors of the groups of bodies; they are repeated for more groups.
FILLS = ("#F3E7CC", "#CFE6F5", "#F9D9B8", "#D5EBDC", "#E8D3E4", "#F6F2B6", "#DDDDDD")


INK = "#3A3A3A"


PAD = "#C77B74"


RAIL = "#C9C2B8"


SURFACE = "#8E1B1B"


#: SI unit -> factor and unit for people.
READER_UNITS = {
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "rad": (180.0 / math.pi, "deg"),
    "J": (1e3, "mJ"),
}


def reader_unit(unit: str) -> tuple[float, str]:
    """Factor and unit for people for an SI unit."""
    return READER_UNITS.get(unit, (1.0, unit))


def new_figure(width: float, height: float) -> Figure:
    """New figure with a size in inches and its own canvas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from unmodeled.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(w_pad=0.08, h_pad=0.08, wspace=0.03, hspace=0.03)  # type: ignore[call-arg]
    return figure


def fit_text(artist: Text, inches: float) -> None:
    """Break a text into lines until it is at most as wide as ``inches``."""
    text = artist.get_text()
    room = inches * artist.get_figure(root=True).dpi  # type: ignore[union-attr]
    letters = len(text)
    while artist.get_window_extent().width > room and letters > 4:
        letters = int(0.95 * letters)
        artist.set_text(textwrap.fill(text, letters))


def head_line(figure: Figure, text: str, size: float = LARGE, weight: str = "bold") -> None:
    """Title of a figure at its left edge, in as many lines as its width requires."""
    artist = figure.suptitle(plain_text(text), fontsize=size, x=0.01, ha="left", fontweight=weight)
    fit_text(artist, 0.98 * figure.get_figwidth())


def style_axes(ax: Axes, x: str = "", y: str = "", title: str = "") -> Axes:
    """Set labels, a light grid, and no frame at the top and right.

    Examples
    --------
    Labels with units:

    >>> from unmodeled.style import new_figure, style_axes
    >>> style_axes(new_figure(4.0, 3.0).subplots(), "time [s]", "force [N]").get_ylabel()
    'force [N]'
    """
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(GRAY)
    ax.tick_params(labelsize=SMALL + 0.5, color=GRAY, length=3)
    ax.grid(True, color="#E6E6E6", linewidth=0.6)
    ax.set_axisbelow(True)
    if x:
        ax.set_xlabel(x, fontsize=NORMAL)
    if y:
        ax.set_ylabel(y, fontsize=NORMAL)
    if title:
        ax.set_title(title, fontsize=NORMAL, loc="left")
    return ax


def side_legend(ax: Axes, **options: Any) -> None:
    """Legend to the right of the data."""
    settings: dict[str, Any] = {
        "loc": "upper left",
        "bbox_to_anchor": (1.01, 1.0),
        "borderaxespad": 0.0,
        "frameon": False,
        "fontsize": NORMAL - 0.5,
        "handlelength": 1.6,
    }
    ax.legend(**(settings | options))


def plain_text(text: str) -> str:
    """Text of a file without mathematics: matplotlib would interpret a dollar sign."""
    return text.replace("$", r"\$")


def spread_apart(wanted: Sequence[float], gap: float) -> list[float]:
    """Positions closest to the sorted ``wanted`` that have the distance ``gap``."""
    # Isotonic regression of the positions without their gaps: pool adjacent violators.
    blocks: list[list[float]] = []  # mean, count
    for i, value in enumerate(wanted):
        blocks.append([value - i * gap, 1.0])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            mean, count = blocks.pop()
            last = blocks[-1]
            last[0] = (last[0] * last[1] + mean * count) / (last[1] + count)
            last[1] += count
    means = [mean for mean, count in blocks for _ in range(int(count))]
    return [mean + i * gap for i, mean in enumerate(means)]


def body_fill(group: int) -> str:
    """Fill color of a group of bodies that are rigidly connected; ground is -1."""
    return FILLS[group % len(FILLS)] if group >= 0 else RAIL
