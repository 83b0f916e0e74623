"""``[reading]`` of a mechanism: rows of the summary, and names that are wrong."""

import copy
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

import feltmb
from feltmb import InvalidParameter
from feltmb.cli.stroke import summary_table
from feltmb.mechanism import Action
from feltmb.run.reading import reading_of, strike_words

DATA = Path(__file__).resolve().parents[2] / "data"
RAW = tomllib.loads((DATA / "pendulum.toml").read_text())
RAW["points"] = {"head": {"body": "arm", "point": [0.0, -0.15]}}
RAW["events"] = {
    "met": {"contact": 1, "change": "closes"},
    "left": {"contact": 1, "change": "opens", "after": "met"},
}
STROKE = feltmb.table_stroke([0.0, 0.02, 0.04], [0.0, 2.0, 0.0], duration=0.3)


def with_reading(**reading):
    return Action({**copy.deepcopy(RAW), "reading": reading})


ROWS = {
    "lasts": {"between": ["met", "left"]},
    "met_at": {"at": "met"},
    "there": {"output": "head.x", "at": "met"},
    "most": {"output": "contact01.force", "take": "largest"},
    "within": {"output": "head.x", "take": "range", "after": "met", "before": "left"},
    "mean": {"output": "contact01.force", "take": "mean"},
}


def test_rows_are_read_off_outputs_and_events():
    run = feltmb.simulate(with_reading(rows=ROWS), STROKE, output_rate=20000.0)
    met, left = run.event_time("met"), run.event_time("left")
    s = run.summary
    assert s["lasts"] == left - met > 0.0
    assert s["met_at"] == met
    force, x = run["contact01.force"], run["head.x"]
    assert force.max() < s["most"] < 1.001 * force.max()  # between two samples
    assert s["mean"] == pytest.approx(force.mean(), rel=1e-3)
    inside = (run.time >= met) & (run.time <= left)
    assert s["within"] == pytest.approx(x[inside].max() - x[inside].min(), rel=2e-2)
    at = run.time.searchsorted(met)
    assert min(x[at - 1 : at + 1]) <= s["there"] <= max(x[at - 1 : at + 1])


def test_rows_do_not_depend_on_the_samples():
    action = with_reading(rows={k: v for k, v in ROWS.items() if k != "mean"})
    few, many = (feltmb.simulate(action, STROKE, output_rate=rate).summary for rate in (1e3, 1e5))
    assert few == pytest.approx(many, rel=1e-12)


def test_a_run_that_goes_on_has_the_rows_of_its_own_part():
    action = with_reading(rows=ROWS)
    first = feltmb.simulate(action, STROKE, duration=0.02)
    on = feltmb.simulate(action, STROKE, start=first, duration=0.01)
    assert on.summary["most"] >= on["contact01.force"].max()


def test_a_time_of_an_event_is_one_row_of_the_table():
    run = feltmb.simulate(with_reading(rows=ROWS), STROKE)
    texts = list(summary_table(run, "x").columns[0].cells)
    assert [text for text in texts if text in ("met", "met at", "left")] == ["left", "met at"]


def test_a_run_for_its_summary_has_the_rows_too():
    action = with_reading(rows=ROWS)
    whole = feltmb.simulate(action, STROKE)
    quick = feltmb.simulate(action, STROKE, summary_only=True)
    assert quick.summary == whole.summary


def test_a_run_without_the_events_has_no_such_number():
    run = feltmb.simulate(with_reading(rows=ROWS), feltmb.ramp_stroke(0.0, duration=0.001))
    assert "lasts" not in run.summary
    assert "there" not in run.summary
    assert "mean" in run.summary


def test_the_reading_is_found_in_a_saved_run(tmp_path):
    run = feltmb.simulate(with_reading(rows=ROWS), STROKE)
    run.save(tmp_path / "run.nc")
    kept = feltmb.load_run(tmp_path / "run.nc")
    assert set(reading_of(kept).rows) == set(ROWS)
    assert kept.summary == run.summary


def test_rows_are_part_of_the_hash_and_views_are_not():
    plain = with_reading()
    assert with_reading(views={"head": {"curves": ["head.x"]}}).hash == plain.hash
    assert with_reading(rows={"met_at": {"at": "met"}}).hash != plain.hash


@pytest.mark.parametrize(
    ("reading", "said"),
    [
        ({"strike_contact": 7}, r"reading.strike_contact: there is no contact 7"),
        (
            {"striker": {"point": "tip", "direction": [1.0, 0.0]}},
            r"striker.point: point 'tip' is m",
        ),
        ({"rows": {"a": {"at": "hit"}}}, r"rows.a.at: event 'hit' is missing"),
        ({"rows": {"a": {"output": "head.z", "at": "met"}}}, r"no output 'head.z'; did you mean"),
        ({"rows": {"a": {"output": "head.x"}}}, r"rows.a: expected output with take or at"),
        ({"rows": {"a": {"between": ["met", "gone"]}}}, r"rows.a.between: event 'gone' is missing"),
        ({"rows": {"met_time": {"at": "met"}}}, r"the summary has a number of this name"),
        ({"rows": {"a": {"take": "most", "output": "head.x"}}}, r"rows.a.take: got 'most'"),
        ({"views": {"v": {"curves": ["head.x", "hed.y"]}}}, r"views.v.curves: there is no output"),
        ({"view": {}}, r"reading.view: unknown key"),
    ],
)
def test_a_wrong_name_is_one_fault(reading, said):
    with pytest.raises(InvalidParameter, match=said):
        with_reading(**reading)


@pytest.mark.parametrize(
    ("label", "first", "force"),
    [
        ("arm - wall", "arm meets the wall", "largest wall force"),
        ("hammer - string", "hammer meets the string", "largest string force"),
        ("stop", "head meets block", "largest block force"),
        ("", "head meets block", "largest block force"),
    ],
)
def test_a_strike_is_told_in_the_words_of_the_mechanism(label, first, force):
    """The table said "hammer meets the string" of every machine that has a strike contact."""
    action = with_reading(strike_contact=1)
    action = action.with_values({"contacts.01.label": label})
    run = feltmb.simulate(action, STROKE)
    table = summary_table(run, "x")
    texts = list(table.columns[0].cells)
    assert first in texts
    assert force in texts
    words = " ".join(texts)
    assert label == "hammer - string" or not ("hammer" in words or "string" in words)
    line = feltmb.plot.overview(run).get_supxlabel()
    assert force in line
    assert label == "hammer - string" or "string" not in line


def test_a_run_without_its_mechanism_names_no_parts():
    run = feltmb.simulate(with_reading(strike_contact=1), STROKE)
    bare = replace(run, provenance={**run.provenance, "toml": ""})
    assert strike_words(bare)["impact_time"] == "impact"


def test_a_number_that_is_missing_is_told_with_its_present_name():
    run = feltmb.simulate(with_reading(rows=ROWS), STROKE)
    with pytest.raises(KeyError, match="the present name is 'max_impact_force'"):
        run.summary["max_string_force"]
    with pytest.raises(KeyError, match="near are met_at"):
        run.summary["met_a"]


@pytest.mark.parametrize("name", ["arm.angle", "arm.angle.rate"])
def test_a_start_beyond_all_numbers_is_named(name):
    with pytest.raises(feltmb.InvalidParameter, match=rf"start: {name} = 1e300 .*at most 1e\+09"):
        feltmb.simulate(
            with_reading(), STROKE, start={name: "1e300 rad" + "/s" * name.count("rate")}
        )
