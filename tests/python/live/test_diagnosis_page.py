"""The page of ``unmodeled page`` in a browser: drop, check, search, stop, save, and bad input."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import threading
import time
import zipfile

import httpx
import numpy as np
import pytest

import unmodeled
from unmodeled.page.serve import PageServer

GAIN = """
import numpy as np
import unmodeled

def line(time, inputs, p):
    return {"x": p["gain"] * inputs["F"] + p["offset"]}

model = unmodeled.Simulator(
    line, parameters={"gain": (2.0, 0.1, "m/N")}, unknown={"offset": "m"},
    inputs={"F": "N"}, outputs={"x": "m"},
)
"""
SLIDE = """<mujoco><option timestep="0.002"/><worldbody><body name="cart">
<joint name="rail" type="slide" axis="1 0 0" damping="2" stiffness="40"/>
<geom type="box" size=".1 .1 .1" mass="2"/></body></worldbody>
<actuator><motor name="push" joint="rail"/></actuator></mujoco>"""


SAID = {"Load": {"channel": "F", "unit": "N"}, "Pos": {"channel": "x", "unit": "mm"}}


def table(k: int) -> str:
    """A line with an offset of 300 mm; its columns have names of their own."""
    t, rng = np.linspace(0.0, 1.0, 60), np.random.default_rng(k)
    force = (k + 1) * np.sin(7.0 * t + k)
    x = 1e3 * (2.1 * force + 0.3 + 1e-3 * rng.standard_normal(60))
    rows = "\n".join(f"{a:.6g},{b:.6g},{c:.6g}" for a, b, c in zip(t, force, x, strict=True))
    return f"time,Load,Pos\n{rows}"


@contextlib.contextmanager
def running(*given):
    server = PageServer(*given)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    try:
        yield server
    finally:
        server.stop()
        thread.join(20.0)
        assert not thread.is_alive()


@pytest.fixture
def line(tmp_path):
    file = tmp_path / "line.py"
    file.write_text(GAIN, "utf-8")
    with running(str(file)) as server:
        yield server


def until(page, expression, wait=60.0):
    end = time.monotonic() + wait
    while not page.run(expression):
        assert time.monotonic() < end, (expression, page.complaints())
        time.sleep(0.05)


def drop(page, area, **files):
    """Drop files on an area, as a hand does."""
    parts = ",".join(
        f"new File([Uint8Array.from(atob('{base64.b64encode(text.encode()).decode()}'),"
        f"c => c.charCodeAt(0))], {json.dumps(name.replace('__', '.'))})"
        for name, text in files.items()
    )
    page.run(
        f"(() => {{ const d = new DataTransfer(); for (const f of [{parts}]) d.items.add(f);"
        f"document.getElementById('{area}').dispatchEvent(new DragEvent('drop', "
        "{dataTransfer: d, bubbles: true, cancelable: true})); })()"
    )


def choose(page, name, value):
    """Enter a value in the control with this accessible name."""
    page.run(
        f"(() => {{ const e = [...document.querySelectorAll('[aria-label]')].find(e => "
        f"e.getAttribute('aria-label') === {json.dumps(name)}); e.value = {json.dumps(value)};"
        "e.dispatchEvent(new Event('change')); })()"
    )


def click(page, name):
    page.run(f"document.getElementById('{name}').click()")


FAULT = (
    "document.getElementById('fault').hidden ? '' : document.getElementById('fault').textContent"
)
CHECKED = "document.querySelectorAll('#checked figure').length"
ANSWERED = "!document.getElementById('answer').hidden"


def test_files_are_dropped_assigned_checked_and_diagnosed(browser, line):
    browser.resize(1300, 900)
    browser.open(line.address)
    until(browser, "document.getElementById('model').textContent.includes('Inputs: F')")
    drop(browser, "drop-records", a__csv=table(0), b__csv=table(1))
    until(browser, "document.querySelectorAll('#columns select').length === 3")
    click(browser, "check")
    until(browser, FAULT)  # no column is an output
    choose(browser, "Channel of column Load", "F")
    choose(browser, "Channel of column Pos", "x")
    choose(browser, "Unit of column Load", "N")
    choose(browser, "Unit of column Pos", "mm")
    click(browser, "check")
    until(browser, f"{CHECKED} === 2")
    assert browser.run(FAULT) == ""
    unit = "document.querySelector('#checked figure text[x=\"2\"]').textContent"
    assert browser.run(unit) == "[mm]"
    browser.run("document.querySelector('#files input').click()")  # a.csv is only predicted
    click(browser, "search")
    until(browser, ANSWERED)
    assert browser.run(FAULT) == ""
    report = json.loads(httpx.get(line.address + "result/report.json").text)
    assert report["records"] == ["b", "a"]  # those that are predicted come last
    offset = next(c for c in report["changes"] if c["name"] == "offset")
    assert offset["size"] == pytest.approx(0.3, abs=2e-3)
    # The report lives in its frame, which reaches nothing; the case can be repeated.
    refused = "the server responded with a status of 422"  # the first check
    assert [c for c in browser.complaints() if refused not in c] == []
    assert all(r.startswith((line.address, "data:")) for r in browser.requests())
    case = zipfile.ZipFile(io.BytesIO(httpx.get(line.address + "result/case.zip").content))
    assert {"case/case.json", "case/report.html", "case/remedy.toml"} <= set(case.namelist())


def test_every_control_has_a_name_and_is_reached_by_keys(browser, line):
    browser.open(line.address)
    drop(browser, "drop-records", a__csv=table(0))
    until(browser, "document.querySelectorAll('#columns select').length === 3")
    browser.call("Accessibility.enable")
    nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
    roles = {"button", "textbox", "combobox", "checkbox", "spinbutton", "link"}
    controls = [n for n in nodes if not n.get("ignored") and n["role"]["value"] in roles]
    names = [n["name"]["value"] for n in controls]
    browser.call("Accessibility.disable")
    assert all(names)
    assert len(names) >= 12
    assert "Channel of column Load" in names
    seen = set()
    for _ in range(30):
        browser.press("Tab")
        seen.add(browser.run("document.activeElement.id || document.activeElement.ariaLabel"))
    assert {"model-file", "record-files", "check", "good", "seconds", "search"} <= seen
    assert {"Channel of column Pos", "Unit of column Pos", "Remove a.csv"} <= seen


@pytest.mark.parametrize(
    ("area", "name", "said"),
    [
        ("drop-model", "rig__py", "unmodeled page model.py"),
        ("drop-model", "broken__xml", "broken.xml"),
        ("drop-model", "broken__fmu", "broken.fmu"),
        ("drop-records", "notes__docx", ".csv"),
        ("drop-records", "empty__csv", "empty.csv"),
    ],
)
def test_a_bad_file_is_one_message_and_nothing_is_lost(browser, line, area, name, said):
    browser.open(line.address)
    until(browser, "document.getElementById('model').textContent.includes('line')")
    drop(browser, area, **{name: "no such content" if "empty" not in name else ""})
    until(browser, FAULT)
    told = browser.run(FAULT)
    assert said in told
    assert str(line.desk.folder) not in told
    assert "Traceback" not in told
    assert browser.run("document.getElementById('model').textContent.includes('line')")


def test_a_dropped_robot_lists_its_joints(browser):
    pytest.importorskip("mujoco", reason="extra mujoco is not installed")
    with running() as server:
        browser.open(server.address)
        click(browser, "check")
        until(browser, FAULT)
        assert "drop a model first" in browser.run(FAULT)
        drop(browser, "drop-model", cart__xml=SLIDE)
        until(browser, "document.getElementById('model').textContent.includes('Inputs: push')")
        assert browser.run("document.getElementById('priors').textContent").count("cart.mass [kg]")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"files": ["r9"]}, "not here any more"),
        ({"files": []}, "drop a measured file"),
        ({"files": ["r1"], "columns": SAID, "good_enough": ["1parsec"]}, "good-enough"),
        ({"files": ["r1"]}, "none of the outputs x; there are time, Load, Pos; say it"),
        ({"files": ["r1"], "parameter": ["gain"]}, "parameter"),
        ({"files": ["r1"], "seconds": -1}, "seconds"),
        ({"files": ["r1"], "run": "rm"}, "run"),
        ({"files": ["r1"], "columns": {"Load": {"channel": "F"}, "Pos": {"channel": "F"}}}, "Load"),
        ([], "dictionary"),
    ],
)
def test_a_wrong_form_is_refused_with_its_entry(line, given, said):
    own = {"origin": line.address.rsplit("/", 2)[0]}
    httpx.post(line.address + "records?name=a.csv", headers=own, content=table(0).encode())
    answer = httpx.post(line.address + "search", headers=own, json=given)
    assert answer.status_code == 422
    assert said in answer.text
    assert not line.desk.search["running"]


def test_strangers_are_refused(line):
    base, token = line.address.rsplit("/", 2)[0], line.address.rsplit("/", 2)[1]
    assert httpx.get(f"{base}/wrong/state").status_code == 404
    assert httpx.post(line.address + "stop", headers={"origin": "http://evil"}).status_code == 403
    assert httpx.post(line.address + "stop").status_code == 403
    assert httpx.get(line.address, headers={"host": "evil"}).status_code == 421
    assert httpx.get(line.address + "assets/..%2fdesk.py").status_code == 404
    assert httpx.get(line.address + "result/..%2f..%2fx").status_code in (404, 422)
    assert token not in httpx.get(line.address + "state").text


def test_stop_answers_with_the_fits_so_far(line, monkeypatch):
    """The button raises Stop where the diagnosis tells its progress, in another thread."""
    own = {"origin": line.address.rsplit("/", 2)[0]}
    httpx.post(line.address + "records?name=a.csv", headers=own, content=table(0).encode())

    def endless(*_, progress, **__):
        while True:
            progress(unmodeled.Progress("search", 0.5, 3.0, 1.0))
            time.sleep(0.01)

    monkeypatch.setattr("unmodeled.page.desk.diagnose", endless)
    form = {"files": ["r1"], "columns": SAID}
    assert httpx.post(line.address + "search", headers=own, json=form).status_code == 200
    again = httpx.post(line.address + "search", headers=own, json=form)
    assert "stop it first" in again.text
    while line.desk.search.get("share") != 0.5:
        time.sleep(0.01)
    told = httpx.get(line.address + "state").json()["search"]
    assert (told["stage"], told["left"]) == ("searches causes", 3.0)
    httpx.post(line.address + "stop", headers=own)
    while line.desk.search["running"]:
        time.sleep(0.01)
    assert "before the model was fitted" in line.desk.search["fault"]
