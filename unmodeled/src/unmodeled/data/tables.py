"""Tables of numbers in text files of instruments and tracking programs.

A file has a preamble, a header, perhaps a line of units, and rows. Separator and decimal sign are
chosen so that most cells become numbers.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unmodeled.errors import DataError
from unmodeled.units import spelled_unit

__all__ = [
    "MISSING",
    "Lines",
    "Table",
    "are_units",
    "numbered_rows",
    "read_number",
    "read_table",
    "style_of",
    "text_lines",
]

MISSING = ("", "nan", "NaN", "NA", "N/A", "n/a", "-", "--")
#: Pairs of separator and decimal sign; of equally good pairs, the first is used. None: white space.
_STYLES: tuple[tuple[str | None, str], ...] = (
    (",", "."),
    (";", "."),
    ("\t", "."),
    (";", ","),
    ("\t", ","),
    (",", ","),
    (None, "."),
    (None, ","),
)
#: Number of lines that determine the format of a file.
SAMPLE = 60
#: Largest number of lines of a preamble.
LONGEST_PREAMBLE = 200
#: Number of rows below the first row of numbers that are compared with it.
NEXT_ROWS = 4


@dataclass(frozen=True)
class Lines:
    """Lines of a text, with their numbers in the file, counted from 1."""

    texts: list[str]
    numbers: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.texts)

    def __getitem__(self, at: slice) -> Lines:
        return Lines(self.texts[at], self.numbers[at])

    def where(self, keep: Callable[[str], bool]) -> Lines:
        """The lines for which a condition holds."""
        kept = [i for i, text in enumerate(self.texts) if keep(text)]
        return Lines([self.texts[i] for i in kept], self.numbers[kept])


@dataclass(frozen=True)
class Table:
    """A table of text: the lines above its rows, and the rows as cells."""

    preamble: tuple[str, ...]
    """Lines above the header."""
    header: tuple[str, ...]
    line: int
    """Number of the line of the header in the file."""
    units: tuple[str, ...]
    """Units in a second line of the header; empty if there is none."""
    rows: Iterator[tuple[int, list[str]]]
    """Number of the line in the file, and cells."""
    decimal: str
    lines: int
    """Number of lines below the header, the largest possible number of rows."""


def text_lines(data: bytes, path: Path) -> Lines:
    """Non-empty lines of a text in UTF-8, UTF-16, GB18030, or else Windows-1252."""
    encoding = "utf-8-sig"
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif b"\x00" in data[:SAMPLE]:  # without a byte order mark
        even, odd = (data[k : 20 * SAMPLE : 2].count(0) for k in (0, 1))
        if 2 * max(even, odd) > 10 * SAMPLE or 4 * max(even, odd) > len(data):
            encoding = "utf-16-be" if even > odd else "utf-16-le"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as fault:
        # Older instruments use the code page of their system for umlauts and signs of units.
        if encoding != "utf-8-sig" or b"\x00" in data:
            raise DataError(f"{path}: is no text (byte {fault.start})") from None
        text = data.decode("gb18030" if _is_chinese(data) else "cp1252", errors="replace")
    texts = re.split(r"\r\n|\r|\n", text)  # as editors count them
    return Lines(texts, np.arange(1, len(texts) + 1)).where(lambda line: bool(line.strip()))


def _is_chinese(data: bytes) -> bool:
    """Whether the bytes above ASCII are pairs, most of them frequent characters of GB18030.

    Umlauts and accents of Windows-1252 stand alone, or are no frequent characters.
    """
    runs = re.findall(rb"[\x80-\xff]+", data)
    pairs = [run[i : i + 2] for run in runs for i in range(0, len(run), 2)]
    common = [len(p) == 2 and 0xA1 <= p[0] <= 0xD7 and p[1] >= 0xA1 for p in pairs]
    return all(len(run) % 2 == 0 for run in runs) and 2 * sum(common) > len(pairs)


def read_number(cell: str, decimal: str = ".") -> float | None:
    """Number of a cell; NaN if it is empty, None if it is not a number."""
    text = cell.strip()
    if text in MISSING:
        return float("nan")
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        return None


def read_table(lines: Lines) -> Table:
    """Split a text, without its comments, into the lines above the table and its rows.

    Raises
    ------
    DataError
        The text has no table.
    """
    head = lines[: LONGEST_PREAMBLE + SAMPLE]
    separator, decimal = style_of(lines)
    numbered = list(numbered_rows(head, separator))
    cells = [row for _, row in numbered]
    width = _width(cells)
    first = _first_row(cells, width, decimal)
    header = first - 1
    units: tuple[str, ...] = ()
    if first >= 2 and len(cells[first - 2]) == width and are_units(cells[first - 1]):
        header, units = first - 2, tuple(c.strip() for c in cells[first - 1])
    names = tuple(cells[header]) if header >= 0 else ()
    rows = itertools.islice(numbered_rows(lines, separator), first, None)
    return Table(
        preamble=tuple(head.texts[: int(np.sum(head.numbers < numbered[max(header, 0)][0]))]),
        header=names,
        line=numbered[max(header, 0)][0],
        units=units,
        rows=rows,
        decimal=decimal,
        lines=len(lines) - first,
    )


def _sample(lines: Sequence[str]) -> list[str]:
    """Lines from the second half of the text, which contains rows."""
    later = lines[len(lines) // 2 :]
    step = max(1, len(later) // SAMPLE)
    return list(later[::step])


def _split(lines: Iterable[str], separator: str | None) -> Iterator[list[str]]:
    if separator is None:
        return (re.split(r"\s+", line.strip()) for line in lines)
    # A quoted cell may contain line breaks.
    return csv.reader((line + "\n" for line in lines), delimiter=separator, skipinitialspace=True)


def numbered_rows(lines: Lines, separator: str | None) -> Iterator[tuple[int, list[str]]]:
    """Rows with the number of the line at which they begin."""
    taken = 0

    def told() -> Iterator[str]:
        nonlocal taken
        for text in lines.texts:
            taken += 1
            yield text

    first = 0
    for row in _split(told(), separator):
        yield int(lines.numbers[first]), row
        first = taken


def style_of(lines: Lines) -> tuple[str | None, str]:
    """Separator of the cells (None: white space) and decimal sign of the rows of a text."""
    sample = _sample(lines.texts)
    best, chosen = (-1.0, 0.0), _STYLES[0]
    for separator, decimal in _STYLES:
        rows = list(_split(sample, separator))
        cells = [c for row in rows for c in row if c.strip()]
        if not cells:
            continue
        numbers = sum(len(c) for c in cells if read_number(c, decimal) is not None)
        # With the right separator and decimal sign most of the text belongs to numbers; of such
        # pairs, the one with the most cells.
        merit = (round(numbers / sum(map(len, cells)), 2), sum(map(len, rows)) / len(rows))
        if merit > best:
            best, chosen = merit, (separator, decimal)
    return chosen


def _width(cells: Sequence[Sequence[str]]) -> int:
    """Most frequent number of cells, from the end of the first lines."""
    counts = [len(row) for row in cells[len(cells) // 2 :]]
    return max(set(counts), key=counts.count) if counts else 0


def _first_row(cells: Sequence[Sequence[str]], width: int, decimal: str) -> int:
    """Index of the first row of numbers.

    It has at least half as many numbers as the later rows have, as do half of the next rows. There
    is no header below it, unless there is one above it, too.
    """

    def share(row: Sequence[str]) -> float:
        filled = [c for c in row if c.strip() not in MISSING]
        numbers = sum(read_number(c, decimal) is not None for c in filled)
        return numbers / len(filled) if filled and len(row) == width else 0.0

    shares = [share(row) for row in cells]
    header = [
        s == 0.0 and len(row) == width and all(c.strip() for c in row)
        for s, row in zip(shares, cells, strict=True)
    ]
    later = [s for s in shares[len(shares) // 2 :] if s > 0.0]
    usual = sorted(later)[len(later) // 2] if later else 1.0
    full = [i for i, s in enumerate(shares) if s > 0.5 * usual]

    def begins(i: int) -> bool:
        below = shares[i + 1 : i + 1 + NEXT_ROWS]
        later_header = any(header[i + 1 : i + 2]) and not any(header[max(i - 1, 0) : i])
        return not later_header and 2 * sum(s > 0.0 for s in below) >= len(below)

    first = next(filter(begins, full), next(iter(full), len(cells)))
    # A row with a fault is not a header.
    while first > 1 and shares[first - 1] > 0.0:
        first -= 1
    return first


def are_units(row: Sequence[str]) -> bool:
    """Whether a line holds units: most of its cells that are not empty. An unknown one is told."""
    filled = [c.strip() for c in row if c.strip() not in ("", "-", "[]", "()")]
    known = [spelled_unit(c) is not None or (c[0] in "[(" and c[-1] in "])") for c in filled]
    return 2 * sum(known) > len(known)
