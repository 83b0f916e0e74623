"""``feltmb live``: turn a screw and see the machine move, in a browser."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import json_option, print_json, say
from feltmb.cli.completing import actions


@click.command("live")
@click.argument("mechanism", default="steinway45", shell_complete=actions)
@click.argument("records", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--no-browser", is_flag=True, help="Print the address and open no browser.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    show_default=True,
    help="Port of this machine; 0: a free one.",
)
@json_option
def command(
    mechanism: str, records: tuple[Path, ...], no_browser: bool, port: int, as_json: bool
) -> None:
    """Turn and play MECHANISM on a page of this machine, hold RECORDS against it.

    MECHANISM is a packaged one or a TOML file; the page follows the file while you edit it. The
    address is secret and of this machine only. Ctrl-C ends it.
    """
    from feltmb.live import serve

    def told(address: str) -> None:
        if as_json:
            print_json({"address": address})
        else:
            say(address)

    serve(mechanism, records, browser=not no_browser, port=port, say=told)
