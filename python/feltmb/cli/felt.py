"""Command group ``feltmb felt``: loops of fiber masses, identification, envelopes, audits."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    complain,
    console,
    force_option,
    json_option,
    new_table,
    print_json,
    save_figure,
    say_written,
    tables_as_json,
)

if TYPE_CHECKING:
    from feltmb.felt import Audit

__all__ = ["command", "felt"]


def _length(text: str, where: str) -> float:
    from feltmb.errors import InvalidParameter
    from feltmb.quantity import parse_scalar

    try:
        return parse_scalar(text, "m")
    except ValueError as error:
        raise InvalidParameter(f"{where}: {error}") from None


@click.group(name="felt")
def felt() -> None:
    """Felt: loops with friction, identification, envelopes, audit of laws."""


@felt.command(name="list")
@tables_as_json
def list_command() -> None:
    """List the felts that come with feltmb. All of them are synthetic."""
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


@felt.command(name="show")
@click.argument("material")
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
        click.echo(m.about)
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
    click.echo(f"loss of the loop: {100 * m.loss():.2f} % of the loading work")
    if output is not None:
        save_figure(plot_material(m), output, force=force)


@felt.command(name="loop")
@click.option("--v-f0", type=float, required=True, help="Volume fraction without load [-].")
@click.option("--to", "top", type=float, required=True, help="Largest volume fraction [-].")
@click.option("--mu", type=float, default=0.35, show_default=True, help="Friction [-].")
@click.option(
    "--Wf0", "withdrawal", type=float, default=1.0, show_default=True,
    help="Withdrawal force per length [N/m].",
)  # fmt: skip
@click.option("--e-modulus", type=float, default=2.5e9, show_default=True, help="Fiber [Pa].")
@click.option("--d-f", type=float, default=25e-6, show_default=True, help="Fiber diameter [m].")
@click.option(
    "--gamma",
    type=float,
    default=1.3,
    show_default=True,
    help="Blocked length per contact over the fiber diameter [-].",
)
@click.option("--k-bend", type=float, default=24.0, show_default=True, help="Beam constant [-].")
@click.option(
    "--Q",
    "q",
    type=float,
    default=2.0,
    show_default=True,
    help="Constant of thesis eq. 3.15 [-], 2 for random fibers.",
)
@click.option(
    "--form",
    type=click.Choice(["repaired", "printed"]),
    default="repaired",
    show_default=True,
    help="Equations repaired, or as the thesis prints them.",
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
    e_modulus: float,
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
    from feltmb.files import check_writable, write_text

    if not 0 < v_f0 < top < 1:
        raise InvalidParameter(
            f"loop: --v-f0 = {v_f0:g}, --to = {top:g}; expected 0 < v_f0 < to < 1"
        )
    if output is not None:
        check_writable(output, force=force)
    v = np.linspace(v_f0, top, points)
    made = carnaby_pan(v, mu, withdrawal, e_modulus, d_f, v_f0, gamma, k_bend, q, form=form)
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
    click.echo(f"loss: {100 * made.loss:.2f} % of the loading work")


@felt.command(name="identify")
@click.argument("test", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--material", metavar="NAME", required=True, help="Felt (name or TOML) that gives the fibers."
)
@click.option(
    "--out",
    "-o",
    "output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Identified felt, TOML.",
)
@click.option(
    "--plot", "folder", type=click.Path(file_okay=False, path_type=Path),
    help="Folder for the report and its pictures.",
)  # fmt: skip
@click.option("--v-f0", type=float, help="Volume fraction without load [-]; default the felt's.")
@click.option(
    "--thickness", metavar="LENGTH", help="Thickness at v_f0, such as 6mm, for thickness data."
)
@click.option("--area", metavar="AREA", help="Area of the sample, such as 4cm^2, for force data.")
@click.option("--relative", type=float, default=0.0, show_default=True, help="Relative weight [-].")
@click.option("--level", type=float, default=0.95, show_default=True, help="Confidence [-].")
@json_option
@force_option
def identify_command(
    test: Path,
    material: str,
    output: Path | None,
    folder: Path | None,
    v_f0: float | None,
    thickness: str | None,
    area: str | None,
    relative: float,
    level: float,
    as_json: bool,
    force: bool,
) -> None:
    """Identify a felt from the loading-unloading loop in TEST, a CSV with units in its header.

    Columns: one of "v_f [-]", "strain [%]", "thickness [mm]"; one of "pressure [kPa]", "force [N]";
    optionally "branch" with loading and unloading.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.felt import identify, load_material
    from feltmb.felt.plot import plot_identification
    from feltmb.fiber import read_compression
    from feltmb.files import check_writable, write_text
    from feltmb.quantity import parse_scalar

    targets = [] if output is None else [output]
    if folder is not None:
        targets += [folder / "identification.png", folder / "report.md"]
    for path in targets:
        check_writable(path, force=force)
    sample = None
    if area is not None:
        try:
            sample = parse_scalar(area, "m^2")
        except ValueError as error:
            raise InvalidParameter(f"--area: {error}") from None
    base = load_material(material)
    data = read_compression(
        test,
        v_f0=base.v_f0 if v_f0 is None else v_f0,
        thickness0=None if thickness is None else _length(thickness, "--thickness"),
        area=sample,
    )
    name = output.stem if output is not None else test.stem
    result = identify(data, material=base, relative=relative, level=level, name=name)
    if as_json:
        print_json(
            {
                "name": result.name,
                "level": level,
                "loss": result.material.loss(),
                "closing_gap": result.closing_gap,
                "warnings": list(result.warnings),
                "v_f0": result.material.v_f0,
                "v_f_max": result.material.end,
                **{
                    b.which: {
                        "K_p": b.K_p,
                        "gamma": b.gamma,
                        "interval": {k: list(v) for k, v in b.interval.items()},
                        "correlation": b.correlation,
                        "rmse": b.rmse,
                        "r_squared": b.r_squared,
                        "rounds": len(b.rounds),
                    }
                    for b in (result.loading, result.unloading)
                },
            }
        )
    else:
        table = new_table(
            f"Identified from {result.name}, interval of {100 * level:g} %",
            "branch",
            "parameter",
            "value",
            "from",
            "to",
            "R^2",
            right=(2, 3, 4, 5),
        )
        for b in (result.loading, result.unloading):
            for key, title in (("K_p", "K_p [Pa]"), ("gamma", "gamma")):
                fit = f"{b.r_squared:.5f}" if key == "K_p" else ""
                low, high = b.interval[key]
                table.add_row(
                    b.which, title, f"{getattr(b, key):.5g}", f"{low:.5g}", f"{high:.5g}", fit
                )
        console().print(table)
        click.echo(f"loss of the loop: {100 * result.material.loss():.2f} % of the loading work")
        for warning in result.warnings:
            complain(f"warning: {warning}")
    if output is not None:
        say_written(write_text(output, result.material.to_toml(), force=force))
    if folder is not None:
        save_figure(plot_identification(result), folder / "identification.png", force=force)
        text = result.report() + "\n![Identification](identification.png)\n"
        say_written(write_text(folder / "report.md", text, force=force))


@felt.command(name="fit")
@click.argument("contact", metavar="ACTION:CONTACT")
@click.option("--area", required=True, metavar="LAW:NUMBERS", help="As for envelope.")
@click.option(
    "--fibers",
    metavar="NAME",
    required=True,
    help="Felt (name or TOML) that gives fibers and v_f0.",
)
@click.option(
    "--thickness",
    metavar="LENGTH",
    help="Without load, such as 3mm; default: fitted, gamma = pi/2.",
)
@click.option(
    "--friction", type=float, default=0.1, show_default=True,
    help="Share of friction at half the largest force, loading.",
)  # fmt: skip
@click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE",
    help="Change the mechanism first, such as contacts.02.unloading.b=3600. Repeatable.",
)  # fmt: skip
@click.option(
    "--out",
    "-o",
    "output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="TOML file to write.",
)
@json_option
@force_option
def fit_command(
    contact: str,
    area: str,
    fibers: str,
    thickness: str | None,
    friction: float,
    settings: tuple[str, ...],
    output: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Find a felt whose layer has the loop of a contact, such as steinway45:06.

    Force and compression of the contact become pressure and volume fraction by an area and a
    thickness. For a specimen whose pressure was measured use identify.
    """
    from feltmb.felt import audit_targets, contact_loop, fit_contact, load_material, parse_area
    from feltmb.files import check_writable, write_text

    if output is not None:
        check_writable(output, force=force)
    ((name, item),) = audit_targets(contact, settings, all_hint="")
    e, load, back = contact_loop(item, name=name)
    made = fit_contact(
        e,
        load,
        back,
        parse_area(area),
        fibers=load_material(fibers),
        thickness=None if thickness is None else _length(thickness, "--thickness"),
        friction_share=friction,
        name=output.stem if output is not None else name.replace(":", "_"),
        about=f"Felt fitted to the loop of {name}; fibers of {fibers}",
    )
    felt_made = made.material
    assert felt_made.loading is not None
    assert felt_made.unloading is not None
    if as_json:
        print_json(
            {
                "contact": name,
                "thickness": made.thickness,
                "rms_loading": made.rms_loading,
                "rms_unloading": made.rms_unloading,
                "friction_share": made.friction_share,
                "v_f_max": felt_made.end,
                "loading": felt_made.loading.model_dump(),
                "unloading": felt_made.unloading.model_dump(),
                "withdrawal_force": felt_made.fiber.withdrawal_force,
                "warnings": list(made.warnings),
            }
        )
    else:
        table = new_table(
            f"Felt of {name}, {made.thickness * 1e3:.4g} mm thick", "branch", "K_p [Pa]", "gamma",
            "left over", right=(1, 2, 3),
        )  # fmt: skip
        for which, branch, rms in (
            ("loading", felt_made.loading, made.rms_loading),
            ("unloading", felt_made.unloading, made.rms_unloading),
        ):
            table.add_row(which, f"{branch.K_p:.5g}", f"{branch.gamma:.4g}", f"{100 * rms:.2f} %")
        console().print(table)
        click.echo(
            f"withdrawal force {felt_made.fiber.withdrawal_force:.4g} N/m, friction "
            f"{100 * made.friction_share:.3g} % of the pressure at half the largest force"
        )
        for warning in made.warnings:
            complain(f"warning: {warning}")
    if output is not None:
        say_written(write_text(output, felt_made.to_toml(), force=force))


@felt.command(name="envelope")
@click.argument("material")
@click.option(
    "--thickness", metavar="LENGTH", required=True, help="Of the felt without load, such as 6mm."
)
@click.option(
    "--area", required=True, metavar="LAW:NUMBERS",
    help="constant:100mm^2, crossed_cylinders:9mm,0.5mm, circle_on_layer:5mm,10mm (radius, width) "
    "or sphere_on_layer:5mm.",
)  # fmt: skip
@click.option(
    "--columns", is_flag=True, help="Compress each column of the felt by what the indenter leaves."
)
@click.option(
    "--largest",
    metavar="LENGTH",
    help="End of the loop, such as 2mm; default where v_f_max is reached.",
)
@click.option(
    "--points",
    type=click.IntRange(5, 100_000),
    default=193,
    show_default=True,
    help="Rows of the loop.",
)
@click.option(
    "--action", metavar="NAME", default="steinway45", show_default=True, help="Mechanism to extend."
)
@click.option(
    "--contact",
    metavar="NN",
    help="Write a mechanism whose contact (such as 06) has this envelope.",
)
@click.option(
    "--out",
    "-o",
    "output",
    type=click.Path(dir_okay=False, path_type=Path),
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
    thickness: str,
    area: str,
    columns: bool,
    largest: str | None,
    points: int,
    action: str,
    contact: str | None,
    output: Path | None,
    picture: Path | None,
    force: bool,
) -> None:
    """Loop of a contact, force against compression, from felt MATERIAL.

    The table is the value of contacts.NN.memory.envelope in a mechanism file; with --contact the
    file is a mechanism that can be used at once.
    """
    from feltmb.config import load_action
    from feltmb.errors import InvalidParameter
    from feltmb.felt import envelope, load_material, parse_area
    from feltmb.felt.plot import plot_envelope
    from feltmb.files import check_writable, write_text

    for path in (output, picture):
        if path is not None:
            check_writable(path, force=force)
    if contact is not None:
        known = load_action(action).config.contacts
        if contact not in known:
            raise InvalidParameter(
                f"--contact: got {contact!r}, expected one of {', '.join(known)} of {action}"
            )
    made = envelope(
        load_material(material),
        _length(thickness, "--thickness"),
        parse_area(area),
        compression="columns" if columns else "even",
        largest=None if largest is None else _length(largest, "--largest"),
        points=points,
    )
    click.echo(made.about)
    table = new_table(
        "Envelope", "compression [mm]", "loading [N]", "unloading [N]", right=(0, 1, 2)
    )
    for share in (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0):
        x = share * made.closing
        table.add_row(
            f"{x * 1e3:.4g}",
            f"{float(made.core.loading(x)):.5g}",
            f"{float(made.core.unloading(x, made.closing)):.5g}",
        )
    console().print(table)
    click.echo(f"loss of the loop: {100 * made.loss:.2f} % of the loading work")
    if output is not None:
        text = made.to_toml(action, contact) if contact is not None else made.to_toml()
        say_written(write_text(output, text, force=force))
    if picture is not None:
        save_figure(plot_envelope(made), picture, force=force)


def _print_audit(result: Audit) -> None:
    click.echo(f"{result.name}: {result.about or result.law} (law {result.law})")
    if result.closing is not None:
        click.echo(f"  loop ends at {result.closing * 1e3:.4g} mm")
    if result.window is None:
        click.echo("  valid window: none")
    else:
        click.echo(
            f"  valid window: {result.window[0] * 1e3:.4g} to {result.window[1] * 1e3:.4g} mm"
        )
    for branch, (low, high) in result.stiffness_range.items():
        click.echo(f"  tangent stiffness, {branch}: {low * 1e-3:.4g} to {high * 1e-3:.4g} N/mm")
    for f in result.findings:
        click.echo(f"  {f.kind}: {f.text}")
    if not result.findings:
        click.echo("  no faults")
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


@felt.command(name="audit")
@click.argument("law")
@click.option("--all", "everything", is_flag=True, help="All contacts of mechanism LAW.")
@click.option(
    "--set", "settings", multiple=True, metavar="PATH=VALUE",
    help="Change the mechanism first, such as contacts.*.law=printed. Repeatable.",
)  # fmt: skip
@click.option(
    "--largest", metavar="LENGTH", help="End of the audit of a law without a loop, such as 1mm."
)
@click.option(
    "--plot",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for a picture of each.",
)
@json_option
@force_option
def audit_command(
    law: str,
    everything: bool,
    settings: tuple[str, ...],
    largest: str | None,
    folder: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Audit LAW: a contact (steinway45:04), a felt, an envelope, or --all contacts of a mechanism.

    Valid window, crossing, adhesion, made energy, loss against amplitude and frequency, stiffness.
    """
    from feltmb.felt import audit, audit_targets
    from feltmb.felt.plot import plot_audit
    from feltmb.files import check_writable

    targets = audit_targets(law, settings, everything=everything)
    end = None if largest is None else _length(largest, "--largest")

    def picture(name: str) -> Path:
        assert folder is not None
        return folder / f"audit_{Path(name).stem.replace(':', '_')}.png"

    if folder is not None:
        for name, _ in targets:
            check_writable(picture(name), force=force)
    results = [audit(item, name=name, largest=end) for name, item in targets]
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
                click.echo(f"{r.name.partition(':')[2] or r.name} {f.kind}: {f.text}")
    if folder is not None:
        for r in results:
            save_figure(plot_audit(r), picture(r.name), force=force)


command = felt
