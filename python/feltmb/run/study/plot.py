"""Figures of studies: curves over time, values over a sweep, bars of variants."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.run.study.expression import to_unit
from feltmb.run.study.model import Case
from feltmb.run.study.outcomes import StudyOutcomes
from feltmb.style import CYCLE, DPI, GRAY, head_line, plain_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw", "png"]

#: Variants also have different dashes, for prints without color; the first one is solid.
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.4, 1.2, 1.4)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
SMALL, NORMAL = 7.5, 8.5


def _figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from feltmb.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _style(ax: Axes, x: str, y: str, title: str) -> None:
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(GRAY)
    ax.tick_params(labelsize=SMALL, color=GRAY, length=3)
    ax.grid(True, color="#E6E6E6", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.set_xlabel(plain_text(x), fontsize=NORMAL)
    ax.set_ylabel(plain_text(y), fontsize=NORMAL)
    if title:
        ax.set_title(plain_text(title), fontsize=NORMAL, loc="left")


def _ticks(ax: Axes, which: str, *, log: bool, values: Sequence[Any] = ()) -> None:
    """Plain numbers at the ticks, also on logarithmic axes; few ``values`` are used as ticks."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

    axis = ax.xaxis if which == "x" else ax.yaxis
    if log:
        (ax.set_xscale if which == "x" else ax.set_yscale)("log")
        low, high = ax.get_xlim() if which == "x" else ax.get_ylim()
        subs = (1.0, 2.0, 5.0) if high / low < 200 else (1.0,)
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:,.10g}".replace(",", " ")))
        axis.set_minor_formatter(NullFormatter())
    else:
        ax.ticklabel_format(axis=which, useOffset=False, style="plain")  # type: ignore[arg-type]
    if 0 < len(values) <= 8:
        axis.set_major_locator(FixedLocator(list(values)))
        axis.set_minor_locator(FixedLocator([]))
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))


def _with_unit(text: str, unit: str) -> str:
    return f"{text} [{unit}]" if unit and unit != "1" else text


def png(result: StudyOutcomes, name: str) -> bytes:
    """A figure of a study as PNG."""
    buffer = io.BytesIO()
    result.figures[name].savefig(buffer, format="png", dpi=DPI, metadata={"Software": "feltmb"})
    return buffer.getvalue()


def draw(result: StudyOutcomes, name: str) -> Figure:
    """Plot a figure of a study.

    Parameters
    ----------
    result
        Result of the study. Failed simulations are omitted and named in the figure.
    name
        Key of the figure in the file.
    """
    spec = result.study.spec.figures[name]
    count = len(spec.panels)
    columns = min(spec.columns, count)
    rows = math.ceil(count / columns)
    width = 7.4 if columns == 1 else 9.6
    height = rows * (2.7 if spec.kind == "time" and columns == 1 else 3.0) + 0.75
    figure = _figure(width, height)
    axes = figure.subplots(rows, columns, squeeze=False)
    handles: dict[str, Any] = {}
    for i, panel in enumerate(spec.panels):
        ax = axes[i // columns][i % columns]
        kind = {"time": _time, "sweep": _over_axis, "bars": _bars}[spec.kind]
        missing = kind(result, spec, panel, ax, handles)
        for mark in panel.marks:
            ax.axhline(mark.value, color=GRAY, linewidth=0.9, linestyle=(0, (2, 2)), zorder=1)
            if mark.label:
                ax.annotate(
                    plain_text(mark.label),
                    (1.0, mark.value),
                    xycoords=("axes fraction", "data"),
                    xytext=(-2, 2),
                    textcoords="offset points",
                    ha="right",
                    fontsize=SMALL - 0.5,
                    color=GRAY,
                )
        if missing:
            ax.text(
                1.0,
                1.01,
                plain_text("missing: " + ", ".join(missing)),
                transform=ax.transAxes,
                ha="right",
                va="bottom",
                fontsize=SMALL,
                color="#B00020",
            )
    for i in range(count, rows * columns):
        axes[i // columns][i % columns].set_visible(False)
    if handles:
        cite = result.study.spec.thesis.cite
        if spec.kind == "bars" and cite in handles:
            handles[cite] = handles.pop(cite)  # last
        figure.legend(
            list(handles.values()),
            [plain_text(label) for label in handles],
            loc="outside lower center",
            ncols=len(handles) if sum(map(len, handles)) + 7 * len(handles) < 12 * width else 3,
            frameon=False,
            fontsize=NORMAL,
            handlelength=2.6,
        )
    head_line(figure, plain_text(spec.title))
    return figure


def _variants(result: StudyOutcomes, panel: Any) -> list[str]:
    return [v for v in result.study.spec.variants if panel.variants is None or v in panel.variants]


def _strokes(result: StudyOutcomes, panel: Any, variant: str) -> list[str]:
    wanted = [panel.stroke] if panel.stroke else panel.strokes
    return [s for s in result.study.strokes_of(variant) if wanted is None or s in wanted]


def _case_label(result: StudyOutcomes, case: Case, *, several: bool) -> str:
    """Variant, and the point of the sweep if a panel shows several."""
    parts = [result.study.label(case.variant)] if len(result.study.spec.variants) > 1 else []
    parts += [
        f"{axis.label or axis.name} {_short(value)}"
        for axis, value in zip(_axes(result), case.point, strict=True)
        if several
    ]
    return ", ".join(parts) or result.study.label(case.variant)


def _axes(result: StudyOutcomes) -> Sequence[Any]:
    sweep = result.study.spec.sweep
    return sweep.axis if sweep is not None else []


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _time(
    result: StudyOutcomes, spec: Any, panel: Any, ax: Axes, handles: dict[str, Any]
) -> list[str]:
    del spec
    missing: list[str] = []
    variants = list(result.study.spec.variants)
    cases = [case for case in result.outcomes if result.study.shows(panel, case)]
    points = list(dict.fromkeys(case.point for case in cases))
    factor = to_unit(panel.unit)
    top = 0.0
    for case in cases:
        label = _case_label(result, case, several=len(points) > 1)
        pair = result.series(panel, case)
        if pair is None or pair.shape[1] < 2:
            missing.append(label)
            continue
        # Variants have colors; with a sweep, its points have colors and the variants have dashes.
        v, p = variants.index(case.variant), points.index(case.point)
        color = CYCLE[(p if len(points) > 1 else v) % len(CYCLE)]
        (line,) = ax.plot(
            1e3 * pair[0],
            factor * pair[1],
            color=color,
            linestyle=DASHES[v % len(DASHES)],
            linewidth=1.5 if v == 0 else 1.3,
        )
        handles.setdefault(label, line)
        top = max(top, float(np.max(np.abs(pair[1]))))
    title = panel.title or (panel.stroke or "")
    _style(ax, "time [ms]", _with_unit(panel.label or panel.output, panel.unit), title)
    ax.margins(x=0.01)
    _ticks(ax, "y", log=panel.log)
    if cases and top < 1e-9:  # an output that is always zero
        ax.set_ylim(-0.05, 1.0)
    return missing


def _over_axis(
    result: StudyOutcomes, spec: Any, panel: Any, ax: Axes, handles: dict[str, Any]
) -> list[str]:
    axes = _axes(result)
    names = [a.name for a in axes]
    position = names.index(spec.x) if spec.x else 0
    axis = axes[position]
    text, unit, factor = result.study.shown(panel.number)
    if panel.unit:
        unit, factor = panel.unit, to_unit(panel.unit)
    lines: dict[tuple[Any, ...], tuple[list[Any], list[float]]] = {}
    absent = 0
    for case, outcome in result.outcomes.items():
        if not result.study.shows(panel, case):
            continue
        rest = tuple(v for i, v in enumerate(case.point) if i != position)
        x, y = lines.setdefault((case.variant, case.stroke, rest), ([], []))
        value = outcome.numbers.get(panel.number) if outcome.status == "done" else None
        if value is None:
            absent += 1
            continue
        x.append(case.point[position])
        y.append(factor * value)
    variants = list(result.study.spec.variants)
    # By the order in the study, so that a stroke has the same color in every panel.
    others = list(
        dict.fromkeys(
            (c.stroke, tuple(v for i, v in enumerate(c.point) if i != position))
            for c in result.outcomes
        )
    )
    for (variant, stroke, rest), (x, y) in lines.items():
        v, o = variants.index(variant), others.index((stroke, rest))
        parts = [result.study.label(variant)] if len(variants) > 1 else []
        parts += [stroke] if len({k[1] for k in lines}) > 1 or not parts else []
        parts += [
            f"{a.label or a.name} {_short(value)}"
            for a, value in zip([a for i, a in enumerate(axes) if i != position], rest, strict=True)
        ]
        c = o if len(variants) == 1 else v
        (line,) = ax.plot(
            x if all(isinstance(e, (int, float)) for e in x) else [str(e) for e in x],
            y,
            color=CYCLE[c % len(CYCLE)],
            marker=MARKERS[c % len(MARKERS)],
            markersize=4,
            linewidth=1.3,
            linestyle=DASHES[o % len(DASHES)] if len(lines) > len(variants) > 1 else "-",
        )
        handles.setdefault(", ".join(parts), line)
    _style(
        ax,
        _with_unit(axis.label or axis.name, axis.unit),
        _with_unit(panel.label or text, unit),
        panel.title or panel.stroke or "",
    )
    found = list(dict.fromkeys(case.point[position] for case in result.outcomes))
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in found):
        _ticks(ax, "x", log=axis.log, values=found)
    _ticks(ax, "y", log=panel.log)
    return [f"{absent} point{'s' if absent > 1 else ''}"] if absent else []


def _bars(
    result: StudyOutcomes, spec: Any, panel: Any, ax: Axes, handles: dict[str, Any]
) -> list[str]:
    del spec
    text, unit, factor = result.study.shown(panel.number)
    if panel.unit:
        unit, factor = panel.unit, to_unit(panel.unit)
    thesis = result.study.number_spec(panel.number).thesis
    variants = _variants(result, panel)
    strokes = list(dict.fromkeys(s for v in variants for s in _strokes(result, panel, v)))
    missing: list[str] = []
    every = list(result.study.spec.variants)
    width = 0.8 / max(1, len(variants))
    for i, variant in enumerate(variants):
        for k, stroke in enumerate(strokes):
            case = next(
                (
                    c
                    for c in result.outcomes
                    if (c.variant, c.stroke) == (variant, stroke) and result.study.shows(panel, c)
                ),
                None,
            )
            if case is None:
                continue
            outcome = result.outcomes[case]
            value = outcome.numbers.get(panel.number) if outcome.status == "done" else None
            x = k + (i - (len(variants) - 1) / 2) * width
            if value is None:
                missing.append(f"{result.study.label(variant)} {stroke}")
            else:
                bar = ax.bar(
                    x,
                    factor * value,
                    0.92 * width,
                    color=CYCLE[every.index(variant) % len(CYCLE)],
                )
                handles.setdefault(result.study.label(variant), bar)
                ax.annotate(
                    f"{factor * value:.3g}",
                    (x, factor * value),
                    xytext=(0, 2),
                    textcoords="offset points",
                    ha="center",
                    fontsize=SMALL - 1,
                )
            printed = thesis.get(f"{variant}.{stroke}")
            if printed is not None:
                (mark,) = ax.plot(
                    [x - 0.46 * width, x + 0.46 * width],
                    [printed, printed],
                    color="#222222",
                    linewidth=2.2,
                    solid_capstyle="butt",
                )
                handles.setdefault(result.study.spec.thesis.cite, mark)
    ax.set_xticks(range(len(strokes)), [plain_text(s) for s in strokes])
    _style(ax, "", _with_unit(panel.label or text, unit), panel.title)
    ax.grid(False, axis="x")
    if panel.log:
        ax.set_yscale("log")
        low, high = ax.get_ylim()
        ax.set_ylim(low, high * (high / low) ** 0.05)
    else:
        ax.margins(y=0.12)
    _ticks(ax, "y", log=panel.log)
    return missing
