"""Residuals that are not correlated in time: errors of time stamps, and noise stated too small."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.fit.linear import FunctionModel, LinearModel
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import fit_problem
from feltmb.gap import Effect, Options, Parameter, Record, Sensor, Verdict, diagnose
from feltmb.gap.checks import check_records
from feltmb.gap.discrepancy import larger_than_noise, only_white
from feltmb.gap.uncorrelated import uncorrelated

_spec = importlib.util.spec_from_file_location("models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)
SIGMA, COUNT = 1e-3, 1200
TIME = np.arange(COUNT) * 2e-3
LINE = LinearModel(
    output="y",
    columns={"gain": lambda r: r.inputs["x"]},
    parameters=[Parameter(name="gain", value=1.0, sd=0.2)],
    name="line",
)
CUBIC = Effect(name="cubic", component="x", scale=0.5, regressor=lambda r, s: r.inputs["x"] ** 3)


def motion(t):
    """Fast and slow parts, with a pause in which nothing moves."""
    return np.where(t < 0.6, 0.0, np.sin(9.0 * (t - 0.6)) * np.sin(1.5 * (t - 0.6)))


def record(name, seed, *, clock=0.0, noise=SIGMA, role="fit", more=lambda x: 0.0):
    generator = np.random.default_rng(seed)
    seen = motion(TIME + clock * generator.standard_normal(COUNT))
    y = seen + more(seen) + noise * generator.standard_normal(COUNT)
    return Record(
        name=name,
        time=TIME,
        inputs={"x": motion(TIME)},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=SIGMA)},
        role=role,
    )


def fitted(*records):
    segments = tuple(segment_record(LINE, r, {"y": Noise(SIGMA)}, None) for r in records)
    return fit_problem(Problem(LINE, segments))


def told(fit):
    return uncorrelated(fit, larger_than_noise(fit, 0.01), 0.01)


def leaves_white_noise(fit):
    return only_white(larger_than_noise(fit, 0.01))


@pytest.mark.parametrize("clock", [4e-4, 2e-3])
def test_the_errors_of_time_stamps_are_measured(clock):
    (found,) = told(fitted(*(record(f"r{i}", i, clock=clock) for i in range(3))))
    assert found.channel == "y"
    assert found.clock_sd == pytest.approx(clock, rel=0.08)
    assert found.factor == pytest.approx(1.0, abs=0.1)


def test_larger_noise_is_no_error_of_time_stamps():
    assert told(fitted(record("quiet", 1))) == ()
    (found,) = told(fitted(record("loud", 1, noise=5.0 * SIGMA)))
    assert found.clock_sd == 0.0
    assert found.factor == pytest.approx(5.0, rel=0.05)
    assert "noise may be 5.1 times the stated one" in found.text


def test_a_cause_is_correlated_in_time():
    assert told(fitted(record("bent", 1, more=lambda x: 0.05 * x**3))) == ()
    # The delay of a sensor grows with the speed as well.
    late = record("late", 1, more=lambda x: 2e-3 * np.gradient(x, TIME))
    assert told(fitted(late)) == ()


def test_errors_of_time_stamps_and_larger_noise_are_told_apart():
    mixed = [record(f"r{i}", i, clock=2e-3, noise=3.0 * SIGMA) for i in range(3)]
    (found,) = told(fitted(*mixed))
    assert found.clock_sd == pytest.approx(2e-3, rel=0.08)
    assert found.factor == pytest.approx(3.0, rel=0.05)
    assert "beside it, its noise may be" in found.text


def numbers(values, x, role="fit", name="n"):
    """A record of single numbers: the value at the first sample, nothing after it."""
    time, blank = np.array([0.0, 1.0]), np.array([np.nan, np.nan])
    out = []
    for i, (v, at) in enumerate(zip(values, x, strict=True)):
        y = blank.copy()
        y[0] = v
        sensors = {"y": Sensor(name="y", sigma=SIGMA)}
        inputs = {"x": np.full(2, at)}
        made = Record(name=f"{name}{i}", time=time, inputs=inputs, outputs={"y": y},
                      sensors=sensors, role=role)  # fmt: skip
        out.append(made)
    return out


@pytest.mark.parametrize("count", [2, 4])
def test_a_few_numbers_are_rarely_more_than_their_noise(count):
    x = np.linspace(0.5, 1.0, count)
    draws = SIGMA * np.random.default_rng(3).standard_normal((400, count))
    found = [bool(larger_than_noise(fitted(*numbers(x + d, x)), 0.01)) for d in draws]
    assert sum(found) <= 1  # a residual is refuted at 1e-4
    (seen,) = larger_than_noise(fitted(*numbers(x + 6.0 * SIGMA * (-1.0) ** np.arange(count), x)),
                                0.01).values()  # fmt: skip
    assert seen.factor > 3.0


def test_single_numbers_are_not_compared_with_a_constant():
    x = np.array([0.3, 0.6, 1.0])
    records = [*numbers(1.1 * x + 0.05 * x**3, x), *numbers([0.9202], [0.8], "held_out", "h")]
    report = diagnose(LINE, [CUBIC], records, options=Options(bootstrap=0))
    assert not any(row.worse_than_constant for row in report.as_it_is)
    assert not [w for w in check_records(records).warnings if "never changes" in w]


def test_larger_noise_is_rarely_taken_for_errors_of_time_stamps():
    fits = [fitted(record("r", seed, noise=2.0 * SIGMA)) for seed in range(300)]
    found = [u.clock_sd > 0.0 for fit in fits for u in told(fit)]
    assert len(found) == 300
    assert sum(found) <= 8  # 1 %, and three standard deviations of the count


def test_the_statement_tells_errors_of_time_stamps():
    roles = ("fit", "fit", "fit", "held_out")
    records = [record(f"r{i}", i, clock=1e-3, role=role) for i, role in enumerate(roles)]
    report = diagnose(LINE, [CUBIC], records, options=Options(bootstrap=0))
    assert report.verdict is Verdict.DATA_PROBLEM
    assert report.named == ()
    assert any("from the clock of its device" in a.text for a in report.next)
    (clock,) = re.findall(r"independent errors of (\S+) ms would explain it", report.statement)
    assert float(clock) == pytest.approx(1.0, rel=0.05)


def test_white_noise_is_told_from_a_cause():
    assert not leaves_white_noise(fitted(record("quiet", 1)))
    assert leaves_white_noise(fitted(record("loud", 1, noise=5.0 * SIGMA)))
    assert not leaves_white_noise(fitted(record("bent", 1, more=lambda x: 0.05 * x**3)))


def test_a_sigma_that_is_far_too_small_does_not_hide_a_cause():
    """Against a tenth of the noise, every effect seems to gain; the true one is still named."""
    records = [
        record(
            f"r{i}",
            i,
            noise=10.0 * SIGMA,
            more=lambda x: 0.05 * x**3,
            role="fit" if i < 3 else "held_out",
        )
        for i in range(5)
    ]
    quintic = Effect(
        name="quintic", component="x", scale=0.5, regressor=lambda r, s: r.inputs["x"] ** 5
    )
    sign = Effect(
        name="sign", component="x", scale=0.1, regressor=lambda r, s: np.sign(r.inputs["x"])
    )
    report = diagnose(LINE, [CUBIC, quintic, sign], records, options=Options(bootstrap=0))
    assert report.verdict is Verdict.NAMED_RESIDUAL
    assert report.named == ("cubic",)
    assert "its noise may be 10 times the stated one" in report.statement
    assert report.which["cubic"].magnitude == pytest.approx(0.05, rel=0.25)


def test_a_sigma_that_is_too_small_is_a_problem_of_the_data():
    records = [
        record(f"r{i}", i, noise=3.0 * SIGMA, role="fit" if i < 3 else "held_out") for i in range(5)
    ]
    report = diagnose(LINE, [CUBIC], records, options=Options(bootstrap=0))
    assert report.verdict is Verdict.DATA_PROBLEM
    assert report.statement.startswith("The records, not the machine: what is left is 9")
    assert "its noise may be 3 times the stated one" in report.statement
    assert report.which.none == 0.0
    assert report.confidence > 0.9
    assert any("state its true standard deviation" in a.text for a in report.next)


def test_a_certain_effect_that_held_out_records_refuse_is_unknown_beside_noise():
    records = [
        record(
            f"r{i}",
            i,
            noise=2.0 * SIGMA,
            more=lambda x, i=i: (-0.004 if i > 2 else 0.004) * x**3,
            role="fit" if i < 3 else "held_out",
        )
        for i in range(4)
    ]
    report = diagnose(LINE, [CUBIC], records, options=Options(bootstrap=0))
    assert report.verdict is Verdict.UNKNOWN
    assert "cubic" in report.statement
    assert "its noise may be" in report.statement


def test_a_record_without_a_channel_does_not_change_its_noise():
    loud = record("loud", 1, noise=2.0 * SIGMA)
    line = FunctionModel(
        name="line",
        outputs={"y": lambda r, p: p.gain * r.inputs["x"], "z": lambda r, p: 0.0 * r.time},
        parameters=[Parameter(name="gain", value=1.0, sd=0.2)],
    )
    other = replace(
        loud,
        name="other",
        outputs={"z": np.zeros(COUNT)},
        sensors={"z": Sensor(name="z", sigma=1.0)},
    )
    segments = tuple(
        segment_record(line, r, {n: Noise(s.sigma) for n, s in r.sensors.items()}, None)
        for r in (loud, other)
    )
    (found,) = told(fit_problem(Problem(line, segments)))
    assert found.factor == pytest.approx(2.0, rel=0.05)
