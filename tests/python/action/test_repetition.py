"""Repetition of an action: rates against friction and springs, and reasons of the first failure."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb import Error, InvalidParameter
from feltmb.action import repetition
from feltmb.action.repetition import highest_rate, key_travel
from feltmb.cli.technician import repeat as command


@pytest.fixture(scope="module")
def leaded():
    return feltmb.load_action("steinway45_leaded")


@pytest.fixture(scope="module")
def travel(leaded):
    return key_travel(leaded)


def test_key_travel_is_that_of_a_slow_press(action):
    """The travel of the static path, 10.84 mm; the strike of this press bends nothing much."""
    assert key_travel(action) == pytest.approx(0.01084, abs=2e-4)


def test_the_finger_has_its_mass_and_no_more_than_its_force(leaded):
    """F = m a at the tip, in the air between key and hand; the turned arm is 0.2 % shorter."""
    played = repetition.with_finger(leaded, -0.02)
    stroke = feltmb.table_stroke([0.0, 0.004], [-3.0, -3.0], interpolation="linear")
    start = {"playing finger.angle": -0.005 / repetition.ARM}
    run = feltmb.simulate(played, stroke, duration=0.004, start=start, ledger=False)
    tip = repetition.ARM * run["playing finger.angle"]
    assert 2.0 * np.polyfit(run.time, tip, 2)[0] == pytest.approx(-3.0 / repetition.MASS, rel=5e-3)


def test_leads_stay_in_the_key(leaded):
    """Also in a mechanism without texts, as the variants of wear are."""
    plain = feltmb.Action(leaded.config.model_dump(mode="json", by_alias=True, exclude_none=True))
    for action in (leaded, plain):
        played = repetition.with_finger(action)
        place = played.coordinates.index("playing finger.angle")
        matrix = feltmb.evaluate(played, played.rest_pose, 0.0 * played.rest_pose).mass_matrix
        assert matrix[place, place] == pytest.approx(repetition.MASS * repetition.ARM**2, rel=1e-9)


def test_a_sound_action_repeats_seven_times_a_second(leaded, travel):
    sound = highest_rate(leaded, travel, highest=7.0)
    assert (sound.rate, sound.reason) == (7.0, "")
    assert sound.weakest > 2.0


@pytest.mark.parametrize(
    "change",
    [
        {"bodies.butt.friction.amplitude *=": 3.0},
        pytest.param({"springs.butt_spring.stiffness": 0.0}, marks=pytest.mark.slow),
        pytest.param({"straps.bridle_strap.enabled": False}, marks=pytest.mark.slow),
    ],
    ids=["tight center", "no hammer spring", "no bridle strap"],
)
def test_what_a_technician_knows_slows_the_full_return(leaded, travel, change):
    found = highest_rate(leaded.with_values(change), travel, highest=7.0)
    assert found.rate < 6.9
    assert found.reason in ("hammer not back", "key too slow")


def test_a_hammer_that_stays_at_the_string_is_no_note(leaded, travel):
    """With five times the friction it never comes home, though every press still strikes."""
    found = highest_rate(leaded.with_values({"bodies.butt.friction.amplitude *=": 5.0}), travel)
    assert (found.rate, found.reason) == (0.0, "hammer not back")


@pytest.mark.slow
def test_more_friction_is_never_faster_and_a_grand_needs_half_the_return(leaded, travel):
    rates = [
        highest_rate(leaded.with_values({"bodies.butt.friction.amplitude *=": f}), travel).rate
        for f in (1.0, 2.0, 3.0, 5.0)
    ]
    assert rates == sorted(rates, reverse=True)
    assert 8.0 < rates[0] < 10.0
    grand = feltmb.load_action("grand_action")
    half, full = (highest_rate(grand, key_travel(grand), 10.0, r).rate for r in (0.5, 1.0))
    assert half > 11.0 > 7.0 > full


def test_a_finger_that_does_not_sound_is_told(leaded, travel):
    with pytest.raises(Error, match="does not strike"):
        highest_rate(leaded, travel, 0.6)


def test_an_interrupt_answers_with_what_is_done(leaded, monkeypatch):
    def broken(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(repetition, "wait", broken)
    found = feltmb.repeat(leaded, forces=[10.0], returns=[1.0])
    assert found.interrupted
    assert found.rows[0].rate < 7.0
    assert "interrupted" in found.rows[0].sentence


@pytest.mark.parametrize("wrong", [{"forces": [0.0]}, {"returns": [1.2]}, {"highest": np.inf}])
def test_wrong_numbers_are_refused(action, wrong):
    with pytest.raises(InvalidParameter):
        feltmb.repeat(action, **wrong)


def test_a_key_that_does_not_reach_its_punching_is_told(action):
    with pytest.raises(Error, match="does not reach its punching"):
        feltmb.repeat(action.with_values({"surfaces.Gp3.point.y -=": "30 mm"}))


def test_command(tmp_path):
    picture = tmp_path / "r.png"
    slow = ["--set", "bodies.butt.friction.amplitude*=5", "--return", "100%", "--finger", "10N"]
    result = CliRunner().invoke(
        command, ["steinway45_leaded", *slow, "--json", "--plot", str(picture)]
    )
    (row,) = json.loads(result.stdout)["rows"]
    assert (row["rate"], row["reason"]) == (0.0, "hammer not back")
    assert picture.stat().st_size > 10_000
