"""Series of equal length by name: the content of a measured file before it becomes a record."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unmodeled.data.records import Array
from unmodeled.data.tables import Table, plain_name, read_number
from unmodeled.errors import DataError, shortened
from unmodeled.units import spelled_unit, split_column

MOST_NUMBERS = 20_000_000  # limit for a file: 160 MB; reading needs a few times as much
#: Largest number of faults that are listed of a column.
MOST_OF_COLUMN = 1000
#: Usual names of the columns of a quantity, in machines and in other languages.
_CALLED = {
    "time": "time t timestamp rosbag_timestamp elapsed_time date_time zeit prüfzeit uhrzeit temps "
    "tiempo 时间 時間 経過時間",
    "force": "force load load_cell kraft standardkraft f",
    "displacement": "displacement extension travel stroke position crosshead compression weg "
    "standardweg traverse traversenweg verformung",
    "thickness": "thickness gap height dicke höhe",
    "strain": "strain dehnung stauchung",
    "pressure": "pressure stress druck spannung",
    "v_f": "v_f",
    "torque": "torque",
    "motor angle": "motor_angle",
    "key displacement": "key_displacement",
    "finger displacement": "displacement motion weg",
}
#: Columns of a tracker: how sure it is of a point, and coordinates of the point.
_LIKELIHOOD = re.compile(r"(.*?)[._ -]?(?:likelihood|confidence|score)", re.IGNORECASE)
_COORDINATE = re.compile(r"(.*?)[._ -]?[xyz]", re.IGNORECASE)


def limit_text() -> str:
    """The limit as text."""
    return f"the limit of a measured file is {MOST_NUMBERS} numbers"


#: Columns by heading, by plain name, and by the end of the name.
_Lookup = tuple[dict[str, str], dict[str, list[str]], dict[str, list[str]]]


@dataclass
class Columns:
    """Series of equal length by name."""

    values: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    """Units as stated in the file; only columns with a unit are included."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Other content of the file, and why it is not a series."""
    matrices: dict[str, Array] = field(default_factory=dict)
    """Arrays of two sides, which are series if one side is as long as the clock."""
    headings: dict[str, str] = field(default_factory=dict)
    """Complete heading by name, if it contains more than the name."""
    source: str = ""
    """Program that wrote the file, if its format identifies it."""
    frames: str = ""
    """Column with the frame number of a camera."""
    unnamed: str = ""
    """First column, if the header does not name it: it is the clock, or is not used."""
    likelihood: dict[str, str] = field(default_factory=dict)
    """Column of the likelihood [1], by the column to which it belongs."""
    notes: list[str] = field(default_factory=list)
    """Assumptions about the file."""
    lines: NDArray[np.intp] | None = None
    """Line of the file by row, counted from 1; None: the file has no lines."""
    decimal: str = "."
    """Decimal sign of the file."""
    texts: dict[str, list[str]] = field(default_factory=dict)
    """Cells of the columns of text."""
    wrong_cells: dict[str, dict[int, str]] = field(default_factory=dict)
    """Cells that are no numbers, by column and row; their values are NaN."""
    wrong_rows: list[tuple[int, str]] = field(default_factory=list)
    """Rows with another number of cells than the header; their values are NaN."""
    _lookups: tuple[tuple[int, int], _Lookup] | None = field(
        default=None, init=False, repr=False, compare=False
    )

    def __str__(self) -> str:
        shown = [shortened(name) for name in self.values]
        out = [f"{shortened(name)} ({why})" for name, why in self.left_out.items()]
        text = shortened(", ".join(shown), 600) or "none"
        return text + (f"; left out: {shortened(', '.join(out), 300)}" if out else "")

    def split_names(self) -> None:
        """Take units from names such as ``time_ms``, which become headings."""
        for heading in list(self.values):
            name, unit = split_column(heading)
            if unit and heading not in self.units and name not in self.values:
                self.values[name] = self.values.pop(heading)
                self.units[name], self.headings[name] = unit, heading

    def pair_likelihood(self) -> None:
        """Find columns such as ``tip_likelihood`` beside ``tip_x`` and ``tip_y``."""
        coordinates: dict[str, list[str]] = {}
        for column in self.values:
            if (point := _COORDINATE.fullmatch(column)) is not None:
                coordinates.setdefault(plain_name(point[1]), []).append(column)
        for trust, values in self.values.items():
            named = _LIKELIHOOD.fullmatch(trust)
            finite = values[np.isfinite(values)]
            if named is None or np.any((finite < 0.0) | (finite > 1.0)):
                continue
            for column in coordinates.get(plain_name(named[1]), ()):
                self.likelihood[column] = trust

    def take_unnamed(self, name: str) -> None:
        """Find out what the first column is, which the header does not name.

        It is left out beside a column of the time, counts frames if it counts rows, and else can
        be the clock.
        """
        values = self.values.get(name)
        counts = values is not None and values[0] in (0, 1) and bool(np.all(np.diff(values) == 1))
        empty = values is not None and not np.any(np.isfinite(values))
        if self.called("time") or empty:
            self.values.pop(name, None)
            self.left_out[name] = "no name"
            if not (empty or counts):
                self.notes.append(f"{name} has no name in the header and is left out")
            return
        self.unnamed = name
        if counts and not self.frames and not self.units.get(name):
            self.frames = name

    def no_clock(self, name: str) -> str:
        """Why a column cannot be the clock; "" if it can.

        The values of a clock increase, or start again with the next run.
        """
        values = self.values.get(name)
        if values is None:
            return self.left_out.get(name, "missing")
        blank = np.flatnonzero(~np.isfinite(values))
        if blank.size:
            return f"no number in {self.place(int(blank[0]))}"
        again = values[1:] - values[0] < 0.5 * (values[:-1] - values[0])
        wrong = np.flatnonzero((np.diff(values) <= 0.0) & ~again)
        if not wrong.size:
            return ""
        row = int(wrong[0])
        return f"{values[row]:g} is followed by {values[row + 1]:g} in {self.place(row + 1)}"

    def place(self, row: int) -> str:
        """Place of a row in the file, as text: its line, or its number from 1."""
        return f"row {row + 1}" if self.lines is None else f"line {self.lines[row]}"

    def faults(self, names: Iterable[str] | None = None, *, complete: bool = False) -> list[str]:
        """Faults of the rows and of the cells of some columns, of all by default.

        ``complete``: a value that is missing or infinite is a fault, too.
        """
        names = [n for n in (self.values if names is None else names) if n in self.values]
        listed = self.wrong_rows[:MOST_OF_COLUMN]
        for name in names:
            listed += [
                (row, f"{shortened(name)} = {self._shown(cell)}")
                for row, cell in itertools.islice(
                    self.wrong_cells.get(name, {}).items(), MOST_OF_COLUMN
                )
            ]
        short = {row for row, _ in self.wrong_rows}
        for name in names if complete else ():
            reported = short | self.wrong_cells.get(name, {}).keys()
            blank = [int(r) for r in np.flatnonzero(~np.isfinite(self.values[name]))]
            listed += [
                (row, f"{shortened(name)} = {self.values[name][row]}, expected a finite number")
                for row in itertools.islice((r for r in blank if r not in reported), MOST_OF_COLUMN)
            ]
        return [f"{self.place(row)}: {text}" for row, text in sorted(listed)]

    def _shown(self, cell: str) -> str:
        """A cell that is no number, with a hint if it has the other decimal sign."""
        sign = "comma" if self.decimal == "," else "point"
        other = re.fullmatch(r"-?\d++[,.]\d++", cell.strip())
        hint = f" (decimal {sign} expected)" if other else ""
        return f"{shortened(repr(cell))}, expected a number{hint}"

    def add(self, name: str, shape: tuple[int, ...]) -> bool:
        """Whether an array has the shape of a series; other arrays are noted in ``left_out``."""
        if math.prod(shape) == max(shape, default=1) and shape:
            return True
        if shape:
            self.left_out[name] = " x ".join(map(str, shape))
        return False

    def add_cells(self, name: str, values: Array, words: Mapping[int, str], unit: str) -> bool:
        """Add a column of cells; False: it is text, because most of its cells are no numbers.

        ``values``: numbers of the cells, NaN where there is none; ``words``: cells that are no
        numbers, by row.
        """
        if len(words) > np.sum(np.isfinite(values)):
            texts = [words.get(i, "") for i in range(len(values))]
            seconds = seconds_of_day(texts)
            if seconds is None and (lists := _lists(texts)) is not None:
                for j, part in enumerate(lists.T):
                    self.add_cells(f"{name}.{j}", part, {}, unit)
                return True
            if seconds is None:
                self.texts[name] = texts
                first = next(iter(words.values()))
                self.left_out[name] = f"text, such as {shortened(repr(first), 40)}"
                return False
            self.notes.append(
                f"{shortened(name)}: times of day or dates become seconds from the first"
            )
            values, unit = seconds, "s"
        elif words:
            self.wrong_cells[name] = dict(words)
        self.values[name] = values
        if unit and unit != "-":
            self.units[name] = unit
        return True

    def only_longest(self) -> None:
        """Keep only the series with the largest length."""
        longest = max((v.size for v in self.values.values()), default=0)
        for name in [n for n, v in self.values.items() if v.size != longest]:
            self.left_out[name] = f"{self.values.pop(name).size} values"

    def called(self, quantity: str) -> list[str]:
        """Columns that have a usual name of a quantity."""
        names = {plain_name(word) for word in _CALLED[quantity].split()}
        return [column for column in self.values if plain_name(column) in names]

    def find(self, *names: str) -> str:
        """Column of the first of these names that exists; "" if there is none.

        The name may be equal, equal to the complete heading, or written in another notation.
        """
        exact, alike, ends = self._lookup()
        for name in names:
            if name in self.values:
                return name
            if name.strip() in exact:
                return exact[name.strip()]
        for name in names:
            if plain_name(name) and len(matches := alike.get(plain_name(name), [])) == 1:
                return matches[0]
        for name in names:
            if len(matches := ends.get(name, [])) == 1:
                return matches[0]  # the only point of a tracker
        return ""

    def _lookup(self) -> _Lookup:
        """Columns by heading, by plain name, and by the end of the name; made once for a state."""
        state = (len(self.values), len(self.headings))
        if self._lookups is not None and self._lookups[0] == state:
            return self._lookups[1]
        alike: dict[str, list[str]] = {}
        ends: dict[str, list[str]] = {}
        for column in self.values:
            alike.setdefault(plain_name(column), []).append(column)
            ends.setdefault(column.rpartition(".")[2], []).append(column)
        exact = {heading: column for column, heading in reversed(self.headings.items())}
        self._lookups = state, (exact, alike, ends)
        return exact, alike, ends


def columns_of(path: Path, table: Table, names: Sequence[tuple[str, str]]) -> Columns:
    """The series of a table with the given names and units; columns without a name are omitted.

    A column in which most cells are no numbers is text. Times of day become seconds from the first
    row.

    Raises
    ------
    DataError
        Two columns have one name, or the table is too large.
    """
    width = len(names)
    if table.lines < 2:
        raise DataError(f"{path}: {table.lines} rows of numbers, expected at least 2")
    if table.lines * width > MOST_NUMBERS:
        raise DataError(f"{path}: {table.lines} rows of {width}; {limit_text()}")
    columns = Columns(decimal=table.decimal, left_out=dict.fromkeys(table.without, "no cells"))
    counts = Counter(n for n, _ in names if n)
    doubled = {n: f"{c} columns in line {table.line}" for n, c in counts.items() if c > 1}
    columns.left_out |= doubled
    if doubled:
        told = shortened(", ".join(doubled), 200)
        columns.notes.append(f"{told}: several columns have this name and are left out")
    names = [("", "") if name in doubled else (name, unit) for name, unit in names]
    values, words = _cells(table, names, columns)
    if len(values) < 2:  # a quoted cell may contain the other lines
        raise DataError(f"{path}: {len(values)} rows of numbers, expected at least 2")
    below = (*table.units, *("",) * width)  # the name of a test has no unit
    for j, ((name, unit), below_name) in enumerate(zip(names, below, strict=False)):
        if not name:
            continue
        stated = unit or spelled_unit(below_name) or below_name.strip("[]() ")
        if not columns.add_cells(name, values[:, j], words[j], stated):
            continue
        heading = table.header[j].strip() if j < len(table.header) else name
        if heading != name:
            columns.headings[name] = heading
    return columns


def _cells(
    table: Table, names: Sequence[tuple[str, str]], columns: Columns
) -> tuple[Array, list[dict[int, str]]]:
    """Numbers of the named columns, and by column the cells that are none.

    The numbers of the lines, and the rows of a wrong length, go to ``columns``. There are fewer
    rows than lines if a quoted cell contains line breaks.
    """
    width = len(names)
    values = np.full((table.lines, width), np.nan)
    words: list[dict[int, str]] = [{} for _ in names]
    numbers = []
    for i, (line, row) in enumerate(table.rows):
        numbers.append(line)
        if len(row) < width or any(c.strip() for c in row[width:]):
            columns.wrong_rows.append((i, f"{len(row)} cells, expected {width}"))
            continue
        # Empty cells beyond the columns are separators at the end of a row.
        for j, (cell, (name, _)) in enumerate(zip(row, names, strict=False)):
            if not name:
                continue
            number = read_number(cell, table.decimal)
            if number is None:
                words[j][i] = cell
            else:
                values[i, j] = number
    columns.lines = np.array(numbers, dtype=np.intp)
    return values[: len(numbers)], words


#: A date, a time of day, or both: 12:30:05.25, 2026-11-27T12:30:05Z, 27.11.2026 12:30:05,25.
_MOMENT = re.compile(
    r"(?:(?P<a>\d{1,4})(?P<sign>[./-])(?P<b>\d{1,2})(?P=sign)(?P<c>\d{2,4}))?(?:^|[T ,]+|$)"
    r"(?:(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:[.,]\d+)?)(?: ?(?P<half>[AP])M)?"
    r"(?:Z|[+-]\d\d:?\d\d)?)?",
    re.IGNORECASE,
)


def seconds_of_day(texts: Sequence[str]) -> Array | None:
    """Seconds from the first of these times of day or dates [s]; None if one of them is neither.

    Without dates, or if day and month cannot be told apart, midnight adds a day.
    """
    matches = [m for t in texts if (m := _MOMENT.fullmatch(t.strip())) and m[0]]
    timed = {m["h"] is not None for m in matches}
    if not matches or len(matches) < len(texts) or len(timed) > 1:
        return None
    # Whole nanoseconds: those of all days since the year 0 have 63 bits, a float has 53.
    passed = np.zeros(len(matches), dtype=np.int64)
    if True in timed:
        passed[:] = [_nanoseconds(m) for m in matches]
    days = _days([(m["a"], m["sign"], m["b"], m["c"]) for m in matches])
    if days is not None:
        passed += _DAY * (days - days[0])
    elif True in timed:
        passed[1:] += _DAY * np.cumsum(np.diff(passed) < -_DAY // 2)
    else:
        return None
    return np.asarray((passed - passed[0]) / 1e9)


_DAY = 86_400_000_000_000  # ns


def _nanoseconds(moment: re.Match[str]) -> int:
    """Time of day [ns]."""
    hour = int(moment["h"])
    if moment["half"]:
        hour = hour % 12 + 12 * (moment["half"] in "Pp")
    whole, _, rest = moment["s"].replace(",", ".").partition(".")
    return (3600 * hour + 60 * int(moment["m"]) + int(whole)) * 10**9 + int(f"{rest:0<9}"[:9])


def _days(dates: Sequence[tuple[str | None, ...]]) -> NDArray[np.int64] | None:
    """Number of the day of each date; None: there are none, or day and month may be exchanged."""
    parts = {(a, sign, b, c) for a, sign, b, c in dates}
    first, signs, second, _ = zip(*parts, strict=True)
    if None in first:
        return None
    if all(len(str(a)) == 4 for a in first):
        order = (0, 1, 2)
    elif {*signs} == {"."} or max(int(str(a)) for a in first) > 12:
        order = (2, 1, 0)
    elif max(int(str(b)) for b in second) > 12:
        order = (2, 0, 1)
    else:
        return None
    number: dict[tuple[str | None, ...], int] = {}
    for a, sign, b, c in parts:
        y, m, d = (int(str((a, b, c)[k])) for k in order)
        try:
            number[a, sign, b, c] = date(y + 2000 * (y < 100), m, d).toordinal()
        except ValueError:
            return None
    return np.array([number[p] for p in dates], dtype=np.int64)


#: A list of numbers in one cell: ``[0.1, 0.2]``, ``(1; 2)``, ``[0.1 0.2]``.
_LIST = re.compile(r"[\[(]([^\[\]()]*)[\])]")
#: Largest number of numbers in such a list.
LONGEST_LIST = 256


def _lists(texts: Sequence[str]) -> Array | None:
    """Numbers of cells that all hold a list of one length, (n, k); None: they do not."""
    rows: list[list[float | None]] = []
    for text in texts:
        match = _LIST.fullmatch(text.strip())
        cells = re.split(r"\s*[,;]\s*|\s+", match[1].strip()) if match else []
        numbers = [read_number(c) for c in cells]
        if not 1 <= len(numbers) <= LONGEST_LIST or len(numbers) != len(rows[0] if rows else cells):
            return None
        if any(n is None for n in numbers):
            return None
        rows.append(numbers)
    return np.array(rows, dtype=np.float64)
