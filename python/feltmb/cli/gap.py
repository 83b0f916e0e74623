"""``feltmb gap``: the commands of unmodeled, and the page for a customer."""

from __future__ import annotations

import re
from pathlib import Path

import click

from feltmb.cli.completing import actions
from feltmb.cli.settings import SET, load_with_settings
from unmodeled.cli import COMMANDS
from unmodeled.cli.options import FORCE, FileName, argument, declare, option
from unmodeled.cli.running import LazyGroup
from unmodeled.cli.screen import check_targets, print_json, say_written

command = LazyGroup(
    "gap",
    listed={
        **{name: entry for name, entry in COMMANDS.items() if name != "fit"},
        "report": ("feltmb.cli.gap:report", "Write a page for a customer."),
    },
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Diagnose the gap between a model and measurements: which cause, how much, where.

    These are the commands of unmodeled. A model is a packaged mechanism, a mechanism file, an FMU,
    a MuJoCo model (robot.xml), or a function or model of a Python file (model.py:cart). Measured
    files are CSV, MAT, HDF5, NetCDF, Parquet, Feather or MCAP. A TOML file of the same name
    describes each file.
    """,
)


@declare("report")
def report(
    result: Path = argument(),
    action: str = argument(complete=actions),
    customer: bool = option(
        "One page for a customer: the guilty part, what the hand feels, what was done.",
        required=True,
    ),
    out: Path = option(
        "Page to write: .pdf or .html.", FileName(".pdf", ".html"), metavar="FILE", required=True
    ),
    after: str | None = option(
        "Mechanism after the work; default: ACTION without the causes.",
        metavar="ACTION",
        complete=actions,
    ),
    done: str | None = option(
        "Work that was done, a sentence for each item. Default: what should be done.",
        metavar="TEXT",
    ),
    title: str = option("Head line.", default="Your piano action"),
    workshop: str = option("Name of the workshop.", default="", metavar="NAME"),
    photo: Path | None = option(
        "Photo, PNG or JPEG.", click.Path(dir_okay=False, path_type=Path), metavar="FILE"
    ),
    settings: tuple[str, ...] = SET,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Write a page about RESULT, the report.json of a diagnosis of ACTION or its folder."""
    from feltmb.action.customer import customer_page

    del customer  # the only kind of page so far
    check_targets(out, force=force)
    page = customer_page(
        result,
        load_with_settings(action, settings),
        after=after,
        title=title,
        workshop=workshop,
        done=[] if done is None else re.split(r"(?<=[.!])\s+", done.strip()),
        photo=photo,
    )
    written = page.write(out, force=force)
    if as_json:
        print_json({"sentences": page.sentences, page.head: page.work, "file": str(written)})
    else:
        say_written(written)
