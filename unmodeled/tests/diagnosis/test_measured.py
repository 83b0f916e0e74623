"""Measured magnitudes of effects: the test of a part decides what no record can."""

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import (
    Effect,
    LinearModel,
    Measured,
    Parameter,
    Record,
    Sensor,
    Verdict,
    diagnose,
    fit_model,
    library,
    read_measured,
    with_measured,
)
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit import Including, including

from . import models

DRY, CUBIC, NOMINAL = models.DRY, models.CUBIC, models.NOMINAL
OTHER = replace(DRY, name="friction of the seal", component="seal")


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
    x = np.linspace(-1.0, 1.0, 81)
    y = 1.1 * x + 0.15 * x**3 + 0.1 * np.random.default_rng(4).standard_normal(x.size)
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
    found = fit_model(known, [data]).parameters
    rows = np.vstack([np.stack([x, x**3], axis=1) / 0.1, np.diag([1.0 / 0.2, 1.0 / 0.05])])
    right = np.concatenate([y / 0.1, [1.0 / 0.2, 0.1 / 0.05]])
    exact = np.linalg.lstsq(rows, right)[0]
    sds = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    assert np.all(np.abs([p.value for p in found] - exact) < 0.05 * sds)
    assert [0.5 * (p.high - p.low) / 1.96 for p in found] == pytest.approx(sds, rel=0.2)


@pytest.fixture(scope="module")
def data():
    return models.records(1, dry=6e-3)


def test_the_test_of_one_part_names_the_other(data):
    effects = (DRY, OTHER, CUBIC)
    report = diagnose(NOMINAL, effects, data)
    (group,) = report.small  # the damping takes up nearly all of it
    assert {n.cause for n in group} == {DRY.name, OTHER.name}
    clean = with_measured(
        NOMINAL, [Measured(parameter=OTHER.name, value=1e-4, sd=2e-4, how="torque")], effects
    )
    report = diagnose(clean, (DRY, CUBIC), data)
    ((named,),) = report.small
    assert named.cause == DRY.name
    assert named.low < 6e-3 < named.high


def test_the_test_of_the_cause_leaves_nothing_to_explain(data):
    effects = (DRY, OTHER, CUBIC)
    known = with_measured(NOMINAL, [Measured(parameter=DRY.name, value=6.2e-3, sd=3e-4)], effects)
    report = diagnose(known, (OTHER, CUBIC), data)
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    fitted = {p.name: p for p in report.parameters}[DRY.name]
    assert fitted.low < 6e-3 < fitted.high


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
    gain = library.sensor_fault(["q"], "q", "gain")
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


def test_a_test_that_the_records_contradict_is_told():
    test = Measured(parameter="k", value=100.0, sd=0.5)
    report = diagnose(with_measured(NOMINAL, [test]), (CUBIC,), models.records(1))
    change = next(c for c in report.changes if c.name == "k")
    assert change.within is False
    assert change.low < 96.0 - 100.0 < change.high


def test_faults_of_names_are_told_with_the_file(tmp_path):
    shift = Effect(name="shift", component="camera", scale=1.0, observe=lambda _t, y, *_: y)
    path = tmp_path / "m.toml"
    path.write_text("[measured.shift]\nvalue = 1\nsd = 1\n[measured.rust]\nvalue = 1\nsd = 1\n")
    with pytest.raises(DataError, match=r"m\.toml: 2 faults") as failure:
        read_measured(path, NOMINAL, [shift])
    assert "measured.shift: an effect of the records" in str(failure.value)


def test_an_effect_that_changes_the_number_of_a_parameter_is_refused():
    alias = replace(CUBIC, name="stiffer spring", tolerance_parameter="k")
    test = Measured(parameter="stiffer spring", value=0.0, sd=1.0)
    with pytest.raises(InvalidParameter, match="the same number as k: give that parameter"):
        with_measured(NOMINAL, [test], [alias])


def test_records_show_nothing_of_an_effect_that_does_not_act():
    """Neither a prior nor the records: the interval is large, without a warning of numpy."""
    silent = replace(CUBIC, name="silent", rate=lambda t, x, u, p, size, shape: {"v": 0.0 * x.q})
    model = including(NOMINAL, [silent])
    report = fit_model(model, [models.record("soft", 0.5, 3, samples=200)])
    found = {p.name: p for p in report.parameters}["silent"]
    assert found.high - found.low > silent.scale
