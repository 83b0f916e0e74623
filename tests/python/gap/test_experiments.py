"""Advice on the next experiment, held against the experiment itself."""

from dataclasses import replace

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit.linear import LinearModel
from feltmb.fit.model import Candidate, Effect, Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import fit_problem
from feltmb.gap.advise import confusion_at
from feltmb.gap.experiments import _advice, _plans
from feltmb.gap.planning import planned_scores

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
    advice = _advice(fit, Candidate(CUBE), Candidate(SINE), 0.1)
    assert "twice the input" in advice.text
    assert advice.separates == ("cube", "sine")
    assert advice.confusion_then < 0.5 * advice.confusion_now

    def confusion(records):
        scores = planned_scores(LINE, [CUBE, SINE], records)
        signal = confusion_at(scores, np.array([1.0, 1e6]))  # of the first alone
        return signal[0, 1]

    once, twice = record(1.0), replace(record(2.0), name="swing, harder")
    assert advice.confusion_now == pytest.approx(confusion([once]), rel=1e-6)
    assert advice.confusion_then == pytest.approx(confusion([once, twice]), rel=1e-6)


def test_a_motion_is_not_driven_past_its_stops():
    texts = [text for text, _ in _plans(fitted(record(1.0, mode="motion")))]
    assert any("twice as fast" in t for t in texts)
    assert not any("input" in t for t in texts)


def test_twins_are_told_to_need_another_sensor():
    alike = replace(CUBE, name="alike")
    advice = _advice(fitted(record(1.0)), Candidate(CUBE), Candidate(alike), 0.1)
    assert "another point or quantity" in advice.text
    assert advice.confusion_then == pytest.approx(0.5)


def test_what_noise_does_not_hide_is_not_promised_to_an_experiment():
    advice = _advice(fitted(record(3.0)), Candidate(CUBE), Candidate(SINE), 0.1)
    assert advice.confusion_now < 0.005
    assert "the noise of these records would not confuse" in advice.text
    assert advice.confusion_then == advice.confusion_now
