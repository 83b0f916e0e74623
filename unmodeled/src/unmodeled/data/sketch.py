"""Writes a draft of the TOML file of a measured file, with comments for corrections."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from unmodeled.data.columns import read_columns
from unmodeled.data.mapping import (
    Signals,
    clock_column,
    frame_column,
    run_column,
    sheet_for,
    unit_of_column,
    with_headed_units,
)
from unmodeled.data.series import Columns
from unmodeled.data.sheet import ColumnSpec, ReadOptions, Sheet
from unmodeled.errors import DataError
from unmodeled.units import PIXEL, split_column


def sketch_sheet(
    path: Path, signals: Signals | None = None, options: ReadOptions | None = None
) -> tuple[str, str]:
    """Draft of the TOML file that describes a measured file, and what it lacks for the model.

    Parameters
    ----------
    signals
        Signals of the model; without it, every column is an output with the name of the column.
    options
        Specified properties, which are not guessed.

    Returns
    -------
    str
        Text of the file.
    str
        Why the file is no record of the model, and what helps, also in the text; "" if it is one.
    """
    options = options or ReadOptions()
    columns = with_headed_units(read_columns(path), signals or Signals(), options)
    note = ""
    try:
        sheet = sheet_for(path, columns, signals or Signals(), options, None)
    except DataError as error:
        if signals is None:
            raise
        # A name that the model does not have is better than no file.
        note = str(error)
        sheet = sheet_for(path, columns, Signals(), options, None)
    lines = [f"# How {path.name} is read. Written by unmodeled new; check it."]
    if columns.source:
        lines.append(f"# It was exported by {columns.source}.")
    if signals is not None:
        note = f"{note}\n{_other_file(path, sheet, columns, signals)}".strip()
    lines += [f"# {text}" for text in (*columns.notes, *note.splitlines())]
    lines += _top(path, sheet, columns)
    for group, table in (("inputs", sheet.inputs), ("outputs", sheet.outputs)):
        for name, spec in table.items():
            lines += ["", f"[{group}.{_quoted(name)}]", *_column(name, spec, columns)]
            lines += _sensor(spec, output=group == "outputs", unit=_unit(name, spec, columns))
    used = {columns.find(s.column or n) for n, s in {**sheet.inputs, **sheet.outputs}.items()}
    used |= {clock_column(columns, sheet.time), run_column(columns, sheet.run)}
    used |= {frame_column(columns), columns.unnamed, *columns.likelihood.values()}
    left = [c for c in columns.values if c not in used]
    if left:
        lines += ["", f"# Columns that are not used: {', '.join(left)}"]
    if signals is not None:
        known = [*signals.inputs, *(n for m in signals.modes.values() for n in m)]
        known += [o for o in signals.outputs]
        lines += ["", f"# Channels of the model: {', '.join(dict.fromkeys(known))}"]
    return "\n".join(lines) + "\n", note


def _other_file(path: Path, sheet: Sheet, columns: Columns, signals: Signals) -> str:
    """Sentence about the other file that is joined to one without inputs or without outputs."""
    specs = {**sheet.inputs, **sheet.outputs}
    names = [n for n, spec in specs.items() if columns.find(spec.column or n)]
    needs = signals.inputs or signals.modes
    if not any(n in signals.outputs for n in names):
        missing = "no output"
    elif needs and not any(signals.is_input(n) for n in names):
        missing = "no input"
    else:
        return ""
    return (
        f"{path.name} has {missing} of the model. If another file of the same experiment has it, "
        f"with its own clock, join both: unmodeled join {path.name} OTHER.csv "
        "--same 0.532s=1.207s -o JOINED.csv (the time of one event on both clocks; the file with "
        "the clock to keep is the first one); JOINED.toml then describes the record"
    )


def _top(path: Path, sheet: Sheet, columns: Columns) -> list[str]:
    clock = clock_column(columns, sheet.time)
    lines = [
        f"name = {_quoted(path.stem)}",
        'role = "fit"  # or "held_out": confirms the findings of the others',
    ]
    lines.append(f'input_mode = {_quoted(sheet.input_mode)}  # or "motion"')
    lines.append(f"time = {_quoted(clock)}" if clock else '# time = "COLUMN"  # specify the clock')
    if clock == frame_column(columns) and not columns.units.get(clock):
        rate = "" if sheet.frame_rate is None else f"{sheet.frame_rate:g}"
        lines.append(f"frame_rate = {rate}" if rate else "# frame_rate = 1000  # Hz: specify it")
    else:
        unit = unit_of_column(columns, clock, sheet.time_unit)
        why = "" if unit else "  # no unit in the header"
        lines.append(f"time_unit = {_quoted(unit or 's')}{why}")
        if sheet.frame_rate is not None:
            lines.append(f"frame_rate = {sheet.frame_rate:g}")
    runs = run_column(columns, sheet.run)
    if runs:
        lines.append(f"run = {_quoted(runs)}  # each run is a separate record")
    if columns.likelihood:
        lines.append(f"likelihood = {sheet.likelihood:g}  # points below it are missing")
    return lines


def _unit(name: str, spec: ColumnSpec, columns: Columns) -> str:
    return unit_of_column(columns, columns.find(spec.column or name), spec.unit)


def _column(name: str, spec: ColumnSpec, columns: Columns) -> list[str]:
    column = columns.find(spec.column or name)
    unit = _unit(name, spec, columns)
    heading = columns.headings.get(column, column)
    lines = [f"column = {_quoted(column if split_column(heading)[1] else heading)}"]
    lines.append(f"unit = {_quoted(unit)}" if unit else '# unit = "mm"  # no unit in the header')
    if spec.scale != "":
        lines.append(f"scale = {_quoted(spec.scale)}")
    elif unit == PIXEL:
        lines.append('# scale = "0.21 mm"  # length of a pixel: specify it')
    if spec.origin != 0.0:
        lines.append(f"origin = {_quoted(spec.origin)}")
    elif unit == PIXEL:
        lines.append('origin = "start"  # zero at the first value; or a pixel')
    if unit == PIXEL and name.endswith(".y"):
        lines.append(f"down = {'false' if spec.down is False else 'true'}  # counts downward")
    return lines


def _sensor(spec: Any, *, output: bool, unit: str) -> list[str]:
    without = "estimated without it" if output else "without it estimated, or 0 beside equations"
    lines = [f"# sigma = 0.0  # standard deviation of its noise [SI]; {without}"]
    if not output:
        return lines
    lines.append("# relative_sigma = 0.0  # noise in proportion to the value; 0.04 is 4 % of it")
    if spec.delay:
        lines.append(f"delay = {spec.delay:g}  # s, delay relative to the input")
    if spec.reference:
        lines.append(f"reference = {_quoted(spec.reference)}")
    elif unit not in ("N", "kN", "mN"):
        lines.append(
            '# reference = "rest"  # or "absolute"; determined from its first value without it'
        )
    return lines


def _quoted(value: object) -> str:
    """A value in TOML notation."""
    import tomlkit

    return tomlkit.item(value).as_string()
