"""Command group ``feltmb fiber``: laws, contacts, fits and simulation of fiber masses."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.completing import fiber_laws
from feltmb.cli.felt import FILE, ZERO
from feltmb.cli.models import TEST, TestFile
from feltmb.cli.options import (
    DIAMETER,
    FORCE,
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    FileName,
    Number,
    Quantity,
    argument,
    caution,
    count,
    declare,
    fields_of,
    group,
    option,
    positive,
)
from feltmb.cli.screen import (
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
    from feltmb.data import Array
    from feltmb.fiber import Cycle, FiberBox, FiberRun

__all__ = ["command", "fiber"]

ROWS = count(1, 100_000)
SEED = option("Seed of all random draws.", count(0), 0)


@group("fiber")
def fiber() -> None:
    """Micromechanics of fiber networks: explore, fit and simulate felt."""


command = fiber


def _units(*laws: Any) -> dict[str, str]:
    """SI unit of each parameter of these laws, from ``models()``."""
    return {p.name: p.unit or "1" for law in laws for p in law.parameters}


def _quantities(
    pairs: Sequence[str], what: str, units: Mapping[str, str], *, separator: str = ""
) -> dict[str, list[float]]:
    """``name=value`` pairs with units, in SI units; all faults are in one message.

    ``separator`` separates several values of one parameter, if permitted.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.units.quantity import parse_scalar

    out: dict[str, list[float]] = {}
    faults: list[str] = []
    powers: list[tuple[str, str, str]] = []  # name, unit and text; the unit still needs an exponent

    def add(name: str, unit: str, text: str) -> None:
        texts = text.split(separator) if separator else [text]
        try:
            out[name] = [parse_scalar(t, unit) for t in texts]
        except ValueError as error:
            faults.append(f"{what}: {name}: {error}")

    for pair in pairs:
        name, equals, text = (part.strip() for part in pair.partition("="))
        unit = units.get(name, "1")
        if not equals:
            faults.append(f'{what}: "{pair}", expected name=value, for example gamma=1.3')
        elif name not in units:
            known = ", ".join(units)
            faults.append(f'{what}: parameter "{name}" is unknown, expected one of {known}')
        elif unit.rpartition("^")[2] in units:
            powers.append((name, unit, text))
        else:
            add(name, unit, text)
    for name, unit, text in powers:
        head, _, exponent = unit.rpartition("^")
        add(name, f"{head}^{out[exponent][0]:g}" if exponent in out else "1", text)
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


def _numbers(pairs: Sequence[str], what: str, units: Mapping[str, str]) -> dict[str, float]:
    """``name=value`` pairs with one value each."""
    return {name: values[0] for name, values in _quantities(pairs, what, units).items()}


def _csv(columns: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    """Rows of numbers as CSV."""
    lines = [",".join(f"{x:.10g}" for x in row) for row in rows]
    return "\n".join([",".join(columns), *lines]) + "\n"


# --- laws and contacts ---------------------------------------------------------------------------


@declare("models", fiber, "List the laws, or the parameters of law NAME.")
def models_command(name: str | None = argument(complete=fiber_laws)) -> None:
    """List the laws, or the parameters of law NAME with unit, range and meaning."""
    from feltmb.errors import InvalidParameter
    from feltmb.fiber import history_models, models

    kinds = {"Compression laws": models(), "Laws with history": history_models()}
    if name is None:
        for title, laws in kinds.items():
            sources = [(k, d.title, d.source) for k, d in laws.items()]
            show(title, "law | what | source", sources)
        return
    known = {k: d for laws in kinds.values() for k, d in laws.items()}
    if name not in known:
        raise InvalidParameter(f'models: NAME = "{name}", must be one of {", ".join(known)}')
    law = known[name]
    say(f"{law.title}\nsource: {law.source}\nvalid: {law.validity}")
    rows = []
    for p in law.parameters:
        derived = {"v_random": "isotropic" if name == "bending_chain" else "v_f0"}
        default = f"{p.default:.4g}"
        if math.isnan(p.default):
            default = derived.get(p.name, "required")
        rows.append((p.name, p.unit or "-", default, f"{p.low:.3g} to {p.high:.3g}", p.meaning))
    show("Parameters", "name | unit | default | range | meaning", rows)


@declare("contacts", fiber, "Mean free length and contacts per volume by every model.")
def contacts_command(
    v_f: float = option("Volume fraction [-].", FRACTION, required=True, callback=caution("v_f")),
    d_f: float = DIAMETER,
    ratio: float = option("R = v_f/v_random.", POSITIVE, 1.0),
    gamma: float = option(
        "Blocked length per contact over d_f (binomial).",
        POSITIVE,
        math.pi / 2,
        show="pi/2",
        callback=caution("gamma"),
    ),
    diameter_cv: float = option("Coefficient of variation of the diameters.", NOT_NEGATIVE, 0.0),
    length: float | None = option(
        "Mean fiber length [m]: also the numbers per fiber.",
        positive("m"),
        callback=caution("length"),
    ),
    length_cv: float = option(
        "Coefficient of variation of the lengths (gamma distribution).", Number(0, 3), 0.0
    ),
) -> None:
    """Mean free length and contacts per volume by every model."""
    from feltmb.fiber import contact_count, contacts_per_volume, mean_free_length

    names = ["van_wyk", "van_wyk_tube", "komori_makishima", "pan", "poisson", "binomial", "toll"]
    if diameter_cv != 0:
        names = ["komori_makishima", "poisson", "toll"]
    common = {name: {"gamma": gamma} if name == "binomial" else {} for name in names}
    rows = []
    for name in names:
        extra: dict[str, Any] = {**common[name], "ratio": ratio, "diameter_cv": diameter_cv}
        free = mean_free_length(name, v_f, d_f, **extra)
        number = contacts_per_volume(name, v_f, d_f, **extra)
        rows.append((name, f"{free * 1e6:.4f}", f"{free / d_f:.4f}", f"{number * 1e-9:.6g}"))
    title = f"Contacts at v_f = {v_f:g}, d_f = {d_f * 1e6:g} um, R = {ratio:g}"
    show(title, "model | >free length [um] | >over d_f [-] | >contacts [1/mm^3]", rows)
    say("toll counts a contact on both of its fibers (eq. 3.51), the others once.")
    if diameter_cv != 0:
        say("the other models have no distribution of diameters.")
    if length is None:
        return
    rows = []
    for name in ("poisson", "binomial"):
        extra = {"gamma": gamma} if name == "binomial" else {}
        extra |= {"ratio": ratio, "length_cv": length_cv}
        c = contact_count(name, v_f, d_f, length, **extra)
        sd = f"{math.sqrt(c.variance):.4f}"
        rows.append((name, f"{c.mean:.4f}", sd, f"{c.probability[0]:.3e}"))
    heads = "model | >mean | >standard deviation | >probability of none"
    show(f"Contacts on a fiber of {length * 1e3:g} mm", heads, rows)


@declare("pressure", fiber, "Pressure, modulus and energy against volume fraction.")
def pressure_command(
    model: str = argument(complete=fiber_laws),
    given: tuple[str, ...] = option(
        "Parameter, such as E=2.5GPa, else in SI units; see 'feltmb fiber models MODEL'.",
        words="--set -s",
        metavar="NAME=VALUE",
    ),
    top: float = option("Largest volume fraction.", FRACTION, 0.5, words="--to"),
    points: int = option("Rows.", ROWS, 11),
    out: Path | None = option("CSV, or .png/.pdf/.svg for a picture.", FILE),
    force: bool = FORCE,
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
    parameters = _numbers(given, "--set", _units(known[model]))
    warn(unusual(**{k: v for k, v in parameters.items() if k in RANGES}))
    made = law(model, **parameters)
    if points < 2 or not top > made.v_f0:
        raise InvalidParameter(
            f"pressure: --points = {points}, --to = {top:.6g}; expected at least 2 points and "
            f"--to above v_f0 = {made.v_f0:.6g}"
        )
    v = np.linspace(made.v_f0, min(top, 1.0, made.limit * 0.999), points)
    if out is not None and out.suffix != ".csv":
        save_figure(out, lambda: plot_law(made, float(v[-1])), force=force)
        return
    columns = (v, 1 - made.v_f0 / v, made.pressure(v), v * made.slope(v), made.energy(v))
    rows = np.column_stack(columns).tolist()
    if out is not None:
        heads = ("v_f [-]", "strain [-]", "pressure [Pa]", "tangent_modulus [Pa]",
                 "energy_per_fiber_volume [J/m^3]")  # fmt: skip
        save_text(out, _csv(heads, rows), force=force)
        return
    show(
        repr(made),
        "v_f [-] | >strain [-] | >P [Pa] | >tangent [Pa] | >U [J/m^3 fiber]",
        [[f"{x:.5g}" for x in row] for row in rows],
    )


@declare("history", fiber, "Run a law with history over the samples of PATH.")
def history_command(
    model: str = argument(complete=fiber_laws),
    path: Path = argument(FILE),
    given: tuple[str, ...] = option(
        "Parameter, such as E=2.5GPa, else in SI units; its value may be a list.",
        words="--set -s",
        metavar="NAME=VALUE[,VALUE...]",
    ),
    spring: str = option(
        "Compression law of the springs (dunlop, stamm_kelvin).", default="van_wyk"
    ),
    out: Path | None = option("CSV with time, compression and result.", FileName(".csv")),
    force: bool = FORCE,
) -> None:
    """Run a law with history over the samples of PATH, a file with time and compression.

    Its columns are "time [s]" and "strain [-]" or "compression [m]".
    """
    import numpy as np

    from feltmb.errors import InvalidParameter
    from feltmb.fiber import history, history_models, models

    laws = {**models(), **history_models()}
    for what, name in (("MODEL", model), ("--spring", spring)):
        if name not in laws:
            raise InvalidParameter(f'history: {what} = "{name}", must be one of {", ".join(laws)}')
    params = _quantities(given, "--set", _units(laws[spring], laws[model]), separator=",")
    time, x, is_strain = _compression(path)
    result = history(model, time, x, spring=spring, **params)
    heads = ("time [s]", "strain [-]" if is_strain else "compression [m]")
    unit = "stress [Pa]" if is_strain else "force [N]"
    if out is not None:
        rows = np.column_stack([time, x, result]).tolist()
        save_text(out, _csv([*heads, unit], rows), force=force)
    work = float(np.sum(0.5 * (result[1:] + result[:-1]) * np.diff(x)))
    show(
        f"{model} over {len(time)} samples",
        "what | >value",
        [
            (f"largest {unit}", f"{np.max(result):.6g}"),
            (f"at {heads[1]}", f"{x[int(np.argmax(result))]:.6g}"),
            ("work not given back", f"{work:.6g} {'J/m^3' if is_strain else 'J'}"),
        ],
    )


def _compression(path: Path) -> tuple[Array, Array, bool]:
    """Time [s], strain [1] or compression [m] of a file, and whether it is a strain."""
    import numpy as np

    from feltmb.data.columns import read_columns
    from feltmb.data.mapping import clock_column, values_in
    from feltmb.errors import DataError
    from feltmb.units.quantity import fault_text

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
    return time, x, bool(strain)


# --- fits ----------------------------------------------------------------------------------------


@declare("fit", fiber, "Identify a compression law from the CSV file DATA.")
def fit_command(
    data: Path = argument(FILE),
    model: str = option(
        "Law to fit; see models.",
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
    from feltmb.errors import FeltmbError, InvalidParameter
    from feltmb.fiber import compare, fit_branches, models, read_compression
    from feltmb.fiber.plot import plot_fits

    check_targets(out, pictures=(plot,), force=force)
    test = read_compression(
        data, v_f0=v_f0, thickness0=thickness0, area=area, zero=zero, **read.reading
    )
    known = models()
    if model not in known:
        raise InvalidParameter(f'--model = "{model}", must be one of {", ".join(known)}')
    units = _units(*(known.values() if every else [known[model]]))
    bounds = _bounds(bound, units)
    branches = [branch]
    if branch == "each":
        branches = ["loading"] + (["unloading"] if (~test.loading).sum() >= 5 else [])
    common: dict[str, Any] = {
        "fixed": _numbers(fix, "--fix", units),
        "method": method,
        "n_starts": starts,
        "seed": seed,
        "level": level,
    }
    if every:
        fits = compare(test, branch="each" if len(branches) > 1 else branches[0], **common)
    else:
        fits = fit_branches(
            test, model, branches=branches, free=free or None, bounds=bounds, **common
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
        raise FeltmbError(
            "\n".join(
                f"fit: {f.model}, {f.branch}: the data do not determine "
                f"{', '.join(dict.fromkeys((*f.undetermined, *f.at_bound)))}; fix what is known "
                "(--fix, --thickness0, --v-f0), widen a bound (--bound), or choose another law"
                for f in poor
            )
        )


def _bounds(texts: Sequence[str], units: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    from feltmb.errors import InvalidParameter

    bounds: dict[str, tuple[float, float]] = {}
    for name, span in _quantities(texts, "--bound", units, separator=":").items():
        if len(span) != 2:
            raise InvalidParameter(
                f"--bound: {name}: got {len(span)} values, expected name=low:high, for example "
                "gamma=0.5:5"
            )
        bounds[name] = (span[0], span[1])
    return bounds


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


@declare("simulate", fiber, "Compress and release a box of single fibers.")
def simulate_command(
    output: Path = argument(FILE),
    box: FiberBox = fields_of(
        "fiber.simulation:FiberBox",
        n_fibers={"words": "--fibers", "type": count(1, 100_000)},
        n_beads={"words": "--beads", "type": count(2, 10_000)},
        d_f={"type": positive("m"), "default": "25 um", "callback": caution("d_f")},
        segment_length={
            "words": "--segment",
            "type": positive("m"),
            "callback": caution("segment"),
        },
        v_f={"type": FRACTION},
        crimp={"type": Quantity("rad", 0)},
        friction={"type": NOT_NEGATIVE, "default": 0.35},
        repulsion={"type": click.Choice(["hertz", "logarithmic"])},
        E={
            "words": "--e-modulus",
            "type": positive("Pa"),
            "default": "2.5 GPa",
            "callback": caution("E"),
        },
        drag={"type": POSITIVE},
        seed={"type": count(0)},
    ),
    cycle: Cycle = fields_of(
        "fiber.simulation:Cycle",
        v_max={"type": FRACTION},
        strain_per_step={"type": Number(0, 0.01, min_open=True, max_open=True)},
        cycles={"type": count(1, 100_000)},
    ),
    threads: int = option("Number of threads; 0: all cores.", count(0, 1024), 0),
    resume: bool = option("Continue the unfinished run OUTPUT."),
    samples: int | None = option(
        "Stop after this number of samples; the run can be resumed.", count()
    ),
    plot: Path | None = option("Picture.", FILE),
    force: bool = FORCE,
) -> None:
    """Compress and release a box of single fibers, and write the run to OUTPUT (.npz)."""
    from rich.progress import Progress

    from feltmb.errors import FeltmbError, InvalidParameter
    from feltmb.fiber import FiberRun, simulate
    from feltmb.fiber.plot import plot_simulation

    if output.suffix != ".npz":
        raise InvalidParameter(f'{output}: suffix is "{output.suffix}", expected .npz')
    check_targets(None if resume else output, pictures=(plot,), force=force)
    old = FiberRun.load(output) if resume else None
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
            threads=threads,
            progress=tell,
            checkpoint=output,
            max_samples=samples,
        )
    _print_simulation(run)
    say_written(output)
    save_figure(plot, lambda: plot_simulation(run), force=force)
    warn(run.warnings)
    if run.status == "failed":
        raise FeltmbError("simulate: failed, for the reasons above; the samples so far are saved")


def _print_simulation(run: FiberRun) -> None:
    box, phase = run.box, run.column("phase")
    numbers = ("v_f", "pressure", "contacts", "work", "friction_loss", "drag_loss")
    show(
        f"{box.n_fibers} fibers, friction {box.friction:g}",
        "branch | >v_f [-] | >P [Pa] | >contacts | >work [J] | >friction [J] | >drag [J]",
        [
            ["loading" if phase[i] == 0 else "unloading",
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
    from feltmb.errors import InvalidParameter

    for low in (0.75, 0.25):
        bottom = low * run.box.v_f + (1.0 - low) * run.cycle.v_max
        try:
            yield f"{run.pressure_exponent(bottom):.2f} above {bottom:.3g}"
        except InvalidParameter:
            yield f"too few samples above {bottom:.3g}"
