"""``feltmb live``: changes and simulates a mechanism in a browser."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import json_option, print_json, say
from feltmb.cli.completing import actions


@click.command("live")
@click.argument("mechanism", default="steinway45", shell_complete=actions)
@click.argument("records", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--no-browser", is_flag=True, help="Print the address without opening a browser.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    show_default=True,
    help="Port on this computer; 0: a free port.",
)
@json_option
def command(
    mechanism: str, records: tuple[Path, ...], no_browser: bool, port: int, as_json: bool
) -> None:
    """Change and simulate MECHANISM in a browser, and compare it with RECORDS.

    MECHANISM is a packaged mechanism or a TOML file. The page reloads the file when you edit it.
    The address is secret and works only on this computer. Ctrl-C stops the server.
    """
    from feltmb.live import serve

    def say_address(address: str) -> None:
        if as_json:
            print_json({"address": address})
        else:
            say(address)

    serve(mechanism, records, browser=not no_browser, port=port, say=say_address)
