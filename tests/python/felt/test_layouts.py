"""Files as instruments write them (layouts): own numbers of a damped press, 10 ms."""

import re
from pathlib import Path

import pytest

from feltmb.fiber.columns import read_test
from unmodeled.data import ReadOptions
from unmodeled.errors import DataError

LAYOUTS = Path(__file__).resolve().parents[3] / "unmodeled" / "tests" / "layouts"


def put(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "first", "second"),
    [("o_trapezium.csv", "1 _ 1", "1 _ 2"), ("p_blocks.csv", "Specimen 1", "Specimen 2")],
)
def test_tests_side_by_side_or_below_each_other_are_specimens(name, first, second):
    with pytest.raises(DataError, match=f"2 specimens .*: {first}, {second}; expected one"):
        read_test(LAYOUTS / name)
    one, two = (read_test(LAYOUTS / name, specimen=s) for s in (first, second))
    assert one.x.size == two.x.size == 22
    assert (one.x.max(), two.x.max()) == pytest.approx((1.3377e-3, 1.1890e-3), rel=1e-4)
    assert one.loads.max() > 1.1 * two.loads.max()


@pytest.mark.parametrize(("unit", "newtons"), [("g", 9.80665e-3), ("kg", 9.80665)])
def test_a_load_in_grams_is_told_and_the_advice_works(tmp_path, unit, newtons):
    rows = "".join(f"{0.01 * k},{k}\n" for k in range(20))
    path = put(tmp_path / "a.csv", f"Weg [mm],Load cell [{unit}]\n{rows}")
    with pytest.raises(DataError, match=f"unit {unit} does not measure a force") as refused:
        read_test(path)
    column, wanted = re.search(
        r"--column force='([^']+)' --unit force=(\w+)", str(refused.value)
    ).groups()
    told = ReadOptions(columns={"force": column}, units={"force": wanted})
    assert read_test(path, options=told).loads[-1] == pytest.approx(19.0 * newtons)
