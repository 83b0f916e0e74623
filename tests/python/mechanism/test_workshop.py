"""Leads, screws by name, strike weight and key ratio, against formulas by hand."""

from __future__ import annotations

import math
import re

import pytest

import feltmb
import feltmb.action.regulate
import feltmb.action.touch
from feltmb.mechanism.to_core import describe, with_leads
from feltmb.mechanism.workshop import key_ratio, strike_weight
from unmodeled.errors import InvalidParameter


def _key(action):
    return next(b for b in describe(action.config).bodies if b.name == "key")


def test_leads_change_mass_center_and_inertia(action):
    loaded = action.with_values({"lead": ["14 g at 190 mm", "5 g at 100 mm"]})
    key = _key(loaded)
    m, x, inertia = 0.1176, -0.0463, 1741e-6
    total = m + 0.014 + 0.005
    center = (m * x + 0.014 * 0.190 + 0.005 * 0.100) / total
    moved = m * (x - center) ** 2 + 0.014 * (0.190 - center) ** 2 + 0.005 * (0.1 - center) ** 2
    assert key.mass == pytest.approx(total)
    assert key.center_of_mass == pytest.approx((center, 0.0131))
    assert key.inertia == pytest.approx(inertia + moved)
    assert _key(action).mass == 0.1176  # the given action is as it was


def test_height_of_a_lead_and_an_added_one():
    action = feltmb.load_action("steinway45_leaded")
    high = action.with_values({"leads.front.height": "30 mm", "lead": "3 g at 50 mm"})
    assert set(high.config.leads) == {"front", "middle", "added_1"}
    assert with_leads(high.config, "key").center_of_mass[1] == pytest.approx(
        0.0131 + 0.014 * (0.030 - 0.0131) / (0.1176 + 0.031)
    )
    assert len({action.hash, high.hash, feltmb.load_action("steinway45").hash}) == 3


def test_changed_key_keeps_its_leads():
    action = feltmb.load_action("steinway45_leaded").with_values({"bodies.key.mass": 0.1})
    assert _key(action).mass == pytest.approx(0.128)
    again = feltmb.Action(action.raw)
    assert again.hash == action.hash


def test_screws_by_name(action):
    turned = action.with_values({"capstan +=": "0.5 turn", "let-off button -=": "0.1 mm"})
    assert turned.value("surfaces.Kp2.point").value == pytest.approx((-0.141, 0.0326 + 0.35e-3))
    assert turned.value("surfaces.Gp10.point.y").value == pytest.approx(0.0769)
    bent = action.with_values({"backcheck wire +=": "1 deg", "hammer spring *=": 0.8})
    assert bent.value("bodies.wire.angle").value == pytest.approx(math.radians(76.5))
    assert bent.value("springs.butt_spring.stiffness").value == pytest.approx(0.784e-3)
    spoon = action.with_values({"damper_spoon +=": "1 mm"}).value("surfaces.Dp2.point").value
    assert math.dist(spoon, (0.0064, -0.051)) == pytest.approx(1e-3, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "turns"),
    [
        ("0,5turn", 0.5),
        ("3/4 turn", 0.75),
        ("1 1/2 turns", 1.5),
        ("90deg", 0.25),
        ("180°", 0.5),
        ("-1/4turn", -0.25),
    ],
)
def test_turns_as_a_technician_writes_them(action, text, turns):
    found, wanted = (
        action.with_values({"capstan +=": t}).value("surfaces.Kp2.point").value
        for t in (text, f"{turns}turn")
    )
    assert found == pytest.approx(wanted, abs=1e-12)


def test_every_amount_that_a_message_advises_works(action):
    with pytest.raises(InvalidParameter) as refused:
        action.with_values({"capstan +=": "half a turn"})
    advised = re.findall(r"capstan\+=([\w.]+)", str(refused.value).partition("such as")[2])
    assert len(advised) == 3
    for amount in advised:
        assert action.with_values({"capstan +=": amount}) is not action
    with pytest.raises(InvalidParameter, match="'0,35mm', expected a decimal point"):
        action.with_values({"capstan +=": "0,35mm"})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lead": "5 g"}, "5 g at 200 mm"),
        ({"lead": "5 g at 900 mm"}, "a place on the key; the finger presses it at 225 mm"),
        ({"capstan +=": "half turn"}, r"got .half turn., expected .*such as capstan\+=0.5turn"),
        ({"lead": "5 g at 2 N"}, r"leads\.added_1\.position.*does not measure"),
        ({"capstan": "3 mm"}, r"capstan\+=0\.5turn"),
        ({"punchings +=": "1 turn"}, "no thread"),
        ({"capstan +=": "3 N"}, "does not measure"),
        ({"capstan +=": "1 mm", "surfaces.Kp2.point.y +=": "1 mm"}, "changed twice"),
        ({"strike weight": "1 g"}, "below that without a head"),
        ({"leads": {"a": {"mass": 0.01, "position": 0.1, "body": "shank"}}}, "rigid body"),
        ({"screws.capstan.path": "surfaces.Kp9.point"}, r"screws\.capstan\.path.*Kp9"),
        ({"screws.backcheck_wire.direction": [1.0, 0.0]}, "a number has none"),
        ({"reading.weights.hammer": "but"}, "did you mean 'butt'"),
    ],
)
def test_faults_are_told(action, values, message):
    with pytest.raises(InvalidParameter, match=f"(?s){message}"):
        action.with_values(values)


def test_strike_weight_is_that_on_a_scale(action):
    # Level shank on its pin; the scale below the striking point, 122.2 mm from the pin.
    shank = 701.18 * 25.51e-6 * 0.093
    moment = 0.00758 * 0.0134 + shank * (0.032 + 0.0465) + 0.0078 * 0.125
    weight, radius = strike_weight(action.config)
    assert radius == pytest.approx(0.1222)
    assert weight == pytest.approx(moment / radius)
    lighter = action.with_values({"strike weight": "9 g"})
    assert strike_weight(lighter.config)[0] == pytest.approx(0.009)
    mass = 0.0078 - (weight - 0.009) * radius / 0.125
    assert lighter.value("bodies.head.mass").value == pytest.approx(mass)
    assert lighter.value("bodies.head.inertia").value == pytest.approx(3.1e-6 * mass / 0.0078)


def test_key_ratio_moves_the_capstan(action):
    assert key_ratio(action.config) == pytest.approx(141.0 / 225.0)
    moved = action.with_values({"key ratio": 0.6})
    assert moved.value("surfaces.Kp2.point").value == pytest.approx((-0.135, 0.0326))


@pytest.mark.slow
def test_leaded_action_is_regulated_and_weighs_as_technicians_want():
    found = feltmb.action.regulate.regulate("steinway45_leaded")
    rows = {row.name: row for row in found.table}
    assert found.converged
    assert all(row.turned == 0.0 for row in found.table)
    for name, value, tolerance in (
        ("lost motion", 0.1, 0.05),
        ("let-off", 2.5, 0.5),
        ("aftertouch", 1.5, 0.5),
        ("key dip", 10.0, 0.1),
        ("check distance", 15.0, 0.5),
    ):
        assert rows[name].after == pytest.approx(value, abs=tolerance)
    static = feltmb.action.touch.static_touch(found.action)
    gram = 9.80665e-3
    assert 50.0 < static.down_weight / gram < 55.0
    assert 20.0 < static.up_weight / gram < 25.0


def test_force_of_a_spring_at_rest(action):
    from feltmb.action.regulate.measuring import Bench
    from feltmb.action.regulate.targets import Step

    step = Step(
        name="hammer spring",
        measure="spring_force",
        spring="butt_spring",
        point="hammer_tip",
        low="0 N",
    )
    angle = action.rest_pose[action.coordinates.index("hammer.angle")]
    arm = math.hypot(3.1 - 65.1, 125.0 - 2.8) * 1e-3  # pin to nose, shank straight
    force = 0.98e-3 * (angle + 2.8) / arm
    assert Bench().measure(action, step) == pytest.approx(force, rel=1e-6)
