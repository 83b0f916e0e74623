"""What strangers found, the rest: a given thickness, callbacks, digests, large files, pictures."""

import difflib
import importlib
import math
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from feltmb import simulate
from feltmb.arguments import checked
from feltmb.cli import cli
from feltmb.cli.stroke import summary_table
from feltmb.errors import DataError, InvalidParameter
from feltmb.felt import identify, load_material
from feltmb.fiber import (
    CompressionData,
    Cycle,
    FiberBox,
    compare,
    fit,
    fit_branches,
    law,
    read_compression,
)
from feltmb.fiber import simulate as compress
from feltmb.files import package_digest
from feltmb.graphics import plot
from feltmb.mechanism import load_action
from feltmb.run.stroke import load_stroke
from feltmb.units import quantity

FELT = load_material("synthetic_soft_red")
THICK = 6e-3
ROOT = Path(__file__).parents[3]


def a_test(*, thickness0=None, noise=0.002, seed=0, known=THICK):
    """Loop of a law of 6 mm, under load at the first sample; its two branches differ."""
    rng = np.random.default_rng(seed)
    v = np.linspace(1.15, 2.6, 40) * FELT.v_f0
    up = law("binomial", K_p=2.6e6, gamma=1.57, v_f0=FELT.v_f0).pressure(v)
    down = law("binomial", K_p=1.3e6, gamma=1.9, v_f0=FELT.v_f0).pressure(v)
    p = np.concatenate([up, down[::-1]]) + noise * up.max() * rng.normal(size=80)
    height = FELT.v_f0 * known / np.concatenate([v, v[::-1]])
    data = CompressionData(
        FELT.v_f0 * height.max() / height, p, np.arange(80) < 40, FELT.v_f0, "test", height, False
    )
    return data if thickness0 is None else data.with_thickness(thickness0)


def written(tmp_path):
    data = a_test()
    rows = [f"{1e3 * h:.6f},{p:.3f}" for h, p in zip(data.thickness, data.pressure, strict=True)]
    path = tmp_path / "test.csv"
    path.write_text("thickness [mm],pressure [Pa]\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("thickness", "message"),
    [
        (80e-3, r"thickness 80 mm without load.*fibers would fill .* expected at most"),
        (1e-3, r"thickness 1 mm without load, but the test carries .*expected more than"),
        (0.0, r"thickness0 = 0 m, expected > 0"),
    ],
)
def test_a_thickness_that_cannot_be_is_refused_as_a_thickness(tmp_path, thickness, message):
    with pytest.raises(DataError, match=message) as told:
        read_compression(written(tmp_path), v_f0=FELT.v_f0, thickness0=thickness)
    assert "v_f from" not in str(told.value)
    if thickness:
        with pytest.raises(DataError, match=message):
            a_test().with_thickness(thickness)


def test_one_thickness_of_both_branches():
    load, back = fit_branches(a_test(), "binomial", n_starts=3)
    assert load.values["thickness0"] == back.values["thickness0"]
    assert load.interval["thickness0"] == back.interval["thickness0"]
    low, high = load.interval["thickness0"]
    assert low < THICK < high
    assert load.values["K_p"] == pytest.approx(2.6e6, rel=0.2)
    assert back.values["K_p"] == pytest.approx(1.3e6, rel=0.2)
    # Two branches know more than one.
    alone = [fit(a_test(), "binomial", branch=b, n_starts=3) for b in ("loading", "unloading")]
    assert alone[0].values["thickness0"] != alone[1].values["thickness0"]
    for one in alone:
        bottom, top = one.interval["thickness0"]
        assert math.log(high / low) < math.log(top / bottom)
    assert "from all branches" in load.warnings[0]
    ranked = compare(a_test(), ["van_wyk", "binomial"], branch="each", n_starts=2)
    assert [(f.branch, f.model) for f in ranked[::2]] == [
        ("loading", "binomial"), ("unloading", "binomial"),
    ]  # fmt: skip


def test_intervals_of_a_shared_thickness_hold_what_they_say():
    held = 0
    for seed in range(25):
        f = fit_branches(a_test(seed=seed, noise=0.005), "binomial", n_starts=1)[0]
        low, high = f.interval["thickness0"]
        held += low <= THICK <= high
    assert held >= 19  # 95 %: fewer of 25 in 1 of 1000 sets


def test_without_an_unknown_thickness_branches_are_apart():
    data = a_test(thickness0=THICK)
    both = fit_branches(data, "binomial", n_starts=2)
    for got in both:
        own = fit(data, "binomial", branch=got.branch, n_starts=2)
        assert got.values == own.values
        assert got.interval == own.interval


@pytest.mark.parametrize("given", [THICK, 8e-3])
def test_a_thickness_that_the_data_contradict_is_told(given):
    data = a_test(thickness0=given)
    told = [f.warnings for f in fit_branches(data, "binomial", n_starts=3)]
    said = [any("do not agree with the test" in w for w in warnings) for warnings in told]
    assert said == [given != THICK] * 2
    if given != THICK:
        assert "8 mm that was given" in told[0][0]
        assert "asks for 6." in told[0][0] or "asks for 5.9" in told[0][0]


def a_loop(thickness0):
    v = np.linspace(1.05 * FELT.v_f0, 0.999 * FELT.end, 40)
    p = np.concatenate([FELT.pressure("loading", v), FELT.pressure("unloading", v)[::-1]])
    p += 0.002 * p.max() * np.random.default_rng(0).normal(size=80)
    v = np.concatenate([v, v[::-1]])
    height = FELT.v_f0 * THICK / v
    data = CompressionData(v, p, np.arange(80) < 40, FELT.v_f0, "test", height, False)
    return data.with_thickness(thickness0)


@pytest.mark.parametrize("given", [THICK, 8e-3])
def test_identify_tells_a_contradicted_thickness(given):
    found = identify(a_loop(given), material=FELT)
    said = any("does not agree with the loading branch" in w for w in found.warnings)
    assert said == (given != THICK)
    assert found.thickness == pytest.approx(given)
    assert f"unloaded thickness [mm], as given | {1e3 * given:g}" in found.report()


def test_a_given_thickness_is_printed_as_an_assumption(tmp_path):
    asked = ["fiber", "fit", str(written(tmp_path)), "--v-f0", str(FELT.v_f0), "--starts", "2"]
    got = CliRunner().invoke(cli, [*asked, "--thickness", "6mm"])
    assert got.exit_code == 0, got.output
    assert "unloaded thickness: 6 mm, as given" in got.output
    assert "do not agree" not in got.output
    got = CliRunner().invoke(cli, [*asked, "--thickness", "8mm"])
    assert "8 mm that was given" in " ".join(got.output.split())  # it is folded
    got = CliRunner().invoke(cli, asked)
    assert "as given" not in got.output
    assert got.output.count("was not given") == 1  # of one sample, told once


def test_the_help_of_out_names_what_it_takes():
    text = " ".join(CliRunner().invoke(cli, ["stroke", "--help"]).output.split())
    assert ".nc or .h5 (all data) or .csv" in text


def _text(table):
    console = Console(width=100)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


@pytest.fixture(scope="module")
def strokes():
    action = load_action("steinway45").with_values({"shank.rigid": True, "wire.rigid": True})
    return {n: simulate(action, load_stroke(n), duration=0.15) for n in ("staccato", "forte")}


def test_rows_of_the_summary_follow_the_time(strokes):
    summary = {
        "key_start_time": 0.02, "free_flight_time": 0.0456, "jack_toe_time": 0.0465,
        "impact_time": 0.0478, "impact_speed": 3.4, "key_travel": 0.01,
    }  # fmt: skip
    lines = _text(summary_table(replace(strokes["forte"], summary=summary), "any")).splitlines()
    words = ("thrown off", "jack toe", "meets the string")
    at = {word: i for i, line in enumerate(lines) for word in words if word in line}
    assert at["thrown off"] < at["jack toe"] < at["meets the string"]
    assert sum("thrown off" in line for line in lines) == 1
    assert "0.04560" in lines[at["thrown off"]]
    assert not any("none" in line for line in lines)


def test_labels_stay_beside_their_panels(strokes):
    figure = plot.overview(strokes["forte"])
    figure.canvas.draw()
    for ax in figure.axes:
        label = ax.yaxis.label.get_window_extent()
        assert label.height <= ax.get_window_extent().height


@pytest.mark.parametrize(
    ("answer", "stops"),
    [(None, False), (0, False), ("", False), (False, True), (np.False_, True)],
)
def test_only_false_interrupts(answer, stops):
    action = load_action("steinway45")
    told = []

    def progress(t):
        told.append(t)
        return answer

    expected = pytest.raises(KeyboardInterrupt) if stops else nullcontext()
    with expected:
        simulate(action, load_stroke("staccato"), progress=progress)
    assert told  # the first report comes after 50 ms
    assert stops == (len(told) == 1)


@pytest.mark.parametrize("answer", [None, 0, False])
def test_only_false_stops_a_fiber_box(answer):
    box = FiberBox(n_fibers=12, n_beads=7, v_f=0.02)
    cycle = Cycle(v_max=0.03, strain_per_step=1e-3, relax_steps=10, sample_every=50)
    run = compress(box, cycle, threads=1, progress=lambda *_: answer)
    assert run.done == (answer is not False)
    if not run.done:
        assert len(run.table["v_f"]) < len(compress(box, cycle, resume=run).table["v_f"])


def test_the_sequences_of_numbers_are_finite():
    @checked
    def take(values: "Sequence[float]"):  # noqa: F821
        return values

    assert take([1.0, 2]) == [1.0, 2]
    assert take(np.array([1.0, 2.0])).tolist() == [1.0, 2.0]
    with pytest.raises(InvalidParameter, match=r"take: values\[1\]: got nan, expected a finite"):
        take([1.0, math.nan])
    with pytest.raises(InvalidParameter, match=r"values\[0\]: got inf"):
        take(np.array([np.inf]))


def test_members_know_the_code():
    assert len(package_digest()) == 64


def test_the_digest_of_the_package_is_of_all_of_it(monkeypatch, tmp_path):
    digest = importlib.import_module("feltmb.files.digest")
    for name in ("run/a.py", "contact/b.py", "mechanism/c.toml", "_core.so", "files/digest.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_text(name)
    monkeypatch.setattr(digest, "__file__", str(tmp_path / "files" / "digest.py"))
    monkeypatch.setitem(sys.modules, "feltmb._core", SimpleNamespace())

    def now():
        return digest.package_digest.__wrapped__()

    first = now()
    seen = {first}
    for name in ("run/a.py", "contact/b.py", "mechanism/c.toml", "_core.so"):
        (tmp_path / name).write_text("changed")
        seen.add(now())
    (tmp_path / "run" / "a.py").rename(tmp_path / "run" / "z.py")
    seen.add(now())
    assert len(seen) == 6
    (tmp_path / "run" / "__pycache__").mkdir()
    (tmp_path / "run" / "__pycache__" / "a.pyc").write_text("any")
    assert now() in seen


def test_hints_are_made_only_for_faults_that_are_told(monkeypatch, tmp_path):
    asked = []
    kept = difflib.get_close_matches

    def counted(*args, **kwargs):
        asked.append(args[0])
        return kept(*args, **kwargs)

    monkeypatch.setattr(quantity.difflib, "get_close_matches", counted)
    path = tmp_path / "many.toml"
    path.write_text('name = "many"\n' + "".join(f"[t{i}]\na = 1\n" for i in range(3000)))
    with pytest.raises(InvalidParameter, match="3002 faults") as told:
        load_action(path)
    assert len(asked) <= quantity.MOST_FAULTS
    assert "t5: unknown key" in str(told.value)


def test_every_picture_of_the_docs_is_drawn_by_a_command(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    drawn = importlib.import_module("make_pictures").PICTURES
    benched = {"cost_against_size.png", "peers.png"}  # bench/README.md
    kept = {path.name for path in (ROOT / "docs" / "img").glob("*.png")}
    assert kept == set(drawn) | benched
    shown = "".join(p.read_text() for p in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")))
    assert all(f"img/{name}" in shown for name in kept)
