"""How often a diagnosis is right: withheld effects of a user's own model."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from feltmb.gap.withholding import Withheld, WithheldCase, _Machine, outcome_of

from feltmb.cli import main
from feltmb.errors import DataError, InvalidParameter
from feltmb.gap import Effect, LinearModel, Options, Parameter, Record, Sensor, Verdict, withhold

OPTIONS = Options(bootstrap=0, restarts=0, max_effects=1, advice=False)


def model():
    return LinearModel(
        name="cart",
        output="force",
        columns={"mass": lambda r: r.inputs["a"], "viscous": lambda r: r.inputs["v"]},
        parameters=[
            Parameter(name="mass", value=2.0, sd=0.1, unit="kg"),
            Parameter(name="viscous", value=3.0, sd=0.5, unit="N s/m"),
        ],
    )


def effects():
    return [
        Effect(name="dry", component="rail", unit="N", scale=2.0, sign=1,
               regressor=lambda r, _shape: np.tanh(r.inputs["v"] / 0.02)),
        Effect(name="spring", component="rail", unit="N/m", scale=5.0,
               regressor=lambda r, _shape: r.inputs["x"]),
    ]  # fmt: skip


def records():
    t = np.linspace(0.0, 3.0, 150)
    out = []
    for i in range(4):
        w = 3.0 + 0.7 * i
        u = 2.3 * w
        x = np.sin(w * t) + 0.3 * np.sin(u * t)
        v = w * np.cos(w * t) + 0.3 * u * np.cos(u * t)
        a = -w * w * np.sin(w * t) - 0.3 * u * u * np.sin(u * t)
        out.append(
            Record(
                name=f"r{i}",
                time=t,
                inputs={"x": x, "v": v, "a": a},
                outputs={"force": np.where(t < 0.05, np.nan, 0.0)},
                sensors={"force": Sensor(name="force", unit="N", sigma=0.05)},
                input_mode="motion",
            )
        )
    return out


def test_each_effect_in_turn_is_named(tmp_path):
    told = []
    found = withhold(
        model(), effects(), records(), cases=4, seed=3, options=OPTIONS, folder=tmp_path / "b",
        progress=lambda *given: told.append(given[:2]),
    )  # fmt: skip
    assert [c.effect for c in found.cases] == ["", "dry", "spring", ""]
    # By chance, the weak friction seems to differ between the three fitted records.
    assert [c.outcome for c in found.cases] == ["right", "unknown", "right", "right"]
    assert found.cases[1].verdict == Verdict.UNKNOWN
    assert found.cases[1].first == "dry"
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert found.share("right")[3] == 2
    assert found.false_alarms[0] == 0.0
    # By hand: what a spring of this size changes, over the noise, where something is measured.
    case = found.cases[2]
    own = [r.inputs["x"][r.time >= 0.05] for r in records()]
    expected = abs(case.magnitude) * np.sqrt(sum(float(x @ x) for x in own)) / 0.05
    assert case.signal_to_noise == pytest.approx(expected, rel=1e-9)


def test_finished_cases_are_kept_and_others_refused(tmp_path):
    given = {"cases": 2, "seed": 3, "options": OPTIONS, "folder": tmp_path}
    first = withhold(model(), effects(), records(), **given)
    kept = (tmp_path / "case_1.json").read_bytes()
    (tmp_path / "case_0.json").write_text("{")  # damaged: done again
    with pytest.warns(RuntimeWarning, match="case_0.json: the result is computed again"):
        again = withhold(model(), effects(), records(), **given)
    assert (tmp_path / "case_1.json").read_bytes() == kept
    assert again.cases[1].outcome == first.cases[1].outcome
    assert again.cases[0].verdict == first.cases[0].verdict
    with pytest.raises(InvalidParameter, match="holds cases of another model"):
        withhold(model(), effects(), records(), **given | {"seed": 4})
    with pytest.raises(InvalidParameter, match="no effect nothing; there are dry, spring"):
        withhold(model(), effects(), records(), only=["nothing"])
    with pytest.raises(InvalidParameter, match="cases = 0"):
        withhold(model(), effects(), records(), cases=0)


@pytest.mark.parametrize(
    ("effect", "verdict", "named", "one_of", "expected"),
    [
        ("", Verdict.NO_GAP, (), (), "right"),
        ("", Verdict.TOO_WEAK, (), (), "right"),
        ("", Verdict.UNKNOWN, (), (), "wrong"),
        ("dry", Verdict.NAMED, ("dry",), (), "right"),
        ("dry", Verdict.NAMED, ("dry", "spring"), (), "wrong"),
        ("dry", Verdict.NAMED_RESIDUAL, ("dry",), (), "residual"),
        ("dry", Verdict.NAMED, ("spring",), (), "wrong"),
        ("dry", Verdict.ONE_OF, (), ("dry", "spring"), "class"),
        ("dry", Verdict.ONE_OF, (), ("spring", "mass"), "wrong"),
        ("dry", Verdict.UNKNOWN, (), (), "unknown"),
        ("dry", Verdict.NO_GAP, (), (), "silent"),
        ("dry", Verdict.DATA_PROBLEM, (), (), "wrong"),
    ],
)
def test_outcomes(effect, verdict, named, one_of, expected):
    report = SimpleNamespace(verdict=verdict, named=named, one_of=one_of)
    assert outcome_of(effect, report) == expected


def test_shares_have_the_intervals_of_wilson():
    case = WithheldCase(
        number=0, effect="dry", magnitude=1.0, unit="N", signal_to_noise=9.0, outcome="right",
        verdict="NAMED", named=("dry",), one_of=(), first="dry", confidence=1.0, seconds=0.0,
    )  # fmt: skip
    value, low, high, count = Withheld(cases=(case,) * 10).share("right")
    assert (value, count) == (1.0, 10)
    # z^2 / (n + z^2) below 1, with z = 1.959964
    assert low == pytest.approx(10.0 / (10.0 + 1.959964**2), abs=1e-6)
    assert high == 1.0


def test_the_command_writes_what_it_prints(tmp_path, capsys, root):
    folder = root / "examples" / "gap"
    data = sorted((folder / "data").glob("emps_*.csv"))
    arguments = ["gap", "blind", str(folder / "emps.py"), *map(str, data)]
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--cases", "1", "-o", str(tmp_path / "b"), "--json"])
    assert not end.value.code
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "b" / "blind.json").read_text())
    assert printed["cases"][0]["outcome"] == "right"
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--effect", "no such"])
    assert end.value.code == 2
    assert "no effect no such" in capsys.readouterr().err


def test_a_case_that_fails_is_told_and_the_others_go_on(tmp_path):
    torn = Effect(name="torn", component="rail", unit="N", scale=1.0, sign=1,
                  regressor=lambda r, _shape: np.full(r.samples, np.nan))  # fmt: skip
    found = withhold(
        model(), [*effects(), torn], records(), cases=4, only=["torn"], options=OPTIONS,
        folder=tmp_path,
    )  # fmt: skip
    assert [c.outcome for c in found.cases][1::2] == ["failed", "failed"]
    assert all(c.confidence is None and c.error for c in found.cases[1::2])
    json.loads((tmp_path / "case_1.json").read_text(), parse_constant=pytest.fail)


def test_cases_of_other_equations_or_edited_ones_are_not_believed(tmp_path):
    given = {"cases": 2, "seed": 3, "options": OPTIONS, "folder": str(tmp_path)}
    first = withhold(model(), effects(), records(), **given)
    path = tmp_path / "case_1.json"
    path.write_text(path.read_text().replace('"unknown"', '"wrong"'))
    with pytest.warns(RuntimeWarning, match="its checksum differs"):
        again = withhold(model(), effects(), records(), **given)
    assert again.cases[1].outcome == first.cases[1].outcome
    stiffer = effects()
    stiffer[1] = Effect(name="spring", component="rail", unit="N/m", scale=5.0,
                        regressor=lambda r, _shape: 1.5 * r.inputs["x"])  # fmt: skip
    with pytest.raises(InvalidParameter, match="holds cases of another model"):
        withhold(model(), stiffer, records(), **given)


def test_planned_records_need_a_noise():
    bare = [dataclasses.replace(r, sensors={}) for r in records()]
    with pytest.raises(DataError, match=r"nothing was measured of force.*expected sigma"):
        withhold(model(), effects(), bare, cases=1)
    with pytest.raises(InvalidParameter, match="no record nope"):
        withhold(model(), effects(), records(), cases=1, hold_out=["nope"])
    with pytest.raises(InvalidParameter, match="two of them have the same name"):
        withhold(model(), effects() * 2, records(), cases=1)


def test_noise_of_simulated_records_is_that_of_the_sensor_with_its_digitizer():
    """Noise of a total sigma contains the rounding error; it is not added once more."""
    time = np.arange(20_000) * 1e-3
    sensor = Sensor(name="force", sigma=1e-3, quantum=1e-2)
    quiet = Record(name="r", time=time, inputs={"u": np.sin(time)}, sensors={"force": sensor},
                   outputs={"force": np.zeros(time.size)})  # fmt: skip
    line = LinearModel(output="force", columns={"k": lambda r: r.inputs["u"]},
                       parameters=[Parameter(name="k", value=0.3, sd=1e-9)])  # fmt: skip
    machine = _Machine.of(line, [quiet])
    shown, _ = machine.records_with(None, 0.0, np.random.default_rng(1))
    sigma = machine.noise.noise("r")["force"].sigma
    assert np.std(shown[0].outputs["force"] - 0.3 * np.sin(time)) == pytest.approx(sigma, rel=0.05)
