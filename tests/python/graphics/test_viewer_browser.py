"""The page of feltmb view in a real browser: what is drawn, what the hands do, what it asks for."""

import io
import json

import numpy as np
import pytest

import feltmb
from feltmb import Action
from feltmb.graphics.plot.poses import body_poses
from feltmb.graphics.viewer import Curves, assets, fragment, view

VIEWER = "document.querySelector('.feltmb-view').viewer"


@pytest.fixture
def opened(browser, forte, piano, tmp_path_factory):
    """The page of two strokes, freshly loaded."""
    if not hasattr(browser, "two"):
        browser.two = view([forte, piano], tmp_path_factory.mktemp("view") / "two.html")
    browser.resize(1280, 900)
    browser.open(browser.two)
    return browser


def seek(browser, milliseconds):
    browser.run(f"{VIEWER}.seek({milliseconds}); 1")


def pixels(browser, selector):
    """RGB of an element, (height, width, 3)."""
    from PIL import Image

    box = json.loads(
        browser.run(f"JSON.stringify(document.querySelector('{selector}').getBoundingClientRect())")
    )
    with Image.open(io.BytesIO(browser.picture(whole=True))) as image:
        corners = [box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"]]
        return np.asarray(image.convert("RGB").crop([round(c) for c in corners])).astype(int)


def share(picture, color, near=40):
    """Part of a picture in a color."""
    return float(np.mean(np.abs(picture - np.array(color)).max(axis=2) < near))


ORANGE, BLUE = (0xD5, 0x5E, 0x00), (0x00, 0x72, 0xB2)


def test_it_loads_nothing_else_and_complains_of_nothing(opened):
    seek(opened, 95)
    opened.run(f"{VIEWER}.toggle(true); new Promise(go => setTimeout(go, 300))")
    assert opened.requests() == [opened.two.resolve().as_uri()]
    assert opened.complaints() == []


def test_the_numbers_of_the_page_are_those_of_the_runs(opened, forte, piano):
    names = ("hammer_tip.vx", "contact06.force", "key.angle", "string.strike", "energy.kinetic")
    factor = {"string.strike": 1e3, "key.angle": 180 / np.pi, "energy.kinetic": 1e3}
    times = (60.0, 92.7, 93.4, 94.0, 150.0, 333.3)
    got = opened.run(
        f"{json.dumps(times)}.map(t => {json.dumps(names)}.map("
        f"n => {VIEWER}.runs.map(r => r.curves.get(n).at(t))))"
    )
    for t, row in zip(times, got, strict=True):
        for name, pair in zip(names, row, strict=True):
            for run, value in zip((forte, piano), pair, strict=True):
                want = factor.get(name, 1.0) * np.interp(1e-3 * t, run.time, run[name])
                span = factor.get(name, 1.0) * np.ptp(run[name])
                assert value == pytest.approx(want, abs=5e-4 * span), (name, t)


def test_the_mechanism_is_where_the_run_has_it(opened, forte, action):
    bodies = ["ground", *action.config.bodies]
    for t in (60.0, 94.0, 140.0):
        seek(opened, t)
        q = [np.interp(1e-3 * t, forte.time, forte[name]) for name in action.coordinates]
        for name, (x, y, angle) in body_poses(action, q).items():
            here = opened.run(f"{VIEWER}.pose(0, {bodies.index(name)})")
            np.testing.assert_allclose(here, [1e3 * x, 1e3 * y, angle], atol=0.1)


def test_the_picture_changes_with_time_and_is_not_blank(opened):
    pictures = []
    for t in (60.0, 85.0, 94.0):
        seek(opened, t)
        pictures.append(pixels(opened, ".fv-stage"))
    for picture in pictures:
        ink = float(np.mean(picture.min(axis=2) < 200))
        assert 0.005 < ink < 0.4
    for a, b in ((0, 1), (1, 2)):
        assert float(np.mean(np.abs(pictures[a] - pictures[b]).max(axis=2) > 40)) > 0.002


def test_the_second_run_is_an_outline_that_can_be_hidden(opened):
    seek(opened, 88)
    opened.run(f"{VIEWER}.arrows.click(); 1")
    both = share(pixels(opened, ".fv-stage"), BLUE)
    assert both > 0.002
    opened.run("document.querySelectorAll('.fv-chip input')[1].click(); 1")
    assert share(pixels(opened, ".fv-stage"), BLUE) < 0.1 * both


def test_forces_are_arrows_of_the_color_of_their_run(opened):
    seek(opened, 94)
    opened.run("document.querySelectorAll('.fv-chip input')[1].click(); 1")
    with_arrows = share(pixels(opened, ".fv-stage"), ORANGE, 25)
    opened.run(f"{VIEWER}.arrows.click(); 1")
    without = share(pixels(opened, ".fv-stage"), ORANGE, 25)
    assert with_arrows > 5 * without + 5e-4
    values = opened.run("[...document.querySelectorAll('.fv-left .fv-v')].map(e => e.textContent)")
    assert sum(v.endswith(" N") for v in values) >= 3


def test_the_string_strip_shows_its_wave(opened, forte):
    seek(opened, 60)
    still = pixels(opened, ".fv-string")[30:]
    rows = np.flatnonzero(np.any(np.abs(still - np.array(ORANGE)).max(axis=2) < 60, axis=1))
    assert np.ptp(rows) < 6 if rows.size else True
    seek(opened, 1e3 * float(forte.time[np.argmax(forte["string.strike"])]))
    moved = pixels(opened, ".fv-string")[18:]
    rows = np.flatnonzero(np.any(np.abs(moved - np.array(ORANGE)).max(axis=2) < 60, axis=1))
    assert np.ptp(rows) > 20


def test_playing_follows_the_slowness(opened):
    gone = opened.run(
        f"(async () => {{ const v = {VIEWER}; v.slow.value = '10'; v.seek(60); v.toggle(true);"
        "await new Promise(go => requestAnimationFrame(() => requestAnimationFrame(go)));"
        "const a = [v.now, v.stamp]; await new Promise(go => setTimeout(go, 400));"
        "const b = [v.now, v.stamp]; v.toggle(false); return [b[0] - a[0], b[1] - a[1]]; })()"
    )
    assert gone[1] > 200.0
    assert gone[0] == pytest.approx(gone[1] / 10, rel=1e-6)


def test_it_begins_again_at_the_end(opened):
    now = opened.run(
        f"(async () => {{ const v = {VIEWER}; v.slow.value = '0.01'; v.toggle(true);"
        "await new Promise(go => setTimeout(go, 200)); v.toggle(false);"
        "return [v.now >= v.window[0] && v.now <= v.window[1]]; })()"
    )
    assert now == [True]


def test_keys_and_slider(opened):
    opened.run("document.querySelector('.feltmb-view').focus(); 1")
    seek(opened, 90)
    window = opened.run(f"{VIEWER}.window")
    step = (window[1] - window[0]) / 500
    opened.press("ArrowRight")
    assert opened.run(f"{VIEWER}.now") == pytest.approx(90 + step)
    opened.press("End")
    assert opened.run(f"{VIEWER}.now") == pytest.approx(window[1])
    opened.press("Home")
    assert opened.run(f"{VIEWER}.now") == pytest.approx(window[0])
    opened.press(" ", "Space", " ")
    assert opened.run(f"{VIEWER}.playing") is True
    opened.run(
        "(() => { const s = document.querySelector('.fv-slider'); s.value = 5000;"
        "s.dispatchEvent(new Event('input')); return 1; })()"
    )
    assert opened.run(f"{VIEWER}.playing") is False
    assert opened.run(f"{VIEWER}.now") == pytest.approx(sum(window) / 2)


def test_a_drag_in_a_curve_moves_the_time_and_with_shift_enlarges(opened):
    box = opened.run(
        "(r => [r.x, r.y, r.width, r.height])"
        "(document.querySelector('.fv-panel canvas').getBoundingClientRect())"
    )
    low, high = opened.run(f"{VIEWER}.window")

    def x(part):
        return box[0] + 52 + part * (box[2] - 62)

    y = box[1] + 0.5 * box[3]
    opened.mouse("mousePressed", x(0.25), y)
    opened.mouse("mouseMoved", x(0.5), y, buttons=1)
    opened.mouse("mouseReleased", x(0.5), y)
    middle = low + 0.5 * (high - low)
    assert opened.run(f"{VIEWER}.now") == pytest.approx(middle, abs=0.01 * (high - low))
    opened.mouse("mousePressed", x(0.4), y, modifiers=8)
    opened.mouse("mouseMoved", x(0.6), y, buttons=1, modifiers=8)
    opened.mouse("mouseReleased", x(0.6), y, modifiers=8)
    window = opened.run(f"{VIEWER}.window")
    want = [low + 0.4 * (high - low), low + 0.6 * (high - low)]
    assert window == pytest.approx(want, abs=0.01 * (high - low))


def test_events_are_gone_to_and_runs_aligned(opened, forte, piano):
    strike = [1e3 * run.event_time("string_contact_on") for run in (forte, piano)]
    opened.run(
        "[...document.querySelectorAll('.fv-events button')]"
        ".find(b => b.textContent === 'string contact on').click()"
    )
    assert opened.run(f"{VIEWER}.now") == pytest.approx(strike[0], abs=1e-3)
    opened.run(
        f"(() => {{ const a = {VIEWER}.aligner; a.value = 'string contact on';"
        "a.dispatchEvent(new Event('change')); return 1; })()"
    )
    times = opened.run(f"{VIEWER}.runs.map(r => r.time({strike[0]}))")
    assert times == pytest.approx(strike, abs=1e-3)


def test_curves_are_added_and_removed(opened):
    before = opened.run("document.querySelectorAll('.fv-panel').length")
    opened.run(
        "(() => { const s = document.querySelector('.fv-adder select'); s.value = 'jack.angle';"
        "s.dispatchEvent(new Event('change')); return 1; })()"
    )
    assert opened.run("document.querySelectorAll('.fv-panel').length") == before + 1
    opened.run("document.querySelector('.fv-close').click()")
    assert opened.run("document.querySelectorAll('.fv-panel').length") == before
    assert "jack.angle" in opened.run("document.querySelector('.fv-right').textContent")
    assert opened.complaints() == []


def test_on_a_small_screen_it_is_one_column(opened):
    opened.resize(600, 900)
    opened.open(opened.two)
    assert opened.run("document.documentElement.scrollWidth") <= 600
    left, right = (
        opened.run(f"document.querySelector('.fv-{side}').getBoundingClientRect().y")
        for side in ("left", "right")
    )
    assert right > left + 200


def test_texts_of_files_run_nothing(browser, action, tmp_path):
    evil = "<img src=x onerror=\"document.title='owned'\"></script><script>document.title='owned'//"
    raw = action.raw
    raw["name"] = evil
    raw["contacts"]["06"]["label"] = evil
    run = feltmb.simulate(
        Action(raw), feltmb.ramp_stroke(25.0, 0.001, 0.02, duration=0.05, name=evil), 0.05
    )
    measured = Curves(evil, [0.0, 0.05], {evil: [0.0, 1.0]}, {evil: evil})
    browser.open(view([run, measured], tmp_path / "evil.html"))
    assert browser.run("document.title") == f"{evil} · {evil} and {evil}"
    assert browser.run("document.images.length") == 0
    assert browser.run("document.scripts.length") == 2
    assert evil in browser.run("document.querySelector('.fv-left').textContent")
    assert browser.complaints() == []
    # The policy of the page refuses a script even if one got in.
    browser.run(
        "(() => { const s = document.createElement('script');"
        "s.textContent = \"document.title = 'owned'\"; document.body.append(s); return 1; })()"
    )
    assert browser.run("document.title") != "owned"


def test_two_viewers_live_in_one_page(browser, forte, piano, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(
        '<!DOCTYPE html><meta charset="utf-8"><title>r</title>'
        + assets()
        + "<h2>before</h2>"
        + fragment(forte, window=(0.08, 0.1), at=0.09)
        + "<h2>after</h2>"
        + fragment([forte, piano], window=(0.08, 0.1)),
        encoding="utf-8",
    )
    browser.open(path)
    assert browser.run("document.querySelectorAll('.fv-stage').length") == 2
    seek(browser, 95)
    times = browser.run("[...document.querySelectorAll('.feltmb-view')].map(e => e.viewer.now)")
    assert times[0] == pytest.approx(95)
    assert times[1] == pytest.approx(80, abs=0.5)
    assert browser.complaints() == []


def test_curves_alone_are_shown_with_their_holes(browser, tmp_path):
    time = np.linspace(0, 1, 400)
    wave = np.where((time > 0.4) & (time < 0.6), np.nan, np.sin(20 * time))
    path = view(Curves("rig", time, {"u": wave}, {"u": "V"}), tmp_path / "rig.html")
    browser.open(path)
    assert browser.run("document.querySelector('.fv-stage')") is None
    seek(browser, 500)
    assert "–" in browser.run("document.querySelector('.fv-legend').textContent")
    seek(browser, 100)
    text = browser.run("document.querySelector('.fv-legend').textContent")
    assert float(text.split()[-1]) == pytest.approx(np.sin(2.0), abs=2e-3)
    assert browser.complaints() == []
