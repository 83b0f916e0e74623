"""Which column of a measured file is its clock, and what its unit is."""

import re

import numpy as np
import pytest

from unmodeled.data import ReadOptions, read_record
from unmodeled.errors import DataError
from unmodeled.units import split_column

OIL = ["20.0", "20.3", "20.689", "21.121"]
ROOM = ["18.0", "18.01", "18.04", "18.09"]


def record(path, head, *columns, **options):
    rows = [head, *(",".join(cells) for cells in zip(*columns, strict=True))]
    path.write_text("\n".join(rows) + "\n")
    return read_record(path, options=ReadOptions(**options))


@pytest.fixture
def file(tmp_path):
    return tmp_path / "data.csv"


@pytest.mark.parametrize("first", ["", "Unnamed: 0", '""'])
def test_a_first_column_without_a_name_is_the_clock(file, first):
    """The default of pandas; the oil, which becomes warmer and warmer, was the clock."""
    found = record(file, f"{first},oil,room", ["0.0", "0.5", "1.0", "1.5"], OIL, ROOM)
    assert found.time.tolist() == [0.0, 0.5, 1.0, 1.5]
    assert list(found.outputs) == ["oil", "room"]
    assert "column 1 has no name in the header and is taken as the clock in s" in found.notes


def test_a_first_column_with_a_unit_alone_is_the_clock_in_it(file):
    found = record(file, "[ms],oil,room", ["0.0", "0.5", "1.0", "1.5"], OIL, ROOM)
    assert found.time == pytest.approx([0.0, 5e-4, 1e-3, 1.5e-3])


@pytest.mark.parametrize(
    ("cells", "why"),
    [
        (["0.0", "0.5", "0.4", "1.5"], "0.5 is followed by 0.4 in line 4"),
        (["0.0", "0.5", "0.5", "1.5"], "0.5 is followed by 0.5 in line 4"),
        (["0.0", "", "1.0", "1.5"], "no number in line 3"),
        (["5/7/1999", "6/7/1999", "7/7/1999", "8/7/1999"], "text, such as '5/7/1999'"),
    ],
)
def test_a_first_column_without_a_name_that_is_no_clock_is_refused(file, cells, why):
    with pytest.raises(DataError, match=rf"column 1 .*{re.escape(why)}.*--column time=COLUMN"):
        record(file, ",oil,room", cells, OIL, ROOM)


def test_the_clock_can_be_chosen_beside_a_column_without_a_name(file):
    cells = ["3", "1", "2", "7"]
    found = record(file, ",oil,x", cells, OIL, ROOM, columns={"time": "x"})
    assert found.time == pytest.approx([float(x) for x in ROOM])
    assert list(found.outputs) == ["oil"]


def test_rows_that_are_counted_are_frames(file):
    count = ["0", "1", "2", "3"]
    with pytest.raises(DataError, match="counts frames: how many are a second"):
        record(file, ",oil,room", count, OIL, ROOM)
    found = record(file, ",oil,room", count, OIL, ROOM, frame_rate=50.0)
    assert found.time == pytest.approx([0.0, 0.02, 0.04, 0.06])
    # Beside a clock they are the row numbers that pandas writes.
    found = record(file, ",time,room", count, ["0.0", "0.1", "0.2", "0.3"], ROOM)
    assert found.time == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert list(found.outputs) == ["room"]
    found = record(file, ",time,room", OIL, ["0.0", "0.1", "0.2", "0.3"], ROOM)
    assert "column 1 has no name in the header and is left out" in found.notes


def test_runs_of_a_clock_without_a_name_begin_again(file):
    file.write_text(",oil\n0,1\n0.1,2\n0.2,3\n0,4\n0.1,5\n0.2,6\n")
    with pytest.raises(DataError, match="holds 2 runs"):
        read_record(file)


def test_no_other_column_becomes_the_clock(file):
    with pytest.raises(DataError, match=r"no column is the clock.*there are oil, room"):
        record(file, "oil,room", OIL, ROOM)
    with pytest.raises(DataError, match="no column is the clock"):
        record(file, "oil [degC],room [degC]", OIL, ROOM)
    found = record(file, "oil,room", OIL, ROOM, columns={"time": "oil"})
    assert found.time == pytest.approx([float(x) for x in OIL])
    # A unit of time is a statement of the file.
    found = record(file, "elapsed [min],room", OIL, ROOM)
    assert found.time == pytest.approx([60.0 * float(x) for x in OIL])


@pytest.mark.parametrize(
    ("heading", "expected"),
    [
        ("Time<ms>", ("Time", "ms")),
        ("Force <N>", ("Force", "N")),
        ("x<furlong>", ("x", "furlong")),
        ("U_B1 / V", ("U_B1", "V")),
        ("M_3 / N m", ("M_3", "N m")),
        ("p2 / mbar", ("p2", "mbar")),
        ("left / right", ("left / right", "")),
        ("a<b", ("a<b", "")),
        ("input/A", ("input/A", "")),
    ],
)
def test_units_of_headings(heading, expected):
    assert split_column(heading) == expected


def test_units_of_a_header_are_those_of_the_record(file):
    found = record(file, "Time<ms>,U_B1 / mV,M_3 / N mm", ["0", "10", "20", "30"], OIL, ROOM)
    assert found.time == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert {n: s.unit for n, s in found.sensors.items()} == {"U_B1": "V", "M_3": "N m"}
    assert found.outputs["U_B1"] == pytest.approx(1e-3 * np.array([float(x) for x in OIL]))
