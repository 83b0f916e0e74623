"""The rules of the judgement: each decides for one candidate that no other rule would mark so."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from unmodeled import InvalidParameter, diagnose
from unmodeled.report.why import SENTENCES, why
from unmodeled.search import ledger
from unmodeled.search.ledger import RULES, Finding, Mark, from_plain, listed, marked
from unmodeled.search.result import plain

from .conftest import spring_record

OUTSIDE = Finding("wear", fitted=True, evidence=-5.0)
MEMBER = Finding(
    "wear", member=True, fitted=True, probability=0.99, least_probability=0.95, takes=5.0,
    evidence=9.0, together=0.99,
)  # fmt: skip
UNLIKELY = replace(MEMBER, probability=0.5, least_probability=0.4, together=0.5)
#: Each code: a candidate for which it decides, its mark, and the code that it has without the rule.
CASES = {
    "stands for": (replace(OUTSIDE, stands_for=("tear",)), None, "less probable"),
    "not fitted": (Finding("wear"), None, "less probable"),
    "differs": (replace(OUTSIDE, left=True, same=1e-6), None, "not needed"),
    "refused": (replace(OUTSIDE, left=True, refused=True), None, "not needed"),
    "not needed": (replace(OUTSIDE, left=True), None, "less probable"),
    "less probable": (OUTSIDE, None, "unsure"),
    "cut": (replace(MEMBER, complete=False), Mark.UNSURE, "named"),
    "at limit": (replace(UNLIKELY, at_limit=True, predicts=True), Mark.UNSURE, "supported"),
    "zero": (replace(MEMBER, excludes_zero=False), Mark.UNSURE, "named"),
    "small": (replace(MEMBER, takes=0.4), Mark.SMALL, "does not matter"),
    "does not matter": (replace(UNLIKELY, takes=0.4, equivalents=("tear",)), Mark.UNSURE, "one of"),
    "one of": (replace(MEMBER, equivalents=("tear",)), Mark.ONE_OF, "named"),
    "named": (MEMBER, Mark.NAMED, "unsure"),
    "supported": (replace(UNLIKELY, predicts=True), Mark.SUPPORTED, "unsure"),
    "unsure": (UNLIKELY, Mark.UNSURE, None),
    "trust": (replace(MEMBER, least_probability=0.6), Mark.NAMED, None),
    "chosen by": (replace(UNLIKELY, predicts=True), Mark.SUPPORTED, None),
}
BESIDE = ("trust", "chosen by")


def test_each_rule_has_a_code_a_threshold_a_sentence_and_a_case():
    codes = [r.code for r in RULES]
    assert len({*codes}) == len(codes)
    assert {*codes} == {*CASES} == {*SENTENCES}
    assert all(r.threshold for r in RULES if r.code != "unsure")
    assert [r.code for r in RULES[ledger.MARKING :]] == list(BESIDE)


@pytest.mark.parametrize("code", CASES)
def test_each_rule_decides_for_a_candidate(code, monkeypatch):
    finding, mark, other = CASES[code]
    found = marked(finding)
    assert found.mark is mark
    assert code in (found.codes[1:] if code in BESIDE else found.codes[:1])
    rest = tuple(r for r in RULES if r.code != code)
    monkeypatch.setattr(ledger, "RULES", rest)
    monkeypatch.setattr(ledger, "MARKING", ledger.MARKING - (code not in BESIDE))
    if code in BESIDE:
        assert code not in marked(finding).codes
    elif other is None:
        with pytest.raises(StopIteration):
            marked(finding)
    else:
        assert marked(finding).codes[0] == other


@pytest.mark.parametrize(
    ("finding", "mark"),
    [
        # What is outside the answer has no mark, whatever else is known of it.
        (replace(MEMBER, member=False), None),
        (replace(MEMBER, member=False, left=True, predicts=True), None),
        # A search that was cut names nothing.
        (replace(MEMBER, complete=False, equivalents=("tear",), predicts=True), Mark.UNSURE),
        # Nor does one that has not fitted the set without it.
        (replace(MEMBER, evidence=float("nan"), predicts=True), Mark.UNSURE),
        # Held-out records that need it outweigh an interval with zero. What is small in all records
        # together is small.
        (replace(MEMBER, excludes_zero=False, predicts=True), Mark.NAMED),
        (replace(MEMBER, takes=0.4, predicts=True), Mark.SMALL),
        # Equivalents share what one of them takes: the interval of each may contain zero.
        (replace(MEMBER, excludes_zero=False, equivalents=("tear",)), Mark.ONE_OF),
        # A limit is no fault of what the evidence is sure of.
        (replace(MEMBER, at_limit=True), Mark.NAMED),
        # What is small must be probable, with its equivalents, not zero, not refused.
        (replace(UNLIKELY, takes=0.4), Mark.UNSURE),
        (replace(UNLIKELY, takes=0.4, together=0.95, equivalents=("tear",)), Mark.SMALL),
        (replace(MEMBER, takes=0.4, excludes_zero=False), Mark.UNSURE),
        (replace(MEMBER, takes=0.4, refused=True), Mark.UNSURE),
        # What it takes is not known: no reason to call it small.
        (replace(MEMBER, takes=float("nan")), Mark.NAMED),
        # The first that is surer: the evidence, then the held-out records.
        (replace(MEMBER, predicts=True), Mark.NAMED),
        (replace(UNLIKELY, equivalents=("tear",)), Mark.ONE_OF),
    ],
)
def test_the_surest_rule_comes_first(finding, mark):
    assert marked(finding).mark is mark


def test_the_trust_is_told_of_what_is_probable():
    assert marked(UNLIKELY).codes == ("unsure",)
    assert marked(replace(MEMBER, least_probability=0.6)).codes == ("named", "trust")


def test_the_credibility_of_the_user_decides():
    assert marked(replace(UNLIKELY, credibility=0.5)).mark is Mark.NAMED
    assert marked(replace(MEMBER, credibility=0.995)).mark is Mark.UNSURE


def test_beside_a_mark_stands_what_else_holds():
    assert marked(replace(MEMBER, least_probability=0.6, predicts=True)).codes == (
        "named", "trust", "chosen by",
    )  # fmt: skip
    assert marked(replace(OUTSIDE, probability=0.95, predicts=True)).codes == ("less probable",)


def test_a_name_that_is_no_candidate_has_one_message_with_the_nearest_names(spring, causes):
    records = [spring_record("a", 2, hardening=2000.0), spring_record("b", 5, hardening=2000.0)]
    report = diagnose(spring, causes, records)
    assert report.finding("hardening").mark is Mark.NAMED
    with pytest.raises(InvalidParameter) as fault:
        report.finding("hardning")
    count = len(report.findings)
    assert str(fault.value).startswith(f"no candidate 'hardning' among {count}; expected the name")
    assert "nearest: hardening" in str(fault.value)
    with pytest.raises(InvalidParameter, match=r"no candidate 'x' among 0; .* nearest: none$"):
        listed((), "x")
    # Each candidate has one line, members first, and a stored report has the same ones.
    assert [f.cause for f in report.findings if f.member] == list(report.reported)
    assert len({f.cause for f in report.findings}) == count >= report.causes
    stored = from_plain(json.loads(report.to_json()))
    assert [plain(f) for f in stored] == [plain(f) for f in report.findings]
    assert "The records tell it from all other candidates." in report.why("hardening")


@pytest.mark.parametrize("code", CASES)
def test_the_line_of_each_rule_is_told_in_words(code):
    found = marked(CASES[code][0])
    said = why(found)
    inside = found.member or code == "stands for"
    assert said.startswith(f"Wear is {'' if inside else 'not '}in the answer")
    assert SENTENCES[code].partition("{")[0] in said
    assert "{" not in said
    assert (f"marked *{found.mark.value}*" in said) if found.mark else ("marked" not in said)


def test_the_line_tells_what_held_out_records_and_the_evidence_say():
    found = replace(CASES["supported"][0], held_out=(1.4, 1.2, 1.6), better=7, of=8, evidence=-0.69)
    said = why(marked(found))
    assert "7 of 8 held-out records are better with it." in said
    assert "1.4 times as large (95 %: 1.2 to 1.6)" in said
    assert "the odds are 2 to 1 against it." in said
    assert "the odds are 2 to 1 for it." in why(marked(replace(found, evidence=0.69)))
