"""Overview of a stroke on one page, and a comparison of several runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.graphics.plot.axes import head_title, mark_events, set_window
from feltmb.graphics.plot.readings import (
    action_window,
    contact_label,
    loaded_contacts,
    need_samples,
    repeated_strikes,
    run_name,
)
from feltmb.graphics.plot.series import (
    Motion,
    draw_finger,
    draw_motion,
    draw_speed,
    motions_of,
    view_panels,
)
from feltmb.run.reading import reading_of, strike_words, striker_speed
from feltmb.run.results import let_off_words
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.style import (
    CYCLE,
    GRAY,
    LARGE,
    NORMAL,
    SMALL,
    new_figure,
    plain_text,
    reader_unit,
    side_legend,
    style_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feltmb.run.results import Run


@dataclass(frozen=True)
class _Panel:
    """A row of the overview."""

    height: float
    draw: Callable[[Axes], None]
    whole: bool = False
    """Whether it shows the whole run."""
    legend: bool = True


def _panels(run: Run, near: tuple[float, float]) -> Iterator[_Panel]:
    """Finger, motion, striker, views of the mechanism, and forces of the contacts."""
    if "finger.force" in run:
        yield _Panel(0.9, lambda ax: draw_finger(ax, run), whole=True, legend=False)

    def of(motion: Motion, height: float) -> _Panel:
        return _Panel(height, lambda ax: draw_motion(ax, motion, run.time))

    with contextlib.suppress(InvalidParameter):
        yield from (of(m, 1.5) for m in motions_of(run))
    if striker_speed(run) is not None:
        yield _Panel(1.1, lambda ax: draw_speed(ax, run), legend=False)
    for name, view in reading_of(run).views.items():
        if name != "motion":
            yield from (of(p, 1.2) for p in view_panels(run, view))
    seen = (run.time >= near[0]) & (run.time <= near[1])
    peaks = {n: float(np.max(run[f"contact{n:02d}.force"][seen])) for n in loaded_contacts(run)}
    numbers = sorted((n for n, peak in peaks.items() if peak > 0), key=lambda n: -peaks[n])
    if numbers:
        yield _Panel(1.5, lambda ax: _draw_forces(ax, run, numbers[:6]))


def _draw_forces(ax: Axes, run: Run, numbers: Sequence[int]) -> None:
    """Draw the forces of some contacts."""
    for number, color in zip(numbers, CYCLE, strict=False):
        ax.plot(
            1e3 * run.time,
            run[f"contact{number:02d}.force"],
            color=color,
            linewidth=1.1,
            label=contact_label(run, number),
        )
    style_axes(ax, "time [ms]", "contact force [N]")


@checked
def overview(run: Run) -> Figure:
    """Plot one page of a stroke: finger, motion, striker, contact forces, string, felt.

    Raises
    ------
    InvalidParameter
        The run has neither finger, tracking points, coordinates nor contacts.
    """
    need_samples(run)
    whole = (float(run.time[0]), float(run.time[-1]))
    near = action_window(run)
    panels = list(_panels(run, near))
    if not panels:
        raise InvalidParameter("plot overview: the run has no finger, motion or contacts")
    heights = [p.height for p in panels]
    figure = new_figure(8.6, 1.9 * sum(heights) + 0.9)
    head_title(figure, run, "Stroke")
    axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
    labeled = False
    for ax, panel in zip(axes, panels, strict=True):
        panel.draw(ax)
        window = whole if panel.whole else near
        if panel.whole and near != whole:
            ax.axvspan(1e3 * near[0], 1e3 * near[1], color="#F2F2F2", zorder=0)
            ax.set_title("whole run; gray: shown below", fontsize=SMALL, loc="right")
        set_window(ax, window)
        if window == near:
            mark_events(ax, run, near, width=5.2, labels=not labeled)
            labeled = True
        if panel.legend:
            side_legend(ax)
        if ax is not axes[-1] and not panel.whole:
            ax.set_xlabel("")
    summary = _summary_line(run)
    if summary:
        figure.supxlabel(summary, fontsize=SMALL + 1, x=0.01, ha="left")
    return figure


def _summary_line(run: Run) -> str:
    strikes = repeated_strikes(run)
    if strikes:
        rows = [_strike_line(run, i, s) for i, s in enumerate(strikes[:MOST_STRIKES], start=1)]
        more = len(strikes) - MOST_STRIKES
        return "\n".join([*rows, f"{more} more strikes: run.strikes"] if more > 0 else rows)
    s = run.summary
    force, contact = _strike_texts(run)
    parts = _numbers(
        s,
        ("impact_speed", "impact speed (of the contact)", 1.0, "m/s"),
        ("rebound_speed", "rebound speed", 1.0, "m/s"),
        ("max_impact_force", force, 1.0, "N"),
        ("impact_duration", contact, 1e3, "ms"),
    )
    half = -(-len(parts) // 2)
    return "\n".join("   ".join(row) for row in (parts[:half], parts[half:]) if row)


def _strike_line(run: Run, number: int, s: Mapping[str, float]) -> str:
    """Numbers of one of several strikes."""
    force, contact = _strike_texts(run)
    parts = _numbers(
        s,
        ("impact_speed", "impact speed", 1.0, "m/s"),
        ("max_impact_force", force, 1.0, "N"),
        ("sampled_impact_force", force, 1.0, "N"),
        ("impact_duration", contact, 1e3, "ms"),
    )
    return "   ".join([f"strike {number} at {1e3 * s['impact_time']:.1f} ms", *parts])


def _strike_texts(run: Run) -> tuple[str, str]:
    """Words for the largest force of a strike and for the duration of its contact."""
    words = strike_words(run)
    contact = words["impact_duration"].removesuffix(" lasts")
    return plain_text(words["max_impact_force"]), plain_text(contact)


def _numbers(s: Mapping[str, float], *rows: tuple[str, str, float, str]) -> list[str]:
    """Texts of the numbers of a strike that there are.

    ``rows``: key, text, factor to the unit that is shown, this unit; those of let-off and check
    follow.
    """
    parts = []
    for key, text, factor, unit in (
        *rows,
        ("let_off_gap", "let-off gap", 1e3, "mm"),
        ("check_gap", "check distance", 1e3, "mm"),
    ):
        if key in s:
            parts.append(f"{text} {factor * s[key]:.3g} {unit}")
        elif key == "let_off_gap" and let_off_words(s):
            parts.append(let_off_words(s))
    return parts


#: Most strikes whose numbers are printed below an overview.
MOST_STRIKES = 8
#: Letters of a line of the legend of a comparison.
LEGEND_LETTERS = 120


@checked
def compare(
    runs: Sequence[Run], names: Sequence[str], labels: Sequence[str] | None = None
) -> Figure:
    """Plot outputs of several runs in common axes, one panel for each output.

    The legend at the top is that of all panels.

    Parameters
    ----------
    runs
        One or more runs; each has one color.
    names
        Names of outputs, such as ``["hammer_tip.vx", "contact06.force"]``. A run without an output
        is omitted from its panel.
    labels
        Name of each run in the legend, such as its file; default: mechanism and stroke. Equal ones
        get the number of the run.

    Raises
    ------
    InvalidParameter
        There are no runs, no names, an output that no run has, or not one label for each run.
    """
    if not runs or not names:
        raise InvalidParameter(
            f"plot compare: got {len(runs)} runs and {len(names)} outputs, expected one or more"
        )
    if labels is not None and len(labels) != len(runs):
        raise InvalidParameter(
            f"plot compare: got {len(labels)} labels, expected one for each of the {len(runs)} runs"
        )
    for run in runs:
        need_samples(run)
    titles = _titles(runs, labels)
    columns = max(1, min(len(titles), LEGEND_LETTERS // (6 + max(map(len, titles)))))
    lines = -(-len(titles) // columns)
    figure = new_figure(8.8, 2.3 * len(names) + 0.7 + 0.2 * lines)
    axes = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
    shown: dict[str, Any] = {}
    for ax, name in zip(axes, names, strict=True):
        having = [i for i, run in enumerate(runs) if name in run]
        if not having:
            runs[0][name]  # raises an error with similar names
        first = runs[having[0]]
        factor, unit = reader_unit(first.unit(name))
        for i in having:
            (line,) = ax.plot(
                1e3 * runs[i].time,
                factor * runs[i][name],
                color=CYCLE[i % len(CYCLE)],
                linestyle=("-", "--", ":")[(i // len(CYCLE)) % 3],
                linewidth=1.1,
            )
            shown.setdefault(titles[i], line)
        style_axes(ax, "", f"{name} [{unit}]")
        text = first.long_names[first.names.index(name)]
        ax.set_title(plain_text(text), fontsize=SMALL + 0.5, loc="left", color=GRAY)
    axes[-1].set_xlabel("time [ms]", fontsize=NORMAL)
    axes[0].set_xlim(
        1e3 * min(float(r.time[0]) for r in runs), 1e3 * max(float(r.time[-1]) for r in runs)
    )
    figure.legend(
        shown.values(),
        shown.keys(),
        loc="outside upper left",
        title="Comparison",
        title_fontproperties={"size": LARGE, "weight": "bold"},
        alignment="left",
        ncols=columns,
        frameon=False,
        fontsize=NORMAL - 0.5,
    )
    return figure


def _titles(runs: Sequence[Run], labels: Sequence[str] | None) -> list[str]:
    """Different names of the runs for a legend, as text for matplotlib."""
    given = [run_name(run) for run in runs] if labels is None else list(map(plain_text, labels))
    # A legend leaves out names that begin with an underscore.
    given = [f" {n}" if n.startswith("_") else n or f"run {i + 1}" for i, n in enumerate(given)]
    return [f"{n} ({i + 1})" if given.count(n) > 1 else n for i, n in enumerate(given)]
