"""Strokes from files: packaged strokes, TOML, CSV."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from feltmb import params
from feltmb.quantities import SI
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
from unmodeled.arguments import checked
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import read_toml
from unmodeled.units import conversion_factor
from unmodeled.units.quantity import Schema, fault_lines, fault_text


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

    Examples
    --------
    A packaged stroke, its force at 0.2 s [N]:

    >>> from feltmb import load_stroke
    >>> float(load_stroke("forte").at(0.2))
    25.0
    """
    path = params.find(name_or_path, "strokes", "stroke", forms="TOML or CSV")
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


#: Kind of a stroke by the quantity of its input; of several in a file, the first one is the input.
_INPUTS: dict[str, Kind] = {
    "force": "force",
    "torque": "torque",
    "motor angle": "motor_motion",
    "key displacement": "key_motion",
    "finger displacement": "motion",
}
_WANTED = (
    "a column force [N], torque [N m], motor angle [rad], key displacement [m], or "
    "displacement [m] (of the finger)"
)


@checked
def read_stroke_csv(path: str | Path, *, interpolation: Interpolation | None = None) -> Stroke:
    """Read a stroke from a file with the columns ``time [s]`` and, for example, ``force [N]``.

    The input is ``force``, ``torque``, ``motor angle``, ``key displacement`` or ``displacement``
    (of the finger), the first of them that the file has. Other columns are ignored. Separators,
    decimal commas and lines above the header are those of measured records
    (:func:`unmodeled.data.read_record`). The interpolation between rows is a monotone cubic; a
    spline for the two motions that are prescribed exactly; linear for a torque. Units are converted
    (``time [ms],displacement [mm]``). All faults are collected: a missing column or unit, cells
    that are not finite numbers, times that do not increase, gaps of more than five sample
    intervals.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message, with line numbers.
    """
    path = Path(path)
    from unmodeled.data.columns import read_columns
    from unmodeled.data.mapping import clock_column, values_in

    columns = read_columns(path, strict=False)
    faults: list[str] = []
    clock = clock_column(columns, guess=False)
    inputs = [(c, kind) for quantity, kind in _INPUTS.items() for c in columns.called(quantity)]
    if not clock:
        faults.append(f"expected a column time [s]; there are {columns}")
    if not inputs:
        faults.append(f"expected {_WANTED}; there are {columns}")
    column, kind = inputs[0] if inputs else ("", "force")
    series = {
        name: values_in(columns, name, si, faults)
        for name, si in ((clock, "s"), (column, UNITS[kind]))
        if name
    }
    rows = columns.faults(series, complete=True)
    faults += rows
    if clock and not rows:
        faults += _time_faults(
            [(columns.place(i), t) for i, t in enumerate(series[clock].tolist())]
        )
    if faults:
        raise DataError(fault_text(path.name, faults, most=20))
    usual = interpolation or usual_interpolation(kind)
    return table_of(kind, series[clock].tolist(), series[column].tolist(), usual, None, path.stem)


def _time_faults(time: list[tuple[str, float]]) -> list[str]:
    faults = []
    steps = [b[1] - a[1] for a, b in itertools.pairwise(time)]
    for (line, t), step in zip(time[1:], steps, strict=True):
        if step <= 0:
            faults.append(f"{line}: time {t:.9g} s does not follow {t - step:.9g} s; it must grow")
    if not faults and len(steps) > 20:
        usual = sorted(steps)[len(steps) // 2]
        for (line, t), step in zip(time[1:], steps, strict=True):
            if step > 5 * usual:
                faults.append(
                    f"{line}: gap of {step:.6g} s before {t:.6g} s; the usual step is "
                    f"{usual:.6g} s; fill it or cut the record there"
                )
    return faults
