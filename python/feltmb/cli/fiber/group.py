"""The group ``feltmb fiber``, and the common parts of its commands."""

from __future__ import annotations

import csv
import functools
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import complain, console, new_table, say_written, tables_as_json

__all__ = [
    "EXIT_BAD_INPUT",
    "EXIT_FAILED",
    "csv_text",
    "fiber",
    "guard",
    "numbers",
    "parameter_units",
    "print_table",
    "quantities",
    "refuse_existing",
    "seed_option",
    "write_named",
]

seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random draws."
)

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2


def guard(command: Callable[..., None]) -> Callable[..., None]:
    """Convert an exception of feltmb to one message and its exit code."""
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
    """Print rows; the first ``words`` columns contain words, the others numbers."""
    table = new_table(title, *columns, right=tuple(range(words, len(columns))))
    for row in rows:
        table.add_row(*row)
    console().print(table)


def write_named(path: Path, text: str, force: bool) -> None:
    """Write a text file and print its name."""
    from feltmb.files import write_text

    say_written(write_text(path, text, force=force))


def refuse_existing(path: Path, force: bool) -> None:
    """Reject an existing path before any computation."""
    from feltmb.files import check_writable

    check_writable(path, force=force)


def parameter_units(*laws: Any) -> dict[str, str]:
    """SI unit of each parameter of these laws, from ``models()``."""
    return {p.name: p.unit or "1" for law in laws for p in law.parameters}


def quantities(
    pairs: Sequence[str], what: str, units: Mapping[str, str], *, separator: str = ""
) -> dict[str, list[float]]:
    """``name=value`` pairs with units, in SI units; all faults are in one message.

    ``separator`` separates several values of one parameter, if permitted.
    """
    from feltmb.errors import InvalidParameter

    out: dict[str, list[float]] = {}
    faults: list[str] = []
    powers: list[tuple[str, str, str]] = []  # name, unit and text; the unit still needs an exponent
    for pair in pairs:
        name, equals, text = (part.strip() for part in pair.partition("="))
        unit = units.get(name, "1")
        if not equals:
            faults.append(f'{what}: "{pair}", expected name=value, for example gamma=1.3')
        elif name not in units:
            known = ", ".join(units)
            faults.append(f'{what}: parameter "{name}" is unknown, expected one of {known}')
        elif unit.rpartition("^")[2] in units:
            powers.append((name, unit, text))
        else:
            _add_values(out, faults, what, name, unit, text, separator)
    for name, unit, text in powers:
        head, _, exponent = unit.rpartition("^")
        known_unit = f"{head}^{out[exponent][0]:g}" if exponent in out else "1"
        _add_values(out, faults, what, name, known_unit, text, separator)
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


def _add_values(
    out: dict[str, list[float]],
    faults: list[str],
    what: str,
    name: str,
    unit: str,
    text: str,
    separator: str,
) -> None:
    from feltmb.units.quantity import parse_scalar

    try:
        out[name] = [
            parse_scalar(v, unit) for v in (text.split(separator) if separator else [text])
        ]
    except ValueError as error:
        faults.append(f"{what}: {name}: {error}")


def numbers(pairs: Sequence[str], what: str, units: Mapping[str, str]) -> dict[str, float]:
    """``name=value`` pairs with one value each."""
    return {name: values[0] for name, values in quantities(pairs, what, units).items()}


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
