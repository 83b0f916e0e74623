"""The command stroke: what is written, resumed and shown."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from calls import command, refusal
from click.testing import CliRunner
from rich.console import Console

import feltmb
from feltmb import simulate
from feltmb.cli import cli
from feltmb.cli.stroke import summary_table
from feltmb.mechanism import load_action
from feltmb.run.stroke import load_stroke


def test_a_picture_that_fails_loses_nothing(template, tmp_path, monkeypatch):
    import feltmb.graphics.plot

    def fail(*_args, **_options):
        raise AssertionError("no curve")

    monkeypatch.setattr(feltmb.plot, "save_all", fail)
    done = command("stroke", template, "press_release", "piano", "--plot", "-o", tmp_path / "out")
    assert done.exit_code != 0
    assert done.output.count("right-hand sides") == 2  # both tables
    for name in ("press_release", "piano"):
        assert feltmb.load_run(tmp_path / "out" / f"{name}.nc").status == "done"
    assert "no picture or sound: AssertionError: no curve" in str(done.exception)


def test_csv_of_a_stroke_has_units_and_all_outputs(template, tmp_path):
    path = tmp_path / "run.csv"
    done = command("stroke", template, "piano", "--duration", "0.02", "-o", path)
    assert done.exit_code == 0, done.exception
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    run = feltmb.simulate(str(template), "piano", 0.02)
    titles = ["time [s]", *(f"{n} [{u}]" for n, u in zip(run.names, run.units, strict=True))]
    assert head.split(",") == titles
    table = np.array([[float(x) for x in row.split(",")] for row in rows])
    np.testing.assert_allclose(table[:, 0], run.time, rtol=1e-8)
    np.testing.assert_allclose(table[:, 1:], run.values, rtol=1e-8, atol=1e-300)


def test_a_cut_off_command_goes_on(template, tmp_path, monkeypatch):
    out = tmp_path / "out"
    short = ("--duration", "0.01", "-o", out)
    assert command("stroke", template, "piano", "forte", *short).exit_code == 0
    (out / "forte.nc").unlink()  # as if it had been killed
    before = (out / "piano.nc").read_bytes()
    simulated = []
    module = sys.modules["feltmb.run.simulate"]
    real = module.simulate

    def count(action, stroke, *args, **options):
        simulated.append(stroke.name)
        return real(action, stroke, *args, **options)

    monkeypatch.setattr(module, "simulate", count)
    done = command("stroke", template, "piano", "forte", *short, "--resume")
    assert done.exit_code == 0, done.exception
    assert simulated == ["forte"]
    assert done.output.count("right-hand sides") == 2
    assert (out / "piano.nc").read_bytes() == before
    # Other inputs are other runs: nothing is replaced unasked.
    for other in (("--rtol", "1e-5"), ("--set", "hammer.mass=0.013")):
        told = refusal("stroke", template, "piano", "forte", *short, "--resume", *other)
        assert "exists already" in told
    done = command("stroke", template, "piano", *short, "--resume", "--rtol", "1e-5", "--force")
    assert done.exit_code == 0, done.exception
    assert simulated == ["forte", "piano"]


def test_resume_needs_a_place(template):
    assert "--resume needs --out" in refusal("stroke", template, "piano", "--resume")


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
