"""Delays of sensors: by splines on any clock, with a straight continuation at the ends."""

from dataclasses import replace

import numpy as np
import pytest

from unmodeled.chain import Link, fault_of
from unmodeled.chain.times import at_times
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit import (
    Candidate,
    Effect,
    Equations,
    LinearModel,
    Parameter,
    SensitivityRequest,
    State,
)
from unmodeled.fit.observe import observe, observed_sensitivities

SAMPLES = 101


def record(time):
    return Record(
        name="r",
        time=time,
        inputs={"u": np.zeros(time.size)},
        outputs={"y": np.zeros(time.size)},
        sensors={"y": Sensor(name="y", unit="m", sigma=1e-3)},
    )


def motion(t):
    return np.stack([np.sin(7.0 * t), np.cos(5.0 * t)])


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("delay", [3e-3, -3e-3, 0.017])
@pytest.mark.parametrize("samples", [SAMPLES, 501])
def test_a_delayed_motion_is_that_of_an_earlier_time(even, delay, samples):
    time = np.linspace(0.0, 1.0, samples)
    if not even:
        time = time + 0.003 * np.sin(9.0 * time)
    seen = at_times(time, motion(time), time - delay)
    edge = 3 * samples // SAMPLES
    assert np.allclose(seen[:, edge:-edge], motion(time - delay)[:, edge:-edge], atol=2e-7)
    # Straight beyond the ends.
    assert np.allclose(seen, motion(time - delay), atol=0.011)


def test_each_job_has_its_delay_and_a_failed_one_stays_as_it_is():
    time = np.linspace(0.0, 1.0, SAMPLES)
    y = np.repeat(motion(time)[:1], 4, axis=0)
    y[3, 7] = np.nan
    link = Link(fault_of("delay"), [0])
    seen = link(record(time), y[:, :, None], np.array([4e-3, 0.0, 0.3, 4e-3]))[:, :, 0]
    assert np.allclose(seen[0, 3:], motion(time - 4e-3)[0, 3:], atol=2e-7)
    assert np.array_equal(seen[1], y[1])
    assert np.allclose(seen[2, 31:], motion(time - 0.3)[0, 31:], atol=2e-7)
    assert np.array_equal(seen[3], y[3], equal_nan=True)


def test_a_known_delay_is_part_of_the_readings():
    time = np.linspace(0.0, 1.0, SAMPLES)
    r = record(time)
    r = replace(
        r,
        inputs={"u": motion(time)[0]},
        sensors={"y": replace(r.sensors["y"], delay=0.004)},
    )
    model = LinearModel(
        output="y",
        columns={"slope": lambda record: record.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
        name="line",
    )
    seen = observe(model, r, np.ones(1), np.zeros(0))
    assert np.allclose(seen[:, 0], motion(time - 0.004)[0], atol=5e-5)


OSCILLATOR = Equations(
    states=[State(name="x", start_sd=1.0), State(name="v", start_sd=100.0, scale=50.0)],
    rates=lambda t, x, u, p: (x.v, p.k * (u.u - x.x) - 20.0 * x.v),
    outputs={"y": "x"},
    inputs=["u"],
    parameters=[Parameter(name="k", value=1e4, sd=2e3)],
    substeps=4,
    name="oscillator",
)


@pytest.mark.parametrize(
    "known", [{"delay": 5e-3}, {"bandwidth": 1.0}, {"bandwidth": 30.0, "delay": 5e-3, "gain": 1.2}]
)
def test_derivatives_by_the_start_pass_the_sensor(known):
    time = np.arange(401) * 1e-3
    u = np.sin(40.0 * time) + 0.5 * np.sin(130.0 * time)
    sensor = Sensor(name="y", unit="m", sigma=1e-3, **known)
    r = Record(
        name="r", time=time, inputs={"u": u}, outputs={"y": 0.0 * time}, sensors={"y": sensor}
    )
    theta, start, h = np.array([1e4]), np.array([0.1, 3.0]), np.array([1e-4, 0.0])
    (found,) = observed_sensitivities(OSCILLATOR, [SensitivityRequest(r, theta, start)])
    up, down = (observe(OSCILLATOR, r, theta, start + s * h) for s in (1.0, -1.0))
    numeric = (up - down)[:, 0] / 2e-4
    exact = found.d_starts[:, 0, 0]
    assert np.allclose(exact, numeric, rtol=1e-4, atol=1e-4 * np.max(np.abs(numeric)))


@pytest.mark.parametrize("size", [0.5, -0.5])
def test_a_change_of_a_recorded_input_passes_an_included_gain(size):
    """The input effect makes the acting input of the recorded one."""
    time = np.arange(401) * 1e-3
    r = Record(name="r", time=time, inputs={"u": np.sin(40.0 * time)}, outputs={"y": 0.0 * time})
    gain = Candidate(
        Effect(
            name="gain",
            component="u",
            excite=lambda r, size, _: {"u": (1.0 + size) * r.inputs["u"]},
        )
    )
    change = {"u": np.maximum(0.0, 1.0 - np.abs(time - 0.2) / 0.05)}
    theta, start = np.array([1e4]), np.zeros(2)
    plain = SensitivityRequest(r, theta, start, input_changes=(change,))
    with_gain = SensitivityRequest(
        r, theta, start, (gain,), np.array([size]), input_changes=(change,)
    )
    own, passed = (s.d_inputs for s in observed_sensitivities(OSCILLATOR, [plain, with_gain]))
    assert np.allclose(passed, (1.0 + size) * own, rtol=1e-5, atol=1e-6 * np.abs(own).max())


def test_changes_of_inputs_that_the_record_does_not_have_are_refused():
    time = np.arange(401) * 1e-3
    r = Record(name="r", time=time, inputs={"u": 0.0 * time}, outputs={"y": 0.0 * time})
    for change in ({"g": np.zeros(401)}, {"u": np.zeros(3)}):
        request = SensitivityRequest(r, np.array([1e4]), np.zeros(2), input_changes=(change,))
        with pytest.raises(InvalidParameter, match="input_changes"):
            OSCILLATOR.sensitivities([request])
