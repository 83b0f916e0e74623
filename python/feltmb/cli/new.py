"""``feltmb new``: writes a commented mechanism file, or the TOML file of a measured file."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import complain, force_option, model_set_option, say_written, tables_as_json
from feltmb.cli.completing import actions
from feltmb.cli.gap_reading import reading_options

if TYPE_CHECKING:
    from feltmb.data import ReadOptions


@click.command("new")
@click.argument("path", type=click.Path(path_type=Path), required=False)
@click.option(
    "--record",
    type=click.Path(path_type=Path),
    metavar="DATA",
    help="Write the TOML file of this measured file, with a first assignment of its columns.",
)
@click.option(
    "--model",
    metavar="MODEL",
    shell_complete=actions,
    help="With --record: the model whose channels are assigned to the columns, as in gap diagnose.",
)
@reading_options
@model_set_option
@force_option
@tables_as_json
def command(
    path: Path | None,
    record: Path | None,
    model: str | None,
    reading: ReadOptions,
    settings: tuple[str, ...],
    force: bool,
) -> None:
    """Write a commented mechanism file to PATH: a pendulum hammer on felt, ready to run.

    With --record: write the TOML file of a measured file for `gap check`, `gap diagnose` and `fit`,
    at PATH or in the folder of the measured file.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.files import check_writable, write_text

    if path is None and record is not None:
        path = record.with_suffix(".toml")
    if path is None:
        raise InvalidParameter("new: expected the name of a file to write, or --record DATA")
    if path.suffix != ".toml":
        raise InvalidParameter(f"new: got {str(path)!r}, expected a name that ends in .toml")
    if record is None:
        if model is not None:
            raise InvalidParameter("new: --model works with --record")
        template = resources.files("feltmb") / "params" / "template.toml.txt"
        text = template.read_text(encoding="utf-8")
    else:
        check_writable(path, force=force)
        text, lacks = _sketch(record, model, reading, settings)
        if lacks:
            complain(lacks)
    say_written(write_text(path, text, force=force))


def _sketch(
    record: Path, model: str | None, reading: ReadOptions, settings: tuple[str, ...]
) -> tuple[str, str]:
    from feltmb.data.sketch import sketch_sheet
    from feltmb.errors import DataError
    from feltmb.files import is_file, why_missing

    if not is_file(record):
        raise DataError(f"{record}: {why_missing(record)}")
    if model is None:
        return sketch_sheet(record, None, reading)
    from feltmb.cli.gap_models import load_adapter

    return sketch_sheet(record, load_adapter(model, settings).signals, reading)
