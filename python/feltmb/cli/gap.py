"""``feltmb gap``: checks records, plans experiments, diagnoses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    Number,
    ProgressLine,
    budget_option,
    console,
    credibility_option,
    folder_option,
    force_option,
    form_option,
    interruptible,
    json_option,
    list_option,
    model_set_option,
    positive,
    print_json,
    save_figure,
    say,
    say_written,
)
from feltmb.cli.completing import actions, effects
from feltmb.cli.gap_blind import command as blind_command
from feltmb.cli.gap_check import command as check_command
from feltmb.cli.gap_join import command as join_command
from feltmb.cli.gap_plan import command as plan_command
from feltmb.cli.gap_plan import measured_option
from feltmb.cli.gap_reading import reading_options
from feltmb.cli.gap_session import command as session_command
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.data import ReadOptions
    from feltmb.fit import Progress

__all__ = ["command"]


@click.group(name="gap", context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Diagnose the gap between a model and measurements: where, which cause, how far it shrinks.

    A model is a packaged mechanism or a Python file that defines `model` and `effects`. Measured
    files are CSV, MAT or NetCDF. A TOML file of the same name describes each file.
    """


command.add_command(blind_command)
command.add_command(check_command)
command.add_command(join_command)
command.add_command(plan_command)
command.add_command(session_command)


@command.command("diagnose")
@click.argument("model", shell_complete=actions)
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@list_option(
    "--hold-out",
    "hold_out",
    metavar="NAME",
    help="Record (or its file) that is held out to confirm the findings. Default: the records with "
    "the role held_out, else some records are chosen.",
)
@folder_option("Folder for report.html and report.json.")
@list_option(
    "--include",
    "included",
    shell_complete=effects,
    metavar="EFFECT",
    help="Effect of the library that is added to the model before the diagnosis, with its "
    "magnitude as a parameter.",
)
@click.option(
    "--alpha",
    type=Number(0, 0.5, min_open=True, max_open=True),
    default=0.01,
    show_default=True,
    help="Family-wise false alarm rate.",
)
@credibility_option
@form_option
@click.option("--segment", type=positive("s"), help="Length of shooting segments [s].")
@click.option(
    "--max-effects",
    type=click.IntRange(1, 6),
    default=4,
    show_default=True,
    help="Largest set of effects.",
)
@click.option(
    "--bootstrap",
    type=click.IntRange(0, 100_000),
    default=12,
    show_default=True,
    help="Refits for the null distribution.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the refits for the null distribution.",
)
@reading_options
@list_option(
    "--good-enough",
    "good_enough",
    metavar="[CHANNEL=]SIZE",
    help="Difference that you accept, such as 0.2mm or hammer_tip.x=0.1mm. It is added to the "
    "noise of the channels with this unit.",
)
@click.option(
    "--write",
    "written",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the mechanism with calibrated values and named effects (TOML).",
)
@click.option(
    "--profile",
    is_flag=True,
    help="Hold the magnitude of each named effect at six values beside its fit and fit all else "
    "again: a 95 % interval that does not rest on a linear model.",
)
@measured_option
@budget_option
@model_set_option
@json_option
@force_option
def run(
    model: str,
    data: tuple[Path, ...],
    hold_out: tuple[str, ...],
    output: Path | None,
    included: tuple[str, ...],
    alpha: float,
    credibility: float,
    form: float,
    segment: float | None,
    max_effects: int,
    bootstrap: int,
    seed: int,
    reading: ReadOptions,
    good_enough: tuple[str, ...],
    written: Path | None,
    profile: bool,
    measured: Path | None,
    budget: float | None,
    settings: tuple[str, ...],
    as_json: bool,
    force: bool,
) -> None:
    """Diagnose the gap between MODEL and measured DATA.

    Ctrl-C ends the present step and writes the report of the results so far, as --budget does. A
    second Ctrl-C before the report is written stops without a report. An interrupted diagnosis
    continues when it is started again with the same output folder.
    """
    from feltmb.cli.gap_curves import picture_html, record_viewers, remaining_picture
    from feltmb.cli.gap_models import held_out, load_adapter
    from feltmb.files import check_writable, make_folder
    from feltmb.fit.watch import REPORT
    from feltmb.gap import Options, diagnose
    from feltmb.gap.report import report_json, write_report
    from feltmb.gap.resumed import discard, remaining
    from feltmb.gap.text import parts

    if output is not None:
        make_folder(output)
        for name in ("report.html", "report.json", "remains.png"):
            check_writable(output / name, force=force)
    adapter = load_adapter(model, settings)
    if written is not None:
        check_writable(written, force=force)
        adapter.model.check_writing(written)
    groups = adapter.read_each(data, reading)
    records = tuple(r for group in groups for r in group)
    adapter = adapter.with_records(records).including(included).measured(measured)
    held = held_out(hold_out, data, groups) or None
    options = Options(
        alpha=alpha,
        credibility=credibility,
        form=form,
        segment=segment,
        max_effects=max_effects,
        bootstrap=bootstrap,
        seed=seed,
        resume=None if output is None else output / ".resume",
        good_enough=floors(good_enough, adapter.model.units),
        profile=profile,
    )
    line = ProgressLine()
    with interruptible() as stop:

        def tell(p: Progress) -> None:
            if p.stage == REPORT:
                stop.writing()
            line(p)

        report = diagnose(
            adapter.model,
            adapter.effects,
            records,
            held,
            options,
            tell,
            budget=budget,
            stop=stop,
        )
        line.close()
        if as_json:
            print_json(report_json(report))
        else:
            screen = console()
            for part in parts(report, screen.width):
                say(part) if isinstance(part, str) else screen.print(part)
        if written is not None:
            say_written(report.model.write(written, force=force))
        if output is not None:
            viewers = record_viewers(report, records, stop)
            remains = None if stop() else remaining_picture(report)
            if remains is not None:
                save_figure(remains, output / "remains.png", force=force)
                viewers = picture_html(remains) + viewers
            for path in write_report(report, output, force=force, viewers=viewers):
                say_written(path)
            if report.fits is not None and not report.stopped:
                discard(report.fits)
            if kept := remaining(output / ".resume"):
                say(kept, err=True)


def floors(texts: tuple[str, ...], units: Mapping[str, str]) -> dict[str, float]:
    """Practical accuracies by channel or SI unit, from ``0.2mm`` or ``CHANNEL=0.2mm``.

    ``units``: SI unit of each channel of the model, if it is known. A number without a unit has
    that of the channel.
    """
    from feltmb.units import number_and_unit
    from feltmb.units.names import ACCEPTED_UNITS, conversion_factor

    out: dict[str, float] = {}
    for text in texts:
        channel, _, size = (part.strip() for part in text.rpartition("="))
        value, unit = number_and_unit(size) or (0.0, "")
        if not value > 0.0 or not (unit or channel):
            raise InvalidParameter(
                f"--good-enough {text}: expected a size with its unit, such as 0.2mm, or "
                "CHANNEL=0.2mm"
            )
        same = [units[channel]] if units.get(channel) else []
        base = [name for name, (factor, _) in ACCEPTED_UNITS.items() if factor == 1.0]
        for name in same or base:
            try:
                factor = conversion_factor(unit or name, name)
            except InvalidParameter as error:
                if same:
                    raise InvalidParameter(f"--good-enough {text}: {error}") from error
                continue
            out[channel or name] = value * factor
            break
        else:
            raise InvalidParameter(f"--good-enough {text}: unit {unit!r} is not known")
    return out
