"""Pictures of the report as SVG text: a map of where, bars of which, a waterfall of how far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from feltmb.gap.digits import digits
from feltmb.gap.findings import ComponentRow, HowFar, LedgerCell, Ranked

__all__ = ["bars", "force_traces", "ledger_map", "waterfall"]

INK, SOFT, LINE = "#222", "#666", "#ddd"
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#00694e", "#999"


def _text(x: float, y: float, text: str, *, anchor: str = "start", color: str = INK) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{color}">{escape(text)}</text>'
    )


def _svg(width: float, height: float, label: str, parts: Sequence[str]) -> str:
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(label)}" '
        f'style="max-width:{width:.0f}px" font-size="12">' + "".join(parts) + "</svg>"
    )


def _shade(z: float) -> str:
    """White to dark orange on a logarithmic scale of the excess."""
    share = min(1.0, max(0.0, math.log10(1.0 + max(z, 0.0)) / 3.0))
    r = round(255 - share * (255 - 150))
    g = round(255 - share * (255 - 48))
    b = round(255 - share * 255)
    return f"#{r:02x}{g:02x}{b:02x}"


def ledger_map(cells: Sequence[LedgerCell], onset: dict[str, float]) -> str:
    """Channel of every record against time; color is the excess, framed where significant."""
    rows = list(dict.fromkeys((c.record, c.channel) for c in cells))
    if not rows:
        return ""
    left, width = 230.0, 860.0
    parts = []
    y = 4.0
    for i, (record, channel) in enumerate(rows):
        own = [c for c in cells if (c.record, c.channel) == (record, channel)]
        start, end = min(c.start for c in own), max(c.end for c in own)
        scale = (width - left - 10) / max(end - start, 1e-12)
        parts.append(_text(0, y + 14, f"{record}: {channel}"[:36]))
        for c in own:
            x, w = left + (c.start - start) * scale, max((c.end - c.start) * scale, 1.0)
            tip = (
                f"{c.start:.4g} to {c.end:.4g} s: rms {c.rms:.3g}, noise {c.sigma:.3g}, "
                f"excess {c.z:.1f} sd{', significant' if c.significant else ''}"
            )
            frame = ORANGE if c.significant else LINE
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="18" fill="{_shade(c.z)}" '
                f'stroke="{frame}" stroke-width="0.7"><title>{escape(tip)}</title></rect>'
            )
        if record in onset:
            x = left + (onset[record] - start) * scale
            parts.append(
                f'<path d="M{x:.1f} {y - 3:.1f} v24" stroke="{BLUE}" stroke-width="2">'
                f"<title>onset {onset[record]:.4g} s</title></path>"
            )
        y += 24.0
        if i == len(rows) - 1 or rows[i + 1][0] != record:
            parts.append(_text(left, y + 8, f"{start:.4g} s", color=SOFT))
            parts.append(_text(width - 10, y + 8, f"{end:.4g} s", anchor="end", color=SOFT))
            y += 20.0
    return _svg(width, y + 4, "map of the gap in time", parts)


def bars(
    effects: Sequence[Ranked], one_of: Sequence[str], refused: Sequence[str], most: int = 10
) -> str:
    """Belief in each effect, with its magnitude beside it."""
    shown = list(effects[:most])
    if not shown:
        return ""
    left, width, step = 250.0, 860.0, 24.0
    parts = []
    for i, r in enumerate(shown):
        y = i * step + 4
        color = BLUE if r.named else (ORANGE if r.effect in one_of else GREY)
        note = "refused; " if r.effect in refused else ""
        if note:
            color = LINE
        w = max(r.posterior * 200.0, 1.0)
        parts.append(_text(left - 8, y + 13, r.effect[:38], anchor="end"))
        parts.append(
            f'<rect x="{left}" y="{y:.1f}" width="{w:.1f}" height="17" fill="{color}">'
            f"<title>{escape(r.mechanism or r.effect)}</title></rect>"
        )
        unit = "" if r.unit == "1" else f" {r.unit}"
        value = f"{r.magnitude:.{digits(r.magnitude, r.sd, 4)}g}"
        parts.append(
            _text(
                left + w + 8,
                y + 13,
                f"{note}{r.posterior:.0%}; {value} ± {1.96 * r.sd:.2g}{unit}",
                color=SOFT,
            )
        )
    return _svg(width, len(shown) * step + 8, "belief in each effect", parts)


def waterfall(how_far: HowFar) -> str:
    """From the gap as it is to the noise: calibration, each effect, what is left."""
    steps = how_far.waterfall
    top = steps[0][1]
    if not top > 0.0 or not math.isfinite(top):
        return ""
    left, width, step = 250.0, 860.0, 26.0
    levels = np.cumsum([v for n, v in steps if n not in ("unexplained", "noise")])
    scale = 480.0 / max(top, how_far.after, float(np.max(levels)))
    parts = []
    level = 0.0
    for i, (name, value) in enumerate(steps):
        y = i * step + 4
        if name == "as tabulated":
            x, w, color, level = 0.0, value, GREY, value
        elif name in ("unexplained", "noise"):
            x = 0.0 if name == "noise" else steps[-1][1]
            w, color = value, ORANGE if name == "unexplained" else GREEN
        else:
            x, w, color = min(level, level + value), abs(value), BLUE
            level += value
        parts.append(_text(left - 8, y + 14, name[:38], anchor="end"))
        parts.append(
            f'<rect x="{left + x * scale:.1f}" y="{y:.1f}" width="{max(w * scale, 1.0):.1f}" '
            f'height="18" fill="{color}"/>'
        )
        parts.append(_text(left + (x + w) * scale + 8, y + 14, f"{value:+.4g}", color=SOFT))
    return _svg(width, len(steps) * step + 8, "waterfall of the held-out gap", parts)


def force_traces(row: ComponentRow) -> str:
    """Unknown force of one component over time with its band, one line a record."""
    if not row.trace:
        return ""
    width, height, left = 860.0, 90.0, 70.0
    parts = []
    for i, (record, series) in enumerate(list(row.trace.items())[:3]):
        time, force, sd = series["time"], series["force"], series["sd"]
        low = min(f - 2.0 * s for f, s in zip(force, sd, strict=True))
        high = max(f + 2.0 * s for f, s in zip(force, sd, strict=True))
        span = max(high - low, 1e-300)
        y0 = i * (height + 16)
        sx = (width - left - 10) / max(time[-1] - time[0], 1e-12)

        def at(
            t: float,
            f: float,
            y0: float = y0,
            low: float = low,
            span: float = span,
            t0: float = time[0],
            sx: float = sx,
        ) -> str:
            return f"{left + (t - t0) * sx:.1f},{y0 + height - (f - low) / span * height:.1f}"

        upper = " ".join(at(t, f + 2 * s) for t, f, s in zip(time, force, sd, strict=True))
        lower = " ".join(
            at(t, f - 2 * s) for t, f, s in reversed(list(zip(time, force, sd, strict=True)))
        )
        line = " ".join(at(t, f) for t, f in zip(time, force, strict=True))
        parts.append(f'<polygon points="{upper} {lower}" fill="{BLUE}" fill-opacity="0.18"/>')
        parts.append(f'<polyline points="{line}" fill="none" stroke="{BLUE}"/>')
        parts.append(_text(left - 6, y0 + 11, f"{high:.3g}", anchor="end", color=SOFT))
        parts.append(_text(left - 6, y0 + height, f"{low:.3g}", anchor="end", color=SOFT))
        parts.append(_text(left + 4, y0 + 11, f"{record} [{row.unit}]", color=SOFT))
    count = min(len(row.trace), 3)
    return _svg(width, count * (height + 16), f"unknown force at {row.port}", parts)
