"""How the let-off distance depends on what a slow press is.

The table of docs/validation/regulation.md.
"""

import pytest

from feltmb.run.quasistatic import simulated_press, static_let_off

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("speed", "gap"),
    [(1, 3.10), (3, 2.72), (5, 2.53), (8, 2.39), (10, 2.18), (12, 2.17), (20, 2.42)],
)
def test_simulated_press(action, speed, gap):
    assert 1e3 * simulated_press(action, speed=1e-3 * speed).closest == pytest.approx(gap, abs=0.05)


def test_a_quick_press_throws_the_hammer(action):
    assert simulated_press(action, speed=0.030).closest < 0.5e-3


def test_sharper_friction_ends_the_dependence_on_speed(action):
    sharp = action.with_values({"contacts.*.friction.threshold_speed": 1e-5})
    # The sharp step of the friction needs a tight tolerance: 1e-6 is 0.14 mm off at 3 mm/s.
    slow = simulated_press(sharp, speed=0.003, rtol=1e-8).closest
    fast = simulated_press(sharp, speed=0.010, rtol=1e-8).closest
    assert slow == pytest.approx(fast, abs=0.12e-3)
    assert 1e3 * fast == pytest.approx(2.13, abs=0.06)


@pytest.mark.parametrize(
    ("friction", "gap"), [("saturated", 2.92), ("breakaway", 2.09), ("none", 5.17)]
)
def test_press_without_inertia(action, friction, gap):
    found = static_let_off(action, friction=friction)
    assert 1e3 * found.gap == pytest.approx(gap, abs=0.05)


def test_rigid_members_change_little(action):
    rigid = action.with_values({"shank.rigid": True, "wire.rigid": True})
    assert simulated_press(rigid).closest == pytest.approx(
        simulated_press(action).closest, abs=0.1e-3
    )
    assert static_let_off(rigid).gap == pytest.approx(static_let_off(action).gap, abs=0.05e-3)


def test_a_millimeter_of_button_is_ten_of_let_off(action):
    y = action.value("surfaces.Gp10.point.y").value
    gaps = [
        simulated_press(action.with_values({"surfaces.Gp10.point.y": y + d})).closest
        for d in (-0.05e-3, 0.05e-3)
    ]
    assert (gaps[1] - gaps[0]) / 0.1e-3 == pytest.approx(-9.4, abs=0.5)
