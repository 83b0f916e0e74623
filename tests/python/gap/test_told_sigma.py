"""A sigma that is told is good to 20 %: it is estimated with the rest."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.fit.linear import LinearModel
from feltmb.fit.noise import Noise
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Effect, Options, Parameter, Record, Sensor, Verdict, diagnose
from feltmb.gap.discrepancy import noise_factors
from feltmb.gap.search import search

_spec = importlib.util.spec_from_file_location("models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)
QUICK = Options(bootstrap=0, restarts=0, advice=False)
X = np.linspace(-1.0, 1.0, 1500)


def told(noise, sigma, *, left=0.0, seed=1):
    """What is said of the noise of a line with a slow rest, by factor of the sigma that is told."""
    line = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.2)],
        name="line",
    )
    y = X + left * np.cos(9.0 * X) + noise * np.random.default_rng(seed).standard_normal(X.size)
    record = Record(
        name="run",
        time=np.arange(X.size) * 0.01,
        inputs={"x": X},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=sigma)},
    )
    segmented = segment_record(line, record, {"y": Noise(sigma)}, None)
    effect = Effect(name="cubic", component="x", scale=0.5, regressor=lambda r, s: X**3)
    fit = fit_problem(Problem(line, (segmented,)))
    return noise_factors(search(fit, [effect], FitSettings()))


@pytest.mark.parametrize("true", [1.1, 1.2, 1.35])
def test_noise_that_is_larger_than_told_is_estimated(true):
    assert told(0.01 * true, 0.01)["y"] == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize(("true", "left"), [(1.0, 0.0), (0.8, 0.0), (1.0, 0.03), (2.0, 0.0)])
def test_what_is_no_noise_or_too_far_off_is_not_taken_for_noise(true, left):
    # A slow rest of three times the noise, and a noise that no told sigma is off by, stay.
    assert told(0.01 * true, 0.01, left=left) == {}


def records(share, **what):
    return [
        replace(r, sensors={"q": replace(r.sensors["q"], sigma=share * 1e-4)})
        for r in models.records(4, **what)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.95, 0.85])
def test_too_small_a_sigma_does_not_make_a_clean_record_unknown(share):
    report = diagnose(models.NOMINAL, models.EFFECTS, records(share, samples=1500), None, QUICK)
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    if share < 0.9:
        assert any("the larger noise is used" in w for w in report.checks.warnings)


@pytest.mark.slow
def test_an_unknown_cause_stays_unknown_with_too_small_a_sigma():
    report = diagnose(models.NOMINAL, [models.CUBIC], records(0.9, dry=0.02), None, QUICK)
    assert report.verdict is Verdict.UNKNOWN
