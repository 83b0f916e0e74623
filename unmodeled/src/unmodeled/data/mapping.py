"""Assignment of columns of a measured file to signals of a model: specified, or by name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from unmodeled.data.records import Array, InputMode
from unmodeled.data.robots import Joint, Tell
from unmodeled.data.series import Columns
from unmodeled.data.sheet import InputSpec, OutputSpec, ReadOptions, Sheet
from unmodeled.data.tables import plain_name
from unmodeled.errors import DataError, InvalidParameter, shortened, which_column
from unmodeled.units import PIXEL, conversion_factor, spelled_unit, zero_and_factor
from unmodeled.units.quantity import fault_text, validated

_FRAMES = ("frame", "frames", "frameno", "framenumber", "bild")
_RUNS = ("run", "runno", "runnumber", "trial", "repeat", "repetition", "take", "specimen", "test",
         "episode", "episodeindex")  # fmt: skip
#: Quantity of an input by its SI unit.
_QUANTITIES = {"N": "force", "m": "displacement"}


@dataclass(frozen=True)
class Signals:
    """Names and units of the channels of a model."""

    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    modes: Mapping[InputMode, Sequence[str]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Other names."""
    any_inputs: bool = False
    """Whether every column that is no output is an input of its name."""
    joints: Sequence[Joint] = ()
    """Joints of a robot, to which those of a log are assigned."""
    tell: Tell | None = field(default=None, compare=False)
    """Function that gets the table of what was assigned."""

    @classmethod
    def of(cls, model: Any, tell: Tell | None = None) -> Signals:
        """Those of a model."""
        return cls(model.inputs, model.outputs, model.input_modes, model.units, model.input_names,
                   model.any_inputs, model.joints, tell)  # fmt: skip

    def is_input(self, name: str) -> bool:
        """Whether a signal is an input of the model."""
        return name in self.inputs or any(name in names for names in self.modes.values())


def clock_column(columns: Columns, specified: str = "", *, guess: bool = True) -> str:
    """Column of the clock; "" if there is none.

    It is named time, or it is a first column without a name whose values can be a clock. ``guess``:
    without them, the frames, or a first column whose unit measures time.
    """
    if specified:
        return columns.find(specified)
    if columns.unnamed and not columns.frames and not columns.no_clock(columns.unnamed):
        return columns.unnamed  # there is no column named time beside it
    named = columns.called("time")
    wrong = {c for c in named if columns.units.get(c) and not _measures(columns.units[c], "s")}
    clocks = [c for c in named if c not in wrong] or named
    exact = [n for n in ("time", "t", "Time", "T") if n in clocks]
    if exact or len(clocks) == 1 or not guess:
        return next(iter([*exact, *clocks]), "")
    if frames := frame_column(columns):
        return frames
    first = next(iter(columns.values), "")
    timed = [first] if _measures(columns.units.get(first, ""), "s") else []
    return next(iter(clocks or timed), "")


def frame_column(columns: Columns) -> str:
    """Column that counts frames; "" if there is none."""
    return columns.frames or _one_of(columns, _FRAMES)


def run_column(columns: Columns, specified: str = "") -> str:
    """Column that numbers or names the runs; "" if there is none."""
    if specified:
        return columns.find(specified) or (specified if specified in columns.texts else "")
    return _one_of(columns, _RUNS, columns.texts)


def _one_of(columns: Columns, words: Sequence[str], texts: Iterable[str] = ()) -> str:
    matches = [c for c in (*columns.values, *texts) if plain_name(c) in words]
    return matches[0] if len(matches) == 1 else ""


def unit_of_column(columns: Columns, column: str, specified: str = "") -> str:
    """Unit of a column; an unknown unit is kept, "" if there is none."""
    return _spelled(specified or columns.units.get(column, ""))


def _spelled(unit: str) -> str:
    return spelled_unit(unit) or unit


def values_in(columns: Columns, column: str, si: str, faults: list[str]) -> Array:
    """Values of a column in an SI unit; a fault if its unit is missing or measures another one."""
    unit = unit_of_column(columns, column) or ("1" if si == "1" else "")
    values = columns.values[column]
    heading = shortened(columns.headings.get(column, column))
    if not unit:
        faults.append(f"column {heading} states no unit; write '{shortened(column)} [{si}]'")
        return values
    try:
        factor = conversion_factor(unit, si)
    except InvalidParameter as error:
        faults.append(f"column {heading}: {error}")
        return values
    with np.errstate(over="ignore"):
        converted = values * factor
    if np.any(np.isinf(converted) & np.isfinite(values)):
        faults.append(f"column {heading}: holds a value beyond 1.8e308 {si}")
    return converted


def sheet_for(
    path: Path, columns: Columns, signals: Signals, options: ReadOptions, given: Sheet | None
) -> Sheet:
    """Description of a file: its TOML file or a guess, changed by the options.

    Raises
    ------
    DataError
        A required signal is missing or ambiguous.
    """
    options = _with_clock(columns, options, "" if given is None else given.time)
    if given is not None:
        sheet = given
    elif signals.outputs:
        sheet = _of_model(path, columns, signals, options)
    else:
        sheet = _of_columns(path, columns, options)
    return _changed(path, sheet, columns, signals, options)


def _headed(
    columns: Columns, signals: Signals, options: ReadOptions, assigned: Mapping[str, str]
) -> Iterator[tuple[str, tuple[str, str]]]:
    """Columns whose name ends with a unit; their channel, and the unit."""
    channel_of = {plain_name(n): n for n in (*signals.inputs, *signals.outputs)}
    taken = {plain_name(c) for c in columns.values} | {*options.columns}
    for column in columns.values:
        name, _, unit = column.rpartition("_" if "_" in column else " ")
        channel = assigned.get(column)
        if channel is None and plain_name(name) not in taken:
            channel = channel_of.get(plain_name(name))
        known = spelled_unit(unit) if channel and not columns.units.get(column) else None
        if channel and known and _reads(known, signals.units.get(channel, "")):
            yield column, (channel, known)


def with_headed_units(columns: Columns, signals: Signals, options: ReadOptions) -> Columns:
    """The columns with units that follow the name of a channel: ``room_degC`` is room in degC.

    The unit counts only if it measures the quantity of the channel in the model. A note tells it.
    """
    assigned = {columns.find(c): n for n, c in options.columns.items()}
    found = dict(_headed(columns, signals, options, assigned))
    if not found:
        return columns
    named = {c: c if c in assigned else found[c][0] if c in found else c for c in columns.values}
    told = [f"{c} is {channel} in {unit}" for c, (channel, unit) in found.items()]
    return replace(
        columns,
        values={named[c]: v for c, v in columns.values.items()},
        units=columns.units | {named[c]: unit for c, (_, unit) in found.items()},
        headings=columns.headings | {named[c]: c for c in found},
        notes=[*columns.notes, f"{', '.join(told)} (--unit NAME=UNIT says another unit)"],
    )


def _reads(unit: str, wanted: str) -> bool:
    """Whether a unit measures what the model wants; a plain number has only the unit %."""
    if unit == PIXEL or not wanted or (wanted == "1" and unit != "%"):
        return False
    try:
        zero_and_factor(unit, wanted)
    except InvalidParameter:
        return False
    return True


def _with_clock(columns: Columns, options: ReadOptions, stated: str) -> ReadOptions:
    """The options with the unit of the clock under ``time``, if its column was named instead."""
    if "time" in options.units:
        return options
    clock = clock_column(columns, options.columns.get("time", stated))
    first = next(iter(columns.values), "")
    for name, unit in options.units.items():
        column = columns.find(name) if name else ""
        if column and (column == clock or (not clock and column == first and _measures(unit, "s"))):
            units = {n: u for n, u in options.units.items() if n != name} | {"time": unit}
            return replace(options, units=units, columns={**options.columns, "time": column})
    return options


def _of_model(path: Path, columns: Columns, signals: Signals, options: ReadOptions) -> Sheet:
    """Assign columns by the names of the signals of the model."""

    def find(name: str) -> str:
        specified = options.columns.get(name)
        if specified is not None:
            return specified
        column = columns.find(name, *signals.names.get(name, ()))
        return column or (_by_quantity(columns, signals, name) if signals.is_input(name) else "")

    names = [*chain(*signals.modes.values()), *signals.inputs, *signals.outputs]
    place = {n: find(n) for n in names}
    fitting = [m for m, names in signals.modes.items() if all(place[n] for n in names)]
    measured = [n for n in signals.outputs if place[n]]
    faults = _unknown_channels(signals, options, ())
    there = f"there are {columns} ({which_column()})"
    if signals.modes and not fitting:
        wanted = " or ".join(map(" and ".join, signals.modes.values()))
        faults.append(f"no column {wanted} for the input; {there}")
    if not measured:
        faults.append(f"none of the outputs {', '.join(signals.outputs)}; {there}")
    mode: InputMode = next(iter([*fitting, *signals.modes]), "force")
    driven = (*signals.inputs, *signals.modes.get(mode, ()))
    if signals.any_inputs:
        used = [columns.find(place[n]) for n in (*driven, *measured)]
        others = _other_inputs(columns, options, used)
        place |= others
        driven = (*driven, *others)
    for name in (*driven, *measured):
        faults += _faults_of_place(name, place[name], columns, signals, options, name in driven)
    if faults:
        raise DataError(fault_text(str(path), faults))
    return Sheet(
        input_mode=mode,
        inputs={n: InputSpec(column=_other(place[n], n)) for n in driven},
        outputs={n: OutputSpec(column=_other(place[n], n)) for n in measured},
    )


def _aside(columns: Columns, options: ReadOptions) -> set[str]:
    """Columns that are no signals: clock, frames, runs, likelihoods, one without a name."""
    return {
        clock_column(columns, options.columns.get("time", "")),
        frame_column(columns),
        run_column(columns, options.run),
        columns.unnamed,
        *columns.likelihood.values(),
    }


def _other_inputs(columns: Columns, options: ReadOptions, used: Sequence[str]) -> dict[str, str]:
    """Further inputs and their columns, of a model that takes any; a note for each that is none."""
    aside = _aside(columns, options).union(used)
    channel_of = {columns.find(c) or c: name for name, c in options.columns.items()}
    inputs = {}
    for column in columns.values:
        if column in aside:
            continue
        if why := _no_input(columns, column):
            columns.notes.append(f"column {column} is left out: {why}")
        else:
            inputs[channel_of.get(column, column)] = column
    return inputs


def _faults_of_place(
    name: str, place: str, columns: Columns, signals: Signals, options: ReadOptions, driven: bool
) -> list[str]:
    """Why the column of a signal cannot be read: it does not exist, or has no unit."""
    column = columns.find(place)
    if not place:
        return []
    if not column:
        return [f"no column {shortened(repr(place))} for {name}; there are {columns}"]
    unit = signals.units.get(name) or "1"
    # A unit or a scale without a channel is that of the outputs.
    scaled = {name} if driven else {name, ""}
    if unit == "1" or columns.units.get(column) or scaled & {*options.units, *options.scales}:
        return []
    return [
        f"column {place} has no unit in the header, expected such as [{unit}] (specify it: --unit "
        f"{name}={unit}, in Python units of ReadOptions)"
    ]


def _unknown_channels(
    signals: Signals, options: ReadOptions, described: Iterable[str]
) -> list[str]:
    """Faults of columns that are assigned to channels which the model does not have.

    ``described``: further channels, which the TOML file of the measurement names.
    """
    if signals.any_inputs:
        return []
    modes = [n for names in signals.modes.values() for n in names]
    known = ["time", *dict.fromkeys([*signals.inputs, *modes, *signals.outputs])]
    others = {*described, *(n for names in signals.names.values() for n in names)}
    faults = []
    for name in options.columns:
        if name not in known and name not in others:
            same = [n for n in known if n.split(".")[0] == name]
            same = same or [n for n in known if n.startswith(name)][:3]
            near = same or difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(known)}"
            faults.append(f"column {options.columns[name]} for {name}: no such channel; {hint}")
    return faults


def _no_input(columns: Columns, column: str) -> str:
    """Why a column cannot be an input; empty: it is complete and has a known unit or none."""
    unit = columns.units.get(column, "")
    if unit and spelled_unit(unit) is None:
        return f"its unit {unit} is not known"
    values = columns.values[column]
    missing = int(np.sum(~np.isfinite(values)))
    return f"{missing} of {values.size} values are missing" if missing else ""


def _other(column: str, name: str) -> str:
    return "" if column in ("", name) else column


def _by_quantity(columns: Columns, signals: Signals, name: str) -> str:
    """The only column with a usual name and a unit of an input."""
    si = signals.units.get(name) or "1"
    if si not in _QUANTITIES:
        return ""
    named = columns.called(_QUANTITIES[si])
    matches = [c for c in named if _measures(columns.units.get(c, ""), si)]
    return matches[0] if len(matches) == 1 else ""


def _measures(unit: str, si: str) -> bool:
    known = spelled_unit(unit)
    if known is None or known == PIXEL:
        return False
    try:
        conversion_factor(known, si)
    except InvalidParameter:
        return False
    return True


def _of_columns(path: Path, columns: Columns, options: ReadOptions) -> Sheet:
    """Every column is an output of its name, except the clock and a force."""
    aside = _aside(columns, options)
    rest = [c for c in columns.values if c not in aside]
    forces = [c for c in columns.called("force") if c in rest]
    forces = forces if len(forces) == 1 < len(rest) else []
    channel_of = {v: k for k, v in options.columns.items()}
    outputs = {channel_of.get(c, c): OutputSpec(column=c) for c in rest if c not in forces}
    if not outputs:
        raise DataError(f"{path}: holds no output; there are {columns}")
    return Sheet(
        inputs={channel_of.get(c, "force"): InputSpec(column=c) for c in forces}, outputs=outputs
    )


# ---------------------------------------------------------------- options


def _changed(
    path: Path, sheet: Sheet, columns: Columns, signals: Signals, options: ReadOptions
) -> Sheet:
    """The description, changed by the options."""
    inputs: dict[str, Any] = dict(sheet.inputs)
    outputs: dict[str, Any] = dict(sheet.outputs)
    for name, column in options.columns.items():
        if name == "time":
            continue
        where = inputs if name in inputs or signals.is_input(name) else outputs
        empty = InputSpec() if where is inputs else OutputSpec()
        where[name] = where.get(name, empty).model_copy(update={"column": column})
    known = {*inputs, *outputs, "time", ""}
    described = (*sheet.inputs, *sheet.outputs)
    faults = _unknown_channels(signals, options, described) if signals.outputs else []
    faults += [
        f"{what} of {name}: there is no such channel; known are {', '.join(sorted(known - {''}))}"
        for what, table in (
            ("unit", options.units),
            ("scale", options.scales),
            ("origin", options.origins),
            ("period", options.periods),
            ("time offset", options.delays),
            ("reference", options.references),
        )
        for name in table
        if name not in known
    ]
    for group in (inputs, outputs):
        for name, spec in group.items():
            try:
                update = _update(name, spec, columns, options, output=group is outputs)
            except InvalidParameter as error:
                faults.append(str(error))
                continue
            group[name] = spec.model_copy(update=update) if update else spec
    if faults:
        raise DataError(fault_text(str(path), faults))
    changed = {**options.top(), "inputs": inputs, "outputs": outputs}
    return validated(Sheet, {**dict(sheet), **changed}, str(path), DataError)


def _update(
    name: str, spec: Any, columns: Columns, options: ReadOptions, *, output: bool
) -> dict[str, Any]:
    """Fields of one column that the options replace."""
    headed = columns.units.get(columns.find(spec.column or name), "")

    def option(table: Mapping[str, Any], *, of_all: bool) -> Any:
        """Value for this channel, or the one without a channel, if it is meant for this one."""
        return table.get(name, table.get("") if output and of_all else None)

    unit = option(options.units, of_all=not (spec.unit or headed)) or None
    update: dict[str, Any] = {"unit": unit}
    unit = _spelled(unit or spec.unit or headed)
    update["scale"] = option(options.scales, of_all=unit in ("", PIXEL))
    if update["scale"] is not None and not unit:
        update["unit"] = unit = PIXEL
    pixels = unit == PIXEL
    origin = option(options.origins, of_all=pixels or _measures(unit, "m"))
    if name not in options.origins:
        origin = _of_axis(name, origin, pixels=pixels)
    update["origin"] = None if origin is None else _origin(name, origin)
    update["period"] = options.periods.get(name)
    if pixels and name.endswith(".y") and options.y_up:
        update["down"] = False
    if output:
        update["delay"] = option(options.delays, of_all=True)
        update["reference"] = option(options.references, of_all=True)
    return {key: value for key, value in update.items() if value is not None}


def _of_axis(name: str, origin: str | None, *, pixels: bool) -> str | None:
    """Component of an origin "X,Y" that belongs to a channel."""
    if origin is None or "," not in origin:
        return origin
    parts = [p.strip() for p in origin.split(",")]
    if len(parts) != 2:
        raise InvalidParameter(f"origin of {name}: got {shortened(repr(origin))}, expected X,Y")
    axis = name.rpartition(".")[2]
    if axis not in ("x", "y") or not pixels:
        return None
    return parts["xy".index(axis)]


def _origin(name: str, text: str) -> float | str:
    if text == "start":
        return text
    try:
        return float(text)
    except ValueError:
        got = shortened(repr(text))
        raise InvalidParameter(
            f"origin of {name}: got {got}, expected a number in the unit of the file, or start"
        ) from None
