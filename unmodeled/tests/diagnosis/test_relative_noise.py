"""Noise in proportion to the value: weights in a fit, a diagnosis, and records that state it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import (
    Effect,
    Equations,
    LinearModel,
    Parameter,
    Record,
    Sensor,
    State,
    Verdict,
    diagnose,
    fit_model,
)
from unmodeled.data import read_record, write_record
from unmodeled.errors import DataError
from unmodeled.fit.noise import Noise
from unmodeled.models import Candidate, Jobs

SIGMA, RELATIVE, COUNT = 2e-3, 0.04, 300
TANK = Equations(
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


def record(name, seed, *, amount=1.0, relative=RELATIVE, second=0.0, role="fit"):
    generator = np.random.default_rng(seed)
    time = np.linspace(0.0, 300.0, COUNT)
    feed = amount * np.where((time > 5.0) & (time < generator.uniform(25.0, 65.0)), 0.05, 0.0)
    nothing = Record(
        name=name, time=time, inputs={"feed": feed}, outputs={"a": 0.0 * time, "b": 0.0 * time}
    )
    jobs = Jobs(
        theta=TRUTH[None, :],
        starts=np.zeros((1, 2)),
        included=(Candidate(SECOND_ORDER),),
        magnitudes=np.array([[second]]),
    )
    clean = TANK.simulate(nothing, jobs)[0]
    noisy = clean + np.hypot(SIGMA, relative * clean) * generator.standard_normal(clean.shape)
    sensors = {
        n: Sensor(name=n, unit="mol/l", sigma=SIGMA, relative_sigma=RELATIVE) for n in ("a", "b")
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
    table = np.column_stack([own.time, np.ones(own.samples)])

    def least_squares(sd):
        weighted = table / sd[:, None]
        covariance = np.linalg.inv(weighted.T @ weighted)
        value = covariance @ (weighted.T @ (own.outputs["y"] / sd))
        return value, np.sqrt(np.diag(covariance))

    found = fit_model(model, [own]).parameters
    value = np.array([p.value for p in found])
    noise = Noise(0.05, relative=0.1)
    exact, sd = least_squares(noise.sd_of_measured(own.time, own.outputs["y"]))
    assert np.all(np.abs(value - exact) < 0.02 * sd)
    # With the true standard deviations, which nobody knows, the result is the same within a share
    # of its own error.
    exact, sd = least_squares(true_sd)
    assert np.all(np.abs(value - exact) < 0.5 * sd)
    half = np.array([0.5 * (p.high - p.low) / 1.96 for p in found])
    assert half == pytest.approx(sd, rel=0.25)


def test_the_weights_do_not_favor_samples_that_are_too_small():
    """Weights from the measured values would give -2 relative_sigma^2, seven standard errors."""
    far = []
    for seed in range(20):
        model, own, _ = _line(seed)
        slope = fit_model(model, [own]).parameters[0]
        far.append((slope.value - 3.0) / (0.5 * (slope.high - slope.low) / 1.96))
    assert abs(np.mean(far)) < 3.0 / np.sqrt(20)
    assert 0.6 < np.std(far) < 1.4


@pytest.mark.slow
def test_intervals_of_the_tank_cover():
    far = []
    for seed in range(12):
        found = fit_model(TANK, records(seed)[:2]).parameters
        far.append(
            [
                (p.value - t) / (0.5 * (p.high - p.low) / 1.96)
                for p, t in zip(found, TRUTH, strict=True)
            ]
        )
    assert np.abs(np.mean(far)) < 0.6
    assert np.mean(np.abs(far) < 2.0) > 0.8


def test_a_complete_model_has_no_gap():
    own = records(1)
    report = diagnose(TANK, [SECOND_ORDER], own)
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    for channel in report.channels:
        clean = np.concatenate([r.outputs[channel.name] for r in own])
        assert channel.noise == pytest.approx(
            np.sqrt(np.mean(np.hypot(SIGMA, RELATIVE * clean) ** 2)), rel=0.05
        )
        assert channel.explained == pytest.approx(channel.noise, rel=0.1)


def test_a_missing_effect_is_named_and_covered():
    report = diagnose(TANK, [SECOND_ORDER], records(4, second=0.02))
    (found,) = report.named
    assert found.cause == "second order"
    assert found.low < 0.02 < found.high


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
