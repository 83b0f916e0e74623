"""Runs with several strikes: the numbers of each."""

import copy
import io

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb.cli.stroke import command, strike_tables, summary_table
from feltmb.mechanism import Action
from feltmb.run.events import Change
from feltmb.run.strikes import find_strikes

PERIOD = 0.4


@pytest.fixture(scope="module")
def stroke():
    one = feltmb.pulse_stroke(8.0, start=0.02, rise=0.02, fall=0.08, duration=PERIOD)
    return feltmb.sequence(one, one, period=PERIOD)


@pytest.fixture(scope="module")
def run(stroke):
    return feltmb.simulate("steinway45", stroke)


def test_each_key_stroke_is_a_strike_with_its_own_numbers(run):
    assert list(run.strikes.index) == [1, 2]
    one, two = run.strike_list
    names = ("key_start", "damper_start", "jack_toe", "impact", "key_landing", "check")
    for name in (*names, "check_end", "key_return"):
        later = two[f"{name}_time"] - one[f"{name}_time"]
        assert later == pytest.approx(PERIOD, abs=2e-3), name
    for strike in (one, two):
        times = [strike[f"{n}_time"] for n in ("key_start", "impact", "check", "key_return")]
        assert times == sorted(times)
        assert strike["check_time"] < strike["check_end_time"]
    assert two["impact_speed"] == pytest.approx(one["impact_speed"], rel=0.01)
    assert two["check_gap"] == pytest.approx(one["check_gap"], abs=1e-3)
    impacts = run.events[(run.events["contact"] == 6) & (run.events["change"] == "closes")]
    assert list(run.strikes["impact_time"]) == list(impacts["time"])
    assert list(run.strikes["impact_speed"]) == list(impacts["approach06"])
    at = (run.time > two["impact_time"] - 1e-3) & (run.time < two["impact_time"] + 5e-3)
    assert two["sampled_impact_force"] == run["contact06.force"][at].max()
    front = run["key_front.y"]
    assert two["key_travel"] == front[0] - front[run.time > PERIOD].min()


def test_the_first_strike_is_that_of_the_summary(run):
    (one, _), summary = run.strike_list, run.summary
    for name in set(one) & set(summary) - {"check_gap", "check_gap_swing", "key_travel"}:
        assert one[name] == summary[name], name
    assert {"let_off_gap", "rebound_speed"} <= set(
        feltmb.simulate("steinway45", "piano").strikes.columns
    )


def test_strikes_are_saved(run, tmp_path):
    assert feltmb.load_run(run.save(tmp_path / "run.nc")).strike_list == run.strike_list


def test_a_run_without_samples_does_not_tell_its_strikes(stroke):
    run = feltmb.simulate("steinway45", stroke, summary_only=True)
    assert run.strikes.empty
    assert run.summary["impact_time"] > 0.0


def test_strikes_between_two_samples_have_the_numbers_of_their_events():
    run = feltmb.simulate("steinway45", "repeated", output_rate=8.0)
    fine = feltmb.simulate("steinway45", "repeated")
    assert list(run.strikes["impact_speed"]) == list(fine.strikes["impact_speed"])
    assert 0 < run.strikes["key_travel"].count() < 5


def test_without_a_key_the_striker_tells_where_a_strike_begins(run, stroke):
    raw = copy.deepcopy(feltmb.load_action("steinway45").raw)
    del raw["reading"]["key_point"], raw["reading"]["touch"]
    free = feltmb.simulate(Action(raw), stroke)
    assert list(free.strikes["impact_time"]) == list(run.strikes["impact_time"])
    assert list(free.strikes["check_time"]) == list(run.strikes["check_time"])
    assert "key_return_time" not in free.strikes


@pytest.mark.parametrize("rtol", [None, 1e-7])
def test_a_strike_without_a_new_press_has_no_key_start(rtol):
    """Without let-off the key that stays down throws the hammer to the string again."""
    raw = copy.deepcopy(feltmb.load_action("steinway45").raw)
    raw["surfaces"]["Gp10"]["point"]["value"][1] += 3.0  # mm: the jack does not reach the button
    stroke = feltmb.ramp_stroke(10.0, 0.02, 0.05, duration=0.4)
    strikes = feltmb.simulate(Action(raw), stroke, rtol=rtol).strikes
    np.testing.assert_allclose(strikes["impact_time"], [0.0674, 0.0868, 0.0935], atol=1e-4)
    assert list(np.isnan(strikes["key_start_time"])) == [False, True, True]


def test_each_new_press_is_a_key_start():
    strikes = feltmb.simulate("steinway45", "repeated").strikes.iloc[:4]
    starts, impacts = strikes["key_start_time"].to_numpy(), strikes["impact_time"].to_numpy()
    assert np.all(starts < impacts)
    assert np.all(starts[1:] > impacts[:-1])


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([], []),
        ([(0.0, True), (2e-3, False)], [(0, 1)]),
        ([(0.0, True), (2e-3, False), (3e-3, True), (5e-3, False)], [(0, 3)]),
        ([(0.0, True), (2e-3, False), (9e-3, True), (11e-3, False)], [(0, 1), (2, 3)]),
        ([(0.0, True), (9e-3, False), (20e-3, True)], [(0, None), (2, None)]),
        ([(0.0, False), (9e-3, True)], [(1, None)]),
    ],
)
def test_contacts_within_6_ms_are_one_strike(times, expected):
    changes = [Change(time, 6, None, closes) for time, closes in times]
    assert find_strikes(changes, 6) == expected


def text_of(table):
    from rich.console import Console

    screen = Console(width=200, record=True, file=io.StringIO())
    screen.print(table)
    return screen.export_text()


def test_the_command_prints_a_column_for_each_strike(run):
    (table,) = strike_tables(run, "two")
    text = text_of(table)
    assert "2 strikes" in text
    for strike in run.strike_list:
        assert f"{strike['impact_time']:.5f}" in text
        assert f"{strike['impact_speed']:.4g}" in text
    assert "none" in text
    assert "key is back" in text
    whole = text_of(summary_table(run, "two"))
    assert "impact speed" not in whole
    assert f"{run.summary['max_impact_force']:.4g}" in whole
    assert strike_tables(feltmb.simulate("steinway45", "piano"), "one") == []
    output = CliRunner().invoke(command, ["steinway45", "repeated", "--json"]).output
    assert output.count('"impact_speed"') == 6
