"""``feltmb sensitivity``: influence of parameters on the results of a stroke."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.cli.completing import actions, strokes
from feltmb.cli.completing import paths as known_paths
from feltmb.cli.settings import SET, load_with_settings
from unmodeled.cli.options import (
    FORCE,
    FileName,
    Number,
    argument,
    count,
    declare,
    option,
    positive,
)
from unmodeled.cli.screen import (
    check_targets,
    console,
    pretty,
    print_json,
    save_figure,
    save_text,
    show,
    working,
)

if TYPE_CHECKING:
    from feltmb.run.sensitivity import Gradient


@declare("sensitivity")
def command(
    action: str = argument(complete=actions),
    stroke: str = argument(complete=strokes),
    parameters: tuple[str, ...] = option(
        "Dotted path as for --set, with * for any name; or stroke.scale, stroke.delay. Default: "
        "every number of the mechanism, which takes longer.",
        metavar="PATH",
        complete=known_paths,
    ),
    number: str | None = option(
        "Number of the summary, or a row of [reading], that sorts the table; default: "
        "impact_speed, or the first number of the stroke.",
        metavar="NAME",
    ),
    most: int = option("Rows of the table.", count(), 20),
    duration: float | None = option(
        "Simulated time [s]; default: the stroke's own.", positive("s")
    ),
    rtol: float = option("Tolerance of the stroke.", Number(1e-13, 1e-2), 1e-9),
    plot: Path | None = option(
        "Draw the most influential parameters (.png, .pdf or .svg).", metavar="FILE"
    ),
    out: Path | None = option("Write all effects as CSV.", FileName(".csv")),
    settings: tuple[str, ...] = SET,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Compute the derivatives of a STROKE of ACTION with respect to its parameters.

    The table shows how the numbers of the strike change if a parameter increases by 1 %. A
    parameter that is zero is changed by 1 % of a typical value (1 mm, 0.01 rad and so on).
    """
    from feltmb.graphics.plot import effects as draw_effects
    from feltmb.run.reading import summary_rows
    from feltmb.run.sensitivity import gradient
    from feltmb.run.stroke import load_stroke

    mechanism = load_with_settings(action, settings)
    check_targets(out, pictures=(plot,), force=force)
    with working("simulating"):
        result = gradient(
            mechanism,
            load_stroke(stroke),
            list(parameters) or None,
            (),
            duration=duration,
            rtol=rtol,
        )
    number = _sorting_number(result, number, f"stroke {stroke!r} of {mechanism.name!r}")
    if number in result.unknown and not as_json:
        from unmodeled.errors import InvalidParameter

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
        print_json(_as_json(result))
    else:
        _print_effects(result, effects, list(order[:most]), number, stroke, words)
        for name, why in result.unknown.items():
            console().print(f"{words.get(name, name.replace('_', ' '))} has no derivative: {why}")
    save_text(out, lambda: effects.loc[order].to_csv(), force=force)
    change = effects.loc[order[:most], number].rename(words.get(number, number))
    save_figure(plot, lambda: draw_effects(change, result.summary_units[number]), force=force)


def _sorting_number(result: Gradient, number: str | None, what: str) -> str:
    """The number that sorts the table."""
    from feltmb.run.arrays import missing_number
    from unmodeled.errors import InvalidParameter

    if number is None:
        known = [n for n in result.summary if n not in result.unknown] or list(result.summary)
        number = next((n for n in ("impact_speed", *known) if n in known), None)
        if number is None:
            raise InvalidParameter(
                f"{what} has no number to order by: [reading] of the mechanism names no "
                "strike_contact and no key_point"
            )
    if number not in result.summary:
        raise InvalidParameter(f"--number {missing_number(number, result.summary)}")
    return number


def _as_json(result: Gradient) -> dict[str, Any]:
    return {
        "summary": result.summary,
        "parameters": {
            p.path: {"value": p.value, "unit": p.unit, "size": p.size} for p in result.parameters
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


def _print_effects(
    result: Gradient,
    effects: Any,
    paths: Sequence[str],
    number: str,
    stroke: str,
    words: Mapping[str, str],
) -> None:
    others = ("impact_time", "max_impact_force", "rebound_speed")
    shown = list(dict.fromkeys([number, *(n for n in others if n in effects)]))
    shown = shown[:2]  # as many as fit into 80 columns
    names = [words.get(n, n.replace("_", " ")) for n in shown]
    units = result.summary_units

    def cell(effect: float, name: str) -> str:
        return " ".join(pretty(effect, units[name])) if math.isfinite(effect) else "-"

    values = {p.path: p for p in result.parameters}
    rows = [
        (path, f"{values[path].value:.4g}", values[path].unit,
         *(cell(float(effects.loc[path, name]), name) for name in shown))
        for path in paths
    ]  # fmt: skip
    now = " ".join(pretty(result.summary[number], units[number]))
    heads = " | ".join(["=parameter", ">value", "unit", *(f">{name}" for name in names)])
    show(f"{stroke}: what 1 % more does; {names[0]} is {now}", heads, rows)
