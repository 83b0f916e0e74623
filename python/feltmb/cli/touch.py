"""``feltmb touch``: touch of an action."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    FolderName,
    console,
    force_option,
    is_terminal,
    json_option,
    load_with_settings,
    new_table,
    print_json,
    say_written,
    set_option,
)
from feltmb.cli.completing import actions

if TYPE_CHECKING:
    from feltmb.action.touch import Touch, TouchRow


@click.command("touch")
@click.argument("action", shell_complete=actions)
@click.option(
    "--plot",
    "folder",
    type=FolderName(file_okay=False),
    help="Draw touch_static.png and touch_dynamic.png in this folder; with --set or --before, of "
    "both mechanisms.",
)
@click.option(
    "--before",
    metavar="ACTION",
    shell_complete=actions,
    help="Mechanism for comparison; default with --set: ACTION without changes.",
)
@set_option
@force_option
@json_option
def command(
    action: str,
    folder: Path | None,
    before: str | None,
    settings: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> None:
    """Compute the touch of ACTION: weights of a slow press and release, and series of strikes.

    Static values are computed without inertia. Pressed and struck strikes are simulated in threads.
    The table contains published ranges, most of them of grand pianos. With --set or --before it
    shows the values of both mechanisms.
    """
    from feltmb.action.touch import touch
    from feltmb.files import check_writable, make_folder

    mechanism = load_with_settings(action, settings)
    if before is None and settings:
        before = action
    former = load_with_settings(before, ()) if before is not None else None
    if folder is not None:
        make_folder(folder)
        for name in ("touch_static.png", "touch_dynamic.png"):
            check_writable(folder / name, force=force)
    if is_terminal():
        with console(stderr=True).status("measuring") as status:
            earlier = touch(former, progress=status.update) if former is not None else None
            result = touch(mechanism, progress=status.update)
    else:
        earlier = touch(former) if former is not None else None
        result = touch(mechanism)
    if as_json:
        data = result.as_dict()
        print_json(data if earlier is None else data | {"before": earlier.as_dict()})
    else:
        screen = console()
        screen.print(touch_table(result, earlier))
        if result.weights is not None:
            share = result.weights.hammer_share
            screen.print(
                f"The key carries the share {share:.2f} of strike weight times hammer / key "
                "travel. A level shank gives about 1; that of an upright stands, and its hammer "
                "hangs on the center pin."
            )
        screen.print(strike_table(result))
        for note in result.static.notes:
            screen.print(f"Note: {note}")
        for i, source in enumerate(_sources(result), start=1):
            screen.print(f"[{i}] {source}")
        for strike in result.strikes:
            if strike.failure:
                unit = "N" if strike.kind == "pressed" else "m/s"
                screen.print(f"{strike.kind} {strike.level:g} {unit}: {strike.failure}")
    if folder is not None:
        for path in result.plot(folder, before=earlier, force=force):
            say_written(path)


def _sources(result: Touch) -> list[str]:
    return list(dict.fromkeys(row.source for row in result.rows if row.source))


def _published(row: TouchRow) -> str:
    if row.low is not None and row.high is not None:
        return f"{row.low:g} to {row.high:g}"
    return "" if row.published is None else f"{row.published:g}"


def _shown(row: TouchRow) -> str:
    if row.value is None:
        return "-"
    return f"{row.value:.{3 if row.unit in ('1', 'mm') else 1}f}"


def touch_table(result: Touch, before: Touch | None = None) -> Any:
    """Simulated and published values, forces in gram-force; ``before``: of another mechanism."""
    from feltmb.action.touch.pictures import GRAM_FORCE

    title = f"touch of {result.action.name}"
    if before is not None and before.action.name != result.action.name:
        title += f", before: {before.action.name}"
    heads = ["here"] if before is None else ["before", "after"]
    right = (*range(1, 1 + len(heads)), 2 + len(heads))
    table = new_table(title, "", *heads, "unit", "published", "", "", right=right)
    sources = _sources(result)
    for row in result.rows:
        unit = "" if row.unit == "1" else row.unit
        if row.value is not None and row.unit == "gf" and before is None:
            unit = f"gf = {row.value * GRAM_FORCE:.3f} N"
        numbers = [_shown(row)]
        if before is not None:
            then = next((r for r in before.rows if r.key == row.key), None)
            numbers.insert(0, "-" if then is None else _shown(then))
        source = f"[{sources.index(row.source) + 1}]" if row.source else ""
        table.add_row(row.name, *numbers, unit, _published(row), row.verdict, source)
    low, high = (1e3 * w for w in result.static.window)
    table.caption = (
        f"weights: mean over {low:.2f} to {high:.2f} mm of key travel, damper lifted; "
        "empty: nothing published"
    )
    return table


def strike_table(result: Touch) -> Any:
    """Table with one row per strike."""
    table = new_table(
        "strikes",
        "",
        "level",
        "unit",
        "impact m/s",
        "key m/s",
        "travel ms",
        "bottom - string ms",
        right=(1, 3, 4, 5, 6),
    )

    def show(value: float | None, factor: float, digits: int) -> str:
        return "-" if value is None else f"{value * factor:.{digits}f}"

    for strike in result.strikes:
        table.add_row(
            strike.kind,
            f"{strike.level:g}",
            "N" if strike.kind == "pressed" else "m/s",
            show(strike.hammer_speed, 1.0, 3),
            show(strike.key_speed, 1.0, 3),
            show(strike.travel_time, 1e3, 1),
            show(strike.bottom_after_string, 1e3, 1),
        )
    fits = [
        f"{kind} {1e3 * a:.1f} ms v^{b:.3f} (to {100 * worst:.0f} %)"
        for kind, (a, b, worst) in result.fits.items()
    ]
    table.caption = "travel time: " + ", ".join(fits) if fits else None
    return table


__all__ = ["command", "strike_table", "touch_table"]
