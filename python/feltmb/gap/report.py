"""Report of a diagnosis and its files, JSON and HTML; equal input gives equal bytes."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb._core import __version__
from feltmb.arguments import checked
from feltmb.display import html_table
from feltmb.errors import InvalidParameter
from feltmb.files import make_folder, write_text
from feltmb.fit.solve import NOT_CONVERGED
from feltmb.gap.findings import Findings
from feltmb.gap.page import page, percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Report", "plain", "report_json", "write_report"]


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Report(Findings):
    """Result of :func:`feltmb.gap.diagnose`."""

    def __repr__(self) -> str:
        names = ", ".join(self.named or self.one_of) or "nothing"
        far = self.how_far
        gap = (
            "no gap above noise" if far.no_gap else f"closes {far.closed_text} of the held-out gap"
        )
        return (
            f"Report({self.verdict.value}: {names}; {gap}, confidence {percent(self.confidence)})"
        )

    def _repr_html_(self) -> str:
        rows = [
            (
                r.effect,
                r.magnitude,
                *((r.low, r.high) if r.converged else (NOT_CONVERGED, "")),
                r.unit,
                f"{r.posterior:.0%}",
            )
            for r in self.which.effects
            if r.refitted
        ]
        head = ("effect", "magnitude", "95 % from", "to", "unit", "probability")
        return html_table(f"{self.verdict.value}: {self.statement}", head, rows)

    @checked
    def text(self, width: int = 80) -> str:
        """Everything that ``feltmb gap diagnose`` prints; ``print(report)`` prints it too.

        Parameters
        ----------
        width
            Largest number of characters of a line, >= 40.
        """
        from feltmb.gap.text import report_text

        if width < 40:
            raise InvalidParameter(f"width = {width}, expected at least 40 characters")
        return report_text(self, width)

    def __str__(self) -> str:
        return self.text()

    def plot(self) -> Figure:
        """Draw the held-out gap of each channel: as tabulated, calibrated, and with the effects.

        Returns
        -------
        Figure
            Figure of matplotlib. The gaps are in units of the noise of the channel.
        """
        from feltmb.gap.picture import held_out_gaps

        return held_out_gaps(self)

    @checked
    def write(self, folder: str | Path, *, force: bool = False) -> tuple[Path, Path]:
        """Write report.html and report.json to a folder."""
        return write_report(self, Path(folder), force=force)


#: Fields that are null where nothing is large enough to show.
NEVER = ("smallest", "smallest_before")


def plain(value: Any) -> Any:
    """Value as JSON types: numbers to 9 digits, infinities as texts, but null in ``NEVER``."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        out = {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {k: None if k in NEVER and v == "inf" else v for k, v in out.items()}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        number = float(value)
        if math.isnan(number):
            return None
        if math.isinf(number):
            return "inf" if number > 0 else "-inf"
        return float(f"{number:.9g}")
    return None if value is None else str(value)


def report_json(report: Findings) -> dict[str, Any]:
    """Report as one JSON object in the order of the page; computation times are omitted."""
    fit = report.fit
    return {
        "feltmb": __version__,
        "model": report.model.original.name,
        "verdict": report.verdict.value,
        "stopped": report.stopped,
        "statement": report.statement,
        "confidence": plain(report.confidence),
        "as_it_is": plain(report.as_it_is),
        "calibrated": plain(report.calibrated),
        "given": plain(report.given),
        "named": list(report.named),
        "one_of": list(report.one_of),
        "closest": plain(report.closest),
        "which": plain(report.which),
        "profiles": plain(report.profiles),
        "how_far": plain(report.how_far),
        "where": plain(report.where),
        "next": plain(report.next),
        "not_tested": plain(report.not_tested),
        "refused": plain(report.refused),
        "with_effects": {
            "parameters": plain(report.model.parameters),
            "effects": plain(report.model.effects),
            "shapes": {t.name: plain(t.shape) for t in report.model.included},
        },
        "fit": {
            "intervals": plain(fit.intervals()),
            "chi2": plain(fit.chi2),
            "dof": plain(fit.dof),
            "level": plain(fit.level),
            "converged": fit.converged,
            "notes": list(fit.notes),
        },
        "data checks": plain(report.checks),
    }


def write_report(
    report: Findings, folder: Path, *, force: bool = False, viewers: str = ""
) -> tuple[Path, Path]:
    """Write report.html and report.json to a folder.

    ``viewers`` is HTML that shows the records beside the model, see :func:`feltmb.gap.page.page`.
    """
    make_folder(folder)
    text = json.dumps(report_json(report), indent=1, ensure_ascii=False)
    return (
        write_text(folder / "report.html", page(report, viewers), force=force),
        write_text(folder / "report.json", text + "\n", force=force),
    )
