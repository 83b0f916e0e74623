"""How often a diagnosis is right: withheld effects of a user's own model."""

import dataclasses
import json

import numpy as np
import pytest

from unmodeled import (
    Effect,
    Equations,
    LinearModel,
    Options,
    Parameter,
    Record,
    Sensor,
    StartPrior,
    State,
    Withheld,
    diagnose,
    withhold,
)
from unmodeled.cli import main
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.search.result import Case

from .conftest import SIGMA, spring_record


@pytest.fixture
def records():
    empty = (spring_record(name, k) for name, k in (("a", 2), ("b", 3), ("c", 5)))
    return [
        dataclasses.replace(r, outputs={"force": np.where(r.time < 0.05, np.nan, 0.0)})
        for r in empty
    ]


def test_each_effect_in_turn_is_named(spring, causes, records):
    told = []
    options = Options(good_enough={"force": 0.01})
    found = withhold(
        spring, causes, records, options=options, cases=5, seed=1,
        progress=lambda *given: told.append(given[:2]),
    )  # fmt: skip
    assert [c.effect for c in found.cases] == ["", "hardening", "preload", "even", ""]
    assert [c.outcome for c in found.cases] == ["quiet", "right", "right", "right", "quiet"]
    assert told == [(1, 5), (2, 5), (3, 5), (4, 5), (5, 5)]
    shares = found.shares()
    assert shares["right"][::3] == (1.0, 3)
    assert shares["false alarm"][::3] == (0.0, 2)
    # One interval of the stiffness in each case, and one of each named effect.
    assert shares["intervals"][3] == 8
    assert shares["intervals"][0] >= 0.75
    # By hand: what a preload of this size changes, over the noise, where something is measured.
    case = found.cases[2]
    seen = sum(int((r.time >= 0.05).sum()) for r in records)
    expected = abs(case.magnitude) * np.sqrt(seen) / SIGMA
    assert case.signal_to_noise == pytest.approx(expected, rel=1e-9)


def test_effects_that_act_alike_are_a_class_and_a_weak_one_is_silent(spring, causes, records):
    hardening, preload, _ = causes
    alike = [dataclasses.replace(preload, name=n, component=n) for n in ("one", "other")]
    weak = dataclasses.replace(hardening, scale=1e-3)
    found = withhold(spring, [*alike, weak], records, cases=4, seed=1)
    assert [c.outcome for c in found.cases] == ["quiet", "class", "class", "silent"]
    assert set(found.cases[1].answer[0]) == {"one", "other"}
    assert found.cases[3].signal_to_noise < 1.0
    assert found.shares()["class"][::3] == (1.0, 2)  # the weak one does not count


def test_an_effect_that_the_diagnosis_takes_for_another_is_wrong(spring, causes, records):
    """The other one acts as the preload does, and is much more probable before the records."""
    preload = causes[1]
    likely = dataclasses.replace(preload, name="likely", weight=1e4)
    found = withhold(spring, [preload, likely], records, only=["preload"], seed=1)
    assert [c.outcome for c in found.cases] == ["quiet", "wrong"]
    assert found.cases[1].answer == (("likely",),)


def test_a_case_that_fails_is_told_and_the_others_go_on(spring, causes, records):
    torn = Effect(name="torn", component="spring", unit="N", scale=1.0, sign=1,
                  regressor=lambda r, _shape: np.full(r.samples, np.nan))  # fmt: skip
    found = withhold(spring, [*causes, torn], records, cases=2, only=["torn"])
    assert [c.outcome for c in found.cases] == ["quiet", "none"]
    assert "no number for force" in found.cases[1].error


def test_an_interrupted_run_has_the_finished_cases(spring, causes, records):
    """The diagnosis answers Ctrl-C with its fits so far; the case does not count."""
    calls, limit = [], 1

    def even(record, _shape):
        calls.append(bool(np.nanmax(record.outputs["force"])))  # of the simulated machine
        if calls.count(True) >= limit:
            raise KeyboardInterrupt
        return record.inputs["x"] ** 2

    slow = (*causes[:2], dataclasses.replace(causes[2], regressor=even))
    with pytest.raises(KeyboardInterrupt):
        withhold(spring, slow, records, cases=30)

    def stop(done, _total, _case):
        nonlocal limit
        limit = 1 if done == 2 else limit

    calls, limit = [], 10_000
    found = withhold(spring, slow, records, cases=30, progress=stop)
    assert [c.number for c in found.cases] == [0, 1]


def test_wrong_arguments_are_told_before_the_first_case(spring, causes, records):
    bare = [dataclasses.replace(r, sensors={}) for r in records]
    with pytest.raises(DataError, match=r"force: never changes.*expected sigma"):
        withhold(spring, causes, bare, cases=1)
    with pytest.raises(InvalidParameter, match="no record nope"):
        withhold(spring, causes, records, cases=1, hold_out=["nope"])
    with pytest.raises(InvalidParameter, match="effect preload: is listed twice"):
        withhold(spring, [*causes, causes[1]], records, cases=1)
    with pytest.raises(InvalidParameter, match="no effect nothing; there are hardening, preload"):
        withhold(spring, causes, records, only=["nothing"])
    with pytest.raises(InvalidParameter, match="cases = 0"):
        withhold(spring, causes, records, cases=0)


def decay(start):
    time = np.linspace(0.0, 2.0, 100)
    x = 3.0 * np.exp(-0.8 * time) + np.random.default_rng(0).normal(0.0, 0.01, time.size)
    return Record(name="r", time=time, inputs={}, outputs={"x": x}, start=start,
                  sensors={"x": Sensor(name="x", unit="K", sigma=0.01)})  # fmt: skip


@pytest.mark.parametrize("start", [None, StartPrior(known=False)])
def test_a_machine_starts_where_the_measured_one_does(start):
    """Unknown start states, and parameters without a prior, are fitted to the records first."""
    model = Equations(
        name="decay", states=[State(name="x", unit="K")], outputs={"x": "x"}, inputs=[],
        parameters=[Parameter(name="a", value=0.5, unit="1/s")],
        rates=lambda t, x, u, p: (-p.a * x.x,),
    )  # fmt: skip
    seen = []
    heat = Effect(name="heat", component="wall", unit="K/s", scale=1.0,
                  rate=lambda t, x, u, p, size, shape: {"x": size + 0.0 * x.x})  # fmt: skip
    found = withhold(model, [heat], [decay(start)], cases=2, progress=lambda *c: seen.append(c[2]))
    assert [c.outcome for c in found.cases] == ["quiet", "right"]
    # The interval of the rate covers 0.8 1/s, not 0.5 1/s.
    assert found.cases[0].covered == found.cases[0].intervals == 1


def test_noise_of_simulated_records_is_that_of_the_sensor_with_its_digitizer(monkeypatch):
    """Noise of a total sigma contains the rounding error; it is not added once more."""
    time, shown = np.arange(20_000) * 1e-3, []

    def watched(model, effects, records, **given):
        shown.extend(records)
        return diagnose(model, effects, records, **given)

    monkeypatch.setattr("unmodeled.blind.diagnose", watched)
    sensor = Sensor(name="force", unit="N", sigma=4e-3, quantum=1e-2)
    quiet = Record(name="r", time=time, inputs={"u": np.sin(time)}, sensors={"force": sensor},
                   outputs={"force": 0.0 * time})  # fmt: skip
    line = LinearModel(output="force", columns={"k": lambda r: r.inputs["u"]},
                       parameters=[Parameter(name="k", value=0.3, sd=1e-9)])  # fmt: skip
    withhold(line, [], [quiet], cases=1)
    noise = shown[0].outputs["force"] - 0.3 * np.sin(time)
    assert np.std(noise) == pytest.approx(np.hypot(4e-3, 1e-2 / np.sqrt(12.0)), rel=0.02)


def test_shares_have_the_intervals_of_wilson():
    case = Case(0, "dry", 1.0, "N", 9.0, "right")
    value, low, high, count = Withheld((case,) * 10).shares()["right"]
    assert (value, count) == (1.0, 10)
    # z^2 / (n + z^2) below 1, with z = 1.959964
    assert low == pytest.approx(10.0 / (10.0 + 1.959964**2), abs=1e-6)
    assert high == 1.0


def test_the_command_writes_what_it_prints(tmp_path, capsys, root):
    folder = root / "unmodeled" / "examples"
    data = sorted((folder / "data").glob("emps_*.csv"))
    arguments = ["blind", str(folder / "emps.py"), *map(str, data)]
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--only", "dry friction", "-o", str(tmp_path / "b"), "--json"])
    assert not end.value.code
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "b" / "blind.json").read_text())
    assert printed["cases"][1]["outcome"] == "right"
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--only", "no such"])
    assert end.value.code == 2
    assert "no effect no such" in capsys.readouterr().err
