"""Command group ``feltmb actuator``: the key actuator alone, its studies, and its design."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from feltmb.cli.common import (
    FRACTION,
    FileName,
    FolderName,
    check_targets,
    complain,
    console,
    force_option,
    json_option,
    list_option,
    new_table,
    parse_damper,
    positive,
    pretty,
    print_json,
    save_figure,
    say_written,
    with_settings,
)
from feltmb.cli.completing import actions, actuators

if TYPE_CHECKING:
    from feltmb.action.actuator import Actuator, ActuatorRun

__all__ = ["command"]

ROWS = {
    "first_contact_time": ("first contact with the stop", "s"),
    "first_contact_speed": ("speed at this contact", "m/s"),
    "peak_stop_force": ("largest stop force", "N"),
    "peak_finger_force": ("largest finger force", "N"),
    "bounces": ("bounces at the stop", "times"),
    "deflection": ("largest tip deflection", "m"),
    "mean_finger_force": ("mean finger force, last quarter", "N"),
    "ringing": ("rms of its oscillation", "N"),
}


def _load(arm: str, damper: str | None, settings: tuple[str, ...]) -> Actuator:
    from feltmb.action.actuator import load_actuator

    actuator = with_settings(load_actuator(arm), settings)
    return actuator if damper is None else actuator.with_damper(*parse_damper(damper))


_arm = click.option(
    "--arm",
    shell_complete=actuators,
    metavar="NAME",
    default="wood",
    show_default=True,
    help="wood, aluminum, or an actuator file.",
)
_damper = click.option(
    "--damper",
    metavar="KIND[=C]",
    help="none, dashpot, one-sided; C in N m s/rad, default the thesis's.",
)
_set = list_option(
    "--set",
    "settings",
    metavar="PATH=VALUE",
    help="Change a value of the actuator by its dotted path, such as "
    "tip.mass=1.5g; a bare number is in SI units.",
)


@click.group("actuator", invoke_without_command=True)
@_arm
@_damper
@_set
@click.option("--elements", type=click.IntRange(1, 200), help="Finite elements of the arm.")
@click.option("--torque", metavar="FILE", help="Torque by time, CSV or TOML; default: the file's.")
@click.option(
    "--action-force",
    metavar="FILE",
    help="Measured force of the action on the tip over time, CSV or TOML; it replaces the mass.",
)
@click.option(
    "--duration", type=positive("s"), default=0.2, show_default=True, help="Simulated time [s]."
)
@click.option(
    "--output-rate",
    type=positive("Hz"),
    default=10000.0,
    show_default=True,
    help="Samples per second [Hz].",
)
@click.option(
    "--tolerance",
    type=FRACTION,
    default=3e-5,
    show_default=True,
    help="Error of a force, relative to the largest.",
)
@click.option(
    "--out",
    "-o",
    metavar="FILE",
    type=FileName(".nc", ".csv"),
    help="File to write, .nc or .csv.",
)
@click.option("--plot", is_flag=True, help="Also draw actuator_ARM.png beside --out (or here).")
@force_option
@json_option
@click.pass_context
def command(
    context: click.Context,
    arm: str,
    damper: str | None,
    settings: tuple[str, ...],
    elements: int | None,
    torque: str | None,
    action_force: str | None,
    duration: float,
    output_rate: float,
    tolerance: float,
    out: Path | None,
    plot: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Simulate the key actuator of thesis chapter 5 on its felt stop.

    Motor, hub, flexible arm by finite elements, tip mass, gravity, damper, equivalent reaction of
    the action. To let it press a real action: feltmb stroke ACTION --actuator NAME.
    """
    if context.invoked_subcommand is not None:
        given = [
            option.opts[0]
            for option in context.command.params
            if option.name is not None
            and context.get_parameter_source(option.name) is ParameterSource.COMMANDLINE
        ]
        if given:
            from feltmb.errors import InvalidParameter

            raise InvalidParameter(
                f"{', '.join(given)}: actuator {context.invoked_subcommand} does not read what "
                "stands before its name; see its --help"
            )
        return
    from feltmb.action.actuator import simulate_actuator
    from feltmb.action.actuator.plot import plot_run
    from feltmb.run.stroke import load_stroke

    if elements is not None:
        settings = (*settings, f"arm.elements={elements}")
    actuator = _load(arm, damper, settings)
    if action_force is not None:
        actuator = actuator.with_action(load_stroke(action_force))
    folder = out.parent if out is not None else Path()
    # The name comes from a file and must not lead to another folder.
    name = re.sub(r"[^\w.-]+", "_", actuator.name)
    picture = folder / f"actuator_{name}.png"
    if out is not None and out.suffix not in (".nc", ".csv"):
        raise click.UsageError(f"--out {out}: expected the name of a .nc or .csv file")
    check_targets(out, pictures=(picture if plot else None,), force=force)
    stroke = load_stroke(torque) if torque is not None else None
    run = simulate_actuator(
        actuator, stroke, duration, output_rate=output_rate, tolerance=tolerance
    )
    if as_json:
        print_json(
            {
                "summary": run.summary,
                "energy": run.energy,
                "stats": run.stats,
                "frequencies": _frequencies(actuator),
            }
        )
    else:
        _show(actuator, run)
    for warning in run.stats["warnings"]:
        complain(f"warning: {warning}")
    if out is not None:
        say_written(run.save(out, force=force))
    if plot:
        kind = actuator.config.damper.kind.replace("_", "-")
        figure = plot_run(run, f"Key actuator, {actuator.name} arm, damper: {kind}")
        save_figure(figure, picture, force=force)


def _frequencies(actuator: Actuator, count: int = 3) -> list[float]:
    most = min(count, 2 * actuator.config.arm.elements)
    return [float(f) for f in actuator.frequencies(most)]


def _show(actuator: Actuator, run: ActuatorRun) -> None:
    kind = actuator.config.damper.kind.replace("_", "-")
    table = new_table(f"actuator {actuator.name}, damper {kind}", "", "value", "unit", right=(1,))
    for i, f in enumerate(_frequencies(actuator)):
        table.add_row(f"natural frequency {i + 1}", f"{f:.5g}", "Hz")
    reaction = actuator.config.action
    if reaction.mass or reaction.force is None:
        table.add_row("mass of the action", f"{reaction.mass:.4g}", "kg")
    if reaction.force is not None:
        role = "added to the mass" if reaction.mass else "replaces the mass"
        table.add_row("force of the action", "record", role)
    for key, (text, unit) in ROWS.items():
        if key not in run.summary:
            continue
        value = run.summary[key]
        number, shown = (f"{1e3 * value:.3f}", "ms") if unit == "s" else pretty(value, unit)
        table.add_row(text, number, shown)
    for key in ("work_motor", "given_to_action", "dissipated_stop", "dissipated_damper"):
        table.add_row(key.replace("_", " "), *pretty(run.energy[key], "J"))
    table.add_row("energy balance error", f"{run.energy['residual_relative']:.1e}", "of work")
    table.caption = (
        f"{run.stats['steps']} steps, {run.stats['forces']} forces, "
        f"{1e3 * run.stats['wall']:.3g} ms"
    )
    console().print(table)


@command.command("study", short_help="Figures 5.6 to 5.11 of the thesis and its findings.")
@click.option(
    "--out",
    "-o",
    metavar="DIRECTORY",
    type=FolderName(),
    help="Folder for the figures and the tables.",
)
@force_option
@json_option
def study_command(out: Path | None, force: bool, as_json: bool) -> None:
    """Figures 5.6 to 5.11 of the thesis and its findings, held against the numbers."""
    from dataclasses import asdict

    from feltmb.action.actuator.studies import study_actuator
    from feltmb.files import make_folder

    if out is not None:
        make_folder(out)
    result = study_actuator()
    if as_json:
        print_json(
            {
                "runs": {name: run.summary for name, run in result.runs.items()},
                "findings": [asdict(f) for f in result.findings],
            }
        )
    else:
        table = new_table("what the thesis found", "finding", "section", "here", "agrees")
        for f in result.findings:
            verdict = "not tested" if f.agrees is None else "yes" if f.agrees else "NO"
            table.add_row(f.says, f.source, f.here, verdict)
        console().print(table)
    if out is not None:
        for path in result.save(out, force=force):
            say_written(path)


@command.command("match")
@click.argument("target")
@_arm
@click.option(
    "--damper",
    metavar="KIND[=C]",
    default="one-sided",
    show_default=True,
    help="Damper at the start of the fit.",
)
@_set
@click.option(
    "--action",
    shell_complete=actions,
    metavar="NAME",
    help="Press this action instead of the stop of the actuator.",
)
@click.option(
    "--torque",
    metavar="FILE",
    help="Torque at the start of the fit; default: that of the actuator.",
)
@list_option(
    "--fit",
    metavar="NAME",
    default=("stiffness", "damping", "torque"),
    show_default=True,
    help="Parameters that are fitted.",
)
@click.option(
    "--knots",
    type=click.IntRange(2, 100),
    default=8,
    show_default=True,
    help="Knots of the torque.",
)
@click.option(
    "--steps",
    type=click.IntRange(1),
    default=60,
    show_default=True,
    help="Largest number of steps.",
)
@click.option(
    "--out",
    "-o",
    metavar="FILE",
    type=FileName(".toml"),
    help="Actuator file to write (TOML).",
)
@click.option("--plot", metavar="FILE", type=click.Path(path_type=Path), help="Picture to write.")
@force_option
@json_option
def match_command(
    target: str,
    arm: str,
    damper: str,
    settings: tuple[str, ...],
    action: str | None,
    torque: str | None,
    fit: tuple[str, ...],
    knots: int,
    steps: int,
    out: Path | None,
    plot: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Fit arm, damper and torque so that the finger force follows TARGET.

    TARGET is a CSV with the header "time [s],force [N]" or a force stroke.
    """
    from feltmb.action.actuator.matching import match
    from feltmb.action.actuator.plot import plot_match
    from feltmb.files import write_text
    from feltmb.run.stroke import load_stroke

    check_targets(out, pictures=(plot,), force=force)
    found = match(
        _load(arm, damper, settings),
        load_stroke(target),
        action=action,
        fit=list(fit),
        knots=knots,
        start_torque=load_stroke(torque) if torque is not None else None,
        max_evaluations=steps,
    )
    if as_json:
        print_json(
            {
                "rms": found.rms,
                "rms_start": found.rms_start,
                "relative": found.relative,
                "evaluations": found.evaluations,
                "parameters": [vars(p) for p in found.parameters],
            }
        )
    else:
        table = new_table(
            "finger force on its target", "parameter", "start", "fitted", "95 % interval", "unit",
            "force changes by", right=(1, 2, 5),
        )  # fmt: skip
        for p in found.parameters:
            note = " (at its bound)" if p.at_bound else ""
            table.add_row(
                p.name + note,
                f"{p.start:.4g}",
                f"{p.value:.4g}",
                f"{p.low:.4g} to {p.high:.4g}",
                p.unit,
                f"{p.effect:.3g} N",
            )
        table.caption = (
            f"rms deviation {found.rms:.3g} N, {100 * found.relative:.2g} % of the target (before "
            f"{found.rms_start:.3g} N); {found.evaluations} simulations; last column: rms, for "
            "10 % of a parameter or 0.1 N m of torque"
        )
        console().print(table)
    if out is not None:
        say_written(write_text(out, found.actuator.to_toml(), force=force))
    if plot is not None:
        save_figure(plot_match(found), plot, force=force)
