"""``unmodeled plan``: what proposed records would tell about causes."""

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
    MODEL_SET,
    argument,
    declare,
    option,
)
from unmodeled.cli.screen import Line, print_json, say, show
from unmodeled.units import readable_unit, unit_suffix

if TYPE_CHECKING:
    from unmodeled.cli.models import StatedOptions
    from unmodeled.data import ReadOptions
    from unmodeled.experiment import Belief, Plan, Visible

#: Largest numbers of causes, and of helpful tests, that are listed.
MOST_CAUSES, MOST_TESTS = 12, 5
#: Smallest probability of a cause that is listed, as a share of the largest.
LIKELY = 0.1


@declare("plan", short="What proposed records would tell about causes.", more=[config_option])
def plan(
    model: str = MODEL,
    proposed: tuple[Path, ...] = argument(click.Path(path_type=Path), required=False),
    data: tuple[Path, ...] = option("Measured file, to which the records add.", metavar="FILE"),
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
    channels: tuple[str, ...] = option(
        "Channel or output that will be measured, in addition to those of the files.",
        metavar="NAME",
    ),
    stated: StatedOptions = STATED,
    exclude: tuple[str, ...] = EXCLUDE,
    reading: ReadOptions = READING,
    settings: tuple[str, ...] = MODEL_SET,
    *,
    as_json: bool,
) -> None:
    """Compute what PROPOSED records would tell about the causes that MODEL may lack.

    PROPOSED are files with a time and inputs that you could apply, of any shape; without them the
    planned runs of the model are used. The most informative record comes first, then the best one
    in addition to it. The command lists the causes that the records would detect and separate, and
    the tests of single parts that would help. It invents no inputs: vary yours and compare.

    The values of output columns do not count, their sensors do. A file without them is measured by
    the sensors of --data, else of the planned runs of the model, else at all outputs. What --data
    say about causes comes from the --report of their diagnosis.
    """
    from unmodeled.experiment import plan as planned

    loaded = load_named(model, settings, channels, stated)
    records = loaded.read(data, reading) if data else ()
    runs = loaded.read_proposed(proposed, records, channels, reading)
    loaded = loaded.with_records(records or runs, exclude).measured(measured)
    belief = None if report is None else _belief(report)
    line, start = Line(), time.monotonic()

    def show_progress(stage: str, done: int, total: int) -> None:
        elapsed = time.monotonic() - start
        line.show(stage, f"{stage}: {done + 1} of {total}, {elapsed:.0f} s")

    result = planned(
        loaded.model,
        loaded.effects,
        runs,
        records,
        aim=aim,
        belief=belief,
        progress=show_progress,
    )
    line.close()
    if as_json:
        print_json(result.as_dict())
        return
    _print(result)
    if belief is not None and belief.included:
        say(f"Named causes are part of the model: {', '.join(belief.included)}.")
    if records and belief is None:
        say("The data count by their inputs and sensors only; --report adds what they say.")


def _belief(path: Path) -> Belief:
    """The probabilities of a diagnosis."""
    from unmodeled.experiment import Belief
    from unmodeled.files import is_folder, read_json

    return Belief.of_report(read_json(path / "report.json" if is_folder(path) else path))


def _amount(value: float, unit: str) -> str:
    """A value in the unit in which people read it."""
    factor, shown = readable_unit(value, unit)
    return f"{factor * value:.3g}{unit_suffix(shown)}"


def _print(result: Plan) -> None:
    """Print the plan as tables, with reasons."""
    names = result.aim == "names"

    def value(v: float) -> str:
        return f"{v:.0%}" if names else f"{v:.3g}"

    what = "probability of the correct name" if names else "information"
    rows = []
    for i, r in enumerate(result.records, 1):
        text = "\n".join([r.record.name, *(f"  {t}" for t in r.reasons(len(result.effects)))])
        rows.append((f"{i}", text, f"{value(r.before)} -> {value(r.after)}"))
    show("next records", f"= | record | =>{what}", rows)
    say(
        f"Expected {what}: {value(result.before)} now, {value(result.after)} after all of these "
        "records."
    )
    _print_causes(result.effects)
    for group in result.inseparable:
        say("none of these records separates: " + ", ".join(group))
    for text in result.repeats:
        say(text)
    for t in result.tests[:MOST_TESTS]:
        to = f"{t.sd:.1%}" if t.unit == "1" else _amount(t.sd, t.unit)
        say(f"measure a part separately: {t.name} to {to} ({value(t.after)})")
    if result.failed:
        say(f"The model cannot simulate {', '.join(result.failed)}.")


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
        say(f"and {len(shown) - len(likely)} less probable causes (--json)")
    hidden = [v for v in causes if v not in shown]
    for why, imitated in (
        ("a change of parameters looks the same", True),
        ("no measured output changes", False),
    ):
        names = [_name(v) for v in hidden if v.imitated is imitated]
        more = f" and {len(names) - MOST_CAUSES} more" if len(names) > MOST_CAUSES else ""
        if names:
            say(f"cannot be detected, because {why}: {', '.join(names[:MOST_CAUSES])}{more}")
