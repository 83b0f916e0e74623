"""Files that commands read and write: kinds, endings, folders."""

import pytest
from calls import refusal
from click.testing import CliRunner

import feltmb
from feltmb import simulate
from feltmb.cli import cli
from unmodeled.errors import InvalidParameter
from unmodeled.files import make_folder


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("duraton = 0.3\n[ram]\nforce = 5.0", "did you mean 'ramp'?"),
        ("kind = 'force'\ntime = [0, 1]\nvalue = [0, 1]", "give one of ramp, pulse, knots"),
        ("[body.a]\nmass = 1.0\n[surface.b]", "did you mean 'bodies'?"),
        ("about = 'nothing'", "is neither a stroke nor a mechanism"),
    ],
)
def test_a_file_is_judged_as_what_it_is_meant_to_be(tmp_path, text, message):
    path = tmp_path / "x.toml"
    path.write_text(f'schema = 1\nname = "x"\n{text}\n', encoding="utf-8")
    told = refusal("validate", path)
    assert message in told
    assert ("bodies: is missing" in told) == ("bodies" in message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("stroke", "{t}", "piano", "-o", "run.mp3"),
            "cannot write .mp3, expected .nc, .h5 or .csv",
        ),
        (("stroke", "{t}", "piano", "forte", "-o", "run.nc"), "expected that of a folder"),
        (("wav", "{t}", "-o", "a.mp3"), "cannot write .mp3, expected .wav"),
        (("touch", "{t}", "--plot", "t.png"), "t.png: is the name of a file, expected that of a"),
        (("plot", "{t}", "-o", "t.png"), "expected that of a folder"),
        (("demo", "-o", "t.csv"), "expected that of a folder"),
        (("regulate", "steinway45", "-o", "t.json"), "cannot write .json, expected .toml"),
        (("sensitivity", "{t}", "piano", "-o", "t.nc"), "cannot write .nc, expected .csv"),
        (("actuator", "-o", "t.txt"), "cannot write .txt, expected .nc or .csv"),
        (
            ("felt", "envelope", "synthetic_hammer", "-o", "t.csv"),
            "cannot write .csv, expected .toml",
        ),
    ],
)
def test_the_ending_decides_and_is_checked_first(
    template, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    told = refusal(*(str(template) if a == "{t}" else a for a in arguments))
    assert message in told
    assert not list(tmp_path.iterdir())


def test_endings_of_the_library(template, tmp_path):
    run = feltmb.simulate(str(template), "piano", 0.005)
    with pytest.raises(InvalidParameter, match=r"cannot write \.txt, expected \.nc, \.h5 or \.csv"):
        run.save(tmp_path / "run.txt")
    with pytest.raises(InvalidParameter, match=r"cannot write a name without ending"):
        run.save(tmp_path / "run")


def _call(*arguments):
    result = CliRunner(env={"COLUMNS": "80"}).invoke(cli, [str(a) for a in arguments])
    return result, str(result.exception or "")


def test_a_mistyped_folder_is_not_made(tmp_path):
    (tmp_path / "results").mkdir()
    result, said = _call("stroke", "steinway45", "forte", "-o", tmp_path / "resutls/a/run.nc")
    assert "there is no such folder ('resutls' is missing); did you mean 'results'?" in said
    assert isinstance(result.exception, InvalidParameter)
    for line in (
        ["stroke", "steinway45", "forte", "piano", "-o", tmp_path / "typo" / "runs"],
        ["touch", "steinway45", "--plot", tmp_path / "typo" / "touch"],
        ["regulate", "steinway45", "-o", tmp_path / "typo" / "new.toml"],
        ["demo", "--out", tmp_path / "typo" / "demo"],
        ["new", tmp_path / "typo" / "own.toml"],
        ["felt", "audit", "a12_03", "--plot", tmp_path / "typo" / "deeper" / "loops"],
    ):
        _, said = _call(*line)
        assert "there is no such folder" in said, line
        assert "create it first, or correct the path" in said
    assert [p.name for p in tmp_path.iterdir()] == ["results"]


def test_the_folder_that_is_named_is_made(tmp_path):
    run = simulate("steinway45", "forte", duration=0.005, ledger=False)
    with pytest.raises(InvalidParameter, match="there is no such folder"):
        run.save(tmp_path / "none" / "run.nc")
    assert make_folder(tmp_path / "new") == tmp_path / "new"
    assert make_folder(tmp_path / "new").is_dir()
    run.save(tmp_path / "new" / "run.nc")
    with pytest.raises(InvalidParameter, match="is a file, expected a folder"):
        make_folder(tmp_path / "new" / "run.nc")
    with pytest.raises(InvalidParameter, match="no such folder"):
        make_folder(tmp_path / "a" / "b")
