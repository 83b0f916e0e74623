"""Figures of the fiber models: chapters 2 and 3 of the thesis, and laws of the literature.

Usage: python bench/thesis_studies/fiber_figures.py FOLDER [--fibers N] [--seed N]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.fiber.plot import COLORS
from unmodeled.style import new_figure, style_axes

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


def pressures(parameters: dict[str, dict[str, float]] | None = None, top: float = 0.4) -> Any:
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


def sphere(n: int = 1500, seed: int = 0, ratio: float = 3.0, spread: int = 30) -> Any:
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


def structural_numbers(n: int = 6000, seed: int = 0) -> Any:
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


def planar() -> Any:
    """Plot a planar glass fiber mass for two orientations (thesis Fig. 3.5): E = 75 GPa."""
    from feltmb.fiber.laws import pressure

    figure = new_figure(7.0, 4.6)
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


def van_wyk() -> Any:
    """Plot granular theory and van Wyk's law for spatial networks (thesis Fig. 3.7)."""
    from feltmb.fiber.laws import pressure

    figure = new_figure(7.0, 4.6)
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


def toll() -> Any:
    """Plot granular theory and Toll's planar law (thesis Fig. 3.8)."""
    from feltmb.fiber.laws import pressure

    figure = new_figure(7.0, 4.6)
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


def contact_models(d_f: float = 25e-6, gamma: float = math.pi / 2) -> Any:
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


def arcs() -> Any:
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


def laws_with_memory() -> Any:
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
        ("stulov", {"stiffness": 1e9, "exponent": 2.5, "amplitude": 0.6, "time": 2e-4}),
        ("stulov_differential", {"stiffness": 4e8, "exponent": 2.5, "time": 3e-4}),
        ("hunt_crossley", {"stiffness": 4e8, "exponent": 2.5, "damping": 0.2}),
        (
            "lankarani_nikravesh",
            {"stiffness": 4e8, "exponent": 2.5, "restitution": 0.8, "impact_speed": 1.57},
        ),
    )
    for color, (name, given) in zip(COLORS, cases, strict=False):
        axes[2].plot(
            u * 1e3, history(name, t, u, **given), color=color, label=name.replace("_", " ")
        )
    style_axes(axes[2], "compression [mm]", "force [N]", "Half sine of 2 ms")
    for ax in axes:
        ax.legend(frameon=False, fontsize=8)
    return figure


def figures(fibers: int = 6000, seed: int = 0) -> dict[str, Callable[[], Any]]:
    """Functions that draw, by the name of the figure."""
    return {
        "pressures": pressures,
        "sphere": lambda: sphere(min(fibers, 3000), seed),
        "structure": lambda: structural_numbers(fibers, seed),
        "planar": planar,
        "van_wyk": van_wyk,
        "toll": toll,
        "contacts": contact_models,
        "arcs": arcs,
        "history": laws_with_memory,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fibers", type=int, default=6000, help="the thesis uses 6000")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for name, draw in figures(given.fibers, given.seed).items():
        draw().savefig(given.folder / f"{name}.png")


if __name__ == "__main__":
    main()
