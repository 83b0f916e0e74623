"""Prescribed motion: the reaction is exact, whatever the mechanism does beside it."""

import numpy as np
import pytest

import feltmb
from unmodeled.errors import InvalidParameter

MASS, ARM, INERTIA = 20e-3, 0.1, 12e-6  # of the pendulum: kg, m, kg m^2 about the center of mass
ABOUT_PIVOT = INERTIA + MASS * ARM**2


def swing_of(amplitude=0.4, duration=0.5):
    """A smooth there and back, at rest at both ends, with its exact second derivative."""
    t = np.linspace(0.0, duration, 201)
    w = 2.0 * np.pi / duration
    angle = amplitude * (1.0 - np.cos(w * t)) ** 2 / 4.0
    return t, angle


@pytest.fixture(scope="module")
def motor(pendulum):
    """The pendulum without its felt, with a motor on its axis."""
    return pendulum.with_values(
        {"contacts.01.enabled": False, "motor": {"coordinate": "arm.angle"}}
    )


def test_torque_of_a_prescribed_angle(motor):
    """Closed form: T = I q'' + m g l sin q."""
    t, angle = swing_of()
    stroke = feltmb.motion_stroke(t, angle, of="motor")
    run = feltmb.simulate(motor, stroke, rtol=1e-8)
    q = run["arm.angle"]
    assert q == pytest.approx(stroke.at(run.time) + q[0], abs=5e-8)
    acceleration = stroke.profile.acceleration(run.time)
    exact = ABOUT_PIVOT * acceleration + MASS * 9.81 * ARM * np.sin(q)
    assert run["motor.torque"] == pytest.approx(exact, abs=3e-5 * np.max(np.abs(exact)))
    assert run.energy["residual_relative"] < 1e-6


def test_torque_drives_what_the_motion_took(motor):
    """Back again: the reaction as torque input gives the motion."""
    t, angle = swing_of()
    moved = feltmb.simulate(
        motor, feltmb.motion_stroke(t, angle, of="motor"), rtol=1e-9, output_rate=2000
    )
    torque = feltmb.torque_stroke(moved.time, moved["motor.torque"], interpolation="monotone")
    driven = feltmb.simulate(motor, torque, rtol=1e-9, output_rate=2000)
    assert driven["arm.angle"] == pytest.approx(moved["arm.angle"], abs=2e-5)


def test_force_at_a_prescribed_point(pendulum):
    """The point under the finger moves along one direction; the arm turns as geometry demands."""
    free = pendulum.with_values({"contacts.01.enabled": False})
    t, way = swing_of(0.02)
    stroke = feltmb.motion_stroke(t, way, of="key")
    run = feltmb.simulate(free, stroke, rtol=1e-9)
    lever = 0.12
    q = run["arm.angle"]
    assert -lever * np.sin(q) == pytest.approx(stroke.at(run.time), abs=5e-9)
    # -l cos q q' = x', so q'' = (-x''/l + sin q q'^2) / cos q; F (-l cos q) = I q'' + m g l_s sin q
    rate = run["arm.angle.rate"]
    second = (-stroke.profile.acceleration(run.time) / lever + np.sin(q) * rate**2) / np.cos(q)
    moment = ABOUT_PIVOT * second + MASS * 9.81 * ARM * np.sin(q)
    exact = -moment / (lever * np.cos(q))
    assert run["finger.force"] == pytest.approx(exact, abs=1e-5 * np.max(np.abs(exact)))


def test_force_to_motion_to_force(action):
    """The forte stroke, driven by the motion of its own key: the same force, strike and work.

    The key turns and lifts (two coordinates), so the motion of its front fixes neither alone.
    """
    by_force = feltmb.simulate(action, "forte", rtol=1e-8)
    travel = by_force["finger.displacement"]
    stroke = feltmb.motion_stroke(by_force.time, travel - travel[0], of="key")
    run = feltmb.simulate(action, stroke, rtol=1e-7)
    assert run["finger.displacement"] == pytest.approx(travel, abs=2e-8)
    error = run["finger.force"] - by_force["finger.force"]
    # Where the force jumps in slope, a spline through samples of 0.1 ms rings for one of them.
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.median(np.abs(error)) < 1e-3
    for key, room in (("impact_speed", 2e-5), ("key_start_time", 1e-4), ("max_impact_force", 2e-3)):
        assert run.summary[key] == pytest.approx(by_force.summary[key], rel=room)
    assert run.energy["work_in"] == pytest.approx(by_force.energy["work_in"], rel=1e-4)
    assert run.energy["residual_relative"] < 1e-4


def test_the_key_may_lift_under_a_prescribed_front(rigid):
    """A fast release: the finger's point goes up as told, the key's pivot leaves its pin."""
    press = feltmb.simulate(rigid, "press_release", rtol=1e-7)
    travel = press["finger.displacement"]
    stroke = feltmb.motion_stroke(press.time, travel - travel[0], of="key")
    run = feltmb.simulate(rigid, stroke, rtol=1e-7)
    assert np.max(press["key.lift"]) - press["key.lift"][0] > 5e-5
    assert run["key.lift"] == pytest.approx(press["key.lift"], abs=3e-5)
    assert run["finger.displacement"] == pytest.approx(travel, abs=2e-8)


def test_pad_and_prescribed_key_agree_when_the_pad_is_hard(rigid):
    """A stiffer and stiffer pad goes to the exact reaction."""
    t = np.linspace(0.0, 0.12, 121)
    down = 5e-3 * np.sin(0.5 * np.pi * np.clip((t - 0.01) / 0.1, 0.0, 1.0)) ** 2
    exact = feltmb.simulate(rigid, feltmb.motion_stroke(t, down, of="key"), rtol=1e-7)
    errors = []
    for stiffness in (1e4, 1e5, 1e6):  # N/m; a harder one rattles
        pad = {"stiffness": stiffness, "exponent": 1.0, "damping": 20.0}
        other = rigid.with_values({f"finger.pad.{key}": value for key, value in pad.items()})
        run = feltmb.simulate(
            other, feltmb.motion_stroke(t, down, interpolation="spline"), rtol=1e-7
        )
        errors.append(np.sqrt(np.mean((run["finger.force"] - exact["finger.force"]) ** 2)))
    assert errors[0] > 3.0 * errors[1] > 6.0 * errors[2]
    assert errors[2] < 0.03  # N, of 10


def test_a_motion_that_starts_with_a_jolt_is_refused(rigid):
    t = np.linspace(-0.05, 0.1, 151)
    stroke = feltmb.motion_stroke(t, 0.1 * (t + 0.05), of="key")
    with pytest.raises(InvalidParameter, match=r"starts with 0\.1 m/s, the mechanism with 0"):
        feltmb.simulate(rigid, stroke)


def test_a_motor_input_needs_a_motor(rigid):
    with pytest.raises(InvalidParameter, match=r"describes no motor; compose it"):
        feltmb.simulate(rigid, feltmb.torque_stroke([0.0, 0.1], [0.0, 1.0]))


def test_noise_of_a_record_is_seen_and_smoothed(rigid):
    t = np.linspace(0.0, 0.1, 401)
    down = 8e-3 * np.sin(0.5 * np.pi * np.clip((t - 0.02) / 0.07, 0.0, 1.0)) ** 2
    noisy = down + 3e-6 * np.random.default_rng(4).standard_normal(t.size)
    stroke = feltmb.motion_stroke(t, noisy, of="key")
    assert stroke.noise == pytest.approx(3e-6, rel=0.2)
    rough = feltmb.simulate(rigid, stroke, rtol=1e-6, ledger=False)
    smooth = feltmb.simulate(rigid, stroke.smoothed(3e-6), rtol=1e-6, ledger=False)
    clean = feltmb.simulate(rigid, feltmb.motion_stroke(t, down, of="key"), rtol=1e-6, ledger=False)
    assert any("mostly noise" in w for w in rough.stats["warnings"])
    assert not any("mostly noise" in w for w in smooth.stats["warnings"])
    early = rough.time < 0.085  # before the key meets the ground
    size = [np.std((r["finger.force"] - clean["finger.force"])[early]) for r in (rough, smooth)]
    assert size[1] < 0.1 * size[0]
    assert smooth.stats["warnings"] == clean.stats["warnings"]
