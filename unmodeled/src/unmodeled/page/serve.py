"""The page of ``unmodeled page``: its server, and its command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import click

from unmodeled.arguments import checked
from unmodeled.cli import completing
from unmodeled.cli.options import argument, count, declare, option
from unmodeled.cli.screen import print_json
from unmodeled.cli.screen import say as say_line
from unmodeled.page.server import LocalServer, packages

PROGRAM = "unmodeled page"


class PageServer(LocalServer):
    """A server of the page that has a port and is not running yet; see :func:`serve`."""

    def __init__(self, model: str = "", records: Sequence[Path] = (), port: int = 0):
        with packages(PROGRAM, "starlette uvicorn"):
            from unmodeled.page.app import make_app
            from unmodeled.page.desk import Desk
        self.desk = Desk(model, tuple(records))
        try:
            super().__init__(PROGRAM, lambda *at: make_app(self.desk, *at), port)
        except BaseException:
            self.desk.close()
            raise


@checked
def serve(
    model: str = "",
    records: Sequence[str | Path] = (),
    *,
    browser: bool = True,
    port: int = 0,
    say: Callable[[str], object] = print,
) -> None:
    """Open a page on which records are compared with a model and diagnosed; returns after Ctrl-C.

    Parameters
    ----------
    model
        Model as for :func:`unmodeled.load_model`. "": an FMU or a MuJoCo file is dropped on the
        page. A Python file is only read from here, because it is executed.
    records
        Measured files; more can be dropped on the page.
    browser
        Whether the page is opened in the browser.
    port
        Port of this computer; 0: any free port.
    say
        Function that is called with the address.

    Raises
    ------
    InvalidParameter, DataError
        There is no such model, or a file cannot be read.
    Error
        The port is in use, or the packages of ``unmodeled[page]`` are missing.
    """
    PageServer(model, [Path(r) for r in records], port).show(say, browser=browser)


@declare("page")
def command(
    model: str | None = argument(complete=completing.models),
    data: tuple[Path, ...] = argument(click.Path(path_type=Path), required=False),
    no_browser: bool = option("Print the address without opening a browser."),
    port: int = option("Port on this computer; 0: a free port.", count(0, 65535), 0),
    *,
    as_json: bool,
) -> None:
    """Diagnose in a browser: drop MODEL and measured DATA, check them, and search.

    An FMU or a MuJoCo model (robot.xml) can also be dropped on the page. Equations and functions
    are only read from MODEL (model.py:cart), because a Python file is executed. The address is
    secret and works only on this computer. Ctrl-C stops the server.
    """

    def say(address: str) -> None:
        if as_json:
            print_json({"address": address})
        else:
            say_line(address)

    serve(model or "", data, browser=not no_browser, port=port, say=say)
