"""Tempered fits, from which effects are screened: closed forms of a linear model."""

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit import Candidate, Effect, Parameter
from feltmb.fit.linear import LinearModel
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import refine
from feltmb.gap.score import score_fit

SETTINGS = FitSettings(decrement=1e-10)
X = np.linspace(-1.0, 1.0, 101)


def line(sd):
    """A line through data of a cubic with noise of 0.01; the slope is 1 with this prior."""
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="slope", value=1.0, sd=sd)],
        name="line",
    )
    y = 1.3 * X + 0.1 * X**3 + 0.01 * np.random.default_rng(1).standard_normal(X.size)
    record = Record(
        name="run",
        time=np.arange(X.size) * 0.01,
        inputs={"x": X},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=0.01)},
    )
    problem = Problem(model, (segment_record(model, record, {"y": Noise(0.01)}, None),))
    cubic = Effect(name="cubic", component="spring", scale=0.1, regressor=lambda _r, _s: X**3)
    return fit_problem(problem, SETTINGS), Candidate(cubic, cubic.shapes[0]), y


def test_a_tempered_fit_is_that_to_records_with_more_noise():
    fit, _, y = line(0.2)
    mild = refine.tempered(fit, SETTINGS)
    sigma = 0.01 * refine.TEMPERED[0]
    slope = 1.0 + (X @ (y - X)) / (X @ X + (sigma / 0.2) ** 2)
    assert mild.point.theta[0] == pytest.approx(slope, rel=1e-9)
    assert abs(slope - fit.point.theta[0]) > 1e-3  # the noise matters
    own = np.sum(((y - slope * X) / 0.01) ** 2) + ((slope - 1.0) / 0.2) ** 2
    assert mild.cost == pytest.approx(own, rel=1e-9)


def test_scores_of_a_linear_model_are_those_of_the_fit():
    fit, cubic, _ = line(0.2)
    mild = refine.tempered(fit, SETTINGS)
    at, there = score_fit(fit, (cubic,)), score_fit(mild, (cubic,))
    assert there.singles() == pytest.approx(at.singles(), rel=1e-8)
    assert there.one_step() == pytest.approx(at.one_step(), rel=1e-8)


def test_an_effect_that_is_cooled_ends_at_the_minimum():
    fit, cubic, y = line(0.2)
    mild = refine.tempered(fit, SETTINGS)
    cooled = refine.cooled(mild, (cubic,), np.zeros(1), SETTINGS)
    columns = np.vstack([np.stack([X, X**3], axis=1) / 0.01, [[1.0 / 0.2, 0.0]]])
    right = np.append(y / 0.01, 1.0 / 0.2)
    slope, size = np.linalg.lstsq(columns, right, rcond=None)[0]
    assert cooled.point.theta[0] == pytest.approx(slope, rel=1e-8)
    assert cooled.point.magnitudes[0] == pytest.approx(size, rel=1e-8)
    assert cooled.converged


def test_without_a_prior_there_is_nothing_to_temper():
    fit, _, _ = line(np.inf)
    assert refine.tempered(fit, SETTINGS) is None
