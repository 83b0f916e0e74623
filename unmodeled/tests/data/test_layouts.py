"""Files as instruments write them (layouts): own numbers of a damped press, 10 ms."""

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from unmodeled.data import ReadOptions, read_record, read_records
from unmodeled.data.columns import read_columns
from unmodeled.errors import DataError

LAYOUTS = Path(__file__).resolve().parents[1] / "layouts"
#: Start of the clock [s], and column, unit and multiple of the force and the travel.
RIGHT = {
    "a_labview.lvm": (0.0, ("Force", "N", 1.0), ("Travel", "mm", 1.0)),
    "b_labview_nox.lvm": (0.0, ("Force", "N", 1.0), ("Travel", "mm", 1.0)),
    "c_tektronix.csv": (-0.1, ("CH1", "V", 1.0)),
    "d_rigol.csv": (-0.05, ("CH1", "V", 1.0), ("CH2", "V", 1.0)),
    "e_pico.csv": (0.0, ("Channel A", "V", 1.0), ("Channel B", "mV", 1.0)),
    "f_zwick.csv": (0.0, ("Standardkraft", "N", 1.0), ("Standardweg", "mm", 1.0)),
    "g_opensim.mot": (0.0, ("force", "", 1.0), ("knee_angle", "deg", 1.0)),
    "h_px4.csv": (112.6, ("xyz[0]", "", 1.0), ("xyz[1]", "", 1.0)),
    "i_betaflight.csv": (4.0, ("gyroADC[0]", "", 1.0), ("motor[0]", "", 1.0)),
    "j_bluehill.csv": (0.0, ("Load", "N", 250.0), ("Compressive extension", "mm", 1.0)),
    "k_mts.txt": (12.5, ("Axial Force", "kN", 1e-3), ("Axial Displacement", "mm", 1.0)),
    "l_motec.csv": (0.0, ("Brake Pres Front", "bar", 1.0), ("Damper Pos FL", "mm", 1.0)),
    "m_arduino.txt": (0.0, ("column_2", "", 1.0), ("column_3", "", 1.0)),
    "n_qualisys.tsv": (0.0, ("hammer.x", "mm", 1.0), ("hammer.y", "mm", 1.0)),
}


def truth(samples):
    t = 0.01 * np.arange(samples)
    return t, 5.0 * (1.0 - np.exp(-t / 0.1)), 2.0 * (1.0 - np.exp(-t / 0.15))


def put(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", RIGHT)
def test_a_layout_has_its_numbers_units_and_clock(name):
    start, *signals = RIGHT[name]
    columns, record = read_columns(LAYOUTS / name), read_record(LAYOUTS / name)
    time, *expected = truth(record.samples)
    assert record.samples in (24, 60)
    np.testing.assert_allclose(record.time, start + time, atol=1e-9)
    for (column, unit, factor), values in zip(signals, expected, strict=False):
        assert columns.units.get(column, "") == unit
        error = 6e-3 if name in ("d_rigol.csv", "m_arduino.txt") else 6e-4  # digits in the file
        np.testing.assert_allclose(columns.values[column], factor * values, atol=factor * error)


def test_every_packaged_layout_is_read_without_faults():
    assert {p.name for p in LAYOUTS.iterdir()} >= {*RIGHT}
    assert not [n for n in RIGHT if read_columns(LAYOUTS / n).faults()]


def test_an_index_in_brackets_is_part_of_the_name():
    columns = read_columns(LAYOUTS / "q_index.csv")
    assert list(columns.values) == ["time", "pos[0]", "pos[1]"]
    np.testing.assert_allclose(columns.values["pos[1]"], 2.0 * columns.values["pos[0]"])


def test_dates_are_a_clock_and_a_name_may_stand_above_the_units():
    record = read_record(LAYOUTS / "r_dates.csv")
    np.testing.assert_allclose(record.time, 86400.0 * np.arange(15))
    assert list(record.outputs) == ["well-a", "well-b"]
    np.testing.assert_allclose(record.outputs["well-b"], 1e5 * (15.5 + np.arange(15)))


def test_dates_beside_times_of_day_count_days(tmp_path):
    rows = "\n".join(f"2026-11-{day:02d} 12:00:00,{day}" for day in (1, 3, 4))
    path = put(tmp_path / "a.csv", f"when,x [mm]\n{rows}\n")
    found = read_record(path, options=ReadOptions(columns={"time": "when"}))
    np.testing.assert_allclose(found.time, [0.0, 172800.0, 259200.0])


def test_parts_with_a_clock_are_runs(tmp_path):
    text = (LAYOUTS / "a_labview.lvm").read_text(encoding="utf-8")
    second = text[text.index("Channels") :]
    found = read_records([put(tmp_path / "two.lvm", text + "\n" + second)])
    assert [r.name for r in found] == ["two-1", "two-2"]
    np.testing.assert_array_equal(found[0].outputs["Travel"], found[1].outputs["Travel"])
    rows = "\n".join(f"0.{k},{k},{2 * k},{3 * k},{4 * k}" for k in range(1, 9))
    head = "Time,Left,,Right,\ns,N,mm,N,mm\n".replace("Time,Left,,Right,", "time,F,x,F,x")
    sides = read_records([put(tmp_path / "sides.csv", f",left,,right,\n{head}{rows}\n")])
    assert [r.name for r in sides] == ["sides-left", "sides-right"]
    np.testing.assert_allclose(sides[1].outputs["x"], 4e-3 * np.arange(1, 9))


def test_a_fault_in_a_part_keeps_its_line(tmp_path):
    block = "T1\nt [s],x [mm]\n0.5,1.5\n1.5,2.5\n2.5,3.5\n3.5,4.5\n"
    path = put(tmp_path / "a.csv", block + block.replace("T1", "T2").replace(",2.5", ",two"))
    with pytest.raises(DataError, match="line 10: x = 'two', expected a number"):
        read_record(path)


@pytest.mark.parametrize(
    ("cell", "value"),
    [("1,234.50", 1234.5), ("12,345,678.0", 12345678.0), ("-1,234.", -1234.0)],
)
def test_separators_of_thousands(tmp_path, cell, value):
    path = put(tmp_path / "a.csv", f't [s],x [N]\n0,"{cell}"\n1,2.0\n2,3.0\n')
    assert read_columns(path).values["x"][0] == value
    comma = cell.translate(str.maketrans(",.", ".,"))
    path = put(tmp_path / "b.csv", f"t [s];x [N]\n0,0;{comma}\n1,5;2,0\n2,5;3,0\n")
    assert read_columns(path).values["x"][0] == value


@pytest.mark.parametrize("text", ["Force:{f},Travel:{x}", "{f}\t{x}"])
def test_names_of_a_serial_monitor(tmp_path, text):
    head = "" if ":" in text else "12:30:04.990 -> Force\tTravel\n"
    rows = [text.format(f=5 * k, x=2.5 * k) for k in range(20)]
    lines = "\n".join(f"12:30:05.{10 * k:03d} -> {row}" for k, row in enumerate(rows))
    columns = read_columns(put(tmp_path / "a.txt", head + lines))
    np.testing.assert_allclose(columns.values["Force"], 5.0 * np.arange(20))
    np.testing.assert_allclose(columns.values["Travel"], 2.5 * np.arange(20))


@pytest.mark.parametrize("rate", ["Sample Rate;0,1;kHz", "Sample interval [ms];10", "tInc = 0,01"])
def test_a_step_of_the_preamble_is_the_clock(tmp_path, rate):
    rows = "\n".join(f"{k},5;{k + 1},5" for k in range(12))
    path = put(tmp_path / "a.csv", f"Station;A\n{rate}\nForce [N];x [mm]\n{rows}\n")
    record = read_record(path)
    np.testing.assert_allclose(record.time, 0.01 * np.arange(12))
    assert any("steps of 0.01 s, which the file states" in n for n in record.notes)


# ---------------------------------------------------------------- workbooks and TDMS


def test_a_workbook(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "Results"
    book.active.append(["Maximum", 95.0])
    sheet = book.create_sheet("Raw")
    for row in (["Operator", "lab"], [], ["Time", "Force", "Travel"], ["s", "N", "mm"]):
        sheet.append(row)
    for k in range(20):
        sheet.append([0.01 * k, 5 * k, 2.5 * k])
    book.save(tmp_path / "a.xlsx")
    record = read_record(tmp_path / "a.xlsx")
    np.testing.assert_allclose(record.time, 0.01 * np.arange(20))
    np.testing.assert_allclose(record.inputs["force"], 5.0 * np.arange(20))
    np.testing.assert_allclose(record.outputs["Travel"], 2.5e-3 * np.arange(20))
    assert "sheet Raw is read, not Results" in record.notes
    sheet["B8"] = "n/a?"
    book.save(tmp_path / "b.xlsx")
    with pytest.raises(DataError, match=r"line 8: Force = 'n/a\?', expected a number"):
        read_record(tmp_path / "b.xlsx")


def test_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    step = {"wf_increment": 0.01, "wf_start_offset": 0.5}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment([
            nptdms.ChannelObject("rig", "Force", 5.0 * np.arange(20), {"unit_string": "N", **step}),
            nptdms.ChannelObject("rig", "Travel", np.arange(20), {"unit_string": "mm", **step}),
        ])  # fmt: skip
    record = read_record(tmp_path / "a.tdms")
    np.testing.assert_allclose(record.time, 0.5 + 0.01 * np.arange(20))
    np.testing.assert_allclose(record.inputs["force"], 5.0 * np.arange(20))
    np.testing.assert_allclose(record.outputs["Travel"], 1e-3 * np.arange(20))


@pytest.mark.parametrize(("kind", "package"), [("xlsx", "openpyxl"), ("tdms", "npTDMS")])
def test_damaged_files_and_missing_packages(tmp_path, monkeypatch, kind, package):
    pytest.importorskip(package.lower())
    path = tmp_path / f"a.{kind}"
    path.write_bytes(b"PK\x03\x04 damaged" * 20)
    with pytest.raises(DataError, match="cannot be read as"):
        read_record(path)
    monkeypatch.setitem(sys.modules, package.lower(), None)
    with pytest.raises(DataError, match=f"pip install {package} \\(extra 'instruments'"):
        read_record(path)


def test_a_workbook_that_unpacks_to_gigabytes_is_refused(tmp_path):
    pytest.importorskip("openpyxl")
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("xl/worksheets/sheet1.xml", b" " * 110_000_000)
    with pytest.raises(DataError, match="bytes unpacked; the limit is"):
        read_record(tmp_path / "a.xlsx")


def test_the_ending_of_a_testing_machine_is_a_text(tmp_path):
    path = tmp_path / "Probe1.TRA"
    path.write_bytes((LAYOUTS / "f_zwick.csv").read_bytes())
    np.testing.assert_allclose(read_record(path).time, 0.01 * np.arange(60))
