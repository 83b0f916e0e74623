"""The actuator over the key in one system with the action."""

import numpy as np
import pytest

import feltmb
from feltmb.action.actuator import compose, load_actuator
from unmodeled.errors import InvalidParameter

RAMP = feltmb.torque_stroke([0.0, 0.06], [0.0, 3.0], duration=0.2)


@pytest.fixture(scope="module")
def coupled(rigid):
    return compose(rigid, "wood")


@pytest.fixture(scope="module")
def run(coupled):
    return feltmb.simulate(coupled, RAMP)


def test_torque_in_stroke_out(run):
    assert 2.0 < run.summary["impact_speed"] < 8.0
    assert run.energy["residual_relative"] < 1e-4
    assert "motor.torque" in run
    number = max(int(n[7:9]) for n in run.names if n.startswith("contact"))
    assert run["finger.force"] == pytest.approx(run[f"contact{number:02d}.force"])
    work = np.trapezoid(run["motor.torque"] * run["actuator.hub.rate"], run.time)
    assert run.energy["work_in"] == pytest.approx(work, rel=2e-3)


def test_the_arm_rests_on_the_key(rigid, coupled):
    """Gravity moment of arm and tip about the hub = finger force times the lever."""
    rest = coupled.rest_pose
    state = feltmb.evaluate(coupled, rest, np.zeros_like(rest)).contacts
    force = state["normal_force"].iloc[-1]
    wood = load_actuator("wood")
    weight = np.asarray(wood._core.beam.weight)[0]
    assert force == pytest.approx(9.81 * weight / wood.reach, rel=5e-3)
    moved = dict(zip(coupled.coordinates, rest, strict=True))
    before = dict(zip(rigid.coordinates, rigid.rest_pose, strict=True))
    assert moved["key.angle"] == pytest.approx(before["key.angle"], abs=1e-3)


def test_a_light_stiff_actuator_is_a_force(rigid):
    """Without inertia and flexibility the stroke is that of the force T / (a + L).

    A long hub, so that the finger goes straight down.
    """
    ghost = load_actuator("wood").with_values(
        {
            "hub.radius": 2.0,
            "hub.inertia": 1e-7,
            "arm.density": 1.0,
            "arm.young_modulus": 1e12,
            "tip.mass": 1e-6,
            "mount.pads.pulp.hunt_crossley.stiffness": 5e6,
            "gravity": 0.0,
        }
    )
    reach = ghost.reach
    force = feltmb.table_stroke(
        [0.0, 0.05, 0.14], [0.0, 0.0, 25.0], interpolation="linear", duration=0.2
    )
    torque = feltmb.torque_stroke([0.0, 0.05, 0.14], [0.0, 0.0, 25.0 * reach], duration=0.2)
    by_force = feltmb.simulate(rigid, force)
    by_torque = feltmb.simulate(compose(rigid, ghost), torque)
    assert by_torque.summary["impact_speed"] == pytest.approx(
        by_force.summary["impact_speed"], rel=5e-3
    )
    assert by_torque.summary["impact_time"] == pytest.approx(
        by_force.summary["impact_time"], abs=3e-4
    )


def test_a_heavy_hub_is_a_motion(rigid):
    """The hub's angle prescribed, and a hub of huge inertia that moves the same way."""
    t = np.linspace(0.0, 0.1, 101)
    angle = 0.09 * np.sin(0.5 * np.pi * np.clip(t / 0.08, 0.0, 1.0)) ** 2
    made = load_actuator("aluminum").with_values({"gravity": 0.0})
    moved = feltmb.simulate(compose(rigid, made), feltmb.motion_stroke(t, angle, of="motor"))
    heavy = made.with_values({"hub.inertia": 5.0})
    system = compose(rigid, heavy)
    profile = feltmb.motion_stroke(t, angle, of="motor").profile
    fine = np.linspace(0.0, 0.1, 2001)
    torque = (5.0 + made.rigid_inertia) * profile.acceleration(fine)
    driven = feltmb.simulate(system, feltmb.torque_stroke(fine, torque), max_step=1e-4)
    size = np.max(moved["finger.force"])
    error = driven["finger.force"] - np.interp(driven.time, moved.time, moved["finger.force"])
    assert np.sqrt(np.mean(error**2)) < 0.05 * size
    assert driven["key_front.y"] == pytest.approx(moved["key_front.y"], abs=2e-4)


def test_dampers_reach_the_mechanism(rigid):
    """One-sided: nothing while pressing, heat after; the ledger has it."""
    damped = feltmb.simulate(compose(rigid, load_actuator("wood").with_damper("one-sided")), RAMP)
    plain = feltmb.simulate(compose(rigid, "wood"), RAMP)
    hub = "joint.actuator.hub"
    assert plain.energy["dissipated"][hub] == pytest.approx(0.0, abs=1e-12)
    assert damped.energy["dissipated"][hub] > 1e-4
    assert damped.energy["residual_relative"] < 1e-4
    assert damped.summary["impact_speed"] == pytest.approx(plain.summary["impact_speed"], rel=0.02)


def test_pads(rigid):
    felt = feltmb.simulate(compose(rigid, "wood", pad="felt"), RAMP)
    assert felt.summary["impact_speed"] > 2.0
    with pytest.raises(InvalidParameter, match="pad 'silk' is unknown; pads are pulp, felt"):
        compose(rigid, "wood", pad="silk")


def test_what_cannot_be_composed(rigid, coupled):
    with pytest.raises(InvalidParameter, match=r"has a motor already; .* uses the names act"):
        compose(coupled, "wood")
    bare = load_actuator("wood").raw
    del bare["mount"]
    with pytest.raises(InvalidParameter, match=r"has no \[mount\]"):
        compose(rigid, type(load_actuator("wood"))(bare))
    with pytest.raises(InvalidParameter, match="is a force of a finger, but a motor presses"):
        feltmb.simulate(coupled, "forte")


def test_a_motor_whose_arm_swings_round_is_told(run, coupled):
    assert not [w for w in run.stats["warnings"] if "swings round" in w]
    lifted = feltmb.simulate(coupled, feltmb.torque_stroke([0.0, 0.01], [0.0, -3.0], duration=0.1))
    angle = lifted["actuator.hub"]
    assert np.abs(angle - angle[0]).max() > np.pi / 4
    found = [w for w in lifted.stats["warnings"] if "swings round" in w]
    assert len(found) == 1
    assert found[0].startswith("actuator.hub turns by ")
