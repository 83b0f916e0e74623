"""The live page while a control is dragged: latency in Chromium, and memory of the server.

    python bench/speed/live_page.py latency [--changes 60] [--every 0.03] [--tab numbers] [--page]
    python bench/speed/live_page.py memory [--minutes 30] [--rate 6]

The server is a process of its own; with --page the file of `feltmb page` is measured. Latency: from
a change of the slider to the frame after the new picture was drawn, of every change, and its parts;
the work of the main thread of the browser, and the processor times of the server and of all
processes of the browser, by picture. Memory: three random controls at a time, two strokes, six
random curves, a rest of 0.8 s after 20 changes, a new connection after 400; the least and the
largest of each minute.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType, SimpleNamespace

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
TICK = os.sysconf("SC_CLK_TCK")
SLIDER = """(() => {
  const e = document.querySelector('[data-key="screw.let-off"] input[type=range]');
  const b = e.getBoundingClientRect();
  return [b.x, b.y, b.width, b.height];
})()"""
#: Parts of the time of a picture [ms]: those that the server tells, the rest of the way of the
#: answer, the script of the page, and the wait for the next frame.
LISTEN = """(() => {
  const live = feltmbLive, hear = live.hear;
  live.times = [];
  window.told = {};
  live.hear = function (m) {
    const quick = m.on === "run" && m.run.quality === "quick";
    if (!quick || !live.sent.has(m.id)) return hear.call(this, m);
    const parts = {...m.run.milliseconds}, heard = performance.now();
    parts.transport = heard - live.sent.get(m.id) - Object.values(parts).reduce((a, b) => a + b, 0);
    hear.call(this, m);
    const drawn = parts.script = performance.now() - heard;
    requestAnimationFrame(() => {
      parts.frame = performance.now() - heard - drawn;
      for (const [name, t] of Object.entries(parts)) (told[name] ||= []).push(t);
    });
  };
  return 1;
})()"""
#: Counters of the browser: work of its main thread [s].
WORK = ("TaskDuration", "ScriptDuration", "LayoutDuration", "RecalcStyleDuration")


def of_tests(path: str) -> ModuleType:
    """A conftest as a module."""
    spec = importlib.util.spec_from_file_location(path.replace("/", "_"), ROOT / "tests" / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def exported() -> Iterator[tuple[int, str]]:
    """No process, and the address of a file of `feltmb page`."""
    from feltmb import export_page

    with TemporaryDirectory() as folder:
        yield 0, export_page("steinway45", Path(folder) / "action.html").as_uri()


@contextmanager
def serving() -> Iterator[tuple[int, str]]:
    """Process and address of a live server."""
    command = [sys.executable, "-m", "feltmb", "live", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        yield server.pid, next(line for line in server.stdout if "http" in line).split()[-1]
    finally:
        server.terminate()
        server.wait(10)


def numbers_of(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def processor(pid: int) -> float:
    """Processor time [s] of a process and all below it, to a tick; 0 of no process."""
    if not pid:
        return 0.0
    found = numbers_of(pid)
    total = (int(found[11]) + int(found[12])) / TICK
    for other in Path("/proc").iterdir():
        if other.name.isdigit():
            try:
                if int(numbers_of(int(other.name))[1]) == pid:
                    total += processor(int(other.name))
            except OSError:
                continue
    return total


def resident(pid: int) -> float:
    """Memory [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def latency(changes: int, every: float, tab: str, page_file: bool) -> None:
    browser = of_tests("python/graphics/conftest.py").Browser
    where = exported() if page_file else serving()
    with where as (pid, address), browser(1400, 900) as page:

        def until(expression: str) -> None:
            end = time.monotonic() + 60.0
            while not page.run(expression):
                assert time.monotonic() < end, expression
                time.sleep(0.05)

        def drag(count: int) -> None:
            x, y, w, h = page.run(SLIDER)
            page.mouse("mousePressed", x + 0.5 * w, y + 0.5 * h)
            for i in range(1, count + 1):
                begin = time.monotonic()
                away = 0.3 * abs((i + 20) % 40 - 20) / 20.0
                page.mouse("mouseMoved", x + (0.5 - away) * w, y + 0.5 * h, buttons=1)
                time.sleep(max(0.0, every - (time.monotonic() - begin)))
            page.mouse("mouseReleased", x + 0.5 * w, y + 0.5 * h)

        def work() -> list[float]:
            found = {m["name"]: m["value"] for m in page.call("Performance.getMetrics")["metrics"]}
            return [found[name] for name in WORK]

        begin = time.monotonic()
        page.open(address)
        page.call("Performance.enable")
        until("!!(window.feltmbLive && feltmbLive.viewer)")
        print(f"first picture: {1e3 * (time.monotonic() - begin):.0f} ms")
        until("!!(window.feltmbLive && feltmbLive.viewer && feltmbLive.got.a.quality === 'full')")
        page.run(f"feltmbLive.tab = {tab!r}; feltmbLive.fillTab(); 1")
        drag(20)
        time.sleep(1.5)
        page.run(LISTEN)
        before = processor(pid), processor(page._process.pid), *work()
        drag(changes)
        until("!feltmbLive.sent.size")
        after = processor(pid), processor(page._process.pid), *work()
        until(f"feltmbLive.times.length >= {changes}")
        times, told = page.run("feltmbLive.times"), page.run("told")
    pictures = len(told["script"])
    deciles, most = statistics.quantiles(times, n=10), statistics.quantiles(times, n=20)[-1]
    print(f"load {os.getloadavg()[0]:.1f}; {len(times)} changes, {pictures} pictures")
    print(
        f"change to picture: median {statistics.median(times):.0f} ms, "
        f"deciles {deciles[0]:.0f} and {deciles[-1]:.0f} ms, 95 % within {most:.0f} ms"
    )
    parts = [f"{name} {statistics.median(values):.1f}" for name, values in told.items()]
    print(f"parts of a picture, medians [ms]: {', '.join(parts)}")
    costs = [1e3 * (b - a) / pictures for a, b in zip(before, after, strict=True)]
    print("processor time by picture: server {:.0f} ms, browser {:.0f} ms".format(*costs[:2]))
    print(
        "main thread by picture: all {:.1f} ms, script {:.1f}, layout {:.1f}, style {:.1f}".format(
            *costs[2:]
        )
    )


def memory(minutes: float, rate: float) -> None:
    client = of_tests("python/live/conftest.py").Client
    rng = np.random.default_rng(5)
    begin, k, pages, due, sizes = time.monotonic(), 0, 0, 0.0, []
    with serving() as (pid, address):

        def tell() -> None:
            print(
                f"{(time.monotonic() - begin) / 60.0:5.1f} min, {k} changes, {pages} pages: "
                f"{min(sizes):.1f} to {max(sizes):.1f} MB, {processor(pid):.0f} s processor",
                flush=True,
            )

        end = begin + 60.0 * minutes
        while time.monotonic() < end:
            with client(SimpleNamespace(address=address)) as page:
                pages += 1
                knobs, outputs = page.hello["knobs"], [o[0] for o in page.hello["outputs"]]
                for _ in range(400):
                    if time.monotonic() > end:
                        break
                    k += 1
                    at = time.monotonic()
                    some = rng.choice(len(knobs), 3, replace=False)
                    drag = {
                        knobs[i]["name"]: rng.uniform(0.2, 0.4) * knobs[i]["high"] for i in some
                    }
                    playing = {"kind": "press", "force": rng.uniform(3.0, 20.0)} if k % 3 else {}
                    shown = list(rng.choice(outputs, 6, replace=False))
                    page.send(
                        "simulate", id=k, turned={"knobs": drag}, playing=playing, shown=shown
                    )
                    page.until(lambda m, k=k: m["on"] in ("run", "fault") and m["id"] == k)
                    rest = 0.8 if k % 20 == 0 else 0.0
                    time.sleep(max(rest, 1.0 / rate - (time.monotonic() - at)))
                    sizes.append(resident(pid))
                    if time.monotonic() - begin >= due:
                        tell()
                        due += 60.0
                        sizes.clear()
        if sizes:
            tell()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["latency", "memory"])
    parser.add_argument("--changes", type=int, default=60)
    parser.add_argument("--every", type=float, default=0.03, help="time between changes [s]")
    parser.add_argument("--tab", default="numbers")
    parser.add_argument("--page", action="store_true", help="the file of feltmb page")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=6.0, help="changes a second")
    given = parser.parse_args()
    if given.what == "latency":
        latency(given.changes, given.every, given.tab, given.page)
    else:
        memory(given.minutes, given.rate)


if __name__ == "__main__":
    main()
