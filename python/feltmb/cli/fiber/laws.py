"""``feltmb fiber pressure, tensor, granular, arcs, history``: laws of compression."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    FileName,
    Number,
    Quantity,
    complain,
    force_option,
    list_option,
    modulus_option,
    save_figure,
    say,
)
from feltmb.cli.completing import fiber_laws
from feltmb.cli.fiber.group import (
    csv_text,
    fiber,
    guard,
    numbers,
    parameter_units,
    print_table,
    quantities,
    write_named,
)


@fiber.command(name="pressure", short_help="Pressure, modulus and energy against volume fraction.")
@click.argument("model", shell_complete=fiber_laws)
@list_option(
    "--set",
    "-s",
    "given",
    metavar="NAME=VALUE",
    help="Parameter, such as E=2.5GPa, else in SI units; see 'feltmb fiber models MODEL'.",
)
@click.option(
    "--to", "top", type=FRACTION, default=0.5, show_default=True, help="Largest volume fraction."
)
@click.option(
    "--points", type=click.IntRange(1, 100_000), default=11, show_default=True, help="Rows."
)
@click.option(
    "--out",
    "-o",
    "output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="CSV, or .png/.pdf/.svg for a picture.",
)
@force_option
@guard
def pressure_command(
    model: str, given: tuple[str, ...], top: float, points: int, output: Path | None, force: bool
) -> None:
    """Pressure, tangent modulus and stored energy of MODEL against volume fraction."""
    import numpy as np

    from feltmb.errors import InvalidParameter
    from feltmb.fiber import law, models, unusual
    from feltmb.fiber.plot import plot_law
    from feltmb.fiber.ranges import RANGES

    known = models()
    if model not in known:
        law(model)  # the message has the known laws
    parameters = numbers(given, "--set", parameter_units(known[model]))
    for text in unusual(**{k: v for k, v in parameters.items() if k in RANGES}):
        complain(f"warning: {text}")
    made = law(model, **parameters)
    if points < 2 or not top > made.v_f0:
        raise InvalidParameter(
            f"pressure: --points = {points}, --to = {top:.6g}; expected at least 2 points and "
            f"--to above v_f0 = {made.v_f0:.6g}"
        )
    v = np.linspace(made.v_f0, min(top, 1.0, made.limit * 0.999), points)
    p, t, u = made.pressure(v), v * made.slope(v), made.energy(v)
    if output is not None and output.suffix != ".csv":
        save_figure(plot_law(made, float(v[-1])), output, force=force)
        return
    columns = [
        "v_f [-]",
        "strain [-]",
        "pressure [Pa]",
        "tangent_modulus [Pa]",
        "energy_per_fiber_volume [J/m^3]",
    ]
    rows = np.column_stack([v, 1 - made.v_f0 / v, p, t, u])
    if output is not None:
        write_named(output, csv_text(columns, rows.tolist()), force)
        return
    print_table(
        repr(made),
        ["v_f [-]", "strain [-]", "P [Pa]", "tangent [Pa]", "U [J/m^3 fiber]"],
        [[f"{x:.5g}" for x in row] for row in rows],
    )


@fiber.command(name="tensor", short_help="Structure and stiffness of a bonded network (Narter).")
@click.option("--ratio", type=POSITIVE, default=1.0, show_default=True, help="R = v_f/v_random.")
@click.option(
    "--deformation",
    "-F",
    help="Instead of --ratio: deformation gradient, 3 stretches or 9 numbers by rows, with commas.",
)
@modulus_option
@click.option("--v-f", type=FRACTION, required=True, help="Volume fraction [-].")
@guard
def tensor_command(ratio: float, deformation: str | None, modulus: float, v_f: float) -> None:
    """Structure, stiffness and engineering moduli of a bonded network (Narter)."""
    from feltmb.fiber import density_structure, narter_tensors, structure, uniaxial_tensor

    if deformation is None:
        s: Any = structure(ratio)
        eeee = uniaxial_tensor(ratio)
    else:
        s = density_structure(deformation=_gradient(deformation), max_nodes=200)
        eeee = s.eeee
    t = narter_tensors(eeee, modulus, v_f)
    names = ["f", "n3", "e3", "K3", "M3"]
    print_table(
        "Structure [-]",
        ["f", "<n3^4>", "<e3^4>", "K3", "M3"],
        [[f"{getattr(s, k):.9f}" for k in names]],
    )
    order = ["11", "22", "33", "12", "13", "23"]
    small = 1e-9 * modulus
    print_table(
        "Stiffness [Pa]",
        ["", *order],
        [
            [o, *(f"{x:.4g}" if abs(x) > small else "0" for x in row)]
            for o, row in zip(order, t.stiffness, strict=True)
        ],
    )
    print_table(
        "Moduli",
        ["", "1 / 12", "2 / 13", "3 / 23"],
        [
            ["Young's E1 E2 E3 [Pa]", *(f"{x:.6g}" for x in t.young)],
            ["shear G12 G13 G23 [Pa]", *(f"{x:.6g}" for x in t.shear)],
            [
                "Poisson nu12 nu13 nu23 [-]",
                *(f"{t.poisson[k]:.6g}" for k in ("nu12", "nu13", "nu23")),
            ],
        ],
    )


def _gradient(text: str) -> Any:
    import numpy as np

    from feltmb.errors import InvalidParameter

    try:
        numbers = [float(x) for x in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) == 3:
        return np.diag(numbers)
    if len(numbers) == 9:
        return np.array(numbers).reshape(3, 3)
    raise InvalidParameter(
        f'deformation: "{text}", expected 3 stretches or 9 numbers by rows, for example 1,1,0.5'
    )


@fiber.command(name="granular", short_help="Stress of the granular rate theory on a straight path.")
@click.option(
    "--to",
    "last",
    required=True,
    help="Last deformation gradient: 3 stretches or 9 numbers by rows, with commas.",
)
@click.option(
    "--v-random", type=FRACTION, required=True, help="Volume fraction of the random network [-]."
)
@modulus_option
@click.option("--k-b", type=NOT_NEGATIVE, default=1.0, show_default=True, help="Bending constant.")
@click.option("--k-t", type=NOT_NEGATIVE, default=1.0, show_default=True, help="Torsion constant.")
@click.option("--beta", type=NOT_NEGATIVE, default=0.0, show_default=True, help="Crimp ratio.")
@click.option("--transverse", is_flag=True, help="Keep the transverse term of eq. 3.52.")
@click.option(
    "--points", type=click.IntRange(1, 100_000), default=11, show_default=True, help="Rows."
)
@guard
def granular_command(
    last: str,
    v_random: float,
    modulus: float,
    k_b: float,
    k_t: float,
    beta: float,
    transverse: bool,
    points: int,
) -> None:
    """Stress of the granular rate theory on a straight path from F = I to --to (tensor form)."""
    import numpy as np

    from feltmb.errors import InvalidParameter
    from feltmb.fiber import granular_stress

    if not 2 <= points <= 1000:
        raise InvalidParameter(f"granular: --points = {points}, must be between 2 and 1000")
    share = np.linspace(0, 1, points)[:, None, None]
    path = np.eye(3) * (1 - share) + share * _gradient(last)
    stress = granular_stress(
        path,
        v_random=v_random,
        E=modulus,
        k_b=k_b,
        k_t=k_t,
        beta=beta,
        transverse=transverse,
        substeps=12,
    )
    v = v_random / np.linalg.det(path)
    small = 1e-9 * float(np.max(np.abs(stress)))
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    print_table(
        "Cauchy stress [Pa], tension positive",
        ["v_f [-]", "11", "22", "33", "12", "13", "23"],
        [
            [f"{a:.4f}", *(f"{t[k]:.3g}" if abs(t[k]) > small else "0" for k in order)]
            for a, t in zip(v, stress, strict=True)
        ],
    )


@fiber.command(name="arcs", short_help="Energy method of Komori-Itoh and Lee-Carnaby.")
@click.option(
    "--scheme",
    type=click.Choice(["isotropic", "confined", "simple"]),
    default="confined",
    show_default=True,
    help="Lateral strain: equal to that of the height, zero, or free of stress.",
)
@modulus_option
@click.option("--v-f0", type=FRACTION, required=True, help="Volume fraction at rest [-].")
@click.option(
    "--chord-ratio",
    type=Number(0.05, 1),
    default=1.0,
    show_default=True,
    help="Chord over arc length at rest; 1 straight.",
)
@click.option(
    "--slip-stress",
    type=Quantity("Pa", 0),
    default=0.0,
    show_default=True,
    help="Slip force over d_f^2 [Pa].",
)
@click.option("--to", "top", type=FRACTION, default=0.5, show_default=True, help="Largest strain.")
@click.option(
    "--points", type=click.IntRange(1, 100_000), default=11, show_default=True, help="Rows."
)
@guard
def arcs_command(
    scheme: str,
    modulus: float,
    v_f0: float,
    chord_ratio: float,
    slip_stress: float,
    top: float,
    points: int,
) -> None:
    """Energy method of Komori-Itoh and Lee-Carnaby: segments bent to arcs."""
    import numpy as np

    from feltmb.fiber import compress_arcs

    c = compress_arcs(
        np.linspace(0, top, max(points, 2)),
        E=modulus,
        v_f0=v_f0,
        scheme=scheme,
        chord_ratio=chord_ratio,
        slip_stress=slip_stress,
    )
    print_table(
        f"Arcs, {scheme} compression",
        ["strain [-]", "v_f [-]", "P [Pa]", "bending", "straight.", "slipping", "lateral [-]"],
        [
            [f"{a:.4g}", f"{b:.4g}", f"{p:.5g}", f"{x:.4g}", f"{y:.4g}", f"{z:.4g}", f"{q:.5g}"]
            for a, b, p, x, y, z, q in zip(
                c.strain,
                c.v_f,
                c.pressure,
                c.bending,
                c.straightening,
                c.slipping,
                c.lateral_stretch,
                strict=True,
            )
        ],
    )
    say("bending, straightening, slipping: stored energy [J per m^3 of fiber], eq. 2.6")


@fiber.command(name="history", short_help="Run a law with history over the samples of PATH.")
@click.argument("model", shell_complete=fiber_laws)
@click.argument("path", type=click.Path(dir_okay=False, path_type=Path))
@list_option(
    "--set",
    "-s",
    "given",
    metavar="NAME=VALUE[,VALUE...]",
    help="Parameter, such as E=2.5GPa, else in SI units; its value may be a list.",
)
@click.option(
    "--spring",
    default="van_wyk",
    show_default=True,
    help="Compression law of the springs (dunlop, stamm_kelvin).",
)
@click.option(
    "--out",
    "-o",
    "output",
    type=FileName(".csv", dir_okay=False),
    help="CSV with time, compression and result.",
)
@force_option
@guard
def history_command(
    model: str, path: Path, given: tuple[str, ...], spring: str, output: Path | None, force: bool
) -> None:
    """Run a law with history over the samples of PATH, a file with time and compression.

    Its columns are "time [s]" and "strain [-]" or "compression [m]".
    """
    import numpy as np

    from feltmb.data.columns import read_columns
    from feltmb.data.mapping import clock_column, values_in
    from feltmb.errors import DataError, InvalidParameter
    from feltmb.fiber import history, history_models, models
    from feltmb.units.quantity import fault_text

    laws = {**models(), **history_models()}
    for what, name in (("MODEL", model), ("--spring", spring)):
        if name not in laws:
            raise InvalidParameter(f'history: {what} = "{name}", must be one of {", ".join(laws)}')
    units = parameter_units(laws[spring], laws[model])
    params = quantities(given, "--set", units, separator=",")
    columns = read_columns(path, strict=False)
    faults: list[str] = []
    clock = clock_column(columns, guess=False)
    strain = columns.called("strain")
    column = next(iter([*strain, *columns.called("displacement")]), "")
    if not clock or not column:
        faults.append(
            f"expected the columns time [s] and strain [-] or compression [m]; there are {columns}"
        )
    wanted = ((clock, "s"), (column, "1" if strain else "m"))
    series = [values_in(columns, name, si, faults) for name, si in wanted if name]
    faults += columns.faults([c for c in (clock, column) if c], complete=True)
    if faults:
        raise DataError(fault_text(str(path), faults, most=20))
    time, x = series
    if strain and np.max(x) >= 1.0:
        i = int(np.argmax(x >= 1.0))
        raise DataError(
            f"{path}: {columns.place(i)}: strain {x[i]:g}, expected < 1 (compression positive): "
            "at 1 nothing is left of the thickness"
        )
    headings = ("time [s]", "strain [-]" if strain else "compression [m]")
    result = history(model, time, x, spring=spring, **params)
    unit = "stress [Pa]" if strain else "force [N]"
    if output is not None:
        table = csv_text([*headings, unit], np.column_stack([time, x, result]).tolist())
        write_named(output, table, force)
    work = float(np.sum(0.5 * (result[1:] + result[:-1]) * np.diff(x)))
    print_table(
        f"{model} over {len(time)} samples",
        ["what", "value"],
        [
            [f"largest {unit}", f"{np.max(result):.6g}"],
            [f"at {headings[1]}", f"{x[int(np.argmax(result))]:.6g}"],
            ["work not given back", f"{work:.6g} {'J/m^3' if strain else 'J'}"],
        ],
    )
