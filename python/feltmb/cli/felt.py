"""Command group ``feltmb felt``: identification, envelopes, audits of laws."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import click

from feltmb.cli.completing import actions, felts, packaged
from feltmb.cli.compression import TEST, TestFile
from feltmb.cli.settings import SET
from unmodeled.cli.options import (
    FORCE,
    FRACTION,
    FileName,
    FolderName,
    Number,
    Quantity,
    argument,
    count,
    declare,
    fields_of,
    group,
    option,
    positive,
)
from unmodeled.cli.screen import (
    check_targets,
    complain,
    finite,
    print_json,
    save_figure,
    save_text,
    say,
    say_written,
    show,
    warn,
)

if TYPE_CHECKING:
    from feltmb.felt import (
        Audit,
        ContactFit,
        FeltEnvelope,
        Identification,
        LawFit,
        LoopUncertainty,
        MeasuredLoop,
        PooledLaw,
    )
    from feltmb.felt.envelopes import FeltLaw

#: A file that exists.
FILE = click.Path(dir_okay=False, path_type=Path)
MATERIAL = argument(complete=felts)
TOML = option("TOML file to write.", FileName(".toml"))
AREA = option(
    "constant:100mm^2, crossed_cylinders:9mm,0.5mm, circle_on_layer:5mm,10mm (radius, width) or "
    "sphere_on_layer:5mm.",
    metavar="LAW:NUMBERS",
    required=True,
)
ZERO = option(
    "Displacement at the first contact [m], such as 0.35mm, for displacement data; default: 0.",
    Quantity("m"),
)
ROWS = count(5, 100_000)


@group("felt")
def felt() -> None:
    """Felt: identification, envelopes, audit of laws."""


command = felt


# --- contact laws --------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Written:
    """What `felt envelope` and `felt contact` write."""

    points: int = option("Rows of the table.", ROWS, 193)
    action: str = option(
        "Mechanism to extend.", default="steinway45", metavar="NAME", complete=actions
    )
    contact: str | None = option(
        "Write a mechanism in which this contact (such as 06) has the law.", metavar="NN"
    )
    out: Path | None = TOML
    plot: Path | None = option("Picture (.png, .pdf or .svg).", FILE)
    force: bool = FORCE

    def check(self) -> None:
        """Check the files and the contact."""
        from feltmb.mechanism import load_action
        from unmodeled.errors import InvalidParameter

        check_targets(self.out, pictures=(self.plot,), force=self.force)
        known = {} if self.contact is None else load_action(self.action).config.contacts
        if self.contact is not None and self.contact not in known:
            raise InvalidParameter(
                f"--contact: got {self.contact!r}, expected one of {', '.join(known)} of "
                f"{self.action}"
            )

    def write(self, made: FeltEnvelope, draw: Callable[[], Any]) -> None:
        """Write the table or the mechanism, and the picture."""
        extended = (None, None) if self.contact is None else (self.action, self.contact)
        save_text(self.out, lambda: made.to_toml(*extended), force=self.force)
        save_figure(self.plot, draw, force=self.force)


WRITTEN = fields_of("feltmb.cli.felt:_Written")


LAW = option(
    "Law that gets the loop: felt_memory, or felt_return_point for small vibrations.",
    click.Choice(["felt_memory", "felt_return_point"]),
    "felt_memory",
)


def _print_envelope(made: FeltEnvelope, sure: LoopUncertainty | None = None) -> None:
    """Print some rows of an envelope, with their standard uncertainties if they are known."""
    import numpy as np

    sides = () if sure is None else (sure.loading, sure.unloading)

    def rows() -> Iterator[list[str]]:
        for share in (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0):
            x = share * made.closing
            forces = float(made.core.loading(x)), float(made.core.unloading(x, made.closing))
            texts = [[f"{force:.5g}"] for force in forces]
            for text, side in zip(texts, sides, strict=False):
                text.append(f"{np.interp(x, made.compression, side):.2g}")
            yield [f"{x * 1e3:.4g}", *texts[0], *texts[1]]

    plus = " | >± [N]" if sides else ""
    heads = f">compression [mm] | >loading [N]{plus} | >unloading [N]{plus}"
    show("Envelope", heads, rows())


@declare("envelope", felt, "Loop of a contact, force against compression.")
def envelope_command(
    material: str = MATERIAL,
    thickness: float = option(
        "Thickness of the felt without load [m], such as 6mm.", positive("m"), required=True
    ),
    area: str = AREA,
    columns: bool = option(
        "Compute the compression of each column of the felt under the indenter."
    ),
    law: str = LAW,
    largest: float | None = option(
        "End of the loop [m], such as 2mm; default: compression at v_f_max.", positive("m")
    ),
    written: _Written = WRITTEN,
) -> None:
    """Compute the loop of a contact, force against compression, from felt MATERIAL.

    The table is the value of contacts.NN.memory.envelope in a mechanism file. With --contact the
    output file is a complete mechanism.
    """
    from feltmb.felt import envelope, load_material, parse_area
    from feltmb.felt.plot import plot_envelope

    written.check()
    made = envelope(
        load_material(material),
        thickness,
        parse_area(area),
        compression="columns" if columns else "even",
        largest=largest,
        points=written.points,
    )
    made = replace(made, law_name=cast("FeltLaw", law))
    say(made.about)
    _print_envelope(made)
    apart = ""
    if math.isfinite(made.open_loss):
        apart = f"; without closing it at its end by force: {100 * made.open_loss:.2f} %"
    say(f"loss of the loop: {100 * made.loss:.2f} % of the loading work{apart}")
    written.write(made, lambda: plot_envelope(made))


@declare("contact", felt, "Contact law from the measured loop in TEST.")
def contact_command(
    test: Path = argument(FILE),
    zero: float | None = option(
        "Displacement (or thickness) at the first contact [m], such as 0.4mm; default: the "
        "beginning of a smooth toe of loading.",
        Quantity("m"),
    ),
    thickness: float | None = option(
        "Thickness without load [m], for a column of strain.", positive("m")
    ),
    area: float | None = option(
        "Area [m^2], for a column of pressure and for the values of Kawabata's system (KES).",
        positive("m^2"),
    ),
    loss: float | None = option(
        "Loss of a test of loading only, such as 30%; 0: an elastic law.",
        Number(0, 1, max_open=True),
    ),
    law: str = LAW,
    read: TestFile = TEST,
    written: _Written = WRITTEN,
    *,
    as_json: bool,
) -> None:
    """Contact law from the measured loop in TEST, a CSV with units in its header.

    Columns: "displacement [mm]" (positive in compression), "thickness [mm]" or "strain [%]", and
    "force [N]" or "stress [kPa]", also by their usual names in English, German, French, Chinese and
    Japanese; other units, such as in, gf and kgf, are converted. A column that is called
    compression and starts at zero is not shifted. No data of the fibers are needed. The loop is one
    cycle; the loss of each is printed, and the scatter of the complete ones gives the uncertainty
    of the forces. The table is the value of contacts.NN.memory.envelope in a mechanism file. With
    --contact the output file is a complete mechanism.
    """
    from feltmb.felt import read_measured_loop
    from feltmb.felt.plot import plot_measured_loop

    written.check()
    loop = read_measured_loop(
        test,
        zero=zero,
        points=written.points,
        thickness0=thickness,
        area=area,
        loss=loss,
        law=cast("FeltLaw", law),
        **read.reading,
    )
    kes = {} if area is None else loop.kawabata(area)
    if as_json:
        print_json({**_contact_json(loop), **({"kawabata": kes} if kes else {})})
    else:
        _print_contact(loop)
        if kes:
            say(
                f"KES: WC {kes['WC']:.4g} J/m^2, LC {kes['LC']:.3f}, RC {100 * kes['RC']:.1f} %, "
                f"up to {kes['pressure'] / 98.0665:.4g} gf/cm^2 (KES ends at 50)"
            )
    written.write(loop.envelope, lambda: plot_measured_loop(loop))


def _first_contact(loop: MeasuredLoop) -> tuple[float, list[float]]:
    """Reading at the first contact [m], and its interval."""
    sign = -1.0 if loop.by_thickness else 1.0
    return sign * loop.zero, sorted(sign * end for end in loop.zero_interval or ())


def _contact_json(loop: MeasuredLoop) -> dict[str, Any]:
    made, sure = loop.envelope, loop.uncertainty
    at, span = _first_contact(loop)
    return {
        "zero": at,
        "zero_interval": span or None,
        "cycle": loop.branches.chosen,
        "cycles": [{**asdict(one), "speed": finite(one.speed)} for one in loop.cycles],
        "largest_compression": made.closing,
        "largest_force": float(made.loading[-1]),
        "loss": made.loss,
        "loss_of_samples": loop.loss,
        "loss_factor": loop.loss_factor,
        "uncertainty": {
            "cycles": sure.cycles,
            "zero": sure.zero,
            "loss": sure.loss,
            "kappa": finite(sure.kappa),
            "loading": sure.loading.tolist(),
            "unloading": sure.unloading.tolist(),
            "source": sure.source,
        },
        "memory": dict(loop.memory),
        "rms_of_law": loop.rms,
        "notes": list(loop.notes),
        "envelope": made.table(),
    }


def _print_contact(loop: MeasuredLoop) -> None:
    made, sure = loop.envelope, loop.uncertainty
    at, span = _first_contact(loop)
    _print_envelope(made, sure)
    say(f"±: standard uncertainty (68 %), {sure.source}")
    what = "thickness" if loop.by_thickness else "displacement"
    given = "given, or zero of a compression"
    if span:
        given = f"95 %: {1e3 * span[0]:.4g} to {1e3 * span[1]:.4g} mm; --zero"
    say(f"{what} at the first contact: {at * 1e3:.4g} mm ({given})")
    sd = f" ± {100 * sure.loss:.2g}" if sure.loss > 0.0 else ""
    say(
        f"loss of the loop: {100 * made.loss:.2f}{sd} % of the loading work; of the samples of its "
        f"cycle: {100 * loop.loss:.2f} % (loss factor, tan delta: {loop.loss_factor:.3f})"
    )
    if len(loop.cycles) > 1:
        show(
            "Cycles",
            ">cycle | >from [mm] | >to [mm] | >force [N] | >speed [mm/s] | >loss [%] | >± [%]",
            [
                (
                    f"{c.number}{' *' if c.number == loop.branches.chosen else ''}",
                    f"{1e3 * c.low:.4g}",
                    f"{1e3 * c.top:.4g}",
                    f"{c.force:.4g}",
                    f"{1e3 * c.speed:.3g}" if math.isfinite(c.speed) else "-",
                    f"{100 * c.loss:.2f}",
                    f"{100 * c.sd:.2g}",
                )
                for c in loop.cycles
            ],
        )
        say("* the loop")
    say(_memory(loop))
    say(
        f"difference of law and test: {loop.rms:.4g} N rms, "
        f"{100 * loop.rms / made.loading[-1]:.2g} % of the largest force"
    )
    warn(loop.notes)


def _memory(loop: MeasuredLoop) -> str:
    """Numbers of the memory with their uncertainty, or why they have none."""
    if "kappa" not in loop.memory:
        rest = " and wiping_out = 0" if loop.envelope.law_name == "felt_memory" else ""
        return (
            f"memory: kappa = 0.2{rest}, the defaults of the law: the test does not "
            "tell better ones, and they have no uncertainty"
        )
    from feltmb.felt.measured import WIPING_OUT

    kappa, sd = loop.memory["kappa"], loop.uncertainty.kappa
    about = f"± {sd:.2g}" if math.isfinite(sd) else "the test does not determine its uncertainty"
    if loop.envelope.law_name != "felt_memory":
        return f"memory: kappa = {kappa:.4g} ({about})"
    return (
        f"memory: kappa = {kappa:.4g} ({about}), wiping_out = "
        f"{loop.memory.get('wiping_out', 0.0):g} (of 0 and {WIPING_OUT}, the one that follows the "
        "test better; no uncertainty)"
    )


@declare("law", felt, "Fit a law with few parameters to TESTS: loading, relaxation, rate.")
def law_command(
    tests: tuple[Path, ...] = argument(FILE),
    law: str = option(
        "power, exponential (eq. 4.21) and van_wyk (of loading; van_wyk_3 with its exponent 3), "
        "maxwell (branches of the hold under the largest load), stulov and rate (of cycles of "
        "several speeds).",
        click.Choice(["power", "exponential", "van_wyk", "van_wyk_3", "maxwell", "stulov", "rate"]),
        "power",
    ),
    zero: float | None = option(
        "Displacement (or thickness) at the first contact [m]; default: fitted.", Quantity("m")
    ),
    thickness: float | None = option(
        "Thickness at the first contact [m], for strain and van Wyk's law.", positive("m")
    ),
    area: float | None = option("Area [m^2], for a column of pressure.", positive("m^2")),
    read: TestFile = TEST,
    out: Path | None = option("Keys of a contact with the law, TOML.", FileName(".toml")),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Fit a law to TESTS. Several tests of loading are specimens of one law.

    The columns are those of `felt contact`. A test of loading only is enough for power,
    exponential and van_wyk; the loss stays open. maxwell, stulov and rate need a column of time.
    """
    from feltmb.felt import fit_law, pool, read_specimen
    from feltmb.felt.laws import LOADING
    from unmodeled.errors import InvalidParameter

    check_targets(out, force=force)
    reading = read.reading
    if reading.pop("cycle") is not None:
        raise InvalidParameter(
            "--cycle: a law of loading is of the first complete cycle, the others are of the whole "
            "test; expected no --cycle"
        )
    given = {"zero": zero, "thickness0": thickness, "area": area, **reading}
    specimens = [read_specimen(test, **given) for test in tests]
    several = len(specimens) > 1
    if several and law not in LOADING:
        raise InvalidParameter(f"--law {law} is of one test, got {len(specimens)}")
    if out is not None and (several or law in LOADING[1:]):
        raise InvalidParameter(
            f"{out}: --law {law} of {len(specimens)} tests is no contact law; expected power, "
            "maxwell, stulov or rate of one test (felt contact makes a table of any loop)"
        )
    pooled = pool(specimens, law, thickness=thickness) if several else None  # type: ignore[arg-type]
    fits = pooled.fits if pooled else (fit_law(specimens[0], law, thickness=thickness),)  # type: ignore[arg-type]
    if as_json:
        every: list[LawFit | PooledLaw] = [*fits, *filter(None, [pooled])]
        print_json([_law_json(one) for one in every])
    else:
        _print_laws(fits, pooled)
    warn([note for test in specimens for note in test.notes])
    save_text(out, fits[0].to_toml, force=force)


def _law_json(one: LawFit | PooledLaw) -> dict[str, Any]:
    keys = ("name", "law", "values", "interval", "rms", "relative", "undetermined", "warnings")
    made = {key: getattr(one, key) for key in keys if hasattr(one, key)}
    if hasattr(one, "scatter"):
        made |= {key: getattr(one, key).tolist() for key in ("compression", "force", "scatter")}
    return made


def _print_laws(fits: Sequence[LawFit], pooled: PooledLaw | None) -> None:
    from feltmb.felt.laws import UNITS

    rows: list[Sequence[str]] = []
    every: list[LawFit | PooledLaw] = [*fits, *filter(None, [pooled])]
    for one in every:
        name = getattr(one, "name", "all specimens")
        for key, value in one.values.items():
            low, high = one.interval.get(key, (math.nan, math.nan))
            ends = ("given", "") if math.isnan(low) else (f"{low:.4g}", f"{high:.4g}")
            if key in getattr(one, "undetermined", ()):
                ends = ("undetermined", "")
            rows.append((name, key, UNITS.get(key, "-"), f"{value:.5g}", *ends))
            name = ""
    show(
        f"Law {fits[0].law}, intervals of 95 %",
        "test | parameter | unit | >value | >from | >to",
        rows,
    )
    for fit in fits:
        say(f"{fit.name}: off by {fit.rms:.4g} N rms, typically {100 * fit.relative:.3g} %")
    if pooled is not None:
        show(
            "Scatter between specimens",
            ">compression [mm] | >force of the law [N] | >± [N] | >± [%]",
            [
                (f"{1e3 * e:.4g}", f"{f:.4g}", f"{s:.2g}", f"{100 * s / f:.3g}")
                for e, f, s in zip(pooled.compression, pooled.force, pooled.scatter, strict=True)
            ],
        )
    warn([f"{fit.name}: {text}" for fit in fits for text in fit.warnings])


@declare("bulk", felt, "Density, area weight, porosity, fineness and volume fraction of a felt.")
def bulk_command(
    v_f: float | None = option("Volume fraction [-].", FRACTION),
    density: float | None = option("Density, such as 200kg/m3.", positive("kg/m^3")),
    porosity: float | None = option("Share of the volume without fibers.", FRACTION),
    area_weight: float | None = option("Mass per area, such as 800g/m2.", positive("kg/m^2")),
    thickness: float | None = option("Thickness without load, such as 6mm.", positive("m")),
    diameter: float | None = option("Diameter of the fibers, such as 25um.", positive("m")),
    fineness: float | None = option("Fineness of the fibers, such as 6dtex.", positive("kg/m")),
    fiber_density: float = option("Density of the fibers.", positive("kg/m^3"), "1310kg/m3"),
    *,
    as_json: bool,
) -> None:
    """Print all numbers of a felt from those that are known, such as its density."""
    from feltmb.felt import bulk

    made = bulk(
        v_f=v_f, density=density, porosity=porosity, area_weight=area_weight, thickness=thickness,
        diameter=diameter, fineness=fineness, fiber_density=fiber_density,
    )  # fmt: skip
    if as_json:
        print_json(made)
        return
    units = {
        "v_f": ("-", 1.0), "density": ("kg/m^3", 1.0), "porosity": ("-", 1.0),
        "area_weight": ("g/m^2", 1e3), "thickness": ("mm", 1e3), "diameter": ("um", 1e6),
        "fineness": ("dtex", 1e7), "fiber_density": ("kg/m^3", 1.0),
    }  # fmt: skip
    show(
        "Felt without load",
        "number | unit | >value",
        [
            (name, unit, f"{factor * value:.5g}")
            for name, (unit, factor) in units.items()
            if (value := made.get(name)) is not None
        ],
    )


@declare("fmu", felt, "Export LAW as a co-simulation unit (FMI): compression in, force out.")
def fmu_command(
    law: str = argument(complete=packaged("", "felts")),
    settings: tuple[str, ...] = SET,
    out: Path = option("The unit (.fmu).", metavar="FILE", required=True),
    fmi: Literal["3.0", "2.0"] = option(
        "Version of the interface.", click.Choice(["3.0", "2.0"]), "3.0"
    ),
    parameters: tuple[str, ...] = option(
        "Numbers that become parameters, such as law.kappa; default: all.",
        words="--parameter",
        metavar="PATTERN",
    ),
    force: bool = FORCE,
) -> None:
    """Export LAW as a co-simulation unit: a contact (steinway45:04), an envelope, or a law.

    LAW may be a file of `felt law`, `felt contact` or `felt envelope`. Inputs are compression [m]
    and rate [m/s], outputs are force [N] and energy [J]. The binary needs no Python.
    """
    from feltmb.run.fmu import export_felt

    name, found = _one_law(law, settings)
    written = export_felt(
        found,
        out,
        name=name,
        version=fmi,
        parameters=parameters or "*",
        force=force,
    )
    say_written(written)


def _one_law(law: str, settings: tuple[str, ...]) -> tuple[str, Any]:
    """A law that another program can have, and its name."""
    from feltmb.felt import FeltEnvelope, FeltMaterial, audit_targets
    from unmodeled.errors import InvalidParameter

    [(name, item)] = audit_targets(law, settings, all_hint="", notify=complain)
    if isinstance(item, FeltMaterial):
        raise InvalidParameter(
            f"{law} is a felt without a thickness and an area, expected a law; hint: feltmb felt "
            f"envelope {law} --thickness 6mm --area constant:1cm2 -o envelope.toml"
        )
    return name, item.law() if isinstance(item, FeltEnvelope) else item


@declare("c", felt, "Export LAW for C: its text, a compiled library, its header.")
def c_command(
    law: str = argument(complete=packaged("", "felts")),
    settings: tuple[str, ...] = SET,
    out: Path = option("Folder of the three files.", FolderName(), required=True),
    force: bool = FORCE,
) -> None:
    """Export LAW for programs that call C, such as MATLAB, Julia and Modelica.

    LAW is as for `felt fmu`. The folder gets felt.txt (the law), feltmb_felt.h and the compiled
    library, which needs neither Python nor a C++ compiler.
    """
    from feltmb.run.c_library import export_felt_c

    export_felt_c(_one_law(law, settings)[1], out, force=force)
    say_written(out)
    say(f"a program: cc -I {out} program.c -L {out} -lfeltmb_felt -Wl,-rpath,{out} -o program")


# --- felts from loops ----------------------------------------------------------------------------


@declare("identify", felt, "Identify a felt from the measured loop in TEST.")
def identify_command(
    test: Path = argument(FILE),
    material: str = option(
        "Felt (name or TOML file) whose fiber data are used.",
        metavar="NAME",
        complete=felts,
        required=True,
    ),
    out: Path | None = option("Identified felt, TOML.", FileName(".toml")),
    folder: Path | None = option(
        "Folder for the report and its pictures.", FolderName(), words="--plot"
    ),
    v_f0: float | None = option(
        "Volume fraction without load [-]; default: that of the felt.", FRACTION
    ),
    thickness: float | None = option(
        "Thickness without load [m], such as 6mm, for thickness data; default: estimated.",
        positive("m"),
    ),
    area: float | None = option(
        "Area of the sample [m^2], such as 4cm2, for force data.", positive("m^2")
    ),
    zero: float | None = ZERO,
    read: TestFile = TEST,
    relative: float = option(
        "Factor r of the weight 1/(1 + r P/P_max) of a sample [-]; 0: equal weights.",
        Number(0.0, 1e3),
        0.0,
    ),
    level: float = option("Confidence [-].", FRACTION, 0.95),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Identify a felt from the loading-unloading loop in TEST, a CSV with units in its header.

    Columns: one of "v_f [-]", "strain [%]", "thickness [mm]", "displacement [mm]"; one of
    "pressure [kPa]", "force [N]"; optionally "branch" with loading and unloading.
    """
    from feltmb.felt import identify, load_material
    from feltmb.felt.plot import plot_identification
    from feltmb.fiber import read_compression
    from unmodeled.files import make_folder

    report = None if folder is None else make_folder(folder) / "report.md"
    image = None if folder is None else folder / "identification.png"
    check_targets(out, report, pictures=(image,), force=force)
    base = load_material(material)
    data = read_compression(
        test,
        v_f0=base.v_f0 if v_f0 is None else v_f0,
        thickness0=thickness,
        area=area,
        zero=zero,
        **read.reading,
    )
    name = out.stem if out is not None else test.stem
    result = identify(data, material=base, relative=relative, level=level, name=name)
    if as_json:
        print_json(_identification_json(result, level))
    else:
        _print_identification(result, level)
        if v_f0 is None:
            say(f"v_f0 = {base.v_f0:g}, that of {material} (--v-f0)")
        measured = finite(result.measured_loss)
        samples = "" if measured is None else f"; of the samples: {100 * measured:.2f} %"
        say(f"loss of the loop: {100 * result.material.loss():.2f} % of the loading work{samples}")
        warn(result.warnings)
    save_text(out, result.material.to_toml, force=force)
    save_figure(image, lambda: plot_identification(result), force=force)
    text = result.report() + "\n![Identification](identification.png)\n"
    save_text(report, text, force=force)


def _identification_json(result: Identification, level: float) -> dict[str, Any]:
    return {
        "name": result.name,
        "level": level,
        "loss": result.material.loss(),
        "measured_loss": finite(result.measured_loss),
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


def _print_identification(result: Identification, level: float) -> None:
    rows: list[Sequence[str]] = []
    for b in (result.loading, result.unloading):
        for key, title in (("K_p", "K_p [Pa]"), ("gamma", "gamma")):
            fit = f"{b.r_squared:.5f}" if key == "K_p" else ""
            low, high = b.interval[key]
            value = f"{getattr(b, key):.5g}"
            rows.append((b.which, title, value, f"{low:.5g}", f"{high:.5g}", fit))
    if result.thickness is not None:
        span = result.thickness_interval
        ends = ("given", "") if span is None else [f"{1e3 * x:.5g}" for x in span]
        rows.append(("both", "thickness [mm]", f"{1e3 * result.thickness:.5g}", *ends))
    title = f"Identified from {result.name}, interval of {100 * level:g} %"
    show(title, "branch | parameter | >value | >from | >to | >R^2", rows)


@declare("fit", felt, "Find a felt whose layer has the loop of ACTION:CONTACT.")
def fit_command(
    contact: str = argument(complete=actions, metavar="ACTION:CONTACT"),
    area: str = option(
        "Area of the contact, as in `felt envelope`.", metavar="LAW:NUMBERS", required=True
    ),
    fibers: str = option(
        "Felt (name or TOML file) whose fiber data and v_f0 are used.",
        metavar="NAME",
        complete=felts,
        required=True,
    ),
    thickness: float | None = option(
        "Thickness without load [m], such as 3mm; default: fitted with gamma = pi/2.",
        positive("m"),
    ),
    friction: float = option(
        "Share of friction at half the largest force, loading.", Number(0, 1, max_open=True), 0.1
    ),
    settings: tuple[str, ...] = SET,
    out: Path | None = TOML,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Find a felt whose layer has the loop of a contact, such as steinway45:06.

    Area and thickness convert force and compression of the contact to pressure and volume fraction.
    For a specimen with measured pressure use identify.
    """
    from feltmb.felt import audit_targets, contact_loop, fit_contact, load_material, parse_area

    check_targets(out, force=force)
    ((name, item),) = audit_targets(contact, settings, all_hint="", notify=complain)
    made = fit_contact(
        *contact_loop(item, name=name),
        parse_area(area),
        fibers=load_material(fibers),
        thickness=thickness,
        friction_share=friction,
        name=out.stem if out is not None else name.replace(":", "_"),
        about=f"Felt fitted to the loop of {name}; fibers of {fibers}",
    )
    if as_json:
        print_json(_fit_json(name, made))
    else:
        material = made.material
        show(
            f"Felt of {name}, {made.thickness * 1e3:.4g} mm thick",
            "branch | >K_p [Pa] | >gamma | >left over",
            [
                (which, f"{branch.K_p:.5g}", f"{branch.gamma:.4g}", f"{100 * rms:.2f} %")
                for which, branch, rms in (
                    ("loading", material.loading, made.rms_loading),
                    ("unloading", material.unloading, made.rms_unloading),
                )
                if branch is not None
            ],
        )
        say(
            f"withdrawal force {material.fiber.withdrawal_force:.4g} N/m, friction "
            f"{100 * made.friction_share:.3g} % of the pressure at half the largest force"
        )
        warn(made.warnings)
    save_text(out, made.material.to_toml, force=force)


def _fit_json(name: str, made: ContactFit) -> dict[str, Any]:
    material = made.material
    assert material.loading is not None
    assert material.unloading is not None
    return {
        "contact": name,
        "thickness": made.thickness,
        "rms_loading": made.rms_loading,
        "rms_unloading": made.rms_unloading,
        "friction_share": made.friction_share,
        "v_f_max": material.end,
        "loading": material.loading.model_dump(),
        "unloading": material.unloading.model_dump(),
        "withdrawal_force": material.fiber.withdrawal_force,
        "warnings": list(made.warnings),
    }


# --- audit ---------------------------------------------------------------------------------------


@declare("audit", felt, "Audit LAW: a contact, a felt, an envelope, or all contacts.")
def audit_command(
    law: str = argument(complete=packaged("", "felts")),
    everything: bool = option("Audit all contacts of the mechanism LAW.", words="--all"),
    settings: tuple[str, ...] = SET,
    largest: float | None = option(
        "End of the audit of a law without a loop [m], such as 1mm.", positive("m")
    ),
    folder: Path | None = option(
        "Folder for one picture of each law.", FolderName(), words="--plot"
    ),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Audit LAW: a contact (steinway45:04), a felt, an envelope, or --all contacts of a mechanism.

    The audit reports valid window, crossing, adhesion, created energy, loss against amplitude and
    frequency, and stiffness.
    """
    from feltmb.felt import audit, audit_targets
    from feltmb.felt.plot import plot_audit
    from unmodeled.files import check_writable, make_folder

    if everything and ":" in law:
        raise click.UsageError(f"--all is for all contacts of a mechanism; {law} is one of them")
    targets = audit_targets(law, settings, everything=everything, notify=complain)
    images: dict[str, Path] = {}
    if folder is not None:
        make_folder(folder)
        for name, _ in targets:
            images[name] = folder / f"audit_{Path(name).stem.replace(':', '_')}.png"
            check_writable(images[name], force=force)
    results = [audit(item, name=name, largest=largest) for name, item in targets]
    if as_json:
        print_json([r.to_dict() for r in results])
    elif len(results) == 1:
        _print_audit(results[0])
    else:
        _print_audits(law, results)
    for r in results:
        save_figure(images.get(r.name), lambda r=r: plot_audit(r), force=force)  # type: ignore[misc]


def _print_audit(result: Audit) -> None:
    say(f"{result.name}: {result.about or result.law} (law {result.law})")
    if result.closing is not None:
        say(f"  loop ends at {result.closing * 1e3:.4g} mm")
    if result.window is None:
        say("  valid window: none")
    else:
        say(f"  valid window: {result.window[0] * 1e3:.4g} to {result.window[1] * 1e3:.4g} mm")
    for branch, (low, high) in result.stiffness_range.items():
        say(f"  tangent stiffness, {branch}: {low * 1e-3:.4g} to {high * 1e-3:.4g} N/mm")
    for f in result.findings:
        say(f"  {f.kind}: {f.text}")
    if not result.findings:
        say("  no faults")
    frequencies = sorted({c.frequency for c in result.cycles})
    rows = []
    for amplitude in sorted({c.amplitude for c in result.cycles}):
        row = [c for c in result.cycles if c.amplitude == amplitude]
        losses = (f"{100 * c.loss:.2f} ({100 * c.first_loss:.2f})" for c in row)
        rows.append([f"{amplitude * 1e3:.4g} mm", *losses])
    heads = " | ".join(["amplitude", *(f">{f:g} Hz" for f in frequencies)])
    show("Loss of the second cycle, in brackets of the first [%]", heads, rows)


def _print_audits(law: str, results: Sequence[Audit]) -> None:
    def short(r: Audit) -> str:
        return r.name.partition(":")[2] or r.name

    rows = []
    for r in results:
        full = {c.frequency: c for c in r.cycles if c.amplitude == r.cycles[-1].amplitude}
        window = "none"
        if r.window is not None:
            window = f"{r.window[0] * 1e3:.3f} - {r.window[1] * 1e3:.3f}"
        kinds = {f.kind for f in r.findings} & {"crossing", "adhesion", "softening", "open"}
        rows.append(
            (
                short(r),
                window,
                "-" if r.closing is None else f"{r.closing * 1e3:.3f}",
                f"{100 * full[0.03].loss:.2f} %",
                f"{100 * full[30.0].loss:.2f} %",
                ", ".join(sorted(kinds)) or "sound",
                "sound" if r.law_is_sound else "unsound",
            )
        )
    show(
        f"Audit of {law}: contact law {', '.join(sorted({r.law for r in results}))}",
        "no. | >window [mm] | >loop to | >loss, 0.03 Hz | >30 Hz | data | law",
        rows,
    )
    for r in results:
        for f in r.findings:
            say(f"{short(r)} {f.kind}: {f.text}")
