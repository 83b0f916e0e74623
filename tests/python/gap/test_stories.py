"""First-time stories on the whole action, by the command line, with nothing prepared."""

import json
import subprocess
import sys

import pytest

from stories.stories import STORIES, diagnose, make

CALIBRATED = ["head", "heavy", "felt", "let_off", "string", "friction", "one_camera"]


def test_the_stories_are_twelve_and_each_says_what_is_right():
    twelve = set(STORIES) - {"heavy", "one_camera"}
    assert len(twelve) == 12
    for story in STORIES.values():
        assert story.verdicts


@pytest.mark.slow
@pytest.mark.parametrize("name", CALIBRATED)
def test_a_part_that_is_off_is_told_with_its_size(name, tmp_path):
    story = STORIES[name]
    outcome = diagnose(make(story, tmp_path), "-o", str(tmp_path / "report"))
    assert outcome.missing(story) == []
    part, truth = story.size
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    if part in report["named"]:  # beyond its tolerance, and held-out records feel it
        (row,) = [r for r in report["which"]["effects"] if r["effect"] == part]
        assert report["how_far"]["closed"] > 0.5
    else:
        (row,) = [r for r in report["calibrated"] if r["name"] == part]
        assert row["share"] > 0.5
    assert row["low"] <= truth <= row["high"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tilt", "scale", "late"])
def test_a_sensor_that_is_wrong_is_to_blame_and_no_part(name, tmp_path):
    """Such searches did not end: the model alone was fitted to records that it cannot explain."""
    story = STORIES[name]
    outcome = diagnose(make(story, tmp_path), "-o", str(tmp_path / "report"))
    assert outcome.missing(story) == []
    effect, truth = story.size
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert report["named"] == [effect]
    (row,) = [r for r in report["which"]["effects"] if r["effect"] == effect]
    assert row["low"] <= truth <= row["high"]


@pytest.mark.slow
def test_another_action_is_told_as_that_with_the_numbers_that_are_off(tmp_path):
    """The search did not end: no set of effects corrects three wrong numbers at once."""
    story = STORIES["other"]
    outcome = diagnose(make(story, tmp_path), "-o", str(tmp_path / "report"))
    assert outcome.missing(story) == []
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    rows = {r["name"]: r for r in report["calibrated"]}
    assert rows["key_dip"]["low"] < story.size[1] < rows["key_dip"]["high"]
    # A third of the strings, but not of their bending stiffness.
    assert rows["string_impedance"]["value"] == pytest.approx(-2.0 / 3.0, abs=0.02)
    assert report["next"][0]["text"].startswith("Make sure that the model is of the machine")


@pytest.mark.slow
def test_nothing_is_told_where_nothing_is_off(tmp_path):
    outcome = diagnose(make(STORIES["nothing"], tmp_path))
    assert outcome.missing(STORIES["nothing"]) == []


@pytest.mark.slow
def test_a_wrong_unit_is_told_before_any_fit(tmp_path):
    outcome = diagnose(make(STORIES["unit"], tmp_path))
    assert outcome.missing(STORIES["unit"]) == []
    assert outcome.code == 2
    assert "mm labeled as cm" in " ".join(outcome.first)


@pytest.mark.slow
def test_a_run_without_noise_shows_no_gap(tmp_path):
    """Its noise is below the error of the simulation: the fit did not end."""
    paths = []
    for stroke, duration in (("piano", "0.5"), ("forte", "0.2")):
        paths.append(tmp_path / f"{stroke}.csv")
        options = ["--duration", duration, "-o", str(paths[-1])]
        command = [sys.executable, "-m", "feltmb", "stroke", "steinway45", stroke, *options]
        subprocess.run(command, check=True)
    outcome = diagnose(paths)
    assert outcome.verdict == "NO GAP"
    assert "less than the error of a simulation" in (tmp_path / "said.txt").read_text()
