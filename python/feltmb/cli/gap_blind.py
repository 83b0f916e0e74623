"""``feltmb gap blind``: how often the diagnosis would be correct on the user's own machine."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    console,
    credibility_option,
    folder_option,
    is_terminal,
    json_option,
    list_option,
    model_set_option,
    new_table,
    positive,
    print_json,
    redraw,
    say,
    say_written,
)
from feltmb.cli.completing import actions, effects
from feltmb.units import unit_suffix

if TYPE_CHECKING:
    from feltmb.gap import Case

__all__ = ["command"]


class _Told:
    """Prints each case with its withheld effect and the diagnosis, and the remaining time."""

    def __init__(self) -> None:
        self.start = time.monotonic()

    def __call__(self, done: int, total: int, case: Case) -> None:
        left = (time.monotonic() - self.start) / done * (total - done)
        rest = f"; about {left:.0f} s left" if done < total else ""
        unit = unit_suffix(case.unit)
        what = f"{case.effect} {case.magnitude:.3g}{unit}" if case.effect else "nothing withheld"
        said = case.verdict or case.error
        text = f"{done} of {total}: {what}: {said} ({case.outcome}){rest}"
        if is_terminal():
            redraw("")
        say(text, err=True)


@click.command("blind", short_help="Test the diagnosis of MODEL on simulated machines.")
@click.argument("model", shell_complete=actions)
@click.argument("data", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--cases",
    type=click.IntRange(1, 100_000),
    help="Number of cases; default: one without an effect and one for each effect.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random draws."
)
@list_option(
    "--effect",
    "only",
    shell_complete=effects,
    metavar="EFFECT",
    help="Effect that is withheld; default: each effect in turn. All effects are candidates.",
)
@list_option(
    "--hold-out",
    "hold_out",
    metavar="NAME",
    help="Record that is held out to confirm the findings.",
)
@folder_option("Folder for blind.json and one file for each case. An interrupted run continues.")
@credibility_option
@click.option(
    "--seconds",
    type=positive("s"),
    default=120.0,
    show_default=True,
    help="Limit of time of each diagnosis [s].",
)
@model_set_option
@json_option
def command(
    model: str,
    data: tuple[Path, ...],
    cases: int | None,
    seed: int,
    only: tuple[str, ...],
    hold_out: tuple[str, ...],
    output: Path | None,
    credibility: float,
    seconds: float,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Estimate how often a diagnosis of MODEL would be correct on your machine.

    Each case adds one effect of the library to the model, with a magnitude and parameters from
    their priors, and simulates the inputs of DATA with the noise of its sensors. The diagnosis does
    not know the effect. Without DATA the planned runs of the model are used. Machine and model have
    the same equations, so a real machine is more difficult.
    """
    import json

    from feltmb.cli.gap_models import held_out, load_adapter
    from feltmb.errors import InvalidParameter
    from feltmb.files import write_text
    from feltmb.gap import OUTCOMES, Options, withhold

    adapter = load_adapter(model, settings)
    groups = adapter.read_each(data) if data else (adapter.planned,)
    records = tuple(r for group in groups for r in group)
    if not records:
        raise InvalidParameter(f"{model}: has no planned runs; give measured or planned files")
    adapter = adapter.with_records(records)
    found = withhold(
        adapter.model,
        adapter.effects,
        records,
        cases=cases,
        seed=seed,
        only=list(dict.fromkeys(only)) or None,
        hold_out=(held_out(hold_out, data, groups) if data else list(hold_out)) or None,
        folder=output,
        options=Options(credibility=credibility, seconds=seconds),
        progress=_Told(),
    )
    result = found.as_dict()
    if output is not None:
        text = json.dumps(result, indent=1, sort_keys=True) + "\n"
        say_written(write_text(output / "blind.json", text, force=True))
    if as_json:
        print_json(result)
        return
    table = new_table(
        "withheld", "effect", "S/N", *OUTCOMES, right=tuple(range(1, 2 + len(OUTCOMES))), whole=(0,)
    )
    for row in found.rows():
        ratio = f"{row['signal_to_noise']:.3g}" if row["effect"] else ""
        counts = [str(row[word] or "") for word in OUTCOMES]
        table.add_row(row["effect"] or "(nothing)", ratio, *counts)
    console().print(table)
    shares = found.shares()
    for word, text in (
        ("right", "right, signal-to-noise ratio of 5 or more"),
        ("wrong", "wrong, signal-to-noise ratio of 5 or more"),
        ("false alarm", "false alarms, nothing withheld"),
        ("intervals", "95 % intervals that contain the truth"),
    ):
        if word in shares:
            value, low, high, count = shares[word]
            say(f"{text}: {value:.0%} of {count} (95 %: {low:.0%} to {high:.0%})")
