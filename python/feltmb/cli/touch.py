"""``feltmb touch``: what the finger feels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
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
    type=click.Path(path_type=Path, file_okay=False),
    help="Draw touch_static.png and touch_dynamic.png in this folder.",
)
@set_option
@force_option
@json_option
def command(
    action: str,
    folder: Path | None,
    settings: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> None:
    """Touch of ACTION: weights of a slow press and release, and families of blows.

    Static numbers without inertia; pressed and struck blows simulated in threads. Published ranges
    stand beside them; most are of grand pianos.
    """
    from feltmb.action.touch import touch
    from feltmb.files import check_writable

    mechanism = load_with_settings(action, settings)
    if folder is not None:
        for name in ("touch_static.png", "touch_dynamic.png"):
            check_writable(folder / name, force=force)
    if is_terminal():
        with console(stderr=True).status("measuring") as status:
            result = touch(mechanism, progress=lambda text: status.update(text))
    else:
        result = touch(mechanism)
    if as_json:
        print_json(result.as_dict())
    else:
        screen = console()
        screen.print(touch_table(result))
        screen.print(blow_table(result))
        for i, source in enumerate(_sources(result), start=1):
            screen.print(f"[{i}] {source}")
        for blow in result.blows:
            if blow.failure:
                unit = "N" if blow.kind == "pressed" else "m/s"
                screen.print(f"{blow.kind} {blow.level:g} {unit}: {blow.failure}")
    if folder is not None:
        for path in result.plot(folder, force=force):
            say_written(path)


def _sources(result: Touch) -> list[str]:
    return list(dict.fromkeys(row.source for row in result.rows if row.source))


def _published(row: TouchRow) -> str:
    if row.low is not None and row.high is not None:
        return f"{row.low:g} to {row.high:g}"
    return "" if row.published is None else f"{row.published:g}"


def touch_table(result: Touch) -> Any:
    """Ours beside published numbers; forces in N and gram-force."""
    from feltmb.action.touch.pictures import GRAM_FORCE

    table = new_table(
        f"touch of {result.action.name}", "", "here", "unit", "published", "", "", right=(1, 3)
    )
    sources = _sources(result)
    for row in result.rows:
        unit = "" if row.unit == "1" else row.unit
        if row.value is None:
            number = "-"
        elif row.unit == "gf":
            number, unit = f"{row.value:.1f}", f"gf = {row.value * GRAM_FORCE:.3f} N"
        else:
            number = f"{row.value:.3f}" if row.unit in ("1", "mm") else f"{row.value:.1f}"
        source = f"[{sources.index(row.source) + 1}]" if row.source else ""
        table.add_row(row.name, number, unit, _published(row), row.verdict, source)
    low, high = (1e3 * w for w in result.static.window)
    table.caption = (
        f"weights: mean over {low:.2f} to {high:.2f} mm of key travel, damper lifted; "
        "empty: nothing published"
    )
    return table


def blow_table(result: Touch) -> Any:
    """One row a blow."""
    table = new_table(
        "blows",
        "",
        "level",
        "unit",
        "hammer m/s",
        "key m/s",
        "travel ms",
        "bottom - string ms",
        right=(1, 3, 4, 5, 6),
    )

    def show(value: float | None, factor: float, digits: int) -> str:
        return "-" if value is None else f"{value * factor:.{digits}f}"

    for blow in result.blows:
        table.add_row(
            blow.kind,
            f"{blow.level:g}",
            "N" if blow.kind == "pressed" else "m/s",
            show(blow.hammer_speed, 1.0, 3),
            show(blow.key_speed, 1.0, 3),
            show(blow.travel_time, 1e3, 1),
            show(blow.bottom_after_string, 1e3, 1),
        )
    fits = [
        f"{kind} {1e3 * a:.1f} ms v^{b:.3f} (to {100 * worst:.0f} %)"
        for kind, (a, b, worst) in result.fits.items()
    ]
    table.caption = "travel time: " + ", ".join(fits) if fits else None
    return table


__all__ = ["blow_table", "command", "touch_table"]
