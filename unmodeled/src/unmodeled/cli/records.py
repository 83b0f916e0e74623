"""``unmodeled check`` and ``join``: measured records before any fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from unmodeled.cli.completing import models
from unmodeled.cli.models import READING, STATED, load_named
from unmodeled.cli.options import (
    FORCE,
    MODEL_SET,
    FileName,
    argument,
    declare,
    option,
    pairs,
)
from unmodeled.cli.screen import (
    LateLine,
    check_targets,
    complain,
    pretty,
    print_json,
    save_figure,
    save_text,
    say,
    say_written,
    show,
)
from unmodeled.errors import InvalidParameter, merged, shortened

if TYPE_CHECKING:
    from unmodeled import Comparison
    from unmodeled.cli.models import StatedOptions
    from unmodeled.data import ReadOptions, Record


#: A part of the note about a channel that the model lacks.
NO_OUTPUT = "the model has no such output"


@declare("check", short="Check measured DATA, also against a model, before any fit.")
def check(
    model_and_data: tuple[str, ...] = argument(complete=models, metavar="[MODEL] DATA..."),
    picture: Path | None = option(
        "Draw records, model and difference: .png, .pdf or .svg.",
        words="--out -o",
        metavar="PICTURE",
    ),
    reading: ReadOptions = READING,
    settings: tuple[str, ...] = MODEL_SET,
    stated: StatedOptions = STATED,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Check measured DATA: clocks, units, codes for missing values, spikes.

    With MODEL (as in `unmodeled diagnose`), also simulate each record with the tabulated numbers,
    show the difference between record and model before any fit, and tell a unit, sign, clock or
    order of columns that would explain it.
    """
    name, data = _split(model_and_data)
    check_targets(pictures=(picture,), force=force)
    if name is None:
        if picture is not None or settings:
            raise InvalidParameter("check: --out and --set need a MODEL before the data")
        _check_alone(data, reading, as_json=as_json)
        return
    from unmodeled import check

    loaded = load_named(name, settings, stated=stated)
    records = loaded.read(data, reading)
    with LateLine() as line:
        comparison = check(loaded.model, records, progress=line)
    if as_json:
        rows = [{k: None if isinstance(v, float) and not isfinite(v) else v for k, v in r.items()}
                for r in comparison.frame.to_dict("records")]  # fmt: skip
        hints = [asdict(h) for h in comparison.hints]
        shown = {"notes": comparison.notes, "identifiability": comparison.identifiability}
        print_json({"rows": rows, "hints": hints, **shown})
    else:
        _print_check(comparison, loaded.model.units)
    save_figure(picture, comparison.plot, force=force)


def _print_check(comparison: Comparison, units: Mapping[str, str]) -> None:
    strange = [n for n in comparison.notes if NO_OUTPUT in n]
    notes = [n for n in comparison.notes if n not in strange]
    _print_notes(strange)
    _print_channels(_channels(comparison.records))
    inputs = [
        (r.name, n, r.input_units.get(n) or units.get(n) or "1", f"{v.min():.4g}",
         f"{v.max():.4g}")
        for r in comparison.records for n, v in r.inputs.items()
    ]  # fmt: skip
    if inputs:
        show("inputs of the model", "=record | =input | unit | >lowest | >highest", inputs)
    _print_comparison(comparison)
    for sentence in comparison.identifiability:
        say(f"Motions: {sentence}")
    _print_notes([*(h.text for h in comparison.hints), *notes, *_without_noise(comparison)])
    if not comparison.hints:
        say("No unit, sign, delay or order of columns explains the difference: go on with "
            "`unmodeled diagnose`.")  # fmt: skip


def _split(given: Sequence[str]) -> tuple[str | None, list[Path]]:
    """The model, if the first argument is not a measured file, and the files."""
    from unmodeled.data.columns import MEASURED_FILES

    if Path(given[0]).suffix.lower() in MEASURED_FILES or Path(given[0]).is_dir():
        return None, [Path(g) for g in given]
    if len(given) == 1:
        raise InvalidParameter(
            f"check: got {given[0]!r} alone, expected measured files "
            f"({', '.join(MEASURED_FILES)}), before them perhaps a model"
        )
    return given[0], [Path(g) for g in given[1:]]


def _check_alone(data: Sequence[Path], reading: ReadOptions, *, as_json: bool) -> None:
    from unmodeled.data.files import read_each
    from unmodeled.search.records import check_records

    records = [r for group in read_each(data, options=reading) for r in group]
    notes, channels = check_records(records), _channels(records)
    if as_json:
        print_json({"channels": channels, "notes": notes})
    else:
        _print_channels(channels)
        _print_notes(notes)


def _channels(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Numbers of each channel of each record."""
    import numpy as np

    from unmodeled.search.records import noise_of_channel

    rows = []
    for r in records:
        for name, values in r.outputs.items():
            known = values[np.isfinite(values)]
            rows.append({
                "record": r.name, "channel": name, "unit": r.sensors[name].unit,
                "samples": known.size, "missing": 1.0 - known.size / values.size,
                "motion": float(np.std(known)) if known.size else 0.0,
                "noise": noise_of_channel(r, name).sigma,
                "stated": r.sensors[name].sigma is not None,
            })  # fmt: skip
    return rows


#: Largest number of channels that a table on the screen shows.
MOST_CHANNELS = 200


def _print_channels(channels: Sequence[dict[str, Any]]) -> None:
    more = len(channels) - MOST_CHANNELS
    show(
        "channels",
        "=record | =channel | unit | >samples | >missing | >motion | >noise | =from",
        [
            (c["record"], c["channel"], c["unit"], str(c["samples"]), f"{c['missing']:.0%}",
             f"{c['motion']:.4g}", f"{c['noise']:.2g}", "sensor" if c["stated"] else "data")
            for c in channels[:MOST_CHANNELS]
        ],
        f"{more} more channels are not shown; --json prints all" if more > 0 else None,
    )  # fmt: skip


def _print_comparison(comparison: Comparison) -> None:
    """Print a table for each record, because a table is as wide as a terminal."""

    def size(value: float, unit: str) -> str:
        return " ".join(pretty(value, unit)) if unit != "1" else f"{value:.4g}"

    for record in comparison.records:
        rows = [
            (
                r.channel,
                size(r.rms, r.unit),
                f"{r.share:.2g}",
                f"{r.in_noise:.3g}" if r.stated else "",
                f"{r.factor:.4g}",
                size(r.delay, "s") if isfinite(r.delay) else "",
                f"{r.correlation:.3f}",
            )
            for r in [r for r in comparison.rows if r.record == record.name][:MOST_CHANNELS]
        ]
        heads = "=channel | =>rms | =>of motion | =>in noise | =>factor | =>delay | =>corr."
        stated = any(row[3] for row in rows)
        show(
            f"{record.name} - {comparison.model}, nothing fitted",
            heads if stated else heads.replace(" | =>in noise", ""),
            rows if stated else [(*row[:3], *row[4:]) for row in rows],
        )


def _without_noise(comparison: Comparison) -> list[str]:
    """Sentence about the channels whose difference is not given in noise."""
    names = dict.fromkeys(r.channel for r in comparison.rows if not r.stated)
    if not names:
        return []
    return [
        f"{shortened(', '.join(names), 200)}: no noise is stated, so that the difference is not "
        "given in noise (sigma in the TOML file beside the data, in Python sigma of unmodeled.read)"
    ]


def _print_notes(notes: Sequence[str]) -> None:
    """Print notes: first those that name an option; those with one text about several, as one."""
    for note in merged(sorted(notes, key=lambda text: "--" not in text)):
        say(f"Note: {note}")


# --- two files with two clocks -------------------------------------------------------------------


@declare("join", short="Join two files with two clocks to one record.")
def join(
    first: Path = argument(),
    second: Path = argument(),
    out: Path = option(
        "CSV file to write; its TOML file gets the same name.", FileName(".csv"), required=True
    ),
    same: tuple[str, ...] = option(
        "Time of an event on the clock of FIRST and on that of SECOND, such as 0.532s=1.207s. One "
        "gives the offset of the clocks, two give also their rate; auto: by the begin of the "
        "motion; default: the clocks are equal.",
        metavar="TIME=TIME",
    ),
    model: str | None = option(
        "With --same auto: model whose motion under the force is correlated with FIRST, which is "
        "far more accurate.",
        metavar="MODEL",
        complete=models,
    ),
    inputs: tuple[str, ...] = option(
        "Channel that is an input of the model, such as force=Load; default: the only channel in N "
        "is the force, if neither file has an input.",
        words="--input",
        metavar="NAME=CHANNEL",
    ),
    force: bool = FORCE,
) -> None:
    """Join FIRST and SECOND, measured files of one experiment with two clocks, to one record.

    The clock and the samples of FIRST are kept, such as those of a camera. SECOND is interpolated
    linearly at these times. Each file is described by its TOML file or its header.
    """
    from unmodeled.data import join_records, read_record, write_record
    from unmodeled.files import check_writable
    from unmodeled.search.compare import join_by_motion

    read = {p.resolve() for file in (first, second) for p in (file, file.with_suffix(".toml"))}
    for path in (out, out.with_suffix(".toml")):
        check_writable(path, force=force)
        if path.resolve() in read:
            raise InvalidParameter(f"join: -o {out} is the name of a file that is joined")
    chosen = pairs("--input", inputs, "NAME=CHANNEL") or None
    one, two = read_record(first), read_record(second)
    if same == ("auto",):
        if model is None:
            complain("--model MODEL would align the clocks far more accurately")
        known = None if model is None else load_named(model).model
        made = join_by_motion(one, two, known, inputs=chosen)
    elif model is not None:
        raise click.UsageError("--model aligns the clocks with --same auto")
    else:
        # An event is read to a sample.
        sd = max(one.interval, two.interval) if same else 0.0
        made = join_records(one, two, same=_events(same), inputs=chosen, same_sd=sd)
    made = replace(made, name=out.stem)
    for note in made.notes:
        complain(note)
    say_written(write_record(made, out, force=force))
    say_written(out.with_suffix(".toml"))
    channels = [f"input {n}" for n in made.inputs] + list(made.outputs)
    say(f"{made.samples} samples of {', '.join(channels)}")


def _events(texts: Sequence[str]) -> list[tuple[float, float]]:
    from unmodeled.units.quantity import parse_scalar

    events = []
    for text in texts:
        one, mark, two = text.partition("=")
        try:
            if not mark:
                raise ValueError("expected TIME=TIME, such as 0.532s=1.207s")
            events.append((parse_scalar(one, "s"), parse_scalar(two, "s")))
        except ValueError as error:
            raise InvalidParameter(f"--same {text}: {error}") from None
    return events


# --- the file that describes a measured file -----------------------------------------------------


@declare("new")
def new(
    record: Path = argument(metavar="DATA"),
    path: Path | None = option(
        "File to write; default: the name of DATA with the ending .toml.",
        FileName(".toml"),
        words="--out -o",
        metavar="FILE",
    ),
    model: str | None = option(
        "Model whose channels are assigned to the columns.", metavar="MODEL", complete=models
    ),
    reading: ReadOptions = READING,
    settings: tuple[str, ...] = MODEL_SET,
    force: bool = FORCE,
) -> None:
    """Write the TOML file that describes a measured file, with a first assignment of its columns.

    `check`, `diagnose` and `fit` read it together with DATA.
    """
    from unmodeled.data.sketch import sketch_sheet
    from unmodeled.errors import DataError
    from unmodeled.files import check_writable, is_file, why_missing

    path = record.with_suffix(".toml") if path is None else path
    check_writable(path, force=force)
    if not is_file(record):
        raise DataError(f"{record}: {why_missing(record)}")
    signals = None if model is None else load_named(model, settings).signals
    text, lacks = sketch_sheet(record, signals, reading)
    if lacks:
        complain(lacks)
    save_text(path, text, force=force)
