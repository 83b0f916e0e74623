"""Studies: named variants of a mechanism under strokes, what to draw, tabulate and check, as data.

:func:`study` runs a packaged study or a user's own TOML file; see ``docs/studies.md`` for the file.
"""

from __future__ import annotations

import difflib
import itertools
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError

from feltmb import params
from feltmb.config import Action, load_action
from feltmb.errors import InvalidParameter
from feltmb.files import check_writable, is_file, read_toml, write_file, write_text
from feltmb.quantity import Schema, fault_lines, shortened
from feltmb.simulate import simulate
from feltmb.stroke import Stroke, load_stroke, motion_stroke, table_stroke
from feltmb.study_expression import Formula, NotThere, to_unit
from feltmb.sweep import (
    Axis,
    Extract,
    Member,
    Outcome,
    Progress,
    ProgressBar,
    apply_point,
    axis_values,
    check_options,
    grid_points,
    run_members,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from feltmb.results import Run

Array = npt.NDArray[np.float64]

__all__ = [
    "Case",
    "FindingResult",
    "Study",
    "StudyResult",
    "extract_run",
    "load_study",
    "packaged_studies",
    "run_studies",
    "statistic",
    "study",
    "study_targets",
]

#: Numbers that every run may have: name -> (text, unit to show).
KNOWN: dict[str, tuple[str, str]] = {
    "impact_speed": ("impact speed", "m/s"),
    "rebound_speed": ("rebound speed", "m/s"),
    "max_string_force": ("largest string force", "N"),
    "string_contact_duration": ("string contact lasts", "ms"),
    "let_off_gap": ("distance at let-off", "mm"),
    "check_gap": ("distance in check", "mm"),
    "check_gap_swing": ("swing in check, last 10 ms", "mm"),
    "key_travel": ("key travel", "mm"),
    "steps": ("integration steps", "1"),
    "rhs": ("right-hand sides", "1"),
}
MOST_SAMPLES = 6000  # of a series that is kept for a figure

_WORD = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*$")

Stat = Literal[
    "first",
    "last",
    "min",
    "max",
    "mean",
    "span",
    "rms",
    "variation",
    "time_of_max",
    "time_of_min",
    "rises_above",
    "falls_below",
    "time_above",
    "pulses",
    "settles",
    "swing_back",
    "frequency",
]
#: Statistics that need ``level``.
_LEVEL = ("rises_above", "falls_below", "time_above", "pulses", "settles")
_TIMES = ("time_of_max", "time_of_min", "rises_above", "falls_below", "time_above", "settles")

When = float | str


# --- the file ------------------------------------------------------------------------------------


class _Thesis(Schema):
    """Where a study comes from and what it found, in one sentence."""

    cite: str = "thesis"
    figure: str = ""
    found: str = ""


class _StrokeSpec(Schema):
    """A stroke made from another: scaled, later, or what was recorded at the key under it."""

    base: str
    record: Literal["force", "key_motion"] | None = None
    scale: float = 1.0
    delay: float = 0.0
    duration: Annotated[float, Field(gt=0)] | None = None


class _Base(Schema):
    action: str = "steinway45"
    strokes: list[str] = Field(min_length=1)
    values: dict[str, Any] = Field(default_factory=dict)
    options: dict[str, Any] = Field(default_factory=dict)


class _Variant(Schema):
    label: str = ""
    note: str = ""
    action: str | None = None
    values: dict[str, Any] = Field(default_factory=dict)
    strokes: list[str] | None = None
    options: dict[str, Any] = Field(default_factory=dict)
    only: dict[str, list[Any]] = Field(default_factory=dict)


class _Axis(Schema):
    name: str
    label: str = ""
    unit: str = "1"
    path: str | list[str]
    inverse: list[str] = Field(default_factory=list)
    how: Literal["set", "scale", "offset"] = "set"
    values: Any
    log: bool = False


class _Sweep(Schema):
    mode: Literal["grid", "list"] = "grid"
    axis: list[_Axis] = Field(min_length=1)


class _Number(Schema):
    label: str = ""
    unit: str = ""
    value: str | None = None
    output: str | None = None
    stat: Stat | None = None
    start: Annotated[When | None, Field(alias="from")] = None
    end: Annotated[When | None, Field(alias="to")] = None
    level: float | None = None
    thesis: dict[str, float] = Field(default_factory=dict)
    digits: Annotated[int, Field(ge=1, le=15)] = 4
    strokes: list[str] | None = None


class _Mark(Schema):
    value: float
    label: str = ""


class _Panel(Schema):
    output: str | None = None
    number: str | None = None
    stroke: str | None = None
    strokes: list[str] | None = None
    variants: list[str] | None = None
    unit: str = ""
    label: str = ""
    title: str = ""
    start: Annotated[When | None, Field(alias="from")] = None
    end: Annotated[When | None, Field(alias="to")] = None
    from_rest: bool = False
    log: bool = False
    marks: list[_Mark] = Field(default_factory=list)


class _Figure(Schema):
    title: str
    kind: Literal["time", "sweep", "bars"] = "time"
    figure: str = ""
    caption: str = ""
    columns: Annotated[int, Field(ge=1, le=4)] = 1
    x: str | None = None
    panels: list[_Panel] = Field(min_length=1)


class _Finding(Schema):
    says: str
    source: str = ""
    check: str | None = None
    size: str | None = None
    unit: str = "1"
    thesis: float | None = None
    within: Annotated[float, Field(gt=0)] | None = None
    note: str = ""


class StudyFile(Schema):
    """A study file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    title: str
    about: str = ""
    thesis: _Thesis = _Thesis()
    base: _Base
    strokes: dict[str, _StrokeSpec] = Field(default_factory=dict)
    variants: dict[str, _Variant] = Field(default_factory=dict)
    sweep: _Sweep | None = None
    numbers: dict[str, _Number] = Field(default_factory=dict)
    figures: dict[str, _Figure] = Field(default_factory=dict)
    findings: list[_Finding] = Field(default_factory=list)


def packaged_studies() -> list[str]:
    """Names of the studies that come with the package, in the order of the thesis's figures."""
    listed = params.folder("studies") / "order.txt"
    names = params.names("studies")
    order = listed.read_text(encoding="utf-8").split() if listed.is_file() else []
    return sorted(names, key=lambda n: (order.index(n) if n in order else len(order), n))


def load_study(name_or_path: str | Path) -> Study:
    """Read a study: the name of a packaged one, or the path of a TOML file.

    Raises
    ------
    InvalidParameter
        Listing all faults of the file at once.
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
        raise InvalidParameter(f"study {text!r}: there is no such file")
    return Study.read(path)


@dataclass(frozen=True)
class Case:
    """One simulation of a study: a variant under a stroke at a point of the sweep."""

    variant: str
    stroke: str
    point: tuple[Any, ...] = ()


@dataclass(frozen=True, eq=False)
class Study:
    """A checked study, ready to run. Made by :func:`load_study`.

    Attributes
    ----------
    spec
        Content of the file.
    actions, strokes
        Mechanisms by variant (with its values) and strokes by name.
    axes
        Directions of the sweep; empty without one.
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
        """Read and check a file."""
        return cls.from_dict(read_toml(path), origin=path.name, folder=path.parent)

    @classmethod
    def from_dict(
        cls, raw: Mapping[str, Any], *, origin: str = "study", folder: Path | None = None
    ) -> Study:
        """Check the tables of a study.

        Parameters
        ----------
        folder
            Where the paths of mechanisms and strokes start; default: the working folder.
        """
        faults: list[str] = []
        try:
            spec = StudyFile.model_validate(raw)
        except ValidationError as error:
            raise _refusal(origin, fault_lines(error, StudyFile)) from None
        except RecursionError:
            raise _refusal(origin, ["tables are nested too deeply"]) from None
        where = folder if folder is not None else Path()
        if not spec.variants:
            spec = spec.model_copy(update={"variants": {"base": _Variant(label=spec.title)}})
        faults += _name_faults(spec)
        strokes = _strokes(spec, where, faults)
        actions = _actions(spec, where, faults)
        axes = _axes(spec, faults)
        faults += _reference_faults(spec, axes)
        if faults:
            raise _refusal(origin, faults)
        return cls(spec, actions, strokes, axes, origin)

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.spec.name

    def strokes_of(self, variant: str) -> list[str]:
        """Names of the strokes of a variant."""
        own = self.spec.variants[variant].strokes
        return list(self.spec.base.strokes if own is None else own)

    def label(self, variant: str) -> str:
        """Name of a variant for the reader."""
        return self.spec.variants[variant].label or variant

    def points(self) -> list[tuple[Any, ...]]:
        """Points of the sweep; one empty point without a sweep."""
        if self.spec.sweep is None:
            return [()]
        return list(grid_points(self.axes, self.spec.sweep.mode))

    def cases(self) -> list[Case]:
        """All simulations: variants, then points of the sweep, then strokes."""
        return [
            Case(variant, stroke, point)
            for variant in self.spec.variants
            for point in self.points()
            if self._has(variant, point)
            for stroke in self.strokes_of(variant)
        ]

    def _has(self, variant: str, point: tuple[Any, ...]) -> bool:
        only = self.spec.variants[variant].only
        return all(
            axis.name not in only or any(_same(value, wanted) for wanted in only[axis.name])
            for axis, value in zip(self.axes, point, strict=True)
        )

    def number_spec(self, name: str) -> _Number:
        """How a number is found and shown; numbers of the run's summary need no entry."""
        return self.spec.numbers.get(name, _Number())

    def shown(self, name: str) -> tuple[str, str, float]:
        """Text, unit and factor from SI of a number."""
        number = self.number_spec(name)
        text, unit = KNOWN.get(
            name, (name.replace("_", " "), "ms" if name.endswith("_time") else "1")
        )
        unit = number.unit or unit
        factor = to_unit(unit)
        return number.label or text, "" if unit == "1" else unit, factor

    def member(self, case: Case) -> Member:
        """The simulation of a case."""
        variant = self.spec.variants[case.variant]
        action = self.actions[case.variant]
        values: dict[str, Any] = {}
        for axis, value in zip(self.axes, case.point, strict=True):
            values.update(axis.at(action, value))
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
            " ".join([self.name, case.variant, *map(_short, case.point), case.stroke]),
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
                if case.stroke in self._panel_strokes(panel) and (
                    panel.variants is None or case.variant in panel.variants
                ):
                    series[series_key(panel)] = {
                        "output": panel.output,
                        "from": panel.start,
                        "to": panel.end,
                        "from_rest": panel.from_rest,
                    }
        return {"numbers": numbers, "series": series}

    def _panel_strokes(self, panel: _Panel) -> list[str]:
        if panel.stroke is not None:
            return [panel.stroke]
        return list(panel.strokes if panel.strokes is not None else self.spec.base.strokes)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def series_key(panel: _Panel) -> str:
    """Name under which the samples of a panel are kept."""
    import hashlib

    text = json.dumps([panel.output, panel.start, panel.end, panel.from_rest])
    return "s" + hashlib.sha256(text.encode()).hexdigest()[:12]


# --- checking the file ---------------------------------------------------------------------------


def _refusal(origin: str, faults: Sequence[str]) -> InvalidParameter:
    unique = list(dict.fromkeys(faults))
    count = "1 fault" if len(unique) == 1 else f"{len(unique)} faults"
    return InvalidParameter(f"{origin}: {count}\n" + "\n".join(f"  {f}" for f in unique))


def _name_faults(spec: StudyFile) -> Iterator[str]:
    for table, names in (
        ("variants", spec.variants),
        ("numbers", spec.numbers),
        ("strokes", spec.strokes),
    ):
        for name in names:
            if not _WORD.match(name):
                yield f"{table}.{name}: expected a word of letters, digits and _"
    if not re.match(r"^[A-Za-z0-9_.-]+$", spec.name):
        yield f"name: got {spec.name!r}, expected letters, digits, '_', '-' and '.'"


class _Strokes(Mapping[str, Stroke]):
    """Strokes by name; those recorded from a run are made when first asked for."""

    def __init__(self) -> None:
        self._made: dict[str, Stroke | Callable[[], Stroke]] = {}

    def add(self, name: str, stroke: Stroke | Callable[[], Stroke]) -> None:
        self._made[name] = stroke

    def __getitem__(self, name: str) -> Stroke:
        made = self._made[name]
        if not isinstance(made, Stroke):
            made = self._made[name] = made()
        return made

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


def _record(spec: StudyFile, stroke: Stroke, name: str, what: str, folder: Path) -> Stroke:
    """What a sensor at the key would record while the base mechanism plays a stroke."""
    action: Action = _load_beside(load_action, spec.base.action, folder)
    if spec.base.values:
        action = action.with_values(spec.base.values)
    run = simulate(action, stroke, rtol=1e-7, ledger=False, events=False)
    if what == "force":
        made = table_stroke(run.time.tolist(), run["finger.force"].tolist(), name=name)
    else:
        travel = run["finger.displacement"]
        made = motion_stroke(run.time.tolist(), (travel - travel[0]).tolist(), of="key", name=name)
    return replace(made, duration=stroke.duration)


def _strokes(spec: StudyFile, folder: Path, faults: list[str]) -> _Strokes:
    out = _Strokes()
    wanted = list(spec.base.strokes)
    for variant in spec.variants.values():
        wanted += variant.strokes or []
    for name in dict.fromkeys(wanted):
        try:
            made = spec.strokes.get(name)
            if made is None:
                out.add(name, _load_beside(load_stroke, name, folder))
                continue
            stroke = _load_beside(load_stroke, made.base, folder)
            stroke = stroke.scaled(made.scale).shifted(made.delay)
            if made.duration is not None:
                stroke = replace(stroke, duration=made.duration)
            if made.record is None:
                out.add(name, replace(stroke, name=name))
            else:
                out.add(name, partial(_record, spec, stroke, name, made.record, folder))
        except InvalidParameter as error:
            faults.append(f"stroke {name}: {error}")
    return out


def _load_beside(load: Any, name: str, folder: Path) -> Any:
    """A packaged name, or a path that starts at the folder of the study."""
    beside = folder / name
    if Path(name).suffix and is_file(beside):
        return load(beside)
    return load(name)


def _actions(spec: StudyFile, folder: Path, faults: list[str]) -> dict[str, Action]:
    out: dict[str, Action] = {}
    for name, variant in spec.variants.items():
        try:
            action: Action = _load_beside(load_action, variant.action or spec.base.action, folder)
            changed = {**spec.base.values, **variant.values}
            out[name] = action.with_values(changed) if changed else action
        except InvalidParameter as error:
            faults.append(f"variants.{name}: {error}")
    for where, options in [("base", spec.base.options)] + [
        (f"variants.{n}", v.options) for n, v in spec.variants.items()
    ]:
        try:
            check_options(options)
        except InvalidParameter as error:
            faults.append(f"{where}.options: {error}")
    return out


def _axes(spec: StudyFile, faults: list[str]) -> tuple[Axis, ...]:
    axes: list[Axis] = []
    for i, given in enumerate(spec.sweep.axis if spec.sweep is not None else []):
        where = f"sweep.axis.{i}"
        try:
            values, how = axis_values(given.values, f"{where}.values")
            if how != "set":
                raise InvalidParameter(f"{where}: write how = {how!r} beside the values")
        except InvalidParameter as error:
            faults.append(str(error))
            continue
        if not _WORD.match(given.name):
            faults.append(f"{where}.name: got {given.name!r}, expected a word")
        if given.inverse and given.how != "scale":
            faults.append(f"{where}.inverse: is for how = 'scale' only")
        paths = (given.path,) if isinstance(given.path, str) else tuple(given.path)
        axes.append(Axis(given.name, values, paths, given.how, tuple(given.inverse)))
    if spec.sweep is not None and not faults:
        try:
            grid_points(axes, spec.sweep.mode)
        except InvalidParameter as error:
            faults.append(str(error))
    return tuple(axes)


def _formula(text: str, where: str, faults: list[str]) -> Formula | None:
    try:
        return Formula(text)
    except InvalidParameter as error:
        faults.append(f"{where}: {error}")
        return None


def _unit_fault(unit: str, where: str) -> list[str]:
    try:
        to_unit(unit)
    except InvalidParameter as error:
        return [f"{where}: {error}"]
    return []


def _reference_faults(spec: StudyFile, axes: Sequence[Axis]) -> list[str]:
    """Names that point nowhere, and formulas that are none."""
    faults: list[str] = []
    strokes = list(
        dict.fromkeys(
            [*spec.base.strokes, *(s for v in spec.variants.values() for s in v.strokes or [])]
        )
    )

    def need(name: str | None, known: Iterable[str], where: str, what: str) -> None:
        listed = list(known)
        if name is not None and name not in listed:
            faults.append(f"{where}: {what} {name!r} is none of {', '.join(listed) or 'none'}")

    def check_when(when: When | None, where: str) -> None:
        if isinstance(when, str):
            _formula(when, where, faults)

    for name, variant in spec.variants.items():
        for axis in variant.only:
            need(axis, [a.name for a in axes], f"variants.{name}.only", "axis")
    for name, number in spec.numbers.items():
        where = f"numbers.{name}"
        faults += _unit_fault(number.unit, f"{where}.unit")
        if number.value is not None and number.output is not None:
            faults.append(f"{where}: give either value, or output and stat")
        if number.output is not None and number.stat is None:
            faults.append(f"{where}: output needs stat")
        if number.stat in _LEVEL and number.level is None:
            faults.append(f"{where}: stat {number.stat!r} needs level")
        for text in (number.value, number.output):
            if text is not None:
                _formula(text, where, faults)
        check_when(number.start, f"{where}.from")
        check_when(number.end, f"{where}.to")
        for key in number.thesis:
            of, _, stroke = key.partition(".")
            need(of, spec.variants, f"{where}.thesis", "variant")
            need(stroke, strokes, f"{where}.thesis", "stroke")
        for stroke in number.strokes or []:
            need(stroke, strokes, f"{where}.strokes", "stroke")
    for name, figure in spec.figures.items():
        for i, panel in enumerate(figure.panels):
            where = f"figures.{name}.panels.{i}"
            faults += _unit_fault(panel.unit, f"{where}.unit")
            need(panel.stroke, strokes, f"{where}.stroke", "stroke")
            for shown in panel.variants or []:
                need(shown, spec.variants, f"{where}.variants", "variant")
            for stroke in panel.strokes or []:
                need(stroke, strokes, f"{where}.strokes", "stroke")
            check_when(panel.start, f"{where}.from")
            check_when(panel.end, f"{where}.to")
            if figure.kind == "time":
                if panel.output is None:
                    faults.append(f"{where}: a figure over time needs output")
                else:
                    _formula(panel.output, f"{where}.output", faults)
                if panel.stroke is None and len(strokes) > 1:
                    faults.append(f"{where}: a figure over time needs stroke")
            else:
                if panel.number is None:
                    faults.append(f"{where}: a figure of kind {figure.kind!r} needs number")
                if figure.kind == "sweep":
                    need(
                        figure.x or (axes[0].name if axes else ""),
                        [a.name for a in axes],
                        where,
                        "axis",
                    )
    for i, finding in enumerate(spec.findings):
        where = f"findings.{i}"
        faults += _unit_fault(finding.unit, f"{where}.unit")
        if (finding.thesis is None) != (finding.within is None) or (
            finding.thesis is not None and finding.size is None
        ):
            faults.append(f"{where}: size, thesis and within belong together")
        for text in (finding.check, finding.size):
            formula = _formula(text, where, faults) if text is not None else None
            if formula is None:
                continue
            for name in formula.names():
                faults.append(f"{where}: {name!r} stands alone; write {name}(variant, stroke)")
            for name, arguments in formula.calls():
                if name not in spec.numbers and name not in KNOWN and not name.endswith("_time"):
                    known = ", ".join([*spec.numbers, *KNOWN])
                    faults.append(f"{where}: number {name!r} is none of {known}")
                faults += _call_faults(name, arguments, spec, strokes, axes, where)
    return faults


def _call_faults(
    name: str,
    arguments: tuple[Any, ...],
    spec: StudyFile,
    strokes: list[str],
    axes: Sequence[Axis],
    where: str,
) -> Iterator[str]:
    text = f"{name}({', '.join(map(_short, arguments))})"
    words = [a for a in arguments if isinstance(a, str)]
    for word in words:
        if (
            word not in spec.variants
            and word not in strokes
            and not any(word in map(str, a.values) for a in axes)
        ):
            yield f"{where}: {text}: {word!r} is no variant, no stroke and no value of an axis"
    if len(spec.variants) > 1 and not any(w in spec.variants for w in words):
        yield f"{where}: {text}: says no variant"
    if len(strokes) > 1 and not any(w in strokes for w in words):
        yield f"{where}: {text}: says no stroke"
    if len(arguments) - sum(w in spec.variants or w in strokes for w in words) != len(axes):
        yield f"{where}: {text}: expected a value for each of {len(axes)} axes of the sweep"


# --- taking numbers and series from a run --------------------------------------------------------


def extract_run(
    run: Run, action: Action, spec: Mapping[str, Any]
) -> tuple[dict[str, float], dict[str, Array]]:
    """Numbers and series of a run; what the run does not have is absent.

    Parameters
    ----------
    spec
        ``numbers``: name -> entry of ``[numbers]``; ``series``: key -> output and window.
    """
    scalars: dict[str, float] = {k: float(v) for k, v in run.summary.items()}
    counts = ("steps", "rhs", "jacobians", "reversals", "wall")
    scalars.update({k: float(run.stats[k]) for k in counts if k in run.stats})
    if run.energy:
        scalars.update({k: float(v) for k, v in run.energy.items() if isinstance(v, float)})

    # What is switched off has no output: a strap that is not there does not pull, a stop does not
    # move.
    still = {f"{name}.force" for name, strap in action.config.straps.items() if not strap.enabled}
    if action.config.string is not None and action.config.string.kind == "rigid_stop":
        still |= {"string.strike", "string.bridge_force"}

    def output(name: str, arguments: tuple[Any, ...] | None) -> Array | float:
        if arguments is not None:
            raise NotThere(name)
        if name == "time":
            return run.time
        if name in run:
            return run[name]
        if name in scalars:
            return scalars[name]
        if name in still:
            return np.zeros_like(run.time)
        raise NotThere(name)

    def scalar(name: str, arguments: tuple[Any, ...] | None) -> float:
        if arguments is None and name in scalars:
            return scalars[name]
        raise NotThere(name)

    def window(start: When | None, end: When | None) -> tuple[float, float]:
        low = run.time[0] if start is None else float(_when(start, scalar))
        high = run.time[-1] if end is None else float(_when(end, scalar))
        return float(low), float(high)

    def samples_of(text: str) -> Array:
        made = np.asarray(Formula(text)(output), dtype=float)
        return np.broadcast_to(made, run.time.shape)

    def number(entry: Mapping[str, Any]) -> float:
        if entry.get("value") is not None:
            return float(Formula(entry["value"])(scalar))
        low, high = window(entry.get("from"), entry.get("to"))
        chosen = (run.time >= low) & (run.time <= high)
        if np.count_nonzero(chosen) < 2:
            raise NotThere(entry["output"])
        samples = samples_of(entry["output"])[chosen]
        return statistic(entry["stat"], run.time[chosen], samples, entry.get("level"))

    # Numbers may stand on others that come later in the file: go round until nothing is added.
    numbers: dict[str, float] = {}
    left = dict(spec["numbers"])
    for _ in spec["numbers"]:
        before = len(left)
        for name, entry in list(left.items()):
            try:
                value = number(entry)
            except NotThere:
                continue
            del left[name]
            if math.isfinite(value):
                numbers[name] = scalars[name] = value
        if len(left) == before:
            break
    series: dict[str, Array] = {}
    for key, entry in spec["series"].items():
        try:
            samples = samples_of(entry["output"])
            low, high = window(entry.get("from"), entry.get("to"))
        except NotThere:
            continue
        if entry.get("from_rest"):
            samples = samples - samples[0]
        chosen = (run.time >= low) & (run.time <= high)
        series[key] = _thin(np.stack([run.time[chosen], samples[chosen]]))
    return numbers, series


def _when(when: When, scalar: Any) -> float:
    return float(Formula(when)(scalar)) if isinstance(when, str) else float(when)


def _thin(pair: Array) -> Array:
    """At most MOST_SAMPLES samples; of each stretch the smallest and the largest stay."""
    count = pair.shape[1]
    if count <= MOST_SAMPLES:
        return np.ascontiguousarray(pair)
    edges = np.linspace(0, count, MOST_SAMPLES // 2 + 1).astype(int)
    keep: list[int] = []
    for a, b in itertools.pairwise(edges):
        low, high = a + int(np.argmin(pair[1, a:b])), a + int(np.argmax(pair[1, a:b]))
        keep += sorted({low, high})
    return np.ascontiguousarray(pair[:, keep])


def statistic(stat: str, time: Array, samples: Array, level: float | None = None) -> float:
    """One number of a stretch of samples.

    Parameters
    ----------
    stat
        ``first last min max mean span rms`` (span: largest less smallest; rms: about the mean);
        ``variation``: sum of all changes; ``time_of_max time_of_min``; ``rises_above
        falls_below``: first time at which it does; ``time_above``: how long; ``pulses``: how
        often it is above ``level``, pauses of less than a hundredth of the stretch not counted;
        ``settles``: from when on it stays within ``level`` of its last value; ``swing_back``: how
        far it returns below its largest value; ``frequency``: largest line of the spectrum of at
        least three periods [Hz].
    time, samples
        [s] and any unit, shape (n,), n >= 2, evenly sampled.

    Returns
    -------
    float
        NaN if it does not occur.
    """
    simple: dict[str, Callable[[], Any]] = {
        "first": lambda: samples[0],
        "last": lambda: samples[-1],
        "min": lambda: np.min(samples),
        "max": lambda: np.max(samples),
        "mean": lambda: np.mean(samples),
        "span": lambda: np.ptp(samples),
        "rms": lambda: np.std(samples),
        "variation": lambda: np.sum(np.abs(np.diff(samples))),
        "time_of_max": lambda: time[np.argmax(samples)],
        "time_of_min": lambda: time[np.argmin(samples)],
        "swing_back": lambda: np.max(samples) - np.min(samples[np.argmax(samples) :]),
    }
    if stat in simple:
        return float(simple[stat]())
    if stat == "frequency":
        if np.ptp(samples) < 1e-9:  # round-off
            return math.nan
        swing = (samples - np.mean(samples)) * np.hanning(samples.size)
        count = 8 * samples.size
        power = np.abs(np.fft.rfft(swing, count))
        step = (time[-1] - time[0]) / (time.size - 1)
        lines = np.fft.rfftfreq(count, step)
        power[lines < 3.0 / (time[-1] - time[0])] = 0.0
        return float(lines[int(np.argmax(power))])
    assert level is not None
    if stat == "settles":
        outside = np.nonzero(np.abs(samples - samples[-1]) > level)[0]
        return float(time[0] if outside.size == 0 else time[min(outside[-1] + 1, time.size - 1)])
    above = samples > level
    if stat == "time_above":
        return float(np.count_nonzero(above) * (time[-1] - time[0]) / (time.size - 1))
    if stat == "pulses":
        times = time[np.nonzero(above)[0]]
        pause = 0.01 * (time[-1] - time[0])
        return float(np.count_nonzero(np.diff(times) > pause) + int(times.size > 0))
    wanted = above if stat == "rises_above" else samples < level
    found = np.nonzero(wanted)[0]
    return float(time[found[0]]) if found.size else math.nan


# --- results -------------------------------------------------------------------------------------


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

    def series(self, panel: _Panel, case: Case) -> Array | None:
        """Times [s] and samples [SI] of a panel, shape (2, n)."""
        outcome = self.outcomes.get(case)
        return None if outcome is None else outcome.series.get(series_key(panel))

    def _case(self, variant: str, stroke: str, point: tuple[Any, ...]) -> Case:
        for case in self.outcomes:
            if (
                case.variant == variant
                and case.stroke == stroke
                and len(case.point) == len(point)
                and all(_same(a, b) for a, b in zip(case.point, point, strict=True))
            ):
                return case
        return Case(variant, stroke, point)

    @cached_property
    def findings(self) -> list[FindingResult]:
        """Findings of the file and what became of them."""
        return [self._judge(finding) for finding in self.study.spec.findings]

    def _judge(self, finding: _Finding) -> FindingResult:
        reasons: list[str] = []

        def lookup(name: str, arguments: tuple[Any, ...] | None) -> float:
            variant, stroke, point = self._arguments(arguments or ())
            outcome = self.outcomes.get(self._case(variant, stroke, point))
            value = None
            if outcome is not None and outcome.status == "done":
                value = outcome.numbers.get(name)
            if value is None:
                where = " ".join([variant, *map(_short, point), stroke])
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
        from feltmb.study_plot import draw

        for name in self.study.spec.figures:
            if name not in self._cache:
                self._cache[name] = draw(self, name)
        return {name: self._cache[name] for name in self.study.spec.figures}

    @property
    def failed(self) -> dict[str, str]:
        """Errors by simulation."""
        return {
            " ".join([case.variant, *map(_short, case.point), case.stroke]): outcome.error
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
        from feltmb.study_report import page

        return page([self])

    def save(self, folder: str | Path, *, force: bool = False, page: bool = True) -> list[Path]:
        """Write NAME.html, NAME.csv (SI units), NAME.json and the figures as PNG into a folder.

        Parameters
        ----------
        page
            False: without the HTML page.
        """
        from feltmb.study_plot import png

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


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12)
    return str(a) == str(b)


# --- running -------------------------------------------------------------------------------------


def run_studies(
    studies: Sequence[Study],
    *,
    executor: Executor | None = None,
    jobs: int | None = None,
    folder: str | Path | None = None,
    progress: Progress | bool | None = None,
) -> list[StudyResult]:
    """Run several studies, all their simulations side by side; see :func:`study`."""
    tagged: list[tuple[int, Case]] = []
    members: list[Member] = []
    found: list[dict[Case, Outcome | None]] = []
    for k, each in enumerate(studies):
        found.append(dict.fromkeys(each.cases()))
        for case in each.cases():
            try:
                members.append(each.member(case))
            except (InvalidParameter, TypeError, ValueError) as error:
                found[k][case] = Outcome("failed", " ".join(str(error).split()))
                continue
            tagged.append((k, case))
    with ProgressBar(progress, len(members), "studies") as bar:
        for index, outcome in run_members(members, executor=executor, jobs=jobs, folder=folder):
            k, case = tagged[index]
            found[k][case] = outcome
            bar.step(members[index].name)
    return [
        StudyResult(each, {c: o or Outcome("error", "was not run") for c, o in outcomes.items()})
        for each, outcomes in zip(studies, found, strict=True)
    ]


def study(
    name_or_path: str | Path | Study | Mapping[str, Any],
    executor: Executor | None = None,
    *,
    jobs: int | None = None,
    folder: str | Path | None = None,
    progress: Progress | bool | None = None,
) -> StudyResult:
    """Run a study: variants under strokes, side by side, with table, figures and findings.

    Parameters
    ----------
    name_or_path
        Name of a packaged study, path of a TOML file, its tables, or what ``load_study`` gave.
    executor
        Any ``concurrent.futures.Executor``; default: threads, one a core.
    jobs
        Threads without an executor.
    folder
        Folder of finished simulations, from which a study that was cut off goes on.
    progress
        ``progress(done, total, name)``; default: a bar on a terminal; False: none.

    Returns
    -------
    StudyResult
        ``table``, ``findings``, ``figures``; a simulation that failed has its error in the table.

    Raises
    ------
    InvalidParameter
        Listing all faults of the study.
    """
    if isinstance(name_or_path, Study):
        made = name_or_path
    elif isinstance(name_or_path, Mapping):
        made = Study.from_dict(name_or_path)
    else:
        made = load_study(name_or_path)
    return run_studies([made], executor=executor, jobs=jobs, folder=folder, progress=progress)[0]
