"""Models of equations: faults of their description, derivatives, rates as outputs, units."""

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Coordinate, Coupling, Equations, Parameter, Rate, Record, State, library
from unmodeled.errors import InvalidParameter
from unmodeled.fit import SensitivityRequest
from unmodeled.models import Candidate, Jobs

from ..diagnosis import models


def test_sensitivities_are_derivatives():
    one, start = models.record("r", 1.0, 1, samples=200), np.array([2e-3, 0.03])
    included, candidates = (Candidate(models.CUBIC),), (Candidate(models.DRY),)
    (s,) = models.NOMINAL.sensitivities(
        [
            SensitivityRequest(
                one, models.TRUTH, start, included, np.array([500.0]), candidates=candidates
            )
        ]
    )

    def run(theta, x, dry):
        jobs = Jobs(
            theta=theta[None],
            starts=x[None],
            included=(*included, *candidates),
            magnitudes=np.array([[500.0, dry]]),
        )
        return models.NOMINAL.simulate(one, jobs)[0]

    h = 1e-5
    step = np.array([0.0, h, 0.0])
    by_k = (run(models.TRUTH + step, start, 0.0) - run(models.TRUTH - step, start, 0.0)) / (2 * h)
    scale = np.max(np.abs(by_k))
    np.testing.assert_allclose(s.d_theta[..., 1] / scale, by_k / scale, atol=1e-4)
    base = run(models.TRUTH, start, 0.0)
    by_v = (run(models.TRUTH, start + [0, h], 0.0) - base) / h
    np.testing.assert_allclose(s.d_starts[..., 1], by_v, atol=1e-4)
    by_dry = (run(models.TRUTH, start, 1e-6) - base) / 1e-6
    scale = np.max(np.abs(by_dry))
    np.testing.assert_allclose(s.d_candidates[..., 0] / scale, by_dry / scale, atol=2e-3)


def test_the_motion_is_that_of_the_states():
    one = models.record("r", 1.0, 1, samples=100)
    jobs = Jobs(theta=np.tile(models.TRUTH, (2, 1)), starts=np.array([[0.0, 0.0], [0.01, 0.0]]))
    states = models.NOMINAL.motion(one, jobs)
    assert states.shape == (2, 100, 2)
    np.testing.assert_array_equal(states[..., :1], models.NOMINAL.simulate(one, jobs))
    np.testing.assert_array_equal(states[:, 0], jobs.starts)


def test_all_that_is_wrong_with_a_model_is_told_at_once():
    arm = Coordinate(name="arm", position="q", speed="v")
    with pytest.raises(InvalidParameter) as error:
        Equations(
            name="arm",
            states=[State(name="q"), State(name="v")],
            rates=lambda t, x, u, p: (x.v, -x.q),
            outputs={"q": "q"},
            coordinates=[arm, arm, Coupling(name="joint", first=arm, second=arm)],
            substeps=0,
        )
    text = str(error.value)
    for part in (
        "'arm' names two coordinates or ports",
        "coupling joint: lies between arm and itself",
        "substeps = 0, expected a whole number >= 1, or None",
    ):
        assert part in text
    # Arguments of a wrong kind are told before.
    given = {"states": [State(name="q")], "rates": lambda t, x, u, p: (x.q,), "outputs": {"q": "q"}}
    for name, value in (("method", "euler"), ("hold", "cubic"), ("substeps", 2.5)):
        with pytest.raises(InvalidParameter, match=f"{name}: got {value!r}, expected"):
            Equations(**given, **{name: value})


def test_an_accelerometer_feels_effects_and_unknown_forces():
    slide = Coordinate(name="slide", position="q", speed="v", inertia="m")
    model = Equations(
        states=[State(name="q", unit="m", start=0), State(name="v", unit="m/s", scale=1)],
        parameters=[Parameter(name="m", value=2.0), Parameter(name="k", value=100.0)],
        inputs=["f"],
        rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q) / p.m),
        outputs={"a": Rate("v"), "v": "v"},
        coordinates=[slide],
        substeps=4,
    )
    assert model.units == {"a": "m/s^2", "v": "m/s"}
    time = np.arange(401) * 2.5e-3
    record = Record(name="r", time=time, inputs={"f": np.sin(20.0 * time)}, outputs={"a": 0 * time})
    cube = library.polynomial_stiffness(slide, 3, scale=1.0)
    jobs = Jobs(
        theta=np.array([[2.0, 100.0]]),
        starts=np.zeros((1, 2), dtype=int),
        included=(Candidate(cube),),
        magnitudes=np.array([[2e6]]),
        forces=np.array([[[0.0, 0.5]]]),
    )
    a, v = model.simulate(record, jobs)[0].T
    assert np.allclose(a[1:-1], (v[2:] - v[:-2]) / 5e-3, atol=2e-3 * np.max(abs(a)))
    bare = replace(jobs, included=(), magnitudes=np.zeros((1, 0)), forces=None)
    without = model.simulate(record, bare)[0, :, 0]
    assert np.max(abs(a - without)) > 0.2 * np.max(abs(a))
    with pytest.raises(InvalidParameter, match="output a: 'w' is no state; known are q, v"):
        Equations(
            states=[State(name="q"), State(name="v")],
            rates=lambda t, x, u, p: (x.v, -x.q),
            outputs={"a": Rate("w")},
        )


def test_the_unit_of_a_coordinate_agrees_with_that_of_its_state():
    """A pendulum whose coordinate has the default unit N got magnitudes in N s/m."""

    def turning(angle="rad", **of_coordinate):
        return Equations(
            states=[State(name="q", unit=angle), State(name="v", unit=f"{angle}/s")],
            rates=lambda t, x, u, p: (x.v, -x.q),
            outputs={"q": "q"},
            coordinates=[Coordinate(name="pivot", position="q", speed="v", **of_coordinate)],
        )

    with pytest.raises(InvalidParameter, match=r"position q has the unit rad, but a force in N mo"):
        turning()
    torques = ("N m", "Nm", "N*m", "kN m", "mN m", "rad/s^2")
    for good in (*({"unit": u} for u in torques), {"position_unit": "rad"}):
        turning(**good)
    turning("deg", unit="N m")
    turning("steps")
    turning("1")
