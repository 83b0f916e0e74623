"""Who may use a local page, what its answers allow, and how much they take."""

from __future__ import annotations

import hmac
import logging
from collections.abc import Awaitable, Callable
from typing import Any

from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from unmodeled.errors import Error, InvalidParameter, printable


class Guard:
    """Reject requests that are not from our own page: other hosts, origins or tokens."""

    def __init__(self, app: ASGIApp, token: str, hosts: tuple[str, ...]):
        self.app = app
        self.token = token
        self.hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or reject a request."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        why = self._refused(scope)
        if why is None:
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": why[1]})
        else:
            await answer(why[1] + "\n", why[0])(scope, receive, send)

    def _refused(self, scope: Scope) -> tuple[int, str] | None:
        headers = [(k.lower(), v.decode("latin-1")) for k, v in scope["headers"]]
        hosts = [v for k, v in headers if k == b"host"]
        if len(hosts) != 1 or hosts[0] not in self.hosts:
            return 421, "this server answers to its own address only"
        origins = [v for k, v in headers if k == b"origin"]
        allowed = [f"http://{host}" for host in self.hosts]
        needs = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if (needs and not origins) or any(origin not in allowed for origin in origins):
            return 403, "requests of other pages are refused"
        given = scope["path"].split("/")[1].encode("utf-8", "replace")
        if not hmac.compare_digest(given, self.token.encode()):
            return 404, "the address lacks the token that the server printed"
        return None


def answer(
    content: str | bytes, status: int = 200, kind: str = "text/plain; charset=utf-8"
) -> Response:
    """A response with the common headers."""
    return Response(content, status, headers=HEADERS, media_type=kind)


#: Largest uploaded file [bytes].
MOST_UPLOAD = 32 * 1024 * 1024

_LOG = logging.getLogger(__name__)

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src 'self' data: blob:; media-src 'self' blob:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


async def body_of(request: Request, most: int) -> bytes:
    """Body of a request, with a limited size that does not depend on its header.

    Raises
    ------
    InvalidParameter
        The body is larger.
    """
    parts, size = [], 0
    length = request.headers.get("content-length", "0")
    if length.isdigit() and int(length) > most:
        raise InvalidParameter(f"got {int(length)} bytes, expected at most {most}")
    async for part in request.stream():
        size += len(part)
        if size > most:
            raise InvalidParameter(f"got more than {most} bytes, expected at most that")
        parts.append(part)
    return b"".join(parts)


def fault_of(error: Exception, program: str) -> str:
    """Message of an error for the page; internal errors are written to the log."""
    if isinstance(error, Error):
        return str(error)
    _LOG.error("%s: unexpected error", program, exc_info=error)
    text = printable(f"{type(error).__name__}: {error}")[:300]
    return f"unexpected error, {text}; the terminal of {program} shows more"


def guarded(
    work: Callable[[Request], Awaitable[Response]], program: str
) -> Callable[[Request], Any]:
    """Function whose errors are answers that the page shows."""

    async def wrapped(request: Request) -> Response:
        try:
            return await work(request)
        except Error as error:
            return answer(str(error), 422)
        except ClientDisconnect:  # nobody hears the answer
            return answer("the request was given up", 499)
        except Exception as error:
            return answer(fault_of(error, program), 500)

    return wrapped
