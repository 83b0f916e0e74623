"""First-time stories on the whole action, by the command line, with nothing prepared."""

import json

import pytest

from feltmb.adapters.model import resolve
from feltmb.cli import main
from stories.stories import STORIES, make


def told(name, folder):
    """What a diagnosis tells of a story: report and the values by name."""
    paths = [str(p) for p in make(STORIES[name], folder)]
    with pytest.raises(SystemExit) as end:
        main(["gap", "diagnose", "steinway45", *paths, "--seconds", "600", "-o", str(folder / "r")])
    assert not end.value.code
    report = json.loads((folder / "r" / "report.json").read_text())
    values = {p["name"]: p for p in report["parameters"]}
    return report, values | {n["cause"]: n for n in report["named"]}


def test_what_differs_in_a_story_is_known_to_the_library():
    model, effects = resolve("steinway45", {}, (), notify=lambda _: None)
    known = {p.name for p in model.parameters} | {e.name for e in effects}
    assert {s.size[0] for s in STORIES.values() if s.size is not None} <= known
    assert sum(s.size is None for s in STORIES.values()) == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["head", "let_off", "one_camera"])
def test_a_part_that_is_off_is_told_with_its_size(name, tmp_path):
    _, values = told(name, tmp_path)
    part, truth = STORIES[name].size
    assert values[part]["low"] <= truth <= values[part]["high"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tilt", "late"])
def test_a_sensor_that_is_wrong_is_to_blame_and_no_part(name, tmp_path):
    report, values = told(name, tmp_path)
    effect, truth = STORIES[name].size
    assert [n["cause"] for n in report["named"]] == [effect]
    assert values[effect]["low"] <= truth <= values[effect]["high"]


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing(tmp_path):
    report, _ = told("nothing", tmp_path)
    assert report["verdict"] in ("NO_GAP", "CALIBRATED")


def test_a_wrong_unit_is_told_by_a_comparison(tmp_path, capsys):
    paths = [str(p) for p in make(STORIES["unit"], tmp_path, ("forte",))]
    with pytest.raises(SystemExit):
        main(["gap", "check", "steinway45", *paths, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert any(h["kind"] == "unit" for h in found["hints"])
