"""``feltmb gap join``: joins two measured files with two clocks to one record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    FileName,
    complain,
    force_option,
    list_option,
    say,
    say_written,
    split_pairs,
    tables_as_json,
)
from feltmb.cli.completing import actions
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.data import Record

__all__ = ["command"]

#: Largest number of alignments with a model; smallest standard deviation of the offset [s], because
#: a lighter or easier part is early, too.
ROUNDS, MODEL_SD = 4, 2e-3


@click.command("join", short_help="Join two files with two clocks to one record.")
@click.argument("first", type=click.Path(path_type=Path))
@click.argument("second", type=click.Path(path_type=Path))
@click.option(
    "--out",
    "-o",
    "output",
    type=FileName(".csv", dir_okay=False),
    required=True,
    help="CSV file to write; its TOML file gets the same name.",
)
@list_option(
    "--same",
    metavar="TIME=TIME",
    help="Time of an event on the clock of FIRST and on that of SECOND, such as 0.532s=1.207s. "
    "One gives the offset of the clocks, two give also their rate; auto: by the begin of the "
    "motion; default: the clocks are equal.",
)
@click.option(
    "--model",
    metavar="MODEL",
    shell_complete=actions,
    help="With --same auto: model whose motion under the force is correlated with FIRST, which is "
    "far more accurate.",
)
@list_option(
    "--input",
    "inputs",
    metavar="NAME=CHANNEL",
    help="Channel that is an input of the model, such as force=Load; default: the only channel in "
    "N is the force, if neither file has an input.",
)
@force_option
@tables_as_json
def command(
    first: Path,
    second: Path,
    output: Path,
    same: tuple[str, ...],
    model: str | None,
    inputs: tuple[str, ...],
    force: bool,
) -> None:
    """Join FIRST and SECOND, measured files of one experiment with two clocks, to one record.

    The clock and the samples of FIRST are kept, such as those of a camera. SECOND is interpolated
    linearly at these times. Each file is described by its TOML file or its header.
    """
    from feltmb.data import join_records, read_record, write_record
    from feltmb.files import check_writable

    read = {p.resolve() for file in (first, second) for p in (file, file.with_suffix(".toml"))}
    for path in (output, output.with_suffix(".toml")):
        check_writable(path, force=force)
        if path.resolve() in read:
            raise InvalidParameter(f"join: -o {output} is the name of a file that is joined")
    chosen = split_pairs("--input", inputs, "NAME=CHANNEL") or None
    one, two = read_record(first), read_record(second)
    if same == ("auto",):
        made = _aligned(one, two, model, chosen)
    elif model is not None:
        raise click.UsageError("--model aligns the clocks with --same auto")
    else:
        made = join_records(one, two, same=_events(same), inputs=chosen)
    made = replace(made, name=output.stem)
    for note in made.notes:
        complain(note)
    say_written(write_record(made, output, force=force))
    say_written(output.with_suffix(".toml"))
    channels = [f"input {n}" for n in made.inputs] + list(made.outputs)
    say(f"{made.samples} samples of {', '.join(channels)}")


def _events(texts: Sequence[str]) -> list[tuple[float, float]]:
    from feltmb.units.quantity import parse_scalar

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


def _aligned(
    first: Record, second: Record, model: str | None, inputs: Mapping[str, str] | None
) -> Record:
    """Records joined by the begin of the motion, and then by the motion of a model."""
    from feltmb.data import join_records
    from feltmb.data.joining import align_clocks

    clocks, sd = align_clocks(first, second)
    offset = clocks.offset
    if model is None:
        complain("--model MODEL would align the clocks far more accurately")
        return join_records(first, second, same=[(0.0, offset)], inputs=inputs, same_sd=sd)
    from feltmb.cli.gap_models import load_adapter
    from feltmb.gap import check

    checked = load_adapter(model, ()).model
    for _ in range(ROUNDS):
        made = join_records(first, second, same=[(0.0, offset)], inputs=inputs)
        delays = [r.delay for r in check(checked, [made]).rows if math.isfinite(r.delay)]
        if not delays:
            break
        middle = sum(delays) / len(delays)
        offset -= middle
        sd = max(max(delays) - min(delays), MODEL_SD, first.interval, second.interval)
        if abs(middle) < 0.1 * sd:
            break
    return join_records(first, second, same=[(0.0, offset)], inputs=inputs, same_sd=sd)
