"""Command group ``feltmb fiber``: every command, exit codes, files written whole or not at all."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli.fiber import fiber
from feltmb.fiber import pressure
from unmodeled.errors import Error, FileExists, InvalidParameter


def run(*args, code=0):
    result = CliRunner(env={"COLUMNS": "80"}).invoke(fiber, [str(a) for a in args])
    said, exit_code = result.output, result.exit_code
    if isinstance(result.exception, Error):  # feltmb.cli.main prints it
        said += f"feltmb: {result.exception}"
        exit_code = 2 if isinstance(result.exception, (InvalidParameter, FileExists)) else 1
    elif not isinstance(result.exception, (SystemExit, type(None))):
        raise result.exception
    assert exit_code == code, said
    assert all(
        len(line) <= 80
        for line in result.stdout.splitlines()
        if not line.startswith(("warning", "wrote", "error"))
    ), result.stdout
    return said


@pytest.fixture
def loop(tmp_path):
    v = np.linspace(0.132, 0.33, 41)
    rng = np.random.default_rng(0)
    up = pressure("binomial", v, K_p=4e6, gamma=1.3, v_f0=0.132)
    down = pressure("binomial", v, K_p=3.82e5, gamma=3.16, v_f0=0.132)
    rows = ["v_f [-],pressure [kPa],branch"]
    for p, word, order in ((up, "loading", 1), (down, "unloading", -1)):
        noisy = p / 1e3 + rng.normal(size=41)
        rows += [f"{a:.6f},{b:.6f},{word}" for a, b in list(zip(v, noisy, strict=True))[::order]]
    path = tmp_path / "loop.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_fit_both_branches(loop, tmp_path):
    out, picture = tmp_path / "fit.json", tmp_path / "fit.png"
    text = run("fit", loop, "--model", "binomial", "-o", out, "--plot", picture)
    assert "K_p" in text
    assert "Correlation" in text
    fits = json.loads(out.read_text())["fits"]
    assert [f["branch"] for f in fits] == ["loading", "unloading"]
    for f, truth in zip(
        fits, ({"K_p": 4e6, "gamma": 1.3}, {"K_p": 3.82e5, "gamma": 3.16}), strict=True
    ):
        for name, value in truth.items():
            low, high = f["interval"][name]
            assert low - 0.05 * value <= value <= high + 0.05 * value
    assert picture.stat().st_size > 10000
    assert "exists already" in run("fit", loop, "-o", out, code=2)


def test_fit_all_and_options(loop):
    text = run("fit", loop, "--all", "--branch", "loading", "--starts", 1)
    assert text.index("binomial") < text.index("van_wyk")
    text = run(
        "fit",
        loop,
        "--model",
        "van_wyk",
        "--branch",
        "loading",
        "-f",
        "E=1e9",
        "--method",
        "nelder_mead",
        "-b",
        "k_p=1e-4:1",
    )
    assert "fixed" in text
    text = run("fit", loop, "--bound", "gamma=1", code=2)
    assert "--bound: gamma=1: expected NAME=LOW:HIGH" in text
    assert "gamma: got 'x'" in run("fit", loop, "-b", "gamma=x:2", code=2)
    assert 'parameter "gam" is unknown' in run("fit", loop, "-f", "gam=1", code=2)


def test_fit_bad_file(tmp_path):
    bad = tmp_path / "bad.csv"
    bad.write_text("v_f [-],pressure [kPa]\n0.1,a\n0.2,b\n0.3,1\n0.4,2\n")
    text = run("fit", bad, code=2)
    assert "line 2" in text
    assert "line 3" in text
    assert text.count("feltmb:") == 1


def test_simulate_and_resume(tmp_path):
    out, whole = tmp_path / "run.npz", tmp_path / "whole.npz"
    given = [
        "--fibers",
        24,
        "--beads",
        11,
        "--v-f",
        0.03,
        "--v-max",
        0.036,
        "--strain-per-step",
        5e-4,
        "--threads",
        1,
    ]
    text = run("simulate", out, *given, "--samples", 3)
    assert "unfinished" in text
    assert "exists already" in run("simulate", out, *given, code=2)
    text = run("simulate", out, "--resume", "--fibers", 30, "--v-max", 0.05, code=2)
    assert "--fibers: 30 does not belong to the run, which has 24" in text
    assert "--v-max: 0.05 does not belong to the run, which has 0.036" in text
    # So fast and so loose a box shows drag and inertia only: it is computed whole, and has failed.
    text = run("simulate", out, "--resume", "--fibers", 24, "--plot", tmp_path / "run.png", code=1)
    assert "loop loss" in text
    assert "release takes work too" in text
    run("simulate", whole, *given, code=1)
    with np.load(out) as a, np.load(whole) as b:
        assert np.array_equal(a["table_pressure"], b["table_pressure"])
        assert np.array_equal(a["state_positions"], b["state_positions"])
    assert ".npz" in run("simulate", tmp_path / "run.txt", code=2)
    assert "no such file" in run("simulate", tmp_path / "none.npz", "--resume", code=2)
    assert "n_fibers" in run("simulate", tmp_path / "x.npz", "--fibers", 1, code=2)
    assert not (tmp_path / "x.npz").exists()


def test_directions_in_and_fibers_out(tmp_path):
    table, out, vtk = (tmp_path / name for name in ("dirs.csv", "run.npz", "run.vtk"))
    table.write_text("x,y,z\n" + "1,0,0\n0,1,0\n" * 12)
    given = ["--beads", 11, "--v-f", 0.03, "--v-max", 0.036, "--strain-per-step", 5e-4]
    text = run("simulate", out, *given, "--orientation", table, "--vtk", vtk, "--samples", 1)
    assert "24 fibers" in text
    assert "porosity" in text
    assert "0.97" in text
    assert vtk.read_text().splitlines()[0] == "# vtk DataFile Version 3.0"
    text = run("simulate", out, "--resume", "--orientation", table, "--vtk", vtk, code=2)
    assert "exists" in text
    text = run("simulate", out, "--resume", *given, "--orientation", table, code=2)
    assert "directions are of the beginning" in text
    text = run("simulate", tmp_path / "b.npz", "--fibers", 9, "--orientation", table, code=2)
    assert "got the shape (24, 3), expected (9, 3)" in text
