"""``feltmb regulate``: turn the screws of an action until it meets its targets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    FileName,
    complain,
    console,
    force_option,
    is_terminal,
    json_option,
    list_option,
    load_with_settings,
    new_table,
    print_json,
    say_written,
    set_option,
    split_pairs,
)
from feltmb.cli.completing import actions, packaged

if TYPE_CHECKING:
    from feltmb.action.regulate import Regulation


@click.command("regulate")
@click.argument("action", shell_complete=actions)
@click.option(
    "--targets",
    shell_complete=packaged("regulation"),
    metavar="FILE",
    help="Packaged name or TOML file; default: the packaged targets of the mechanism's name.",
)
@list_option(
    "--target",
    "own",
    metavar="STEP=VALUE",
    help="Target of a step, such as let-off=4mm or key-dip=10mm.",
)
@click.option(
    "-o",
    "--out",
    type=FileName(".toml", dir_okay=False),
    help="Write the regulated mechanism, with its provenance, to this TOML file.",
)
@set_option
@force_option
@json_option
def command(
    action: str,
    targets: str | None,
    own: tuple[str, ...],
    out: Path | None,
    settings: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> None:
    """Regulate ACTION: key dip, strike, lost motion, let-off, damper, backcheck.

    Each step measures one value and turns one screw. The steps are repeated until all targets are
    met. If a target cannot be met, the table gives the reason, no file is written, and the exit
    code is 1.
    """
    from feltmb.action.regulate import default_targets, load_targets, regulate
    from feltmb.errors import FeltmbError
    from feltmb.files import check_writable, write_text

    mechanism = load_with_settings(action, settings)
    wanted = load_targets(targets) if targets is not None else None
    if own:
        wanted = (wanted or default_targets(mechanism)).with_targets(
            split_pairs("--target", own, "STEP=VALUE, such as let-off=4mm")
        )
    if out is not None:
        check_writable(out, force=force)
    if is_terminal():
        with console(stderr=True).status("measuring") as status:
            result = regulate(mechanism, wanted, progress=lambda text: status.update(text))
    else:
        result = regulate(mechanism, wanted)
    if as_json:
        print_json(result.as_dict())
    else:
        screen = console()
        screen.print(regulation_table(result))
        if result.provenance["screws"]:
            screen.print(screw_table(result))
        else:
            screen.print("No screw was turned.")
        for row in result.table:
            if row.before is None and row.holds:
                screen.print(f"{row.name} could not be measured before: {row.why}.")
        for note in result.notes:
            screen.print(f"Note: {note}.")
    if not result.converged:
        for row in result.unmet[:-1]:
            complain(_unmet(row))
        last = _unmet(result.unmet[-1])
        raise FeltmbError(f"{last}\nnothing was written" if out is not None else last)
    if out is not None:
        say_written(write_text(out, result.to_toml(), force=force))


def _unmet(row: Any) -> str:
    return f"{row.name}: target {row.target} {row.unit}".rstrip() + f" is not met: {row.why}"


def _show(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def regulation_table(result: Regulation) -> Any:
    """Table of each step: target, before and after."""
    name = result.provenance["action"]
    table = new_table(
        f"regulation of {name}",
        "",
        "step",
        "target",
        "before",
        "after",
        "unit",
        "",
        right=(2, 3, 4),
    )
    for row in result.table:
        table.add_row(
            row.letter,
            row.name,
            row.target,
            _show(row.before),
            _show(row.after),
            row.unit,
            "holds" if row.holds else "NOT MET",
        )
    counts = ", ".join(f"{number} {what}" for what, number in result.counts.items())
    rounds = f"{result.rounds} round" + ("" if result.rounds == 1 else "s")
    table.caption = f"{rounds}; {counts}; targets {result.provenance['targets']}"
    return table


def screw_table(result: Regulation) -> Any:
    """Table of the turned screws and their changes."""
    table = new_table(
        "screws", "step", "screw", "turned", "value changed", "before", "after", right=(2,)
    )
    for row in result.table:
        if row.screw and row.turned:
            table.add_row(
                row.name,
                row.screw,
                row.moved,
                row.path,
                row.value_before,
                row.value_after,
            )
    return table


__all__ = ["command", "regulation_table", "screw_table"]
