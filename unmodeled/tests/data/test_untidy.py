"""Untidy files that people have: each is read, or one message says what is wrong."""

import json

import numpy as np
import pytest

from unmodeled.data import read, read_record
from unmodeled.errors import DataError
from unmodeled.units import split_column, to_si


def put(folder, text, name="a.csv"):
    (folder / name).write_text(text)
    return folder / name


def test_a_point_is_a_missing_value(tmp_path):
    path = put(tmp_path, "time [s],x [m]\n0,1\n0.1,.\n0.2,3\n0.3,.5\n")
    np.testing.assert_array_equal(read_record(path).outputs["x"], [1.0, np.nan, 3.0, 0.5])


def test_a_name_of_two_columns_that_nobody_needs_is_left_out(tmp_path):
    path = put(tmp_path, "time [s],x [m],note,note\n0,1,7,8\n0.1,2,7,8\n0.2,3,7,8\n")
    record = read_record(path)
    assert [*record.outputs] == ["x"]
    assert any("note: several columns have this name" in n for n in record.notes)
    with pytest.raises(DataError, match=r"left out: note \(2 columns in line 1\)"):
        read_record(path, outputs=["note"])


def test_a_clock_that_goes_back_is_told_with_its_line(tmp_path):
    path = put(tmp_path, "time [s],x [m]\n0.28,1\n0.24,2\n0.32,3\n0.36,4\n")
    with pytest.raises(DataError, match=r"line 3: time does not increase, from 0\.28 s to 0\.24 s"):
        read_record(path)


@pytest.mark.parametrize("form", ["[{}, {}]", "({};{})", "[{} {}]"])
def test_lists_in_cells_are_columns(tmp_path, form):
    rows = [f'{k},"{form.format(k + 0.5, -k)}"' for k in range(5)]
    record = read_record(put(tmp_path, "time [s],q [rad]\n" + "\n".join(rows)))
    np.testing.assert_array_equal(record.outputs["q.0"], np.arange(5) + 0.5)
    np.testing.assert_array_equal(record.outputs["q.1"], -np.arange(5.0))
    assert record.sensors["q.1"].unit == "rad"


ROWS = [{"time": 0.1 * k, "arm": {"angle [deg]": 180.0}, "tip": [k, 2 * k]} for k in range(5)]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.json", json.dumps(ROWS)),
        ("a.json", json.dumps({"about": "a rig", "rows": ROWS})),
        ("a.jsonl", "\n".join(map(json.dumps, ROWS))),
        ("a.json", json.dumps({"time": [0.1 * k for k in range(5)], "tip.1": [0, 2, 4, 6, 8],
                               "tip.0": [*range(5)], "arm.angle [deg]": [180.0] * 5})),
    ],
)  # fmt: skip
def test_json_of_records_or_of_lists(tmp_path, name, text):
    record = read_record(put(tmp_path, text, name))
    assert {*record.outputs} == {"arm.angle", "tip.0", "tip.1"}
    np.testing.assert_allclose(record.time, 0.1 * np.arange(5))
    np.testing.assert_allclose(record.outputs["arm.angle"], np.pi)
    np.testing.assert_array_equal(record.outputs["tip.1"], 2.0 * np.arange(5))


@pytest.mark.parametrize("text", ["3", "[]", "[1, 2]", "{}", "[{}]", '{"a": 1}', "[[1], {}]", "{"])
def test_json_that_is_no_table_gives_one_message(tmp_path, text):
    put(tmp_path, "time,x\n0,1\n1,2\n2,4\n", "b.csv")
    with pytest.raises(DataError):
        read_record(put(tmp_path, text, "a.json"))
    assert len(read(tmp_path)) == 1  # a folder may hold other JSON files


def test_json_of_many_names_is_limited_before_the_table_is_made(tmp_path):
    rows = [{f"x{k}": 1} for k in range(6000)]
    with pytest.raises(DataError, match="6000 records of 6000; the limit"):
        read_record(put(tmp_path, json.dumps(rows), "a.json"))


@pytest.mark.parametrize(
    ("unit", "size", "si"),
    [("C", 1.0, "A s"), ("mAh", 3.6, "A s"), ("Ah", 3600.0, "A s"), ("ppm", 1e-6, "1"),
     ("rad/s/V", 1.0, "rad/(s V)"), ("km/h/s", 1 / 3.6, "m/s^2")],
)  # fmt: skip
def test_units_of_batteries_gases_and_gains(unit, size, si):
    assert to_si(unit)[0] == pytest.approx(size)
    assert to_si(unit)[1] == to_si(si)[1]


def test_a_letter_is_degrees_where_a_temperature_is_expected(tmp_path):
    path = put(tmp_path, "time [s],room [C],q [C]\n0,20,1\n1,21,2\n2,22,3\n")
    units = {"room": "K", "q": "C"}
    record = read_record(path, outputs=["room", "q"], units=units)
    np.testing.assert_allclose(record.outputs["room"], [293.15, 294.15, 295.15])
    np.testing.assert_allclose(record.outputs["q"], [1.0, 2.0, 3.0])
    assert split_column("Sensor (C)") == ("Sensor (C)", "")
