"""The page of a diagnosis in a browser: motions, changes, zoom, search, and no network."""

from __future__ import annotations

import numpy as np
import pytest

import unmodeled
from unmodeled import Coordinate, Equations, Record, diagnose


def rubbing(k: int) -> Record:
    """A mass on a spring with dry friction that the model lacks."""
    time = np.linspace(0.0, 2.0, 401)
    force = np.sin((7.0 + 2.0 * k) * time) + 0.5 * np.sin(17.0 * time)
    q, v, found = 0.0, 0.0, []
    for f in force:
        found.append(q)
        for _ in range(20):
            v += 2.5e-4 * (f - 100.0 * q - 0.5 * v - 0.2 * np.tanh(v / 2e-3))
            q += 2.5e-4 * v
    noise = np.random.default_rng(k).normal(0.0, 1e-5, time.size)
    sensors = {"q": unmodeled.Sensor(name="q", unit="m", sigma=1e-5)}
    return Record(
        name=f"run {k}", time=time, inputs={"f": force}, outputs={"q": np.array(found) + noise},
        sensors=sensors, role="held_out" if k == 2 else "fit",
    )  # fmt: skip


@pytest.fixture(scope="module")
def report():
    model = Equations(
        lambda _, x, u, p: (x.v, (u.f - p.k * x.q - 0.5 * x.v) / 1.0),
        states={"q": (0.0, 0.0, "m"), "v": (0.0, 0.0, "m/s")},
        parameters={"k": (101.0, 2.0, "N/m")},
        outputs={"q": "q"},
        coordinates=[Coordinate(name="mass", position="q", speed="v", inertia=1.0)],
        name="mass",
    )
    return diagnose(model, ("dry friction*", "viscous*"), [rubbing(k) for k in range(3)])


@pytest.fixture
def page(browser, report, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(report.html("A mass on a spring"), encoding="utf-8")
    browser.resize(1300, 900)
    browser.open(path)
    yield browser
    browser.resize(1280, 900)


TEXT = "document.getElementById('{}').textContent"
CURVES = "[...document.querySelectorAll('#chart path')].map((p) => p.getAttribute('d'))"


def test_the_page_loads_nothing_and_has_no_errors(page):
    assert page.complaints() == []
    assert [r for r in page.requests() if not r.startswith(("file:", "data:"))] == []


def test_curves_and_number_follow_the_changes(page, report):
    assert report.motions.changes[0] == "dry friction mass"
    before, text = page.run(CURVES), page.run(TEXT.format("left"))
    page.run("document.querySelector('#changes input').click()")
    after = page.run(CURVES)
    # The record and the model as it is stay; the model with the changes and its residual move.
    assert [a == b for a, b in zip(before[:3], after[:3], strict=True)] == [True, True, False]
    assert before[4] != after[4]
    told = page.run(TEXT.format("left"))
    assert told != text
    assert "not fitted again" in told
    left = next(a for a in report.motions.alternatives if a.kept[0] is False and all(a.kept[1:]))
    share = 100.0 * left.left["q"] / report.motions.chosen.motion
    assert float(told.split(": ")[1].split(" %")[0]) == pytest.approx(share, rel=0.06)
    page.run("document.querySelector('#changes input').click()")
    assert page.run(TEXT.format("left")) == text


def test_a_record_is_chosen_and_enlarged_by_keys(page):
    page.run("document.querySelectorAll('#records button')[1].click()")
    assert page.run(TEXT.format("which")) == "q of run 1"
    labels = "[...document.querySelectorAll('#chart text')].map((t) => t.textContent)"
    whole = page.run(labels)
    page.run("document.getElementById('chart').focus()")
    page.press("+", text="+")
    assert page.run(labels) != whole
    page.press("0", text="0")
    assert page.run(labels) == whole


def test_candidates_are_searched(page):
    page.run(
        "(() => { const f = document.getElementById('find'); f.value = 'friction';"
        " f.dispatchEvent(new Event('input')); })()"
    )
    shown = page.run(
        "[...document.querySelectorAll('#candidates tbody tr')].filter((r) => !r.hidden)"
        ".map((r) => r.cells[0].textContent)"
    )
    assert shown
    assert all("friction" in name.lower() for name in shown)


def test_sentence_and_picture_are_the_first_screen_of_a_phone(page):
    page.resize(390, 844)
    page.run("dispatchEvent(new Event('resize'))")
    below = page.run("document.querySelector('#chart path').getBoundingClientRect().bottom")
    assert below < 844
    assert page.run("document.documentElement.scrollWidth") <= 390


def test_every_control_has_a_name(page):
    unnamed = page.run(
        "[...document.querySelectorAll('button, input')].filter((e) => !(e.ariaLabel ||"
        " e.textContent.trim() || (e.labels && e.labels.length))).length"
    )
    assert unnamed == 0
