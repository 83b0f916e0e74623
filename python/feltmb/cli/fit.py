"""``feltmb fit``: fits a model without a diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    ProgressLine,
    console,
    folder_option,
    force_option,
    json_option,
    model_set_option,
    new_table,
    positive,
    print_json,
    say,
    say_written,
)
from feltmb.cli.completing import actions
from feltmb.cli.gap_reading import reading_options, stated_options

if TYPE_CHECKING:
    from feltmb.cli.gap_models import Stated
    from feltmb.data import ReadOptions

__all__ = ["command"]


@click.command(name="fit")
@click.argument("model", shell_complete=actions)
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--seconds",
    type=positive("s"),
    default="120 s",
    show_default=True,
    help="Limit of time, such as 5min [s].",
)
@folder_option("Folder for fit.json.")
@reading_options
@model_set_option
@stated_options
@json_option
@force_option
def command(
    model: str,
    data: tuple[Path, ...],
    seconds: float,
    output: Path | None,
    reading: ReadOptions,
    settings: tuple[str, ...],
    stated: Stated,
    as_json: bool,
    force: bool,
) -> None:
    """Fit the parameters of MODEL to measured DATA, and print values and intervals.

    MODEL is a mechanism (packaged or a TOML file), an FMU, a MuJoCo model (robot.xml), or a
    function or model of a Python file (model.py:cart). Effects are not searched;
    `feltmb gap diagnose` does that.
    """
    from feltmb.cli.gap_models import load_adapter
    from feltmb.files import check_writable, make_folder, write_text
    from feltmb.gap import Options, fit_model

    if output is not None:
        check_writable(make_folder(output) / "fit.json", force=force)
    adapter = load_adapter(model, settings, stated=stated)
    records = adapter.read(data, reading)
    line = ProgressLine()
    report = fit_model(adapter.model, records, options=Options(seconds=seconds), tell=line)
    line.close()
    if output is not None:
        say_written(write_text(output / "fit.json", report.to_json(), force=force))
    if as_json:
        print_json(report.as_dict())
        return
    screen = console()
    table = new_table(
        adapter.model.name, "parameter", "fitted", "95 %", "prior", right=(1, 2, 3), whole=(0,)
    )
    for p in report.parameters:
        unit = "" if p.unit == "1" else f" [{p.unit}]"
        table.add_row(
            p.name + unit,
            f"{p.value:.5g}",
            f"{p.low:.4g} .. {p.high:.4g}",
            f"{p.tabulated:.4g} ± {p.sd:.2g}",
        )
    screen.print(table)
    residuals = new_table(
        "residual (rms)", "channel", "tabulated", "fitted", "noise", right=(1, 2, 3), whole=(0,)
    )
    for c in report.channels:
        noise = "" if c.noise != c.noise else f"{c.noise:.3g}"
        residuals.add_row(f"{c.name} [{c.unit}]", f"{c.tabulated:.3g}", f"{c.explained:.3g}", noise)
    screen.print(residuals)
    for cause in (*report.named, *(c for group in report.classes for c in group)):
        say(f"{cause.cause}: it is wrong, probability {cause.probability:.0%}")
    for note in report.notes:
        say(f"note: {note}")
    if any(c.material for c in report.channels):
        say("the model does not explain the records: see feltmb gap diagnose")
