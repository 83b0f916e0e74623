"""Viewers of records and models before and after a diagnosis, for the page of the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from feltmb.data import Array, Record
    from feltmb.gap import GapBefore, Report
    from feltmb.gap.findings import ModelWithEffects
    from feltmb.graphics.viewer import Curves
    from feltmb.mechanism import Action

__all__ = [
    "overlay_page",
    "picture_html",
    "record_viewers",
    "remaining_by_part",
    "remaining_picture",
]

#: Largest number of records that are shown; the others are only in the files.
MOST_RECORDS = 8


def record_viewers(
    report: Report, records: Sequence[Record], stop: Callable[[], bool] = lambda: False
) -> str:
    """HTML with one viewer per record: measured, tabulated, calibrated, and with effects.

    Each model is simulated in open loop over the complete part of the record that was used. Records
    that a model cannot simulate to the end are omitted. When ``stop`` returns True, so are all that
    are not finished.
    """
    from feltmb.errors import FeltmbError
    from feltmb.graphics.viewer import Curves, assets, fragment

    if stop():
        return ""
    model = report.fit.problem.model
    versions = [("model as tabulated", report.tabulated), ("model, calibrated", report.fitted)]
    if report.model.included:
        versions.append(("model with effects", report.model))
    parts = []
    driven, _ = model.driven(records)
    for record in model.ready(driven[:MOST_RECORDS]).records:
        units = {name: record.sensors[name].unit for name in record.outputs}
        shown = [Curves("measured", record.time, record.outputs, units)]
        try:
            for name, version in versions:
                if stop():
                    break
                shown.append(_curves(name, version, record, units))
            panels = [{"title": n, "outputs": [n], "change": False} for n in record.outputs]
            viewer = fragment(shown, panels=panels)
        except (FeltmbError, FloatingPointError, ArithmeticError):
            continue
        if stop():
            break
        parts.append(f"<h3>{_escaped(record.name)}</h3>\n{viewer}")
    return assets() + "".join(parts) if parts else ""


def remaining_by_part(report: Report) -> dict[str, float]:
    """Share of the squared gap that remains on held-out data, by body with the points [1].

    Empty if only noise remains, and for models that are not mechanisms.
    """
    action = getattr(report.fit.problem.model.core, "action", None)
    if action is None:
        return {}
    left: dict[str, float] = {}
    more_than_noise = {c.channel for c in report.remaining_cells}
    for row in report.how_far.rows:
        if row.channel not in more_than_noise:
            continue
        point = action.config.points.get(row.channel.rpartition(".")[0])
        beyond = (row.after / row.noise) ** 2 - 1.0 if row.noise > 0.0 else 0.0
        if row.metric == report.how_far.metric and point is not None and beyond > 0.0:
            left[point.body] = left.get(point.body, 0.0) + beyond
    total = sum(left.values())
    return {body: v / total for body, v in sorted(left.items(), key=lambda x: -x[1])}


def remaining_picture(report: Report) -> Figure | None:
    """Drawing of the mechanism with parts colored by their share of the remaining gap."""
    from feltmb.graphics.plot import mechanism

    shares = remaining_by_part(report)
    if not shares:
        return None
    action: Action = report.fit.problem.model.core.action
    labels = {b: action.config.bodies[b].label or b for b in shares if b in action.config.bodies}
    told = ", ".join(f"{labels.get(b, b)} {100.0 * s:.0f} %" for b, s in shares.items())
    return mechanism(action, title=f"remaining gap: {told}", shares=shares)


def picture_html(figure: Figure) -> str:
    """A figure as HTML for a page that loads nothing."""
    import base64
    import io

    made = io.BytesIO()
    figure.savefig(made, format="png", dpi=110)
    data = base64.b64encode(made.getvalue()).decode()
    return (
        "<h3>Parts by their share of the remaining gap</h3>\n"
        f'<img alt="mechanism, parts colored" style="max-width:100%" '
        f'src="data:image/png;base64,{data}">'
    )


def overlay_page(found: GapBefore) -> str:
    """HTML page with one viewer per record: measured, and the model before any fit."""
    from feltmb.graphics.viewer import Curves, assets, fragment

    parts = []
    for record in found.records[:MOST_RECORDS]:
        model = found.simulated[record.name]
        names = [n for n in record.outputs if n in model and np.isfinite(model[n]).any()]
        if not names:
            continue
        units = {n: record.sensors[n].unit for n in names}
        measured = {n: record.outputs[n] for n in names}
        shown = [
            Curves("measured", record.time, measured, units),
            Curves("model, nothing fitted", record.time, {n: model[n] for n in names}, units),
        ]
        panels = [{"title": n, "outputs": [n], "change": False} for n in names]
        parts.append(f"<h2>{_escaped(record.name)}</h2>\n{fragment(shown, panels=panels)}")
    more = len(found.records) - MOST_RECORDS
    if more > 0:
        parts.append(f"<p>{more} more records are not drawn.</p>")
    title = f"{_escaped(found.model)}: the gap before anything is fitted"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"<title>{title}</title>\n"
        f"{assets()}</head>\n<body>\n<h1>{title}</h1>\n{''.join(parts)}\n</body>\n</html>\n"
    )


def _curves(name: str, model: ModelWithEffects, record: Record, units: dict[str, str]) -> Curves:
    from feltmb.errors import DataError
    from feltmb.graphics.viewer import Curves

    outputs: dict[str, Array] = model.simulate(record)
    values = {n: outputs[n] for n in record.outputs if n in outputs}
    if not all(np.all(np.isfinite(v)) for v in values.values()):
        raise DataError(f"{name}: left the numbers on record {record.name}")
    return Curves(name, record.time, values, units)


def _escaped(text: str) -> str:
    from html import escape

    return escape(text)
