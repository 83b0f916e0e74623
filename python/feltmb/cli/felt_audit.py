"""``feltmb felt audit``: faults of a law and its data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    FolderName,
    complain,
    console,
    force_option,
    json_option,
    new_table,
    positive,
    print_json,
    save_figure,
    say,
    set_option,
)
from feltmb.cli.completing import packaged

if TYPE_CHECKING:
    from feltmb.felt import Audit


__all__ = ["audit_command"]


def _print_audit(result: Audit) -> None:
    say(f"{result.name}: {result.about or result.law} (law {result.law})")
    if result.closing is not None:
        say(f"  loop ends at {result.closing * 1e3:.4g} mm")
    if result.window is None:
        say("  valid window: none")
    else:
        say(f"  valid window: {result.window[0] * 1e3:.4g} to {result.window[1] * 1e3:.4g} mm")
    for branch, (low, high) in result.stiffness_range.items():
        say(f"  tangent stiffness, {branch}: {low * 1e-3:.4g} to {high * 1e-3:.4g} N/mm")
    for f in result.findings:
        say(f"  {f.kind}: {f.text}")
    if not result.findings:
        say("  no faults")
    frequencies = sorted({c.frequency for c in result.cycles})
    table = new_table(
        "Loss of the second cycle, in brackets of the first [%]",
        "amplitude",
        *(f"{f:g} Hz" for f in frequencies),
        right=tuple(range(1, len(frequencies) + 1)),
    )
    for amplitude in sorted({c.amplitude for c in result.cycles}):
        row = [c for c in result.cycles if c.amplitude == amplitude]
        table.add_row(
            f"{amplitude * 1e3:.4g} mm",
            *(f"{100 * c.loss:.2f} ({100 * c.first_loss:.2f})" for c in row),
        )
    console().print(table)


@click.command(
    name="audit", short_help="Audit LAW: a contact, a felt, an envelope, or all contacts."
)
@click.argument("law", shell_complete=packaged("", "felts"))
@click.option("--all", "everything", is_flag=True, help="Audit all contacts of the mechanism LAW.")
@set_option
@click.option(
    "--largest",
    type=positive("m"),
    help="End of the audit of a law without a loop [m], such as 1mm.",
)
@click.option(
    "--plot",
    "folder",
    type=FolderName(file_okay=False),
    help="Folder for one picture of each law.",
)
@json_option
@force_option
def audit_command(
    law: str,
    everything: bool,
    settings: tuple[str, ...],
    largest: float | None,
    folder: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Audit LAW: a contact (steinway45:04), a felt, an envelope, or --all contacts of a mechanism.

    The audit reports valid window, crossing, adhesion, created energy, loss against amplitude and
    frequency, and stiffness.
    """
    from feltmb.felt import audit, audit_targets
    from feltmb.felt.plot import plot_audit
    from feltmb.files import check_writable, make_folder

    if everything and ":" in law:
        raise click.UsageError(f"--all is for all contacts of a mechanism; {law} is one of them")
    targets = audit_targets(law, settings, everything=everything, tell=complain)

    def picture(name: str) -> Path:
        assert folder is not None
        return folder / f"audit_{Path(name).stem.replace(':', '_')}.png"

    if folder is not None:
        make_folder(folder)
        for name, _ in targets:
            check_writable(picture(name), force=force)
    results = [audit(item, name=name, largest=largest) for name, item in targets]
    if as_json:
        print_json([r.to_dict() for r in results])
    elif len(results) == 1:
        _print_audit(results[0])
    else:
        table = new_table(
            f"Audit of {law}: contact law {', '.join(sorted({r.law for r in results}))}",
            "no.",
            "window [mm]",
            "loop to",
            "loss, 0.03 Hz",
            "30 Hz",
            "data",
            "law",
            right=(1, 2, 3, 4),
        )
        for r in results:
            full = {c.frequency: c for c in r.cycles if c.amplitude == r.cycles[-1].amplitude}
            window = "none"
            if r.window is not None:
                window = f"{r.window[0] * 1e3:.3f} - {r.window[1] * 1e3:.3f}"
            kinds = sorted(
                {f.kind for f in r.findings} & {"crossing", "adhesion", "softening", "open"}
            )
            table.add_row(
                r.name.partition(":")[2] or r.name,
                window,
                "-" if r.closing is None else f"{r.closing * 1e3:.3f}",
                f"{100 * full[0.03].loss:.2f} %",
                f"{100 * full[30.0].loss:.2f} %",
                ", ".join(kinds) or "sound",
                "sound" if r.law_is_sound else "unsound",
            )
        console().print(table)
        for r in results:
            for f in r.findings:
                say(f"{r.name.partition(':')[2] or r.name} {f.kind}: {f.text}")
    if folder is not None:
        for r in results:
            save_figure(plot_audit(r), picture(r.name), force=force)
