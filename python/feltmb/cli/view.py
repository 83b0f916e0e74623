"""``feltmb view``: shows saved runs in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    POSITIVE,
    Quantity,
    complain,
    force_option,
    names_of_files,
    say_written,
    tables_as_json,
)
from feltmb.cli.completing import events
from feltmb.cli.gap_reading import reading_options

if TYPE_CHECKING:
    from feltmb.data import ReadOptions
    from feltmb.graphics.viewer import Curves
    from feltmb.run.results import Run


@click.command("view")
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="HTML file; default: RUN.html.",
)
@click.option(
    "--slowness",
    type=POSITIVE,
    default=20.0,
    show_default=True,
    help="Factor by which the motion is slower than in reality; it can be changed in the page.",
)
@click.option(
    "--window",
    type=(Quantity("s"), Quantity("s")),
    metavar="FROM TO",
    help="Show only this time interval [s].",
)
@click.option(
    "--align",
    metavar="EVENT",
    shell_complete=events,
    help="Shift the runs so that this event, such as string_contact_on, has the same time in all "
    "runs.",
)
@click.option("--at", type=Quantity("s"), help="Start the display at this time [s].")
@reading_options
@force_option
@tables_as_json
def command(
    runs: tuple[Path, ...],
    out: Path | None,
    slowness: float,
    window: tuple[float, float] | None,
    align: str | None,
    at: float | None,
    reading: ReadOptions,
    force: bool,
) -> None:
    """Show saved RUNS in a browser: motion, forces, curves, string.

    Writes one HTML file that needs no network. Up to six runs are compared, with the names of
    their files: the first one is filled, and the others are outlines. A run may also be a file of
    measured curves (CSV, text, MAT) with a header such as "time [s],hammer_tip.vx [m/s]". Its TOML
    file and the options of reading are those of `gap check`.
    """
    from feltmb.graphics.viewer import read_each_run, view
    from feltmb.run.results import load_run

    loaded: list[Run | Curves] = []
    names: list[str] = []
    for path, name in zip(runs, names_of_files(runs), strict=True):
        if path.suffix.lower() in (".nc", ".h5"):
            loaded.append(load_run(path))
            names.append(name)
            continue
        several = read_each_run(path, reading)
        for curves in several:
            loaded.append(curves)
            names.append(name if len(several) == 1 else curves.name)
            for note in curves.notes:
                complain(f"{path}: {note}")
    target = out or runs[0].with_suffix(".html")
    say_written(
        view(
            loaded,
            target,
            names=names if len(loaded) > 1 else None,
            slowness=slowness,
            window=window,
            align=align,
            at=at,
            force=force,
        )
    )
