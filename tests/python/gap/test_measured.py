"""Measured magnitudes of effects: the test of a part decides what no record can."""

import importlib.util
import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap.sessions import _same_session

import feltmb
from feltmb.adapters import mechanism_model
from feltmb.cli import main
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit import Including, including
from feltmb.fit.linear import LinearModel
from feltmb.gap import (
    Effect,
    InputLimits,
    Limits,
    Measured,
    Options,
    Parameter,
    Record,
    Sensor,
    Verdict,
    diagnose,
    library,
    read_measured,
    with_measured,
)

_spec = importlib.util.spec_from_file_location("models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)

DRY, CUBIC, NOMINAL = models.DRY, models.CUBIC, models.NOMINAL
OTHER = replace(DRY, name="friction of the seal", component="seal")
OPTIONS = Options(bootstrap=0, advice=False)


def test_a_measured_effect_is_a_parameter_with_this_prior():
    tests = [Measured(parameter=DRY.name, value=v, sd=1e-3) for v in (5e-3, 7e-3)]
    tests.append(Measured(parameter="m", value=1.05, sd=0.01))
    model = with_measured(NOMINAL, tests, [DRY, CUBIC])
    assert isinstance(model, Including)
    found = {p.name: p for p in model.parameters}
    assert found[DRY.name].value == pytest.approx(6e-3)
    assert found[DRY.name].sd == pytest.approx(1e-3 / np.sqrt(2.0))
    assert found[DRY.name].unit == "N"
    assert (found["m"].value, found["m"].sd) == (1.05, 0.01)
    assert CUBIC.name not in found
    assert with_measured(NOMINAL, [], [DRY]) is NOMINAL


def test_the_fit_weighs_the_test_against_the_records():
    """Closed form: least squares with one row for the test."""
    x = np.linspace(-1.0, 1.0, 41)
    y = 1.2 * x + 0.3 * x**3
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.2)],
        name="line",
    )
    cubic = Effect(name="cubic", component="spring", scale=0.1, regressor=lambda _r, _s: x**3)
    data = Record(
        name="run",
        time=np.arange(x.size) * 0.01,
        inputs={"x": x},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=0.1)},
    )
    known = with_measured(model, [Measured(parameter="cubic", value=0.1, sd=0.05)], [cubic])
    fit = fit_problem(
        Problem(known, (segment_record(known, data, {"y": Noise(0.1)}, None),)),
        FitSettings(decrement=1e-10),
    )
    rows = np.vstack([np.stack([x, x**3], axis=1) / 0.1, np.diag([1.0 / 0.2, 1.0 / 0.05])])
    right = np.concatenate([y / 0.1, [1.0 / 0.2, 0.1 / 0.05]])
    assert fit.point.theta == pytest.approx(np.linalg.lstsq(rows, right)[0], rel=1e-6)
    sds = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    assert [i.sd for i in fit.intervals()] == pytest.approx(sds, rel=1e-6)


@pytest.fixture(scope="module")
def data():
    return models.records(1, dry=6e-3)


def test_the_test_of_one_part_names_the_other(data):
    effects = (DRY, OTHER, CUBIC)
    report = diagnose(NOMINAL, effects, data, options=OPTIONS)
    assert report.verdict is Verdict.ONE_OF
    assert set(report.one_of) == {DRY.name, OTHER.name}
    clean = with_measured(
        NOMINAL, [Measured(parameter=OTHER.name, value=1e-4, sd=2e-4, how="torque")], effects
    )
    report = diagnose(clean, effects, data, options=OPTIONS)
    assert report.verdict is Verdict.NAMED
    assert report.named == (DRY.name,)
    assert report.which[DRY.name].low < 6e-3 < report.which[DRY.name].high
    assert [(n.name, n.why) for n in report.not_tested] == [
        (OTHER.name, "it is a parameter of the model")
    ]


def test_the_test_of_the_cause_leaves_nothing_to_explain(data):
    effects = (DRY, OTHER, CUBIC)
    known = with_measured(NOMINAL, [Measured(parameter=DRY.name, value=6.2e-3, sd=3e-4)], effects)
    report = diagnose(known, effects, data, options=OPTIONS)
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    fitted = {i.name: i for i in report.fit.intervals()}[DRY.name]
    assert fitted.low < 6e-3 < fitted.high
    (one,) = report.given
    assert (one.name, one.given, one.given_sd, one.differs) == (DRY.name, 6.2e-3, 3e-4, True)
    assert (one.tabulated, one.tolerance) == (0.0, np.inf)
    assert (one.low, one.high) == (fitted.low, fitted.high)
    assert one.text in report.statement
    assert "(95 %, test 0.0062 ± 0.00059 N)" in one.text


def test_files_have_effects_in_their_units(tmp_path):
    path = tmp_path / "measured.toml"
    path.write_text(
        '[measured."dry friction"]\nvalue = "6 mN"\nsd = "0.5 mN"\nhow = "spring balance"\n'
        "[measured.m]\nvalue = 1.02\nsd = 0.01\n"
    )
    dry, mass = read_measured(path, NOMINAL, models.EFFECTS)
    assert dry == Measured(parameter="dry friction", value=6e-3, sd=5e-4, how="spring balance")
    assert mass.parameter == "m"
    with pytest.raises(DataError, match=r"measured\.dry friction: no parameter of oscillator"):
        read_measured(path, NOMINAL)
    path.write_text('[measured."dry frictoin"]\nvalue = "6 mN"\nsd = "0.5 mN"\n')
    with pytest.raises(
        DataError, match="no parameter or tested effect of oscillator; near are dry fric"
    ):
        read_measured(path, NOMINAL, models.EFFECTS)


def test_an_effect_with_the_name_of_a_parameter_means_the_parameter(tmp_path):
    alias = replace(CUBIC, name="k", unit="1")
    path = tmp_path / "measured.toml"
    path.write_text('[measured.k]\nvalue = "98 N/m"\nsd = "1 N/m"\n')
    tests = read_measured(path, NOMINAL, [alias])
    model = with_measured(NOMINAL, tests, [alias])
    assert not isinstance(model, Including)
    assert {p.name: p.value for p in model.parameters}["k"] == 98.0


def test_faults_of_measured_effects_are_told_together():
    gain = library.sensor_gain(["q"], "q")
    tests = [
        Measured(parameter=gain.name, value=0.0, sd=0.01),
        Measured(parameter=DRY.name, value=-1.0, sd=0.1),
        Measured(parameter="rust", value=0.0, sd=0.01),
    ]
    with pytest.raises(InvalidParameter) as caught:
        with_measured(NOMINAL, tests, [DRY, CUBIC, gain])
    text = str(caught.value)
    assert f"{gain.name}: an effect of the records and not of the machine" in text
    assert "dry friction: got -1 N, expected a value in [0, inf]" in text
    assert "rust: no parameter or tested effect of oscillator; there are m, k, d" in text


def test_tests_of_a_model_that_includes_effects_are_kept(data):
    """``ready`` builds such a model anew: it lost the tests."""
    tests = [
        Measured(parameter="m", value=1.2, sd=1e-3),
        Measured(parameter=CUBIC.name, value=50.0, sd=2.0),
    ]
    model = with_measured(including(NOMINAL, [CUBIC]), tests, [DRY])
    for one in (model, model.ready(data).model):
        found = {p.name: (p.value, p.sd) for p in one.parameters}
        assert found["m"] == (1.2, 1e-3)
        assert found[CUBIC.name] == (50.0, 2.0)
        assert found["k"] == (100.0, 10.0)


def test_a_measured_parameter_is_compared_with_its_table():
    """The fit cannot tell that a spring is wrong once its rate was measured: the report does."""
    for tabulated, tolerance, told in ((96.0, 5.0, False), (70.0, 5.0, True), (95.0, 0.0, True)):
        table = {p.name: p for p in NOMINAL.parameters}
        table["k"] = replace(table["k"], value=tabulated, sd=tolerance)
        model = NOMINAL.with_parameters(table)
        test = Measured(parameter="k", value=96.3, sd=0.3)
        report = diagnose(
            with_measured(model, [test]), (CUBIC,), models.records(1), options=OPTIONS
        )
        (one,) = report.given
        assert (one.name, one.tabulated, one.tolerance) == ("k", tabulated, tolerance)
        assert one.low < 96.0 < one.high
        assert one.differs is told
        assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
        wide = f" ± {1.96 * tolerance:g}" if tolerance else ""
        both = f"(95 %, table {tabulated:g}{wide} N/m, test 96.3 ± 0.59 N/m)"
        assert (f"The model has {one.text}. Nothing else is missing" in report.statement) is told
        assert both in one.text
        for row in report.calibrated:
            assert ("than measured" in row.text) is (row.name == "k")


def test_a_test_that_the_records_contradict_is_reported():
    test = Measured(parameter="k", value=100.0, sd=0.5)
    report = diagnose(with_measured(NOMINAL, [test]), (CUBIC,), models.records(1), options=OPTIONS)
    (one,) = report.given
    assert (one.given, one.given_sd, one.refuted) == (100.0, 0.5, True)
    assert "test 100 ± 0.98 N/m" in one.text
    assert one.remark == "; the records contradict the test, which is not used"
    assert any("refute the test of k" in w for w in report.checks.warnings)


def test_the_test_of_a_number_excludes_the_effects_that_change_it():
    """The spring is as tabulated: what acts like a stiffer spring is another part."""
    stiffer = Effect(
        name="stiffer spring", component="spring", unit="N/m", scale=20.0,
        tolerance_parameter="k",
        rate=lambda t, x, u, p, size, shape: {"v": -size * x.q / p.m},
    )  # fmt: skip
    other = replace(stiffer, name="other spring", component="guide", tolerance_parameter="")
    table = {p.name: p for p in NOMINAL.parameters}
    table["k"] = replace(table["k"], value=60.0, sd=2.0)
    model, runs = NOMINAL.with_parameters(table), models.records(1)
    report = diagnose(model, (stiffer, other), runs, options=OPTIONS)
    assert report.named != (other.name,)
    known = with_measured(model, [Measured(parameter="k", value=60.0, sd=2.0)])
    report = diagnose(known, (stiffer, other), runs, options=OPTIONS)
    assert report.named == (other.name,)
    assert [(n.name, n.why) for n in report.not_tested] == [
        (stiffer.name, "the test of k measured the number that it changes")
    ]


def test_effects_of_both_options_are_reported(data):
    """--include and --measured: one model that includes effects is based on the other."""
    both = (DRY, CUBIC)
    tests = [Measured(parameter=CUBIC.name, value=0.0, sd=100.0)]
    inner = including(NOMINAL, [DRY])
    report = diagnose(with_measured(inner, tests, both), both, data, options=OPTIONS)
    assert [(g.name, g.differs) for g in report.given] == [(DRY.name, True), (CUBIC.name, False)]
    assert DRY.name in report.statement
    assert report.given[1].remark == "; not distinguishable from zero"
    tests.append(Measured(parameter=DRY.name, value=6.2e-3, sd=3e-4))
    report = diagnose(with_measured(inner, tests, both), both, data, options=OPTIONS)
    dry = report.given[0]
    assert (dry.name, dry.tabulated, dry.differs, dry.given) == (DRY.name, 0.0, True, 6.2e-3)
    assert "table" not in dry.text


def test_faults_of_names_are_told_with_the_file(tmp_path):
    shift = Effect(name="shift", component="camera", scale=1.0, observe=lambda _t, y, *_: y)
    path = tmp_path / "m.toml"
    path.write_text("[measured.shift]\nvalue = 1\nsd = 1\n[measured.rust]\nvalue = 1\nsd = 1\n")
    with pytest.raises(DataError, match=r"m\.toml: 2 faults") as failure:
        read_measured(path, NOMINAL, [shift])
    assert "measured.shift: an effect of the records" in str(failure.value)


def test_the_example_machine_measures_its_parts():
    path = Path(__file__).parents[3] / "examples" / "gap" / "simulated_machine.py"
    spec = importlib.util.spec_from_file_location("machine", path)
    machine = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(machine)
    assert machine.true_value("felt.04") == pytest.approx(0.05)
    assert machine.true_value("capstan_height") == pytest.approx(1e-4)
    assert machine.true_value("felt.05") == 0.0
    assert machine.true_value("string_distance") == 0.0
    # The friction of the butt is 0.0025 N m in the table, 0.0065 N m in the machine.
    assert machine.true_value("joint_friction.butt") == pytest.approx(1.6)


def test_limits_of_a_model_that_includes_effects_are_kept(data):
    model = including(NOMINAL, [CUBIC])
    held = {p.name: replace(p, lower=0.5 * p.value, upper=100.0) for p in model.parameters}
    for one in (model.with_parameters(held), model.with_parameters(held).ready(data).model):
        limits = {p.name: (p.lower, p.upper) for p in one.parameters if p.name in held}
        assert limits == {n: (p.lower, p.upper) for n, p in held.items()}
    with pytest.raises(InvalidParameter, match="rust: no parameter of"):
        model.with_parameters({"rust": model.parameters[0]})


def test_an_effect_that_changes_the_number_of_a_parameter_is_refused():
    alias = replace(CUBIC, name="stiffer spring", tolerance_parameter="k")
    test = Measured(parameter="stiffer spring", value=0.0, sd=1.0)
    with pytest.raises(InvalidParameter, match="the same number as k: give that parameter"):
        with_measured(NOMINAL, [test], [alias])


def test_a_plan_of_the_action_with_a_measured_effect_has_its_own_store():
    """The key of the stored experiments did not contain the options of such a model."""
    keys = set()
    for variation in (0.01, 0.1):
        model, effects = mechanism_model(
            feltmb.load_action("steinway45"), variation=variation, channels=["key", "hammer_tip"]
        )
        keys.add(model.identity())
        for value in (0.0, 1e-4):
            test = Measured(parameter="felt_thickness.06", value=value, sd=5e-5)
            keys.add(with_measured(model, [test], effects).identity())
    assert len(keys) == 4  # the value is part of the key by the parameters


def test_a_session_with_other_tests_is_another_session(tmp_path):
    limits = Limits(inputs={"f": InputLimits(least=-1.0, most=1.0, rate=100.0)}, duration=1.0)
    tests = [Measured(parameter=OTHER.name, value=1e-4, sd=2e-4)]
    effects = (DRY, OTHER)
    plain = (NOMINAL, effects, limits, [], 0)
    _same_session(tmp_path, *plain)
    _same_session(tmp_path, *plain)
    with pytest.raises(InvalidParameter, match="holds another session"):
        _same_session(tmp_path, with_measured(NOMINAL, tests, effects), *plain[1:])


def test_faults_of_priors_of_included_effects():
    with pytest.raises(InvalidParameter, match="2 standard deviations for 1 effects"):
        including(NOMINAL, [DRY], [0.0], [1.0, 2.0])
    with pytest.raises(InvalidParameter, match="a standard deviation of 0, expected > 0"):
        including(NOMINAL, [DRY], [0.0], [0.0])
    with pytest.raises(InvalidParameter, match=r"dry friction = -1, expected a value in \[0, inf"):
        including(NOMINAL, [DRY], [-1.0])


def test_command_line(tmp_path, capsys):
    """The effect is no candidate any more, and a typing error is told with similar names."""
    folder = Path(__file__).parents[3] / "examples" / "gap"
    data = [str(p) for p in sorted((folder / "data").glob("emps_*.csv"))]
    tests = tmp_path / "tests.toml"
    tests.write_text('[measured."dry friction"]\nvalue = "20 N"\nsd = "5 N"\n')
    command = ["gap", "diagnose", str(folder / "emps.py"), *data, "--measured", str(tests)]
    with pytest.raises(SystemExit) as stop:
        main([*command, "--bootstrap", "0", "-o", str(tmp_path / "report")])
    assert stop.value.code == 0
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert "dry friction" not in [e["effect"] for e in report["which"]["effects"]]
    assert "dry friction" in [p["name"] for p in report["fit"]["intervals"]]
    assert [(n["name"], n["why"]) for n in report["not_tested"]] == [
        ("dry friction", "it is a parameter of the model, with the shape 0.0006")
    ]
    tests.write_text('[measured."dry frictoin"]\nvalue = "20 N"\nsd = "5 N"\n')
    with pytest.raises(SystemExit) as stop:
        main(command)
    assert stop.value.code == 2
    assert "near are dry friction" in capsys.readouterr().err


def test_records_tell_nothing_of_an_effect_that_they_do_not_show():
    """Neither a prior nor the records: the interval is infinite, without a warning of numpy."""
    silent = replace(CUBIC, name="silent", rate=lambda t, x, u, p, size, shape: {"v": 0.0 * x.q})
    model = including(NOMINAL, [silent])
    run = models.record("soft", 0.5, 3)
    fit = fit_problem(
        Problem(model, (segment_record(model, run, {"q": Noise(1e-4)}, 0.2),)),
        FitSettings(iterations=3),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = {i.name: i for i in fit.intervals()}["silent"]
    assert found.sd == np.inf
    assert found.contraction == 0.0
