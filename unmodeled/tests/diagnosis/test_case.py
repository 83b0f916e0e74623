"""A diagnosis as a folder that another person repeats: what it holds, and what verify says."""

import copy
import importlib.util
import json
import shutil
import sys
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

import unmodeled
from unmodeled import Options, Record, Sensor, Simulator, StartPrior, verification
from unmodeled.cli import main
from unmodeled.data import read_record, write_record
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit.mjcf_parts import parts_of
from unmodeled.models.model import Origin, Parameter, UserUnit, prior_jobs
from unmodeled.models.writing import write
from unmodeled.report.case import _copy, _has_effects, sha256_of
from unmodeled.report.stored import Answer
from unmodeled.report.values import as_made, as_stored

LINE = """
def line(time, inputs, parameters):
    return {"x": parameters["gain"] * inputs["force"] + parameters["offset"]}
"""
PRIOR = {"gain": (2.1, 0.2, "m/N")}
UNKNOWN = {"offset": "m"}


def run(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    return end.value.code


def records():
    """Three runs of a machine with an offset of 0.3 m, the last one with a name like a path."""
    time = np.linspace(0.0, 1.0, 60)
    found = []
    for k, name in enumerate(("a", "b", "runs/third run")):
        force = (1.0 + k) * np.sin(7.0 * time + k)
        x = 2.0 * force + 0.3 + 1e-3 * np.random.default_rng(k).standard_normal(time.size)
        sensors = {"x": Sensor(name="x", unit="m", sigma=1e-3)}
        given = {"inputs": {"force": force}, "outputs": {"x": x}, "sensors": sensors}
        found.append(Record(name=name, time=time, **given))
    return found


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """An imported file that defines the function."""
    path = tmp_path_factory.mktemp("rig") / "rig.py"
    path.write_text(LINE)
    spec = importlib.util.spec_from_file_location("rig_of_test", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "rig_of_test", module)
        yield module


@pytest.fixture(scope="module")
def report(rig):
    """The diagnosis of the three runs."""
    return diagnosed(rig.line, options=Options(seconds=60.0))


@pytest.fixture(scope="module")
def written(report, tmp_path_factory):
    """Folder of its case."""
    folder = tmp_path_factory.mktemp("written") / "case"
    report.write(folder)
    return folder


def diagnosed(function, **more):
    model = Simulator(function, parameters=PRIOR, unknown=UNKNOWN)
    return model.diagnose(records(), exclude=["sensor*", "input*"], **more)


def edited(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_a_case_is_repeated_and_its_numbers_agree(report, written):
    assert [n.cause for n in report.named] == ["offset"]
    found = unmodeled.verify(written)
    assert found.agrees, str(found)
    one, other = report.as_dict(), found.answer
    assert one["sets"] == other["sets"]
    assert one["parameters"] == other["parameters"]
    rows = {r.what: r for r in found.rows}
    assert rows["offset"].stored == pytest.approx(0.3, rel=1e-2)
    assert rows["parameter gain"].again == pytest.approx(2.0, rel=1e-2)
    assert "Not stored" not in (written / "README.txt").read_text()


def test_what_changed_in_a_case_is_told_with_an_exit_code(written, tmp_path, capsys):
    at = shutil.copytree(written, tmp_path / "case")
    assert run("verify", at) == 0
    assert "The answer is the same" in capsys.readouterr().out
    whole = (at / "case.json").read_text()

    def narrow(case):
        case["model"]["parameters"][0]["sd"] = 1e-4

    edited(at / "case.json", narrow)  # a disputed prior: the gain stays at 2.1
    assert run("verify", at, "--json") == 1
    rows = {r["what"]: r for r in json.loads(capsys.readouterr().out)["rows"]}
    gain = rows["parameter gain"]
    assert not gain["agrees"]
    assert (gain["stored"], gain["again"]) == pytest.approx((2.0, 2.1), rel=5e-3)
    (at / "case.json").write_text(whole)
    file = at / "records" / "03_runs_third_run.csv"
    lines = file.read_text().splitlines()
    lines[30] = ",".join([*lines[30].split(",")[:2], "4.0"])
    file.write_text("\n".join(lines) + "\n")
    assert run("verify", at) == 1
    said = capsys.readouterr().out
    assert "Nothing was run: files are not those of the case." in said
    assert "- file records/03_runs_third_run.csv: the stored hash in the case, changed now" in said


def test_a_model_that_no_file_holds_is_told_and_given_to_verify(rig, tmp_path, capsys):
    factor = 1.0
    report = diagnosed(lambda t, u, p: {"x": factor * p["gain"] * u["force"] + p["offset"]})
    at = tmp_path / "case"
    report.write(at)
    said = (at / "README.txt").read_text()
    assert "--model FILE.py:NAME" in said
    assert "which no file holds alone" in said
    with pytest.raises(InvalidParameter, match=r"is not stored.*--model FILE\.py:NAME"):
        unmodeled.verify(at)
    assert run("verify", at, "--model", f"{rig.__file__}:line") == 0
    (tmp_path / "other.py").write_text(LINE.replace("offset", "shift"))
    assert run("verify", at, "--model", f"{tmp_path / 'other.py'}:line") == 2
    assert "shift" in capsys.readouterr().err


def test_an_effect_of_a_script_is_told(rig, tmp_path):
    own = unmodeled.Effect(
        name="wobble",
        component="table",
        unit="m",
        observe=lambda r, y, m, s: y + m[:, None, None] * np.sin(50.0 * r.time)[:, None],
    )
    report = Simulator(rig.line, parameters=PRIOR, unknown=UNKNOWN).diagnose(
        records(), effects=[own]
    )
    report.write(tmp_path / "case")
    assert "the effects wobble are functions" in (tmp_path / "case" / "README.txt").read_text()
    with pytest.raises(InvalidParameter, match="no effect wobble is known"):
        unmodeled.verify(tmp_path / "case")


def test_a_mujoco_model_is_stored_with_its_parts_and_its_included_effects(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "robot" / "parts").mkdir(parents=True)
    (tmp_path / "robot" / "arm.xml").write_text(
        '<mujoco><compiler meshdir="parts"/><include file="parts/body.xml"/><actuator>'
        '<motor name="m" joint="j"/></actuator></mujoco>'
    )
    (tmp_path / "robot" / "parts" / "body.xml").write_text(
        '<mujoco><asset><mesh name="t" file="t.obj"/></asset><worldbody><body><joint name="j" '
        'axis="0 1 0"/><geom type="box" size=".1 .02 .02" pos=".1 0 0"/><geom type="mesh" mesh="t" '
        'contype="0" conaffinity="0"/></body></worldbody></mujoco>'
    )
    (tmp_path / "robot" / "parts" / "t.obj").write_text(
        "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    make = {"parameters": {"j.damping": (0.05, 0.05)}, "inputs": ["m"], "outputs": ["j"]}
    model = unmodeled.mujoco(tmp_path / "robot" / "arm.xml", **make)
    time = np.arange(150) * 0.01
    given = {"time": time, "inputs": {"m": 0.5 * np.sin(9.0 * time)}}
    blank = Record(name="a", outputs={"j": time}, **given)
    y = model.simulate(blank, prior_jobs(model, blank))[0, :, 0]
    noisy = y + 1e-4 * np.random.default_rng(0).standard_normal(time.size)
    sensors = {"j": Sensor(name="j", unit="rad", sigma=1e-4)}
    record = Record(name="a", outputs={"j": noisy}, sensors=sensors, **given)
    dry = {e.name: e for e in model.effects}["j.frictionloss"]
    richer = unmodeled.including(model, [replace(dry, scale=0.01)], sds=[0.01])
    richer.diagnose(record, effects=(), hold_out=()).write(tmp_path / "case")
    kept = sorted(p.name for p in (tmp_path / "case" / "model").rglob("*") if p.is_file())
    assert kept == ["arm.xml", "body.xml", "t.obj"]
    found = unmodeled.verify(tmp_path / "case")
    assert found.agrees, str(found)
    assert {"parameter j.damping", "parameter j.frictionloss"} <= {r.what for r in found.rows}


def test_records_come_back_bit_by_bit(tmp_path):
    generator = np.random.default_rng(1)
    time = 0.1 + np.cumsum(generator.uniform(1e-3, 1.0, 200)) / 3.0
    x = generator.standard_normal(200) * 10.0 ** generator.integers(-9, 9, 200)
    x[7] = np.nan
    sensor = Sensor(name="x", unit="m", sigma=1 / 3, quantum=1e-3, delay=0.1, bandwidth=70.0,
                    gain=1.1, offset=0.01, gain_sd=0.02, offset_sd=0.1, delay_sd=1e-3)  # fmt: skip
    record = Record(
        name="x/ü", time=time, inputs={"u": time / 7.0}, outputs={"x": x},
        sensors={"x": sensor}, input_units={"u": "N"}, input_sigma={"u": 0.1}, role="held_out",
        start=StartPrior(mean={"q": 1 / 7}, sd={"q": 0.1}), conditions={"humidity": 0.4},
    )  # fmt: skip
    back = read_record(write_record(record, tmp_path / "r.csv"), inputs=["u"], outputs=["x"])
    for f in fields(Record):
        if f.name not in ("time", "inputs", "outputs", "notes", "source"):
            assert getattr(back, f.name) == getattr(record, f.name), f.name
    assert np.array_equal(back.time, time)
    assert np.array_equal(back.inputs["u"], record.inputs["u"])
    assert np.array_equal(back.outputs["x"], x, equal_nan=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c.update(version=99), "version: got 99, expected 1"),
        (lambda c: c.pop("options"), "options: "),
        (lambda c: c["sha256"].update({"../x": "0"}), "../x is outside of the folder"),
        (lambda c: c["sha256"].update({"records/x.csv": "0"}), "records/x.csv is missing"),
    ],
)
def test_a_folder_that_is_no_case_is_told(written, tmp_path, change, said):
    with pytest.raises(DataError, match=r"holds no case\.json"):
        unmodeled.verify(tmp_path)
    shutil.copytree(written, tmp_path / "case")
    edited(tmp_path / "case" / "case.json", change)
    with pytest.raises(DataError, match=said):
        unmodeled.verify(tmp_path / "case")


def test_the_unit_of_a_user_is_stored():
    """A screw has turns beside its length."""
    screw = Parameter(name="screw", value=0.0, sd=1e-4, user_unit=UserUnit("turn", 1430.0))
    assert as_made(as_stored(screw)) == screw


def test_what_is_stored_comes_back_and_a_function_is_refused():
    given = {"a": True, "b": None, "c": 3, "d": 0.1, "e": "text", "f": ((1.0, -np.inf), 2)}
    stored = json.loads(json.dumps(as_stored(given)))
    made = as_made(stored)
    assert made == given
    assert [type(v) for v in made.values()] == [type(v) for v in given.values()]
    assert np.isnan(as_made(as_stored(np.nan)))
    with pytest.raises(TypeError, match="function cannot be stored"):
        as_stored(run)


@pytest.mark.parametrize(
    ("made_by", "text", "known"),
    [
        ("load_model", "model = 1\ndef effects(records):\n    return []\n", True),
        ("load_model", "model = 1\neffects = ()\n", True),
        ("load_model", "model = 1\nside_effects = ()\n", False),
        ("simulator", "effects = ()\n", False),
    ],
)
def test_a_file_of_a_model_may_define_its_effects(tmp_path, made_by, text, known):
    path = tmp_path / "rig.py"
    path.write_text(text)
    assert _has_effects(Origin(made_by, f"{path}:model")) is known
    assert not _has_effects(None)


def test_a_folder_is_written_whole_or_stays(report, rig, tmp_path, monkeypatch):
    at = tmp_path / "case"
    report.write(at)
    (at / "mine.txt").write_text("mine")
    before = {p: p.read_bytes() for p in at.rglob("*") if p.is_file()}
    with pytest.raises(unmodeled.errors.FileExists, match=r"case.*exists already"):
        report.write(at)

    def ctrl_c(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("unmodeled.report.case.sha256_of", ctrl_c)
        with pytest.raises(KeyboardInterrupt):
            report.write(at, force=True)
    assert {p: p.read_bytes() for p in at.rglob("*") if p.is_file()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["case"]
    (tmp_path / "other.py").write_text(LINE)
    model = unmodeled.load_model(f"{tmp_path / 'other.py'}:line", parameters=PRIOR, unknown=UNKNOWN)
    model.model.diagnose(records()[:1], exclude=["*"]).write(at, force=True)
    assert [p.name for p in (at / "model").iterdir()] == ["other.py"]  # not that of the old case
    assert (at / "mine.txt").read_text() == "mine"
    assert len([*(at / "records").iterdir()]) == 2


def test_an_interrupted_diagnosis_has_an_exit_code_of_its_own(tmp_path, monkeypatch, capsys):
    (tmp_path / "rig.py").write_text(LINE)
    write_record(records()[0], tmp_path / "r.csv")
    told = []

    def interrupt(self, progress):
        told.append(progress.stage)
        if progress.stage == "search":
            raise KeyboardInterrupt

    monkeypatch.setattr("unmodeled.cli.screen.ProgressLine.__call__", interrupt)
    code = run("diagnose", f"{tmp_path / 'rig.py'}:line", tmp_path / "r.csv", "--parameter",
               "gain=2.1±0.2", "--unknown", "offset=m", "-o", tmp_path / "case")  # fmt: skip
    assert code == 130
    assert "interrupted" in capsys.readouterr().out
    assert (tmp_path / "case" / "case.json").exists()


# ------------------------------------------------------------------------- cases of strangers

#: What replaces a value of a JSON file; the first stands for its removal.
WRONG = (KeyError, None, True, -1, 1e308, "nan", "", "../../x", "/etc/hostname", [], [[]], {},
         {"class": "Effect"}, {"class": "x"}, "a\0b", [1, "a"])  # fmt: skip


def places(node, at=()):
    """Paths of all values of a JSON file."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        yield (*at, key)
        if isinstance(value, dict | list):
            yield from places(value, (*at, key))


def put(node, at, value):
    for key in at[:-1]:
        node = node[key]
    if value is KeyError:
        del node[at[-1]]
    else:
        node[at[-1]] = value


@pytest.mark.parametrize("file", ["case.json", "report.json"])
@pytest.mark.parametrize("count", [121, pytest.param(2000, marks=pytest.mark.slow)])
def test_a_damaged_case_gives_one_message(written, tmp_path, monkeypatch, file, count):
    at = shutil.copytree(written, tmp_path / "case")
    whole = {n: json.loads((at / n).read_text()) for n in ("case.json", "report.json")}
    again = whole["report.json"]

    def here(_module, asked, progress):
        return verification.repeat(asked, progress)

    def diagnosed(*_, **__):
        return SimpleNamespace(as_dict=lambda: again)

    monkeypatch.setattr(verification, "run_apart", here)
    monkeypatch.setattr(verification, "diagnose", diagnosed)
    read = whole[file] if file == "case.json" else {k: again[k] for k in Answer.model_fields}
    every = [(p, v) for p in places(read) for v in WRONG]
    generator = np.random.default_rng(93)
    picked = generator.choice(len(every), min(count, len(every)), replace=False)
    refused = 0
    for k in picked:
        changed = copy.deepcopy(whole)
        put(changed[file], *every[k])
        (at / "report.json").write_text(json.dumps(changed["report.json"]))
        if file == "report.json":
            changed["case.json"]["sha256"]["report.json"] = sha256_of(at / "report.json")
        (at / "case.json").write_text(json.dumps(changed["case.json"]))
        try:
            str(unmodeled.verify(at))
        except unmodeled.errors.Error as error:
            refused += len(str(error)) < 3000
        except Exception as error:
            raise AssertionError(every[k]) from error
    assert refused > 0.3 * len(picked)


def test_a_file_that_changed_stops_before_anything_runs(written, tmp_path):
    at = shutil.copytree(written, tmp_path / "case")
    (at / "model" / "rig.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n" + LINE)
    found = unmodeled.verify(at)
    assert not found.agrees
    assert found.answer is None
    assert [r.what for r in found.rows] == ["file model/rig.py"]
    assert not (tmp_path / "ran").exists()


def test_a_model_that_ends_its_process_gives_no_verdict(written, tmp_path, capfd):
    at = shutil.copytree(written, tmp_path / "case")
    model = at / "model" / "rig.py"
    model.write_text("import os\nprint('{\"result\": {}}', flush=True)\nos._exit(0)\n" + LINE)
    edited(at / "case.json", lambda c: c["sha256"].update({"model/rig.py": sha256_of(model)}))
    with pytest.raises(unmodeled.errors.ModelError, match=r"without an answer \(exit code 0\)"):
        unmodeled.verify(at)
    assert run("verify", at) == 2
    assert "its model in" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda at: (at / "model" / "helper.py").write_text(""), r"helper\.py is no file of the"),
        (lambda at: (at / "records" / "01_a.toml").unlink(), r"01_a\.toml is missing"),
        (lambda at: edited(at / "case.json", lambda c: c["sha256"].pop("model/rig.py")),
         r"model/rig\.py has no hash"),
        (lambda at: linked(at / "model" / "rig.py"), r"model/rig\.py is outside of the folder"),
    ],
)  # fmt: skip
def test_verify_reads_listed_files_of_the_folder_only(written, tmp_path, change, said):
    at = shutil.copytree(written, tmp_path / "case")
    change(at)
    with pytest.raises(DataError, match=said):
        unmodeled.verify(at)


def linked(path):
    """Move a file out of its case, and link to it."""
    other = path.parents[2] / path.name
    path.rename(other)
    path.symlink_to(other)


# --------------------------------------------------------------------------- parts of a model

ARM = (
    '<mujoco><include file="{}"/><worldbody><body name="arm"><joint name="j" axis="0 1 0" '
    'damping="0.1"/><geom size=".02" mass="1"/></body></worldbody>'
    '<actuator><motor name="m" joint="j"/></actuator></mujoco>'
)
COMMON = '<mujoco><option timestep="0.01"/></mujoco>'


def test_a_part_beside_the_folder_of_a_model_is_stored_and_listed(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "common").mkdir()
    (tmp_path / "robot").mkdir()
    (tmp_path / "common" / "x.xml").write_text(COMMON)
    (tmp_path / "robot" / "arm.xml").write_text(ARM.format("../common/x.xml"))
    out, kept = tmp_path / "out" / "model", []
    out.parent.mkdir()
    place, outside, left = _copy(tmp_path / "robot" / "arm.xml", out, kept)
    assert (place, outside, left) == ("robot/arm.xml", ["common/x.xml"], [])
    assert sorted(kept) == [out / "common" / "x.xml", out / "robot" / "arm.xml"]
    assert {*parts_of(out / place).sizes} == {*kept}
    told = unmodeled.mujoco(tmp_path / "robot" / "arm.xml", parameters={"j.damping": (None, 0.1)})
    assert any("outside its folder" in n for n in told.mjcf.notices)
    written = write(told, tmp_path / "r.xml", np.array([0.2]), (), np.zeros(0))
    assert "holds what is in ../common/x.xml" in written.read_text()


def test_a_part_with_an_absolute_path_is_not_stored(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "x.xml").write_text(COMMON)
    (tmp_path / "robot").mkdir()
    source = tmp_path / "robot" / "arm.xml"
    source.write_text(ARM.format(tmp_path / "elsewhere" / "x.xml"))
    (tmp_path / "out").mkdir()
    kept = []
    place, outside, left = _copy(source, tmp_path / "out" / "model", kept)
    assert (place, outside) == ("arm.xml", [])
    assert kept == [tmp_path / "out" / "model" / "arm.xml"]
    assert left == [f"{tmp_path / 'elsewhere' / 'x.xml'}, which arm.xml names by an absolute path"]
