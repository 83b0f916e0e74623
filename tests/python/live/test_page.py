"""The live page in a real browser: what hands do, what is drawn, what it survives."""

import json
import time

import numpy as np
import pytest

import feltmb

READY = "!!(window.feltmbLive && feltmbLive.viewer && feltmbLive.got.a.quality === 'full')"


def until(page, expression, wait=60.0):
    """Wait until an expression of the page is true."""
    end = time.monotonic() + wait
    while not page.run(expression):
        assert time.monotonic() < end, (expression, page.complaints())
        time.sleep(0.05)


@pytest.fixture
def opened(browser, live):
    """The page of the packaged action, nothing turned."""
    browser.resize(1400, 900)
    browser.call("Emulation.setEmulatedMedia", features=[])
    browser.open("about:blank")
    browser.open(live.address)
    until(browser, READY)
    return browser


def center(page, selector):
    return page.run(
        f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
        "e.scrollIntoView({block: 'center'}); const b = e.getBoundingClientRect();"
        "return [b.x, b.y, b.width, b.height]; })()"
    )


def slider(page, knob):
    return center(page, f'[data-key="{knob}"] input[type=range]')


def settled(page, more=""):
    until(page, f"!feltmbLive.sent.size && feltmbLive.times.length > 0 {more}")


def tip(page):
    """The hammer's path as the page has it [mm]."""
    return np.array(page.run("[...feltmbLive.viewer.runs[0].curves.get('hammer_tip.x').values]"))


def test_it_asks_nobody_else_and_complains_of_nothing(opened, live):
    assert all(r.startswith(live.address) for r in opened.requests())
    assert opened.complaints() == []


def test_a_dragged_screw_changes_the_path_of_the_hammer(opened):
    before = tip(opened)
    x, y, w, h = slider(opened, "screw.let-off")
    opened.mouse("mousePressed", x + 0.5 * w, y + 0.5 * h)
    for k in range(1, 9):
        opened.mouse("mouseMoved", x + (0.5 - 0.05 * k) * w, y + 0.5 * h, buttons=1)
    opened.mouse("mouseReleased", x + 0.1 * w, y + 0.5 * h)
    settled(opened)
    after = tip(opened)
    turned = opened.run("feltmbLive.state.now.knobs['screw.let-off']")
    assert turned == pytest.approx(-0.0016, abs=2e-4)
    common = min(len(before), len(after))
    assert np.max(np.abs(before[:common] - after[:common])) > 0.5
    until(opened, READY)
    action = feltmb.load_action("steinway45")
    run = feltmb.simulate(action.with_values({"surfaces.Gp10.point.y": 0.077 + turned}), "forte")
    shown = opened.run(
        "Object.fromEntries([...document.querySelectorAll('.numbers tr[data-name]')].map(r =>"
        "[r.dataset.name, Number(r.querySelector('[data-value]').dataset.value)]))"
    )
    assert shown == pytest.approx(run.summary, rel=1e-9)
    print("change to picture, median [ms]:", np.median(opened.run("feltmbLive.times")))


def test_surfaces_move_with_what_is_turned_before_the_whole_look_comes(opened):
    points = (
        "Object.fromEntries(['Gp10', 'Gp8'].map(n => [n, feltmbLive.viewer.runs[0].stage.shapes"
        ".find(s => s.surface === n).points[0]]))"
    )
    before = opened.run(points)
    opened.run(
        "feltmbLive.pictured({on: 'run', slot: 'a', id: 0, set: {}, run: {...feltmbLive.got.a,"
        "quality: 'quick', stage: {...feltmbLive.got.a.stage, look: undefined,"
        "shifts: {Gp10: [1, -2]}}}}); 1"
    )
    after = opened.run(points)
    assert np.subtract(after["Gp10"], before["Gp10"]) == pytest.approx([1.0, -2.0])
    assert after["Gp8"] == before["Gp8"]


def test_while_turning_nothing_is_built_anew(opened):
    opened.run(
        "window.built = []; new MutationObserver(found => { for (const m of found)"
        "for (const n of m.addedNodes) if (n.nodeType === 1) built.push(n.outerHTML); })"
        ".observe(document.getElementById('see'), {childList: true, subtree: true}); 1"
    )
    turn = "feltmbLive.change('t', n => {{ n.knobs['felt.06'] = {}; }}); 1"
    peaks = []
    for k in range(4):
        opened.run(turn.format(0.02 * k))
        settled(opened)
        until(opened, READY)
        peaks.append(opened.run("feltmbLive.got.a.summary.max_impact_force"))
        cell = "document.querySelector('[data-name=max_impact_force] [data-value]')"
        assert opened.run(f"Number({cell}.dataset.value)") == peaks[-1]
        assert opened.run(f"parseFloat({cell}.textContent)") == pytest.approx(peaks[-1], rel=1e-4)
    assert opened.run("built") == []
    assert len(set(peaks)) == 4


def test_while_turning_a_picture_ends_where_motion_and_view_end(opened):
    opened.run(
        "window.ends = []; const pictured = feltmbLive.pictured;"
        "feltmbLive.pictured = function (m) { pictured.call(this, m);"
        "const {time} = this.viewer.runs[0].curves.get('hammer_tip.x');"
        "ends.push(time[time.length - 1] / this.got.a.last); }; 1"
    )
    end = opened.run("feltmbLive.got.a.busy[1] / feltmbLive.got.a.last")
    for view, share in (("busy", end), ("all", 1.0)):
        opened.run(f"feltmbLive.viewer.look('{view}'); ends = []; 1")
        opened.run("feltmbLive.change('t', n => { n.knobs['felt.06'] = Math.random(); }); 1")
        settled(opened)
        until(opened, READY)
        assert opened.run("ends") == pytest.approx([share, 1.0], abs=1e-6)
    assert end < 0.5


def test_a_contact_loop_follows_in_the_chart_that_is_there(opened):
    opened.run("feltmbLive.tab = 'loops'; feltmbLive.loop = 6; feltmbLive.fillTab(); 1")
    until(opened, "document.querySelectorAll('#more .uplot').length === 1")
    until(opened, READY)
    opened.run("window.chart = feltmbLive.loopBox.plot.chart; 1")
    peaks = []
    for k in range(3):
        opened.run(f"feltmbLive.change('t', n => {{ n.knobs['felt.06'] = {0.1 * k}; }}); 1")
        settled(opened)
        until(opened, READY)
        assert opened.run("chart === feltmbLive.loopBox.plot.chart && chart.root.isConnected")
        peaks.append(opened.run("Math.max(...chart.data[1][1])"))
        scale = opened.run("[chart.scales.y.min, chart.scales.y.max]")
        assert scale[0] < 0 < peaks[-1] < scale[1]
    assert len(set(peaks)) == 3
    assert opened.run("document.querySelectorAll('#more .uplot, #more .legend').length") == 2
    opened.run("feltmbLive.tab = 'numbers'; feltmbLive.fillTab(); 1")
    opened.run("feltmbLive.tab = 'loops'; feltmbLive.fillTab(); 1")
    assert opened.run("chart !== feltmbLive.loopBox.plot.chart")
    assert opened.run("feltmbLive.charts.length") == 1
    assert opened.complaints() == []


def test_curves_out_of_sight_wait_until_nothing_is_turned(opened):
    opened.resize(390, 844)
    until(opened, "feltmbLive.viewer.panels.every(p => p.inSight === false)")
    until(opened, READY)
    opened.run(
        "window.drawn = 0; feltmbLive.viewer.panels.forEach(p => { const draw = p.drawStill;"
        "p.drawStill = function (...a) { drawn++; return draw.apply(this, a); }; }); 1"
    )
    render = "feltmbLive.viewer.panels.forEach(p => { p.key = null; }); feltmbLive.viewer.render();"
    assert opened.run(f"{render} {render} drawn") == 0
    until(opened, "drawn === feltmbLive.viewer.panels.length")
    opened.run(f"drawn = 0; {render} feltmbLive.viewer.panels[0].box.scrollIntoView(); 1")
    until(opened, "drawn > 0 && feltmbLive.viewer.panels[0].inSight")
    opened.resize(1400, 900)


def test_undo_redo_and_the_address(opened):
    opened.run("document.querySelector('[data-key=\"screw.key dip\"] input').focus(); 1")
    opened.run(
        "(() => { const i = document.querySelector('[data-key=\"screw.key dip\"] .value');"
        "i.value = '0.4'; i.dispatchEvent(new Event('change')); return 1; })()"
    )
    assert opened.run("feltmbLive.state.now.knobs") == {"screw.key dip": pytest.approx(4e-4)}
    until(opened, "location.hash.includes('key%20dip')")
    address = opened.run("location.href")
    opened.run("document.activeElement.blur(); 1")
    opened.call("Input.dispatchKeyEvent", type="keyDown", key="z", code="KeyZ", modifiers=2)
    assert opened.run("feltmbLive.state.now.knobs") == {}
    opened.call("Input.dispatchKeyEvent", type="keyDown", key="z", code="KeyZ", modifiers=10)
    assert opened.run("feltmbLive.state.now.knobs") == {"screw.key dip": pytest.approx(4e-4)}
    opened.open("about:blank")
    opened.open(address)
    until(opened, READY)
    assert opened.run("feltmbLive.got.a.set") == {"surfaces.Gp3.point.y": "-38.994 mm"}


def test_by_keyboard_alone_a_screw_is_found_and_turned(opened):
    opened.run("document.body.focus(); 1")
    opened.press("/", "Slash", "/")
    for letter in "let-off":
        opened.press(letter, text=letter)
    assert opened.run("document.querySelectorAll('.found .knob').length") >= 2
    opened.press("Tab", "Tab")
    opened.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab",
                windowsVirtualKeyCode=9)  # fmt: skip
    until(opened, "!!document.activeElement.closest('.found')", 5)
    for _ in range(4):
        if opened.run("document.activeElement.type") == "range":
            break
        opened.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab",
                    windowsVirtualKeyCode=9)  # fmt: skip
    for _ in range(3):
        opened.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight",
                    code="ArrowRight", windowsVirtualKeyCode=39)  # fmt: skip
    assert opened.run("Object.values(feltmbLive.state.now.knobs)[0]") > 0


def test_any_number_of_the_file_is_found_by_its_path(opened):
    opened.run(
        "(() => { const s = document.querySelector('#turn input[type=search]');"
        "s.value = 'string.diameter'; s.dispatchEvent(new Event('input')); return 1; })()"
    )
    opened.run(
        "(() => { const i = document.querySelector('.found [data-key=\"string.diameter\"] .value');"
        "i.value = '1.05'; i.dispatchEvent(new Event('change')); return 1; })()"
    )
    until(opened, "feltmbLive.got.a.set['string.diameter'] === '1.05 mm'")


def test_b_is_drawn_over_a_in_every_view(opened):
    opened.run(
        "[...document.querySelectorAll('#top button')]"
        ".find(b => b.textContent === 'Keep as B').click()"
    )
    opened.run("feltmbLive.change('t', n => { n.knobs['screw.let-off'] = 0.0005; }); 1")
    until(
        opened,
        "feltmbLive.got.b && feltmbLive.got.b.quality === 'full'"
        "&& feltmbLive.got.a.set['surfaces.Gp10.point.y'] === '77.5 mm'",
    )
    assert opened.run("feltmbLive.viewer.runs.length") == 2
    assert opened.run("document.querySelectorAll('.numbers tr')[1].cells.length") == 4
    a, b = opened.run("feltmbLive.viewer.runs.map(r => r.curves.get('hammer_tip.x').values.at(-1))")
    assert a != b
    opened.press("x", "KeyX", "x")
    until(opened, "!('screw.let-off' in feltmbLive.state.now.knobs)")
    assert opened.run("feltmbLive.state.now.b.knobs") == {"screw.let-off": 0.0005}


@pytest.mark.parametrize("kind", ["press", "strike", "slow", "repeat", "drawn"])
def test_every_way_to_play(opened, kind):
    opened.run(
        "(() => { const s = document.querySelector('.play select');"
        f"s.value = '{kind}'; s.dispatchEvent(new Event('change')); return 1; }})()"
    )
    until(opened, "!feltmbLive.sent.size && feltmbLive.played.includes("
          f"'\"kind\":\"{kind}\"')")  # fmt: skip
    assert opened.run("document.getElementById('faults').hidden")
    assert opened.complaints() == []


def test_names_and_numbers_are_drawn_where_wanted(opened):
    ink = "(() => { const c = feltmbLive.viewer.stage.canvas; return c.toDataURL(); })()"
    without = opened.run(ink)
    toggle = "feltmbLive.viewer.names.click(); 1"
    opened.run(toggle)
    assert opened.run(ink) != without
    assert "hammer butt" in opened.run("feltmbLive.viewer.runs[0].stage.bodies.map(b => b.name)")
    opened.run(toggle)
    assert opened.run(ink) == without


def test_the_scale_comes_from_two_clicks_in_a_picture(opened):
    opened.run("feltmbLive.hello.files = [{file: 'r1', name: 'a.csv', columns: []}]")
    opened.run("feltmbLive.tab = 'measured'; feltmbLive.fillTab(); 1")
    opened.run(
        "(async () => { const c = document.createElement('canvas'); c.width = 400; c.height = 300;"
        "const b = await new Promise(go => c.toBlob(go)); const d = new DataTransfer();"
        "d.items.add(new File([b], 'p.png'));"
        "const i = document.querySelector('input[accept=\"image/*\"]');"
        "i.closest('details').open = true; i.files = d.files;"
        "i.dispatchEvent(new Event('change')); })(); 1"
    )
    until(opened, "!document.querySelector('.photo').hidden")
    left, top, width, _ = center(opened, ".photo")
    for x, y in ((10, 20), (310, 220)):
        opened.mouse("mousePressed", left + x * width / 400, top + y * width / 400)
        opened.mouse("mouseReleased", left + x * width / 400, top + y * width / 400)
    length, x0, y0, x1, y1 = (
        float(t) for t in opened.run("feltmbLive.reading.scales['']").replace("mm from", "")
        .replace("to", "").split()
    )  # fmt: skip
    assert length == 100.0
    assert (x1 - x0, y1 - y0) == (pytest.approx(300, abs=2), pytest.approx(200, abs=2))
    opened.run("feltmbLive.hello.files = []; feltmbLive.reading = null; feltmbLive.fillFiles(); 1")
    assert opened.complaints() == []


def test_the_touch_is_drawn_to_the_forces_that_a_hand_feels(opened):
    opened.run("feltmbLive.tab = 'touch'; feltmbLive.fillTab(); feltmbLive.ask(true); 1")
    until(opened, "document.querySelectorAll('#more .uplot').length === 1")
    top = "feltmbLive.charts.at(-1).scales.y.max"
    assert opened.run(top) == 2
    opened.run("document.querySelector('#more input[type=checkbox]').click(); 1")
    assert opened.run(top) > 2
    opened.run("feltmbLive.allForces = false; feltmbLive.tab = 'numbers'; feltmbLive.fillTab(); 1")


def test_a_stroke_is_drawn_by_hand(opened):
    opened.run(
        "(() => { const s = document.querySelector('.play select');"
        "s.value = 'drawn'; s.dispatchEvent(new Event('change')); return 1; })()"
    )
    settled(opened)
    x, y, w, h = center(opened, ".draw")
    opened.mouse("mousePressed", x + 0.1 * w, y + 0.9 * h)
    for k in range(1, 12):
        opened.mouse("mouseMoved", x + (0.1 + 0.04 * k) * w, y + (0.9 - 0.06 * k) * h, buttons=1)
    opened.mouse("mouseReleased", x + 0.54 * w, y + 0.24 * h)
    until(
        opened,
        "feltmbLive.got.a.quality === 'full' && feltmbLive.state.now.playing.value.length > 8",
    )
    forces = opened.run("[...feltmbLive.viewer.runs[0].curves.get('finger.force').values]")
    assert max(forces) == pytest.approx(
        max(opened.run("feltmbLive.state.now.playing.value")), rel=0.02
    )


def test_a_lost_connection_resumes(opened):
    opened.run("feltmbLive.change('t', n => { n.knobs['felt.06'] = 0.2; }); 1")
    settled(opened)
    count = opened.run("feltmbLive.times.length")
    opened.run("feltmbLive.line.socket.close(); 1")
    until(opened, "feltmbLive.line.up")
    until(opened, f"feltmbLive.times.length > {count}")
    stiffness = opened.run("parseFloat(feltmbLive.got.a.set['contacts.06.loading.a'])")
    assert stiffness == pytest.approx(28200)


def test_what_cannot_be_simulated_is_said_and_the_page_goes_on(opened):
    opened.run("feltmbLive.change('t', n => { n.numbers['bodies.key.mass'] = -1; }); 1")
    until(opened, "!document.getElementById('faults').hidden")
    assert "mass" in opened.run("document.getElementById('faults').textContent")
    opened.run("feltmbLive.undo(); 1")
    until(opened, "document.getElementById('faults').hidden")


def test_a_dropped_csv_is_held_against_it(opened, live):
    run = feltmb.simulate("steinway45", "forte", output_rate=2000.0)
    rest = run["hammer_tip.x"][0]
    lines = ["time [s],finger.force [N],hammer_tip.x [mm]"] + [
        f"{t:.6g},{f:.6g},{1e3 * (x - rest):.6g}"
        for t, f, x in zip(run.time, run["finger.force"], run["hammer_tip.x"], strict=True)
        if t < 0.09
    ]
    opened.run("feltmbLive.tab = 'measured'; feltmbLive.fillTab(); 1")
    opened.run(
        "(() => { const d = new DataTransfer();"
        f"d.items.add(new File([{json.dumps(chr(10).join(lines))}], 'rig.csv'));"
        "document.querySelector('.drop').dispatchEvent(new DragEvent('drop',"
        "{dataTransfer: d, cancelable: true, bubbles: true})); return 1; })()"
    )
    until(opened, "document.querySelectorAll('.residuals tr').length === 1")
    cell = "parseFloat(document.querySelector('.residuals .n').textContent)"
    exact = opened.run(cell)
    opened.run("window.overlay = document.querySelector('#more .uplot'); 1")
    opened.run("feltmbLive.change('t', n => { n.knobs['mass.head'] = 0.1; }); 1")
    until(opened, f"{cell} > {3 * exact}")
    assert opened.run("document.querySelectorAll('#more .uplot canvas').length") == 1
    assert opened.run("overlay === document.querySelector('#more .uplot')")
    assert opened.complaints() == []
    for entry in live.studio.uploads.listing():
        live.studio.uploads.remove(entry["file"])


def test_a_proposed_stroke_is_played_by_a_click(opened):
    rows = [
        {"name": f"{name}: <b>9 N</b>", "reasons": ["separates a from b"], "before": 0.01,
         "after": 0.5, "playing": {"kind": "packaged", "name": name}}
        for name in ("piano", "staccato")
    ]  # fmt: skip
    plan = {"on": "plan", "rows": rows, "source": "the records", "notes": ["a note"]}
    opened.run("feltmbLive.tab = 'measured'; feltmbLive.fillTab(); 1")
    opened.run(f"feltmbLive.hear({json.dumps(plan)}); 1")
    text = opened.run("document.querySelector('.proposals').textContent")
    assert "separates a from b" in text
    assert "<b>9 N</b>" in text
    opened.run("document.querySelectorAll('.proposals button')[1].click(); 1")
    until(opened, "feltmbLive.played && feltmbLive.played.includes('staccato')")
    until(opened, READY)
    assert opened.run("document.querySelector('.play select').value") == "packaged staccato"
    opened.run("feltmbLive.undo(); 1")
    assert opened.run("feltmbLive.state.now.playing.name") == "forte"
    assert opened.complaints() == []


def test_what_a_diagnosis_tells_is_shown_and_applied(opened):
    row = {"unit": "m", "text": "<i>why</i>", "magnitude": -6e-4, "low": -6.1e-4, "high": -5.9e-4}
    bodies = opened.run("feltmbLive.viewer.stage.bodies?.length || 11")
    told = {
        "on": "diagnosis", "verdict": "Named", "statement": "The model misses 9 %.",
        "reasons": ["the search was ended before its end"], "stopped": True,
        "answer": "The capstan is low (-0.6 mm).",
        "causes": [{**row, "effect": "slip", "how": "97% probable", "knob": ""},
                   {**row, "effect": "capstan_height", "how": "outside its tolerance",
                    "knob": "screw.lost motion"}],
        "candidates": [
            {"effect": "creep", "unit": "", "how": "2% probable", "text": "", "knob": ""}
        ],
        "tint": [0.0] * bodies,
    }  # fmt: skip
    opened.run("feltmbLive.tab = 'measured'; feltmbLive.fillTab(); 1")
    opened.run(f"feltmbLive.hear({json.dumps(told)}); 1")
    text = opened.run("feltmbLive.diagnosisBox.textContent")
    for part in ("Named", "misses 9 %", "before its end", "97% probable", "<i>why</i>", "Stopped"):
        assert part in text
    assert "-0.6 mm (-0.61 to -0.59)" in text.replace("\u2212", "-")
    assert opened.run("document.querySelectorAll('.candidates tr').length") == 3
    assert opened.run("document.querySelectorAll('.candidates button').length") == 1
    assert opened.run("feltmbLive.answer.textContent").startswith("The capstan is low (-0.6 mm).")
    assert opened.run("feltmbLive.answer.compareDocumentPosition(feltmbLive.root) & 4")  # above it
    opened.run("document.querySelector('.candidates button').click(); 1")
    turned = opened.run("feltmbLive.state.now.knobs['screw.lost motion']")
    assert turned == pytest.approx(-6e-4)
    until(opened, READY)
    progress = {"on": "diagnosing", "stage": "held_out", "share": 0.834, "left": 12.3}
    opened.run("feltmbLive.hello.files = [{file: 'r1', name: 'a.csv', columns: []}]")
    opened.run("feltmbLive.fillFiles(); 1")
    opened.run(f"feltmbLive.hear({json.dumps(progress)}); 1")
    assert (
        opened.run("feltmbLive.diagnosing_.textContent") == "held out, 83 % done, about 12 s left"
    )
    opened.run("feltmbLive.hello.files = []; feltmbLive.fillFiles(); feltmbLive.undo(); 1")
    assert opened.complaints() == []


@pytest.mark.slow
def test_from_records_over_a_diagnosis_to_a_played_proposal(
    browser, serve, tmp_path, capstan_records
):
    paths = []
    for name, text in capstan_records.items():
        paths.append(tmp_path / name)
        paths[-1].write_text(text, encoding="utf-8")
    press = (
        "[...document.querySelectorAll('#more button')].find(b => b.textContent === {!r}).click()"
    )
    with serve("steinway45", paths) as live:
        browser.resize(1400, 900)
        browser.open(live.address)
        until(browser, READY)
        browser.run("feltmbLive.tab = 'measured'; feltmbLive.fillTab(); feltmbLive.measure(); 1")
        until(browser, "document.querySelectorAll('.residuals tr').length >= 15")
        browser.run(press.format("Diagnose"))
        until(browser, "!!document.querySelector('.candidates')", 900.0)
        assert "capstan" in browser.run("feltmbLive.diagnosisBox.textContent")
        assert not browser.run("!!feltmbLive.last.diagnosis.stopped")
        # What the diagnosis believes is what the plan goes on from.
        browser.run(press.format("Propose strokes"))
        until(browser, "!!document.querySelector('.proposals')", 600.0)
        assert "Planned from: the diagnosis." in browser.run("feltmbLive.planBox.textContent")
        browser.run("document.querySelector('.proposals button').click(); 1")
        until(browser, "feltmbLive.played && feltmbLive.played.includes('packaged')")
        until(browser, READY)
        rows = "[...document.querySelectorAll('.candidates tr')]"
        row = f"{rows}.find(r => /capstan/.test(r.textContent))"
        rms = "feltmbLive.last.measured.rows.reduce((sum, r) => sum + r.rms, 0)"
        before = browser.run(rms)
        browser.run(f"{row}.querySelector('button').click(); 1")
        turned = browser.run("feltmbLive.state.now.knobs['screw.lost motion']")
        assert turned == pytest.approx(-6e-4, rel=0.05)
        until(browser, f"{rms} < {0.3 * before}")
        assert browser.complaints() == []
        browser.open("about:blank")


def test_the_difference_can_be_heard_where_there_is_a_b(opened):
    pressed = "[...document.querySelectorAll('#top button')].find(b => b.textContent === {!r})"
    heard = pressed.format("Hear A − B")
    assert opened.run(heard + ".disabled")
    opened.run(pressed.format("Keep as B") + ".click()")
    opened.run("feltmbLive.change('t', n => { n.knobs['felt.06'] = 0.3; }); 1")
    settled(opened)
    until(opened, READY)
    # A browser plays sound only where a hand asked for it.
    x, y, w, h = opened.run(
        f"(() => {{ const b = {heard}.getBoundingClientRect();"
        "return [b.x, b.y, b.width, b.height]; })()"
    )
    for kind in ("mousePressed", "mouseReleased"):
        opened.mouse(kind, x + 0.5 * w, y + 0.5 * h)
    until(opened, "!!feltmbLive.sound && / dB (below|above) A/.test(feltmbLive.status.textContent)")


def test_names_in_files_are_text(browser, serve, tmp_path):
    evil = "<img src=x onerror=\"document.title='owned'\"></script><script>alert(1)//"
    raw = feltmb.load_action("steinway45").raw
    raw["about"] = evil
    raw["contacts"]["06"]["label"] = evil
    raw["bodies"]["key"]["label"] = evil
    path = tmp_path / "evil.toml"
    path.write_text(feltmb.Action(raw).to_toml(), encoding="utf-8")
    with serve(str(path)) as live:
        browser.open(live.address)
        until(browser, READY)
        assert browser.run("document.images.length") == 0
        assert evil in browser.run("document.getElementById('see').textContent")
        assert browser.complaints() == []
        browser.open("about:blank")


def test_two_pages_at_once(opened, live, client):
    with client(live) as other:
        opened.run("feltmbLive.change('t', n => { n.knobs['screw.let-off'] = 0.0005; }); 1")
        got = other.run(1, "quick", turned={"knobs": {"screw.let-off": -5e-4}})
        until(opened, "feltmbLive.got.a.set['surfaces.Gp10.point.y'] === '77.5 mm'")
    assert got["set"]["surfaces.Gp10.point.y"] == "76.5 mm"


@pytest.mark.parametrize("width", [390, 800, 1400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_and_can_be_read(opened, width, scheme):
    opened.call(
        "Emulation.setEmulatedMedia",
        features=[{"name": "prefers-color-scheme", "value": scheme}],
    )
    opened.resize(width, 844)
    opened.run("new Promise(go => setTimeout(go, 200))")
    assert opened.run("document.documentElement.scrollWidth") <= width
    paper = opened.run("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(255, 255, 255)") == (scheme == "light")
    assert opened.complaints() == []
