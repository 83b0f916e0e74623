"""What no experiment shows is told as a sentence, and is null in JSON."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.cli import main as feltmb_main
from feltmb.gap import (
    Effect,
    InputLimits,
    Limits,
    LinearModel,
    Options,
    Parameter,
    PartTest,
    Record,
    Sensor,
    design,
    diagnose,
)
from feltmb.gap.page import page
from feltmb.gap.plan_files import design_json
from feltmb.gap.report import report_json
from feltmb.gap.visibility import HelpfulPart


def effect(name, column):
    return Effect(name=name, component="c", unit="m", regressor=lambda r, s: column(r.inputs["u"]))


def line(sd=np.inf):
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=sd)],
    )
    model.inputs = ("u",)
    return model


ALIKE, MUTE = effect("alike", lambda u: 2.0 * u), effect("mute", lambda u: 0.0 * u)
SQUARE = effect("square", lambda u: u**2)
LIMITS = Limits(
    inputs={"u": InputLimits(least=-1.0, most=1.0)}, duration=1.0, sample_rate=100.0, lead=0.0
)
GIVEN = {"sensors": {"y": Sensor(name="y", sigma=0.1)}, "refinements": 0, "candidates": 2}


def test_a_plan_says_why_an_effect_does_not_show():
    found = design(line(), [ALIKE, MUTE, SQUARE], limits=LIMITS, budget=1, **GIVEN)
    rows = {v.effect: v for v in found.effects}
    assert rows["alike"].smallest == rows["mute"].smallest == np.inf
    assert rows["alike"].hidden == (
        "a change of slope looks the same in all tested experiments; measure this parameter "
        "separately"
    )
    assert rows["mute"].hidden == "no measured output changes with it in any tested experiment"
    assert rows["square"].hidden == ""
    numbers = {r["effect"]: r for r in design_json(found)["effects"]}
    assert numbers["alike"]["smallest"] is numbers["mute"]["smallest"] is None
    assert numbers["square"]["smallest_before"] is None  # before any experiment nothing shows
    assert numbers["square"]["smallest"] == pytest.approx(rows["square"].smallest)
    # A tolerance that is finite leaves something.
    known = design(line(sd=0.1), [ALIKE], limits=LIMITS, budget=1, **GIVEN)
    assert known.effects[0].hidden == ""


def test_a_plan_without_a_stroke_says_what_strokes_would_show():
    """Only a test of a part is cheap enough: the strokes are told, not "from inf"."""
    part = PartTest(parameter="slope", sd=0.1, cost=0.1)
    found = design(line(), [SQUARE], limits=replace(LIMITS, parts=(part,)), budget=0.5, **GIVEN)
    (row,) = found.effects
    assert row.smallest == np.inf
    assert row.hidden.startswith(
        "no experiment of the plan shows it; all tested experiments together show it from 0."
    )
    assert row.hidden.endswith(" m")


def test_a_part_that_makes_the_difference_is_told_without_inf():
    one = HelpfulPart(
        effect="alike", parameter="slope", known_to=0.1, unit="1", tolerance=np.inf,
        smallest_before=np.inf, smallest=0.5, effect_unit="m",
    )  # fmt: skip
    assert one.text == "slope known to 10.0%: alike is detectable from 500 mm (now at no magnitude)"


CODE = """
import sys
sys.path.insert(0, {folder!r})
from test_never_seen import ALIKE, LIMITS, MUTE, SQUARE, line
model, effects, limits = line(), [{effects}], LIMITS
"""


@pytest.mark.parametrize("effects", ["ALIKE, MUTE, SQUARE", "ALIKE"])
def test_commands_never_print_inf(tmp_path, capsys, effects):
    """A plan of one effect printed "now 100%, detectable from inf"."""
    code = CODE.format(folder=str(Path(__file__).parent), effects=effects)
    (tmp_path / "line.py").write_text(code)
    words = ["gap", "plan", str(tmp_path / "line.py"), "--budget", "1", "--refine", "0"]
    with pytest.raises(SystemExit, match="0"):
        feltmb_main([*words, "--candidates", "2"])
    text = capsys.readouterr().out
    assert not re.search(r"\binf\b", text)
    told = " ".join(text.split())
    assert "alike cannot be detected: a change of slope looks the same" in told
    assert ("detectable effects" in text) == ("SQUARE" in effects)
    with pytest.raises(SystemExit, match="0"):
        feltmb_main([*words, "--candidates", "2", "--json"])
    rows = json.loads(capsys.readouterr().out)["effects"]
    assert next(r for r in rows if r["effect"] == "alike")["smallest"] is None
    (tmp_path / "planned.csv").write_text(
        "time [s],u,y\n" + "".join(f"{0.01 * k},{0.01 * k},0\n" for k in range(100))
    )
    planned = [*words[:3], str(tmp_path / "planned.csv")]
    with pytest.raises(SystemExit, match="0"):
        feltmb_main(planned)
    text = capsys.readouterr().out
    assert not re.search(r"\binf\b", text)
    assert "alike cannot be detected: a change of slope looks the same" in text
    with pytest.raises(SystemExit, match="0"):
        feltmb_main([*planned, "--json"])
    rows = json.loads(capsys.readouterr().out)["effects"]
    assert next(r for r in rows if r["effect"] == "alike")["smallest"] is None


def test_a_report_has_null_and_words():
    time = np.arange(100) / 100.0
    u = np.sin(7.0 * time)
    y = u + 0.3 * u**2 + 0.1 * np.random.default_rng(1).standard_normal(100)
    record = Record(
        name="a", time=time, inputs={"u": u}, outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=0.1)},
    )  # fmt: skip
    report = diagnose(
        line(), [ALIKE, SQUARE], [record], None, Options(bootstrap=0, restarts=0, advice=False)
    )
    rows = {r["effect"]: r for r in report_json(report)["which"]["effects"]}
    assert rows["alike"]["smallest"] is None
    assert rows["square"]["smallest"] > 0.0
    html = page(report)
    assert html.count("at no magnitude") == 1
    assert ">inf<" not in html
