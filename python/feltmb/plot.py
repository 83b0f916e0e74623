"""Pictures of runs and mechanisms.

Every function takes a :class:`~feltmb.results.Run` (or several, or an
:class:`~feltmb.config.Action`) and returns a matplotlib ``Figure`` of its own; nothing is shown and
no global state of matplotlib is touched. Axes carry the units of a reader: ms, mm, N, m/s, mJ. What
a run does not have is left out; a picture of which nothing would be left is refused.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb import _core
from feltmb.errors import InvalidParameter
from feltmb.files import check_writable, write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feltmb.config import Action, Surface
    from feltmb.results import Run

Array = npt.NDArray[np.float64]

__all__ = [
    "PICTURES",
    "Scene",
    "Shape",
    "body_poses",
    "compare",
    "contact_forces",
    "energy",
    "finger_force",
    "hammer_speed",
    "loops",
    "mechanism",
    "motion",
    "overview",
    "run_action",
    "save_all",
    "scene",
    "string",
]

# --- house style ---------------------------------------------------------------------------------

#: Colors of Okabe and Ito, distinct for all common kinds of color vision.
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

#: SI unit -> factor and unit for the reader.
_READER = {
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "rad": (180.0 / math.pi, "deg"),
    "J": (1e3, "mJ"),
}


def _reader(unit: str) -> tuple[float, str]:
    return _READER.get(unit, (1.0, unit))


def _figure(width: float, height: float) -> Figure:
    """Figure of a size in inches with a canvas of its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(w_pad=0.08, h_pad=0.08, wspace=0.03, hspace=0.03)  # type: ignore[call-arg]
    return figure


def _style(ax: Axes, x: str = "", y: str = "", title: str = "") -> Axes:
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


def _legend(ax: Axes, **options: Any) -> None:
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


def _plain(text: str) -> str:
    """Text of a file as it is: matplotlib would read a dollar sign as mathematics."""
    return text.replace("$", r"\$")


def _run_name(run: Run) -> str:
    stroke = run.provenance.get("stroke", {}).get("name", "")
    action = str(run.provenance.get("action", ""))
    return _plain(
        " · ".join(part for part in (action, f"stroke {stroke}" if stroke else "") if part)
    )


def _title(figure: Figure, run: Run, what: str) -> None:
    name = _run_name(run)
    figure.suptitle(
        f"{what}: {name}" if name else what, fontsize=LARGE, x=0.01, ha="left", fontweight="bold"
    )


# --- what a run holds ----------------------------------------------------------------------------


def _need_samples(run: Run) -> None:
    if len(run.time) < 2:
        raise InvalidParameter(f"plot: the run has {len(run.time)} samples, expected at least 2")


def run_action(run: Run) -> Action:
    """Mechanism of a run, made again from the text of its parameters.

    Raises
    ------
    InvalidParameter
        The run does not hold its parameters.
    """
    import tomllib

    from feltmb.config import Action

    text = run.provenance.get("toml")
    if not text:
        raise InvalidParameter("plot: the run does not hold the parameters of its mechanism")
    return Action(tomllib.loads(str(text)), origin=str(run.provenance.get("action", "run")))


def _contact_label(run: Run, number: int) -> str:
    name = f"contact{number:02d}.force"
    text = run.long_names[run.names.index(name)]
    label = text.partition(": ")[2]
    return _plain(f"{number} {label}" if label else f"contact {number}")


def _contact_numbers(run: Run) -> list[int]:
    found = (re.fullmatch(r"contact(\d+)\.force", name) for name in run.names)
    return sorted(int(match.group(1)) for match in found if match)


def _loaded_contacts(run: Run, least: float = 1e-6) -> list[int]:
    """Numbers of the contacts that carry more than ``least`` [N] at some sample."""
    return [n for n in _contact_numbers(run) if float(np.max(run[f"contact{n:02d}.force"])) > least]


_AUTOMATIC = re.compile(r"(contact\d+|finger)_(on|off)")


def _named_events(run: Run) -> list[tuple[float, str]]:
    """Times [s] and names of the events that the mechanism file names, in time, each once.

    A point that passes its travel again and again is an event each time; a rule names the first.
    """
    table = run.event_table
    first: dict[str, float] = {}
    for name, time in zip(table.get("event", []), table.get("time", []), strict=True):
        if not _AUTOMATIC.fullmatch(str(name)):
            first.setdefault(str(name), float(time))
    return sorted((time, name) for name, time in first.items())


def _action_window(run: Run) -> tuple[float, float]:
    """Times [s] around the named events, or the whole run if there are none or they fill it."""
    times = [t for t, _ in _named_events(run)]
    start, end = float(run.time[0]), float(run.time[-1])
    if len(times) < 2:
        return start, end
    first = min((t for t, name in _named_events(run) if name != "key_start"), default=times[0])
    span = max(times[-1] - first, 1e-3)
    return max(start, first - 0.6 * span), min(end, times[-1] + 1.2 * span)


def _busy_window(run: Run) -> tuple[float, float]:
    """Times [s] between which forces and motions change, with a margin."""
    start, end = float(run.time[0]), float(run.time[-1])
    columns = [
        i
        for i, name in enumerate(run.names)
        if re.fullmatch(r"contact\d+\.force|finger\.force|.+\.[xy]", name)
    ]
    if not columns:
        return start, end
    values = run.values[:, columns]
    size = np.ptp(values, axis=0)
    values = values[:, size > 1e-6 * max(float(size.max()), 1e-30)]
    size = np.ptp(values, axis=0)
    if size.size == 0:
        return start, end
    leaves = np.any(np.abs(values - values[0]) > 0.02 * size, axis=1)
    settles = np.any(np.abs(values - values[-1]) > 0.02 * size, axis=1)
    first = float(run.time[int(np.argmax(leaves))])
    last = float(run.time[len(run.time) - 1 - int(np.argmax(settles[::-1]))])
    span = max(last - first, 1e-3)
    return max(start, first - 0.06 * span), min(end, last + 0.06 * span)


def _spread(wanted: Sequence[float], gap: float) -> list[float]:
    """Positions nearest to the sorted ``wanted`` that keep ``gap`` between neighbors."""
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


def _mark_events(
    ax: Axes,
    run: Run,
    window: tuple[float, float],
    *,
    width: float,
    labels: bool = True,
    only: Iterable[str] | None = None,
) -> None:
    """Thin lines at the named events, their names above the axes without collision.

    ``window`` in s; ``width`` of the axes in inches, which decides how close names may stand.
    """
    chosen = None if only is None else set(only)
    low, high = window
    events = [
        (t, name)
        for t, name in _named_events(run)
        if low <= t <= high and (chosen is None or name in chosen)
    ]
    if not events:
        return
    fractions = [(t - low) / (high - low) for t, _ in events]
    gap = 1.3 * SMALL / 72.0 / width
    shift = _spread(fractions, gap)
    over = shift[-1] - 1.0
    if over > 0:
        shift = _spread(
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
            _plain(name.replace("_", " ")),
            transform=ax.transAxes,
            rotation=90,
            ha="center",
            va="bottom",
            fontsize=SMALL,
            color="#444444",
        )


# --- time series ---------------------------------------------------------------------------------

#: label, output, factor: what the thesis draws together in Figs 4.12 to 4.16.
_MOTION = (
    ("key front, dy", "key_front.y", 1.0, BLUE, "-"),
    ("whippen, dy", "whippen.y", 1.0, GREEN, "-"),
    ("4 × key lift", "key_balance.y", 4.0, PURPLE, "-"),
    ("hammer tip, dx", "hammer_tip.x", 1.0, RED, "-"),
    ("hammer tip, dy", "hammer_tip.y", 1.0, ORANGE, "--"),
)


def _motion_curves(run: Run) -> list[tuple[str, Array, str, str]]:
    """Label, displacement from the start [m], color and line style."""
    curves = [
        (label, factor * (run[name] - run[name][0]), color, style)
        for label, name, factor, color, style in _MOTION
        if name in run
    ]
    if curves:
        return curves
    points = [n for n in run.names if re.fullmatch(r".+\.[xy]", n) and run.unit(n) == "m"]
    for i, name in enumerate(points[:12]):
        point, axis = name[:-2], name[-1]
        color = CYCLE[(i // 2) % len(CYCLE)]
        style = "-" if axis == "y" else "--"
        curves.append((_plain(f"{point}, d{axis}"), run[name] - run[name][0], color, style))
    if not curves:
        raise InvalidParameter(
            "plot motion: the run has no tracking points; give the mechanism [points]"
        )
    return curves


def _draw_motion(ax: Axes, run: Run) -> None:
    for label, values, color, style in _motion_curves(run):
        ax.plot(
            1e3 * run.time, 1e3 * values, color=color, linestyle=style, linewidth=1.3, label=label
        )
    _style(ax, "time, ms", "displacement from start, mm")


def _set_window(ax: Axes, window: tuple[float, float]) -> None:
    """Limits of time [s], and of the ordinate from what is seen in them."""
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


def motion(run: Run) -> Figure:
    """Motion of key front, whippen, key lift (times 4) and hammer tip from their start.

    As thesis Figs 4.12 to 4.16; below, the time around the blow. A mechanism without these points
    shows its first tracking points.

    Raises
    ------
    InvalidParameter
        The run has no tracking points.
    """
    _need_samples(run)
    _motion_curves(run)
    whole = (float(run.time[0]), float(run.time[-1]))
    near = _action_window(run)
    zoom = near[1] - near[0] < 0.8 * (whole[1] - whole[0])
    figure = _figure(9.0, 7.4 if zoom else 4.6)
    _title(figure, run, "Motion")
    axes = figure.subplots(2 if zoom else 1, 1, squeeze=False)[:, 0]
    for ax, window in zip(axes, (whole, near), strict=False):
        _draw_motion(ax, run)
        _set_window(ax, window)
    if zoom:
        axes[0].axvspan(1e3 * near[0], 1e3 * near[1], color="#F2F2F2", zorder=0)
        axes[0].set_xlabel("")
        axes[0].set_title("whole run; gray: shown below", fontsize=SMALL + 0.5, loc="right")
        early = [name for t, name in _named_events(run) if not near[0] <= t <= near[1]]
        _mark_events(axes[0], run, whole, width=6.4, only=early)
    _mark_events(axes[-1], run, near if zoom else whole, width=6.4)
    _legend(axes[0])
    return figure


def _speed_name(run: Run) -> str:
    if "hammer_tip.vx" in run:
        return "hammer_tip.vx"
    raise InvalidParameter(
        "plot hammer_speed: the run has no output 'hammer_tip.vx'; give the mechanism a tracking "
        "point hammer_tip"
    )


def _draw_speed(ax: Axes, run: Run, *, marks: bool = True) -> None:
    # x points to the player: the hammer runs toward the string with negative speed.
    speed = -run[_speed_name(run)]
    ax.plot(1e3 * run.time, speed, color=RED, linewidth=1.3, label="hammer tip")
    ax.axhline(0.0, color=GRAY, linewidth=0.6)
    _style(ax, "time, ms", "speed toward string, m/s")
    if not marks:
        return
    top = float(np.max(speed))
    # After the impact the hammer runs away from the string: above zero there is room.
    for event, word, color, height in (
        ("string_contact_on", "impact", BLACK, 0.97),
        ("string_contact_off", "rebound", BLUE, 0.42),
    ):
        time = run.event_time(event)
        if time is None:
            continue
        value = float(np.interp(time, run.time, speed))
        ax.plot([1e3 * time], [value], "o", color=color, markersize=4, zorder=4)
        ax.annotate(
            f"{word} {1e3 * time:.1f} ms, {value:.2f} m/s",
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
        )


def hammer_speed(run: Run) -> Figure:
    """Horizontal speed [m/s] of the hammer tip, positive toward the string; thesis Figs 4.9, 4.10.

    Raises
    ------
    InvalidParameter
        The run has no output ``hammer_tip.vx``.
    """
    _need_samples(run)
    _speed_name(run)
    figure = _figure(7.5, 4.2)
    _title(figure, run, "Hammer speed")
    ax = figure.subplots()
    _draw_speed(ax, run)
    _set_window(ax, _action_window(run))
    return figure


def _grid(figure: Figure, count: int, columns: int) -> list[Axes]:
    rows = -(-count // columns)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes[count:]:
        ax.set_visible(False)
    return list(axes[:count])


def contact_forces(run: Run) -> Figure:
    """Normal force [N] of every contact that ever carries one, each with its peak.

    Raises
    ------
    InvalidParameter
        No contact carries force.
    """
    _need_samples(run)
    numbers = _loaded_contacts(run)
    if not numbers:
        raise InvalidParameter("plot contact_forces: no contact of the run carries force")
    columns = min(4, len(numbers))
    rows = -(-len(numbers) // columns)
    figure = _figure(2.9 * columns + 0.4, 1.75 * rows + 0.7)
    _title(figure, run, "Contact forces")
    window = _busy_window(run)
    for i, (ax, number) in enumerate(
        zip(_grid(figure, len(numbers), columns), numbers, strict=True)
    ):
        force = run[f"contact{number:02d}.force"]
        peak = int(np.argmax(force))
        ax.fill_between(1e3 * run.time, force, color=BLUE, alpha=0.15, linewidth=0)
        ax.plot(1e3 * run.time, force, color=BLUE, linewidth=1.0)
        last = i + columns >= len(numbers)
        _style(ax, "time, ms" if last else "", "force, N" if i % columns == 0 else "")
        ax.set_title(_contact_label(run, number), fontsize=SMALL + 1, loc="left", pad=13)
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


def _draw_finger(ax: Axes, run: Run) -> None:
    ax.plot(
        1e3 * run.time, run["finger.force"], color=BLUE, linewidth=1.3, label="force on the key"
    )
    _style(ax, "time, ms", "finger force, N")


def _need_output(run: Run, name: str, picture: str) -> None:
    if name not in run:
        raise InvalidParameter(f"plot {picture}: the run has no output {name!r}")


def finger_force(run: Run) -> Figure:
    """Force [N] and travel [mm] of the finger; of a prescribed motion also what was prescribed.

    Raises
    ------
    InvalidParameter
        The run has no finger.
    """
    _need_samples(run)
    _need_output(run, "finger.force", "finger_force")
    travel = "finger.displacement" in run
    figure = _figure(8.0, 5.0 if travel else 3.4)
    _title(figure, run, "Finger")
    axes = figure.subplots(2 if travel else 1, 1, squeeze=False, sharex=True)[:, 0]
    window = (float(run.time[0]), float(run.time[-1]))
    _draw_finger(axes[0], run)
    _set_window(axes[0], window)
    _mark_events(axes[0], run, window, width=6.0)
    if travel:
        ax = axes[1]
        axes[0].set_xlabel("")
        moved = run.provenance.get("stroke", {}).get("kind") in ("motion", "key_motion")
        travelled = run["finger.displacement"] - (0.0 if moved else run["finger.displacement"][0])
        ax.plot(
            1e3 * run.time,
            1e3 * travelled,
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
            _legend(ax)
        _style(ax, "time, ms", "travel, mm")
        _set_window(ax, window)
        _mark_events(ax, run, window, width=6.0, labels=False)
    return figure


def _string_window(run: Run) -> tuple[float, float]:
    start, end = float(run.time[0]), float(run.time[-1])
    strike = np.abs(run["string.strike"]) if "string.strike" in run else np.zeros(1)
    top = float(strike.max())
    if top <= 0:
        return start, end
    moving = np.flatnonzero(strike > 0.02 * top)
    first, last = float(run.time[moving[0]]), float(run.time[moving[-1]])
    span = max(last - first, 2e-3)
    return max(start, first - 0.08 * span), min(end, last + 0.08 * span)


def string(run: Run) -> Figure:
    """String: displacement at the strike point, bridge force, and its shape over time.

    Raises
    ------
    InvalidParameter
        The run has no modal string.
    """
    _need_samples(run)
    parameters = run.provenance.get("string")
    shape = bool(parameters) and run.eta.ndim == 2 and run.eta.shape[1] > 0
    names = [n for n in ("string.strike", "string.bridge_force") if n in run]
    if not names and not shape:
        raise InvalidParameter("plot string: the run has no modal string")
    window = _string_window(run)
    figure = _figure(8.0, 1.9 * len(names) + (2.8 if shape else 0.0) + 0.4)
    _title(figure, run, "String")
    rows = len(names) + int(shape)
    heights = [1.0] * len(names) + [1.5] * int(shape)
    axes = figure.subplots(rows, 1, squeeze=False, sharex=True, height_ratios=heights)[:, 0]
    for ax, name in zip(axes, names, strict=False):
        factor, unit = _reader(run.unit(name))
        what = "strike point" if name == "string.strike" else "bridge force"
        color = RED if name == "string.strike" else BLUE
        ax.plot(1e3 * run.time, factor * run[name], color=color, linewidth=1.2)
        ax.axhline(0.0, color=GRAY, linewidth=0.6)
        _style(ax, "", f"{what}, {unit}")
        _set_window(ax, window)
        only = ("string_contact_on", "string_contact_off")
        _mark_events(ax, run, window, width=6.0, only=only, labels=ax is axes[0])
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
        _style(ax, "", "distance from end, mm")
        ax.grid(False)
        bar = figure.colorbar(image, ax=ax, pad=0.015, aspect=18)
        bar.set_label("displacement away\nfrom the hammer, mm", fontsize=SMALL + 0.5)
        bar.ax.tick_params(labelsize=SMALL)
    axes[-1].set_xlabel("time, ms", fontsize=NORMAL)
    return figure


_STORED = (
    ("kinetic", "kinetic", BLUE),
    ("gravity", "gravity", GREEN),
    ("elastic", "springs, straps,\nflexible members", PURPLE),
    ("contact", "felt", ORANGE),
    ("string", "string", SKY),
)


def _finger_work(run: Run) -> Array | None:
    if "finger.force" not in run or "finger.displacement" not in run:
        return None
    force, travel = run["finger.force"], run["finger.displacement"]
    steps = 0.5 * (force[1:] + force[:-1]) * np.diff(travel)
    return np.concatenate([[0.0], np.cumsum(steps)])


def energy(run: Run) -> Figure:
    """Energies [mJ] stored since the start, finger work, and where energy went.

    The bars and the residual come from the ledger, if the run has one.

    Raises
    ------
    InvalidParameter
        The run has no energies.
    """
    _need_samples(run)
    parts = [(f"energy.{n}", label, c) for n, label, c in _STORED if f"energy.{n}" in run]
    if not parts:
        raise InvalidParameter("plot energy: the run has no energies")
    dissipated = run.energy.get("dissipated", {})
    figure = _figure(9.0, 7.2 if dissipated else 4.2)
    _title(figure, run, "Energy")
    axes = figure.subplots(2 if dissipated else 1, 1, squeeze=False, height_ratios=None)[:, 0]
    ax = axes[0]
    t = 1e3 * run.time
    above, below = np.zeros_like(t), np.zeros_like(t)
    for name, label, color in parts:
        change = 1e3 * (run[name] - run[name][0])
        up, down = np.clip(change, 0, None), np.clip(change, None, 0)
        ax.fill_between(t, above, above + up, color=color, alpha=0.8, linewidth=0, label=label)
        ax.fill_between(t, below, below + down, color=color, alpha=0.8, linewidth=0)
        above, below = above + up, below + down
    ax.plot(t, above + below, color=BLACK, linewidth=1.1, label="sum stored")
    work = _finger_work(run)
    if work is not None:
        ax.plot(t, 1e3 * work, color=RED, linewidth=1.2, linestyle="--", label="finger work")
        ax.fill_between(
            t,
            above + below,
            1e3 * work,
            facecolor="none",
            edgecolor=PALE,
            hatch="////",
            linewidth=0,
            label="lost to friction\nand felt",
            zorder=0,
        )
    ax.axhline(0.0, color=GRAY, linewidth=0.6)
    _style(ax, "time, ms", "change since start, mJ")
    window = _busy_window(run)
    ax.set_xlim(1e3 * window[0], 1e3 * window[1])
    top = max(float(above.max()), 1e3 * float(work.max()) if work is not None else 0.0)
    bottom = float(below.min())
    pad = 0.05 * (top - bottom) or 1.0
    ax.set_ylim(bottom - pad if bottom < 0 else -0.4 * pad, top + pad)
    _mark_events(ax, run, window, width=6.2)
    _legend(ax)
    if dissipated:
        _dissipation_bars(axes[1], run, dissipated)
    return figure


def _dissipation_bars(ax: Axes, run: Run, dissipated: Mapping[str, float]) -> None:
    groups: dict[str, dict[str, float]] = {}
    for name, value in dissipated.items():
        match = re.fullmatch(r"contact(\d+)\.(normal|friction)", name)
        if match and f"contact{match.group(1)}.force" in run:
            key, kind = _contact_label(run, int(match.group(1))), match.group(2)
        elif match:
            key, kind = f"contact {int(match.group(1))}", match.group(2)
        else:
            key = _plain(name.replace("joint.", "joint "))
            kind = "friction" if name.startswith("joint.") else "normal"
        groups.setdefault(key, {})[kind] = 1e3 * value + groups.get(key, {}).get(kind, 0.0)
    order = sorted(groups, key=lambda k: -abs(sum(groups[k].values())))
    shown = order[:12]
    if len(order) > 12:
        rest = f"{len(order) - 12} others"
        groups[rest] = {
            kind: sum(groups[k].get(kind, 0.0) for k in order[12:])
            for kind in ("normal", "friction")
        }
        shown.append(rest)
    rows = np.arange(len(shown))
    left = np.zeros(len(shown))
    ends = [0.0]
    for kind, label, color in (
        ("normal", "felt, string,\nflexible members", ORANGE),
        ("friction", "friction", BLUE),
    ):
        values = np.array([groups[k].get(kind, 0.0) for k in shown])
        ax.barh(rows, values, left=left, color=color, height=0.7, label=label)
        left = left + values
        ends += left.tolist()
    ax.set_yticks(rows, shown)
    ax.invert_yaxis()
    room = 0.04 * (max(ends) - min(ends)) or 1.0
    ax.set_xlim(min(ends) - (room if min(ends) < 0 else 0.0), max(ends) + room)
    _style(ax, "dissipated in the whole run, mJ")
    ax.grid(False, axis="y")
    ledger = run.energy
    if "residual_relative" in ledger:
        ax.set_title(
            f"work in {1e3 * ledger['work_in']:.4g} mJ, dissipated "
            f"{1e3 * ledger['dissipated_total']:.4g} mJ; largest residual "
            f"{1e3 * ledger['residual_largest']:.2g} mJ = "
            f"{ledger['residual_relative']:.1e} of the energy that went through",
            fontsize=SMALL + 0.5,
            loc="left",
        )
    _legend(ax)


def loops(run: Run, numbers: Sequence[int] | None = None) -> Figure:
    """Force against compression of contacts, over the loading and unloading curves of their laws.

    Parameters
    ----------
    run
        The mechanism's laws are read from its provenance.
    numbers
        Contacts; default: all that carry force.

    Raises
    ------
    InvalidParameter
        A number is no contact, or no contact carries force.
    """
    from feltmb.config import core_law

    _need_samples(run)
    known = _contact_numbers(run)
    chosen = _loaded_contacts(run) if numbers is None else [int(n) for n in numbers]
    for number in chosen:
        if number not in known:
            raise InvalidParameter(
                f"plot loops: there is no contact {number}; contacts are "
                f"{', '.join(map(str, known)) or 'none'}"
            )
    if not chosen:
        raise InvalidParameter("plot loops: no contact of the run carries force")
    laws = {int(k): c for k, c in run_action(run).config.contacts.items()}
    columns = min(4, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = _figure(max(2.7 * columns + 0.4, 5.0), 2.3 * rows + 0.9)
    _title(figure, run, "Force and compression")
    for i, (ax, number) in enumerate(zip(_grid(figure, len(chosen), columns), chosen, strict=True)):
        compression = run[f"contact{number:02d}.compression"]
        force = run[f"contact{number:02d}.force"]
        deepest = max(float(compression.max()), 1e-6)
        e = np.linspace(0.0, 1.08 * deepest, 200)
        contact = laws[number]
        if contact.law == "hunt_crossley":
            static = np.asarray(_core.ContactLaw(core_law(contact)).force(e))
            ax.plot(1e3 * e, static, color="#B0B0B0", linewidth=2.4, label="law at rest")
        else:
            for curve, style, label in (
                (contact.loading, "-", "law, loading"),
                (contact.unloading, (0, (2, 1)), "law, unloading"),
            ):
                assert curve is not None
                values = np.asarray(_core.ExponentialCurve(curve.a, curve.b, curve.c).force(e))
                ax.plot(
                    1e3 * e, values, color="#B0B0B0", linewidth=2.4, linestyle=style, label=label
                )
        touching = compression > 0
        loop = np.where(touching, force, np.nan)
        ax.plot(1e3 * compression, loop, color=RED, linewidth=0.9, label="run")
        _style(
            ax,
            "compression, mm" if i + columns >= len(chosen) else "",
            "force, N" if i % columns == 0 else "",
        )
        ax.set_title(_contact_label(run, number), fontsize=SMALL + 0.5, loc="left")
        ax.set_xlim(0.0, 1.08e3 * deepest)
        peak = max(float(force.max()), 1e-6)
        ax.set_ylim(-0.03 * peak, 1.12 * peak)
        ax.locator_params(nbins=4)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower right", ncols=3, frameon=False, fontsize=NORMAL - 0.5
    )
    return figure


def overview(run: Run) -> Figure:
    """One page of a stroke: finger, motion, hammer speed, largest contact forces, string, felt.

    Raises
    ------
    InvalidParameter
        The run has neither finger, tracking points nor contacts.
    """
    _need_samples(run)
    whole = (float(run.time[0]), float(run.time[-1]))
    near = _action_window(run)
    seen = (run.time >= near[0]) & (run.time <= near[1])
    peaks = {n: float(np.max(run[f"contact{n:02d}.force"][seen])) for n in _loaded_contacts(run)}
    numbers = sorted((n for n, peak in peaks.items() if peak > 0), key=lambda n: -peaks[n])
    panels: list[str] = []
    if "finger.force" in run:
        panels.append("finger")
    try:
        _motion_curves(run)
        panels.append("motion")
    except InvalidParameter:
        pass
    if "hammer_tip.vx" in run:
        panels.append("speed")
    if numbers:
        panels.append("forces")
    if not panels:
        raise InvalidParameter("plot overview: the run has no finger, tracking points or contacts")
    heights = {"finger": 0.9, "motion": 1.5, "speed": 1.1, "forces": 1.5}
    total = sum(heights[p] for p in panels)
    figure = _figure(8.6, 1.9 * total + 0.9)
    _title(figure, run, "Stroke")
    axes = figure.subplots(
        len(panels), 1, squeeze=False, height_ratios=[heights[p] for p in panels]
    )[:, 0]
    labelled = False
    for ax, panel in zip(axes, panels, strict=True):
        window = whole if panel == "finger" else near
        if panel == "finger":
            _draw_finger(ax, run)
            if near != whole:
                ax.axvspan(1e3 * near[0], 1e3 * near[1], color="#F2F2F2", zorder=0)
                ax.set_title("whole run; gray: shown below", fontsize=SMALL, loc="right")
        elif panel == "motion":
            _draw_motion(ax, run)
            ax.set_ylabel("displacement, mm", fontsize=NORMAL)
        elif panel == "speed":
            _draw_speed(ax, run)
        else:
            for number, color in zip(numbers[:6], CYCLE, strict=False):
                ax.plot(
                    1e3 * run.time,
                    run[f"contact{number:02d}.force"],
                    color=color,
                    linewidth=1.1,
                    label=_contact_label(run, number),
                )
            _style(ax, "time, ms", "contact force, N")
        _set_window(ax, window)
        if window == near:
            _mark_events(ax, run, near, width=5.2, labels=not labelled)
            labelled = True
        if panel in ("motion", "forces"):
            _legend(ax)
        if ax is not axes[-1] and panel != "finger":
            ax.set_xlabel("")
    summary = _summary_line(run)
    if summary:
        figure.supxlabel(summary, fontsize=SMALL + 1, x=0.01, ha="left")
    return figure


def _summary_line(run: Run) -> str:
    s = run.summary
    parts = []
    for key, text, factor, unit in (
        ("impact_speed", "approach at impact", 1.0, "m/s"),
        ("rebound_speed", "at rebound", 1.0, "m/s"),
        ("max_string_force", "largest string force", 1.0, "N"),
        ("string_contact_duration", "string contact", 1e3, "ms"),
        ("let_off_gap", "let-off gap", 1e3, "mm"),
        ("check_gap", "check distance", 1e3, "mm"),
    ):
        if key in s:
            parts.append(f"{text} {factor * s[key]:.3g} {unit}")
    half = -(-len(parts) // 2)
    return "\n".join("   ".join(row) for row in (parts[:half], parts[half:]) if row)


def compare(runs: Sequence[Run], names: Sequence[str]) -> Figure:
    """Overlay outputs of several runs, one panel for each output.

    Parameters
    ----------
    runs
        One or more; each becomes one color.
    names
        Outputs, such as ``["hammer_tip.vx", "contact06.force"]``. A run without one of them is
        left out of that panel.

    Raises
    ------
    InvalidParameter
        No runs, no names, or an output that no run has.
    """
    if not runs or not names:
        raise InvalidParameter(
            f"plot compare: got {len(runs)} runs and {len(names)} outputs, expected one or more"
        )
    for run in runs:
        _need_samples(run)
    figure = _figure(8.8, 2.3 * len(names) + 0.7)
    figure.suptitle("Comparison", fontsize=LARGE, x=0.01, ha="left", fontweight="bold")
    axes = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
    labels = [_run_name(run) or f"run {i + 1}" for i, run in enumerate(runs)]
    doubled = {label for label in labels if labels.count(label) > 1}
    labels = [f"{label} ({i + 1})" if label in doubled else label for i, label in enumerate(labels)]
    shown: dict[str, Any] = {}
    for ax, name in zip(axes, names, strict=True):
        having = [i for i, run in enumerate(runs) if name in run]
        if not having:
            runs[0][name]  # raises with names that are near
        first = runs[having[0]]
        factor, unit = _reader(first.unit(name))
        for i in having:
            (line,) = ax.plot(
                1e3 * runs[i].time,
                factor * runs[i][name],
                color=CYCLE[i % len(CYCLE)],
                linestyle=("-", "--", ":")[(i // len(CYCLE)) % 3],
                linewidth=1.1,
            )
            shown.setdefault(labels[i], line)
        _style(ax, "", f"{name}, {unit}")
        text = first.long_names[first.names.index(name)]
        ax.set_title(_plain(text), fontsize=SMALL + 0.5, loc="left", color=GRAY)
    axes[-1].set_xlabel("time, ms", fontsize=NORMAL)
    axes[0].set_xlim(
        1e3 * min(float(r.time[0]) for r in runs), 1e3 * max(float(r.time[-1]) for r in runs)
    )
    axes[0].legend(
        shown.values(),
        shown.keys(),
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        frameon=False,
        fontsize=NORMAL - 0.5,
    )
    return figure


# --- the mechanism as shapes ---------------------------------------------------------------------

Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Shape:
    """A polygon or polyline fixed to a body.

    Attributes
    ----------
    body, role, name : str
        ``role`` is ``wood``, ``wire``, ``pad`` (what a contact surface is cut from), ``surface``
        (the exact contact geometry), ``mark``; ``name`` of the surface or point it stands for.
    points : ndarray (n, 2)
        In the frame of the body [m].
    closed : bool
        Polygon, not polyline.
    """

    body: str
    role: str
    name: str
    points: Array
    closed: bool


@dataclass(frozen=True)
class Scene:
    """What to draw of a mechanism, independent of its pose.

    Attributes
    ----------
    shapes : tuple of Shape
        In the order of drawing.
    group : dict
        Body -> index of the group of bodies welded together; ground is -1.
    unit : float
        Length [m] that counts as small for this mechanism.
    """

    shapes: tuple[Shape, ...]
    group: dict[str, int]
    unit: float


def body_poses(action: Action, q: npt.ArrayLike) -> dict[str, Pose]:
    """Origin x, y [m] and angle [rad] of every body, of a flexible beam at its clamped end.

    Parameters
    ----------
    q
        Mechanical coordinates [rad, m] in the order of ``action.coordinates``.
    """
    locate: Any = getattr(_core, "body_poses", None)  # the stub of the core may lag behind
    found = locate(action.mechanism, np.asarray(q, dtype=float).ravel())
    poses: dict[str, Pose] = {"ground": (0.0, 0.0, 0.0)}
    for name, (x, y, angle) in found.items():
        poses[str(name)] = (float(x), float(y), float(angle))
    return poses


def bent_beams(action: Action, q: npt.ArrayLike) -> dict[str, Array]:
    """Center lines (n, 2) [m] of the flexible beams in the frames of their clamped ends."""
    mechanism = action.mechanism
    names = getattr(mechanism, "beam_names", ())  # the stub of the core may lag behind
    position = np.asarray(q, dtype=float).ravel()
    line: Any = getattr(mechanism, "beam_centerline", None)
    return {str(n): np.asarray(line(n, position, 25)) for n in names}


def bend(points: Array, line: Array, length: float) -> Array:
    """Points of a straight beam [m] after it took the shape of a center line."""
    grid = np.linspace(0.0, length, len(line))
    slope = np.gradient(line, grid, axis=0)
    slope /= np.hypot(slope[:, 0], slope[:, 1])[:, None]
    s = np.clip(points[:, 0], 0.0, length)
    center = np.column_stack([np.interp(s, grid, line[:, k]) for k in (0, 1)])
    along = np.column_stack([np.interp(s, grid, slope[:, k]) for k in (0, 1)])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    out: Array = center + (points[:, 0] - s)[:, None] * along + points[:, 1, None] * across
    return out


def station(points: Array, line: Array, length: float, x: float) -> Array:
    """Points fixed to the cross section at ``x`` [m] of a beam that took the shape of a line."""
    grid = np.linspace(0.0, length, len(line))
    at = np.array([np.interp(x, grid, line[:, k]) for k in (0, 1)])
    angle = float(np.interp(x, grid, np.gradient(line[:, 1], grid, edge_order=2)))
    return _to_ground((float(at[0]), float(at[1]), angle), points - np.array([x, 0.0]))


def _point_at(
    action: Action,
    poses: Mapping[str, Pose],
    bent: Mapping[str, Array],
    body: str,
    point: npt.ArrayLike,
) -> Array:
    """Place in the ground frame [m] of a point of a body, also of a flexible beam."""
    p = np.asarray(point, dtype=float)
    if body in bent:
        length = action.config.bodies[body].length or 1.0
        p = station(p[None, :], bent[body], length, float(p[0]))[0]
    out: Array = _to_ground(poses[body], p[None, :])[0]
    return out


def _to_ground(pose: Pose, points: Array) -> Array:
    x, y, angle = pose
    c, s = math.cos(angle), math.sin(angle)
    out: Array = points @ np.array([[c, s], [-s, c]]) + np.array([x, y])
    return out


def _to_body(pose: Pose, points: Array) -> Array:
    x, y, angle = pose
    c, s = math.cos(angle), math.sin(angle)
    out: Array = (points - np.array([x, y])) @ np.array([[c, -s], [s, c]])
    return out


def contact_rows(action: Action, q: npt.ArrayLike) -> dict[int, tuple[float, ...]]:
    """Number -> (x, y [m] of the contact point, normal into the circle's body, compression [m])."""
    position = np.asarray(q, dtype=float).ravel()
    out = _core.evaluate(action.mechanism, position, np.zeros_like(position), 0.0)
    # Columns of the core: number, compression, rate, force, slip, friction, x, y, normal.
    return {
        int(row[0]): (row[6], row[7], row[8], row[9], row[1])
        for row in out["contacts"]
        if int(row[0]) > 0
    }


def _circle(center: Array, radius: float, low: float, high: float) -> Array:
    """Points of an arc; the polygon leaves it by less than 1 um."""
    step = 2.0 * math.acos(max(0.0, 1.0 - 1e-6 / max(radius, 2e-6)))
    count = max(9, math.ceil(abs(high - low) / step) + 1)
    angle = np.linspace(low, high, count)
    return center + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _wrap(angle: float, about: float) -> float:
    return about + math.remainder(angle - about, 2.0 * math.pi)


def _capsule(a: Array, ra: float, b: Array, rb: float) -> Array:
    """Outline of the convex hull of two discs."""
    d = b - a
    length = float(np.hypot(*d))
    if length <= abs(ra - rb) + 1e-12:
        center, radius = (a, ra) if ra >= rb else (b, rb)
        angle = np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False)
        return center + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    along = math.atan2(d[1], d[0])
    half = math.acos((ra - rb) / length)
    first = np.linspace(along + half, along + 2.0 * math.pi - half, 24)
    second = np.linspace(along - half, along + half, 24)
    return np.vstack(
        [
            a + ra * np.column_stack([np.cos(first), np.sin(first)]),
            b + rb * np.column_stack([np.cos(second), np.sin(second)]),
        ]
    )


def _dense(outline: Array, step: float) -> Array:
    """Closed outline with points no further apart than ``step``, so that it can bend."""
    parts = []
    for a, b in itertools.pairwise(np.vstack([outline, outline[:1]])):
        count = max(1, math.ceil(float(np.hypot(*(b - a))) / step))
        parts.append(a + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (b - a))
    return np.vstack(parts)


def _box(low: Array, high: Array, radius: float) -> Array:
    """Rectangle with round corners."""
    corners = []
    for x, y, start in (
        (high[0], high[1], 0.0),
        (low[0], high[1], 0.5),
        (low[0], low[1], 1.0),
        (high[0], low[1], 1.5),
    ):
        angle = np.linspace(start, start + 0.5, 7) * math.pi
        sx, sy = (1.0 if x == high[0] else -1.0), (1.0 if y == high[1] else -1.0)
        center = np.array([x - sx * radius, y - sy * radius])
        corners.append(center + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.vstack(corners)


def _unit(action: Action, poses: Mapping[str, Pose]) -> float:
    """Size of the mechanism over 500: one millimeter of an upright action."""
    points = [
        _to_ground(poses[s.body], np.array([s.point]))
        for s in action.config.surfaces.values()
        if s.radius is None or s.radius < 0.05
    ]
    points += [np.array([pose[:2]]) for pose in poses.values()]
    points += [
        _to_ground(poses[p.body], np.array([p.point])) for p in action.config.points.values()
    ]
    cloud = np.vstack(points)
    size = float(np.max(np.ptp(cloud, axis=0)))
    return size / 500.0 if size > 0 else 1e-3


def _used_surfaces(action: Action) -> dict[str, Surface]:
    """Surfaces of contacts that are on."""
    names = {n for c in action.config.contacts.values() if c.enabled for n in c.surfaces}
    return {n: s for n, s in action.config.surfaces.items() if n in names}


def scene(action: Action, poses: Sequence[npt.ArrayLike] = ()) -> Scene:
    """Shapes of a mechanism.

    Surfaces are infinite lines and full circles to the simulation; drawn are the pieces near the
    tabulated point and near where the contact is at rest and in ``poses``.

    Parameters
    ----------
    poses
        Coordinates q [rad, m] of poses in which the drawn pieces must reach the contact points.
    """
    config = action.config
    rest = action.rest_pose
    rest_poses = body_poses(action, rest)
    u = _unit(action, rest_poses)
    surfaces = _used_surfaces(action)
    touched: dict[str, list[Array]] = {name: [] for name in surfaces}
    for q in (rest, *poses):
        where = rest_poses if q is rest else body_poses(action, q)
        rows = contact_rows(action, q)
        for key, contact in config.contacts.items():
            if contact.enabled and int(key) in rows:
                point = np.array([rows[int(key)][:2]])
                for name in contact.surfaces:
                    touched[name].append(_to_body(where[surfaces[name].body], point)[0])
    string_surface = config.string.surface if config.string is not None else ""
    pieces = {
        name: _surface_piece(name, s, touched[name], _center(action, s.body), u)
        for name, s in surfaces.items()
    }
    shapes: list[Shape] = []
    group = _groups(action)
    strings = {name for name, s in surfaces.items() if _is_string(action, name, string_surface)}
    for name, piece in pieces.items():
        if surfaces[name].body == "ground" and name not in strings:
            shapes += piece.shapes
    for body in config.bodies:
        own = {n: p for n, p in pieces.items() if surfaces[n].body == body}
        shapes += _body_shapes(action, body, own, u)
        for piece in own.values():
            shapes += piece.shapes
    return Scene(tuple(shapes), group, u)


def _is_string(action: Action, name: str, string_surface: str) -> bool:
    """The surface of the string, or another one on the same line (the damper's)."""
    if not string_surface or name not in action.config.surfaces:
        return False
    if name == string_surface:
        return True
    a, b = action.config.surfaces[name], action.config.surfaces[string_surface]
    if a.kind != "line" or b.kind != "line" or a.body != b.body or not a.normal or not b.normal:
        return False
    off = np.dot(np.subtract(a.point, b.point), b.normal)
    return abs(off) < 1e-3 and float(np.dot(a.normal, b.normal)) > 0.999


def _center(action: Action, body: str) -> Array:
    if body == "ground":
        return np.zeros(2)
    b = action.config.bodies[body]
    return (
        np.array([0.5 * b.length, 0.0])
        if b.kind == "beam" and b.length
        else np.array(b.center_of_mass)
    )


def _groups(action: Action) -> dict[str, int]:
    group = {"ground": -1}
    for name, body in action.config.bodies.items():
        chain, parent = name, body
        while parent.joint == "weld" and parent.parent != "ground":
            chain = parent.parent
            parent = action.config.bodies[chain]
        if parent.joint == "weld":
            group[name] = -1
        else:
            group.setdefault(chain, len(set(group.values()) - {-1}))
            group[name] = group[chain]
    return group


@dataclass(frozen=True)
class _Piece:
    """Drawn piece of a surface, and where and how thick the body must reach it."""

    shapes: list[Shape]
    node: Array
    radius: float
    small: bool


def _surface_piece(name: str, s: Surface, touched: list[Array], center: Array, u: float) -> _Piece:
    p = np.array(s.point)
    ground = s.body == "ground"
    depth = (4.5 if ground else 2.4) * u
    if s.kind == "line":
        assert s.normal is not None
        normal = np.array(s.normal) / np.hypot(*s.normal)
        along = np.array([normal[1], -normal[0]])
        places = [0.0] + [float(along @ (t - p)) for t in touched]
        # Far from its tabulated point only the place of the contact is material for sure.
        if len(touched) and min(abs(x) for x in places[1:]) > 60.0 * u:
            places = places[1:]
        pad = 6.5 * u
        a, b = p + along * (min(places) - pad), p + along * (max(places) + pad)
        line = np.array([a, b])
        block = np.array([a, b, b - normal * depth, a - normal * depth])
        node = 0.5 * (a + b) - 0.5 * depth * normal
        shapes = [
            Shape(s.body, "pad", name, block, True),
            Shape(s.body, "surface", name, line, False),
        ]
        return _Piece(shapes, node, 0.5 * depth, False)
    radius = float(s.radius or 0.0)
    angles = [math.atan2(t[1] - p[1], t[0] - p[0]) for t in touched]
    if s.kind == "hybrid":
        assert s.arc is not None
        return _hybrid_piece(name, s, touched, u)
    if s.kind == "circle" and radius <= 14.0 * u:
        if radius <= 0.05 * u:
            dot = _circle(p, 0.4 * u, 0.0, 2.0 * math.pi)[:-1]
            return _Piece([Shape(s.body, "mark", name, dot, True)], p, 0.5 * u, True)
        ring = _circle(p, radius, 0.0, 2.0 * math.pi)[:-1]
        shapes = [
            Shape(s.body, "pad", name, ring, True),
            Shape(s.body, "surface", name, np.vstack([ring, ring[:1]]), False),
        ]
        return _Piece(shapes, p, radius, True)
    if s.kind == "concave":
        toward = center - p
        angles.append(math.atan2(toward[1], toward[0]))
    about = angles[0] if angles else math.atan2(center[1] - p[1], center[0] - p[0])
    angles = [_wrap(a, about) for a in angles] or [about]
    pad = 9.0 * u / radius
    low, high = min(angles) - pad, max(angles) + pad
    if high - low >= 2.0 * math.pi:
        low, high = 0.0, 2.0 * math.pi
    arc = _circle(p, radius, low, high)
    other = radius + depth if s.kind == "concave" else max(radius - depth, 0.0)
    band = np.vstack([arc, _circle(p, other, high, low) if other > 0 else p[None, :]])
    middle = 0.5 * (low + high)
    node = p + 0.5 * (radius + other) * np.array([math.cos(middle), math.sin(middle)])
    shapes = [
        Shape(s.body, "pad", name, band, True),
        Shape(s.body, "surface", name, arc, False),
    ]
    return _Piece(shapes, node, 2.6 * u, False)


def _hybrid_piece(name: str, s: Surface, touched: list[Array], u: float) -> _Piece:
    """Arc and its two tangent half-lines: clockwise before the first angle, on after the second."""
    assert s.arc is not None
    p, radius = np.array(s.point), float(s.radius or 0.0)
    low, high = s.arc
    before = np.array([math.sin(low), -math.cos(low)])
    after = np.array([-math.sin(high), math.cos(high)])
    first = p + radius * np.array([math.cos(low), math.sin(low)])
    last = p + radius * np.array([math.cos(high), math.sin(high)])
    reach_before = max([6.0 * u] + [float(before @ (t - first)) + 2.0 * u for t in touched])
    reach_after = max([8.0 * u] + [float(after @ (t - last)) + 2.0 * u for t in touched])
    curve = np.vstack(
        [first + before * reach_before, _circle(p, radius, low, high), last + after * reach_after]
    )
    depth = 5.0 * u
    inner = np.vstack(
        [last + after * reach_after + before * depth, first + before * reach_before + after * depth]
    )
    shapes = [
        Shape(s.body, "pad", name, np.vstack([curve, inner]), True),
        Shape(s.body, "surface", name, curve, False),
    ]
    return _Piece(shapes, p + (before + after) * 0.5 * depth, 2.2 * u, False)


def _body_shapes(action: Action, name: str, pieces: Mapping[str, _Piece], u: float) -> list[Shape]:
    """Plausible outline: a rod, a bar, or limbs between joints, surfaces and center of mass."""
    config = action.config
    body = config.bodies[name]
    thin: list[Array] = []
    for strap in config.straps.values():
        for end, place in ((strap.body_a, strap.point_a), (strap.body_b, strap.point_b)):
            if end == name and strap.enabled:
                thin.append(np.array(place))
    if body.kind == "beam":
        assert body.length is not None
        assert body.area is not None
        radius = math.sqrt(body.area / math.pi)
        rod = _dense(_capsule(np.zeros(2), radius, np.array([body.length, 0.0]), radius), 4.0 * u)
        role = "wire" if radius < 2.0 * u else "wood"
        return [Shape(name, role, name, rod, True)]
    children = [
        np.array(b.position)
        for b in config.bodies.values()
        if b.parent == name and b.joint != "prismatic"
    ]
    masses = sorted(b.mass for b in config.bodies.values() if b.mass > 0)
    if body.mass <= 0 and not pieces and not thin:
        return []
    median = masses[len(masses) // 2] if masses else 1.0
    heavy = min(8.0, max(2.4, 5.5 * math.sqrt(body.mass / median))) * u
    nodes: list[tuple[Array, float]] = [(np.zeros(2), 4.2 * u)]
    nodes += [(c, 3.8 * u) for c in children]
    finger = []
    if config.finger is not None and config.finger.body == name:
        finger = [np.array(config.finger.point)]
    massive = [n for n, _ in nodes] + [p.node for p in pieces.values() if not p.small] + finger
    massive.append(np.array(body.center_of_mass))
    bar = _bar(np.array(massive), pieces, u)
    shapes: list[Shape] = []
    if bar is not None:
        shapes.append(Shape(name, "wood", name, bar, True))
        low, high = bar.min(axis=0), bar.max(axis=0)
        for piece in pieces.values():
            foot = np.clip(piece.node, low + 2.0 * u, high - 2.0 * u)
            if piece.small and np.hypot(*(piece.node - foot)) > 2.0 * u:
                radius = min(piece.radius, 3.0 * u)
                shapes.append(
                    Shape(name, "wood", name, _capsule(foot, radius, piece.node, radius), True)
                )
        for point in thin:
            foot = np.clip(point, low, high)
            shapes.append(Shape(name, "wire", name, _capsule(foot, 0.7 * u, point, 0.7 * u), True))
        return shapes
    nodes.insert(len(children) + 1, (np.array(body.center_of_mass), heavy))
    nodes += [(p.node, p.radius) for p in pieces.values()]
    for a, b in _tree([n for n, _ in nodes], len(children) + 1):
        (pa, ra), (pb, rb) = nodes[a], nodes[b]
        gap = float(np.hypot(*(pb - pa)))
        if gap > 1.5 * (ra + rb):
            # Far apart: a limb no thicker than needed, the discs at its ends stay visible.
            ra, rb = min(ra, 3.6 * u), min(rb, 3.6 * u)
        shapes.append(
            Shape(name, "wood", name, _capsule(pa, max(ra, 1.2 * u), pb, max(rb, 1.2 * u)), True)
        )
    for node, radius in nodes:
        if radius > 2.8 * u and len(nodes) > 1:
            shapes.append(Shape(name, "wood", name, _capsule(node, radius, node, radius), True))
    for point in thin:
        near = min(nodes, key=lambda n: float(np.hypot(*(n[0] - point))))[0]
        if np.hypot(*(near - point)) > 1e-9:
            shapes.insert(
                0, Shape(name, "wire", name, _capsule(near, 0.7 * u, point, 0.7 * u), True)
            )
    return shapes


def _bar(cloud: Array, pieces: Mapping[str, _Piece], u: float) -> Array | None:
    """Straight bar through points that are long and slender along an axis of their frame."""
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    size = high - low
    if size.max() < 120.0 * u or size.min() > 0.2 * size.max():
        return None
    long = int(np.argmax(size))
    for piece in pieces.values():
        for shape in piece.shapes:
            if shape.role == "pad" and not piece.small:
                low = np.minimum(low, shape.points.min(axis=0))
                high = np.maximum(high, shape.points.max(axis=0))
    short = 1 - long
    if high[short] - low[short] < 4.0 * u:
        low[short] -= 2.0 * u
        high[short] += 2.0 * u
    low[long] -= 2.0 * u
    high[long] += 2.0 * u
    return _box(low, high, min(1.5 * u, 0.4 * float(high[short] - low[short])))


def _tree(points: Sequence[Array], first: int) -> list[tuple[int, int]]:
    """Edges of the shortest tree that joins the points and holds the edge from 0 to ``first``."""
    if len(points) < 2:
        return []
    inside, edges = {0, first}, [(0, first)]
    while len(inside) < len(points):
        a, b = min(
            ((i, j) for i in inside for j in range(len(points)) if j not in inside),
            key=lambda e: float(np.hypot(*(points[e[0]] - points[e[1]]))),
        )
        edges.append((a, b))
        inside.add(b)
    return edges


# --- drawing the mechanism -----------------------------------------------------------------------

#: Fill of the groups of bodies, pale tints; a mechanism with more groups starts over.
FILLS = ("#F3E7CC", "#CFE6F5", "#F9D9B8", "#D5EBDC", "#E8D3E4", "#F6F2B6", "#DDDDDD")
INK = "#3A3A3A"
FELT = "#C77B74"
RAIL = "#C9C2B8"
SURFACE = "#8E1B1B"


def _fill(group: int) -> str:
    return FILLS[group % len(FILLS)] if group >= 0 else RAIL


def strap_curve(a: Array, b: Array, free_length: float, count: int = 24) -> Array:
    """Points of a strap between its ends [m]: straight when taut, else sagging by its slack."""
    gap = float(np.hypot(*(b - a)))
    s = np.linspace(0.0, 1.0, count)[:, None]
    line = a + s * (b - a)
    if gap >= free_length or gap <= 0:
        return np.asarray(line)
    # A shallow parabola of sag f over a chord c is longer than it by 8 f^2 / (3 c).
    sag = min(math.sqrt(3.0 / 8.0 * gap * (free_length - gap)), 0.5 * free_length)
    out: Array = line + 4.0 * s * (1.0 - s) * np.array([0.0, -sag])
    return out


def spiral(radius: float) -> Array:
    """Points of the sign of a torsion spring around the origin [m]."""
    angle = np.linspace(0.0, 5.0 * math.pi, 90)
    r = radius * (0.45 + 0.55 * angle / angle[-1])
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def string_line(action: Action) -> tuple[Array, Array, Array, float] | None:
    """End y = 0 of the string, direction of y, normal toward the hammer, length [m]; or None."""
    config = action.config
    if config.string is None:
        return None
    s = config.surfaces[config.string.surface]
    if s.kind != "line" or s.normal is None:
        return None
    normal = np.array(s.normal) / np.hypot(*s.normal)
    along = np.array([normal[1], -normal[0]])
    if along @ np.array(config.string.direction) < 0:
        along = -along
    start = np.array(s.point) - config.string.anchor * along
    return start, along, normal, config.string.length


def string_reach(line: tuple[Array, Array, Array, float], limits: tuple[Array, Array]) -> float:
    """How much of the string lies in the view [m], from its end y = 0."""
    start, along, _, reach = line
    for k in (0, 1):
        edge = limits[1][k] if along[k] > 0 else limits[0][k]
        if abs(along[k]) > 1e-9:
            reach = min(reach, float((edge - start[k]) / along[k]))
    return max(reach, 1e-6)


def view_box(action: Action, drawn: Scene, qs: Sequence[npt.ArrayLike]) -> tuple[Array, Array]:
    """Corners [m] of what the bodies cover in the poses, with a margin."""
    low, high = np.full(2, math.inf), np.full(2, -math.inf)
    for q in qs:
        poses = body_poses(action, q)
        for shape in drawn.shapes:
            points = _to_ground(poses[shape.body], shape.points)
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    line = string_line(action)
    if line is not None:
        start = line[0]
        low, high = np.minimum(low, start), np.maximum(high, start)
    if not np.all(np.isfinite(low)):
        raise InvalidParameter(f"plot mechanism: {action.name!r} has nothing to draw")
    margin = 12.0 * drawn.unit
    return low - margin, high + margin


def _body_transform(ax: Axes, pose: Pose) -> Any:
    from matplotlib.transforms import Affine2D

    return Affine2D().rotate(pose[2]).translate(pose[0], pose[1]) + ax.transData


def shape_points(action: Action, shape: Shape, bent: Mapping[str, Array]) -> Array:
    """Points of a shape in the frame of its body [m], bent if the body is a flexible beam."""
    if shape.body not in bent:
        return shape.points
    length = action.config.bodies[shape.body].length or 1.0
    x = station_of(action, shape)
    if x is None:
        return bend(shape.points, bent[shape.body], length)
    return station(shape.points, bent[shape.body], length, x)


def station_of(action: Action, shape: Shape) -> float | None:
    """Place x [m] along a beam of the cross section that a surface is fixed to; None of others.

    The simulation fixes a surface to the cross section at its tabulated point.
    """
    if shape.role not in ("pad", "surface", "mark") or shape.name not in action.config.surfaces:
        return None
    return float(action.config.surfaces[shape.name].point[0])


def draw_bodies(
    ax: Axes,
    action: Action,
    drawn: Scene,
    poses: Mapping[str, Pose],
    bent: Mapping[str, Array],
) -> dict[str, list[tuple[Any, list[Shape]]]]:
    """Draw the shapes, in m; artists and what they show by body, so that a pose is one transform.

    ``bent`` holds the center lines of flexible beams.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    artists: dict[str, list[Any]] = {}
    for order, body in enumerate(("ground", *action.config.bodies)):
        own = [s for s in drawn.shapes if s.body == body]
        transform = _body_transform(ax, poses[body])
        z = 2.0 + 0.1 * order
        made: list[tuple[Any, list[Shape]]] = []
        for role, fill, ink in (
            ("wire", "#8A8A8A", "#555555"),
            ("wood", _fill(drawn.group[body]), INK),
        ):
            chosen = [s for s in own if s.role == role]
            outlines = [shape_points(action, s, bent) for s in chosen]
            if outlines:
                # Twice: all outlines first, then all fills, so that overlapping parts are one.
                under = PolyCollection(
                    outlines, facecolors=ink, edgecolors=ink, linewidths=1.3, zorder=z
                )
                over = PolyCollection(outlines, facecolors=fill, edgecolors="none", zorder=z + 0.01)
                made += [(under, chosen), (over, chosen)]
        chosen = [s for s in own if s.role == "pad"]
        if chosen:
            pads = PolyCollection(
                [shape_points(action, s, bent) for s in chosen],
                facecolors=FELT if body != "ground" else RAIL,
                edgecolors="none",
                alpha=0.45 if body != "ground" else 1.0,
                zorder=z + 0.02,
            )
            made.append((pads, chosen))
        for s in own:
            if s.role == "surface":
                line = LineCollection(
                    [shape_points(action, s, bent)],
                    colors=SURFACE,
                    linewidths=1.1,
                    zorder=z + 0.03,
                )
                line.set_gid(f"surface:{s.name}")
                made.append((line, [s]))
        for artist, _ in made:
            artist.set_transform(transform)
            ax.add_collection(artist, autolim=False)
        artists[body] = made
    return artists


def _joints(action: Action) -> list[tuple[str, str, str, Array]]:
    """Body, kind, parent and place in the frame of the parent [m] of the joints that move."""
    return [
        (name, b.joint, b.parent, np.array(b.position))
        for name, b in action.config.bodies.items()
        if b.joint != "weld"
    ]


def _label_candidates() -> list[tuple[float, float]]:
    """Offsets of a label in multiples of its height, near ones first."""
    out = []
    for radius in (1.3, 1.9, 2.6, 3.5, 4.6, 6.0):
        for k in range(16):
            angle = math.pi * (0.25 + k / 8.0)
            out.append((radius * math.cos(angle), radius * math.sin(angle)))
    return out


class _Labels:
    """Greedy placement of labels in pixels: clear of each other, of obstacles where possible."""

    def __init__(self, obstacles: Array, bounds: tuple[float, float, float, float]):
        self.obstacles = obstacles
        self.bounds = bounds
        self.boxes: list[tuple[float, float, float, float]] = []
        self.leaders: list[tuple[Array, Array]] = []

    def place(
        self, anchors: Array, width: float, height: float, unit: float
    ) -> tuple[Array, Array]:
        """Anchor and center of a label; the anchors are equally good."""
        best, best_cost = (anchors[0], anchors[0]), math.inf
        for at in anchors:
            for dx, dy in _label_candidates():
                # Wide labels move sideways by half of their width.
                stretch = 0.5 * (width - height) * np.sign(dx) * min(1.0, abs(dx / (dy or 1e-9)))
                center = at + np.array([dx * unit + stretch, dy * unit])
                cost = self._cost(at, center, width, height, math.hypot(dx, dy))
                if cost < best_cost:
                    best, best_cost = (at, center), cost
        self.boxes.append((best[1][0], best[1][1], width, height))
        self.leaders.append(best)
        return best

    def _cost(self, at: Array, center: Array, width: float, height: float, away: float) -> float:
        x0, y0, x1, y1 = self.bounds
        w, h = 0.5 * width + 2.0, 0.5 * height + 2.0
        cost = 1.2 * away
        if not (x0 + w < center[0] < x1 - w and y0 + h < center[1] < y1 - h):
            cost += 500.0
        for bx, by, bw, bh in self.boxes:
            over_x = w + 0.5 * bw - abs(center[0] - bx)
            over_y = h + 0.5 * bh - abs(center[1] - by)
            if over_x > 0 and over_y > 0:
                cost += 200.0 + min(over_x, over_y)
        for t in np.linspace(0.15, 1.0, 7):
            p = at + t * (center - at)
            for bx, by, bw, bh in self.boxes:
                if abs(p[0] - bx) < 0.5 * bw + 1 and abs(p[1] - by) < 0.5 * bh + 1:
                    cost += 30.0
        for a, b in self.leaders:
            if _cross(at, center, a, b):
                cost += 25.0
        inside = (np.abs(self.obstacles[:, 0] - center[0]) < w) & (
            np.abs(self.obstacles[:, 1] - center[1]) < h
        )
        return cost + 1.5 * min(float(np.count_nonzero(inside)), 14.0)


def _cross(a: Array, b: Array, c: Array, d: Array) -> bool:
    def side(p: Array, q: Array, r: Array) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def draw_fixed(
    ax: Axes,
    action: Action,
    drawn: Scene,
    limits: tuple[Array, Array],
    *,
    with_string: bool = True,
) -> None:
    """String at rest and signs of the ground joints, in m."""
    u = drawn.unit
    line = string_line(action)
    if line is not None and with_string:
        start, along, *_ = line
        ends = np.array([start, start + along * string_reach(line, limits)])
        ax.plot(ends[:, 0], ends[:, 1], color=INK, linewidth=1.8, zorder=1.5, gid="string")
        ax.plot([start[0]], [start[1]], marker="s", markersize=4, color=INK, zorder=1.6)
    for _, kind, parent, place in _joints(action):
        if parent == "ground" and kind == "revolute":
            foot = place + np.array([[0.0, 0.0], [-4.2 * u, -7.0 * u], [4.2 * u, -7.0 * u]])
            ax.fill(
                foot[:, 0], foot[:, 1], facecolor="white", edgecolor=GRAY, linewidth=0.8, zorder=1.7
            )
            for k in range(5):
                x = place[0] + (-4.2 + 2.1 * k) * u
                y = place[1] - 7.0 * u
                ax.plot([x, x - 1.8 * u], [y, y - 2.2 * u], color=GRAY, linewidth=0.7, zorder=1.7)


def draw_joints(ax: Axes, action: Action, drawn: Scene, poses: Mapping[str, Pose]) -> list[Any]:
    """Pins and slides of the joints; artists with the frame they move with as ``body``."""
    u = drawn.unit
    angle = np.linspace(0.0, 2.0 * math.pi, 25)
    ring = 1.7 * u * np.column_stack([np.cos(angle), np.sin(angle)])
    out: list[Any] = []
    for name, kind, parent, place in _joints(action):
        if kind == "prismatic":
            axis = np.array(action.config.bodies[name].axis)
            axis = axis / np.hypot(*axis)
            side = np.array([axis[1], -axis[0]])
            for sign in (-1.0, 1.0):
                rail = place + np.array([-9.0 * u * axis, 9.0 * u * axis]) + sign * 2.6 * u * side
                (line,) = ax.plot(rail[:, 0], rail[:, 1], color=GRAY, linewidth=1.2, zorder=5.0)
                line.set_transform(_body_transform(ax, poses[parent]))
                out.append((parent, line))
        else:
            (pin,) = ax.fill(
                ring[:, 0] + place[0],
                ring[:, 1] + place[1],
                facecolor="white",
                edgecolor=INK,
                linewidth=1.1,
                zorder=5.2,
            )
            pin.set_transform(_body_transform(ax, poses[parent]))
            out.append((parent, pin))
    for body in _spring_bodies(action):
        points = spiral(4.6 * u)
        (line,) = ax.plot(points[:, 0], points[:, 1], color=GREEN, linewidth=0.9, zorder=5.1)
        line.set_transform(_body_transform(ax, poses[body]))
        out.append((body, line))
    return out


def _spring_bodies(action: Action) -> list[str]:
    """Bodies whose joints carry a torsion spring."""
    bodies = {b.coordinate: n for n, b in action.config.bodies.items() if b.coordinate}
    return [
        bodies[s.coordinate]
        for s in action.config.springs.values()
        if s.enabled and s.coordinate in bodies
    ]


def strap_ends(
    action: Action, poses: Mapping[str, Pose], bent: Mapping[str, Array]
) -> list[tuple[str, Array, Array, float]]:
    """Name, ends in the ground frame [m] and free length [m] of the straps that are on."""
    return [
        (
            name,
            _point_at(action, poses, bent, s.body_a, s.point_a),
            _point_at(action, poses, bent, s.body_b, s.point_b),
            s.free_length,
        )
        for name, s in action.config.straps.items()
        if s.enabled
    ]


def _inside_upper_right(points: Array, limits: tuple[Array, Array], share: Array) -> bool:
    """Whether the upper right corner, ``share`` of the view in x and y, is free of points."""
    low, high = limits
    corner = high - share * (high - low)
    return not bool(np.any(np.all(points > corner, axis=1)))


def mechanism(action: Action, q: npt.ArrayLike | None = None) -> Figure:
    """Draw a mechanism in a pose: bodies, contact surfaces with numbers, joints, springs, string.

    Contact surfaces (dark red) are drawn where the simulation has them. The outlines of the bodies
    only join what is known of them: joints, surfaces, center of mass, attachments.

    Parameters
    ----------
    action
        The mechanism.
    q
        Coordinates [rad, m] in the order of ``action.coordinates``; default: at rest.

    Raises
    ------
    InvalidParameter
        The pose has the wrong length, or there is nothing to draw.
    """
    pose = action.rest_pose if q is None else np.asarray(q, dtype=float).ravel()
    if pose.size != len(action.coordinates):
        raise InvalidParameter(
            f"plot mechanism: the pose has {pose.size} numbers, expected {len(action.coordinates)} "
            f"({', '.join(action.coordinates)})"
        )
    drawn = scene(action, [pose])
    poses = body_poses(action, pose)
    bent = bent_beams(action, pose)
    limits = view_box(action, drawn, [pose])
    cloud = np.vstack([_to_ground(poses[s.body], s.points) for s in drawn.shapes])
    contacts = {int(k): c for k, c in action.config.contacts.items() if c.enabled}
    size = limits[1] - limits[0]
    rows = len(contacts) + 9
    height = 8.6
    width = float(np.clip(height * size[0] / size[1], 4.5, 11.0))
    # Room that the list needs, in inches.
    text_height, text_width = 0.155 * rows + 0.2, 2.9
    inside = _inside_upper_right(
        cloud, limits, np.array([text_width / width, text_height / height])
    )
    figure = _figure(width + (0.2 if inside else text_width + 0.2), height + 0.5)
    figure.set_layout_engine("none")
    total_w, total_h = figure.get_size_inches()
    ax = figure.add_axes(
        (0.1 / total_w, 0.05 / total_h, width / total_w, (height - 0.05) / total_h)
    )
    figure.text(
        0.1 / total_w,
        1.0 - 0.1 / total_h,
        _plain(f"Mechanism {action.name}" + ("" if q is not None else ", at rest")),
        fontsize=LARGE,
        fontweight="bold",
        va="top",
    )
    ax.set_xlim(limits[0][0], limits[1][0])
    ax.set_ylim(limits[0][1], limits[1][1])
    ax.set_aspect("equal", adjustable="box")
    ax.set_axis_off()
    draw_fixed(ax, action, drawn, limits)
    draw_bodies(ax, action, drawn, poses, bent)
    draw_joints(ax, action, drawn, poses)
    _draw_attachments(ax, action, drawn, poses, bent)
    _draw_scale(ax, drawn, limits)
    figure.draw_without_rendering()
    _label_mechanism(ax, action, drawn, pose, poses)
    _list_contacts(figure, action, contacts)
    return figure


def _draw_attachments(
    ax: Axes, action: Action, drawn: Scene, poses: Mapping[str, Pose], bent: Mapping[str, Array]
) -> None:
    u = drawn.unit
    for name, a, b, free in strap_ends(action, poses, bent):
        curve = strap_curve(a, b, free)
        ax.plot(
            curve[:, 0], curve[:, 1], color=PURPLE, linewidth=1.5, zorder=5.3, gid=f"strap:{name}"
        )
        ax.plot(
            *np.array([a, b]).T, "o", color=PURPLE, markersize=2.6, zorder=5.4, linestyle="none"
        )
    for name, body in action.config.bodies.items():
        if body.mass <= 0 and body.kind != "beam":
            continue
        center = _point_at(action, poses, bent, name, _center(action, name))
        ax.plot(
            *center,
            marker="o",
            markersize=5.0,
            color="white",
            markeredgecolor=INK,
            markeredgewidth=0.7,
            zorder=5.5,
        )
        ax.plot(*center, marker="+", markersize=5.0, color=INK, markeredgewidth=0.7, zorder=5.6)
    for name, point in action.config.points.items():
        at = _point_at(action, poses, bent, point.body, point.point)
        ax.plot(
            *at,
            marker="D",
            markersize=3.2,
            color=BLUE,
            markeredgecolor="white",
            markeredgewidth=0.4,
            zorder=5.8,
            gid=f"point:{name}",
        )
    finger = action.config.finger
    if finger is not None:
        at = _point_at(action, poses, bent, finger.body, finger.point)
        direction = np.array(finger.direction) / np.hypot(*finger.direction)
        ax.annotate(
            "",
            at - 0.6 * u * direction,
            at - 32.0 * u * direction,
            arrowprops={"arrowstyle": "-|>", "color": RED, "linewidth": 1.6},
            zorder=6,
        )
        ax.text(
            float(at[0] - 34.0 * u * direction[0]),
            float(at[1] - 34.0 * u * direction[1]),
            "finger",
            color=RED,
            fontsize=NORMAL,
            ha="center",
            va="bottom" if direction[1] < 0 else "top",
        )


def _draw_scale(ax: Axes, drawn: Scene, limits: tuple[Array, Array]) -> None:
    """Bar of a round length in the lower right corner."""
    span = 100.0 * drawn.unit
    round_length = 10.0 ** math.floor(math.log10(span))
    for step in (5.0, 2.0):
        if step * round_length <= span:
            round_length *= step
            break
    x1 = limits[1][0] - 6.0 * drawn.unit
    y = limits[0][1] + 6.0 * drawn.unit
    ax.plot([x1 - round_length, x1], [y, y], color=INK, linewidth=2.0, solid_capstyle="butt")
    ax.text(
        x1 - 0.5 * round_length,
        y + 2.0 * drawn.unit,
        f"{1e3 * round_length:g} mm",
        ha="center",
        va="bottom",
        fontsize=SMALL + 0.5,
    )


def _body_label(action: Action, name: str) -> str:
    return _plain(action.config.bodies[name].label or name.replace("_", " "))


def _label_mechanism(
    ax: Axes, action: Action, drawn: Scene, q: Array, poses: Mapping[str, Pose]
) -> None:
    """Numbers of contacts and names of bodies, placed clear of each other."""
    bent = bent_beams(action, q)
    to_pixels = ax.transData
    obstacles = []
    for shape in drawn.shapes:
        if shape.role in ("surface", "wood", "wire"):
            points = _to_ground(poses[shape.body], shape.points)
            steps = np.vstack([points[::4], points[-1:]])
            dense = (
                np.vstack([np.linspace(a, b, 8) for a, b in itertools.pairwise(steps)])
                if len(steps) > 1
                else steps
            )
            obstacles.append(to_pixels.transform(dense))
    line = string_line(action)
    if line is not None:
        start, along, _, length = line
        obstacles.append(to_pixels.transform(np.linspace(start, start + along * length, 300)))
    finger = action.config.finger
    if finger is not None:
        at = _point_at(action, poses, bent, finger.body, finger.point)
        away = -np.array(finger.direction) / np.hypot(*finger.direction)
        obstacles.append(
            to_pixels.transform(at + np.linspace(0, 42 * drawn.unit, 60)[:, None] * away)
        )
    rows = contact_rows(action, q)
    for key, contact in action.config.contacts.items():
        if contact.enabled:
            x, y, nx, ny, compression = rows[int(key)]
            half = 0.5 * max(-compression, 0.0) * np.array([nx, ny])
            middle = np.array([x, y])
            ends = np.array([middle - half, middle + half])
            if half @ half > (0.4 * drawn.unit) ** 2:
                ax.plot(*ends.T, color=SURFACE, linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=5.9)
                obstacles.append(to_pixels.transform(np.linspace(ends[0], ends[1], 10)))
    box = ax.get_window_extent()
    labels = _Labels(
        np.vstack(obstacles) if obstacles else np.zeros((0, 2)), (box.x0, box.y0, box.x1, box.y1)
    )
    pixel = DPI / 72.0
    back = to_pixels.inverted()

    def put(text: str, at: Array, size: float, color: str, circle: bool, unit: float) -> None:
        """Write a text near ``at``, one place or several equally good ones, in m."""
        height = 1.5 * size * pixel
        width = 1.65 * size * pixel if circle else (0.6 * size * len(text) + 4.0) * pixel
        anchors = np.atleast_2d(np.asarray(to_pixels.transform(np.atleast_2d(at))))
        pixels, place = labels.place(anchors, width, height, unit)
        at = back.transform(pixels)
        where = back.transform(place)
        toward = pixels - place
        length = float(np.hypot(*toward))
        # Leave the box of a text where the leader crosses its edge.
        reach = min(
            0.5 * width / abs(toward[0]) if toward[0] else math.inf,
            0.5 * height / abs(toward[1]) if toward[1] else math.inf,
        )
        if length > 0.8 * height and reach < 1.0:
            edge = back.transform(place + toward * reach)
            ax.plot(*np.array([edge, at]).T, color=color, linewidth=0.6, zorder=7)
        options: dict[str, Any] = {}
        if circle:
            options["bbox"] = {
                "boxstyle": "circle,pad=0.22",
                "facecolor": "white",
                "edgecolor": color,
                "linewidth": 0.8,
            }
        ax.text(
            where[0],
            where[1],
            text,
            fontsize=size,
            color=color,
            ha="center",
            va="center",
            zorder=8,
            **options,
        )

    for key, contact in action.config.contacts.items():
        if contact.enabled:
            at = np.array(rows[int(key)][:2])
            put(str(int(key)), at, SMALL, SURFACE, True, 1.6 * SMALL * pixel)
    for name, body in action.config.bodies.items():
        if body.mass <= 0 and body.kind != "beam":
            continue
        middles = [_center(action, name)] + [
            0.5 * (s.points.min(axis=0) + s.points.max(axis=0))
            for s in drawn.shapes
            if s.body == name and s.role == "wood"
        ]
        at = _to_ground(poses[name], np.array(middles))
        put(_body_label(action, name), at, NORMAL, BLACK, False, 2.0 * NORMAL * pixel)
    for name, point in action.config.points.items():
        at = _point_at(action, poses, bent, point.body, point.point)
        put(_plain(name.replace("_", " ")), at, SMALL - 0.5, BLUE, False, 1.6 * SMALL * pixel)


def _list_contacts(figure: Figure, action: Action, contacts: Mapping[int, Any]) -> None:
    """Numbers and names of the contacts, and the signs, as a list beside the drawing."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    for number, contact in contacts.items():
        handles.append(
            Line2D(
                [],
                [],
                linestyle="none",
                marker=f"${number}$",
                markeredgewidth=0,
                markersize=5.5 + 2.5 * (number > 9),
                color=SURFACE,
                label=_plain(contact.label or f"contact {number}"),
            )
        )
    handles.append(Line2D([], [], color=SURFACE, linewidth=1.2, label="contact surface"))
    handles.append(Patch(facecolor=RAIL, label="fixed to the ground"))
    if any(s.enabled for s in action.config.springs.values()):
        handles.append(
            Line2D([], [], color=GREEN, marker="$◎$", linestyle="none", label="torsion spring")
        )
    for strap in action.config.straps.values():
        if strap.enabled:
            name = strap.label.split(",")[0] or "strap"
            handles.append(Line2D([], [], color=PURPLE, linewidth=1.5, label=_plain(name)))
            break
    handles.append(
        Line2D(
            [],
            [],
            color="white",
            marker="o",
            markeredgecolor=INK,
            linestyle="none",
            markersize=6,
            label="joint",
        )
    )
    handles.append(
        Line2D(
            [],
            [],
            color=INK,
            marker="P",
            markeredgecolor=INK,
            linestyle="none",
            markersize=4.5,
            label="center of mass",
        )
    )
    if action.config.points:
        handles.append(
            Line2D(
                [],
                [],
                color=BLUE,
                marker="D",
                linestyle="none",
                markersize=3.5,
                label="tracking point",
            )
        )
    if action.config.string is not None:
        handles.append(Line2D([], [], color=INK, linewidth=1.8, label="string"))
    total_w, total_h = figure.get_size_inches()
    figure.legend(
        handles=handles,
        loc="upper right",
        bbox_to_anchor=(1.0 - 0.1 / total_w, 1.0 - 0.1 / total_h),
        frameon=False,
        fontsize=NORMAL - 0.5,
        labelspacing=0.45,
    )


# --- files ---------------------------------------------------------------------------------------


def _pose_of_run(run: Run) -> Figure:
    action = run_action(run)
    names = action.coordinates
    if not all(name in run for name in names):
        raise InvalidParameter("plot mechanism: the run does not hold all coordinates")
    return mechanism(action, np.array([run[name][0] for name in names]))


#: Pictures that :func:`save_all` writes.
PICTURES = {
    "overview": overview,
    "motion": motion,
    "hammer_speed": hammer_speed,
    "contact_forces": contact_forces,
    "finger_force": finger_force,
    "string": string,
    "energy": energy,
    "loops": loops,
    "mechanism": _pose_of_run,
}


def save_all(run: Run, folder: str | Path, stem: str, force: bool = False) -> list[Path]:
    """Write every picture that the run has data for, as ``folder/stem_PICTURE.png``.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    FileExists
        One of the files exists and ``force`` is not given; nothing is written then.
    InvalidParameter
        The run has data for no picture.
    """
    folder = Path(folder)
    figures: dict[Path, Figure] = {}
    for name, draw in PICTURES.items():
        path = folder / f"{stem}_{name}.png"
        check_writable(path, force=force)
        try:
            figures[path] = draw(run)
        except InvalidParameter:
            continue
    if not figures:
        raise InvalidParameter("plot: the run has data for no picture")
    for path, figure in figures.items():
        write_file(path, lambda target, f=figure: f.savefig(target), force=force)  # type: ignore[misc]
    return list(figures)
