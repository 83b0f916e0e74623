"""``feltmb list``: lists packaged data, laws and units."""

from __future__ import annotations

import click

from feltmb.cli.common import console, json_option, new_table, print_json

ONE_NOTE = (
    "Every mechanism here is one note: 40 of 88 (middle C) of one upright piano, steinway45 and "
    "its variants, unless its name has another; grand_action is a grand from literature. Another "
    "note, piano or machine needs a file of its own: feltmb new FILE.toml writes a template."
)


@click.command("list")
@json_option
def command(as_json: bool) -> None:
    """List packaged mechanisms, strokes, contact laws and accepted units."""
    from feltmb import params
    from feltmb.contact import LAWS
    from feltmb.run.stroke import load_stroke, packaged_strokes
    from feltmb.units import ACCEPTED_UNITS

    actions, actuators = params.texts("about"), params.texts("about", "actuators")
    strokes = {name: load_stroke(name) for name in packaged_strokes()}
    if as_json:
        print_json(
            {
                "actions": actions,
                "actuators": actuators,
                "strokes": {n: s.as_dict() for n, s in strokes.items()},
                "laws": LAWS,
                "units": sorted(ACCEPTED_UNITS),
            }
        )
        return
    screen = console()
    table = new_table("mechanisms", "name", "about")
    for name, about in actions.items():
        table.add_row(name, about)
    screen.print(table)
    screen.print(ONE_NOTE)
    table = new_table("actuators", "name", "about")
    for name, about in actuators.items():
        table.add_row(name, about)
    screen.print(table)
    table = new_table("strokes", "name", "input", "largest", "length", right=(2, 3))
    for name, stroke in strokes.items():
        factor, unit = (1e3, "mm") if stroke.unit == "m" else (1.0, stroke.unit)
        top = max(stroke.value) * factor
        table.add_row(name, stroke.kind, f"{top:g} {unit}", f"{stroke.duration:g} s")
    screen.print(table)
    table = new_table("contact laws (contacts.NN.law)", "name", "about")
    for name, about in LAWS.items():
        table.add_row(name, about)
    screen.print(table)
    screen.print("units: " + " ".join(sorted(u for u in ACCEPTED_UNITS if u != "1")))
