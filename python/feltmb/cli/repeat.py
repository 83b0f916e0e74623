"""``feltmb repeat``: highest rate at which every press of the key strikes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    Number,
    check_targets,
    console,
    force_option,
    json_option,
    list_option,
    load_with_settings,
    new_table,
    picture_option,
    positive,
    print_json,
    save_figure,
    set_option,
)
from feltmb.cli.completing import actions

if TYPE_CHECKING:
    from feltmb.action.repetition import Repetition


@click.command("repeat")
@click.argument("action", shell_complete=actions)
@list_option(
    "--speed",
    "speeds",
    type=positive("m/s"),
    help="Speed of the pressing finger [m/s]; default: 0.15 (soft) and 0.5 (hard).",
)
@list_option(
    "--return",
    "returns",
    type=Number(0, 1, min_open=True),
    help="Share of the key travel that the key returns between presses, such as 50%; default: "
    "100 %, 75 %, 50 %.",
)
@click.option(
    "--presses", type=click.IntRange(2, 50), default=5, show_default=True, help="Presses in a run."
)
@click.option(
    "--highest",
    type=Number(2, 50),
    default=16.0,
    show_default=True,
    help="Rate at which the search ends, presses per second.",
)
@picture_option("Draw the rates with their reasons, and the run with the first failure.")
@set_option
@force_option
@json_option
def command(
    action: str,
    speeds: tuple[float, ...],
    returns: tuple[float, ...],
    presses: int,
    highest: float,
    picture: Path | None,
    settings: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> None:
    """Find the highest rate at which every press of the key of ACTION strikes.

    The table tells why the first press fails beyond this rate: the key is too slow, the hammer was
    not caught, or the jack is not back under the butt.
    """
    from feltmb.action.repetition import RETURNS, SPEEDS, repeat

    check_targets(pictures=(picture,), force=force)
    mechanism = load_with_settings(action, settings)
    result = repeat(
        mechanism,
        speeds=speeds or SPEEDS,
        returns=returns or RETURNS,
        presses=presses,
        highest=highest,
    )
    if as_json:
        print_json(result.as_dict())
    else:
        console().print(repetition_table(result))
    if picture is not None:
        save_figure(result.plot(), picture, force=force)


def repetition_table(result: Repetition) -> Any:
    """Highest rates with their reasons."""
    table = new_table(
        f"repetition of {result.action.name}",
        "finger m/s",
        "key returns mm",
        "highest rate 1/s",
        "first strike m/s",
        "weakest strike m/s",
        "above this rate",
        right=(0, 1, 2, 3, 4),
    )
    for row in result.rows:
        table.add_row(
            f"{row.speed:g}",
            f"{1e3 * row.key_return * result.travel:.1f}",
            row.rate_text,
            f"{row.impact_speed:.2f}",
            "-" if math.isnan(row.weakest) else f"{row.weakest:.2f}",
            row.sentence,
        )
    table.caption = (
        f"{result.presses} presses; a press strikes if it reaches half the impact speed of the "
        "first one"
    )
    return table


__all__ = ["command", "repetition_table"]
