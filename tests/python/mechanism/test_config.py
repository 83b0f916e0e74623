"""Mechanism files: loading, changing values, hash, round trip."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb.action.actuator import load_actuator
from feltmb.cli import main
from feltmb.mechanism import Action, parse_setting
from feltmb.mechanism.parameters import bare_numbers, notes_of_numbers, with_noted_values
from feltmb.mechanism.values import apply_values
from unmodeled.errors import InvalidParameter

DATA = Path(__file__).resolve().parents[2] / "data"


def test_packaged_actions():
    assert {"steinway45", "steinway45_printed"} <= set(feltmb.packaged_actions())
    for name in feltmb.packaged_actions():
        assert feltmb.load_action(name).name == name


def test_coordinates_in_the_order_of_the_design(action, rigid):
    assert rigid.coordinates == (
        "key.lift", "key.angle", "whippen.angle", "jack.angle", "hammer.angle", "damper.angle",
    )  # fmt: skip
    elastic = ("u1", "v1", "v2")
    assert action.coordinates == (
        *rigid.coordinates, *(f"wire.{e}" for e in elastic), *(f"shank.{e}" for e in elastic),
    )  # fmt: skip


def test_units_are_converted_at_the_door(action):
    config = action.config
    assert config.bodies["key"].inertia == pytest.approx(1741e-6)
    assert config.surfaces["Gp3"].point == pytest.approx((0.218, -0.039394))
    assert config.bodies["wire"].angle == pytest.approx(np.deg2rad(75.5))
    assert config.contacts["04"].loading.b == 15600.0
    assert config.string.young_modulus == 2e11


def test_printed_tables_differ_by_the_regulation_only(action):
    printed = feltmb.load_action("steinway45_printed")
    assert printed.config.surfaces["Gp3"].point == pytest.approx((0.218, -0.0407))
    assert printed.config.surfaces["Gp10"].point == pytest.approx((-0.133, 0.0774))
    assert printed.config.contacts == action.config.contacts
    assert printed.config.bodies == action.config.bodies
    assert printed.hash != action.hash


def test_unknown_action_lists_the_packaged_ones():
    with pytest.raises(
        feltmb.InvalidParameter, match=r"'grand' is unknown; packaged are .*steinway45"
    ):
        feltmb.load_action("grand")
    with pytest.raises(feltmb.InvalidParameter, match="there is no such file"):
        feltmb.load_action("grand.toml")


# --- with_values ------------------------------------------------------------------------------


def test_a_number_without_a_unit_is_in_si_units(action):
    """The file gives the length in mm and the angle in deg; it keeps its units and gets a note."""
    other = action.with_values(
        {"bodies.wire.length": 0.07, "string.modes": 80, "wire.angle": np.pi / 3, "key.mass": 0.1}
    )
    assert other.config.bodies["wire"].length == 0.07
    assert other.config.bodies["wire"].angle == np.pi / 3
    assert other.config.string.modes == 80
    assert action.config.string.modes == 40
    length = {"value": 70.0, "unit": "mm", "note": "set by with_values, in SI: 0.07"}
    assert other.raw["bodies"]["wire"]["length"] == length
    assert other.raw["bodies"]["key"]["mass"]["note"] == "set by with_values"


def test_value_of_a_path_is_in_si_units(action):
    number, unit = action.value("bodies.head.mass")
    assert (number, unit) == (0.0078, "kg")
    for path, expected in (
        ("head.mass", (0.0078, "kg")),
        ("surfaces.Gp10.point.y", (pytest.approx(0.077), "m")),
        ("surfaces.Gp10.point", (pytest.approx((-0.133, 0.077)), "m")),
        ("wire.angle", (pytest.approx(np.radians(75.5)), "rad")),
        ("string.modes", (40, "1")),
        ("contacts.06.loading.b", (1740.0, "1/m")),
        ("springs.jack_spring.rest_angle", (0.4, "rad")),
        ("key.friction.amplitude", (action.config.bodies["key"].friction.amplitude, "N m")),
        ("gravity", ((0.0, -9.81), "m/s^2")),
    ):
        assert action.value(path) == expected, path
    for path in ("head.mass", "surfaces.Gp10.point", "wire.angle", "string.tension"):
        assert action.with_values({path: action.value(path).value}).hash == action.hash, path
    for path, message in (
        ("head.maas", "'maas' does not exist; did you mean 'mass'"),
        ("hed.mass", "'hed' does not exist"),
        ("string.kind", "is 'modal', expected a number"),
        ("wire.rigid", "is False, expected a number"),
        ("contacts.06.loading", "a table with contacts.06.loading.a"),
        ("string.tension.deeper", "'deeper' does not exist"),
        ("", "does not exist"),
    ):
        with pytest.raises(feltmb.InvalidParameter, match=message):
            action.value(path)


def test_text_and_tables_carry_their_own_unit(action):
    other = action.with_values(
        {
            "bodies.wire.angle": "1.3 rad",
            "string.length": {"value": 631.5, "unit": "mm"},
            "bodies.key.mass": "117.6 g",
        }
    )
    assert other.config.bodies["wire"].angle == 1.3
    assert other.config.string.length == pytest.approx(0.6315)
    assert other.config.bodies["key"].mass == pytest.approx(0.1176)


def test_wildcard_and_body_name(action):
    other = action.with_values({"contacts.*.law": "printed", "key.mass": 0.12})
    assert {c.law for c in other.config.contacts.values()} == {"printed"}
    assert other.config.bodies["key"].mass == 0.12
    slow = action.with_values({"contacts.*.alpha": 10})
    assert {c.alpha for c in slow.config.contacts.values()} == {10.0}


@pytest.mark.parametrize("path", ["surfaces.Gp10.point.y", "surfaces.Gp10.point.1"])
def test_component_of_a_point(action, path):
    for value in (0.0771, "77.1 mm", "0.0771"):
        other = action.with_values({path: value})
        assert other.config.surfaces["Gp10"].point == pytest.approx((-0.133, 0.0771)), value


def test_component_of_a_bare_list(action):
    assert action.with_values({"finger.direction.x": 0.0}).config.finger.direction == (0.0, -1.0)


def test_whole_point_and_start_pose(action):
    other = action.with_values(
        {"surfaces.Gp10.point": [-0.133, 0.0772], "start_pose.hammer.angle": -0.45}
    )
    assert other.config.surfaces["Gp10"].point == pytest.approx((-0.133, 0.0772))
    assert other.config.start_pose["hammer.angle"] == -0.45


def test_curve_coefficients_and_envelopes_are_in_si_units(action):
    other = action.with_values({"contacts.02.unloading.b": 3600.0})
    assert other.config.contacts["02"].unloading.b == 3600.0
    raw = action.raw
    raw["contacts"]["02"]["loading"] = {
        "a": 5.0,
        "b": 1.0,
        "c": 0.0,
        "unit": ["N/mm", "1/mm", "N/m"],
    }
    curve = Action(raw).with_values({"contacts.02.loading.a": 7e3, "contacts.02.loading.b *=": 2})
    assert curve.value("contacts.02.loading.a") == (7e3, "N/m")
    assert curve.value("contacts.02.loading.b") == (2e3, "1/m")
    loop = {"unit": ["mm", "N"], "compression": [0.0, 0.5, 1.0],
            "loading": [0.0, 4.0, 10.0], "unloading": [0.0, 3.0, 10.0]}  # fmt: skip
    raw["contacts"]["02"] |= {"law": "felt_memory", "memory": {"envelope": loop}}
    wider = Action(raw).with_values({"contacts.02.memory.envelope.compression": [0.0, 1e-3, 2e-3]})
    assert wider.raw["contacts"]["02"]["memory"]["envelope"]["compression"] == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"string.modez": 80}, r"string\.modez: unknown key; did you mean 'modes'"),
        ({"strings.modes": 80}, "'strings' does not exist"),
        ({"bodies.kee.mass": 1.0}, "'bodies.kee' does not exist"),
        ({"contacts.77.law": "mean"}, "'contacts.77' does not exist"),
        ({"surfaces.Gp10.point.z": 1.0}, "leads into a quantity|does not exist"),
        ({"surfaces.Gp10.point.2": 1.0}, "does not exist"),
        ({"string.modes": 0}, r"string\.modes: got 0, must be >= 1"),
        ({"string.modes": 2.5}, r"string\.modes"),
        ({"bodies.key.mass": -0.1}, r"bodies\.key\.mass: got .*, must be >= 0"),
        ({"bodies.key.mass": "0.1 m"}, "does not measure this quantity; expected a unit of kg"),
        ({"contacts.06.law": "soft"}, r"contacts\.06\.law: got 'soft', expected 'guarded'"),
        ({"string.kind": "rope"}, r"string\.kind: got 'rope', expected 'modal' or 'rigid_stop'"),
        ({"start_pose.nothing": 1.0}, "coordinate 'nothing' is missing"),
        ({"string.damping_ratio": 1.0}, "must be < 1"),
    ],
)
def test_values_that_cannot_be_set(action, values, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        action.with_values(values)


@pytest.mark.parametrize("name", ["steinway45_leaded", "steinway45_felt"])
def test_numbers_with_and_without_a_unit_change_what_a_whole_check_changes(name):
    """A change of numbers shares all other parts; radii of layers are those of surfaces."""
    action = feltmb.load_action(name)
    changes = [
        {"surfaces.Gp10.point.y": "77.1 mm"},
        {"surfaces.Gp10.point.y +=": "0.1 mm", "bodies.key.mass": 0.12},
        {"surfaces.Hp2.radius": "12.5 mm"},
        {"surfaces.Hp2.radius": 0.0125},
        {"springs.butt_spring.rest_angle": "-150 deg", "bodies.wire.angle +=": "1 deg"},
        {"contacts.06.friction.threshold_speed": "2 mm/s"},
    ]
    for values in changes:
        whole = Action(apply_values(action.raw, values, "with_values"), action.origin)
        changed = action.with_values(values)
        assert changed.hash == whole.hash != action.hash
        assert changed.config == whole.config


def test_all_unknown_paths_at_once(action):
    with pytest.raises(feltmb.InvalidParameter) as caught:
        action.with_values({"a.b": 1, "bodies.kee.mass": 2, "string.modes": 50})
    assert "'a'" in str(caught.value)
    assert "bodies.kee" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("string.modes=80", ("string.modes", 80)),
        ("string.kind = rigid_stop", ("string.kind", "rigid_stop")),
        ("shank.rigid=false", ("shank.rigid", False)),
        ("surfaces.Gp10.point=[1.0, 2.0]", ("surfaces.Gp10.point", [1.0, 2.0])),
        ("bodies.key.mass=117 g", ("bodies.key.mass", "117 g")),
        ('bodies.key.mass="117 g"', ("bodies.key.mass", "117 g")),
    ],
)
def test_setting_of_the_command_line(text, expected):
    assert parse_setting(text) == expected


@pytest.mark.parametrize("text", ["string.modes", "=3", ""])
def test_setting_without_path_or_value(text):
    with pytest.raises(feltmb.InvalidParameter, match="expected PATH=VALUE"):
        parse_setting(text)


def told(model, values):
    return notes_of_numbers(model, model.with_values(values), values)


def test_a_number_without_a_unit_is_in_si_units_and_it_is_told(action):
    (text,) = told(action, {"head.mass": 7.2})
    assert text.startswith("bodies.head.mass = 7.2 kg (was 0.0078 kg). A number without a unit")
    for path, value, says in (
        ("head.mass.value", 7.2, "bodies.head.mass = 7.2 kg (was 0.0078 kg)"),
        ("surfaces.Gp10.point.y", 0.0771, "surfaces.Gp10.point.y = 0.0771 m (was 0.077 m)"),
        ("surfaces.Gp10.point.y", 0.0771, "is in SI units; the file has mm"),
        ("bodies.head.angle", 30, "bodies.head.angle = 30 rad (was"),  # not in the file
        ("contacts.01.loading.a", 5, "contacts.01.loading.a = 5 N/m (was 5520 N/m)"),
        (
            "head.position",
            [3e-3, 4e-3],
            "bodies.head.position.x = 0.003 m (was 0.093 m); bodies.head.",
        ),
        ("contacts.*.loading.a", 5000.0, "; and "),
    ):
        (text,) = told(action, {path: value})
        assert says in text
    arm = load_actuator("wood")
    (text,) = told(arm, {"hub.radius": 0.03})
    assert text.startswith("hub.radius = 0.03 m")
    silent = {"head.mass": "7.2 g", "string.modes": 80, "wire.rigid": True,
              "contacts.06.law": "printed", "key.mass": 0.1176}  # fmt: skip
    assert told(action, silent) == []


@pytest.mark.parametrize(
    ("setting", "path", "expected"),
    [
        ("surfaces.Gp10.point.y+=0.5mm", "surfaces.Gp10.point.y", "77 mm -> 77.5 mm"),
        ("surfaces.Gp10.point.1 -= 20 um", "surfaces.Gp10.point.y", "77 mm -> 76.98 mm"),
        ("wire.angle+=0.01rad", "bodies.wire.angle", "75.5 deg -> 76.073 deg"),
        ("wire.angle.value+=0.01", "bodies.wire.angle", "75.5 deg -> 76.073 deg. A number without"),
        ("string.modes*=1.5", "string.modes", "40 -> 60"),
        ("string.modes-=10", "string.modes", "40 -> 30"),
        ("contacts.06.loading.a+=5N/mm", "contacts.06.loading.a", "23500 N/m -> 28500 N/m"),
        ("contacts.06.loading.a*=110%", "contacts.06.loading.a", "23500 N/m -> 25850 N/m"),
        ("gravity.y *= 0.5", "gravity.y", "-9.81 m/s^2 -> -4.905 m/s^2"),
        ('head.position+=[0, "1mm"]', "bodies.head.position.x", "93 mm -> 93 mm; bodies.head"),
    ],
)
def test_change_by_an_amount_tells_from_and_to(action, setting, path, expected):
    told = []
    with_noted_values(action, [setting], told.append)
    (text,) = told
    assert text.startswith(f"{path} {expected}")


def test_changes_act_in_their_order_and_everywhere(action, tmp_path):
    path = "surfaces.Gp10.point.y"
    values = {path: "76 mm", f"{path} +=": "1 mm", f"{path}*=": 2}
    other = action.with_values(values)
    assert other.config.surfaces["Gp10"].point == pytest.approx((-0.133, 0.154))
    assert action.config.surfaces["Gp10"].point == pytest.approx((-0.133, 0.077))
    assert other.raw["surfaces"]["Gp10"]["point"]["note"] == "y set by with_values"
    file = tmp_path / "mine.toml"
    file.write_text(
        'schema = 1\nname = "mine"\nextends = "steinway45"\n'
        '[values]\n"surfaces.Gp10.point.y +=" = "0.5 mm"\n"contacts.*.alpha *=" = 2\n'
    )
    mine = feltmb.load_action(file).config
    assert mine.surfaces["Gp10"].point[1] == pytest.approx(0.0775)
    assert {c.alpha for c in mine.contacts.values()} == {200.0}
    bare = feltmb.mechanism.Action(action.raw | {"gravity": [0.0, -9.81]})
    lighter = bare.with_values({"gravity.y +=": "1 mm/s^2"})
    assert lighter.config.gravity[1] == pytest.approx(-9.809, abs=1e-12)
    texts = feltmb.mechanism.Action(action.raw | {"gravity": [0.0, "-9810 mm/s^2"]})
    for change, expected in (
        ({"gravity *=": 0.5}, (0.0, -4.905)),
        ({"gravity +=": ["1 mm/s^2", 1]}, (0.001, -8.81)),
        ({"gravity": [0.3, -7]}, (0.3, -7.0)),
    ):
        assert texts.with_values(change).config.gravity == pytest.approx(expected), change
    arm = load_actuator("wood")
    grown = arm.with_values({"hub.radius +=": "1 mm"})
    assert grown.config.hub.radius == pytest.approx(arm.config.hub.radius + 1e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["surfaces.Gp10.point.y-=0.5N"], r"point\.y -=: unit 'N' does not measure"),
        (["surfaces.Gp10.point.y*=2mm"], r"point\.y \*=: unit 'mm' does not measure"),
        (["surfaces.Gp10.point.y+=up"], "got 'up', expected a number"),
        (["surfaces.Gp10.point+=2mm"], r"expected a component, such as surfaces\.Gp10\.point\.x"),
        (["surfaces.Gp10+=2mm"], "is a table, expected one of its numbers: point, normal"),
        (["string.kind+=1"], "the value is 'modal', expected a number"),
        (["wire.rigid*=2"], "the value is False, expected a number"),
        (["wire.angl+=1deg"], "no such number; did you mean 'angle'"),
        (["contacts.06.friction.b1+=10%"], r"for a share write \*="),
        (["string.modes*=1.51"], "expected a whole number"),
        (["key.mass-=1kg"], "must be >= 0"),
        (["capstn+=0.2mm"], r"did you mean capstan"),
        (["let-off=3mm"], r"did you mean surfaces\.Gp10 \(let-off button"),
        (["regulating_button.y+=3"], r"did you mean surfaces\.Gp10"),
        (["Kp2.point.y+=1mm"], r"did you mean surfaces\.Kp2"),
        (["key.mass+=1g", "key.mass+=1g"], r"--set key\.mass \+=: given twice"),
        (["+=3"], "expected PATH=VALUE"),
    ],
)
def test_changes_that_cannot_be_made(action, settings, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        with_noted_values(action, settings)


def test_numbers_without_a_unit_are_listed_with_the_si_unit_that_they_have(tmp_path, capsys):
    text = (DATA / "pendulum.toml").read_text()
    bare = {p.path: (p.value, p.unit, units) for p, units in bare_numbers(load(DATA))}
    assert bare["bodies.arm.position.y"] == (0.5, "m", ("mm",))
    assert bare["contacts.01.loading.b"] == (730.0, "1/m", ())
    assert not {"bodies.arm.mass", "bodies.arm.position.x", "finger.pad.exponent"} & set(bare)
    for old, new in (
        ('inertia = { value = 12.0, unit = "kg mm^2" }', "inertia = 12.0"),
        ('inertia = { value = 12.0, unit = "kg mm^2" }', "inertia = { value = 12.0 }"),
        ('inertia = { value = 12.0, unit = "kg mm^2" }', 'inertia = "12.0"'),
    ):
        assert old in text
        (tmp_path / "pendulum.toml").write_text(text.replace(old, new))
        found = {p.path: p for p, _ in bare_numbers(load(tmp_path))}
        assert found["bodies.arm.inertia"].value == 12.0
        assert found["bodies.arm.inertia"].unit == "kg m^2"
    assert bare_numbers(feltmb.load_action("steinway45")) == []
    assert bare_numbers(load_actuator("wood")) == []
    for path in (Path(__file__).resolve().parents[3] / "examples" / "gallery").glob("*.toml"):
        assert not [p.path for p, units in bare_numbers(feltmb.load_action(path)) if units], path
    with pytest.raises(SystemExit):
        main(["validate", str(DATA / "pendulum.toml")])
    out, err = capsys.readouterr()
    assert "numbers without a unit are in SI units: bodies.arm.position.y = 0.5 m;" in out
    assert "bodies.arm.position.y = 0.5 m: has no unit, and other numbers" in err
    with pytest.raises(SystemExit):
        main(["show", str(DATA / "pendulum.toml"), "--values"])
    out = capsys.readouterr().out
    assert re.search(r"bodies.arm.position +\[0.0, 0.5\] +m +no unit in the file", out)


def load(folder):
    return feltmb.load_action(folder / "pendulum.toml")


# --- hash, round trip, pickle, extends ---------------------------------------------------------


def test_hash_changes_with_every_kind_of_number(action):
    changes = [
        {"string.modes": 41},
        {"contacts.06.alpha": 99.0},
        {"contacts.06.law": "printed"},
        {"surfaces.Gp10.point.y": 0.0770000001},
        {"bodies.key.mass": 0.11760001},
        {"contacts.16.enabled": True},
        {"springs.jack_spring.rest_angle": 0.41},
        {"straps.bridle_strap.k3": 3.5e7},
        {"finger.pad.stiffness": 1.2e5},
    ]
    hashes = {action.hash} | {action.with_values(c).hash for c in changes}
    assert len(hashes) == len(changes) + 1


def test_hash_does_not_change_otherwise(action):
    assert feltmb.load_action("steinway45").hash == action.hash
    assert action.with_values({}).hash == action.hash
    assert action.with_values({"string.modes": 40}).hash == action.hash
    assert action.with_values({"bodies.wire.angle": "75.5 deg"}).hash == action.hash
    assert action.with_values({"about": "the same"}).hash == action.hash
    assert action.with_values({"contacts.06.label": "other words"}).hash == action.hash
    assert action.with_values({"contacts.06.note": "other words"}).hash == action.hash


def test_toml_round_trip(action, tmp_path):
    changed = action.with_values({"string.modes": 23, "contacts.*.law": "mean"})
    path = tmp_path / "copy.toml"
    path.write_text(changed.to_toml(), encoding="utf-8")
    again = feltmb.load_action(path)
    assert again.hash == changed.hash
    assert again.config == changed.config
    assert again.to_toml() == changed.to_toml()


def test_pickle(action):
    changed = action.with_values({"string.modes": 23})
    again = pickle.loads(pickle.dumps(changed))
    assert again.hash == changed.hash
    assert np.array_equal(again.rest_pose, changed.rest_pose)


def test_raw_and_rest_pose_are_copies(action):
    action.raw["string"]["modes"] = 7
    action.rest_pose[:] = 0.0
    assert action.config.string.modes == 40
    assert action.rest_pose[1] > 0.04
    with pytest.raises(Exception, match="frozen"):
        action.config.string.modes = 7


def test_extends(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'schema = 1\nname = "mine"\nextends = "steinway45"\n'
        '[values]\n"string.modes" = 60\n"surfaces.Gp10.point.y" = 0.0774\n'
    )
    mine = feltmb.load_action(path)
    assert mine.name == "mine"
    assert mine.config.string.modes == 60
    assert mine.config.surfaces["Gp10"].point == pytest.approx((-0.133, 0.0774))
    second = tmp_path / "second.toml"
    second.write_text('schema = 1\nname = "second"\nextends = "mine.toml"\n')
    assert feltmb.load_action(second).config.string.modes == 60


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('extends = "loop.toml"', "leads back to itself"),
        ('extends = "nothing"', "'nothing' is unknown"),
        ("extends = 3", "expected a name or a path"),
        ('extends = "steinway45"\n[bodies.key]\nmass = 1', "got bodies"),
        ('extends = "steinway45"\nvalues = 3', "values: expected a table"),
    ],
)
def test_faults_of_extends(tmp_path, text, message):
    path = tmp_path / "loop.toml"
    path.write_text(f'schema = 1\nname = "loop"\n{text}\n')
    with pytest.raises(feltmb.InvalidParameter, match=message):
        feltmb.load_action(path)


def test_every_number_has_a_path_that_can_be_set(action):
    """What ``quantities`` lists, ``with_values`` takes back without changing anything."""
    listed = list(action.quantities())
    assert len(listed) > 200
    same = {p: {"value": v, "unit": u} if u else v for p, v, u, _ in listed}
    assert action.with_values(same).hash == action.hash


def test_values_from_tables_have_a_source(action):
    """Every measured number says where it comes from."""
    for path, _, _, source in action.quantities():
        part = path.split(".")[0]
        if part in ("bodies", "surfaces", "springs", "straps") and path.split(".")[-1] in (
            "mass", "inertia", "center_of_mass", "point", "stiffness", "radius", "length",
        ):  # fmt: skip
            assert source, path


def test_files_of_a_mechanism_are_all_that_it_names(tmp_path):
    from feltmb.mechanism import files_of

    top, base, felt = (tmp_path / n for n in ("top.toml", "base.toml", "felt.toml"))
    top.write_text('schema = 1\nname = "top"\nextends = "base.toml"\n', encoding="utf-8")
    assert files_of(top) == (top, base)  # missing yet
    base.write_text('[contacts.01]\nlaw = { felt = "felt.toml" }\n', encoding="utf-8")
    assert files_of(top) == (top, base, felt)
    base.write_text('schema = 1\nextends = "steinway45"\n', encoding="utf-8")
    assert [p.name for p in files_of(top)] == ["top.toml", "base.toml", "steinway45.toml"]


def test_a_number_that_may_be_in_the_unit_of_the_file_is_told_with_every_run(data):
    """200 is kilograms, of a beater whose file says grams."""
    pedal, kick = feltmb.load_action(data / "pedal.toml"), feltmb.load_stroke(data / "kick.toml")
    heavy = pedal.with_values({"beater.mass": 200})
    told = "bodies.beater.mass = 200 kg (was 0.13 kg)"
    (text,) = feltmb.simulate(heavy, kick, duration=0.001).warnings
    assert text.startswith(told)
    assert text.endswith("the file has g")
    assert feltmb.gradient(heavy, kick, ["stroke.scale"], (), duration=0.001).warnings == (text,)
    swept = feltmb.sweep(pedal, [kick], [{"beater.mass": 200}, {"beater.mass": "200 g"}],
                         mode="list", options={"duration": 0.001})  # fmt: skip
    assert list(swept.table["warnings"]) == [text, ""]
    light = pedal.with_values({"bodies.board.mass": 0.5, "beater.mass": "200 g"})
    right = heavy.with_values({"beater.mass": 0.2})
    assert light.doubts == right.doubts == ()
    rule = "A number without a unit is in SI units; the file has g"
    told = "bodies.beater.mass = 0.2 kg (was 0.13 kg). "
    assert right.notes == (told + rule,)
    assert repr(right).endswith(told + rule)
    assert light.notes == (f"bodies.board.mass = 0.5 kg (was 0.4 kg). {rule}",)
    assert pedal.with_values({"beater.mass": "200 g", "beater.angle": 0.1}).notes == ()
    assert heavy.with_values({"board.mass": 0.5}).doubts == (text,)
    assert len(pedal.with_values({"beater.position": [5.0, 2.0]}).doubts) == 1
    assert len(pedal.with_values({"beater.mass *=": 2000.0, "gravity": [0.0, 0.0]}).doubts) == 0


@pytest.mark.parametrize(
    ("path", "wanted"),
    [
        ("beater.mass.value", (0.13, "kg")),
        ("bodies.beater.position.value.x", (0.25, "m")),
        ("bodies.beater.position.0", (0.25, "m")),
        ("contacts.*.hunt_crossley.stiffness", "contacts.02.hunt_crossley.stiffness"),
        ("surfaces.ball.dampers.x", "does not exist"),
    ],
)
def test_value_takes_the_paths_of_with_values(path, wanted, data):
    pedal = feltmb.load_action(data / "pedal.toml")
    if isinstance(wanted, tuple):
        assert pedal.value(path) == pytest.approx(wanted)
        return
    with pytest.raises(feltmb.InvalidParameter, match=wanted):
        pedal.value(path)


@pytest.mark.parametrize("path", ["string.modes", "bodies.key.mass", "bodies.key.mass +="])
@pytest.mark.parametrize("value", [iter((1, 2)), map(str, [1]), [iter(())], {"value": iter(())}])
def test_a_value_that_no_file_can_hold_is_told(path, value):
    with pytest.raises(InvalidParameter, match=re.escape(path.split(" ")[0])):
        feltmb.load_action("steinway45").with_values({path: value})
