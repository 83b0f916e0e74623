"""What instruments state outside of the rows of a table; workbooks and TDMS files."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from unmodeled.data.formats import reading
from unmodeled.data.series import MOST_NUMBERS, Columns, limit_text
from unmodeled.data.tables import Lines, Table, plain_name, read_number, style_of
from unmodeled.errors import DataError, InvalidParameter, shortened
from unmodeled.files import LARGEST_TABLE, plain_text, read_input
from unmodeled.units import conversion_factor, number_and_unit, spelled_unit

LARGEST_BOOK = 100_000_000  # unpacked bytes of a workbook, whose cells need a second per 5 MB
#: Settings that state the time between two rows, and the number of rows in a second.
_STEPS = "delta_x, sample interval, sampling interval, increment, tinc, sample period, delta t"
_RATES = "sample rate, sampling rate, sample frequency, sampling frequency, scan rate, abtastrate"
_STARTS = "x0, start, t0"
#: Words in the names of coordinates of OpenSim that are angles.
_ANGLE = re.compile(
    r"angle|flex|extension|adduction|abduction|rotation|tilt|list|bending|pro_sup|deviation"
    r"|inversion|eversion|mtp|subtalar"
)
#: A line of the monitor of the Arduino IDE with time stamps, and a cell with its name.
_MONITOR = re.compile(r"\s*(\d\d:\d\d:\d\d[.,]\d+) -> (.*)")
_NAMED = re.compile(r"\s*([^\s:,;]+)\s*:\s*(\S+)\s*")


def _stated(table: Table, words: str, unit: str) -> float | None:
    """Number of the first of these settings [unit]; None: there is none."""
    plain = [plain_name(w) for w in words.split(",")]
    for values in (table.settings[w] for w in plain if w in table.settings):
        quantity = number_and_unit(
            values[0].replace(",", ".") if table.decimal == "," else values[0]
        )
        if quantity is not None:
            known = spelled_unit(quantity[1] or " ".join(values[1:2])) or unit
            try:
                return quantity[0] * conversion_factor(known, unit)
            except InvalidParameter:
                continue
    return None


def add_stated(columns: Columns, table: Table) -> None:
    """Add what the text outside of the rows states: units of the columns, and the clock."""
    first = next(iter(columns.values), "")
    words = table.settings
    if units := words.get("yunitlabel"):  # LabVIEW: of the columns after that of X
        for name, unit in zip([*columns.values][1:], units, strict=False):
            columns.units.setdefault(name, spelled_unit(unit) or unit)
        columns.source = "LabVIEW"
        if words.get("xdimension", ("Time",))[0] == "Time":
            columns.units.setdefault(first, "s")
    if "indegrees" in words:
        unit = "deg" if words["indegrees"][0].lower() == "yes" else "rad"
        angles = [n for n in columns.values if _ANGLE.search(n.lower())]
        for name in angles:
            columns.units.setdefault(name, unit)
        columns.source = "OpenSim"
        if angles:
            columns.notes.append(f"{', '.join(angles)}: in {unit}, as inDegrees states")
    _add_microseconds(columns, table)
    _add_clock(columns, table, first)


def _add_microseconds(columns: Columns, table: Table) -> None:
    """Clocks of flight controllers count microseconds, without a unit."""
    blackbox = any("Blackbox flight data recorder" in line for line in table.preamble)
    indices = any(re.search(r"\[\d+\]", name) for name in columns.values)
    ulog = "timestamp_sample" in columns.values or indices
    clock, source = ("time", "Betaflight") if blackbox else ("timestamp", "PX4" if ulog else "")
    if source and clock in columns.values and clock not in columns.units:
        columns.units[clock], columns.source = "us", source
        columns.notes.append(f"{clock}: in us, as {source} logs it (--unit time=s if not)")


def _add_clock(columns: Columns, table: Table, first: str) -> None:
    """A clock from the step or the rate that the file states, if no column is one."""
    values = columns.values.get(first)
    if columns.called("time") or values is None:
        return
    step = _stated(table, _STEPS, "s")
    rate = _stated(table, _RATES, "Hz") if step is None else None
    step = 1.0 / rate if rate else step
    if step is None or not step > 0.0:
        return
    empty = not np.isfinite(values).any()
    number = np.arange(values.size, dtype=float)
    known = spelled_unit(columns.units.get(first, ""))
    if known is None and not empty and np.array_equal(values, np.round(values[0]) + number):
        number = values
    elif not empty and known == "s":
        return
    if empty or number is values:
        columns.left_out[first] = "no values" if empty else "a counter"
        del columns.values[first]
    columns.values["time"] = (_stated(table, _STARTS, "s") or 0.0) + number * step
    columns.units["time"] = "s"
    columns.notes.append(f"time is counted in steps of {step:g} s, which the file states")


# ---------------------------------------------------------------- serial monitor


def without_monitor(lines: Lines) -> Lines:
    """Lines of a serial monitor as a table: ``12:30:05.250 -> 1.23,4.56``; others as they are."""
    matches = [_MONITOR.fullmatch(text) for text in lines.texts]
    stamped = [*filter(None, matches)]
    if 2 * len(stamped) < len(lines) or len(stamped) < 2:
        return lines
    rows = [m[2] for m in stamped]
    numbers = lines.numbers[[m is not None for m in matches]]
    separator, decimal = style_of(Lines(rows, numbers))
    cells = [row.split(separator) for row in rows]
    pairs = [m for c in cells[-1] if (m := _NAMED.fullmatch(c))]
    named = len(pairs) == len(cells[-1])
    if named and all(read_number(m[2], decimal) is not None for m in pairs):
        names = [m[1] for m in pairs]
        cells = [[c.rpartition(":")[2] for c in row] for row in cells]
    elif all(read_number(c, decimal) is None for c in cells[0]):
        names, cells, stamped, numbers = cells[0], cells[1:], stamped[1:], numbers[1:]
    else:
        names = [f"column_{j + 2}" for j in range(len(cells[-1]))]
    between = separator or "\t"
    texts = [between.join([m[1], *row]) for m, row in zip(stamped, cells, strict=True)]
    places = np.concatenate([numbers[:1], numbers])
    return Lines([between.join(["time", *names]), *texts], places, (between, decimal))


# ---------------------------------------------------------------- workbooks


def workbook_lines(path: Path) -> tuple[Lines, list[str]]:
    """Rows of the sheet of a workbook with the most numbers, as lines; notes about other sheets."""
    data = read_input(path, most=LARGEST_TABLE)
    sheets: dict[str, tuple[int, list[str], list[int]]] = {}
    with reading(path, "a workbook", "openpyxl", "instruments"):
        from openpyxl import load_workbook

        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            size = sum(item.file_size for item in packed.infolist())
        if size > LARGEST_BOOK:
            raise DataError(f"{path}: {size} bytes unpacked; the limit is {LARGEST_BOOK}")
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        count = iter(range(MOST_NUMBERS))
        for sheet in book.worksheets:
            sheet.reset_dimensions()
            sheets[sheet.title] = _sheet_lines(path, sheet.iter_rows(values_only=True), count)
    if not sheets:
        raise DataError(f"{path}: has no sheet of cells")
    chosen = max(sheets, key=lambda name: sheets[name][0])
    others = [name for name, (numbers, _, _) in sheets.items() if numbers and name != chosen]
    _, texts, rows = sheets[chosen]
    note = f"sheet {shortened(chosen)} is read, not {shortened(', '.join(others), 200)}"
    lines = Lines(texts, np.array(rows, dtype=np.intp), style=("\t", "."))
    return lines, [note] * bool(others)


def _sheet_lines(
    path: Path, rows: Iterable[tuple[Any, ...]], count: Iterator[int]
) -> tuple[int, list[str], list[int]]:
    """Number of the cells with numbers, and the rows that are not empty as lines of a table."""
    numbers, texts, places = 0, [], []
    for place, row in enumerate(rows, 1):
        if next(count, None) is None or any(next(count, None) is None for _ in row):
            raise DataError(f"{path}: too many cells; {limit_text()}")
        if not any(c is not None for c in row):
            continue
        numbers += sum(isinstance(c, (int, float)) for c in row)
        cells = ["" if c is None else c.isoformat(" ") if hasattr(c, "hour") and hasattr(c, "year")
                 else plain_text(str(c)) for c in row]  # fmt: skip
        line = io.StringIO()
        csv.writer(line, delimiter="\t", lineterminator="").writerow(cells)
        texts.append(line.getvalue())
        places.append(place)
    return numbers, texts, places


# ---------------------------------------------------------------- TDMS


def read_tdms(path: Path) -> Columns:
    """Channels of a TDMS file; the clock is a channel, or has the increment of the waveforms."""
    columns = Columns(source="TDMS")
    steps: dict[str, tuple[float, float]] = {}
    with reading(path, "TDMS", "npTDMS", "instruments"):
        from nptdms import TdmsFile

        with TdmsFile.open(io.BytesIO(read_input(path, most=LARGEST_TABLE))) as file:
            channels = [c for group in file.groups() for c in group.channels()]
            if sum(len(c) for c in channels) > MOST_NUMBERS:
                raise DataError(f"{path}: {limit_text()}")
            groups = {c.group_name for c in channels if len(c) > 1}
            for channel in channels:
                name = plain_text(channel.name)
                name = f"{plain_text(channel.group_name)}.{name}" if len(groups) > 1 else name
                values = np.asarray(channel[:])
                if values.dtype.kind == "M" and values.size:
                    columns.values[name] = (values - values[0]) / np.timedelta64(1, "s")
                    columns.units[name] = "s"
                elif values.dtype.kind in "iufb":
                    columns.values[name] = values.astype(np.float64)
                    unit = plain_text(str(channel.properties.get("unit_string", "")))
                    columns.units |= {name: spelled_unit(unit) or unit} if unit else {}
                    step = float(channel.properties.get("wf_increment", 0.0))
                    start = float(channel.properties.get("wf_start_offset", 0.0))
                    steps |= {name: (start, step)} if step > 0.0 else {}
                else:
                    columns.left_out[name] = "no numbers"
    columns.only_longest()
    clocks = {steps[n] for n in columns.values if n in steps}
    if not columns.called("time") and len(clocks) == 1:
        (start, step), size = clocks.pop(), next(iter(columns.values.values())).size
        clock = np.asarray(start + step * np.arange(size), dtype=np.float64)
        columns.values = {"time": clock, **columns.values}
        columns.units["time"] = "s"
        columns.notes.append(f"time is counted in steps of {step:g} s, which the file states")
    return columns
