"""The commands of the diagnosis on a committed example."""

import json
from pathlib import Path

import numpy as np
import pytest

from unmodeled.cli import main

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = ROOT / "unmodeled" / "examples"
EMPS = [str(f) for f in sorted((EXAMPLES / "data").glob("emps_*.csv"))]
#: Options with which a diagnosis takes seconds.
QUICK = ("--max-effects", "1")


def run(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code


def test_diagnose_writes_the_same_report_twice(tmp_path, capsys):
    for name in "ab":
        given = (
            "diagnose",
            EXAMPLES / "emps.py",
            *EMPS,
            "--max-effects",
            "2",
            "-o",
            tmp_path / name,
        )
        assert run(*given) == 0
    out = capsys.readouterr().out
    assert "dry friction" in out
    found = [json.loads((tmp_path / name / "report.json").read_text()) for name in "ab"]
    assert [n["cause"] for n in found[0]["named"]] == ["dry friction"]
    assert found[0]["named"][0]["low"] < 20.4 < found[0]["named"][0]["high"]
    for data in found:
        del data["seconds"]
    assert found[0] == found[1]
    page = (tmp_path / "a" / "report.html").read_text()
    assert "http" not in page.replace("http-equiv", "")  # nothing is loaded from elsewhere
    assert page.count('role="img"') == 7  # motions twice, two laws, and three of the details
    assert run(*given) == 2
    assert "--force" in capsys.readouterr().err


def test_check_and_fit(capsys):
    assert run("check", *EMPS) == 0
    assert "emps_fit" in capsys.readouterr().out
    assert run("fit", EXAMPLES / "emps.py", EMPS[0], "--json") == 0
    rows = json.loads(capsys.readouterr().out)["parameters"]
    assert {r["name"] for r in rows} == {"mass", "viscous"}


FEW = [
    *("--set", "tolerances=let_off_button,felt.03"),
    *("--set", "effects=let_off_button,camera_skew,viscous_friction.butt"),
]


def test_a_held_out_file_is_told_from_another_of_its_name(tmp_path, capsys):
    data = []
    for folder, source in zip("ab", EMPS, strict=False):
        (tmp_path / folder).mkdir()
        for suffix in (".csv", ".toml"):
            text = Path(source).with_suffix(suffix).read_text()
            (tmp_path / folder / f"r{suffix}").write_text(text)
        data.append(tmp_path / folder / "r.csv")
    assert run("diagnose", EXAMPLES / "emps.py", *data, "--hold-out", "r.csv") == 2
    assert (
        "--hold-out r.csv: is the name of 2 files; give the whole path" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nothing.py", *EMPS), "no such file"),
        (("nothing", *EMPS), "no model 'nothing'"),
        ((EXAMPLES / "emps.py", "x.csv"), "no such file"),
        ((EXAMPLES / "emps.py", *EMPS, "--hold-out", "z"), "no record z"),
        ((EXAMPLES / "emps.py", *EMPS, "--credibility", "3"), "0.5<=x<1"),
        ((EXAMPLES / "emps.py", *EMPS, "--prior", "1"), "0<x<1"),
        ((EXAMPLES / "emps.py", *EMPS, "--seconds", "-1"), "x>0"),
        ((EXAMPLES / "emps.py", *EMPS, "--good-enough", "2"), "expected a size with its unit"),
        ((EXAMPLES / "emps.py", *EMPS, "--good-enough", "z=2N"), "good_enough: got z"),
        ((EXAMPLES / "emps.py", *EMPS, "-o", "a.xml"), "cannot write .xml, expected .toml"),
    ],
)
def test_bad_input_gives_one_message(arguments, said, capsys):
    assert run("diagnose", *arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error


def test_a_limit_of_time_and_what_is_good_enough_are_used(capsys):
    given = ("diagnose", EXAMPLES / "emps.py", *EMPS, "--json")
    assert run(*given, "--seconds", "1ms", "--good-enough", "force=30N") == 0
    found = json.loads(capsys.readouterr().out)
    assert not found["complete"]
    assert found["channels"][0]["good_enough"] == 30.0
    assert found["verdict"] == "NO_GAP"


def test_columns_are_inputs_of_a_model_that_names_none(tmp_path, capsys):
    """A LinearModel reads columns of the record by their names; a sheet was necessary for them."""
    (tmp_path / "spring.py").write_text(
        "from unmodeled import LinearModel, Parameter\n"
        'model = LinearModel(name="spring", output="F", columns={"k": lambda r: r.inputs["x"]},\n'
        '    parameters=[Parameter(name="k", value=100.0, sd=10.0, unit="N/m")])\n'
        "effects = ()\n"
    )
    files = []
    for i in range(3):
        x = 0.02 * np.sin((20.0 + 9.0 * i) * np.arange(300) * 2e-3)
        force = 104.0 * x + 1e-2 * np.random.default_rng(i).standard_normal(300)
        path = tmp_path / f"r{i}.csv"
        rows = zip(2.0 * np.arange(300), 1e3 * x, 0.0 * x, force, strict=True)
        lines = ["time [ms],x [mm],unused [1],F [N],state [foo],sparse"]
        lines += [",".join(map(str, r)) + f",1,{'' if n % 9 else 2}" for n, r in enumerate(rows)]
        path.write_text("\n".join(lines) + "\n")
        files.append(path)
    assert run("check", tmp_path / "spring.py", *files) == 0
    assert run("new", files[0], "--model", tmp_path / "spring.py") == 0
    assert '[inputs."x"]' in files[0].with_suffix(".toml").read_text()
    capsys.readouterr()
    assert run("diagnose", tmp_path / "spring.py", *files, "--hold-out", files[2]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "The parameter k is 103.9" in shown or "k is 104.0" in shown
    assert "column state is left out: its unit foo is not known" in shown
    assert "column sparse is left out: 266 of 300 values are missing" in shown


def test_a_missing_input_of_a_linear_model_is_named(tmp_path, capsys):
    (tmp_path / "spring.py").write_text(
        "from unmodeled import LinearModel, Parameter\n"
        'model = LinearModel(name="spring", output="F", columns={"k": lambda r: r.inputs["x"]},\n'
        '    parameters=[Parameter(name="k", value=100.0, sd=10.0, unit="N/m")])\n'
        "effects = ()\n"
    )
    rows = [f"{0.01 * i:.2f},{'' if i == 7 else i},{i},{0.5 * i}" for i in range(50)]
    path = tmp_path / "r.csv"
    path.write_text("\n".join(["time [s],x [m],y [m],F [N]", *rows]) + "\n")
    run("diagnose", tmp_path / "spring.py", path)
    error = capsys.readouterr().err
    assert "its functions raise KeyError: 'x'; the inputs of record r are y" in error
    assert "column x is left out: 1 of 50 values are missing" in error
    assert "Traceback" not in error


def test_notes_about_several_channels_are_one_and_long_tables_end(tmp_path, capsys):
    names = [f"c{k}" for k in range(210)]
    rows = [",".join([f"{t}", *(["1"] * 209), f"{t * t}"]) for t in range(6)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([",".join(["t [s]", *names]), *rows]))
    assert run("check", path) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "10 more channels are not shown; --json prints all" in out
    assert out.count(": it never changes") == 1
    assert "Note: a.c0, a.c1, a.c2" in out
    # What can be stated is told first.
    assert out.index("no unit in the header") < out.index("it never changes")
    assert run("check", path, "--json") == 0
    assert len(json.loads(capsys.readouterr().out)["channels"]) == 210


def test_a_difference_that_is_not_given_in_noise_is_told(tmp_path, capsys):
    model = tmp_path / "m.py"
    model.write_text(
        "import unmodeled\n"
        "model = unmodeled.Equations(lambda t, x, u, p: (-p.k * x.q,),"
        " states={'q': (1.0, 0.1, 'm')},"
        " parameters={'k': (1.0, 0.1, '1/s')}, outputs={'q': 'q'})\n"
    )
    path = tmp_path / "a.csv"
    path.write_text("t [s],q [m]\n" + "".join(f"{0.1 * k},{0.9**k}\n" for k in range(30)))
    assert run("check", model, path) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "of motion factor" in out
    assert "q: no noise is stated, so that the difference is not given in noise" in out


def test_the_answer_is_drawn_where_the_name_is_that_of_a_picture(tmp_path, capsys):
    picture = tmp_path / "answer.svg"
    given = ("diagnose", EXAMPLES / "emps.py", *EMPS, "--seconds", "0.01", "-o", picture)
    assert run(*given) == 0
    assert f"wrote {picture}" in capsys.readouterr().err.replace("\n", "")
    assert "<svg" in picture.read_text()
    assert run(*given) == 2  # before anything is computed
    assert "--force" in capsys.readouterr().err
