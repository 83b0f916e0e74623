"""``feltmb fiber fit``: constants of a law from a compression test."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import (
    FRACTION,
    FileName,
    force_option,
    list_option,
    positive,
    save_figure,
    say,
    zero_option,
)
from feltmb.cli.completing import fiber_laws
from feltmb.cli.fiber.group import (
    fiber,
    guard,
    numbers,
    parameter_units,
    print_table,
    quantities,
    refuse_existing,
    seed_option,
    write_named,
)
from feltmb.cli.gap_reading import test_options


def _fit_rows(f: Any) -> list[list[str]]:
    rows = []
    for name in f.free:
        low, high = f.interval[name]
        ends = [f"{low:.4g}", f"{high:.4g}"]
        if name in f.undetermined:
            ends = ["undetermined", ""]
        rows.append([name, f.units[name] or "-", f"{f.values[name]:.6g}", *ends])
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
        "undetermined": list(f.undetermined),
        "at_bound": list(f.at_bound),
        "reference": f.reference,
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
@list_option("--free", metavar="NAME", help="Parameter to identify. Default by law.")
@list_option("--fix", "-f", metavar="NAME=VALUE", help="Fixed parameter, such as E=2.5GPa.")
@list_option("--bound", "-b", metavar="NAME=LOW:HIGH", help="Bounds of a parameter.")
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
@click.option(
    "--v-f0",
    type=FRACTION,
    help="Volume fraction of zero pressure [-]; default: estimated from v_f data.",
)
@click.option(
    "--thickness0",
    "--thickness",
    "thickness0",
    type=positive("m"),
    help="Thickness at v_f0, without load [m]; default: estimated from thickness data.",
)
@click.option("--area", type=positive("m^2"), help="Sample area [m^2], with force data.")
@zero_option
@test_options
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
    zero: float | None,
    reading: dict[str, Any],
    plot: Path | None,
    output: Path | None,
    force: bool,
) -> None:
    """Identify a compression law from DATA, a CSV file with units in its header.

    Columns: v_f [-], strain [-], thickness or displacement [mm]; pressure [kPa] or force [N];
    optionally branch.
    """
    from feltmb.errors import InvalidParameter, ModelError
    from feltmb.fiber import compare, fit_branches, models, read_compression
    from feltmb.fiber.plot import plot_fits

    for path in (plot, output):
        if path is not None:
            refuse_existing(path, force)
    test = read_compression(data, v_f0=v_f0, thickness0=thickness0, area=area, zero=zero, **reading)
    known = models()
    if model not in known:
        raise InvalidParameter(f'--model = "{model}", must be one of {", ".join(known)}')
    units = parameter_units(*(known.values() if every else [known[model]]))
    bounds: dict[str, tuple[float, float]] = {}
    for name, span in quantities(bound, "--bound", units, separator=":").items():
        if len(span) != 2:
            raise InvalidParameter(
                f"--bound: {name}: got {len(span)} values, expected name=low:high, for example "
                "gamma=0.5:5"
            )
        bounds[name] = (span[0], span[1])
    branches = [branch]
    if branch == "each":
        branches = ["loading"] + (["unloading"] if (~test.loading).sum() >= 5 else [])
    common: dict[str, Any] = {
        "fixed": numbers(fix, "--fix", units),
        "method": method,
        "n_starts": starts,
        "seed": seed,
        "level": level,
    }
    if every:
        both = len(branches) > 1
        fits = compare(test, branch="each" if both else branches[0], **common)
    else:
        fits = fit_branches(
            test, model, branches=branches, free=free or None, bounds=bounds, **common
        )
    if test.thickness0 is not None:
        say(f"unloaded thickness: {test.thickness0 * 1e3:.6g} mm, as given; all values rest on it")
    for which in branches:
        here = [f for f in fits if f.branch == which]
        if every:
            best = here[0].bic
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
                    for f in here
                ],
            )
            continue
        f = here[0]
        print_table(
            f"{test.name}, {which}: {model}, {len(f.v_f)} samples",
            ["parameter", "unit", "value", f"{100 * level:g} % from", "to"],
            _fit_rows(f),
        )
        say(
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
    # Statements about the sample are the same for all laws and branches.
    for warning in dict.fromkeys(w for f in fits for w in f.warnings):
        same = [f for f in fits if warning in f.warnings]
        laws = list(dict.fromkeys(f.model for f in same))
        branches = list(dict.fromkeys(f.branch for f in same))
        of = "all laws" if len(same) == len(fits) and len(laws) > 1 else ", ".join(laws)
        say(f"warning: {of}, {' and '.join(branches)}: {warning}")
    if plot is not None:
        save_figure(plot_fits(fits), plot, force=force)
    # In a comparison, a law that does not fit is a result; alone, its values are meaningless.
    poor = [] if every else [f for f in fits if f.undetermined or f.at_bound]
    if output is not None:
        document = {"data": str(data.name), "fits": [_fit_dictionary(f) for f in fits]}
        write_named(output, json.dumps(document, indent=1) + "\n", force)
    if poor:
        raise ModelError(
            "\n".join(
                f"fit: {f.model}, {f.branch}: the data do not determine "
                f"{', '.join(dict.fromkeys((*f.undetermined, *f.at_bound)))}; fix what is known "
                "(--fix, --thickness0, --v-f0), widen a bound (--bound), or choose another law"
                for f in poor
            )
        )
