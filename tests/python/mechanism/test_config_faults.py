"""Bad mechanism files: one message, all faults at once, each with what, where, got, expected."""

import contextlib
import copy
import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import feltmb
from feltmb.mechanism import Action


@pytest.fixture
def raw(action):
    return action.raw


def message_of(raw):
    with pytest.raises(feltmb.InvalidParameter) as caught:
        Action(raw, origin="mine.toml")
    return str(caught.value)


def test_all_faults_of_a_file_at_once(raw):
    raw["bodies"]["key"]["mass"] = {"value": -1.0, "unit": "kg"}
    raw["bodies"]["jack"]["parent"] = "whipen"
    raw["surfaces"]["Gp2"]["radius"] = {"value": 382.0, "unit": "kg"}
    raw["contacts"]["03"]["surfaces"] = ["Kp2", "Wp22"]
    raw["contacts"]["05"]["lwa"] = "printed"
    raw["contacts"]["06"]["alpha"] = 0.0
    raw["springs"]["jack_spring"]["coordinate"] = "jack"
    raw["string"]["modes"] = "forty"
    del raw["string"]["tension"]
    raw["points"]["hammer_tip"]["body"] = "heed"
    text = message_of(raw)
    assert text.startswith("mine.toml: 10 faults\n")
    for part in (
        "bodies.key.mass: got ",
        "bodies.jack.parent: body 'whipen' is missing; body names are backcheck, balance_slider",
        "surfaces.Gp2.radius: unit 'kg' does not measure this quantity; expected a unit of m",
        "contacts.03.surfaces: surface 'Wp22' is missing; surface names are",
        "contacts.05.lwa: unknown key; did you mean 'law'?",
        "contacts.06.alpha: got ",
        "springs.jack_spring.coordinate: coordinate 'jack' is missing",
        "string.modes: got 'forty'",
        "string.tension: is missing",
        "points.hammer_tip.body: body 'heed' is missing",
    ):
        assert part in text, part


def test_faults_of_the_core_join_those_of_the_schema(raw):
    """What only the whole shows is told in the same round as a wrong entry."""
    raw["string"]["modes"] = True  # no number, though Python would take it for one
    raw["bodies"]["key"]["rigid"] = "yes"
    raw["start_pose"]["key.angle"] = "high"
    raw["contacts"]["03"]["typo"] = 1
    raw["surfaces"]["Gp6"]["normal"] = [0.5, 0.5]  # seen by the core only
    raw["contacts"]["05"]["surfaces"] = ["Gp6", "Gp9"]  # seen by the core only
    raw["contacts"]["07"]["law"] = "felt_memory"
    raw["contacts"]["07"]["memory"] = {"creep_stiffness": 1.0}  # seen by the core only
    raw["contacts"]["09"]["law"] = "felt_memory"
    raw["contacts"]["09"]["memory"] = {
        "envelope": {"compression": [0, 1], "loading": [0], "unloading": [0, 1]}  # core only
    }
    text = message_of(raw)
    assert text.startswith("mine.toml: 8 faults\n")
    for part in (
        "string.modes: got True, expected a whole number",
        "bodies.key.rigid: got 'yes', expected true or false",
        "start_pose: key.angle: got 'high', expected a number",
        "contacts.03.typo: unknown key",
        "normal has length 0.7071",
        "one of the pair must be a circle",
        "creep_damping [N s/m] = 0, must be > 0 with creep",
        "contacts.09: felt_memory: envelope",
    ):
        assert part in text, part


def test_faults_that_a_wrong_entry_would_cause_are_not_told(raw):
    mass = raw["bodies"]["key"]["mass"]
    raw["bodies"]["key"]["mass"] = "heavy"
    text = message_of(raw)
    assert text.startswith("mine.toml: 1 fault\n")
    raw["bodies"]["key"]["mass"] = mass
    raw["contacts"]["06"]["alpha"] = 0.0  # the string's only contact
    assert message_of(raw).startswith("mine.toml: 1 fault\n")


def test_a_body_that_moves_no_mass_is_told_beside_other_faults(raw):
    for name in ("jack",):
        for key in ("mass", "inertia"):
            raw["bodies"][name].pop(key, None)
    raw["surfaces"]["Gp6"]["normal"] = [0.5, 0.5]
    text = message_of(raw)
    assert 'coordinate "jack.angle" moves no mass' in text
    assert "normal has length" in text


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("bodies", "key", "mass"), math.nan, "expected a finite number"),
        (("bodies", "key", "mass"), {"value": 1.0, "unit": "stone"}, "unknown unit 'stone'"),
        (("bodies", "key", "joint"), "ball", "got 'ball', expected 'revolute'"),
        (("bodies", "key", "parent"), "nobody", "bodies.key.parent: body 'nobody' is missing"),
        (("bodies", "key", "position"), [1.0], "got [1.0], expected 2 numbers"),
        (("bodies", "key", "position"), {"value": [1.0, "x"], "unit": "mm"}, "a finite number"),
        (("surfaces", "Gp6", "kind"), "plane", "got 'plane', expected 'line', 'circle'"),
        (("surfaces", "Gp6", "normal"), [0.5, 0.5], "normal has length"),
        (("contacts", "06", "surfaces"), ["Hp2"], "contacts.06.surfaces"),
        (("contacts", "06", "surfaces"), ["Gp6", "Gp9"], "one of the pair must be a circle"),
        (("contacts", "06", "loading"), {"a": 1.0}, "contacts.06.loading.b: is missing"),
        (("contacts", "06", "law"), "hunt_crossley", "contacts.06.hunt_crossley: is missing"),
        (("contacts", "6"), {}, "contacts.6: expected a number of two digits"),
        (("string", "surface"), "Gp2", "must be a line of the ground"),
        (("string", "surface"), "Gp66", "string.surface: surface 'Gp66' is missing"),
        (("finger", "body"), "hand", "finger.body: body 'hand' is missing"),
        (("events", "check", "after"), "never", "event 'never' is missing"),
        (("events", "check", "contact"), [8, 77], "events.check.contact: there is no contact 77"),
        (("reading", "strike_contact"), 77, "reading.strike_contact: there is no contact 77"),
        (("reading", "key_point"), "heel", "reading.key_point: point 'heel' is missing"),
        (("schema",), 2, "schema: got 2, expected 1"),
        (("typo",), 3, "typo: unknown key"),
    ],
)  # fmt: skip
def test_one_fault(raw, path, value, message):
    node = raw
    for part in path[:-1]:
        node = node[part]
    node[path[-1]] = value
    text = message_of(raw)
    assert message in text
    assert "Traceback" not in text
    assert "pydantic" not in text


def test_missing_tables(raw):
    assert "bodies: is missing" in message_of({k: v for k, v in raw.items() if k != "bodies"})
    assert "name: is missing" in message_of({k: v for k, v in raw.items() if k != "name"})
    assert "schema" in message_of({})


def test_loop_of_parents(raw):
    raw["bodies"]["key"]["parent"] = "jack"
    raw["bodies"]["whippen"]["parent"] = "key"
    text = message_of(raw)
    assert "never reaches the ground" in text
    for body in ("key", "whippen", "jack"):
        assert f'body "{body}"' in text


def test_coordinate_given_twice_or_without_mass(raw):
    raw["bodies"]["jack"]["coordinate"] = "key.angle"
    raw["springs"]["jack_spring"]["coordinate"] = "key.angle"
    raw["start_pose"].pop("jack.angle")
    assert 'coordinate "key.angle" is given twice' in message_of(raw)


def test_body_that_moves_no_mass(raw):
    raw["bodies"]["damper"] |= {"mass": 0.0, "inertia": 0.0}
    assert 'coordinate "damper.angle" moves no mass' in message_of(raw)


def test_unreachable_pose(data):
    """A hammer that falls for ever names the coordinate and the force that is left."""
    falling = feltmb.load_action(data / "hammer_string.toml").with_values(
        {"contacts.02.enabled": False, "gravity": [-9.81, 0.0]}
    )
    with pytest.raises(feltmb.ModelError, match=r"no rest pose was reached .*hammer\.x .*feels"):
        _ = falling.rest_pose


def test_files_that_are_no_mechanism(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("schema = 1\nname = ")
    with pytest.raises(feltmb.InvalidParameter, match=r"bad\.toml: is no TOML: "):
        feltmb.load_action(path)
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(feltmb.InvalidParameter, match="is no UTF-8 text"):
        feltmb.load_action(path)
    path.write_text("")
    with pytest.raises(feltmb.InvalidParameter, match="faults"):
        feltmb.load_action(path)
    with pytest.raises(feltmb.InvalidParameter, match="is a folder, expected a file"):
        feltmb.load_action(tmp_path)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("finger", "pad", "stiffness"), {"unit": "N/m^1.5"}),
        (("contacts", "06", "loading", "unit"), 3),
        (("contacts", "06", "loading", "unit"), None),
        (("bodies", "key", "coordinate"), ["x"]),
        (("springs", "jack_spring"), 3),
        (("bodies",), 3),
        (("contacts",), [1, 2]),
        (("surfaces", "Gp2", "kind"), {"a": 1}),
        (("events", "check", "contact"), {"a": 1}),
        (("bodies", "key", "friction"), 3.0),
        (("string",), 3),
        (("string", "strike_point"), "middle"),
        (("start_pose", "hammer.angle"), "x"),
        (("contacts", "²"), {}),
        (("extends",), "steinway45"),
    ],
)
def test_nodes_of_the_wrong_kind_are_faults_not_crashes(raw, path, value):
    node = raw
    for part in path[:-1]:
        node = node[part]
    node[path[-1]] = value
    assert "fault" in message_of(raw)


def test_friction_of_the_wrong_dimension_is_a_fault(raw):
    raw["contacts"]["06"]["friction"]["threshold_speed"] = {"value": 1.0, "unit": "N"}
    raw["bodies"]["key"]["friction"]["amplitude"] = {"value": 1.0, "unit": "m/s"}
    text = message_of(raw)
    assert "contacts.06.friction.threshold_speed" in text
    assert "bodies.key.friction.amplitude" in text


def paths(node, prefix=()):
    if prefix:
        yield prefix
    if isinstance(node, dict):
        for key, value in node.items():
            yield from paths(value, (*prefix, key))


ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.integers(-2, 2), max_size=3),
    st.dictionaries(st.sampled_from(["value", "unit", "a", "x"]), st.integers(), max_size=2),
)


RAW = feltmb.load_action("steinway45").raw
PATHS = list(paths(RAW))


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_any_damaged_file_is_refused_or_read_but_never_crashes(data):
    """A sample of what fuzz/test_fuzz.py (mechanism) does 32 000 times in the slow set."""
    raw = copy.deepcopy(RAW)
    for _ in range(data.draw(st.integers(1, 3))):
        path = PATHS[data.draw(st.integers(0, len(PATHS) - 1))]
        node = raw
        for part in path[:-1]:
            node = node.get(part) if isinstance(node, dict) else None
        if not isinstance(node, dict) or path[-1] not in node:
            continue  # an earlier damage has taken it
        if data.draw(st.booleans()):
            node[path[-1]] = data.draw(ODD)
        else:
            del node[path[-1]]
    with contextlib.suppress(feltmb.InvalidParameter):
        Action(raw)


@pytest.mark.parametrize("direction", [[0.0, 0.0], [1e300, 1e300]])
def test_a_direction_of_an_event_has_a_length(data, direction):
    action = feltmb.load_action(data / "pendulum.toml")
    point = next(iter(action.config.points))
    event = {"point": point, "travel": 0.001, "direction": direction}
    with pytest.raises(feltmb.InvalidParameter, match=r"direction: got .* expected a length of"):
        action.with_values({"events": {"moves": event}})


def test_a_string_without_mass_is_refused():
    """Its frequencies are no numbers to integrate with: runs were done and full of NaN."""
    action = feltmb.load_action("steinway45")
    with pytest.raises(feltmb.InvalidParameter, match=r"frequency of the last mode .* <= 1e12"):
        action.with_values({"string.linear_density": 1e-300})


def test_control_letters_of_names_are_escaped_in_messages(data):
    raw = copy.deepcopy(feltmb.load_action(data / "pendulum.toml").raw)
    raw["bodies"]["arm"]["coordinate"] = "\xad\u200b[2J"
    raw["start_pose"] = {"arm.angle": 0.1}
    text = message_of(raw)
    assert r"coordinate names are \u00ad\u200b[2J" in text
    assert "\xad" not in text
    assert "\u200b" not in text


def test_an_actuator_whose_pad_is_no_name(tmp_path):
    from feltmb import params
    from feltmb.action.actuator import load_actuator

    text = (params.folder("actuators") / "wood.toml").read_text("utf-8")
    path = tmp_path / "bad.toml"
    for value in ("{ a = 1 }", "2.5", "[1]"):
        path.write_text(text.replace('pad = "pulp"', f"pad = {value}", 1))
        with pytest.raises(feltmb.InvalidParameter, match=r"mount\.pad"):
            load_actuator(path)
    path.write_text(f'extends = "wood"\nname = "x"\n{"a" * 3000} = 1\n')
    with pytest.raises(feltmb.InvalidParameter) as told:
        load_actuator(path)
    assert len(str(told.value)) < 500


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            {"law": "hunt_crossley"},
            "contacts.01.hunt_crossley: is missing; law 'hunt_crossley' needs it; "
            "required: stiffness; optional: exponent, damping [s/m], note",
        ),
        (
            {"law": "kelvin_voigt", "kelvin_voigt": {"damping": 1.0}},
            "contacts.01.kelvin_voigt.stiffness: is missing; required: stiffness [N/m]; "
            "optional: damping [N s/m], note",
        ),
        (
            {"loading": None},
            "contacts.01.loading: is missing; law 'guarded' needs it; "
            "required: a [N/m], b [1/m], c [N/m]",
        ),
    ],
)
def test_a_missing_key_is_told_with_the_keys_of_its_table(data, changes, fault):
    raw = feltmb.load_action(data / "pendulum.toml").raw
    contact = raw["contacts"]["01"]
    contact |= changes
    raw["contacts"]["01"] = {k: v for k, v in contact.items() if v is not None}
    with pytest.raises(feltmb.InvalidParameter) as caught:
        feltmb.mechanism.Action(raw)
    assert str(caught.value).splitlines()[1:] == [f"  {fault}"]
