"""``feltmb sensitivity``: table, JSON, files, faults."""

import json

import numpy as np
import pytest
from calls import command, refusal

import feltmb
from feltmb.cli import main

COMMON = ["steinway45", "forte", "--duration", "0.097", "--rtol", "1e-6"]
PATHS = ["--parameters", "key.mass", "--parameters", "stroke.scale"]


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main(["sensitivity", *arguments])
    out = capsys.readouterr()
    return ended.value.code, out.out, out.err


def test_table_picture_and_csv(capsys, tmp_path):
    picture, table = tmp_path / "effects.png", tmp_path / "effects.csv"
    code, out, err = run(capsys, *COMMON, *PATHS, "--plot", str(picture), "-o", str(table))
    assert code == 0, err
    assert "stroke.scale" in out
    assert "impact speed is 3.3" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    lines = table.read_text().splitlines()
    assert lines[0].startswith("parameter,")
    assert lines[1].startswith("stroke.scale,")  # the more influential one


def test_json(capsys):
    code, out, _ = run(capsys, *COMMON, *PATHS, "--json")
    found = json.loads(out)
    assert code == 0
    assert found["parameters"]["bodies.key.mass"]["unit"] == "kg"
    assert found["derivatives"]["impact_speed"]["stroke.scale"] > 0.0


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--parameters", "key.mss"], "bodies.key.mass"),
        ([*PATHS, "--number", "loudness"], "impact_speed"),
        ([*PATHS, "--number", "max_string_force"], "the present name is 'max_impact_force'"),
        ([*PATHS, "--most", "0"], "0 is not in the range x>=1"),
    ],
)
def test_faults(capsys, arguments, text):
    code, _, err = run(capsys, *COMMON, *arguments)
    assert code == 2
    assert text in err


def test_number_is_a_row_of_the_reading(capsys, data):
    machine = [str(data / "pedal.toml"), str(data / "kick.toml")]
    code, out, err = run(
        capsys, *machine, "--parameters", "beater.mass", "--number", "head_force", "--json"
    )
    assert code == 0, err
    found = json.loads(out)["derivatives"]["head_force"]["bodies.beater.mass"]
    assert found == pytest.approx(-242.9, rel=0.02)


def test_a_number_without_a_derivative_is_no_empty_table(capsys, data, monkeypatch):
    """Whatever the reason is; the first number that has a derivative is chosen by itself."""
    import dataclasses

    from feltmb.run import sensitivity

    whole = sensitivity.gradient
    why = "two contacts change order"

    def without(*args, **options):
        g = whole(*args, **options)
        return dataclasses.replace(g, unknown={"impact_speed": why, "meets": why})

    monkeypatch.setattr(sensitivity, "gradient", without)
    machine = [str(data / "pedal.toml"), str(data / "kick.toml"), "--parameters", "beater.mass"]
    code, out, err = run(capsys, *machine, "--number", "meets")
    assert (code, out) == (2, "")
    assert f"'meets' has no derivative in this stroke: {why}" in err
    code, out, err = run(capsys, *machine)
    assert code == 0, err
    assert "hit time is" in out


def test_sensitivity_of_the_template(template):
    """The rest pose near a rest pose: the search went to and fro between two roundings."""
    gradient = feltmb.gradient(str(template), "piano", None, ())
    assert gradient.summary
    assert np.all(np.isfinite(gradient.summary_gradient["key_travel"]))


def test_sensitivity_orders_by_what_the_stroke_has(template):
    done = command("sensitivity", template, "piano", "--parameters", "hammer.mass")
    assert done.exit_code == 0, done.exception
    peak = feltmb.simulate(str(template), "piano").summary["max_impact_force"]
    assert f"is {peak:.4g} N" in done.output
    assert "impact_speed" in refusal(
        *("sensitivity", template, "piano", "--parameters", "hammer.mass"),
        *("--number", "impact_speed"),
    )
