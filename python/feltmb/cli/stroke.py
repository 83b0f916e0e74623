"""``feltmb stroke``: simulate strokes."""

from __future__ import annotations

import math
import re
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    Number,
    complain,
    console,
    force_option,
    json_option,
    list_option,
    load_with_settings,
    new_table,
    parse_damper,
    parse_option,
    positive,
    pretty,
    print_json,
    say,
    say_written,
    set_option,
    split_pairs,
)
from feltmb.cli.completing import actions, actuators, strokes

if TYPE_CHECKING:
    from concurrent.futures import Future

    from feltmb.mechanism import Action
    from feltmb.run.results import Run
    from feltmb.run.stroke import Stroke


@click.command("stroke")
@click.argument("action", shell_complete=actions)
@click.argument("strokes", nargs=-1, shell_complete=strokes)
@set_option
@click.option(
    "--actuator",
    shell_complete=actuators,
    metavar="NAME",
    help="Actuator that presses the key: wood, aluminum, or a file.",
)
@click.option(
    "--damper",
    metavar="KIND[=C]",
    help="Damper of the actuator: none, dashpot, one-sided; C in N m s/rad, default the thesis's.",
)
@click.option(
    "--pad", metavar="NAME", help="Pad of the finger of the actuator: pulp (default) or felt."
)
@list_option(
    "--torque",
    "torques",
    metavar="FILE",
    help="Torque of its motor by time, CSV or TOML; default: that of the actuator.",
)
@click.option(
    "--out",
    "-o",
    type=click.Path(path_type=Path),
    help="Output file: .nc or .h5 (all data) or .csv (the outputs over time). With several "
    "strokes: folder for the files STROKE.nc.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Keep the runs in --out that have the same inputs. An interrupted command thus continues.",
)
@click.option("--plot", is_flag=True, help="Also draw plots beside --out (or here).")
@click.option("--wav", is_flag=True, help="Also write the string as WAV beside --out (or here).")
@click.option(
    "--duration", type=positive("s"), help="Simulated time [s]; default: the stroke's own."
)
@click.option(
    "--rtol", type=Number(1e-13, 1e-2), default=1e-6, show_default=True, help="Relative tolerance."
)
@click.option(
    "--error",
    type=Number(0, 0.1, min_open=True),
    help="Instead of --rtol: largest error of the hammer force relative to its peak, for a strike "
    "of 50 ms on a string.",
)
@click.option(
    "--method",
    type=click.Choice(["auto", "cvode", "modal"]),
    default="auto",
    show_default=True,
    help="cvode: CVODES integrates all states; modal: the vibration of a free string is computed "
    "exactly and separately.",
)
@click.option(
    "--output-rate",
    type=positive("Hz"),
    help="Samples per second [Hz]; default: 10000, with --plot 40000 (runs longer than 5 s fewer).",
)
@click.option(
    "--max-wall",
    type=positive("s"),
    help="Stop a stroke after this wall time [s]; the simulated part is saved.",
)
@click.option(
    "--ledger-limit",
    type=Number(0, min_open=True),
    default=0.1,
    show_default=True,
    help="A run fails if the energy balance error exceeds this fraction of the exchanged energy.",
)
@click.option(
    "--start",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Start at the end of this saved run.",
)
@list_option(
    "--initial",
    "initial",
    metavar="NAME=VALUE",
    help="Initial value of a coordinate or speed that differs from the rest pose, such as "
    "x=-5mm or x.rate=2m/s; a bare number is in SI units.",
)
@click.option(
    "--noise",
    metavar="LENGTH",
    help='Standard deviation of the noise of measured strokes, such as "2 um"; the strokes are '
    "smoothed within it.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    help="Number of parallel strokes.",
)
@click.option("--no-ledger", is_flag=True, help="Omit the energy ledger (faster).")
@force_option
@json_option
def command(
    action: str,
    strokes: tuple[str, ...],
    settings: tuple[str, ...],
    actuator: str | None,
    damper: str | None,
    pad: str | None,
    torques: tuple[str, ...],
    out: Path | None,
    resume: bool,
    plot: bool,
    wav: bool,
    duration: float | None,
    rtol: float,
    error: float | None,
    method: str,
    output_rate: float | None,
    max_wall: float | None,
    ledger_limit: float,
    start: Path | None,
    initial: tuple[str, ...],
    noise: str | None,
    jobs: int,
    no_ledger: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Simulate ACTION under one or more STROKES.

    ACTION is a packaged mechanism or a TOML file. A STROKE is a packaged name, a TOML file or a
    CSV with the header "time [s],force [N]"; instead of force: displacement (of the finger), key
    displacement, torque, motor angle. See: feltmb list.
    """
    from concurrent.futures import ThreadPoolExecutor

    from feltmb.errors import FeltmbError, IntegrationError
    from feltmb.files import check_writable, make_folder
    from feltmb.run.results import load_run
    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import load_stroke

    given = click.get_current_context().get_parameter_source("rtol")
    if error is not None and given is click.core.ParameterSource.COMMANDLINE:
        raise click.UsageError("--error chooses the tolerance: give --rtol or --error, not both")
    mechanism = load_with_settings(action, settings)
    loaded = [load_stroke(s) for s in (*strokes, *torques)]
    if actuator is not None:
        mechanism, own = _with_actuator(mechanism, actuator, damper, pad)
        loaded = loaded or [own]
    elif damper or pad or torques:
        raise click.UsageError("--damper, --pad and --torque need --actuator")
    if not loaded:
        raise click.UsageError("Missing argument 'STROKES...'.")
    if start is not None and initial:
        raise click.UsageError("--start and --initial both give the start state")
    if noise is not None:
        loaded = [s.smoothed(parse_option("--noise", noise, s.unit)) for s in loaded]
    stems = _stems([s.name for s in loaded])
    targets = _targets(out, stems)
    options = [
        {
            "duration": duration,
            "rtol": rtol,
            "error": error,
            "method": method,
            "output_rate": output_rate or _output_rate(duration or s.duration, plot=plot),
            "ledger": not no_ledger,
        }
        for s in loaded
    ]
    begin = _initial(mechanism, initial)
    keys = [
        _inputs(mechanism, s, each, start, begin) for s, each in zip(loaded, options, strict=True)
    ]
    kept: dict[int, Run] = {}
    if out is not None and out not in targets:
        make_folder(out)
    if resume:
        kept = _finished(targets, keys)
    for i, (target, stem) in enumerate(zip(targets, stems, strict=True)):
        for path in _files(target, stem, plot=plot, wav=wav) if i not in kept else []:
            check_writable(path, force=force)
    first = load_run(start) if start is not None else begin or None

    stop = {"now": False}

    def one(i: int) -> tuple[Run, str]:
        if i in kept:
            return kept[i], ""
        try:
            run = simulate(
                mechanism,
                loaded[i],
                **options[i],  # type: ignore[arg-type]
                start=first,
                max_wall=max_wall,
                ledger_limit=ledger_limit,
                progress=(lambda _t: not stop["now"]) if jobs > 1 else None,
            )
        except IntegrationError as failure:
            return failure.partial, str(failure)
        run.provenance["inputs"] = keys[i]
        return run, ""

    failures: list[str] = []
    summaries: dict[str, Any] = {}
    screen = console()

    def finish(i: int, run: Run, failure: str) -> None:
        name = loaded[i].name
        if failure:
            failures.append(f"{name}: {failure}")
        target = targets[i]
        if i in kept:
            say(f"kept {target}", err=True)
        elif target is not None:
            say_written(run.save(target, force=force))
        summaries[stems[i]] = {
            "status": run.status,
            "summary": run.summary,
            "energy": run.energy,
            "stats": run.stats,
        }
        if len(run.strike_list) > 1:
            summaries[stems[i]]["strikes"] = run.strike_list
        if not as_json:
            for table in (*strike_tables(run, name), summary_table(run, name)):
                screen.print(table)
        for warning in run.stats["warnings"]:
            complain(f"warning: {name}: {warning}")
        try:
            _draw(run, target, stems[i], plot=plot, wav=wav, force=force or i in kept)
        except Exception as fault:  # the saved run stays valid
            kind = "" if isinstance(fault, FeltmbError) else f"{type(fault).__name__}: "
            failures.append(f"{name}: no picture or sound: {kind}{fault}")

    with ThreadPoolExecutor(max_workers=min(jobs, len(loaded))) as pool:
        waiting: dict[int, Future[tuple[Run, str]]] = {}
        try:
            for i in range(len(loaded) if jobs > 1 else 0):
                try:
                    waiting[i] = pool.submit(one, i)
                except RuntimeError as refused:
                    raise FeltmbError(
                        f"--jobs {jobs}: no thread could be started ({refused}); use --jobs 1"
                    ) from None
            for i in range(len(loaded)):
                result = waiting[i].result() if waiting else one(i)
                waiting.pop(i, None)
                finish(i, *result)
        except BaseException:
            # Results that other threads have finished are saved.
            stop["now"] = True
            for i, future in waiting.items():
                if not future.cancel() and future.exception() is None:
                    finish(i, *future.result())
            raise
    if as_json:
        print_json(summaries)
    if failures:
        for failure in failures[:-1]:
            complain(failure)
        raise FeltmbError(failures[-1])


def _with_actuator(
    action: Action, name: str, damper: str | None, pad: str | None
) -> tuple[Action, Stroke]:
    """The action with an actuator at its key, and the torque of the actuator."""
    from feltmb.action.actuator import compose, load_actuator

    made = load_actuator(name)
    if damper is not None:
        made = made.with_damper(*parse_damper(damper))
    return compose(action, made, pad=pad), made.torque


def _output_rate(duration: float, *, plot: bool) -> float:
    """Samples per second without --output-rate [Hz]."""
    from feltmb.run.options import RunOptions

    if not plot:
        return RunOptions.output_rate
    from feltmb.graphics.plot import picture_rate

    return picture_rate(duration, RunOptions.output_rate)


def _initial(action: Action, texts: tuple[str, ...]) -> dict[str, str]:
    """Initial values of ``--initial``, checked before anything is simulated."""
    from feltmb.run.simulate import initial_values

    found = split_pairs("--initial", texts, "NAME=VALUE")
    initial_values(action, found)
    return found


def _inputs(
    action: Action,
    stroke: Stroke,
    options: dict[str, Any],
    start: Path | None,
    initial: dict[str, str],
) -> str:
    """Hash of everything that determines a run."""
    from feltmb.files import LARGEST_FILE, digest_of, package_digest, read_input

    first = None if start is None else read_input(start, most=LARGEST_FILE)
    return digest_of(package_digest(), action.hash, stroke.as_dict(), options, first, initial)


def _finished(targets: list[Path | None], keys: list[str]) -> dict[int, Run]:
    """Finished runs with the same inputs that already exist in the targets."""
    from feltmb.files import is_file
    from feltmb.run.results import load_run

    found: dict[int, Run] = {}
    for i, (target, key) in enumerate(zip(targets, keys, strict=True)):
        if target is None or target.suffix == ".csv":
            raise click.UsageError("--resume needs --out with the name of a folder or a .nc file")
        if not is_file(target):
            continue
        run = load_run(target)
        if run.status == "done" and run.provenance.get("inputs") == key:
            found[i] = run
    return found


def _targets(out: Path | None, stems: list[str]) -> list[Path | None]:
    from feltmb.files import check_folder, check_suffix

    if out is None:
        return [None] * len(stems)
    if len(stems) == 1 and out.suffix:
        check_suffix(out, ".nc", ".h5", ".csv")
        return [out]
    check_folder(out)
    return [out / f"{stem}.nc" for stem in stems]


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


def _files(target: Path | None, stem: str, *, plot: bool, wav: bool) -> list[Path]:
    """All files that may be written for one stroke."""
    folder, stem = (target.parent, target.stem) if target is not None else (Path(), stem)
    files = [target] if target is not None else []
    if plot:
        from feltmb.graphics.plot import PICTURES

        files += [folder / f"{stem}_{picture}.png" for picture in PICTURES]
    if wav:
        files.append(folder / f"{stem}.wav")
    return files


def _draw(run: Run, target: Path | None, stem: str, *, plot: bool, wav: bool, force: bool) -> None:
    folder, stem = (target.parent, target.stem) if target is not None else (Path(), stem)
    if plot:
        from feltmb.graphics.plot import save_all

        for path in save_all(run, folder, stem, force=force):
            say_written(path)
    if wav:
        say_written(run.write_wav(folder / f"{stem}.wav", force=force))


#: Strikes in a table, which then fits a screen of 80 characters.
SIDE_BY_SIDE = 4


def strike_tables(run: Run, title: str) -> list[Any]:
    """Tables of a run with several strikes, one column for each; else none."""
    from feltmb.run.reading import strike_words, summary_rows
    from feltmb.run.results import let_off_words
    from feltmb.units import readable_unit

    strikes = run.strike_list
    if len(strikes) < 2:
        return []
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
            after = [s[key] - s["impact_time"] for s in strikes if key in s]
            late = sum(after) / len(after) if after else late
        order[key] = late
    rows = {key: rows[key] for key in sorted(rows, key=order.__getitem__)}
    tables = []
    for first in range(0, len(strikes), SIDE_BY_SIDE):
        part = strikes[first : first + SIDE_BY_SIDE]
        heads = [f"{first + i + 1}" for i in range(len(part))]
        head = f"{title}: {run.provenance['action']}: {len(strikes)} strikes"
        table = new_table(head, "strike", *heads, "unit", right=tuple(range(1, len(part) + 1)))
        for key, (text, unit) in rows.items():
            values = [strike.get(key) for strike in part]
            if key == "let_off_time":
                # "no let-off: pushed to the string" is the cell "pushed".
                why = [
                    let_off_words(s).removeprefix("no let-off: ").partition(" ")[0] for s in part
                ]
            else:
                why = ["" for _ in part]
            if not any(why) and all(value is None for value in values):
                continue
            # One unit for a row: that of its largest value.
            largest = max((abs(v) for v in values if v is not None), default=0.0)
            factor, name = (1.0, unit) if key.endswith("_time") else readable_unit(largest, unit)
            digits = ".5f" if key.endswith("_time") else ".4g"
            cells = [
                word or "-" if value is None else format(value * factor, digits)
                for value, word in zip(values, why, strict=True)
            ]
            table.add_row(text, *cells, name)
        tables.append(table)
    return tables


def summary_table(run: Run, title: str) -> Any:
    """Table of the summary of a run, with its work counts below.

    Numbers of single strikes are omitted if there are several; see :func:`strike_tables`.
    """
    from feltmb.run.reading import reading_of, row_unit, summary_rows
    from feltmb.run.results import let_off_words

    table = new_table(f"{title}: {run.provenance['action']}", "", "value", "unit", right=(1,))
    words = let_off_words(run.summary)
    # Events are sorted by time; entries after an event in the list stay after it.
    groups: list[tuple[float, list[tuple[str, str, str]]]] = [(-math.inf, [])]
    several = len(run.strike_list) > 1
    rows = reading_of(run).rows
    told = {f"{row.at}_time" for row in rows.values() if row.output is None}
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
    for cells in chain.from_iterable(part for _, part in sorted(groups, key=lambda g: g[0])):
        table.add_row(*cells)
    for name, each in rows.items():
        if name in run.summary:
            text = each.text or name.replace("_", " ")
            table.add_row(text, *pretty(run.summary[name], row_unit(run, name)))
    stats = run.stats
    if run.energy:
        table.add_row("work put in", *pretty(run.energy["work_in"], "J"))
        table.add_row(
            "energy balance error",
            f"{run.energy['residual_relative']:.1e}",
            "of the exchanged energy",
        )
        for name in run.energy["created_by"]:
            table.add_row(
                f"energy CREATED by {name}", *pretty(-run.energy["dissipated"][name], "J")
            )
    table.caption = (
        f"{stats['steps']} steps, {stats['rhs']} right-hand sides, "
        f"{1e3 * stats['wall']:.3g} ms" + (f"; {run.status}" if run.status != "done" else "")
    )
    return table


__all__ = ["command", "strike_tables", "summary_table"]
