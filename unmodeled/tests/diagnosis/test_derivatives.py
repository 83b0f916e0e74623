"""Derivatives of residuals by all unknowns, against differences of residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import (
    Coordinate,
    Effect,
    Equations,
    Options,
    Parameter,
    Record,
    Sensor,
    State,
    library,
)
from unmodeled.data import StartPrior
from unmodeled.search.linear import (
    EvaluationRequest,
    Point,
    count_global,
    evaluate,
    local_of,
    movable,
)
from unmodeled.search.problem import Member
from unmodeled.search.records import prepare, ready_records

MASS = Coordinate(name="mass", position="x", speed="v", inertia="m")


def rates(t, x, u, p):
    del t
    return x.v, (u.f - p.k * x.x - p.d * x.v) / p.m


def slide(duration=4.0, samples=401):
    """A mass on a spring that is driven by two sines, and a record of its inputs."""
    model = Equations(
        name="slide",
        states=[State(name="x", unit="m", scale=0.01), State(name="v", unit="m/s", scale=0.1)],
        parameters=[
            Parameter(name="m", value=2.0, sd=0.1, unit="kg"),
            Parameter(name="k", value=300.0, sd=30.0, unit="N/m"),
            Parameter(name="d", value=6.0, sd=3.0, unit="N s/m"),
        ],
        inputs={"f": "N"},
        rates=rates,
        outputs={"position": "x"},
        coordinates=[MASS],
    )
    t = np.linspace(0.0, duration, samples)
    f = 4.0 * np.sin(9.0 * t) + 2.0 * np.sin(4.0 * t)
    record = Record(
        name="run",
        time=t,
        inputs={"f": f},
        outputs={"position": 0.01 * np.sin(9.0 * t)},
        sensors={"position": Sensor(name="position", unit="m", sigma=1e-5)},
    )
    return model, record


EFFECTS = (
    library.dry_friction(MASS, scale=1.0, speed=0.1),
    library.hysteresis(MASS, scale=1.0, travel=0.01),
    library.sensor_fault(
        ["position"],
        "position",
        "saturation",
        shapes=(("highest", 0.006), ("highest", 0.009)),
    ),
)


@pytest.mark.parametrize(
    "shapes",
    [
        {"dry friction mass": 0.01},
        {"hysteresis mass": (0.004, 2.0)},
        # The shape of a sensor is no number of the rates.
        {"saturation of sensor position": ("highest", 0.008)},
        {"dry friction mass": 0.01, "saturation of sensor position": ("highest", 0.008)},
    ],
)
def test_derivatives_by_all_unknowns_are_those_of_the_simulation(shapes):
    model, record = slide()
    problem = prepare(ready_records(model, [record]), EFFECTS, (), Options())
    names = [c.name for c in problem.causes]
    members = tuple(Member(names.index(name), shape) for name, shape in shapes.items())
    x = np.zeros(count_global(problem, members))
    x[len(problem.free) : len(problem.free) + len(members)] = 0.8
    local = tuple(np.zeros(len(local_of(problem, members, o))) for o in problem.fit)

    def residual(at):
        ask = EvaluationRequest(members, Point(at, local), problem.fit, derivatives=False)
        return evaluate(problem, [ask])[0][0].residual

    exact = evaluate(problem, [EvaluationRequest(members, Point(x, local), problem.fit)])[0][
        0
    ].by_global
    for k in range(x.size):
        step = np.zeros_like(x)
        step[k] = 1e-3
        differences = (residual(x - step) - residual(x + step)) / 2e-3
        error = np.linalg.norm(exact[..., k] - differences)
        assert error < 0.02 * np.linalg.norm(differences), k


def test_derivatives_of_a_late_record_are_those_of_the_late_motion():
    model, record = slide()
    sensor = replace(record.sensors["position"], delay_sd=0.02)
    start = StartPrior(mean={"x": 0.0, "v": 0.0}, sd={"x": 0.01, "v": 0.1})
    late = replace(record, sensors={"position": sensor}, start=start)
    problem = prepare(ready_records(model, [late]), EFFECTS, (), Options())
    assert [q.kind for q in problem.fit[0].local] == ["start", "start", "delay"]
    start = np.array([*np.full(len(problem.free), 0.3), 0.5, -0.7, 1.55])  # between two samples

    def at(values, derivatives=False):
        point = Point(values[:-3], (values[-3:],))
        return evaluate(
            problem, [EvaluationRequest((), point, problem.fit, derivatives=derivatives)]
        )[0][0]

    found = at(start, derivatives=True)
    exact = np.concatenate([found.by_global, found.by_local], axis=2)
    for k, step in enumerate(1e-3 * np.eye(start.size)):
        differences = (at(start - step).residual - at(start + step).residual) / 2e-3
        error = np.linalg.norm(exact[..., k] - differences)
        assert error < 0.02 * np.linalg.norm(differences), k


def test_the_derivative_by_a_delay_is_that_of_the_interpolated_outputs():
    """Steps of the input make kinks, where a difference of neighboring samples is another one."""
    t, h = np.arange(200.0), 1.0
    u = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 20), 10)
    sensor = Sensor(name="x", unit="m", sigma=1e-3, delay_sd=h)
    record = Record(
        name="run", time=t, inputs={"u": u}, outputs={"x": 0.1 * u}, sensors={"x": sensor}
    )
    model = Equations(
        lambda t, x, u, p: ((u.u - x.x) / p.tau,),
        states={"x": (0.0, 0.0, "m")},
        parameters={"tau": (3.0, 0.1, "s")},
        hold="zero",
        inputs={"u": "m"},
        outputs={"x": "x"},
    )
    problem = prepare(ready_records(model, [record]), (), (), Options())
    assert [q.kind for q in problem.fit[0].local] == ["delay"]

    def at(delay, derivatives=False):
        point = Point(np.zeros(1), (np.array([delay]),))
        return evaluate(
            problem, [EvaluationRequest((), point, problem.fit, derivatives=derivatives)]
        )[0][0]

    exact = at(0.4, derivatives=True).by_local[..., 0]
    differences = (at(0.39).residual - at(0.41).residual) / 0.02
    assert np.linalg.norm(exact - differences) < 0.01 * np.linalg.norm(differences)


def test_only_numbers_on_one_side_that_differ_are_fitted():
    def law(*shapes, zero=0.0):
        return Effect(
            name="law", component="part", unit="N", scale=1.0, shapes=shapes, shape_zero=zero,
            rate=lambda t, x, u, p, size, shape: {},
        )  # fmt: skip

    assert movable(law(0.1, 0.3)) == (0,)
    assert movable(law((0.1, 2.0), (0.3, 2.0))) == (0,)  # the second is the same in all
    assert movable(law((0.1, 2.0), (0.3, 4.0))) == (0, 1)
    assert movable(law((0.1, 2.0), (0.3, 4.0, 1.0))) == ()  # forms of different lengths
    assert movable(law(1, 3)) == ()
    assert movable(law(-0.1, 0.3)) == ()
    assert movable(law(0.2, 0.3, zero=0.1)) == (0,)
    assert movable(law(0.0, 0.3, zero=0.1)) == ()
