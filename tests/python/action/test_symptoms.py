"""Symptoms: causes in order of likelihood from a table of wear."""

import json
import math

import pytest
from click.testing import CliRunner

import feltmb
from feltmb import InvalidParameter, Wear
from feltmb.action.symptoms import PACKAGED, load_symptoms, packaged_wear
from feltmb.action.wearing import NUMBERS, Variant
from feltmb.cli.technician import symptom as command

BASE = dict.fromkeys(NUMBERS, 10.0) | {"let_off": 2.3, "check": 15.0}


def table(*rows):
    found = [(v, BASE | numbers) for v, numbers in rows]
    return Wear("own", "0", dict(BASE), tuple(found))


def felt(part, amount=5e-4):
    return Variant(part, "thinner", "thinner", amount, "")


def screw(amount, turns=0.0):
    return Variant("button", "screw", "", amount, "", "m", turns, "up" if amount > 0.0 else "down")


def test_likelihood_is_the_probability_to_reach_the_limit():
    """Hand formula: 2 mm to the limit. 0.5 mm of felt A takes all of it, of B a half.

    With 0.3 mm as the standard deviation, A needs 5/3 and B 10/3 of it.
    """
    found = feltmb.symptom(
        "blocks", table((felt("A"), {"let_off": 0.3}), (felt("B"), {"let_off": 1.3}))
    )
    a, b = (math.erfc(z / math.sqrt(2.0)) for z in (5 / 3, 10 / 3))
    assert [c.part for c in found.causes] == ["A"]  # B: below 2 %
    others = len(found.beyond)  # each like A, the only one that is listed
    assert found.causes[0].share == pytest.approx(a / (a + b) / (1.0 + others))
    assert found.beyond_share == pytest.approx(others / (1.0 + others))
    assert found.causes[0].change == "0.5 mm thinner"
    assert found.limit == 0.3


def test_a_number_that_is_lost_is_the_symptom():
    lost = table((felt("A"), {"let_off": math.nan}), (felt("B"), {"let_off": 3.0}))
    assert [c.part for c in feltmb.symptom("blocks", lost).causes] == ["A"]
    assert not feltmb.symptom("weak tone", lost).causes


def test_screws_take_the_number_back_with_their_turns():
    found = feltmb.symptom(
        "checks too low",
        table((screw(-5e-4, 0.5), {"check": 9.0}), (screw(5e-4, 0.5), {"check": 23.0})),
    )
    (cause,) = found.causes
    assert cause.change == "+0.25 mm = 0.25 turn up"  # half of the way of 8 mm suffices
    assert found.screws == ("button: -0.33 mm = 0.33 turn down",)  # 4 of 6 mm


def test_packaged_table_is_that_of_the_packaged_action():
    """If not, compute the table anew: see docs/howto/find_a_cause.md."""
    wear = packaged_wear()
    assert wear.hash == feltmb.load_action(PACKAGED).hash
    kinds = {"thinner", "harder", "friction", "spring", "tight", "missing", "screw"}
    assert {v.kind for v, _ in wear.rows} == kinds


@pytest.mark.parametrize("name", load_symptoms())
def test_every_symptom_has_a_cause(name):
    found = feltmb.symptom(name)
    assert found.causes
    sign = 1.0 if found.worse == "more" else -1.0
    assert sign * found.value < sign * found.limit  # the regulated action does not have it
    listed = sum(c.share for c in found.causes)
    assert 0.9 < listed + found.beyond_share <= 1.0 + 1e-9
    assert max(c.share for c in found.causes) < 0.7  # others are possible
    result = CliRunner().invoke(command, [name, "--json"])
    assert json.loads(result.stdout)["name"] == name


def test_known_causes_come_first():
    """Workshop knowledge: the let-off button blocks, and the backcheck wire sets the check."""
    for name in ("blocks", "double strikes"):
        assert "let-off button" in feltmb.symptom(name).causes[0].part
    for name in ("checks too low", "checks too high"):
        assert any("backcheck wire" in c.part for c in feltmb.symptom(name).causes)
    sticks = feltmb.symptom("key sticks")
    assert sticks.causes[0].part == "key, front bushing"
    assert {"key, balance hole and bushing", "hammer butt, joint"} < {c.part for c in sticks.causes}
    assert any("rub" in text for text in sticks.beyond)
    slow = {c.part for c in feltmb.symptom("slow repetition").causes}
    assert {"hammer butt, joint", "butt spring", "bridle strap"} <= slow


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("bobbling", "bubbles"),
        ("blubbering", "bubbles"),
        ("heavy or sluggish", "uneven touch"),
        ("sluggish", "key sticks"),
        ("The hammer does not check", "checks too low"),
        ("doesn't check", "checks too low"),
        ("jack slips", "jack slips"),
        ("won't repeat", "slow repetition"),
        ("it won\N{RIGHT SINGLE QUOTATION MARK}t repeat!", "slow repetition"),
        ("clicking", "noisy return"),
        ("double-striking hammer", "double strikes"),
    ],
)
def test_words_of_the_trade_are_understood(words, name):
    assert feltmb.symptom(words).name == name


def test_two_symptoms_in_one_text_are_told():
    with pytest.raises(InvalidParameter, match="is blocks or noisy return: expected one of"):
        feltmb.symptom("blocking and clicking")


def test_causes_of_double_strikes_are_those_of_the_trade():
    told = " ".join(feltmb.symptom("double strikes").beyond)
    for word in ("lost motion", "hammer blow", "key dip", "backcheck", "damper spring"):
        assert word in told


def test_what_is_unknown_is_refused(tmp_path):
    with pytest.raises(InvalidParameter, match=r"blocks, double strikes, .*weak tone"):
        feltmb.symptom("xyz")
    (tmp_path / "no.json").write_text("{}")
    result = CliRunner().invoke(command, ["blocks", "--wear", str(tmp_path / "no.json")])
    assert "feltmb wear" in str(result.exception)
