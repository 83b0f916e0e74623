"""Records beside the model before and after a diagnosis, as viewers for the page of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from feltmb.data import Array, Record
    from feltmb.gap import GapBefore, Report
    from feltmb.gap.findings import ModelWithEffects
    from feltmb.graphics.viewer import Curves

__all__ = ["overlay_page", "record_viewers"]

#: More records than these are not drawn; the others are in the files.
MOST_RECORDS = 8


def record_viewers(report: Report, records: Sequence[Record]) -> str:
    """HTML of one viewer a record: measured, the model as tabulated, calibrated, with effects.

    Each is an open-loop simulation over all of the record that was used. A record that a model
    cannot follow to its end is left out.
    """
    from feltmb.errors import FeltmbError
    from feltmb.graphics.viewer import Curves, assets, fragment

    model = report.fit.problem.model
    parts = []
    for record in model.ready(records[:MOST_RECORDS]).records:
        units = {name: record.sensors[name].unit for name in record.outputs}
        shown = [Curves("measured", record.time, record.outputs, units)]
        try:
            shown.append(_curves("model as tabulated", report.tabulated, record, units))
            shown.append(_curves("model, calibrated", report.fitted, record, units))
            if report.model.included:
                shown.append(_curves("model with effects", report.model, record, units))
            panels = [{"title": n, "outputs": [n], "change": False} for n in record.outputs]
            viewer = fragment(shown, panels=panels)
        except (FeltmbError, FloatingPointError, ArithmeticError):
            continue
        parts.append(f"<h3>{_escaped(record.name)}</h3>\n{viewer}")
    return assets() + "".join(parts) if parts else ""


def overlay_page(found: GapBefore) -> str:
    """HTML page with one viewer a record: measured, and the model with nothing fitted."""
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
    values = {n: outputs[n] for n in record.outputs}
    if not all(np.all(np.isfinite(v)) for v in values.values()):
        raise DataError(f"{name}: left the numbers on record {record.name}")
    return Curves(name, record.time, values, units)


def _escaped(text: str) -> str:
    from html import escape

    return escape(text)
