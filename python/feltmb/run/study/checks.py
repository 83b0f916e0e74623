"""Checks of a study file, all in one message; and its strokes, mechanisms and axes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from feltmb.errors import InvalidParameter
from feltmb.files import named_file
from feltmb.mechanism import Action, load_action
from feltmb.run.options import OPTIONS, check_options
from feltmb.run.simulate import simulate
from feltmb.run.stroke import Stroke, load_stroke, motion_stroke, table_stroke
from feltmb.run.study.expression import Formula, to_unit
from feltmb.run.study.schema import KNOWN, NEED_LEVEL, WORD, StudyFile, When
from feltmb.run.sweep import Axis, axis_values, grid_points


def short(value: Any) -> str:
    """Number or word as a label."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def refusal(origin: str, faults: Sequence[str]) -> InvalidParameter:
    """An error with all faults of a file."""
    unique = list(dict.fromkeys(faults))
    count = "1 fault" if len(unique) == 1 else f"{len(unique)} faults"
    return InvalidParameter(f"{origin}: {count}\n" + "\n".join(f"  {f}" for f in unique))


def name_faults(spec: StudyFile) -> Iterator[str]:
    """Faults of invalid names."""
    for table, names in (
        ("variants", spec.variants),
        ("numbers", spec.numbers),
        ("strokes", spec.strokes),
    ):
        for name in names:
            if not WORD.match(name):
                yield f"{table}.{name}: expected a word of letters, digits and _"
    if not re.match(r"^[A-Za-z0-9_.-]+$", spec.name):
        yield f"name: got {spec.name!r}, expected letters, digits, '_', '-' and '.'"


class _Strokes(Mapping[str, Stroke]):
    """Strokes by name; strokes that are recorded from a run are made when they are first needed."""

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


def _record(spec: StudyFile, stroke: Stroke, name: str, what: str, folder: Path | None) -> Stroke:
    """Stroke that a sensor at the key would record when the base mechanism performs a stroke."""
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


def make_strokes(spec: StudyFile, folder: Path | None, faults: list[str]) -> _Strokes:
    """Strokes of a study by name."""
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


def _load_beside(load: Any, name: str, folder: Path | None) -> Any:
    """A packaged name, or a path relative to the folder of the study if it is a file."""
    return load(name if folder is None else named_file(folder, name, "path"))


def make_actions(spec: StudyFile, folder: Path | None, faults: list[str]) -> dict[str, Action]:
    """Mechanisms of a study by variant, with the values of the variant."""
    out: dict[str, Action] = {}
    load = cache(partial(_load_beside, load_action, folder=folder))  # most share one
    for name, variant in spec.variants.items():
        try:
            action: Action = load(variant.action or spec.base.action)
            changed = {**spec.base.values, **variant.values}
            out[name] = action.with_values(changed) if changed else action
        except InvalidParameter as error:
            faults.append(f"variants.{name}: {error}")
    for where, options in [("base", spec.base.options)] + [
        (f"variants.{n}", v.options) for n, v in spec.variants.items()
    ]:
        try:
            check_options(options, known=OPTIONS)
        except InvalidParameter as error:
            faults.append(f"{where}.options: {error}")
    return out


def make_axes(spec: StudyFile, faults: list[str]) -> tuple[Axis, ...]:
    """Axes of the sweep."""
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
        if not WORD.match(given.name):
            faults.append(f"{where}.name: got {given.name!r}, expected a word")
        if given.inverse and given.how != "scale":
            faults.append(f"{where}.inverse: is for how = 'scale' only")
        paths = (given.path,) if isinstance(given.path, str) else tuple(given.path)
        faults += _unit_fault(given.unit, f"{where}.unit")
        inverse = tuple(given.inverse)
        axes.append(Axis(given.name, values, paths, given.how, inverse, given.unit))
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


def reference_faults(spec: StudyFile, axes: Sequence[Axis]) -> list[str]:
    """Faults of references that do not exist, and of invalid formulas."""
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
        if number.stat in NEED_LEVEL and number.level is None:
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
            for axis in panel.only:
                need(axis, [a.name for a in axes], f"{where}.only", "axis")
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
        need(finding.over, [a.name for a in axes], f"{where}.over", "axis")
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
                faults += _call_faults(name, arguments, spec, strokes, axes, where, finding.over)
    return faults


def _call_faults(
    name: str,
    arguments: tuple[Any, ...],
    spec: StudyFile,
    strokes: list[str],
    axes: Sequence[Axis],
    where: str,
    over: str | None,
) -> Iterator[str]:
    text = f"{name}({', '.join(map(short, arguments))})"
    words = [a for a in arguments if isinstance(a, str)]
    for word in words:
        if (
            word not in spec.variants
            and word not in strokes
            and word != over
            and not any(word in map(str, a.values) for a in axes)
        ):
            yield f"{where}: {text}: {word!r} is no variant, no stroke and no value of an axis"
    if len(spec.variants) > 1 and not any(w in spec.variants for w in words):
        yield f"{where}: {text}: says no variant"
    if len(strokes) > 1 and not any(w in strokes for w in words):
        yield f"{where}: {text}: says no stroke"
    if len(arguments) - sum(w in spec.variants or w in strokes for w in words) != len(axes):
        yield f"{where}: {text}: expected a value for each of {len(axes)} axes of the sweep"
