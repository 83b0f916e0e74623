"""First-order lags: closed forms, derivatives, and a diagnosis that finds them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled import diagnose, library
from unmodeled.chain.times import low_passed
from unmodeled.data import Record, Sensor
from unmodeled.fit.observe import observe, observed_sensitivities
from unmodeled.models.model import Candidate, SensitivityRequest

from ..diagnosis import models


def clock(even):
    time = 0.01 * np.arange(101)
    return time if even else time + 0.004 * np.sin(time * 40.0)


def record(time, u):
    return Record(name="r", time=time, inputs={"f": u}, outputs={"q": 0.0 * time})


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("constant", [1e-4, 0.03, 2.0])
def test_the_filter_is_the_solution_of_its_equation(even, constant):
    time = clock(even)
    y = np.sin(3.0 * time) + 0.2 * time
    r = record(time, y)
    seen = low_passed(r.time, y[None], constant, y[:1])[0]
    exact = solve_ivp(
        lambda t, x: (np.interp(t, time, y) - x) / constant,
        (time[0], time[-1]),
        [y[0]],
        t_eval=time,
        method="LSODA",
        rtol=1e-9,
        atol=1e-11,
        max_step=5e-3,
    ).y[0]
    assert np.allclose(seen, exact, atol=2e-6)


@pytest.mark.parametrize("even", [True, False])
def test_without_a_start_the_signal_always_had_its_first_slope(even):
    time = clock(even)
    seen = low_passed(time, 3.0 * time[None] + 1.0, 0.2)[0]
    assert np.allclose(seen, 3.0 * (time - 0.2) + 1.0, atol=1e-12)


@pytest.mark.parametrize("before", ["constant", "zero"])
def test_a_drive_that_lags(before):
    """Closed form of a step: 1 - exp(-t / constant), or nothing happens."""
    time = clock(True)
    effect = library.input_fault("f", "lag", scale=0.1)
    seen = effect.excite(record(time, np.ones(101)), 0.2, before)["f"]
    # The input that is zero one sample before rises on a line.
    rising = 1.0 - 0.2 / 0.01 * (1.0 - np.exp(-0.01 / 0.2)) * np.exp(-time / 0.2)
    assert np.allclose(seen, rising if before == "zero" else 1.0, atol=1e-12)
    unknown = record(time, np.ones(101)).cut(20, 100)
    moved = unknown.with_changed_inputs(lambda r: effect.excite(r, 0.2, before))
    assert np.allclose(moved.inputs["f"], seen[20:100], atol=1e-12)


@pytest.mark.parametrize("make", ["sensor", "input"])
def test_derivatives_by_a_lag_are_differences(make):
    r, start = models.record("r", 1.0, 3), np.array([0.004, 0.02])
    if make == "sensor":
        candidate = Candidate(library.sensor_fault(["q"], "q", "lag", scale=0.01))
    else:
        candidate = Candidate(library.input_fault("f", "lag", scale=0.01), "constant")

    def seen(size):
        return observe(models.NOMINAL, r, models.TRUTH, start, (candidate,), np.array([size]))

    request = SensitivityRequest(r, models.TRUTH, start, (candidate,), np.array([0.05]))
    (found,) = observed_sensitivities(models.NOMINAL, [request])
    numeric = (seen(0.05 + 1e-5) - seen(0.05 - 1e-5))[:, 0] / 2e-5
    scale = np.max(np.abs(numeric))
    # That of an input is a difference over the first step of the effect.
    exact = 1e-6 if make == "sensor" else 2e-2
    assert np.allclose(found.d_magnitudes[:, 0, 0], numeric, atol=exact * scale)


def test_a_lag_that_vanishes_changes_nothing_after_an_unknown_start():
    """The first reading is not that of the model; its share vanishes with the time constant."""
    part = models.records(5)[0].cut(250, 600)
    assert not part.start.known
    effect = library.sensor_fault(["q"], "q", "lag", scale=0.01)
    y = part.outputs["q"] + 0.01
    sizes = np.array([0.0, 1e-9, 1e-5])
    seen = effect.observe(part, np.tile(y, (3, 1))[..., None], sizes, None)[..., 0]
    rate = np.abs(np.diff(y) / np.diff(part.time)).max()
    assert np.all(np.abs(seen - y) <= 1.001 * sizes[:, None] * rate)


@pytest.mark.parametrize("cut", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_slow_sensor_is_found(cut):
    """The force is not zero at the first sample; parts of a record begin during a motion."""
    records = []
    for r in models.records(5):
        y = r.outputs["q"][None]
        slow = low_passed(r.time, y, 0.03, y[:, 0])[0]
        noise = 1e-4 * np.random.default_rng(len(records)).standard_normal(600)
        sensor = Sensor(name="q", unit="m", sigma=1.1e-4)
        seen = replace(r, outputs={"q": slow + noise}, sensors={"q": sensor})
        records += [seen.cut(0, 250, f"{r.name} 1"), seen.cut(250, 600, r.name)] if cut else [seen]
    effects = [
        *models.EFFECTS,
        *library.for_sensor(["q"], "q", records[0]),
    ]
    report = diagnose(models.NOMINAL, effects, records)
    (named,) = report.named
    assert named.cause == "lag of sensor q"
    assert named.magnitude == pytest.approx(0.03, rel=0.05)
