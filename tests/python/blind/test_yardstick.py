"""The yardstick: marks, comparison, imperfect machines, a case in a process of its own."""

import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import blind.yardstick
from blind import small_machine
from blind.imperfect.generate import NOISE, ROWS, load, make, save, simulate
from blind.imperfect.machines import TABLES
from blind.imperfect.stated import stated, to_records
from blind.marks import Answer, Cause, Marked, Truth, compare, mark, mcnemar, read, table
from blind.yardstick import run_case
from blind.yardstick_sets import SEALED, SETS
from unmodeled.data import Record
from unmodeled.fit import Jobs

FRICTION = Truth("effect", (Cause(("dry friction",), ("Stribeck friction",)),), {"m": 2.0})


def _short(name):
    """Number and table of a machine, with shorter records."""
    index = [t.name for t in TABLES].index(name)
    return index, replace(TABLES[index], samples=200)


@pytest.mark.parametrize(
    ("expected", "answer"),
    [
        ("right", Answer("NAMED", ("dry friction",))),
        ("right", Answer("NAMED", ("dry friction", "Stribeck friction"))),
        ("class", Answer("NAMED", ("Stribeck friction",))),
        ("class", Answer("ONE OF", classes=(("backlash", "dry friction"),))),
        ("wrong", Answer("ONE OF", classes=(("backlash", "creep"),))),
        ("wrong", Answer("NAMED", ("dry friction", "backlash"))),
        ("wrong", Answer("NAMED", ("dry friction",), (("backlash", "creep"),))),
        ("wrong", Answer("DATA PROBLEM")),
        ("silent", Answer("CALIBRATED", moved=("m",))),
        ("silent", Answer("UNKNOWN")),
        ("none", Answer("none", ("dry friction",))),
    ],
)
def test_marks_of_one_effect(expected, answer):
    assert mark(FRICTION, answer) == expected


def test_marks_of_two_effects():
    both = Truth("effect", (Cause(("dry friction",)), Cause(("viscous friction",))))
    assert mark(both, Answer("NAMED", ("viscous friction", "dry friction"))) == "right"
    assert mark(both, Answer("NAMED", ("dry friction",))) == "part"
    assert mark(both, Answer("NAMED", ("dry friction", "creep"))) == "wrong"
    assert mark(both, Answer("ONE OF", classes=(("dry friction", "creep"),))) == "class"


def test_parameter_counts_alone_only():
    truth = Truth("effect", (Cause(("mass", "parameter:m")),))
    assert mark(truth, Answer("CALIBRATED", moved=("m", "k"))) == "right"
    assert mark(truth, Answer("CALIBRATED", moved=("k",))) == "silent"
    assert mark(truth, Answer("UNKNOWN", moved=("m",))) == "silent"
    assert mark(truth, Answer("NAMED", ("parameter:m",))) == "right"
    assert mark(truth, Answer("NAMED", ("creep",), moved=("m",))) == "wrong"


def test_marks_of_controls_and_causes_from_outside():
    control, outside = Truth("control"), Truth("outside", (Cause((), ("creep",)),))
    for answer, first, second in (
        (Answer("CALIBRATED"), "quiet", "silent"),
        (Answer("UNKNOWN"), "unknown", "right"),
        (Answer("NAMED", ("backlash",)), "false alarm", "wrong"),
        (Answer("ONE OF", classes=(("backlash",),)), "false alarm", "wrong"),
        (Answer("NAMED", ("creep",)), "false alarm", "class"),
        (Answer("DATA PROBLEM"), "false alarm", "wrong"),
        (Answer("none"), "none", "none"),
    ):
        assert (mark(control, answer), mark(outside, answer)) == (first, second)


def test_marks_of_numbers_and_of_a_required_class():
    numbers = Truth("numbers", numbers={"k": 20.0}, free=("offset of*",))
    near, far = {"k": (20.5, 19.0, 22.0)}, {"k": (18.0, 17.0, 19.0)}
    assert mark(numbers, Answer("CALIBRATED", parameters=near)) == "right"
    assert mark(numbers, Answer("NAMED", ("offset of sensor x",), parameters=near)) == "right"
    assert mark(numbers, Answer("CALIBRATED", parameters=far)) == "silent"
    assert mark(numbers, Answer("NAMED", ("creep",), parameters=near)) == "wrong"
    either = Truth("one of", (Cause(("dry", "one-sided")),))
    assert mark(either, Answer("ONE OF", classes=(("dry", "one-sided", "x"),))) == "right"
    assert mark(either, Answer("ONE OF", classes=(("dry", "x"),))) == "class"
    assert mark(either, Answer("NAMED", ("dry",))) == "wrong"
    assert mark(either, Answer("CALIBRATED")) == "silent"


def test_mcnemar_is_the_binomial_test():
    from scipy.stats import binomtest

    for a, b in ((0, 0), (3, 0), (1, 7), (5, 5), (2, 11)):
        expected = binomtest(a, a + b).pvalue if a + b else 1.0
        assert mcnemar(a, b) == pytest.approx(expected)


def _marked(case, answer):
    return Marked("some", case, "abc", FRICTION, answer)


def test_files_and_paired_table(tmp_path):
    right = Answer(
        "NAMED", ("dry friction",), parameters={"m": (2.1, 1.9, 2.3)}, seconds=3.0,
        held_out=(4.0, 1.0),
    )  # fmt: skip
    far = Answer("NAMED", ("creep",), parameters={"m": (2.5, 2.3, float("nan"))}, seconds=5.0)
    missed = Answer("CALIBRATED", parameters={"m": (2.5, 2.3, 2.7)})
    path = tmp_path / "a.jsonl"
    rows = [_marked(0, far), _marked(0, right), _marked(1, missed)]
    path.write_text("".join(m.line + "\n" for m in rows))
    json.loads(path.read_text().splitlines()[0], parse_constant=pytest.fail)
    one = read(path)
    assert [m.mark for m in one.values()] == ["right", "silent"]  # the last of a case counts
    shown = table(list(one.values()))
    assert shown["intervals that cover"] == "1 of 2 (50%)"
    assert shown["effects: right"] == "1 of 2"
    assert shown["held-out residual after / before, median"] == "0.25 (1)"
    two = {("some", 0): _marked(0, far), ("some", 1): _marked(1, right), ("some", 2): rows[0]}
    text = compare(one, two)
    assert "some, 2 cases" in text
    assert "| right or quiet | 1 | 1 | 1 |" in text
    assert "| neither wrong nor false alarm | 1 | 0 | 1 |" in text
    assert "- 0: right -> wrong" in text


def test_sets_are_frozen():
    counts = {n: s.count for n, s in SETS.items()}
    assert counts == {
        "imperfect": 120, "perfect": 24, "small": 300, "action": 60, "measured": 8, "trials": 9,
        "signals": 15, "stories": 13,
    }  # fmt: skip
    assert len(SETS["imperfect"].third()) == 40
    # 36 controls with up to 1 %, 12 with 3 %, 72 with an effect.
    shares = [r.share for r in ROWS[:10] if r.ratio == 0.0]
    assert shares == [0.0, 0.003, 0.01, 0.03]
    assert sorted((r.share, r.ratio) for r in ROWS[4:10]) == [
        (s, r) for s in shares[1:] for r in (3.0, 10.0)
    ]
    assert len(TABLES) == 12


@pytest.mark.parametrize("name", ["fan", "heater"])
def test_machine_without_a_cause_is_the_stated_model(name):
    index, machine = _short(name)
    (made,) = make(machine, index, [0])
    assert made.cause is None
    records = to_records(machine, made.records, made.noise)
    model, _ = stated(machine, records[0])
    theta = np.array([[made.parameters[p.name] for p in model.parameters]])
    starts = np.array([[s.start for s in model.states()]])
    for record in records:
        jobs = Jobs(theta=theta, starts=starts)
        y = model.simulate(record, jobs)[0]
        for k, channel in enumerate(model.outputs):
            left = record.outputs[channel] - y[:, k]
            noise = made.noise[channel]
            assert np.std(left) == pytest.approx(noise, rel=0.1)
            assert abs(np.mean(left)) < 0.15 * noise
            assert noise == pytest.approx(NOISE * np.std(y[:, k]), rel=0.7)


@pytest.mark.parametrize("machine", TABLES, ids=lambda t: t.name)
def test_candidates_have_the_accepted_names(machine):
    rng, time = np.random.default_rng(0), machine.step * np.arange(machine.samples)
    columns = dict(machine.drive(rng, time, 0))
    columns |= {"time": time} | {c: np.sin(time) for c in machine.outputs}
    records = to_records(machine, [columns], dict.fromkeys(machine.outputs, 1e-3))
    model, effects = stated(machine, records[0])
    names = {e.name for e in effects}
    assert len(names) == len(effects) >= 20
    for cause in machine.causes:
        assert {*cause.right, *cause.near, *cause.literal} <= names
    assert [p.name for p in model.parameters] == list(machine.parameters)


def test_effect_has_the_wanted_size_and_the_cache_is_the_same(tmp_path):
    index, machine = _short("fan")
    rows = [0, 5]  # the second: a discrepancy of 0.3 %, a bearing with ten times as much
    made = make(machine, index, rows)
    assert made[1].reached["foreign"] == pytest.approx(0.003, rel=0.05)
    assert made[1].reached["effect_left"] == pytest.approx(
        10.0 * made[1].reached["foreign_left"], rel=0.1
    )
    assert made[1].foreign["foreign"] > 0.0
    assert made[1].cause.name == "bearing"
    # The effect of the stored size, and the discrepancy, make the stored record.
    given = {n: made[1].records[0][n][:, None] for n in ("T",)}
    p = {n: np.array([v]) for n, v in made[1].parameters.items()}
    e = {c.name: np.zeros(1) for c in machine.causes}
    e |= {n: np.array([v]) for n, v in made[1].foreign.items()} | {
        "bearing": np.array([made[1].size])
    }
    y = simulate(machine, given, p, e)["speed"][:, 0]
    left = made[1].records[0]["speed"] - y
    assert np.std(left) == pytest.approx(made[1].noise["speed"], rel=0.1)
    save(tmp_path / "fan.npz", made)
    read_back = load(machine, index, tmp_path)
    assert np.array_equal(read_back[1].records[3]["speed"], made[1].records[3]["speed"])


def test_a_new_seed_draws_other_machines():
    index, machine = _short("fan")
    one, other, again = (make(machine, index, [0], seed)[0] for seed in (1, 2, 1))
    assert one.parameters == again.parameters
    assert one.parameters != other.parameters


def test_held_out_records_are_of_the_last_runs():
    index, machine = _short("fan")
    (made,) = make(machine, index, [0])
    roles = [r.role for r in to_records(machine, made.records, made.noise)]
    assert roles == ["fit", "fit", "held_out", "held_out"]


def _engine(source, tmp_path, monkeypatch):
    (tmp_path / "own_engine.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{':'.join(p for p in sys.path if p)}")
    return "own_engine:answer"


def test_case_runs_in_a_process_of_its_own(tmp_path, monkeypatch):
    source = (
        "from blind.marks import Answer\n"
        "def answer(model, effects, records, seconds):\n"
        "    print('noise on the terminal')\n"
        "    return Answer('CALIBRATED', parameters={'k': (2.6, 2.5, float('nan'))})\n"
    )
    engine = _engine(source, tmp_path, monkeypatch)
    truth, answer = run_case(engine, "trials", 3, tmp_path, 20.0)
    assert truth.numbers == {"k": 2.589}
    assert mark(truth, answer) == "right"


@pytest.mark.parametrize(
    ("body", "said"),
    [("while True: pass", "no answer in 1 s"), ("raise ValueError('no')", "ValueError: no")],
)
def test_late_or_failed_answer_is_none(body, said, tmp_path, monkeypatch):
    source = f"def answer(*given):\n    {body}\n"
    engine = _engine(source, tmp_path, monkeypatch)
    truth, answer = run_case(engine, "trials", 3, tmp_path, 1.0)
    assert mark(truth, answer) == "none"
    assert said in answer.said


def test_result_of_the_engine_as_an_answer(monkeypatch):
    cause = SimpleNamespace(cause="creep", parameter=False, magnitude=1.0, low=0.5, high=1.5)
    other = SimpleNamespace(cause="m", parameter=True, magnitude=3.0, low=2.5, high=3.5)
    fitted = SimpleNamespace(name="k", value=2.0, low=1.9, high=2.1, tabulated=1.0)
    result = SimpleNamespace(
        verdict=SimpleNamespace(value="named"), reasons=(), named=(cause,), classes=((other,),),
        parameters=(fitted,), held_out_gain=(0.4, 0.3, 0.5), supported=(), summary=lambda: "found",
        worst=SimpleNamespace(held_out_explained=0.4), findings=(),
    )  # fmt: skip
    engine = SimpleNamespace(Options=lambda seconds: seconds, diagnose=lambda *_, **__: result)
    monkeypatch.setattr(blind.yardstick, "unmodeled", engine)
    answer = blind.yardstick.diagnosed(None, (), (), 120.0)
    assert (answer.verdict, answer.named, answer.classes) == (
        "NAMED",
        ("creep",),
        (("parameter:m",),),
    )
    assert answer.moved == ("k",)
    assert answer.magnitudes == {"creep": (1.0, 0.5, 1.5)}
    assert answer.held_out == (1.0, 0.4)


def test_command_stores_and_compares(tmp_path, monkeypatch, capsys):
    def answered(engine, *_):
        return FRICTION, Answer("NAMED", ("dry friction",) if engine == "feltmb" else ("creep",))

    monkeypatch.setattr(blind.yardstick, "run_case", answered)
    for engine in ("feltmb", "mine:answer", "feltmb"):
        arguments = ["trials", "--engine", engine, "--third", "--results", str(tmp_path)]
        monkeypatch.setattr(sys, "argv", ["yardstick", *arguments])
        blind.yardstick.main()
    lines = (tmp_path / "feltmb.jsonl").read_text().splitlines()
    assert [json.loads(line)["case"] for line in lines] == [0, 3, 6]  # answered once
    capsys.readouterr()
    paths = [str(Path(tmp_path) / f"{n}.jsonl") for n in ("feltmb", "mine.answer")]
    monkeypatch.setattr(sys, "argv", ["yardstick", "--compare", *paths])
    blind.yardstick.main()
    assert "| right or quiet | 3 | 0 | 0.25 |" in capsys.readouterr().out


def test_a_new_seed_has_other_truths_and_they_are_hashed_first(tmp_path, monkeypatch, capsys):
    asked = []

    def answered(_engine, name, case, cache, _limit, further):
        asked.append((name, case, further))
        task = SEALED["small"](7, 1).task(case, cache)
        return task.truth, Answer("UNKNOWN")

    monkeypatch.setattr(blind.yardstick, "run_case", answered)
    arguments = ["small", "--seed", "7", "--count", "1", "--cache", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["yardstick", *arguments, "--results", str(tmp_path)])
    blind.yardstick.main()
    assert asked == [("small", 0, ["--seed", "7", "--count", "1"])]
    sealed = (tmp_path / "small-7" / "truths.json").read_bytes()
    assert hashlib.sha256(sealed).hexdigest() in capsys.readouterr().out
    rows = [json.loads(line) for line in (tmp_path / "feltmb.jsonl").read_text().splitlines()]
    assert [(r["set"], r["case"]) for r in rows] == [("small-7", 0)]
    assert json.loads(sealed) == json.loads(json.dumps(small_machine.draw(7, 1)))
    assert small_machine.draw(8, 1) != json.loads(sealed)[:1]


def test_process_that_somebody_ends_is_no_answer(tmp_path, monkeypatch):
    source = "import os, signal\ndef answer(*given):\n    os.kill(os.getpid(), signal.SIGTERM)\n"
    engine = _engine(source, tmp_path, monkeypatch)
    with pytest.raises(TimeoutError, match="signal 15"):
        run_case(engine, "trials", 3, tmp_path, 5.0)


def test_a_stroke_of_the_small_set_ends_after_the_turn_of_the_hammer():
    from blind.yardstick_sets import AFTER_TURN, _until_after_turn

    time = np.arange(400) * 1e-3
    hammer = np.where(time < 0.05, time, 0.1 - time)
    record = Record(name="blow", time=time, inputs={}, outputs={"hammer": hammer})
    cut = _until_after_turn(record)
    assert cut.name == "blow"
    assert cut.time[-1] == pytest.approx(0.05 + AFTER_TURN, abs=1.1e-3)
    assert _until_after_turn(record.cut(0, 60, name="short")).samples == 60
