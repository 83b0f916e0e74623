"""Tables of numbers in text files of instruments and tracking programs.

A file has a preamble of settings, a heading (names, perhaps units above or below them), and a block
of rows in which the same cells are numbers. Separator and decimal sign are chosen so that most
cells become numbers. Settings may stand beside the rows. Several tests may stand side by side (the
names repeat in the heading), or one below another (the heading repeats in the rows): both become
one table with a column that names the test of each row.
"""

from __future__ import annotations

import csv
import itertools
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unmodeled.errors import DataError
from unmodeled.units import spelled_unit, split_column

MISSING = ("", "nan", "NaN", "NA", "N/A", "n/a", "-", "--", ".")
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
#: Name of the column that tells several tests of a file apart.
TEST = "specimen"
#: A number with separators of thousands; its other sign tells which of them is the decimal sign.
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*)")
#: A setting in one cell: ``inDegrees=yes``, ``tInc = 2e-07``.
_SETTING = re.compile(r"([^=]*[^=\s])\s*=\s*(.*\S)")


@dataclass(frozen=True)
class Lines:
    """Lines of a text, with their numbers in the file, counted from 1."""

    texts: list[str]
    numbers: NDArray[np.intp]
    style: tuple[str | None, str] | None = None
    """Separator and decimal sign, if they are known."""

    def __len__(self) -> int:
        return len(self.texts)

    def __getitem__(self, at: slice) -> Lines:
        return Lines(self.texts[at], self.numbers[at], self.style)

    def where(self, keep: Callable[[str], bool]) -> Lines:
        """The lines for which a condition holds."""
        kept = [i for i, text in enumerate(self.texts) if keep(text)]
        return Lines([self.texts[i] for i in kept], self.numbers[kept], self.style)


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
    settings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Values beside each word of the preamble, by its plain name."""
    without: tuple[str, ...] = ()
    """Names at the end of the header that have no cells in the rows."""


def plain_name(name: str) -> str:
    """A name without differences of notation (``Arm_Tip X``, ``arm_tip.x``), or accents."""
    return re.sub(r"[\W_]", "", unicodedata.normalize("NFKD", name).lower())


def text_lines(data: bytes, path: Path) -> Lines:
    """Non-empty lines of a text in UTF-8, UTF-16, GB18030, Shift JIS, or else Windows-1252."""
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
        page = "gb18030" if _is_chinese(data) else "cp932" if _is_japanese(data) else "cp1252"
        text = data.decode(page, errors="replace")
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


def _is_japanese(data: bytes) -> bool:
    """Whether it is Shift JIS, and most characters above ASCII are kana or frequent kanji.

    Windows-1252 is seldom valid Shift JIS, and then has rare kanji or half-width kana. Its quotes
    and dashes are a frequent kanji with the letter after them, which stands alone: not counted.
    """
    try:
        words = re.findall(r"[^\x00-\x7f]{2,}", data.decode("cp932"))
    except UnicodeDecodeError:
        return False
    above = "".join(words)
    common = ["\u3041" <= c <= "\u30fc" or 0x88 <= c.encode("cp932")[0] <= 0x97 for c in above]
    return 2 * sum(common) > len(above)


def read_number(cell: str, decimal: str = ".") -> float | None:
    """Number of a cell; NaN if it is empty, None if it is not a number."""
    text = cell.strip()
    if text in MISSING:
        return float("nan")
    if _THOUSANDS.fullmatch(text):
        text = text.replace("." if decimal == "," else ",", "")
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        return None


def read_table(lines: Lines, *, tests: bool = False) -> Table:
    """Split a text, without its comments, into the lines above the table and its rows.

    ``tests``: a heading that repeats begins another test, named in a further column.

    Raises
    ------
    DataError
        The text has no table.
    """
    head = lines[: LONGEST_PREAMBLE + SAMPLE]
    separator, decimal = style_of(lines)
    numbered = list(numbered_rows(head, separator))
    rows = numbered_rows(lines, separator)
    cells = [row for _, row in numbered]
    width = _width(cells)
    beside = _beside(cells, width, decimal)
    settings = _settings(row[:beside] for row in cells)
    if beside:
        width -= beside
        cells = [row[beside:] for row in cells]
        rows = ((line, row[beside:]) for line, row in rows)
    first = _first_row(cells, width, decimal)
    header, names, units = _heading(cells, first, width)
    settings |= _settings(cells[: max(header, 0)])
    if beside and header < 0:
        names = _names_in(settings)
    names, units, stated = _without_settings(names, units)
    settings |= stated
    without = names[width:]
    rows = itertools.islice(rows, first, None)
    count = len(lines) - first
    if tests and (several := _side_by_side(names, units)):
        names, units, places = several
        labels = _labels(cells[header - 1] if header > 0 else [], len(places))
        rows = _stacked(list(rows), places, labels)
        names, count = (*names, _test_name(names)), count * len(places)
    elif tests and _repeats(lines, numbered[header][0] if header >= 0 else 0):
        above = cells[header - 1] if header else []
        names = names[:width]
        rows = _in_blocks(rows, cells[header:first], above, decimal, len(names))
        names = (*names, _test_name(names))
    else:
        names = names[:width] if without else names
    line = numbered[max(header, 0)][0]
    return Table(
        preamble=tuple(head.texts[: int(np.sum(head.numbers < line))]),
        header=names,
        line=line,
        units=units,
        rows=rows,
        decimal=decimal,
        lines=count,
        settings=settings,
        without=tuple(c for c in without if c.strip()),
    )


def _repeats(lines: Lines, number: int) -> bool:
    """Whether the text of a line of the file occurs again."""
    at = int(np.searchsorted(lines.numbers, number))
    return number > 0 and lines.texts.count(lines.texts[at]) > 1


def _beside(cells: Sequence[Sequence[str]], width: int, decimal: str) -> int:
    """Number of cells of settings that stand before the numbers of the first rows; mostly 0.

    They are empty in the later rows, and the first of them is a word.
    """
    rows = [row for row in cells if len(row) == width]
    if len(rows) < len(cells) or not rows or read_number(rows[0][0], decimal) is not None:
        return 0
    later = rows[len(rows) // 2 :]
    blank = itertools.takewhile(lambda j: not any(r[j].strip() for r in later), range(width))
    count = len([*blank])
    numbers = all(
        row[count].strip() and read_number(row[count], decimal) is not None
        for row in rows
        if count < width
    )
    return count if numbers and count < width else 0


def _settings(rows: Iterable[Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Settings of the preamble: a word and the values beside it; the last one counts."""
    settings = {}
    for row in rows:
        filled = [c.strip() for c in row if c.strip()]
        if len(filled) == 1 and (setting := _SETTING.fullmatch(filled[0])):
            filled = [setting[1], setting[2]]
        if len(filled) > 1:
            name, unit = split_column(filled[0])
            settings[plain_name(name)] = (*filled[1:], unit) if unit else tuple(filled[1:])
    return settings


def _names_in(settings: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Names of a clock and a channel that the settings tell, as an oscilloscope does."""
    if "source" not in settings:
        return ()
    units = [settings.get(f"{side}units", ("",))[0] for side in ("horizontal", "vertical")]
    return f"time [{units[0] or 's'}]", f"{settings['source'][0]} [{units[1]}]"


def _heading(
    cells: Sequence[Sequence[str]], first: int, width: int
) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
    """Index of the line of names above the first row (-1: none), the names, and the units."""
    if first < 1:
        return -1, (), ()
    above = [list(row) if len(row) >= width else [] for row in cells[max(first - 3, 0) : first]]
    above = [[]] * (3 - len(above)) + above
    if above[1] and are_units(above[2]):
        return first - 2, tuple(above[1]), tuple(c.strip() for c in above[2])
    names = cells[first - 1]
    incomplete = not all(c.strip() for c in names[:width]) or len({*names}) < len(names)
    if len(above[1]) == len(names) and incomplete and are_units(above[1]):
        higher = above[0] if len(above[0]) == len(names) else names
        names = [name if name.strip() else other for name, other in zip(names, higher, strict=True)]
        return first - 1, tuple(names), tuple(c.strip() for c in above[1])
    return first - 1, tuple(names), ()


def _without_settings(
    names: tuple[str, ...], units: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...], dict[str, tuple[str, ...]]]:
    """The names and units before the settings at the end of a heading, and these settings.

    A setting is a name with a number in place of the unit, or a cell such as ``tInc = 2e-07``.
    """
    settings: dict[str, tuple[str, ...]] = {}
    end = len(names)
    for j in reversed(range(len(names))):
        setting = _SETTING.fullmatch(names[j].strip())
        below = units[j] if j < len(units) else ""
        if setting is not None:
            settings[plain_name(setting[1])] = (setting[2],)
        elif below and read_number(below) is not None:
            settings[plain_name(names[j])] = (below,)
        elif names[j].strip():
            break
        else:
            continue
        end = j
    return names[:end], units[:end], settings


def _side_by_side(
    names: tuple[str, ...], units: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...], list[list[int]]] | None:
    """Names and units of one of several tests side by side, and the places of each; None: one test.

    The names and their units repeat, perhaps after a clock that all tests share.
    """
    places = [j for j, name in enumerate(names) if name.strip()]
    keys = [(names[j].strip(), units[j] if j < len(units) else "") for j in places]
    for shared in (0, 1):
        rest = keys[shared:]
        size = len(dict.fromkeys(rest))
        if size > 1 and len(rest) > size and rest == rest[:size] * (len(rest) // size):
            groups = [places[shared:][k : k + size] for k in range(0, len(rest), size)]
            every = [places[:shared] + group for group in groups]
            return (
                tuple(names[j] for j in every[0]),
                tuple(units[j] for j in every[0]) if units else (),
                every,
            )
    return None


def _labels(above: Sequence[str], count: int) -> list[str]:
    """Names of tests side by side: the cells of the line above, if it names each of them."""
    filled = [c.strip() for c in above if c.strip()]
    labels = filled[-count:] if len(filled) in (count, count + 1) else []
    return labels if len({*labels}) == count else [str(k + 1) for k in range(count)]


def _test_name(names: Sequence[str]) -> str:
    return "part of the file" if TEST in map(plain_name, names) else TEST


def _stacked(
    rows: Sequence[tuple[int, list[str]]], places: Sequence[Sequence[int]], labels: Sequence[str]
) -> Iterator[tuple[int, list[str]]]:
    """Rows of the tests one below another, each with the name of its test, without empty rows."""
    for columns, label in zip(places, labels, strict=True):
        for line, row in rows:
            part = [row[j] if j < len(row) else "" for j in columns]
            if any(c.strip() for c in part):
                yield line, [*part, label]


def _in_blocks(
    rows: Iterable[tuple[int, list[str]]],
    heading: Sequence[list[str]],
    above: Sequence[str],
    decimal: str,
    width: int,
) -> Iterator[tuple[int, list[str]]]:
    """Rows of tests one below another, each with the name of its test: the line above its heading.

    ``heading``: lines that repeat above each test; ``above``: the line above the first one.
    """
    blocks: list[tuple[str, list[tuple[int, list[str]]]]] = []
    held: list[tuple[int, list[str]]] = []
    below = 0

    def begin(above: Sequence[str]) -> None:
        blocks.append((next((c.strip() for c in above if c.strip()), ""), []))

    begin(above)
    for line, row in rows:
        if below and row == heading[len(heading) - below]:
            below -= 1
        elif row == heading[0]:
            # What stands between the rows and the heading belongs to the preamble of the test.
            begin(held[-1][1] if held else [])
            held, below = [], len(heading) - 1
        elif any(c.strip() and read_number(c, decimal) is None for c in row):
            held.append((line, row))
        else:
            blocks[-1][1].extend([*held, (line, row)])
            held, below = [], 0
    blocks[-1][1].extend(held)
    titles = {title for title, _ in blocks}
    for number, (title, block) in enumerate(blocks, 1):
        label = title if len(titles) == len(blocks) and "" not in titles else str(number)
        for line, row in block:
            fits = not any(c.strip() for c in row[width:])
            yield line, [*row[:width], label] if fits else row


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

    def counted() -> Iterator[str]:
        nonlocal taken
        for text in lines.texts:
            taken += 1
            yield text

    first = 0
    for row in _split(counted(), separator):
        yield int(lines.numbers[first]), row
        first = taken


def style_of(lines: Lines) -> tuple[str | None, str]:
    """Separator of the cells (None: white space) and decimal sign of the rows of a text."""
    if lines.style is not None:
        return lines.style
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


def _numbers_in(row: Sequence[str], decimal: str) -> float:
    """Share of the filled cells that are numbers [1]."""
    filled = [c for c in row if c.strip() not in MISSING]
    return sum(read_number(c, decimal) is not None for c in filled) / max(len(filled), 1)


def _first_row(cells: Sequence[Sequence[str]], width: int, decimal: str) -> int:
    """Index of the first row of numbers.

    It has at least half as many numbers as the later rows have, as do half of the next rows. There
    is no header below it, unless there is one above it, too.
    """
    shares = [_numbers_in(row, decimal) if len(row) == width else 0.0 for row in cells]
    whole = [len(row) == width and all(map(str.strip, row)) for row in cells]
    header = [w and s == 0.0 for s, w in zip(shares, whole, strict=True)]
    later = sorted(s for s in shares[len(shares) // 2 :] if s > 0.0) or [1.0]
    usual = later[len(later) // 2]
    full = [i for i, s in enumerate(shares) if s > 0.5 * usual]

    def begins(i: int) -> bool:
        below = shares[i + 1 : i + 1 + NEXT_ROWS]
        later_header = any(header[i + 1 : i + 2]) and not any(header[max(i - 1, 0) : i])
        return not later_header and 2 * sum(s > 0.0 for s in below) >= len(below)

    first = next(iter([*filter(begins, full), *full]), len(cells))
    # A row with a fault is not a header.
    while first > 1 and shares[first - 1] > 0.0:
        first -= 1
    return first


def are_units(row: Sequence[str]) -> bool:
    """Whether a line holds units: most of its cells that are not empty. An unknown one is told."""
    filled = [c.strip() for c in row if c.strip() not in ("", "-", "[]", "()")]
    filled = [c for c in filled if read_number(c) is None]
    known = [spelled_unit(c) is not None or (c[0] in "[(" and c[-1] in "])") for c in filled]
    return 2 * sum(known) > len(known)
