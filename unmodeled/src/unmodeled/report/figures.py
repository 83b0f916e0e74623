"""Figures of the report of a diagnosis."""

from __future__ import annotations

import io
import itertools
import math
import re
import textwrap
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.pictures.curves import Law, Motion, Motions
from unmodeled.search.held_out import HALF
from unmodeled.search.result import Result
from unmodeled.style import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    NORMAL,
    ORANGE,
    RED,
    SKY,
    SMALL,
    new_figure,
    plain_text,
    style_axes,
)
from unmodeled.units import readable_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 9.0  # inches
#: Largest number of channels of a comparison.
CHANNELS = 24
#: Largest numbers of records, points of a curve, unknowns, and letters of a name in a figure.
RECORDS, POINTS, UNKNOWNS, LETTERS = 6, 1200, 24, 44
#: Largest numbers of small panels of motions, of them in a row, and of laws.
PANELS, ACROSS, LAWS = 12, 4, 6
#: Largest number of laws below a motion.
BELOW = 3
#: Share of the measured range that a model may leave on each side.
OUTSIDE = 0.6


#: Prefixes of SI units by their power of ten.
PREFIXES = {-9: "n", -6: "\N{MICRO SIGN}", -3: "m", 3: "k", 6: "M", 9: "G"}
#: Units that take a prefix; g stands for kg.
PREFIXABLE = {"m", "s", "N", "A", "V", "W", "J", "Pa", "Hz", "rad", "H", "F", "K", "C", "mol"}
#: Times from which an axis shows minutes, and hours [s].
MINUTES = (600.0, 36_000.0)
#: Digits of a superscript.
SUPERSCRIPT = str.maketrans(
    "-0123456789",
    "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079",
)


def axis_unit(*values: Array, unit: str) -> tuple[float, str]:
    """Factor and unit in which the numbers of an axis have few digits.

    Parameters
    ----------
    values
        What the axis shows [unit].
    unit
        SI unit.
    """
    known = [np.abs(v[np.isfinite(v)]) for v in values]
    most = max((float(v.max()) for v in known if v.size), default=0.0)
    factor, name = readable_unit(most, unit)
    if unit == "s" and most >= MINUTES[0]:
        return (1.0 / 60.0, "min") if most < MINUTES[1] else (1.0 / 3600.0, "h")
    if most == 0.0 or 0.05 <= factor * most < 1e4:
        return factor, name
    power = 3 * math.floor(math.log10(most) / 3.0)
    first, *rest = unit.replace("/", " /", 1).split(" ")
    if unit in ("", "1"):
        return 10.0**-power, f"10{str(power).translate(SUPERSCRIPT)}"
    if power in PREFIXES and (first in PREFIXABLE or first == "kg"):
        if first == "kg":
            return (factor, name) if power > 0 else (10.0**3, " ".join(["g", *rest]))
        own = " ".join([f"{PREFIXES[power]}{first}", *rest]).replace(" /", "/")
        return 10.0**-power, own
    return 10.0**-power, f"10{str(power).translate(SUPERSCRIPT)} {unit}"


def raised(unit: str) -> str:
    """A unit with superscripts for its powers, and the sign of degrees."""
    text = re.sub(r"\^(-?\d+)", lambda m: m[1].translate(SUPERSCRIPT), unit)
    return re.sub(r"\bdeg([CF])\b", "\N{DEGREE SIGN}\\1", text)


def svg(figure: Figure, name: str) -> str:
    """Figure as SVG text, reproducible byte by byte.

    Parameters
    ----------
    figure
        Figure of matplotlib.
    name
        Description of the figure.
    """
    import matplotlib as mpl

    file = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    # The page must not contain addresses; HTML needs neither the XML namespaces nor the license.
    addresses = r"<metadata>.*?</metadata>|\s+xmlns(?::\w+)?=\"[^\"]*\""
    found = re.sub(addresses, "", file.getvalue(), flags=re.DOTALL)
    found = found[found.index("<svg") :]
    return found.replace("<svg", f'<svg role="img" aria-label="{escape(name)}"', 1)


def steps(result: Result) -> list[tuple[str, float]]:
    """Residuals of the worst channel [its unit] after each step: tabulated, calibrated, causes.

    Parameters
    ----------
    result
        Result of a diagnosis.
    """
    channel, k = result.worst, result.channels.index(result.worst)
    found = [("tabulated", channel.tabulated), ("calibrated", channel.calibrated)]
    known = {frozenset(s.causes): s.residual[k] for s in result.sets}
    groups = (*((n,) for n in (*result.named, *result.supported)), *result.classes,
              *result.small, *result.unsure)  # fmt: skip
    words = {n.cause: " or ".join(m.cause for m in g) for g in groups for n in g}
    done: frozenset[str] = frozenset()
    rest = list(result.reported)
    while rest:
        fitted = [(known[done | {n}], n) for n in rest if done | {n} in known]
        if not fitted or len(rest) == 1:
            found.append((" and ".join(words[n] for n in rest), channel.explained))
            break
        value, name = min(fitted)
        found.append((words[name], value))
        done |= {name}
        rest.remove(name)
    return found


def waterfall(result: Result) -> Figure:
    """Residual of the worst channel: tabulated, calibrated, with each cause, and the noise.

    Parameters
    ----------
    result
        Result of a diagnosis.
    """
    c, levels = result.worst, steps(result)
    bars = [(levels[0][0], 0.0, levels[0][1], GRAY)]
    bars += [
        (name, value, before - value, BLUE)
        for (_, before), (name, value) in itertools.pairwise(levels)
    ]
    bars.append(("remains", 0.0, levels[-1][1], RED))
    if np.isfinite(c.noise):
        bars.append(("noise of the sensor", 0.0, c.noise, GREEN))
    figure = new_figure(WIDTH, 0.3 * len(bars) + 0.7)
    ax = figure.subplots()
    style_axes(ax, plain_text(f"rms residual of {c.name} [% of its motion]"))
    ax.grid(visible=False)
    for i, (_, left, width, color) in enumerate(bars):
        at, change = 100.0 * c.share(left), 100.0 * c.share(width)
        ax.barh(i, change, 0.66, left=at, color=color)
        end = max(at, at + change)
        rounded = float(f"{change:.2g}")
        shown = f" {rounded:g}" if left == 0.0 and color != BLUE else f" {-rounded:+g}"
        ax.text(end, i, shown, va="center", fontsize=NORMAL)
    ax.set_yticks(range(len(bars)), [plain_text(b[0][:LETTERS]) for b in bars], fontsize=NORMAL)
    ax.set_ylim(len(bars) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.margins(x=0.12)
    return figure


def motion(motions: Motions) -> Figure:
    """Measured, the model as it is, and with the changes: the clearest part, then all records.

    Parameters
    ----------
    motions
        The chosen part, and the records by channel.
    """
    first, rest = motions.chosen, motions.whole[:PANELS]
    across = min(ACROSS, len(rest)) or 1
    rows = -(-len(rest) // across)
    figure = new_figure(WIDTH, 3.0 + 1.3 * rows)
    grid = figure.add_gridspec(1 + rows, across, height_ratios=[2.4, *([1.0] * rows)])
    _motion_panel(figure.add_subplot(grid[0, :]), first, large=True)
    for k, m in enumerate(rest):
        _motion_panel(figure.add_subplot(grid[1 + k // across, k % across]), m, large=False)
    _key(figure, MOTION_KEY)
    return figure


def answer(motions: Motions | None, laws: Sequence[Law]) -> Figure:
    """The answer in one picture: the clearest part of the motions, and the first laws below it.

    Parameters
    ----------
    motions
        Motions of the records; None: they are not known.
    laws
        Laws with the points that the records leave for them.
    """
    shown = laws[:BELOW]
    figure = new_figure(WIDTH, 2.6 * (motions is not None) + 2.7 * bool(shown) + 0.3)
    rows = [2.5] * (motions is not None) + [2.6] * bool(shown)
    grid = figure.add_gridspec(len(rows) or 1, len(shown) or 1, height_ratios=rows or [1.0])
    if motions is not None:
        _motion_panel(figure.add_subplot(grid[0, :]), motions.chosen, large=True)
    for k, law in enumerate(shown):
        _law_panel(figure.add_subplot(grid[-1, k]), law)
    _key(figure, [*MOTION_KEY, *(LAW_KEY if shown else ())])
    return figure


def _motion_panel(ax: Axes, m: Motion, *, large: bool) -> None:
    """One motion; the model may leave the panel if it leaves the record far."""
    seen = m.measured[np.isfinite(m.measured)]
    factor, unit = axis_unit(seen, unit=m.unit)
    clock, second = axis_unit(m.time, unit="s")
    width = 1.5 if large else 1.0
    ax.plot(clock * m.time, factor * m.tabulated, color=ORANGE, ls=(0, (4, 1.5)), lw=width)
    ax.plot(clock * m.time, factor * m.measured, color=BLACK, lw=2.4 * width, alpha=0.35)
    ax.plot(clock * m.time, factor * m.changed, color=BLUE, ls=(0, (2.5, 1.0)), lw=width)
    low, high = limits(m)
    ax.set_ylim(factor * low, factor * high)
    title = m.record if large else m.record[: LETTERS // 2]
    y = _axis(m.channel if large else m.channel[:12], unit)
    style_axes(ax, f"time [{second}]" if large else "", y,
               plain_text(f"{title}, held out" if m.held_out else title))  # fmt: skip
    ax.locator_params(nbins=6 if large else 3)


def limits(m: Motion) -> tuple[float, float]:
    """Ends of the axis of a motion [its unit]: the measured values, and most of the models."""
    known = [v[np.isfinite(v)] for v in (m.measured, m.tabulated, m.changed)]
    low, high = float(known[0].min()), float(known[0].max())
    room = OUTSIDE * (high - low) or 1.0
    every = np.concatenate(known)
    low, high = max(low - room, float(every.min())), min(high + room, float(every.max()))
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _key(figure: Figure, items: Sequence[tuple[str, str]]) -> None:
    """Names of the colors above a figure: none covers a curve."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=color, lw=2.2) for _, color in items]
    figure.legend(handles, [n for n, _ in items], loc="outside upper left", ncols=len(items),
                  frameon=False, fontsize=NORMAL, handlelength=1.4)  # fmt: skip


#: Names of the colors.
MOTION_KEY = (("measured", GRAY), ("as it is", ORANGE), ("with the changes", BLUE))
LAW_KEY = (("records", BLACK), ("law, 95 %", SKY))
#: Colors and markers of the records of a law.
RECORD_MARKS = ((BLACK, "o"), (RED, "s"), (GREEN, "^"))


def evidence(laws: Sequence[Law], *, key: bool = True) -> Figure:
    """The evidence of each change in the coordinates of its law: points, law and interval.

    Parameters
    ----------
    laws
        Laws with the points that the records leave for them.
    key
        Whether the colors are named.
    """
    shown = laws[:LAWS]
    across = min(2, max(len(shown), 1))
    rows = -(-len(shown) // across) or 1
    figure = new_figure(WIDTH if across > 1 else 0.5 * WIDTH, 2.9 * rows + 0.3)
    panels = figure.subplots(rows, across, squeeze=False).ravel()
    for ax in panels[len(shown) :]:
        ax.set_visible(False)
    for ax, law in zip(panels, shown, strict=False):
        _law_panel(ax, law)
    if key:
        _key(figure, LAW_KEY)
    return figure


def _law_panel(ax: Axes, law: Law) -> None:
    """One law, in readable units."""
    own = [(p.x, p.y) for p in law.points] + [(line.x, line.y) for line in law.lines]
    (fx, ux), (fy, uy) = (
        axis_unit(*values, unit=axis.unit)
        for axis, values in zip((law.x, law.y), zip(*own, strict=True), strict=True)
    )
    title = law.title[:1].upper() + law.title[1:] if " " in law.title else law.title
    style_axes(ax, _axis(law.x.label, ux), _axis(law.y.label, uy),
               plain_text(textwrap.fill(raised(title), LETTERS)))  # fmt: skip
    {"records": _bars, "likelihood": _likelihood, "step": _step}.get(law.kind, _curve)(
        ax, law, fx, fy
    )


def _axis(label: str, unit: str) -> str:
    return plain_text(label if unit in ("", "1") else f"{label} [{raised(unit)}]")


def _curve(ax: Axes, law: Law, fx: float, fy: float) -> None:
    ax.axhline(0.0, color=GRAY, lw=0.6)
    for line in law.lines:
        if law.kind == "law":
            ax.fill_between(fx * line.x, fy * line.low, fy * line.high, color=SKY, alpha=0.4, lw=0)
        else:
            for end in (line.low, line.high):
                ax.plot(fx * line.x, fy * end, color=SKY, lw=0.7)
        ax.plot(fx * line.x, fy * line.y, color=BLUE, lw=1.8, zorder=1.5)
    records = list(dict.fromkeys(p.label.partition(", ")[0] for p in law.points))
    for p in law.points:
        color, mark = RECORD_MARKS[records.index(p.label.partition(", ")[0]) % len(RECORD_MARKS)]
        way = p.label.rpartition(", ")[2]
        mark = {"rising": ">", "falling": "<"}.get(way, mark)
        if np.any(p.sd > 0.0):
            ax.errorbar(fx * p.x, fy * p.y, HALF * fy * p.sd, fmt=mark, color=color, ms=3.5,
                        lw=0.8, zorder=3)  # fmt: skip
        else:
            ax.plot(fx * p.x, fy * p.y, mark, color=color, ms=3.0, alpha=0.5, mew=0, zorder=2)


def _step(ax: Axes, law: Law, fx: float, fy: float) -> None:
    """A signal over time: with and without the change."""
    for line, color, style in zip(law.lines, (ORANGE, BLUE), ("--", "-"), strict=True):
        ax.plot(fx * line.x, fy * line.y, color=color, ls=style, lw=1.6)
    for p in law.points:
        ax.plot(fx * p.x, fy * p.y, "o", color=BLACK, ms=2.5, mew=0)
    for row, (line, color) in enumerate(zip(law.lines, (ORANGE, BLUE), strict=True)):
        ax.annotate(line.label, (1.0, 1.02), (0, 9 * row), xycoords="axes fraction", ha="right",
                    textcoords="offset points", color=color, fontsize=SMALL)  # fmt: skip


def _likelihood(ax: Axes, law: Law, fx: float, fy: float) -> None:
    """A likelihood with the model as it is, and the records by themselves below it."""
    curve, as_it_is = law.lines
    ax.fill_between(fx * curve.x, curve.y, color=SKY, alpha=0.4, lw=0)
    ax.plot(fx * curve.x, curve.y, color=BLUE, lw=1.8)
    ax.axvline(fx * as_it_is.x[0], color=ORANGE, ls="--", lw=1.6)
    left = as_it_is.x[0] < curve.x[np.argmax(curve.y)]
    ax.annotate("as it is", (fx * as_it_is.x[0], 1.08), (4 if left else -4, 0),
                textcoords="offset points", ha="left" if left else "right", color=ORANGE,
                fontsize=SMALL)  # fmt: skip
    ax.locator_params(axis="x", nbins=4)  # a value and its neighbors have many digits
    gap = 0.5 / max(len(law.points), 3)
    for k, p in enumerate(law.points):
        ax.errorbar(fx * p.x, [-gap * (k + 1)], xerr=HALF * fx * p.sd, fmt="o", color=BLACK, ms=3.5,
                    lw=0.9)  # fmt: skip
    ax.set_yticks([0.0, 0.5, 1.0])
    ax.set_ylim(-gap * (len(law.points) + 1), 1.18)
    del fy


def _bars(ax: Axes, law: Law, fx: float, fy: float) -> None:
    """Sizes by record."""
    for k, p in enumerate(law.points):
        ax.bar(k, fy * p.y, 0.6, color=BLUE, yerr=HALF * fy * p.sd, error_kw={"lw": 0.9})
    many = len(law.points) > 4
    ax.set_xticks(range(len(law.points)), [plain_text(p.label[:16]) for p in law.points],
                  rotation=30 if many else 0, ha="right" if many else "center")  # fmt: skip
    ax.axhline(0.0, color=GRAY, lw=0.6)
    del fx


def residuals(result: Result) -> Figure:
    """Residual of the worst channel over time, a panel for each record.

    Parameters
    ----------
    result
        Result of a diagnosis.
    """
    shown, c = result.traces[:RECORDS], result.worst
    causes = bool(result.named or result.classes)
    figure = new_figure(WIDTH, 1.15 * max(len(shown), 1) + 0.6)
    panels = figure.subplots(max(len(shown), 1), 1, squeeze=False)[:, 0]
    for trace, ax in zip(shown, panels, strict=False):
        every = slice(None, None, max(1, trace.time.size // POINTS))
        held = " (held out)" if trace.held_out else ""
        style_axes(ax, "", plain_text(f"[{c.unit}]"), plain_text(trace.record + held))
        if np.isfinite(c.noise):
            ax.axhspan(-2.0 * c.noise, 2.0 * c.noise, color=GREEN, alpha=0.18, lw=0)
        label = "calibrated"
        ax.plot(trace.time[every], trace.calibrated[every], color=GRAY, lw=0.9, label=label)
        if causes:
            label = "with the causes"
            ax.plot(trace.time[every], trace.explained[every], color=BLUE, lw=0.9, label=label)
    if shown:
        panels[-1].set_xlabel("time [s]", fontsize=NORMAL)
        title = f"{c.name}, measured less simulated (green: twice the noise of the sensor)"
        figure.suptitle(plain_text(title), fontsize=NORMAL, x=0.01, ha="left")
        panels[0].legend(frameon=False, fontsize=NORMAL, loc="upper right", ncols=2)
    return figure


def residual_force(result: Result) -> Figure:
    """The force that would explain what remains at the best place, over speed and position.

    A curve shows which law it may be: a step at zero speed is dry friction, a parabola is drag.

    Parameters
    ----------
    result
        Result of a diagnosis.
    """
    figure = new_figure(WIDTH, 2.6)
    panels = figure.subplots(1, 2, sharey=True)
    place = next((p for p in result.places if p.force), None)
    for k, (ax, of) in enumerate(zip(panels, ("speed", "position"), strict=True)):
        unit = "" if place is None else f" [{place.units[1 - k]}]"
        style_axes(ax, of + unit, "" if k or place is None else f"force [{place.units[2]}]")
        if place is not None:
            ax.axhline(0.0, color=GRAY, lw=0.6)
            ax.plot(place.force[1 - k], place.force[2], ".", color=BLUE, ms=4)
    if place is not None:
        title = f"force that would explain what remains at {place.name}"
        figure.suptitle(plain_text(title), fontsize=NORMAL, x=0.01, ha="left")
    return figure


def correlation(result: Result) -> Figure:
    """Correlation of the fitted parameters and magnitudes.

    Parameters
    ----------
    result
        Result of a diagnosis.
    """
    matrix = np.abs(result.correlation - np.eye(len(result.correlation)))
    order = np.sort(np.argsort(-matrix.max(axis=1, initial=0.0), kind="stable")[:UNKNOWNS])
    names = [plain_text(result.unknowns[i][:LETTERS]) for i in order]
    size = 0.26 * len(order)
    figure = new_figure(min(size + 3.4, WIDTH), max(size, 0.5) + 1.2)
    ax = figure.subplots()
    ax.imshow(result.correlation[np.ix_(order, order)], cmap="RdBu", vmin=-1.0, vmax=1.0)
    ax.set_yticks(range(len(order)), names, fontsize=NORMAL)
    ax.set_xticks(range(len(order)), names, fontsize=NORMAL, rotation=60, ha="right")
    for row, i in enumerate(order):
        for column, j in enumerate(order):
            if row != column and abs(value := result.correlation[i, j]) > 0.5:
                ink = "white" if abs(value) > 0.7 else "black"
                ax.text(column, row, f"{value:.2f}"[-5:], color=ink, fontsize=5.5, ha="center",
                        va="center")  # fmt: skip
    return figure


def comparison(title: str, channels: Sequence[tuple[str, str, Record, Array, float]]) -> Figure:
    """Records beside the model, and the difference; a row of panels for each channel.

    Parameters
    ----------
    title
        Title of the figure.
    channels
        Name, unit, record, values of the model, and noise [its unit] of each channel.
    """
    shown = channels[:CHANNELS]
    rows = max(len(shown), 1)
    figure = new_figure(WIDTH, 1.7 * rows + 0.6)
    panels = figure.subplots(rows, 2, squeeze=False, width_ratios=(3, 2))
    for (left, right), (name, unit, record, model, noise) in zip(panels, shown, strict=False):
        measured = record.outputs[name]
        factor, own = readable_unit(float(np.nanmax(np.abs(measured))), unit)
        label = "" if own == "1" else f" [{own}]"
        style_axes(left, y=plain_text(f"{name}{label}"), title=plain_text(record.name))
        left.plot(record.time, factor * measured, color=BLUE, lw=1.2, label="record")
        left.plot(record.time, factor * model, color=ORANGE, lw=1.0, ls="--", label="model")
        style_axes(right, y=plain_text(f"record - model{label}"))
        right.axhspan(-2.0 * factor * noise, 2.0 * factor * noise, color=GREEN, alpha=0.18, lw=0)
        right.plot(record.time, factor * (measured - model), color=BLUE, lw=0.9)
    if shown:
        panels[0, 0].legend(frameon=False, fontsize=NORMAL, loc="best")
    for ax in panels[-1]:
        ax.set_xlabel("time [s]", fontsize=NORMAL)
    figure.suptitle(plain_text(title), fontsize=NORMAL, x=0.01, ha="left")
    return figure
