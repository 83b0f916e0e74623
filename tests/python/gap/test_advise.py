"""Advice on the next experiment, held against the experiment itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from feltmb.data import Record, Sensor
from feltmb.fit import FunctionModel, LinearModel
from feltmb.fit.model import Candidate, Effect, Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import fit_problem
from feltmb.gap.advise import _advice, _experiments

NOISE = 0.02
LINE = LinearModel(
    output="y",
    columns={"slope": lambda record: record.inputs["u"]},
    parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
    name="line",
)
CUBE = Effect(
    name="cube",
    component="spring",
    unit="1",
    scale=0.1,
    regressor=lambda record, shape: record.inputs["u"] ** 3,
)
SINE = Effect(
    name="sine",
    component="spring",
    unit="1",
    scale=0.1,
    regressor=lambda record, shape: np.sin(1.5 * record.inputs["u"]) - record.inputs["u"],
)


def record(strength, *, mode="force"):
    time = np.linspace(0.0, 1.0, 200)
    u = strength * np.sin(2.0 * np.pi * 3.0 * time)
    y = u + 0.1 * u**3 + NOISE * np.random.default_rng(1).standard_normal(200)
    return Record(
        name="swing",
        time=time,
        inputs={"u": u},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", unit="1", sigma=NOISE)},
        input_mode=mode,
    )


def fitted(r):
    return fit_problem(Problem(LINE, (segment_record(LINE, r, {"y": Noise(NOISE)}, None),)))


def test_advice_is_what_the_experiment_would_give():
    fit = fitted(record(1.0))
    (advice,) = _advice(fit, [(Candidate(CUBE), Candidate(SINE))], {"cube": 0.1})
    assert "twice the input" in advice.text
    assert advice.separates == ("cube", "sine")
    assert advice.confusion_then < 0.5 * advice.confusion_now

    def confusion(records):
        """From the whitened columns, with the prior of the slope as one more row."""
        u = np.concatenate([r.inputs["u"] for r in records])
        columns = np.column_stack([u, 0.1 * u**3, 0.1 * (np.sin(1.5 * u) - u)]) / NOISE
        slope, a, b = np.vstack([columns, [10.0, 0.0, 0.0]]).T
        a, b = (c - slope * (slope @ c) / (slope @ slope) for c in (a, b))
        strength = np.linalg.norm(a)
        rho = abs(a @ b) / (strength * np.linalg.norm(b))
        p, q = (norm.cdf(-strength * np.sqrt(0.5 * (1.0 + s * rho))) for s in (-1.0, 1.0))
        return p + q - 2.0 * p * q

    once, twice = record(1.0), replace(record(2.0), name="swing, harder")
    assert advice.confusion_now == pytest.approx(confusion([once]), rel=1e-6)
    assert advice.confusion_then == pytest.approx(confusion([once, twice]), rel=1e-6)


def test_a_motion_is_not_driven_past_its_stops():
    fit = fitted(record(1.0, mode="motion"))
    texts = [text for text, _ in _experiments(fit, (Candidate(CUBE), Candidate(SINE)))]
    assert any("twice as fast" in t for t in texts)
    assert not any("input" in t for t in texts)


def test_twins_are_told_to_need_another_sensor():
    alike = replace(CUBE, name="alike")
    pairs = [(Candidate(CUBE), Candidate(alike))]
    (advice,) = _advice(fitted(record(1.0)), pairs, {"cube": 0.1})
    assert "another point or quantity" in advice.text
    assert advice.confusion_then == pytest.approx(0.5)


def test_what_noise_does_not_hide_is_not_promised_to_an_experiment():
    pairs = [(Candidate(CUBE), Candidate(SINE))]
    (advice,) = _advice(fitted(record(3.0)), pairs, {"cube": 0.1})
    assert advice.confusion_now < 0.005
    assert "the noise of these records would not confuse" in advice.text
    assert advice.confusion_then == advice.confusion_now


@pytest.mark.parametrize(("strength", "told"), [(1.57, True), (1.6, False)])
def test_a_confusion_of_two_percent_is_worth_an_experiment(strength, told):
    """Probability of confusion: 2.5 and 1.6 %."""
    pairs = [(Candidate(CUBE), Candidate(SINE))]
    (advice,) = _advice(fitted(record(strength)), pairs, {"cube": 0.1})
    assert (advice.confusion_now > 0.02) is told
    assert ("the probability of confusing cube with sine falls from 3%" in advice.text) is told
    assert ("would not confuse" in advice.text) is not told


def test_a_further_output_is_offered():
    """Only z separates the two: y shows both alike. A third of the noise of y would not."""
    model = FunctionModel(
        name="lever",
        outputs={"y": lambda r, p: p.slope * r.inputs["u"], "z": lambda r, p: 0.0 * r.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
    )

    def seen(name, by_z):
        return Effect(
            name=name,
            component="c",
            scale=0.1,
            regressor=lambda r, s: np.outer(r.inputs["u"] ** 3, [1.0, by_z]),
        )

    own, noise = record(1.0), {"y": Noise(NOISE)}
    fit = fit_problem(Problem(model, (segment_record(model, own, noise, None),)))
    pairs = [(Candidate(seen("one", 1.0)), Candidate(seen("two", -1.0)))]
    (advice,) = _advice(fit, pairs, {"one": 0.1})
    assert advice.text.startswith("record swing with z measured as well")
    assert advice.confusion_now == pytest.approx(0.5)
    assert advice.confusion_then < 0.01
