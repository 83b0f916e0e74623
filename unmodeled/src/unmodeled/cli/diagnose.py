"""``unmodeled diagnose``, ``blind`` and ``fit``: models against records."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from unmodeled.cli.models import (
    DATA,
    EXCLUDE,
    HOLD_OUT,
    MEASURED,
    MODEL,
    READING,
    RUNNING,
    STATED,
    config_option,
    effects,
    held_out,
    load_named,
)
from unmodeled.cli.options import (
    FORCE,
    MODEL_SET,
    SEED,
    Command,
    FolderName,
    Number,
    argument,
    count,
    declare,
    fields_of,
    option,
    positive,
)
from unmodeled.cli.records import NO_OUTPUT
from unmodeled.cli.screen import (
    ProgressLine,
    check_targets,
    complain,
    console,
    is_terminal,
    print_json,
    redraw,
    save_figure,
    save_text,
    say,
    say_written,
    show,
)
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    from unmodeled import Explained, Options, Report
    from unmodeled.cli.models import Running, StatedOptions
    from unmodeled.data import ReadOptions, Record
    from unmodeled.loading import LoadedModel
    from unmodeled.search.result import Case

#: Endings of files for a remedy; another name is that of a folder. Lines of a difference.
REMEDIES = (".toml", ".xml")
PICTURES = (".png", ".pdf", ".svg")
DIFF = 60

CREDIBILITY = {"type": Number(0.5, 1, max_open=True)}
SECONDS = {"type": positive("s")}
TOLERANCES = {
    "type": click.Choice(["auto", "drawn", "kept"]),
    "text": "Whether all parameters deviate by about their standard deviations, as those of a new "
    "machine (drawn), or few do, as after a repair (kept); auto: the records decide.",
}


# --- diagnosis -----------------------------------------------------------------------------------


class _TwoSeries(Command):
    """A command whose option ``--then`` takes all files that follow it."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put ``--then`` before each of these files."""
        out: list[str] = []
        then = False
        for word in args:
            then = word == "--then" or (then and not word.startswith("-"))
            out += ["--then", word] if then and word != "--then" else [word] * (word != "--then")
        return super().parse_args(ctx, out + ["--then"] * ("--then" in {*args} - {*out}))


@declare("diagnose", cls=_TwoSeries, more=[config_option])
def run(
    model: str = MODEL,
    data: tuple[Path, ...] = DATA,
    then: tuple[str, ...] = option(
        "Files after a change of the machine, up to the next option: what changed is told.",
        metavar="FILES",
    ),
    hold_out: tuple[str, ...] = HOLD_OUT,
    out: Path | None = option(
        "Folder for the report, the remedy, and what unmodeled verify needs; or a file for the "
        "remedy: the numbers (TOML), a MuJoCo model (XML); or a picture of motions and evidence: "
        ".png, .pdf or .svg; or a video of a MuJoCo model beside the machine: .gif.",
        metavar="NAME",
    ),
    stated: StatedOptions = STATED,
    exclude: tuple[str, ...] = EXCLUDE,
    include: tuple[str, ...] = option(
        "Effect of the library that is added to the model before the diagnosis, with its magnitude "
        "as a parameter.",
        metavar="EFFECT",
        complete=effects,
    ),
    options: Options = fields_of(
        "unmodeled.search.options:Options",
        credibility=CREDIBILITY,
        prior={"type": Number(0, 1, min_open=True, max_open=True)},
        max_effects={"type": count(1, 12)},
        seconds=SECONDS,
        rounds={"type": count(1, 10**9)},
        tolerances=TOLERANCES,
    ),
    good_enough: tuple[str, ...] = option(
        "Difference that does not matter, such as 0.2mm or tip.x=0.1mm; default: 1 % of the "
        "motion.",
        metavar="[CHANNEL=]SIZE",
    ),
    reading: ReadOptions = READING,
    measured: Path | None = MEASURED,
    settings: tuple[str, ...] = MODEL_SET,
    running: Running = RUNNING,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Diagnose the gap between MODEL and measured DATA.

    MODEL is an FMU, a MuJoCo model (robot.xml), or a function of a Python file
    (model.py:cart).

    Ctrl-C ends the search; the answer rests on the fits so far, and the exit code is 130.
    """
    from unmodeled import diagnose
    from unmodeled.search.result import Reason

    loaded = running.of(load_named(model, settings, stated=stated))
    picture = out if out is not None and out.suffix.lower() in PICTURES else None
    video = out if out is not None and out.suffix.lower() == ".gif" else None
    check_targets(video, pictures=[picture], force=force)
    folder, remedy = _places(None if picture or video else out, loaded, force=force)
    every = (*data, *map(Path, then))
    groups = loaded.read_each(every, reading)
    records = tuple(r for group in groups for r in group)
    first = sum(map(len, groups[: len(data)]))
    if include or measured is not None or not loaded.default:
        loaded = loaded.with_records(records).including(include).measured(measured)
    line = ProgressLine()
    report = diagnose(
        loaded.model,
        None if loaded.default else loaded.effects,
        records[:first],
        then=records[first:],
        exclude=exclude,
        hold_out=held_out(hold_out, every, groups) or None,
        options=replace(options, good_enough=floors(good_enough, loaded.model.units)),
        progress=line,
    )
    line.close()
    if as_json:
        _say_cached(report)
        print_json(report.as_dict())
    else:
        for note in report.notes:
            if NO_OUTPUT in note:  # told first: it may be a misspelled name
                complain(f"note: {note}")
        say(report.text(console().width))
    if folder is not None:
        title = f"{loaded.model.name}: diagnosis"
        say_written(report.write(folder, title=title, force=force))
    _remedy(report, remedy, alone=folder is None, force=force)
    save_figure(picture, lambda: report.plot("answer"), force=force)
    _film(report, records, video, force=force)
    if Reason.INTERRUPTED in report.reasons:
        click.get_current_context().exit(130)


def _film(report: Report, records: Sequence[Record], path: Path | None, *, force: bool) -> None:
    """Write a video of the record in which the changes take away most, if there is a name."""
    if path is not None and report.model is not None:
        name = report.motions.chosen.record if report.motions is not None else records[0].name
        shown = next(r for r in records if r.name == name)
        say_written(report.model.film(path, shown, force=force))


def _say_cached(report: Report) -> None:
    """Say beside the answer how many runs were not made."""
    if report.cached:
        say(report.cached, err=True)


def _places(
    out: Path | None, loaded: LoadedModel, *, force: bool
) -> tuple[Path | None, Path | None]:
    """Folder of the report and file of the remedy, checked before anything is computed."""
    from unmodeled.files import check_suffix, check_writable, make_folder
    from unmodeled.models.writing import suffixes

    folder = out if out is not None and out.suffix.lower() not in REMEDIES else None
    remedy = None if folder is not None else out
    if folder is not None:
        make_folder(folder)
        remedy = folder / f"remedy{suffixes(loaded.model)[0]}"
        for name in ("report.html", "report.txt", "report.json", "case.json"):
            check_writable(folder / name, force=force)
    if remedy is not None:
        for beside in (remedy, remedy.with_suffix(".patch"), remedy.with_suffix(".png")):
            check_writable(beside, force=force)
        check_suffix(remedy, *suffixes(loaded.model))
    return folder, remedy


def _remedy(report: Report, path: Path | None, *, alone: bool, force: bool) -> None:
    """Write the remedy, if there is one; beside a report it may be impossible."""
    if path is None or report.model is None:
        return
    try:
        _write_remedy(report.model, path, force=force)
        robot = path if path.suffix == ".xml" and not alone and report.motions else None
        save_figure(
            robot and robot.with_suffix(".png"), lambda: report.plot("channels"), force=force
        )
    except InvalidParameter as error:
        if alone:
            raise
        complain(f"no remedy: {error}")


def _write_remedy(model: Explained, path: Path, *, force: bool) -> None:
    """Write the model with what was found, and show how its file differs."""
    from difflib import unified_diff

    from unmodeled.files import write_text
    from unmodeled.models.writing import suffixes, text

    say_written(model.write(path, force=force))
    old = text(model.original)
    if old and path.suffix == suffixes(model.original)[0]:
        new = path.read_text("utf-8").splitlines()
        both = old.splitlines(), new, "unchanged", path.name
        patch = "\n".join([*unified_diff(*both, lineterm=""), ""])
        say_written(write_text(path.with_suffix(".patch"), patch, force=force))
        lines = [*unified_diff(*both, n=0, lineterm="")]
        say("\n".join(lines[:DIFF]) + (f"\n... {len(lines) - DIFF} more" if lines[DIFF:] else ""))
    if model.left_out and path.suffix != ".toml":
        say(f"not in {path.name}: {', '.join(model.left_out)}; it has no place for them")


def floors(texts: Sequence[str], units: Mapping[str, str]) -> dict[str, float]:
    """Accepted differences by channel or SI unit, from ``0.2mm`` or ``CHANNEL=0.2mm``.

    ``units``: SI unit of each channel of the model, if it is known. A number without a unit has
    that of the channel.
    """
    from unmodeled.units import number_and_unit
    from unmodeled.units.names import ACCEPTED_UNITS, conversion_factor

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


# --- fit without a diagnosis ---------------------------------------------------------------------


@declare("fit")
def fit(
    model: str = MODEL,
    data: tuple[Path, ...] = DATA,
    options: Options = fields_of(
        "unmodeled.search.options:Options", seconds=SECONDS, tolerances=TOLERANCES
    ),
    out: Path | None = option("Folder for fit.json.", FolderName(), metavar="DIRECTORY"),
    reading: ReadOptions = READING,
    settings: tuple[str, ...] = MODEL_SET,
    stated: StatedOptions = STATED,
    running: Running = RUNNING,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Fit the parameters of MODEL to measured DATA, and print values and intervals.

    MODEL is an FMU, a MuJoCo model (robot.xml), or a
    function or model of a Python file (model.py:cart). Effects are not searched;
    `unmodeled diagnose` does that.
    """
    from unmodeled import fit_model
    from unmodeled.files import make_folder

    file = None if out is None else make_folder(out) / "fit.json"
    check_targets(file, force=force)
    loaded = running.of(load_named(model, settings, stated=stated))
    line = ProgressLine()
    report = fit_model(loaded.model, loaded.read(data, reading), options=options, progress=line)
    line.close()
    _say_cached(report)
    save_text(file, report.to_json, force=force)
    if as_json:
        print_json(report.as_dict())
    else:
        _print_fit(loaded.model.name, report)


def _print_fit(name: str, report: Report) -> None:
    def bracket(unit: str) -> str:
        return "" if unit == "1" else f" [{unit}]"

    show(
        name,
        "=parameter | >fitted | >95 % | >prior",
        [
            (
                p.name + bracket(p.unit),
                f"{p.value:.5g}",
                f"{p.low:.4g} .. {p.high:.4g}",
                f"{p.tabulated:.4g} ± {p.sd:.2g}",
            )
            for p in report.parameters
        ],
    )
    show(
        "residual (rms)",
        "=channel | >tabulated | >fitted | >noise",
        [
            (
                f"{c.name} [{c.unit}]",
                f"{c.tabulated:.3g}",
                f"{c.explained:.3g}",
                "" if c.noise != c.noise else f"{c.noise:.3g}",
            )
            for c in report.channels
        ],
    )
    for cause in (*report.named, *(c for alike in report.classes for c in alike)):
        say(f"{cause.cause}: it is wrong, probability {cause.probability:.0%}")
    for note in report.notes:
        say(f"note: {note}")
    if any(c.material for c in report.channels):
        say("the model does not explain the records: see unmodeled diagnose")


# --- simulated machines --------------------------------------------------------------------------


class _CaseLine:
    """Prints each case with its withheld effect and the diagnosis, and the remaining time."""

    def __init__(self) -> None:
        self.start = time.monotonic()

    def __call__(self, done: int, total: int, case: Case) -> None:
        from unmodeled.units import unit_suffix

        left = (time.monotonic() - self.start) / done * (total - done)
        rest = f"; about {left:.0f} s left" if done < total else ""
        unit = unit_suffix(case.unit)
        what = f"{case.effect} {case.magnitude:.3g}{unit}" if case.effect else "nothing withheld"
        said = case.verdict or case.error
        if is_terminal():
            redraw("")
        say(f"{done} of {total}: {what}: {said} ({case.outcome}){rest}", err=True)


@declare("blind", more=[config_option])
def blind(
    model: str = MODEL,
    data: tuple[Path, ...] = argument(required=False),
    cases: int | None = option(
        "Number of cases; default: one without an effect and one for each effect.",
        count(1, 100_000),
    ),
    seed: int = SEED,
    only: tuple[str, ...] = option(
        "Effect that is withheld; default: each effect in turn. All effects are candidates.",
        metavar="EFFECT",
        complete=effects,
    ),
    hold_out: tuple[str, ...] = option(
        "Record that is held out to confirm the findings.", metavar="NAME"
    ),
    out: Path | None = option(
        "Folder for blind.json. Ctrl-C ends the run with the finished cases.",
        FolderName(),
        metavar="DIRECTORY",
    ),
    options: Options = fields_of(
        "unmodeled.search.options:Options", credibility=CREDIBILITY, seconds=SECONDS
    ),
    stated: StatedOptions = STATED,
    exclude: tuple[str, ...] = EXCLUDE,
    reading: ReadOptions = READING,
    settings: tuple[str, ...] = MODEL_SET,
    *,
    as_json: bool,
) -> None:
    """Estimate how often a diagnosis of MODEL would be correct on your machine.

    Each case adds one effect of the library to the model, with a magnitude and parameters from
    their priors, and simulates the inputs of DATA with the noise of its sensors. The diagnosis does
    not know the effect. Without DATA the planned runs of the model are used. Machine and model have
    the same equations, so a real machine is more difficult.
    """
    from unmodeled import withhold
    from unmodeled.files import make_folder

    loaded = load_named(model, settings, stated=stated)
    groups = loaded.read_each(data, reading) if data else (loaded.planned,)
    records = tuple(r for group in groups for r in group)
    if not records:
        raise InvalidParameter(f"{model}: has no planned runs; give measured or planned files")
    loaded = loaded.with_records(records, exclude)
    if out is not None:
        make_folder(out)
    study = withhold(
        loaded.model,
        loaded.effects,
        records,
        cases=cases,
        seed=seed,
        only=list(dict.fromkeys(only)) or None,
        hold_out=(held_out(hold_out, data, groups) if data else list(hold_out)) or None,
        options=options,
        progress=_CaseLine(),
    )
    result = study.as_dict()
    if out is not None:
        text = json.dumps(result, indent=1, sort_keys=True) + "\n"
        save_text(out / "blind.json", text, force=True)
    if as_json:
        print_json(result)
        return
    from unmodeled.search.result import OUTCOMES

    rows = []
    for row in study.rows():
        ratio = f"{row['signal_to_noise']:.3g}" if row["effect"] else ""
        counts = [str(row[word] or "") for word in OUTCOMES]
        rows.append([row["effect"] or "(nothing)", ratio, *counts])
    show("withheld", f"=effect | >S/N | {' | '.join(f'>{word}' for word in OUTCOMES)}", rows)
    shares = study.shares()
    for word, text in (
        ("right", "right, signal-to-noise ratio of 5 or more"),
        ("wrong", "wrong, signal-to-noise ratio of 5 or more"),
        ("false alarm", "false alarms, nothing withheld"),
        ("intervals", "95 % intervals that contain the truth"),
    ):
        if word in shares:
            value, low, high, number = shares[word]
            say(f"{text}: {value:.0%} of {number} (95 %: {low:.0%} to {high:.0%})")
