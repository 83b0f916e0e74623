"""Pages and WebSocket of the live server, and their access control."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tomlkit
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from feltmb import __version__
from feltmb.graphics.viewer import script_of
from feltmb.graphics.viewer.packing import binary_message
from feltmb.live.knobs import Bench
from feltmb.live.measured import Measured
from feltmb.live.pictures import greeting
from feltmb.live.request_queue import RequestQueue
from feltmb.live.states import Asked, Turned, fault_of
from feltmb.mechanism import files_of, load_action
from feltmb.run.simulate import simulate
from feltmb.run.sound import difference, sampled, wav
from feltmb.run.stroke import Stroke
from unmodeled.errors import InvalidParameter
from unmodeled.files import is_file, read_input
from unmodeled.page.guard import HEADERS, MOST_UPLOAD, Guard, answer, body_of, guarded
from unmodeled.page.uploads import Uploads

#: Largest body of a request [bytes]; number of pages.
MOST_BODY, MOST_PAGES = 256 * 1024, 16
#: Interval of the checks of the mechanism file [s].
LOOK = 0.25


class Studio:
    """Common data of all pages: the mechanism, its file, threads, uploaded files.

    Parameters
    ----------
    mechanism
        Name of a packaged mechanism, or path of a TOML file that is monitored.
    records
        Initial measured files.
    """

    def __init__(self, mechanism: str, records: tuple[Path, ...] = ()):
        self.name = mechanism
        self.bench = Bench(load_action(mechanism))
        self.faults: list[str] = []
        self.version = 1
        self.pool = ThreadPoolExecutor(max(4, os.cpu_count() or 4), thread_name_prefix="live")
        self.pages: set[Page] = set()
        self._folder = tempfile.TemporaryDirectory(prefix="feltmb-live")
        self.uploads = Uploads(Path(self._folder.name))
        for path in records:
            if is_file(sheet := path.with_suffix(".toml")):
                self.uploads.add(sheet.name, read_input(sheet, most=MOST_UPLOAD))
            self.uploads.add(path.name, read_input(path, most=MOST_UPLOAD))
        self.files = self.uploads.listing()  # of every page; others are of the page that added them
        path = Path(mechanism)
        self._file = path if is_file(path) else None
        self._stamps = stamps(files_of(self._file)) if self._file is not None else {}

    async def follow(self) -> None:
        """Read the mechanism again when its file, or a file to which it refers, changes."""
        while self._file is not None:
            await asyncio.sleep(LOOK)
            now = stamps(self._stamps)
            if now == self._stamps or now[self._file] is None:
                continue
            loop = asyncio.get_running_loop()
            self._stamps = now
            try:
                # Files are noted before they are read: a change meanwhile is detected later.
                named = await loop.run_in_executor(self.pool, files_of, self._file)
                self._stamps = stamps(named) | {path: now[path] for path in now if path in named}
                action = await loop.run_in_executor(self.pool, load_action, str(self._file))
                self.bench, self.faults = await loop.run_in_executor(self.pool, Bench, action), []
            except Exception as error:  # otherwise the file would not be followed any more
                self.faults = fault_of(error).splitlines()
            self.version += 1
            for page in tuple(self.pages):
                await page.greet()

    def close(self) -> None:
        """Release threads and files."""
        self.pool.shutdown(wait=False, cancel_futures=True)
        self._folder.cleanup()


def stamps(paths: Iterable[Path]) -> dict[Path, tuple[int, int] | None]:
    """Time and size of files, None for a missing file; changed files have other values."""
    out: dict[Path, tuple[int, int] | None] = {}
    for path in paths:
        try:
            status = path.stat()
        except OSError:
            out[path] = None
        else:
            out[path] = status.st_mtime_ns, status.st_size
    return out


class Page:
    """One connection to a page."""

    def __init__(self, studio: Studio, socket: WebSocket):
        self.studio = studio
        self.socket = socket
        self._box: dict[str, dict[str, Any]] = {}
        self._filled = asyncio.Event()
        self.requests = RequestQueue(lambda: studio.bench, studio.pool, self.post)
        self.measured = Measured(lambda: studio.bench, studio.uploads, studio.pool, self.post)

    def post(self, kind: str, message: dict[str, Any]) -> None:
        """Queue a message for the page; a newer message replaces an unsent one of the same kind."""
        self._box.pop(kind, None)  # the newest message is sent last
        self._box[kind] = message
        self._filled.set()

    async def serve(self) -> None:
        """Communicate with the page until it is closed."""
        await self.greet()
        tasks = [
            asyncio.create_task(each)
            for each in (self._hear(), self._send(), self.requests.work(), self.measured.work())
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                if (fault := task.exception()) is not None:
                    raise fault
        finally:
            self.requests.close()
            self.measured.close()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def greet(self) -> None:
        """Send the knobs and outputs, at the start and after a change of the mechanism file."""
        bench, loop = self.studio.bench, asyncio.get_running_loop()
        try:
            content = await loop.run_in_executor(self.studio.pool, greeting, bench)
        except Exception as error:  # otherwise the page would be empty
            content = {"faults": fault_of(error).splitlines()}
        self.requests.again()
        self.post(
            "hello",
            {
                "on": "hello",
                "version": __version__,
                "mechanism": self.studio.name,
                "edition": self.studio.version,
                "files": self.studio.files,
                **content,
                "faults": self.studio.faults or content.get("faults", []),
            },
        )

    async def _hear(self) -> None:
        while True:
            try:
                text = await self.socket.receive_text()
            except (WebSocketDisconnect, KeyError, RuntimeError):
                return
            try:
                message = json.loads(text)
                self._do(message)
            except (ValueError, RecursionError) as error:  # an invalid message
                self.post("refused", {"on": "refused", "text": str(error)[:2000]})
            except Exception as error:  # otherwise the page would end
                self.post("refused", {"on": "refused", "text": fault_of(error)})

    def _do(self, message: Any) -> None:
        if not isinstance(message, dict):
            raise InvalidParameter("message: expected a table")
        given = dict(message)
        what = given.pop("do", None)
        if what == "simulate":
            slot = given.pop("slot", "a")
            if slot not in ("a", "b"):
                raise InvalidParameter("slot: expected a or b")
            self.requests.ask(slot, Asked.read(given))
        elif what == "forget":
            self.requests.forget("b")
        elif what == "regulate":
            self.requests.regulate(Turned.model_validate(given.get("turned", {})))
        elif what == "measure":
            self.measured.ask(given)
        elif what == "diagnose":
            self.measured.diagnose(given)
        elif what == "plan":
            self.measured.plan(given)
        elif what == "stop":
            self.measured.stop()
        else:
            raise InvalidParameter(f"do: got {str(what)[:40]!r}")

    async def _send(self) -> None:
        while True:
            await self._filled.wait()
            self._filled.clear()
            while self._box:
                kind = next(iter(self._box))
                data = binary_message(self._box.pop(kind))
                try:
                    await self.socket.send_bytes(data)
                except (WebSocketDisconnect, RuntimeError):
                    return


# --- pages ---------------------------------------------------------------------------------------


@cache
def _asset(name: str) -> str:
    return (resources.files("feltmb.live") / "assets" / name).read_text(encoding="utf-8")


@cache
def _script() -> str:
    """Script of the page: drawing as in the static viewer, then the live parts."""
    return script_of(_asset("live.js"), "window.feltmbLive = new Live(Line);\n")


def make_app(studio: Studio, token: str, hosts: tuple[str, ...]) -> ASGIApp:
    """The application of a live server.

    Parameters
    ----------
    token
        First part of every path.
    hosts
        Permitted values of the header Host, such as ``127.0.0.1:PORT``.
    """

    async def page(_request: Request) -> Response:
        return answer(_asset("live.html"), kind="text/html; charset=utf-8")

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name == "live.js":
            return answer(_script(), kind="text/javascript; charset=utf-8")
        if name == "live.css":
            text = resources.files("feltmb.graphics.viewer") / "assets" / "viewer.css"
            return answer(
                text.read_text(encoding="utf-8") + _asset("live.css"),
                kind="text/css; charset=utf-8",
            )
        if name == "uPlot.js":
            return answer(_asset("uPlot.iife.min.js"), kind="text/javascript; charset=utf-8")
        if name == "uPlot.css":
            return answer(_asset("uPlot.min.css"), kind="text/css; charset=utf-8")
        if name == "icon.svg":
            return answer(_asset("icon.svg"), kind="image/svg+xml")
        return answer("no such file\n", 404)

    async def asked(request: Request) -> Asked:
        try:
            return Asked.read(json.loads(await body_of(request, MOST_BODY)))
        except (ValueError, RecursionError) as error:
            raise InvalidParameter(str(error)) from None

    async def in_thread(work: Callable[[], Any]) -> Any:
        return await asyncio.get_running_loop().run_in_executor(studio.pool, work)

    async def sound(request: Request) -> Response:
        given = await asked(request)
        data, level = await in_thread(lambda: sound_of(studio.bench, given))
        out = answer(data, kind="audio/wav")
        if level is not None:
            out.headers["X-Level"] = f"{level:.2f}"
        return out

    async def stroke(request: Request) -> Response:
        given = await asked(request)
        return answer(await in_thread(lambda: stroke_toml(given.playing.stroke())))

    async def toml(request: Request) -> Response:
        given = await asked(request)
        return answer(await in_thread(lambda: toml_of(studio.bench, given.turned)))

    async def upload(request: Request) -> Response:
        name = request.query_params.get("name", "record.csv")
        data = await body_of(request, MOST_UPLOAD)
        entry = await in_thread(lambda: studio.uploads.add(name, data))
        return JSONResponse(entry, headers=HEADERS)

    async def remove(request: Request) -> Response:
        studio.uploads.remove(request.path_params["file"])
        return JSONResponse({}, headers=HEADERS)

    async def socket(websocket: WebSocket) -> None:
        if len(studio.pages) >= MOST_PAGES:
            await websocket.close(1013, f"{MOST_PAGES} pages are open")
            return
        await websocket.accept()
        mine = Page(studio, websocket)
        studio.pages.add(mine)
        try:
            await mine.serve()
        finally:
            studio.pages.discard(mine)

    @contextlib.asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        following = asyncio.create_task(studio.follow())
        yield
        following.cancel()
        studio.close()

    routes = [
        Route(f"/{token}/", page),
        Route(f"/{token}/assets/{{name}}", asset),
        Route(f"/{token}/sound", guarded(sound, "feltmb live"), methods=["POST"]),
        Route(f"/{token}/toml", guarded(toml, "feltmb live"), methods=["POST"]),
        Route(f"/{token}/stroke", guarded(stroke, "feltmb live"), methods=["POST"]),
        Route(f"/{token}/records", guarded(upload, "feltmb live"), methods=["POST"]),
        Route(f"/{token}/records/{{file}}", guarded(remove, "feltmb live"), methods=["DELETE"]),
        WebSocketRoute(f"/{token}/socket", socket),
    ]
    return Guard(Starlette(routes=routes, lifespan=lifespan), token, hosts)


def sound_of(bench: Bench, asked: Asked) -> tuple[bytes, float | None]:
    """WAV file of the run, as from ``feltmb wav``; with ``minus``, of the difference.

    The second result is the level of the difference relative to the first sound [dB]; None without
    a difference.
    """
    stroke = asked.playing.stroke()

    def heard(turned: Turned) -> npt.NDArray[np.float64]:
        run = simulate(turned.action(bench), stroke)
        return sampled(run.time, run.bridge_force())

    sound = heard(asked.turned)
    if asked.minus is None:
        return wav(sound), None
    rest = difference(sound, heard(asked.minus))
    power, left = float(np.sum(sound**2)), float(np.sum(rest**2))
    return wav(rest), 10.0 * math.log10(left / power) if left > 0.0 and power > 0.0 else None


def stroke_toml(stroke: Stroke) -> str:
    """Stroke file for ``feltmb stroke``."""
    knots = {
        "unit": ["s", stroke.unit],
        "time": list(stroke.time),
        "value": list(stroke.value),
        "interpolation": stroke.interpolation,
    }
    return tomlkit.dumps(
        {
            "schema": 1,
            "name": _one_line(stroke.name),
            "source": f"played in feltmb live {__version__}",
            "kind": stroke.kind,
            "duration": stroke.duration,
            "knots": knots,
        }
    )


def toml_of(bench: Bench, turned: Turned) -> str:
    """Mechanism file with the changes, and a comment about them at its top."""
    action = turned.action(bench)
    values = bench.values(turned.knobs, turned.numbers)
    lines = [
        f"Turned in feltmb live {__version__}, {time.strftime('%Y-%m-%d %H:%M')}.",
        f"Data set {bench.action.name}, hash {bench.action.hash}.",
        *(
            f"  {bench.knobs[name].label}: {value:+.6g} {bench.knobs[name].unit}"
            for name, value in turned.knobs.items()
        ),
        "As of the command line: " + " ".join(f"--set '{p}={v}'" for p, v in values.items()),
    ]
    return "".join(f"# {_one_line(line)}\n" for line in lines) + "\n" + action.to_toml()


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
