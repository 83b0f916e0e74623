"""Shapes between those of the list, and effects whose form is a shape."""

from dataclasses import replace

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit import Candidate, Effect, Named, Parameter
from feltmb.fit.linear import LinearModel
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Coordinate, Verdict, diagnose, library
from feltmb.gap.criteria import FITTED_SHAPE
from feltmb.gap.score import prior_of
from feltmb.gap.search import search
from feltmb.gap.shape import movable

NOISE = 0.01
LINE = LinearModel(
    output="y",
    columns={"slope": lambda r: r.inputs["x"]},
    parameters=[Parameter(name="slope", value=1.0, sd=0.2)],
    name="line",
)


def effect(shapes, name="clearance"):
    """A slope that is missing within +-shape."""
    return Effect(
        name=name,
        component="stop",
        scale=0.3,
        shapes=shapes,
        regressor=lambda r, b: -np.clip(r.inputs["x"], -b, b),
    )


def records(law, *, count=4, reach=1.0, seed=0):
    out = []
    for k in range(count):
        random = np.random.default_rng([seed, k])
        x = reach * random.uniform(-1.0, 1.0, 200)
        y = law(x) + NOISE * random.standard_normal(200)
        out.append(
            Record(
                name=f"run {k + 1}",
                time=np.arange(200) * 0.01,
                inputs={"x": x},
                outputs={"y": y},
                sensors={"y": Sensor(name="y", sigma=NOISE)},
            )
        )
    return out


def test_only_numbers_that_the_list_varies_may_move():
    assert movable(effect((0.1, 0.2))) == (0,)
    assert movable(effect(((0.1, 2.0), (0.2, 2.0), (0.2, 10.0)))) == (0, 1)
    assert movable(effect(((0.1, 0.0), (0.2, 1.0)))) == (0,)  # a share of zero has no logarithm
    for fixed in ((None,), (0.1,), (1, 2), ("odd", "even"), (0.1, None), (0.1, (0.2, 0.3))):
        assert movable(effect(fixed)) == ()


def test_a_shape_off_the_list_is_fitted_and_costs_what_it_says():
    truth = 0.31
    runs = records(lambda x: x - 0.5 * np.clip(x, -truth, truth))
    segmented_records = tuple(segment_record(LINE, r, {"y": Noise(NOISE)}, None) for r in runs)
    known = effect((0.05, 0.15, 0.6))
    best = search(fit_problem(Problem(LINE, segmented_records)), [known], FitSettings()).sets[0]
    (candidate,) = best.fit.included
    assert candidate.shape == pytest.approx(truth, rel=0.05)
    assert best.fit.point.magnitudes[0] == pytest.approx(0.5, rel=0.05)
    assert best.fit.explains
    two = effect(((0.1, 2.0), (0.2, 10.0)))
    costs = [prior_of([Candidate(two, s)], 1.0) for s in ((0.1, 2.0), (0.3, 2.0), (0.3, 5.0))]
    assert np.diff(costs) == pytest.approx([-FITTED_SHAPE, -FITTED_SHAPE])
    listed = replace(candidate, shape=0.15)
    assert prior_of([listed], 1.0) - prior_of([candidate], 1.0) == pytest.approx(FITTED_SHAPE)


def test_no_second_effect_mends_a_shape_that_is_off_the_list():
    runs = records(lambda x: x - 0.5 * np.clip(x, -0.31, 0.31))
    cubic = Effect(name="cubic", component="spring", regressor=lambda r, s: r.inputs["x"] ** 3)
    report = diagnose(LINE, [effect((0.05, 0.15, 0.6)), cubic], runs)
    assert report.verdict is Verdict.NAMED
    assert report.named == ("clearance",)
    assert report.which["clearance"].shape == pytest.approx(0.31, rel=0.05)
    assert report.model.included[0].shape == report.which["clearance"].shape


def test_a_shape_of_the_list_stays():
    runs = records(lambda x: x - 0.5 * np.clip(x, -0.15, 0.15))
    report = diagnose(LINE, [effect((0.05, 0.15, 0.6))], runs)
    assert report.which["clearance"].shape == 0.15


def test_a_gap_that_only_held_out_records_show_is_told():
    def law(x):
        return x + 0.5 * np.maximum(np.abs(x) - 1.0, 0.0) * np.sign(x)

    runs = [*records(law, count=3), *records(law, count=1, reach=2.0, seed=1)]
    runs[3] = replace(runs[3], name="far")
    stop = Effect(
        name="stop",
        component="stop",
        regressor=lambda r, s: np.maximum(np.abs(r.inputs["x"]) - 1.0, 0.0),
    )
    report = diagnose(LINE, [stop], runs, hold_out="far")
    assert report.verdict is Verdict.UNKNOWN
    assert "held-out ones do" in report.statement
    assert report.which.none == 0.0
    assert report.confidence > 0.5
    # Parameters that the fitted records do not show are no gap.
    near = [replace(r, inputs={"x": 1e-3 * r.inputs["x"]}) for r in runs[:3]]
    flat = [replace(r, outputs={"y": r.outputs["y"] - law(r.inputs["x"])}) for r in runs[:3]]
    near = [
        replace(n, outputs={"y": f.outputs["y"] + 1.3 * n.inputs["x"]})
        for n, f in zip(near, flat, strict=True)
    ]
    steep = replace(flat[0], name="far")
    steep = replace(steep, outputs={"y": steep.outputs["y"] + 1.3 * steep.inputs["x"]})
    report = diagnose(LINE, [stop], [*near, steep], hold_out="far")
    assert report.verdict is Verdict.NO_GAP


SLIDE = Coordinate(name="slide", position="q", speed="v", inertia=1.0)


def cycled(shape, amplitude, steps=4000, turns=2):
    """Force of the hysteresis of unit size along a sinusoidal path, and the path."""
    law = library.hysteresis(SLIDE, scale=1.0, travel=1.0)
    assert law.rate is not None
    t = np.linspace(0.0, 2.0 * np.pi * turns, steps)
    q, v = amplitude * np.sin(t), amplitude * np.cos(t)
    slip, force = 0.0, []
    for k in range(steps):
        x = Named({"q": np.array(q[k]), "v": np.array(v[k]), "hysteresis.slip": np.array(slip)})
        rate = law.rate(0.0, x, Named({}), Named({}), 1.0, shape)
        force.append(-float(rate["v"]))
        slip += float(rate["hysteresis.slip"]) * (t[1] - t[0])
    return q, np.array(force)


def test_hysteresis_is_that_of_an_elastic_plastic_element_when_sharp():
    b, amplitude = 0.1, 0.5
    q, force = cycled((b, 40.0), amplitude)
    assert np.max(np.abs(force)) == pytest.approx(1.0, rel=0.02)
    half = len(q) // 2
    loss = np.trapezoid(force[half:], q[half:])
    assert loss == pytest.approx(4.0 * (amplitude - b), rel=0.03)


@pytest.mark.parametrize("sharpness", [1.0, 2.0, 10.0])
def test_hysteresis_dissipates_and_is_bounded_by_its_size(sharpness):
    for amplitude in (0.02, 0.1, 1.0):
        q, force = cycled((0.1, sharpness), amplitude)
        half = len(q) // 2
        assert np.max(np.abs(force)) < 1.01
        assert np.trapezoid(force[half:], q[half:]) > -1e-6  # sharp and small: elastic


def test_hysteresis_follows_its_loading_curve():
    # From rest dz/dq = 1 - z^n, z = (q - slip) / b in units of b: for n = 2 a hyperbolic tangent.
    b = 0.1
    q, force = cycled((b, 2.0), 0.5, steps=8000)
    rising = slice(0, 1000)  # the first quarter of the first turn
    assert force[rising] == pytest.approx(np.tanh(q[rising] / b), abs=5e-3)


def test_an_end_stop_acts_beyond_its_end_alone():
    stop = library.end_stop(SLIDE, stiffness=2.0, travel=1.0)
    assert movable(stop) == (1,)  # the side is what it is
    assert stop.rate is not None
    q = np.array([-1.0, -0.2, 0.0, 0.2, 1.0])
    x = Named({"q": q, "v": np.zeros(5)})
    upper = stop.rate(0.0, x, Named({}), Named({}), 3.0, (1.0, 0.5))["v"]
    lower = stop.rate(0.0, x, Named({}), Named({}), 3.0, (-1.0, 0.5))["v"]
    assert upper == pytest.approx([0.0, 0.0, 0.0, 0.0, -1.5])
    assert lower == pytest.approx([1.5, 0.0, 0.0, 0.0, 0.0])


def test_a_bent_sensor_and_a_bent_input_are_the_model_at_size_zero_and_bend_as_they_say():
    run = records(lambda x: x, count=1)[0]
    bent = library.bent_input("x", level=2.0)
    x = run.inputs["x"]
    assert bent.excite is not None
    for shape, curve in (("odd", x * np.abs(x)), ("even", x**2)):
        assert np.array_equal(bent.excite(run, 0.0, shape)["x"], x)
        assert bent.excite(run, 0.1, shape)["x"] == pytest.approx(x + 0.05 * curve)
    sensor = library.sensor_bend(["y"], "y", level=2.0)
    assert sensor.observe is not None
    y = run.outputs["y"][None, :, None]
    segments, magnitudes = np.array([[0, 199]]), np.array([0.1])
    for shape, curve in (("odd", y * np.abs(y)), ("even", y**2)):
        assert sensor.observe(run, y, segments, magnitudes, shape) == pytest.approx(
            y + 0.05 * curve
        )
    assert {"nonlinearity of input x", "nonlinearity of sensor y"} <= {
        e.name for e in (*library.for_input("x", run), *library.for_sensor(["y"], "y", run))
    }


def test_a_bent_input_is_named():
    def law(x):
        return 1.1 * (x + 0.1 * x**2)

    runs = records(law)
    report = diagnose(LINE, library.for_input("x", runs[0]), runs)
    assert "nonlinearity of input x" in (*report.named, *report.one_of)
    assert report.which["nonlinearity of input x"].shape == "even"
