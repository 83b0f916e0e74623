"""Slow presses: friction and dashpots against formulas by hand."""

import math

import numpy as np
import pytest

from feltmb import load_action
from feltmb.run.quasistatic import SlowPress, simulated_press
from unmodeled.errors import InvalidParameter

LEVER = """
schema = 1
name = "lever"
gravity = [0.0, 0.0]

[bodies.lever]
coordinate = "turn"
position = [0.0, 0.0]
mass = { value = 0.1, unit = "kg" }
inertia = { value = 1.0e-4, unit = "kg m^2" }
friction = { amplitude = "0.02 N m", b1 = 0.5, b2 = 2.0, threshold_speed = "1e-4 rad/s" }

[springs.lever]
coordinate = "turn"
stiffness = "2 N m/rad"
rest_angle = "0 rad"

[finger]
body = "lever"
point = [0.2, 0.0]
"""


ARM = 0.2


@pytest.fixture(scope="module")
def lever(tmp_path_factory):
    path = tmp_path_factory.mktemp("lever") / "lever.toml"
    path.write_text(LEVER)
    return load_action(path)


def _force(action, travel, *, speed, friction="law"):
    press = SlowPress(action, speed=speed, friction=friction)
    for part in np.linspace(0.0, travel, 21)[1:]:
        press.advance(float(part))
    return press.force, press.q[0]


@pytest.mark.parametrize("speed", [1e-3, 0.010, 0.03])
@pytest.mark.parametrize(
    ("candidate", "torque"),
    [
        ({}, lambda _: 0.0),
        ({"viscous": 0.3}, lambda w: 0.3 * w),
        ({"quadratic": 4.0}, lambda w: 4.0 * w**2),
        ({"stribeck": 0.05, "stribeck_speed": 0.05}, lambda w: 0.05 * math.exp(-((w / 0.05) ** 2))),
    ],
)
def test_every_candidate_of_friction_acts_in_a_slow_press(lever, speed, candidate, torque):
    """By hand: F a cos(turn) = k turn + A + the term, at the joint's speed v / (a cos(turn))."""
    action = lever.with_values({f"bodies.lever.friction.{k}": v for k, v in candidate.items()})
    for mode in ("law", "saturated"):
        force, turn = _force(action, 0.004, speed=speed, friction=mode)
        arm = ARM * math.cos(turn)
        rate = speed / arm
        expected = (2.0 * abs(turn) + 0.02 + torque(rate)) / arm
        assert force == pytest.approx(expected, rel=2e-4), mode


@pytest.mark.parametrize(
    "values",
    [
        {"springs.lever.damping": 0.3},
        {"dashpots": {"slow": {"coordinate": "turn", "coefficient": "0.3 N m s/rad"}}},
    ],
)
def test_dashpots_and_damped_springs_act_in_a_slow_press(lever, values, tmp_path):
    text = LEVER
    if "dashpots" in values:
        text += '\n[dashpots.slow]\ncoordinate = "turn"\ncoefficient = "0.3 N m s/rad"\n'
    else:
        text = text.replace('stiffness = "2 N m/rad"', 'stiffness = "2 N m/rad"\ndamping = 0.3')
    path = tmp_path / "lever.toml"
    path.write_text(text)
    action = load_action(path)
    for mode, part in (("law", 1.0), ("saturated", 1.0), ("none", 0.0), ("breakaway", 0.0)):
        without, _ = _force(lever, 0.004, speed=0.01, friction=mode)
        force, turn = _force(action, 0.004, speed=0.01, friction=mode)
        arm = ARM * math.cos(turn)
        assert force - without == pytest.approx(part * 0.3 * 0.01 / arm**2, abs=2e-4 * force)


def test_breakaway_holds_what_eq_a1_and_stribeck_hold_at_most(lever):
    action = lever.with_values(
        {"bodies.lever.friction.stribeck": 0.01, "bodies.lever.friction.viscous": 9.0}
    )
    f = action.config.bodies["lever"].friction
    v = np.linspace(0.0, 1e-3, 1_000_001)
    x = v / f.threshold_speed
    dry = f.amplitude * (np.tanh(x) + f.b1 * x / (1.0 + f.b2 * x**4))
    dry = dry + f.stribeck * np.exp(-((v / f.stribeck_speed) ** 2)) * np.tanh(x)
    force, turn = _force(action, 0.004, speed=0.01, friction="breakaway")
    assert force * ARM * math.cos(turn) - 2.0 * abs(turn) == pytest.approx(dry.max(), rel=1e-4)
    # The bump of eq. A.1 is looked for where it is, however far from the threshold.
    far = lever.with_values({"bodies.lever.friction.b2": 1e-6})
    force, turn = _force(far, 0.004, speed=0.01, friction="breakaway")
    top = (3e-6) ** -0.25
    bump = 0.02 * (1.0 + 0.5 * top / (1.0 + 1e-6 * top**4))
    assert force * ARM * math.cos(turn) - 2.0 * abs(turn) == pytest.approx(bump, rel=1e-3)


def test_friction_that_grows_without_end_has_no_breakaway_value(lever):
    with pytest.raises(InvalidParameter, match=r"bodies\.lever\.friction.*b2 = 0"):
        SlowPress(lever.with_values({"bodies.lever.friction.b2": 0.0}), friction="breakaway")


@pytest.mark.slow
@pytest.mark.parametrize("candidate", [{"viscous": 0.3}, {"quadratic": 5.0}])
def test_a_slow_press_without_inertia_feels_what_a_simulated_one_feels(candidate):
    action = load_action("steinway45").with_values(
        {f"bodies.key.friction.{k}": v for k, v in candidate.items()}
    )
    simulated = simulated_press(action, travel=0.006)
    force, _ = _force(action, 0.004, speed=0.010)
    assert force == pytest.approx(np.interp(0.004, simulated.travel, simulated.force), rel=3e-3)
