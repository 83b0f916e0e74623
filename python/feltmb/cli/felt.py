"""Command group ``feltmb felt``: loops of fiber masses, identification, envelopes, audits."""

from __future__ import annotations

import math
from pathlib import Path

import click

from feltmb.cli.common import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    FileName,
    caution,
    check_targets,
    complain,
    console,
    diameter_option,
    force_option,
    modulus_option,
    new_table,
    positive,
    save_figure,
    say,
    say_written,
    tables_as_json,
)
from feltmb.cli.completing import actions, felts
from feltmb.cli.felt_audit import audit_command
from feltmb.cli.felt_contact import contact_command, known_contact, print_envelope
from feltmb.cli.felt_fit import fit_command, identify_command

__all__ = ["command", "felt"]


@click.group(name="felt")
def felt() -> None:
    """Felt: loops with friction, identification, envelopes, audit of laws."""


@felt.command(name="list")
@tables_as_json
def list_command() -> None:
    """List the packaged felts. All of them are synthetic."""
    from feltmb.felt import load_material, packaged_materials

    table = new_table("Felts (synthetic, not measured)", "name", "v_f", "P max [MPa]", "loss",
                      right=(1, 2, 3))  # fmt: skip
    for name in packaged_materials():
        m = load_material(name)
        top = m.pressure("loading", [m.end])[0]
        table.add_row(
            name, f"{m.v_f0:.3f} to {m.end:.2f}", f"{top * 1e-6:.3f}", f"{100 * m.loss():.1f} %"
        )
    console().print(table)


@felt.command(name="show", short_help="Pressures, parts and critical angles of felt MATERIAL.")
@click.argument("material", shell_complete=felts)
@click.option(
    "--points",
    type=click.IntRange(2, 100_000),
    default=9,
    show_default=True,
    help="Rows of the table.",
)
@click.option(
    "--out",
    "-o",
    "output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Picture (.png, .pdf or .svg).",
)
@force_option
@tables_as_json
def show_command(material: str, points: int, output: Path | None, force: bool) -> None:
    """Pressures, parts and critical angles of felt MATERIAL (name or TOML file)."""
    import numpy as np

    from feltmb.felt import load_material
    from feltmb.felt.plot import plot_material

    m = load_material(material)
    v = np.linspace(m.v_f0, m.end, points)
    load, back = m.branch("loading", v), m.branch("unloading", v)
    if m.about:
        say(m.about)
    table = new_table(
        m.name, "v_f [-]", "P load [kPa]", "friction", "angle [deg]", "P unload [kPa]", "friction",
        "angle [deg]", right=tuple(range(7)),
    )  # fmt: skip
    for i, x in enumerate(v):
        table.add_row(
            f"{x:.4f}",
            *(
                text
                for c in (load, back)
                for text in (
                    f"{c.pressure[i] * 1e-3:.5g}",
                    f"{c.friction[i] * 1e-3:.4g}",
                    f"{math.degrees(c.theta_cr[i]):.2f}",
                )
            ),
        )
    console().print(table)
    say(f"loss of the loop: {100 * m.loss():.2f} % of the loading work")
    for text in m.fiber.unusual():
        complain(f"warning: {text}")
    if output is not None:
        save_figure(plot_material(m), output, force=force)


@felt.command(name="loop", short_help="Compress and release a fiber mass with friction.")
@click.option("--v-f0", type=FRACTION, required=True, help="Volume fraction without load [-].")
@click.option(
    "--to", "top", type=FRACTION, required=True, callback=caution("v_f"),
    help="Largest volume fraction [-].",
)  # fmt: skip
@click.option(
    "--mu", type=NOT_NEGATIVE, default=0.35, show_default=True, callback=caution("mu"),
    help="Friction [-].",
)  # fmt: skip
@click.option(
    "--Wf0", "withdrawal", type=positive("N/m"), default=1.0, show_default=True,
    callback=caution("Wf0"), help="Withdrawal force per length [N/m].",
)  # fmt: skip
@modulus_option
@diameter_option
@click.option(
    "--gamma",
    type=POSITIVE,
    default=1.3,
    show_default=True,
    callback=caution("gamma"),
    help="Blocked length per contact over the fiber diameter [-].",
)
@click.option("--k-bend", type=POSITIVE, default=24.0, show_default=True, help="Beam constant [-].")
@click.option(
    "--Q",
    "q",
    type=POSITIVE,
    default=2.0,
    show_default=True,
    help="Constant of thesis eq. 3.15 [-], 2 for random fibers.",
)
@click.option(
    "--form",
    type=click.Choice(["repaired", "printed"]),
    default="repaired",
    show_default=True,
    help="Corrected equations, or the equations as printed in the thesis.",
)
@click.option(
    "--points",
    type=click.IntRange(2, 100_000),
    default=201,
    show_default=True,
    help="Points of each branch.",
)
@click.option(
    "--out", "-o", "output", type=click.Path(dir_okay=False, path_type=Path),
    help="CSV, or .png/.pdf/.svg for a picture.",
)  # fmt: skip
@force_option
@tables_as_json
def loop_command(
    v_f0: float,
    top: float,
    mu: float,
    withdrawal: float,
    modulus: float,
    d_f: float,
    gamma: float,
    k_bend: float,
    q: float,
    form: str,
    points: int,
    output: Path | None,
    force: bool,
) -> None:
    """Compress and release a fiber mass with friction between its fibers."""
    import numpy as np

    from feltmb.errors import InvalidParameter
    from feltmb.felt.plot import plot_loop
    from feltmb.fiber import carnaby_pan
    from feltmb.files import write_text

    if not 0 < v_f0 < top < 1:
        raise InvalidParameter(
            f"loop: --v-f0 = {v_f0:g}, --to = {top:g}; expected 0 < v_f0 < to < 1"
        )
    if output is not None:
        picture = None if output.suffix == ".csv" else output
        check_targets(output if picture is None else None, pictures=(picture,), force=force)
    v = np.linspace(v_f0, top, points)
    made = carnaby_pan(v, mu, withdrawal, modulus, d_f, v_f0, gamma, k_bend, q, form=form)
    if not np.all(np.isfinite(made.P_loading)):
        raise InvalidParameter("loop: these numbers give pressures beyond any; check their units")
    if output is not None and output.suffix != ".csv":
        save_figure(plot_loop(made), output, force=force)
    columns = {
        "v_f [-]": made.v_f,
        "C [N]": made.C,
        "theta_cr [rad]": made.theta_cr,
        "r_sc [-]": made.r_sc,
        "C_s_loading [N]": made.C_s_loading,
        "C_s_unloading [N]": made.C_s_unloading,
        "sigma_el [Pa]": made.sigma_el,
        "P_loading [Pa]": made.P_loading,
        "P_unloading [Pa]": made.P_unloading,
    }
    if output is not None and output.suffix == ".csv":
        rows = [",".join(columns)]
        rows += [
            ",".join(f"{x:.10g}" for x in row) for row in np.column_stack(list(columns.values()))
        ]
        say_written(write_text(output, "\n".join(rows) + "\n", force=force))
    if output is None:
        table = new_table(
            f"Loop of a fiber mass, {form} form", "v_f", "angle [deg]", "slide", "P load [kPa]",
            "P unload [kPa]", right=tuple(range(5)),
        )  # fmt: skip
        for i in np.unique(np.linspace(0, points - 1, min(points, 11)).astype(int)):
            table.add_row(
                f"{made.v_f[i]:.4f}",
                f"{math.degrees(made.theta_cr[i]):.2f}",
                f"{100 * made.r_sc[i]:.1f} %",
                f"{made.P_loading[i] * 1e-3:.5g}",
                f"{made.P_unloading[i] * 1e-3:.5g}",
            )
        console().print(table)
    say(f"loss: {100 * made.loss:.2f} % of the loading work")


@felt.command(name="envelope", short_help="Loop of a contact, force against compression.")
@click.argument("material", shell_complete=felts)
@click.option(
    "--thickness",
    type=positive("m"),
    required=True,
    help="Thickness of the felt without load [m], such as 6mm.",
)
@click.option(
    "--area", required=True, metavar="LAW:NUMBERS",
    help="constant:100mm^2, crossed_cylinders:9mm,0.5mm, circle_on_layer:5mm,10mm (radius, width) "
    "or sphere_on_layer:5mm.",
)  # fmt: skip
@click.option(
    "--columns",
    is_flag=True,
    help="Compute the compression of each column of the felt under the indenter.",
)
@click.option(
    "--largest",
    type=positive("m"),
    help="End of the loop [m], such as 2mm; default: compression at v_f_max.",
)
@click.option(
    "--points",
    type=click.IntRange(5, 100_000),
    default=193,
    show_default=True,
    help="Rows of the loop.",
)
@click.option(
    "--action",
    shell_complete=actions,
    metavar="NAME",
    default="steinway45",
    show_default=True,
    help="Mechanism to extend.",
)
@click.option(
    "--contact",
    metavar="NN",
    help="Write a mechanism in which this contact (such as 06) has the envelope.",
)
@click.option(
    "--out",
    "-o",
    "output",
    type=FileName(".toml", dir_okay=False),
    help="TOML file to write.",
)
@click.option(
    "--plot",
    "picture",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Picture (.png, .pdf or .svg).",
)
@force_option
@tables_as_json
def envelope_command(
    material: str,
    thickness: float,
    area: str,
    columns: bool,
    largest: float | None,
    points: int,
    action: str,
    contact: str | None,
    output: Path | None,
    picture: Path | None,
    force: bool,
) -> None:
    """Compute the loop of a contact, force against compression, from felt MATERIAL.

    The table is the value of contacts.NN.memory.envelope in a mechanism file. With --contact the
    output file is a complete mechanism.
    """
    from feltmb.felt import envelope, load_material, parse_area
    from feltmb.felt.plot import plot_envelope
    from feltmb.files import write_text

    check_targets(output, pictures=(picture,), force=force)
    known_contact(action, contact)
    made = envelope(
        load_material(material),
        thickness,
        parse_area(area),
        compression="columns" if columns else "even",
        largest=largest,
        points=points,
    )
    say(made.about)
    print_envelope(made)
    apart = ""
    if math.isfinite(made.open_loss):
        apart = f"; without closing it at its end by force: {100 * made.open_loss:.2f} %"
    say(f"loss of the loop: {100 * made.loss:.2f} % of the loading work{apart}")
    if output is not None:
        text = made.to_toml(action, contact) if contact is not None else made.to_toml()
        say_written(write_text(output, text, force=force))
    if picture is not None:
        save_figure(plot_envelope(made), picture, force=force)


felt.add_command(identify_command)
felt.add_command(fit_command)
felt.add_command(audit_command)
felt.add_command(contact_command)

command = felt
