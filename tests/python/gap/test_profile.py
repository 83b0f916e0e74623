"""The profile of a magnitude against closed forms."""

import numpy as np
import pytest

from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import (
    Candidate,
    Effect,
    Exposed,
    LinearModel,
    Options,
    Parameter,
    Record,
    SimulatorModel,
    diagnose,
)
from feltmb.gap.profile import profile_of

TIME = np.linspace(0.0, 2.0, 201)
PUSH = np.sin(3.0 * TIME) + 0.3 * TIME
NOISE = 0.02


def record(values, name="one", seed=3):
    noise = NOISE * np.random.default_rng(seed).standard_normal(TIME.size)
    return Record(
        name=name,
        time=TIME,
        inputs={"f": PUSH},
        outputs={"y": values + noise},
    )


def fitted(model, effect, one, size):
    noise = {"y": Noise(NOISE)}
    problem = Problem(model, (segment_record(model, one, noise, None),), (Candidate(effect),))
    return fit_problem(problem, FitSettings(restarts=0), point=problem.start(np.array([size])))


def test_the_profile_of_a_linear_model_is_its_parabola():
    effect = Effect(name="drift", component="sensor", regressor=lambda r, _shape: r.time)
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["f"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
        name="line",
    )
    fit = fitted(model, effect, record(1.05 * PUSH + 0.2 * TIME), 0.1)
    told = []
    p = profile_of(fit, "drift", FitSettings(decrement=1e-6), lambda *what: told.append(what))
    scaled = (np.array(p.values) - p.magnitude) / p.sd
    np.testing.assert_allclose(scaled, [-3, -2, -1, 0, 1, 2, 3], atol=1e-9)
    np.testing.assert_allclose(p.rises, scaled**2, rtol=1e-4, atol=1e-6)
    assert p.low == pytest.approx(p.magnitude - 1.96 * p.sd, rel=1e-4)
    assert p.high == pytest.approx(p.magnitude + 1.96 * p.sd, rel=1e-4)
    assert [w[1:] for w in told] == [(i, 6) for i in range(6)]


def curve(_time, inputs, parameters):
    """A magnitude that saturates: its likelihood leans."""
    return {"y": parameters["gain"] * inputs["f"] + np.tanh(parameters["bend"] * TIME)}


def simulated():
    return SimulatorModel(
        curve,
        parameters=[Parameter(name="gain", value=1.0, sd=0.1)],
        inputs={"f": "N"},
        outputs={"y": "m"},
        exposed={"bend": Exposed(scale=1.0, sign=1)},
        name="curve",
    )


def test_a_leaning_profile_is_that_of_all_else_in_closed_form():
    model = simulated()
    (effect,) = model.effects
    one = record(1.02 * PUSH + np.tanh(2.2 * TIME), seed=8)
    fit = fitted(model, effect, one, 2.0)
    p = profile_of(fit, effect.name, FitSettings(decrement=1e-6))

    def least(bend):
        """Least sum of squares over the gain, which enters linearly and has a prior."""
        rest = (one.outputs["y"] - np.tanh(bend * TIME)) / NOISE
        column = PUSH / NOISE
        gain = (column @ rest + 1.0 / 0.1**2) / (column @ column + 1.0 / 0.1**2)
        return np.sum((rest - gain * column) ** 2) + ((gain - 1.0) / 0.1) ** 2

    rises = [least(v) - least(p.magnitude) for v in p.values]
    np.testing.assert_allclose(p.rises, rises, rtol=1e-3, atol=1e-3)
    assert p.rises[0] > 1.05 * p.rises[-1]  # not a parabola
    grid = np.linspace(p.values[0], p.values[-1], 4001)
    inside = grid[[least(v) - least(p.magnitude) < 1.96**2 for v in grid]]
    width = inside[-1] - inside[0]
    assert abs(p.low - inside[0]) < 0.01 * width
    assert abs(p.high - inside[-1]) < 0.01 * width


def test_an_end_at_a_limit_is_the_limit():
    model = simulated()
    (effect,) = model.effects
    fit = fitted(model, effect, record(PUSH + np.tanh(1e-4 * TIME), seed=4), 1e-3)
    p = profile_of(fit, effect.name, FitSettings())
    assert p.low == 0.0 == p.values[0]
    assert p.high > p.magnitude


def test_a_diagnosis_has_the_profiles_of_what_it_names():
    model = simulated()
    records = [record(1.02 * PUSH + np.tanh(2.2 * TIME), f"run {i}", i) for i in range(3)]
    report = diagnose(
        model, model.effects, records, options=Options(bootstrap=0, profile=True, advice=False)
    )
    assert report.named == ("bend",)
    (p,) = report.profiles
    assert p.low < 2.2 < p.high
    assert "95 % interval by profile" in p.text
    plain = diagnose(model, model.effects, records, options=Options(bootstrap=0, advice=False))
    assert plain.profiles == ()
