"""Command group ``feltmb actuator``: the key actuator alone, and its design."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from feltmb.cli.completing import actions, actuators
from feltmb.cli.settings import with_settings
from feltmb.cli.stroke import parse_damper
from unmodeled.cli.options import (
    FORCE,
    FRACTION,
    CommandGroup,
    FileName,
    argument,
    count,
    declare,
    option,
    positive,
)
from unmodeled.cli.screen import (
    check_targets,
    pretty,
    print_json,
    save_figure,
    save_text,
    say_written,
    show,
    warn,
)
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.action.actuator import Actuator, ActuatorRun
    from feltmb.action.actuator.matching import Match

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
ARM = option(
    "wood, aluminum, or an actuator file.", default="wood", metavar="NAME", complete=actuators
)
SETTINGS = option(
    "Change a value of the actuator by its dotted path, such as tip.mass=1.5g; a bare number is in "
    "SI units.",
    words="--set",
    metavar="PATH=VALUE",
)


def _load(arm: str, damper: str | None, settings: Sequence[str]) -> Actuator:
    from feltmb.action.actuator import load_actuator

    actuator = with_settings(load_actuator(arm), settings)
    return actuator if damper is None else actuator.with_damper(*parse_damper(damper))


@declare("actuator", cls=CommandGroup, invoke_without_command=True)
def command(
    arm: str = ARM,
    damper: str | None = option(
        "none, dashpot, one-sided; C in N m s/rad, default the thesis's.", metavar="KIND[=C]"
    ),
    settings: tuple[str, ...] = SETTINGS,
    elements: int | None = option("Finite elements of the arm.", count(1, 200)),
    torque: str | None = option(
        "Torque by time, CSV or TOML; default: the file's.", metavar="FILE"
    ),
    action_force: str | None = option(
        "Measured force of the action on the tip over time, CSV or TOML; it replaces the mass.",
        metavar="FILE",
    ),
    duration: float = option("Simulated time [s].", positive("s"), 0.2),
    output_rate: float = option("Samples per second [Hz].", positive("Hz"), 10000.0),
    tolerance: float = option("Error of a force, relative to the largest.", FRACTION, 3e-5),
    out: Path | None = option(
        "File to write, .nc or .csv.", FileName(".nc", ".csv", dir_okay=True), metavar="FILE"
    ),
    plot: bool = option("Also draw actuator_ARM.png beside --out (or here)."),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Simulate the key actuator of thesis chapter 5 on its felt stop.

    Motor, hub, flexible arm by finite elements, tip mass, gravity, damper, equivalent reaction of
    the action. To let it press a real action: feltmb stroke ACTION --actuator NAME.
    """
    context = click.get_current_context()
    if context.invoked_subcommand is not None:
        given = [
            option.opts[0]
            for option in context.command.params
            if option.name is not None
            and context.get_parameter_source(option.name) is ParameterSource.COMMANDLINE
        ]
        if given:
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
    # The name comes from a file and must not lead to another folder.
    name = re.sub(r"[^\w.-]+", "_", actuator.name)
    picture = (out.parent if out is not None else Path()) / f"actuator_{name}.png"
    if out is not None and out.suffix not in (".nc", ".csv"):
        raise click.UsageError(f"--out {out}: expected the name of a .nc or .csv file")
    check_targets(out, pictures=(picture if plot else None,), force=force)
    stroke = load_stroke(torque) if torque is not None else None
    run = simulate_actuator(
        actuator, stroke, duration, output_rate=output_rate, tolerance=tolerance
    )
    most = min(3, 2 * actuator.config.arm.elements)
    frequencies = [float(f) for f in actuator.frequencies(most)]
    kind = actuator.config.damper.kind.replace("_", "-")
    if as_json:
        tables = {name: getattr(run, name) for name in ("summary", "energy", "stats")}
        print_json(tables | {"frequencies": frequencies})
    else:
        show(
            f"actuator {actuator.name}, damper {kind}",
            "| >value | unit",
            _rows(actuator, run, frequencies),
            f"{run.stats['steps']} steps, {run.stats['forces']} forces, "
            f"{1e3 * run.stats['wall']:.3g} ms",
        )
    warn(run.stats["warnings"])
    if out is not None:
        say_written(run.save(out, force=force))
    title = f"Key actuator, {actuator.name} arm, damper: {kind}"
    save_figure(picture if plot else None, lambda: plot_run(run, title), force=force)


def _rows(
    actuator: Actuator, run: ActuatorRun, frequencies: Sequence[float]
) -> Iterator[tuple[str, str, str]]:
    for i, f in enumerate(frequencies):
        yield f"natural frequency {i + 1}", f"{f:.5g}", "Hz"
    reaction = actuator.config.action
    if reaction.mass or reaction.force is None:
        yield "mass of the action", f"{reaction.mass:.4g}", "kg"
    if reaction.force is not None:
        role = "added to the mass" if reaction.mass else "replaces the mass"
        yield "force of the action", "record", role
    for key, (text, unit) in ROWS.items():
        if key in run.summary:
            value = run.summary[key]
            cells = (f"{1e3 * value:.3f}", "ms") if unit == "s" else pretty(value, unit)
            yield text, *cells
    for key in ("work_motor", "given_to_action", "dissipated_stop", "dissipated_damper"):
        yield key.replace("_", " "), *pretty(run.energy[key], "J")
    yield "energy balance error", f"{run.energy['residual_relative']:.1e}", "of work"


@declare("match", command)
def match_command(
    target: str = argument(),
    arm: str = ARM,
    damper: str = option(
        "Damper at the start of the fit.", default="one-sided", metavar="KIND[=C]"
    ),
    settings: tuple[str, ...] = SETTINGS,
    action: str | None = option(
        "Press this action instead of the stop of the actuator.", metavar="NAME", complete=actions
    ),
    torque: str | None = option(
        "Torque at the start of the fit; default: that of the actuator.", metavar="FILE"
    ),
    fit: tuple[str, ...] = option(
        "Parameters that are fitted.", default=("stiffness", "damping", "torque"), metavar="NAME"
    ),
    knots: int = option("Knots of the torque.", count(2, 100), 8),
    steps: int = option("Largest number of steps.", count(), 60),
    out: Path | None = option("Actuator file to write (TOML).", FileName(".toml"), metavar="FILE"),
    plot: Path | None = option("Picture to write.", metavar="FILE"),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Fit arm, damper and torque so that the finger force follows TARGET.

    TARGET is a CSV with the header "time [s],force [N]" or a force stroke.
    """
    from feltmb.action.actuator.matching import match
    from feltmb.action.actuator.plot import plot_match
    from feltmb.run.stroke import load_stroke

    check_targets(out, pictures=(plot,), force=force)
    matched = match(
        _load(arm, damper, settings),
        load_stroke(target),
        action=action,
        fit=list(fit),
        knots=knots,
        start_torque=load_stroke(torque) if torque is not None else None,
        max_evaluations=steps,
    )
    if as_json:
        numbers = ("rms", "rms_start", "relative", "evaluations")
        parameters = {"parameters": [vars(p) for p in matched.parameters]}
        print_json({name: getattr(matched, name) for name in numbers} | parameters)
    else:
        _print_match(matched)
    save_text(out, matched.actuator.to_toml, force=force)
    save_figure(plot, lambda: plot_match(matched), force=force)


def _print_match(matched: Match) -> None:
    rows = [
        (
            p.name + (" (at its bound)" if p.at_bound else ""),
            f"{p.start:.4g}",
            f"{p.value:.4g}",
            f"{p.low:.4g} to {p.high:.4g}",
            p.unit,
            f"{p.effect:.3g} N",
        )
        for p in matched.parameters
    ]
    show(
        "finger force on its target",
        "parameter | >start | >fitted | 95 % interval | unit | >force changes by",
        rows,
        f"rms deviation {matched.rms:.3g} N, {100 * matched.relative:.2g} % of the target (before "
        f"{matched.rms_start:.3g} N); {matched.evaluations} simulations; last column: rms, for "
        "10 % of a parameter or 0.1 N m of torque",
    )
