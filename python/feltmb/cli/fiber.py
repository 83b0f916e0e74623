"""Command group ``feltmb fiber``: structure, contacts, laws, fits, simulation of fiber masses."""

from __future__ import annotations

import csv
import functools
import io
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import (
    complain,
    console,
    force_option,
    new_table,
    save_figure,
    say_written,
    tables_as_json,
)

_EXIT_FAILED = 1
_EXIT_BAD_INPUT = 2


def _guard(command: Callable[..., None]) -> Callable[..., None]:
    """Turn our errors into one message and the exit code that belongs to it."""
    with_json = tables_as_json(command)

    @functools.wraps(with_json)
    def run(*args: Any, **kwargs: Any) -> None:
        from feltmb.errors import FeltmbError, FileExists, InvalidParameter

        try:
            with_json(*args, **kwargs)
        except FeltmbError as error:
            complain(str(error))
            bad_input = isinstance(error, InvalidParameter | FileExists)
            sys.exit(_EXIT_BAD_INPUT if bad_input else _EXIT_FAILED)

    return run


def _table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, words: int = 1
) -> None:
    """Print rows; the first ``words`` columns hold words, the others numbers."""
    table = new_table(title, *columns, right=tuple(range(words, len(columns))))
    for row in rows:
        table.add_row(*row)
    console().print(table)


def _write_text(path: Path, text: str, force: bool) -> None:
    from feltmb.files import write_text

    say_written(write_text(path, text, force=force))


def _refuse_existing(path: Path, force: bool) -> None:
    from feltmb.files import check_writable

    check_writable(path, force=force)


def _numbers(pairs: Sequence[str], what: str) -> dict[str, float]:
    from feltmb.errors import InvalidParameter

    out: dict[str, float] = {}
    faults = []
    for pair in pairs:
        name, equals, value = pair.partition("=")
        try:
            if not equals:
                raise ValueError
            out[name.strip()] = float(value)
        except ValueError:
            faults.append(f'{what}: "{pair}", expected name=number, for example gamma=1.3')
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


def _csv(columns: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([f"{x:.10g}" for x in row])
    return stream.getvalue()


@click.group(name="fiber")
def fiber() -> None:
    """Micromechanics of fiber networks: explore, fit and simulate felt."""


@fiber.command(name="models")
@click.argument("name", required=False)
@_guard
def models_command(name: str | None) -> None:
    """List the laws, or the parameters of law NAME with unit, range and meaning."""
    from feltmb.errors import InvalidParameter
    from feltmb.fiber import history_models, models

    laws = {**models(), **history_models()}
    if name is None:
        _table(
            "Compression laws",
            ["law", "what", "source"],
            [[k, d.title, d.source] for k, d in models().items()],
            words=3,
        )
        _table(
            "Laws with history",
            ["law", "what", "source"],
            [[k, d.title, d.source] for k, d in history_models().items()],
            words=3,
        )
        return
    if name not in laws:
        raise InvalidParameter(f'models: NAME = "{name}", must be one of {", ".join(laws)}')
    law = laws[name]
    click.echo(f"{law.title}\nsource: {law.source}\nvalid: {law.validity}")
    rows = []
    for p in law.parameters:
        default = "v_f0" if p.name == "v_random" and name != "bending_chain" else "required"
        if not math.isnan(p.default):
            default = f"{p.default:.4g}"
        elif p.name == "v_random" and name == "bending_chain":
            default = "isotropic"
        rows.append([p.name, p.unit or "-", default, f"{p.low:.3g} to {p.high:.3g}", p.meaning])
    _table("Parameters", ["name", "unit", "default", "range", "meaning"], rows, words=5)


@fiber.command(name="structure")
@click.argument("ratio", type=float, nargs=-1, required=True)
@click.option(
    "--network",
    "n",
    type=click.IntRange(1, 10_000_000),
    help="Estimate also from a random network of N fibers.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of all that is random.")
@click.option(
    "--spread",
    type=click.IntRange(0, 100_000),
    default=0,
    show_default=True,
    help="Diffusion steps.",
)
@_guard
def structure_command(ratio: tuple[float, ...], n: int | None, seed: int, spread: int) -> None:
    """Structural numbers after uniaxial compression by RATIO = v_f / v_random."""
    from feltmb.fiber import network, structure

    names = ["f", "n3", "e3", "K3", "M3"]
    rows = []
    made = network(n, seed, spread) if n is not None else None
    for r in ratio:
        s = structure(r)
        rows.append([f"{r:g}", *(f"{getattr(s, k):.9f}" for k in names)])
        if made is not None:
            e = made.deform(r).structure()
            rows.append(["  sampled", *(f"{getattr(e, k):.5f}" for k in names)])
            rows.append(["  +-", *(f"{e.error[k]:.5f}" for k in names)])
    _table("Structural numbers [-]", ["R", "f", "<n3^4>", "<e3^4>", "K3", "M3"], rows)


@fiber.command(name="contacts")
@click.option("--v-f", type=float, required=True, help="Volume fraction [-].")
@click.option("--d-f", type=float, default=25e-6, show_default=True, help="Fiber diameter [m].")
@click.option("--ratio", type=float, default=1.0, show_default=True, help="R = v_f/v_random.")
@click.option(
    "--gamma",
    type=float,
    default=math.pi / 2,
    show_default="pi/2",
    help="Blocked length per contact over d_f (binomial).",
)
@click.option(
    "--diameter-cv",
    type=float,
    default=0.0,
    show_default=True,
    help="Coefficient of variation of the diameters.",
)
@click.option("--length", type=float, help="Mean fiber length [m]: also the numbers per fiber.")
@click.option(
    "--length-cv",
    type=float,
    default=0.0,
    show_default=True,
    help="Coefficient of variation of the lengths (gamma distribution).",
)
@_guard
def contacts_command(
    v_f: float,
    d_f: float,
    ratio: float,
    gamma: float,
    diameter_cv: float,
    length: float | None,
    length_cv: float,
) -> None:
    """Mean free length and contacts per volume by every model."""
    from feltmb.fiber import contact_count, contacts_per_volume, mean_free_length

    names: tuple[str, ...] = (
        "van_wyk",
        "van_wyk_tube",
        "komori_makishima",
        "pan",
        "poisson",
        "binomial",
        "toll",
    )
    if diameter_cv != 0:
        names = ("komori_makishima", "poisson", "toll")
    rows = []
    for name in names:
        extra: dict[str, Any] = {"gamma": gamma} if name == "binomial" else {}
        extra["diameter_cv"] = diameter_cv
        free = mean_free_length(name, v_f, d_f, ratio=ratio, **extra)
        number = contacts_per_volume(name, v_f, d_f, ratio=ratio, **extra)
        rows.append([name, f"{free * 1e6:.4f}", f"{free / d_f:.4f}", f"{number * 1e-9:.6g}"])
    _table(
        f"Contacts at v_f = {v_f:g}, d_f = {d_f * 1e6:g} um, R = {ratio:g}",
        ["model", "free length [um]", "over d_f [-]", "contacts [1/mm^3]"],
        rows,
    )
    click.echo("toll counts a contact on both of its fibers (eq. 3.51), the others once.")
    if diameter_cv != 0:
        click.echo("the other models have no distribution of diameters.")
    if length is not None:
        rows = []
        for name in ("poisson", "binomial"):
            extra = {"gamma": gamma} if name == "binomial" else {}
            c = contact_count(name, v_f, d_f, length, ratio=ratio, length_cv=length_cv, **extra)
            rows.append(
                [name, f"{c.mean:.4f}", f"{math.sqrt(c.variance):.4f}", f"{c.probability[0]:.3e}"]
            )
        _table(
            f"Contacts on a fiber of {length * 1e3:g} mm",
            ["model", "mean", "standard deviation", "probability of none"],
            rows,
        )


@fiber.command(name="pressure")
@click.argument("model")
@click.option(
    "--set",
    "-s",
    "given",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter in SI units; repeat. See 'feltmb fiber models MODEL'.",
)
@click.option(
    "--to", "top", type=float, default=0.5, show_default=True, help="Largest volume fraction."
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
@_guard
def pressure_command(
    model: str, given: tuple[str, ...], top: float, points: int, output: Path | None, force: bool
) -> None:
    """Pressure, tangent modulus and stored energy of MODEL against volume fraction."""
    import numpy as np

    from feltmb.errors import InvalidParameter
    from feltmb.fiber import law
    from feltmb.fiber.plot import plot_law

    made = law(model, **_numbers(given, "--set"))
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
        _write_text(output, _csv(columns, rows.tolist()), force)
        return
    _table(
        repr(made),
        ["v_f [-]", "strain [-]", "P [Pa]", "tangent [Pa]", "U [J/m^3 fiber]"],
        [[f"{x:.5g}" for x in row] for row in rows],
    )


@fiber.command(name="tensor")
@click.option("--ratio", type=float, default=1.0, show_default=True, help="R = v_f/v_random.")
@click.option(
    "--deformation",
    "-F",
    help="Instead of --ratio: deformation gradient, 3 stretches or 9 numbers by rows, with commas.",
)
@click.option(
    "--e-modulus",
    "modulus",
    type=float,
    default=2.5e9,
    show_default=True,
    help="Fiber modulus [Pa].",
)
@click.option("--v-f", type=float, required=True, help="Volume fraction [-].")
@_guard
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
    _table(
        "Structure [-]",
        ["f", "<n3^4>", "<e3^4>", "K3", "M3"],
        [[f"{getattr(s, k):.9f}" for k in names]],
    )
    order = ["11", "22", "33", "12", "13", "23"]
    small = 1e-9 * modulus
    _table(
        "Stiffness [Pa]",
        ["", *order],
        [
            [o, *(f"{x:.4g}" if abs(x) > small else "0" for x in row)]
            for o, row in zip(order, t.stiffness, strict=True)
        ],
    )
    _table(
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


@fiber.command(name="granular")
@click.option(
    "--to",
    "last",
    required=True,
    help="Last deformation gradient: 3 stretches or 9 numbers by rows, with commas.",
)
@click.option("--v-random", type=float, required=True, help="Volume fraction when random [-].")
@click.option(
    "--e-modulus",
    "modulus",
    type=float,
    default=2.5e9,
    show_default=True,
    help="Fiber modulus [Pa].",
)
@click.option("--k-b", type=float, default=1.0, show_default=True, help="Bending constant.")
@click.option("--k-t", type=float, default=1.0, show_default=True, help="Torsion constant.")
@click.option("--beta", type=float, default=0.0, show_default=True, help="Crimp ratio.")
@click.option("--transverse", is_flag=True, help="Keep the transverse term of eq. 3.52.")
@click.option(
    "--points", type=click.IntRange(1, 100_000), default=11, show_default=True, help="Rows."
)
@_guard
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
    _table(
        "Cauchy stress [Pa], tension positive",
        ["v_f [-]", "11", "22", "33", "12", "13", "23"],
        [
            [f"{a:.4f}", *(f"{t[k]:.3g}" if abs(t[k]) > small else "0" for k in order)]
            for a, t in zip(v, stress, strict=True)
        ],
    )


@fiber.command(name="arcs")
@click.option(
    "--scheme",
    type=click.Choice(["isotropic", "confined", "simple"]),
    default="confined",
    show_default=True,
    help="Sides: like the height, held, or free of stress.",
)
@click.option(
    "--e-modulus",
    "modulus",
    type=float,
    default=2.5e9,
    show_default=True,
    help="Fiber modulus [Pa].",
)
@click.option("--v-f0", type=float, required=True, help="Volume fraction at rest [-].")
@click.option(
    "--chord-ratio",
    type=float,
    default=1.0,
    show_default=True,
    help="Chord over arc length at rest; 1 straight.",
)
@click.option(
    "--slip-stress", type=float, default=0.0, show_default=True, help="Slip force over d_f^2 [Pa]."
)
@click.option("--to", "top", type=float, default=0.5, show_default=True, help="Largest strain.")
@click.option(
    "--points", type=click.IntRange(1, 100_000), default=11, show_default=True, help="Rows."
)
@_guard
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
    _table(
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
    click.echo("bending, straightening, slipping: stored energy [J per m^3 of fiber], eq. 2.6")


@fiber.command(name="history")
@click.argument("model")
@click.argument("path", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--set",
    "-s",
    "given",
    multiple=True,
    metavar="NAME=VALUE[,VALUE...]",
    help="Parameter in SI units; lists with commas; repeat.",
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
    type=click.Path(dir_okay=False, path_type=Path),
    help="CSV with time, compression and result.",
)
@force_option
@_guard
def history_command(
    model: str, path: Path, given: tuple[str, ...], spring: str, output: Path | None, force: bool
) -> None:
    """Run a law with history over the samples of PATH: CSV with time [s] and compression.

    The second column is "strain [-]" or "compression [m]".
    """
    import numpy as np

    from feltmb.errors import DataError, InvalidParameter
    from feltmb.fiber import history

    params: dict[str, list[float]] = {}
    for pair in given:
        name, _, text = pair.partition("=")
        try:
            params[name.strip()] = [float(x) for x in text.split(",")]
        except ValueError:
            raise InvalidParameter(f'--set: "{pair}", expected name=number[,number...]') from None
    try:
        with path.open(encoding="utf-8-sig") as stream:
            lines = [line for line in stream if line.strip() and not line.startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read ({error}), expected a CSV file") from None
    header = [h.strip() for h in lines[0].split(",")] if lines else []
    if header not in (["time [s]", "strain [-]"], ["time [s]", "compression [m]"]):
        raise DataError(
            f'{path}: header is {header}, expected "time [s],strain [-]" or '
            '"time [s],compression [m]"'
        )
    faults = []
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            t, x = (float(c) for c in line.split(","))
            rows.append((t, x))
        except ValueError:
            faults.append(f'{path}: sample line {number}: "{line.strip()}", expected two numbers')
    if len(rows) < 2 and not faults:
        faults.append(f"{path}: {len(rows)} samples, expected at least 2")
    if faults:
        raise DataError("\n".join(faults))
    time, x = np.array(rows).T
    result = history(model, time, x, spring=spring, **params)
    unit = "stress [Pa]" if header[1].startswith("strain") else "force [N]"
    if output is not None:
        text = _csv([*header, unit], np.column_stack([time, x, result]).tolist())
        _write_text(output, text, force)
    work = float(np.sum(0.5 * (result[1:] + result[:-1]) * np.diff(x)))
    _table(
        f"{model} over {len(time)} samples",
        ["what", "value"],
        [
            [f"largest {unit}", f"{np.max(result):.6g}"],
            [f"at {header[1]}", f"{x[int(np.argmax(result))]:.6g}"],
            ["work not given back", f"{work:.6g} {'J/m^3' if 'strain' in header[1] else 'J'}"],
        ],
    )


def _fit_rows(f: Any) -> list[list[str]]:
    rows = []
    for name in f.free:
        low, high = f.interval[name]
        rows.append(
            [name, f.units[name] or "-", f"{f.values[name]:.6g}", f"{low:.4g}", f"{high:.4g}"]
        )
    for name, value in f.values.items():
        if name not in f.free:
            rows.append([name, f.units.get(name) or "-", f"{value:.6g}", "fixed", ""])
    return rows


def _fit_dictionary(f: Any) -> dict[str, Any]:
    def safe(x: float) -> float | None:
        return x if math.isfinite(x) else None

    return {
        "model": f.model,
        "branch": f.branch,
        "method": f.method,
        "free": list(f.free),
        "values": f.values,
        "units": f.units,
        "level": f.level,
        "interval": {k: [safe(a), safe(b)] for k, (a, b) in f.interval.items()},
        "correlation": f.correlation.tolist(),
        "rmse [Pa]": f.rmse,
        "bic": f.bic,
        "r_squared": f.r_squared,
        "warnings": list(f.warnings),
        "samples": len(f.v_f),
    }


@fiber.command(name="fit")
@click.argument("data", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--model",
    "-m",
    metavar="NAME",
    default="binomial",
    show_default=True,
    help="Law to fit; see models.",
)
@click.option("--all", "every", is_flag=True, help="Fit every law and rank them by BIC.")
@click.option(
    "--branch",
    type=click.Choice(["loading", "unloading", "each", "both"]),
    default="each",
    show_default=True,
    help="each: one fit per branch in the file; both: one fit through both.",
)
@click.option("--free", multiple=True, help="Parameter to identify; repeat. Default by law.")
@click.option("--fix", "-f", multiple=True, metavar="NAME=VALUE", help="Fixed parameter; repeat.")
@click.option("--bound", "-b", multiple=True, metavar="NAME=LOW:HIGH", help="Bounds; repeat.")
@click.option(
    "--method",
    type=click.Choice(["least_squares", "nelder_mead"]),
    default="least_squares",
    show_default=True,
    help="Trust region, or the simplex of the thesis.",
)
@click.option(
    "--starts",
    type=click.IntRange(1, 10_000),
    default=12,
    show_default=True,
    help="Starting points.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of all that is random.")
@click.option("--level", type=float, default=0.95, show_default=True, help="Confidence level.")
@click.option("--v-f0", type=float, help="Volume fraction of zero pressure [-].")
@click.option("--thickness0", type=float, help="Thickness at v_f0 [m].")
@click.option("--area", type=float, help="Sample area [m^2], with force data.")
@click.option(
    "--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture of fit and residuals."
)
@click.option(
    "--out",
    "-o",
    "output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Results as JSON.",
)
@force_option
@_guard
def fit_command(
    data: Path,
    model: str,
    every: bool,
    branch: str,
    free: tuple[str, ...],
    fix: tuple[str, ...],
    bound: tuple[str, ...],
    method: str,
    starts: int,
    seed: int,
    level: float,
    v_f0: float | None,
    thickness0: float | None,
    area: float | None,
    plot: Path | None,
    output: Path | None,
    force: bool,
) -> None:
    """Identify a compression law from DATA, a CSV file with units in its header.

    Columns: v_f [-], strain [-] or thickness [mm]; pressure [kPa] or force [N]; optionally branch.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.fiber import compare, fit, read_compression
    from feltmb.fiber.plot import plot_fits

    for path in (plot, output):
        if path is not None:
            _refuse_existing(path, force)
    test = read_compression(data, v_f0=v_f0, thickness0=thickness0, area=area)
    bounds: dict[str, tuple[float, float]] = {}
    for text in bound:
        name, _, span = text.partition("=")
        try:
            low, high = (float(x) for x in span.split(":"))
        except ValueError:
            raise InvalidParameter(
                f'--bound: "{text}", expected name=low:high, for example gamma=0.5:5'
            ) from None
        bounds[name] = (low, high)
    branches = [branch]
    if branch == "each":
        branches = ["loading"] + (["unloading"] if (~test.loading).sum() >= 5 else [])
    common: dict[str, Any] = {
        "fixed": _numbers(fix, "--fix"),
        "method": method,
        "n_starts": starts,
        "seed": seed,
        "level": level,
    }
    fits = []
    for which in branches:
        if every:
            ranked = compare(test, branch=which, **common)
            best = ranked[0].bic
            _table(
                f"{test.name}, {which}: laws by BIC",
                ["law", "BIC - best", "RMSE [Pa]", "parameters", "warnings"],
                [
                    [
                        f.model,
                        f"{f.bic - best:.2f}",
                        f"{f.rmse:.5g}",
                        " ".join(f"{k}={f.values[k]:.4g}" for k in f.free),
                        str(len(f.warnings)),
                    ]
                    for f in ranked
                ],
            )
            fits += ranked
        else:
            f = fit(test, model, free=free or None, bounds=bounds, branch=which, **common)
            _table(
                f"{test.name}, {which}: {model}, {len(f.v_f)} samples",
                ["parameter", "unit", "value", f"{100 * level:g} % from", "to"],
                _fit_rows(f),
            )
            click.echo(
                f"RMSE {f.rmse:.6g} Pa   R^2 {f.r_squared:.6f}   BIC {f.bic:.2f}   "
                f"{f.n_best} of {f.n_starts} starts agree"
            )
            if len(f.free) > 1:
                _table(
                    "Correlation",
                    ["", *f.free],
                    [
                        [n, *(f"{x:+.4f}" for x in row)]
                        for n, row in zip(f.free, f.correlation, strict=True)
                    ],
                )
            fits.append(f)
    for f in fits:
        for warning in f.warnings:
            click.echo(f"warning: {f.model}, {f.branch}: {warning}")
    if plot is not None:
        save_figure(plot_fits(fits), plot, force=force)
    if output is not None:
        document = {"data": str(data.name), "fits": [_fit_dictionary(f) for f in fits]}
        _write_text(output, json.dumps(document, indent=1) + "\n", force)


@fiber.command(name="simulate")
@click.argument("output", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--fibers",
    type=click.IntRange(1, 100_000),
    default=60,
    show_default=True,
    help="Fibers in the box.",
)
@click.option(
    "--beads",
    type=click.IntRange(2, 10_000),
    default=31,
    show_default=True,
    help="Beads per fiber.",
)
@click.option("--d-f", type=float, default=25e-6, show_default=True, help="Fiber diameter [m].")
@click.option(
    "--segment", type=float, default=62.5e-6, show_default=True, help="Segment length [m]."
)
@click.option("--v-f", type=float, default=0.1, show_default=True, help="First volume fraction.")
@click.option("--v-max", type=float, default=0.3, show_default=True, help="Turning point.")
@click.option(
    "--crimp", type=float, default=0.3, show_default=True, help="Turning angle per bead [rad]."
)
@click.option("--friction", type=float, default=0.35, show_default=True, help="Coefficient [-].")
@click.option(
    "--repulsion",
    type=click.Choice(["hertz", "logarithmic"]),
    default="hertz",
    show_default=True,
    help="Between touching segments: Hertz with friction, or eq. 2.10.",
)
@click.option(
    "--e-modulus",
    "modulus",
    type=float,
    default=2.5e9,
    show_default=True,
    help="Fiber modulus [Pa].",
)
@click.option(
    "--drag",
    type=float,
    default=0.001,
    show_default=True,
    help="Drag rate over the stretching frequency.",
)
@click.option(
    "--strain-per-step", type=float, default=2e-5, show_default=True, help="Halve it to check."
)
@click.option(
    "--cycles",
    type=click.IntRange(1, 100_000),
    default=1,
    show_default=True,
    help="Press and release so often.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of all that is random.")
@click.option(
    "--threads", type=click.IntRange(0, 1024), default=0, show_default=True, help="0: all cores."
)
@click.option("--resume", is_flag=True, help="Go on with OUTPUT, an unfinished run.")
@click.option("--samples", type=int, help="Stop after this many samples; resume later.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture.")
@force_option
@_guard
def simulate_command(
    output: Path,
    fibers: int,
    beads: int,
    d_f: float,
    segment: float,
    v_f: float,
    v_max: float,
    crimp: float,
    friction: float,
    repulsion: str,
    modulus: float,
    drag: float,
    strain_per_step: float,
    cycles: int,
    seed: int,
    threads: int,
    resume: bool,
    samples: int | None,
    plot: Path | None,
    force: bool,
) -> None:
    """Compress and release a box of single fibers; the run goes to OUTPUT (.npz)."""
    from feltmb.errors import InvalidParameter
    from feltmb.fiber import Cycle, FiberBox, FiberRun
    from feltmb.fiber import simulate as run_simulation
    from feltmb.fiber.plot import plot_simulation

    if output.suffix != ".npz":
        raise InvalidParameter(f'{output}: suffix is "{output.suffix}", expected .npz')
    if threads < 0 or seed < 0:
        raise InvalidParameter(f"simulate: threads = {threads}, seed = {seed}, expected >= 0")
    if plot is not None:
        _refuse_existing(plot, force)
    old = None
    if resume:
        old = FiberRun.load(output)
        box, cycle = old.box, old.cycle
    else:
        _refuse_existing(output, force)
        box = FiberBox(
            n_fibers=fibers,
            n_beads=beads,
            d_f=d_f,
            segment_length=segment,
            v_f=v_f,
            crimp=crimp,
            friction=friction,
            repulsion=repulsion,
            E=modulus,
            drag=drag,
            seed=seed,
        )
        sample_every = max(1, round(0.01 / strain_per_step)) if strain_per_step > 0 else 1
        cycle = Cycle(
            v_max=v_max, strain_per_step=strain_per_step, cycles=cycles, sample_every=sample_every
        )
    from rich.progress import Progress

    with Progress(console=console(stderr=True), transient=True) as bar:
        task = bar.add_task("compressing", total=1.0)

        def show(done: float, sample: dict[str, Any]) -> None:
            bar.update(
                task,
                completed=done,
                description=f"v_f {sample['v_f']:.4f} P {sample['pressure']:.4g} Pa",
            )

        run = run_simulation(
            box,
            cycle,
            resume=old,
            threads=threads,
            progress=show,
            checkpoint=output,
            max_samples=samples,
        )
    rows = []
    phase = run.column("phase")
    picks = sorted({int(i) for i in [k * (len(phase) - 1) / 10 for k in range(11)]})
    for i in picks:
        rows.append(
            [
                "loading" if phase[i] == 0 else "unloading",
                *(
                    f"{run.table[k][i]:.3g}"
                    for k in ("v_f", "pressure", "contacts", "work", "friction_loss", "drag_loss")
                ),
            ]
        )
    _table(
        f"{box.n_fibers} fibers, friction {box.friction:g}",
        ["branch", "v_f [-]", "P [Pa]", "contacts", "work [J]", "friction [J]", "drag [J]"],
        rows,
    )
    laid, relaxed = run.laid, run.relaxed
    click.echo(
        f"contacts as laid {laid['crossings']:.0f}, Toll {laid['toll']:.1f} "
        f"+- {math.sqrt(laid['toll']):.1f}; relaxed {relaxed['contacts']:.0f}"
    )
    if run.done:
        low = 0.75 * box.v_f + 0.25 * cycle.v_max
        high = 0.25 * box.v_f + 0.75 * cycle.v_max
        exponents = []
        for bottom in (low, high):
            try:
                exponents.append(f"{run.pressure_exponent(bottom):.2f} above {bottom:.3g}")
            except InvalidParameter:
                exponents.append(f"too few samples above {bottom:.3g}")
        click.echo(
            f"loop loss {100 * run.loop_loss:.2f} %\n"
            f"pressure exponent of loading: {', '.join(exponents)}"
        )
    else:
        click.echo("unfinished; go on with --resume")
    say_written(output)
    if plot is not None:
        save_figure(plot_simulation(run), plot, force=force)


@fiber.command(name="gallery")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--fibers",
    type=int,
    default=6000,
    show_default=True,
    help="Fibers of the sampled network (the thesis uses 6000).",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of all that is random.")
@force_option
@_guard
def gallery_command(folder: Path, fibers: int, seed: int, force: bool) -> None:
    """Draw all pictures of the fiber models into FOLDER."""
    from feltmb.fiber.plot import gallery

    figures = gallery(fibers, seed)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.png" for name in figures]
    for path in paths:
        _refuse_existing(path, force)
    for path, figure in zip(paths, figures.values(), strict=True):
        save_figure(figure, path, force=True)


command = fiber
"""What the main group loads."""
