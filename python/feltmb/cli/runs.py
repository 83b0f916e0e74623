"""``feltmb plot``, ``view``, ``animate``, ``wav``: pictures and sound of saved runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from feltmb.cli.completing import events, outputs
from unmodeled.cli.models import READING
from unmodeled.cli.options import (
    FORCE,
    POSITIVE,
    FileName,
    FolderName,
    Quantity,
    argument,
    count,
    declare,
    option,
)
from unmodeled.cli.screen import complain, names_of_files, say_written

if TYPE_CHECKING:
    from feltmb.graphics.viewer import Curves
    from feltmb.run.results import Run
    from unmodeled.data import ReadOptions

SLOWNESS = "Factor by which the motion is slower than in reality"
WINDOW = option(
    "Show only this time interval [s].", (Quantity("s"), Quantity("s")), metavar="FROM TO"
)


@declare("plot")
def plot(
    runs: tuple[Path, ...] = argument(),
    out: Path | None = option(
        "Folder for the plots; default: the folder of each run.", FolderName()
    ),
    compare: tuple[str, ...] = option(
        "Draw only this output, with all runs in one plot, such as hammer_tip.x. The legend has "
        "the names of the files.",
        metavar="OUTPUT",
        complete=outputs,
    ),
    force: bool = FORCE,
) -> None:
    """Draw all plots of each run, or compare selected outputs of RUNS."""
    from feltmb.graphics.plot import compare as overlay
    from feltmb.graphics.plot import save_all
    from feltmb.run.results import load_run
    from unmodeled.files import make_folder, write_file

    loaded = [load_run(path) for path in runs]
    if compare:
        figure = overlay(loaded, list(compare), names_of_files(runs))
        folder = runs[0].parent if out is None else make_folder(out)
        target = folder / "compare.png"
        say_written(write_file(target, lambda p: figure.savefig(p, dpi=150), force=force))
        return
    for path, run in zip(runs, loaded, strict=True):
        for written in save_all(run, out or path.parent, path.stem, force=force):
            say_written(written)


@declare("view")
def view(
    runs: tuple[Path, ...] = argument(),
    out: Path | None = option("HTML file; default: RUN.html.", metavar="FILE"),
    slowness: float = option(f"{SLOWNESS}; it can be changed in the page.", POSITIVE, 20.0),
    window: tuple[float, float] | None = WINDOW,
    align: str | None = option(
        "Shift the runs so that this event, such as string_contact_on, has the same time in all "
        "runs.",
        metavar="EVENT",
        complete=events,
    ),
    at: float | None = option("Start the display at this time [s].", Quantity("s")),
    reading: ReadOptions = READING,
    force: bool = FORCE,
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
    made = view(
        loaded,
        out or runs[0].with_suffix(".html"),
        names=names if len(loaded) > 1 else None,
        slowness=slowness,
        window=window,
        align=align,
        at=at,
        force=force,
    )
    say_written(made)


@declare("animate")
def animate(
    run: Path = argument(),
    out: Path | None = option("GIF file; default: RUN.gif.", metavar="FILE"),
    slowness: float = option(f"{SLOWNESS}.", POSITIVE, 20.0),
    fps: int = option("Frames per second.", count(1, 50), 30),
    window: tuple[float, float] | None = WINDOW,
    force: bool = FORCE,
) -> None:
    """Animate the mechanism of a saved RUN."""
    from feltmb.graphics.animate import animate
    from feltmb.run.results import load_run

    target = out or run.with_suffix(".gif")
    say_written(
        animate(load_run(run), target, fps=fps, slowness=slowness, window=window, force=force)
    )


@declare("wav")
def wav(
    run: Path = argument(),
    out: Path | None = option(
        "WAV file; default: RUN.wav.", FileName(".wav", dir_okay=True), metavar="FILE"
    ),
    position: float | None = option(
        "Position [m] from the end y = 0 at which the string displacement is the signal; default: "
        "the force at the bridge end.",
        Quantity("m"),
    ),
    slowness: float = option(f"{SLOWNESS}.", POSITIVE, 1.0),
    force: bool = FORCE,
) -> None:
    """Write the string vibration of a saved RUN as a WAV file."""
    from feltmb.run.results import load_run

    target = out or run.with_suffix(".wav")
    say_written(load_run(run).write_wav(target, position=position, slowness=slowness, force=force))
