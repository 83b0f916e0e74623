"""Numbers, keys and values that a mechanism cannot have."""

import tomllib
from importlib import resources

import numpy as np
import pytest
from calls import refused

import feltmb
from feltmb.mechanism import Action


@pytest.fixture(scope="module")
def pendulum():
    """The mechanism that ``feltmb new`` writes."""
    text = (resources.files("feltmb") / "params" / "template.toml.txt").read_text("utf-8")
    return Action(tomllib.loads(text), "template.toml")


def test_integer_beyond_floats(pendulum):
    # OverflowError: int too large to convert to float
    refused(lambda: pendulum.with_values({"bodies.hammer.mass": 10**400}), "finite number")
    refused(
        lambda: pendulum.with_values({"bodies.hammer.center_of_mass": [10**400, 0]}),
        "finite number",
    )


def test_integer_of_thousands_of_digits(tmp_path):
    # ValueError: Exceeds the limit (4300 digits) for integer string conversion
    path = tmp_path / "digits.toml"
    path.write_text("schema = " + "1" * 5000)
    refused(lambda: feltmb.load_action(path), "digits.toml")
    refused(
        lambda: Action({"name": "x"}).with_values(
            dict([feltmb.mechanism.parse_setting("schema=" + "1" * 5000)])
        )
    )


def test_power_of_a_unit_beyond_floats(pendulum):
    # OverflowError: (34, 'Numerical result out of range')
    refused(
        lambda: pendulum.with_values({"bodies.hammer.mass": "1 kHz^999"}),
        "bodies.hammer.mass",
        "expected a unit of kg",
    )


def test_digits_that_are_no_numbers(action, pendulum):
    # ValueError: invalid literal for int() with base 10: '²²'
    refused(lambda: action.with_values({"surfaces.Gp3.point.²": 1.0}), "point.²")
    raw = pendulum.raw
    raw["contacts"]["²²"] = raw["contacts"]["01"]
    refused(lambda: Action(raw), "contacts.²²: expected a number of two digits")


def test_byte_order_mark_of_a_mechanism(pendulum, tmp_path):
    # "is no TOML: Invalid statement (at line 1, column 1)", while CSV files may begin with one
    path = tmp_path / "marked.toml"
    path.write_text("\ufeff" + pendulum.to_toml(), encoding="utf-8")
    assert feltmb.load_action(path).hash == pendulum.hash


def test_dotted_keys_nested_deeply(tmp_path):
    # RecursionError from copy.deepcopy
    path = tmp_path / "deep.toml"
    path.write_text("a." * 3000 + "b = 1\n")
    refused(lambda: feltmb.load_action(path), "deep.toml", "nested too deeply")


def test_faults_without_end_are_cut(pendulum):
    # 400000 lines of message for as many unknown keys
    text = refused(lambda: Action(pendulum.raw | {f"k{i}": 1 for i in range(3000)}))
    assert "3000 faults" in text
    assert len(text.splitlines()) < 150


def test_values_of_numpy_reach_the_file(pendulum):
    # ConvertError of tomlkit after the simulation: int64 is no TOML item
    values = {"bodies.hammer.mass": np.float64(0.013), "contacts.02.enabled": np.bool_(False)}
    other = pendulum.with_values(values | {"surfaces.pad.point": np.array([0.0, 0.059])})
    assert "13.0" in other.to_toml()
    assert other.config.surfaces["pad"].point == pytest.approx((0.0, 0.059))


def test_none_is_no_value_of_a_file(pendulum):
    # accepted, then ConvertError of tomlkit after the simulation
    refused(lambda: pendulum.with_values({"bodies.hammer.length": None}), "length: got None")


@pytest.mark.parametrize("values", [None, 5, "string.modes=80", [("a", 1)], {1: 2}])
def test_with_values_wants_paths(pendulum, values):
    # AttributeError: 'int' object has no attribute 'items'
    refused(lambda: pendulum.with_values(values), "with_values", "expected")


def test_tables_below_values_of_extends(tmp_path):
    # [values] string.modes = 80 replaced the whole string: "string.surface: is missing", ...
    path = tmp_path / "mine.toml"
    path.write_text(
        'schema = 1\nname = "mine"\nextends = "steinway45"\n[values]\nstring.modes = 80\n'
    )
    refused(lambda: feltmb.load_action(path), '"string.modes" = ...')


def test_check_contact_that_does_not_exist(action):
    # KeyError: 'contact99.force' after the simulation
    refused(
        lambda: action.with_values({"reading.check_contacts": [8, 99]}),
        "reading.check_contacts: there is no contact 99",
    )


def test_events_that_wait_for_one_another(action):
    # accepted; none of them ever happened
    refused(
        lambda: action.with_values({"events.string_contact_on.after": "check"}),
        "events.check: waits for itself",
    )


@pytest.mark.parametrize("name", ["time", "tip.x", "energy.kinetic", "contact01.force", "a/b"])
def test_names_of_outputs_that_collide(pendulum, name):
    # ValueError of xarray after the simulation, or an output silently replaced by another
    raw = pendulum.raw
    raw["bodies"]["hammer"]["coordinate"] = name
    raw["springs"]["return_spring"]["coordinate"] = name
    raw["start_pose"] = {name: 0.1}
    refused(lambda: Action(raw), f"output {name!r}")


def test_long_words_of_a_file_are_cut_in_the_message(tmp_path):
    # messages of 5000 letters
    path = tmp_path / "a.toml"
    path.write_text(f'schema = 1\nname = "a"\n{"b" * 5000} = 1\n')
    for read in (feltmb.load_action, feltmb.load_stroke, feltmb.load_targets):
        assert len(refused(lambda read=read: read(path))) < 3000


def test_force_without_end(pendulum):
    # accelerations of NaN
    refused(lambda: feltmb.evaluate(pendulum, [0.0], [0.0], float("inf")), "finger_force")


def test_faults_of_limits_name_the_limit(pendulum):
    # "max_step [s] and max_wall [s] must be >= 0, max_steps >= 1" for any of the three
    refused(lambda: feltmb.simulate(pendulum, "staccato", max_wall=-1.0), "max_wall = -1 s")
    refused(lambda: feltmb.simulate(pendulum, "staccato", max_step=-1.0), "max_step = -1 s")
