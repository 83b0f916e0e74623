"""Noise in proportion to the value: weights in a fit, a diagnosis, and records that ask for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import fit_problem
from feltmb.gap.checks import check_records
from feltmb.gap.discrepancy import larger_than_noise, with_factor
from feltmb.gap.further_sensors import Sensors
from feltmb.gap.information import information
from feltmb.gap.uncorrelated import _of, uncorrelated

from feltmb.data import read_record, read_records, write_record
from feltmb.errors import DataError
from feltmb.fit.limits import FurtherSensor
from feltmb.fit.linear import LinearModel
from feltmb.fit.noise import Noise
from feltmb.gap import (
    Candidate,
    Effect,
    Jobs,
    OdeModel,
    Parameter,
    Record,
    Sensor,
    State,
    Verdict,
    check,
    diagnose,
    fit_model,
)

ROOT = Path(__file__).parents[3]
SIGMA, RELATIVE, COUNT = 2e-3, 0.04, 300
TANK = OdeModel(
    name="tank",
    states=[
        State(name="a", unit="mol/l", scale=1.0, start_sd=0.0),
        State(name="b", unit="mol/l", scale=1.0, start_sd=0.0),
    ],
    parameters=[
        Parameter(name="k1", value=0.05, sd=0.01, unit="1/s", lower=1e-4),
        Parameter(name="k2", value=0.02, sd=0.004, unit="1/s", lower=1e-4),
    ],
    inputs=["feed"],
    rates=lambda t, x, u, p: (u.feed - p.k1 * x.a, p.k1 * x.a - p.k2 * x.b),
    outputs={"a": "a", "b": "b"},
)
TRUTH = np.array([0.053, 0.0192])
SECOND_ORDER = Effect(
    name="second order",
    component="tank",
    unit="l/(mol s)",
    scale=0.01,
    rate=lambda t, x, u, p, size, shape: {"a": -size * x.a**2, "b": size * x.a**2},
)


def record(name, seed, *, amount=1.0, key=True, relative=RELATIVE, second=0.0, role="fit"):
    generator = np.random.default_rng(seed)
    time = np.linspace(0.0, 300.0, COUNT)
    feed = amount * np.where((time > 5.0) & (time < generator.uniform(25.0, 65.0)), 0.05, 0.0)
    nothing = Record(
        name=name, time=time, inputs={"feed": feed}, outputs={"a": 0.0 * time, "b": 0.0 * time}
    )
    jobs = Jobs(
        theta=TRUTH[None, :],
        segments=np.array([[0, COUNT - 1]]),
        starts=np.zeros((1, 2)),
        included=(Candidate(SECOND_ORDER),),
        magnitudes=np.array([[second]]),
    )
    clean = TANK.simulate(nothing, jobs).outputs[0]
    noisy = clean + np.hypot(SIGMA, relative * clean) * generator.standard_normal(clean.shape)
    stated = RELATIVE if key else 0.0
    sensors = {
        n: Sensor(name=n, unit="mol/l", sigma=SIGMA, relative_sigma=stated) for n in ("a", "b")
    }
    return replace(
        nothing, outputs={"a": noisy[:, 0], "b": noisy[:, 1]}, sensors=sensors, role=role
    )


def records(seed, **what):
    return [
        record("one", 3 * seed, **what),
        record("two", 3 * seed + 1, amount=2.0, **what),
        record("three", 3 * seed + 2, amount=0.6, role="held_out", **what),
    ]


# ---------------------------------------------------------------- noise of a sample


def test_the_standard_deviation_follows_the_value_and_not_its_noise():
    time = np.linspace(0.0, 1.0, 2000)
    value = 1.0 + 4.0 * time**2
    noise = Noise(0.01, relative=0.1)
    seen = value + noise.draw(time, np.random.default_rng(1), value)
    assert (seen - value).std() == pytest.approx(np.sqrt(np.mean(noise.sd(value) ** 2)), rel=0.05)
    error = noise.sd_of_measured(time, seen) / noise.sd(value) - 1.0
    assert error.std() < 0.08
    away = (seen - value) / noise.sd(value)
    assert abs(np.corrcoef(error, away)[0, 1]) < 0.06  # of the measured value itself: 1


def test_where_neighbors_disagree_the_noise_is_not_too_small():
    noise = Noise(0.01, relative=0.1)
    time = np.arange(40.0)
    step = np.where(time < 20.0, 0.0, 5.0)
    found = noise.sd_of_measured(time, step)
    assert np.all(found > 0.75 * noise.sd(step))
    assert found[:16] == pytest.approx(noise.sd(step)[:16])
    assert found[24:] == pytest.approx(noise.sd(step)[24:])
    alternating = np.where(time % 2 == 0, 0.0, 5.0)
    assert np.all(noise.sd_of_measured(time, alternating) >= 0.999 * noise.sd(alternating))


def test_few_and_missing_samples():
    noise = Noise(0.01, relative=0.1)
    time = np.arange(4.0)
    few = np.array([1.0, 7.0, np.nan, 3.0])
    assert noise.sd_of_measured(time, few)[[0, 1, 3]] == pytest.approx(noise.sd(few[[0, 1, 3]]))
    assert noise.sd_of_measured(time, np.full(4, np.nan)) == pytest.approx(0.01)


@pytest.mark.parametrize(
    "color",
    [{}, {"correlation_time": 3.0}, {"correlation_time": 30.0, "white": 0.4}, {"averaged": 3}],
)
def test_whitening_is_that_of_the_whole_covariance(color):
    time = np.arange(16.0)
    values = np.linspace(0.0, 3.0, 16) ** 2
    values[5] = np.nan
    noise = Noise(0.02, relative=0.1, **color)
    own = Record(name="r", time=time, inputs={}, outputs={"y": values})
    model = LinearModel(output="y", columns={"c": lambda r: r.time}, parameters=[
        Parameter(name="c", value=0.0, sd=1.0)])  # fmt: skip
    segmented = segment_record(model, own, {"y": noise}, None, np.array([[0, 15]]))
    rest = np.random.default_rng(2).standard_normal((1, 16, 1))
    seen = np.isfinite(values)
    apart = np.subtract.outer(time[seen], time[seen])
    if noise.averaged > 1 or noise.mixed:
        correlation = noise.correlation(apart, 1.0)
    elif noise.correlation_time:
        correlation = np.exp(-np.abs(apart) / noise.correlation_time)
    else:
        correlation = np.eye(seen.sum())
    sd = segmented.sd[seen, 0]
    r = rest[0, seen, 0]
    expected = r @ np.linalg.solve(sd[:, None] * correlation * sd, r)
    # The prediction of averaged noise reaches back over a few samples only.
    rel = 0.05 if noise.averaged > 1 else 1e-6
    assert np.sum(segmented.whiten(rest) ** 2) == pytest.approx(expected, rel=rel)


# ---------------------------------------------------------------- fit


def _line(seed, count=400, relative=0.2):
    generator = np.random.default_rng(seed)
    time = np.linspace(0.0, 10.0, count)
    true = 2.0 + 3.0 * time
    sd = np.hypot(0.05, relative * true)
    y = true + sd * generator.standard_normal(count)
    sensor = Sensor(name="y", sigma=0.05, relative_sigma=relative)
    own = Record(name="r", time=time, inputs={}, outputs={"y": y}, sensors={"y": sensor})
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.time, "start": lambda r: np.ones(r.samples)},
        parameters=[
            Parameter(name="slope", value=0.0, sd=np.inf),
            Parameter(name="start", value=0.0, sd=np.inf),
        ],
    )
    return model, own, sd


def test_a_linear_fit_is_the_weighted_least_squares():
    model, own, true_sd = _line(1, relative=0.1)
    noise = {"y": Noise(0.05, relative=0.1)}
    segmented = segment_record(model, own, noise, None)
    fit = fit_problem(Problem(model, (segmented,)))
    table = np.column_stack([own.time, np.ones(own.samples)])

    def least_squares(sd):
        weighted = table / sd[:, None]
        covariance = np.linalg.inv(weighted.T @ weighted)
        return covariance @ (weighted.T @ (own.outputs["y"] / sd)), covariance

    value, covariance = least_squares(segmented.sd[:, 0])
    assert fit.point.theta == pytest.approx(value, rel=1e-6)
    assert fit.covariance == pytest.approx(covariance, rel=1e-5)
    # With the true standard deviations, which nobody knows, the result is the same within a share
    # of its own error.
    value, covariance = least_squares(true_sd)
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(fit.point.theta - value) < 0.5 * sd)
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(sd, rel=0.05)


def test_the_weights_do_not_favor_samples_that_are_too_small():
    """Weights from the measured values would give -2 relative_sigma^2, seven standard errors."""
    far = []
    for seed in range(20):
        model, own, _ = _line(seed)
        fit = fit_model(model, [own])
        far.append((fit.point.theta[0] - 3.0) / np.sqrt(fit.covariance[0, 0]))
    assert abs(np.mean(far)) < 3.0 / np.sqrt(20)
    assert 0.6 < np.std(far) < 1.4


def test_one_factor_of_the_noise_scales_both_parts():
    model, own, _ = _line(1)
    segmented = segment_record(model, own, {"y": Noise(0.05, relative=0.2)}, None)
    larger = with_factor(model, segmented, {"y": 3.0})
    assert larger.sd == pytest.approx(3.0 * segmented.sd, rel=0.02)
    assert larger.noise[0] == Noise(0.05 * 3.0, relative=0.2 * 3.0)


def test_intervals_of_the_tank_cover():
    far = []
    for seed in range(12):
        fit = fit_model(TANK, records(seed)[:2])
        assert fit.explains
        far.append((fit.point.theta[:2] - TRUTH) / np.sqrt(np.diag(fit.covariance))[:2])
    assert np.abs(np.mean(far)) < 0.6
    assert np.mean(np.abs(far) < 2.0) > 0.8


# ---------------------------------------------------------------- diagnosis


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_complete_model_has_no_gap(seed):
    report = diagnose(TANK, [SECOND_ORDER], records(seed))
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    assert not report.checks.warnings
    shown = {row.channel: row.noise for row in report.how_far.rows if row.metric == "open loop"}
    sd = {n: np.hypot(SIGMA, RELATIVE * records(seed)[2].outputs[n]) for n in ("a", "b")}
    for name, noise in shown.items():
        assert noise == pytest.approx(np.sqrt(np.mean(sd[name] ** 2)), rel=0.05)


def test_a_missing_effect_is_named_and_covered():
    report = diagnose(TANK, [SECOND_ORDER], records(4, second=0.02))
    (found,) = report.which.effects[:1]
    assert report.named == ("second order",)
    assert found.low < 0.02 < found.high


def test_without_the_key_the_records_ask_for_it():
    """Errors of the time stamps would explain a decay as well: it is as fast as it is large."""
    report = diagnose(TANK, [SECOND_ORDER], records(1, key=False))
    assert report.verdict is Verdict.DATA_PROBLEM
    assert "grows with the value: noise of 3.9 % of the value" in report.statement
    assert "time stamps" not in report.text()
    assert "relative_sigma = 0.04" in report.text().replace("\n", " ")


def test_errors_of_a_larger_relative_noise_are_told_with_the_whole():
    fits = [segment_record(TANK, r, {n: Noise(SIGMA, relative=0.01) for n in "ab"}, None)
            for r in records(2, key=False)]  # fmt: skip
    fit = fit_problem(Problem(TANK, tuple(fits)))
    found = uncorrelated(fit, larger_than_noise(fit, 0.01), 0.01)
    assert [u.relative for u in found] == pytest.approx([0.04, 0.04], rel=0.1)


# ---------------------------------------------------------------- checks without a model


@pytest.mark.parametrize(("true", "told"), [(0.5, True), (1.6, False)])
def test_no_noise_is_told_that_no_sensor_can_have(true, told):
    generator = np.random.default_rng(0)
    value = np.abs(generator.standard_normal(400))  # in units of the noise at zero
    levels = (100.0 * value) ** 2
    squares = true**2 * levels * generator.standard_normal(400) ** 2
    factor = float(np.sqrt(np.mean(squares)))
    found = _of("y", factor, squares, np.zeros(400), levels, 0.0, 0.05)
    assert (found.relative > 0.0) == told
    assert found.relative == pytest.approx(true, rel=0.15) or not told
    assert told or found.factor == factor


@pytest.mark.parametrize("sigma", [SIGMA, None])
def test_the_data_checks_tell_both_numbers(sigma):
    own = [
        replace(r, sensors={n: replace(s, sigma=sigma) for n, s in r.sensors.items()})
        for r in records(3, key=False)
    ]
    told = [w for w in check_records(own).warnings if "grows with its value" in w]
    assert [w.split(":")[0] for w in told] == ["a", "b"]
    assert "state sigma = 0.002" in told[0]
    assert "relative_sigma = 0.04 " in told[0]


def test_constant_noise_and_the_stated_one_are_not_told():
    for seed in range(30):
        assert not check_records(records(seed)).warnings
        assert not check_records(records(seed, key=False, relative=0.0)).warnings


def test_a_motion_that_shakes_where_it_is_far_is_no_noise():
    for path in sorted((ROOT / "examples" / "gap_action").glob("*/*.csv")):
        told = check_records(read_records([path])).warnings
        assert not [w for w in told if "grows with its value" in w], path


def test_values_with_two_digits_are_no_error():
    time = np.arange(1000) * 0.01
    y = np.array([float(f"{v:.2g}") for v in 20.0 * np.exp(-time / 3.0)])
    checked = check_records([Record(name="r", time=time, inputs={}, outputs={"y": y})])
    assert not [w for w in checked.warnings if "grows" in w]


def test_a_vibration_at_a_large_value_is_no_noise():
    time = np.arange(600) * 0.01
    told = 0
    for seed in range(40):
        generator = np.random.default_rng(seed)
        moved = 5.0 + 0.2 * np.sin(generator.uniform(20.0, 310.0) * time)
        y = np.where(time < 3.0, 0.0, moved) + 0.01 * generator.standard_normal(600)
        own = Record(name="r", time=time, inputs={}, outputs={"y": y})
        told += any("grows" in w for w in check_records([own]).warnings)
    assert told == 0


def test_the_gap_before_a_fit_is_in_this_noise():
    (one, *_) = own = records(1)
    found = check(TANK, own)
    (row,) = [r for r in found.rows if (r.record, r.channel) == ("one", "a")]
    clean = found.simulated["one"]["a"]
    assert row.noise == pytest.approx(
        np.sqrt(np.mean(np.hypot(SIGMA, RELATIVE * clean) ** 2)), rel=0.1
    )
    assert row.rms == pytest.approx(np.sqrt(np.mean((one.outputs["a"] - clean) ** 2)))
    found.plot()


# ---------------------------------------------------------------- files and faults


def test_a_file_states_it(tmp_path):
    path = write_record(records(1)[0], tmp_path / "one.csv")
    assert "relative_sigma = 0.04" in path.with_suffix(".toml").read_text()
    assert read_record(path).sensors["a"].relative_sigma == 0.04


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("-0.1", "relative_sigma = -0.1, expected from 0 to 1 (0.04 is 4 % of the value)"),
        ("4", "relative_sigma = 4.0, expected from 0 to 1 (0.04 is 4 % of the value)"),
        ("nan", "outputs.a.relative_sigma: got nan"),
        ('"4 %"', "outputs.a.relative_sigma"),
    ],
)
def test_a_wrong_value_is_told(tmp_path, value, told):
    path = write_record(records(1)[0], tmp_path / "one.csv")
    sheet = path.with_suffix(".toml")
    sheet.write_text(
        sheet.read_text().replace("relative_sigma = 0.04", f"relative_sigma = {value}")
    )
    with pytest.raises(DataError) as error:
        read_record(path)
    assert told in str(error.value)


def test_it_needs_the_noise_at_zero():
    with pytest.raises(DataError, match="expected with it a sigma, the noise at the value zero"):
        Sensor(name="y", relative_sigma=0.04)


# ---------------------------------------------------------------- plans


def test_the_information_of_a_record_is_that_of_weighted_samples():
    model, own, _ = _line(1, relative=0.1)
    bend = Effect(
        name="bend", component="line", scale=0.5, regressor=lambda r, shape: r.time**2 / 10.0
    )
    found = information(model, own, (Candidate(bend),))
    segmented = segment_record(model, own, {"y": Noise(0.05, relative=0.1)}, None)
    table = np.column_stack([own.time, np.ones(own.samples), 0.5 * own.time**2 / 10.0])
    weighted = table / segmented.sd
    assert found.matrix == pytest.approx(weighted.T @ weighted, rel=1e-6)


def test_a_better_sensor_has_less_of_both_parts():
    now = {"y": Sensor(name="y", sigma=0.03, relative_sigma=0.06)}
    better = Sensors(now).having(FurtherSensor(output="y", sigma=0.01)).now["y"]
    assert better.relative_sigma == pytest.approx(0.02)
