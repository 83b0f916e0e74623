"""Targets of a regulation: of a file, of the command line, extended."""

import json

import pytest
from calls import refused
from click.testing import CliRunner

import feltmb
from feltmb.action.regulate import load_targets
from feltmb.cli import cli
from unmodeled.errors import InvalidParameter


def _call(*arguments):
    result = CliRunner(env={"COLUMNS": "80"}).invoke(cli, [str(a) for a in arguments])
    return result, str(result.exception or "")


def test_targets_of_the_line_stand_beside_those_of_a_file():
    packaged = load_targets("steinway45")
    mine = packaged.with_targets(
        {"let-off": "4mm", "A": "10 mm", "shank on_the REST rail": "0 N to 1 N"}
    )
    by_name = {step.name: step for step in mine.steps}
    assert by_name["let-off"].target == pytest.approx(4e-3)
    assert by_name["key dip"].target == pytest.approx(10e-3)
    assert (by_name["shank on the rest rail"].low, by_name["shank on the rest rail"].high) == (0, 1)
    assert by_name["hammer blow"] == packaged.steps[1]
    assert mine.name == (
        "steinway45 with let-off = 4mm, A = 10 mm, shank on_the REST rail = 0 N to 1 N"
    )


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("letoff", "4mm", "there is no such step; did you mean 'let-off'?"),
        ("D", "1 mm", "names 2 steps"),
        ("let-off", "4 N", "does not measure"),
        ("let-off", "nan mm", "expected"),
        ("shank on the rest rail", "1 N", "is a range of 0.001 to 0.2"),
        ("shank on the rest rail", "1 N to 0.5 N", "the smaller number first"),
    ],
)
def test_a_target_that_is_none_is_refused(name, value, said):
    with pytest.raises(InvalidParameter) as caught:
        load_targets("steinway45").with_targets({name: value})
    assert said in str(caught.value)
    assert name in str(caught.value)


def test_targets_extend_packaged_ones(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'schema = 1\nname = "mine"\nextends = "steinway45"\n'
        '[[steps]]\nname = "let-off"\ntarget = "3 mm"\n'
        '[[steps]]\nname = "shank on the rest rail"\ntarget = "0.1 N"\ntolerance = "0.05 N"\n'
        '[[steps]]\nname = "damper at rest"\nmeasure = "rest_force"\ncontact = 10\nlow = "0.1 N"\n'
    )
    base, mine = load_targets("steinway45"), load_targets(path)
    assert mine.name == "mine"
    assert mine.cite == base.cite
    assert [s.name for s in mine.steps] == [*(s.name for s in base.steps), "damper at rest"]
    by_name = {step.name: step for step in mine.steps}
    assert by_name["let-off"].target == pytest.approx(3e-3)
    assert by_name["let-off"].screw == base.steps[4].screw
    assert by_name["shank on the rest rail"].low is None  # a target instead of the range
    assert by_name["shank on the rest rail"].target == 0.1
    again = tmp_path / "again.toml"
    again.write_text('schema = 1\nname = "again"\nextends = "mine.toml"\nrounds = 2\n')
    assert load_targets(again).steps == mine.steps
    assert load_targets(again).rounds == 2
    again.write_text('schema = 1\nname = "again"\nextends = "again.toml"\n')
    with pytest.raises(InvalidParameter, match="leads back to itself"):
        load_targets(again)
    again.write_text('schema = 1\nname = "again"\nextends = "nothing"\n')
    with pytest.raises(InvalidParameter, match="'nothing' is unknown"):
        load_targets(again)


def test_regulate_shows_the_screws_before_and_after(tmp_path):
    path = tmp_path / "dip.toml"
    path.write_text(
        'schema = 1\nname = "dip"\n[[steps]]\nname = "key dip"\nmeasure = "rest_gap"\ncontact = 2\n'
        'target = "10.5 mm"\ntolerance = "0.01 mm"\n'
        'screw = { name = "washers", path = "surfaces.Gp3.point", direction = [0.0, 1.0], '
        'low = "-5 mm", high = "5 mm", gain = -1.0 }\n'
    )
    result, said = _call(
        "regulate", "steinway45_printed", "--targets", path, "--target", "key-dip=10mm"
    )
    assert said == ""
    words = " ".join(result.stdout.split())
    assert "dip with key-dip = 10mm" in words
    assert "10.000" in words
    assert "(218, -40.7)" in words
    screws = json.loads(
        _call("regulate", "steinway45_printed", "--targets", path, "--json")[0].stdout
    )["steps"]
    assert screws[0]["value_before"] == "(218, -40.7) mm"
    assert screws[0]["value_after"] != screws[0]["value_before"]
    for wrong in ("let-off", "=4mm", "let-off="):
        said = _call("regulate", "steinway45", "--target", wrong)[1]
        assert said == f"--target {wrong}: expected STEP=VALUE, such as let-off=4mm"


def test_measure_of_a_regulation_that_is_no_text(tmp_path):
    # TypeError: unhashable type: 'dict'
    path = tmp_path / "a.toml"
    path.write_text('schema = 1\nname = "a"\n[[steps]]\nmeasure = { a = 1 }\n')
    refused(lambda: feltmb.load_targets(path), "a.toml: ", "measure")
