"""The server of the live page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from unmodeled.arguments import checked
from unmodeled.page.server import LocalServer, packages


class Live(LocalServer):
    """A live server that has a port and is not running yet.

    Parameters
    ----------
    mechanism
        Name of a packaged mechanism, or path of a TOML file, which is then monitored.
    records
        Initial measured files.
    port
        Port of this computer; 0: any free port.
    """

    def __init__(self, mechanism: str, records: Sequence[Path] = (), port: int = 0):
        with packages("feltmb live", "starlette uvicorn websockets"):
            import websockets  # noqa: F401

            from feltmb.live.app import Studio, make_app
        self.studio = Studio(mechanism, tuple(records))
        try:
            super().__init__(
                "feltmb live", lambda token, hosts: make_app(self.studio, token, hosts), port
            )
        except BaseException:
            self.studio.close()
            raise


@checked
def serve(
    mechanism: str = "steinway45_leaded",
    records: Sequence[str | Path] = (),
    *,
    browser: bool = True,
    port: int = 0,
    say: Callable[[str], object] = print,
) -> None:
    """Open a page on which a mechanism can be changed and simulated; returns after Ctrl-C.

    Parameters
    ----------
    mechanism
        Name of a packaged mechanism, or path of a TOML file. The page monitors the file: a saved
        change is shown immediately, with all faults of the file.
    records
        Measured files for comparison; more can be dropped on the page.
    browser
        Whether the page is opened in the browser.
    port
        Port of this computer; 0: any free port.
    say
        Function that is called with the address.

    Raises
    ------
    InvalidParameter
        The mechanism does not exist, or its file has faults.
    Error
        The port is in use, or the packages of ``feltmb[live]`` are missing.
    """
    Live(mechanism, [Path(r) for r in records], port).show(say, browser=browser)
