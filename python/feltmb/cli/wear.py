"""``feltmb wear``: each felt, friction and spring changed, against what a technician reads."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    FileName,
    check_targets,
    console,
    force_option,
    json_option,
    list_option,
    load_with_settings,
    new_table,
    picture_option,
    print_json,
    save_figure,
    say_written,
    set_option,
)
from feltmb.cli.completing import actions

if TYPE_CHECKING:
    from feltmb.action.wearing import Wear


@click.command("wear")
@click.argument("action", shell_complete=actions)
@list_option(
    "--part",
    "parts",
    metavar="PATTERN",
    help="Part of the mechanism, such as '*jack*'; default: all, which takes minutes.",
)
@click.option("--screws", is_flag=True, help="Also turn each screw of the regulation both ways.")
@picture_option("Draw all changes in one picture.")
@click.option(
    "--out",
    "-o",
    "output",
    metavar="FILE",
    type=FileName(".csv", ".json", dir_okay=False),
    help="Write all numbers as a table (CSV) or as JSON.",
)
@set_option
@force_option
@json_option
def command(
    action: str,
    parts: tuple[str, ...],
    screws: bool,
    picture: Path | None,
    output: Path | None,
    settings: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> None:
    """Change each part of ACTION alone, and measure the regulation, touch and repetition.

    Each felt is 0.2 and 0.5 mm thinner, or 20 % harder; each friction is doubled; each spring is
    20 % weaker.
    """
    import json

    from feltmb.action.wearing import wear
    from feltmb.files import write_text

    check_targets(output, pictures=(picture,), force=force)
    mechanism = load_with_settings(action, settings)
    result = wear(mechanism, parts=parts, screws=screws)
    if as_json:
        print_json(result.as_dict())
    else:
        console().print(wear_table(result))
    if output is not None:
        text = json.dumps(result.as_dict(), indent=1, ensure_ascii=False) + "\n"
        if output.suffix.lower() == ".csv":
            text = result.frame.to_csv(index=False)
        say_written(write_text(output, text, force=force))
    if picture is not None:
        save_figure(result.plot(), picture, force=force)


def wear_table(result: Wear) -> Any:
    """Numbers of the mechanism, and their changes by each variant."""
    from feltmb.action.wearing import MATTERS, NUMBERS, WEAR_NUMBERS

    heads = [f"{NUMBERS[n][0]} {NUMBERS[n][1]}" for n in WEAR_NUMBERS]
    right = tuple(range(2, 2 + len(heads)))
    table = new_table(f"wear of {result.name}", "part", "change", *heads, right=right)

    def text(name: str, value: float, sign: str = "") -> str:
        if not math.isfinite(value):
            return "none"
        places = max(0, 1 - math.floor(math.log10(MATTERS[name])))
        shown = f"{round(value, places) + 0.0:{sign}.{places}f}"
        return "" if sign and not float(shown) else shown

    table.add_row("as it is", "", *(text(n, result.base[n]) for n in WEAR_NUMBERS))
    for variant, numbers in result.rows:
        changes = (text(n, numbers[n] - result.base[n], "+") for n in WEAR_NUMBERS)
        table.add_row(variant.part, variant.change, *changes)
    table.caption = (
        "first row: numbers; then their changes; empty: no change; none: the number no longer "
        "exists"
    )
    return table


__all__ = ["command", "wear_table"]
