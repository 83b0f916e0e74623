"""The report: codes and numbers, text, page, table, files."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Report, Verdict
from unmodeled.errors import FileExists
from unmodeled.search.result import (
    Cell,
    Channel,
    Event,
    Named,
    ParameterValue,
    Place,
    Reason,
    SetOfCauses,
    Trace,
)

NAN = float("nan")


@pytest.fixture
def report():
    """A report of an arm with dry friction and a class, made by hand."""
    friction = Named(
        "dry friction", "arm joint", "N m", 0.0213, 0.0195, 0.0231, 0.98,
        by_record=(0.0211, 0.0216), mechanism="A constant torque acts against the motion.",
        remedy="Clean the joint.", shape=(0.01,), shape_names=("threshold speed [rad/s]",),
    )  # fmt: skip
    delay = Named("delay", "sensor", "s", 0.0021, 0.0015, 0.0027, 0.6)
    mass = Named("J", "arm", "kg m^2", 0.025, 0.024, 0.026, 0.4, parameter=True)
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
            ParameterValue("c", "The damping", "N m s/rad", 0.01, 0.004, 0.012, 0.0115, 0.0125),
            ParameterValue("felt", "The felt", "1", 0.0, 0.08, -0.16, -0.27, -0.04, True),
            ParameterValue("k", "The spring", "N/m", 10.0, 1.0, 10.1, 9.8, 10.4),
        ),
        sets=(
            SetOfCauses(("dry friction", "delay"), 0.6, (0.011, 0.05), (0.0213, 0.0021)),
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
        told=("dry friction", "delay"),
        unknowns=("c", "k", "dry friction"),
        correlation=np.array([[1.0, 0.97, 0.1], [0.97, 1.0, 0.2], [0.1, 0.2, 1.0]]),
        traces=(Trace("slow", False, time, 0.05 * time, 0.01 * time),),
    )


TEXT = """\
Named. The model misses 20 % of the motion of angle, and 10 % with fitted
parameters. dry friction of 0.0213 N m (0.0195 to 0.0231) and one of delay or J
outside its tolerance take it to 2.2 %. The rest matters: 2.2 % of angle, 11
times the noise; 1 % would be good enough.

What is missing
The search ended at its limit of time, or was interrupted.
- dry friction [arm joint]: 0.0213 N m (0.0195 to 0.0231); in each record
  0.0211, 0.0216; threshold speed [rad/s] 0.01. A constant torque acts against
  the motion.
- One of these, which the records do not tell apart: delay [sensor] of 2.10 ms
  (1.50 to 2.70) or J outside its tolerance [arm] of 0.02500 kg m^2 (0.02400 to
  0.02600)

Calibration
- The damping: 0.01200 N m s/rad (0.01150 to 0.01250); tabulated 0.01 N m s/rad,
  a change of 0.5 tolerances
- The felt: -16 % (-27 to -4); tabulated 0 %, a change of 2 tolerances

Held-out records
Where nothing was fitted, the residual shrinks by 80 % with the causes (70 to 85
%).

Where
Without the causes, the residual is largest in angle of fast, 0.5 to 1 s, after
impact: 0.07 rad rms, 0.012 rad with the causes.
At the event impact of fast, angle comes 3 ms later than in the model (0.1 ms
with the causes).
An unknown action at tip joint would take what remains in the worst channel from
2.2 % to 0.5 %; it would resemble the sign of the speed (80 % of it).

Next
- dry friction: Clean the joint.
- To tell delay from J outside its tolerance, measure J by itself.
- To tell delay from J outside its tolerance, record more motions like fast:
  they differ most there.

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

 set                      probability   left of angle
 ────────────────────────────────────────────────────
 dry friction and delay         0.600           2.2 %
 dry friction and J             0.380           2.4 %
 dry friction                   0.020             4 %
 nothing                        0.000            10 %

Causes (details)

 cause          probability
 ──────────────────────────
 dry friction         1.000
 delay                0.600
 J                    0.380

Parameters (details)

 parameter        tabulated                             fitted, 95 %
 ───────────────────────────────────────────────────────────────────
 c           0.01 N m s/rad   0.01200 N m s/rad (0.01150 to 0.01250)
 felt                   0 %                        -16 % (-27 to -4)
 k                   10 N/m                10.10 N/m (9.80 to 10.40)

Notes (details)
- The clock is that of the file.
- Not fitted: drag.
"""


def test_the_text_says_everything_in_this_order(report):
    assert report.text(80) == TEXT.rstrip()
    assert str(report) == report.text()


def test_the_first_line_tells_sizes_first(report):
    # 0.1 and 0.05 of a motion of 0.5, then 0.011.
    numbers = re.findall(r"([\d.]+) %", report.summary())
    assert numbers[:3] == ["20", "10", "2.2"]
    assert "0.0213 N m (0.0195 to 0.0231)" in report.summary()


@pytest.mark.parametrize("verdict", [Verdict.NO_GAP, Verdict.CALIBRATED, Verdict.UNKNOWN])
def test_without_causes_no_cause_is_told(report, verdict):
    bare = replace(report, verdict=verdict, named=(), classes=(), held_out_gain=None, sets=())
    assert isinstance(bare, Report)
    assert "friction" not in bare.text()
    assert "Held-out records" not in bare.text()


def test_a_search_that_ended_early_does_not_say_that_no_cause_is_missing(report):
    bare = replace(report, verdict=Verdict.CALIBRATED, named=(), classes=(), sets=())
    assert not bare.complete
    assert "No cause was found before the search ended" in bare.summary()
    assert "No cause is missing" in replace(bare, complete=True).summary()


def test_a_cause_that_is_fitted_but_not_named_is_told(report):
    sets = (SetOfCauses(("dry friction", "delay", "wear"), 1.0, (0.011, 0.05)), *report.sets)
    reasons = (Reason.DIFFERS_BETWEEN_RECORDS,)
    refused = replace(report, sets=sets, told=sets[0].causes, reasons=reasons)
    assert "wear" in refused.text().split("\nCalibration")[0]
    assert "not named" in refused.summary()
    assert "not named" not in report.summary()


def test_no_statistics_on_the_first_screen(report):
    first = report.text().split("(details)")[0]
    assert not re.search(r"probab|\bp =|log evidence|\b0\.98\b", first)
    assert sum(line.startswith("- ") for line in first.split("\nNext\n")[1].splitlines()) == 3


def test_json_has_codes_and_numbers(report):
    found = json.loads(report.to_json())
    assert (found["format"], found["version"]) == ("unmodeled diagnosis", 1)
    assert found["verdict"] == "NAMED"
    assert found["reasons"] == ["NOT_COMPLETE"]
    assert found["named"][0]["by_record"] == [0.0211, 0.0216]
    assert found["channels"][1]["noise"] is None
    assert found["places"][0]["resembles"] == [["sign of the speed", 0.8]]
    assert found["correlation"][0][1] == 0.97
    assert report.summary() not in report.to_json()


def test_the_page_is_self_contained_and_escaped(report):
    other = replace(report, named=(replace(report.named[0], cause="<script>x</script>"),))
    page = other.html(title="a & b")
    assert not re.search(r"https?:|src=|url\((?!#)|@import", page)
    assert "<script" not in page
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


def test_a_channel_that_does_not_move_is_told_in_its_unit(report):
    still = replace(report, channels=(replace(report.channels[0], motion=0.0),), places=())
    assert " deg" in still.summary() or " rad" in still.summary()


def test_the_worst_channel_is_the_one_that_matters(report):
    noisy = Channel("noisy", "rad", 0.1, 0.12, 0.1, 0.1, 0.1, good_enough=1e-3)
    assert replace(report, channels=(noisy, *report.channels)).worst.name == "angle"


def test_the_table_has_one_row_for_each_cause_and_parameter(report):
    frame = report.frame
    assert list(frame.index) == ["dry friction", "delay", "J", "c", "felt", "k"]
    assert list(frame["kind"]) == ["named", "class 1", "class 1", *["parameter"] * 3]
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


def test_a_parameter_far_outside_its_tolerance_is_an_answer(report):
    assert "off by" not in report.summary()
    far = ParameterValue("m", "mass", "kg", 1.0, 0.01, 1.033, 1.031, 1.035)
    unsure = ParameterValue("n", "number", "1", 1.0, 0.01, 1.033, 0.9, 1.2)
    share = ParameterValue("f", "felt", "1", 0.0, 0.1, -0.4, -0.5, -0.3, True)
    told = replace(report, verdict=Verdict.CALIBRATED, named=(), classes=(), complete=True,
                   parameters=(far, unsure, share))  # fmt: skip
    assert told.summary().startswith(
        "The parameter felt is off by -40 %, 4 tolerances. "
        "The parameter mass is off by +0.033 kg, 3.3 tolerances. The model misses"
    )
    assert "No other cause is missing" in told.summary()
    assert told.as_dict()["off"] == ["f", "m"]
    assert "felt: check it, and correct the machine" in " ".join(told.text().split())
    unknown = replace(told, verdict=Verdict.UNKNOWN)  # it imitates what is not known
    assert unknown.off == ()
    named = Named("m", "arm", "kg", 1.033, 1.031, 1.035, 0.99, parameter=True, changes="m")
    assert [p.name for p in replace(told, named=(named,)).off] == ["f"]
    assert [p.name for p in replace(told, classes=((named, named),)).off] == ["f"]
    further = replace(far, value=13.4, low=13.3, high=13.5)
    several = replace(told, parameters=(further,))
    assert several.summary().startswith("The parameter mass is off by +12.4 kg, 1200 tolerances.")


def bare_report(report, verdict, **fields):
    fields = {"named": (), "classes": (), "held_out_gain": None, "reasons": ()} | fields
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
    assert "Diagnose again with 310 s: 22 of 22 causes were not tried." in none.text(200)
    some = unknown(sets=nothing, not_tried=every[:1], **late)
    assert "No cause that was tried explains it; 1 of 22 causes was not tried" in some.summary()
    ended = unknown(sets=nothing, not_tried=(), **late)
    assert "Diagnose again with 310 s: the search did not reach its end." in ended.text(200)
    refused = unknown(refused=("creep",), reasons=(Reason.DIFFERS_BETWEEN_RECORDS,), causes=22)
    assert "is refused (creep): it has another magnitude in each record" in refused.summary()
    assert "A probable cause is not named (creep): it has" in refused.text(200)
    empty = unknown(sets=nothing, not_tried=())
    assert "No cause was tried" in empty.summary()
    for text in (none, some, ended, refused, empty):
        assert not re.search(r"\b[01] causes", text.text(200))


def test_the_name_of_a_parameter_is_the_subject_of_its_sentence(report):
    far = ParameterValue("f", "The friction of arm", "1", 0.0, 0.1, -0.4, -0.5, -0.3)
    told = bare_report(report, Verdict.CALIBRATED, parameters=(far,))
    assert told.summary().startswith("The friction of arm is off by -0.4, 4 tolerances.")


def test_a_machine_with_a_change_has_a_next_step(report):
    quiet = tuple(replace(c, explained=5e-4) for c in report.channels)
    fields = {"complete": True, "not_tried": (), "channels": quiet, "places": (), "unknowns": (),
              "correlation": np.zeros((0, 0))}  # fmt: skip
    moved = ParameterValue("k", "k", "N/m", 10.0, 1.0, 11.0, 10.8, 11.2)
    told = bare_report(report, Verdict.CALIBRATED, parameters=(moved,), **fields)
    assert "- k: 11.00 N/m (10.80 to 11.20), tabulated 10 N/m: correct" in told.text(200)
    still = bare_report(report, Verdict.NO_GAP, parameters=(), **fields)
    assert "- None: the model can be used" in still.text(200)


def test_held_out_records_that_are_not_predicted_are_told(report):
    told = replace(report, reasons=(Reason.NOT_PREDICTED,))
    assert "The held-out records were not predicted" in told.text(200)
