"""Records from files: CSV, MAT (version 5 or 7.3) and NetCDF, with a small TOML beside them.

``strokes/forte.csv`` is described by ``strokes/forte.toml``; without it every column must be
called for by name and has its unit in the header, ``hammer [mm]``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from feltmb.data.columns import Columns, read_columns
from feltmb.data.records import Array, InputMode, Record, Role, Sensor, StartPrior
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import is_file, read_toml, why_missing
from feltmb.units import conversion_factor
from feltmb.units.quantity import Schema, fault_lines, fault_text, shortened

__all__ = ["read_record", "read_records", "write_record"]


class _Column(Schema):
    """A column of the file: where it is and in what unit."""

    column: str = ""
    """Name in the file; default: that of the signal."""
    unit: str = ""
    """Unit in the file; default: that of the header, else SI."""
    factor: float = 1.0
    """Multiplies the values after the unit."""
    shift: float = 0.0
    """Added after the factor [unit of the model]."""
    si: str = ""
    """Unit of the model; default: the SI unit of the same quantity, or the unit itself."""


class _Input(_Column):
    sigma: Annotated[float, Field(ge=0.0)] = 0.0
    correlation_time: Annotated[float, Field(ge=0.0)] = 0.0


class _Output(_Column):
    sigma: float | None = None
    quantum: float = 0.0
    delay: float = 0.0
    bandwidth: float | None = None
    gain: float = 1.0
    offset: float = 0.0
    correlation_time: float = 0.0
    gain_sd: float = 0.0
    offset_sd: float = 0.0
    delay_sd: float = 0.0
    point: str = ""
    axis: str = ""


class _Sheet(Schema):
    """The TOML beside a measured file."""

    name: str = ""
    role: Literal["fit", "held_out"] = "fit"
    input_mode: Literal["force", "motion"] = "force"
    repeats: str = ""
    source: str = ""
    time: str = ""
    """Column of the clock; default: time or t, else the first."""
    interval: float | None = None
    """Step of the clock [s] if the file has none."""
    first: int = 0
    """First sample that is used."""
    last: int | None = None
    """Sample before which to stop; negative counts from the end."""
    every: Annotated[int, Field(ge=1)] = 1
    """Use every so-manyth sample."""
    inputs: dict[str, _Input] = {}
    outputs: dict[str, _Output] = {}
    start: dict[str, tuple[float, float]] = {}
    """State -> (mean, standard deviation) at the first sample [SI]."""
    conditions: dict[str, float | str] = {}


def read_records(
    paths: Sequence[str | Path],
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    modes: Mapping[InputMode, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
) -> tuple[Record, ...]:
    """Read several files; all faults in one message. See :func:`read_record`."""
    found, faults = [], []
    for path in paths:
        try:
            found.append(
                read_record(path, inputs=inputs, outputs=outputs, modes=modes, units=units)
            )
        except DataError as error:
            faults.append(str(error))
    if faults:
        raise DataError("\n".join(faults))
    if not found:
        raise DataError("no measured files were given")
    return tuple(found)


def read_record(
    path: str | Path,
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    modes: Mapping[InputMode, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
) -> Record:
    """Read one measured file.

    Parameters
    ----------
    path
        ``.csv`` (comma, semicolon or tab; lines with # are comments; empty cells and nan are
        missing), ``.mat``, ``.nc``.
    inputs, outputs
        Names of the signals when there is no TOML beside the file; they are columns then. All
        inputs must be there, and one of the outputs: the others were not measured.
    modes
        Further inputs by input mode; the first mode whose inputs the file has counts.
    units
        Units of the model by signal: without TOML their columns must say theirs in the header.

    Raises
    ------
    DataError
        With every fault of the file.
    """
    path = Path(path)
    if not is_file(path):
        raise DataError(f"{path}: {why_missing(path)}")
    beside = path.with_suffix(".toml")
    if is_file(beside):
        raw = read_toml(beside)
        try:
            sheet = _Sheet.model_validate(raw)
        except ValidationError as error:
            raise DataError(fault_text(str(beside), fault_lines(error, _Sheet))) from None
        if not sheet.outputs:
            raise DataError(f"{beside}: there is no table [outputs.NAME]: nothing to compare")
    else:
        if not outputs:
            raise DataError(
                f"{path}: there is no {beside.name} beside it that says which columns are inputs "
                "and outputs; write one, or name them"
            )
        columns = read_columns(path)
        sheet = _plain_sheet(path, columns, inputs, outputs, modes or {}, units or {})
        return _build(path, sheet, columns)
    return _build(path, sheet, read_columns(path))


def _plain_sheet(
    path: Path,
    columns: Columns,
    inputs: Sequence[str],
    outputs: Sequence[str],
    modes: Mapping[InputMode, Sequence[str]],
    units: Mapping[str, str],
) -> _Sheet:
    """What a file without a sheet says by the names of its columns."""
    there = columns.values
    fitting = [m for m, names in modes.items() if all(n in there for n in names)]
    faults = []
    if modes and not fitting:
        wanted = " or ".join(" and ".join(names) for names in modes.values())
        faults.append(f"no column {wanted} for the input; there are {columns}")
    if not any(n in there for n in outputs):
        faults.append(f"none of the outputs {', '.join(outputs)}; there are {columns}")
    for name in there:
        unit = units.get(name, "1")
        if unit != "1" and not columns.units.get(name):
            faults.append(f"column {name} has no unit in the header, expected such as [{unit}]")
    if faults:
        raise DataError(fault_text(str(path), faults))
    mode: InputMode = next(iter([*fitting, *modes]), "force")
    seen = [n for n in outputs if n in there]
    return _Sheet(
        input_mode=mode,
        inputs={n: _Input() for n in (*inputs, *modes.get(mode, tuple[str, ...]()))},
        outputs={n: _Output() for n in seen},
    )


def _build(path: Path, sheet: _Sheet, columns: Columns) -> Record:
    faults: list[str] = []

    def find(name: str, spec: _Column) -> tuple[Array, str]:
        key = spec.column or name
        shown = shortened(key)
        if key not in columns.values:
            faults.append(f"no column {shown!r}; there are {columns}")
            return np.zeros(0), ""
        unit = spec.unit or columns.units.get(key, "")
        factor, si = _to_si(unit, spec.si)
        if factor is None:
            expected = f"expected one of {spec.si}" if spec.si else "give its si and factor"
            faults.append(f"column {shown}: unit {shortened(unit)!r} is unknown; {expected}")
            return np.zeros(0), ""
        with np.errstate(over="ignore", invalid="ignore"):  # the record tells of what is infinite
            return columns.values[key] * factor * spec.factor + spec.shift, si

    part = slice(sheet.first, sheet.last, sheet.every)
    read_in = {n: find(n, s) for n, s in sheet.inputs.items()}
    read_out = {n: find(n, s) for n, s in sheet.outputs.items()}
    time = _clock(sheet, columns, faults)
    sensors = {}
    for name, spec in sheet.outputs.items():
        fields = spec.model_dump(exclude={"column", "unit", "factor", "shift", "si"})
        if fields["bandwidth"] is None:
            fields.pop("bandwidth")
        try:
            sensors[name] = Sensor(name=name, unit=read_out[name][1] or "1", **fields)
        except DataError as error:
            faults.append(str(error))
    start = None
    if sheet.start:
        try:
            start = StartPrior(
                mean={k: v[0] for k, v in sheet.start.items()},
                sd={k: v[1] for k, v in sheet.start.items()},
            )
        except DataError as error:
            faults.append(str(error))
    if faults:
        raise DataError(fault_text(str(path), faults))
    role: Role = sheet.role
    mode: InputMode = sheet.input_mode
    try:
        return Record(
            name=sheet.name or path.stem,
            time=time[part],
            inputs={n: v[part] for n, (v, _) in read_in.items()},
            outputs={n: v[part] for n, (v, _) in read_out.items()},
            sensors=sensors,
            input_mode=mode,
            input_units={n: unit for n, (_, unit) in read_in.items() if unit not in ("", "1")},
            input_sigma={n: s.sigma for n, s in sheet.inputs.items() if s.sigma > 0.0},
            input_correlation_time={
                n: s.correlation_time for n, s in sheet.inputs.items() if s.correlation_time > 0.0
            },
            conditions=sheet.conditions,
            role=role,
            start=start,
            repeats=sheet.repeats,
            source=sheet.source,
        )
    except DataError as error:
        raise DataError(f"{path}: {error}") from None


def _clock(sheet: _Sheet, columns: Columns, faults: list[str]) -> Array:
    length = max((v.size for v in columns.values.values()), default=0)
    if sheet.interval is not None:
        if not sheet.interval > 0.0:
            faults.append(f"interval = {sheet.interval!r}, expected > 0 [s]")
        with np.errstate(over="ignore"):
            return np.arange(length, dtype=np.float64) * float(sheet.interval)
    name = sheet.time
    if not name:
        name = next((n for n in ("time", "t", "Time", "T") if n in columns.values), "")
        name = name or next(iter(columns.values), "")
    if name not in columns.values:
        faults.append(f"no column {shortened(name)!r} for the clock; there are {columns}")
        return np.zeros(0)
    unit = columns.units.get(name, "") or "s"
    factor, _ = _to_si(unit, "s")
    if factor is None:
        faults.append(f"column {shortened(name)}: unit {shortened(unit)!r} is no time")
        return np.zeros(0)
    with np.errstate(over="ignore"):
        return columns.values[name] * factor


#: Units whose SI form keeps its name in reports.
_SI = ("m", "kg", "s", "rad", "Hz", "N", "Pa", "J", "m/s", "m/s^2", "rad/s", "N m", "1")
#: Units of other fields, taken as they stand.
_OTHERS = ("V", "A", "ohm", "W", "K", "degC", "T", "Pa s", "%", "dB", "counts")


def _to_si(unit: str, si: str) -> tuple[float | None, str]:
    """Factor to SI and its unit; units of other fields (V, degC) stay as they are."""
    if not unit:
        return 1.0, si or "1"
    for target in (si,) if si else _SI:
        try:
            return conversion_factor(unit, target), target
        except (InvalidParameter, ValueError):
            continue
    if (si and si != unit) or (not si and unit not in _OTHERS):
        return None, si
    return 1.0, unit


def write_record(record: Record, path: str | Path, *, force: bool = False) -> Path:
    """Write a record as CSV with its TOML beside it, so that :func:`read_record` returns it."""
    import tomlkit

    from feltmb.files import write_text

    path = Path(path)
    names = ["time", *record.inputs, *record.outputs]
    units = ["s", *(record.input_units.get(n, "") for n in record.inputs)]
    units += [record.sensors[n].unit for n in record.outputs]
    head = [f"{n} [{u}]" if u and u != "1" else n for n, u in zip(names, units, strict=True)]
    table = np.column_stack([record.time, *record.inputs.values(), *record.outputs.values()])
    lines = [",".join(head)]
    lines += [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in table]
    sheet: dict[str, Any] = {
        "name": record.name,
        "role": record.role,
        "input_mode": record.input_mode,
    }
    for key in ("repeats", "source"):
        if getattr(record, key):
            sheet[key] = getattr(record, key)
    sheet["inputs"] = {
        n: {
            k: v
            for k, v in (
                ("sigma", record.input_sigma.get(n, 0.0)),
                ("correlation_time", record.input_correlation_time.get(n, 0.0)),
            )
            if v
        }
        for n in record.inputs
    }
    plain = Sensor(name="")
    sheet["outputs"] = {}
    for n, sensor in record.sensors.items():
        fields = {
            k: getattr(sensor, k)
            for k in _Output.model_fields
            if k in Sensor.__dataclass_fields__ and getattr(sensor, k) != getattr(plain, k)
        }
        fields.pop("unit", None)
        sheet["outputs"][n] = {k: v for k, v in fields.items() if v is not None}
    if record.start is not None:
        sheet["start"] = {
            k: [float(record.start.mean.get(k, 0.0)), float(record.start.sd.get(k, 1e300))]
            for k in {**record.start.mean, **record.start.sd}
        }
    if record.conditions:
        sheet["conditions"] = dict(record.conditions)
    write_text(path, "\n".join(lines) + "\n", force=force)
    write_text(path.with_suffix(".toml"), tomlkit.dumps(sheet), force=force)
    return path
