"""The application of the page: files of the page, uploads, check, search, results."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from functools import cache
from importlib import resources
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from unmodeled.errors import Error, InvalidParameter
from unmodeled.page.desk import Desk, Form, form_of
from unmodeled.page.guard import HEADERS, MOST_UPLOAD, Guard, answer, body_of, guarded

#: Largest form [bytes].
MOST_FORM = 256 * 1024
POLICY = "Content-Security-Policy"
KINDS = {"page.html": "text/html", "page.css": "text/css", "page.js": "text/javascript",
         "icon.svg": "image/svg+xml"}  # fmt: skip
#: A report has its own script, whose digest it states; it stands in a frame that reaches nothing.
REPORT = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'; sandbox allow-scripts"
)


@cache
def _asset(name: str) -> Response:
    text = (resources.files("unmodeled.page") / "assets" / name).read_text("utf-8")
    out = answer(text, kind=f"{KINDS[name]}; charset=utf-8")
    out.headers[POLICY] = f"{HEADERS[POLICY]}; frame-src 'self'"
    return out


def make_app(desk: Desk, token: str, hosts: tuple[str, ...]) -> ASGIApp:
    """The application of the server of a page.

    Parameters
    ----------
    token
        First part of every path.
    hosts
        Permitted values of the header Host, such as ``127.0.0.1:PORT``.
    """

    async def told(work: Callable[[], Any]) -> Response:
        """Answer of a function in a thread; its errors name no folder of the server."""
        try:
            found = await asyncio.to_thread(work)
        except Error as error:
            raise InvalidParameter(desk.told(error)) from error
        return JSONResponse(found or {}, headers=HEADERS)

    async def form(request: Request) -> Form:
        try:
            return form_of(json.loads(await body_of(request, MOST_FORM)))
        except (ValueError, RecursionError) as error:
            raise InvalidParameter(str(error)) from None

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "page.html")
        return _asset(name) if name in KINDS else answer("no such file\n", 404)

    async def state(_request: Request) -> Response:
        return JSONResponse(desk.state(), headers=HEADERS)

    async def upload(request: Request) -> Response:
        name = request.query_params.get("name", "record.csv")
        data = await body_of(request, MOST_UPLOAD)
        add = desk.add_model if request.url.path.endswith("/model") else desk.uploads.add
        return await told(lambda: add(name, data))

    async def remove(request: Request) -> Response:
        return await told(lambda: desk.uploads.remove(request.path_params["file"]))

    async def check(request: Request) -> Response:
        given = await form(request)
        return await told(lambda: desk.check(given))

    async def search(request: Request) -> Response:
        given = await form(request)
        return await told(lambda: desk.begin(given))

    async def stop(_request: Request) -> Response:
        return await told(desk.stop)

    async def result(request: Request) -> Response:
        name = request.path_params["name"]
        data = await asyncio.to_thread(desk.file, name)
        shown = name == "report.html" and "save" not in request.query_params
        out = answer(data, kind="text/html; charset=utf-8" if shown else "application/octet-stream")
        if shown:
            out.headers[POLICY] = REPORT
            del out.headers["Cross-Origin-Opener-Policy"]  # not with a sandbox
        else:
            out.headers["Content-Disposition"] = f'attachment; filename="{name}"'
        return out

    @contextlib.asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        yield
        desk.close()

    works = {
        ("", "GET"): page,
        ("assets/{name}", "GET"): page,
        ("state", "GET"): state,
        ("model", "POST"): upload,
        ("records", "POST"): upload,
        ("records/{file}", "DELETE"): remove,
        ("check", "POST"): check,
        ("search", "POST"): search,
        ("stop", "POST"): stop,
        ("result/{name}", "GET"): result,
    }
    routes = [
        Route(f"/{token}/{path}", guarded(work, "unmodeled page"), methods=[method])
        for (path, method), work in works.items()
    ]
    return Guard(Starlette(routes=routes, lifespan=lifespan), token, hosts)
