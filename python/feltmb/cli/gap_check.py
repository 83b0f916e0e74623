"""``feltmb gap check``: checks records alone, and compares them with a model before any fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

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
    say_written,
)
from feltmb.cli.completing import actions
from feltmb.cli.gap_reading import reading_options
from feltmb.errors import DataError, InvalidParameter

if TYPE_CHECKING:
    from feltmb.data import ReadOptions, Record
    from feltmb.gap import DataChecks, GapBefore, GapBeforeRow

__all__ = ["command"]


@click.command("check")
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
@click.option(
    "--html",
    "html_page",
    metavar="PAGE",
    type=click.Path(path_type=Path),
    help="Write a page that shows records and model together, as in feltmb view.",
)
@reading_options
@model_set_option
@json_option
@force_option
def command(
    model_and_data: tuple[str, ...],
    picture: Path | None,
    html_page: Path | None,
    reading: ReadOptions,
    settings: tuple[str, ...],
    as_json: bool,
    force: bool,
) -> None:
    """Check measured DATA: clocks, units, noise, repeatability.

    With MODEL (as in `gap diagnose`), also simulate each record with the tabulated numbers and show
    the difference between record and model before any fit.
    """
    from feltmb.gap.checks import check_records
    from feltmb.gap.report import plain

    name, data = _split(model_and_data)
    check_targets(html_page, pictures=(picture,), force=force)
    if html_page is not None and html_page.suffix.lower() not in (".html", ".htm"):
        raise InvalidParameter(f"--html {html_page}: expected a name that ends in .html")
    if name is None:
        if picture is not None or html_page is not None or settings:
            raise InvalidParameter(
                "gap check: --out, --html and --set need a MODEL before the data"
            )
        from feltmb.data.files import read_each

        records = [r for group in read_each(data, options=reading) for r in group]
        checks = check_records(records)
        if as_json:
            print_json(plain(checks))
        else:
            _print_checks(checks)
            _print_warnings(checks.told)
        _refuse(checks)
        return
    from feltmb.cli.gap_models import load_adapter
    from feltmb.gap import check

    adapter = load_adapter(name, settings)
    records = list(adapter.read(data, reading))
    checks = check_records(records, adapter.model.outputs)
    if checks.problems and not as_json:
        _print_checks(checks)
    _refuse(checks)
    found = check(adapter.model, records)
    if as_json:
        print_json({"checks": plain(found.checks), "gap": plain(found.rows), "notes": found.notes})
    else:
        _print_checks(found.checks)
        _print_inputs(found.records, adapter.model.units)
        _print_gap(found)
        _print_warnings(found.told)
    if picture is not None:
        save_figure(found.plot(), picture, force=force)
    if html_page is not None:
        from feltmb.cli.gap_curves import overlay_page
        from feltmb.files import write_text

        say_written(write_text(html_page, overlay_page(found), force=force))


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


def _refuse(checks: DataChecks) -> None:
    if checks.problems:
        raise DataError("records: " + "; ".join(checks.problems))


def _print_checks(checks: DataChecks) -> None:
    table = new_table(
        "channels",
        "record",
        "channel",
        "unit",
        "samples",
        "missing",
        "spread",
        "noise",
        "from",
        right=(3, 4, 5, 6),
        whole=(0, 1, 6),
    )
    for c in checks.channels:
        table.add_row(
            c.record,
            c.channel,
            c.unit,
            str(c.samples),
            f"{c.missing:.0%}",
            f"{c.spread:.4g}",
            f"{c.sigma:.2g}" + (f" + {100.0 * c.relative:.2g}%" if c.relative else ""),
            c.method,
        )
    console().print(table)
    for label, channel, sd in checks.repeatability:
        say(f"repeats {label}: {channel} differs by {sd:.3g}")


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


def _print_gap(found: GapBefore) -> None:
    """Print a table for each record, because a table is as wide as a terminal."""
    for record in found.records:
        table = new_table(
            f"{record.name} - {found.model}, nothing fitted",
            "channel",
            "rms",
            "largest",
            "in noise",
            "corr.",
            "looks like",
            right=(1, 2, 3, 4),
            whole=(0, 1, 2, 3, 4),
        )
        for r in found.rows:
            if r.record != record.name:
                continue
            table.add_row(
                r.channel,
                _size(r.rms, r.unit),
                _size(r.largest, r.unit),
                f"{r.in_noise:.3g}, {abs(r.largest_in_noise):.3g}",
                f"{r.correlation:.3f}" if isfinite(r.correlation) else "",
                _looks(r),
            )
        console().print(table)


def _size(value: float, unit: str) -> str:
    return " ".join(pretty(value, unit)) if unit != "1" else f"{value:.4g}"


def _looks(row: GapBeforeRow) -> str:
    """Delay or factor that alone explains at least half of the squared difference, as text."""
    from feltmb.units import readable_unit

    texts = []
    if isfinite(row.delay):
        factor, unit = readable_unit(row.delay, "s")
        size = f"{abs(factor * row.delay):.3g} {unit}"
        texts.append(f"{size} {'late' if row.delay > 0 else 'early'}")
    if isfinite(row.factor):
        texts.append(f"{row.factor:.4g} times")
    return "\n".join(texts)


def _print_warnings(warnings: Sequence[str]) -> None:
    for warning in warnings:
        say(f"Warning: {warning}")
