"""Sensors that lag: what a segment shows does not depend on where it was cut."""

from dataclasses import replace

import numpy as np
import pytest
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import fit_problem

from feltmb.data import Record, Sensor
from feltmb.errors import InvalidParameter
from feltmb.fit import OdeModel
from feltmb.fit.linear import LinearModel
from feltmb.fit.model import Candidate, Effect, Jobs, Parameter, SensitivityRequest, State
from feltmb.fit.observe import observe_jobs
from feltmb.fit.shift import shifted

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
    return np.stack([np.sin(7.0 * t), np.cos(5.0 * t)], axis=-1)


def cut(y, segments):
    length = int(np.max(segments[:, 1] - segments[:, 0])) + 1
    out = np.zeros((len(segments), length, y.shape[-1]))
    for b, (i, j) in enumerate(segments):
        out[b, : j - i + 1] = y[i : j + 1]
    return out


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("delay", [3e-3, -3e-3, 0.017])
def test_segments_of_one_motion_see_into_one_another(even, delay):
    time = np.linspace(0.0, 1.0, SAMPLES)
    if not even:
        time = time + 0.003 * np.sin(9.0 * time)
    r = record(time)
    segments = np.array([[0, 30], [30, 47], [47, 77], [77, 100]])
    delays = np.full(4, delay)
    whole = shifted(r, motion(time)[None], np.array([[0, 100]]), delays[:1])[0]
    assert np.allclose(whole[3:-3], motion(time - delay)[3:-3], atol=2e-7)
    assert np.allclose(
        whole, motion(time - delay), atol=0.011
    )  # straight from rest beyond the ends
    seen = shifted(r, cut(motion(time), segments), segments, delays)
    assert np.allclose(seen, cut(whole, segments), atol=2e-7)


def test_a_gap_between_segments_makes_no_step():
    time = np.linspace(0.0, 1.0, SAMPLES)
    segments = np.array([[0, 50], [50, 100]])
    y = cut(motion(time), segments)
    y[1] += 1.0
    delays = np.full(2, 4e-3)
    seen = shifted(record(time), y, segments, delays)
    want = cut(motion(time - 4e-3), segments)
    want[1] += 1.0
    assert np.allclose(seen[1], want[1], atol=2e-7)
    # Jobs of other sizes keep to themselves, and none is lost.
    other = shifted(record(time), y, segments, np.array([4e-3, 0.0]))
    assert np.allclose(other[0], want[0], atol=5e-5)
    assert np.array_equal(other[1], y[1])
    turned = shifted(record(time), y[::-1], segments[::-1], delays)
    assert np.allclose(turned[1], other[0])


def test_a_lag_longer_than_what_a_spline_remembers():
    time = np.linspace(0.0, 1.0, SAMPLES)
    segments = np.array([[0, 50], [50, 100]])
    seen = shifted(record(time), cut(motion(time), segments), segments, np.full(2, 0.3))
    assert np.allclose(seen[1], motion(time - 0.3)[50:], atol=2e-7)


def test_what_failed_stays_and_two_dimensions_do():
    time = np.linspace(0.0, 1.0, SAMPLES)
    segments = np.array([[0, 50], [50, 100]])
    y = cut(motion(time), segments)
    y[1, 7] = np.nan
    delays = np.full(2, 4e-3)
    seen = shifted(record(time), y, segments, delays)
    assert np.array_equal(seen[1], y[1], equal_nan=True)
    assert np.all(np.isfinite(seen[0]))
    flat = shifted(record(time), y[:, :, 0], segments, delays)
    assert np.allclose(flat, seen[:, :, 0], rtol=0.0, atol=1e-14, equal_nan=True)


def test_a_known_delay_does_not_depend_on_the_segments():
    time = np.linspace(0.0, 1.0, SAMPLES)
    r = record(time)
    r = replace(
        r,
        inputs={"u": motion(time)[:, 0]},
        sensors={"y": replace(r.sensors["y"], delay=0.004)},
    )
    model = LinearModel(
        output="y",
        columns={"slope": lambda record: record.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
        name="line",
    )
    segments = np.array([[0, 40], [40, 100]])
    jobs = Jobs.at_point(np.ones(1), segments, np.zeros((2, 0)), (), np.zeros(0))
    seen = observe_jobs(model, r, jobs).outputs
    want = motion(time - 0.004)[:, 0]
    assert np.allclose(seen[0, :41, 0], want[:41], atol=5e-5)
    assert np.allclose(seen[1, :61, 0], want[40:], atol=5e-5)


OSCILLATOR = OdeModel(
    states=[State(name="x", start_sd=1.0), State(name="v", start_sd=100.0, scale=50.0)],
    rates=lambda t, x, u, p: (x.v, p.k * (u.u - x.x) - 20.0 * x.v),
    outputs={"y": "x"},
    inputs=["u"],
    parameters=[Parameter(name="k", value=1e4, sd=2e3)],
    substeps=4,
    name="oscillator",
)


def shaken(noise=1e-3, **known):
    """Record of the oscillator with k = 10000 by a sensor of these properties."""
    time = np.arange(401) * 1e-3
    u = np.sin(40.0 * time) + 0.5 * np.sin(130.0 * time)
    sensor = Sensor(name="y", unit="m", sigma=1e-3, **known)
    r = Record(
        name="r",
        time=time,
        inputs={"u": u},
        outputs={"y": np.zeros(time.size)},
        sensors={"y": sensor},
    )
    whole = Jobs.at_point(np.array([1e4]), np.array([[0, 400]]), np.zeros((1, 2)), (), np.zeros(0))
    y = observe_jobs(OSCILLATOR, r, whole).outputs[0, :, 0]
    return replace(r, outputs={"y": y + noise * np.random.default_rng(0).standard_normal(401)})


@pytest.mark.parametrize(
    "known", [{"delay": 2e-3}, {"delay": 5e-3}, {"bandwidth": 60.0, "delay": 5e-3}]
)
def test_fits_do_not_depend_on_segments_where_a_sensor_lags(known):
    r = shaken(**known)
    every = np.arange(0, 400, 25)
    values = []
    for segments in (np.array([[0, 400]]), np.column_stack([every, every + 25])):
        segmented = segment_record(OSCILLATOR, r, {"y": Noise(1e-3)}, None, segments)
        fit = fit_problem(Problem(OSCILLATOR, (segmented,)))
        assert fit.explains
        assert fit.converged
        values.append(fit.intervals()[0])
    one, many = values
    assert abs(one.value - 1e4) < 2.5 * one.sd
    assert abs(many.value - one.value) < 0.5 * one.sd
    assert many.sd == pytest.approx(one.sd, rel=0.2)


@pytest.mark.parametrize("bandwidth", [1.0, 30.0])
def test_derivatives_through_a_slow_sensor_are_those_of_a_segment_alone(bandwidth):
    r = shaken(bandwidth=bandwidth)
    segments = np.array([[0, 100], [100, 220], [220, 400]])
    segmented = segment_record(OSCILLATOR, r, {"y": Noise(1e-3)}, None, segments)
    problem = Problem(OSCILLATOR, (segmented,))
    point = problem.start()
    by_state = problem.linear(point)[0].by_state
    for w in range(3):
        ends = []
        for h in (1e-4, -1e-4):
            starts = point.places[0].starts.copy()
            starts[w, 0] += h
            place = replace(point.places[0], starts=starts)
            ends.append(problem.predict(replace(point, places=(place,)))[0][1][w])
        numeric = -(ends[0] - ends[1]) / 2e-4
        assert np.allclose(by_state[w, :, 0], numeric, rtol=1e-4, atol=1e-4 * np.max(abs(numeric)))


def test_segments_hold_six_time_constants_of_a_slow_sensor():
    for bandwidth, least in ((1e4, 0.0), (10.0, 0.095), (1.0, 0.4)):
        segments = segment_record(OSCILLATOR, shaken(bandwidth=bandwidth), {}, None).segments
        assert np.all(np.diff(segments, axis=1) * 1e-3 >= 0.75 * least)
        # A length that is asked for is kept.
        asked = segment_record(OSCILLATOR, shaken(bandwidth=bandwidth), {}, 0.05).segments
        assert len(asked) == 8


@pytest.mark.parametrize("bandwidth", [1.0, 30.0])
def test_input_noise_of_a_segment_does_not_pass_a_slow_sensor_into_the_next(bandwidth):
    """A linear model: the columns are exact differences, segment by segment."""
    r = replace(shaken(bandwidth=bandwidth), input_sigma={"u": 0.1})
    segments = np.array([[0, 100], [100, 220], [220, 400]])
    segmented = segment_record(OSCILLATOR, r, {"y": Noise(1e-3)}, None, segments)
    problem = Problem(OSCILLATOR, (segmented,))
    point = problem.start()
    linear = problem.linear(point)[0]
    assert linear.by_input.shape[2] == 6
    before = problem.predict(point)[0]
    for w, (first, last) in enumerate(segments):
        phase = (np.arange(401) - first) / (last - first) * 5.0
        change = np.maximum(0.0, 1.0 - abs(phase - 2.0)) * 0.1 * np.sqrt(5.0 / (last - first))
        changed = r.with_inputs({"u": r.inputs["u"] + change})
        own = segment_record(OSCILLATOR, changed, {"y": Noise(1e-3)}, None, segments)
        after = replace(problem, segmented_records=(own,)).predict(point)[0]
        numeric = before[1][w] - after[1][w]
        assert np.allclose(linear.by_input[w, :, 2], numeric, atol=1e-6 * np.max(abs(numeric)))


@pytest.mark.parametrize("size", [0.5, -0.5])
def test_noise_of_a_recorded_input_passes_an_included_gain(size):
    """The recorded input is noisy, and the input effect makes the acting one of it."""
    r = replace(shaken(), input_sigma={"u": 0.1})
    segments = np.array([[0, 100], [100, 220], [220, 400]])
    segmented = segment_record(OSCILLATOR, r, {"y": Noise(1e-3)}, None, segments)
    gain = Effect(
        name="gain", component="u", excite=lambda r, size, _: {"u": (1.0 + size) * r.inputs["u"]}
    )
    plain = Problem(OSCILLATOR, (segmented,))
    more = plain.with_candidates((Candidate(gain),))
    point = plain.start()
    own = plain.linear(point)[0].by_input
    passed = more.linear(replace(point, magnitudes=np.array([size]), memo={}))[0].by_input
    assert np.allclose(passed, (1.0 + size) * own, rtol=1e-5, atol=1e-6 * np.abs(own).max())


def test_changes_of_inputs_that_the_record_does_not_have_are_refused():
    r = shaken()
    for change in ({"g": np.zeros(401)}, {"u": np.zeros(3)}):
        request = SensitivityRequest(
            r, np.array([1e4]), np.array([[0, 400]]), np.zeros((1, 2)), input_changes=(change,)
        )
        with pytest.raises(InvalidParameter, match="input_changes"):
            OSCILLATOR.sensitivities([request])
