"""Page for a customer: the guilty part, the curve of the hand, the sentences."""

import json
import re
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

import feltmb
from feltmb import InvalidParameter
from feltmb.action.customer import GRAM, customer_page
from feltmb.cli.gap import report as command


def change(name, component, size, unit="1", **other):
    row = {"name": name, "title": name, "component": component, "unit": unit, "size": size}
    return row | {"tier": "named", "mechanism": "", "remedy": "", "equivalents": []} | other


def result(folder, *rows, verdict="NAMED", parameters=()):
    data = {"format": "unmodeled diagnosis", "version": 2, "verdict": verdict, "changes": rows}
    data |= {"parameters": parameters}
    (folder / "report.json").write_text(json.dumps(data))
    return folder


KEY = change("coulomb_friction.key", "key joint", 0.0079, "N m")
FELT = change("felt_thickness.03", "contact 03, key capstan - whippen", 5e-4, "m")


def test_a_joint_and_a_felt_are_places(tmp_path):
    page = customer_page(result(tmp_path, KEY), "steinway45")
    assert page.bodies == ("key",)
    assert page.points == (pytest.approx((0.0, 0.0), abs=1e-3),)  # the balance pin
    friction = page.before.value("bodies.key.friction.amplitude").value
    assert friction == pytest.approx(0.0158)
    page = customer_page(result(tmp_path, FELT), "steinway45")
    assert page.bodies == ("key", "whippen")
    (point,) = page.points
    assert point == pytest.approx((-0.141, 0.035), abs=0.015)  # about the top of the capstan
    assert "0.5\N{NO-BREAK SPACE}mm" in page.found
    assert "contact" not in page.found


def test_a_screw_is_a_place_and_a_mass_is_a_whole_part(tmp_path):
    screw = change("capstan_height", "capstan", 5e-4, "m")
    (point,) = customer_page(result(tmp_path, screw), "steinway45").points
    assert point == pytest.approx((-0.141, 0.035), abs=0.015)
    heavy = change("mass.head", "mass of hammer head", 0.1)
    page = customer_page(result(tmp_path, heavy), "steinway45")
    assert (page.bodies, page.points) == (("head",), ())
    spring = change("spring_rate.butt_spring", "butt spring", 0.1)
    assert len(customer_page(result(tmp_path, spring), "steinway45").points) == 1


def test_a_sensor_is_no_fault_of_the_instrument(tmp_path):
    late = change("input_delay", "force sensor", 2e-4, "s", remedy="Tap the sensor.")
    page = customer_page(result(tmp_path, late, KEY), "steinway45")
    alone = customer_page(result(tmp_path, KEY), "steinway45")
    assert (page.found, page.work) == (alone.found, alone.work)
    page = customer_page(result(tmp_path, late), "steinway45")
    assert page.found == "The action moves as a sound action does."
    assert page.work == ("Nothing needs to be done.",)


def test_a_parameter_that_changed_is_the_answer(tmp_path):
    rows = [
        {"name": n, "tabulated": 0.0, "value": v}
        for n, v in (("capstan_height", -6.6e-4), ("mass.head", 0.03))
    ]
    turn = {"unit": "turn", "per_unit": 1.0 / 0.7e-3, "words": ["up", "down"]}
    capstan = change("capstan_height", "", -6.6e-4, "m", title="The capstan", tier="fitted",
                     low=-6.9e-4, high=-6.3e-4, user_unit=turn)  # fmt: skip
    folder = result(tmp_path, capstan, verdict="CALIBRATED", parameters=rows)
    page = customer_page(folder, "steinway45")
    assert page.bodies == ("key",)
    plain = page.found.replace("\N{NO-BREAK SPACE}", " ")
    assert plain == "The capstan is off (-0.66 mm, 0.94 turns down)."
    assert page.work == ("Turn the capstan 0.94 turns up.",)
    path = "surfaces.Kp2.point.y"
    height = [a.value(path).value for a in (page.after, page.before)]
    assert height[1] - height[0] == pytest.approx(-6.6e-4)
    assert page.after.hash == feltmb.load_action("steinway45").hash
    either = result(tmp_path, capstan, KEY | {"equivalents": [FELT]})
    assert "One of these was found" in customer_page(either, "steinway45").found


def test_work_that_was_done_replaces_the_advice(tmp_path):
    folder = result(tmp_path, KEY)
    assert not customer_page(folder, "steinway45").done
    page = customer_page(folder, "steinway45", done=["Bushing eased."])
    assert page.done
    assert page.work == ("Bushing eased.",)


@pytest.mark.parametrize(
    ("done", "hand", "left"),
    [
        ((), "goes down with 93 g and lifts 30 g; after the work, it will be 79 g and 43 g.",
         "has 0.2 mm of travel left; after the work, it will have 0.5 mm."),
        (["Eased."], "goes down with 79 g and lifts 43 g; before, it was 93 g and 30 g.",
         "has 0.5 mm of travel left; before, it had 0.2 mm."),
    ],
)  # fmt: skip
def test_work_that_is_not_done_has_not_changed_the_weights(tmp_path, done, hand, left):
    page = customer_page(result(tmp_path, KEY), "steinway45", done=done)
    old, new = (SimpleNamespace(down_weight=d * GRAM, up_weight=u * GRAM)
                for d, u in ((93.0, 30.0), (79.0, 43.0)))  # fmt: skip
    assert page._hand(old, new, False).endswith(hand)
    assert page._left(0.2, 0.5, False).endswith(left)


NAN = float("nan")


@pytest.mark.parametrize(
    ("before", "after", "now", "done"),
    [
        (0.52, 0.48,
         "After the let-off, the key has 0.5 mm of travel left, now and after the work.",
         "After the let-off, the key has 0.5 mm of travel left, as before."),
        (0.0, 0.5,
         "The hammer does not let off before the key is at its end; after the work, the key will "
         "have 0.5 mm of travel left after the let-off.",
         "After the let-off, the key has 0.5 mm of travel left; before, the hammer did not let "
         "off."),
        (0.0, -0.1,
         "The hammer does not let off before the key is at its end, now and after the work.",
         "The hammer does not let off before the key is at its end, as before."),
        (NAN, 0.5, "After the work, the key will have 0.5 mm of travel left after the let-off.",
         "After the let-off, the key has 0.5 mm of travel left."),
        (0.5, NAN, "After the let-off, the key has 0.5 mm of travel left.",
         "Before, the key had 0.5 mm of travel left after the let-off."),
        (NAN, NAN, *2 * ("The travel of the key after the let-off could not be measured.",)),
    ],
)  # fmt: skip
def test_travel_after_the_let_off(tmp_path, before, after, now, done):
    folder = result(tmp_path, KEY)
    for work, text in (((), now), (["Eased."], done)):
        page = customer_page(folder, "steinway45", done=work)
        assert page._left(before, after, False) == text


def test_a_key_without_let_off_has_no_travel_after_it(tmp_path):
    page = customer_page(result(tmp_path, KEY), "steinway45")
    none = SimpleNamespace(has_let_off=False, down_weight=GRAM, up_weight=GRAM)
    page.__dict__["touches"] = None, none  # cannot be played slowly before
    assert page.sentences[2] == "After the work, the hammer will not let off."


@pytest.mark.parametrize("done", [[""], ["Bushing eased.", " "]])
def test_empty_work_is_refused(tmp_path, done):
    folder = result(tmp_path, KEY)
    with pytest.raises(InvalidParameter, match="done: got an empty sentence"):
        customer_page(folder, "steinway45", done=done)


def test_empty_work_of_the_command_is_refused(tmp_path):
    options = ["--customer", "--done=", "-o", str(tmp_path / "page.html")]
    ended = CliRunner().invoke(command, [str(result(tmp_path, KEY)), "steinway45", *options])
    assert isinstance(ended.exception, InvalidParameter) or ended.exit_code == 2


def test_the_size_of_a_friction_is_what_it_has_more(tmp_path):
    library = feltmb.adapters.load_library(feltmb.load_action("steinway45"))
    told = KEY | {"mechanism": library.effect("coulomb_friction.key").mechanism}
    page = customer_page(result(tmp_path, told), "steinway45")
    plain = page.found.replace("\N{NO-BREAK SPACE}", " ")
    assert plain.endswith("has more dry friction (0.0079 N m).")


def test_without_a_cause_before_and_after_are_one(tmp_path):
    page = customer_page(result(tmp_path, verdict="NO_GAP"), "steinway45")
    assert page.before is page.after
    assert page.bodies == ()
    assert page.work == ("Nothing needs to be done.",)
    unknown = customer_page(result(tmp_path, verdict="UNKNOWN"), "steinway45")
    assert "regulate" in unknown.work[0]


def test_what_is_no_result_is_refused(tmp_path):
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(InvalidParameter, match=re.escape("feltmb gap diagnose --out")):
        customer_page(tmp_path, "steinway45")
    other = result(tmp_path, change("spring_rate.none", "none", 0.1))
    with pytest.raises(InvalidParameter, match="another mechanism"):
        customer_page(other, "steinway45")
    (tmp_path / "photo.png").write_text("no picture")
    with pytest.raises(InvalidParameter, match="PNG or JPEG"):
        customer_page(result(tmp_path, KEY), "steinway45", photo=tmp_path / "photo.png")


@pytest.mark.slow
def test_page_of_a_key_with_twice_the_friction(tmp_path):
    """Hand formula: friction torque over the arm of the finger, 0.0079 N m / 225 mm = 3.6 g."""
    folder = result(tmp_path, KEY)
    page = customer_page(folder, "steinway45", workshop="Workshop <1>")
    before, after = page.touches
    assert (before.down_weight - after.down_weight) / 9.80665e-3 == pytest.approx(3.58, rel=0.05)
    assert len(page.sentences) == 3
    text = page.html()
    assert text.count("<svg") == 2
    assert "Workshop &lt;1&gt;" in text
    done = CliRunner().invoke(
        command, [str(folder), "steinway45", "--customer", "-o", str(tmp_path / "page.pdf")]
    )
    assert done.exit_code == 0
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    assert feltmb.load_action("steinway45").hash == page.after.hash


def test_a_screw_of_the_frame_has_a_ring(tmp_path):
    turn = {"unit": "turn", "per_unit": 1.0 / 0.7e-3, "words": ["up", "down"]}
    button = change("let_off_button", "", -3.5e-4, "m", title="The let-off button", tier="fitted",
                    low=-3.52e-4, high=-3.48e-4, user_unit=turn)  # fmt: skip
    page = customer_page(result(tmp_path, button, verdict="CALIBRATED"), "steinway45")
    assert page.bodies == ("ground",)
    assert len(page.points) == 1  # contact of the jack with the button
    assert page.work == ("Turn the let-off button half a turn up.",)


def test_dollar_signs_are_no_mathematics(tmp_path, monkeypatch):
    monkeypatch.setattr("feltmb.action.touch.static.STEP", 1e-4)  # of its curves no number matters
    page = customer_page(
        result(tmp_path, KEY), "steinway45", title="From $x_{ to $y", workshop="A$$ & B$",
        done=["Paid $5_ and $6^."],
    )  # fmt: skip
    assert page.write(tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    assert page.write(tmp_path / "page.HTM").read_text(encoding="utf-8").count("<svg") == 2
