"""Common parts of the commands: consoles, options, numbers for people."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from feltmb.cli import completing
from feltmb.cli.messages import complain
from feltmb.errors import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from feltmb.action.actuator import Actuator
    from feltmb.gap import Progress
    from feltmb.mechanism import Action

__all__ = [
    "ListOption",
    "ProgressLine",
    "Quantity",
    "caution",
    "complain",
    "console",
    "diameter_option",
    "force_option",
    "is_terminal",
    "json_option",
    "list_option",
    "load_with_settings",
    "model_set_option",
    "modulus_option",
    "names_of_files",
    "new_table",
    "parse_damper",
    "positive",
    "pretty",
    "print_json",
    "redraw",
    "save_figure",
    "say",
    "say_written",
    "set_option",
    "split_list",
    "split_pairs",
    "tables_as_json",
    "with_settings",
    "zero_option",
]

F = TypeVar("F", bound=Callable[..., Any])
M = TypeVar("M", "Action", "Actuator")


#: Length of an unlimited line [characters].
UNFOLDED = 10_000

#: Results and written files of a command with --json; None without this option.
_collected: ContextVar[dict[str, list[Any]] | None] = ContextVar("collected", default=None)


def console(*, stderr: bool = False) -> Console:
    """Console for tables (stdout) or for progress and messages (stderr).

    Without a terminal there are no colors, and lines are neither cut nor folded unless COLUMNS
    states a line length.
    """
    from rich.console import Console

    from feltmb.tables import Screen

    if stderr or _collected.get() is None:
        screen = Screen(stderr=stderr, highlight=False, markup=False, emoji=False)
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


def tables_as_json(command: F) -> F:
    """Option ``--json`` of a command that prints tables or writes files.

    With the option, the printed tables and the names of the written files are printed on stdout as
    one JSON object; numbers have the digits of the tables. All other text is printed on stderr.
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


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text; control characters in names of files are escaped.

    All commands print with this function or with :func:`console`. On stdout, long lines are folded
    between words if the screen is narrow.
    """
    text = printable(text)
    if not err:
        from feltmb.tables import folded_text

        text = folded_text(text, console().width)
    click.echo(text, err=err, nl=nl)


def redraw(text: str, *, end: bool = False) -> None:
    """Replace the progress line on stderr."""
    click.echo(f"\r\x1b[2K{printable(text)}", nl=end, err=True)


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


class ProgressLine:
    """Progress of a diagnosis on stderr.

    On a terminal, one line is rewritten; elsewhere, one line per stage and one every half a minute
    is printed.
    """

    def __init__(self) -> None:
        self._stage = ""
        self._next = 0.0

    def __call__(self, p: Progress) -> None:
        """Show the progress."""
        if is_terminal():
            redraw(self.text(p)[: max(console(stderr=True).width - 1, 20)])
        elif p.stage not in (self._stage, "done") or p.elapsed >= self._next:
            self._next = p.elapsed + 30.0
            say(f"feltmb: {self.text(p)}", err=True)
        self._stage = p.stage

    @staticmethod
    def text(p: Progress) -> str:
        """The line; the most important parts come first, because its end may be cut."""
        parts = [STAGES.get(p.stage, p.stage), f"{p.share:.0%}", duration(p.elapsed)]
        if math.isfinite(p.left) and p.stage != "done":
            parts.append(f"about {duration(p.left)} left")
        return ", ".join(parts)

    def close(self) -> None:
        """Clear the line."""
        if self._stage and is_terminal():
            redraw("")


def duration(seconds: float) -> str:
    """A time for people: 8 s, 3:20 min, 1:05 h."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    if whole < 6000:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d} h"


def say_written(path: Path) -> None:
    """Print the name of a written file."""
    found = _collected.get()
    if found is not None:
        found["written"].append(str(path))
    say(f"wrote {path}", err=True)


def _picture_kind(path: Path) -> str:
    from feltmb.errors import InvalidParameter

    kind = path.suffix.lstrip(".").lower()
    if kind not in ("png", "pdf", "svg"):
        raise InvalidParameter(f"{path}: cannot draw .{kind}, expected .png, .pdf or .svg")
    return kind


class FileName(click.Path):
    """Name of a file to be written, with a suffix that the command supports."""

    def __init__(self, *suffixes: str, dir_okay: bool = True):
        super().__init__(path_type=Path, dir_okay=dir_okay)
        self.suffixes = suffixes

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        from feltmb.files import check_suffix

        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        check_suffix(path, *self.suffixes)
        return path


class FolderName(click.Path):
    """Name of a folder to be written, which is not the name of a file."""

    def __init__(self, file_okay: bool = True) -> None:
        super().__init__(path_type=Path, file_okay=file_okay)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        from feltmb.files import check_folder

        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        check_folder(path)
        return path


def check_targets(*files: Path | None, pictures: tuple[Path | None, ...] = (), force: bool) -> None:
    """Check all files before any is written: writable, no duplicates, known formats."""
    from feltmb.errors import InvalidParameter
    from feltmb.files import check_writable

    targets = [path for path in (*files, *pictures) if path is not None]
    seen: set[Path] = set()
    for path in targets:
        here = path.absolute()
        if any(here == other or here in other.parents or other in here.parents for other in seen):
            raise InvalidParameter(f"{path}: is wanted for two results; give each its own name")
        seen.add(here)
    for path in targets:
        check_writable(path, force=force)
    for picture in pictures:
        if picture is not None:
            _picture_kind(picture)


def save_figure(figure: Any, path: Path, *, force: bool) -> None:
    """Write a figure as PNG, PDF or SVG, and print the name of the file."""
    from feltmb.files import write_file

    kind = _picture_kind(path)
    say_written(write_file(path, lambda p: figure.savefig(p, format=kind, dpi=150), force=force))


def new_table(
    title: str, *columns: str, right: tuple[int, ...] = (), whole: tuple[int, ...] = ()
) -> Table:
    """Table that fits the screen; see :func:`feltmb.tables.new_table`."""
    from feltmb import tables

    return tables.new_table(title, *columns, right=right, whole=whole)


def pretty(value: float, unit: str) -> tuple[str, str]:
    """Number and unit for people; see :func:`feltmb.units.pretty`."""
    from feltmb import units

    return units.pretty(value, unit)


def print_json(value: Any) -> None:
    """Print JSON on stdout, with keys in a fixed order."""
    click.echo(json.dumps(value, indent=2, sort_keys=True))


#: SI unit of an option -> name of its value in the help.
_KINDS = {
    "m": "LENGTH",
    "m^2": "AREA",
    "s": "TIME",
    "rad": "ANGLE",
    "Hz": "RATE",
    "Pa": "PRESSURE",
    "N/m": "FORCE/LENGTH",
}


class Quantity(click.FloatRange):
    """A finite number with a unit, such as 25um or "3 cm^2", within limits in the SI unit.

    A number without a unit is in the SI unit, which the help shows. The parser is also used for
    files, so that units are written in the same way everywhere.

    Parameters
    ----------
    unit
        SI unit of the value; "1" for a plain number, which may also be in %.
    low, high
        Limits in that unit.
    """

    name = "quantity"

    def __init__(
        self,
        unit: str,
        low: float | None = None,
        high: float | None = None,
        *,
        min_open: bool = False,
        max_open: bool = False,
    ) -> None:
        super().__init__(low, high, min_open=min_open, max_open=max_open)
        self.unit = unit

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str | None:
        """Text after the option in the help."""
        del ctx
        if isinstance(param, click.Argument):
            return None
        return "NUMBER" if self.unit == "1" else f"{_KINDS.get(self.unit, 'NUMBER')}[{self.unit}]"

    def _describe_range(self) -> str:
        return "" if self.min is None and self.max is None else super()._describe_range()

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number in the SI unit, or an error message."""
        from feltmb.units.quantity import parse_scalar

        try:
            number = parse_scalar(value, self.unit)
        except ValueError as error:
            self.fail(str(error), param, ctx)
        return float(super().convert(number, param, ctx))


class Number(Quantity):
    """A plain number within limits."""

    def __init__(
        self,
        low: float | None = None,
        high: float | None = None,
        *,
        min_open: bool = False,
        max_open: bool = False,
    ) -> None:
        super().__init__("1", low, high, min_open=min_open, max_open=max_open)


def positive(unit: str) -> Quantity:
    """A quantity > 0 with this SI unit."""
    return Quantity(unit, 0, min_open=True)


zero_option = click.option(
    "--zero",
    type=Quantity("m"),
    help="Displacement at the first contact [m], such as 0.35mm, for displacement data; "
    "default: 0.",
)


POSITIVE = Number(0, min_open=True)
NOT_NEGATIVE = Number(0)
FRACTION = Number(0, 1, min_open=True, max_open=True)

_BRACKETS = {"(": ")", "[": "]", "{": "}"}
_ASSIGNMENT = re.compile(r"\s*[\w.*\[\]-]+\s*\+?=")


def split_list(text: str) -> list[str]:
    """Items of a list separated by commas; commas in brackets or quotes do not separate.

    If the list begins with NAME=VALUE, a comma only separates before the next NAME=, so that a
    value may be a list: ``a=1,2,b=3`` has two items.

    Raises
    ------
    ValueError
        An item is empty.
    """
    pairs = _ASSIGNMENT.match(text) is not None
    items, start, quote = [], 0, ""
    closing: list[str] = []
    for i, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in _BRACKETS:
            closing.append(_BRACKETS[letter])
        elif closing and letter == closing[-1]:
            closing.pop()
        elif letter == "," and not closing and (not pairs or _ASSIGNMENT.match(text, i + 1)):
            items.append(text[start:i].strip())
            start = i + 1
    items.append(text[start:].strip())
    if not all(items):
        raise ValueError(f"got {text!r}, expected items between commas, none of them empty")
    return items


class ListOption(click.Option):
    """Option that may be repeated and accepts lists with commas: ``-x a -x b`` is ``-x a,b``."""

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """All items, converted."""
        items: list[Any] = []
        for given in value or ():
            try:
                # A file whose name contains a comma is one item.
                whole = not isinstance(given, str) or Path(given).exists()
                items += [given] if whole else split_list(given)
            except ValueError as error:
                raise click.BadParameter(str(error), ctx, self) from None
            except OSError:  # too long for a file name
                items += split_list(given)
        return super().type_cast_value(ctx, tuple(items))


def list_option(*declarations: str, **attributes: Any) -> Callable[[F], F]:
    """An option with a list as value: repeated, separated by commas, or both."""
    text = attributes.pop("help")
    return click.option(
        *declarations,
        cls=ListOption,
        multiple=True,
        help=f"{text} Repeatable, or a list with commas.",
        **attributes,
    )


def _settings(metavar: str, text: str) -> Callable[[F], F]:
    return list_option(
        "--set", "settings", metavar=metavar, shell_complete=completing.settings, help=text
    )


def set_option(function: F) -> F:
    """Option ``--set PATH=VALUE`` (also ``+=``, ``-=``, ``*=``), which may be repeated."""
    return _settings(
        "PATH=VALUE",
        "Change a value of the mechanism by its dotted path, such as string.modes=80 or "
        "contacts.*.law=printed; a bare number is in SI units. PATH+=AMOUNT, "
        "PATH-=AMOUNT and PATH*=FACTOR change a number: surfaces.Gp10.point.y+=0.5mm.",
    )(function)


def model_set_option(function: F) -> F:
    """Option ``--set NAME=VALUE`` of a model, which may be repeated."""
    return _settings(
        "NAME=VALUE",
        "Setting of a packaged mechanism or mechanism file: channels=key,hammer, effects=all, "
        "tolerances=felt.*, library, until, variation, rtol, segment; or a "
        "value of the mechanism by its dotted path, such as string.modes=80 or "
        "surfaces.Gp10.point.y+=0.5mm.",
    )(function)


def force_option(function: F) -> F:
    """Option ``--force``."""
    return click.option("--force", is_flag=True, help="Overwrite existing files.")(function)


def picture_option(text: str) -> Callable[[F], F]:
    """Option ``--plot FILE`` of a command that draws one picture."""
    return click.option(
        "--plot",
        "picture",
        metavar="FILE",
        type=FileName(".png", ".pdf", ".svg", dir_okay=False),
        help=text,
    )


def json_option(function: F) -> F:
    """Option ``--json``."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")(
        function
    )


def folder_option(text: str, *, required: bool = False) -> Callable[[F], F]:
    """Option ``--out DIRECTORY`` as the argument ``output``; ``text`` is its help."""
    return click.option(
        "--out",
        "-o",
        "output",
        metavar="DIRECTORY",
        type=FolderName(),
        required=required,
        help=text,
    )


credibility_option = click.option(
    "--credibility",
    type=Number(0.5, 1, max_open=True),
    default=0.9,
    show_default=True,
    help="Posterior probability that a named effect needs, compared with the other causes of the "
    "library.",
)


def caution(name: str) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Callback of an option that warns of an unusual number of fibers."""

    def check(_context: click.Context, _parameter: click.Parameter, value: Any) -> Any:
        if value is not None:
            from feltmb.fiber import unusual

            for text in unusual(**{name: value}):
                complain(f"warning: {text}")
        return value

    return check


modulus_option = click.option(
    "--e-modulus",
    "modulus",
    type=positive("Pa"),
    default="2.5 GPa",
    show_default=True,
    callback=caution("E"),
    help="Fiber modulus [Pa].",
)
diameter_option = click.option(
    "--d-f",
    type=positive("m"),
    default="25 um",
    show_default=True,
    callback=caution("d_f"),
    help="Fiber diameter [m].",
)


def load_with_settings(name: str, settings: tuple[str, ...]) -> Action:
    """Mechanism by name or path, with the values of ``--set``."""
    from feltmb.mechanism import load_action

    return with_settings(load_action(name), settings)


def with_settings(model: M, settings: Sequence[str]) -> M:
    """Model of a file with the values of ``--set``; tells what changed numbers became."""
    from feltmb.mechanism.parameters import with_values_told

    return with_values_told(model, settings, complain)


def parse_option(option: str, text: str, unit: str) -> float:
    """Value of an option with its unit, such as 6mm, in SI units.

    Raises
    ------
    InvalidParameter
        The value is invalid; the message names the option.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.units.quantity import parse_scalar

    try:
        return parse_scalar(text, unit)
    except ValueError as error:
        raise InvalidParameter(f"{option}: {error}") from None


def split_pairs(option: str, texts: Sequence[str], form: str) -> dict[str, str]:
    """Names and values of an option that is given as ``NAME=VALUE``, as text.

    Parameters
    ----------
    option
        Name of the option, for the message.
    texts
        Values of the option.
    form
        What is expected, for the message.

    Raises
    ------
    click.UsageError
        A text is no pair, or a name is given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise click.UsageError(f"{option} {text}: expected {form}")
        if name in found:
            raise click.UsageError(f"{option} {name}: given twice")
        found[name] = value
    return found


def parse_damper(text: str) -> tuple[str, float | None]:
    """Kind and coefficient [N m s/rad] from ``--damper one-sided=0.05``."""
    kind, sign, value = text.partition("=")
    return kind.strip(), parse_option("--damper", value, "N m s/rad") if sign else None


def is_terminal() -> bool:
    """Whether a progress line can be drawn."""
    return sys.stderr.isatty()


def names_of_files(paths: Sequence[Path]) -> list[str]:
    """Names of files for people: without folder and ending, unless two files have the same."""
    stems = [path.stem for path in paths]
    return [p.stem if stems.count(p.stem) == 1 else str(p) for p in paths]
