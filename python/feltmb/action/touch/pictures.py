"""Figures of a touch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from feltmb.action.touch.published import published_numbers
from feltmb.action.touch.static import StaticTouch
from feltmb.action.touch.strikes import Strike

if TYPE_CHECKING:
    from feltmb.run.quasistatic import SimulatedPress

GRAM_FORCE = 9.80665e-3  # N

#: Range of an axis of speeds without a strike [m/s].
EMPTY_SPEEDS = 0.3, 8.0
PRESS, RELEASE, LIFTED, MUTED = "#0b5394", "#b45f06", "#38761d", "#777777"


def static_figure(name: str, static: StaticTouch, slow: SimulatedPress) -> Any:
    """Plot force against travel: press and release, with let-off and key bottom marked."""
    from feltmb.figure import Figure

    s = static
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(
        1e3 * slow.travel, slow.force, color=MUTED, lw=0.7, label="simulated at 10 mm/s", zorder=1
    )
    axes.plot(1e3 * s.press.travel, s.press.force, color=PRESS, lw=1.8, label="press")
    axes.plot(1e3 * s.release.travel, s.release.force, color=RELEASE, lw=1.8, label="release")
    label = "damper lifted"
    for path in (s.lifted_press, s.lifted_release):
        axes.plot(1e3 * path.travel, path.force, color=LIFTED, lw=1.2, ls="--", label=label)
        label = "_"
    low, high = (1e3 * w for w in s.window)
    axes.axvspan(low, high, color=LIFTED, alpha=0.07, lw=0)
    for y in (s.down_weight, s.up_weight):
        axes.hlines(y, low, high, color=LIFTED, lw=0.8, ls=":")
    axes.text(
        low + 0.1,
        0.03,
        f"window of the weights: DW {s.down_weight:.2f} N, UW {s.up_weight:.2f} N",
        color=LIFTED,
        fontsize=8,
    )
    # Without a let-off, the weights give the scale: the press ends at a blocked hammer or key.
    top = 1.5 * s.let_off_force if math.isfinite(s.let_off_force) else 3.0 * s.down_weight_most
    if math.isfinite(s.let_off_travel):
        axes.plot([1e3 * s.let_off_travel], [s.let_off_force], "o", color=PRESS, ms=6)
        axes.annotate(
            f"let-off\n{s.let_off_force:.2f} N at {1e3 * s.let_off_travel:.2f} mm",
            (1e3 * s.let_off_travel, s.let_off_force),
            xytext=(-14, 16),
            textcoords="offset points",
            ha="right",
            fontsize=9,
            color=PRESS,
            arrowprops={"arrowstyle": "-", "color": PRESS, "lw": 0.7},
        )
    if math.isfinite(s.key_dip):
        axes.axvline(1e3 * s.key_dip, color="k", lw=0.7, ls="-.")
        axes.text(
            1e3 * s.key_dip + 0.08,
            0.03 * top,
            "key meets\npunching",
            fontsize=8,
            va="bottom",
            ha="left",
        )
    axes.set_xlim(0.0, 1e3 * s.press.travel[-1] + 0.8)
    axes.set_ylim(0.0, top)
    axes.set_xlabel("travel of the key front [mm]")
    axes.set_ylabel("force at the key front [N]")
    axes.set_title(f"{name}: static touch", loc="left")
    axes.legend(loc="upper left", frameon=False, fontsize=9)
    gram = axes.secondary_yaxis("right", functions=(_to_gram, _from_gram))
    gram.set_ylabel("gram-force")
    return figure


def _to_gram(force: Any) -> Any:
    return force / GRAM_FORCE


def _from_gram(weight: Any) -> Any:
    return weight * GRAM_FORCE


def dynamic_figure(
    name: str, strikes_of_all: Sequence[Strike], fits: Mapping[str, tuple[float, float, float]]
) -> Any:
    """Plot impact speed, key-bottom time and travel time of the families of strikes."""
    import numpy as np
    from matplotlib.ticker import FuncFormatter

    from feltmb.figure import Figure

    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2)
    families = [
        (kind, color, marker, [b for b in strikes_of_all if b.kind == kind and b.hammer_speed])
        for kind, color, marker in (("pressed", PRESS, "o"), ("struck", RELEASE, "s"))
    ]

    def columns(strikes: list[Strike], x: str, y: str) -> tuple[list[float], list[float]]:
        rows = [(getattr(b, x), getattr(b, y)) for b in strikes]
        rows = [(p, q) for p, q in rows if p is not None and q is not None]
        return [p for p, _ in rows], [q for _, q in rows]

    kind, color, marker, strikes = families[0]
    axes = panels[0, 0]
    axes.plot(*columns(strikes, "level", "hammer_speed"), marker=marker, color=color)
    axes.set_xlabel("force level of a pressed strike [N]")
    axes = panels[0, 1]
    for kind, color, marker, strikes in families:
        axes.plot(*columns(strikes, "key_speed", "hammer_speed"), marker, color=color, label=kind)
    axes.set_xlabel("largest key front speed [m/s]")
    for axes in (panels[0, 0], panels[0, 1]):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylabel("impact speed [m/s]")
    panels[0, 1].legend(frameon=False, fontsize=9)
    axes = panels[1, 0]
    for kind, color, marker, strikes in families:
        v, y = columns(strikes, "hammer_speed", "bottom_after_string")
        axes.plot(v, [1e3 * t for t in y], marker=marker, lw=0.8, color=color, label=kind)
    axes.axhspan(-4.0, 35.0, color=MUTED, alpha=0.12, lw=0, label="grands, published range")
    axes.axhline(0.0, color="k", lw=0.6)
    axes.set_ylim(-8.0, 50.0)
    axes.set_xscale("log")
    if not any(columns(f[3], "hammer_speed", "bottom_after_string")[0] for f in families):
        axes.set_xlim(*EMPTY_SPEEDS)  # no key reached its punching
    axes.set_xlabel("impact speed [m/s]")
    axes.set_ylabel("key bottom after string contact [ms]")
    axes.legend(frameon=False, fontsize=9, loc="upper right")
    axes = panels[1, 1]
    everything: list[float] = []
    for kind, color, marker, strikes in families:
        v, y = columns(strikes, "hammer_speed", "travel_time")
        everything += v
        axes.plot(v, [1e3 * t for t in y], marker, color=color, label=kind)
        if kind in fits and v:
            a, b, _ = fits[kind]
            x = np.geomspace(min(v), max(v), 60)
            axes.plot(
                x, 1e3 * a * x**b, color=color, lw=0.9, label=f"{1e3 * a:.0f} ms $v^{{{b:.2f}}}$"
            )
    published = published_numbers()
    if everything:
        x = np.geomspace(min(everything), max(everything), 60)
        a, b = (published[f"travel_time_{k}_pressed"]["value"] for k in ("factor", "exponent"))
        axes.plot(x, a * x**b, color=MUTED, ls="--", lw=0.9, label="grands, " + _law(a, b))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("impact speed [m/s]")
    axes.set_ylabel("travel time [ms]")
    axes.legend(frameon=False, fontsize=9)
    plain = FuncFormatter(lambda value, _pos: f"{value:g}")
    for axes in panels.ravel():
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                axis.set_major_formatter(plain)
                axis.set_minor_formatter(FuncFormatter(_some_minor))
        axes.grid(True, which="major", lw=0.3)
    figure.suptitle(f"{name}: strikes", x=0.01, ha="left")
    return figure


def _law(factor: float, exponent: float) -> str:
    return f"{factor:.0f} ms $v^{{{exponent:.2f}}}$"


def _some_minor(value: float, _pos: int) -> str:
    """Label 2 and 5 between the decades of an axis."""
    lead = f"{value:e}"[0]
    return f"{value:g}" if lead in "25" else ""
