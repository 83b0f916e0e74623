"""Figures of a touch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feltmb.action.touch.published import published_numbers
from feltmb.action.touch.static import Distances, StaticTouch
from feltmb.action.touch.strikes import Strike
from unmodeled.style import head_line

if TYPE_CHECKING:
    from feltmb.run.quasistatic import SimulatedPress

GRAM_FORCE = 9.80665e-3  # N

#: Range of an axis of speeds without a strike [m/s].
EMPTY_SPEEDS = 0.3, 8.0
PRESS, RELEASE, LIFTED, MUTED = "#0b5394", "#b45f06", "#38761d", "#777777"


def static_figure(
    title: str,
    static: StaticTouch,
    slow: SimulatedPress,
    ruled: Distances,
    before: StaticTouch | None = None,
) -> Any:
    """Plot force against travel: press and release, with let-off and key bottom marked.

    ``before``: of another mechanism, drawn with thin lines.
    """
    from unmodeled.figure import Figure

    s = static
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    which = "" if before is None else ", after"
    label = f"simulated at 10 mm/s{which}"
    axes.plot(1e3 * slow.travel, slow.force, color=MUTED, lw=0.7, label=label, zorder=1)
    if before is not None:
        _static_curves(axes, before, ", before", width=0.5, alpha=0.7)
    _static_curves(axes, s, which)
    low, high = (1e3 * w for w in s.window)
    axes.axvspan(low, high, color=LIFTED, alpha=0.07, lw=0, label="window of the weights DW, UW")
    for y in (s.down_weight, s.up_weight):
        axes.hlines(y, low, high, color=LIFTED, lw=0.8, ls=":")
    # Without a let-off, the weights give the scale: the press ends at a blocked hammer or key.
    top = max(
        1.5 * t.let_off_force if math.isfinite(t.let_off_force) else 3.0 * t.down_weight_most
        for t in (s, before)
        if t is not None
    )
    if s.has_let_off:
        axes.plot([1e3 * s.let_off_travel], [s.let_off_force], "o", color=PRESS, ms=6)
        axes.annotate(
            f"let-off {1e3 * ruled.let_off:.1f} mm\nfrom the string,\npeak {s.let_off_force:.2f} N",
            (1e3 * s.let_off_travel, s.let_off_force),
            xytext=(-14, 16),
            textcoords="offset points",
            ha="right",
            fontsize=9,
            color=PRESS,
            arrowprops={"arrowstyle": "-", "color": PRESS, "lw": 0.7},
        )
    if s.has_bottom:
        axes.axvline(1e3 * s.bottom_travel, color="k", lw=0.7, ls="-.")
        axes.text(
            1e3 * s.bottom_travel + 0.08,
            0.03 * top,
            f"key meets\npunching:\ndip {1e3 * ruled.dip:.1f} mm"
            + (f",\naftertouch\n{1e3 * ruled.aftertouch:.1f} mm" if s.has_let_off else ""),
            fontsize=8,
            va="bottom",
            ha="left",
        )
    axes.set_xlim(0.0, 1e3 * max(t.press.travel[-1] for t in (s, before) if t is not None) + 0.8)
    axes.set_ylim(0.0, top)
    axes.set_xlabel("travel of the key front [mm]")
    axes.set_ylabel("force at the key front [N]")
    head_line(figure, f"{title}: static touch", 12.0, "normal")
    axes.legend(loc="upper left", frameon=False, fontsize=9)
    gram = axes.secondary_yaxis("right", functions=(_to_gram, _from_gram))
    gram.set_ylabel("gram-force")
    return figure


def _static_curves(
    axes: Any, s: StaticTouch, which: str, *, width: float = 1.0, alpha: float = 1.0
) -> None:
    """Curves of one mechanism; ``which`` is a part of their names in the legend."""
    weights = f"DW {s.down_weight:.2f} N, UW {s.up_weight:.2f} N"
    for path, color, lw, ls, name in (
        (s.press, PRESS, 1.8, "-", f"press{which}"),
        (s.release, RELEASE, 1.8, "-", f"release{which}"),
        (s.lifted_press, LIFTED, 1.2, "--", f"damper lifted{which}: {weights}"),
        (s.lifted_release, LIFTED, 1.2, "--", "_"),
    ):
        axes.plot(
            1e3 * path.travel,
            path.force,
            color=color,
            lw=width * lw,
            ls=ls,
            alpha=alpha,
            label=name,
        )
    if which == ", before" and s.has_let_off:
        axes.plot([1e3 * s.let_off_travel], [s.let_off_force], "o", color=PRESS, ms=6, mfc="none")


def _to_gram(force: Any) -> Any:
    return force / GRAM_FORCE


def _from_gram(weight: Any) -> Any:
    return weight * GRAM_FORCE


@dataclass(frozen=True)
class _Family:
    """Strikes of one kind and one mechanism, with their look."""

    name: str
    strikes: Sequence[Strike]
    fit: tuple[float, float, float] | None
    color: str
    marker: str
    before: bool

    @property
    def look(self) -> dict[str, Any]:
        """Options of a plot."""
        if self.before:
            return {"color": self.color, "marker": self.marker, "mfc": "none", "alpha": 0.7}
        return {"color": self.color, "marker": self.marker}

    def columns(self, x: str, y: str, factor: float = 1.0) -> tuple[list[float], list[float]]:
        """Two values of the strikes that have both; the second with a factor."""
        rows = [(getattr(b, x), getattr(b, y)) for b in self.strikes]
        rows = [(p, factor * q) for p, q in rows if p is not None and q is not None]
        return [p for p, _ in rows], [q for _, q in rows]


def _families(
    strikes: Sequence[Strike], fits: Mapping[str, tuple[float, float, float]], which: str
) -> list[_Family]:
    return [
        _Family(
            f"{kind}{which}",
            [b for b in strikes if b.kind == kind and b.hammer_speed],
            fits.get(kind),
            color,
            marker,
            which == ", before",
        )
        for kind, color, marker in (("pressed", PRESS, "o"), ("struck", RELEASE, "s"))
    ]


def _draw_speeds(panels: Any, families: Sequence[Any]) -> None:
    """Impact speed against the force of a press, and against the speed of the key."""
    for f in families:
        if f.name.startswith("pressed"):
            line = {"lw": 0.8, "ls": "--"} if f.before else {}
            panels[0].plot(*f.columns("level", "hammer_speed"), **f.look, **line, label=f.name)
        panels[1].plot(*f.columns("key_speed", "hammer_speed"), ls="", **f.look, label=f.name)
    panels[0].set_xlabel("force level of a pressed strike [N]")
    panels[1].set_xlabel("largest key front speed [m/s]")
    for axes in panels:
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylabel("impact speed [m/s]")
        axes.legend(frameon=False, fontsize=9)


def _draw_bottom(axes: Any, families: Sequence[Any]) -> None:
    """Time from the contact with the string to the punching, against the impact speed."""
    landed, latest = False, 25.0
    for f in families:
        v, y = f.columns("hammer_speed", "bottom_after_string", 1e3)
        landed, latest = landed or bool(v), max([latest, *y])
        axes.plot(v, y, lw=0.8, ls="--" if f.before else "-", **f.look, label=f.name)
    axes.axhspan(-4.0, 35.0, color=MUTED, alpha=0.12, lw=0, label="grands, published range")
    axes.axhline(0.0, color="k", lw=0.6)
    axes.set_ylim(-8.0, latest + 25.0)  # the legend is above the points
    axes.set_xscale("log")
    if not landed:  # no key reached its punching
        axes.set_xlim(*EMPTY_SPEEDS)
    axes.set_xlabel("impact speed [m/s]")
    axes.set_ylabel("key bottom after string contact [ms]")
    axes.legend(frameon=False, fontsize=9, loc="upper right")


def _draw_travel(axes: Any, families: Sequence[Any]) -> None:
    """Travel time against the impact speed, with the fitted and the published law."""
    import numpy as np

    def curve(speeds: Sequence[float], a: float, b: float, **look: Any) -> None:
        x = np.geomspace(min(speeds), max(speeds), 60)
        axes.plot(x, a * x**b, **look)

    everything: list[float] = []
    for f in families:
        v, y = f.columns("hammer_speed", "travel_time", 1e3)
        everything += v
        fitted = f.fit is not None and bool(v)
        law = f": {_law(1e3 * f.fit[0], f.fit[1])}" if fitted else ""
        axes.plot(v, y, ls="", **f.look, label=f.name + law)
        if fitted:
            a, b, _ = f.fit
            curve(v, 1e3 * a, b, color=f.color, lw=0.9, ls="--" if f.before else "-")
    if everything:
        published = published_numbers()
        a, b = (published[f"travel_time_{k}_pressed"]["value"] for k in ("factor", "exponent"))
        curve(everything, a, b, color=MUTED, ls=":", lw=1.2, label="grands, " + _law(a, b))
    axes.set_xscale("log")
    axes.set_yscale("log")
    if len(families) > 2:  # room for the legend below the points
        lowest, highest = axes.get_ylim()
        axes.set_ylim(lowest * (lowest / highest) ** 0.3, highest)
    axes.set_xlabel("impact speed [m/s]")
    axes.set_ylabel("travel time [ms]")
    axes.legend(frameon=False, fontsize=9, loc="lower left")


def dynamic_figure(
    title: str,
    strikes: Sequence[Strike],
    fits: Mapping[str, tuple[float, float, float]],
    before: tuple[Sequence[Strike], Mapping[str, tuple[float, float, float]]] | None = None,
) -> Any:
    """Plot impact speed, key-bottom time and travel time of the families of strikes.

    ``before``: strikes and fits of another mechanism, drawn with open markers.
    """
    from matplotlib.ticker import FuncFormatter

    from unmodeled.figure import Figure

    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2)
    families = _families(strikes, fits, "" if before is None else ", after")
    if before is not None:
        families = [*_families(*before, ", before"), *families]
    _draw_speeds(panels[0], families)
    _draw_bottom(panels[1, 0], families)
    _draw_travel(panels[1, 1], families)
    plain = FuncFormatter(lambda value, _pos: f"{value:g}")
    for axes in panels.ravel():
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                axis.set_major_formatter(plain)
                axis.set_minor_formatter(FuncFormatter(_some_minor))
        axes.grid(True, which="major", lw=0.3)
    head_line(figure, f"{title}: strikes", 12.0, "normal")
    return figure


def _law(factor: float, exponent: float) -> str:
    return f"{factor:.0f} ms $v^{{{exponent:.2f}}}$"


def _some_minor(value: float, _pos: int) -> str:
    """Label 2 and 5 between the decades of an axis."""
    lead = f"{value:e}"[0]
    return f"{value:g}" if lead in "25" else ""
