"""Figures of the fiber models. Every function returns a matplotlib Figure and shows nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.style import new_figure, style_axes

Array = NDArray[np.float64]

COLORS = ("#1b6ca8", "#d1495b", "#2e8b57", "#edae49", "#6a4c93", "#444444", "#00a6a6", "#b5651d")


def plot_fits(fits: Sequence[Any]) -> Any:
    """Plot a measured curve, fitted laws and residuals.

    The abscissa is what was measured: laws that estimate the unloaded thickness give the same
    sample different volume fractions, so that these are drawn over the thickness.
    """
    from matplotlib import colormaps

    from feltmb.fiber.fitting import THICKNESS

    by_thickness = all(THICKNESS in f.values for f in fits)

    def at(f: Any, v: Array) -> Array:
        """Abscissa of volume fractions of a fit."""
        if not by_thickness:
            return v
        return np.asarray(1e3 * f.values["v_f0"] * f.values[THICKNESS] / v)

    figure = new_figure(7.4, 6.0)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.4))
    drawn: set[str] = set()
    laws = list(dict.fromkeys(f.model for f in fits))
    palette = COLORS
    if len(laws) > len(COLORS):
        palette = tuple(colormaps["tab20"](range(20)))
    named: set[str] = set()
    for f in fits:
        color = palette[laws.index(f.model) % len(palette)]
        line = "--" if f.branch == "unloading" and len(fits) > len(laws) else "-"
        if f.branch not in drawn:
            marker = "o" if f.branch != "unloading" else "s"
            top.plot(
                at(f, f.v_f),
                f.pressure / 1e3,
                marker,
                color="#777777",
                markersize=3,
                label=f"data, {f.branch}",
            )
            drawn.add(f.branch)
        made = f.law()
        v = np.linspace(max(np.min(f.v_f), made.v_f0), np.max(f.v_f), 300)
        label = f.model if f.model not in named else "_"
        named.add(f.model)
        top.plot(at(f, v), made.pressure(v) / 1e3, line, color=color, label=label)
        order = np.argsort(f.v_f)
        bottom.plot(
            at(f, f.v_f[order]),
            f.residuals[order] / 1e3,
            ".-",
            color=color,
            markersize=4,
            linewidth=0.7,
        )
    bottom.axhline(0, color="black", linewidth=0.8)
    style_axes(top, "", "pressure [kPa]", fits[0].name)
    measured = "thickness [mm]" if by_thickness else "volume fraction $v_f$ [-]"
    style_axes(bottom, measured, "data - law [kPa]")
    if by_thickness:
        bottom.invert_xaxis()  # compression to the right
    if len(fits) > len(laws):
        top.plot([], [], "--", color="#777777", label="law, unloading")
    if len(laws) > 4:
        beside = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "borderaxespad": 0.0}
        top.legend(frameon=False, fontsize=8, **beside)
    else:
        top.legend(frameon=False, fontsize=8)
    return figure


def plot_simulation(run: Any) -> Any:
    """Plot pressure loop, contacts and energies of a fiber-by-fiber simulation."""
    from feltmb.fiber.contacts import contacts_per_volume

    figure = new_figure(10.5, 3.8)
    axes = figure.subplots(1, 3)
    v, p, phase = run.column("v_f"), run.column("pressure"), run.column("phase")
    for which, label in ((0, "loading"), (1, "unloading")):
        keep = phase == which
        if which == 1:
            # The reversal belongs to both branches.
            keep = keep | np.append(keep[1:], False)
        axes[0].plot(v[keep], p[keep] / 1e3, color=COLORS[which], label=label)
        contacts = run.column("contacts")[keep] * v[keep]
        volume = run.laid["volume"] * run.box.v_f
        axes[1].plot(v[keep], contacts / volume * 1e-9, color=COLORS[which], label=label)
    style_axes(
        axes[0],
        "volume fraction $v_f$ [-]",
        "pressure [kPa]",
        f"friction {run.box.friction:g}, loop loss {100 * run.loop_loss:.0f} %"
        if run.done
        else "unfinished",
    )
    grid = np.linspace(np.min(v), np.max(v), 50)
    toll = contacts_per_volume("toll", grid, run.box.d_f, counting="once")
    axes[1].plot(grid, toll * 1e-9, color="black", linestyle="--", label="Toll, isotropic")
    style_axes(axes[1], "volume fraction $v_f$ [-]", "contacts [1/mm$^3$]", "Each contact once")
    strain = run.column("step") * (1 if len(v) else 0)
    for color, (name, label) in zip(
        COLORS,
        (
            ("work", "work"),
            ("bending", "bending energy"),
            ("friction_loss", "friction"),
            ("drag_loss", "drag"),
        ),
        strict=False,
    ):
        axes[2].plot(strain / 1e3, run.column(name) * 1e6, color=color, label=label)
    style_axes(axes[2], "step / 1000", "energy [uJ]", "Energy books")
    for ax in axes:
        ax.legend(frameon=False, fontsize=8)
    return figure
