"""``unmodeled plan``: plans experiments that identify causes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from unmodeled.cli.models import (
    EXCLUDE,
    MEASURED,
    MODEL,
    READING,
    STATED,
    config_option,
    load_named,
)
from unmodeled.cli.options import (
    FORCE,
    MODEL_SET,
    FolderName,
    Number,
    argument,
    count,
    declare,
    option,
)
from unmodeled.cli.screen import Line, print_json, say, say_written, show
from unmodeled.errors import InvalidParameter
from unmodeled.units import readable_unit, unit_suffix

if TYPE_CHECKING:
    from unmodeled.cli.models import Stated
    from unmodeled.data import ReadOptions, Record, Sensor
    from unmodeled.experiment import Belief, Design, Limits, Visible
    from unmodeled.loading import LoadedModel

__all__ = ["plan"]

#: Largest numbers of causes, and of helpful tests or sensors, that are listed.
MOST_CAUSES, MOST_HELP = 12, 5
#: Smallest probability of a cause that is listed, as a share of the largest.
LIKELY = 0.1


@declare("plan", short="Experiments that identify what MODEL lacks.", more=[config_option])
def plan(
    model: str = MODEL,
    data: tuple[Path, ...] = argument(required=False),
    budget: float = option(
        "Number of records (the limits give the cost of a test of a part).",
        Number(0, 1000, min_open=True),
        3.0,
    ),
    limits: Path | None = option(
        "TOML file with the limits of the inputs, sensors, and possible tests of parts. Default: "
        "the limits of the model.",
        metavar="FILE",
    ),
    report: Path | None = option(
        "Diagnosis of the data (folder or report.json). The plan separates the causes that it "
        "could not separate.",
        metavar="PATH",
    ),
    measured: Path | None = MEASURED,
    aim: Literal["names", "sizes"] = option(
        "Identify causes, or estimate their magnitudes.",
        click.Choice(["names", "sizes"]),
        "names",
    ),
    channels: tuple[str, ...] = option("Channel or output that will be measured.", metavar="NAME"),
    families: tuple[str, ...] = option(
        "Kind of profile; default: all.", words="--family", metavar="NAME"
    ),
    candidates: int = option(
        "Number of profiles that are evaluated in full.", count(1, 10_000), 12
    ),
    refinements: int = option(
        "Number of further profiles that improve the first experiment.",
        count(0, 10_000),
        4,
        words="--refine",
    ),
    seed: int = option("Seed of the random draws.", count(0), 0),
    out: Path | None = option(
        "Folder of the inputs (CSV), their pictures and plan.json.",
        FolderName(),
        metavar="DIRECTORY",
    ),
    stated: Stated = STATED,
    exclude: tuple[str, ...] = EXCLUDE,
    reading: ReadOptions = READING,
    settings: tuple[str, ...] = MODEL_SET,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Plan experiments that identify what MODEL lacks.

    The experiments are smooth profiles of the inputs within limits, and tests of single parts. The
    most informative ones come first. DATA are measured files, to which the experiments add; what
    they say about causes comes from the --report of their diagnosis.
    """
    from unmodeled.experiment import design, design_json, write_design
    from unmodeled.files import check_writable, make_folder

    if out is not None:
        check_writable(make_folder(out) / "plan.json", force=force)
    loaded = load_named(model, settings, channels, stated)
    records = loaded.read(data, reading) if data else ()
    loaded = loaded.with_records(records, exclude).measured(measured)
    allowed = _limits(model, loaded, limits)
    belief = None if report is None else _belief(report)
    line, start = Line(), time.monotonic()

    def tell(stage: str, done: int, total: int) -> None:
        elapsed = time.monotonic() - start
        line.show(stage, f"{stage}: {done + 1} of {total}, {elapsed:.0f} s")

    found = design(
        loaded.model,
        loaded.effects,
        records,
        limits=allowed,
        sensors=_sensors(loaded, allowed, records, channels),
        budget=budget,
        aim=aim,
        belief=belief,
        families=families,
        candidates=candidates,
        refinements=refinements,
        seed=seed,
        progress=tell,
    )
    line.close()
    if as_json:
        print_json(design_json(found))
    else:
        _print(found)
        if belief is not None and belief.included:
            say(f"Named causes are part of the model: {', '.join(belief.included)}.")
        if records and belief is None:
            say("The data count by their inputs and sensors only; --report adds what they say.")
    if out is not None:
        units = {**loaded.model.units, **{n: i.unit for n, i in allowed.inputs.items()}}
        written = write_design(found, out, units=units, force=force)
        for i, e in enumerate(found.experiments, 1):
            if e.record is not None and loaded.write_input is not None:
                written += loaded.write_input(e, out / f"{i}", units, force=force)
        for path in written:
            if not as_json:
                say_written(path)


def _limits(model: str, loaded: LoadedModel, file: Path | None) -> Limits:
    """Limits from a file, or those of the model."""
    from unmodeled.experiment import read_limits

    if file is not None:
        return read_limits(file, loaded.model, loaded.effects)
    if loaded.limits is None:
        raise InvalidParameter(
            f"{model}: how far may its inputs go? Give --limits FILE with schema = 1, duration = "
            '"1 s" and [inputs.NAME] with most, and where it matters least, rate, acceleration'
        )
    return loaded.limits


def _sensors(
    loaded: LoadedModel, limits: Limits, records: Sequence[Record], channels: Sequence[str]
) -> dict[str, Sensor] | None:
    """Sensors of the planned outputs from planned runs of the model; None: see ``design``."""
    from unmodeled.experiment.designs import sensors_of

    wanted = loaded.outputs_of(channels) if channels else None
    if wanted is not None and (limits.sensors or not loaded.planned):
        raise InvalidParameter("--channels: name what is measured in [sensors] of the limits")
    if limits.sensors or not loaded.planned:
        return None
    usual = dict(loaded.planned[0].sensors)
    seen = sensors_of(records, loaded.model.outputs, usual)
    if wanted is None:
        return seen if records else usual
    return {n: s for n, s in (usual | seen).items() if n in wanted}


def _belief(path: Path) -> Belief:
    """What a diagnosis found."""
    from unmodeled.experiment import Belief
    from unmodeled.files import is_folder, read_json

    return Belief.of_report(read_json(path / "report.json" if is_folder(path) else path))


def _amount(value: float, unit: str) -> str:
    """A value in the unit in which people read it."""
    factor, shown = readable_unit(value, unit)
    return f"{factor * value:.3g}{unit_suffix(shown)}"


def _print(found: Design) -> None:
    """Print the plan as tables, with reasons."""
    from unmodeled.experiment import reasons

    names = found.aim == "names"

    def value(v: float) -> str:
        return f"{v:.0%}" if names else f"{v:.3g}"

    what = "probability of the correct name" if names else "information"
    rows = []
    for i, e in enumerate(found.experiments, 1):
        text = "\n".join([e.name, *(f"  {r}" for r in reasons(e, len(found.effects)))])
        rows.append((f"{i}", text, f"{e.cost:g}", f"{value(e.before)} -> {value(e.after)}"))
    if rows:
        show("next experiments", f"= | experiment | =>cost | =>{what}", rows)
    else:
        say("No experiment within the limits gives more information.")
    say(
        f"Expected {what}: {value(found.before)} now, {value(found.after)} after the plan"
        f" ({value(found.reachable)} with all tested experiments)."
    )
    _print_causes(found.effects)
    for group in found.inseparable:
        say("no experiment within the limits separates: " + ", ".join(group))
    for what, kind in (("measure a part separately", found.tests), ("add a sensor", found.sensors)):
        for h in kind[:MOST_HELP]:
            to = f"{h.sd:.1%}" if h.unit == "1" else _amount(h.sd, h.unit)
            say(f"{what}: {h.name} to {to} ({value(h.after)})")
    if found.failed:
        say(f"{found.failed} profiles could not be simulated and are omitted")


def _name(cause: Visible) -> str:
    return f"{cause.cause} outside its tolerance" if cause.parameter else cause.cause


def _print_causes(causes: Sequence[Visible]) -> None:
    """Print the most probable causes, and those that cannot be detected."""
    shown = [v for v in causes if v.smallest < float("inf")]
    likely = [v for v in shown[:MOST_CAUSES] if v.belief >= LIKELY * causes[0].belief]
    rows = [
        (_name(v), f"{v.belief:.0%}", _amount(v.smallest, v.unit), f"{v.right:.0%}",
         *((v.rival, f"{v.confusion:.0%}") if v.rival else ("", "")))
        for v in likely
    ]  # fmt: skip
    if shown:
        heads = "=cause | >now | >detectable from | >correct | confused with | >chance"
        show("detectable causes", heads, rows)
    if len(shown) > len(likely):
        say(f"and {len(shown) - len(likely)} less probable causes (plan.json, --json)")
    hidden = [v for v in causes if v not in shown]
    for why, imitated in (
        ("a change of parameters looks the same", True),
        ("no measured output changes", False),
    ):
        own = [_name(v) for v in hidden if v.imitated is imitated]
        more = f" and {len(own) - MOST_CAUSES} more" if len(own) > MOST_CAUSES else ""
        if own:
            say(f"cannot be detected, because {why}: {', '.join(own[:MOST_CAUSES])}{more}")
