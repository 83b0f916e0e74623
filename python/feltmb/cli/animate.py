"""``feltmb animate``: a moving picture of a saved run."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import POSITIVE, Quantity, force_option, say_written, tables_as_json


@click.command("animate")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="GIF file; default: RUN.gif.",
)
@click.option(
    "--slowness",
    type=POSITIVE,
    default=20.0,
    show_default=True,
    help="Factor by which the motion is slower than in reality.",
)
@click.option(
    "--fps",
    type=click.IntRange(1, 50),
    default=30,
    show_default=True,
    help="Frames per second.",
)
@click.option(
    "--window",
    type=(Quantity("s"), Quantity("s")),
    metavar="FROM TO",
    help="Show only this time interval [s].",
)
@force_option
@tables_as_json
def command(
    run: Path,
    out: Path | None,
    slowness: float,
    fps: int,
    window: tuple[float, float] | None,
    force: bool,
) -> None:
    """Animate the mechanism of a saved RUN."""
    from feltmb.graphics.animate import animate
    from feltmb.run.results import load_run

    target = out or run.with_suffix(".gif")
    say_written(
        animate(load_run(run), target, fps=fps, slowness=slowness, window=window, force=force)
    )
