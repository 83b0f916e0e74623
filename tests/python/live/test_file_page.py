"""The page as one file: what is in it, its numbers in Node, and itself in a browser."""

import base64
import json
import re
import shutil
import subprocess
import time
from importlib import resources

import numpy as np
import pytest

import feltmb
from feltmb.adapters import mechanism_model
from feltmb.graphics.plot.readings import busy_window, named_events
from feltmb.graphics.viewer.packing import json_text
from feltmb.live import page as made
from feltmb.live.knobs import Bench
from feltmb.live.pictures import summary_of
from feltmb.live.request_queue import speed_curve, target_rows
from feltmb.run.sound import difference, sampled, wav
from unmodeled.data import ReadOptions
from unmodeled.data.files import read_each
from unmodeled.data.mapping import Signals

ACTION = "steinway45_leaded"
built = pytest.mark.skipif(
    not made.MODULE.is_file(), reason="the module is not built: bash tools/wasm.sh"
)
node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")

#: A run with what is turned: numbers, summary, events; or what else the worker tells.
MAIN = """
const [moduleFile, contentFile, askedFile, answerFile] = process.argv.slice(2);
const fs = require("fs");
(async () => {
  const [content, asked] = [contentFile, askedFile].map(f => JSON.parse(fs.readFileSync(f)));
  const core = await Core.load(fs.readFileSync(moduleFile));
  const machine = new Machine(core, content), out = [];
  for (const {turned, stroke, rtol, what, file, reading} of asked) {
    try {
      machine.turn(turned);
      if (what === "targets") { out.push(targetRows(machine)); continue; }
      if (what === "speeds") { out.push(speedRows(machine)); continue; }
      if (what === "sound") {
        const heard = name => bridgeOf(machine.run(content.strokes[name], {rtol}));
        const [own, other] = [heard("forte"), heard("piano")];
        const [rest, level] = differenceOf(own, other);
        out.push({own: Buffer.from(wavOf(own)).toString("base64"), level});
        continue;
      }
      if (what === "columns") {
        const {time, channels} = readColumns(file, reading, content.outputs);
        out.push([[...time], ...[...channels].map(([n, c]) => [n, c.fromStart, [...c.values]])]);
        continue;
      }
      const run = machine.run(content.strokes[stroke], {rtol, rate: 2000});
      const picture = pictureOf(machine, run, ["contact06.force"], "full", turned);
      out.push({
        time: [...run.time], summary: picture.summary, events: picture.events,
        busy: picture.busy, poses: picture.stage.poses.length, frames: picture.stage.time.length,
        values: Object.fromEntries(Object.entries(run.values).map(([n, v]) => [n, [...v]]))});
    } catch (error) { out.push({fault: error.message}); }
  }
  fs.writeFileSync(answerFile, JSON.stringify(out));
})();
"""


@pytest.fixture(scope="module")
def action():
    return feltmb.load_action(ACTION)


@pytest.fixture(scope="module")
def content(action):
    return made.content_of(action)


@pytest.fixture
def in_node(tmp_path, content):
    """Runs of the module in Node."""

    def runs(*asked):
        assets = resources.files("feltmb")
        parts = ("graphics/viewer/assets/packing.js", "live/assets/engine.js")
        text = "".join(assets.joinpath(p).read_text(encoding="utf-8") for p in parts) + MAIN
        for name, data in (
            ("main.js", text),
            ("content.json", json_text(content)),
            ("asked.json", json.dumps(asked)),
        ):
            (tmp_path / name).write_text(data, encoding="utf-8")
        files = [str(tmp_path / n) for n in ("main.js", "content.json", "asked.json", "out.json")]
        done = subprocess.run(
            ["node", files[0], str(made.MODULE), *files[1:]], capture_output=True, timeout=120
        )
        assert done.returncode == 0, done.stderr.decode()[-2000:]
        return json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))

    return runs


def far(found, run, until=np.inf):
    """Largest distance of each output from that of the native core, as a share of its size."""
    kept = run.time < until
    return [
        float(np.max(np.abs(np.array(found["values"][name]) - values)[kept])) / size
        for name, values in zip(run.names, run.values.T, strict=True)
        if (size := float(np.max(np.abs(values)))) > 0.0
    ]


def native(action, stroke, rtol):
    return feltmb.simulate(action, stroke, ledger=False, rtol=rtol, output_rate=2000.0)


PLAIN = {"knobs": {}, "numbers": {}}


@built
@node
def test_module_gives_the_numbers_of_the_native_core(in_node, action):
    """The last bits decide which steps are taken, and with them what the tolerance leaves open."""
    bench = Bench(action)
    turned = {k: 0.5 * bench.knobs[k].high for k in list(bench.knobs)[:3]}
    asked = [
        {"turned": PLAIN, "stroke": "forte", "rtol": 1e-6},
        {"turned": PLAIN, "stroke": "forte", "rtol": 1e-11},
        {"turned": {"knobs": turned, "numbers": {}}, "stroke": "piano", "rtol": 1e-11},
        {"turned": {"knobs": {}, "numbers": {"bodies.key.mass": -1.0}}, "stroke": "forte"},
    ]
    usual, exact, changed, bad = in_node(*asked)
    # Before the first contact changes, the steps are the same.
    assert max(far(usual, native(action, "forte", 1e-6), 0.05)) < 1e-9
    other = action.with_values(bench.values(turned, {}))
    for found, run, near in (
        (exact, native(action, "forte", 1e-11), 1e-9),
        (changed, native(other, "piano", 1e-11), 1e-8),  # a file has numbers of 12 digits
    ):
        assert np.median(far(found, run)) < 1e-8
        assert max(far(found, run)) < 1e-5  # friction of a contact that is lightly touched
        want = summary_of(run)
        for name, value in found["summary"].items():
            # A force is flat about its maximum: the time of that is known to the root.
            flat = name == "max_impact_force_time"
            assert value == pytest.approx(want[name], rel=1e-6 if flat else near), name
    assert "bodies.key.mass" in bad["fault"]


@built
@node
def test_module_names_the_events_and_numbers_of_a_strike(in_node, action):
    (found,) = in_node({"turned": PLAIN, "stroke": "piano", "rtol": 1e-8})
    run = native(action, "piano", 1e-8)
    assert {"impact_speed", "max_impact_force", "let_off_gap", "key_travel"} <= set(
        found["summary"]
    )
    named = [name.replace("_", " ") for _, name in named_events(run)]
    assert [name for _, name in found["events"]] == named
    assert found["busy"] == pytest.approx([1e3 * t for t in busy_window(run)], abs=0.51)
    assert found["frames"] > 100
    assert found["poses"] == 3 * (1 + len(action.config.bodies))


@built
@node
def test_module_measures_what_a_regulation_measures(in_node, action):
    bench = Bench(action)
    turned = {"screw.lost motion": 3e-4, "screw.let-off": -4e-4}
    asked = {"turned": {"knobs": turned, "numbers": {}}}
    found, speeds = in_node(asked | {"what": "targets"}, asked | {"what": "speeds"})
    changed = action.with_values(bench.values(turned, {}))
    want = speed_curve(changed)
    assert speeds["missed"] == want["missed"]
    assert np.array(speeds["rows"]) == pytest.approx(np.array(want["rows"]), rel=1e-3)
    rows = target_rows(bench, changed)
    assert [r["name"] for r in found] == [r["name"] for r in rows]
    for mine, row in zip(found, rows, strict=True):
        assert mine["value"] == pytest.approx(row["value"], rel=2e-3, abs=1e-6), row["name"]
        assert (mine["holds"], mine["wanted"]) == (row["holds"], row["wanted"])
    assert {r["holds"] for r in rows} == {True, False}


@built
@node
def test_module_sounds_as_the_native_core(in_node, action):
    (found,) = in_node({"turned": PLAIN, "what": "sound", "rtol": 1e-9})
    runs = [feltmb.simulate(action, n, ledger=False, rtol=1e-9) for n in ("forte", "piano")]
    own, other = (sampled(run.time, run.bridge_force()) for run in runs)
    mine, want = base64.b64decode(found["own"]), wav(own)
    assert mine[:44] == want[:44]
    heard, wanted = (np.frombuffer(w[44:], "<i2").astype(float) for w in (mine, want))
    assert np.max(np.abs(heard - wanted)) < 1e-3 * np.max(np.abs(wanted))
    rest = difference(own, other)
    level = 10 * np.log10(np.sum(rest**2) / np.sum(own**2))
    assert found["level"] == pytest.approx(level, abs=0.01)


@built
@node
def test_page_reads_pixels_as_gap_check_does(in_node, action, tmp_path):
    rng = np.random.default_rng(1)
    pixels = 300.0 + rng.normal(size=(5, 3))
    names = ["time", "hammer_tip.x", "hammer_tip.y", "whippen.y"]
    units = ["", "px", "px", "mm"]
    table = np.column_stack([np.arange(5.0), pixels])
    reading = {
        "columns": {},
        "units": {},
        "scales": {"": "210 mm from 120 340 to 412 338"},
        "origins": {"": "310.5,290"},
        "frame_rate": 1000.0,
        "down": None,
    }
    columns = [[n, u, list(v)] for n, u, v in zip(names, units, table.T, strict=True)]
    asked = {"turned": PLAIN, "what": "columns", "file": {"name": "a.csv", "columns": columns}}
    bad = asked | {"reading": reading | {"scales": {"": "some"}}}
    found, fault = in_node(asked | {"reading": reading}, bad)
    head = ",".join(f"{n} [{u}]" if u else n for n, u in zip(names, units, strict=True))
    path = tmp_path / "a.csv"
    path.write_text(head + "\n" + "\n".join(",".join(map(str, row)) for row in table))
    model, _ = mechanism_model(action)
    signals = Signals(inputs=(), outputs=model.outputs, modes={}, units={}, names=model.input_names)
    ((record,),) = read_each([path], signals, ReadOptions(**reading))
    time, *channels = found
    assert time == pytest.approx(list(record.time))
    assert {name for name, _, _ in channels} == set(record.outputs)
    for name, _, values in channels:
        assert values == pytest.approx(list(record.outputs[name]), rel=1e-12), name
    assert "one pixel is some" in fault["fault"]


def test_knobs_of_the_page_move_the_numbers_of_the_archive(content, action):
    bench = Bench(action)
    assert len(content["knobs"]) >= len(bench.knobs) - 1
    # Two knobs at the same number: factors first, then summands.
    names = [n for n, rules in content["knobs"].items() if len(rules) > 1][:4]
    sizes = {n: 0.3 * (bench.knobs[n].high or bench.knobs[n].low) for n in names}
    said = np.array(content["first"])
    for name, size in sizes.items():
        for i, scale, exp, add in content["knobs"][name]:
            said[i] = said[i] * (1 + scale * size) * np.exp(exp * size) + add * size
    changed = action.with_values(bench.values(sizes, {}))
    rows = feltmb._core.description_numbers(feltmb.mechanism.describe(changed.config))
    assert said == pytest.approx([row["value"] for row in rows], rel=1e-9)


def test_page_is_one_file_that_asks_for_nothing(tmp_path, monkeypatch, content):
    module = tmp_path / "core.wasm"
    module.write_bytes(b"\0asm")
    monkeypatch.setattr(made, "MODULE", module)
    monkeypatch.setattr(made, "content_of", lambda _: content)  # 1.3 s; its own tests look at it
    text = feltmb.export_page(ACTION, tmp_path / "a.html").read_text(encoding="utf-8")
    held = json.loads(re.search(r'id="content">(.*?)</script>', text, re.S)[1])
    assert held["archive"] == content["archive"]
    assert "AGFzbQ==" in text
    assert not re.search(r'(src|href)="(?!#)', text)
    assert "default-src 'none'" in text.replace("&#x27;", "'")
    with pytest.raises(feltmb.FileExists):
        feltmb.export_page(ACTION, tmp_path / "a.html")


def test_page_without_the_module_says_what_builds_it(tmp_path, monkeypatch):
    monkeypatch.setattr(made, "MODULE", tmp_path / "none.wasm")
    with pytest.raises(feltmb.InvalidParameter, match=r"none\.wasm is not .*bash tools/wasm\.sh"):
        feltmb.export_page(ACTION, tmp_path / "a.html")


@pytest.mark.slow
@built
@pytest.mark.parametrize("width", [1400, 390])
def test_page_simulates_in_a_browser_without_a_server(browser, tmp_path, width):
    path = feltmb.export_page(ACTION, tmp_path / "a.html")
    browser.resize(width, 900)
    browser.open(path)

    def until(expression):
        end = time.monotonic() + 60.0
        while not browser.run(expression):
            assert time.monotonic() < end, (expression, browser.complaints())
            time.sleep(0.05)

    until("!!(window.feltmbLive && feltmbLive.viewer && feltmbLive.got.a.quality === 'full')")
    run = feltmb.simulate(ACTION, "forte", ledger=False)
    speed = browser.run("feltmbLive.got.a.summary.impact_speed")
    assert speed == pytest.approx(run.summary["impact_speed"], rel=1e-4)
    browser.run("feltmbLive.keep()")
    browser.run("feltmbLive.change('x', n => { n.playing.name = 'piano'; }, true)")
    until(f"feltmbLive.got.b && feltmbLive.got.a.summary.impact_speed < 0.9 * {speed}")
    assert browser.complaints() == []
    assert browser.run("document.documentElement.scrollWidth") <= width
    # What is heard is a sound file of the run.
    browser.run("window.Audio = class { constructor(src) { window.heard = src; } async play() {} }")
    browser.run("feltmbLive.hearRest.click()")
    until("window.heard && feltmbLive.status.textContent.includes('sound the same')")
    for tab, table in (("regulation", "targets"), ("touch", "touch"), ("speeds", "speeds")):
        browser.run(f"feltmbLive.tab = '{tab}'; feltmbLive.fillTab(); feltmbLive.ask(true)")
        until(f"feltmbLive.last && feltmbLive.last.{table}")
        assert "fault" not in browser.run(f"Object.keys(feltmbLive.last.{table})")
    lights = browser.run("feltmbLive.last.targets.rows.map(r => [r.name, r.value])")
    assert dict(lights)["hammer blow"] == pytest.approx(45.0, abs=0.5)
    # A measured file, made of the model itself, has no distance from it.
    run = feltmb.simulate(ACTION, "piano", ledger=False)
    x = 1e3 * run["hammer_tip.x"][::10]
    for name, head, values in (("m.csv", "mm", x), ("pixels.csv", "px", x / 0.2)):
        rows = zip(run.time[::10], values, strict=True)
        table = f"time [s],hammer_tip.x [{head}]\n" + "\n".join(f"{t},{v}" for t, v in rows)
        browser.run("feltmbLive.reading = null; feltmbLive.hello.files = []; 1")
        browser.run("delete feltmbLive.last.measured")
        browser.run(f"feltmbLive.upload([new File([{json.dumps(table)}], '{name}')])")
        if head == "px":
            until("feltmbLive.last.measured?.fault")
            assert "how large is one" in browser.run("feltmbLive.last.measured.fault")
            browser.run("feltmbLive.reading.scales[''] = '0.2 mm'; feltmbLive.measure(); 1")
        until("feltmbLive.last.measured?.rows")
        (row,) = browser.run("feltmbLive.last.measured.rows")
        assert row["rms"] < 1e-3  # mm: samples at other times
    assert browser.complaints() == []
