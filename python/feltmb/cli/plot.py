"""``feltmb plot``: plots of saved runs."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import (
    FolderName,
    force_option,
    list_option,
    names_of_files,
    say_written,
    tables_as_json,
)
from feltmb.cli.completing import outputs


@click.command("plot")
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    type=FolderName(file_okay=False),
    help="Folder for the plots; default: the folder of each run.",
)
@list_option(
    "--compare",
    metavar="OUTPUT",
    shell_complete=outputs,
    help="Draw only this output, with all runs in one plot, such as hammer_tip.x. The legend has "
    "the names of the files.",
)
@force_option
@tables_as_json
def command(
    runs: tuple[Path, ...], out: Path | None, compare: tuple[str, ...], force: bool
) -> None:
    """Draw all plots of each run, or compare selected outputs of RUNS."""
    from feltmb.files import make_folder, write_file
    from feltmb.graphics.plot import compare as overlay
    from feltmb.graphics.plot import save_all
    from feltmb.run.results import load_run

    loaded = [load_run(path) for path in runs]
    if compare:
        figure = overlay(loaded, list(compare), names_of_files(runs))
        if out is not None:
            make_folder(out)
        target = (out or runs[0].parent) / "compare.png"
        say_written(write_file(target, lambda p: figure.savefig(p, dpi=150), force=force))
        return
    for path, run in zip(runs, loaded, strict=True):
        for written in save_all(run, out or path.parent, path.stem, force=force):
            say_written(written)
