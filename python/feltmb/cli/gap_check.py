"""``feltmb gap check``: checks records alone, and compares them with a model before any fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    check_targets,
    console,
    force_option,
    json_option,
    model_set_option,
    new_table,
    pretty,
    print_json,
    save_figure,
    say,
)
from feltmb.cli.completing import actions
from feltmb.cli.gap_reading import reading_options, stated_options
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.cli.gap_models import Stated
    from feltmb.data import ReadOptions, Record
    from feltmb.gap import Comparison

__all__ = ["command"]


@click.command("check", short_help="Check measured DATA, also against a model, before any fit.")
@click.argument("model_and_data", nargs=-1, required=True, shell_complete=actions,
                metavar="[MODEL] DATA...")  # fmt: skip
@click.option(
    "--out",
    "-o",
    "picture",
    metavar="PICTURE",
    type=click.Path(path_type=Path),
    help="Draw records, model and difference: .png, .pdf or .svg.",
)
@reading_options
@model_set_option
@stated_options
@json_option
@force_option
def command(
    model_and_data: tuple[str, ...],
    picture: Path | None,
    reading: ReadOptions,
    settings: tuple[str, ...],
    stated: Stated,
    as_json: bool,
    force: bool,
) -> None:
    """Check measured DATA: clocks, units, codes for missing values, spikes.

    With MODEL (as in `gap diagnose`), also simulate each record with the tabulated numbers, show
    the difference between record and model before any fit, and tell a unit, sign, clock or order
    of columns that would explain it.
    """
    name, data = _split(model_and_data)
    check_targets(pictures=(picture,), force=force)
    if name is None:
        if picture is not None or settings:
            raise InvalidParameter("gap check: --out and --set need a MODEL before the data")
        from feltmb.data.files import read_each
        from feltmb.gap.data_check import check_records

        records = [r for group in read_each(data, options=reading) for r in group]
        notes = check_records(records)
        if as_json:
            print_json({"channels": _channels(records), "notes": notes})
        else:
            _print_channels(records)
            _print_notes(notes)
        return
    from feltmb.cli.gap_models import load_adapter
    from feltmb.gap import check

    adapter = load_adapter(name, settings, stated=stated)
    found = check(adapter.model, adapter.read(data, reading))
    hints = [h.text for h in found.hints]
    if as_json:
        rows = [_plain(r) for r in found.frame.to_dict("records")]
        print_json({"rows": rows, "hints": [asdict(h) for h in found.hints], "notes": found.notes})
    else:
        _print_channels(found.records)
        _print_inputs(found.records, adapter.model.units)
        _print_comparison(found)
        _print_notes([*found.notes, *hints])
    if picture is not None:
        save_figure(found.plot(), picture, force=force)


def _split(given: Sequence[str]) -> tuple[str | None, list[Path]]:
    """The model, if the first argument is not a measured file, and the files."""
    from feltmb.data.columns import MEASURED_FILES

    if Path(given[0]).suffix.lower() in MEASURED_FILES:
        return None, [Path(g) for g in given]
    if len(given) == 1:
        raise InvalidParameter(
            f"gap check: got {given[0]!r} alone, expected measured files "
            f"({', '.join(MEASURED_FILES)}), before them perhaps a model"
        )
    return given[0], [Path(g) for g in given[1:]]


def _channels(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Numbers of each channel of each record."""
    import numpy as np

    from feltmb.gap.records import noise_of_channel

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


def _plain(row: Mapping[Any, Any]) -> dict[str, Any]:
    """A row with None where a number is not known."""
    return {str(k): None if isinstance(v, float) and not isfinite(v) else v for k, v in row.items()}


def _print_channels(records: Sequence[Record]) -> None:
    table = new_table(
        "channels", "record", "channel", "unit", "samples", "missing", "motion", "noise", "from",
        right=(3, 4, 5, 6), whole=(0, 1, 6),
    )  # fmt: skip
    for c in _channels(records):
        numbers = [str(c["samples"]), f"{c['missing']:.0%}", f"{c['motion']:.4g}"]
        origin = "sensor" if c["stated"] else "data"
        table.add_row(c["record"], c["channel"], c["unit"], *numbers, f"{c['noise']:.2g}", origin)
    console().print(table)


def _print_inputs(records: Sequence[Record], units: Mapping[str, str]) -> None:
    """Print the inputs as the model gets them."""
    table = new_table(
        "inputs of the model", "record", "input", "unit", "lowest", "highest",
        right=(3, 4), whole=(0, 1),
    )  # fmt: skip
    for record in records:
        for name, values in record.inputs.items():
            unit = record.input_units.get(name) or units.get(name) or "1"
            table.add_row(record.name, name, unit, f"{values.min():.4g}", f"{values.max():.4g}")
    if table.row_count:
        console().print(table)


def _print_comparison(found: Comparison) -> None:
    """Print a table for each record, because a table is as wide as a terminal."""
    for record in found.records:
        table = new_table(
            f"{record.name} - {found.model}, nothing fitted",
            "channel", "rms", "of motion", "in noise", "factor", "delay", "corr.",
            right=(1, 2, 3, 4, 5, 6), whole=(0, 1, 2, 3, 4, 5, 6),
        )  # fmt: skip
        for r in found.rows:
            if r.record == record.name:
                table.add_row(
                    r.channel,
                    _size(r.rms, r.unit),
                    f"{r.share:.2g}",
                    f"{r.in_noise:.3g}" if r.stated else "",
                    f"{r.factor:.4g}",
                    _size(r.delay, "s") if isfinite(r.delay) else "",
                    f"{r.correlation:.3f}",
                )
        console().print(table)


def _size(value: float, unit: str) -> str:
    return " ".join(pretty(value, unit)) if unit != "1" else f"{value:.4g}"


def _print_notes(notes: Sequence[str]) -> None:
    for note in notes:
        say(f"Note: {note}")
