"""Figures of the report of a diagnosis."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.search.result import Result
from unmodeled.style import (
    BLUE,
    GRAY,
    GREEN,
    NORMAL,
    ORANGE,
    RED,
    new_figure,
    plain_text,
    style_axes,
)
from unmodeled.units import readable_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 9.0  # inches
#: Largest number of channels of a comparison.
CHANNELS = 24
#: Largest numbers of records, points of a curve, unknowns, and letters of a name in a figure.
RECORDS, POINTS, UNKNOWNS, LETTERS = 6, 1200, 24, 44


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
    words = {n.cause: " or ".join(m.cause for m in g) for g in result.classes for n in g}
    words |= {n.cause: n.cause for n in result.named}
    done: frozenset[str] = frozenset()
    rest = [name for name in result.reported if name in words]
    while rest:
        fitted = [(known[done | {n}], n) for n in rest if done | {n} in known]
        if not fitted or len(rest) == 1:
            found.append((" and ".join(words[n] for n in rest), known[frozenset(result.reported)]))
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
        shown = f" {change:.2g}" if left == 0.0 and color != BLUE else f" {-change:+.2g}"
        ax.text(end, i, shown, va="center", fontsize=NORMAL)
    ax.set_yticks(range(len(bars)), [plain_text(b[0][:LETTERS]) for b in bars], fontsize=NORMAL)
    ax.set_ylim(len(bars) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.margins(x=0.12)
    return figure


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
