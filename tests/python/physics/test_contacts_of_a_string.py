"""Several contacts with one string: hammer and damper, on one face of it or on both.

The dense witness writes tests/data/damped_string.toml again: all modes and bodies in one system for
scipy, with the two forces as formulas.
"""

import dataclasses

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.optimize import root

import feltmb
from feltmb.cli.inputs import showing as show
from feltmb.run.sensitivity import gradient

LENGTH, TENSION, DENSITY, YOUNG, DIAMETER, XI, MODES = (
    0.6315,
    654.0,
    5.98e-3,
    2e11,
    0.99e-3,
    1e-3,
    24,
)
ANCHOR, DAMPER_AT = 0.0789375, 0.1789375  # y of hammer and damper [m]
MASS = np.array([9e-3, 5e-3])
STIFFNESS, DAMPING = np.array([2e6, 4e5]), np.array([0.1, 2.0])  # of the felts, exponent 2
SPRING, SPRING_REST = 50.0, 10e-3
OPPOSITE = {
    "surfaces.damper_line.normal": [1.0, 0.0],
    "springs.damper_spring.rest_angle": "-10 mm",
    "start_pose": {"hammer.x": -0.999, "damper.x": -0.001},
}


def shapes(y):
    j = np.arange(1, MODES + 1)
    return np.sqrt(2.0 / (DENSITY * LENGTH)) * np.sin(j * np.pi * y / LENGTH)


def frequencies():
    j = np.arange(1, MODES + 1)
    eps = np.pi * DIAMETER**4 * YOUNG / (64.0 * LENGTH**2 * TENSION)
    return np.pi * j / LENGTH * np.sqrt(TENSION / DENSITY * (1.0 + eps * np.pi**2 * j**2))


class Witness:
    """Bodies and modes; side -1: the damper presses against the hammer."""

    def __init__(self, side=1.0, damper_at=DAMPER_AT, gravity=-1e-3, rest=SPRING_REST):
        self.side = np.array([1.0, side])
        self.phi = np.stack([shapes(ANCHOR), shapes(damper_at)])
        self.omega = frequencies()
        self.gravity, self.rest = gravity, side * rest

    def forces(self, x, v, eta, rate):
        e = self.side * (x - self.phi @ eta)
        de = self.side * (v - self.phi @ rate)
        force = STIFFNESS * np.maximum(e, 0.0) ** 2 * (1.0 + DAMPING * de)
        return np.maximum(force, 0.0)

    def accelerations(self, x, v, eta, rate):
        f = self.side * self.forces(x, v, eta, rate)
        pull = np.array([0.0, -SPRING * (x[1] - self.rest)])
        own = self.gravity + (pull - f) / MASS
        return own, f @ self.phi - self.omega**2 * eta - 2.0 * XI * self.omega * rate

    def rhs(self, _t, y):
        x, v, eta, rate = np.split(y, [2, 4, 4 + MODES])
        own, modal = self.accelerations(x, v, eta, rate)
        return np.concatenate([v, own, rate, modal])

    def run(self, y, times):
        out = solve_ivp(
            self.rhs, (0.0, times[-1]), y, "DOP853", times, rtol=1e-11, atol=1e-14, max_step=1e-5
        )
        force = [self.forces(*np.split(column, [2, 4, 4 + MODES])) for column in out.y.T]
        return out.y.T, np.array(force)


@pytest.fixture(scope="module")
def damped(data):
    return feltmb.load_action(data / "damped_string.toml")


def thrown(action, speed, x=-1e-4, **options):
    """From rest, with the hammer near the string at a speed."""
    still = feltmb.ramp_stroke(0.0, duration=1e-7)
    rest = feltmb.simulate(action, still, events=False, ledger=False)
    state = np.array(rest.end_state)
    state[[0, 2]] = x, speed
    start = dataclasses.replace(rest, end_state=state)
    stroke = feltmb.ramp_stroke(0.0, duration=options.pop("duration", 8e-3))
    return state, feltmb.simulate(action, stroke, start=start, output_rate=2e4, **options)


CASES = {
    "side by side": ({}, {}),
    "opposite": (OPPOSITE, {"side": -1.0}),
    "at one point": (
        {"contacts.03.surfaces": ["felt", "string_line"], "string.other_surfaces": [],
         "string.strike_point": ANCHOR},
        {"damper_at": ANCHOR},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_hammer_and_damper_against_all_modes_at_once(damped, case):
    values, own = CASES[case]
    action = damped.with_values(values)
    # The damper is on the string when the hammer meets it, loses it and meets it again.
    start, run = thrown(action, 1.0, rtol=1e-9)
    states, forces = Witness(**own).run(start, run.time)
    assert np.sum((forces[:, 0] > 0.0) & (forces[:, 1] > 0.0)) > 10
    assert run.status == "done"
    for i, name in enumerate(("contact01.force", "contact03.force")):
        top = np.max(forces[:, i])
        assert top > 0.5
        np.testing.assert_allclose(run[name], forces[:, i], atol=2e-6 * top, err_msg=name)
    eta = states[:, 4 : 4 + MODES]
    np.testing.assert_allclose(run.eta, eta, atol=1e-6 * np.max(np.abs(eta)))
    np.testing.assert_allclose(run["string.strike"], eta @ shapes(ANCHOR), atol=1e-9)


@pytest.mark.parametrize("method", ["cvode", "modal"])
@pytest.mark.parametrize("case", CASES)
def test_methods_agree_and_the_ledger_closes(damped, case, method):
    _, run = thrown(damped.with_values(CASES[case][0]), 1.0, rtol=1e-8, method=method, ledger=True)
    assert run.energy["residual_relative"] < 1e-5
    assert run.energy["dissipated"]["contact03.normal"] > 1e-5
    reference = thrown(damped.with_values(CASES[case][0]), 1.0, rtol=1e-10, method="cvode")[1]
    for name in ("contact01.force", "contact03.force"):
        top = np.max(reference[name])
        np.testing.assert_allclose(run[name], reference[name], atol=1e-4 * top, err_msg=name)


def test_a_damper_that_is_off_lets_the_string_go(damped):
    """It hangs through the string: its place says nothing."""
    off = {"contacts.03.enabled": False}
    start, run = thrown(damped.with_values(off), 1.0, x=-3e-4, ledger=True)
    assert start[1] > 1e-3  # beyond the line
    assert run.stats["strikes"] >= 1
    assert run["contact03.force"].max() == 0.0


def test_held_points_take_the_quick_way_and_agree(damped):
    """Linear but for its contacts: modes and scalar forces alone."""
    values = {"string.strike_point": ANCHOR, "springs.damper_spring.enabled": False,
              "gravity": [20.0, 0.0], "start_pose": {"hammer.x": -1e-4, "damper.x": 1e-4},
              "contacts.02.enabled": False}  # fmt: skip
    action = damped.with_values(values)
    options = {"events": False, "ledger": False, "rtol": 1e-9}
    _, quick = thrown(action, 1.0, **options)
    _, whole = thrown(action, 1.0, method="cvode", **options)
    assert quick.stats["rhs"] != whole.stats["rhs"]
    for name in ("contact01.force", "contact03.force"):
        top = np.max(whole[name])
        np.testing.assert_allclose(quick[name], whole[name], atol=2e-5 * top, err_msg=name)


@pytest.mark.parametrize(
    ("case", "gravity", "rest"),
    [
        ("side by side", 50.0, 10e-3),  # both press
        ("opposite", 50.0, 10e-3),  # one presses against the other
        ("opposite", 500.0, 50e-3 - 1e-5),  # the string is pressed against a felt that was open
        ("at one point", 50.0, 10e-3),
    ],
)
def test_at_rest_string_and_felts_are_springs_in_series(damped, case, gravity, rest):
    values, own = CASES[case]
    side = own.get("side", 1.0)
    action = damped.with_values(
        values
        | {"gravity": [gravity, 0.0], "springs.damper_spring.rest_angle": f"{side * rest} m",
           "start_pose": {"hammer.x": -1e-4, "damper.x": -1e-4}}
    )  # fmt: skip
    found = action.equilibrium
    witness = Witness(**own, gravity=gravity, rest=rest)
    zero, still = np.zeros(2), np.zeros(MODES)

    def unbalance(z):
        x, eta = 1e-3 * z[:2], 1e-5 * z[2:]
        body, modal = witness.accelerations(x, zero, eta, still)
        return np.concatenate([body, 1e-2 * modal])

    first = np.concatenate([1e3 * np.array(found["q"]), 1e5 * np.array(found["eta"])])
    exact = root(unbalance, first + 1e-3, tol=1e-13)
    assert np.max(np.abs(unbalance(exact.x))) < 1e-6
    force = witness.forces(1e-3 * exact.x[:2], zero, 1e-5 * exact.x[2:], still)
    assert np.all(force > 1e-3)
    np.testing.assert_allclose(found["q"], 1e-3 * exact.x[:2], atol=1e-9)
    np.testing.assert_allclose(found["eta"], 1e-5 * exact.x[2:], atol=1e-11)
    assert found["iterations"] < 40


def ring(action, mode, duration):
    """Energy of a mode that was set going, over that at the start; the damper rests."""
    still = feltmb.ramp_stroke(0.0, duration=1e-7)
    rest = feltmb.simulate(action, still, events=False, ledger=False)
    state = np.array(rest.end_state)
    state[4 + MODES + mode - 1] = 2e-3
    start = dataclasses.replace(rest, end_state=state)
    run = feltmb.simulate(
        action, feltmb.ramp_stroke(0.0, duration=duration), start=start, rtol=1e-9, ledger=False
    )
    omega = frequencies()[mode - 1]
    eta = run.eta[:, mode - 1] - rest.eta[-1, mode - 1]
    rate = np.array(run.end_state)[4 + MODES + mode - 1]
    return 0.5 * (rate**2 + (omega * eta[-1]) ** 2) / (0.5 * 2e-3**2)


def test_a_damper_at_a_node_of_a_mode_does_not_damp_it(damped):
    def at(y):
        values = {"surfaces.damper_line.point.y": ANCHOR - y, "string.strike_point": ANCHOR}
        return damped.with_values(values)

    mode, duration = 4, 0.05
    alone = np.exp(-2.0 * XI * frequencies()[mode - 1] * duration)
    assert ring(at(LENGTH / 4.0), mode, duration) == pytest.approx(alone, rel=2.0 * XI)
    assert ring(at(LENGTH / 8.0), mode, duration) < 0.5 * alone
    assert ring(at(LENGTH / 4.0), 2, duration) < 0.8 * np.exp(
        -2.0 * XI * frequencies()[1] * duration
    )


def test_the_packaged_damper_ends_the_tone_when_the_key_is_let_go():
    values = {"string.damping_ratio": 7e-4, "shank.rigid": True, "wire.rigid": True}
    runs = [
        feltmb.simulate(
            feltmb.load_action(name).with_values(values), "press_release", duration=0.65, rtol=1e-5
        )
        for name in ("steinway45", "steinway45_damped")
    ]
    sounding = [float(np.interp(0.4, run.time, run["energy.string"])) for run in runs]
    ended = [run["energy.string"][-1] for run in runs]
    lifted = np.interp(0.4, runs[1].time, runs[1]["contact10.force"])
    assert lifted == 0.0
    assert sounding[1] == pytest.approx(sounding[0], rel=0.05)
    assert ended[0] > 0.4 * sounding[0]
    assert ended[1] < 0.01 * sounding[1]
    assert all(run.energy["residual_relative"] < 1e-3 for run in runs)


PATHS = ("contacts.10.loading.a", "string.tension", "damper.mass", "surfaces.Gp9.point.y")


@pytest.mark.slow  # tight runs for the differences
def test_gradient_with_a_damper_on_the_string_against_differences(rigid):
    """The spoon is taken off: hammer and damper are on the string together."""
    action = rigid.with_values({"string.other_surfaces": ["Gp9"], "contacts.09.enabled": False})
    options = {"duration": 0.096, "output_rate": 1000.0}
    names = ["contact10.force", "contact06.force", "string.bridge_force", "damper.angle"]
    # Moving the damper's line moves the hammer's force by 3e-5 N a mm only, of 25 N.
    exact = gradient(action, "forte", list(PATHS), names, rtol=1e-10, tolerance=1e-5, **options)
    struck = exact.time > 0.0925
    assert np.any(np.all(exact.values[struck][:, :2] > 0.0, axis=1))
    start = {"contacts.10.loading.a": 280.0, "string.tension": 654.0, "damper.mass": 0.01318,
             "surfaces.Gp9.point.y": 0.232}  # fmt: skip
    units = {"damper.mass": "kg", "surfaces.Gp9.point.y": "m"}
    for path in PATHS:

        def at(value, path=path):
            text = f"{value!r} {units[path]}" if path in units else value
            run = feltmb.simulate(
                action.with_values({path: text}), "forte", ledger=False, rtol=1e-12, **options
            )
            return np.stack([run[n] for n in names], axis=1)

        size = start[path]
        step = (1e-3 if path.endswith("point.y") else 1e-2) * size
        coarse = (at(size + step) - at(size - step)) / (2 * step)
        fine = (at(size + step / 2) - at(size - step / 2)) / step
        by_runs = (4 * fine - coarse) / 3
        for i, name in enumerate(names):
            own = exact.of(name, exact.columns[PATHS.index(path)])
            top = np.max(np.abs(by_runs[:, i]))
            assert np.max(np.abs(own - by_runs[:, i])) < 3e-3 * top, (path, name)


def test_show_names_what_touches_the_string():
    text = CliRunner(env={"COLUMNS": "200"}).invoke(show, ["steinway45_damped"]).output
    assert "touched by contacts 06 hammer - string, 10 damper - string" in text


def test_an_empty_list_is_no_part_of_the_hash():
    base = feltmb.load_action("steinway45")
    assert base.with_values({"string.other_surfaces": []}).hash == base.hash
    assert feltmb.load_action("steinway45_damped").hash != base.hash


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"string.other_surfaces": ["rail"]},
            'surface "rail" runs 1 m beside "string_line", expected on the same',
        ),
        ({"string.other_surfaces": ["damper_line", "damper_line"]}, '"damper_line" is given twice'),
        ({"string.other_surfaces": ["string_line"]}, '"string_line" is given twice'),
        ({"string.other_surfaces": ["felt"]}, 'surface "felt" must be a line of the ground'),
        ({"string.other_surfaces": ["damper"]}, "surface 'damper' is missing; surface names are"),
        ({"string.other_surfaces": "damper_line"}, "string.other_surfaces: got 'damper_line'"),
        ({"surfaces.damper_line.point.x": 0.01}, "runs 0.01 m beside"),
        ({"surfaces.damper_line.normal": [0.0, 1.0]}, 'is not parallel to "string_line"'),
        ({"contacts.03.surfaces": ["felt", "rail"]}, 'no contact uses its surface "damper_line"'),
        (
            {"surfaces.damper_line.point.y": -0.6, "string.strike_point": 0.07},
            'point of surface "damper_line" is 0.678937 m from the end y = 0, must lie inside',
        ),
    ],
)
def test_what_cannot_touch_a_string_is_refused(damped, values, message):
    with pytest.raises(feltmb.InvalidParameter) as error:
        damped.with_values(values).mechanism  # noqa: B018
    assert message in str(error.value)


def test_a_body_beyond_the_end_of_the_string_is_told(damped):
    beyond = damped.with_values({"surfaces.felt.point.y": -0.6})
    with pytest.raises(
        feltmb.ModelError, match=r'contact03 .*touches string "string" at y = 0.678'
    ) as refused:
        beyond.rest_pose  # noqa: B018
    assert refused.value.code == "beyond_string"
    # The hammer comes there later: the run ends there, with what was simulated.
    past = damped.with_values({"surfaces.nose.point.y": 0.08})
    with pytest.raises(feltmb.IntegrationError, match="contact01 hammer - string touches") as error:
        thrown(past, 1.0)
    assert error.value.code == "beyond_string"
    assert "between its ends, 0 to 0.6315 m" in str(error.value)
    assert error.value.partial.time[-1] > 5e-5
