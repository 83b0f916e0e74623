"""A checked study: its simulations, and the values that are taken from each run."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from feltmb import params
from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.files import is_file, read_toml, why_missing
from feltmb.mechanism import Action
from feltmb.run.arrays import renamed
from feltmb.run.stroke import Stroke
from feltmb.run.study.checks import (
    make_actions,
    make_axes,
    make_strokes,
    name_faults,
    reference_faults,
    refusal,
    short,
)
from feltmb.run.study.expression import to_unit
from feltmb.run.study.extract import extract_run
from feltmb.run.study.schema import KNOWN, NumberSpec, PanelSpec, StudyFile, VariantSpec
from feltmb.run.sweep import Axis, Extract, Member, apply_point, grid_points
from feltmb.units.quantity import fault_lines, shortened


def packaged_studies() -> list[str]:
    """Names of the packaged studies, in the order of the figures of the thesis."""
    return params.names("studies")


def study_outlines() -> list[Study]:
    """Packaged studies without mechanisms and strokes, for listing only."""
    out = []
    for name in packaged_studies():
        path = params.folder("studies") / f"{name}.toml"
        spec = StudyFile.model_validate(read_toml(path))
        out.append(Study(_with_variant(spec), {}, {}, make_axes(spec, []), path.name))
    return out


def _with_variant(spec: StudyFile) -> StudyFile:
    """Add the variant "base" to a study without variants."""
    if spec.variants:
        return spec
    return spec.model_copy(update={"variants": {"base": VariantSpec(label=spec.title)}})


@checked
def load_study(name_or_path: str | Path) -> Study:
    """Read a study: the name of a packaged one, or the path of a TOML file.

    Raises
    ------
    InvalidParameter
        The file has faults; all of them are in the message.
    """
    text = str(name_or_path)
    if text in packaged_studies():
        return Study.read(params.folder("studies") / f"{text}.toml")
    path = Path(text)
    if path.suffix != ".toml" and not is_file(path):
        near = difflib.get_close_matches(text, packaged_studies(), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InvalidParameter(
            f"study {shortened(repr(text))} is unknown; "
            f"packaged are {', '.join(packaged_studies())}; or give the path of a TOML file{hint}"
        )
    if not is_file(path):
        raise InvalidParameter(f"study {shortened(repr(text))}: {why_missing(path)}")
    return Study.read(path)


@checked
@dataclass(frozen=True)
class Case:
    """One simulation of a study: a variant with a stroke at a point of the sweep."""

    variant: str
    stroke: str
    point: tuple[Any, ...] = ()


@checked
@dataclass(frozen=True, eq=False)
class Study:
    """A checked study, ready to run, made by :func:`load_study`.

    Attributes
    ----------
    spec
        Content of the file.
    actions, strokes
        Mechanisms by variant (with the values of the variant), and strokes by name.
    axes
        Axes of the sweep; empty without a sweep.
    origin
        Name of the file.
    """

    spec: StudyFile
    actions: Mapping[str, Action]
    strokes: Mapping[str, Stroke]
    axes: tuple[Axis, ...]
    origin: str

    @classmethod
    def read(cls, path: Path) -> Study:
        """Read and check a study file."""
        return cls.from_dict(read_toml(path), origin=path.name, folder=path.parent)

    @classmethod
    def from_dict(
        cls, raw: Mapping[str, Any], *, origin: str = "study", folder: Path | None = None
    ) -> Study:
        """Check the tables of a study.

        Parameters
        ----------
        folder
            Folder of relative paths of mechanisms and strokes; paths outside it are rejected.
            Default: the working folder, with any path.
        """
        faults: list[str] = []
        try:
            spec = StudyFile.model_validate(renamed(raw))
        except ValidationError as error:
            raise refusal(origin, fault_lines(error, StudyFile)) from None
        except RecursionError:
            raise refusal(origin, ["tables are nested too deeply"]) from None
        spec = _with_variant(spec)
        faults += name_faults(spec)
        strokes = make_strokes(spec, folder, faults)
        actions = make_actions(spec, folder, faults)
        axes = make_axes(spec, faults)
        faults += reference_faults(spec, axes)
        if faults:
            raise refusal(origin, faults)
        return cls(spec, actions, strokes, axes, origin)

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.spec.name

    def strokes_of(self, variant: str) -> list[str]:
        """Names of the strokes of a variant."""
        own = self._variant(variant).strokes
        return list(self.spec.base.strokes if own is None else own)

    def label(self, variant: str) -> str:
        """Name of a variant for people."""
        return self._variant(variant).label or variant

    def _variant(self, name: str) -> VariantSpec:
        if name not in self.spec.variants:
            known = ", ".join(self.spec.variants)
            raise InvalidParameter(f"study {self.name!r}: no variant {name!r}; it has {known}")
        return self.spec.variants[name]

    def points(self) -> list[tuple[Any, ...]]:
        """Points of the sweep; one empty point without a sweep."""
        if self.spec.sweep is None:
            return [()]
        return list(grid_points(self.axes, self.spec.sweep.mode))

    def cases(self) -> list[Case]:
        """All simulations, by variant, then point of the sweep, then stroke."""
        return [
            Case(variant, stroke, point)
            for variant in self.spec.variants
            for point in self.points()
            if self._has(variant, point)
            for stroke in self.strokes_of(variant)
        ]

    def _has(self, variant: str, point: tuple[Any, ...]) -> bool:
        return self._among(self.spec.variants[variant].only, point)

    def _among(self, only: Mapping[str, list[Any]], point: tuple[Any, ...]) -> bool:
        """Whether the values of a point are among the values in ``only`` for their axes."""
        return all(
            axis.name not in only or any(same(value, wanted) for wanted in only[axis.name])
            for axis, value in zip(self.axes, point, strict=True)
        )

    def shows(self, panel: PanelSpec, case: Case) -> bool:
        """Whether a panel shows a case."""
        return (
            (panel.variants is None or case.variant in panel.variants)
            and (panel.stroke is None or case.stroke == panel.stroke)
            and (panel.stroke is not None or panel.strokes is None or case.stroke in panel.strokes)
            and self._among(panel.only, case.point)
        )

    def number_spec(self, name: str) -> NumberSpec:
        """Definition of a value; values in the summary of a run need no entry."""
        return self.spec.numbers.get(name, NumberSpec())

    def shown(self, name: str) -> tuple[str, str, float]:
        """Label, unit and factor from SI of a value."""
        number = self.number_spec(name)
        text, unit = KNOWN.get(
            name, (name.replace("_", " "), "ms" if name.endswith("_time") else "1")
        )
        unit = number.unit or unit
        factor = to_unit(unit)
        return number.label or text, "" if unit == "1" else unit, factor

    def member(self, case: Case) -> Member:
        """The simulation of a case."""
        variant = self._variant(case.variant)
        action = self.actions[case.variant]
        if case.stroke not in self.strokes:
            known = ", ".join(self.strokes)
            raise InvalidParameter(
                f"study {self.name!r}: no stroke {case.stroke!r}; it has {known}"
            )
        if len(case.point) != len(self.axes):
            raise InvalidParameter(
                f"study {self.name!r}: a point of {len(case.point)} values, expected "
                f"{len(self.axes)}, one for each axis"
            )
        values: dict[str, Any] = {}
        for axis, value in zip(self.axes, case.point, strict=True):
            values.update(axis.at(value))
        mechanism, stroke, options = apply_point(
            action,
            self.strokes[case.stroke],
            {**self.spec.base.options, **variant.options},
            values,
        )
        return Member(
            action,
            stroke,
            mechanism,
            options,
            " ".join([self.name, case.variant, *map(short, case.point), case.stroke]),
            Extract(extract_run, self._extract_spec(case)),
        )

    def _extract_spec(self, case: Case) -> dict[str, Any]:
        numbers = {
            name: number.model_dump(
                by_alias=True,
                exclude={"label", "unit", "thesis", "strokes", "digits"},
                exclude_none=True,
            )
            for name, number in self.spec.numbers.items()
            if (number.value or number.output)
            and (number.strokes is None or case.stroke in number.strokes)
        }
        series = {}
        for figure in self.spec.figures.values():
            for panel in figure.panels:
                if figure.kind != "time" or panel.output is None:
                    continue
                if case.stroke in self._panel_strokes(panel) and self.shows(panel, case):
                    series[series_key(panel)] = {
                        "output": panel.output,
                        "from": panel.start,
                        "to": panel.end,
                        "from_rest": panel.from_rest,
                    }
        return {"numbers": numbers, "series": series}

    def _panel_strokes(self, panel: PanelSpec) -> list[str]:
        if panel.stroke is not None:
            return [panel.stroke]
        return list(panel.strokes if panel.strokes is not None else self.spec.base.strokes)


def series_key(panel: PanelSpec) -> str:
    """Key of the stored samples of a panel."""
    import hashlib

    text = json.dumps([panel.output, panel.start, panel.end, panel.from_rest])
    return "s" + hashlib.sha256(text.encode()).hexdigest()[:12]


def same(a: Any, b: Any) -> bool:
    """Whether two values of an axis are equal."""
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12)
    return str(a) == str(b)
