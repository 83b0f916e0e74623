"""Libraries as data: faults of files, selection, channels, names on the command line."""

from functools import cache

import numpy as np
import pytest

import feltmb
from feltmb.action.touch import static_touch
from feltmb.adapters import action_with_effects, load_library, mechanism_model, planned_strokes
from feltmb.adapters.changes import Change, Values, applied
from feltmb.adapters.findings import action_of_findings
from feltmb.adapters.model import resolve
from feltmb.mechanism import Action
from feltmb.mechanism.numbers import read_entry, replace_entry
from unmodeled.errors import InvalidParameter

ACTION = feltmb.load_action("steinway45")


def write(tmp_path, text):
    path = tmp_path / "lib.toml"
    path.write_text("schema = 1\nname = 'mine'\nextends = 'mechanism'\n" + text)
    return path


def test_all_faults_of_a_library_come_at_once(tmp_path):
    path = write(
        tmp_path,
        """
[effects.a]
magnitude = 0.1
changes = [{ path = "bodies.kee.mass", scale = 1.0 }]
[effects.b]
magnitude = "3 kg"
unit = "m"
changes = [{ path = "bodies.key.mass", scale = 1.0 }]
[effects.c]
magnitude = 0.1
[effects.d]
magnitude = 0.1
insert = { kind = "clearance", body = "nobody" }
""",
    )
    with pytest.raises(InvalidParameter) as error:
        load_library(ACTION, path)
    text = str(error.value)
    for part in (
        "lib.toml: 4 faults",
        "effects.a",
        "'kee'",
        "effects.b",
        "kg",
        "effects.c",
        "nobody",
    ):
        assert part in text


def test_an_unknown_key_is_named_with_the_near_one(tmp_path):
    with pytest.raises(InvalidParameter, match="did you mean 'mechanism'"):
        load_library(ACTION, write(tmp_path, "[effects.a]\nmagnitude = 1.0\nmechanisms = 'x'\n"))


def test_selection_by_name_pattern_and_all():
    library = load_library(ACTION)
    assert len(library.select(["all"])) == len(library.effects)
    assert {e.name for e in library.select(["felt_hysteresis.*"])} == {
        f"felt_hysteresis.{n:02d}" for n in range(1, 16)
    }
    with pytest.raises(InvalidParameter, match=r"let_off_buton.*near are let_off_button"):
        library.select(["let_off_buton"])
    with pytest.raises(InvalidParameter, match="no name of library"):
        library.select(["zzz*"])


def test_channels_have_names_and_outputs_stand_for_themselves():
    library = load_library(ACTION)
    assert library.outputs(["key", "hammer_tip"]) == (
        "key_front.y",
        "hammer_tip.x",
        "hammer_tip.y",
    )
    assert library.outputs(["jack_top.y"]) == ("jack_top.y",)
    with pytest.raises(InvalidParameter, match="channel 'hamer' is unknown; known are key"):
        library.outputs(["hamer"])
    with pytest.raises(InvalidParameter, match=r"outputs nose\.x: mechanism 'steinway45' has"):
        mechanism_model(ACTION, channels=["nose.x"])


def test_changes_combine_and_a_zero_leaves_the_very_object():
    config = ACTION.config
    path = "surfaces.Gp10.point.y"
    old = read_entry(config, path)
    moved = applied([(Change(path=path, add=1.0), 1e-4)] * 2, Values(config))
    assert moved == {path: pytest.approx(old + 2e-4)}
    assert read_entry(replace_entry(config, path, moved[path]), path) == moved[path]
    assert read_entry(config, path) == old
    factors = [(Change(path="head.mass", scale=1.0), 0.1), (Change(path="head.mass", exp=1.0), 0.2)]
    heavier = applied(factors, Values(config))
    assert heavier == {"head.mass": pytest.approx(0.0078 * 1.1 * np.exp(0.2))}
    assert applied([(Change(path=path, add=1.0, scale=2.0), 0.0)], Values(config)) == {}
    with pytest.raises(InvalidParameter, match="'kee' does not exist"):
        read_entry(config, "bodies.kee.mass")


def test_an_with_effects_mechanism_is_one_that_loads():
    library = load_library(ACTION)
    assert action_with_effects(ACTION, [(library.effect("let_off_button"), 0.0, None)]) is ACTION
    # The round trip through plain tables loses nothing that counts.
    raw = ACTION.config.model_dump(mode="json", by_alias=True, exclude_none=True)
    assert Action(raw).hash == ACTION.hash
    chosen = [
        (library.effect("pivot_clearance.butt"), 5e-5, None),
        (library.effect("felt_relaxation.02"), 0.2, 0.02),
        (library.effect("key_flexibility"), 1e-4, None),
        (library.effect("load_cell_mass"), 5e-3, None),
    ]
    changed = action_with_effects(ACTION, chosen)
    assert {"butt.pin.x", "butt.pin.y", "key_front.bend"} <= set(changed.coordinates)
    run = feltmb.simulate(changed, "forte", duration=0.12, ledger=True, rtol=1e-7)
    assert run.energy["residual_relative"] < 1e-5
    assert run.energy["created_by"] == []


@pytest.mark.parametrize("name", ["steinway45_leaded", "grand_action"])
def test_lead_in_the_key_is_a_cause(name):
    action = feltmb.load_action(name)
    entry = load_library(action).effect("key_lead")
    made = action_with_effects(action, [(entry, 0.010, None)])
    told = action.with_values({"lead": "10 g at 140 mm"})
    a, b = (static_touch(each) for each in (made, told))
    assert a.down_weight == pytest.approx(b.down_weight, abs=2e-3)  # the height differs
    assert a.down_weight < static_touch(action).down_weight - 0.05


def test_a_library_replaces_one_entry_of_a_kind_by_its_name():
    library = load_library(feltmb.load_action("grand_action"))
    for entries in (library.tolerances, library.effects):
        assert len({e.name for e in entries}) == len(entries)
    told = {e.name: e for e in library.tolerances}["joint_friction.hammer"]
    assert told.part == "The friction of the hammer center"
    assert told.remedy.startswith("Ease or renew the hammer center")
    assert library.effect("coulomb_friction.hammer").component == "hammer center"
    assert library.effect("coulomb_friction.jack").component == "jack joint"


def test_a_pivot_that_gives_tends_to_the_ideal_one():
    """Twice the compliance, twice the departure: the limit is the joint as it was."""
    library = load_library(ACTION)
    stroke = feltmb.load_stroke("forte")
    entry = library.effect("pivot_compliance.butt")

    def motion(action):
        run = feltmb.simulate(action, stroke, duration=0.066, ledger=False, rtol=1e-9)
        return run["hammer_tip.x"]

    plain = motion(ACTION)
    small, large = (
        motion(action_with_effects(ACTION, [(entry, s, None)])) - plain for s in (1e-7, 2e-7)
    )
    # At rest the pin stands where the load puts it; moving, it swings a little on its bushing.
    assert small[0] < -1e-9
    assert large[0] == pytest.approx(2.0 * small[0], rel=1e-5)
    assert np.max(np.abs(large)) > 5e-7
    assert np.max(np.abs(large - 2.0 * small)) < 0.06 * np.max(np.abs(large))


def test_a_member_that_the_model_takes_as_rigid_may_bend():
    """Twice the compliance, twice the departure: the limit is the rigid member."""
    rigid = ACTION.with_values({"shank.rigid": True})
    names = [e.name for e in load_library(rigid, "mechanism").effects]
    assert "flexibility.shank" in names
    assert "flexibility.wire" not in names  # it bends already
    entry = load_library(rigid, "mechanism").effect("flexibility.shank")
    assert action_with_effects(rigid, [(entry, 0.0, None)]).config is rigid.config

    def motion(action):
        run = feltmb.simulate(action, "forte", duration=0.06, ledger=False, rtol=1e-9)
        return run["hammer_tip.x"]

    plain = motion(rigid)
    small, large = (
        motion(action_with_effects(rigid, [(entry, s, None)])) - plain for s in (0.02, 0.04)
    )
    assert np.max(np.abs(large)) > 2e-7
    np.testing.assert_allclose(large, 2.0 * small, atol=0.01 * np.max(np.abs(large)))


@pytest.mark.parametrize(
    ("name", "each", "back"),
    [
        ("felt.11", "", {"felt.11"}),
        ("felt.{name}", 'for = "contact"\n', {"felt.01", "felt.11"}),
    ],
)
def test_a_tolerance_of_the_user_is_not_left_out_by_the_library_that_he_extends(
    tmp_path, name, each, back
):
    """steinway45 leaves out felt.01, felt.11 and felt.16; contact 16 is off."""
    without = {"felt.01", "felt.11", "felt.16"}
    assert not without & {e.name for e in load_library(ACTION).tolerances}
    file = tmp_path / "mine.toml"
    path = "contacts.{name}.alpha" if each else "contacts.11.alpha"
    file.write_text(
        f'schema = 1\nname = "mine"\nextends = "steinway45"\n[tolerances."{name}"]\n{each}'
        f'component = "felt"\nsd = 0.3\nchanges = [{{ path = "{path}", scale = 1.0 }}]\n'
    )
    found = {e.name: e.magnitude for e in load_library(ACTION, file).tolerances}
    assert without & set(found) == back
    assert {found[n] for n in back} == {0.3}


def test_all_effects_of_the_library_are_tested_unless_some_are_chosen():
    library = load_library(ACTION)
    assert library.select() == library.effects
    assert [e.name for e in library.select(["inertia.key", "camera_*", "camera_scale"])] == [
        "inertia.key",
        *(e.name for e in library.effects if e.name.startswith("camera_")),
    ]


def test_names_on_the_command_line():
    model, effects = resolve(
        "steinway45", {"channels": "key", "effects": "let_off_button,felt_*.02"}
    )
    assert model.outputs == ("key_front.y",)
    assert "let_off_button" in [e.name for e in effects]
    assert resolve("mine.py", {}) is None
    with pytest.raises(InvalidParameter, match="--set chanels: expected channels, effects"):
        resolve("steinway45", {"chanels": "key"})
    with pytest.raises(InvalidParameter, match="rtol: got 'small'"):
        resolve("steinway45", {"rtol": "small"})


def test_the_document_shows_the_library_as_it_is():
    import runpy
    from pathlib import Path

    tool = Path(__file__).parents[3] / "tools" / "make_effects_table.py"
    made = runpy.run_path(str(tool))
    text = made["DOCUMENT"].read_text(encoding="utf-8")
    assert made["renewed"](text) == text, "run tools/make_effects_table.py"


def test_a_rigid_member_leaves_its_effects_out_and_a_typo_does_not():
    action = ACTION
    rigid = action.with_values({"bodies.wire.rigid": True, "bodies.shank.rigid": True})
    whole, less = load_library(action), load_library(rigid)
    names, fewer = ({e.name for e in library.effects} for library in (whole, less))
    assert {"damping.wire", "damping.shank"} <= names - fewer
    with pytest.raises(
        InvalidParameter, match=r"'damping\.shnk' is not in library .*damping\.shank"
    ):
        whole.select(["damping.shnk"])


def test_an_extended_library_keeps_what_it_does_not_say(tmp_path):
    action = ACTION
    file = tmp_path / "mine.toml"
    file.write_text(
        'schema = 1\nname = "mine"\nextends = "steinway45"\n[effects.extra]\nlabel = "extra"\n'
        'component = "x"\nmagnitude = 0.1\nchanges = [{ path = "bodies.head.mass", scale = 1.0 }]\n'
    )
    base, mine = load_library(action), load_library(action, file)
    assert [e.name for e in mine.effects] == [*(e.name for e in base.effects), "extra"]
    assert mine.default_channels == base.default_channels
    assert [t.name for t in mine.tolerances] == [t.name for t in base.tolerances]


def test_a_turned_camera_turns_what_is_recorded_of_a_point_in_part():
    """Of whippen.y alone a tilt showed nothing: no set of effects explained the records."""
    model, effects = resolve("steinway45", {"channels": "whippen", "effects": "camera_tilt"})
    assert model.outputs == ("whippen.y", "whippen.x")
    assert model.beside == {"whippen.x"}
    (tilt,) = effects
    shown = np.array([[[1.0, 0.25], [2.0, 0.5]]])
    turned = tilt.observe(None, shown, np.array([0.1]), None)
    c, s = np.cos(0.1), np.sin(0.1)
    assert turned[0, :, 0] == pytest.approx([c - 0.25 * s, 2.0 * c - 0.5 * s], rel=1e-12)
    assert all("whippen.x" not in r.outputs for r in planned_strokes(model))
    plain, _ = resolve("steinway45", {"channels": "whippen", "effects": "camera_scale"})
    assert plain.outputs == ("whippen.y",)


def test_the_mass_of_the_head_is_not_held_to_its_tabulated_inertia():
    """With 9 g instead of 7.8 g in mass alone, 14.89 +- 0.15 % was told where 15.38 % is true."""
    model, _ = resolve("steinway45", {"effects": "camera_scale"})
    names = [p.name for p in model.parameters]
    assert "inertia.head" in names
    changed = action_with_effects(
        ACTION, [(load_library(ACTION).choose_tolerances(["inertia.head"])[0], -0.1, None)]
    )
    before, after = ACTION.config.bodies["head"], changed.config.bodies["head"]
    assert after.inertia == pytest.approx(0.9 * before.inertia)
    assert after.mass == before.mass


@cache
def plain_touch():
    return static_touch(ACTION)


def moved(name, size):
    """Static touch with an effect, minus the plain one: blow distance after let-off, weight."""
    library = load_library(ACTION)
    plain = plain_touch()
    other = static_touch(action_with_effects(ACTION, [(library.effect(name), size, None)]))
    strike = ACTION.config.reading.strike_contact
    gap, before = (float(np.min(s.press.gap[strike])) for s in (other, plain))
    return gap - before, other.balance_weight - plain.balance_weight


def test_each_friction_of_the_hammer_of_a_grand_names_the_swings_that_tell_it():
    library = load_library(feltmb.load_action("grand_action"))
    chain = ["joint_friction.hammer", "contact_friction.04", "contact_friction.11"]
    for entry in library.choose_tolerances(chain):
        assert "swing" in entry.remedy, entry.name
        assert entry.magnitude == 0.2


def test_the_rest_rail_moves_along_its_screw():
    action = feltmb.load_action("steinway45_leaded")
    (rail,) = load_library(action).choose_tolerances(["rest_rail"])
    as_told = action_with_effects(action, [(rail, 1.5e-3, None)])
    as_set = action.with_values({"rest_rail+=": "1.5 mm"})
    surfaces = [a.config.surfaces["Gp8"] for a in (as_told, as_set)]
    assert surfaces[0].point == pytest.approx(surfaces[1].point)
    assert surfaces[0].radius == surfaces[1].radius


def test_a_farther_string_leaves_a_larger_gap_at_let_off():
    gap, weight = moved("string_distance", 5e-4)
    assert gap == pytest.approx(5e-4, rel=1e-3)
    assert weight == pytest.approx(0.0, abs=1e-9)


def test_leads_in_the_key_change_the_balance_weight_by_their_moment():
    config = ACTION.config
    arm = config.finger.point[0]
    step = 1e-3
    gap, weight = moved("center_of_mass_x.key", step)
    expected = -config.bodies["key"].mass * 9.81 * step / arm
    assert weight == pytest.approx(expected, rel=0.03)  # the key is tilted by up to 3 degrees
    assert gap == pytest.approx(0.0, abs=3e-5)  # felt under another load


def test_inertia_is_not_seen_by_a_static_test_but_by_a_stroke():
    gap, weight = moved("inertia.key", 0.1)
    assert (gap, weight) == pytest.approx((0.0, 0.0), abs=1e-9)
    entry = load_library(ACTION).effect("inertia.key")
    stroke = feltmb.load_stroke("forte")
    runs = [
        feltmb.simulate(action_with_effects(ACTION, [(entry, size, None)]), stroke, duration=0.1)
        for size in (0.0, 0.1)
    ]
    plain, heavier = (r["hammer_tip.x"] - r["hammer_tip.x"][0] for r in runs)
    halfway = np.argmax(plain < 0.5 * plain.min())
    assert plain[halfway] < heavier[halfway] - 1e-4 < -1e-3


CART = """
schema = 1
name = "cart"
[bodies.cart]
joint = "prismatic"
axis = [1.0, 0.0]
coordinate = "cart.position"
mass = "0.8 kg"
[bodies.rod]
parent = "cart"
joint = "revolute"
coordinate = "rod.angle"
mass = "200 g"
center_of_mass = { value = [0.0, -150.0], unit = "mm" }
inertia = "1500 kg mm^2"
[springs.return]
coordinate = "cart.position"
stiffness = "40 N/m"
rest_angle = "0 m"
[finger]
body = "cart"
point = [0.0, 0.0]
direction = [1.0, 0.0]
[points.carriage]
body = "cart"
point = [0.0, 0.0]
"""


@pytest.fixture
def cart(tmp_path):
    (tmp_path / "cart.toml").write_text(CART)
    return feltmb.load_action(tmp_path / "cart.toml")


def test_a_mechanism_without_friction_gets_candidates_of_friction(cart):
    """Their magnitudes follow from the weight on each joint."""
    action = cart
    found = {e.name: e for e in load_library(action).effects}
    assert found["coulomb_friction.cart"].magnitude == pytest.approx(0.5 * 0.02 * 9.81)
    assert found["coulomb_friction.rod"].magnitude == pytest.approx(0.5 * 0.02 * 0.2 * 9.81 * 0.15)
    assert "felt_humidity" not in found
    rubbing = action_with_effects(action, [(found["coulomb_friction.cart"], 0.3, None)])
    assert rubbing.config.bodies["cart"].friction.amplitude == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("name", "size", "value", "note"),
    [
        ("gravity_misalignment", 0.02, [0.1962, -9.81], "x before 0"),  # the file has no gravity
        ("pivot_position_y.rod", 1e-3, [0.0, 1e-3], "y before 0"),
        ("center_of_mass_y.rod", 3e-3, [0, -147], "y before -150 mm"),
        ("inertia.rod", 0.1, 1650, "before 1500 kg mm^2"),
    ],
)
def test_a_changed_number_is_written_in_its_unit_with_what_it_was(cart, name, size, value, note):
    chosen = [(load_library(cart).effect(name), size, None)]
    path = chosen[0][0].changes[0].path
    found = action_of_findings(cart, chosen, provenance="fit")
    wanted = read_entry(action_with_effects(cart, chosen).config, path)
    assert read_entry(found.config, path) == pytest.approx(wanted, rel=1e-11)
    node = found.raw
    for key in path.removesuffix(".x").removesuffix(".y").split("."):
        node = node[key]
    assert node["value"] == pytest.approx(value)
    assert (node["source"], node["status"], node["note"]) == ("fit", "fitted", note)
