"""Figures of energy (stored, supplied, dissipated), and of force over compression."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb import _core
from feltmb.graphics.plot.axes import head_title, mark_events, panel_grid
from feltmb.graphics.plot.readings import (
    busy_window,
    contact_label,
    contact_numbers,
    finger_work,
    loaded_contacts,
    need_samples,
    run_action,
)
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.style import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    NORMAL,
    ORANGE,
    PALE,
    PURPLE,
    RED,
    SKY,
    SMALL,
    fit_text,
    new_figure,
    plain_text,
    side_legend,
    style_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feltmb.run.results import Run

_STORED = (
    ("kinetic", "kinetic", BLUE),
    ("gravity", "gravity", GREEN),
    ("elastic", "springs, straps,\nflexible members", PURPLE),
    ("contact", "contacts", ORANGE),
    ("string", "string", SKY),
)


@checked
def energy(run: Run) -> Figure:
    """Plot energies [mJ] since the start: stored energy, work of the finger, and losses.

    The bars and the residual are from the energy balance, if the run has one.

    Raises
    ------
    InvalidParameter
        The run has no energies.
    """
    need_samples(run)
    parts = [(f"energy.{n}", label, c) for n, label, c in _STORED if f"energy.{n}" in run]
    if not parts:
        raise InvalidParameter("plot energy: the run has no energies")
    dissipated = run.energy.get("dissipated", {})
    bars = any(dissipated.values())
    figure = new_figure(9.0, 7.2 if bars else 4.2)
    head_title(figure, run, "Energy")
    axes = figure.subplots(2 if bars else 1, 1, squeeze=False, height_ratios=None)[:, 0]
    ax = axes[0]
    t = 1e3 * run.time
    above, below = np.zeros_like(t), np.zeros_like(t)
    for name, label, color in parts:
        change = 1e3 * (run[name] - run[name][0])
        up, down = np.clip(change, 0, None), np.clip(change, None, 0)
        if np.any(change):
            ax.fill_between(t, above, above + up, color=color, alpha=0.8, linewidth=0, label=label)
            ax.fill_between(t, below, below + down, color=color, alpha=0.8, linewidth=0)
        above, below = above + up, below + down
    ax.plot(t, above + below, color=BLACK, linewidth=1.1, label="sum stored")
    work = finger_work(run)
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
            label="dissipated",
            zorder=0,
        )
    ax.axhline(0.0, color=GRAY, linewidth=0.6)
    style_axes(ax, "time [ms]", "change since start [mJ]")
    window = busy_window(run)
    ax.set_xlim(1e3 * window[0], 1e3 * window[1])
    top = max(float(above.max()), 1e3 * float(work.max()) if work is not None else 0.0)
    bottom = float(below.min())
    pad = 0.05 * (top - bottom) or 1.0
    ax.set_ylim(bottom - pad if bottom < 0 else -0.4 * pad, top + pad)
    mark_events(ax, run, window, width=6.2)
    side_legend(ax)
    if bars:
        _dissipation_bars(axes[1], run, dissipated)
    return figure


def _dissipation_bars(ax: Axes, run: Run, dissipated: Mapping[str, float]) -> None:
    groups: dict[str, dict[str, float]] = {}
    for name, value in dissipated.items():
        if not value:
            continue
        match = re.fullmatch(r"contact(\d+)\.(normal|friction)", name)
        if match and f"contact{match.group(1)}.force" in run:
            key, kind = contact_label(run, int(match.group(1))), match.group(2)
        elif match:
            key, kind = f"contact {int(match.group(1))}", match.group(2)
        else:
            key = plain_text(name.replace("joint.", "joint "))
            kind = (
                "friction" if name.startswith("joint.") or name.endswith(".friction") else "normal"
            )
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
        ("normal", "deformation", ORANGE),
        ("friction", "friction", BLUE),
    ):
        if not any(groups[k].get(kind) for k in shown):
            continue
        values = np.array([groups[k].get(kind, 0.0) for k in shown])
        ax.barh(rows, values, left=left, color=color, height=0.7, label=label)
        left = left + values
        ends += left.tolist()
    ax.set_yticks(rows, shown)
    ax.invert_yaxis()
    room = 0.04 * (max(ends) - min(ends)) or 1.0
    ax.set_xlim(min(ends) - (room if min(ends) < 0 else 0.0), max(ends) + room)
    style_axes(ax, "dissipated in the whole run [mJ]")
    ax.grid(False, axis="y")
    ledger = run.energy
    if "residual_relative" in ledger:
        text = (
            f"work in {1e3 * ledger['work_in']:.4g} mJ, dissipated "
            f"{1e3 * ledger['dissipated_total']:.4g} mJ; largest residual "
            f"{1e3 * ledger['residual_largest']:.2g} mJ = "
            f"{ledger['residual_relative']:.1e} of the energy that went through"
        )
        fit_text(ax.set_title(text, fontsize=SMALL + 0.5, loc="left"), 5.6)
    if shown:
        side_legend(ax)


def _alone(law: _core.ContactLaw, deepest: float, lasts: float) -> tuple[Any, Any]:
    """Compression [m] and force [N] of a law for a press to ``deepest`` within ``lasts`` [s]."""
    e = np.linspace(0.0, deepest, 200)
    whole = np.r_[e, e[-2::-1]]
    time = np.linspace(0.0, max(lasts, 1e-4), whole.size)
    force = np.asarray(_core.force_along(law, time.tolist(), whole.tolist()))
    return (e, force[: e.size]), (whole[e.size - 1 :], force[e.size - 1 :])


#: Share of the largest compression between two samples above which a loop has visible corners.
COARSE = 0.25


@checked
def loops(run: Run, numbers: Sequence[int] | None = None) -> Figure:
    """Plot force over compression of contacts, compared with their laws alone.

    For the law alone, virgin felt is compressed uniformly to the largest compression of the run and
    released, within the duration of the contact. The samples of the run are connected by straight
    lines; a note tells if they are too few for a contact.

    Parameters
    ----------
    run
        Run; the laws of the mechanism are read from its provenance.
    numbers
        Numbers of contacts; default: all contacts with a force.

    Raises
    ------
    InvalidParameter
        A number is not a contact, or no contact has a force.
    """
    from feltmb.mechanism import core_law

    need_samples(run)
    known = contact_numbers(run)
    chosen = loaded_contacts(run) if numbers is None else [int(n) for n in numbers]
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
    figure = new_figure(max(2.7 * columns + 0.4, 5.0), 2.3 * rows + 0.9)
    head_title(figure, run, "Force and compression")
    coarse = []
    for i, (ax, number) in enumerate(
        zip(panel_grid(figure, len(chosen), columns), chosen, strict=True)
    ):
        compression = run[f"contact{number:02d}.compression"]
        force = run[f"contact{number:02d}.force"]
        deepest = max(float(compression.max()), 1e-6)
        touching = compression > 0
        lasts = float(np.count_nonzero(touching)) * float(np.mean(np.diff(run.time)))
        up, down = _alone(core_law(laws[number]), deepest, lasts)
        for (e, values), style, label in (
            (up, "-", "law alone, pressed"),
            (down, (0, (2, 1)), "law alone, released"),
        ):
            ax.plot(1e3 * e, values, color="#B0B0B0", linewidth=2.4, linestyle=style, label=label)
        loop = np.where(touching, force, np.nan)
        steps = np.abs(np.diff(compression))[touching[1:] & touching[:-1]]
        if steps.max(initial=0.0) > COARSE * deepest:
            coarse.append(number)
        ax.plot(1e3 * compression, loop, color=RED, linewidth=0.9, label="run")
        style_axes(
            ax,
            "compression [mm]" if i + columns >= len(chosen) else "",
            "force [N]" if i % columns == 0 else "",
        )
        fit_text(ax.set_title(contact_label(run, number), fontsize=SMALL + 0.5, loc="left"), 2.2)
        ax.set_xlim(0.0, 1.08e3 * deepest)
        peak = max(float(force.max()), 1e-6)
        ax.set_ylim(-0.03 * peak, 1.12 * peak)
        ax.locator_params(nbins=4)
    if coarse:
        interval = 1e3 * float(np.median(np.diff(run.time)))
        figure.supxlabel(
            f"Samples every {interval:.3g} ms are few for contacts "
            f"{', '.join(map(str, coarse))}: simulate with a higher output rate.",
            fontsize=NORMAL - 0.5,
            ha="left",
            x=0.01,
        )
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower right", ncols=3, frameon=False, fontsize=NORMAL - 0.5
    )
    return figure
