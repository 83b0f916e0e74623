"""Command group ``feltmb fiber``: fits and simulation of fiber masses."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.completing import fiber_laws
from feltmb.cli.compression import TEST, TestFile
from feltmb.cli.felt import FILE, ZERO
from unmodeled.cli.options import (
    FORCE,
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    SEED,
    Fields,
    FileName,
    Number,
    Quantity,
    argument,
    count,
    declare,
    fields_of,
    group,
    is_given,
    option,
    pairs,
    positive,
)
from unmodeled.cli.screen import (
    check_targets,
    console,
    finite,
    save_figure,
    save_text,
    say,
    say_written,
    show,
    warn,
)

if TYPE_CHECKING:
    from feltmb.fiber import Cycle, FiberBox, FiberRun


@group("fiber")
def fiber() -> None:
    """Micromechanics of fiber networks: fit laws, and simulate fibers."""


command = fiber


def _units(*laws: Any) -> dict[str, str]:
    """SI unit of each parameter of these laws, from ``models()``."""
    return {p.name: p.unit or "1" for law in laws for p in law.parameters}


def _quantities(
    option: str, texts: Sequence[str], units: Mapping[str, str], form: str = "NAME=VALUE"
) -> dict[str, list[float]]:
    """Values by parameter in SI units, of "1" or "1:5"; all faults are in one message."""
    from unmodeled.errors import InvalidParameter
    from unmodeled.units.quantity import parse_scalar

    given = pairs(option, texts, form)
    out: dict[str, list[float]] = {}
    faults: list[str] = []
    for name, text in given.items():
        if name not in units:
            known = ", ".join(units)
            faults.append(f'{option}: parameter "{name}" is unknown, expected one of {known}')
            continue
        try:
            out[name] = [parse_scalar(part, units[name]) for part in text.split(":")]
        except ValueError as error:
            faults.append(f"{option}: {name}: {error}")
    wrong = [name for name, values in out.items() if len(values) != form.count(":") + 1]
    faults += [f"{option}: {name}={given[name]}: expected {form}" for name in wrong]
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


# --- fits ----------------------------------------------------------------------------------------


@declare("fit", fiber, "Identify a compression law from the CSV file DATA.")
def fit_command(
    data: Path = argument(FILE),
    model: str = option(
        "Law to fit, see `feltmb list`.",
        default="binomial",
        words="--model -m",
        metavar="NAME",
        complete=fiber_laws,
    ),
    every: bool = option("Fit every law and rank them by BIC.", words="--all"),
    branch: str = option(
        "each: one fit per branch in the file; both: one fit through both.",
        click.Choice(["loading", "unloading", "each", "both"]),
        "each",
    ),
    free: tuple[str, ...] = option("Parameter to identify. Default by law.", metavar="NAME"),
    fix: tuple[str, ...] = option(
        "Fixed parameter, such as E=2.5GPa.", words="--fix -f", metavar="NAME=VALUE"
    ),
    bound: tuple[str, ...] = option(
        "Bounds of a parameter.", words="--bound -b", metavar="NAME=LOW:HIGH"
    ),
    method: str = option(
        "Trust region, or the simplex of the thesis.",
        click.Choice(["least_squares", "nelder_mead"]),
        "least_squares",
    ),
    starts: int = option("Starting points.", count(1, 10_000), 12),
    seed: int = SEED,
    level: float = option("Confidence level.", FRACTION, 0.95),
    v_f0: float | None = option(
        "Volume fraction of zero pressure [-]; default: estimated from v_f data.", FRACTION
    ),
    thickness0: float | None = option(
        "Thickness at v_f0, without load [m]; default: estimated from thickness data.",
        positive("m"),
        words="--thickness0 --thickness",
    ),
    area: float | None = option("Sample area [m^2], with force data.", positive("m^2")),
    zero: float | None = ZERO,
    read: TestFile = TEST,
    plot: Path | None = option("Picture of fit and residuals.", FILE),
    out: Path | None = option("Results as JSON.", FileName(".json")),
    force: bool = FORCE,
) -> None:
    """Identify a compression law from DATA, a CSV file with units in its header.

    Columns: v_f [-], strain [-], thickness or displacement [mm]; pressure [kPa] or force [N];
    optionally branch.
    """
    from feltmb.fiber import compare, fit_branches, models, read_compression
    from feltmb.fiber.plot import plot_fits
    from unmodeled.errors import Error, InvalidParameter

    check_targets(out, pictures=(plot,), force=force)
    test = read_compression(
        data, v_f0=v_f0, thickness0=thickness0, area=area, zero=zero, **read.reading
    )
    known = models()
    if model not in known:
        raise InvalidParameter(f'--model = "{model}", must be one of {", ".join(known)}')
    units = _units(*(known.values() if every else [known[model]]))
    bounds = _quantities("--bound", bound, units, "NAME=LOW:HIGH")
    branches = [branch]
    if branch == "each":
        branches = ["loading", "unloading"][: 1 + (sum(~test.loading) >= 5)]
    common: dict[str, Any] = {
        "fixed": {k: v[0] for k, v in _quantities("--fix", fix, units).items()},
        "method": method,
        "n_starts": starts,
        "seed": seed,
        "level": level,
    }
    if every:
        fits = compare(test, branch="each" if len(branches) > 1 else branches[0], **common)
    else:
        fits = fit_branches(
            test,
            model,
            branches=branches,
            free=free or None,
            bounds={k: (v[0], v[1]) for k, v in bounds.items()},
            **common,
        )
    if test.thickness0 is not None:
        say(f"unloaded thickness: {test.thickness0 * 1e3:.6g} mm, as given; all values rest on it")
    for which in branches:
        here = [f for f in fits if f.branch == which]
        if every:
            _print_ranking(f"{test.name}, {which}: laws by BIC", here)
        else:
            _print_fit(f"{test.name}, {which}: {model}, {len(here[0].v_f)} samples", here[0])
    _print_warnings(fits)
    save_figure(plot, lambda: plot_fits(fits), force=force)
    # In a comparison, a law that does not fit is a result; alone, its values are meaningless.
    poor = [] if every else [f for f in fits if f.undetermined or f.at_bound]
    document = {"data": str(data.name), "fits": [_fit_dictionary(f) for f in fits]}
    save_text(out, json.dumps(document, indent=1) + "\n", force=force)
    if poor:
        raise Error("\n".join(map(_undetermined, poor)))


def _undetermined(f: Any) -> str:
    names = ", ".join(dict.fromkeys((*f.undetermined, *f.at_bound)))
    return (
        f"fit: {f.model}, {f.branch}: the data do not determine {names}; fix what is known (--fix, "
        "--thickness0, --v-f0), widen a bound (--bound), or choose another law"
    )


def _print_ranking(title: str, fits: Sequence[Any]) -> None:
    rows = []
    for f in fits:
        values = " ".join(f"{k}={f.values[k]:.4g}" for k in f.free)
        bic = f"{f.bic - fits[0].bic:.2f}"
        rows.append((f.model, bic, f"{f.rmse:.5g}", values, str(len(f.warnings))))
    show(title, "law | >BIC - best | >RMSE [Pa] | >parameters | >warnings", rows)


def _print_fit(title: str, f: Any) -> None:
    rows = []
    for name in (*f.free, *(n for n in f.values if n not in f.free)):
        low, high = f.interval[name] if name in f.free else (0.0, 0.0)
        ends = [f"{low:.4g}", f"{high:.4g}"] if name in f.free else ["fixed", ""]
        if name in f.free and name in f.undetermined:
            ends = ["undetermined", ""]
        rows.append([name, f.units.get(name) or "-", f"{f.values[name]:.6g}", *ends])
    show(title, f"parameter | >unit | >value | >{100 * f.level:g} % from | >to", rows)
    say(
        f"RMSE {f.rmse:.6g} Pa   R^2 {f.r_squared:.6f}   BIC {f.bic:.2f}   "
        f"{f.n_best} of {f.n_starts} starts agree"
    )
    if len(f.free) > 1:
        rows = [
            [name, *(f"{x:+.4f}" for x in row)]
            for name, row in zip(f.free, f.correlation, strict=True)
        ]
        show("Correlation", " | ".join(["", *(f">{name}" for name in f.free)]), rows)


def _print_warnings(fits: Sequence[Any]) -> None:
    """Print each warning once; one about the sample is the same for all laws and branches."""
    for warning in dict.fromkeys(w for f in fits for w in f.warnings):
        same = [f for f in fits if warning in f.warnings]
        laws = list(dict.fromkeys(f.model for f in same))
        branches = dict.fromkeys(f.branch for f in same)
        of = "all laws" if len(same) == len(fits) and len(laws) > 1 else ", ".join(laws)
        say(f"warning: {of}, {' and '.join(branches)}: {warning}")


def _fit_dictionary(f: Any) -> dict[str, Any]:
    same = ("model", "branch", "method", "values", "units", "level", "reference", "bic",
            "r_squared")  # fmt: skip
    return {name: getattr(f, name) for name in same} | {
        "free": list(f.free),
        "interval": {k: [finite(a), finite(b)] for k, (a, b) in f.interval.items()},
        "undetermined": list(f.undetermined),
        "at_bound": list(f.at_bound),
        "correlation": f.correlation.tolist(),
        "rmse [Pa]": f.rmse,
        "warnings": list(f.warnings),
        "samples": len(f.v_f),
    }


# --- simulation ----------------------------------------------------------------------------------


BOX = fields_of(
    "feltmb.fiber.simulation:FiberBox",
    n_fibers={"words": "--fibers", "type": count(1, 100_000)},
    n_beads={"words": "--beads", "type": count(2, 10_000)},
    d_f={"type": positive("m"), "default": "25 um"},
    segment_length={
        "words": "--segment",
        "type": positive("m"),
    },
    v_f={"type": FRACTION},
    crimp={"type": Quantity("rad", 0)},
    friction={"type": NOT_NEGATIVE, "default": 0.35},
    repulsion={"type": click.Choice(["hertz", "logarithmic"])},
    E={
        "words": "--e-modulus",
        "type": positive("Pa"),
        "default": "2.5 GPa",
    },
    drag={"type": POSITIVE},
    seed={"type": count(0)},
)
CYCLE = fields_of(
    "feltmb.fiber.simulation:Cycle",
    v_max={"type": FRACTION},
    strain_per_step={"type": Number(0, 0.01, min_open=True, max_open=True)},
    cycles={"type": count(1, 100_000)},
)


def _not_resumed(fields: Fields, asked: object, old: object) -> Iterator[str]:
    """Options on the command line that differ from a run that is to go on."""
    for f, _, name in fields.parts():
        wanted, has = getattr(asked, f.name), getattr(old, f.name)
        if is_given(name) and wanted != has:
            word = name.replace("_", "-")
            yield f"--{word}: {wanted} does not belong to the run, which has {has}"


@declare("simulate", fiber, "Compress and release a box of single fibers.")
def simulate_command(
    output: Path = argument(FILE),
    box: FiberBox = BOX,
    cycle: Cycle = CYCLE,
    threads: int = option("Number of threads; 0: all cores.", count(0, 1024), 0),
    resume: bool = option("Continue the unfinished run OUTPUT."),
    samples: int | None = option(
        "Stop after this number of samples; the run can be resumed.", count()
    ),
    orientation: Path | None = option(
        "Table with the direction x, y, z of each fiber (z: compression); default: at random.",
        FILE,
    ),
    vtk: Path | None = option(
        "The fibers at the end, for ParaView (.vtk); with --samples, those at that sample.",
        FileName(".vtk"),
    ),
    plot: Path | None = option("Picture.", FILE),
    force: bool = FORCE,
) -> None:
    """Compress and release a box of single fibers, and write the run to OUTPUT (.npz)."""
    from rich.progress import Progress

    from feltmb.fiber import FiberRun, read_directions, simulate, unusual
    from feltmb.fiber.plot import plot_simulation
    from unmodeled.errors import Error, InvalidParameter

    warn(unusual(d_f=box.d_f, segment=box.segment_length, E=box.E))
    if output.suffix != ".npz":
        raise InvalidParameter(f'{output}: suffix is "{output.suffix}", expected .npz')
    check_targets(None if resume else output, pictures=(plot,), force=force)
    check_targets(vtk, force=force)
    directions = None if orientation is None else read_directions(orientation)
    if directions is not None and not is_given("fibers"):
        box = replace(box, n_fibers=len(directions))
    old = FiberRun.load(output) if resume else None
    if old is not None:
        faults = [*_not_resumed(BOX, box, old.box), *_not_resumed(CYCLE, cycle, old.cycle)]
        if faults:
            text = "\n".join(faults)
            raise InvalidParameter(f"{output}: --resume goes on with the run as it is:\n{text}")
    cycle = replace(cycle, sample_every=max(1, round(0.01 / cycle.strain_per_step)))
    with Progress(console=console(stderr=True), transient=True) as bar:
        task = bar.add_task("compressing", total=1.0)

        def tell(done: float, sample: dict[str, Any]) -> None:
            text = f"v_f {sample['v_f']:.4f} P {sample['pressure']:.4g} Pa"
            bar.update(task, completed=done, description=text)

        run = simulate(
            box if old is None else old.box,
            cycle if old is None else old.cycle,
            resume=old,
            directions=directions,
            threads=threads,
            progress=tell,
            checkpoint=output,
            max_samples=samples,
        )
    _print_simulation(run)
    say_written(output)
    save_text(vtk, run.to_vtk, force=force)
    save_figure(plot, lambda: plot_simulation(run), force=force)
    warn(run.warnings)
    if run.status == "failed":
        raise Error("simulate: failed, for the reasons above; the samples so far are saved")


def _print_simulation(run: FiberRun) -> None:
    box, phase = run.box, run.column("phase")
    numbers = ("pressure", "contacts", "work", "friction_loss", "drag_loss")
    show(
        f"{box.n_fibers} fibers, friction {box.friction:g}",
        "branch | >v_f [-] | >porosity [-] | >P [Pa] | >contacts | >work [J] | >friction [J] | "
        ">drag [J]",
        [
            ["loading" if phase[i] == 0 else "unloading",
             f"{run.table['v_f'][i]:.3g}", f"{1.0 - run.table['v_f'][i]:.3g}",
             *(f"{run.table[k][i]:.3g}" for k in numbers)]
            for i in sorted({int(k * (len(phase) - 1) / 10) for k in range(11)})
        ],
    )  # fmt: skip
    laid, relaxed = run.laid, run.relaxed
    say(
        f"contacts as laid {laid['crossings']:.0f}, Toll {laid['toll']:.1f} "
        f"+- {math.sqrt(laid['toll']):.1f}; relaxed {relaxed['contacts']:.0f}"
    )
    if not run.done:
        say("unfinished; go on with --resume")
        return
    energy = run.energy
    shares = ", ".join(
        f"{name} {100 * energy[name] / max(energy['put_in'], 1e-300):.3g} %"
        for name in ("friction", "drag")
    )
    say(
        f"loop loss {100 * run.loop_loss:.2f} %; of the work put in: {shares}\n"
        f"pressure exponent of loading: {', '.join(_exponents(run))}"
    )


def _exponents(run: FiberRun) -> Iterator[str]:
    from unmodeled.errors import InvalidParameter

    for low in (0.75, 0.25):
        bottom = low * run.box.v_f + (1.0 - low) * run.cycle.v_max
        try:
            yield f"{run.pressure_exponent(bottom):.2f} above {bottom:.3g}"
        except InvalidParameter:
            yield f"too few samples above {bottom:.3g}"
