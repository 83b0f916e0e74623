"""Where the gap is: parts of records, events, and ports."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled import (
    Coordinate,
    Effect,
    Equations,
    LinearModel,
    Parameter,
    Record,
    Sensor,
    State,
    Verdict,
    diagnose,
)

from .conftest import SIGMA, spring_record


def test_cells_show_the_part_of_the_record_that_differs(spring, causes):
    records = [spring_record(name, n) for name, n in (("a", 2), ("b", 5), ("c", 3))]
    outputs = records[1].outputs["force"].copy()
    outputs[150:180] += 3.0
    records[1] = dataclasses.replace(records[1], outputs={"force": outputs})
    result = diagnose(spring, causes, records)
    worst = max(result.cells, key=lambda c: c.explained)
    assert worst.record == "b"
    assert worst.start < records[1].time[160] < worst.end
    quiet = [c.explained for c in result.cells if c.record != "b"]
    assert max(quiet) < 0.5 * worst.explained
    # The mean squares of the cells are those of the channel.
    squares = np.mean([c.explained**2 for c in result.cells])
    assert squares == pytest.approx(result.channels[0].explained ** 2, rel=0.1)


class Struck(LinearModel):
    """A model with events, the first one at 1 s."""

    times = (1.0,)

    def events(self, record, outputs):  # noqa: ARG002
        return [("impact", t) for t in self.times]


def struck(late, *times):
    """Diagnosis of three records that are late."""
    t = np.linspace(0.0, 2.0, 2001)
    step = lambda at: 1.0 / (1.0 + np.exp(-(t - at) / 0.01))  # noqa: E731
    records = [
        Record(
            name=f"r{k}",
            time=t,
            inputs={"x": step(1.0)},
            outputs={"force": step(1.0 + late) + np.random.default_rng(k).normal(0, 1e-3, t.size)},
            sensors={"force": Sensor(name="force", unit="N", sigma=1e-3)},
        )
        for k in range(3)
    ]
    model = Struck(
        name="struck",
        output="force",
        columns={"k": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="k", value=1.0, sd=0.01, unit="N")],
    )
    model.times = times
    return diagnose(model, (), records)


@pytest.mark.parametrize(("apart", "count"), [(0.0, 2), (3e-3, 0), (2e-2, 2)])
def test_events_that_are_too_near_each_other_have_no_delay(apart, count):
    """Unless they are one."""
    assert len(struck(0.004, 1.0, 1.0 + apart).events) == 3 * count


def test_events_show_the_delay_of_the_record():
    late = 0.004
    result = struck(late, 1.0)
    assert {(e.event, e.time) for e in result.events} == {("impact", 1.0)}
    for e in result.events:
        assert e.delay == pytest.approx(late, rel=0.05)
        assert e.delay > 20.0 * e.delay_sd
    assert {c.since for c in result.cells} == {"", "impact"}


def two_masses(friction=0.0, cubic=0.0):
    """Records of two coupled masses of which a force on the first one drives both."""
    t = np.arange(160) * 0.02
    records = []
    for k, role in enumerate(("fit", "fit", "held_out")):
        force = 3.0 * np.sin((4.0 + 2.0 * k) * t) + 1.0 * np.sin((11.0 + k) * t)

        def rates(s, x, force=force):
            pull = 60.0 * (x[0] - x[2])
            extra = friction * np.tanh(x[3] / 0.01) + cubic * x[2] ** 3
            drive = np.interp(s, t, force) - 30.0 * x[0] - x[1] - pull
            return [x[1], drive, x[3], pull - x[3] - extra]

        y = solve_ivp(rates, (0.0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-6, atol=1e-9).y
        noise = np.random.default_rng(k).normal(0.0, 1e-3, (2, t.size))
        sensor = {n: Sensor(name=n, unit="m", sigma=1e-3) for n in ("first", "second")}
        outputs = {"first": y[0] + noise[0], "second": y[2] + noise[1]}
        records.append(
            Record(
                name=f"r{k}",
                role=role,
                time=t,
                inputs={"force": force},
                outputs=outputs,
                sensors=sensor,
            )
        )
    return records


@pytest.fixture(scope="module")
def pair():
    states = [State(name=n, scale=0.1, start_sd=0.0) for n in ("x", "v", "y", "w")]

    def rates(_, x, u, p):
        pull = 60.0 * (x.x - x.y)
        return x.v, u.force - p.k * x.x - x.v - pull, x.w, pull - x.w

    return Equations(
        name="pair",
        states=states,
        rates=rates,
        outputs={"first": "x", "second": "y"},
        inputs=["force"],
        parameters=[Parameter(name="k", value=30.0, sd=1.0, unit="N/m")],
        coordinates=[
            Coordinate(name="at first", position="x", speed="v", inertia=1.0, scale=1.0),
            Coordinate(name="at second", position="y", speed="w", inertia=1.0, scale=1.0),
        ],
        substeps=1,
    )


def test_the_port_of_a_missing_force_is_found_with_its_law(pair):
    result = diagnose(pair, (), two_masses(friction=0.6))
    assert result.verdict is Verdict.UNKNOWN
    first, second = result.places
    assert (first.name, first.port) == ("at second", True)
    assert first.gain > second.gain + 100.0
    # The force explains nearly everything, and the force elsewhere does not.
    for left, channel in zip(first.left, result.channels, strict=True):
        assert left < 0.1 * channel.explained
        assert left < 2.0 * channel.noise
    assert max(second.left) > 3.0 * max(first.left)
    assert first.resembles[0][0] == "sign of the speed"


def test_no_place_is_told_where_nothing_is_missing(pair):
    result = diagnose(pair, (), two_masses())
    assert result.verdict in (Verdict.CALIBRATED, Verdict.NO_GAP)
    assert result.places == ()


def test_without_ports_the_component_of_effects_is_told(spring):
    def cubic(component, sign):
        return Effect(
            name=f"{component} {sign}",
            component=component,
            unit="N",
            scale=1.0,
            regressor=lambda r, _: (
                np.sin(12.0 * r.inputs["x"] / 0.1) if component == "right" else np.cos(5.0 * r.time)
            ),
        )

    # The foreign force has another sign in each record, so that no effect explains it.
    records = [
        spring_record(n, c, foreign=2.0 * s) for n, c, s in (("a", 2, 1), ("b", 5, -1), ("c", 3, 1))
    ]
    result = diagnose(spring, (cubic("right", 1), cubic("wrong", 1)), records)
    assert result.channels[0].explained > 10.0 * SIGMA
    assert result.places[0].name == "right"
    assert not result.places[0].port
    assert result.places[0].left[0] < 2.0 * SIGMA


def test_a_force_that_position_and_speed_explain_resembles_no_law():
    """The speed is linear in time, the position is its square: nothing of the force was left."""
    time = np.linspace(0.0, 3.0, 60)
    records = [
        Record(
            name=f"r{k}",
            time=time,
            inputs={},
            outputs={"h": 40.0 - 4.9 * time**2 + 0.5 * np.sin(3.0 * time + k)},
        )
        for k in range(3)
    ]
    model = Equations(
        lambda t, x, u, p: (x.v, -p.g + 0.0 * x.v),
        states={"h": "m", "v": "m/s"},
        parameters={"g": (9.81, 0.01, "m/s^2")},
        outputs={"h": "h"},
    )
    report = model.diagnose(records, effects=["viscous*"])
    assert all(share <= 1.0 for p in report.places for _, share in p.resembles)
