"""Files as instruments write them (layouts): own numbers of a damped press, 10 ms."""

import re
from pathlib import Path

import numpy as np
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


ENGLISH = """
Key Word,Test Type,Speed,Shape,No of Batches:,Qty/Batch:,Compression,Plate,Name,Thickness,Width,
Height,Size Unit:,Max._Force,Unit,Time,Force,Disp.,Stroke
"""
JAPANESE = """
キーワード,試験種類,速度,形状,バッチ数,サブバッチ数,圧縮,平板,名前,厚さ,幅,
高さ,寸法単位,最大点_試験力,単位,時間,試験力,変位,ストローク
"""


def trapezium(words, columns, stroke=0.35):
    """Export of Trapezium: settings, sizes, results, then a block a specimen."""

    def row(*cells):
        return ",".join(f'"{cell}"' for cell in cells)

    words = [word.strip() for word in words.split(",")]
    key, kind, speed, shape, batch, qty, press, plate, name, t, w, h, size, peak, unit = words[:15]
    lines = [row(key, kind, speed, shape, batch, qty), row("", press, "0.6mm/min", plate, 1, 2), ""]
    lines += [row(batch, 1), row(qty, 2), row(name, t, w, h), row(size, "mm", "mm", "mm")]
    specimens = ["1 _ 1", "1 _ 2"]
    lines += [row(one, "20.0000", "20.0000", "6.0000") for one in specimens]
    lines += ["", row(name, peak), row("", "Calc. at Entire Areas"), row(unit, "N")]
    lines += [row(one, f"{columns[1].max():.4f}") for one in specimens]
    for one, gain in zip(specimens, (1.0, 1.2), strict=True):
        lines += ["", row(one, ""), row(*words[15:]), row("sec", "N", "mm", "mm")]
        for time, force, x in zip(*columns, strict=True):
            cells = (f"{time:.2f}", f"{gain * force:.5f}", f"{x:.5f}", f"{x + stroke:.5f}")
            lines.append(row(*cells))
    return "\r\n".join([*lines, ""])


@pytest.mark.parametrize(
    ("words", "encoding"),
    [(ENGLISH, "ascii"), (JAPANESE, "cp932"), (JAPANESE, "utf-8-sig"), (JAPANESE, "utf-16")],
)
def test_an_export_of_trapezium(tmp_path, words, encoding):
    """Both languages, in Shift JIS too; the stroke is the displacement from another zero."""
    x = np.concatenate([np.linspace(0.0, 1.2, 60), np.linspace(1.2, 0.0, 60)[1:]])
    columns = (0.5 * np.arange(x.size), 30.0 * x**2.5, x)
    path = tmp_path / "test.csv"
    path.write_bytes(trapezium(words, columns).encode(encoding))
    with pytest.raises(DataError, match=r"2 specimens .*: 1 _ 1, 1 _ 2; expected one"):
        read_test(path)
    test = read_test(path, specimen="1 _ 2")
    assert np.allclose(test.x, 1e-3 * x, rtol=0.0, atol=1e-8)
    assert np.allclose(test.loads, 1.2 * columns[1], rtol=0.0, atol=1e-5)
    assert np.allclose(test.time, columns[0])
    disp, moved = words.strip().split(",")[-2:]
    assert test.notes == (
        f"{disp} is used, not {moved}, which differs from it by no more than a constant",
    )


def test_two_displacements_that_differ_are_refused(tmp_path):
    """A transducer at the specimen does not read the compliance of the frame."""
    x = np.linspace(0.0, 1.2, 60)
    rows = "".join(f"{a},{a + 0.01 * a * a},{30.0 * a**2.5}\n" for a in x)
    path = put(tmp_path / "a.csv", f"Disp. [mm],Stroke [mm],Force [N]\n{rows}")
    with pytest.raises(DataError, match=r"Disp\. .*Stroke .* are each a displacement"):
        read_test(path)


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
