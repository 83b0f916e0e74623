"""Models of files on the command line: parameters, unknown effects, options in a file, remedy."""

import json
import tomllib

import numpy as np
import pytest

from unmodeled.cli import main

LINE = """
def line(time, inputs, parameters):
    return {"x": parameters["gain"] * inputs["force"] + parameters["offset"]}
"""


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    return end.value.code


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a function, and three runs of a machine with an offset of 0.3 m."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.py").write_text(LINE)
    time = np.linspace(0.0, 1.0, 60)
    for k in range(3):
        force = (1.0 + k) * np.sin(7.0 * time + k)
        x = 2.0 * force + 0.3 + 1e-3 * np.random.default_rng(k).standard_normal(time.size)
        head = "time [s],force [N],x [m]"
        np.savetxt(f"run{k}.csv", np.column_stack([time, force, x]), "%.6g", ",", header=head,
                   comments="")  # fmt: skip
    return tmp_path


DATA = ("run0.csv", "run1.csv", "run2.csv")


def test_a_function_with_its_options_in_a_file(here, capsys):
    (here / "case.toml").write_text(
        'exclude = ["sensor*", "input force"]\nunknown = "offset=20 cm"\n'
        '[parameter]\ngain = "2.1 m/N ± 10 %"\n'
    )
    given = ("diagnose", "model.py:line", *DATA, "--config", "case.toml")
    assert run(*given, "--json", "-o", "out") == 0
    report = json.loads(capsys.readouterr().out)
    assert [n["cause"] for n in report["named"]] == ["offset"]
    (gain,) = report["parameters"]
    assert (gain["unit"], gain["tabulated"], gain["sd"]) == ("m/N", 2.1, pytest.approx(0.21))
    remedy = tomllib.loads((here / "out" / "remedy.toml").read_text())
    assert remedy == {"parameters": pytest.approx({"gain": 2.0, "offset": 0.3}, rel=1e-2)}
    assert (here / "out" / "report.html").exists()


def test_an_option_of_the_command_line_replaces_that_of_the_file(here, capsys):
    (here / "case.toml").write_text('seconds = 3\n[parameter]\ngain = "2±1"\n')
    given = ("diagnose", "model.py:line", "run0.csv", "--config", "case.toml")
    assert run(*given, "--parameter", "gain=x") == 2
    assert "--parameter gain=x" in capsys.readouterr().err


@pytest.mark.usefixtures("here")
def test_a_fit_of_a_function(capsys):
    given = ("--parameter", "gain=2.1m/N±5%,offset=0 m±1 m")
    assert run("fit", "model.py:line", *DATA, *given, "--json") == 0
    found = {p["name"]: p for p in json.loads(capsys.readouterr().out)["parameters"]}
    assert found["gain"]["value"] == pytest.approx(2.0, rel=1e-3)
    assert found["offset"]["value"] == pytest.approx(0.3, rel=1e-2)
    assert found["offset"]["sd"] == 1.0


def test_blind_and_plan_take_what_diagnose_takes(here, capsys):
    """The channels, the sizes and the choice of the effects are those of a diagnosis."""
    (here / "case.toml").write_text(
        'exclude = ["sensor*", "input force"]\nunknown = "offset=m"\n'
        '[parameter]\ngain = "2.1m/N±5%"\n'
    )
    ramp = "".join(f"{k / 60:.4f},{k / 20:.3f}\n" for k in range(60))
    (here / "ramp.csv").write_text("time [s],force [N]\n" + ramp)
    given = ("model.py:line", *DATA, "--config", "case.toml", "--json")
    assert run("blind", *given, "--cases", 2) == 0
    cases = json.loads(capsys.readouterr().out)["cases"]
    assert [(c["effect"], c["outcome"]) for c in cases] == [("", "quiet"), ("offset", "right")]
    data = [word for name in DATA for word in ("--data", name)]
    assert run("plan", "model.py:line", "ramp.csv", *data, *given[-3:]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert [r["record"] for r in plan["records"]] == ["ramp"]
    assert {c["cause"] for c in plan["effects"]} <= {"offset", "gain"}
    assert plan["after"] > plan["before"]
    assert run("plan", "model.py:line", *given[-3:]) == 2
    assert "has no planned runs; give files with a time and inputs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("model.py:other",), "other is missing, expected a model or a function with this name; "
         "there is model.py:line"),
        (("model.py",), "model is missing"),
        (("model.py:lin", "--parameter", "gain=2±1"), "lin is missing, expected a model"),
        (("model.py:line", "--parameter", "gan=2±1"), "reads the parameter gain, which is "
         "not stated; near are gan; stated are gan: add gain to parameters or unknown"),
        (("model.py:line", "--parameter", "gain"), "--parameter gain: expected NAME=VALUE±SD"),
        (("model.py:line", "--parameter", "gain=2kg±1m"), "--parameter gain=2kg±1m"),
        (("model.py:line", "--parameter", "gain=2±-1"), "expected a value and its standard"),
        (("model.py:line", "--unknown", "offset=furlong"), "--unknown offset=furlong"),
        (("model.py:line", "--set", "a=b"), "has no settings (--set), because it is a .py file"),
        (("nothing.fmu",), "no such file"),
        (("nothing.xml",), "no such file"),
        (("model.py:line", "--config", "bad.toml"), "exclud is no option of this command; did you"),
    ],
)  # fmt: skip
def test_bad_input_gives_one_message(here, arguments, said, capsys):
    pytest.importorskip("fmpy")
    if arguments == ("nothing.xml",):
        pytest.importorskip("mujoco")
    (here / "bad.toml").write_text("exclud = 'x'\n")
    model, *options = arguments
    assert run("diagnose", model, *DATA, *options) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
