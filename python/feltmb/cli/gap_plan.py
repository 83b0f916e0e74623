"""``feltmb gap plan``: plans experiments that identify effects."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    Number,
    console,
    folder_option,
    force_option,
    is_terminal,
    json_option,
    list_option,
    model_set_option,
    new_table,
    print_json,
    redraw,
    say,
    say_written,
)
from feltmb.cli.completing import actions, actuators
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.cli.gap_models import Adapter
    from feltmb.data import Record
    from feltmb.experiment.files import InputFiles
    from feltmb.gap import Design, DesignedExperiment, Limits
    from feltmb.gap.visibility import Visible

__all__ = [
    "Telling",
    "command",
    "input_files",
    "limits_of",
    "limits_option",
    "measured_option",
    "print_design",
    "sensors_of",
    "units_of",
]

#: Largest numbers of effects, parts, and further records or sensors that are listed.
MOST_EFFECTS, MOST_PARTS, MOST_ADDED = 12, 5, 5

measured_option = click.option(
    "--measured",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="TOML file with tests of single parts: [measured.NAME] with value, sd and how. NAME is a "
    "parameter, whose tolerance the test replaces, or an effect, which becomes a parameter.",
)
limits_option = click.option(
    "--limits",
    "limits_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="TOML file with the limits of the inputs, the possible tests of parts and further "
    "sensors. Default: the limits of the model; for a mechanism with a finger 0 to 25 N, 2 kN/s, "
    "0.6 s.",
)


class Telling:
    """Progress of a plan: one line on a terminal, else one line per stage."""

    def __init__(self) -> None:
        self._stage = ""
        self._start = time.monotonic()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show the progress."""
        text = f"{stage}: {done + 1} of {total}, {time.monotonic() - self._start:.0f} s"
        if is_terminal():
            redraw(text)
        elif stage != self._stage:
            say(f"feltmb: {text}", err=True)
        self._stage = stage

    def close(self) -> None:
        """Clear the line."""
        if self._stage and is_terminal():
            redraw("")


@click.command("plan", short_help="Experiments that identify the effects of MODEL.")
@click.argument("model", shell_complete=actions)
@click.argument("data", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--budget",
    type=Number(0, 1000, min_open=True),
    help="Design experiments with this number of records (the limits give the cost of a test of a "
    "part and of a sensor). Without it the planned runs of the model are compared.",
)
@limits_option
@click.option(
    "--report",
    "report_folder",
    metavar="PATH",
    type=click.Path(path_type=Path),
    help="Report of a diagnosis (folder or report.json). The plan separates the causes that the "
    "report could not separate.",
)
@measured_option
@click.option(
    "--aim",
    type=click.Choice(["names", "sizes"]),
    default="names",
    show_default=True,
    help="Identify effects, or estimate their magnitudes.",
)
@list_option("--channels", metavar="NAME", help="Channel or output that will be measured.")
@list_option("--family", "families", metavar="NAME", help="Kind of profile; default: all.")
@click.option(
    "--candidates",
    type=click.IntRange(1, 10_000),
    default=12,
    show_default=True,
    help="Number of profiles that are evaluated in full.",
)
@click.option(
    "--refine",
    "refinements",
    type=click.IntRange(0, 10_000),
    default=4,
    show_default=True,
    help="Number of further profiles that improve the first experiment.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the random draws."
)
@click.option(
    "--arm",
    shell_complete=actuators,
    metavar="NAME",
    help="Key actuator (wood, aluminum or a file) for which torques are also written.",
)
@folder_option(
    "Folder of the inputs (CSV; for a mechanism strokes, TOML), their pictures and plan.json. For "
    "a mechanism, the next plan in it is faster."
)
@model_set_option
@json_option
@force_option
def command(
    model: str,
    data: tuple[Path, ...],
    budget: float | None,
    limits_file: Path | None,
    report_folder: Path | None,
    measured: Path | None,
    aim: Any,
    channels: tuple[str, ...],
    families: tuple[str, ...],
    candidates: int,
    refinements: int,
    seed: int,
    arm: str | None,
    output: Path | None,
    settings: tuple[str, ...],
    as_json: bool,
    force: bool,
) -> None:
    """Plan experiments that identify the effects of MODEL.

    With --budget the command designs experiments: smooth profiles of the inputs within limits,
    tests of single parts, and further sensors. The most informative experiments come first. DATA
    are measured files. The plan uses these files, or a --report, as its starting point.

    Without --budget the command compares planned runs before any measurement. DATA are files with
    planned inputs. Without DATA the first planned run of the model is used (for a mechanism: the
    packaged forte stroke, measured by cameras with a noise of 0.02 mm). Further runs of the model
    and outputs that are not measured are ranked as next experiments.
    """
    from feltmb.cli.gap_models import load_adapter

    adapter = load_adapter(model, settings, channels)
    records = adapter.read(data) if data else ()
    adapter = adapter.with_records(records, limits_file).measured(measured)
    if budget is None:
        for option, given in (
            ("--limits", limits_file),
            ("--report", report_folder),
            ("--arm", arm),
            ("--out", output),
        ):
            if given is not None:
                raise InvalidParameter(
                    f"{option} needs --budget, the number of experiments that may be made"
                )
        _compare(model, adapter, records, channels, as_json=as_json)
        return
    from feltmb.experiment.files import design_json, write_design
    from feltmb.files import check_writable, make_folder
    from feltmb.gap import Belief, design

    if output is not None:
        make_folder(output)
        check_writable(output / "plan.json", force=force)
    lever = None if arm is None else _lever(arm)
    limits = limits_of(model, adapter, limits_file)
    belief = None
    if report_folder is not None:
        belief = Belief.of_report(_report(report_folder, adapter.model.name))
    telling = Telling()
    found = design(
        adapter.model,
        adapter.effects,
        records,
        limits=limits,
        sensors=sensors_of(adapter, limits, records, channels),
        budget=budget,
        aim=aim,
        belief=belief,
        families=families,
        candidates=candidates,
        refinements=refinements,
        seed=seed,
        folder=None if output is None else output / ".plan",
        progress=telling,
    )
    telling.close()
    if as_json:
        print_json(design_json(found))
    else:
        print_design(found)
    if output is not None:
        for path in write_design(
            found,
            output,
            units=units_of(adapter, limits),
            input_files=input_files(adapter, units_of(adapter, limits), lever=lever, force=force),
            force=force,
        ):
            if not as_json:
                say_written(path)


def input_files(
    adapter: Adapter, units: Mapping[str, str], *, lever: float | None = None, force: bool
) -> InputFiles:
    """Function that writes planned inputs as strokes of a mechanism, and as torque of an arm."""
    from feltmb.adapters import write_planned_stroke, write_planned_torque

    def write(experiment: DesignedExperiment, stem: Path) -> list[Path]:
        assert experiment.profile is not None
        assert experiment.record is not None
        time, value = experiment.profile.knots()
        unit, out = units.get(experiment.input, "1"), []
        if experiment.input in adapter.kinds:
            path = stem.with_name(f"{stem.name}.toml")
            kind = adapter.kinds[experiment.input]
            out.append(
                write_planned_stroke(
                    path, kind, time, value, unit=unit, about=experiment.name, force=force
                )
            )
        if lever is not None and unit == "N":
            path = stem.with_name(f"{stem.name}_torque.csv")
            # Evenly sampled: a table with long pauses would count as damaged.
            clock, forces = experiment.record.time, experiment.record.inputs[experiment.input]
            out.append(write_planned_torque(path, clock, lever * forces, force=force))
        return out

    return write


def limits_of(model: str, adapter: Adapter, file: Path | None) -> Limits:
    """Limits from a file, or those of the model."""
    from feltmb.gap import read_limits

    if file is not None:
        return read_limits(file, adapter.model, adapter.effects)
    if adapter.limits is None:
        raise InvalidParameter(
            f"{model}: how far may its inputs go? Give --limits FILE with schema = 1, duration = "
            '"1 s" and [inputs.NAME] with most, and where it matters least, rate, acceleration'
        )
    return adapter.limits


def sensors_of(
    adapter: Adapter, limits: Limits, records: Sequence[Record], channels: Sequence[str]
) -> Any:
    """Sensors of the planned outputs, from the records, or else from planned runs."""
    from dataclasses import replace

    wanted = adapter.outputs_of(channels) if channels else None
    if wanted is None and (limits.sensors or not adapter.planned):
        return None
    if limits.sensors or not adapter.planned:
        raise InvalidParameter(
            "--channels: the limits name what is measured in [sensors]; got both"
            if limits.sensors
            else "--channels: name what is measured in [sensors] of the limits"
        )
    known = dict(adapter.planned[0].sensors)
    if records:
        seen = {n: s for r in records for n, s in r.sensors.items()}
        # Channels that are asked for may be new ones.
        new = {} if wanted is None else known
        known = new | {
            n: replace(s, sigma=known[n].sigma) if s.sigma is None and n in known else s
            for n, s in seen.items()
            if n in adapter.model.outputs
        }
    return {n: s for n, s in known.items() if wanted is None or n in wanted}


def units_of(adapter: Adapter, limits: Limits) -> dict[str, str]:
    """Units of inputs and outputs."""
    return {**adapter.model.units, **{n: i.unit for n, i in limits.inputs.items()}}


def _report(path: Path, model: str) -> Any:
    """The report of a diagnosis of this model."""
    from feltmb.files import is_folder, read_json

    file = path / "report.json" if is_folder(path) else path
    report = read_json(file)
    if isinstance(report, dict) and report.get("model", model) != model:
        raise InvalidParameter(
            f"--report {file}: is of the model {report['model']!r}, expected one of {model!r}"
        )
    return report


def _lever(arm: str) -> float:
    """Distance from the axis of the motor to the tip of the arm [m]."""
    from feltmb.action.actuator import load_actuator

    config = load_actuator(arm).config
    return float(config.hub.radius + sum(s.length for s in config.arm.stretches()))


def print_design(found: Design) -> None:
    """Print the plan as tables, with reasons."""
    names = found.aim == "names"

    def value(v: float) -> str:
        return f"{v:.0%}" if names else f"{v:.3g}"

    what = "probability of the correct name" if names else "information"
    if not found.experiments:
        say("No experiment within the limits gives more information.")
    else:
        table = new_table(
            "next experiments", "", "experiment", "cost", what, right=(2, 3), whole=(0, 2, 3)
        )
        for i, e in enumerate(found.experiments, 1):
            text = "\n".join([e.name, *(f"  {r}" for r in e.reasons)])
            table.add_row(str(i), text, f"{e.cost:g}", f"{value(e.before)} -> {value(e.after)}")
        console().print(table)
    say(
        f"Expected {what}: {value(found.before)} now, {value(found.after)} after the plan"
        + (f" ({value(found.reachable)} with all tested experiments)." if names else ".")
    )
    _print_effects(found.effects, MOST_EFFECTS, "now", lambda v: v.belief)
    if found.sensors:
        table = new_table(
            "further sensors", "sensor", "cost", what, "gain per cost", "planned",
            right=(1, 2, 3), whole=(1, 2, 3, 4),
        )  # fmt: skip
        for s in found.sensors:
            text = "\n".join([s.name, *(f"  {r}" for r in s.reasons)])
            then = f"{value(s.before)} -> {value(s.after)}"
            gain = f"{s.gain_per_cost:+.1%}" if names else f"{s.gain_per_cost:+.3g}"
            table.add_row(text, f"{s.sensor.cost:g}", then, gain, "yes" if s.planned else "no")
        console().print(table)
    for p in found.parts[:MOST_PARTS]:
        say(f"measure a part separately: {p.text}")
    for group in found.inseparable:
        say("no experiment within the limits separates: " + ", ".join(group))
        tests = [t.text for t in found.decisive if t.effect in group]
        if tests:
            say(f"  a test of its part separates an effect from the others: {', '.join(tests)}")
    if found.failed:
        say(f"{found.failed} profiles could not be simulated and are omitted")


def _print_effects(
    effects: Sequence[Visible], most: int, share: str, of: Callable[[Visible], float]
) -> None:
    """Print the first ``most`` effects, with a share ``of`` each."""
    shown = [v for v in effects if not v.hidden]
    table = new_table(
        "detectable effects", "effect", share, "detectable from", "correct", "or most similar",
        "confused with", "chance",
        right=(1, 2, 3, 4, 6), whole=(0,),
    )  # fmt: skip
    for v in shown[:most]:
        size = f"{v.smallest:.3g} {'' if v.unit == '1' else v.unit}".strip()
        rival = (v.rival, f"{v.confusion:.0%}") if v.confusion >= 0.01 else ("", "")
        table.add_row(v.effect, f"{of(v):.0%}", size, f"{v.right:.0%}", f"{v.pair:.0%}", *rival)
    if shown:
        console().print(table)
    if len(shown) > most:
        say(f"and {len(shown) - most} more effects (plan.json, --json)")
    hidden = [v for v in effects if v.hidden]
    for v in hidden[:most]:
        say(f"{v.effect} cannot be detected: {v.hidden}")
    if len(hidden) > most:
        say(f"and {len(hidden) - most} more that cannot be detected (plan.json, --json)")


def _compare(
    model: str,
    adapter: Adapter,
    measured: Sequence[Record],
    channels: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Print which effects planned runs could separate, before any measurement."""
    from feltmb.gap import plan
    from feltmb.gap.report import plain

    planned = adapter.planned
    records = measured or planned
    if not records:
        raise InvalidParameter(f"{model}: has no planned runs; give measured or planned files")
    found = plan(
        adapter.model,
        adapter.effects,
        records if measured else records[:1],
        channels=adapter.outputs_of(channels) if channels else None,
        experiments=planned if measured else records[1:],
    )
    if as_json:
        print_json(plain(found))
        return
    _print_effects(found.effects, len(found.effects), "own signature", lambda v: v.surviving)
    for group in found.inseparable:
        say("cannot be separated: " + ", ".join(group))
    say(f"Expected probability of the correct name: {found.after:.0%}.")
    for e in found.experiments[:MOST_ADDED]:
        text = "; ".join(e.reasons) or "separates no further effects"
        say(f"add {e.kind} {e.name} ({e.after:.0%}): {text}")
