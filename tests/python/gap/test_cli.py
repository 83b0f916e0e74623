"""The commands of the diagnosis on a committed example."""

import json
from pathlib import Path

import pytest

from feltmb.cli import main

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = ROOT / "examples" / "gap"
EMPS = [str(f) for f in sorted((EXAMPLES / "data").glob("emps_*.csv"))]


def run(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code


def test_diagnose_writes_the_same_report_twice(tmp_path, capsys):
    for name in "ab":
        code = run("gap", "diagnose", EXAMPLES / "emps.py", *EMPS, "-o", tmp_path / name)
        assert code == 0
    out = capsys.readouterr().out
    assert "dry friction" in out
    for file in ("report.html", "report.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    assert not (tmp_path / "a" / ".resume").exists()
    page = (tmp_path / "a" / "report.html").read_text()
    assert "http" not in page.replace("http-equiv", "")  # nothing is loaded from elsewhere
    assert page.count('class="feltmb-view"') == len(EMPS)  # each record beside the model
    assert page.count("model, amended") >= len(EMPS)
    data = json.loads((tmp_path / "a" / "report.json").read_text())
    assert data["named"][0] == "dry friction"
    assert run("gap", "diagnose", EXAMPLES / "emps.py", *EMPS, "-o", tmp_path / "a") == 2
    assert "--force" in capsys.readouterr().err


def test_check_foresee_and_fit(capsys):
    assert run("gap", "check", *EMPS) == 0
    assert "emps_fit" in capsys.readouterr().out
    assert run("gap", "foresee", EXAMPLES / "emps.py", EMPS[0]) == 0
    assert "dry friction" in capsys.readouterr().out
    assert run("fit", EXAMPLES / "emps.py", EMPS[0], "--json") == 0
    rows = json.loads(capsys.readouterr().out)["parameters"]
    assert {r["name"] for r in rows} == {"mass", "viscous"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("gap", "diagnose", "nothing.py", *EMPS), "no such file"),
        (("gap", "diagnose", "nothing", *EMPS), "no model 'nothing'"),
        (("gap", "diagnose", EXAMPLES / "emps.py", "x.csv"), "no such file"),
        (("gap", "diagnose", EXAMPLES / "emps.py", *EMPS, "--hold-out", "z"), "no record z"),
        (("gap", "diagnose", EXAMPLES / "emps.py", *EMPS, "--alpha", "3"), "0<x<0.5"),
        (
            ("gap", "diagnose", EXAMPLES / "emps.py", *EMPS, "--window", "-1"),
            "-1.0 is not in the range x>0",
        ),
    ],
)
def test_bad_input_gives_one_message(arguments, said, capsys):
    assert run(*arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
