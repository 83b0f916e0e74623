"""``feltmb wav``: the sound of the string."""

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
    help="Position [m] from the end y = 0 at which the string displacement is the signal; default: "
    "the force at the bridge end.",
)
@click.option(
    "--slowness",
    type=POSITIVE,
    default=1.0,
    show_default=True,
    help="Factor by which the motion is slower than in reality.",
)
@force_option
@tables_as_json
def command(
    run: Path, out: Path | None, position: float | None, slowness: float, force: bool
) -> None:
    """Write the string vibration of a saved RUN as a WAV file."""
    from feltmb.run.results import load_run

    target = out or run.with_suffix(".wav")
    say_written(load_run(run).write_wav(target, position=position, slowness=slowness, force=force))
