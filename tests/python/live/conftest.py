"""A live server in a thread, pages that talk with it, and the browser of the viewer's tests."""

import contextlib
import importlib.util
import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import feltmb

pytest.importorskip("starlette", reason="extra live is not installed")
pytest.importorskip("uvicorn", reason="extra live is not installed")
pytest.importorskip("websockets", reason="extra live is not installed")

_spec = importlib.util.spec_from_file_location(
    "viewer_browser", Path(__file__).parents[1] / "graphics" / "conftest.py"
)
_viewer = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_viewer)
browser = _viewer.browser


@contextlib.contextmanager
def running(mechanism="steinway45", records=()):
    """A server that answers."""
    from feltmb.live.server import Live

    live = Live(mechanism, records)
    thread = threading.Thread(target=live.run, daemon=True)
    thread.start()
    until = time.monotonic() + 30.0
    while not live.started and time.monotonic() < until:
        time.sleep(0.01)
    assert live.started
    try:
        yield live
    finally:
        live.stop()
        thread.join(20.0)
        assert not thread.is_alive()


@pytest.fixture(scope="session")
def live():
    """One server of the packaged action for all tests that leave it as it is."""
    with running() as server:
        yield server


@pytest.fixture
def serve():
    """Further servers."""
    return running


def unpacked(message):
    """What a binary message holds; packed numbers as bytes."""
    start = 4 + int.from_bytes(message[:4], "little")

    def of(table):
        if "data" in table:
            at, size = table["data"]
            table["data"] = message[start + at : start + at + size]
        return table

    return json.loads(message[4:start], object_hook=of)


class Client:
    """The other end of the WebSocket, as the page is."""

    def __init__(self, server, **options):
        from websockets.sync.client import connect

        base = server.address
        origin = options.pop("origin", base.rsplit("/", 2)[0])
        self._open = connect(
            base.replace("http", "ws") + "socket", origin=origin, max_size=None, **options
        )

    def __enter__(self):
        self.socket = self._open.__enter__()
        self.hello = self.until(lambda m: m["on"] == "hello")
        return self

    def __exit__(self, *what):
        self._open.__exit__(*what)

    def send(self, do, **what):
        self.socket.send(json.dumps({"do": do, **what}))

    def until(self, wanted, wait=60.0):
        """The first message that is wanted."""
        end = time.monotonic() + wait
        while True:
            data = self.socket.recv(timeout=max(0.01, end - time.monotonic()))
            m, self.bytes = unpacked(data), len(data)
            if wanted(m):
                return m

    def run(self, number, quality="full", **what):
        """The picture of a request."""
        self.send("simulate", id=number, **what)
        return self.until(
            lambda m: m["on"] == "run" and m["id"] == number and m["run"]["quality"] == quality
        )


@pytest.fixture(scope="session")
def capstan_records():
    """Name and text of measured strokes of an action whose capstan stands 0.6 mm too low."""
    action = feltmb.load_action("steinway45").with_values({"surfaces.Kp2.point.y": 0.032})
    channels = ["key_front.y", "whippen.y", "hammer_tip.x", "hammer_tip.y", "backcheck.x"]
    rng = np.random.default_rng(1)
    out = {}
    for name in ("forte", "piano", "staccato"):
        run = feltmb.simulate(action, name, output_rate=2000.0)
        moved = np.column_stack([1e3 * (run[c] - run[c][0]) for c in channels])
        moved += rng.normal(scale=0.02, size=moved.shape)
        table = np.column_stack([run.time, run["finger.force"], moved])
        head = ",".join(["time [s]", "finger.force [N]", *(f"{c} [mm]" for c in channels)])
        rows = "\n".join(",".join(f"{v:.7g}" for v in row) for row in table)
        out[f"{name}.csv"] = f"{head}\n{rows}"
    return out


@pytest.fixture
def client():
    """A page by its server."""
    return Client
