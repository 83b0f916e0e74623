"""What the commands print: texts, tables, JSON, progress, names of written files."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from unmodeled.errors import Error, message, printable

if TYPE_CHECKING:
    from rich.console import Console

    from unmodeled import Progress
    from unmodeled.tables import FittingTable

#: Length of an unlimited line [characters].
UNFOLDED = 10_000

#: Results and written files of a command with --json; None without this option.
_collected: ContextVar[dict[str, list[Any]] | None] = ContextVar("collected", default=None)


#: Name of the program, the beginning of its messages.
_program: ContextVar[str] = ContextVar("program", default="unmodeled")


@contextlib.contextmanager
def named(program: str) -> Iterator[None]:
    """Messages of this program begin with its name."""
    token = _program.set(program)
    try:
        yield
    finally:
        _program.reset(token)


# --- texts ---------------------------------------------------------------------------------------


def complain(text: str) -> None:
    """Print one message on stderr; names of files are made harmless and shortened."""
    click.echo(message(f"{_program.get()}: {text}"), err=True)


def warn(texts: Iterable[str], of: str = "") -> None:
    """Print warnings on stderr; ``of``: what they concern."""
    for text in texts:
        complain(f"warning: {f'{of}: ' if of else ''}{text}")


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text; control characters in names of files are escaped.

    All commands print with this function or with :func:`console`. On stdout, long lines are folded
    between words if the screen is narrow.
    """
    text = printable(text)
    if not err:
        from unmodeled.tables import folded_text

        text = folded_text(text, console().width)
    click.echo(text, err=err, nl=nl)


def console(*, stderr: bool = False) -> Console:
    """Console for tables (stdout) or for progress and messages (stderr).

    Without a terminal there are no colors, and lines are neither cut nor folded unless COLUMNS
    states a line length.
    """
    from rich.console import Console

    from unmodeled.tables import Screen

    if stderr or _collected.get() is None:
        screen = Screen(stderr=stderr, highlight=False, markup=False, emoji=False)
        if not screen.is_terminal and "COLUMNS" not in os.environ:
            screen.width = UNFOLDED
        return screen

    class Collector(Console):
        def print(self, *objects: Any, **_options: Any) -> None:
            collected = _collected.get()
            assert collected is not None
            collected["tables"] += [_table_data(o) for o in objects if hasattr(o, "columns")]

    return Collector(highlight=False, markup=False, emoji=False)


# --- tables --------------------------------------------------------------------------------------


def table(
    title: str, heads: str, rows: Iterable[Sequence[str]] = (), caption: str | None = None
) -> FittingTable:
    """Table that fits the screen.

    Parameters
    ----------
    title, caption
        Text above and below.
    heads
        Heads of the columns, separated by ``|``. ``>`` before a head: right-aligned; ``=``: its
        cells are never folded.
    rows
        Cells.
    """
    from unmodeled.tables import new_table

    marked = [head.strip() for head in heads.split("|")]
    names = [head.lstrip(">=") for head in marked]
    marks = [head[: len(head) - len(name)] for head, name in zip(marked, names, strict=True)]
    right, whole = (tuple(i for i, m in enumerate(marks) if mark in m) for mark in ">=")
    made = new_table(title, *names, right=right, whole=whole)
    for row in rows:
        made.add_row(*row)
    made.caption = caption
    return made


def show(title: str, heads: str, rows: Iterable[Sequence[str]], caption: str | None = None) -> None:
    """Print a table; see :func:`table`."""
    console().print(table(title, heads, rows, caption))


def pretty(value: float, unit: str) -> tuple[str, str]:
    """Number and unit for people; see :func:`unmodeled.units.pretty`."""
    from unmodeled import units

    return units.pretty(value, unit)


# --- JSON ----------------------------------------------------------------------------------------


def as_json_option() -> click.Option:
    """Option ``--json``."""
    text = "Print JSON instead of a table."
    return click.Option(["as_json", "--json"], is_flag=True, help=text)


def print_json(value: Any) -> None:
    """Print JSON on stdout, with keys in a fixed order."""
    click.echo(json.dumps(value, indent=2, sort_keys=True))


def finite(value: float) -> float | None:
    """A number for JSON; None: there is none."""
    return value if math.isfinite(value) else None


def collected_json(function: Callable[..., None], *, as_json: bool, **given: Any) -> None:
    """Call a function that prints tables or writes files, with ``--json`` or without.

    With the option, the printed tables and the names of the written files are printed on stdout as
    one JSON object; numbers have the digits of the tables. All other text is printed on stderr. If
    the function fails after a part of its work, the object has this part and the error.
    """
    if not as_json:
        function(**given)
        return
    collected: dict[str, list[Any]] = {"tables": [], "written": []}
    fault: Error | None = None
    token = _collected.set(collected)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            function(**given)
    except Error as error:
        fault = error
    finally:
        _collected.reset(token)
    result: dict[str, Any] = {key: value for key, value in collected.items() if value}
    if fault is None or result:
        print_json(result | ({} if fault is None else {"error": str(fault)}))
    if fault is not None:
        raise fault


def _table_data(table: Any) -> dict[str, Any]:
    """Title and rows of a table; numeric cells become numbers."""
    heads = [str(column.header) for column in table.columns]
    heads = [h or f"column{i + 1}" for i, h in enumerate(heads)]
    cells = [[str(cell) for cell in column.cells] for column in table.columns]
    rows = [
        {head: _cell_value(text) for head, text in zip(heads, row, strict=True)}
        for row in zip(*cells, strict=True)
    ]
    return {"title": str(table.title or ""), "rows": rows}


def _cell_value(text: str) -> Any:
    try:
        number = float(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else text


# --- progress ------------------------------------------------------------------------------------


def is_terminal() -> bool:
    """Whether a progress line can be drawn."""
    return sys.stderr.isatty()


def redraw(text: str, *, end: bool = False) -> None:
    """Replace the progress line on stderr."""
    click.echo(f"\r\x1b[2K{printable(text)}", nl=end, err=True)


@contextlib.contextmanager
def working(text: str) -> Iterator[Callable[[str], None] | None]:
    """Show on a terminal that a command works; gives the function that changes the text."""
    if not is_terminal():
        yield None
        return
    with console(stderr=True).status(text) as status:
        yield lambda new: status.update(new)


class Line:
    """Progress on stderr: on a terminal one line that is rewritten, else one line per stage."""

    def __init__(self) -> None:
        self._stage = ""

    def show(self, stage: str, text: str) -> None:
        """Show the text of a stage; without a terminal only the name of a new stage."""
        if is_terminal():
            redraw(text[: max(console(stderr=True).width - 1, 20)])
        elif stage != self._stage:
            say(f"{_program.get()}: {stage}", err=True)
        self._stage = stage

    def close(self) -> None:
        """Clear the line."""
        if self._stage and is_terminal():
            redraw("")


class LateLine(Line):
    """Progress of what is usually quick: its first text is shown after two seconds."""

    #: Time without a line [s].
    QUIET = 2.0

    def __init__(self) -> None:
        super().__init__()
        self._text, self._late = "", False
        self._timer = threading.Timer(self.QUIET, self._begin)
        self._timer.daemon = True

    def __enter__(self) -> LateLine:
        self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        self.close()

    def __call__(self, text: str) -> None:
        """What begins."""
        self._text = text
        if self._late:
            self.show(text, text)

    def _begin(self) -> None:
        self._late = True
        self(self._text)


#: Stages of a diagnosis in words.
STAGES = {
    "prepare": "prepares the records",
    "fit": "fits the model",
    "search": "searches causes",
    "exchange": "tries to exchange causes",
    "held_out": "predicts the held-out records",
    "judge": "judges",
    "locate": "looks where something is left",
    "done": "done",
}


class ProgressLine(Line):
    """Progress of a diagnosis on stderr; without a terminal also a line every half a minute."""

    def __init__(self) -> None:
        super().__init__()
        self._next = 0.0

    def __call__(self, p: Progress) -> None:
        """Show the progress."""
        if is_terminal():
            self.show(p.stage, self.text(p))
        elif p.stage not in (self._stage, "done") or p.elapsed >= self._next:
            self._next = p.elapsed + 30.0
            say(f"{_program.get()}: {self.text(p)}", err=True)
        self._stage = p.stage

    @staticmethod
    def text(p: Progress) -> str:
        """The line; the most important parts come first, because its end may be cut."""
        parts = [STAGES.get(p.stage, p.stage), f"{p.share:.0%}", duration(p.elapsed)]
        if math.isfinite(p.left) and p.stage != "done":
            parts.append(f"about {duration(p.left)} left")
            if p.needed > 1.1 * (p.elapsed + p.left):
                parts.append(f"all causes need about {duration(p.needed)} (--seconds)")
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """A time for people: 8 s, 3:20 min, 1:05 h."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    if whole < 6000:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d} h"


# --- files ----------------------------------------------------------------------------


def say_written(path: Path) -> None:
    """Print the name of a written file."""
    collected = _collected.get()
    if collected is not None:
        collected["written"].append(str(path))
    say(f"wrote {path}", err=True)


def save_text(path: Path | None, text: str | Callable[[], str], *, force: bool) -> None:
    """Write a text file, if there is a name, and print its name."""
    from unmodeled.files import write_text

    if path is not None:
        say_written(write_text(path, text if isinstance(text, str) else text(), force=force))


def _picture_kind(path: Path) -> str:
    from unmodeled.errors import InvalidParameter

    kind = path.suffix.lstrip(".").lower()
    if kind not in ("png", "pdf", "svg"):
        raise InvalidParameter(f"{path}: cannot draw .{kind}, expected .png, .pdf or .svg")
    return kind


def save_figure(path: Path | None, draw: Callable[[], Any], *, force: bool) -> None:
    """Draw a figure as PNG, PDF or SVG, if there is a name, and print the name of the file."""
    from unmodeled.files import write_file

    if path is not None:
        kind, figure = _picture_kind(path), draw()
        written = write_file(path, lambda p: figure.savefig(p, format=kind, dpi=150), force=force)
        say_written(written)


def check_targets(*files: Path | None, pictures: Sequence[Path | None] = (), force: bool) -> None:
    """Check all files before any is written: writable, no duplicates, known formats."""
    from unmodeled.errors import InvalidParameter
    from unmodeled.files import check_writable

    targets = [path for path in (*files, *pictures) if path is not None]
    folders: set[Path] = set()
    for path in targets:
        here = path.absolute()
        if any(
            here == other or here in other.parents or other in here.parents for other in folders
        ):
            raise InvalidParameter(f"{path}: is wanted for two results; give each its own name")
        folders.add(here)
    for path in targets:
        check_writable(path, force=force)
    for picture in pictures:
        if picture is not None:
            _picture_kind(picture)


def names_of_files(paths: Sequence[Path]) -> list[str]:
    """Names of files for people: without folder and ending, unless two files have the same."""
    stems = [path.stem for path in paths]
    return [p.stem if stems.count(p.stem) == 1 else str(p) for p in paths]
