"""``feltmb wav``: the string as sound."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import (
    POSITIVE,
    FileName,
    Quantity,
    force_option,
    say_written,
    tables_as_json,
)


@click.command("wav")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    metavar="FILE",
    type=FileName(".wav"),
    help="WAV file; default: RUN.wav.",
)
@click.option(
    "--position",
    type=Quantity("m"),
    help="Listen to the string's displacement here [m] from "
    "its end y = 0; default: the force at the bridge end.",
)
@click.option(
    "--slowness",
    type=POSITIVE,
    default=1.0,
    show_default=True,
    help="How many times slower than life.",
)
@force_option
@tables_as_json
def command(
    run: Path, out: Path | None, position: float | None, slowness: float, force: bool
) -> None:
    """Write the string of a saved RUN as a WAV file."""
    from feltmb.run.results import load_run

    target = out or run.with_suffix(".wav")
    say_written(load_run(run).write_wav(target, position=position, slowness=slowness, force=force))
