"""Draws the pictures of docs/howto/live.md and page.md: pages in Chromium, by day and by night.

python tools/make_live_pictures.py [NAME...]
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from docs_pages import small_png

ROOT = Path(__file__).resolve().parents[1]

FOLDER = ROOT / "docs" / "img" / "live"
ACTION = "steinway45_leaded"
#: Name -> width, height, color scheme, tab, scroll position.
VIEWS = {
    "wide": (1400, 1000, "light", "regulation", 0),
    "wide_dark": (1400, 1000, "dark", "numbers", 0),
    "middle": (800, 1000, "light", "numbers", 0),
    "middle_dark": (800, 1000, "dark", "numbers", 0),
    "narrow": (390, 844, "light", "numbers", 400),
    "narrow_dark": (390, 844, "dark", "numbers", 400),
    "regulation": (1000, 420, "light", "regulation", -1),
    "touch": (1000, 520, "light", "touch", -1),
    "measured": (1000, 900, "light", "measured", -1),
    "plan": (1000, 560, "light", "measured", -1),
}
TURN = (
    "feltmbLive.change('t', n => { n.knobs['screw.let-off'] = -0.0008; }); feltmbLive.fillTurn(); 1"
)


def browser_of_the_tests() -> Any:
    """Chromium of the tests, controlled by its DevTools protocol."""
    path = ROOT / "tests" / "python" / "graphics" / "conftest.py"
    spec = importlib.util.spec_from_file_location("viewer_browser", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Browser


def until(page: Any, expression: str) -> None:
    """Wait until an expression in the page is true."""
    end = time.monotonic() + 120.0
    while not page.run(expression):
        if time.monotonic() > end:
            raise TimeoutError(f"{expression}: {page.complaints()}")
        time.sleep(0.1)


def measured_file(folder: Path) -> Path:
    """A stroke of an action whose capstan is 0.3 mm too low, with the noise of a camera."""
    import numpy as np

    import feltmb

    action = feltmb.load_action(ACTION).with_values({"capstan-=": "0.3 mm"})
    run = feltmb.simulate(action, "piano", output_rate=2000.0)
    noise = np.random.default_rng(3).normal(scale=2e-5, size=(len(run.time), 2))
    rows = ["time [s],finger.force [N],key_front.y [mm],hammer_tip.x [mm]"]
    for i, t in enumerate(run.time):
        moved = [run[n][i] - run[n][0] for n in ("key_front.y", "hammer_tip.x")] + noise[i]
        numbers = ",".join(f"{1e3 * v:.5g}" for v in moved)
        rows.append(f"{t:.6g},{run['finger.force'][i]:.6g},{numbers}")
    path = folder / "rig.csv"
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def draw_page() -> None:
    """The page of ``unmodeled page`` with the servo of the guide First answer."""
    import shutil
    import subprocess

    from unmodeled.page.serve import PageServer

    fault = "(e => e.hidden ? '' : e.textContent)(document.getElementById('fault'))"
    with tempfile.TemporaryDirectory() as text, browser_of_the_tests()(1000, 700) as page:
        folder = Path(text)
        for path in (ROOT / "examples" / "first_answer").iterdir():
            if path.is_file():
                shutil.copy(path, folder)
        subprocess.run([sys.executable, "measure.py", "servo"], cwd=folder, check=True)
        server = PageServer(str(folder / "servo.xml"), sorted(folder.glob("servo_*.csv")))
        threading.Thread(target=server.run, daemon=True).start()
        while not server.started:
            time.sleep(0.05)
        page.open(server.address)
        until(page, "document.querySelectorAll('#columns select').length > 0")
        page.run("document.getElementById('check').click()")
        until(page, "document.querySelectorAll('#checked figure').length > 0")
        page.run("document.getElementById('search').click()")
        until(page, "!document.getElementById('answer').hidden")
        time.sleep(1.0)
        if told := page.run(fault):
            raise RuntimeError(told)
        for name, width, height, there in (
            ("page_check", 1000, 900, "h-records"),
            ("page_answer", 1000, 900, "h-answer"),
            ("page_narrow", 390, 844, "h-check"),
        ):
            page.resize(width, height)
            time.sleep(0.5)
            page.run(f"document.getElementById('{there}').scrollIntoView(); 1")
            time.sleep(0.5)
            drawn = folder / f"{name}.png"
            drawn.write_bytes(page.picture())
            small_png(drawn, FOLDER / f"{name}.png", width=width, colors=256)
            print(name, flush=True)
        server.stop()


def main() -> None:
    """Draw all of them."""
    from feltmb.live.server import Live

    if not sys.argv[1:] or "page" in sys.argv[1:]:
        draw_page()
    if sys.argv[1:] == ["page"]:
        return

    FOLDER.mkdir(parents=True, exist_ok=True)
    wanted = [name for name in sys.argv[1:] if name != "page"] or list(VIEWS)
    with tempfile.TemporaryDirectory() as text, browser_of_the_tests()(1400, 1000) as page:
        folder = Path(text)
        live = Live(ACTION, [measured_file(folder)])
        threading.Thread(target=live.run, daemon=True).start()
        while not live.started:
            time.sleep(0.05)
        for name in wanted:
            width, height, scheme, tab, down = VIEWS[name]
            page.resize(width, height)
            feature = {"name": "prefers-color-scheme", "value": scheme}
            page.call("Emulation.setEmulatedMedia", features=[feature])
            page.open("about:blank")
            page.open(live.address)
            until(page, "!!(window.feltmbLive && feltmbLive.viewer)")
            if tab != "measured":
                page.run("feltmbLive.keep(); 1")
                page.run(TURN)
            page.run(f"feltmbLive.tab = '{tab}'; feltmbLive.fillTab(); feltmbLive.ask(true); 1")
            until(page, "feltmbLive.got.a.quality === 'full' && !feltmbLive.dirty")
            kinds = {"regulation": "targets", "touch": "touch", "measured": "measured"}
            if tab in kinds:
                for kind in [kinds[tab], *(["touch b"] if tab == "touch" else [])]:
                    until(page, f"!!(feltmbLive.last && feltmbLive.last['{kind}'])")
            if name == "plan":
                page.run("feltmbLive.plan(); 1")
                until(page, "!!feltmbLive.last.plan")
            page.run("feltmbLive.viewer.seek(88); feltmbLive.say(''); 1")
            if name == "plan":
                page.run("feltmbLive.planBox.parentElement.querySelector('h3').scrollIntoView(); 1")
            elif down < 0:
                page.run("document.getElementById('more').scrollIntoView(); 1")
            else:
                page.run(f"window.scrollTo(0, {down}); 1")
            time.sleep(0.5)
            drawn = folder / f"{name}.png"
            drawn.write_bytes(page.picture())
            small_png(drawn, FOLDER / f"{name}.png", width=min(width, 1300), colors=256)
            print(name, flush=True)
        live.stop()


if __name__ == "__main__":
    main()
