"""The rest pose: minimum of the energy found by another method, reached by settling, and kept."""

import numpy as np
import pytest
from scipy.optimize import minimize

import feltmb


@pytest.fixture(scope="module")
def action(rigid):
    """Rigid members: these tests are not about the members."""
    return rigid


STILL = feltmb.ramp_stroke(0.0, duration=0.5)
JOINTS = ("balance_slider", "key", "whippen", "jack", "butt", "damper")


def without_friction(action, values=None):
    joints = {f"bodies.{name}.friction.amplitude": 0.0 for name in JOINTS}
    return action.with_values({"contacts.*.friction.amplitude": 0.0, **joints, **(values or {})})


def test_known_rest_pose(action):
    """As found by the independent trial model of the design."""
    known = [-7.8236e-5, 0.0409638, -0.0850183, 0.2848430, -0.4714884, -0.0358386]
    assert np.all(np.abs(action.rest_pose - known) < 1e-7)


@pytest.mark.parametrize("members", ["rigid", "flexible"])
def test_no_force_at_rest(action, members):
    if members == "flexible":
        action = feltmb.load_action("steinway45")
    point = feltmb.evaluate(action, action.rest_pose, np.zeros(len(action.coordinates)))
    scale = np.array(action.mechanism.coordinate_scale)
    assert np.max(np.abs(point.force) * scale) < 1e-12
    assert action.equilibrium["residual"] < 1e-12


def test_independent_minimization(action):
    """Potential energy by integrating the generalized force along a line, minimized by scipy."""
    scale = np.array(action.mechanism.coordinate_scale)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    rest = action.rest_pose

    def force(q):
        return feltmb.evaluate(action, q, np.zeros(6)).force

    def energy(x):
        # Work against the forces on the straight way from rest; the felts are in the path.
        d = x * scale
        along = [force(rest + 0.5 * (1 + s) * d) @ d for s in nodes]
        return -0.5 * float(np.dot(weights, along))

    rng = np.random.default_rng(3)
    for _ in range(3):
        start = rng.normal(size=6) * 0.3
        found = minimize(
            energy,
            start,
            jac=lambda x: -force(rest + x * scale) * scale,
            method="BFGS",
            options={"gtol": 1e-13, "maxiter": 2000},
        )
        assert np.all(np.abs(found.x) < 2e-4)  # of 1 mm of felt
    for _ in range(50):
        assert energy(rng.normal(size=6) * 10.0 ** rng.uniform(-3, 0)) >= 0.0


def test_start_pose_does_not_matter(action):
    for change in ({"hammer.angle": -0.44}, {"jack.angle": 0.27}, {"key.angle": 0.03}):
        values = {f"start_pose.{name}": value for name, value in change.items()}
        other = action.with_values(values)
        assert np.all(np.abs(other.rest_pose - action.rest_pose) < 1e-9)


def test_settling_ends_at_rest(action, state_of):
    """Let go beside the rest pose, without friction (which creeps): the felts damp it down."""
    free = without_friction(action, {"contacts.*.alpha": 10.0})
    rest = free.rest_pose
    moved = rest + 0.3 * np.array(free.mechanism.coordinate_scale)
    run = feltmb.simulate(
        free, STILL, duration=6.0, rtol=1e-6, start=state_of(free, moved, np.zeros(6)),
        output_rate=200.0, events=False, ledger=False,
    )  # fmt: skip
    q = np.stack([run[name] for name in free.coordinates], axis=1)
    away = np.max(np.abs(q - rest) / np.array(free.mechanism.coordinate_scale), axis=1)
    assert away[0] > 0.25
    assert away[-1] < 0.05
    assert np.max(away[-200:]) < 0.2 * np.max(away[:200])


def test_at_rest_stays_put(action):
    run = feltmb.simulate(action, STILL, duration=2.0, rtol=1e-8)
    scale = np.array(action.mechanism.coordinate_scale)
    q = np.stack([run[name] for name in action.coordinates], axis=1)
    assert np.max(np.abs(q - q[0]) / scale) < 1e-6
    assert not run.summary.get("impact_time")
    assert len(run.events) == 0


def test_rest_under_a_held_finger_force(action):
    """A held force gives a pose where it is balanced."""
    from feltmb import _core

    found = _core.find_equilibrium(action.mechanism, 0.4)
    point = feltmb.evaluate(action, found["q"], np.zeros(6), finger_force=0.4)
    scale = np.array(action.mechanism.coordinate_scale)
    assert np.max(np.abs(point.force) * scale) < 1e-12
    assert found["q"][1] < action.rest_pose[1]


def test_a_body_without_support_is_reported(data):
    hammer = feltmb.load_action(data / "hammer_string.toml")
    free = hammer.with_values({"contacts.02.enabled": False, "gravity": [-9.81, 0.0]})
    with pytest.raises(feltmb.ModelError, match=r"no rest pose .*hammer\.x = .* still feels .* N;"):
        feltmb.simulate(free, STILL)
