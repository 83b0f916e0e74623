"""``feltmb gap``: checks records, plans experiments, diagnoses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    Number,
    ProgressLine,
    complain,
    console,
    credibility_option,
    force_option,
    json_option,
    list_option,
    model_set_option,
    positive,
    print_json,
    say,
    say_written,
)
from feltmb.cli.completing import actions, effects
from feltmb.cli.gap_blind import command as blind_command
from feltmb.cli.gap_check import command as check_command
from feltmb.cli.gap_join import command as join_command
from feltmb.cli.gap_plan import command as plan_command
from feltmb.cli.gap_plan import measured_option
from feltmb.cli.gap_reading import config_option, reading_options, stated_options
from feltmb.cli.gap_report import command as report_command
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.cli.gap_models import Stated
    from feltmb.data import ReadOptions
    from feltmb.gap import Explained

__all__ = ["command"]

#: Endings of files for a remedy; another name is that of a folder. Lines of a difference.
REMEDIES = (".toml", ".xml")
DIFF = 60


@click.group(name="gap", context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Diagnose the gap between a model and measurements: which cause, how much, where.

    A model is a packaged mechanism, a mechanism file, an FMU, a MuJoCo model (robot.xml), or a
    function or model of a Python file (model.py:cart). Measured files are CSV, MAT, HDF5, NetCDF,
    Parquet, Feather or MCAP. A TOML file of the same name describes each file.
    """


command.add_command(blind_command)
command.add_command(check_command)
command.add_command(join_command)
command.add_command(plan_command)
command.add_command(report_command)


@command.command("diagnose")
@click.argument("model", shell_complete=actions)
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@list_option(
    "--hold-out",
    "hold_out",
    metavar="NAME",
    help="Record (or its file) that is not fitted, but predicted. Default: the records with the "
    "role held_out, else some records are chosen.",
)
@click.option(
    "--out",
    "-o",
    "output",
    metavar="NAME",
    type=click.Path(path_type=Path),
    help="Folder for report.html, report.txt, report.json and the remedy; or a file for the "
    "remedy: the mechanism or the numbers (TOML), a MuJoCo model (XML).",
)
@stated_options
@list_option(
    "--exclude",
    "excluded",
    metavar="EFFECT",
    help="Effect, pattern such as 'sensor*', or component that is not tested.",
)
@list_option(
    "--include",
    "included",
    shell_complete=effects,
    metavar="EFFECT",
    help="Effect of the library that is added to the model before the diagnosis, with its "
    "magnitude as a parameter.",
)
@credibility_option
@click.option(
    "--prior",
    type=Number(0, 1, min_open=True, max_open=True),
    default=0.5,
    show_default=True,
    help="Prior probability that the model lacks an effect of the list.",
)
@click.option(
    "--max-effects",
    type=click.IntRange(1, 6),
    default=4,
    show_default=True,
    help="Largest set of effects.",
)
@click.option(
    "--seconds",
    type=positive("s"),
    default=120.0,
    show_default="120 s",
    help="Limit of time; the best sets of effects until then are the answer, such as 5min [s].",
)
@list_option(
    "--good-enough",
    "good_enough",
    metavar="[CHANNEL=]SIZE",
    help="Difference that does not matter, such as 0.2mm or hammer_tip.x=0.1mm; default: 1 % of "
    "the motion.",
)
@reading_options
@config_option
@measured_option
@model_set_option
@json_option
@force_option
def run(
    model: str,
    data: tuple[Path, ...],
    hold_out: tuple[str, ...],
    output: Path | None,
    stated: Stated,
    excluded: tuple[str, ...],
    included: tuple[str, ...],
    credibility: float,
    prior: float,
    max_effects: int,
    seconds: float,
    good_enough: tuple[str, ...],
    reading: ReadOptions,
    measured: Path | None,
    settings: tuple[str, ...],
    as_json: bool,
    force: bool,
) -> None:
    """Diagnose the gap between MODEL and measured DATA.

    MODEL is a mechanism, an FMU, a MuJoCo model (robot.xml), or a function of a Python file
    (model.py:cart).

    Ctrl-C ends the search; the answer rests on the fits so far.
    """
    from feltmb.cli.gap_models import held_out, load_adapter
    from feltmb.files import check_writable, make_folder
    from feltmb.gap import Options, diagnose

    adapter = load_adapter(model, settings, stated=stated)
    folder = output if output is not None and output.suffix.lower() not in REMEDIES else None
    remedy = None if folder is not None else output
    if folder is not None:
        make_folder(folder)
        remedy = folder / f"remedy{adapter.model.suffixes[0]}"
        for name in ("report.html", "report.txt", "report.json"):
            check_writable(folder / name, force=force)
    if remedy is not None:
        check_writable(remedy, force=force)
        adapter.model.check_writing(remedy)
    groups = adapter.read_each(data, reading)
    records = tuple(r for group in groups for r in group)
    if included or measured is not None or not adapter.default:
        adapter = adapter.with_records(records).including(included).measured(measured)
    options = Options(
        credibility=credibility,
        good_enough=floors(good_enough, adapter.model.units),
        missing=prior,
        seconds=seconds,
        most=max_effects,
    )
    line = ProgressLine()
    report = diagnose(
        adapter.model,
        None if adapter.default else adapter.effects,
        records,
        exclude=excluded,
        hold_out=held_out(hold_out, data, groups) or None,
        options=options,
        tell=line,
    )
    line.close()
    if as_json:
        print_json(report.as_dict())
    else:
        say(report.text(console().width))
    if folder is not None:
        title = f"{adapter.model.name}: diagnosis"
        say_written(report.write(folder, title=title, force=force))
    if remedy is not None and report.model is not None:
        try:
            _write_remedy(report.model, remedy, force=force)
        except InvalidParameter as error:
            if folder is None:
                raise
            complain(f"no remedy: {error}")


def _write_remedy(model: Explained, path: Path, *, force: bool) -> None:
    """Write the model with what was found, and show how its file differs."""
    from difflib import unified_diff

    source = model.original.source
    old = "" if source is None else source.read_text("utf-8", "replace")
    say_written(model.write(path, force=force))
    if source is not None and path.suffix == source.suffix:
        new = path.read_text("utf-8").splitlines()
        lines = [*unified_diff(old.splitlines(), new, source.name, path.name, n=0, lineterm="")]
        say("\n".join(lines[:DIFF]) + (f"\n... {len(lines) - DIFF} more" if lines[DIFF:] else ""))
    if model.left_out and path.suffix != ".toml":
        say(f"not in {path.name}: {', '.join(model.left_out)}; it has no place for them")


def floors(texts: tuple[str, ...], units: Mapping[str, str]) -> dict[str, float]:
    """Accepted differences by channel or SI unit, from ``0.2mm`` or ``CHANNEL=0.2mm``.

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
