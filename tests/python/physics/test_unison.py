"""Unisons: several equal strings struck together, and one definition of the impact speed."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb.cli.inputs import showing as show
from feltmb.mechanism.parameters import find_parameters

TENSION, DENSITY = 654.0, 5.98e-3  # of one string [N], [kg/m]
STILL = feltmb.ramp_stroke(0.0, duration=4e-3)


@pytest.fixture(scope="module")
def hammer(data):
    return feltmb.load_action(data / "hammer_string.toml")


def strike(action, state_of, speed=2.0, **options):
    """The hammer thrown against the strings, a nanometer before them."""
    start = state_of(action, np.array([-1e-9]), np.array([speed]))
    return feltmb.simulate(action, STILL, start=start, **{"rtol": 1e-9, **options})


def as_one(n):
    """One string that is to a hammer what n are."""
    return {
        "string.tension": n * TENSION,
        "string.linear_density": f"{n * 5.98} g/m",
        "string.young_modulus": f"{n * 200.0} GPa",
    }


@pytest.mark.parametrize("method", ["cvode", "modal"])
@pytest.mark.parametrize("n", [2, 3])
def test_n_strings_are_one_of_n_times_density_tension_and_stiffness(hammer, state_of, n, method):
    many = strike(hammer.with_values({"string.count": n}), state_of, method=method)
    heavy = strike(hammer.with_values(as_one(n)), state_of, method=method)
    assert many.summary == pytest.approx(heavy.summary, rel=2e-5)
    for name in ("contact01.force", "string.strike", "string.bridge_force", "energy.string"):
        top = np.max(np.abs(heavy[name]))
        assert top > 0.0
        np.testing.assert_allclose(many[name], heavy[name], atol=1e-6 * top, err_msg=name)
    # And it is not what one string does.
    one = strike(hammer, state_of, method=method)
    assert many.summary["max_impact_force"] > 1.2 * one.summary["max_impact_force"]


@pytest.mark.parametrize("n", [1, 3])
def test_until_the_echo_n_strings_are_a_dashpot_of_n_impedances(hammer, state_of, n):
    """F = 2 n Z v at the struck place, Z = sqrt(T mu), until the near end answers."""
    action = hammer.with_values(
        {
            "string.count": n,
            "string.modes": 200,
            "string.damping_ratio": 0.0,
            "string.young_modulus": 0.0,  # waves of all lengths run at one speed
        }
    )
    run = strike(action, state_of, output_rate=2e5)
    force = run["contact01.force"]
    speed = np.gradient(run["string.strike"], run.time)
    echo = 2.0 * 0.0789375 / np.sqrt(TENSION / DENSITY)
    early = (run.time > 0.3 * echo) & (run.time < 0.9 * echo)
    impedance = np.sum(force[early] * speed[early]) / np.sum(speed[early] ** 2)
    assert impedance == pytest.approx(2.0 * n * np.sqrt(TENSION * DENSITY), rel=0.01)


def test_each_of_three_strings_bears_a_third_of_the_force(hammer, state_of):
    """Modes of one string, driven by a third of the recorded force, give the recorded motion."""
    action = hammer.with_values({"string.count": 3})
    run = strike(action, state_of, output_rate=4e5)
    core = feltmb._core
    one = core.ModalString(
        core.StringParameters(
            diameter=0.99e-3, tension=TENSION, length=0.6315, linear_density=DENSITY,
            young_modulus=2e11, damping_ratio=0.07, modes=40,
        )
    )  # fmt: skip
    phi = one.shapes(0.0789375)[0]
    omega, xi = one.angular_frequency, 0.07
    third = run["contact01.force"] / 3.0
    # Convolution with the impulse response of each damped mode.
    t = run.time
    free = omega * np.sqrt(1.0 - xi**2)
    response = phi**2 * np.exp(-xi * omega * t[:, None]) * np.sin(free * t[:, None]) / free
    moved = np.convolve(third, response.sum(axis=1))[: t.size] * (t[1] - t[0])
    top = np.max(np.abs(run["string.strike"]))
    assert np.max(np.abs(moved - run["string.strike"])) < 2e-3 * top
    eta = np.stack(
        [np.convolve(third, r)[: t.size] for r in (response / phi).T], axis=1
    ) * (t[1] - t[0])  # fmt: skip
    bridge = 3.0 * one.bridge_force(eta)
    np.testing.assert_allclose(
        bridge, run["string.bridge_force"], atol=1e-2 * np.max(np.abs(bridge))
    )


@pytest.mark.parametrize("method", ["cvode", "modal"])
def test_the_energy_ledger_closes_with_three_strings(hammer, state_of, method):
    action = hammer.with_values({"string.count": 3})
    run = strike(action, state_of, method=method, ledger=True)
    given = 0.5 * 9e-3 * 2.0**2
    assert np.max(run["energy.string"]) > 0.05 * given
    assert abs(run.energy["residual_largest"]) < 1e-5 * given


def test_saved_runs_know_how_many_strings_sound(hammer, state_of, tmp_path):
    run = strike(hammer.with_values({"string.count": 3}), state_of)
    assert run.provenance["string"]["count"] == 3
    again = feltmb.load_run(run.save(tmp_path / "run.nc"))
    np.testing.assert_allclose(
        again._string().bridge_force(np.ascontiguousarray(again.eta)),
        run["string.bridge_force"],
        rtol=1e-9,
        atol=1e-12,
    )


def test_the_action_has_three_strings_and_the_printed_one_has_one():
    counts = {
        name: feltmb.load_action(name).config.string.count
        for name in (
            *("steinway45", "steinway45_felt", "steinway45_felt_hammer"),
            "steinway45_printed",
        )
    }
    assert list(counts.values()) == [3, 3, 3, 1]
    rows = {row[0]: row for row in feltmb.load_action("steinway45").quantities()}
    assert rows["string.count"][1] == 3
    assert "thesis_gap" in rows["string.count"][3]


def test_show_names_the_strings_and_their_source():
    text = CliRunner(env={"COLUMNS": "200"}).invoke(show, ["steinway45", "--values"]).output
    line = next(line for line in text.splitlines() if "string.count" in line)
    assert "Table 4.3" in line
    assert "fitted" in line
    text = CliRunner(env={"COLUMNS": "80"}).invoke(show, ["steinway45"]).output
    assert "3 equal strings" in text
    shown = CliRunner().invoke(show, ["steinway45", "--set", "string.count=2", "--json"]).output
    values = {row["path"]: row for row in json.loads(shown)["values"]}
    assert values["string.count"]["value"] == 2
    assert values["string.count"]["source"] == ""


def test_a_count_of_one_keeps_the_hash_and_another_changes_it(hammer):
    assert hammer.with_values({"string.count": 1}).hash == hammer.hash
    assert hammer.with_values({"string.count": 2}).hash != hammer.hash


@pytest.mark.parametrize(
    ("count", "message"),
    [
        (0, "string.count: got 0, must be >= 1"),
        (-3, "string.count: got -3, must be >= 1"),
        (10**400, "string.count: got 1"),
        (2.5, "string.count: got 2.5, expected a whole number"),
        (True, "string.count: got True, expected a whole number"),
        ("3", "string.count: got '3', expected a whole number"),
        (float("nan"), "expected a whole number"),
        (float("inf"), "expected a whole number"),
        ({"value": 3, "unit": "mm"}, "got unit 'mm', expected a count"),
        ({"value": 3, "sorce": "x"}, "unknown key sorce"),
    ],
)
def test_a_wrong_count_is_refused(count, message):
    with pytest.raises(feltmb.InvalidParameter) as error:
        feltmb.load_action("steinway45").with_values({"string.count": count})
    assert message in str(error.value)
    assert len(str(error.value)) < 1000


def test_a_count_is_no_parameter_to_derive_by(action):
    with pytest.raises(feltmb.InvalidParameter, match="names no real number"):
        find_parameters(action, "string.count")
    assert find_parameters(action, "string.tension")[0].value == TENSION


# --- one impact speed ----------------------------------------------------------------------------


def words_of(figure):
    """Every text of a figure."""
    from matplotlib.text import Text

    return [t.get_text() for t in figure.findobj(Text) if t.get_text()]


def test_impact_speed_is_that_of_the_contact_wherever_it_is_printed(action):
    from feltmb import plot
    from feltmb.action.touch.strikes import simulate_strike
    from feltmb.run.reading import summary_rows

    run = feltmb.simulate(action, "forte", duration=0.12, rtol=1e-5)
    speed = run.summary["impact_speed"]
    first = run.events[run.events["event"] == "string_contact_on"].iloc[0]
    assert speed == pytest.approx(first["approach06"], rel=1e-12)
    nose = float(np.interp(run.summary["impact_time"], run.time, -run["hammer_tip.vx"]))
    assert f"{speed:.2f}" != f"{nose:.2f}"  # else the test shows nothing
    for figure in (plot.striker_speed(run), plot.overview(run)):
        for text in words_of(figure):
            if "impact speed" in text:
                assert f"{speed:.3g} m/s" in text
            if f"{nose:.2f} m/s" in text:
                assert "tip" in text
                assert "impact" not in text
    assert any("impact speed (of the contact)" in t for t in words_of(plot.overview(run)))
    assert "of the contact" in summary_rows(run)["impact_speed"][0]
    strike = simulate_strike(action, "pressed", 12.0, 10.5e-3)
    stroke = feltmb.ramp_stroke(12.0, 0.020, 0.020, duration=0.45)
    same = feltmb.simulate(action, stroke, ledger=False, output_rate=5000.0)
    assert strike.hammer_speed == pytest.approx(same.summary["impact_speed"], rel=1e-12)
