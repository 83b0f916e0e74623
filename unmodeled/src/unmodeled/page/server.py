"""A server of pages for this computer only: one port, one secret address."""

from __future__ import annotations

import contextlib
import ctypes
import secrets
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from unmodeled.errors import Error

if TYPE_CHECKING:
    from starlette.types import ASGIApp

HOST = "127.0.0.1"

#: Largest message of a WebSocket [bytes].
MOST_MESSAGE = 256 * 1024
#: Option of ``mallopt`` of glibc, and its value: memory from this size on is of the system [bytes].
M_MMAP_THRESHOLD, LARGE = -3, 2**20
#: Largest time for which a thread of Python keeps messages waiting [s].
SWITCH = 5e-4


class LocalServer:
    """A server that has a port and is not running yet.

    Parameters
    ----------
    program
        Command that serves, for messages.
    make_app
        Function of the token and of the permitted hosts that returns the application.
    port
        Port of this computer; 0: any free port.

    Attributes
    ----------
    address : str
        Address for a browser; its token prevents other access.

    Raises
    ------
    Error
        The port is in use.
    """

    def __init__(
        self, program: str, make_app: Callable[[str, tuple[str, ...]], ASGIApp], port: int = 0
    ):
        import uvicorn

        from unmodeled.page.door import patient_protocol

        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((HOST, port))
            self._socket.listen()  # the address is valid as soon as it is printed
        except OSError as error:
            self._socket.close()
            raise Error(f"{program}: port {port}: {error.strerror or error}") from None
        self.port = int(self._socket.getsockname()[1])
        token = secrets.token_urlsafe(24)
        self.address = f"http://{HOST}:{self.port}/{token}/"
        hosts = (f"{HOST}:{self.port}", f"localhost:{self.port}")
        self._server: Any = uvicorn.Server(
            uvicorn.Config(
                make_app(token, hosts),
                log_level="warning",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                http=patient_protocol(token),
                ws_max_size=MOST_MESSAGE,
                ws_max_queue=8,
                ws_per_message_deflate=False,  # accessible only from this computer
                limit_concurrency=64,
                timeout_graceful_shutdown=2,
            )
        )

        # uvicorn would raise the signal again after its end, which interrupts the shutdown.
        vars(self._server)["capture_signals"] = lambda: _ends(self._server)

    def run(self) -> None:
        """Serve until :meth:`stop`, or Ctrl-C."""
        give_back_large_arrays()
        sys.setswitchinterval(SWITCH)
        self._server.run(sockets=[self._socket])

    def show(self, say: Callable[[str], object], *, browser: bool) -> None:
        """Tell the address, open it in the browser if wanted, and serve."""
        say(self.address)
        if browser:
            webbrowser.open(self.address)
        self.run()

    def stop(self) -> None:
        """Stop :meth:`run`, from another thread."""
        self._server.should_exit = True

    @property
    def started(self) -> bool:
        """Whether the server answers."""
        return bool(self._server.started)


@contextlib.contextmanager
def packages(program: str, needed: str) -> Iterator[None]:
    """A block that imports packages of an extra; ``needed``: their names.

    Raises
    ------
    Error
        One of them is not installed; the message says how it is.
    """
    try:
        import uvicorn  # noqa: F401

        yield
    except ImportError as missing:
        raise Error(f"{program}: {missing.name} is not installed; pip install {needed}") from None


def give_back_large_arrays() -> bool:
    """Memory of large arrays goes back to the system; whether the C library can be told so.

    By itself glibc raises its limit to the largest array that was freed. The arrays of whole runs
    then lie in its heaps, which grow by the gaps between them.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none, and needs none
    return mallopt is not None and bool(mallopt(M_MMAP_THRESHOLD, LARGE))


@contextlib.contextmanager
def _ends(server: Any) -> Iterator[None]:
    """Context in which Ctrl-C and a termination request end the server without an error."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    kinds = (signal.SIGINT, signal.SIGTERM)
    before = {kind: signal.signal(kind, server.handle_exit) for kind in kinds}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
