"""Tables that fit the screen: lines are folded only between words, never in numbers or names.

A table that is too wide is folded, else split into several tables with the same first column, else
written as one block of lines for each row.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from unmodeled.errors import printable

if TYPE_CHECKING:
    from rich.console import ConsoleOptions, RenderResult

#: Width between two columns of the box, and around the table [characters].
BETWEEN, AROUND = 3, 2
#: Smallest width of a text column, unless there is no alternative [characters].
PROSE = 24

Cells = list[str]


class FittingTable(Table):
    """A table with text cells.

    ``whole``: indices of the columns whose cells are never folded, not even between words.
    """

    def __init__(self, title: str, whole: Sequence[int] = ()):
        super().__init__(title=title, box=box.SIMPLE, title_justify="left", pad_edge=False)
        self.whole = frozenset(whole)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Lines of the table in the form that fits."""
        if not self.columns:
            return
        room = options.max_width - AROUND
        columns = [_column_cells(column) for column in self.columns]
        wants = full = [max(map(_longest_line, cells)) for cells in columns]
        if _total(wants) > room:  # heads are folded first
            wants = [max(_longest_word(cells[0]), 0, *map(_longest_line, cells[1:]))
                     for cells in columns]  # fmt: skip
        needs = [
            wants[i] if i in self.whole else max(map(_longest_word, cells))
            for i, cells in enumerate(columns)
        ]
        title = printable(str(self.title or ""))
        yield from _folded(title, options.max_width, "table.title")
        groups = _groups(needs, wants, room)
        if groups:
            for group in groups:
                least, most, whole = ([sizes[i] for i in group] for sizes in (needs, wants, full))
                yield self._part(group, _shared(least, most, whole, room))
        else:
            yield from self._blocks(columns, options.max_width)
        yield from _folded(printable(str(self.caption or "")), options.max_width, "table.caption")

    def _part(self, group: list[int], widths: list[int]) -> Table:
        """The columns of a group as a table of rich with folded cells."""
        part = Table(box=box.SIMPLE, pad_edge=False)
        columns = [_column_cells(self.columns[i]) for i in group]
        folded = [[folded_text(cell, width) for cell in cells]
                  for cells, width in zip(columns, widths, strict=True)]  # fmt: skip
        for i, cells in zip(group, folded, strict=True):
            # Cells are folded already; "ignore" would disable their justification.
            part.add_column(
                cells[0], justify=self.columns[i].justify, no_wrap=True, overflow="crop"
            )
        for row in zip(*(cells[1:] for cells in folded), strict=True):
            part.add_row(*row)
        return part

    def _blocks(self, columns: list[Cells], width: int) -> RenderResult:
        """One block of lines per row: the first cell, and below it the others with their heads."""
        yield Text("")
        if len(columns[0]) == 1:
            yield from _folded(", ".join(cells[0] for cells in columns), width)
        for row in range(1, len(columns[0])):
            for i, cells in enumerate(columns):
                head, value = cells[0], cells[row]
                if value or i == 0:
                    text = f"{head}: {value}" if head else value
                    lines = folded_text(text, width - 4).replace("\n", "\n    ")
                    yield Text(("  " if i else "") + lines, no_wrap=True, overflow="ignore")
        yield Text("")


def new_table(
    title: str, *columns: str, right: tuple[int, ...] = (), whole: tuple[int, ...] = ()
) -> FittingTable:
    """Table that fits the screen.

    Parameters
    ----------
    title
        Title above the table.
    columns
        Heads of the columns.
    right
        Indices of right-aligned columns.
    whole
        Indices of columns whose cells are never folded.
    """
    table = FittingTable(title, whole)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i in right else "left")
    return table


def _column_cells(column: object) -> Cells:
    """Head and cells of a column as text."""
    cells = (column.header, *column.cells)  # type: ignore[attr-defined]
    return [printable(str(cell)) for cell in cells]


#: A unit in brackets is one word.
_WORD = re.compile(r"(?:\[[^\[\]]{1,16}\]|\S)+")


def _words(text: str) -> list[str]:
    return _WORD.findall(text)


def _longest_word(text: str) -> int:
    return max(map(cell_len, _words(text)), default=0)


def _longest_line(text: str) -> int:
    return max(map(cell_len, text.split("\n")), default=0)


def folded_text(text: str, width: int) -> str:
    """Lines of at most ``width`` characters, folded between words; longer words are kept."""
    return "\n".join(line for part in text.split("\n") for line in _fold_line(part, width))


def _fold_line(text: str, width: int) -> list[str]:
    if cell_len(text) <= width:
        return [text]
    indent = text[: len(text) - len(text.lstrip())]
    lines = [""]
    for word in _words(text):
        longer = f"{lines[-1]} {word}" if lines[-1] else f"{indent}{word}"
        if lines[-1] and cell_len(longer) > width:
            lines.append(f"{indent}{word}")
        else:
            lines[-1] = longer
    return lines


def _folded(text: str, width: int, style: str = "") -> RenderResult:
    if text:
        yield Text(folded_text(text, width), style=style, no_wrap=True, overflow="ignore")


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + BETWEEN * (len(widths) - 1)


def _shared(needs: list[int], wants: list[int], full: list[int], room: int) -> list[int]:
    """Widths of columns: the wanted ones, or the largest equal width that fits; at least the need.

    Remaining space is given to the first columns that want more, then to folded heads.
    """
    cap = max(wants, default=0)
    widths = list(needs)
    while cap > 0:
        widths = [max(need, min(want, cap)) for need, want in zip(needs, wants, strict=True)]
        if _total(widths) <= room:
            break
        cap -= 1
    for sizes in (wants, full):
        for i, size in enumerate(sizes):
            widths[i] += max(0, min(size - widths[i], room - _total(widths)))
    return widths


def _groups(needs: list[int], wants: list[int], room: int) -> list[list[int]]:
    """Columns in one table, with the first column in every group; none: not even two fit."""
    everything = list(range(len(needs)))
    comfortable = [max(n, min(w, PROSE)) for n, w in zip(needs, wants, strict=True)]
    twofold = [max(n, (w + 1) // 2) for n, w in zip(needs, wants, strict=True)]
    if _total(comfortable) <= room or _total(twofold) <= room or len(everything) == 2:
        return [everything] if _total(needs) <= room else []
    groups: list[list[int]] = []
    for i in everything[1:]:
        if groups and _total([comfortable[0], *(comfortable[k] for k in groups[-1][1:]),
                              comfortable[i]]) <= room:  # fmt: skip
            groups[-1].append(i)
        else:
            groups.append([0, i])
    fits = all(_total([needs[i] for i in group]) <= room for group in groups)
    return groups if fits else []


class Screen(Console):
    """Console that extends a line for a long word instead of breaking the word.

    Control characters in names of files are escaped.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print; see :class:`rich.console.Console`."""
        folded = [
            Text(folded_text(printable(o), self.width)) if isinstance(o, str) else o
            for o in objects
        ]
        super().print(*folded, **{"crop": False, "overflow": "ignore", **options})
