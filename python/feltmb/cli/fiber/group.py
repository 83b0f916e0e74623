"""The group ``feltmb fiber`` and what its commands share."""

from __future__ import annotations

import csv
import functools
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import POSITIVE, complain, console, new_table, say_written, tables_as_json

__all__ = [
    "EXIT_BAD_INPUT",
    "EXIT_FAILED",
    "csv_text",
    "fiber",
    "guard",
    "modulus_option",
    "numbers",
    "print_table",
    "refuse_existing",
    "seed_option",
    "write_named",
]

modulus_option = click.option(
    "--e-modulus",
    "modulus",
    type=POSITIVE,
    default="2.5e9",
    show_default=True,
    help="Fiber modulus [Pa].",
)
seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Of all that is random."
)

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2


def guard(command: Callable[..., None]) -> Callable[..., None]:
    """Turn our errors into one message and the exit code that belongs to it."""
    with_json = tables_as_json(command)

    @functools.wraps(with_json)
    def run(*args: Any, **kwargs: Any) -> None:
        from feltmb.errors import FeltmbError, FileExists, InvalidParameter

        try:
            with_json(*args, **kwargs)
        except FeltmbError as error:
            complain(str(error))
            bad_input = isinstance(error, InvalidParameter | FileExists)
            raise click.exceptions.Exit(EXIT_BAD_INPUT if bad_input else EXIT_FAILED) from None

    return run


def print_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, words: int = 1
) -> None:
    """Print rows; the first ``words`` columns hold words, the others numbers."""
    table = new_table(title, *columns, right=tuple(range(words, len(columns))))
    for row in rows:
        table.add_row(*row)
    console().print(table)


def write_named(path: Path, text: str, force: bool) -> None:
    """Write a text file and say so."""
    from feltmb.files import write_text

    say_written(write_text(path, text, force=force))


def refuse_existing(path: Path, force: bool) -> None:
    """Refuse a path that is taken, before anything is computed."""
    from feltmb.files import check_writable

    check_writable(path, force=force)


def numbers(pairs: Sequence[str], what: str) -> dict[str, float]:
    """``name=number`` pairs; all faults at once."""
    from feltmb.errors import InvalidParameter

    out: dict[str, float] = {}
    faults = []
    for pair in pairs:
        name, equals, value = pair.partition("=")
        try:
            if not equals:
                raise ValueError
            out[name.strip()] = float(value)
        except ValueError:
            faults.append(f'{what}: "{pair}", expected name=number, for example gamma=1.3')
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


def csv_text(columns: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    """Rows of numbers as CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([f"{x:.10g}" for x in row])
    return stream.getvalue()


@click.group(name="fiber")
def fiber() -> None:
    """Micromechanics of fiber networks: explore, fit and simulate felt."""
