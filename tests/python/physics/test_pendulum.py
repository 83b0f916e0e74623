"""A second mechanism from its own file: closed forms of a pendulum and of its strike on felt."""

import numpy as np
import pytest
from scipy.special import ellipk

import feltmb

MASS, ARM, INERTIA = 20e-3, 0.1, 12e-6  # kg, m, kg m^2 about the center of mass
ABOUT_PIVOT = INERTIA + MASS * ARM**2
REACH = 0.15  # m, pivot to the middle of the head
STILL = feltmb.ramp_stroke(0.0, duration=1.0)


@pytest.fixture(scope="module")
def swing(pendulum):
    """Without the felt block."""
    return pendulum.with_values({"contacts.01.enabled": False})


def test_hangs_against_the_felt(pendulum):
    """Moment of gravity about the pivot = moment of the felt's force."""
    (angle,) = pendulum.rest_pose
    row = feltmb.evaluate(pendulum, [angle], [0.0]).contacts.loc[1]
    lever = REACH * np.cos(angle)
    moment = -MASS * 9.81 * ARM * np.sin(angle)
    assert row["compression"] > 0.0
    assert row["normal_force"] * lever == pytest.approx(moment, rel=1e-9)


@pytest.mark.parametrize("amplitude", [0.01, 0.5, 1.5, 3.0])
def test_period_of_the_free_pendulum(swing, state_of, amplitude):
    """Complete elliptic integral, also close to the upper equilibrium."""
    exact = 4.0 * np.sqrt(ABOUT_PIVOT / (MASS * 9.81 * ARM)) * ellipk(np.sin(amplitude / 2.0) ** 2)
    run = feltmb.simulate(
        swing, STILL, duration=1.02 * exact, rtol=1e-10, start=state_of(swing, [amplitude], [0.0])
    )
    angle = run["arm.angle"]
    down = np.nonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))[0][0]
    up = np.nonzero((angle[:-1] <= 0.0) & (angle[1:] > 0.0))[0][0]

    def crossing(i):
        return np.interp(0.0, sorted(angle[i : i + 2]), sorted_times(i))

    def sorted_times(i):
        pair = run.time[i : i + 2]
        return pair if angle[i] <= angle[i + 1] else pair[::-1]

    assert 2.0 * (crossing(up) - crossing(down)) == pytest.approx(exact, rel=1e-6)
    assert np.max(np.abs(angle)) == pytest.approx(amplitude, rel=1e-7)


def test_energy_of_the_free_pendulum(swing, state_of):
    run = feltmb.simulate(swing, STILL, rtol=1e-10, start=state_of(swing, [2.0], [0.0]))
    kinetic = 0.5 * ABOUT_PIVOT * run["arm.angle.rate"] ** 2
    height = 0.5 - ARM * np.cos(run["arm.angle"])
    assert run["energy.kinetic"] == pytest.approx(kinetic, rel=1e-12)
    assert run["energy.gravity"] == pytest.approx(MASS * 9.81 * height, rel=1e-12)
    total = kinetic + MASS * 9.81 * height
    assert np.ptp(total) < 3e-8 * np.ptp(kinetic)


def test_blow_on_elastic_felt(pendulum, state_of):
    """Without hysteresis the speed comes back, and the felt's depth follows from the energy."""
    felt = pendulum.with_values(
        {
            "contacts.01.law": "hunt_crossley",
            "contacts.01.hunt_crossley": {"stiffness": 2e6, "exponent": 2.0, "damping": 0.0},
            "gravity": [0.0, -1e-4],
        }
    )
    speed = 20.0  # rad/s
    run = feltmb.simulate(
        felt, STILL, duration=0.05, rtol=1e-9, start=state_of(felt, [-0.1], [speed]),
        output_rate=200e3,
    )  # fmt: skip
    assert run["arm.angle.rate"][-1] == pytest.approx(-speed, rel=1e-6)
    deepest = (3.0 * 0.5 * ABOUT_PIVOT * speed**2 / 2e6) ** (1.0 / 3.0)
    assert np.max(run["contact01.compression"]) == pytest.approx(deepest, rel=1e-5)
    assert np.max(run["contact01.force"]) == pytest.approx(2e6 * deepest**2, rel=2e-5)


def test_blow_on_real_felt_loses_what_the_ledger_says(pendulum, state_of):
    run = feltmb.simulate(
        pendulum, STILL, duration=0.03, rtol=1e-10, start=state_of(pendulum, [-0.05], [4.0])
    )
    total = run["energy.kinetic"] + run["energy.gravity"] + run["energy.contact"]
    lost = run.energy["dissipated"]["contact01.normal"]
    assert lost > 0.1 * run["energy.kinetic"][0]
    assert total[0] - total[-1] == pytest.approx(lost, rel=1e-7)
    assert list(run.events["event"])[:2] == ["felt_on", "felt_off"]


def test_finger_force_does_work_and_lifts(pendulum):
    """A slow push holds the head where the moments balance."""
    run = feltmb.simulate(pendulum, feltmb.ramp_stroke(0.05, 0.1, 2.0), duration=12.0, rtol=1e-7)
    late = run.time > 10.0
    mean = np.mean(run["arm.angle"][late])
    moment = 0.05 * 0.12 * np.cos(mean)
    assert -MASS * 9.81 * ARM * np.sin(mean) == pytest.approx(moment, rel=2e-2)
    assert run.energy["residual_relative"] < 1e-4
    assert "head_away_time" in run.summary


def test_finger_motion_pushes_through_the_pad(pendulum):
    stroke = feltmb.motion_stroke([0.0, 0.3, 0.6], [0.0, 0.02, 0.02])
    run = feltmb.simulate(pendulum, stroke, rtol=1e-8)
    pad = 0.02 - run["finger.displacement"][-1]
    held = run["finger.force"][-1]
    assert run["finger.force"][0] == 0.0
    assert held == pytest.approx(1e5 * pad**1.5, rel=1e-2)
    assert run.energy["residual_relative"] < 1e-6


def test_moved_and_turned_world(pendulum):
    """The same motion wherever the machine stands and whichever way it is turned."""
    turn, shift = 0.7, np.array([3.0, -2.0])
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(x, y):
        return [float(v) for v in matrix @ [x, y] + shift]

    def turned(x, y):
        return [float(v) for v in matrix @ [x, y]]

    other = pendulum.with_values(
        {
            "gravity": turned(0.0, -9.81),
            "bodies.arm.position": moved(0.0, 0.5),
            "bodies.arm.angle": turn,
            "surfaces.block.point": {"value": moved(9e-3, 0.35), "unit": "m"},
            "surfaces.block.normal": turned(-1.0, 0.0),
            "finger.direction": turned(-1.0, 0.0),
            "events.head_away.direction": turned(-1.0, 0.0),
        }
    )
    stroke = feltmb.pulse_stroke(0.5, duration=0.5)
    a = feltmb.simulate(pendulum, stroke, rtol=1e-9)
    b = feltmb.simulate(other, stroke, rtol=1e-9)
    assert np.max(np.abs(a["arm.angle"])) > 0.05
    assert np.max(np.abs(a["arm.angle"] - b["arm.angle"])) < 1e-7
    assert np.max(np.abs(a["contact01.force"] - b["contact01.force"])) < 1e-3


def test_mirrored_world(pendulum):
    mirrored = pendulum.with_values(
        {
            "surfaces.block.point": [-9e-3, 0.35],
            "surfaces.block.normal": [1.0, 0.0],
            "finger.direction": [1.0, 0.0],
            "events.head_away.direction": [1.0, 0.0],
        }
    )
    stroke = feltmb.pulse_stroke(0.5, duration=0.5)
    a = feltmb.simulate(pendulum, stroke, rtol=1e-9)
    b = feltmb.simulate(mirrored, stroke, rtol=1e-9)
    assert np.max(np.abs(a["arm.angle"] + b["arm.angle"])) < 1e-7
