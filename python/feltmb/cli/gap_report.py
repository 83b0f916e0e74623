"""``feltmb gap report``: page for a customer from the result of a diagnosis."""

from __future__ import annotations

import re
from pathlib import Path

import click

from feltmb.cli.common import (
    FileName,
    check_targets,
    force_option,
    json_option,
    load_with_settings,
    print_json,
    say_written,
    set_option,
)
from feltmb.cli.completing import actions

__all__ = ["command"]


@click.command("report", short_help="Write a page for a customer.")
@click.argument("result", type=click.Path(path_type=Path))
@click.argument("action", shell_complete=actions)
@click.option(
    "--customer",
    is_flag=True,
    required=True,
    help="One page for a customer: the guilty part, what the hand feels, what was done.",
)
@click.option(
    "-o",
    "--out",
    "output",
    metavar="FILE",
    type=FileName(".pdf", ".html", dir_okay=False),
    required=True,
    help="Page to write: .pdf or .html.",
)
@click.option(
    "--after",
    metavar="ACTION",
    shell_complete=actions,
    help="Mechanism after the work; default: ACTION without the causes.",
)
@click.option(
    "--done",
    metavar="TEXT",
    help="Work that was done, a sentence for each item. Default: what should be done.",
)
@click.option("--title", default="Your piano action", show_default=True, help="Head line.")
@click.option("--workshop", default="", metavar="NAME", help="Name of the workshop.")
@click.option(
    "--photo",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Photo, PNG or JPEG.",
)
@set_option
@force_option
@json_option
def command(
    result: Path,
    action: str,
    customer: bool,
    output: Path,
    after: str | None,
    done: str | None,
    title: str,
    workshop: str,
    photo: Path | None,
    settings: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> None:
    """Write a page about RESULT, the report.json of a diagnosis of ACTION or its folder."""
    from feltmb.action.customer import customer_page

    del customer  # the only kind of page so far
    check_targets(output, force=force)
    page = customer_page(
        result,
        load_with_settings(action, settings),
        after=after,
        title=title,
        workshop=workshop,
        done=[] if done is None else re.split(r"(?<=[.!])\s+", done.strip()),
        photo=photo,
    )
    written = page.write(output, force=force)
    if as_json:
        print_json({"sentences": page.sentences, page.head: page.work, "file": str(written)})
    else:
        say_written(written)
