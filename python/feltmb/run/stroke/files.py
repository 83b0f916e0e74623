"""Strokes from files: packaged strokes, TOML, CSV."""

from __future__ import annotations

import io
import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from feltmb import params
from feltmb.arguments import checked
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import LARGEST_TABLE, is_file, read_text, read_toml, why_missing
from feltmb.run.stroke.strokes import (
    PRESCRIBED,
    UNITS,
    Interpolation,
    Kind,
    Stroke,
    pulse_stroke,
    ramp_stroke,
    sequence,
    table_of,
    usual_interpolation,
)
from feltmb.units import conversion_factor
from feltmb.units.quantity import SI, Schema, fault_lines, fault_text, shortened, split_heading


class _Ramp(Schema):
    force: Annotated[float, SI("N")]
    start: Annotated[float, SI("s"), Field(ge=0)]
    ramp: Annotated[float, SI("s"), Field(gt=0)]


class _Pulse(Schema):
    force: Annotated[float, SI("N")]
    start: Annotated[float, SI("s"), Field(ge=0)]
    rise: Annotated[float, SI("s"), Field(gt=0)]
    hold: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    fall: Annotated[float, SI("s"), Field(gt=0)]


class _Knots(Schema):
    unit: Annotated[list[str], Field(min_length=2, max_length=2)] | None = None
    time: list[float]
    value: list[float]
    interpolation: Interpolation | None = None


class _Oscillation(Schema):
    amplitude: Annotated[float, SI("1")]
    frequency: Annotated[float, SI("Hz"), Field(gt=0)]


class StrokeFile(Schema):
    """A stroke file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    about: str = ""
    source: str = ""
    kind: Kind = "force"
    duration: Annotated[float, SI("s"), Field(gt=0)] | None = None
    ramp: _Ramp | None = None
    pulse: _Pulse | None = None
    knots: _Knots | None = None
    oscillation: _Oscillation | None = None
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    period: Annotated[float, SI("s"), Field(gt=0)] | None = None


#: All keys of a stroke file.
STROKE_KEYS = {k for t in (StrokeFile, _Ramp, _Pulse, _Knots, _Oscillation) for k in t.model_fields}


def packaged_strokes() -> list[str]:
    """Names of the packaged strokes."""
    return params.names("strokes")


@checked
def load_stroke(name_or_path: str | Path) -> Stroke:
    """Read a stroke: a packaged name, a TOML file, or a CSV of force or displacement over time.

    Raises
    ------
    InvalidParameter
        The name is unknown, or a TOML file has faults; all of them are in the message.
    DataError
        A CSV has faults; all of them are in the message, with line numbers.
    """
    text = str(name_or_path)
    if text in packaged_strokes():
        return _from_toml(params.folder("strokes") / f"{text}.toml")
    path = Path(text)
    if not is_file(path):
        hint = why_missing(path) if path.suffix else "or give the path of a TOML or CSV file"
        raise InvalidParameter(
            f"stroke {shortened(repr(text))} is unknown; "
            f"packaged are {', '.join(packaged_strokes())}; {hint}"
        )
    return _from_toml(path) if path.suffix == ".toml" else read_stroke_csv(path)


def _from_toml(path: Path) -> Stroke:
    raw = read_toml(path)
    faults: list[str] = []
    others = [kind for kind in UNITS if kind != "force"]  # a list: the kind may be unhashable
    if raw.get("kind") in others and "knots" not in raw:
        faults.append(f"kind {raw['kind']!r} needs knots; ramp and pulse are forces")
    given = [key for key in ("ramp", "pulse", "knots") if key in raw]
    if len(given) != 1:
        faults.append(
            f"give one of ramp, pulse, knots; got {', '.join(given) if given else 'none'}"
        )
    try:
        parsed = StrokeFile.model_validate(raw)
    except ValidationError as error:
        faults += fault_lines(error, StrokeFile)
    if faults:
        raise InvalidParameter(fault_text(path.name, faults))
    stroke = _one_stroke(parsed, path)
    if parsed.oscillation is not None:
        stroke = replace(
            stroke,
            oscillation_amplitude=parsed.oscillation.amplitude,
            oscillation_frequency=parsed.oscillation.frequency,
        )
    if parsed.duration is not None:
        stroke = replace(stroke, duration=parsed.duration)
    stroke = replace(stroke, name=parsed.name, source=parsed.source)
    if parsed.repeat > 1:
        stroke = sequence(*[stroke] * parsed.repeat, period=parsed.period, name=parsed.name)
        stroke = replace(stroke, source=parsed.source)
    return stroke


def _one_stroke(parsed: StrokeFile, path: Path) -> Stroke:
    if parsed.ramp is not None:
        r = parsed.ramp
        return ramp_stroke(r.force, r.start, r.ramp)
    if parsed.pulse is not None:
        p = parsed.pulse
        return pulse_stroke(p.force, p.start, p.rise, p.fall, hold=p.hold)
    knots = parsed.knots
    assert knots is not None
    try:
        unit = knots.unit or ["s", UNITS[parsed.kind]]
        time_factor = conversion_factor(unit[0], "s")
        value_factor = conversion_factor(unit[-1], UNITS[parsed.kind])
    except InvalidParameter as error:
        raise InvalidParameter(f"{path.name}: knots.unit: {error}") from None
    return table_of(
        parsed.kind,
        [t * time_factor for t in knots.time],
        [v * value_factor for v in knots.value],
        knots.interpolation
        or (usual_interpolation(parsed.kind) if parsed.kind in PRESCRIBED else "linear"),
        None,
        parsed.name,
    )


_COLUMNS: dict[str, Kind] = {
    "force": "force",
    "displacement": "motion",
    "motion": "motion",
    "key displacement": "key_motion",
    "torque": "torque",
    "motor angle": "motor_motion",
}


@checked
def read_stroke_csv(path: str | Path, *, interpolation: Interpolation | None = None) -> Stroke:
    """Read a stroke from CSV with the header ``time [s],force [N]``.

    The second column is ``force``, ``displacement`` (of the finger), ``key displacement``,
    ``torque`` or ``motor angle``. The interpolation between rows is a monotone cubic; a spline for
    the two motions that are prescribed exactly; linear for a torque. Units in the header are
    converted (``time [ms],displacement [mm]``). All faults are collected: missing or wrong header,
    cells that are not finite numbers, times that do not increase, gaps of more than five sample
    intervals.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message, with line numbers.
    """
    path = Path(path)
    text = read_text(path, most=LARGEST_TABLE)
    kind, factors, header_faults = _parse_header(text)
    time, value, faults = _parse_rows(text, factors)
    faults = header_faults + faults + _time_faults([row for row in time if math.isfinite(row[1])])
    if faults:
        raise DataError(fault_text(path.name, faults, most=20))
    usual = interpolation or usual_interpolation(kind)
    return table_of(kind, [t for _, t in time], value, usual, None, path.stem)


def _parse_header(text: str) -> tuple[Kind, tuple[float, float], list[str]]:
    wanted = (
        "'time [s],force [N]', or instead of force: displacement [m], key displacement [m], "
        "torque [N m], motor angle [rad]"
    )
    line = next((x for x in text.splitlines() if x.strip() and not x.startswith("#")), "")
    cells = line.split(",")
    kind: Kind = "force"
    factors = [1.0, 1.0]
    if len(cells) != 2:
        return kind, (1.0, 1.0), [f"header: got {line[:80]!r}, expected {wanted}"]
    faults = []
    for i, cell in enumerate(cells):
        name, unit = split_heading(cell)
        name = name.lower()
        if i == 0 and name == "time":
            si = "s"
        elif i == 1 and name in _COLUMNS:
            kind = _COLUMNS[name]
            si = UNITS[kind]
        else:
            faults.append(f"header: got column {cell.strip()[:80]!r}, expected {wanted}")
            continue
        if unit is None:
            faults.append(
                f"header: column {cell.strip()[:80]!r} states no unit; write '{name} [{si}]'"
            )
            continue
        try:
            factors[i] = conversion_factor(unit, si)
        except InvalidParameter as error:
            faults.append(f"header: column {name!r}: {error}")
    return kind, (factors[0], factors[1]), faults


def _parse_rows(
    text: str, factors: tuple[float, float]
) -> tuple[list[tuple[int, float]], list[float], list[str]]:
    time: list[tuple[int, float]] = []
    value: list[float] = []
    faults: list[str] = []
    header_seen = False
    for number, line in enumerate(io.StringIO(text), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        if not header_seen:
            header_seen = True
            continue
        cells = line.rstrip("\r\n").split(",")
        if len(cells) != 2:
            faults.append(f"line {number}: got {len(cells)} cells, expected 2")
            continue
        row = []
        for cell, column in zip(cells, ("time", "value"), strict=True):
            try:
                parsed = float(cell)
            except ValueError:
                parsed = math.nan
            if not math.isfinite(parsed):
                faults.append(
                    f"line {number}: {column} is {cell.strip()!r}, expected a finite number"
                )
            row.append(parsed)
        time.append((number, row[0] * factors[0]))
        value.append(row[1] * factors[1])
    if len(time) < 2 and not faults:
        faults.append(f"got {len(time)} rows of data, expected at least 2")
    return time, value, faults


def _time_faults(time: list[tuple[int, float]]) -> list[str]:
    faults = []
    steps = [b[1] - a[1] for a, b in itertools.pairwise(time)]
    for (number, t), step in zip(time[1:], steps, strict=True):
        if step <= 0:
            faults.append(
                f"line {number}: time {t:.9g} s does not follow {t - step:.9g} s; it must grow"
            )
    if not faults and len(steps) > 20:
        usual = sorted(steps)[len(steps) // 2]
        for (number, t), step in zip(time[1:], steps, strict=True):
            if step > 5 * usual:
                faults.append(
                    f"line {number}: gap of {step:.6g} s before {t:.6g} s; the usual step is "
                    f"{usual:.6g} s; fill it or cut the record there"
                )
    return faults
