"""Figures over time: motion, speed of the striker, contact and finger forces, string."""

from __future__ import annotations

import itertools
import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from feltmb import _core
from feltmb.graphics.plot.axes import head_title, mark_events, panel_grid, set_window
from feltmb.graphics.plot.readings import (
    action_window,
    busy_window,
    contact_label,
    loaded_contacts,
    named_events,
    need_output,
    need_samples,
    need_striker,
    repeated_strikes,
    string_window,
)
from feltmb.run.reading import contact_parties, reading_of, strike_events
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.style import (
    BLACK,
    BLUE,
    CYCLE,
    GRAY,
    GREEN,
    NORMAL,
    ORANGE,
    PURPLE,
    RED,
    SMALL,
    fit_text,
    new_figure,
    plain_text,
    reader_unit,
    side_legend,
    style_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feltmb.mechanism import View
    from feltmb.run.results import Run

Array = npt.NDArray[np.float64]

#: Colors of the curves of a view, in this order.
_COLORS = (BLUE, GREEN, PURPLE, RED, ORANGE, *CYCLE)


@dataclass(frozen=True)
class Motion:
    """Curves of a panel, which have one unit."""

    what: str
    unit: str
    """SI unit of the curves."""
    curves: Sequence[tuple[str, Array, str, str]]
    """Label, values (of a motion: change from the start) [unit], color and line style."""


def view_panels(run: Run, view: View) -> list[Motion]:
    """Panels of a view, one for each unit of its outputs.

    The second coordinate of a point is dashed.
    """
    curves: dict[str, list[tuple[str, Array, str, str]]] = {}
    firsts: dict[str, str] = {}
    points: list[str] = []
    for row, color in zip(view.rows, itertools.cycle(_COLORS), strict=False):
        if row.output not in run:
            continue
        values = run[row.output]
        point = row.output.rpartition(".")[0]
        style = "--" if point in points else "-"
        points.append(point)
        start = values[0] if view.change else 0.0
        label, unit = plain_text(row.label or row.output), run.unit(row.output)
        firsts.setdefault(unit, row.output)
        own = curves.setdefault(unit, [])
        own.append((label, row.factor * (values - start), color, style))
    return [
        Motion(plain_text(view.title or firsts[unit]), unit, own) for unit, own in curves.items()
    ]


def _motion_of_points(run: Run) -> Iterator[Motion]:
    """Displacement of the tracking points, at most six."""
    names = [n for n in run.names if re.fullmatch(r".+\.[xy]", n) and run.unit(n) == "m"]
    names = [n for n in names if f"{n}.rate" not in run][:12]  # a coordinate may have such a name
    curves = [
        (
            plain_text(f"{name[:-2]}, d{name[-1]}"),
            run[name] - run[name][0],
            CYCLE[(i // 2) % len(CYCLE)],
            "-" if name[-1] == "y" else "--",
        )
        for i, name in enumerate(names)
    ]
    if curves:
        yield Motion("displacement", "m", curves)


def _motions_of_coordinates(run: Run) -> Iterator[Motion]:
    """Displacements and angles of the coordinates, but not those of the bending of beams."""
    moves = [n for n in run.names if f"{n}.rate" in run and not re.fullmatch(r".+\.[uv]\d+", n)]
    for what, unit in (("displacement", "m"), ("angle", "rad")):
        own = [n for n in moves if run.unit(n) == unit][:12]
        curves = [
            (plain_text(n), run[n] - run[n][0], color, "-")
            for n, color in zip(own, itertools.cycle(CYCLE), strict=False)
        ]
        if curves:
            yield Motion(what, unit, curves)


def motions_of(run: Run) -> list[Motion]:
    """The view ``motion`` of ``[reading]``, else tracking points, else coordinates by their unit.

    Coordinates of the bending of beams are omitted.

    Raises
    ------
    InvalidParameter
        The run has none of these.
    """
    view = reading_of(run).views.get("motion")
    if view is not None and (panels := view_panels(run, view)):
        names = {"m": "displacement", "rad": "angle"} if view.change else {}
        return [replace(p, what=names.get(p.unit, p.what)) for p in panels]
    found = list(_motion_of_points(run)) or list(_motions_of_coordinates(run))
    if not found:
        raise InvalidParameter("plot motion: the run has no tracking points and no coordinates")
    return found


def draw_motion(ax: Axes, motion: Motion, time: Array, words: str = "") -> None:
    """Plot the curves of one unit on axes; ``words`` follow their name."""
    factor, unit = reader_unit(motion.unit)
    for label, values, color, style in motion.curves:
        ax.plot(
            1e3 * time, factor * values, color=color, linestyle=style, linewidth=1.3, label=label
        )
    style_axes(ax, "time [ms]", textwrap.fill(f"{motion.what}{words} [{unit}]", 28))


@checked
def motion(run: Run) -> Figure:
    """Plot the view ``motion`` of ``[reading]``; for the action, thesis Figs 4.12 to 4.16.

    The lower panel shows the time around the strike. For a mechanism without this view, its first
    tracking points are shown, and without points its coordinates.

    Raises
    ------
    InvalidParameter
        The run has neither tracking points nor coordinates.
    """
    need_samples(run)
    motions = motions_of(run)
    whole = (float(run.time[0]), float(run.time[-1]))
    near = action_window(run)
    zoom = near[1] - near[0] < 0.8 * (whole[1] - whole[0])
    panels = [(m, w) for m in motions for w in ((whole, near) if zoom else (whole,))]
    figure = new_figure(9.0, 1.8 + 2.8 * len(panels))
    head_title(figure, run, "Motion")
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    view = reading_of(run).views.get("motion")
    whole_values = view is not None and not view.change
    early = [name for t, name in named_events(run) if not near[0] <= t <= near[1]]
    for ax, (moved, window) in zip(axes, panels, strict=True):
        draw_motion(ax, moved, run.time, "" if whole_values else " from start")
        set_window(ax, window)
        if zoom and window == whole:
            ax.axvspan(1e3 * near[0], 1e3 * near[1], color="#F2F2F2", zorder=0)
            ax.set_xlabel("")
            ax.set_title("whole run; gray: shown below", fontsize=SMALL + 0.5, loc="right")
            mark_events(ax, run, whole, width=6.4, only=early)
        else:
            mark_events(ax, run, window, width=6.4)
        if window == whole:
            side_legend(ax)
    return figure


def striker_name(run: Run) -> str:
    """Name of the striking point, as text for matplotlib."""
    striker = reading_of(run).striker
    return plain_text("striker" if striker is None else striker.label or striker.point)


def draw_speed(ax: Axes, run: Run, *, marks: bool = True) -> None:
    """Plot the speed of the striking point in its direction on axes.

    This is not the impact speed, which is the speed of the contact
    (``run.summary["impact_speed"]``).
    """
    speed = need_striker(run)
    label = striker_name(run)
    parties = contact_parties(run, reading_of(run).strike_contact)
    other = plain_text(shortened(parties[1], 24)) if parties else "surface"
    where = f"toward {other}" if parties else "speed"
    ax.plot(1e3 * run.time, speed, color=RED, linewidth=1.3, label=label)
    ax.axhline(0.0, color=GRAY, linewidth=0.6)
    lines = textwrap.wrap(label, 28) + textwrap.wrap(f"{where} [m/s]", 28)
    style_axes(ax, "time [ms]", "\n".join(lines))
    if not marks:
        return
    top = float(np.max(speed))
    strikes = repeated_strikes(run)
    for number, strike in enumerate(strikes, start=1):
        met = strike["impact_time"]
        tip = float(np.interp(met, run.time, speed))
        ax.plot([1e3 * met], [tip], "o", color=BLACK, markersize=4, zorder=4)
        ax.annotate(
            f"{number}: {tip:.2f} m/s",
            (1e3 * met, tip),
            xytext=(6, 2),
            textcoords="offset points",
            fontsize=SMALL + 0.5,
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"},
        )
    if strikes:
        return
    # After the impact the striker moves away from what it met: there is space above zero.
    met = run.summary.get("impact_time", math.nan)
    left = met + run.summary.get("impact_duration", math.nan)
    for time, word, color, height in (
        (met, f"{other} met", BLACK, 0.97),
        (left, f"{other} left", BLUE, 0.42),
    ):
        if not math.isfinite(time):
            continue
        value = float(np.interp(time, run.time, speed))
        ax.plot([1e3 * time], [value], "o", color=color, markersize=4, zorder=4)
        ax.annotate(
            f"{word} at {1e3 * time:.1f} ms, {label} {value:.2f} m/s",
            (1e3 * time, value),
            xytext=(14, height * top),
            textcoords=("offset points", "data"),
            ha="left",
            va="center",
            fontsize=SMALL + 0.5,
            arrowprops={
                "arrowstyle": "-",
                "color": color,
                "linewidth": 0.6,
                "shrinkB": 3.0,
                "relpos": (0.0, 0.5),
            },
            color=color,
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"},
        )


@checked
def striker_speed(run: Run) -> Figure:
    """Plot the speed [m/s] of the striking point in its direction; thesis Figs 4.9, 4.10.

    The impact speed of a run, ``run.summary["impact_speed"]``, is the closing speed of the contact
    along its normal, and not the speed of this tracking point.

    Raises
    ------
    InvalidParameter
        The mechanism names no ``reading.striker``.
    """
    need_samples(run)
    need_striker(run)
    figure = new_figure(7.5, 4.2)
    head_title(figure, run, f"Speed of the {striker_name(run)}")
    ax = figure.subplots()
    draw_speed(ax, run)
    set_window(ax, action_window(run))
    return figure


@checked
def contact_forces(run: Run) -> Figure:
    """Plot the normal force [N] of every contact with a force, and its peak.

    Raises
    ------
    InvalidParameter
        No contact has a force.
    """
    need_samples(run)
    numbers = loaded_contacts(run)
    if not numbers:
        raise InvalidParameter("plot contact_forces: no contact of the run carries force")
    columns = min(4, len(numbers))
    rows = -(-len(numbers) // columns)
    figure = new_figure(2.9 * columns + 0.4, 1.75 * rows + 0.7)
    head_title(figure, run, "Contact forces")
    window = busy_window(run)
    for i, (ax, number) in enumerate(
        zip(panel_grid(figure, len(numbers), columns), numbers, strict=True)
    ):
        force = run[f"contact{number:02d}.force"]
        peak = int(np.argmax(force))
        ax.fill_between(1e3 * run.time, force, color=BLUE, alpha=0.15, linewidth=0)
        ax.plot(1e3 * run.time, force, color=BLUE, linewidth=1.0)
        last = i + columns >= len(numbers)
        style_axes(ax, "time [ms]" if last else "", "force [N]" if i % columns == 0 else "")
        title = ax.set_title(contact_label(run, number), fontsize=SMALL + 1, loc="left", pad=13)
        fit_text(title, 2.4)
        held = force[0] >= 0.999 * force[peak]
        when = "at the start" if held else f"at {1e3 * float(run.time[peak]):.1f} ms"
        ax.text(
            0.0,
            1.03,
            f"peak {force[peak]:.3g} N {when}",
            transform=ax.transAxes,
            fontsize=SMALL,
            color=GRAY,
            ha="left",
            va="bottom",
        )
        ax.set_xlim(1e3 * window[0], 1e3 * window[1])
        ax.set_ylim(0.0, 1.08 * float(force[peak]))
        ax.locator_params(axis="x", nbins=5)
        ax.locator_params(axis="y", nbins=4)
    return figure


def draw_finger(ax: Axes, run: Run) -> None:
    """Plot the force of the finger on axes."""
    ax.plot(1e3 * run.time, run["finger.force"], color=BLUE, linewidth=1.3)
    style_axes(ax, "time [ms]", "finger force [N]")


@checked
def finger_force(run: Run) -> Figure:
    """Plot force [N] and travel [mm] of the finger; for a prescribed motion, also this motion.

    Raises
    ------
    InvalidParameter
        The run has no finger.
    """
    need_samples(run)
    need_output(run, "finger.force", "finger_force")
    travel = "finger.displacement" in run
    figure = new_figure(8.0, 5.0 if travel else 3.4)
    head_title(figure, run, "Finger")
    axes = figure.subplots(2 if travel else 1, 1, squeeze=False, sharex=True)[:, 0]
    window = (float(run.time[0]), float(run.time[-1]))
    draw_finger(axes[0], run)
    set_window(axes[0], window)
    mark_events(axes[0], run, window, width=6.0)
    if travel:
        ax = axes[1]
        axes[0].set_xlabel("")
        moved = run.provenance.get("stroke", {}).get("kind") in ("motion", "key_motion")
        traveled = run["finger.displacement"] - (0.0 if moved else run["finger.displacement"][0])
        ax.plot(
            1e3 * run.time,
            1e3 * traveled,
            color=GREEN,
            linewidth=1.3,
            label="point under the finger",
        )
        stroke = run.provenance.get("stroke", {})
        if moved:
            profile = _core.Profile(
                stroke["time"],
                stroke["value"],
                getattr(_core.Interpolation, stroke["interpolation"]),
            )
            prescribed = np.asarray(profile.value(run.time))
            if stroke["kind"] == "key_motion":
                prescribed += run["finger.displacement"][0] - prescribed[0]
            ax.plot(
                1e3 * run.time,
                1e3 * prescribed,
                color=BLACK,
                linewidth=1.0,
                linestyle="--",
                label="finger, prescribed" if stroke["kind"] == "motion" else "prescribed",
            )
            side_legend(ax)
        style_axes(ax, "time [ms]", "travel [mm]")
        set_window(ax, window)
        mark_events(ax, run, window, width=6.0, labels=False)
    return figure


@checked
def string(run: Run) -> Figure:
    """Plot the string: displacement at the strike point, bridge force, and shape over time.

    Raises
    ------
    InvalidParameter
        The run has no modal string.
    """
    need_samples(run)
    parameters = run.provenance.get("string")
    shape = bool(parameters) and run.eta.ndim == 2 and run.eta.shape[1] > 0
    names = [n for n in ("string.strike", "string.bridge_force") if n in run]
    if not names and not shape:
        raise InvalidParameter("plot string: the run has no modal string")
    window = string_window(run)
    figure = new_figure(8.0, 1.9 * len(names) + (2.8 if shape else 0.0) + 0.4)
    head_title(figure, run, "String")
    rows = len(names) + int(shape)
    heights = [1.0] * len(names) + [1.5] * int(shape)
    axes = figure.subplots(rows, 1, squeeze=False, sharex=True, height_ratios=heights)[:, 0]
    for ax, name in zip(axes, names, strict=False):
        factor, unit = reader_unit(run.unit(name))
        what = "strike point" if name == "string.strike" else "bridge force"
        color = RED if name == "string.strike" else BLUE
        ax.plot(1e3 * run.time, factor * run[name], color=color, linewidth=1.2)
        ax.axhline(0.0, color=GRAY, linewidth=0.6)
        style_axes(ax, "", f"{what} [{unit}]")
        set_window(ax, window)
        mark_events(ax, run, window, width=6.0, only=strike_events(run), labels=ax is axes[0])
    if shape:
        assert parameters is not None
        ax = axes[-1]
        keep = (run.time >= window[0]) & (run.time <= window[1])
        length = float(parameters["length"])
        places = np.linspace(0.0, length, 161)
        w = 1e3 * run.string_displacement(places)[keep]
        top = float(np.abs(w).max()) or 1.0
        image = ax.imshow(
            w.T,
            origin="lower",
            aspect="auto",
            extent=(1e3 * run.time[keep][0], 1e3 * run.time[keep][-1], 0.0, 1e3 * length),
            cmap="RdBu_r",
            vmin=-top,
            vmax=top,
            interpolation="bilinear",
        )
        style_axes(ax, "", "distance from end [mm]")
        ax.grid(False)
        bar = figure.colorbar(image, ax=ax, pad=0.015, aspect=18)
        bar.set_label("displacement away\nfrom the striker [mm]", fontsize=SMALL + 0.5)
        bar.ax.tick_params(labelsize=SMALL)
    axes[-1].set_xlabel("time [ms]", fontsize=NORMAL)
    return figure
