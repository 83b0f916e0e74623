"""``feltmb fiber simulate``: fiber masses simulated bead by bead."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from feltmb.cli.common import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    Number,
    Quantity,
    caution,
    complain,
    console,
    diameter_option,
    force_option,
    modulus_option,
    positive,
    save_figure,
    say,
    say_written,
)
from feltmb.cli.fiber.group import (
    fiber,
    guard,
    print_table,
    refuse_existing,
    seed_option,
)


@fiber.command(name="simulate", short_help="Compress and release a box of single fibers.")
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
@diameter_option
@click.option(
    "--segment",
    type=positive("m"),
    default=62.5e-6,
    show_default=True,
    callback=caution("segment"),
    help="Segment length [m].",
)
@click.option(
    "--v-f", type=FRACTION, default=0.1, show_default=True, help="Initial volume fraction."
)
@click.option(
    "--v-max", type=FRACTION, default=0.3, show_default=True, help="Largest volume fraction."
)
@click.option(
    "--crimp",
    type=Quantity("rad", 0),
    default=0.3,
    show_default=True,
    help="Turning angle per bead [rad].",
)
@click.option(
    "--friction",
    type=NOT_NEGATIVE,
    default=0.35,
    show_default=True,
    help="Coefficient of friction [-].",
)
@click.option(
    "--repulsion",
    type=click.Choice(["hertz", "logarithmic"]),
    default="hertz",
    show_default=True,
    help="Repulsion between touching segments: Hertz with friction, or eq. 2.10.",
)
@modulus_option
@click.option(
    "--drag",
    type=POSITIVE,
    default=0.001,
    show_default=True,
    help="Drag rate over the stretching frequency.",
)
@click.option(
    "--strain-per-step",
    type=Number(0, 0.01, min_open=True, max_open=True),
    default=2e-5,
    show_default=True,
    help="Strain in one time step; halve it to check the result.",
)
@click.option(
    "--cycles",
    type=click.IntRange(1, 100_000),
    default=1,
    show_default=True,
    help="Number of cycles of compression and release.",
)
@seed_option
@click.option(
    "--threads",
    type=click.IntRange(0, 1024),
    default=0,
    show_default=True,
    help="Number of threads; 0: all cores.",
)
@click.option("--resume", is_flag=True, help="Continue the unfinished run OUTPUT.")
@click.option(
    "--samples",
    type=click.IntRange(1),
    help="Stop after this number of samples; the run can be resumed.",
)
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture.")
@force_option
@guard
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
    """Compress and release a box of single fibers, and write the run to OUTPUT (.npz)."""
    from feltmb.errors import InvalidParameter, ModelError
    from feltmb.fiber import Cycle, FiberBox, FiberRun
    from feltmb.fiber import simulate as run_simulation
    from feltmb.fiber.plot import plot_simulation

    if output.suffix != ".npz":
        raise InvalidParameter(f'{output}: suffix is "{output.suffix}", expected .npz')
    if threads < 0 or seed < 0:
        raise InvalidParameter(f"simulate: threads = {threads}, seed = {seed}, expected >= 0")
    if plot is not None:
        refuse_existing(plot, force)
    old = None
    if resume:
        old = FiberRun.load(output)
        box, cycle = old.box, old.cycle
    else:
        refuse_existing(output, force)
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
    print_table(
        f"{box.n_fibers} fibers, friction {box.friction:g}",
        ["branch", "v_f [-]", "P [Pa]", "contacts", "work [J]", "friction [J]", "drag [J]"],
        rows,
    )
    laid, relaxed = run.laid, run.relaxed
    say(
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
        energy = run.energy
        shares = ", ".join(
            f"{name} {100 * energy[name] / max(energy['put_in'], 1e-300):.3g} %"
            for name in ("friction", "drag")
        )
        say(
            f"loop loss {100 * run.loop_loss:.2f} %; of the work put in: {shares}\n"
            f"pressure exponent of loading: {', '.join(exponents)}"
        )
    else:
        say("unfinished; go on with --resume")
    say_written(output)
    if plot is not None:
        save_figure(plot_simulation(run), plot, force=force)
    for warning in run.warnings:
        complain(f"warning: {warning}")
    if run.status == "failed":
        raise ModelError("simulate: failed, for the reasons above; the samples so far are saved")
