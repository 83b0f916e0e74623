"""Strokes made in Python and read from TOML."""

import dataclasses
import pickle

import numpy as np
import pytest
from calls import refused

import feltmb


def test_ramp():
    stroke = feltmb.ramp_stroke(force=5.0, start=0.083, ramp=0.3475)
    assert stroke.kind == "force"
    assert stroke.unit == "N"
    assert stroke.at([0.0, 0.083, 0.083 + 0.17375, 0.4305, 1.0]) == pytest.approx([0, 0, 2.5, 5, 5])
    assert stroke.duration == pytest.approx(0.6505)


def test_ramp_with_oscillation():
    stroke = feltmb.ramp_stroke(10.0, 0.0, 0.1, oscillation=(0.1, 40.0))
    t = 0.2 + 0.25 / 40.0
    assert stroke.at(t) == pytest.approx(11.0)


def test_kinds_and_their_units():
    angle = feltmb.motion_stroke([0.0, 0.1, 0.2], [0.0, 0.1, 0.2], of="motor")
    assert (angle.kind, angle.unit, angle.interpolation) == ("motor_motion", "rad", "spline")
    key = feltmb.motion_stroke([0.0, 0.1, 0.2], [0.0, 0.01, 0.01], of="key")
    assert (key.kind, key.unit, key.interpolation) == ("key_motion", "m", "spline")
    torque = feltmb.torque_stroke([0.0, 0.06], [0.0, 3.0])
    assert (torque.kind, torque.unit, torque.at(0.03)) == ("torque", "N m", 1.5)
    assert pickle.loads(pickle.dumps(key)) == key
    with pytest.raises(feltmb.InvalidParameter, match="expected one of 'finger', 'key', 'motor'"):
        feltmb.motion_stroke([0.0, 0.1], [0.0, 0.01], of="hand")
    with pytest.raises(feltmb.InvalidParameter, match="infinite forces at its knots"):
        feltmb.motion_stroke([0.0, 0.1], [0.0, 0.01], of="key", interpolation="linear")


def test_a_motion_in_toml(tmp_path):
    path = tmp_path / "down.toml"
    path.write_text(
        'schema = 1\nname = "down"\nkind = "key_motion"\n[knots]\nunit = ["ms", "mm"]\n'
        "time = [0, 50, 100]\nvalue = [0, 5, 10]\n"
    )
    stroke = feltmb.load_stroke(path)
    assert (stroke.kind, stroke.interpolation) == ("key_motion", "spline")
    assert stroke.at(0.1) == pytest.approx(0.010)
    path.write_text(
        'schema = 1\nname = "x"\nkind = "torque"\n'
        '[ramp]\nforce = "1 N"\nstart = "0 s"\nramp = "1 s"'
    )
    with pytest.raises(feltmb.InvalidParameter, match="kind 'torque' needs knots"):
        feltmb.load_stroke(path)


def test_smoothing_needs_noise_and_samples():
    short = feltmb.motion_stroke([0.0, 0.1, 0.2], [0.0, 0.1, 0.2], of="key")
    assert short.noise == 0.0
    with pytest.raises(feltmb.InvalidParameter, match="got 3 samples, expected at least 12"):
        short.smoothed(1e-6)
    with pytest.raises(feltmb.InvalidParameter, match=r"noise = 0\.0, must be > 0"):
        short.smoothed()


def test_pulse_and_hold():
    stroke = feltmb.pulse_stroke(16.0, 0.02, 0.01, 0.02, hold=0.1)
    assert stroke.at([0.02, 0.025, 0.03, 0.13, 0.14, 0.15]) == pytest.approx([0, 8, 16, 16, 8, 0])
    assert feltmb.pulse_stroke(16.0).at(0.02 + 0.0125) == pytest.approx(16.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"force": float("nan")}, "force: got nan, expected a finite number"),
        ({"force": 1.0, "start": -0.1}, "start = -0.1, must be >= 0 s"),
        ({"force": 1.0, "ramp": 0.0}, "ramp = 0.0, must be > 0 s"),
        ({"force": 1.0, "duration": 0.0}, "duration = 0 s, must be > 0"),
        ({"force": 1.0, "duration": -1.0}, "duration = -1 s, must be > 0"),
        ({"force": 1.0, "duration": float("inf")}, "duration: got inf, expected a finite number"),
        ({"force": 1.0, "oscillation": (0.1, float("nan"))}, "oscillation"),
    ],
)
def test_arguments_out_of_range(arguments, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        feltmb.ramp_stroke(**arguments)


@pytest.mark.parametrize(
    ("time", "value", "message"),
    [
        ([0.0, 0.1, 0.1], [0, 1, 2], "knot 2 does not follow"),
        ([0.0, 0.1], [0, 1, 2], "2 times and 3 values"),
        ([], [], "0 times and 0 values"),
        ([0.0, 0.1], [0, float("nan")], r"force\[1\]: got nan, expected a finite number"),
    ],
)
def test_faults_of_a_table(time, value, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        feltmb.table_stroke(time, value)


def test_unknown_interpolation_is_refused():
    with pytest.raises(feltmb.InvalidParameter, match="interpolation"):
        feltmb.table_stroke([0.0, 1.0], [0.0, 1.0], interpolation="cubic")


def test_motion_is_in_meters():
    stroke = feltmb.motion_stroke([0.0, 0.1], [0.0, 0.01])
    assert stroke.kind == "motion"
    assert stroke.unit == "m"
    assert stroke.duration == 0.1


def test_shifted_and_scaled():
    stroke = feltmb.ramp_stroke(5.0, 0.1, 0.1, duration=0.4)
    assert stroke.shifted(0.2).at(0.4) == pytest.approx(5.0)
    assert stroke.shifted(0.2).duration == pytest.approx(0.6)
    assert stroke.scaled(3.0).at(0.15) == pytest.approx(7.5)


def test_sequence():
    strike = feltmb.pulse_stroke(10.0, duration=0.3)
    line = feltmb.sequence(strike, strike.scaled(0.5), strike, period=0.2)
    peak = 0.02 + 0.0125
    assert line.at([peak, peak + 0.2, peak + 0.4]) == pytest.approx([10, 5, 10])
    assert line.duration == pytest.approx(0.7)
    after = feltmb.sequence(strike, strike)
    assert after.at(0.3 + peak) == pytest.approx(10.0)


def test_press_and_release_as_a_sequence():
    press = feltmb.ramp_stroke(5.0, 0.05, 0.1, duration=0.3)
    release = feltmb.table_stroke([0.0, 0.03], [5.0, 0.0], interpolation="linear", duration=0.2)
    both = feltmb.sequence(press, release)
    assert both.at([0.2, 0.3, 0.315, 0.4]) == pytest.approx([5.0, 5.0, 2.5, 0.0])


def test_faults_of_a_sequence():
    strike = feltmb.pulse_stroke(10.0)
    with pytest.raises(feltmb.InvalidParameter, match="at least one stroke"):
        feltmb.sequence()
    with pytest.raises(feltmb.InvalidParameter, match=r"stroke 1 .* begins at .* before"):
        feltmb.sequence(strike, strike, period=0.01)
    with pytest.raises(feltmb.InvalidParameter, match="they must agree"):
        feltmb.sequence(strike, feltmb.motion_stroke([0, 1], [0, 1]))
    with pytest.raises(feltmb.InvalidParameter, match="oscillates"):
        feltmb.sequence(feltmb.ramp_stroke(1.0, oscillation=(0.1, 40.0)))


def test_pickle_and_plain_data():
    stroke = feltmb.ramp_stroke(5.0, oscillation=(0.1, 40.0))
    again = pickle.loads(pickle.dumps(stroke))
    assert again == stroke
    assert again.at(0.3) == stroke.at(0.3)
    assert feltmb.Stroke(**stroke.as_dict()).as_dict() == stroke.as_dict()


# --- TOML --------------------------------------------------------------------------------------


def test_packaged_strokes():
    assert {"piano", "forte", "staccato", "repeated", "press_release"} <= set(
        feltmb.packaged_strokes()
    )
    for name in feltmb.packaged_strokes():
        stroke = feltmb.load_stroke(name)
        assert stroke.name == name
        assert stroke.source


def test_packaged_blows_are_those_of_the_design():
    assert feltmb.load_stroke("piano").at([0.083, 0.433, 0.49]) == pytest.approx([0, 5, 5])
    assert feltmb.load_stroke("forte").at([0.05, 0.143, 0.3]) == pytest.approx([0, 25, 25])


def write(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text("schema = 1\nname = 'mine'\n" + text, encoding="utf-8")
    return path


def test_knots_with_units(tmp_path):
    path = write(
        tmp_path,
        "kind = 'motion'\nduration = '0.4 s'\n[knots]\nunit = ['ms', 'mm']\n"
        "time = [0, 100, 200]\nvalue = [0, 10, 10]\n",
    )
    stroke = feltmb.load_stroke(path)
    assert stroke.kind == "motion"
    assert stroke.at(0.05) == pytest.approx(0.005)
    assert stroke.duration == 0.4


def test_repeat(tmp_path):
    path = write(
        tmp_path,
        "repeat = 3\nperiod = '200 ms'\n[pulse]\nforce = 16.0\nstart = 0.02\nrise = 0.01\n"
        "fall = 0.01\n",
    )
    stroke = feltmb.load_stroke(path)
    assert stroke.at([0.03, 0.23, 0.43]) == pytest.approx([16, 16, 16])


def test_all_faults_of_a_stroke_at_once(tmp_path):
    path = write(
        tmp_path,
        "kind = 'push'\nduration = 0.0\n[ramp]\nforce = '5 m'\nstart = -1.0\nrampp = 1.0\n",
    )
    with pytest.raises(feltmb.InvalidParameter) as caught:
        feltmb.load_stroke(path)
    text = str(caught.value)
    for part in (
        "mine.toml",
        "kind: got 'push'",
        "duration: got 0.0, must be > 0",
        "ramp.force: unit 'm' does not measure",
        "ramp.start: got -1.0, must be >= 0",
        "ramp.ramp: is missing",
        "ramp.rampp: unknown key; did you mean 'ramp'?",
    ):
        assert part in text, part


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "give one of ramp, pulse, knots; got none"),
        ("kind = ['force']\n[ramp]\nforce=1\nstart=0\nramp=1", r"kind: got \['force'\]"),
        ("[kind]\na = 1\n[ramp]\nforce=1\nstart=0\nramp=1", "kind: got"),
        ("[ramp]\nforce=1\nstart=0\nramp=1\n[pulse]\nforce=1\nstart=0\nrise=1\nfall=1", "got ramp"),
        ("[knots]\nunit=[]\ntime=[0,1]\nvalue=[0,1]", "unit"),
        ("[knots]\nunit=['s','kg']\ntime=[0,1]\nvalue=[0,1]", "knots.unit"),
        ("[knots]\ntime=[0,0]\nvalue=[0,1]", "does not follow"),
        ("[knots]\ntime=[0,1]\nvalue=[0,nan]", "knots.value"),
        ("repeat = 3\nperiod = 0.001\n[pulse]\nforce=1\nstart=0\nrise=1\nfall=1", "begins at"),
    ],
)  # fmt: skip
def test_faults_of_a_stroke_file(tmp_path, text, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        feltmb.load_stroke(write(tmp_path, text))


def test_unknown_stroke_lists_the_packaged_ones():
    with pytest.raises(feltmb.InvalidParameter, match=r"'loud' is unknown; packaged are .*forte"):
        feltmb.load_stroke("loud")
    with pytest.raises(feltmb.InvalidParameter, match="there is no such file"):
        feltmb.load_stroke("loud.csv")


def test_values_at_scalars_and_arrays():
    stroke = feltmb.ramp_stroke(5.0)
    assert np.ndim(stroke.at(0.1)) == 0
    assert stroke.at(np.zeros((2, 3))).shape == (2, 3)


def test_oscillating_stroke_is_not_shifted():
    # the ramp came later, its oscillation did not: another stroke
    stroke = feltmb.ramp_stroke(5.0, oscillation=(0.5, 30.0))
    refused(lambda: stroke.shifted(0.01), "oscillates and cannot be shifted")


def test_oscillation_that_is_no_number():
    # accepted; the solver failed later: "the right-hand side failed at the start"
    stroke = feltmb.load_stroke("forte")
    refused(lambda: dataclasses.replace(stroke, oscillation_amplitude=float("nan")), "oscillation")


def test_sequence_holds_what_a_stroke_holds():
    # Two held ramps in sequence fell linearly from one to the next.
    ramp = feltmb.ramp_stroke(5.0, 0.05, 0.1, duration=0.3)
    both = feltmb.sequence(ramp, ramp)
    assert both.at([0.15, 0.2, 0.299, 0.301, 0.34, 0.45]).tolist() == pytest.approx(
        [5.0, 5.0, 5.0, 0.0, 0.0, 5.0]
    )
