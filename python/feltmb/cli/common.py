"""What the commands share: consoles, options, numbers for people."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import sys
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from feltmb.mechanism import Action

__all__ = [
    "complain",
    "console",
    "force_option",
    "is_terminal",
    "json_option",
    "load_with_settings",
    "new_table",
    "parse_damper",
    "pretty",
    "print_json",
    "save_figure",
    "say_written",
    "set_option",
    "subject_set_option",
    "tables_as_json",
]

F = TypeVar("F", bound=Callable[..., Any])


#: Length of a line that nobody looks at [characters].
UNFOLDED = 10_000

#: What a command with --json showed and wrote; None while it prints for people.
_collected: ContextVar[dict[str, list[Any]] | None] = ContextVar("collected", default=None)


def console(*, stderr: bool = False) -> Console:
    """Console for tables (stdout) or for progress and messages (stderr).

    Where no terminal is there are no colors, and no line is cut or folded unless COLUMNS says how
    long a line may be.
    """
    from rich.console import Console

    if stderr or _collected.get() is None:
        screen = Console(stderr=stderr, highlight=False, markup=False, emoji=False)
        if not screen.is_terminal and "COLUMNS" not in os.environ:
            screen.width = UNFOLDED
        return screen

    class Collector(Console):
        def print(self, *objects: Any, **_options: Any) -> None:
            found = _collected.get()
            assert found is not None
            found["tables"] += [_table_data(o) for o in objects if hasattr(o, "columns")]

    return Collector(highlight=False, markup=False, emoji=False)


def _table_data(table: Table) -> dict[str, Any]:
    """Title and rows of a table; cells that are numbers as numbers."""
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


def tables_as_json(command: F) -> F:
    """Option ``--json`` of a command that prints tables or writes files.

    With it the tables that the command prints and the names of the files that it writes go to
    stdout as one object; numbers have the digits that the tables show. All other words go to
    stderr.
    """

    @functools.wraps(command)
    def run(*args: Any, as_json: bool, **kwargs: Any) -> None:
        if not as_json:
            command(*args, **kwargs)
            return
        found: dict[str, list[Any]] = {"tables": [], "written": []}
        token = _collected.set(found)
        try:
            with contextlib.redirect_stdout(sys.stderr):
                command(*args, **kwargs)
        finally:
            _collected.reset(token)
        print_json({key: value for key, value in found.items() if value})

    return json_option(cast(F, run))


def complain(text: str) -> None:
    """One message on stderr."""
    click.echo(f"feltmb: {text}", err=True)


def say_written(path: Path) -> None:
    """Name a file that was written."""
    found = _collected.get()
    if found is not None:
        found["written"].append(str(path))
    click.echo(f"wrote {path}", err=True)


def _picture_kind(path: Path) -> str:
    from feltmb.errors import InvalidParameter

    kind = path.suffix.lstrip(".").lower()
    if kind not in ("png", "pdf", "svg"):
        raise InvalidParameter(f"{path}: cannot draw .{kind}, expected .png, .pdf or .svg")
    return kind


def check_targets(*files: Path | None, pictures: tuple[Path | None, ...] = (), force: bool) -> None:
    """Before anything is written: every file could be, none twice, pictures in a known format."""
    from feltmb.errors import InvalidParameter
    from feltmb.files import check_writable

    seen: set[Path] = set()
    for path in (*files, *pictures):
        if path is None:
            continue
        check_writable(path, force=force)
        here = path.absolute()
        if any(here == other or here in other.parents or other in here.parents for other in seen):
            raise InvalidParameter(f"{path}: is wanted for two results; give each its own name")
        seen.add(here)
    for path in pictures:
        if path is not None:
            _picture_kind(path)


def save_figure(figure: Any, path: Path, *, force: bool) -> None:
    """Write a figure as PNG, PDF or SVG and name the file."""
    from feltmb.files import write_file

    kind = _picture_kind(path)
    say_written(write_file(path, lambda p: figure.savefig(p, format=kind, dpi=150), force=force))


def new_table(
    title: str, *columns: str, right: tuple[int, ...] = (), whole: tuple[int, ...] = ()
) -> Table:
    """Table that prints well at 80 columns.

    ``right``: indices of right-aligned columns; ``whole``: of those whose cells are never folded.
    """
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE, title_justify="left", pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(
            column, justify="right" if i in right else "left", overflow="fold", no_wrap=i in whole
        )
    return table


_SCALES = {
    "m": [(1e-6, 1e6, "um"), (1.0, 1e3, "mm")],
    "s": [(1.0, 1e3, "ms")],
    "J": [(1.0, 1e3, "mJ")],
}


def pretty(value: float, unit: str) -> tuple[str, str]:
    """Number and unit for people: small lengths in mm, short times in ms."""
    for limit, factor, name in _SCALES.get(unit, []):
        if abs(value) < limit:
            return f"{value * factor:.4g}", name
    return f"{value:.4g}", unit


def print_json(value: Any) -> None:
    """JSON on stdout, keys in a fixed order."""
    click.echo(json.dumps(value, indent=2, sort_keys=True))


class Number(click.FloatRange):
    """A finite number within bounds, which the help shows."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number, or a message."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number.", param, ctx)
        return number


POSITIVE = Number(0, min_open=True)
NOT_NEGATIVE = Number(0)
FRACTION = Number(0, 1, min_open=True, max_open=True)


def _settings(metavar: str, text: str) -> Callable[[F], F]:
    return click.option("--set", "settings", multiple=True, metavar=metavar, help=text)


def set_option(function: F) -> F:
    """Option ``--set PATH=VALUE``, any number of times."""
    return _settings(
        "PATH=VALUE",
        "Change a value of the mechanism by its dotted path, such as string.modes=80 or "
        "contacts.*.law=printed. Repeatable.",
    )(function)


def subject_set_option(function: F) -> F:
    """Option ``--set NAME=VALUE`` of what is fitted or diagnosed, any number of times."""
    return _settings(
        "NAME=VALUE",
        "Setting of a packaged mechanism or mechanism file: channels=key,hammer, effects=all, "
        "tolerances=felt.*, library, shooting, until, floor, rtol, window, derivatives; or a value "
        "of the mechanism by its dotted path, such as string.modes=80. Repeatable.",
    )(function)


def force_option(function: F) -> F:
    """Option ``--force``."""
    return click.option("--force", is_flag=True, help="Replace files that exist.")(function)


def json_option(function: F) -> F:
    """Option ``--json``."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")(
        function
    )


def load_with_settings(name: str, settings: tuple[str, ...]) -> Action:
    """Mechanism by name or path, with the values of ``--set``."""
    from feltmb.mechanism import load_action, parse_setting

    action = load_action(name)
    if settings:
        action = action.with_values(dict(parse_setting(text) for text in settings))
    return action


def parse_option(option: str, text: str, unit: str) -> float:
    """Value of an option with its unit, such as 6mm, in an SI unit.

    Raises
    ------
    InvalidParameter
        Naming the option.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.units.quantity import parse_scalar

    try:
        return parse_scalar(text, unit)
    except ValueError as error:
        raise InvalidParameter(f"{option}: {error}") from None


def parse_damper(text: str) -> tuple[str, float | None]:
    """Kind and coefficient [N m s/rad] of ``--damper one-sided=0.05``."""
    kind, sign, value = text.partition("=")
    return kind.strip(), parse_option("--damper", value, "N m s/rad") if sign else None


def is_terminal() -> bool:
    """Whether progress may be drawn."""
    return sys.stderr.isatty()
