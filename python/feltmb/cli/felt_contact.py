"""``feltmb felt contact``: the contact law of a measured loop."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from feltmb.cli.common import (
    FileName,
    Quantity,
    check_targets,
    complain,
    console,
    force_option,
    json_option,
    new_table,
    positive,
    print_json,
    save_figure,
    say,
    say_written,
)
from feltmb.cli.completing import actions
from feltmb.cli.gap_reading import test_options

if TYPE_CHECKING:
    from feltmb.felt import FeltEnvelope, LoopUncertainty, MeasuredLoop

__all__ = ["contact_command", "known_contact", "print_envelope"]


def known_contact(action: str, contact: str | None) -> None:
    """Check that a mechanism has a contact.

    Raises
    ------
    InvalidParameter
        It has none with this name.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.mechanism import load_action

    if contact is None:
        return
    known = load_action(action).config.contacts
    if contact not in known:
        raise InvalidParameter(
            f"--contact: got {contact!r}, expected one of {', '.join(known)} of {action}"
        )


def print_envelope(made: FeltEnvelope, sure: LoopUncertainty | None = None) -> None:
    """Print some rows of an envelope, with their standard uncertainties if they are known."""
    columns = ["compression [mm]", "loading [N]", "unloading [N]"]
    if sure is not None:
        columns = [columns[0], columns[1], "± [N]", columns[2], "± [N]"]
    table = new_table("Envelope", *columns, right=tuple(range(len(columns))))
    for share in (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0):
        x = share * made.closing
        forces = float(made.core.loading(x)), float(made.core.unloading(x, made.closing))
        row = [f"{force:.5g}" for force in forces]
        if sure is not None:
            sides = (np.interp(x, made.compression, sd) for sd in (sure.loading, sure.unloading))
            row = [text for pair in zip(row, (f"{sd:.2g}" for sd in sides), strict=True)
                   for text in pair]  # fmt: skip
        table.add_row(f"{x * 1e3:.4g}", *row)
    console().print(table)


def _print_cycles(found: MeasuredLoop) -> None:
    """Print the loss of each cycle."""
    table = new_table("Cycles", "cycle", "from [mm]", "to [mm]", "force [N]", "loss [%]", "± [%]",
                      right=tuple(range(6)))  # fmt: skip
    for one in found.cycles:
        mark = " *" if one.number == found.branches.chosen else ""
        row = [f"{1e3 * x:.4g}" for x in (one.low, one.top)]
        row += [f"{one.force:.4g}", f"{100 * one.loss:.2f}", f"{100 * one.sd:.2g}"]
        table.add_row(f"{one.number}{mark}", *row)
    console().print(table)
    say("* the loop")


def _memory(found: MeasuredLoop) -> str:
    """Numbers of the memory with their uncertainty, or why they have none."""
    if "kappa" not in found.memory:
        return (
            "memory: kappa = 0.2 and wiping_out = 0, the defaults of the law: the test does not "
            "tell better ones, and they have no uncertainty"
        )
    from feltmb.felt.measured import WIPING_OUT

    kappa, sd = found.memory["kappa"], found.uncertainty.kappa
    about = f"± {sd:.2g}" if math.isfinite(sd) else "the test does not determine its uncertainty"
    return (
        f"memory: kappa = {kappa:.4g} ({about}), wiping_out = "
        f"{found.memory.get('wiping_out', 0.0):g} (of 0 and {WIPING_OUT}, the one that follows the "
        "test better; no uncertainty)"
    )


@click.command(name="contact", short_help="Contact law from the measured loop in TEST.")
@click.argument("test", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--zero",
    type=Quantity("m"),
    help="Displacement (or thickness) at the first contact [m], such as 0.4mm; default: the "
    "beginning of a power law through the toe of loading.",
)
@click.option(
    "--thickness", type=positive("m"), help="Thickness without load [m], for a column of strain."
)
@click.option("--area", type=positive("m^2"), help="Area [m^2], for a column of pressure.")
@test_options
@click.option(
    "--points", type=click.IntRange(5, 100_000), default=193, show_default=True,
    help="Rows of the table.",
)  # fmt: skip
@click.option(
    "--action", shell_complete=actions, metavar="NAME", default="steinway45", show_default=True,
    help="Mechanism to extend.",
)  # fmt: skip
@click.option(
    "--contact",
    metavar="NN",
    help="Write a mechanism in which this contact (such as 06) has the law.",
)
@click.option(
    "--out", "-o", "output", type=FileName(".toml", dir_okay=False), help="TOML file to write."
)
@click.option(
    "--plot", "picture", type=click.Path(dir_okay=False, path_type=Path),
    help="Picture (.png, .pdf or .svg).",
)  # fmt: skip
@json_option
@force_option
def contact_command(
    test: Path,
    zero: float | None,
    thickness: float | None,
    area: float | None,
    reading: dict[str, Any],
    points: int,
    action: str,
    contact: str | None,
    output: Path | None,
    picture: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Contact law from the measured loop in TEST, a CSV with units in its header.

    Columns: "displacement [mm]" (positive in compression), "thickness [mm]" or "strain [%]", and
    "force [N]" or "stress [kPa]", also by their usual names in English, German and French; other
    units, such as in, gf and kgf, are converted. A column that is called compression and starts at
    zero is not shifted. No data of the fibers are needed. The loop is one cycle; the loss of each
    is printed, and the scatter of the complete ones gives the uncertainty of the forces. The table
    is the value of contacts.NN.memory.envelope in a mechanism file. With --contact the output file
    is a complete mechanism.
    """
    from feltmb.felt import read_measured_loop
    from feltmb.felt.plot import plot_measured_loop
    from feltmb.files import write_text

    check_targets(output, pictures=(picture,), force=force)
    known_contact(action, contact)
    found = read_measured_loop(
        test, zero=zero, points=points, thickness0=thickness, area=area, **reading
    )
    made, sure = found.envelope, found.uncertainty
    sign = -1.0 if found.by_thickness else 1.0
    at = sign * found.zero
    span = sorted(sign * end for end in found.zero_interval or ())
    if as_json:
        print_json(
            {
                "zero": at,
                "zero_interval": span or None,
                "cycle": found.branches.chosen,
                "cycles": [asdict(one) for one in found.cycles],
                "largest_compression": made.closing,
                "largest_force": float(made.loading[-1]),
                "loss": made.loss,
                "loss_of_samples": found.loss,
                "uncertainty": {
                    "cycles": sure.cycles,
                    "zero": sure.zero,
                    "loss": sure.loss,
                    "kappa": sure.kappa if math.isfinite(sure.kappa) else None,
                    "loading": sure.loading.tolist(),
                    "unloading": sure.unloading.tolist(),
                    "source": sure.source,
                },
                "memory": dict(found.memory),
                "rms_of_law": found.rms,
                "notes": list(found.notes),
                "envelope": made.table(),
            }
        )
    else:
        print_envelope(made, sure)
        say(f"±: standard uncertainty (68 %), {sure.source}")
        what = "thickness" if found.by_thickness else "displacement"
        given = "given, or zero of a compression"
        if span:
            given = f"95 %: {1e3 * span[0]:.4g} to {1e3 * span[1]:.4g} mm; --zero"
        say(f"{what} at the first contact: {at * 1e3:.4g} mm ({given})")
        say(
            f"loss of the loop: {100 * made.loss:.2f} ± {100 * sure.loss:.2g} % of the loading "
            f"work; of the samples of its cycle: {100 * found.loss:.2f} %"
        )
        if len(found.cycles) > 1:
            _print_cycles(found)
        say(_memory(found))
        say(
            f"difference of law and test: {found.rms:.4g} N rms, "
            f"{100 * found.rms / made.loading[-1]:.2g} % of the largest force"
        )
        for note in found.notes:
            complain(f"warning: {note}")
    if output is not None:
        extended = (action, contact) if contact is not None else (None, None)
        text = made.to_toml(*extended)
        say_written(write_text(output, text, force=force))
    if picture is not None:
        save_figure(plot_measured_loop(found), picture, force=force)
