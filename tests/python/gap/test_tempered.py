"""Tempered fits: closed forms of a linear model, and an effect that a parameter has taken up."""

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit import Candidate, Effect, Parameter
from feltmb.fit.linear import LinearModel
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Exposed, SimulatorModel, refine
from feltmb.gap.score import all_candidates, score_fit
from feltmb.gap.search import search

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
    annealed = refine.annealed(mild, (cubic,), np.zeros(1), SETTINGS)
    columns = np.vstack([np.stack([X, X**3], axis=1) / 0.01, [[1.0 / 0.2, 0.0]]])
    right = np.append(y / 0.01, 1.0 / 0.2)
    slope, size = np.linalg.lstsq(columns, right, rcond=None)[0]
    assert annealed.point.theta[0] == pytest.approx(slope, rel=1e-8)
    assert annealed.point.magnitudes[0] == pytest.approx(size, rel=1e-8)
    assert annealed.converged


def test_without_a_prior_there_is_nothing_to_temper():
    fit, _, _ = line(np.inf)
    assert refine.tempered(fit, SETTINGS) is None


def coupled(time, _inputs, parameters):
    """The stiffness can replace the coupling; where it does, the coupling has no influence."""
    p = parameters
    y = p["stiffness"] * np.sin(7.0 * time)
    y += p["coupling"] * (1.0 - p["stiffness"]) * (np.sin(7.0 * time) + 0.04 * np.sin(11.0 * time))
    for k in range(12, 20):
        y += p[f"other{k}"] * (0.5 * np.sin(11.0 * time) + 0.87 * np.sin(k * time))
    return {"y": y}


def test_an_effect_that_a_parameter_has_taken_up_is_found(monkeypatch):
    time, sigma = np.linspace(0.0, 2.0 * np.pi, 101), 0.05
    others = [f"other{k}" for k in range(12, 20)]  # more than are refitted
    model = SimulatorModel(
        coupled,
        name="coupled",
        parameters=[Parameter(name="stiffness", value=0.0, sd=0.3)],
        inputs=[],
        outputs={"y": "m"},
        exposed={
            "coupling": Exposed(scale=1.0, sign=1, upper=2.0),
            **{n: Exposed(scale=0.02) for n in others},
        },
    )
    made = coupled(time, {}, {"stiffness": 0.0, "coupling": 1.0, **dict.fromkeys(others, 0.0)})
    noise = sigma * np.random.default_rng(3).standard_normal(time.size)
    record = Record(
        name="run",
        time=time,
        inputs={},
        outputs={"y": made["y"] + noise},
        sensors={"y": Sensor(name="y", unit="m", sigma=sigma)},
    )
    segmented = segment_record(model, record, {"y": Noise(sigma)}, None)
    fit = fit_problem(Problem(model, (segmented,)))
    assert fit.explains
    assert fit.point.theta[0] > 0.9
    scores = score_fit(fit, all_candidates(model.effects))
    singles = dict(zip((t.name for t in scores.candidates), scores.singles(), strict=True))
    assert singles["coupling"] < 1.0 < max(singles.values())
    best = search(fit, model.effects, FitSettings()).best
    assert best.names == ("coupling",)
    assert best.fit.point.magnitudes[0] == pytest.approx(1.0, abs=0.1)
    assert abs(best.fit.point.theta[0]) < 0.5
    monkeypatch.setattr("feltmb.gap.search.tempered", lambda *_: None)
    assert search(fit, model.effects, FitSettings()).best.names != ("coupling",)
