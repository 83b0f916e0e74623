"""``feltmb sensitivity``: influence of parameters on the results of a stroke."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    FileName,
    Number,
    check_targets,
    console,
    force_option,
    is_terminal,
    json_option,
    list_option,
    load_with_settings,
    new_table,
    positive,
    pretty,
    print_json,
    save_figure,
    set_option,
)
from feltmb.cli.completing import actions, strokes
from feltmb.cli.completing import paths as known_paths

if TYPE_CHECKING:
    from feltmb.run.sensitivity import Gradient


@click.command("sensitivity")
@click.argument("action", shell_complete=actions)
@click.argument("stroke", shell_complete=strokes)
@list_option(
    "--parameters",
    "paths",
    metavar="PATH",
    shell_complete=known_paths,
    help="Dotted path as for --set, with * for any name; or stroke.scale, stroke.delay. Default: "
    "every number of the mechanism, which takes longer.",
)
@click.option(
    "--number",
    metavar="NAME",
    help="Number of the summary, or a row of [reading], that sorts the table; default: "
    "impact_speed, or the first number of the stroke.",
)
@click.option(
    "--most", type=click.IntRange(1), default=20, show_default=True, help="Rows of the table."
)
@click.option(
    "--duration", type=positive("s"), help="Simulated time [s]; default: the stroke's own."
)
@click.option(
    "--rtol",
    type=Number(1e-13, 1e-2),
    default=1e-9,
    show_default=True,
    help="Tolerance of the stroke.",
)
@click.option(
    "--plot",
    "picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Draw the most influential parameters (.png, .pdf or .svg).",
)
@click.option(
    "-o",
    "--out",
    "table_file",
    type=FileName(".csv", dir_okay=False),
    help="Write all effects as CSV.",
)
@set_option
@force_option
@json_option
def command(
    action: str,
    stroke: str,
    paths: tuple[str, ...],
    number: str | None,
    most: int,
    duration: float | None,
    rtol: float,
    picture: Path | None,
    table_file: Path | None,
    settings: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> None:
    """Compute the derivatives of a STROKE of ACTION with respect to its parameters.

    The table shows how the numbers of the strike change if a parameter increases by 1 %. A
    parameter that is zero is changed by 1 % of a typical value (1 mm, 0.01 rad and so on).
    """
    from feltmb.errors import InvalidParameter
    from feltmb.files import write_text
    from feltmb.run.arrays import missing_number
    from feltmb.run.reading import summary_rows
    from feltmb.run.sensitivity import gradient
    from feltmb.run.stroke import load_stroke

    mechanism = load_with_settings(action, settings)
    check_targets(table_file, pictures=(picture,), force=force)

    def run() -> Gradient:
        return gradient(
            mechanism,
            load_stroke(stroke),
            list(paths) or None,
            (),
            duration=duration,
            rtol=rtol,
        )

    if is_terminal():
        with console(stderr=True).status("simulating"):
            result = run()
    else:
        result = run()
    if number is None:
        known = [n for n in result.summary if n not in result.unknown] or list(result.summary)
        number = next((n for n in ("impact_speed", *known) if n in known), None)
        if number is None:
            raise InvalidParameter(
                f"stroke {stroke!r} of {mechanism.name!r} has no number to order by: [reading] of "
                "the mechanism names no strike_contact and no key_point"
            )
    if number not in result.summary:
        raise InvalidParameter(f"--number {missing_number(number, result.summary)}")
    if number in result.unknown and not as_json:
        raise InvalidParameter(
            f"--number {number!r} has no derivative in this stroke: {result.unknown[number]}"
        )
    effects = result.effects()
    words = {
        name: text.partition(" (")[0]
        for name, (text, unit) in summary_rows(mechanism).items()
        if unit != "s"  # times have short names of their own
    } | {"impact_duration": "contact duration"}
    order = effects[number].abs().sort_values(ascending=False, kind="stable").index
    if as_json:
        print_json(
            {
                "summary": result.summary,
                "parameters": {
                    p.path: {"value": p.value, "unit": p.unit, "size": p.size}
                    for p in result.parameters
                },
                "derivatives": {
                    name: {
                        column: None if name in result.unknown else float(value)
                        for column, value in zip(result.columns, g, strict=True)
                    }
                    for name, g in result.summary_gradient.items()
                },
                "unknown": result.unknown,
                "stats": result.stats,
            }
        )
    else:
        table = _table(result, effects, list(order[:most]), number, stroke, words)
        console().print(table)
        for name, why in result.unknown.items():
            console().print(f"{words.get(name, name.replace('_', ' '))} has no derivative: {why}")
    if table_file is not None:
        from feltmb.cli.common import say_written

        say_written(write_text(table_file, effects.loc[order].to_csv(), force=force))
    if picture is not None:
        from feltmb.graphics.plot import effects as draw_effects

        change = effects.loc[order[:most], number].rename(words.get(number, number))
        figure = draw_effects(change, result.summary_units[number])
        save_figure(figure, picture, force=force)


def _table(
    result: Gradient,
    effects: Any,
    rows: list[str],
    number: str,
    stroke: str,
    words: Mapping[str, str],
) -> Any:
    shown = [number] + [
        n for n in ("impact_time", "max_impact_force", "rebound_speed") if n in effects
    ]
    shown = list(dict.fromkeys(shown))[:2]  # as many as fit into 80 columns
    names = [words.get(n, n.replace("_", " ")) for n in shown]
    value, unit = pretty(result.summary[number], result.summary_units[number])
    table = new_table(
        f"{stroke}: what 1 % more does; {names[0]} is {value} {unit}",
        "parameter",
        "value",
        "unit",
        *names,
        right=(1, *range(3, 3 + len(shown))),
        whole=(0,),
    )
    values = {p.path: p for p in result.parameters}
    for path in rows:
        cells = []
        for name in shown:
            effect = float(effects.loc[path, name])
            known = math.isfinite(effect)
            cells.append(" ".join(pretty(effect, result.summary_units[name])) if known else "-")
        table.add_row(path, f"{values[path].value:.4g}", values[path].unit, *cells)
    return table


__all__ = ["command"]
