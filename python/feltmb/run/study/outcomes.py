"""Results of the runs of a study: values, table, findings."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from feltmb.arguments import checked
from feltmb.display import html_table
from feltmb.errors import InvalidParameter
from feltmb.run.arrays import table_to_dataset
from feltmb.run.study.checks import short
from feltmb.run.study.expression import Formula, NotThere, si_unit, to_unit
from feltmb.run.study.model import Case, Study, same, series_key
from feltmb.run.study.schema import KNOWN, FindingSpec, PanelSpec
from feltmb.run.sweep import Outcome

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FindingResult:
    """A finding compared with the runs.

    Attributes
    ----------
    says, source, note
        Texts of the file.
    claim
        ``thesis``: a statement of the source that the study cites; ``own``: a statement of the
        study.
    outcome
        ``agrees``, ``disagrees`` or ``not tested``; ``depends``: for a finding over an axis of the
        sweep, it holds at some values and not at others.
    reason
        Reason why it was not tested, for all or some of the values.
    here, thesis
        Sizes in ``unit``; None if not defined. Over an axis, ``here`` is None.
    low, high
        Smallest and largest size over an axis, in ``unit``; None if not defined.
    held, of
        Number of values of the axis at which it holds, and number of values; None without an axis.
    """

    says: str
    source: str
    outcome: Literal["agrees", "depends", "disagrees", "not tested"]
    here: float | None = None
    thesis: float | None = None
    unit: str = ""
    reason: str = ""
    note: str = ""
    claim: Literal["thesis", "own"] = "own"
    low: float | None = None
    high: float | None = None
    held: int | None = None
    of: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {k: getattr(self, k) for k in self.__dataclass_fields__}


@dataclass(frozen=True, eq=False)
class StudyOutcomes(ABC):
    """Results of a study.

    Attributes
    ----------
    study : Study
        The study.
    outcomes : dict
        Outcome by :class:`Case`.
    """

    study: Study
    outcomes: Mapping[Case, Outcome]

    def __repr__(self) -> str:
        counts = ", ".join(
            f"{sum(f.outcome == word for f in self.findings)} {word}"
            for word in ("agrees", "depends", "disagrees", "not tested")
        )
        kind = type(self).__name__
        return f"{kind}({self.study.name!r}, {len(self.outcomes)} runs; findings: {counts})"

    @property
    @abstractmethod
    def figures(self) -> dict[str, Figure]:
        """Figures by name, as matplotlib ``Figure``."""

    def _repr_html_(self) -> str:
        rows = [(f.outcome, f.claim, f.says) for f in self.findings]
        return html_table(repr(self), ("outcome", "claim of", "finding"), rows)

    @checked
    def plot(self, name: str | None = None) -> Figure:
        """Plot a figure of the study.

        Parameters
        ----------
        name
            Name of the figure in the study; default: the first.
        """
        known = list(self.study.spec.figures)
        if name is None and known:
            name = known[0]
        if name not in known:
            raise InvalidParameter(
                f"plot: study {self.study.name!r} has no figure {name!r}, expected one of: "
                + ", ".join(known)
            )
        return self.figures[name]

    def to_xarray(self) -> xr.Dataset:
        """Table as a dataset over variant, stroke and axes; the variables have SI units.

        Returns
        -------
        Dataset
            Dataset; its only dimension is ``member`` if some combinations were not simulated.
        """
        units = {n: si_unit(self.study.shown(n)[1]) for n in self.numbers}
        axes = ["variant", "stroke", *(a.name for a in self.study.axes)]
        return table_to_dataset(self.table, axes, units)

    @cached_property
    def numbers(self) -> list[str]:
        """Names of the values in the table: those of the file, else those of any run."""
        if self.study.spec.numbers:
            return list(self.study.spec.numbers)
        found = {n for o in self.outcomes.values() for n in o.numbers}
        return [n for n in KNOWN if n in found]

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row per simulation: variant, stroke, axes, status, error, values in SI units."""
        import pandas as pd

        rows = []
        for case, outcome in self.outcomes.items():
            row: dict[str, Any] = {"variant": case.variant, "stroke": case.stroke}
            row.update(zip([a.name for a in self.study.axes], case.point, strict=True))
            row.update(status=outcome.status, error=outcome.error)
            row.update({n: outcome.numbers.get(n, math.nan) for n in self.numbers})
            rows.append(row)
        return pd.DataFrame(rows)

    @checked
    def number(self, name: str, variant: str, stroke: str, *point: Any) -> float | None:
        """A value in SI units; None if the run does not have it."""
        outcome = self.outcomes.get(self._case(variant, stroke, point))
        return None if outcome is None else outcome.numbers.get(name)

    @checked
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
        """Findings of the file with their results."""
        return [self._judge(finding) for finding in self.study.spec.findings]

    def _judge(self, finding: FindingSpec) -> FindingResult:
        common: dict[str, Any] = {
            "says": finding.says,
            "source": finding.source,
            "thesis": finding.thesis,
            "unit": finding.unit,
            "note": finding.note,
            "claim": finding.claim,
        }
        if finding.over is None:
            holds, here, reason = self._judge_at(finding, {})
            return FindingResult(**common, outcome=_outcome(holds), here=here, reason=reason)
        values = next(a.values for a in self.study.axes if a.name == finding.over)
        judged = [self._judge_at(finding, {finding.over: value}) for value in values]
        decided = [holds for holds, _, _ in judged if holds is not None]
        sizes = [here for _, here, _ in judged if here is not None and math.isfinite(here)]
        held = sum(decided)
        missing = [reason for holds, _, reason in judged if holds is None]
        return FindingResult(
            **common,
            outcome=_outcome(
                None
                if not decided
                else held == len(decided)
                if held in (0, len(decided))
                else "some"
            ),
            low=min(sizes, default=None),
            high=max(sizes, default=None),
            held=held,
            of=len(decided),
            reason=f"not tested at {len(missing)} of {len(judged)}: {missing[0]}"
            if missing
            else "",
        )

    def _judge_at(
        self, finding: FindingSpec, place: Mapping[str, Any]
    ) -> tuple[bool | None, float | None, str]:
        """Whether a finding holds, its size, or why neither; ``place``: value by axis name."""
        reasons: list[str] = []

        def lookup(name: str, arguments: tuple[Any, ...] | None) -> float:
            variant, stroke, point = self._arguments(arguments or (), place)
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
            return None, None, reasons[-1]
        if finding.thesis is not None and finding.within is not None and here is not None:
            near = abs(here - finding.thesis) <= finding.within * abs(finding.thesis)
            holds = near if holds is None else holds and near
        return holds, here, "" if holds is not None else "no number decides it"

    def _arguments(
        self, arguments: tuple[Any, ...], place: Mapping[str, Any]
    ) -> tuple[str, str, tuple[Any, ...]]:
        """Variant, stroke and point of a call; if there is only one, it may be omitted."""
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
                point.append(place.get(word, word) if isinstance(word, str) else word)
        return variant, stroke or self.study.strokes_of(variant)[0], tuple(point)

    @property
    def failed(self) -> dict[str, str]:
        """Error messages by simulation."""
        return {
            _said(case): outcome.error
            for case, outcome in self.outcomes.items()
            if outcome.status != "done"
        }

    @property
    def warnings(self) -> dict[str, str]:
        """Warnings by simulation (:attr:`Run.warnings`)."""
        return {
            _said(case): "; ".join(outcome.warnings)
            for case, outcome in self.outcomes.items()
            if outcome.warnings
        }

    def as_dict(self) -> dict[str, Any]:
        """Plain data: table (values in SI units), units, findings, errors."""
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
            "warnings": self.warnings,
        }


def _said(case: Case) -> str:
    """Name of a simulation for people."""
    return " ".join([case.variant, *map(short, case.point), case.stroke])


def _outcome(
    holds: bool | Literal["some"] | None,
) -> Literal["agrees", "depends", "disagrees", "not tested"]:
    """Outcome of a finding as a word; ``"some"``: it holds at some of several values."""
    if holds is None:
        return "not tested"
    if holds == "some":
        return "depends"
    return "agrees" if holds else "disagrees"
