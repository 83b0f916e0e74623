"""``feltmb fiber fit``: constants of a law from a compression test."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import FRACTION, POSITIVE, FileName, force_option, save_figure
from feltmb.cli.completing import fiber_laws
from feltmb.cli.fiber.group import (
    fiber,
    guard,
    numbers,
    print_table,
    refuse_existing,
    seed_option,
    write_named,
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


@fiber.command(name="fit", short_help="Identify a compression law from the CSV file DATA.")
@click.argument("data", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--model",
    "-m",
    shell_complete=fiber_laws,
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
@seed_option
@click.option("--level", type=FRACTION, default=0.95, show_default=True, help="Confidence level.")
@click.option("--v-f0", type=FRACTION, help="Volume fraction of zero pressure [-].")
@click.option("--thickness0", type=POSITIVE, help="Thickness at v_f0 [m].")
@click.option("--area", type=POSITIVE, help="Sample area [m^2], with force data.")
@click.option(
    "--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture of fit and residuals."
)
@click.option(
    "--out",
    "-o",
    "output",
    type=FileName(".json", dir_okay=False),
    help="Results as JSON.",
)
@force_option
@guard
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
            refuse_existing(path, force)
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
        "fixed": numbers(fix, "--fix"),
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
            print_table(
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
            print_table(
                f"{test.name}, {which}: {model}, {len(f.v_f)} samples",
                ["parameter", "unit", "value", f"{100 * level:g} % from", "to"],
                _fit_rows(f),
            )
            click.echo(
                f"RMSE {f.rmse:.6g} Pa   R^2 {f.r_squared:.6f}   BIC {f.bic:.2f}   "
                f"{f.n_best} of {f.n_starts} starts agree"
            )
            if len(f.free) > 1:
                print_table(
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
        write_named(output, json.dumps(document, indent=1) + "\n", force)
