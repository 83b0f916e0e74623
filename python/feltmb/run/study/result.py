"""What a study gave: table, findings, figures, files."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from feltmb.files import check_writable, write_file, write_text
from feltmb.run.study.checks import short
from feltmb.run.study.expression import Formula, NotThere, to_unit
from feltmb.run.study.model import Case, Study, same, series_key
from feltmb.run.study.schema import KNOWN, FindingSpec, PanelSpec
from feltmb.run.sweep import Outcome

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FindingResult:
    """A finding held against the runs.

    Attributes
    ----------
    says, source, note
        As in the file.
    outcome
        ``agrees``, ``disagrees`` or ``not tested``.
    reason
        Why it was not tested.
    here, thesis
        Sizes in ``unit``; None without.
    """

    says: str
    source: str
    outcome: Literal["agrees", "disagrees", "not tested"]
    here: float | None = None
    thesis: float | None = None
    unit: str = ""
    reason: str = ""
    note: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {k: getattr(self, k) for k in self.__dataclass_fields__}


@dataclass(frozen=True, eq=False)
class StudyResult:
    """What a study gave.

    Attributes
    ----------
    study : Study
        What was run.
    outcomes : dict
        Outcome by :class:`Case`.
    """

    study: Study
    outcomes: Mapping[Case, Outcome]
    _cache: dict[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        counts = ", ".join(
            f"{sum(f.outcome == word for f in self.findings)} {word}"
            for word in ("agrees", "disagrees", "not tested")
        )
        return f"StudyResult({self.study.name!r}, {len(self.outcomes)} runs; findings: {counts})"

    @cached_property
    def numbers(self) -> list[str]:
        """Names of the tabulated numbers: those of the file, else those that every run may have."""
        if self.study.spec.numbers:
            return list(self.study.spec.numbers)
        found = {n for o in self.outcomes.values() for n in o.numbers}
        return [n for n in KNOWN if n in found]

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a simulation: variant, stroke, axes, status, error, numbers in SI units."""
        import pandas as pd

        rows = []
        for case, outcome in self.outcomes.items():
            row: dict[str, Any] = {"variant": case.variant, "stroke": case.stroke}
            row.update(zip([a.name for a in self.study.axes], case.point, strict=True))
            row.update(status=outcome.status, error=outcome.error)
            row.update({n: outcome.numbers.get(n, math.nan) for n in self.numbers})
            rows.append(row)
        return pd.DataFrame(rows)

    def number(self, name: str, variant: str, stroke: str, *point: Any) -> float | None:
        """A number in SI units; None if the run does not have it."""
        outcome = self.outcomes.get(self._case(variant, stroke, point))
        return None if outcome is None else outcome.numbers.get(name)

    def series(self, panel: PanelSpec, case: Case) -> Array | None:
        """Times [s] and samples [SI] of a panel, shape (2, n)."""
        outcome = self.outcomes.get(case)
        return None if outcome is None else outcome.series.get(series_key(panel))

    def _case(self, variant: str, stroke: str, point: tuple[Any, ...]) -> Case:
        for case in self.outcomes:
            if (
                case.variant == variant
                and case.stroke == stroke
                and len(case.point) == len(point)
                and all(same(a, b) for a, b in zip(case.point, point, strict=True))
            ):
                return case
        return Case(variant, stroke, point)

    @cached_property
    def findings(self) -> list[FindingResult]:
        """Findings of the file and what became of them."""
        return [self._judge(finding) for finding in self.study.spec.findings]

    def _judge(self, finding: FindingSpec) -> FindingResult:
        reasons: list[str] = []

        def lookup(name: str, arguments: tuple[Any, ...] | None) -> float:
            variant, stroke, point = self._arguments(arguments or ())
            outcome = self.outcomes.get(self._case(variant, stroke, point))
            value = None
            if outcome is not None and outcome.status == "done":
                value = outcome.numbers.get(name)
            if value is None:
                where = " ".join([variant, *map(short, point), stroke])
                reasons.append(
                    f"{where} did not run"
                    if outcome is None
                    else f"{where} failed: {outcome.error}"
                    if outcome.status != "done"
                    else f"{where} has no {name}"
                )
                raise NotThere(name)
            return value

        holds: bool | None = None
        here: float | None = None
        try:
            if finding.size is not None:
                here = float(Formula(finding.size)(lookup)) * to_unit(finding.unit)
            if finding.check is not None:
                holds = bool(Formula(finding.check)(lookup))
        except NotThere:
            return FindingResult(
                finding.says,
                finding.source,
                "not tested",
                None,
                finding.thesis,
                finding.unit,
                reasons[-1],
                finding.note,
            )
        if finding.thesis is not None and finding.within is not None and here is not None:
            near = abs(here - finding.thesis) <= finding.within * abs(finding.thesis)
            holds = near if holds is None else holds and near
        return FindingResult(
            finding.says,
            finding.source,
            "not tested" if holds is None else "agrees" if holds else "disagrees",
            here,
            finding.thesis,
            finding.unit,
            "" if holds is not None else "no number decides it",
            finding.note,
        )

    def _arguments(self, arguments: tuple[Any, ...]) -> tuple[str, str, tuple[Any, ...]]:
        """Variant, stroke and point of a call; what is the only one may be left out."""
        variants = list(self.study.spec.variants)
        variant = variants[0]
        stroke = ""
        point: list[Any] = []
        for word in arguments:
            if isinstance(word, str) and word in self.study.spec.variants:
                variant = word
            elif isinstance(word, str) and word in self.study.strokes:
                stroke = word
            else:
                point.append(word)
        return variant, stroke or self.study.strokes_of(variant)[0], tuple(point)

    @property
    def figures(self) -> dict[str, Figure]:
        """Figures by name, as matplotlib ``Figure``; drawn when they are first asked for."""
        from feltmb.run.study.plot import draw

        for name in self.study.spec.figures:
            if name not in self._cache:
                self._cache[name] = draw(self, name)
        return {name: self._cache[name] for name in self.study.spec.figures}

    @property
    def failed(self) -> dict[str, str]:
        """Errors by simulation."""
        return {
            " ".join([case.variant, *map(short, case.point), case.stroke]): outcome.error
            for case, outcome in self.outcomes.items()
            if outcome.status != "done"
        }

    def as_dict(self) -> dict[str, Any]:
        """Plain data: table (numbers in SI), units, findings, errors."""
        rows = []
        for row in self.table.to_dict(orient="records"):
            rows.append(
                {
                    str(k): None if isinstance(v, float) and not math.isfinite(v) else v
                    for k, v in row.items()
                }
            )
        return {
            "study": self.study.name,
            "title": self.study.spec.title,
            "source": self.study.spec.thesis.model_dump(),
            "actions": {name: a.hash for name, a in self.study.actions.items()},
            "numbers": {
                name: {"label": self.study.shown(name)[0], "shown_in": self.study.shown(name)[1]}
                for name in self.numbers
            },
            "table": rows,
            "findings": [f.as_dict() for f in self.findings],
            "failed": self.failed,
        }

    def html(self) -> str:
        """One self-contained page."""
        from feltmb.run.study.page import page

        return page([self])

    def save(self, folder: str | Path, *, force: bool = False, page: bool = True) -> list[Path]:
        """Write NAME.html, NAME.csv (SI units), NAME.json and the figures as PNG into a folder.

        Parameters
        ----------
        page
            False: without the HTML page.
        """
        from feltmb.run.study.plot import png

        paths = [p for p in study_targets(self.study, folder) if page or p.suffix != ".html"]
        for path in paths:
            check_writable(path, force=force)
        written = []
        for path in paths:
            if path.suffix == ".html":
                text = self.html()
            elif path.suffix == ".csv":
                text = self.table.to_csv(index=False)
            elif path.suffix == ".json":
                text = json.dumps(self.as_dict(), indent=2, sort_keys=True) + "\n"
            else:
                continue
            written.append(write_text(path, text, force=force))
        for name in self.study.spec.figures:
            data, path = png(self, name), Path(folder) / f"{self.study.name}_{name}.png"
            written.append(write_file(path, partial(_write_bytes, data), force=force))
        return written


def _write_bytes(data: bytes, target: Path) -> None:
    target.write_bytes(data)


def study_targets(made: Study, folder: str | Path) -> list[Path]:
    """Files that ``StudyResult.save`` writes for a study."""
    where = Path(folder)
    return [where / f"{made.name}.{suffix}" for suffix in ("html", "csv", "json")] + [
        where / f"{made.name}_{key}.png" for key in made.spec.figures
    ]
