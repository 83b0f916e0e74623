"""Figures of the fiber models. Every function returns a matplotlib Figure and shows nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb.style import head_line

Array = NDArray[np.float64]

COLORS = ("#1b6ca8", "#d1495b", "#2e8b57", "#edae49", "#6a4c93", "#444444", "#00a6a6", "#b5651d")

FELT_EXAMPLES: dict[str, dict[str, float]] = {
    "van_wyk": {"k_p": 0.01, "E": 2.5e9, "v_f0": 0.1},
    "neckar": {"k_p": 0.01, "E": 2.5e9, "v_f0": 0.1, "v_fm": 0.7},
    "stamm": {"k_p": 0.01, "E": 2.5e9, "v_f0": 0.1, "v_fm": 0.7, "w_f": 0.5},
    "toll_planar": {"E": 2.5e9, "v_f0": 0.1},
    "narter": {"E": 2.5e9, "v_f0": 0.1, "gamma": 1.3, "K_E": 0.01},
    "alkhagen_toll": {"E": 2.5e9, "v_f0": 0.1, "k_b": 1.0, "k_t": 1.0, "beta": 5.0},
    "binomial": {"K_p": 4e6, "gamma": 1.3, "v_f0": 0.1},
    "bending_chain": {"E": 2.5e9, "gamma": 1.3, "v_f0": 0.1, "K_p": 0.64},
    "komori_itoh": {"E": 2.5e8, "v_f0": 0.1},
    "komori_itoh_renewed": {"E": 2.5e7, "v_f0": 0.1},
    "lee_carnaby": {"E": 2.5e8, "v_f0": 0.1, "chord_ratio": 0.9},
}
"""Parameters of a felt-like mass for every law (an illustration, not a fit)."""


def new_figure(width: float = 7.0, height: float = 4.6) -> Any:
    """New figure with a size in inches."""
    from feltmb.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def style_axes(
    axes: Any, xlabel: str, ylabel: str, title: str = "", *, title_size: float = 11
) -> None:
    """Set labels, a light grid, and no frame at the top and right."""
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    if title:
        axes.set_title(title, fontsize=title_size, loc="left")
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def plot_law(made: Any, top: float) -> Any:
    """Plot pressure, tangent modulus and energy of one law up to the volume fraction ``top``."""
    v = np.linspace(made.v_f0, top, 300)
    figure = new_figure(10, 3.4)
    axes = figure.subplots(1, 3)
    rows = (
        (made.pressure(v) / 1e3, "pressure [kPa]"),
        (v * made.slope(v) / 1e3, "tangent modulus [kPa]"),
        (made.energy(v) / 1e3, "energy per fiber volume [kJ/m$^3$]"),
    )
    for ax, (y, label) in zip(axes, rows, strict=True):
        ax.plot(v, y, color=COLORS[0])
        style_axes(ax, "volume fraction $v_f$ [-]", label)
    head_line(figure, made.name, 12.0, "normal")
    return figure


def plot_pressures(parameters: dict[str, dict[str, float]] | None = None, top: float = 0.4) -> Any:
    """Plot the pressure of all compression laws (parameters: :data:`FELT_EXAMPLES`)."""
    from feltmb.fiber.laws import law

    chosen = FELT_EXAMPLES if parameters is None else parameters
    figure = new_figure(8.4, 5.2)
    ax = figure.subplots()
    styles = ("-", "--")
    for number, (name, given) in enumerate(chosen.items()):
        made = law(name, **given)
        v = np.linspace(made.v_f0, min(top, made.limit * 0.98), 400)[1:]
        ax.semilogy(
            v,
            made.pressure(v) / 1e3,
            styles[number // len(COLORS)],
            color=COLORS[number % len(COLORS)],
            label=name,
        )
    ax.set_ylim(1e-2, 1e5)
    style_axes(
        ax,
        "volume fraction $v_f$ [-]",
        "pressure [kPa]",
        "Compression laws, one felt-like mass ($v_{f0}$ = 0.1)",
    )
    ax.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def plot_sphere(n: int = 1500, seed: int = 0, ratio: float = 3.0, spread: int = 30) -> Any:
    """Plot the unit sphere of fiber directions before and after compression (thesis Fig. 3.2)."""
    from feltmb.fiber.orientation import network

    before = network(n, seed, spread)
    after = before.deform(ratio)
    figure = new_figure(8.8, 4.8)
    angle = np.linspace(0, 2 * math.pi, 200)
    pairs = ((before, "random"), (after, f"compressed, R = {ratio:g}"))
    for number, (made, title) in enumerate(pairs):
        ax = figure.add_subplot(1, 2, number + 1, projection="3d")
        d = made.directions
        front = (
            d
            @ np.array(
                [math.cos(0.35) * math.cos(-1.05), math.cos(0.35) * math.sin(-1.05), math.sin(0.35)]
            )
            > 0
        )
        # Points on the back are lighter to show depth.
        ax.scatter(*d[~front].T, s=3, color="#b9cfe0", depthshade=False)
        ax.scatter(*d[front].T, s=5, color=COLORS[0], depthshade=False)
        ax.plot(np.cos(angle), np.sin(angle), 0 * angle, color="#888888", linewidth=0.8)
        ax.view_init(elev=20, azim=-60)
        ax.set_box_aspect((1, 1, 1))
        ax.set_title(title, fontsize=11, y=0.98)
        for name in ("x", "y", "z"):
            getattr(ax, f"set_{name}ticks")([-1, 0, 1])
            getattr(ax, f"set_{name}lim")(-1, 1)
        ax.text2D(0.95, 0.86, "$e_3$ [-]", transform=ax.transAxes)
        ax.set_xlabel("$e_1$ [-]")
        ax.set_ylabel("$e_2$ [-]")
    return figure


def plot_structure(n: int = 6000, seed: int = 0) -> Any:
    """Plot structural numbers over R (thesis Fig. 3.6), with estimates from a sampled network."""
    from feltmb.fiber.orientation import network, structure

    ratios = np.geomspace(1, 30, 120)
    exact = [structure(r) for r in ratios]
    sampled_at = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
    base = network(n, seed, 0)
    sampled = [base.deform(r).structure() for r in sampled_at]
    figure = new_figure(7.6, 4.8)
    ax = figure.subplots()
    labels = {
        "f": "$f$",
        "n3": r"$\langle n_3^4\rangle_c$",
        "e3": r"$\langle e_3^4\rangle_c$",
        "K3": "$K_3$",
        "M3": "$M_3$",
    }
    for color, (name, label) in zip(COLORS, labels.items(), strict=False):
        ax.semilogx(ratios, [getattr(s, name) for s in exact], color=color, label=label)
        ax.errorbar(
            sampled_at,
            [getattr(s, name) for s in sampled],
            yerr=[2 * s.error[name] for s in sampled],
            fmt="o",
            color=color,
            markersize=4,
            capsize=2,
        )
    for value, text in ((math.pi / 4, r"$\pi/4$"), (2 / math.pi, r"$2/\pi$")):
        ax.axhline(value, color="#999999", linewidth=0.7, linestyle=":")
        ax.text(31, value, " " + text, va="center", color="#666666", fontsize=9)
    style_axes(
        ax,
        "$R = v_f / v_{random}$ [-]",
        "structural number [-]",
        f"Lines exact; points: {n} random fibers, 2 standard errors",
    )
    ax.set_xticks([1, 2, 5, 10, 20, 30], ["1", "2", "5", "10", "20", "30"])
    ax.minorticks_off()
    ax.legend(frameon=False, loc="center right", bbox_to_anchor=(1.0, 0.4))
    return figure


def plot_planar() -> Any:
    """Plot a planar glass fiber mass for two orientations (thesis Fig. 3.5): E = 75 GPa."""
    from feltmb.fiber.laws import pressure

    figure = new_figure()
    ax = figure.subplots()
    v = np.linspace(0.02, 0.3, 300)
    for color, f in zip(COLORS, (2 / math.pi, 0.4), strict=False):
        p = pressure("toll_planar", v, E=75e9, v_f0=0.02, f=f)
        ax.plot(v, p / 1e6, color=color, label=f"f = {f:.3f}")
    style_axes(
        ax, "volume fraction $v_f$ [-]", "pressure [MPa]", "Planar fiber mass, E = 75 GPa (eq. 2.8)"
    )
    ax.legend(frameon=False, title="orientation")
    return figure


def plot_van_wyk() -> Any:
    """Plot granular theory and van Wyk's law for spatial networks (thesis Fig. 3.7)."""
    from feltmb.fiber.laws import pressure

    figure = new_figure()
    ax = figure.subplots()
    v = np.geomspace(0.0205, 0.4, 300)
    common: dict[str, Any] = {"E": 2.5e9, "v_f0": 0.02}
    for color, beta in zip(COLORS, (5.0, 10.0, 20.0, 40.0), strict=False):
        p = pressure("alkhagen_toll", v, k_b=1, k_t=1, beta=beta, **common)
        ax.loglog(v, p, color=color, label=rf"granular, $\beta$ = {beta:g}")
    ax.loglog(
        v,
        pressure("van_wyk", v, k_p=0.01, **common),
        color="black",
        linestyle="--",
        label="van Wyk, $k_p$ = 0.01",
    )
    style_axes(
        ax,
        "volume fraction $v_f$ [-]",
        "pressure [Pa]",
        "$k_b = k_t = 1$, random at $v_{f0}$ = 0.02, E = 2.5 GPa",
    )
    ax.set_ylim(1e-1, 1e8)
    ax.set_xticks([0.02, 0.05, 0.1, 0.2, 0.4], ["0.02", "0.05", "0.1", "0.2", "0.4"])
    ax.minorticks_off()
    ax.legend(frameon=False)
    return figure


def plot_toll() -> Any:
    """Plot granular theory and Toll's planar law (thesis Fig. 3.8)."""
    from feltmb.fiber.laws import pressure

    figure = new_figure()
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    v0 = 0.005
    ratio = np.geomspace(1.05, 60, 300)
    v = v0 * ratio
    granular = pressure("alkhagen_toll", v, E=2.5e9, v_f0=v0, k_b=1, k_t=1, beta=1)
    planar = 128 / (3 * math.pi**4) * 2.5e9 * (2 / math.pi) ** 4 * v**5
    top.loglog(ratio, granular, color=COLORS[0], label="granular, spatial (eq. 3.55)")
    top.loglog(ratio, planar, color="black", linestyle="--", label="planar (eq. 3.56)")
    style_axes(top, "", "pressure [Pa]", r"$k_b = k_t = \beta = 1$")
    top.legend(frameon=False)
    bottom.semilogx(ratio, granular / planar, color=COLORS[0])
    bottom.axhline(1, color="#888888", linewidth=0.8, linestyle=":")
    style_axes(bottom, "$R = v_f / v_{random}$ [-]", "ratio [-]")
    bottom.set_xticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
    bottom.minorticks_off()
    return figure


def plot_contacts(d_f: float = 25e-6, gamma: float = math.pi / 2) -> Any:
    """Plot the mean free length of the contact models over volume fraction."""
    from feltmb.fiber.contacts import contact_count, mean_free_length

    figure = new_figure(9.4, 4.2)
    left, right = figure.subplots(1, 2)
    v = np.linspace(0.02, 0.6, 200)
    names = (("van_wyk", "van Wyk, Komori, Toll"), ("pan", "Pan"), ("binomial", "binomial"))
    for color, (name, label) in zip(COLORS, names, strict=False):
        extra: dict[str, Any] = {"gamma": gamma} if name == "binomial" else {}
        left.semilogy(v, mean_free_length(name, v, d_f, **extra) / d_f, color=color, label=label)
    left.semilogy(
        v,
        mean_free_length("komori_makishima", v, d_f, ratio=5.0) / d_f,
        color=COLORS[0],
        linestyle="--",
        label="Komori, R = 5",
    )
    style_axes(
        left, "volume fraction $v_f$ [-]", "mean free length / $d_f$ [-]", "Isotropic fibers"
    )
    left.legend(frameon=False)
    for color, name in zip(COLORS, ("poisson", "binomial"), strict=False):
        extra = {"gamma": gamma} if name == "binomial" else {}
        c = contact_count(name, 0.2, d_f, 20 * gamma * d_f, **extra)
        keep = c.k <= 30
        shift = -0.2 if name == "poisson" else 0.2
        right.bar(c.k[keep] + shift, c.probability[keep], 0.4, color=color, label=name)
    style_axes(
        right,
        "contacts on a fiber [1]",
        "probability [-]",
        f"$v_f$ = 0.2, length {20 * gamma:.1f} $d_f$",
    )
    right.legend(frameon=False)
    return figure


def plot_arcs() -> Any:
    """Plot the energy method: schemes and parts of the energy (eq. 2.6)."""
    from feltmb.fiber.energy_method import compress_arcs

    figure = new_figure(9.6, 4.2)
    left, right = figure.subplots(1, 2)
    strain = np.linspace(0, 0.5, 60)
    for color, scheme in zip(COLORS, ("isotropic", "confined", "simple"), strict=False):
        c = compress_arcs(strain, E=2.5e9, v_f0=0.05, scheme=scheme, chord_ratio=0.95)
        left.plot(c.strain, c.pressure / 1e3, color=color, label=f"{scheme}, b/L = 0.95")
    strain = np.concatenate([[0.0, 1e-6], strain[1:]])
    straight = compress_arcs(strain, E=2.5e9, v_f0=0.05, chord_ratio=1.0)
    left.plot(
        straight.strain,
        straight.pressure / 1e3,
        color="black",
        linestyle="--",
        label="confined, straight",
    )
    style_axes(left, "axial strain [-]", "axial stress [kPa]", "Segments bent to arcs")
    left.legend(frameon=False)
    strain = np.linspace(0, 0.7, 141)
    c = compress_arcs(
        strain, E=2.5e9, v_f0=0.05, scheme="simple", chord_ratio=0.999, slip_stress=2e6
    )
    shares = (c.bending_share, c.straightening_share, c.slipping_share)
    right.stackplot(
        c.strain, *shares, colors=COLORS[:3], labels=("bending", "straightening", "slipping")
    )
    right.set_ylim(0, 1)
    style_axes(
        right,
        "axial strain [-]",
        "share of the segments [-]",
        "Simple, b/L = 0.999, slip stress 2 MPa",
    )
    right.legend(loc="lower left", framealpha=0.95)
    return figure


def plot_history() -> Any:
    """Plot loops of the laws with memory."""
    from feltmb.fiber.histories import history

    figure = new_figure(10, 3.6)
    axes = figure.subplots(1, 3)
    t = np.linspace(0, 4, 1601)
    rise = 1 - np.abs(1 - np.mod(t, 2))
    strain = 0.5 * rise * np.where(t < 2, 1.0, 0.6)
    felt: dict[str, Any] = {
        "k_p": 0.01,
        "E": 2.5e9,
        "v_f0": 0.13,
        "phi": 0.15,
        "f_c": [200.0, 2000.0, 8000.0],
    }
    p = history("dunlop", t, strain, **felt)
    axes[0].plot(strain, p / 1e3, color=COLORS[0], label="Dunlop")
    p = history("stamm_kelvin", t, strain, G=3e6, c=1e6, **felt)
    axes[0].plot(strain, p / 1e3, color=COLORS[1], label="Stamm")
    style_axes(axes[0], "strain [-]", "stress [kPa]", "Spring-slider units")
    t = np.linspace(0, 3, 1201)
    hold = 0.4 * np.minimum(t / 0.05, 1)
    p = history("maxwell", t, hold, E_inf=1e5, p_inf=2.5, E=1e5, p=2.5, tau=0.5)
    axes[1].plot(t, p / 1e3, color=COLORS[2], label="Maxwell, 3 components")
    axes[1].set_ylim(bottom=0)
    style_axes(axes[1], "time [s]", "stress [kPa]", "Relaxation at strain 0.4")
    t = np.linspace(0, 2e-3, 2001)
    u = 1e-3 * np.sin(math.pi * t / 2e-3)
    cases: tuple[tuple[str, dict[str, Any]], ...] = (
        ("stulov", {"F0": 1e9, "p": 2.5, "epsilon": 0.6, "tau0": 2e-4}),
        ("stulov_differential", {"F0": 4e8, "p": 2.5, "alpha": 3e-4}),
        ("hunt_crossley", {"K": 4e8, "n": 2.5, "alpha": 0.2}),
        ("lankarani_nikravesh", {"K": 4e8, "n": 2.5, "e": 0.8, "impact_speed": 1.57}),
    )
    for color, (name, given) in zip(COLORS, cases, strict=False):
        axes[2].plot(
            u * 1e3, history(name, t, u, **given), color=color, label=name.replace("_", " ")
        )
    style_axes(axes[2], "compression [mm]", "force [N]", "Half sine of 2 ms")
    for ax in axes:
        ax.legend(frameon=False, fontsize=8)
    return figure


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


def gallery(fibers: int = 6000, seed: int = 0) -> dict[str, Any]:
    """All figures by name."""
    drawers: dict[str, Callable[[], Any]] = {
        "pressures": plot_pressures,
        "sphere": lambda: plot_sphere(min(fibers, 3000), seed),
        "structure": lambda: plot_structure(fibers, seed),
        "planar": plot_planar,
        "van_wyk": plot_van_wyk,
        "toll": plot_toll,
        "contacts": plot_contacts,
        "arcs": plot_arcs,
        "history": plot_history,
    }
    return {name: draw() for name, draw in drawers.items()}
