"""Sessions: plan, measure, diagnose, on an oscillator whose dry friction the model lacks."""

import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.cli import main as feltmb_main
from feltmb.data import read_record, write_record
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import read_toml
from feltmb.gap import (
    Candidate,
    InputLimits,
    Jobs,
    Limits,
    Measured,
    Options,
    PartTest,
    Record,
    Sensor,
    StartPrior,
    session,
)

HERE = Path(__file__).parent
spec = importlib.util.spec_from_file_location("gap_models", HERE / "models.py")
models = importlib.util.module_from_spec(spec)
spec.loader.exec_module(models)

LIMITS = Limits(
    inputs={"f": InputLimits(least=-2.0, most=2.0, unit="N")}, duration=2.0, sample_rate=250.0
)
SENSORS = {"q": Sensor(name="q", unit="m", sigma=1e-4)}
QUICK = {
    "limits": LIMITS,
    "sensors": SENSORS,
    "options": Options(bootstrap=0, restarts=0, advice=False),
    "candidates": 4,
    "refinements": 0,
    "units": {"f": "N", "q": "m"},
}


def main(words):
    """Exit code of the command."""
    try:
        feltmb_main(words)
    except SystemExit as end:
        return end.code
    return 0


class Machine:
    """Plays a request on the oscillator with dry friction, and counts."""

    def __init__(self, dry=0.05):
        self.dry = dry
        self.calls = []

    def __call__(self, request, answer):
        self.calls.append(request.name)
        rows = np.loadtxt(request, delimiter=",", skiprows=1)
        asked = Record(
            name="x",
            time=rows[:, 0],
            inputs={"f": rows[:, 1]},
            outputs={"q": 0.0 * rows[:, 0]},
            sensors=SENSORS,
            start=StartPrior(mean={"q": 0.0, "v": 0.0}, sd={"q": 0.0, "v": 0.0}),
        )
        jobs = Jobs(
            theta=models.TRUTH[None, :],
            segments=np.array([[0, asked.samples - 1]]),
            starts=np.zeros((1, 2)),
            included=(Candidate(models.DRY), Candidate(models.CUBIC)),
            magnitudes=np.array([[self.dry, 0.0]]),
        )
        clean = models.NOMINAL.simulate(asked, jobs).outputs[0, :, 0]
        noise = 1e-4 * np.random.default_rng(len(self.calls)).standard_normal(clean.size)
        write_record(replace(asked, outputs={"q": clean + noise}), answer, force=True)


def read(path):
    return [read_record(path)]


@pytest.mark.slow
def test_a_session_names_what_is_missing_and_resumes(tmp_path):
    machine = Machine()
    told = []
    found = session(
        models.NOMINAL, models.EFFECTS, machine, read, tmp_path, budget=3, told=told.append, **QUICK
    )
    assert found.outcome == "named"
    assert found.steps[-1].named == ("dry friction",)
    assert len(machine.calls) == len(found.steps) <= 3
    assert [s.number for s in told] == list(range(1, len(told) + 1))
    assert (tmp_path / "1" / "report.html").is_file()
    assert (tmp_path / "1" / "1.png").is_file()
    # Nothing is measured or diagnosed again.
    again = session(models.NOMINAL, models.EFFECTS, _refuse, read, tmp_path,
                    budget=3, **QUICK)  # fmt: skip
    assert again.steps == found.steps
    assert again.outcome == "named"


def _refuse(request, answer):
    raise AssertionError(f"{request} was asked again, for {answer}")


def test_a_session_that_was_cut_off_does_not_measure_twice(tmp_path):
    class Cut(Exception):
        pass

    machine = Machine()

    def cut(request, answer):
        machine(request, answer)
        raise Cut

    with pytest.raises(Cut):
        session(models.NOMINAL, models.EFFECTS, cut, read, tmp_path, budget=1, **QUICK)
    asked = (tmp_path / "1" / "request.csv").read_bytes()
    found = session(models.NOMINAL, models.EFFECTS, _refuse, read, tmp_path, budget=1, **QUICK)
    assert machine.calls == ["request.csv"]
    assert (tmp_path / "1" / "request.csv").read_bytes() == asked
    assert len(found.steps) == 1


def test_a_budget_ends_it(tmp_path):
    found = session(
        models.NOMINAL, models.EFFECTS, Machine(dry=0.0), read, tmp_path, budget=1, **QUICK
    )
    assert found.outcome == "out of budget"
    assert found.steps[-1].named == ()


def test_a_machine_that_is_its_model_ends_with_nothing_missing(tmp_path):
    found = session(
        models.NOMINAL, [models.DRY], Machine(dry=0.0), read, tmp_path, budget=6, **QUICK
    )
    assert found.outcome == "nothing is missing"
    assert found.steps[-1].verdict in ("NO GAP", "NO STRUCTURAL GAP, CALIBRATED")
    assert len(found.steps) < 6
    assert "would show each effect at 0.5 times its expected magnitude" in found.statement


def test_a_record_that_comes_again_is_reported_in_its_step(tmp_path):
    machine = Machine(dry=0.0)
    kept = []

    def again(request, answer):
        """A rig that always returns its first record."""
        if not kept:
            machine(request, answer)
            kept.extend(p.read_bytes() for p in (answer, answer.with_suffix(".toml")))
        answer.write_bytes(kept[0])
        answer.with_suffix(".toml").write_bytes(kept[1])

    wide = [models.DRY, models.CUBIC]
    found = session(models.NOMINAL, wide, again, read, tmp_path, budget=2, **QUICK)
    assert any("experiment_2" in w and "same" in w for w in found.steps[-1].warnings)


@pytest.mark.slow
def test_equal_effects_are_inseparable(tmp_path):
    same = replace(models.DRY, name="dry too")
    found = session(
        models.NOMINAL, [models.DRY, same], Machine(), read, tmp_path, budget=4, **QUICK
    )
    assert found.outcome == "inseparable"
    assert set(found.steps[-1].one_of) == {"dry friction", "dry too"}
    assert (
        "with this standard deviation, separates a cause from the others: dry " in found.statement
    )
    assert len(found.steps) < 4
    assert found.steps[0].expected < 0.55  # a plan does not promise to tell equal effects apart


@pytest.mark.slow
def test_a_part_is_measured_where_it_tells_more(tmp_path):
    """Its request is a TOML, and its value replaces the tolerance."""
    part = PartTest(parameter="d", sd=0.01, cost=0.2, how="free swing")
    limits = replace(LIMITS, parts=(part,))
    machine = Machine()
    asked = []

    def run(request, answer):
        if request.suffix == ".toml":
            asked.append(request.read_text())
            answer.write_text('[measured.d]\nvalue = 0.6\nsd = "0.01 N s/m"\n')
        else:
            machine(request, answer)

    found = session(
        models.NOMINAL, models.EFFECTS, run, read, tmp_path, budget=2.2,
        **{**QUICK, "limits": limits},
    )  # fmt: skip
    kinds = [s.kind for s in found.steps]
    assert kinds.count("part") == len(asked) <= 1
    if asked:
        assert 'parameter = "d"' in asked[0]
    assert "record" in kinds


def equal_effects_with_a_test(folder, value):
    """A session with two equal effects, one of which can be tested by itself."""
    same = replace(models.DRY, name="dry too")
    test = PartTest(parameter="dry too", sd=5e-3, cost=0.5, how="torque wrench")
    machine, asked = Machine(), []

    def run(request, answer):
        if request.suffix == ".toml":
            asked.append(read_toml(request)["part"])
            answer.write_text(f"[measured.'dry too']\nvalue = {value}\nsd = 0.005\n")
        else:
            machine(request, answer)

    found = session(
        models.NOMINAL, [models.DRY, same], run, read, folder, budget=4,
        **{**QUICK, "limits": replace(LIMITS, parts=(test,))},
    )  # fmt: skip
    assert asked == [{"parameter": "dry too", "sd": 5e-3, "how": "torque wrench"}]
    again = session(
        models.NOMINAL, [models.DRY, same], _refuse, read, folder, budget=4,
        **{**QUICK, "limits": replace(LIMITS, parts=(test,))},
    )  # fmt: skip
    assert (again.outcome, again.statement, again.steps) == (
        found.outcome, found.statement, found.steps,
    )  # fmt: skip
    return found


def test_what_the_budget_does_not_pay_for_is_no_reason_for_further_experiments(tmp_path):
    """The test of the part would decide. Without it, further strokes decide nothing."""
    same = replace(models.DRY, name="dry too")
    dear = PartTest(parameter="dry too", sd=5e-3, cost=20.0, how="torque wrench")
    machine = Machine()
    found = session(
        models.NOMINAL, [models.DRY, same], machine, read, tmp_path, budget=4,
        **{**QUICK, "limits": replace(LIMITS, parts=(dear,))},
    )  # fmt: skip
    assert found.outcome == "inseparable"
    assert found.steps[0].expected < 0.55
    assert len(machine.calls) < 3
    assert "with the remaining budget of" in found.statement
    assert "100% with all tested ones" in found.statement


def test_the_test_of_a_part_names_the_other(tmp_path):
    found = equal_effects_with_a_test(tmp_path, 0.001)
    assert found.outcome == "named"
    assert found.steps[-1].named == ("dry friction",)


def test_the_test_of_a_part_finds_the_cause(tmp_path):
    found = equal_effects_with_a_test(tmp_path, 0.049)
    assert found.outcome == "named"
    assert found.steps[-1].named == ("dry too",)
    (one,) = found.report["given"]
    assert one["differs"]
    assert one["low"] < 0.05 < one["high"]
    assert "dry too of 0.0" in found.statement
    assert "(95 %, test 0.049 ± 0.0098 N)" in found.statement


def test_a_test_from_before_is_no_answer_of_a_session(tmp_path):
    """Who has measured a part looks for further causes."""
    machine = Machine()
    known = Measured(parameter="dry friction", value=0.049, sd=5e-3)
    found = session(
        models.NOMINAL, models.EFFECTS, machine, read, tmp_path, budget=1, measured=[known], **QUICK
    )
    assert machine.calls == ["request.csv"]
    assert found.outcome != "named"
    assert found.steps[-1].named == ()
    (one,) = found.report["given"]
    assert one["differs"]


def test_another_test_than_the_one_asked_for_is_no_answer(tmp_path):
    same = replace(models.DRY, name="dry too")
    test = PartTest(parameter="dry too", sd=5e-3, cost=0.1)

    def run(request, answer):
        assert request.suffix == ".toml"
        answer.write_text("[measured.k]\nvalue = 96\nsd = 1\n")

    with pytest.raises(DataError, match=r"record\.toml: got k, expected the test of dry too"):
        session(
            models.NOMINAL, [models.DRY, same], run, read, tmp_path, budget=0.1,
            **{**QUICK, "limits": replace(LIMITS, parts=(test,))},
        )  # fmt: skip


def test_faults_are_told(tmp_path):
    def silent(request, answer):
        del request, answer

    with pytest.raises(DataError, match=r"record\.csv: missing; expected the record"):
        session(models.NOMINAL, models.EFFECTS, silent, read, tmp_path / "a", budget=1, **QUICK)
    with pytest.raises(InvalidParameter, match="holds another session"):
        session(
            models.NOMINAL, models.EFFECTS, silent, read, tmp_path / "a", budget=1, seed=4, **QUICK
        )
    with pytest.raises(InvalidParameter, match="holds another session"):
        session(models.NOMINAL, models.EFFECTS[:1], silent, read, tmp_path / "a", budget=1, **QUICK)


def test_a_session_names_what_differs_from_the_one_of_its_folder(tmp_path):
    def cut(*_request_and_answer):
        raise KeyboardInterrupt

    def again(**other):
        session(models.NOMINAL, models.EFFECTS, cut, read, tmp_path, budget=1, **QUICK | other)

    with pytest.raises(KeyboardInterrupt):
        again()
    wider = replace(LIMITS, duration=3.0)
    with pytest.raises(InvalidParameter, match="with other limits, seed; give another folder"):
        again(limits=wider, seed=4)


def answered(folder, change, **options):
    """A session of one experiment whose answer is changed, as a record."""
    machine = Machine()

    def run(request, answer):
        machine(request, answer)
        write_record(change(read_record(answer)), answer, force=True)

    return session(
        models.NOMINAL, models.EFFECTS, run, read, folder, budget=1, **QUICK | options
    )  # fmt: skip


def test_a_record_that_is_not_what_was_asked_for_is_told(tmp_path):
    half = answered(tmp_path / "half", lambda r: r.cut(0, r.samples // 2, "half", r.role))
    assert any("lasts" in w and "request.csv" in w for w in half.steps[-1].warnings)
    idle = answered(tmp_path / "idle", lambda r: r.with_inputs({"f": 0.0 * r.inputs["f"]}))
    assert any("recorded f differs from request.csv by 100%" in w for w in idle.steps[-1].warnings)
    longer = answered(tmp_path / "late", lambda r: replace(r, time=r.time - r.time[10]))
    assert not any("differs" in w for w in longer.steps[-1].warnings)  # another zero of its clock
    right = answered(tmp_path / "right", lambda r: r)
    assert not right.steps[-1].warnings
    with pytest.raises(DataError, match="is the unit of the time right"):
        answered(tmp_path / "ms", lambda r: replace(r, time=1e3 * r.time))


def test_an_answer_that_cannot_be_read_is_measured_again_after_its_removal(tmp_path):
    record = tmp_path / "1" / "record.csv"

    def spoil(request, answer):
        Machine()(request, answer)
        answer.write_text("nothing\n")

    with pytest.raises(DataError, match=r"record\.csv, or remove it to measure again"):
        session(models.NOMINAL, models.EFFECTS, spoil, read, tmp_path, budget=1, **QUICK)
    record.unlink()
    found = session(models.NOMINAL, models.EFFECTS, Machine(), read, tmp_path, budget=1, **QUICK)
    assert len(found.steps) == 1
    assert record.is_file()


def test_noise_of_an_input_that_a_record_does_not_state_is_that_of_the_limits(
    tmp_path, monkeypatch
):
    noisy = replace(LIMITS, inputs={"f": replace(LIMITS.inputs["f"], sigma=0.01)})
    seen = []

    def diagnose(_model, _effects, records, *_rest):
        seen.extend(records)
        raise KeyboardInterrupt

    monkeypatch.setattr("feltmb.gap.sessions.diagnose", diagnose)
    with pytest.raises(KeyboardInterrupt):
        session(models.NOMINAL, models.EFFECTS, Machine(), read, tmp_path, budget=1,
                **QUICK | {"limits": noisy})  # fmt: skip
    assert seen[0].input_sigma == {"f": 0.01}


MODEL = f"""
import importlib.util
spec = importlib.util.spec_from_file_location("gap_models", {str(HERE / "models.py")!r})
models = importlib.util.module_from_spec(spec)
spec.loader.exec_module(models)
model, effects = models.NOMINAL, models.EFFECTS
"""
RIG = """
import sys
import numpy as np
from pathlib import Path
request, answer = sys.argv[1:]
rows = np.loadtxt(request, delimiter=",", skiprows=1)
t, f = rows.T
q = v = 0.0
out = []
for k in range(len(t)):
    out.append(q)
    for _ in range(20):
        h = (t[1] - t[0]) / 20
        v += h * (f[k] - 96.0 * q - 0.6 * v - 0.05 * np.tanh(v / 5e-3)) / 1.03
        q += h * v
q = np.array(out) + 1e-4 * np.random.default_rng(3).standard_normal(len(t))
lines = ["time [s],f [N],q [m]"] + [f"{a},{b},{c}" for a, b, c in zip(t, f, q)]
Path(answer).write_text("\\n".join(lines) + "\\n")
"""
LIMITS_FILE = """
schema = 1
duration = "2 s"
sample_rate = 250
lead = "8 ms"
[inputs.f]
unit = "N"
least = -2
most = 2
[sensors.q]
sigma = 1e-4
"""


def test_command_line(tmp_path, capsys):
    for name, text in (("model.py", MODEL), ("rig.py", RIG), ("limits.toml", LIMITS_FILE)):
        (tmp_path / name).write_text(text)
    command = [
        "gap", "session", str(tmp_path / "model.py"), "--limits", str(tmp_path / "limits.toml"),
        "--budget", "1", "--candidates", "3", "--refine", "0", "--bootstrap", "0",
        "-o", str(tmp_path / "s"),
    ]  # fmt: skip
    assert main([*command, "--run", f"{sys.executable} -c 'raise SystemExit(3)'"]) == 2
    assert "exit code 3" in capsys.readouterr().err
    assert main([*command, "--run", "no-such-command"]) == 2
    assert "no command no-such-command" in capsys.readouterr().err
    rig = f"{sys.executable} {tmp_path / 'rig.py'}"
    assert main([*command, "--run", rig, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["outcome"] in ("named", "out of budget")
    assert told["steps"][0]["kind"] == "record"


def test_plan_on_the_command_line(tmp_path, capsys):
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "limits.toml").write_text(LIMITS_FILE)
    model, limits = str(tmp_path / "model.py"), str(tmp_path / "limits.toml")
    few = ["--budget", "2", "--candidates", "3", "--refine", "0"]
    assert main(["gap", "plan", model, *few]) == 2
    assert "Give --limits FILE" in capsys.readouterr().err
    assert main(["gap", "plan", model, "-o", str(tmp_path / "p")]) == 2
    assert "--out needs --budget" in capsys.readouterr().err
    folder = tmp_path / "p"
    assert main(["gap", "plan", model, *few, "--limits", limits, "-o", str(folder)]) == 0
    out = capsys.readouterr().out
    assert "separates" in out or "shows" in out
    rows = np.loadtxt(folder / "1.csv", delimiter=",", skiprows=1)
    assert np.abs(rows[:, 1]).max() <= 2.0 + 1e-9
    plan = json.loads((folder / "plan.json").read_text())
    assert plan["experiments"][0]["cost"] == 1.0
    assert plan["after"] > plan["before"]
    assert main(["gap", "plan", model, *few, "--limits", limits, "-o", str(folder)]) == 2
    assert "--force" in capsys.readouterr().err
