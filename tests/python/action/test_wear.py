"""Wear of an action: the changed parts, and what a change does to the numbers."""

import json
import math

import pytest
from click.testing import CliRunner

import feltmb
from feltmb import InvalidParameter, Wear, _core
from feltmb.action.wearing import NUMBERS, Variant, measure, variants
from feltmb.cli.technician import wear as command
from feltmb.cli.technician import wear_table
from feltmb.mechanism.to_core import with_leads


@pytest.fixture(scope="module")
def every(action):
    return list(variants(action, screws=True))


@pytest.fixture(scope="module")
def changed(every):
    return {(v.part, v.change): a for v, a in every if v.kind != "screw"}


def made(action):
    """A result without simulations: an action, two variants, one without a let-off."""
    base = dict.fromkeys(NUMBERS, 2.0)
    rows = [
        (Variant("felt", "thinner", "0.2 mm thinner", 2e-4, "Renew."), base | {"let_off": 1.5}),
        (
            Variant("felt", "thinner", "0.5 mm thinner", 5e-4, "Renew."),
            base | {"let_off": math.nan},
        ),
    ]
    return Wear(action.name, action.hash, base, tuple(rows))


def test_every_felt_friction_and_spring_is_changed_once(action, changed):
    config = action.config
    felts = {"felt": 13, "rubbing": 7, "joints": 6, "springs": 3}  # backcheck: 3 contacts, 1 felt
    others = {"bushings": 2, "straps": 1}
    assert len(changed) == 3 * felts.pop("felt") + sum(felts.values()) + sum(others.values())
    stiffness = changed["jack spring", "20 % weaker"].value("springs.jack_spring.stiffness")
    assert stiffness.value == pytest.approx(0.8 * config.springs["jack_spring"].stiffness)
    friction = changed["key, joint", "friction doubled"].value("bodies.key.friction.amplitude")
    assert friction.value == pytest.approx(2.0 * config.bodies["key"].friction.amplitude)


def test_a_bushing_brakes_by_tightness_or_side_force(action, changed):
    """Hand formula: coefficient times force times arm, the larger one of both forces."""

    def torque(a):
        return with_leads(a.config, "key").friction.amplitude

    def side(newtons):
        path = "bushings.key_front.side_force"
        return torque(tight.with_values({path: newtons})) - torque(action)

    tight = changed["key, front bushing", "1 N tighter"]
    assert torque(tight) - torque(action) == pytest.approx(0.2 * 1.0 * 0.217)
    assert side(-0.9) == pytest.approx(0.2 * 1.0 * 0.217)  # one side is unloaded by as much
    assert side(-3.0) == pytest.approx(0.2 * 3.0 * 0.217)
    assert feltmb.load_action("steinway45").with_values({"bushings.key_front.arm": 0.2}).hash == (
        action.hash
    )  # without a force it changes nothing
    with pytest.raises(InvalidParameter, match="body"):
        feltmb.Action(action.raw | {"bushings": {"one": {"body": "none"}}})


def test_a_thinner_felt_leaves_a_gap_of_its_thickness(action, changed):
    """Hammer felt: nothing rests on it, so that the gap to the string grows by the thickness."""

    def gap(a):
        pose = a.rest_pose
        rows = _core.evaluate(a.mechanism, pose, 0.0 * pose, 0.0)["contacts"]
        return -next(row[1] for row in rows if int(row[0]) == 6)

    thinner = changed["hammer - string", "0.5 mm thinner"]
    assert gap(thinner) - gap(action) == pytest.approx(5e-4, rel=1e-6)


def test_a_harder_felt_has_a_larger_force(action, changed):
    old = action.config.contacts["03"].loading
    new = changed["key capstan - whippen", "20 % harder"].config.contacts["03"].loading
    assert (new.a, new.c) == pytest.approx((1.2 * old.a, 1.2 * old.c))
    assert new.b == old.b


def test_another_mechanism_has_its_own_parts():
    raw = feltmb.load_action("steinway45").raw
    raw["springs"]["fourth"] = {"coordinate": "whippen.angle", "stiffness": 0.01, "rest_angle": 0.0}
    parts = {v.part for v, _ in variants(feltmb.Action(raw))}
    assert "fourth" in parts


def test_screws_are_those_of_the_targets(every):
    turned = [v for v, _ in every if v.kind == "screw"]
    assert len(turned) == 12
    assert {v.amount for v in turned if v.part == "capstan"} == {-5e-4, 5e-4}


def test_json_and_back(action):
    one = made(action)
    two = Wear.from_dict(json.loads(json.dumps(one.as_dict())))
    assert two.rows[0] == one.rows[0]
    assert math.isnan(two.rows[1][1]["let_off"])
    assert one.changes["let_off"].iloc[0] == -0.5
    assert wear_table(one).row_count == 3
    assert one.plot().axes


def test_an_unknown_part_is_refused():
    result = CliRunner().invoke(command, ["steinway45", "--part", "harp"])
    assert isinstance(result.exception, InvalidParameter)
    assert "key, joint" in str(result.exception)


@pytest.mark.slow
def test_a_worn_capstan_felt_costs_aftertouch():
    """Hand formula: the key moves on by the thickness times the ratio of its arms, 225 / 141.

    Of the regulated action: that of the thesis has 0.5 mm of aftertouch, less than is lost.
    """
    regulated = feltmb.load_action("steinway45_leaded")
    changed = {(v.part, v.change): a for v, a in variants(regulated)}
    base = measure(regulated)
    worn = measure(changed["key capstan - whippen", "0.5 mm thinner"])
    lost = base["aftertouch"] - worn["aftertouch"]
    assert lost == pytest.approx(0.5 * 225 / 141, rel=0.1)
    assert worn["let_off"] == pytest.approx(base["let_off"], abs=0.2)
    assert worn["check"] > base["check"] + 3.0


@pytest.mark.slow
def test_few_parts_by_processes():
    result = feltmb.wear("steinway45", parts=["jack spring"], progress=False)
    assert [v.change for v, _ in result.rows] == ["20 % weaker"]
    assert result.frame.shape[0] == 2
    assert -2.0 < result.changes["down_weight"].iloc[0] < 0.0
