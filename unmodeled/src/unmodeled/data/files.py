"""Records from files: text, MAT (version 5 or 7.3) and NetCDF, each with a small TOML file.

``strokes/forte.toml`` describes ``strokes/forte.csv``. Without it, columns are identified by their
names and have their units in the header, ``tip [mm]``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.arguments import checked
from unmodeled.chain.scales import unwrapped
from unmodeled.data.columns import MEASURED_FILES, read_columns
from unmodeled.data.logs import logs_of
from unmodeled.data.mapping import (
    Signals,
    clock_column,
    frame_column,
    run_column,
    sheet_for,
    unit_of_column,
    with_headed_units,
)
from unmodeled.data.records import Array, InputMode, Record, Sensor, StartPrior
from unmodeled.data.robots import log_of_columns, records_of
from unmodeled.data.series import Columns
from unmodeled.data.sheet import ColumnSpec, OutputSpec, ReadOptions, Sheet
from unmodeled.data.smoothing import start_of
from unmodeled.errors import DataError, InvalidParameter, merged, shortened, which_column
from unmodeled.files import is_file, read_toml, why_missing
from unmodeled.units import (
    PIXEL,
    conversion_factor,
    shows_gravity,
    spelled_unit,
    split_quantity,
    to_si,
    weight_hint,
    zero_and_factor,
)
from unmodeled.units.quantity import fault_text, validated

MOST_RUNS = 1000  # of a file
#: Smallest number of samples of a run that begins where the clock starts again.
SHORTEST_RUN = 2


@checked
def read(
    files: str | Path | Sequence[str | Path],
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    sigma: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    options: ReadOptions | None = None,
    model: Any = None,
) -> tuple[Record, ...]:
    r"""Read measured files: ``unmodeled.read("runs/*.csv")``.

    A model finds its inputs among the columns: they need no names here.

    Parameters
    ----------
    files
        A file, a pattern such as ``runs/*.csv``, a folder, or a list of these; see
        :func:`read_record`.
    inputs, outputs
        Columns that are inputs and outputs; default: every column but the clock is an output, and a
        single force is an input.
    sigma
        Standard deviation of the noise by column [SI unit]; default: as the TOML file states.
    units
        Units of columns whose header states none.
    options
        Options of reading.
    model
        Model for which they are read: its channels are found among the columns, and converted to
        its units. Without it, units become SI units.

    Raises
    ------
    DataError
        No file fits, or a file has faults, all listed in the message.

    Examples
    --------
    A force and a displacement, which become N and m:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import unmodeled
    >>> file = Path(tempfile.mkdtemp()) / "press.csv"
    >>> _ = file.write_text("t [ms],force [kN],x [mm]\n0,0,0\n1,2,1\n2,4,2\n")
    >>> (record,) = unmodeled.read(file, inputs=["force"], outputs=["x"])
    >>> record.inputs["force"].tolist(), record.outputs["x"].tolist()
    ([0.0, 2000.0, 4000.0], [0.0, 0.001, 0.002])
    """
    given = [files] if isinstance(files, str | Path) else list(files)
    paths = [p for g in given for p in _fitting(g)]
    options = options or ReadOptions()
    options = replace(options, units={**options.units, **(units or {})})
    if model is not None:
        signals = Signals.of(model)
        records = tuple(r for group in read_each(paths, signals, options) for r in group)
    elif outputs:
        records = read_records(paths, inputs=inputs, outputs=outputs, options=options)
    else:
        records = tuple(
            r.with_columns_as_inputs({n: n for n in inputs})
            for group in read_each(paths, options=options)
            for r in group
        )
    return tuple(r.with_noise(sigma) for r in records) if sigma else records


def _fitting(given: str | Path) -> list[Path]:
    """Files of a pattern or a folder; a file as it is."""
    path = Path(given)
    if path.is_dir() and logs_of(path) is not None:
        return [path]
    if path.is_dir():  # with other JSON files beside the measured ones
        there = path.iterdir()
    elif any(c in str(given) for c in "*?["):
        there = Path(path.anchor).glob(str(path.relative_to(path.anchor)))
    else:
        return [path]
    kinds = [k for k in MEASURED_FILES if not (path.is_dir() and k == ".json")]
    files = sorted(p for p in there if p.suffix.lower() in kinds)
    if not files:
        raise DataError(
            f"{shortened(str(given))}: no measured file ({', '.join(MEASURED_FILES)}) fits; the "
            f"folder is {Path.cwd()}"
        )
    return files


@checked
def read_records(
    paths: Sequence[str | Path],
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    modes: Mapping[InputMode, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    names: Mapping[str, Sequence[str]] | None = None,
    options: ReadOptions | None = None,
) -> tuple[Record, ...]:
    """Read several files; all faults are in one message. See :func:`read_record`.

    A file with several runs gives one record for each run, marked as repeats.

    Parameters
    ----------
    paths
        Files; a TOML file of the same name describes each.
    inputs
        Names of the inputs of the model.
    outputs
        Names of the outputs of the model.
    modes
        Input modes of the model.
    units
        SI units of inputs and outputs.
    names
        Other names of the signals in the columns.
    options
        Options of reading.
    """
    signals = Signals(inputs, outputs, modes or {}, units or {}, names or {})
    return tuple(r for group in read_each(paths, signals, options) for r in group)


def read_each(
    paths: Sequence[str | Path],
    signals: Signals | None = None,
    options: ReadOptions | None = None,
    kept: Mapping[Path, Columns] | None = None,
) -> tuple[tuple[Record, ...], ...]:
    """Records of each of several files; all faults are in one message.

    ``kept``: columns of files that were read before, and are not read again.
    """
    groups, faults = [], []
    signals, options = signals or Signals(), options or ReadOptions()
    for path in map(Path, paths):
        try:
            groups.append(_read_file(path, signals, options, (kept or {}).get(path)))
        except DataError as error:
            faults.append(str(error))
    if faults:
        raise DataError("\n".join(merged(faults)))
    if not groups:
        raise DataError("no measured files were given")
    return tuple(groups)


@checked
def read_record(
    path: str | Path,
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    modes: Mapping[InputMode, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    names: Mapping[str, Sequence[str]] | None = None,
    options: ReadOptions | None = None,
) -> Record:
    """Read one measured file.

    Parameters
    ----------
    path
        ``.csv``, ``.txt``, ``.tsv`` (comma, semicolon, tab or spaces; decimal point or comma; text
        above the header and lines with # are ignored; empty cells and nan are missing), also
        exports of Kinovea, Tracker and DeepLabCut, and of ROS bags; ``.mat``, ``.nc``, ``.h5``,
        ``.parquet``, ``.feather`` (also of LeRobot), ``.json`` (records, or lists), ``.jsonl``,
        ``.mcap``, ``.xlsx``, ``.tdms``; texts of instruments may end in ``.dat``, ``.asc``,
        ``.lvm``, ``.mot``, ``.sto`` or ``.tra``.
    inputs, outputs
        Names of the signals if there is no TOML file; they are also the names of the columns. All
        inputs must exist, and at least one of the outputs: the others were not measured. Without
        names, every column is an output, except the clock and a single column that is called a
        force.
    modes
        Further inputs by input mode; the first mode with all of its inputs in the file is used.
    units
        Units of the model by signal; without a TOML file, the header must state the units of the
        columns.
    names
        Other names by signal.
    options
        Options that replace the TOML file or the header.

    Raises
    ------
    DataError
        The file has faults, all listed in the message, or it holds several runs.

    Examples
    --------
    A file with a force and a position, by the names of its columns:

    >>> import tempfile
    >>> from pathlib import Path
    >>> from unmodeled.data import read_record
    >>> file = Path(tempfile.mkdtemp()) / "run.csv"
    >>> _ = file.write_text("t [s],force [N],x [m]" + chr(10) + "0,0,0" + chr(10) + "1,2,0.1")
    >>> read_record(file, inputs=["force"], outputs=["x"]).samples
    2
    """
    signals = Signals(inputs, outputs, modes or {}, units or {}, names or {})
    records = _read_file(Path(path), signals, options or ReadOptions())
    if len(records) > 1:
        raise DataError(f"{path}: holds {len(records)} runs, expected one; read_records reads them")
    return records[0]


def read_sheet(path: Path) -> Sheet | None:
    """The TOML file that describes a measured file; None if there is none."""
    beside = path.with_suffix(".toml") if path.name else path
    if not is_file(beside):
        return None
    raw = read_toml(beside)
    if "schema" in raw and "outputs" not in raw:
        return None  # another file of the same name
    sheet = validated(Sheet, raw, str(beside), DataError)
    if not sheet.outputs:
        raise DataError(f"{beside}: there is no table [outputs.NAME]: nothing to compare")
    return sheet


def _read_file(
    path: Path, signals: Signals, options: ReadOptions, columns: Columns | None = None
) -> tuple[Record, ...]:
    if (robot := _read_robot(path, signals, options)) is not None:
        return robot
    if not is_file(path):
        raise DataError(f"{path}: {why_missing(path)}")
    given = read_sheet(path)
    numbered = bool(options.columns) or given is not None
    columns = columns or read_columns(path, numbered=numbered)
    columns = replace(columns, notes=[*columns.notes])  # notes of this reading are added
    columns = with_headed_units(columns, signals, options)
    sheet = sheet_for(path, columns, signals, options, given)
    stated = given is not None and "likelihood" in given.model_fields_set
    if (stated or options.likelihood is not None) and not columns.likelihood:
        raise DataError(
            f"{path}: likelihood = {sheet.likelihood:g}, but the file has no likelihood of its "
            "points, expected a column such as tip_likelihood (0 to 1) beside tip_x and tip_y; "
            f"there are {columns}"
        )
    return build_records(path, sheet, columns, signals.units, guessed=given is None)


def _read_robot(path: Path, signals: Signals, options: ReadOptions) -> tuple[Record, ...] | None:
    """Records of the log of a robot; None: it is none, or its columns were assigned."""
    is_table = is_file(path) and path.suffix.lower() in MEASURED_FILES
    other = path.suffix.lower() != ".json" and not signals.joints
    if is_table and (other or read_sheet(path) is not None):
        return None
    logs = logs_of(path) if is_table or path.exists() else None
    if logs is None and is_table and not options.columns:
        columns = read_columns(path, strict=False)
        clock = clock_column(columns)
        if not clock or run_column(columns):
            return None
        time = _clock(Sheet(time=clock), columns, [])
        others = {c: v for c, v in columns.values.items() if c != clock}
        log = log_of_columns(path.stem, others, time, signals.joints, columns.units)
        logs = None if log is None else [log]
    if logs is None:
        return None
    given = {"columns": options.columns, "units": options.units}
    records, table = records_of(path, logs, signals.joints, **given)
    if signals.tell is not None:
        signals.tell(path, table)
    return records


def build_records(
    path: Path, sheet: Sheet, columns: Columns, model: Mapping[str, str], *, guessed: bool
) -> tuple[Record, ...]:
    """Records of a file, one for each run. ``model``: units of the signals in the model."""
    faults: list[str] = []
    specs: dict[str, ColumnSpec] = {**sheet.inputs, **sheet.outputs}
    read = {n: _series(n, s, sheet, columns, model.get(n, ""), faults) for n, s in specs.items()}
    time = _clock(sheet, columns, faults)
    sensors = {n: _sensor(n, s, read[n][1], faults) for n, s in sheet.outputs.items()}
    start = _start(sheet, faults)
    headed = {n: _stated_unit(n, s, columns) for n, s in specs.items()}
    units = {n: unit for n, (_, unit) in read.items()}
    notes = [*columns.notes, *_unlikely(sheet, columns), *_notes_of_units(headed, units)]
    bare = [n for n, s in specs.items() if guessed and not (s.si or s.scale != "" or headed[n])]
    notes += [_ASSUMED.format(", ".join(bare))] * bool(bare)
    parts = [] if faults else _runs(sheet, columns, time, faults)
    if faults:
        raise DataError(fault_text(str(path), faults))
    run = _Run(sheet, read, headed, sensors, start, notes, sheet.source or columns.source)
    base = sheet.name or path.stem
    records = []
    for label, rows in parts:
        at = rows[sheet.first : sheet.last : sheet.every]
        if fault := _backward(columns, time, at):
            raise DataError(f"{path}: {fault}")
        several = len(parts) > 1
        try:
            made = run.record(f"{base}-{label}" if several else base, time[at], at)
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
        records.append(replace(made, repeats=sheet.repeats or (base if several else "")))
    return tuple(records)


@dataclass(frozen=True)
class _Run:
    """What is known of all runs of a file."""

    sheet: Sheet
    read: Mapping[str, tuple[Array, str]]
    """Values and unit of each signal."""
    headed: Mapping[str, str]
    """Unit of each signal in the file; "" if it is not stated."""
    sensors: Mapping[str, Sensor]
    start: StartPrior | None
    notes: Sequence[str]
    source: str

    def record(self, name: str, time: Array, at: NDArray[np.intp]) -> Record:
        """Record of the samples of one run."""
        sheet = self.sheet

        def values(signal: str, spec: ColumnSpec) -> Array:
            series = self.read[signal][0][at]
            return series - start_of(series) if spec.origin == "start" else series

        units = {n: self.read[n][1] for n in sheet.inputs}
        record = Record(
            name=name,
            time=time,
            inputs={n: values(n, s) for n, s in sheet.inputs.items()},
            outputs={n: values(n, s) for n, s in sheet.outputs.items()},
            sensors=self.sensors,
            input_mode=sheet.input_mode,
            input_units={n: u for n, u in units.items() if u not in ("", "1") or self.headed[n]},
            input_sigma={n: s.sigma for n, s in sheet.inputs.items() if s.sigma},
            input_correlation_time={
                n: s.correlation_time for n, s in sheet.inputs.items() if s.correlation_time
            },
            conditions=sheet.conditions,
            role=sheet.role,
            start=self.start,
            source=self.source,
            notes=tuple(self.notes),
        )
        return _acted(sheet, record)


def _sensor(name: str, spec: OutputSpec, unit: str, faults: list[str]) -> Sensor:
    """Sensor of an output."""
    fields = spec.model_dump(exclude=set(ColumnSpec.model_fields), exclude_none=True)
    try:
        return Sensor(name=name, unit=unit or "1", **fields)
    except DataError as error:
        faults.append(str(error))
        return Sensor(name=name)


def _start(sheet: Sheet, faults: list[str]) -> StartPrior | None:
    """Prior of the start state; None: that of the model."""
    if not sheet.start and sheet.start_known:
        return None
    mean, sd = ({k: v[i] for k, v in sheet.start.items()} for i in (0, 1))
    try:
        return StartPrior(mean=mean, sd=sd, known=sheet.start_known)
    except DataError as error:
        faults.append(str(error))
        return None


def _stated_unit(name: str, spec: ColumnSpec, columns: Columns) -> str:
    """Unit of a signal in the file; "" if it is not stated."""
    return unit_of_column(columns, columns.find(spec.column or name), spec.unit)


def _notes_of_units(headed: Mapping[str, str], units: Mapping[str, str]) -> Iterator[str]:
    """Notes of conversions that are not between units of one quantity."""
    weights = [n for n, unit in units.items() if weight_hint(headed[n] or "1", unit)]
    gravity = [n for n in weights if shows_gravity(headed[n], units[n])]
    if gravity:
        yield f"{', '.join(gravity)}: an accelerometer in g; 1 g is 9.80665 m/s^2"
    if names := [n for n in weights if n not in gravity]:
        yield f"{', '.join(names)}: a scale in g or kg shows a force; 1 g is 9.80665 mN"
    if names := [n for n, unit in units.items() if (headed[n], unit) == ("%", "1")]:
        yield (
            f"{', '.join(names)}: percent in the file become fractions, 45 % is 0.45 (a model "
            "that states the unit % for this signal gets percent)"
        )


_ASSUMED = (
    "{}: no unit in the header; the numbers are taken as they stand, in SI units (--unit "
    "NAME=UNIT, in Python units of ReadOptions)"
)


def _backward(columns: Columns, time: Array, at: NDArray[np.intp]) -> str:
    """Where the clock of a text file is missing or does not increase; "" if nowhere."""
    if columns.lines is None:
        return ""
    blank = np.flatnonzero(~np.isfinite(time[at]))
    if blank.size:
        return f"line {columns.lines[at[blank[0]]]}: no time"
    wrong = np.flatnonzero(np.diff(time[at]) <= 0.0)
    if not wrong.size:
        return ""
    before, here = at[wrong[0]], at[wrong[0] + 1]
    more = f" (and {wrong.size - 1} times more)" if wrong.size > 1 else ""
    return (
        f"line {columns.lines[here]}: time does not increase, from {time[before]:.10g} s to "
        f"{time[here]:.10g} s{more}"
    )


def _acted(sheet: Sheet, record: Record) -> Record:
    """The record with the true inputs, if the sensors of the inputs are specified."""
    for name, spec in sheet.inputs.items():
        errors = spec.model_dump(include={"delay", "gain", "offset", "bandwidth", "faults"})
        record = record.with_sensed_input(
            name, **{k: v for k, v in errors.items() if v is not None}
        )
    return record


def _fault_of_scale(spec: ColumnSpec, unit: str) -> str:
    """Why the size of one unit of a column is not known; "": it is."""
    if spec.scale == "" and unit == PIXEL:
        return (
            ' is in pixels: how large is one? (scale = "0.21 mm" in the TOML, or --scale 0.21mm, '
            "in Python scales of ReadOptions)"
        )
    if spec.scale != "" and _scale(spec.scale) is None:
        return (
            f": scale = {shortened(repr(spec.scale))}, expected what one {unit or 'unit'} is, such "
            "as 0.21mm or 360deg/4096, or the distance of two points, such as "
            '"210 mm from 120 340 to 412 338"'
        )
    return ""


def _series(
    name: str, spec: ColumnSpec, sheet: Sheet, columns: Columns, model: str, faults: list[str]
) -> tuple[Array, str]:
    """Values of a signal and their unit. ``model``: unit of the signal in the model."""
    empty = np.zeros(0), ""
    key = columns.find(spec.column or name)
    shown = shortened(spec.column or name)
    if not key:
        which = "" if spec.column else f" ({which_column(shown)})"
        faults.append(f"no column {shown!r}{which}; there are {columns}")
        return empty
    unit = unit_of_column(columns, key, spec.unit)
    if unscaled := _fault_of_scale(spec, unit):
        faults.append(f"column {shown}{unscaled}")
        return empty
    scale, down = 1.0, bool(spec.down)
    if (size := _scale(spec.scale)) is not None:
        down = name.endswith(".y") and unit == PIXEL if spec.down is None else down
        scale, unit = size
    converted = conversion(unit, spec.si, model)
    if converted is None:
        expected = "give its si and factor"
        if spec.si:
            expected = f"expected one of {spec.si}{weight_hint(unit, spec.si)}"
        faults.append(f"column {shown}: unit {shortened(unit)!r} is unknown; {expected}")
        return empty
    zero, factor, si = converted
    values = columns.values[key]
    if spec.period != "":
        period = _period(spec.period, unit)
        if period is None:
            faults.append(
                f"column {shown}: period = {shortened(repr(spec.period))}, expected a number > 0 "
                f"in {unit or 'the unit of the file'}, or with a unit, such as 360deg"
            )
            return empty
        values = unwrapped(values, period)
    if isinstance(spec.origin, float) and spec.origin != 0.0:
        values = values - spec.origin
    elif zero:
        values = values - zero / scale  # a difference from an origin has no zero
    with np.errstate(over="ignore", invalid="ignore"):  # the record reports infinite values
        values = values * (-factor if down else factor) * scale * spec.factor + spec.shift
    trust = columns.likelihood.get(key)
    if trust is not None:
        values = np.where(_likely(sheet, columns, trust), values, np.nan)
    if sheet.missing:
        values = np.where(np.isin(columns.values[key], sheet.missing), np.nan, values)
    return values, si


def _likely(sheet: Sheet, columns: Columns, trust: str) -> NDArray[np.bool_]:
    """Which samples of a point of a tracker have a sufficient likelihood."""
    return np.asarray(columns.values[trust] >= sheet.likelihood)


def _unlikely(sheet: Sheet, columns: Columns) -> list[str]:
    """One note for each point of a tracker whose samples are left out in part."""
    specs = (*sheet.inputs.items(), *sheet.outputs.items())
    used = (columns.likelihood.get(columns.find(s.column or n)) for n, s in specs)
    notes = []
    for trust in dict.fromkeys(t for t in used if t is not None):
        likely = _likely(sheet, columns, trust)
        if not likely.all():
            notes.append(
                f"{np.sum(~likely)} of {likely.size} points are left out, because {trust} is below "
                f"{sheet.likelihood:g} (likelihood in the TOML, --likelihood NUMBER, in Python "
                "likelihood of ReadOptions)"
            )
    return notes


def _period(period: float | str, unit: str) -> float | None:
    """Period in the unit of the file; None if it is none."""
    length, unit_of_period = (
        split_quantity(period) or (math.nan, "") if isinstance(period, str) else (period, "")
    )
    try:
        length *= conversion_factor(unit_of_period, unit or "1") if unit_of_period else 1.0
    except InvalidParameter:
        return None
    return length if 0.0 < length < math.inf else None


#: A length, and two points of the picture that are so far apart.
_TWO_POINTS = re.compile(
    r"(?P<length>.+?)\s+from\s+(?P<x0>[^\s,;]+)[\s,;]+(?P<y0>[^\s,;]+)"
    r"\s+to\s+(?P<x1>[^\s,;]+)[\s,;]+(?P<y1>[^\s,;]+)"
)

#: ``360deg/4096``: the size of one of several equal parts.
_COUNTED = re.compile(r"(?P<size>.*[^\d\s./])\s*/\s*(?P<count>\d+(?:\.\d*)?)")


def _scale(scale: float | str) -> tuple[float, str] | None:
    """Size and unit of one unit of the file; a bare number is in meters."""
    if not isinstance(scale, str):
        return float(scale), "m"
    apart = 1.0
    if points := _TWO_POINTS.fullmatch(scale.strip()):
        try:
            x0, y0, x1, y1 = (float(points[k]) for k in ("x0", "y0", "x1", "y1"))
        except ValueError:
            return None
        scale, apart = points["length"], math.hypot(x1 - x0, y1 - y0)
    elif counted := _COUNTED.fullmatch(scale.strip()):
        scale, apart = counted["size"], float(counted["count"])
    quantity = split_quantity(scale)
    if quantity is None or not (
        math.isfinite(quantity[0]) and quantity[0] and 0.0 < apart < math.inf
    ):
        return None
    return quantity[0] / apart, quantity[1] or "m"


#: Units of clocks that count from 1970, with a value that the larger units do not reach before the
#: year 5000.
_EPOCH = {"ns": (1e17, 1e-9), "us": (1e14, 1e-6), "ms": (1e11, 1e-3)}


def _clock(sheet: Sheet, columns: Columns, faults: list[str]) -> Array:
    """Times of the samples [s]."""
    if sheet.interval is not None:
        if not sheet.interval > 0.0:
            faults.append(f"interval = {sheet.interval!r}, expected > 0 [s]")
        length = max((v.size for v in columns.values.values()), default=0)
        with np.errstate(over="ignore"):
            return np.arange(length, dtype=np.float64) * float(sheet.interval)
    name = clock_column(columns, sheet.time)
    if not name:
        faults.append(f"{_without_clock(sheet, columns)}; there are {columns}")
        return np.zeros(0)
    unit = unit_of_column(columns, name, sheet.time_unit)
    if name == columns.unnamed and not sheet.time:
        columns.notes.append(
            f"{name} has no name in the header and is taken as the clock in {unit or 's'}"
        )
    frames = name == frame_column(columns) and not columns.units.get(name)
    if sheet.frame_rate is not None:
        number = columns.values[name] if frames else _steps_of(columns.values[name])
        return number / sheet.frame_rate
    if frames and not sheet.time_unit:
        faults.append(
            f"the clock {shortened(name)} counts frames: how many are a second? (frame_rate in "
            "the TOML, --frame-rate HZ, in Python frame_rate of ReadOptions)"
        )
        return np.zeros(0)
    return _seconds(name, unit, columns, faults)


def _steps_of(clock: Array) -> Array:
    """Number of each frame of a video that plays at another frame rate."""
    steps = np.diff(clock)
    forward = steps[steps > 0.0]
    number: Array = np.round((clock - clock[0]) / (np.median(forward) if forward.size else 1.0))
    return number


def _seconds(name: str, unit: str, columns: Columns, faults: list[str]) -> Array:
    """Clock in seconds; one since 1970, in ms or less, starts at zero."""
    values = columns.values[name]
    first = float(values[0]) if values.size and not unit else 0.0
    for epoch, (least, size) in _EPOCH.items():
        if first > least:
            columns.notes.append(
                f"{shortened(name)} counts {epoch} since 1970: zero is its first value"
            )
            return (values - first) * size
    try:
        factor = conversion_factor(unit or "s", "s")
    except InvalidParameter:
        faults.append(f"column {shortened(name)}: unit {shortened(unit)!r} is no time")
        return np.zeros(0)
    with np.errstate(over="ignore"):
        return values * factor


def _without_clock(sheet: Sheet, columns: Columns) -> str:
    """Sentence about a file without a clock."""
    if sheet.time:
        return f"no column {shortened(sheet.time)!r} for the clock"
    way = (
        "name the column of the time in the header, time [s], or with --column time=COLUMN (time "
        "in the TOML, in Python columns of ReadOptions)"
    )
    if columns.unnamed:
        why = columns.no_clock(columns.unnamed)
        return f"{columns.unnamed} has no name in the header and cannot be the clock ({why}): {way}"
    return f"no column is the clock: {way}"


def _runs(
    sheet: Sheet, columns: Columns, time: Array, faults: list[str]
) -> list[tuple[str, NDArray[np.intp]]]:
    """Samples of each run of a file, by its label."""
    rows = np.arange(time.size)
    name = run_column(columns, sheet.run)
    if sheet.run and not name:
        faults.append(f"no column {shortened(sheet.run)!r} for the runs; there are {columns}")
        return []
    with np.errstate(invalid="ignore"):
        steps = np.diff(time)
        if np.sum(steps < 0.0) > 0.5 * steps.size:
            faults.append(f"time decreases, from {time[0]:.10g} s to {time[-1]:.10g} s")
            return []
        # A clock that starts again, as opposed to a clock with an error.
        again = np.flatnonzero((steps < 0.0) & (time[1:] - time[0] < 0.5 * (time[:-1] - time[0])))
    if name and (sheet.run or np.any(steps <= 0.0)):
        if name in columns.texts:
            number = np.array(columns.texts[name])
            labels = [*dict.fromkeys(columns.texts[name])]
        else:
            number = columns.values[name]
            labels = [n for n in dict.fromkeys(number.tolist()) if math.isfinite(n)]
        if len(labels) > MOST_RUNS:
            faults.append(
                f"{len(labels)} runs in column {shortened(name)}; the limit is {MOST_RUNS}"
            )
            return []
        return [
            (label if isinstance(label, str) else f"{label:g}", rows[number == label])
            for label in labels
        ]
    if not again.size or min(np.diff([0, *(again + 1), rows.size])) < SHORTEST_RUN:
        return [("1", rows)]  # a shorter run is an error of the clock, which is told
    if again.size >= MOST_RUNS:
        faults.append(f"the clock starts {again.size + 1} times; the limit is {MOST_RUNS} runs")
        return []
    parts = np.split(rows, again + 1)
    return [(str(k), part) for k, part in enumerate(parts, 1)]


def _is_unit_of(unit: str, wanted: str) -> bool:
    try:
        conversion_factor(unit, spelled_unit(wanted) or wanted)
    except InvalidParameter:
        return False
    return True


def conversion(unit: str, si: str, model: str) -> tuple[float, float, str] | None:
    """Zero, factor and unit of the record; None if the unit is unknown, or does not measure ``si``.

    The unit is ``si`` if it is stated, else that of the model if it measures the same, else SI.
    """
    if not unit:
        return 0.0, 1.0, si or "1"
    wanted = si or model
    if unit in ("C", "F") and wanted and not _is_unit_of(unit, wanted):
        unit = f"deg{unit}"  # a temperature, not a charge or a capacitance
    if shows_gravity(unit, wanted):
        return 0.0, conversion_factor("gn", wanted), wanted
    if wanted and weight_hint(unit, wanted):  # a scale in g shows a force
        return 0.0, to_si(unit)[0] * conversion_factor("kgf", wanted), wanted
    try:
        if wanted:
            return (*zero_and_factor(unit, spelled_unit(wanted) or wanted), wanted)
    except InvalidParameter:
        if si:
            return None
    try:
        return (0.0, *to_si(unit))
    except InvalidParameter:
        return None
