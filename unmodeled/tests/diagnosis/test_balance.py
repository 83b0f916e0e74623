"""Candidates of a force balance: memory along a measured motion, and a damper with a clearance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled import Verdict, diagnose, library
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit import Coordinate, LinearModel, Named, Parameter
from unmodeled.library.balance import MEMORY, slip_along

TIME = np.linspace(0.0, 2.0, 1601)


def moving(t):
    """Position and speed of a motion with reversals at several levels."""
    q = 4e-3 * np.sin(9.0 * t) + 2e-3 * np.sin(23.0 * t)
    return q, 36e-3 * np.cos(9.0 * t) + 46e-3 * np.cos(23.0 * t)


@pytest.mark.parametrize("sharpness", [1.0, 2.0, 10.0])
def test_the_slip_along_a_motion_is_the_integral_of_its_rate(sharpness):
    drive = Coordinate(name="drive", position="q", speed="v")
    rate = library.hysteresis(drive, scale=1.0, travel=0.01).rate
    stretch = 1.5e-3

    def slip(t, z):
        q, v = moving(t)
        x = Named({"q": q, "v": v, "hysteresis.slip": z[0]})
        return [rate(t, x, Named({}), Named({}), 1.0, (stretch, sharpness))["hysteresis.slip"]]

    exact = solve_ivp(slip, (0.0, 2.0), [0.0], t_eval=TIME, rtol=1e-8, atol=1e-10, max_step=1e-3)
    found = slip_along(moving(TIME)[0], stretch, sharpness)
    assert np.max(np.abs(exact.y[0])) > 2e-3
    assert found == pytest.approx(exact.y[0], abs=2e-6)


def test_a_sharp_slip_is_a_play():
    q = moving(TIME)[0]
    play = np.zeros(q.size)
    for i in range(1, q.size):
        play[i] = np.clip(play[i - 1], q[i] - 1.5e-3, q[i] + 1.5e-3)
    assert slip_along(q, 1.5e-3, 400.0) == pytest.approx(play, abs=2e-5)


def test_the_memory_does_not_depend_on_the_number_of_samples():
    q = moving(TIME)[0]
    coarse = np.interp(TIME, TIME[::8], q[::8])  # the same straight lines
    assert slip_along(coarse, 1.5e-3, 2.0)[::8] == pytest.approx(
        slip_along(q[::8], 1.5e-3, 2.0), abs=1e-8
    )


def test_the_relaxation_along_a_motion_has_its_closed_form():
    tau, w = 0.05, 9.0
    exact = (np.sin(w * TIME) - w * tau * np.cos(w * TIME) + w * tau * np.exp(-TIME / tau)) / (
        1.0 + (w * tau) ** 2
    )
    found = MEMORY["creep.stretch"](TIME, np.sin(w * TIME), tau)
    assert found == pytest.approx(exact, abs=2e-5)


def rig(name, force, role="fit"):
    generator = np.random.default_rng(sum(map(ord, name)))
    a, w = generator.uniform(3e-3, 6e-3), generator.uniform(6.0, 25.0)
    q = a * np.sin(w * TIME) * (1.0 + 0.5 * np.sin(2.0 * TIME))
    v = np.gradient(q, TIME)
    sensors = {"force": Sensor(name="force", unit="N", sigma=0.3)}
    total = 2000.0 * q + 300.0 * v + force(q, v) + 0.3 * generator.standard_normal(q.size)
    return Record(
        name=name,
        time=TIME,
        inputs={"q": q, "v": v},
        outputs={"force": total},
        sensors=sensors,
        input_mode="motion",
        role=role,
    )


DAMPER = LinearModel(
    name="damper",
    output="force",
    columns={"k": lambda r: r.inputs["q"], "d": lambda r: r.inputs["v"]},
    parameters=[
        Parameter(name="k", value=2000.0, sd=200.0, unit="N/m"),
        Parameter(name="d", value=300.0, sd=60.0, unit="N s/m"),
    ],
)


def play_of(q, width):
    z = np.zeros(q.size)
    for i in range(1, q.size):
        z[i] = np.clip(z[i - 1], q[i] - width, q[i] + width)
    return z


CAUSES = {
    "clearance of damper": lambda q, v: 300.0 * np.gradient(play_of(q, 7e-4), TIME) - 300.0 * v,
    "hysteresis": lambda q, v: 8.0 * (q - play_of(q, 6e-4)) / 6e-4,
    "creep": lambda q, v: 900.0 * (q - MEMORY["creep.stretch"](TIME, q, 0.2)),
    "dead zone": lambda q, v: -0.6 * 2000.0 * np.clip(q, -8e-4, 8e-4),
    "constant force": lambda q, v: np.full(q.size, 3.0),
}


MAGNITUDES = {
    "clearance of damper": 1.0,
    "hysteresis": 8.0,
    "creep": 900.0,
    "dead zone": 0.6 * 2000.0,
    "constant force": 3.0,
}


#: The page on test rigs finds it too.
SLOW = ("clearance of damper",)


@pytest.mark.parametrize(
    "cause", [pytest.param(c, marks=pytest.mark.slow) if c in SLOW else c for c in CAUSES]
)
def test_a_damper_on_a_test_rig_gets_effects_with_memory(cause):
    """Independent recursions make the force; clearance and hysteresis are sharp in them."""
    roles = ("fit", "fit", "held_out")
    records = [rig(f"run{i}", CAUSES[cause], role) for i, role in enumerate(roles)]
    effects = library.for_force_balance(
        "q", "v", force=15.0, travel=5e-3, pace=0.06, stiffness=2000.0, damping=300.0
    )
    report = diagnose(DAMPER, effects, records)
    assert report.verdict in (Verdict.NAMED, Verdict.ONE_OF)
    told = [*report.named, *(n for group in report.classes for n in group)]
    (found,) = [n for n in told if n.cause == cause]
    assert found.magnitude == pytest.approx(MAGNITUDES[cause], rel=0.1)


def test_a_dead_zone_needs_a_spring_and_a_clearance_a_damper():
    typical = {"force": 15.0, "travel": 5e-3, "pace": 0.06}
    plain = [e.name for e in library.for_force_balance("q", "v", **typical)]
    assert not {"dead zone", "clearance of damper"} & {*plain}
    more = library.for_force_balance("q", "v", **typical, stiffness=2000.0, damping=300.0)
    assert {e.name for e in more} - {*plain} == {"dead zone", "clearance of damper"}


def test_the_noise_of_a_position_does_not_reduce_the_damping():
    """With plain differences, a clean rig had "creep", and a seventh of its damping."""
    model = LinearModel(
        name="damper",
        output="force",
        columns={"k": lambda r: r.inputs["q"], "d": lambda r: library.speed_of(r, "q")},
        parameters=DAMPER.parameters,
    )
    records = []
    for i, role in enumerate(("fit", "fit", "held_out")):
        run = rig(f"noisy{i}", lambda q, v: 0.0 * q, role)
        noise = 4e-6 * np.random.default_rng(i).standard_normal(TIME.size)
        records.append(replace(run, inputs={"q": run.inputs["q"] + noise}))
    effects = library.for_force_balance("q", force=15.0, travel=5e-3, pace=0.06)
    report = diagnose(model, effects, records)
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    assert {p.name: p.value for p in report.parameters}["d"] == pytest.approx(300.0, rel=0.01)
    with pytest.raises(InvalidParameter, match="no input 'speed'"):
        library.speed_of(records[0], "speed")
    with pytest.raises(InvalidParameter, match="no input 'y'"):
        library.for_force_balance("y", force=1.0, travel=1.0, pace=1.0)[0].regressor(run, 0.1)
    with pytest.raises(InvalidParameter, match=r"pace = 0\.0, .*; stiffness = -5\.0, expected"):
        library.for_force_balance("q", force=1.0, travel=1.0, pace=0.0, stiffness=-5.0)
