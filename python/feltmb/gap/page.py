"""The report as one self-contained HTML page."""

from __future__ import annotations

import math
from importlib import resources
from typing import Any

from feltmb._core import __version__
from feltmb.gap.digits import digits
from feltmb.gap.drawing import bars, force_traces, ledger_map, profile_curve, waterfall
from feltmb.gap.findings import EXPLAINED, Findings, Verdict
from feltmb.gap.spread import together

__all__ = ["page", "percent"]

MARK = {
    Verdict.NO_GAP: "good",
    Verdict.CALIBRATED: "named",
    Verdict.NAMED: "named",
    Verdict.ONE_OF: "some",
    Verdict.NAMED_RESIDUAL: "some",
    Verdict.UNKNOWN: "bad",
    Verdict.TOO_WEAK: "none",
    Verdict.DATA_PROBLEM: "bad",
    Verdict.NOT_COMPLETE: "none",
}


def number(value: object, digits: int = 4) -> str:
    """Format a number with a few digits; a dash for a missing value."""
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        return "-"
    return f"{value:.{digits}g}"


def percent(value: float) -> str:
    """Format a share as percent."""
    return f"{value:.0%}" if math.isfinite(value) else "-"


def page(report: Findings, viewers: str = "") -> str:
    """HTML text of the report; it loads nothing from elsewhere, and all text is escaped.

    ``viewers`` is HTML that shows the records beside the model, for models whose runs can be drawn.
    """
    import jinja2
    from markupsafe import Markup

    template = (resources.files("feltmb.gap") / "report.html").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = number
    environment.filters["percent"] = percent
    environment.globals["digits"] = digits
    where = report.where
    significant = [c for c in where.ledger if c.significant]
    context: dict[str, Any] = {
        "version": __version__,
        "report": report,
        "mark": MARK[report.verdict],
        "model": report.model.original.name,
        "explained": report.verdict in EXPLAINED,
        "viewers": Markup(viewers),
        "map": Markup(ledger_map(where.ledger, dict(where.onset))),
        "remains": Markup(ledger_map(where.remains, {}, "map of what remains")),
        "cells": len(where.ledger),
        "significant": len(significant),
        "events": sorted(
            (e for e in where.events if e.significant),
            key=lambda e: (-abs(e.delay) / e.delay_se, e.record, e.time),
        )[:12],
        "components": where.components,
        "traces": [(c, Markup(force_traces(c))) for c in where.components if c.trace],
        "bars": Markup(bars(report.which.effects, report.one_of, [n.name for n in report.refused])),
        "profiles": [(p.text, Markup(profile_curve(p))) for p in report.profiles],
        "waterfall": Markup(waterfall(report.how_far)),
        "refused": [n.name for n in report.refused],
        "intervals": report.fit.intervals(),
        "together": together(report.fit),
        "sources": sorted({s for s in _sources(report) if s}),
    }
    return environment.from_string(template).render(**context)


def _sources(report: Findings) -> list[str]:
    return [segmented.record.source for segmented in report.fit.problem.segmented_records]
