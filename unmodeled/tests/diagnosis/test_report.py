"""The report: codes and numbers, text, page, table, files."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Effect, Report, Verdict
from unmodeled.errors import FileExists
from unmodeled.library import for_force_balance
from unmodeled.models.model import UserUnit
from unmodeled.models.subject import Subject
from unmodeled.report.words import clause, number
from unmodeled.search.ledger import Finding, marked
from unmodeled.search.result import (
    Cell,
    Channel,
    Event,
    NamedCause,
    ParameterValue,
    Place,
    Reason,
    SetOfCauses,
    Trace,
    Without,
)

NAN = float("nan")
DELAY = Subject("sensor", "delay", "angle", "sensor angle")


@pytest.fixture
def report():
    """A report of an arm with dry friction and a class, made by hand."""
    friction = NamedCause(
        "dry friction", "arm joint", "N m", 0.0213, 0.0195, 0.0231, 0.98,
        by_record=(0.0211, 0.0216), mechanism="A constant torque acts against the motion.",
        remedy="Clean the joint.", shape=(0.01,), shape_names=("threshold speed [rad/s]",),
        subject=Subject("coordinate", "dry friction", "", "arm joint", "dry friction"),
    )  # fmt: skip
    delay = NamedCause("delay of sensor angle", "sensor angle", "s", 0.0021, 0.0015, 0.0027, 0.6,
                  kind="sensor", subject=DELAY)  # fmt: skip
    mass = NamedCause("J", "arm", "kg m^2", 0.025, 0.024, 0.026, 0.4, parameter=True, changes="J",
                 kind="parameter")  # fmt: skip
    damping = ParameterValue("c", "The damping", "N m s/rad", 0.01, 0.004, 0.012, 0.0115, 0.0125)
    time = np.linspace(0.0, 1.0, 11)
    return Report(
        verdict=Verdict.NAMED,
        reasons=(Reason.NOT_COMPLETE,),
        channels=(
            Channel("angle", "rad", 1e-3, 0.5, 0.1, 0.05, 0.011, 0.06, 0.012, 0.005),
            Channel("force", "N", NAN, 10.0, 0.1, 0.1, 0.05, NAN, NAN, 0.1),
        ),
        named=(friction,),
        classes=((delay, mass),),
        parameters=(
            damping,
            ParameterValue("J", "J", "kg m^2", 0.02, 0.001, 0.0201, 0.0195, 0.0207),
            ParameterValue("felt", "The felt", "1", 0.0, 0.08, -0.16, -0.27, -0.04, True),
            ParameterValue("k", "The spring", "N/m", 10.0, 1.0, 10.1, 9.8, 10.4),
        ),
        sets=(
            SetOfCauses(
                ("dry friction", "delay of sensor angle"), 0.6, (0.011, 0.05), (0.0213, 0.0021)
            ),
            SetOfCauses(("dry friction", "J"), 0.38, (0.012, 0.05), (0.0213,)),
            SetOfCauses(("dry friction",), 0.02, (0.02, 0.06), (0.0209,)),
            SetOfCauses((), 0.0, (0.05, 0.1)),
        ),
        held_out_gain=(0.2, 0.15, 0.3),
        nothing=0.0,
        not_tried=("drag",),
        complete=False,
        notes=("The clock is that of the file.",),
        records=("slow", "fast"),
        cells=(
            Cell("slow", "angle", 0.0, 0.5, "", 0.03, 0.01),
            Cell("fast", "angle", 0.5, 1.0, "impact", 0.07, 0.012),
        ),
        events=(Event("fast", "impact", "angle", 0.5, 0.003, 0.0001, 1e-4),),
        places=(Place("tip joint", True, (0.002, 0.05), 80.0, (("sign of the speed", 0.8),)),),
        apart=("fast",),
        reported=("dry friction", "delay of sensor angle"),
        changed=((damping,),),
        without=(
            Without("dry friction", (0.042, 0.06), (0.011, 0.05)),
            Without("delay of sensor angle", (0.02, 0.06), (0.011, 0.05)),
            Without("J", (0.02, 0.06), (0.011, 0.05)),
            Without("c", (0.0115, 0.05), (0.011, 0.05)),
        ),
        unknowns=("c", "k", "dry friction"),
        correlation=np.array([[1.0, 0.97, 0.1], [0.97, 1.0, 0.2], [0.1, 0.2, 1.0]]),
        traces=(Trace("slow", False, time, 0.05 * time, 0.01 * time),),
        findings=(
            marked(Finding("dry friction", member=True, fitted=True, probability=0.98, takes=8.0,
                           least_probability=0.95, evidence=3.9, held_out=(2.0, 1.6, 2.5),
                           predicts=True, better=2, of=2)),
            marked(Finding("delay of sensor angle", member=True, fitted=True, probability=0.6,
                           takes=3.0, evidence=4.0, equivalents=("J",))),
            marked(Finding("drag")),
        ),
    )  # fmt: skip


TEXT = """\
The arm joint has dry friction of 0.0213 N m (0.0195 to 0.0231), and either the
sensor angle is 2.10 ms (1.50 to 2.70) late or the parameter J is 0.02500 kg m^2
(0.02400 to 0.02600) instead of 0.02: with all 3 changes of the list, the
residual of angle falls from 20 % to 2.2 % of its motion. The rest matters: 2.2
% of angle, 11 times the noise; 1 % would be good enough.

Changes
The search ended at its limit, after 0 rounds of simulations.
- The arm joint has dry friction of 0.0213 N m (0.0195 to 0.0231); 93 % sure;
  2.2 % of the motion of angle is left, and 8.4 % without it; in each record
  0.0211, 0.0216; threshold speed 0.01 rad/s. A constant torque acts against the
  motion.
- Either the sensor angle is 2.10 ms (1.50 to 2.70) late or the parameter J is
  0.02500 kg m^2 (0.02400 to 0.02600) instead of 0.02; 2.2 % of the motion of
  angle is left, and 4 % without it
- The damping is 0.01200 N m s/rad (0.01150 to 0.01250) instead of 0.01; within
  its tolerance; 2.2 % of the motion of angle is left, and 2.3 % without it

Held-out records
Where nothing was fitted, the residual shrinks by 80 % with dry friction and
delay of sensor angle (70 to 85 %).
dry friction: better in 2 of 2 held-out records: these records also chose the
answer.

Where
Without the causes, the residual is largest in angle of fast, 0.5 to 1 s, after
impact: 0.07 rad rms, 0.012 rad with the causes.
At the event impact of fast, angle comes 3 ms later than in the model (0.1 ms
with the causes).
An unknown action at tip joint would take what remains in the worst channel from
2.2 % to 0.5 %; it would resemble the sign of the speed (80 % of it).

Next
- dry friction: Clean the joint.
- To tell delay of sensor angle from J, measure J by itself.
- To tell delay of sensor angle from J, record more motions like fast: they
  differ most there.

Residuals (details)

                                                                          held
                                                             held out,    out,
 rms residual   noise   tabulated   calibrated   explained      before   after
 ─────────────────────────────────────────────────────────────────────────────
 angle [rad]    0.001         0.1         0.05       0.011        0.06   0.012
 force [N]          -         0.1          0.1        0.05           -       -

 rms residual   of motion
 ────────────────────────
 angle [rad]        2.2 %
 force [N]          0.5 %

Sets (details)

 set                                      probability   left of angle
 ────────────────────────────────────────────────────────────────────
 dry friction and delay of sensor angle         0.600           2.2 %
 dry friction and J                             0.380           2.4 %
 dry friction                                   0.020             4 %
 nothing                                        0.000            10 %

Causes (details)

 cause                   probability
 ───────────────────────────────────
 dry friction                  1.000
 delay of sensor angle         0.600
 J                             0.380

Parameters (details)

 parameter        tabulated                             fitted, 95 %
 ───────────────────────────────────────────────────────────────────
 c           0.01 N m s/rad   0.01200 N m s/rad (0.01150 to 0.01250)
 J              0.02 kg m^2      0.02010 kg m^2 (0.01950 to 0.02070)
 felt                   0 %                        -16 % (-27 to -4)
 k                   10 N/m                10.10 N/m (9.80 to 10.40)

Why (details)

 candidate               in the answer            because
 ────────────────────────────────────────────────────────
 dry friction                    named   named, chosen by
 delay of sensor angle          one of             one of

Notes (details)
- The clock is that of the file.
- Not fitted: drag.
"""


def test_the_text_says_everything_in_this_order(report):
    assert report.text(80) == TEXT.rstrip()
    assert str(report) == report.text()


def test_the_first_sentence_has_two_changes_and_the_number_of_the_rest(report):
    first, *_ = report.summary().split(" of its motion.")
    assert "0.0213 N m (0.0195 to 0.0231)" in first
    assert "either the sensor angle is 2.10 ms (1.50 to 2.70) late or" in first
    assert " or " in first
    assert re.findall(r"([\d.]+) %", first) == ["20", "2.2"]
    off = replace(report.parameters[0], sd=1e-6)
    far = tuple(replace(off, name=f"c{k}", title=f"The c{k}") for k in range(3))
    left = tuple(Without(p.name, (0.1 + k, 0.1), (0.011, 0.05)) for k, p in enumerate(far))
    many = replace(report, changed=tuple((p,) for p in far), without=(*report.without, *left))
    assert "The c2" in many.summary()
    assert "the c1" in many.summary()
    assert "and 3 more changes are in the list: with all 5, the residual" in many.summary()
    for count, words in ((2, "2 more changes are"), (1, "1 more change is")):
        fewer = replace(many, changed=many.changed[:count]).summary()
        assert f"and {words} in the list: with all {2 + count}, the residual" in fewer
    near = tuple(replace(p, sd=0.1) for p in far)
    many = replace(many, changed=tuple((p,) for p in near))
    assert "friction" in many.summary()
    assert "and 3 more parameters differ within their tolerances: with all 5" in many.summary()


def test_the_list_is_sorted_by_how_sure_it_is_and_by_what_it_takes_away(report):
    assert [c.name for c in report.changes] == ["dry friction", "delay of sensor angle", "c"]
    first, second, last = report.changes
    assert (first.tier, first.channel) == ("named", "angle")
    assert first.takes == pytest.approx(np.sqrt(0.042**2 - 0.011**2) / 0.5)
    assert (first.before, first.after) == (0.042 / 0.5, 0.011 / 0.5)
    assert second.tier == "one of"
    (mass,) = second.equivalents
    assert (mass.size, mass.tolerances, mass.within) == (
        pytest.approx(0.005),
        pytest.approx(0.1),
        True,
    )
    assert second.takes == mass.takes == pytest.approx(np.sqrt(0.02**2 - 0.011**2) / 0.5)
    # A parameter that takes away less than what matters is in the list, and no first sentence.
    assert (last.tier, last.matters) == ("fitted", False)
    assert "damping" not in report.summary()
    unsure = replace(report, named=(), supported=report.named, verdict=Verdict.SUPPORTED)
    assert [c.tier for c in unsure.changes[:2]] == ["one of", "supported"]
    unsure = replace(unsure, classes=())
    assert unsure.changes[0].tier == "supported"
    assert "whether it is the cause is not sure" in unsure.text(200)
    assert "Whether dry friction is the cause is not sure" in unsure.summary()
    assert unsure.summary().startswith("The arm joint may have dry friction")
    assert "not sure" not in report.summary()
    failing = tuple(replace(w, before=(np.inf,) * 2) for w in report.without)
    assert "the simulation fails without it" in replace(unsure, without=failing).text(200)
    # What takes nothing away is a part of the fit: a parameter is in its table only.
    less = replace(report, without=tuple(replace(w, before=w.after) for w in report.without))
    assert [c.name for c in less.changes] == ["dry friction", "delay of sensor angle"]
    assert [c.matters for c in less.changes] == [False, False]


def test_what_is_small_or_unsure_is_told_after_what_is_sure(report):
    (friction,), (group,) = report.named, report.classes
    given = replace(report, named=(), classes=(), small=((friction,),), unsure=(group,),
                    verdict=Verdict.CALIBRATED, complete=True)  # fmt: skip
    assert [(c.name, c.tier) for c in given.changes] == [
        ("dry friction", "small"), ("c", "fitted"), ("delay of sensor angle", "unsure"),
    ]  # fmt: skip
    said = given.summary()
    assert said.startswith("No cause that matters is missing: the model misses 20 %")
    small = "The arm joint has dry friction of 0.0213 N m (0.0195 to 0.0231): this is "
    assert f"{small}small (8.1 % of the motion of angle). Also fitted, and not sure: delay" in said
    assert "delay of sensor angle or J. " in said
    text = given.text(400)
    assert "it takes away less than what matters" in text
    assert "the sensor angle may be 2.10 ms" in text
    assert "whether it is there is not sure" in text
    assert "Clean the joint" not in text.split("(details)")[0].split("\nNext\n")[1]
    cut = replace(given, small=(), complete=False).summary()
    assert cut.startswith("No cause was found before the search ended")
    assert "Best so far: delay of sensor angle or J." in cut


def test_no_improvement_rounds_to_nothing(report):
    """Another output shows it: the one that is told first is no better."""
    c = report.channels[0]
    same = replace(report, channels=(replace(c, explained=0.0999, calibrated=0.0999),
                                     report.channels[1]))  # fmt: skip
    said = " ".join(same.summary().split())
    assert "from 20 % to 20 %" not in said
    assert "with all 3 changes of the list, 20 % of the motion of angle is left" in said
    worse = replace(same, channels=(replace(c, explained=0.12), report.channels[1]))
    assert "falls" not in worse.summary()
    # In the list, the residuals with and without it are equal: what it takes away is told.
    near = (replace(report.without[0], before=(0.01101, 0.05)), *report.without[1:])
    lines = replace(report, without=near).text(400).split("\n- ")
    (line,) = (x for x in lines if x.startswith("The arm joint has dry friction"))
    assert "without it" not in line
    assert "it takes away 0.094 % of the motion of angle" in line
    c = replace(c, explained=c.limit, noise=NAN, good_enough=c.limit)
    quiet = bare_report(report, Verdict.CALIBRATED, channels=(c,), complete=True)
    assert quiet.summary().endswith("The rest, 1 %, is less than what is good enough.")


def test_a_cause_has_no_credit_for_what_fitted_parameters_take_away(report):
    """The model misses 4.5 %, calibrated 0.23 %, and 0.21 % with the cause."""
    c = replace(report.channels[0], tabulated=0.0225, calibrated=0.00115, explained=0.00105)
    only = replace(report, channels=(c, report.channels[1]), classes=(), changed=())
    assert (
        "the residual of angle falls from 4.5 % (0.23 % with fitted parameters) to 0.21 % of its"
        in " ".join(only.summary().split())
    )
    # Where a parameter is told, all of it is the list's.
    more = replace(only, changed=report.changed, without=tuple(
        replace(w, before=(0.05, 0.06)) for w in report.without))  # fmt: skip
    assert "falls from 4.5 % to 0.21 %" in more.summary()


@pytest.mark.parametrize(
    ("kind", "place", "size", "said"),
    [
        ("sensor", "sensor angle", 3e-3,
         "the sensor angle may be late or early (3 ms late, between 7 ms early and 13 ms late)"),
        ("sensor", "sensor angle", -3e-3,
         "the sensor angle may be late or early (3 ms early, between 13 ms late and 7 ms early)"),
        ("input", "input pump", -3e-3,
         "the input pump may act at another time than recorded (3 ms later, between 13 ms earlier "
         "and 7 ms later)"),
    ],
)  # fmt: skip
def test_a_delay_of_unknown_sign_is_neither_late_nor_early(report, kind, place, size, said):
    delay = replace(
        report.named[0], cause=f"delay of {place}", component=place, kind="sensor", unit="s",
        magnitude=size, low=-7e-3, high=13e-3, shape=None, shape_names=(), mechanism="",
        subject=Subject(kind, "delay", place.split()[1], place),
    )  # fmt: skip
    given = replace(report, named=(), supported=(delay,), classes=(), verdict=Verdict.SUPPORTED)
    assert clause(given.changes[0]) == said


@pytest.mark.parametrize(("tier", "sure"), [("named", True), ("supported", False),
                                            ("unsure", False), ("small", True)])  # fmt: skip
def test_what_is_not_sure_may_be(report, tier, sure):
    (change, *_) = report.changes
    has = "has dry friction" if sure else "may have dry friction"
    assert f"the arm joint {has} of" in clause(replace(change, tier=tier))
    # An interval that contains zero is no statement, whatever the mark says.
    assert "may have dry friction" in clause(replace(change, tier=tier, low=-0.001))
    # A parameter that is also an effect has the same words: they stand there once.
    twice = replace(change, equivalents=(replace(change, name="its other name"),))
    assert clause(twice) == clause(change)
    other = replace(change, name="another", size=3.0 * change.size)
    assert clause(replace(twice, equivalents=(*twice.equivalents, other))).startswith("either ")


@pytest.mark.parametrize("verdict", [Verdict.NO_GAP, Verdict.CALIBRATED, Verdict.UNKNOWN])
def test_without_causes_no_cause_is_told(report, verdict):
    bare = bare_report(report, verdict, sets=())
    assert isinstance(bare, Report)
    assert "friction" not in bare.text()
    assert "Held-out records" not in bare.text()


def test_numbers_have_two_digits_of_their_uncertainty():
    assert number(0.0129456, 0.00031) == "0.01295"
    assert number(-1.2e-9, 0.02) == number(0.0, 0.02) == "0"
    assert number(1234.4, 20.0) == "1234"


def test_a_search_that_ended_early_does_not_say_that_no_cause_is_missing(report):
    bare = bare_report(report, Verdict.CALIBRATED, sets=())
    assert not bare.complete
    assert "No cause was found before the search ended" in bare.summary()
    bare = replace(bare, complete=True)
    assert "No cause that matters is missing" in bare.summary()
    enough = replace(bare, channels=tuple(replace(c, good_enough=0.2) for c in bare.channels))
    assert "The rest, 11 times the noise, is less than what is good enough" in enough.summary()
    noise = tuple(replace(c, noise=c.explained) for c in bare.channels)
    assert "No cause is missing" in replace(bare, channels=noise).summary()
    # Below twice the noise nothing is judged, whatever share of the motion it is.
    near = tuple(replace(c, noise=c.explained / 1.6, good_enough=0.0) for c in bare.channels)
    said = replace(bare, channels=near).summary()
    assert said.startswith("No cause can be told from the noise: the model misses")
    assert said.endswith("The rest, 1.6 times the noise, is too near to it to tell more.")


def test_no_statistics_on_the_first_screen(report):
    first = report.text().split("(details)")[0]
    assert not re.search(r"probab|\bp =|log evidence|\b0\.98\b", first)
    assert sum(line.startswith("- ") for line in first.split("\nNext\n")[1].splitlines()) == 3


def test_json_has_codes_and_numbers(report):
    found = json.loads(report.to_json())
    assert (found["format"], found["version"]) == ("unmodeled diagnosis", 3)
    assert found["verdict"] == "NAMED"
    assert found["reasons"] == ["NOT_COMPLETE"]
    assert found["named"][0]["by_record"] == [0.0211, 0.0216]
    assert found["channels"][1]["noise"] is None
    assert found["changes"][0]["takes"] == pytest.approx(report.changes[0].takes)
    assert found["changes"][1]["equivalents"][0]["name"] == "J"
    assert found["places"][0]["resembles"] == [["sign of the speed", 0.8]]
    assert found["correlation"][0][1] == 0.97
    assert [(f["cause"], f["mark"], f["codes"]) for f in found["findings"]] == [
        ("dry friction", "NAMED", ["named", "chosen by"]),
        ("delay of sensor angle", "ONE_OF", ["one of"]),
        ("drag", None, ["not fitted"]),
    ]
    assert report.summary() not in report.to_json()


def test_the_page_is_self_contained_and_escaped(report):
    name = "<script>x</script>"
    sets = tuple(replace(s, causes=tuple(c.replace("dry friction", name) for c in s.causes))
                 for s in report.sets)  # fmt: skip
    other = replace(report, named=(replace(report.named[0], cause=name),), sets=sets,
                    reported=(name, "delay of sensor angle"))  # fmt: skip
    page = other.html(title="a & b")
    assert not re.search(r"https?:|src=|url\((?!#)|@import", page)
    assert page.count("<script") == 1  # its own, whose hash is stated
    script = page.split("<script>")[1].split("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'" in page
    assert "a &amp; b" in page
    assert page.count("<svg") == 3
    assert page == other.html(title="a & b")


def test_a_model_that_is_worse_than_a_constant_is_told_first(report):
    def first_step(**fields):
        channels = (replace(report.channels[0], **fields), report.channels[1])
        return replace(report, channels=channels).text().split("\nNext\n")[1].splitlines()[0]

    assert "a constant would be nearer" in first_step(tabulated=0.6, calibrated=0.6)
    assert "a constant would be nearer" not in first_step(tabulated=0.6)  # calibrated: 0.05


def test_a_place_that_explains_little_is_not_told(report):
    weak = (replace(report.places[0], left=(0.0109, 0.05)),)
    assert "tip joint" not in replace(report, places=weak).text()


def test_a_force_resembles_the_first_law_only(report):
    laws = (("sign of the speed", 0.8), ("cube of the speed", 0.7))
    text = replace(report, places=(replace(report.places[0], resembles=laws),)).text(200)
    assert "it would resemble the sign of the speed (80 % of it)" in text
    assert "cube of the speed" not in text


def test_equal_numbers_are_not_opposed(report):
    """What remains, 1.04 %, and what would be good enough, 1 %, have the same digits."""
    little = replace(report.channels[0], explained=5.2e-3)
    text = str(replace(report, channels=(little, report.channels[1])))
    assert "1 % of angle, 5.2 times the noise; a little less would be good enough." in " ".join(
        text.split()
    )


def test_a_channel_that_does_not_move_is_told_in_its_unit(report):
    still = replace(
        report, channels=(replace(report.channels[0], motion=0.0),), places=(), without=()
    )
    assert " deg" in still.summary() or " rad" in still.summary()


def test_the_worst_channel_is_the_one_that_matters(report):
    noisy = Channel("noisy", "rad", 0.1, 0.12, 0.1, 0.1, 0.1, good_enough=1e-3)
    assert replace(report, channels=(noisy, *report.channels)).worst.name == "angle"


def test_the_table_has_one_row_for_each_change_and_parameter(report):
    frame = report.frame
    assert list(frame.index) == ["dry friction", "delay of sensor angle", "J", "c", "felt", "k"]
    kinds = ["change", "change", "equivalent", "change", *["parameter"] * 2]
    assert list(frame["kind"]) == kinds
    assert frame.loc["dry friction", "high"] == 0.0231
    assert frame.loc["k", "tabulated"] == 10.0
    assert "<table" in report._repr_html_()


def test_the_waterfall_passes_through_the_fitted_sets(report):
    axes = report.plot().axes[0]
    widths = [bar.get_width() for bar in axes.patches]
    # tabulated, calibrated, dry friction, delay or J, remains, noise; in % of the motion
    assert widths == pytest.approx([20.0, 10.0, 6.0, 1.8, 2.2, 0.2])


def test_files_are_not_overwritten(report, tmp_path):
    page = report.write(tmp_path / "out", title="arm")
    assert page.read_text(encoding="utf-8").count("<h1>arm</h1>") == 1
    names = sorted(f.name for f in page.parent.iterdir())
    assert names == ["report.html", "report.json", "report.txt"]
    assert (page.parent / "report.json").read_text(encoding="utf-8") == report.to_json()
    with pytest.raises(FileExists):
        report.write(tmp_path / "out")
    report.write(tmp_path / "out", force=True)


def parameters_that_changed(report, *groups, left=0.1, **fields):
    """A report of parameters without a cause: without each, ``left`` [rad] of the angle is left."""
    names = [p.name for group in groups for p in group]
    return bare_report(
        report, Verdict.CALIBRATED, complete=True, changed=groups, parameters=(),
        without=tuple(Without(n, (left, 0.1), (0.011, 0.05)) for n in names), **fields,
    )  # fmt: skip


def test_parameters_are_changes_within_or_outside_their_tolerance(report):
    near = ParameterValue("m", "mass", "kg", 1.0, 0.01, 1.017, 1.015, 1.019)
    share = ParameterValue("f", "The felt", "1", 0.0, 0.1, -0.4, -0.5, -0.3, True)
    found = parameters_that_changed(report, (near,), (share,))
    found = replace(found, parameters=(near, share))
    assert [c.name for c in found.changes] == ["f", "m"]
    assert [c.within for c in found.changes] == [False, True]
    assert "within its tolerance" in found.text()
    assert "outside its tolerance" in found.text()
    assert found.summary().startswith(
        "The felt differs from the model by -40 % (-50 to -30), and the parameter mass is 1.0170 "
        "kg (1.0150 to 1.0190) instead of 1: with both, the residual of angle falls"
    )
    assert "No cause is missing" not in found.summary()
    assert replace(found, verdict=Verdict.UNKNOWN).changes == ()  # they imitate what is not known
    small = parameters_that_changed(report, (near,), left=0.0115)
    assert [(c.name, c.tier, c.matters) for c in small.changes] == [("m", "fitted", False)]
    assert "No cause that matters is missing" in small.summary()
    none = replace(small, without=(Without("m", (0.01101, 0.05), (0.011, 0.05)),))
    assert none.changes == ()  # it is in the table of parameters
    named = NamedCause("m", "arm", "kg", 1.017, 1.015, 1.019, 0.99, parameter=True, changes="m")
    once = replace(found, verdict=Verdict.NAMED, named=(named,))
    assert [(c.name, c.tier) for c in once.changes] == [("m", "named"), ("f", "fitted")]
    assert once.changes[0].tabulated == 1.0
    assert once.changes[0].size == pytest.approx(0.017)
    # An effect that changes the same number begins at zero.
    gain = replace(named, unit="1", magnitude=0.017, low=0.01, high=0.02, parameter=False)
    (first, _) = replace(once, named=(gain,)).changes
    assert (first.tabulated, first.size) == (0.0, 0.017)


def test_a_size_has_the_unit_of_its_owner(report):
    turn = UserUnit("turn", 1.0 / 0.7e-3, ("up", "down"))
    screw = ParameterValue("s", "The button", "m", 0.0, 2e-4, -3.44e-4, -3.6e-4, -3.3e-4,
                           user_unit=turn)  # fmt: skip
    found = parameters_that_changed(report, (screw,))
    assert found.summary().startswith(
        "The button is half a turn lower than in the model (-0.344 mm, -0.360 to -0.330): with this"
    )
    assert "On the machine, turn the button half a turn up, or correct the model." in found.text(
        200
    )
    odd = replace(screw, value=-2.31e-4, low=-2.33e-4, high=-2.29e-4)
    assert "is 0.33 turns lower than" in parameters_that_changed(report, (odd,)).summary()
    ways = ("toward the lever", "away from it"), ("stronger", "weaker"), ("", "")
    told = [
        parameters_that_changed(
            report, (replace(screw, value=3.44e-4, low=3.3e-4, high=3.6e-4,
                             user_unit=replace(turn, words=words)),)
        ).summary()
        for words in ways
    ]  # fmt: skip
    assert "is half a turn further toward the lever than in the model" in told[0]
    assert "is half a turn stronger than in the model" in told[1]
    assert "is half a turn further than in the model" in told[2]
    grams = UserUnit("kg", 6.4e-3)
    head = ParameterValue("h", "The head", "1", 0.0, 0.03, 0.07, 0.06, 0.08, True, grams)
    text = parameters_that_changed(report, (head,)).summary()
    assert text.startswith("The head differs from the model by +7.0 % (+6.0 to +8.0; +0.448 g)")
    either = parameters_that_changed(report, (screw, head)).summary()
    assert either.startswith("Either the button is half a turn lower")
    assert "or the head differs from the model by +7.0 %" in either


def bare_report(report, verdict, **fields):
    none = {
        "named": (),
        "classes": (),
        "changed": (),
        "held_out_gain": None,
        "findings": (),
        "reasons": (),
        "reported": (),
    }
    fields = none | fields
    return replace(report, verdict=verdict, **fields)


def test_an_unknown_cause_is_told_with_its_reason(report):
    nothing = (SetOfCauses((), 1.0, (0.05, 0.05)),)
    every = tuple(f"cause {k}" for k in range(22))
    late = {"reasons": (Reason.NOT_COMPLETE,), "complete": False, "needed": 312.0, "causes": 22}

    def unknown(**fields):
        return bare_report(report, Verdict.UNKNOWN, **{"complete": True} | fields)

    none = unknown(sets=nothing, not_tried=every, **late)
    assert "It is not judged why: 22 of 22 causes were not tried, about 310 s are needed." in (
        none.summary()
    )
    again = "Diagnose again with 310 s (--seconds, in Python seconds of Options): "
    assert f"{again}22 of 22 causes were not tried." in none.text(200)
    some = unknown(sets=nothing, not_tried=every[:1], **late)
    assert "No cause that was tried explains it; 1 of 22 causes was not tried" in some.summary()
    ended = unknown(sets=nothing, not_tried=(), **late)
    assert "Options): the search did not reach its end." in ended.text(200)
    line = marked(Finding("creep", fitted=True, left=True, same=1e-9))
    refused = unknown(findings=(line,), reasons=(Reason.DIFFERS_BETWEEN_RECORDS,), causes=22)
    assert "is refused (creep): it has another magnitude in each record" in refused.summary()
    assert "A probable cause is not in the answer (creep): it has" in refused.text(200)
    empty = unknown(sets=nothing, not_tried=())
    assert "No cause was tried" in empty.summary()
    for text in (none, some, ended, refused, empty):
        assert not re.search(r"\b[01] causes", text.text(200))


def test_a_machine_without_a_change_has_no_next_step(report):
    quiet = tuple(replace(c, explained=5e-4) for c in report.channels)
    fields = {"complete": True, "not_tried": (), "channels": quiet, "places": (), "unknowns": (),
              "correlation": np.zeros((0, 0))}  # fmt: skip
    still = bare_report(report, Verdict.NO_GAP, parameters=(), **fields)
    assert "- None: the model can be used" in still.text(200)


def test_held_out_records_that_are_not_predicted_are_told(report):
    told = replace(report, reasons=(Reason.NOT_PREDICTED,))
    assert "The held-out records were not predicted" in told.text(200)


@pytest.mark.parametrize(
    ("explained", "fitted", "told"),
    [
        (0.04, 0.004, "2.4 % of angle remains in the held-out records, and 0.8 % in the fitted "
         "ones: something acts in the held-out ones that these do not show."),
        (0.004, 0.004, "2.4 % of angle remains in the held-out records, and 0.8 % in the fitted "
         "ones: these alone do not determine all that acts in the held-out ones."),
        (0.04, 0.006, "2.4 % of angle remains in the held-out records, and 1.2 % in the fitted "
         "ones."),
        (0.04, 0.013, ""),
        (0.04, NAN, ""),
    ],
)  # fmt: skip
def test_what_only_the_held_out_records_keep_is_told(report, explained, fitted, told):
    c = replace(report.channels[0], explained=explained, fitted_explained=fitted)
    quiet = bare_report(report, Verdict.CALIBRATED, channels=(c, *report.channels[1:]))
    text = quiet.text(200)
    assert told in text
    assert ("remains in the held-out records" in text) == bool(told)


def test_a_letter_and_a_countable_law_have_their_words(report):
    law = next(e for e in for_force_balance("q", "dq", force=1.0, travel=1.0, pace=1.0)
               if e.name == "constant force")  # fmt: skip
    force = replace(
        report.named[0], cause=law.name, title=law.label, component="drive", subject=law.about
    )
    left = replace(report.without[0], name=law.name)
    first = replace(report, named=(force,), without=(left, *report.without[1:]))
    assert first.summary().startswith("The drive has a constant force of 0.0213 N m (0.0195")
    at = replace(first, named=(replace(force, component="x"),))
    assert at.summary().startswith("A constant force of 0.0213 N m (0.0195 to 0.0231) acts on x")
    unsure = replace(at, named=(), supported=at.named, verdict=Verdict.SUPPORTED)
    assert "may act on x" in unsure.summary()


def test_a_delay_says_what_is_late(report):
    sensor, mass = report.classes[0]
    assert "the sensor angle is 2.10 ms (1.50 to 2.70) late" in report.summary()
    early = replace(sensor, magnitude=-0.002, low=-0.003, high=-0.001)
    said = replace(report, classes=((early, mass),)).summary()
    assert "the sensor angle is 2.0 ms (1.0 to 3.0) early" in said
    # The reading of an input is early where the machine is late.
    of_pump = Subject("input", "delay", "pump", "input pump")
    pump = replace(
        early, cause="delay of input pump", component="input pump", kind="input", subject=of_pump
    )
    said = replace(report, classes=((pump, mass),)).summary()
    assert "the input pump acts 2.0 ms (1.0 to 3.0) later than recorded" in said
    alone = replace(report, named=(replace(pump, by_record=(-0.0021, -0.0019)),), classes=())
    assert "in each record 2.1, 1.9" in alone.text().replace("\n", " ").replace("  ", " ")
    slow = replace(sensor, cause="lag of sensor angle", subject=replace(DELAY, fault="lag"))
    said = replace(report, classes=((slow, mass),)).summary()
    assert "the sensor angle has a lag of 2.10 ms" in said
    drive = replace(slow, component="input pump", kind="", subject=replace(of_pump, fault="lag"))
    said = replace(report, classes=((drive, mass),)).summary()
    assert "the input pump has a lag of 2.10 ms" in said


def test_held_out_records_are_told_one_by_one(report):
    both = replace(report.findings[0], better=7, of=8)
    text = replace(report, findings=(both, *report.findings[1:])).text(200)
    told = "dry friction: better in 7 of 8 held-out records: these records also chose the answer."
    assert told in text
    # The evidence alone chose it: the records are not accused.
    text = replace(report, findings=(replace(both, predicts=False), *report.findings[1:])).text(200)
    assert "dry friction: better in 7 of 8 held-out records.\n" in text
    one = replace(report, findings=(replace(both, better=1, of=1), *report.findings[1:]))
    assert "better in" not in one.text(200)
    assert "Where nothing was fitted" not in replace(report, held_out_gain=(1.0,) * 3).text()


def test_why_is_the_line_of_the_ledger(report):
    said = report.why("dry friction")
    assert said.startswith("Dry friction is in the answer, marked *named*.")
    assert "2 of 2 held-out records are better with it." in said
    assert "These held-out records also chose the answer." in said
    assert "The records do not tell it from J." in report.why("delay of sensor angle")
    assert report.why("drag").startswith("Drag is not in the answer. It was not fitted")


def test_a_dead_zone_has_its_width_in_the_first_sentence(report):
    gap = replace(
        report.named[0], cause="dead zone gearbox", component="gearbox",
        title="a dead zone gearbox", unit="N m/rad", magnitude=59.2, low=55.8, high=62.6,
        subject=Subject("coordinate", "dead zone", "", "gearbox", "a dead zone"),
        by_record=(), shape=(0.00705,), shape_names=("half width [rad]",),
    )  # fmt: skip
    sets = (SetOfCauses(("dead zone gearbox",), 0.98, (0.011, 0.05), (59.2,)), *report.sets[-1:])
    without = (Without("dead zone gearbox", (0.04, 0.06), (0.011, 0.05)),)
    found = replace(report, named=(gap,), classes=(), sets=sets, without=without, changed=())
    assert found.summary().startswith(
        "The gearbox has a dead zone of ±0.00705 rad, where the stiffness of 59.2 N m/rad (55.8 to "
        "62.6) does not act"
    )


@pytest.mark.parametrize(
    ("fault", "place", "shape", "names", "high", "said"),
    [
        ("dead zone", "input valve", 0.045, ("level [V]",), 1.0, "a dead zone of ±0.045 V: "),
        ("dead zone", "input valve", 0.2, ("level",), 0.6,
         "a dead zone of ±0.2, which takes away 50.0 % (40.0 to 60.0) of what is within it: "),
        ("saturation", "sensor y", ("highest", 3.0), ("end", "reading [V]"), 1.0,
         "a saturation above 3 V: "),
    ],
)  # fmt: skip
def test_what_loses_a_part_of_a_signal_is_told_by_its_level(
    report, fault, place, shape, names, high, said
):
    title = f"{fault} of {place}"
    lost = replace(
        report.named[0], cause=title, component=place, title="", unit="1",
        subject=Subject("input", fault, "", place),
        magnitude=1.0 if high == 1.0 else 0.5, low=0.4, high=high, by_record=(), shape=shape,
        shape_names=names, kind="sensor",
    )  # fmt: skip
    sets = (SetOfCauses((title,), 0.98, (0.011, 0.05), (1.0,)), *report.sets[-1:])
    without = (Without(title, (0.04, 0.06), (0.011, 0.05)),)
    found = replace(report, named=(lost,), classes=(), sets=sets, without=without, changed=())
    assert f"the {lost.component} has {said}" in found.summary().replace("The ", "the ", 1)


def test_records_of_noise_show_nothing(report):
    bare = bare_report(report, Verdict.NO_GAP, sets=())
    rest = tuple(replace(c, noise=1.0, motion=1.1) for c in bare.channels)
    assert replace(bare, channels=rest).summary() == (
        "The records do not show what may be missing: they hold nothing but noise."
    )
    moves = (replace(rest[0], motion=5.0), *rest[1:])
    assert "nothing but noise" not in replace(bare, channels=moves).summary()


def test_an_interrupted_search_is_told_and_notes_are_said_once(report):
    notes = ("a: valve in percent", "b: valve in percent", "held out: c")
    stopped = replace(report, reasons=(Reason.NOT_COMPLETE, Reason.INTERRUPTED), notes=notes)
    text = stopped.text()
    assert "The search was interrupted: what was not fitted may explain as much." in text
    assert "ended at its limit" not in text
    assert "- a, b: valve in percent\n- held out: c\n" in text


#: Names of a user that look like those of the library, or like words of a report.
NAMES = (
    "saturation of sensor force", "dead zone of input x", "delay of the sensor", "worn_arm joint",
    "odd zero in each record", "lag of sensor angle", "the of", " of ", "arm joint", "clock",
    "between arm joint and arm joint", "in rec2", "half width [m]", "%s {which}", "of sensor ",
)  # fmt: skip
SHAPES = ((None, ()), (0.3, ("half width [m]",)), (("highest", 2.0), ("end", "reading")))


def _fuzzed(report, count):
    rng = np.random.default_rng(5)
    kinds = ("force", "kinematic", "state", "parameter", "sensor", "input", "drift")
    for _ in range(count):
        name, component, label = (rng.choice([*NAMES, "x"]) for _ in range(3))
        shape, names = SHAPES[rng.integers(len(SHAPES))]
        kind = kinds[rng.integers(len(kinds))]
        own = Effect(name=name, component=component, label=rng.choice(["", label]), kind=kind)
        cause = replace(
            report.named[0], cause=own.name, component=own.component, kind=own.kind,
            title=own.label, subject=own.about, shape=shape, shape_names=names,
        )  # fmt: skip
        left = (replace(report.without[0], name=own.name), *report.without[1:])
        yield own, replace(report, named=(cause,), classes=(), without=left)


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.slow)])
def test_the_name_of_an_effect_of_a_user_is_never_read(report, count):
    for own, found in _fuzzed(report, count):
        said, told = clause(found.changes[0]), own.about.label or own.name
        assert told in said or told[:1].lower() + told[1:] in said, (own.name, own.label, said)
        said = said.replace(told, "").replace(told[:1].lower() + told[1:], "")
        said = said.replace(own.component, "")
        for word in (" late", " early", "recorded", "between the records", "takes away", "lag of"):
            assert word not in said, (own.name, own.label, said)
        assert own.name.strip() in found.to_json()
        assert found.text()


def test_the_part_is_no_piece_of_a_word():
    worn = Effect(name="worn_spring", component="spring").about
    assert worn.label == ""  # the effect worn_spring has a size of
    assert Effect(name="drag of cart", component="cart").about.label == "drag"
