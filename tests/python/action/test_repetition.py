"""Repetition of an action: rates, and the reason of the first failure."""

import json
import time

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb import Error, InvalidParameter
from feltmb.action import repetition
from feltmb.action.repetition import highest_rate, key_travel
from feltmb.cli.technician import repeat as command


@pytest.fixture(scope="module")
def travel(action):
    return key_travel(action)


def test_key_travel_is_that_of_a_slow_press(travel):
    """The travel of the static path, 10.84 mm; the strike of this press bends nothing much."""
    assert travel == pytest.approx(0.01084, abs=2e-4)


def test_every_press_strikes_below_the_rate_and_not_above(action, travel):
    found = highest_rate(action, travel, presses=2, near=14.0)
    assert 9.0 < found.rate < found.failed_rate <= found.rate + 0.25
    assert found.weakest > 0.5 * found.impact_speed
    assert found.press == 2


def test_a_short_return_leaves_the_jack_beside_the_butt(action, travel):
    found = highest_rate(action, travel, 0.5, 0.5, presses=3)
    assert (found.rate, found.press, found.reason) == (0.0, 2, "jack not back")


def test_a_heavy_friction_makes_the_key_too_slow(action, travel):
    sticky = action.with_values({"bodies.key.friction.amplitude": "0.12 N m"})
    found = highest_rate(sticky, travel, presses=2, near=8.0)
    assert found.reason == "key too slow"
    assert found.rate < 9.0


def test_a_slow_finger_is_the_limit(action, travel):
    """Press and lift of 11.8 mm at 0.1 and 0.5 m/s last 0.143 s with 1 ms between them."""
    found = highest_rate(action, travel, 0.1, presses=2, near=6.5)
    assert found.reason == "finger"
    assert found.rate < 1.0 / ((travel + 1e-3) * 12.0 + 1e-3) < found.failed_rate


@pytest.mark.parametrize(
    "wrong", [{"speeds": [0.0]}, {"returns": [1.2]}, {"presses": 1}, {"highest": np.inf}]
)
def test_wrong_numbers_are_refused(action, wrong):
    with pytest.raises(InvalidParameter):
        feltmb.repeat(action, **wrong)


def test_ctrl_c_ends_the_searches_in_all_threads(action, monkeypatch):
    """They do not hear of it: each ran to its end, for up to half a minute."""
    monkeypatch.setattr(repetition, "key_travel", lambda _: 0.01)
    heard = []

    def search(_action, _travel, speed, _key_return, *, progress, **_):
        if speed == 0.1:
            raise KeyboardInterrupt
        end = time.monotonic() + 20.0
        while time.monotonic() < end and progress(0.0):
            time.sleep(0.01)
        heard.append(time.monotonic() < end)

    monkeypatch.setattr(repetition, "highest_rate", search)
    with pytest.raises(KeyboardInterrupt):
        feltmb.repeat(action, speeds=[0.1, 0.5], returns=[1.0])
    assert heard in ([], [True])
    monkeypatch.undo()
    with pytest.raises(KeyboardInterrupt):
        highest_rate(action, 0.01, progress=lambda _: False)


def test_a_key_that_does_not_reach_its_punching_is_told(action):
    with pytest.raises(Error, match="does not reach its punching"):
        feltmb.repeat(action.with_values({"surfaces.Gp3.point.y -=": "30 mm"}))


def test_command(tmp_path):
    picture = tmp_path / "r.png"
    words = ["steinway45", "--return", "50%", "--speed", "0.5m/s", "--presses", "2", "--json"]
    result = CliRunner().invoke(command, [*words, "--plot", str(picture)])
    (row,) = json.loads(result.stdout)["rows"]
    assert (row["rate"], row["failed_rate"], row["press"]) == (0.0, 2.0, 2)
    assert picture.stat().st_size > 10_000
