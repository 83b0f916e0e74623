"""``feltmb symptom``: symptoms of an action, and the parts that cause them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import console, json_option, new_table, print_json

__all__ = ["command"]


def _names(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[str]:
    from feltmb.action.symptoms import load_symptoms

    return [name for name in load_symptoms() if name.startswith(incomplete)]


@click.command("symptom")
@click.argument("name", required=False, shell_complete=_names)
@click.option(
    "--wear",
    "table",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Table of your own action: feltmb wear ACTION --screws -o FILE.json; default: that of "
    "the packaged steinway45_leaded.",
)
@json_option
def command(name: str | None, table: Path | None, as_json: bool) -> None:
    """List the symptoms of an action, or show the causes of the symptom NAME.

    The causes are in order of likelihood, computed by simulation with each part changed alone.
    """
    from feltmb.action.symptoms import load_symptoms, packaged_wear, symptom
    from feltmb.action.wearing import Wear

    wear = packaged_wear() if table is None else Wear.read(table)
    if name is None:
        known = load_symptoms()
        if as_json:
            print_json({key: d.model_dump() for key, d in known.items()})
            return
        out = new_table("symptoms", "name", "what it is")
        for key, d in known.items():
            out.add_row(key, d.what)
        console().print(out)
        return
    found = symptom(name, wear)
    if as_json:
        print_json(found.as_dict())
        return
    screen = console()
    for line in (found.what, f"Test: {found.test}", _numbers(found, wear.name)):
        screen.print(line)
    out = new_table(f"causes of {name}", "part", "change that suffices", "likelihood", "what to do",
                    right=(2,))  # fmt: skip
    for cause in found.causes:
        out.add_row(cause.part, cause.change, f"{100.0 * cause.share:.0f} %", cause.remedy)
    screen.print(out)
    if found.screws:
        screen.print(f"Screws that take it back: {'; '.join(found.screws)}.")


def _numbers(found: Any, action: str) -> str:
    there = found.value >= found.limit if found.worse == "more" else found.value <= found.limit
    text = f"Number: {found.number}, {found.value:.3g} {found.unit} in {action}; "
    if there:
        return f"{text}this action has the symptom already (limit {found.limit:.3g} {found.unit})."
    return f"{text}the symptom is {found.worse} than {found.limit:.3g} {found.unit}."
