"""States and parameters estimated along the records, piece by piece."""

import numpy as np
import pytest

from feltmb.fit.noise import Noise
from feltmb.fit.problem import Problem
from feltmb.fit.recursive import assimilate
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import FitSettings, _minimize, finish
from feltmb.gap import Jobs, OdeModel, Parameter, Record, Sensor, State

NOISE = 1e-4
STATES = [
    State(name="q", unit="m", scale=1e-3, start_sd=1e-5),
    State(name="v", unit="m/s", scale=1e-1, start_sd=1e-3),
]


def linear(process_sd=0.0):
    """An oscillator whose outputs are linear in all that is fitted."""
    return OdeModel(
        name="linear",
        states=STATES,
        parameters=[
            Parameter(name="b", value=1.0, sd=0.5, process_sd=process_sd),
            Parameter(name="o", value=0.0, sd=0.5, unit="m/s^2"),
        ],
        inputs=["f"],
        rates=lambda t, x, u, p: (x.v, p.b * u.f + p.o - 100.0 * x.q - 0.5 * x.v),
        outputs={"q": "q"},
        substeps=2,
        hold="linear",
    )


def ball():
    """A ball that falls on a felt again and again: the later, the less linear."""
    return OdeModel(
        name="ball",
        states=STATES,
        parameters=[
            Parameter(name="g", value=9.81, sd=1.0, unit="m/s^2"),
            Parameter(name="k", value=4e4, sd=1e4, unit="N/(m kg)", lower=1e3),
            Parameter(name="d", value=10.0, sd=4.0, unit="1/s", lower=0.0, process_sd=0.05),
        ],
        inputs=["f"],
        rates=lambda t, x, u, p: (
            x.v,
            u.f - p.g + np.where(x.q < 0.0, np.maximum(-p.k * x.q - p.d * x.v, 0.0), 0.0),
        ),
        outputs={"q": "q"},
        substeps=8,
        hold="linear",
        chaotic=True,
    )


def make_record(model, theta, seed, samples, step, drive=1.0):
    generator = np.random.default_rng(seed)
    time = step * np.arange(samples)
    force = drive * np.sin(13.0 * time + seed)
    clean = Record(name=f"r{seed}", time=time, inputs={"f": force}, outputs={"q": 0.0 * time})
    jobs = Jobs(
        theta=np.asarray(theta)[None],
        segments=np.array([[0, samples - 1]]),
        starts=np.zeros((1, 2)),
    )
    q = model.simulate(clean, jobs).outputs[0, :, 0]
    return Record(
        name=clean.name,
        time=time,
        inputs=clean.inputs,
        outputs={"q": q + NOISE * generator.standard_normal(samples)},
        sensors={"q": Sensor(name="q", unit="m", sigma=NOISE)},
    )


def make_problem(model, records, segment):
    noise = {"q": Noise(NOISE)}
    segmented = tuple(segment_record(model, r, noise, segment) for r in records)
    return Problem(model, segmented, state_scale=np.array([s.scale for s in STATES]))


@pytest.mark.parametrize("process_sd", [0.0, 0.1])
def test_of_a_linear_model_it_is_the_minimum(process_sd):
    model = linear(process_sd)
    problem = make_problem(model, [make_record(model, [1.4, -0.3], 1, 200, 5e-3)], 0.1)
    gap_sd = 1e-2 * problem.state_scale
    point = assimilate(problem, problem.start(), gap_sd)
    found = finish(problem, point, 1e-2, gap_sd)
    # A Newton step from there gains nothing, and Gauss-Newton from the prior ends there.
    other = _minimize(problem, problem.start(), gap_sd, FitSettings(decrement=1e-9), 20)
    assert found.cost == pytest.approx(other[1], rel=1e-7)
    np.testing.assert_allclose(point.theta, other[0].theta, atol=1e-6)
    np.testing.assert_allclose(point.places[0].starts, other[0].places[0].starts, atol=1e-4 * NOISE)


def test_parameters_that_are_held_stay_and_the_states_follow():
    model = linear()
    problem = make_problem(model, [make_record(model, [1.4, -0.3], 1, 200, 5e-3)], 0.1)
    gap_sd = 1e-2 * problem.state_scale
    start = problem.start(theta=np.array([1.3, -0.2]))
    point = assimilate(problem, start, gap_sd, held=True)
    np.testing.assert_allclose(point.theta, [1.3, -0.2], atol=1e-7)
    before = problem.cost_at(start, gap_sd, problem.linear(start))[0]
    assert problem.cost_at(point, gap_sd, problem.linear(point))[0] < 0.2 * before


def test_many_impacts_are_followed_from_the_priors():
    model = ball()
    truth = np.array([8.6, 5.2e4, 6.0])
    problem = make_problem(model, [make_record(model, truth, 1, 250, 2e-3, 3.0)], 0.05)
    gap_sd = 1e-2 * problem.state_scale
    point = assimilate(problem, problem.start(), gap_sd)
    found = _minimize(problem, point, gap_sd, FitSettings(), 20)
    from_truth = assimilate(problem, problem.start(theta=truth), gap_sd, held=True)
    best = _minimize(problem, from_truth, gap_sd, FitSettings(), 20)
    assert found[1] < best[1] + 0.5
    assert found[1] < 1.3 * problem.samples
