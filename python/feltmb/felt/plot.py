"""Figures of felts and their laws. Every function returns a matplotlib Figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from unmodeled.style import new_figure, style_axes

if TYPE_CHECKING:
    from feltmb.felt.auditing import Audit
    from feltmb.felt.envelopes import FeltEnvelope
    from feltmb.felt.identification import Identification
    from feltmb.felt.measured import MeasuredLoop

__all__ = [
    "plot_audit",
    "plot_envelope",
    "plot_identification",
    "plot_measured_loop",
]

LOADING, UNLOADING, FRICTION = "#1b6ca8", "#d1495b", "#edae49"
GRAYS = ("#bbbbbb", "#888888", "#555555", "#222222")


def _scale(largest: float) -> tuple[float, str]:
    """Factor and unit for a pressure axis."""
    return (1e-6, "MPa") if largest >= 1e6 else (1e-3, "kPa")


def plot_identification(result: Identification) -> Any:
    """Plot a loop with the identified felt, its components, angles and residuals."""
    m = result.material
    factor, unit = _scale(float(result.loading.pressure.max()))
    v = np.linspace(m.v_f0, m.end, 400)
    figure = new_figure(10.0, 7.2)
    (loop, parts), (angle, rest) = figure.subplots(2, 2)
    for fit, color in ((result.loading, LOADING), (result.unloading, UNLOADING)):
        curve = m.branch(fit.which, v)
        loop.plot(fit.v_f, fit.pressure * factor, ".", ms=3, color=color, alpha=0.5)
        loop.plot(v, curve.pressure * factor, color=color, label=f"{fit.which}, identified")
        parts.plot(fit.v_f, fit.elastic * factor, ".", ms=3, color=color, alpha=0.5)
        parts.plot(v, curve.elastic * factor, color=color, label=f"elastic, {fit.which}")
        parts.plot(v, curve.friction * factor, "--", color=color, label=f"friction, {fit.which}")
        angle.plot(fit.v_f, np.degrees(fit.theta_cr), ".", ms=3, color=color, alpha=0.5)
        angle.plot(v, np.degrees(curve.theta_cr), color=color, label=fit.which)
        rest.plot(fit.v_f, fit.residuals * factor, ".", ms=3, color=color, label=fit.which)
    loop.legend(frameon=False)
    parts.legend(frameon=False)
    angle.legend(frameon=False, loc="lower right")
    rest.axhline(0.0, color="#888888", lw=0.8)
    rest.legend(frameon=False)
    title = "SYNTHETIC fibers, " if "synthetic" in m.about.lower() else ""
    style_axes(loop, "volume fraction [-]", f"pressure [{unit}]", f"{title}{result.name}: loop")
    style_axes(parts, "volume fraction [-]", f"stress [{unit}]", "Parts: dots from the data")
    style_axes(angle, "volume fraction [-]", "critical angle [deg]", "Critical angle of sliding")
    style_axes(rest, "volume fraction [-]", f"residual [{unit}]", "Measured minus identified")
    return figure


def plot_envelope(made: FeltEnvelope) -> Any:
    """Plot the force of a loop, with unloading of smaller cycles by the law with memory."""
    e = np.linspace(0.0, made.closing, 400)
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    axes.plot(e * 1e3, made.core.loading(e), color=LOADING, label="loading")
    for share in (1.0, 0.75, 0.5):
        x = e[e <= share * made.closing * (1 + 1e-12)]
        axes.plot(
            x * 1e3,
            made.core.unloading(x, share * made.closing),
            color=UNLOADING,
            lw=1.6 if share == 1.0 else 0.9,
            label=f"unloading from {share * made.closing * 1e3:.3g} mm",
        )
    axes.legend(frameon=False)
    title = made.name + (" (SYNTHETIC felt)" if "synthetic" in made.about.lower() else "")
    style_axes(axes, "compression [mm]", "force [N]", title)
    return figure


def plot_measured_loop(found: MeasuredLoop) -> Any:
    """Plot a measured loop, and the force of the law with memory over the same compression.

    Of several loadings, the later ones are darker. The bands are one standard uncertainty wide on
    both sides of the branches.
    """
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    e, made, sure = found.compression * 1e3, found.envelope, found.uncertainty
    parts = found.branches.by_loading
    for i, part in enumerate(parts):
        name = f"measured, loading {i + 1}" if len(parts) > 1 else "measured"
        color = GRAYS[i * (len(GRAYS) - 1) // (len(parts) - 1)] if len(parts) > 1 else GRAYS[1]
        shown = i in (0, len(parts) - 1)
        axes.plot(e[part], found.force[part], ".", color=color, ms=2.5, label=name if shown else "")
    axes.plot(e, found.by_law, color=LOADING, lw=0.9, label="law with memory")
    for i, (force, sd) in enumerate(
        ((made.loading, sure.loading), (made.unloading, sure.unloading))
    ):
        axes.fill_between(
            made.compression * 1e3, force - sd, force + sd, color=FRICTION, alpha=0.5, lw=0.0,
            label="" if i else "± standard uncertainty",
        )  # fmt: skip
    axes.axhline(0.0, color="#888888", lw=0.8)
    axes.legend(frameon=False)
    style_axes(axes, "compression [mm]", "force [N]", found.envelope.name)
    return figure


def plot_audit(audit: Audit) -> Any:
    """Plot curves with the valid range, the loop near zero, losses and stiffness."""
    figure = new_figure(11.0, 7.0)
    (curves, band), (loss, stiffness) = figure.subplots(2, 2)
    e = audit.compression * 1e3
    curves.plot(e, audit.loading, color=LOADING, label="loading")
    curves.plot(e, audit.unloading, color=UNLOADING, label="unloading")
    for axes in (curves, band):
        if audit.window is not None:
            low, high = (x * 1e3 for x in audit.window)
            axes.axvspan(low, high, color="#e6f2e6", zorder=0, label="valid window")
    curves.axhline(0.0, color="#888888", lw=0.8)
    curves.legend(frameon=False)
    style_axes(curves, "compression [mm]", "force [N]", f"{audit.name} ({audit.law})")

    faulty = [f.high for f in audit.findings if f.kind in ("crossing", "adhesion", "softening")]
    reach = min(2.5 * max(faulty), e[-1] * 1e-3) if faulty else 0.25 * e[-1] * 1e-3
    near = audit.compression <= reach
    band.plot(e[near], 1e3 * audit.loading[near], color=LOADING, label="loading")
    band.plot(e[near], 1e3 * audit.unloading[near], color=UNLOADING, label="unloading")
    wrong = near & (audit.unloading > audit.loading)
    if np.any(wrong):
        band.fill_between(
            e, 1e3 * audit.loading, 1e3 * audit.unloading, where=wrong, color=FRICTION, alpha=0.6,
            label="unloading above loading",
        )  # fmt: skip
    band.axhline(0.0, color="#888888", lw=0.8)
    band.set_xlim(0.0, reach * 1e3)
    shown = np.concatenate([audit.loading[near], audit.unloading[near]]) * 1e3
    margin = 0.05 * float(np.ptp(shown))
    band.set_ylim(float(shown.min()) - margin, float(shown.max()) + margin)
    band.legend(frameon=False)
    style_axes(band, "compression [mm]", "force [mN]", "The same near zero")

    amplitudes = sorted({c.amplitude for c in audit.cycles})
    for i, amplitude in enumerate(amplitudes):
        row = [c for c in audit.cycles if c.amplitude == amplitude]
        loss.semilogx(
            [c.frequency for c in row],
            [100 * c.loss for c in row],
            "o-",
            color=GRAYS[i * (len(GRAYS) - 1) // max(len(amplitudes) - 1, 1)],
            label=f"to {amplitude * 1e3:.3g} mm",
        )
    loss.axhline(0.0, color="#888888", lw=0.8)
    loss.legend(frameon=False)
    style_axes(loss, "frequency [Hz]", "loss of the second cycle [%]", "Loss of sinusoidal cycles")

    stiffness.plot(e, audit.loading_stiffness * 1e-3, color=LOADING, label="loading")
    stiffness.plot(e, audit.unloading_stiffness * 1e-3, color=UNLOADING, label="unloading")
    stiffness.axhline(0.0, color="#888888", lw=0.8)
    stiffness.legend(frameon=False)
    style_axes(stiffness, "compression [mm]", "dF/de [N/mm]", "Tangent stiffness")
    return figure
