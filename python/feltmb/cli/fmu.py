"""``feltmb fmu``: a mechanism as a co-simulation unit."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import (
    Number,
    force_option,
    list_option,
    load_with_settings,
    say_written,
    set_option,
    tables_as_json,
)
from feltmb.cli.completing import actions


@click.command("fmu")
@click.argument("action", shell_complete=actions)
@set_option
@click.option(
    "-o",
    "--out",
    required=True,
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The unit (.fmu).",
)
@click.option(
    "--fmi",
    type=click.Choice(["3.0", "2.0"]),
    default="3.0",
    show_default=True,
    help="Version of the interface.",
)
@click.option(
    "--input",
    "drive",
    type=click.Choice(["force", "motion", "key_motion", "torque", "motor_motion"]),
    help="Kind of the input; default: force, or torque of a mechanism with a motor.",
)
@click.option(
    "--hold",
    type=click.Choice(["zero", "linear"]),
    help="Interpolation of the input over a step; default: linear for a motion, else zero "
    "(constant).",
)
@list_option(
    "--parameter",
    "parameters",
    metavar="PATTERN",
    help="Numbers that become parameters, such as 'contacts.06.*'; default: all.",
)
@click.option(
    "--rtol", type=Number(1e-13, 1e-2), default=1e-6, show_default=True, help="Relative tolerance."
)
@force_option
@tables_as_json
def command(
    action: str,
    settings: tuple[str, ...],
    out: Path,
    fmi: str,
    drive: str | None,
    hold: str | None,
    parameters: tuple[str, ...],
    rtol: float,
    force: bool,
) -> None:
    """Export ACTION as a co-simulation unit (FMI). Its binary needs no Python."""
    from feltmb.run.fmu import export_fmu

    mechanism = load_with_settings(action, settings)
    written = export_fmu(
        mechanism,
        out,
        version=fmi,  # type: ignore[arg-type]
        drive=drive,  # type: ignore[arg-type]
        hold=hold,  # type: ignore[arg-type]
        parameters=parameters or "*",
        rtol=rtol,
        force=force,
    )
    say_written(written)
