"""Tables of studies, and one self-contained HTML page."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from feltmb.run.study.model import Case
from feltmb.run.study.outcomes import FindingResult, StudyOutcomes
from feltmb.run.study.plot import png
from feltmb.style import DPI

__all__ = ["Cell", "Table", "by_claim", "finding_sizes", "outcome_text", "page", "tables"]

OUTCOMES = ("agrees", "depends", "disagrees", "not tested")


@dataclass(frozen=True)
class Cell:
    """A cell of a table: text, whether it is a number, and the published value."""

    text: str
    num: bool = False
    printed: str = ""


@dataclass(frozen=True)
class Table:
    """A table for people."""

    title: str
    head: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...], ...]


def number_text(value: float | None, factor: float = 1.0, digits: int = 4) -> str:
    """Format a number: few digits, counts in full, a dash for a missing value."""
    if value is None or not math.isfinite(value):
        return "-"
    shown = value * factor
    if abs(shown) < 1e-11:
        return "0"
    if abs(shown) >= 1000 and shown == int(shown) and abs(shown) < 1e9:
        return f"{int(shown)}"
    return f"{shown:.{digits}g}"


def _case_number(result: StudyOutcomes, case: Case, name: str) -> float | None:
    return result.outcomes[case].numbers.get(name)


def _unit_text(label: str, unit: str) -> str:
    return f"{label} [{unit}]" if unit else label


def tables(result: StudyOutcomes) -> list[Table]:
    """Tables of a study.

    Without a sweep, one table for each stroke, with values in rows and variants in columns. With a
    sweep, one table for each variant and stroke, with points in rows and values in columns.
    """
    return _sweep_tables(result) if result.study.axes else _variant_tables(result)


def _variant_tables(result: StudyOutcomes) -> list[Table]:
    made = result.study
    out = []
    for stroke in dict.fromkeys(case.stroke for case in result.outcomes):
        cases = [case for case in result.outcomes if case.stroke == stroke]
        head = (
            Cell(""),
            *(
                Cell(
                    made.label(c.variant)
                    + ("" if result.outcomes[c].status == "done" else " (stopped early)"),
                    True,
                )
                for c in cases
            ),
        )
        rows = []
        for name in result.numbers:
            label, unit, factor = made.shown(name)
            printed = made.number_spec(name).thesis
            values = [_case_number(result, c, name) for c in cases]
            if all(v is None for v in values) and not printed:
                continue
            rows.append(
                (
                    Cell(_unit_text(label, unit)),
                    *(
                        Cell(
                            number_text(v, factor, made.number_spec(name).digits),
                            True,
                            number_text(printed.get(f"{c.variant}.{stroke}"))
                            if f"{c.variant}.{stroke}" in printed
                            else "",
                        )
                        for c, v in zip(cases, values, strict=True)
                    ),
                )
            )
        out.append(Table(stroke, head, tuple(rows)))
    return out


def _sweep_tables(result: StudyOutcomes) -> list[Table]:
    made = result.study
    sweep = made.spec.sweep
    assert sweep is not None
    out = []
    groups = list(dict.fromkeys((c.variant, c.stroke) for c in result.outcomes))
    for variant, stroke in groups:
        cases = [c for c in result.outcomes if (c.variant, c.stroke) == (variant, stroke)]
        names = [
            n for n in result.numbers if any(_case_number(result, c, n) is not None for c in cases)
        ]
        shown = [made.shown(n) for n in names]
        units = ["" if a.unit == "1" else a.unit for a in sweep.axis]
        head = (
            *(
                Cell(_unit_text(a.label or a.name, u))
                for a, u in zip(sweep.axis, units, strict=True)
            ),
            *(Cell(_unit_text(label, unit), True) for label, unit, _ in shown),
        )
        rows = tuple(
            (
                *(Cell(number_text(v) if isinstance(v, float) else str(v)) for v in case.point),
                *(
                    Cell(
                        number_text(
                            _case_number(result, case, n), factor, made.number_spec(n).digits
                        ),
                        True,
                    )
                    for n, (_, _, factor) in zip(names, shown, strict=True)
                ),
            )
            for case in cases
        )
        title = stroke if len({g[0] for g in groups}) == 1 else f"{made.label(variant)}, {stroke}"
        out.append(Table(title, head, rows))
    return out


def finding_sizes(finding: FindingResult) -> tuple[str, str]:
    """Simulated and published size of a finding, with units."""
    unit = "" if finding.unit in ("", "1") else f" {finding.unit}"
    here = "" if finding.here is None else number_text(finding.here) + unit
    if finding.low is not None and finding.high is not None:
        here = (
            f"{number_text(finding.low, digits=3)} to {number_text(finding.high, digits=3)}{unit}"
        )
    there = "" if finding.thesis is None else number_text(finding.thesis) + unit
    return here, there


def outcome_text(finding: FindingResult) -> str:
    """Outcome as text; over an axis, with the number of values at which the finding holds."""
    return finding.outcome + (f", {finding.held} of {finding.of}" if finding.of else "")


def by_claim(findings: Sequence[FindingResult], cite: str) -> dict[str, list[FindingResult]]:
    """Findings by origin: statements of the cited source, and of the study."""
    groups = {
        f"claims of: {cite}": [f for f in findings if f.claim == "thesis"],
        "own findings": [f for f in findings if f.claim == "own"],
    }
    return {title: group for title, group in groups.items() if group}


def _counts(findings: Sequence[FindingResult]) -> dict[str, dict[str, int]]:
    """Number of findings by origin and outcome."""
    out = {}
    for claim in ("thesis", "own"):
        group = [f for f in findings if f.claim == claim]
        out[claim] = {
            **{word: sum(f.outcome == word for f in group) for word in OUTCOMES},
            "total": len(group),
        }
    return out


def _figures(result: StudyOutcomes) -> list[dict[str, Any]]:
    out = []
    for name, spec in result.study.spec.figures.items():
        figure = result.figures[name]
        out.append(
            {
                "data": base64.b64encode(png(result, name)).decode("ascii"),
                # Shown with 96 pixels per inch: sharp on screens with up to 1.5 times that.
                "width": round(figure.get_figwidth() * 96),
                "alt": f"{spec.title}. {spec.caption}".strip(),
                "figure": spec.figure,
                "caption": spec.caption,
                "dpi": DPI,
            }
        )
    return out


def page(results: Sequence[StudyOutcomes], *, title: str = "") -> str:
    """One HTML page of studies: index, figures, tables, findings; it loads nothing from elsewhere.

    Parameters
    ----------
    results
        Studies in the order of the page.
    title
        Heading; default: the title of the study, or "Studies".
    """
    import jinja2

    from feltmb._core import __version__

    text = (resources.files("feltmb.run.study") / "page.html").read_text(encoding="utf-8")
    template = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    ).from_string(text)
    sections = []
    for i, result in enumerate(results):
        spec = result.study.spec
        sections.append(
            {
                "id": f"study-{i + 1}-{spec.name}",
                "title": spec.title,
                "about": spec.about,
                "source": spec.thesis,
                "runs": len(result.outcomes),
                "figures": _figures(result),
                "tables": [
                    {
                        "head": (
                            Cell(": ".join(t for t in (table.title, table.head[0].text) if t)),
                            *table.head[1:],
                        ),
                        "rows": table.rows,
                    }
                    for table in tables(result)
                ],
                "notes": [
                    f"{result.study.label(name)}: {v.note}"
                    for name, v in spec.variants.items()
                    if v.note
                ],
                "failed": result.failed,
                "warnings": result.warnings,
                "counts": _counts(result.findings),
                "findings": {
                    title: [
                        {
                            "says": f.says,
                            "source": f.source,
                            "note": f.note,
                            "reason": f.reason,
                            "here": finding_sizes(f)[0],
                            "there": finding_sizes(f)[1],
                            "outcome": outcome_text(f),
                            "mark": f.outcome.replace(" ", "-"),
                        }
                        for f in group
                    ]
                    for title, group in by_claim(result.findings, spec.thesis.cite).items()
                },
            }
        )
    actions: dict[str, str] = {}
    for result in results:
        first = next(iter(result.study.actions.values()))
        actions.setdefault(f"{first.name} ({result.study.name})", first.hash[:12])
    rendered: str = template.render(
        title=title or (results[0].study.spec.title if len(results) == 1 else "Studies"),
        studies=sections,
        runs=sum(len(r.outcomes) for r in results),
        failures=sum(len(r.failed) for r in results),
        counts=_counts([f for r in results for f in r.findings]),
        version=__version__,
        actions=actions,
        names=" ".join(r.study.name for r in results),
    )
    return rendered
