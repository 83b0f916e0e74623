"""Figures of the report as SVG: map of the gap, bars of the ranking, waterfall of the gap."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from feltmb.fit.solve import NOT_CONVERGED
from feltmb.gap.digits import digits
from feltmb.gap.findings import ComponentRow, HowFar, LedgerCell, Profile, Ranked
from feltmb.style import (
    BLUE,
    GRAY,
    GREEN,
    NORMAL,
    PALE,
    RED,
    new_figure,
    plain_text,
    style_axes,
)
from feltmb.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["bars", "force_traces", "ledger_map", "profile_curve", "waterfall"]

WIDTH = 9.0  # inches
#: Largest number of letters of a name, of records whose force is drawn, and of drawn effects.
LONGEST_NAME, MOST_RECORDS, BARS = 38, 3, 10


def _svg(figure: Figure, name: str, tips: Mapping[str, str] | None = None) -> str:
    """SVG text of a figure, reproducible byte by byte; ``tips``: tooltips by id of an element."""
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    # The page must not contain addresses; HTML needs neither the XML namespaces nor the license.
    addresses = r"<metadata>.*?</metadata>|\s+xmlns(?::\w+)?=\"[^\"]*\""
    text = re.sub(addresses, "", text, flags=re.DOTALL)
    text = text[text.index("<svg") :]
    for key, tip in (tips or {}).items():
        text = text.replace(f'<g id="{key}">', f'<g id="{key}"><title>{escape(tip)}</title>', 1)
    return text.replace("<svg", f'<svg role="img" aria-label="{escape(name)}"', 1)


def _shade(z: float) -> tuple[float, float, float]:
    """Color from white to dark orange, on a logarithmic scale of the excess."""
    share = min(1.0, max(0.0, math.log10(1.0 + max(z, 0.0)) / 3.0))
    return 1.0 - 0.41 * share, 1.0 - 0.81 * share, 1.0 - share


def _rows(ax: Axes, names: Sequence[str]) -> None:
    """Label one row for each entry, the first at the top."""
    style_axes(ax)
    ax.grid(visible=False)
    ax.set_yticks(range(len(names)), [plain_text(n[:LONGEST_NAME]) for n in names], fontsize=NORMAL)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)


def ledger_map(
    cells: Sequence[LedgerCell], onset: Mapping[str, float], name: str = "map of the gap in time"
) -> str:
    """Map of residuals: channels of records over time. Color: excess; frame: significant."""
    from matplotlib.patches import Rectangle

    records = list(dict.fromkeys(c.record for c in cells))
    if not records:
        return ""
    channels = {r: list(dict.fromkeys(c.channel for c in cells if c.record == r)) for r in records}
    heights = [len(channels[r]) + 1.6 for r in records]
    figure = new_figure(WIDTH, 0.27 * sum(heights) + 0.2)
    panels = figure.subplots(len(records), 1, squeeze=False, height_ratios=heights)[:, 0]
    tips: dict[str, str] = {}
    for record, ax in zip(records, panels, strict=True):
        own = [c for c in cells if c.record == record]
        _rows(ax, channels[record])
        for c in own:
            key = f"{name.replace(' ', '-')}-{len(tips)}"
            tips[key] = (
                f"{c.start:.4g} to {c.end:.4g} s: rms {c.rms:.3g}, noise {c.sigma:.3g}, "
                f"excess {c.z:.1f} sd{', significant' if c.significant else ''}"
            )
            at = c.start, channels[record].index(c.channel) - 0.4
            frame = RED if c.significant else PALE
            cell = Rectangle(at, c.end - c.start, 0.8, fc=_shade(c.z), ec=frame, lw=0.7, gid=key)
            ax.add_patch(cell)
        if record in onset:
            ax.axvline(onset[record], color=BLUE, lw=1.6, gid=f"onset-{len(tips)}")
            tips[f"onset-{len(tips)}"] = f"onset {onset[record]:.4g} s"
        ax.set_xlim(min(c.start for c in own), max(c.end for c in own))
        ax.set_title(plain_text(record), fontsize=NORMAL, loc="left")
        ax.set_xlabel("time [s]", fontsize=NORMAL)
    return _svg(figure, name, tips)


def bars(effects: Sequence[Ranked], one_of: Sequence[str], refused: Sequence[str]) -> str:
    """Probability and magnitude of each effect."""
    shown = list(effects[:BARS])
    if not shown:
        return ""
    figure = new_figure(WIDTH, 0.27 * len(shown) + 0.5)
    ax = figure.subplots()
    _rows(ax, [r.effect for r in shown])
    tips: dict[str, str] = {}
    for i, r in enumerate(shown):
        color = BLUE if r.named else (RED if r.effect in one_of else GRAY)
        note = ""
        if r.effect in refused:
            color, note = PALE, "refused; "
        tips[f"belief-{i}"] = r.mechanism or r.effect
        ax.barh(i, r.posterior, 0.7, color=color, gid=f"belief-{i}")
        unit = unit_suffix(r.unit)
        value = f"{r.magnitude:.{digits(r.magnitude, r.sd, 4)}g}"
        wide = f" ± {1.96 * r.sd:.2g}{unit}" if r.converged else f"{unit}, {NOT_CONVERGED}"
        text = f"{note}{r.posterior:.0%}; {value}{wide}"
        ax.text(r.posterior + 0.01, i, plain_text(text), va="center", fontsize=NORMAL)
    ax.set_xlim(0.0, 1.8)  # space for the magnitudes
    ax.set_xticks([0.0, 0.5, 1.0], ["0", "50 %", "100 %"])
    ax.spines["left"].set_visible(False)
    return _svg(figure, "probability of each effect", tips)


def waterfall(how_far: HowFar) -> str:
    """Waterfall from the tabulated gap to the noise: calibration, each effect, residual."""
    steps = how_far.waterfall
    top = steps[0][1]
    if not top > 0.0 or not math.isfinite(top):
        return ""
    levels = np.cumsum([v for n, v in steps if n not in ("unexplained", "noise")])
    figure = new_figure(WIDTH, 0.29 * len(steps) + 0.5)
    ax = figure.subplots()
    _rows(ax, [name for name, _ in steps])
    level = 0.0
    for i, (name, value) in enumerate(steps):
        if name == "as tabulated":
            x, w, color, level = 0.0, value, GRAY, value
        elif name in ("unexplained", "noise"):
            x = 0.0 if name == "noise" else steps[-1][1]
            w, color = value, RED if name == "unexplained" else GREEN
        else:
            x, w, color = min(level, level + value), abs(value), BLUE
            level += value
        ax.barh(i, w, 0.7, left=x, color=color)
        text = f" {value:+.4g}"
        ax.text(x + w, i, text, va="center", fontsize=NORMAL)
    ax.set_xlim(0.0, 1.2 * max(top, how_far.after, float(np.max(levels))))
    return _svg(figure, "waterfall of the held-out gap")


def force_traces(row: ComponentRow) -> str:
    """Unknown force of one component over time with its interval, one panel for each record."""
    if not row.trace:
        return ""
    shown = list(row.trace.items())[:MOST_RECORDS]
    figure = new_figure(WIDTH, 1.3 * len(shown) + 0.3)
    panels = figure.subplots(len(shown), 1, squeeze=False)[:, 0]
    for (record, series), ax in zip(shown, panels, strict=True):
        time, force, sd = (np.asarray(series[k]) for k in ("time", "force", "sd"))
        style_axes(ax, "time [s]", plain_text(f"force [{row.unit}]"), plain_text(record))
        ax.fill_between(time, force - 2.0 * sd, force + 2.0 * sd, color=BLUE, alpha=0.18, lw=0)
        ax.plot(time, force, color=BLUE, lw=1.0)
    return _svg(figure, f"unknown force at {row.port}")


def profile_curve(profile: Profile) -> str:
    """Rise of the sum of squares about the fitted magnitude, with the linear model of the fit."""
    figure = new_figure(0.6 * WIDTH, 2.6)
    ax = figure.subplots()
    unit = profile.unit
    style_axes(ax, plain_text(f"{profile.effect} [{unit}]"), "rise of the sum of squares [1]")
    values = np.asarray(profile.values)
    at = np.linspace(values[0], values[-1], 101)
    label = "by the linear model of the fit"
    ax.plot(at, ((at - profile.magnitude) / profile.sd) ** 2, color=GRAY, lw=1.0, label=label)
    ax.plot(values, profile.rises, "o", color=BLUE, ms=4.0, label="all else fitted again")
    ax.axhline(1.96**2, color=RED, lw=0.8, ls="--", label="95 %")
    ax.legend(frameon=False, fontsize=NORMAL, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return _svg(figure, f"profile of {profile.effect}")
