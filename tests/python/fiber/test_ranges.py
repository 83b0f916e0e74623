"""Numbers of fibers that no fiber has: warnings with the range; impossible ones are faults."""

import math

import pytest

from feltmb import felt, fiber
from feltmb.cli import main
from feltmb.felt import packaged_materials, read_measured_loop
from feltmb.fiber.ranges import RANGES
from unmodeled.errors import DataError, InvalidParameter


@pytest.fixture
def run(capsys):
    def command(*arguments):
        with pytest.raises(SystemExit) as end:
            main(list(arguments))
        out = capsys.readouterr()
        return end.value.code, out.out + out.err

    return command


@pytest.mark.parametrize("name", RANGES)
def test_a_number_outside_of_its_range_is_told_with_the_range(name):
    usual = RANGES[name]
    for inside in (usual.low, usual.high, math.sqrt(max(usual.low, 1e-9) * usual.high)):
        assert fiber.unusual(**{name: inside}) == []
    (text,) = fiber.unusual(**{name: 1.01 * usual.high})
    assert usual.what in text
    assert f"{usual.low:g} to {usual.high:g}" in text
    assert ("check its unit" in text) == (usual.unit != "1")


def test_segments_are_not_told_as_fibers(run, tmp_path):
    def told(segment):
        # The file has a wrong suffix; the numbers are told before.
        return run("fiber", "simulate", "--segment", segment, str(tmp_path / "x.txt"))[1]

    assert "warning" not in told("5um")
    assert "segment length = 62.5 m is outside of" in told("62.5m")


def test_packaged_felts_are_usual_and_unknown_names_are_refused():
    for name in packaged_materials():
        assert felt.load_material(name).fiber.unusual() == [], name
    assert len(fiber.unusual(d_f=25.0, E=2.5)) == 2
    with pytest.raises(InvalidParameter, match="no number of fibers 'df'; near are d_f"):
        fiber.unusual(df=1.0)


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("--d-f", "25m", "fiber diameter = 25 m"),
        ("--e-modulus", "2.5Pa", "modulus = 2.5 Pa"),
        ("--d-f", "25um", ""),
    ],
)
def test_commands_warn_of_unusual_numbers(run, option, value, told, tmp_path):
    output = run("fiber", "simulate", option, value, str(tmp_path / "x.txt"))[1]
    assert ("warning: " in output) == ("is outside of" in output) == bool(told)
    assert told in output


def test_impossible_numbers_are_faults(run, tmp_path):
    loop = tmp_path / "loop.csv"
    rows = [*range(1, 31), *range(29, 0, -1)]
    loop.write_text("thickness [mm],force [N]\n" + "".join(f"{5 - i / 4},{i * i}\n" for i in rows))
    with pytest.raises(DataError, match=r"thickness down to -0\.0025 m, expected > 0"):
        read_measured_loop(loop)
    code, output = run(
        "felt", "envelope", "synthetic_hammer", "--thickness", "6mm", "--area", "constant:10m^2"
    )
    assert code == 2
    assert "expected 1e-10 to 1" in output
