"""``feltmb stroke`` and ``demo``: simulate strokes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.completing import actions, actuators, strokes
from feltmb.cli.settings import SET, load_with_settings
from feltmb.errors import IntegrationError
from unmodeled.cli.options import (
    FORCE,
    FolderName,
    Number,
    argument,
    count,
    declare,
    fields_of,
    is_given,
    option,
    pairs,
    parse_option,
    positive,
)
from unmodeled.cli.screen import (
    complain,
    console,
    is_terminal,
    pretty,
    print_json,
    say,
    say_written,
    table,
    warn,
)
from unmodeled.errors import Error

if TYPE_CHECKING:
    from feltmb.mechanism import Action
    from feltmb.run.options import RunOptions
    from feltmb.run.results import Run
    from feltmb.run.stroke import Stroke


@dataclass(frozen=True)
class Finger:
    """Actuator that presses the key."""

    actuator: str | None = option(
        "Actuator that presses the key: wood, aluminum, or a file.",
        complete=actuators,
        metavar="NAME",
    )
    damper: str | None = option(
        "Damper of the actuator: none, dashpot, one-sided; C in N m s/rad, default the thesis's.",
        metavar="KIND[=C]",
    )
    pad: str | None = option(
        "Pad of the finger of the actuator: pulp (default) or felt.", metavar="NAME"
    )
    torques: tuple[str, ...] = option(
        "Torque of its motor by time, CSV or TOML; default: that of the actuator.",
        words="--torque",
        metavar="FILE",
    )

    def at(self, action: Action) -> tuple[Action, list[Stroke]]:
        """The action with the actuator at its key, and the torque of the actuator."""
        from feltmb.action.actuator import compose, load_actuator

        if self.actuator is None:
            if self.damper or self.pad or self.torques:
                raise click.UsageError("--damper, --pad and --torque need --actuator")
            return action, []
        made = load_actuator(self.actuator)
        if self.damper is not None:
            made = made.with_damper(*parse_damper(self.damper))
        return compose(action, made, pad=self.pad), [made.torque]


@dataclass(frozen=True)
class Target:
    """Files of the results."""

    out: Path | None = option(
        "Output file: .nc or .h5 (all data) or .csv (the outputs over time). With several "
        "strokes: folder for the files STROKE.nc."
    )
    resume: bool = option(
        "Keep the runs in --out that have the same inputs. An interrupted command thus continues."
    )
    plot: bool = option("Also draw plots beside --out (or here).")
    wav: bool = option("Also write the string as WAV beside --out (or here).")
    force: bool = FORCE

    def of(self, stems: list[str]) -> list[Path | None]:
        """File of each stroke."""
        from unmodeled.files import check_folder, check_suffix, make_folder

        if self.out is None:
            return [None] * len(stems)
        if len(stems) == 1 and self.out.suffix:
            check_suffix(self.out, ".nc", ".h5", ".csv")
            return [self.out]
        check_folder(self.out)
        make_folder(self.out)
        return [self.out / f"{stem}.nc" for stem in stems]

    def output_rate(self, duration: float) -> float:
        """Samples per second without --output-rate [Hz]."""
        from feltmb.run.options import RunOptions

        if not self.plot:
            return RunOptions.output_rate
        from feltmb.graphics.plot import picture_rate

        return picture_rate(duration, RunOptions.output_rate)


@dataclass
class Job:
    """A stroke that is simulated, and where its results are written."""

    stroke: Stroke
    stem: str
    file: Path | None
    options: RunOptions
    inputs: str
    """Hash of everything that determines the run."""
    kept: Run | None = None
    """Finished run of an earlier command."""

    @property
    def beside(self) -> tuple[Path, str]:
        """Folder and beginning of the names of pictures and sound."""
        return (Path(), self.stem) if self.file is None else (self.file.parent, self.file.stem)

    def files(self, target: Target) -> list[Path]:
        """All files that may be written."""
        folder, stem = self.beside
        files = [self.file] if self.file is not None else []
        if target.plot:
            from feltmb.graphics.plot import PICTURES

            files += [folder / f"{stem}_{picture}.png" for picture in PICTURES]
        return [*files, folder / f"{stem}.wav"] if target.wav else files

    def find_kept(self) -> None:
        """Load the finished run with the same inputs, if there is one."""
        from feltmb.run.results import load_run
        from unmodeled.files import is_file

        if self.file is None or self.file.suffix == ".csv":
            raise click.UsageError("--resume needs --out with the name of a folder or a .nc file")
        if is_file(self.file):
            run = load_run(self.file)
            if run.status == "done" and run.provenance.get("inputs") == self.inputs:
                self.kept = run


@declare("stroke")
def command(
    action: str = argument(complete=actions),
    strokes: tuple[str, ...] = argument(complete=strokes, required=False),
    settings: tuple[str, ...] = SET,
    finger: Finger = fields_of("feltmb.cli.stroke:Finger"),
    target: Target = fields_of("feltmb.cli.stroke:Target"),
    options: RunOptions = fields_of(
        "feltmb.run.options:RunOptions",
        duration={"type": positive("s")},
        rtol={"type": Number(1e-13, 1e-2)},
        error={"type": Number(0, 0.1, min_open=True)},
        method={"type": click.Choice(["auto", "cvode", "modal"])},
        output_rate={
            "type": positive("Hz"),
            "default": None,
            "text": "Samples per second [Hz]; default: 10000, with --plot 40000 (runs longer than "
            "5 s fewer).",
        },
        max_wall={"type": positive("s")},
        ledger_limit={"type": Number(0, min_open=True)},
        ledger={"text": "Omit the energy ledger (faster)."},
    ),
    start: Path | None = option(
        "Start at the end of this saved run.",
        click.Path(path_type=Path, exists=True, dir_okay=False),
    ),
    initial: tuple[str, ...] = option(
        "Initial value of a coordinate or speed that differs from the rest pose, such as x=-5mm or "
        "x.rate=2m/s; a bare number is in SI units.",
        metavar="NAME=VALUE",
    ),
    noise: str | None = option(
        'Standard deviation of the noise of measured strokes, such as "2 um"; the strokes are '
        "smoothed within it.",
        metavar="LENGTH",
    ),
    jobs: int = option("Number of parallel strokes.", count(1, 256), 1),
    *,
    as_json: bool,
) -> None:
    """Simulate ACTION under one or more STROKES.

    ACTION is a packaged mechanism or a TOML file. A STROKE is a packaged name, a TOML file or a
    CSV with the header "time [s],force [N]"; instead of force: displacement (of the finger), key
    displacement, torque, motor angle. See: feltmb list.
    """
    from feltmb.run.results import load_run
    from feltmb.run.simulate import initial_values, simulate
    from feltmb.run.stroke import load_stroke

    if options.error is not None and is_given("rtol"):
        raise click.UsageError("--error chooses the tolerance: give --rtol or --error, not both")
    if start is not None and initial:
        raise click.UsageError("--start and --initial both give the start state")
    mechanism, own = finger.at(load_with_settings(action, settings))
    loaded = [load_stroke(s) for s in (*strokes, *finger.torques)] or own
    if not loaded:
        raise click.UsageError("Missing argument 'STROKES...'.")
    if noise is not None:
        loaded = [s.smoothed(parse_option("--noise", noise, s.unit)) for s in loaded]
    begin = pairs("--initial", initial, "NAME=VALUE")
    initial_values(mechanism, begin)
    made = _jobs(mechanism, loaded, options, target, (start, begin))
    first = load_run(start) if start is not None else begin or None
    results = Results(target, quiet=as_json)

    def one(job: Job) -> tuple[Run, str]:
        if job.kept is not None:
            return job.kept, ""
        progress = (lambda _t: not results.stopped) if jobs > 1 else None
        try:
            run = simulate(
                mechanism, job.stroke, options=job.options, start=first, progress=progress
            )
        except IntegrationError as failure:
            return failure.partial, str(failure)
        run.provenance["inputs"] = job.inputs
        return run, ""

    _run_all(made, one, results, jobs)
    if as_json:
        print_json(results.summaries)
    if results.failures:
        for failure in results.failures[:-1]:
            complain(failure)
        raise Error(results.failures[-1])


def _jobs(
    action: Action,
    strokes: Sequence[Stroke],
    options: RunOptions,
    target: Target,
    begin: tuple[Path | None, Mapping[str, str]],
) -> list[Job]:
    """The strokes with their files and options; all files are checked."""
    from unmodeled.files import check_writable

    stems = _stems([s.name for s in strokes])
    made = []
    for stroke, stem, file in zip(strokes, stems, target.of(stems), strict=True):
        own = options
        if not is_given("output_rate"):
            rate = target.output_rate(options.duration or stroke.duration)
            own = replace(options, output_rate=rate)
        made.append(Job(stroke, stem, file, own, _inputs(action, stroke, own, *begin)))
        if target.resume:
            made[-1].find_kept()
    for job in made:
        for path in job.files(target) if job.kept is None else []:
            check_writable(path, force=target.force)
    return made


class Results:
    """Prints and saves each run as it is finished."""

    def __init__(self, target: Target, *, quiet: bool) -> None:
        self.target, self.quiet = target, quiet
        self.stopped = False
        self.failures: list[str] = []
        self.summaries: dict[str, Any] = {}
        self.screen = console()

    def add(self, job: Job, run: Run, failure: str) -> None:
        """Print and save a run."""
        name, force = job.stroke.name, self.target.force
        if failure:
            self.failures.append(f"{name}: {failure}")
        if job.kept is not None:
            say(f"kept {job.file}", err=True)
        elif job.file is not None:
            say_written(run.save(job.file, force=force))
        found = {key: getattr(run, key) for key in ("status", "summary", "energy", "stats")}
        several = {"strikes": run.strike_list} if len(run.strike_list) > 1 else {}
        self.summaries[job.stem] = found | several
        if not self.quiet:
            for table in (*strike_tables(run, name), summary_table(run, name)):
                self.screen.print(table)
        warn(run.stats["warnings"], name)
        try:
            self._draw(job, run, force=force or job.kept is not None)
        except Exception as fault:  # the saved run stays valid
            kind = "" if isinstance(fault, Error) else f"{type(fault).__name__}: "
            self.failures.append(f"{name}: no picture or sound: {kind}{fault}")

    def _draw(self, job: Job, run: Run, *, force: bool) -> None:
        folder, stem = job.beside
        if self.target.plot:
            from feltmb.graphics.plot import save_all

            for path in save_all(run, folder, stem, force=force):
                say_written(path)
        if self.target.wav:
            say_written(run.write_wav(folder / f"{stem}.wav", force=force))


def _run_all(made: Sequence[Job], one: Any, results: Results, jobs: int) -> None:
    """Simulate all strokes, several at a time, and print them in their order."""
    with ThreadPoolExecutor(max_workers=min(jobs, len(made))) as pool:
        waiting: list[Future[tuple[Run, str]]] = []
        done = 0
        try:
            for job in made if jobs > 1 else ():
                try:
                    waiting.append(pool.submit(one, job))
                except RuntimeError as refused:
                    raise Error(
                        f"--jobs {jobs}: no thread could be started ({refused}); use --jobs 1"
                    ) from None
            for i, job in enumerate(made):
                result = waiting[i].result() if waiting else one(job)
                done = i + 1
                results.add(job, *result)
        except BaseException:
            # Results that other threads have finished are saved.
            results.stopped = True
            for job, future in list(zip(made, waiting, strict=False))[done:]:
                if not future.cancel() and future.exception() is None:
                    results.add(job, *future.result())
            raise


def _inputs(
    action: Action,
    stroke: Stroke,
    options: RunOptions,
    start: Path | None,
    initial: Mapping[str, str],
) -> str:
    """Hash of everything that determines a run."""
    from unmodeled.files import LARGEST_FILE, digest_of, package_digest, read_input

    first = None if start is None else read_input(start, most=LARGEST_FILE)
    numbers = asdict(replace(options, max_wall=None, ledger_limit=None))
    return digest_of(
        package_digest("feltmb"), action.hash, stroke.as_dict(), numbers, first, initial
    )


def parse_damper(text: str) -> tuple[str, float | None]:
    """Kind and coefficient [N m s/rad] from ``--damper one-sided=0.05``."""
    kind, sign, value = text.partition("=")
    return kind.strip(), parse_option("--damper", value, "N m s/rad") if sign else None


def _stems(names: list[str]) -> list[str]:
    """File names for strokes: none leads to another folder, and none is used twice."""
    plain = [re.sub(r"[^\w ,.+-]", "_", name).strip(" .")[:100] or "stroke" for name in names]
    stems: list[str] = []
    for i, stem in enumerate(plain):
        number = i + 1
        unique = stem if plain.count(stem) == 1 else f"{stem}_{number}"
        while unique in stems or (unique != stem and unique in plain):
            number += 1
            unique = f"{stem}_{number}"
        stems.append(unique)
    return stems


# --- tables --------------------------------------------------------------------------------------

#: Strikes in a table, which then fits a screen of 80 characters.
SIDE_BY_SIDE = 4


def strike_tables(run: Run, title: str) -> list[Any]:
    """Tables of a run with several strikes, one column for each; else none."""
    strikes = run.strike_list
    if len(strikes) < 2:
        return []
    rows = _strike_rows(run)
    tables = []
    for first in range(0, len(strikes), SIDE_BY_SIDE):
        part = strikes[first : first + SIDE_BY_SIDE]
        heads = " | ".join(f">{first + i + 1}" for i in range(len(part)))
        head = f"{title}: {run.provenance['action']}: {len(strikes)} strikes"
        made = table(head, f"strike | {heads} | unit")
        for key, (text, unit) in rows.items():
            cells = _strike_cells(part, key, unit)
            if cells:
                made.add_row(text, *cells)
        tables.append(made)
    return tables


def _strike_rows(run: Run) -> dict[str, tuple[str, str]]:
    """Text and unit of the numbers of a strike, in the order of their times."""
    from feltmb.run.reading import strike_words, summary_rows

    words = strike_words(run)
    # The exact largest force is that of the run.
    sampled = {"max_impact_force": ("sampled_impact_force", " (samples)")}
    rows = {
        sampled.get(key, (key, ""))[0]: (text + sampled.get(key, (key, ""))[1], unit)
        for key, (text, unit) in summary_rows(run).items()
    }
    rows |= {key: (words[key], "s") for key in ("check_end_time", "key_return_time")}
    # Times in the order of their means after the impact; other numbers stay behind their time.
    late = 0.0
    order = {}
    for key in rows:
        if key.endswith("_time"):
            after = [s[key] - s["impact_time"] for s in run.strike_list if key in s]
            late = sum(after) / len(after) if after else late
        order[key] = late
    return {key: rows[key] for key in sorted(rows, key=order.__getitem__)}


def _strike_cells(strikes: Sequence[Mapping[str, float]], key: str, unit: str) -> list[str]:
    """A number of each strike, and its unit; empty if no strike has it."""
    from feltmb.run.results import let_off_words
    from unmodeled.units import readable_unit

    values = [strike.get(key) for strike in strikes]
    why = ["" for _ in strikes]
    if key == "let_off_time":
        words = [let_off_words(s) for s in strikes]
        why = ["thrown" if w.endswith("thrown off") else w and "none" for w in words]
    if not any(why) and all(value is None for value in values):
        return []
    # One unit for a row: that of its largest value.
    largest = max((abs(v) for v in values if v is not None), default=0.0)
    factor, name = (1.0, unit) if key.endswith("_time") else readable_unit(largest, unit)
    digits = ".5f" if key.endswith("_time") else ".4g"
    cells = [
        word or "-" if value is None else format(value * factor, digits)
        for value, word in zip(values, why, strict=True)
    ]
    return [*cells, name]


def summary_table(run: Run, title: str) -> Any:
    """Table of the summary of a run, with its work counts below.

    Numbers of single strikes are omitted if there are several; see :func:`strike_tables`.
    """
    from feltmb.run.reading import reading_of, row_unit

    made = table(f"{title}: {run.provenance['action']}", "| >value | unit", _summary_cells(run))
    for name, each in reading_of(run).rows.items():
        if name in run.summary:
            text = each.text or name.replace("_", " ")
            made.add_row(text, *pretty(run.summary[name], row_unit(run, name)))
    stats, energy = run.stats, run.energy
    if energy:
        made.add_row("work put in", *pretty(energy["work_in"], "J"))
        error = f"{energy['residual_relative']:.1e}"
        made.add_row("energy balance error", error, "of the exchanged energy")
        for name in energy["created_by"]:
            made.add_row(f"energy CREATED by {name}", *pretty(-energy["dissipated"][name], "J"))
    made.caption = (
        f"{stats['steps']} steps, {stats['rhs']} right-hand sides, "
        f"{1e3 * stats['wall']:.3g} ms" + (f"; {run.status}" if run.status != "done" else "")
    )
    return made


def _summary_cells(run: Run) -> Iterator[tuple[str, str, str]]:
    """Rows of a summary: events sorted by time, each with the entries that follow it."""
    from feltmb.run.reading import reading_of, summary_rows
    from feltmb.run.results import let_off_words

    words = let_off_words(run.summary)
    groups: list[tuple[float, list[tuple[str, str, str]]]] = [(-math.inf, [])]
    several = len(run.strike_list) > 1
    told = {f"{row.at}_time" for row in reading_of(run).rows.values() if row.output is None}
    for key, (text, unit) in summary_rows(run).items():
        if several and key != "max_impact_force":
            continue
        if key == "let_off_time" and words and "free_flight_time" not in run.summary:
            groups[-1][1].append((words, "none", ""))
        if key not in run.summary or key in told:
            continue
        value = run.summary[key]
        if key.endswith("_time"):
            named = words if words and key == "free_flight_time" else text
            groups.append((value, [(named, f"{value:.5f}", "s")]))
        else:
            groups[-1][1].append((text, *pretty(value, unit)))
    return chain.from_iterable(part for _, part in sorted(groups, key=lambda g: g[0]))


# --- demonstration -------------------------------------------------------------------------------

DEMO = ("piano", "forte", "staccato")


@declare("demo")
def demo(
    out: Path = option(
        "Folder for the results. Files of an earlier demo are overwritten.",
        FolderName(),
        Path("out"),
    ),
    no_animation: bool = option("Omit the animation (the slowest part)."),
    settings: tuple[str, ...] = SET,
) -> None:
    """Simulate the strokes piano, forte and staccato of steinway45.

    Prints the results with the published values, and writes NetCDF files, plots and an animation.
    """
    from feltmb.graphics.animate import animate
    from feltmb.graphics.plot import mechanism as draw
    from feltmb.graphics.plot import picture_rate, save_all
    from feltmb.graphics.viewer import view
    from feltmb.run.options import RunOptions
    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import load_stroke
    from unmodeled.files import make_folder, write_file

    action = load_with_settings("steinway45", settings)
    make_folder(out)
    screen = console()
    runs: dict[str, Run] = {}

    with _steps(2 * len(DEMO) + (1 if no_animation else 6)) as step:
        step("drawing the mechanism at rest")
        figure = draw(action)
        written = [
            write_file(out / "mechanism.png", lambda p: figure.savefig(p, dpi=150), force=True)
        ]
        for name in DEMO:
            step(f"simulating {name}")
            stroke = load_stroke(name)
            rate = picture_rate(stroke.duration, RunOptions.output_rate)
            runs[name] = simulate(action, stroke, output_rate=rate)
            written.append(runs[name].save(out / f"{name}.nc", force=True))
            step(f"plotting {name}")
            written += save_all(runs[name], out, name, force=True)
        if not no_animation:
            step("animating forte")
            written.append(animate(runs["forte"], out / "forte.gif", force=True))
            written.append(view(list(runs.values()), out / "strokes.html", force=True))

    for name, run in runs.items():
        for made in (*strike_tables(run, name), summary_table(run, name)):
            screen.print(made)
    screen.print(published_table(list(runs.values())))
    screen.print(
        "String forces and contact times are those of three strings; with the one string that the\n"
        "thesis prints they are not reached: see docs/validation/thesis.md.",
    )
    for path in written:
        say_written(path)


@contextmanager
def _steps(total: int) -> Iterator[Callable[[str], None]]:
    """Bar of progress on a terminal, else a line for each step."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console(stderr=True), disable=not is_terminal()) as bar:
        task = bar.add_task("demo", total=total)

        def step(text: str) -> None:
            done = 0 if bar.tasks[0].description == "demo" else 1
            bar.update(task, description=text, advance=done)
            if not is_terminal():
                say(text, err=True)

        yield step


def published_table(runs: list[Run]) -> Any:
    """Table of simulated and published values."""
    from feltmb.run.published import compare_with_published
    from feltmb.run.reading import summary_rows

    made = table("beside the thesis", "stroke | | >here | >thesis | unit | >differs")
    for run in runs:
        words = summary_rows(run)
        for row in compare_with_published(run):
            text = words.get(row.key, (row.key, row.unit))[0]
            published, unit = pretty(row.published, row.unit)
            here, differs = "did not happen", "-"
            if row.simulated is not None:
                here = f"{row.simulated * float(published) / row.published:.4g}"
                differs = f"{100 * (row.difference or 0.0):+.1f} %"
            made.add_row(row.stroke, text, here, published, unit, differs)
    return made
