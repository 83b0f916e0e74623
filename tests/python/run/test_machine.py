"""A mechanism step by step: the motion of one run, and to the last bit that of its state."""

import copy
import dataclasses
import importlib.util
import pickle
import re
import sys
import threading

import numpy as np
import pytest

import feltmb

STEP = 1e-3
CHANNELS = ("key.angle", "hammer.angle", "jack.angle", "finger.displacement", "contact12.force")


@pytest.fixture(scope="module")
def action(rigid):
    """Rigid members: these tests are not about the members."""
    return rigid


def along(machine, steps, channels=CHANNELS, **course):
    """Values of channels after each of some steps of 1 ms, and events; course: kind=function."""
    [(kind, value)] = course.items()
    seen, events = [], []
    for k in range(1, steps + 1):
        events += machine.advance(STEP, **{kind: value(k)})
        seen.append([machine.read(channel) for channel in channels])
    return np.array(seen), events


def differs(seen, run, channels=CHANNELS):
    """Largest difference over the largest value, channel by channel."""
    return {
        name: np.max(np.abs(seen[:, i] - run[name][1 : len(seen) + 1])) / (np.ptp(run[name]) or 1.0)
        for i, name in enumerate(channels)
    }


# ---------------------------------------------------------------- the same as one run


def test_a_held_force_is_that_of_a_run(action):
    """The same input in steps and at once: both agree as their tolerances do."""
    stroke = feltmb.table_stroke([0.0, 1.0], [8.0, 8.0], interpolation="linear", duration=0.12)
    coarse = {}
    for rtol in (1e-6, 1e-8):
        run = feltmb.simulate(action, stroke, rtol=rtol, output_rate=1 / STEP)
        seen, events = along(feltmb.Machine(action, rtol=rtol), 120, force=lambda _: 8.0)
        off = differs(seen, run)
        assert max(off.values()) < 500 * rtol, off
        coarse[rtol] = max(off.values())
    assert coarse[1e-8] < 0.1 * coarse[1e-6]  # what differs is the error of integration
    assert run.summary["impact_time"] < 0.12
    mine = [(e.contact, e.closes, e.time) for e in events if e.contact and e.time < 0.05]
    table = run.events[(run.events["time"] < 0.05) & (run.events["change"] != "passes")]
    assert [(c, w) for c, w, _ in mine] == [
        (c, w == "closes") for c, w in zip(table["contact"], table["change"], strict=True)
    ]
    assert np.allclose([t for *_, t in mine], table["time"], atol=1e-7)


def test_a_line_between_values_is_that_of_a_table(action):
    value = [25.0 * min(1.0, max(0.0, (k - 20) / 60)) * (1.0 + 0.1 * (k % 3)) for k in range(121)]
    stroke = feltmb.table_stroke(
        np.arange(121) * STEP, value, interpolation="linear", duration=0.12
    )
    run = feltmb.simulate(action, stroke, rtol=1e-8, output_rate=1 / STEP)
    machine = feltmb.Machine(action, rtol=1e-8, hold="linear")
    seen, _ = along(machine, 120, force=lambda k: value[k])
    assert max(differs(seen, run).values()) < 1e-5


def test_a_finger_that_moves(action):
    place = [0.009 * (k / 60) ** 2 * (3 - 2 * k / 60) if k < 60 else 0.009 for k in range(101)]
    stroke = feltmb.motion_stroke(
        np.arange(101) * STEP, place, interpolation="linear", duration=0.1
    )
    run = feltmb.simulate(action, stroke, rtol=1e-8, output_rate=1 / STEP)
    machine = feltmb.Machine(action, rtol=1e-8, hold="linear")
    seen, _ = along(machine, 100, motion=lambda k: place[k])
    assert max(differs(seen, run).values()) < 1e-5


@pytest.mark.parametrize("told", [False, True])
def test_a_prescribed_key_is_where_it_is_told(action, told):
    """Cubics through the values; the speed is found from them in second order."""
    omega = 40.0
    machine = feltmb.Machine(action, rtol=1e-8)
    off, slow = [], []
    for k in range(1, 61):
        t = k * STEP
        speed = 0.003 * omega * np.sin(omega * t)
        machine.advance(
            STEP, key_motion=0.003 * (1 - np.cos(omega * t)), speed=speed if told else None
        )
        off.append(machine.read("finger.displacement") - 0.003 * (1 - np.cos(omega * t)))
        slow.append(machine.read("key.angle.rate") if k == 1 else 0.0)
    assert np.max(np.abs(off)) < 1e-7
    assert abs(machine.read("finger.force")) < 20.0


def test_the_error_does_not_depend_on_the_number_of_steps(undamped):
    """Closed form x = F/k (1 - cos(omega t)). Every step starts without history, at order one."""
    stiffness, mass, force, duration = 2000.0, 0.4, 10.0, 0.4
    omega = np.sqrt(stiffness / mass)
    for step in (1e-2, 1e-3, 1e-4):
        machine = feltmb.Machine(undamped)
        for _ in range(round(duration / step)):
            machine.advance(step, force=force)
        x, v = machine.read("cart.x"), machine.read("cart.x.rate")
        energy = 0.5 * mass * v**2 + 0.5 * stiffness * x**2 - force * x
        assert x == pytest.approx(
            force / stiffness * (1 - np.cos(omega * duration)), abs=2e-4 * force / stiffness
        )
        assert abs(energy) < 5e-4 * 0.5 * force**2 / stiffness


@pytest.fixture
def undamped(tmp_path):
    path = tmp_path / "undamped.toml"
    path.write_text("""schema = 1
name = "undamped"
[bodies.cart]
joint = "prismatic"
axis = [1.0, 0.0]
coordinate = "cart.x"
mass = "0.4 kg"
[springs.c]
coordinate = "cart.x"
stiffness = "2000 N/m"
rest_angle = "0 m"
[finger]
body = "cart"
point = [0.0, 0.0]
direction = [1.0, 0.0]
""")
    return feltmb.load_action(path)


def test_a_reset_to_initial_values(undamped):
    machine = feltmb.Machine(undamped)
    machine.advance(0.01, force=3.0)
    machine.reset({"cart.x": "2 mm", "cart.x.rate": 0.1})
    assert (machine.time, machine.read("cart.x"), machine.read("cart.x.rate")) == (0.0, 2e-3, 0.1)
    omega = np.sqrt(2000.0 / 0.4)
    for _ in range(30):
        machine.advance(1e-3, force=0.0)
    expected = 2e-3 * np.cos(0.03 * omega) + 0.1 / omega * np.sin(0.03 * omega)
    assert machine.read("cart.x") == pytest.approx(expected, abs=1e-7)
    with pytest.raises(feltmb.InvalidParameter, match="no coordinate 'cart'"):
        machine.reset({"cart": 1.0})
    machine.reset()
    assert machine.read("cart.x.rate") == 0.0


def test_a_motor(motored):
    stroke = feltmb.torque_stroke([0.0, 1.0], [2e-3, 2e-3], duration=0.05)
    run = feltmb.simulate(motored, stroke, rtol=1e-8, output_rate=1 / STEP)
    machine = feltmb.Machine(motored, rtol=1e-8)
    seen, _ = along(machine, 50, ("arm.angle", "motor.torque"), torque=lambda _: 2e-3)
    assert max(differs(seen, run, ("arm.angle", "motor.torque")).values()) < 1e-5
    angle = machine.read("arm.angle")
    machine.advance(STEP, motor_motion=angle, speed=0.0)  # from torque to motion
    assert machine.read("arm.angle") != pytest.approx(angle, abs=1e-6)  # counts from its rest


@pytest.fixture
def motored(tmp_path, data):
    text = (data / "pendulum.toml").read_text()
    path = tmp_path / "motored.toml"
    path.write_text(text + '\n[motor]\ncoordinate = "arm.angle"\n')
    return feltmb.load_action(path)


# ---------------------------------------------------------------- states


def forte(k):
    return 25.0 * min(1.0, max(0.0, (k * STEP - 0.01) / 0.03))


def test_the_same_steps_give_the_same_bits(action):
    one, two = feltmb.Machine(action), feltmb.Machine(action)
    a, _ = along(one, 90, force=forte)
    b, _ = along(two, 90, force=forte)
    assert np.array_equal(a, b)
    one.reset()
    assert one.time == 0.0
    again, _ = along(one, 90, force=forte)
    assert np.array_equal(a, again)


@pytest.mark.parametrize("at", [30, 62, 63, 64, 65, 70, 85])
def test_a_state_goes_on_as_if_nothing_had_been(at, action):
    """Also amid the strike on the string, in another machine, and after other motions."""
    machine = feltmb.Machine(action)
    along(machine, at, force=forte)
    state = pickle.loads(pickle.dumps(machine.state()))
    values = machine.values
    end, events = along(machine, 12, force=lambda k: forte(at + k))
    along(machine, 5, force=lambda _: 0.0)
    other = feltmb.Machine(action)
    along(other, 20, force=lambda _: 30.0)
    for each in (machine, other):
        each.restore(state)
        assert each.time == state.time
        assert each.state() == state
        assert np.array_equal(each.values, values)
        again, again_events = along(each, 12, force=lambda k: forte(at + k))
        assert np.array_equal(end, again)
        assert events == again_events


@pytest.fixture
def remembering(tmp_path, data):
    """The pendulum, whose felt block remembers, creeps and forgets while it is open."""
    text = (data / "pendulum.toml").read_text()
    law = """law = "felt_memory"
memory = { kappa = 0.2, recovery_time = 0.5, creep_stiffness = 1e6, creep_damping = 1e3 }"""
    text, found = re.subn(r'law = "guarded"\nalpha = .*', law, text)
    assert found == 1
    path = tmp_path / "remembering.toml"
    path.write_text(text)
    return feltmb.load_action(path)


def test_felt_remembers_in_the_state(remembering):
    machine = feltmb.Machine(remembering)
    channels = ("arm.angle", "contact01.force")

    def blows(k):
        return 3.0 if (k // 25) % 2 == 0 else -3.0

    along(machine, 25, channels, force=lambda _: -2.0)
    largest = []
    while machine.time < 0.4:
        machine.advance(STEP, force=blows(round(machine.time / STEP)))
        largest.append(np.max(machine.state().memory))
    top = int(np.argmax(largest))
    assert largest[top] > 1e-5
    state = machine.state()
    end, _ = along(machine, 60, channels, force=blows)
    machine.reset()
    assert np.max(machine.state().memory) < 0.5 * largest[top]
    machine.restore(state)
    again, _ = along(machine, 60, channels, force=blows)
    assert np.array_equal(end, again)
    # Without the memory the same blows find another felt.
    machine.restore(dataclasses.replace(state, memory=np.zeros_like(state.memory)))
    forgotten, _ = along(machine, 60, channels, force=blows)
    assert np.max(np.abs(forgotten - end)) > 1e-6


def test_looking_changes_nothing(action):
    one, two = feltmb.Machine(action), feltmb.Machine(action)
    for k in range(1, 81):
        one.advance(STEP, force=forte(k))
        two.advance(STEP, force=forte(k))
        two.state()
        two.restore(two.state())
        assert two.values.size == len(two.names)
    assert np.array_equal(one.values, two.values)


def test_the_machine_of_the_thesis_with_flexible_members():
    machine = feltmb.Machine("steinway45")
    along(machine, 70, ("hammer_tip.y",), force=forte)
    state, values = machine.state(), machine.values
    along(machine, 10, ("hammer_tip.y",), force=forte)
    machine.restore(state)
    assert np.array_equal(machine.values, values)


def test_inputs_may_change_their_kind(action):
    machine = feltmb.Machine(action)
    along(machine, 30, force=lambda _: 4.0)
    place = machine.read("finger.displacement")
    rate = machine.read("key.angle.rate")
    machine.advance(1e-5, key_motion=place, speed=0.0)
    assert abs(machine.read("key.angle.rate")) < abs(rate)
    machine.advance(STEP, key_motion=place)
    assert machine.read("finger.displacement") == pytest.approx(place, abs=1e-8)
    assert machine.time == pytest.approx(30 * STEP + 1e-5 + STEP)


# ---------------------------------------------------------------- reading


def test_channels_have_units(action):
    machine = feltmb.Machine(action)
    machine.advance(0.02, force=5.0)
    assert machine.units["finger.displacement"] == "m"
    assert machine.read("finger.displacement", "mm") == 1e3 * machine.read("finger.displacement")
    assert machine.read("finger.force") == 5.0
    assert machine.values[machine.names.index("finger.force")] == 5.0
    assert set(machine.texts) == set(machine.names)
    with pytest.raises(feltmb.InvalidParameter, match=r"unknown; did you mean key\.angle"):
        machine.read("key.angel")
    with pytest.raises(feltmb.InvalidParameter, match="mm"):
        machine.read("finger.force", "mm")


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "got none, expected one of force, motion, key_motion, torque, motor_motion"),
        ({"force": 1.0, "motion": 0.0}, "got force, motion, expected one of"),
        ({"force": 1e9}, r"force = 1e\+09 N, expected 100000 at most"),
        ({"force": float("nan")}, "force: got nan, expected a finite number"),
        ({"force": 1.0, "speed": 0.1}, "speed is given with force"),
        ({"torque": 1.0}, r"torque = 1 N m, but mechanism .* describes no motor"),
        ({"dt": 0.0, "force": 1.0}, "dt = 0 s, expected finite, > 0"),
        ({"dt": -1.0, "force": 1.0}, "dt = -1 s, expected finite, > 0"),
    ],
)
def test_bad_steps(action, arguments, message):
    machine = feltmb.Machine(action)
    with pytest.raises(feltmb.InvalidParameter, match=message):
        machine.advance(**{"dt": STEP, **arguments})
    assert machine.time == 0.0


def test_a_state_of_another_mechanism(action, pendulum):
    state = feltmb.Machine(pendulum).state()
    with pytest.raises(feltmb.InvalidParameter, match="other numbers or parts than"):
        feltmb.Machine(action).restore(state)
    with pytest.raises(feltmb.InvalidParameter, match=r"state: y: got .* expected \d+ real"):
        feltmb.Machine(action).restore(state, same_parts=True)


def test_a_state_of_the_same_parts_with_other_numbers(action):
    """It is refused, unless the caller knows: the same lengths say nothing of the numbers."""
    heavy = action.with_values({"bodies.key.mass": "0.5 kg"})
    machine = feltmb.Machine(action)
    along(machine, 30, force=forte)
    state, other = machine.state(), feltmb.Machine(heavy)
    rest = other.state()
    with pytest.raises(feltmb.InvalidParameter, match=r"other numbers or parts.*same_parts=True"):
        other.restore(state)
    assert other.state() == rest
    other.restore(state, same_parts=True)
    assert np.array_equal(other.state().y, state.y)
    assert other.state() != state  # of another mechanism
    # A state written by hand has no mark.
    machine.restore(dataclasses.replace(state, mechanism=""))
    assert machine.state() == state


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("y", None, r"y: got None, expected \d+ real numbers"),
        ("y", "abc", "y: got 'abc'"),
        ("y", [[0.0], [0.0, 1.0]], "y: got "),
        ("memory", None, "memory: got None"),
        ("memory", [], "memory: got "),  # would forget what the felt remembers
        ("time", "a", "time: got .'a'., expected 1 real number of"),
        ("kind", [], "kind .. is none of"),
        ("drive", (), r"drive: got \(\), expected 4 real numbers"),
        ("drive", None, "drive: got None"),
        ("drive", "abcd", "drive: got 'abcd'"),
    ],
)
def test_odd_states(action, name, value, expected):
    machine = feltmb.Machine(action)
    machine.advance(STEP, force=1.0)
    state = machine.state()
    with pytest.raises(feltmb.InvalidParameter, match=f"state: {expected}"):
        machine.restore(dataclasses.replace(state, **{name: value}))
    with pytest.raises(feltmb.InvalidParameter, match="state: y: got"):
        machine.restore(dataclasses.replace(state, y=state.y.astype(complex)))
    with pytest.raises(feltmb.InvalidParameter, match="state: y: got"):
        machine.restore(dataclasses.replace(state, y=state.y[:, None]))
    assert machine.state() == state


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy])
def test_a_copy_goes_its_own_way(way, action):
    """It shared the state of the first, or ended in a TypeError of Python."""
    machine = feltmb.Machine(action, hold="linear", rtol=1e-5)
    along(machine, 20, force=forte)
    state = machine.state()
    other = way(machine)
    assert other.state() == state
    end, _ = along(other, 10, force=forte)
    assert machine.state() == state
    again, _ = along(machine, 10, force=forte)
    assert np.array_equal(end, again)
    with pytest.raises(feltmb.InvalidParameter, match=r"cannot be pickled; pickle its state\(\)"):
        pickle.dumps(machine)


def test_a_step_that_fails_leaves_the_machine_where_it_was(action):
    machine = feltmb.Machine(action, max_wall=1e-9)
    along(feltmb.Machine(action), 1, force=lambda _: 1.0)
    before = machine.state()
    with pytest.raises(feltmb.IntegrationError, match=r"step of 5 s from t = 0 s with force = 9 N"):
        machine.advance(5.0, force=9.0)
    assert machine.state() == before


def test_one_thread_at_a_time(action):
    """A second thread is refused, not let into the workspace of the first."""
    machine = feltmb.Machine(action)
    refused, done = [], threading.Event()

    def intrude():
        while not done.is_set():
            try:
                machine._stepper.state  # noqa: B018
            except feltmb.InvalidParameter as error:
                refused.append(str(error))
                return

    thread = threading.Thread(target=intrude)
    thread.start()
    for k in range(200):
        try:
            machine.advance(0.05, force=forte(k))
        except feltmb.InvalidParameter:  # the other looked just then
            continue
        if refused:
            break
    done.set()
    thread.join()
    assert refused
    assert "another thread" in refused[0]


# ---------------------------------------------------------------- the worked example


def test_a_controller_holds_the_key_at_half_dip(root):
    path = root / "examples" / "hold_the_key.py"
    assert len(path.read_text().splitlines()) <= 50
    spec = importlib.util.spec_from_file_location("hold_the_key", path)
    example = importlib.util.module_from_spec(spec)
    sys.modules["hold_the_key"] = example
    spec.loader.exec_module(example)
    course = np.array(example.hold(0.8))
    assert len(course) == 800
    held = course[600:, 1]
    assert np.max(np.abs(held - 0.5 * example.DIP)) < 3e-5
    assert np.all((course[:, 2] >= 0.0) & (course[:, 2] <= 20.0))
    assert re.search(r"def force\(self", path.read_text())


class Counted(feltmb.Machine):
    """A machine that remembers how often it was asked."""

    def __init__(self, action, record):
        super().__init__(action, max_step=1e-3)
        self.record = record


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy])
def test_a_copy_of_a_subclass_is_of_the_subclass(way, action):
    machine = Counted(action, [1])
    machine.advance(STEP, force=8.0)
    other = way(machine)
    assert type(other) is Counted
    assert other.state() == machine.state()
    assert other.record == [1]
    assert (other.record is machine.record) == (way is copy.copy)


def test_a_step_that_the_clock_does_not_resolve_is_refused(action):
    machine = feltmb.Machine(action)
    for dt in (1e-300, 5e-324):
        with pytest.raises(feltmb.InvalidParameter, match=r"dt = .* below the resolution"):
            machine.advance(dt, force=1.0)
    assert machine.time == 0.0
    machine.advance(1e-12, force=1.0)
    assert machine.time == 1e-12
