"""Arguments of simulate and evaluate; runs that stop early; runs that go on from another."""

import numpy as np
import pytest

import feltmb


@pytest.fixture(scope="module")
def action(rigid):
    """Rigid members: these tests are not about the members."""
    return rigid


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.0}, r"duration = 0 s, must be > 0"),
        ({"duration": float("nan")}, "duration: got nan, expected a finite number"),
        ({"rtol": 0.5}, r"rtol = 0.5, must be in \[1e-13, 1e-2\]"),
        ({"rtol": float("nan")}, "rtol: got nan, expected a finite number"),
        ({"output_rate": 0.0}, "output_rate = 0 Hz, must be > 0"),
        ({"output_rate": 1e12}, "numbers; the limit is "),
        ({"max_order": 6}, "max_order = 6"),
        ({"max_step": -1.0}, "max_step"),
        ({"max_wall": -1.0}, "max_wall"),
    ],
)
def test_arguments_out_of_range(action, options, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        feltmb.simulate(action, "forte", **options)


def test_samples_of_a_machine_that_is_linear_between_contacts_are_limited(data):
    hammer, still = feltmb.load_action(data / "hammer_string.toml"), feltmb.ramp_stroke(0.0)
    options = {"events": False, "ledger": False}  # these are what a stepper of its own has
    with pytest.raises(feltmb.InvalidParameter, match="numbers; the limit is "):
        feltmb.simulate(hammer, still, output_rate=1e15, **options)


def test_names_instead_of_objects():
    run = feltmb.simulate("steinway45", "forte", duration=0.01)
    assert run.provenance["action"] == "steinway45"


def test_evaluate_refuses_a_wrong_state(action):
    with pytest.raises(feltmb.InvalidParameter, match=r"got q of length 3 .* expected 6"):
        feltmb.evaluate(action, [0, 0, 0], np.zeros(6))
    with pytest.raises(feltmb.InvalidParameter, match="not a finite number"):
        feltmb.evaluate(action, [np.nan] * 6, np.zeros(6))


def test_evaluate(action):
    point = feltmb.evaluate(action, action.rest_pose, np.zeros(6), finger_force=2.0)
    assert point.mass_matrix.shape == (6, 6)
    assert np.allclose(point.mass_matrix @ point.acceleration, point.force)
    assert list(point.contacts.index) == list(range(1, 17))
    assert {"compression", "rate", "normal_force", "slip_speed", "friction_force", "x", "y"} <= set(
        point.contacts.columns
    )


# --- stopping early -----------------------------------------------------------------------------


def check_partial(error, run, whole):
    assert error.partial is run
    assert error.time == run.reached
    assert 0.0 < run.reached < whole
    assert run.status != "done"
    assert run.message
    assert len(run.time) == len(run.values)
    assert run.time[-1] <= run.reached


def test_wall_time(action):
    with pytest.raises(feltmb.IntegrationError) as caught:
        feltmb.simulate(action, "forte", max_wall=1e-9)
    assert caught.value.code == "wall_time"
    check_partial(caught.value, caught.value.partial, 0.4)
    assert caught.value.partial.status == "wall_time"


def test_partial_run_is_the_beginning_of_the_whole(action):
    whole = feltmb.simulate(action, "forte", rtol=1e-10)
    with pytest.raises(feltmb.IntegrationError) as caught:
        feltmb.simulate(action, "forte", rtol=1e-10, max_wall=1e-9)
    part = caught.value.partial
    assert np.array_equal(part.values, whole.values[: len(part.time)])


def test_partial_run_can_be_saved_and_loaded(action, tmp_path):
    with pytest.raises(feltmb.IntegrationError) as caught:
        feltmb.simulate(action, "forte", max_wall=1e-9)
    path = caught.value.partial.save(tmp_path / "partial.nc")
    again = feltmb.load_run(path)
    assert again.status == "wall_time"
    assert again.message == caught.value.partial.message


def test_interruption_by_the_callback(action):
    seen = []

    def stop(time):
        seen.append(time)
        return False

    with pytest.raises(KeyboardInterrupt, match="interrupted at t"):
        feltmb.simulate(action, "staccato", rtol=1e-12, progress=stop)
    assert len(seen) == 1


def test_an_error_of_the_callback_comes_through(action):
    def fail(_):
        raise ZeroDivisionError("of the caller")

    with pytest.raises(ZeroDivisionError, match="of the caller"):
        feltmb.simulate(action, "staccato", rtol=1e-12, progress=fail)


def test_failure_names_time_state_and_contact(action):
    """The literal law beyond the crossing of its fits creates energy until no step is left.

    Old symptom: steps of 1e-22 s, for ever.
    """
    literal = action.with_values({"contacts.*.law": "printed", "string.kind": "rigid_stop"})
    # Newton's method fails at the smallest step, or solves steps too small to get anywhere.
    with pytest.raises(feltmb.IntegrationError) as caught:
        feltmb.simulate(literal, "forte", max_wall=60.0)
    error = caught.value
    assert error.code in ("not_converged", "no_progress")
    check_partial(error, error.partial, 0.4)
    assert error.partial.status == "failed"
    assert error.time > 0.09
    assert error.state.removesuffix(".rate") in action.coordinates
    assert error.contact.startswith("contact")
    assert error.state in str(error)
    assert error.partial.summary["impact_speed"] > 3.0


def test_failure_at_the_start(action, state_of):
    speeds = np.zeros(6)
    speeds[4] = 1e60
    start = state_of(action, action.rest_pose, speeds)
    with pytest.raises(feltmb.IntegrationError) as caught:
        feltmb.simulate(action, "forte", start=start)
    assert caught.value.code == "not_converged"
    assert caught.value.time < 1e-12
    assert len(caught.value.partial.time) == 1


# --- going on from another run --------------------------------------------------------------------


def test_restart_equals_the_uninterrupted_run(action):
    """Cut a stroke where the hammer flies, a knot of both: equal up to the tolerance."""
    cut = 0.0915
    stroke = feltmb.load_stroke("forte")
    whole = feltmb.simulate(action, stroke, duration=0.11, rtol=1e-10)
    first = feltmb.simulate(action, stroke, duration=cut, rtol=1e-10)
    second = feltmb.simulate(
        action, stroke.shifted(-cut), duration=0.11 - cut, rtol=1e-10, start=first
    )
    assert second.reached == pytest.approx(0.11 - cut)
    scale = np.max(np.abs(whole.end_state)) * 1e-6 + 1e-8
    assert np.max(np.abs(second.end_state - whole.end_state)) < scale
    assert second.summary["impact_time"] + cut == pytest.approx(
        whole.summary["impact_time"], abs=1e-8
    )


def test_restart_under_finger_motion(action):
    """The motion counts from rest, not from where the second run begins."""
    stroke = feltmb.motion_stroke([0.05, 0.15, 0.4], [0.0, 0.01, 0.01], duration=0.2)
    whole = feltmb.simulate(action, stroke, duration=0.14, rtol=1e-9)
    first = feltmb.simulate(action, stroke, duration=0.1, rtol=1e-9)
    second = feltmb.simulate(action, stroke.shifted(-0.1), duration=0.04, rtol=1e-9, start=first)
    assert second["finger.force"][0] == pytest.approx(first["finger.force"][-1], rel=1e-9)
    assert second["finger.displacement"][0] == pytest.approx(first["finger.displacement"][-1])
    assert second["finger.force"][-1] == pytest.approx(whole["finger.force"][-1], rel=1e-4)


def test_restart_from_a_file(action, tmp_path):
    first = feltmb.simulate(action, "forte", duration=0.1)
    loaded = feltmb.load_run(first.save(tmp_path / "first.nc"))
    still = feltmb.ramp_stroke(25.0, duration=0.05)
    a = feltmb.simulate(action, still, start=first)
    b = feltmb.simulate(action, still, start=loaded)
    assert np.array_equal(a.values, b.values)


def test_restart_begins_where_the_other_ended(action):
    first = feltmb.simulate(action, "forte", duration=0.1)
    second = feltmb.simulate(action, feltmb.ramp_stroke(25.0), duration=0.01, start=first)
    for name in action.coordinates:
        assert second[name][0] == first[name][-1]


def test_start_of_another_mechanism_is_refused(action, pendulum):
    first = feltmb.simulate(pendulum, feltmb.ramp_stroke(0.1, duration=0.01))
    with pytest.raises(feltmb.InvalidParameter, match=r"start: the run ends with 2 states"):
        feltmb.simulate(action, "forte", start=first)
    other = feltmb.simulate(action.with_values({"string.modes": 10}), "forte", duration=0.01)
    with pytest.raises(feltmb.InvalidParameter, match=r"this mechanism has 92"):
        feltmb.simulate(action, "forte", start=other)


def test_initial_values_of_a_body_that_flies(data):
    """Closed forms: a free flight, and a linear spring met with v gives the force v sqrt(m k)."""
    sledge = feltmb.load_action(data / "mass_spring.toml")
    still = feltmb.ramp_stroke(0.0, duration=0.01)
    free = sledge.with_values({"springs": {}})
    for action in (sledge, free):
        start = {"x": "-4 mm", "x.rate": 2.0}
        run = feltmb.simulate(action, still, rtol=1e-9, output_rate=1e5, start=start)
        assert run["x"][0] == -4e-3
        assert np.interp(1e-3, run.time, run["x"]) == pytest.approx(-2e-3, abs=1e-8)
        assert run["contact01.force"].max() == pytest.approx(2.0 * np.sqrt(20e-3 * 2e4), rel=1e-5)
        assert run["x.rate"][-1] == pytest.approx(-2.0, rel=1e-5)
        assert run.provenance["initial"] == {"x": "-4 mm", "x.rate": "2.0"}


def test_a_contact_that_the_initial_pose_presses_is_told(data):
    sledge = feltmb.load_action(data / "mass_spring.toml")
    still = feltmb.ramp_stroke(0.0, duration=0.01)
    (told,) = feltmb.simulate(sledge, still, start={"x": "2 mm"}).warnings
    assert told == (
        "contact 01 is pressed by 2 mm in the initial pose, with 40 N; in the rest pose by 0 mm"
    )
    assert not feltmb.simulate(sledge, still, start={"x": "-2 mm"}).warnings


def test_numbers_of_numpy_are_initial_values(data):
    sledge = feltmb.load_action(data / "mass_spring.toml")
    still = feltmb.ramp_stroke(0.0, duration=0.01)
    for value in (np.float32(-0.5), np.int64(-2), np.float64(-0.5)):
        assert feltmb.simulate(sledge, still, start={"x": value})["x"][0] == float(value)


def test_a_run_that_fails_tells_what_the_initial_pose_presses():
    with pytest.raises(feltmb.IntegrationError, match=r"is pressed by 94\.9 mm in") as caught:
        feltmb.simulate("steinway45", "forte", start={"hammer.angle": "60 deg"})
    assert caught.value.code == "no_progress"


def test_faults_of_initial_values_come_at_once(data):
    sledge = feltmb.load_action(data / "mass_spring.toml")
    with pytest.raises(feltmb.InvalidParameter) as caught:
        feltmb.simulate(sledge, feltmb.ramp_stroke(0.0), start={"y.rate": 1.0, "x": "3 s"})
    assert "there is no coordinate 'y.rate'; near are x.rate" in str(caught.value)
    assert "start: x: unit 's'" in str(caught.value)


@pytest.mark.parametrize(
    ("given", "told"),
    [("x", "expected NAME=VALUE"), ("x=1mm,x=2mm", "twice"), ("z=1", "no coordinate 'z'")],
)
def test_initial_values_of_the_command_line_are_checked_first(data, given, told, capsys, tmp_path):
    from feltmb.cli import main

    still = tmp_path / "still.csv"
    still.write_text("time [s],force [N]\n0,0\n0.01,0\n")
    with pytest.raises(SystemExit) as stop:
        main(["stroke", str(data / "mass_spring.toml"), str(still), "--initial", given])
    assert stop.value.code == 2
    assert told in capsys.readouterr().err


def test_second_blow_from_the_end_of_the_first(action):
    first = feltmb.simulate(action, "staccato", duration=0.6)
    second = feltmb.simulate(action, "staccato", start=first)
    assert second.summary["impact_speed"] == pytest.approx(first.summary["impact_speed"], rel=0.02)


# --- a mechanism without a finger ----------------------------------------------------------------


def test_without_a_finger_a_push_is_refused(data):
    hammer = feltmb.load_action(data / "hammer_string.toml")
    with pytest.raises(feltmb.InvalidParameter, match="describes no finger"):
        feltmb.simulate(hammer, feltmb.motion_stroke([0.0, 0.1], [0.0, 0.01]))
    with pytest.raises(feltmb.InvalidParameter, match="describes no finger"):
        feltmb.simulate(hammer, feltmb.ramp_stroke(5.0))
    feltmb.simulate(hammer, feltmb.ramp_stroke(0.0, duration=1e-3))
