"""``feltmb felt identify`` and ``feltmb felt fit``: felts from measured loops."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import (
    FRACTION,
    FileName,
    FolderName,
    Number,
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
    set_option,
    zero_option,
)
from feltmb.cli.completing import actions, felts
from feltmb.cli.gap_reading import test_options

__all__ = ["fit_command", "identify_command"]


def _number(value: float) -> float | None:
    """A number for JSON; None: there is none."""
    return value if math.isfinite(value) else None


@click.command(name="identify", short_help="Identify a felt from the measured loop in TEST.")
@click.argument("test", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--material",
    shell_complete=felts,
    metavar="NAME",
    required=True,
    help="Felt (name or TOML file) whose fiber data are used.",
)
@click.option(
    "--out",
    "-o",
    "output",
    type=FileName(".toml", dir_okay=False),
    help="Identified felt, TOML.",
)
@click.option(
    "--plot", "folder", type=FolderName(file_okay=False),
    help="Folder for the report and its pictures.",
)  # fmt: skip
@click.option(
    "--v-f0", type=FRACTION, help="Volume fraction without load [-]; default: that of the felt."
)
@click.option(
    "--thickness",
    type=positive("m"),
    help="Thickness without load [m], such as 6mm, for thickness data; default: estimated.",
)
@click.option(
    "--area", type=positive("m^2"), help="Area of the sample [m^2], such as 4cm2, for force data."
)
@zero_option
@test_options
@click.option(
    "--relative",
    type=Number(0.0, 1e3),
    default=0.0,
    show_default=True,
    help="Factor r of the weight 1/(1 + r P/P_max) of a sample [-]; 0: equal weights.",
)
@click.option("--level", type=FRACTION, default=0.95, show_default=True, help="Confidence [-].")
@json_option
@force_option
def identify_command(
    test: Path,
    material: str,
    output: Path | None,
    folder: Path | None,
    v_f0: float | None,
    thickness: float | None,
    area: float | None,
    zero: float | None,
    reading: dict[str, Any],
    relative: float,
    level: float,
    as_json: bool,
    force: bool,
) -> None:
    """Identify a felt from the loading-unloading loop in TEST, a CSV with units in its header.

    Columns: one of "v_f [-]", "strain [%]", "thickness [mm]", "displacement [mm]"; one of
    "pressure [kPa]", "force [N]"; optionally "branch" with loading and unloading.
    """
    from feltmb.felt import identify, load_material
    from feltmb.felt.plot import plot_identification
    from feltmb.fiber import read_compression
    from feltmb.files import make_folder, write_text

    report = None if folder is None else make_folder(folder) / "report.md"
    picture = None if folder is None else folder / "identification.png"
    check_targets(output, report, pictures=(picture,), force=force)
    base = load_material(material)
    data = read_compression(
        test,
        v_f0=base.v_f0 if v_f0 is None else v_f0,
        thickness0=thickness,
        area=area,
        zero=zero,
        **reading,
    )
    name = output.stem if output is not None else test.stem
    result = identify(data, material=base, relative=relative, level=level, name=name)
    if as_json:
        print_json(
            {
                "name": result.name,
                "level": level,
                "loss": result.material.loss(),
                "measured_loss": _number(result.measured_loss),
                "closing_gap": result.closing_gap,
                "warnings": list(result.warnings),
                "thickness": result.thickness,
                "thickness_interval": result.thickness_interval,
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
        if result.thickness is not None:
            span = result.thickness_interval
            ends = ("given", "") if span is None else [f"{1e3 * x:.5g}" for x in span]
            table.add_row("both", "thickness [mm]", f"{1e3 * result.thickness:.5g}", *ends)
        console().print(table)
        if v_f0 is None:
            say(f"v_f0 = {base.v_f0:g}, that of {material} (--v-f0)")
        measured = _number(result.measured_loss)
        told = "" if measured is None else f"; of the samples: {100 * measured:.2f} %"
        say(f"loss of the loop: {100 * result.material.loss():.2f} % of the loading work{told}")
        for warning in result.warnings:
            complain(f"warning: {warning}")
    if output is not None:
        say_written(write_text(output, result.material.to_toml(), force=force))
    if folder is not None:
        save_figure(plot_identification(result), folder / "identification.png", force=force)
        text = result.report() + "\n![Identification](identification.png)\n"
        say_written(write_text(folder / "report.md", text, force=force))


@click.command(name="fit", short_help="Find a felt whose layer has the loop of ACTION:CONTACT.")
@click.argument("contact", metavar="ACTION:CONTACT", shell_complete=actions)
@click.option(
    "--area",
    required=True,
    metavar="LAW:NUMBERS",
    help="Area of the contact, as in `felt envelope`.",
)
@click.option(
    "--fibers",
    shell_complete=felts,
    metavar="NAME",
    required=True,
    help="Felt (name or TOML file) whose fiber data and v_f0 are used.",
)
@click.option(
    "--thickness",
    type=positive("m"),
    help="Thickness without load [m], such as 3mm; default: fitted with gamma = pi/2.",
)
@click.option(
    "--friction", type=Number(0, 1, max_open=True), default=0.1, show_default=True,
    help="Share of friction at half the largest force, loading.",
)  # fmt: skip
@set_option
@click.option(
    "--out",
    "-o",
    "output",
    type=FileName(".toml", dir_okay=False),
    help="TOML file to write.",
)
@json_option
@force_option
def fit_command(
    contact: str,
    area: str,
    fibers: str,
    thickness: float | None,
    friction: float,
    settings: tuple[str, ...],
    output: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Find a felt whose layer has the loop of a contact, such as steinway45:06.

    Area and thickness convert force and compression of the contact to pressure and volume fraction.
    For a specimen with measured pressure use identify.
    """
    from feltmb.felt import audit_targets, contact_loop, fit_contact, load_material, parse_area
    from feltmb.files import write_text

    check_targets(output, force=force)
    ((name, item),) = audit_targets(contact, settings, all_hint="", tell=complain)
    e, load, back = contact_loop(item, name=name)
    made = fit_contact(
        e,
        load,
        back,
        parse_area(area),
        fibers=load_material(fibers),
        thickness=thickness,
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
        say(
            f"withdrawal force {felt_made.fiber.withdrawal_force:.4g} N/m, friction "
            f"{100 * made.friction_share:.3g} % of the pressure at half the largest force"
        )
        for warning in made.warnings:
            complain(f"warning: {warning}")
    if output is not None:
        say_written(write_text(output, felt_made.to_toml(), force=force))
