"""What the strokes do to the action, against the numbers of the design and against common sense."""

import numpy as np
import pytest

import feltmb


@pytest.fixture(scope="module")
def action(rigid):
    """Rigid members: these tests are not about the members."""
    return rigid


def at_rest_at_the_end(run, action, room=0.3):
    """Coordinates away from the rest pose, in mm of felt."""
    q = np.array([run[name][-1] for name in action.coordinates])
    scale = np.array(action.mechanism.coordinate_scale)
    return np.max(np.abs(q - action.rest_pose) / scale) < room


@pytest.mark.parametrize(
    ("stroke", "damper", "toe", "impact", "landing"),
    [
        ("piano", 0.2187, 0.2319, 0.2384, 0.2396),
        ("forte", 0.0854, 0.0896, 0.0921, 0.0905),
    ],
)
def test_times_of_the_rigid_action(run_of, stroke, damper, toe, impact, landing):
    """Of the independent trial model: two implementations agree up to the check."""
    found = run_of(stroke, rtol=1e-8).summary
    assert found["damper_start_time"] == pytest.approx(damper, abs=5e-4)
    assert found["jack_toe_time"] == pytest.approx(toe, abs=5e-4)
    assert found["impact_time"] == pytest.approx(impact, abs=5e-4)
    assert found["key_landing_time"] == pytest.approx(landing, abs=5e-4)


def test_numbers_of_the_rigid_action(run_of):
    piano, forte = run_of("piano", rtol=1e-8).summary, run_of("forte", rtol=1e-8).summary
    assert piano["impact_speed"] == pytest.approx(1.06, rel=0.02)
    assert forte["impact_speed"] == pytest.approx(3.36, rel=0.02)
    assert piano["let_off_gap"] == pytest.approx(2.26e-3, rel=0.05)
    assert piano["check_gap"] == pytest.approx(12.4e-3, rel=0.02)
    assert forte["check_gap"] == pytest.approx(13.2e-3, rel=0.02)


@pytest.mark.parametrize(("stroke", "law", "force"), [
    ("piano", "printed", 26.5), ("forte", "guarded", 162.0),
])  # fmt: skip
def test_force_on_a_rigid_stop(run_of, stroke, law, force):
    values = {"string.kind": "rigid_stop", "contacts.*.law": law}
    found = run_of(stroke, values=values, rtol=1e-8).summary["max_impact_force"]
    assert found == pytest.approx(force, rel=0.06)


def test_staccato_returns_to_rest(run_of, action):
    run = run_of("staccato", rtol=1e-7, duration=1.5)
    assert run.summary["impact_speed"] > 2.5
    assert at_rest_at_the_end(run, action)
    assert np.max(run["bridle_strap.force"]) > 0.2


def test_press_and_release_returns_to_rest_with_the_strap_pulling(run_of, action):
    """The strap pulls as the key goes up (1.4 N in the trial model with flexible members)."""
    run = run_of("press_release", rtol=1e-8, duration=2.0)
    assert at_rest_at_the_end(run, action)
    released = run.time > 0.45
    pull = run["bridle_strap.force"]
    assert np.max(pull[released]) == pytest.approx(1.4, rel=0.15)
    assert np.max(pull[run.time < 0.2]) == 0.0
    gap = -run["contact04.compression"][-1]
    assert gap == pytest.approx(0.60e-3, abs=0.1e-3)


def test_repeated_blows_strike_three_times(run_of):
    run = run_of("repeated", rtol=1e-7)
    force = run["contact06.force"]
    for i in range(3):
        assert np.max(force[(run.time > 0.2 * i) & (run.time < 0.2 * (i + 1))]) > 10.0
    on = run.events[(run.events["contact"] == 6) & (run.events["change"] == "closes")]
    assert len(on) >= 3


def test_finger_motion_gives_a_finger_force(action):
    stroke = feltmb.motion_stroke([0.05, 0.15, 0.4], [0.0, 0.010, 0.010], duration=0.4)
    run = feltmb.simulate(action, stroke, rtol=1e-8)
    force = run["finger.force"]
    assert np.max(np.abs(force[run.time < 0.05])) < 1e-12
    assert 2.0 < np.max(force) < 50.0
    assert np.min(force) >= 0.0
    travel = run["finger.displacement"]
    assert travel[0] == pytest.approx(0.0, abs=1e-12)
    assert np.all(travel[force > 0] <= np.asarray(stroke.at(run.time))[force > 0])
    assert run.summary["impact_speed"] > 0.5


def test_finger_force_repeats_the_motion_that_it_came_from(action):
    """The force that a prescribed motion gave, fed back as a force, gives the same key motion."""
    motion = feltmb.motion_stroke([0.05, 0.15, 0.4], [0.0, 0.010, 0.010], duration=0.12)
    moved = feltmb.simulate(action, motion, rtol=1e-9, output_rate=50e3)
    force = feltmb.table_stroke(
        moved.time, moved["finger.force"], interpolation="linear", duration=0.12
    )
    pushed = feltmb.simulate(action, force, rtol=1e-8, output_rate=50e3)
    span = np.ptp(moved["key.angle"])
    assert span > 0.01
    assert np.max(np.abs(moved["key.angle"] - pushed["key.angle"])) < 5e-3 * span


@pytest.mark.parametrize("interpolation", ["linear", "monotone"])
def test_a_pulse_after_a_long_rest_is_not_passed_over(action, interpolation):
    """Old symptom: a table beginning after a second of rest moved nothing."""
    stroke = feltmb.table_stroke(
        [1.0, 1.0125, 1.025], [0.0, 16.0, 0.0], interpolation=interpolation, duration=1.1
    )
    assert feltmb.simulate(action, stroke).summary["impact_speed"] > 2.0
    late = feltmb.table_stroke(
        [0.0, 1.0, 1.0125, 1.025], [0.0, 0.0, 16.0, 0.0], interpolation=interpolation, duration=1.1
    )
    assert feltmb.simulate(action, late).summary["impact_speed"] > 2.0


def test_slow_press_lets_off_at_two_millimeters(action):
    """Regulation: button met at gap 6.5 mm and dip 9.1 mm, let-off at 2.00 mm.

    Slower still, the regularised friction fades and the gap grows, to 2.8 mm in a press of 5 s.
    """
    press = feltmb.motion_stroke([0.0, 1.0], [0.0, 11.2e-3], interpolation="linear")
    run = feltmb.simulate(action, press)
    names, gaps = list(run.events["event"]), run.events["gap06"]
    toe = names.index("jack_toe")
    assert gaps[toe] == pytest.approx(6.5e-3, abs=0.2e-3)
    dip = np.interp(run.events["time"][toe], run.time, run["finger.displacement"])
    assert dip == pytest.approx(9.1e-3, abs=0.15e-3)
    assert np.min(-run["contact06.compression"]) == pytest.approx(2.0e-3, abs=0.3e-3)


def test_a_treble_note_is_faster_and_leaves_the_string_sooner(action):
    """Note 64: lighter hammer, string of 1046.5 Hz; the key is that of note 40."""
    treble = feltmb.load_action("steinway45_note64")
    string = treble.config.string
    pitch = np.sqrt(string.tension / string.linear_density) / (2.0 * string.length)
    assert pitch == pytest.approx(440.0 * 2.0 ** ((64 - 49) / 12), rel=1e-3)
    low, high = (feltmb.simulate(a, "forte", ledger=False).summary for a in (action, treble))
    assert high["impact_speed"] > 1.03 * low["impact_speed"]
    assert high["impact_duration"] < 0.7 * low["impact_duration"]
