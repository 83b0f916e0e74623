"""``feltmb demo``: a complete example from simulation to figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    FolderName,
    console,
    is_terminal,
    new_table,
    pretty,
    say,
    say_written,
    set_option,
    tables_as_json,
)

if TYPE_CHECKING:
    from feltmb.run.results import Run

STROKES = ("piano", "forte", "staccato")


@click.command("demo")
@click.option(
    "--out",
    "-o",
    type=FolderName(file_okay=False),
    default=Path("out"),
    show_default=True,
    help="Folder for the results. Files of an earlier demo are overwritten.",
)
@click.option("--no-animation", is_flag=True, help="Omit the animation (the slowest part).")
@set_option
@tables_as_json
def command(out: Path, no_animation: bool, settings: tuple[str, ...]) -> None:
    """Simulate the strokes piano, forte and staccato of steinway45.

    Prints the results with the published values, and writes NetCDF files, plots and an animation.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from feltmb.cli.common import load_with_settings
    from feltmb.cli.stroke import strike_tables, summary_table
    from feltmb.files import make_folder, write_file
    from feltmb.graphics.animate import animate
    from feltmb.graphics.plot import mechanism as draw
    from feltmb.graphics.plot import picture_rate, save_all
    from feltmb.graphics.viewer import view
    from feltmb.run.options import RunOptions
    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import load_stroke

    action = load_with_settings("steinway45", settings)
    make_folder(out)
    screen = console()
    written: list[Path] = []
    runs: dict[str, Run] = {}
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=console(stderr=True),
        disable=not is_terminal(),
    )

    def step(task: Any, text: str) -> None:
        bar.update(task, description=text)
        if not is_terminal():
            say(text, err=True)

    with bar:
        task = bar.add_task("demo", total=2 * len(STROKES) + (6 if not no_animation else 1))
        step(task, "drawing the mechanism at rest")
        figure = draw(action)
        written.append(
            write_file(out / "mechanism.png", lambda p: figure.savefig(p, dpi=150), force=True)
        )
        bar.advance(task)
        for name in STROKES:
            step(task, f"simulating {name}")
            stroke = load_stroke(name)
            rate = picture_rate(stroke.duration, RunOptions.output_rate)
            runs[name] = simulate(action, stroke, output_rate=rate)
            written.append(runs[name].save(out / f"{name}.nc", force=True))
            bar.advance(task)
            step(task, f"plotting {name}")
            written += save_all(runs[name], out, name, force=True)
            bar.advance(task)
        if not no_animation:
            step(task, "animating forte")
            written.append(animate(runs["forte"], out / "forte.gif", force=True))
            written.append(view(list(runs.values()), out / "strokes.html", force=True))
            bar.advance(task, 5)

    for name, run in runs.items():
        for table in (*strike_tables(run, name), summary_table(run, name)):
            screen.print(table)
    screen.print(published_table(list(runs.values())))
    screen.print(
        "String forces and contact times are those of three strings; with the one string that the\n"
        "thesis prints they are not reached: see docs/validation/thesis.md.",
    )
    for path in written:
        say_written(path)


def published_table(runs: list[Run]) -> Any:
    """Table of simulated and published values."""
    from feltmb.run.published import compare_with_published
    from feltmb.run.reading import summary_rows

    table = new_table(
        "beside the thesis", "stroke", "", "here", "thesis", "unit", "differs", right=(2, 3, 5)
    )
    for run in runs:
        words = summary_rows(run)
        for row in compare_with_published(run):
            text = words.get(row.key, (row.key, row.unit))[0]
            published, unit = pretty(row.published, row.unit)
            if row.simulated is None:
                table.add_row(row.stroke, text, "did not happen", published, unit, "-")
                continue
            factor = float(published) / row.published
            difference = row.difference or 0.0
            table.add_row(
                row.stroke,
                text,
                f"{row.simulated * factor:.4g}",
                published,
                unit,
                f"{100 * difference:+.1f} %",
            )
    return table
