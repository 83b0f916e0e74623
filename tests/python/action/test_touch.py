"""Slow press with and without inertia, static touch, families of strikes."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb import Error, InvalidParameter, _core, load_action
from feltmb.action.regulate.measuring import Bench
from feltmb.action.regulate.targets import Step
from feltmb.action.touch import Strike, TouchRow, static_touch, touch
from feltmb.action.touch.static import roles_of
from feltmb.action.touch.strikes import at_speed, fit_travel_time, simulate_strike
from feltmb.action.touch.weights import weights
from feltmb.cli.technician import touch as command
from feltmb.mechanism import Action
from feltmb.run.quasistatic import (
    SlowPress,
    simulated_press,
    slow_press,
    static_let_off,
)


def coarsen(patch):
    """Four times longer steps, where words and pictures matter and no number does."""
    patch.setattr("feltmb.action.touch.static.STEP", 1e-4)


@pytest.fixture(scope="module")
def measured(action):
    return touch(action, forces=(1.5, 3.0, 12.0), speeds=(0.1, 0.3, 0.6))


# ---------------------------------------------------------------- press without inertia


def test_press_without_friction_passes_equilibria_under_a_dead_weight(action):
    """Independent of the path: the energy minimum under a constant finger force."""
    raw = action.raw
    for body in raw["bodies"].values():
        body.pop("friction", None)
    for contact in raw["contacts"].values():
        contact.pop("friction", None)
    smooth = Action(raw)
    press = SlowPress(smooth, friction="none")
    for travel in np.linspace(2e-4, 1.0e-3, 5):
        press.advance(travel)
        rest = _core.find_equilibrium(smooth.mechanism, press.force)
        assert press.height(np.array(rest["q"])) - press.height(smooth.rest_pose) == pytest.approx(
            travel, abs=1e-8
        )


def test_press_without_friction_is_reversible(action):
    up = np.linspace(1e-4, 8e-3, 80)
    path = slow_press(action, np.r_[up, up[-2::-1]], friction="none")
    assert path.jumps == []
    np.testing.assert_allclose(path.force[:80], path.force[:-81:-1][:80], atol=2e-4)


def test_friction_opposes_the_press_and_the_release(action):
    up = np.linspace(1e-4, 8e-3, 80)
    both = np.r_[up, up[-2::-1]]
    free = slow_press(action, up, friction="none")
    rough = slow_press(action, both, friction="saturated")
    inside = (up > 2.2e-3) & (up < 6e-3)
    release = rough.force[79:][::-1]
    assert np.all(rough.force[:80][inside] > free.force[inside] + 0.05)
    assert np.all(release[inside] < free.force[inside] - 0.05)
    # Nearly half way between: most friction is of joints, which does not know the load.
    middle = 0.5 * (rough.force[:80] + release)[inside]
    np.testing.assert_allclose(middle, free.force[inside], rtol=0.06)


def test_saturated_friction_does_not_depend_on_the_speed(action):
    up = np.linspace(1e-4, 6e-3, 60)
    slow = slow_press(action, up, friction="saturated", speed=1e-4)
    fast = slow_press(action, up, friction="saturated", speed=0.1)
    np.testing.assert_allclose(slow.force, fast.force, rtol=2e-3)


def test_press_agrees_with_a_simulated_one(action):
    """The simulated finger at 10 mm/s, where nothing strikes, feels what the path says."""
    path = slow_press(action, np.linspace(1e-4, 6.4e-3, 64), friction="saturated")
    press = simulated_press(action, travel=7e-3)
    inside = (press.travel > 3.0e-3) & (press.travel < 6.0e-3)
    expected = np.interp(press.travel[inside], path.travel, path.force)
    assert np.mean(press.force[inside]) == pytest.approx(np.mean(expected), rel=0.01)
    assert np.max(np.abs(press.force[inside] - expected)) < 0.05


def test_let_off_without_inertia(action):
    found = static_let_off(action)
    assert found.tripped
    assert found.gap == pytest.approx(2.92e-3, abs=0.03e-3)
    coarse = static_let_off(action, step=2e-5)
    assert coarse.gap == pytest.approx(found.gap, abs=0.02e-3)
    # Without friction the jack slips out earlier, the hammer farther from the string.
    assert static_let_off(action, friction="none").gap > 4e-3


def test_simulated_let_off(action):
    press = simulated_press(action)
    assert press.closest == pytest.approx(2.18e-3, abs=0.05e-3)
    assert press.gap_when(9) == pytest.approx(19.6e-3, abs=0.1e-3)
    assert press.gap_when(16) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"speed": 0.0}, "speed"),
        ({"friction": "sticky"}, "friction: got .sticky., expected one of"),
    ],
)
def test_bad_arguments_of_a_press(action, arguments, message):
    with pytest.raises(InvalidParameter, match=message):
        slow_press(action, [1e-3], **arguments)


def test_empty_press(action):
    with pytest.raises(InvalidParameter, match="travel is empty"):
        slow_press(action, [])


# ---------------------------------------------------------------- static touch


def test_weights(measured):
    static = measured.static
    assert static.down_weight == pytest.approx(0.775, abs=0.02)
    assert static.up_weight == pytest.approx(0.419, abs=0.02)
    assert static.friction == pytest.approx(0.5 * (static.down_weight - static.up_weight))
    assert static.balance_weight == pytest.approx(0.5 * (static.down_weight + static.up_weight))
    assert static.up_weight_least <= static.up_weight < static.down_weight
    assert static.down_weight <= static.down_weight_most < static.down_weight_damper
    assert static.take_up < static.window[0] < static.window[1] < static.let_off_travel
    assert static.let_off_travel < static.bottom_travel


def test_friction_is_the_work_lost_in_the_window(measured):
    """Down-weight less up-weight, times the window, is the area between the branches."""
    static = measured.static
    low, high = static.window
    x = np.linspace(low, high, 400)
    down = np.interp(x, static.lifted_press.travel, static.lifted_press.force)
    up = np.interp(x, static.lifted_release.travel[::-1], static.lifted_release.force[::-1])
    area = np.trapezoid(down - up, x)
    assert 2.0 * static.friction * (high - low) == pytest.approx(area, rel=0.01)


def test_distances_are_those_of_a_regulation(action, measured):
    """One definition: let-off, dip, blow and aftertouch of touch are what regulate measures."""
    bench = Bench()
    steps = {
        "let_off_distance": {"measure": "simulated_press"},
        "key_dip": {"measure": "rest_gap", "contact": 2},
        "blow": {"measure": "rest_gap", "contact": 6},
        "aftertouch": {"measure": "aftertouch", "contact": 2},
    }
    for key, entries in steps.items():
        step = Step(name=key, low=0.0, **entries)
        assert measured[key] == pytest.approx(1e3 * bench.measure(action, step), abs=0.002)


def test_weights_by_hand(action, measured):
    """The parts of the balance weight, each by a formula on paper."""
    w, static, gram = measured.weights, measured.static, 9.80665e-3
    parts = {name: force / gram for name, force in w.parts.items()}
    assert sum(parts.values()) == pytest.approx(static.balance_weight / gram)
    assert abs(parts["others"]) < 1.0
    # Key: its moment about the balance rail by the arm of the finger, 225 mm.
    assert w.front_weight == pytest.approx(0.1176 * -0.0463 / 0.225)
    assert parts["key"] == pytest.approx(-1e3 * w.front_weight, abs=0.8)
    # Whippen, jack, wire and backcheck about the whippen's center, weighed at the heel.
    wire = 7830.0 * 6.38e-6 * 0.0661
    lean = np.deg2rad(75.5)
    moment = 9.506 * 29.3 + 2.883 * (33.8 + 1.2) + 1e3 * wire * (53.1 + 33.05 * np.cos(lean))
    moment += 1.921 * (53.1 + (66.1 + 14.0) * np.cos(lean) - 1.4 * np.sin(lean))
    assert 1e3 * w.whippen_weight == pytest.approx(moment / 35.9, rel=0.002)
    assert parts["whippen"] == pytest.approx(1e3 * w.whippen_weight * w.key_ratio, rel=0.02)
    # Hammer spring: its torque by the turn of the hammer for a travel of the key.
    # The arm is the height of the center of the nose above the pin: the string is upright.
    low, high = static.window
    middle = w.action_ratio * (0.5 * (low + high) - static.take_up) / 0.132
    angle = action.rest_pose[action.coordinates.index("hammer.angle")] + middle
    arm = 1e-3 * (122.2 * np.cos(angle) - 49.7 * np.sin(angle))
    spring = 0.98e-3 * (angle + 2.8) * w.action_ratio / arm / gram
    assert parts["butt_spring"] == pytest.approx(spring, rel=0.02)
    # Hammer: the rise of its center by the travel of the key; the shank leans by this angle.
    shank = 1e3 * 701.18 * 25.51e-6 * 0.093
    along = 7.58 * 13.4 + shank * 78.5 + 7.8 * 125.0
    across = 7.58 * 12.7 + shank * 3.1 + 7.8 * (3.1 - 36.9)
    rise = across * np.cos(angle) - along * np.sin(angle)  # g mm per rad
    assert parts["hammer"] == pytest.approx(1e-3 * rise * w.action_ratio / arm, rel=0.06)
    level = w.strike_weight * 9.81 * w.action_ratio
    assert w.hammer_share == pytest.approx(w.parts["hammer"] / level)
    assert 0.1 < w.hammer_share < 0.3  # a level shank would have 1


def test_the_balance_of_a_grand_is_that_of_stanwood():
    """Level shank: balance weight + front weight = key ratio x whippen + ratio x strike weight."""
    grand = load_action("grand_action")
    static = static_touch(grand)
    w = weights(grand, static)
    assert w.hammer_share == pytest.approx(1.0, abs=0.05)
    carried = w.key_ratio * w.whippen_weight + w.action_ratio * w.strike_weight - w.front_weight
    assert static.balance_weight / 9.81e-3 == pytest.approx(1e3 * carried, abs=1.5)


def test_ten_grams_on_the_key_front_are_ten_gram_force(action, measured):
    """A lead at the finger's point takes its own weight off both weights."""
    leaded = static_touch(
        action.with_values({"leads": {"own": {"mass": 0.010, "position": 0.225, "height": 0.0251}}})
    )
    assert measured.static.down_weight - leaded.down_weight == pytest.approx(0.0981, rel=0.01)
    assert measured.static.up_weight - leaded.up_weight == pytest.approx(0.0981, rel=0.01)
    assert leaded.friction == pytest.approx(measured.static.friction, rel=0.01)


def test_without_butt_spring_the_key_is_lighter(action, measured, monkeypatch):
    coarsen(monkeypatch)
    loose = static_touch(action.with_values({"springs.butt_spring.enabled": False}))
    assert loose.balance_weight < measured.static.balance_weight - 0.05


def test_gram_force_and_newton(measured):
    assert measured["down_weight"] == pytest.approx(measured.static.down_weight / 9.80665e-3)
    with pytest.raises(InvalidParameter, match="near are up_weight, down_weight"):
        measured["weight"]


def test_curve_as_data(measured):
    curve = measured.curve
    assert set(curve["branch"]) == {"press", "release", "press_lifted", "release_lifted"}
    press = curve[curve["branch"] == "press"]
    assert press["travel"].is_monotonic_increasing
    assert press["hammer_gap"].iloc[0] == pytest.approx(48.23e-3, abs=0.02e-3)


def test_an_action_that_cannot_be_measured_is_told_with_a_hint(action, monkeypatch):
    coarsen(monkeypatch)
    away = action.with_values({"surfaces.Gp10.point.y": 0.09})
    with pytest.raises(Error, match=r"does not meet the let-off button.*feltmb regulate"):
        static_touch(away)


@pytest.fixture(scope="module")
def without_bottom(action):
    with pytest.MonkeyPatch.context() as patch:
        coarsen(patch)
        return touch(action.with_values({"surfaces.Gp3.point.y": -0.06}), forces=(8.0,), speeds=())


def test_a_touch_without_a_key_bottom_has_pictures(without_bottom, tmp_path):
    assert len(without_bottom.plot(tmp_path)) == 2
    assert "does not reach its front punching" in without_bottom.as_dict()["notes"][0]


@pytest.mark.parametrize(
    ("note", "missing"),
    [
        ("does not reach its front punching", "bottom_travel"),
        ("the jack does not slip off", "let_off_travel"),
    ],
)
def test_an_action_that_is_not_regulated_has_weights_and_notes(
    action, without_bottom, note, missing, monkeypatch
):
    coarsen(monkeypatch)
    if missing == "bottom_travel":
        static = without_bottom.static
    else:
        static = static_touch(action.with_values({"surfaces.Gp10.point.y": 0.0775}))
    assert note in " ".join(static.notes)
    assert "feltmb regulate" in static.notes[-1]
    assert np.isnan(getattr(static, missing))
    assert not (static.has_let_off and static.has_bottom)
    assert 0.0 < static.up_weight < static.down_weight < 1.0


def test_missing_roles_are_named(action):
    raw = action.raw
    for name in ("jack_toe", "let_off", "free_flight"):
        del raw["events"][name]
    with pytest.raises(InvalidParameter, match=r"reading.touch.toe: event 'jack_toe' is missing"):
        Action(raw)
    del raw["reading"]["touch"]["toe"], raw["reading"]["touch"]["start"]
    with pytest.raises(InvalidParameter, match="does not say what is toe, start"):
        static_touch(Action(raw))


def test_events_may_have_any_name(action):
    raw = action.raw
    names = {"key_start": "taste ab", "jack_toe": "puppe", "key_landing": "unten"}
    raw["events"] = {names.get(k, k): v for k, v in raw["events"].items()}
    raw["events"]["let_off"]["after"] = "puppe"
    raw["reading"]["touch"] |= {"start": "taste ab", "toe": "puppe", "landing": "unten"}
    renamed = Action(raw)
    assert roles_of(renamed) == roles_of(action)
    level = ("pressed", 12.0)
    given = simulate_strike(action, *level, dip=0.01)
    assert simulate_strike(renamed, *level, dip=0.01) == given
    assert given.bottom_after_string is not None


# ---------------------------------------------------------------- strikes


def test_louder_blows_are_faster(measured):
    for kind in ("pressed", "struck"):
        strikes = [b for b in measured.strikes if b.kind == kind]
        speeds = [b.hammer_speed for b in strikes]
        times = [b.travel_time for b in strikes]
        assert speeds == sorted(speeds)
        assert times == sorted(times, reverse=True)
        a, b, _ = measured.fits[kind]
        assert 0.05 < a < 0.12
        assert -1.0 < b < -0.5


def test_loud_key_bottoms_before_the_hammer_strikes_and_soft_after(measured):
    pressed = [b for b in measured.strikes if b.kind == "pressed"]
    assert pressed[0].bottom_after_string > 0.0 > pressed[-1].bottom_after_string


def test_struck_is_shorter_than_pressed(measured):
    assert measured["struck_shorter"] > 0.0


def test_too_soft_a_blow_says_so(action, monkeypatch):
    coarsen(monkeypatch)
    result = touch(action, forces=(0.5, 3.0), speeds=())
    soft, loud = result.strikes
    assert soft.hammer_speed is None
    assert "does not reach the string" in soft.failure
    assert loud.failure == ""
    assert result["struck_shorter"] is None


def test_bad_levels(action):
    with pytest.raises(InvalidParameter, match="forces holds -1"):
        touch(action, forces=(-1.0,))


def test_fit_recovers_a_power_law():
    strikes = [Strike("pressed", 1, v, 1, 0.09 * v**-0.6, 0.1, 0.0) for v in (0.5, 1.0, 2.0, 4.0)]
    a, b, worst = fit_travel_time(strikes)
    assert (a, b) == pytest.approx((0.09, -0.6))
    assert worst < 1e-12
    assert fit_travel_time(strikes[:2]) is None
    assert at_speed(strikes, "travel_time", 1.0) == pytest.approx(0.09)
    assert at_speed(strikes, "travel_time", 9.0) is None


@pytest.mark.parametrize(
    ("row", "verdict"),
    [
        (TouchRow("k", "n", 5.0, "gf", 4.0, 6.0), "inside"),
        (TouchRow("k", "n", 3.0, "gf", 4.0, 6.0), "below"),
        (TouchRow("k", "n", 7.0, "gf", 4.0, 6.0), "above"),
        (TouchRow("k", "n", 7.0, "mm", published=5.0), "+2 mm"),
        (TouchRow("k", "n", None, "mm", published=5.0), ""),
        (TouchRow("k", "n", 7.0, "mm"), ""),
    ],
)
def test_verdict(row, verdict):
    assert row.verdict == verdict


def test_pictures(measured, tmp_path):
    written = measured.plot(tmp_path)
    assert [p.name for p in written] == ["touch_static.png", "touch_dynamic.png"]
    assert all(p.stat().st_size > 20_000 for p in written)
    with pytest.raises(Error, match="exists"):
        measured.plot(tmp_path)


def test_pictures_of_before_and_after(action, measured, tmp_path, monkeypatch):
    """Both mechanisms are drawn with their own numbers, and the legend tells which is which."""
    coarsen(monkeypatch)
    lower = static_touch(action.with_values({"surfaces.Gp10.point.y -=": "0.1 mm"}))
    faster = tuple(
        replace(s, hammer_speed=s.hammer_speed and 2 * s.hammer_speed) for s in measured.strikes
    )
    after = replace(measured, static=lower, strikes=faster)
    figures = []
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig", lambda self, *_a, **_k: figures.append(self)
    )
    monkeypatch.setattr("feltmb.action.touch.work.write_file", lambda _p, save, **_k: save("x"))
    after.plot(tmp_path, before=measured)
    static, dynamic = figures

    def legend(axes):
        return [text.get_text() for text in axes.get_legend().get_texts()]

    lines = {line.get_label(): line for line in static.axes[0].lines}
    assert {f"{k}, {w}" for k in ("press", "release") for w in ("before", "after")} <= set(lines)
    assert {"press, before", "press, after"} <= set(legend(static.axes[0]))
    assert lines["press, before"].get_ydata() == pytest.approx(measured.static.press.force)
    assert lines["press, after"].get_ydata() == pytest.approx(lower.press.force)
    for axes in dynamic.axes:
        names = [text.split(":")[0] for text in legend(axes)]
        assert "pressed, before" in names
        assert "pressed, after" in names
    lines = {line.get_label(): line for line in dynamic.axes[0].lines}
    then, now = (lines[f"pressed, {w}"].get_ydata() for w in ("before", "after"))
    assert np.array(now) == pytest.approx(2.0 * np.array(then))
    measured.plot(tmp_path)
    assert not any("before" in text or "after" in text for text in legend(figures[2].axes[0]))


def test_command(action, measured, monkeypatch):
    # The package's front holds the function under the module's name.
    monkeypatch.setattr(sys.modules["feltmb.action.touch"], "touch", lambda *_args, **_kw: measured)
    result = CliRunner().invoke(command, ["steinway45"])
    assert result.exit_code == 0, result.output
    assert "down-weight" in result.output
    assert "46 to 56" in result.output
    data = json.loads(CliRunner().invoke(command, ["steinway45", "--json"]).output)
    assert data["hash"] == action.hash
    assert data["fits"]["pressed"]["b"] < 0.0
