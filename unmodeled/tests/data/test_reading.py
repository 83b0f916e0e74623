"""Measured files as instruments and trackers write them."""

import math
from pathlib import Path

import numpy as np
import pytest

from unmodeled.cli import main
from unmodeled.cli.models import READING
from unmodeled.cli.options import declare
from unmodeled.data import ReadOptions, read_record, read_records, write_record
from unmodeled.data.mapping import Signals
from unmodeled.data.sketch import sketch_sheet
from unmodeled.data.tables import text_lines
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.units import spelled_unit, split_column

UNITS = {"force": "N", "displacement": "m", "tip.x": "m", "tip.y": "m"}
MODES = {"force": ("force",), "motion": ("displacement",)}
MODEL = {"outputs": ("tip.x", "tip.y"), "modes": MODES, "units": UNITS,
         "names": {"force": ("finger.force",)}}  # fmt: skip


def command(*arguments):
    """Exit code of a command."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    return stop.value.code


def put(folder, text, name="a.csv", encoding="utf-8"):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


# ---------------------------------------------------------------- headings and units


@pytest.mark.parametrize(
    ("heading", "name", "unit"),
    [
        ("Force (L)", "Force (L)", ""),
        ("Position (h)", "Position (h)", ""),
        ("Time (h)", "Time", "h"),
        ("Speed (RPM)", "Speed", "rpm"),
        ("force [N]", "force", "N"),
        ("Extension (mm)", "Extension", "mm"),
        ("displacement [millimeters]", "displacement", "mm"),
        ("Time_s", "Time", "s"),
        ("Load, kN", "Load", "kN"),
        ("Weg / mm", "Weg", "mm"),
        ("Time in ms", "Time", "ms"),
        ("area (cm2)", "area", "cm2"),
        ("q [furlong]", "q", "furlong"),
        ("heater (kW)", "heater", "kW"),
        ("P (W)", "P", "W"),
        ("U (mV)", "U", "mV"),
        ("I (mA)", "I", "mA"),
        ("GPS speed (km/h)", "GPS speed", "km/h"),
        ("Speed (mph)", "Speed", "mi/h"),
        ("I (A)", "I", "A"),
        ("R (Ω)", "R", "Ω"),
        ("c (mol/l)", "c", "mol/l"),
        ("T (K)", "T", "K"),
        ("T (°C)", "T", "degC"),
        ("h (W/(m² K))", "h", "W/(m² K)"),
        ("Current_A", "Current", "A"),
        ("Force (A)", "Force (A)", ""),
        ("x (T)", "x (T)", ""),
        ("Marker (left)", "Marker (left)", ""),
        ("Marker 3 X", "Marker 3 X", ""),
        ("force_in", "force_in", ""),
        ("v_min", "v_min", ""),
        ("mass A", "mass A", ""),
        ("Taste mm", "Taste", "mm"),
        ("Moment µN m", "Moment", "µN m"),
        ("pos[0]", "pos[0]", ""),
        ("pos[x]", "pos[x]", ""),
    ],
)
def test_headings_hold_units(heading, name, unit):
    assert split_column(heading) == (name, unit)


@pytest.mark.parametrize("clock", ["Zeitstempel", "t", "Time"])
def test_the_unit_of_a_clock_may_name_its_column(tmp_path, clock):
    path = put(tmp_path, f"{clock},x [mm]\n0,1\n10,2\n20,3\n")
    record = read_record(path, options=ReadOptions(units={clock: "ms"}))
    np.testing.assert_allclose(record.time, [0.0, 0.01, 0.02])
    assert list(record.outputs) == ["x"]


def test_units_are_spelled_in_many_ways():
    spelled = {
        "(mm)": "mm",
        "Seconds": "s",
        "sec.": "s",
        "pixels": "px",
        "N/mm": "N/mm",
        "U/min": "rpm",
        "Hours": "h",
        "liters": "L",
        "lbs": "lb",
    }
    assert {k: spelled_unit(k) for k in spelled} == spelled
    assert spelled_unit("X") is None


# ---------------------------------------------------------------- tables


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("time [s];force [N];tip.x [mm]\n0,0;1,5;0,25\n0,1;2,5;0,5\n0,2;3,5;0,75\n", "utf-8"),
        ("time [s]\tforce [N]\ttip.x [mm]\n0\t1.5\t.25\n.1\t2.5\t.5\n.2\t3.5\t.75\n", "utf-16"),
        ("Prüfung;;\nGeschwindigkeit;10 mm/s;\nProbe;7;\nZeit;Kraft;Tip X\ns;N;mm\n"
         "0,0;1,5;0,25\n0,1;2,5;0,5\n0,2;3,5;0,75\n", "cp1252"),
        ('"Time_s","Force (N)","Tip_X (mm)"\n"0,0","1,5","0,25"\n"0,1","2,5","0,5"\n'
         '"0,2","3,5","0,75"\n', "utf-8"),
        ("time [ms],finger.force [N],tip x [um],\n0,1.5,250,\n100,2.5,500,\n200,3.5,750,\n",
         "utf-8"),
        ("Elapsed Time (s)  Load (N)  tip.x (mm)\n", "utf-8"),
    ],
)  # fmt: skip
def test_tables_of_instruments(tmp_path, text, encoding):
    if text.startswith("Elapsed"):  # spaces between columns need headings without spaces
        text = "Time_s Load_N tip.x[mm]\n0 1.5 .25\n.1 2.5 .5\n.2 3.5 .75\n"
    record = read_record(put(tmp_path, text, encoding=encoding), **MODEL)
    np.testing.assert_allclose(record.time, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(record.inputs["force"], [1.5, 2.5, 3.5])
    np.testing.assert_allclose(record.outputs["tip.x"], [0.25e-3, 0.5e-3, 0.75e-3])


def test_a_fault_in_the_first_row_is_no_header(tmp_path):
    path = put(tmp_path, "t,force [N],tip.x [m]\n0,x,1\n1,2,3\n2,3,4\n3,4,5\n")
    with pytest.raises(DataError, match="line 2: force = 'x', expected a number"):
        read_record(path, **MODEL)


def test_the_input_of_a_test_machine_is_known_by_what_it_measures(tmp_path):
    path = put(tmp_path, "Time (s),Extension (mm),tip.x [mm]\n0,1,2\n1,2,3\n2,3,4\n")
    record = read_record(path, **MODEL)
    assert record.input_mode == "motion"
    np.testing.assert_allclose(record.inputs["displacement"], [1e-3, 2e-3, 3e-3])
    two = put(tmp_path, "t,Load (N),Force (kN),tip.x [mm]\n0,1,2,1\n1,2,3,1\n2,3,4,1\n", "b.csv")
    assert read_record(two, **MODEL).inputs["force"][0] == 2000.0  # the name of the signal first
    none = put(tmp_path, "t,Load (mm),tip.x [mm]\n0,1,2\n1,2,3\n2,3,4\n", "c.csv")
    with pytest.raises(DataError, match="no column force or displacement"):
        read_record(none, **MODEL)


def test_without_model_and_sheet_every_column_is_an_output(tmp_path):
    path = put(tmp_path, "time [s],force [N],a [mm],b\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    record = read_record(path)
    assert list(record.inputs) == ["force"]
    assert list(record.outputs) == ["a", "b"]


# ---------------------------------------------------------------- told on the command line


PIXELS = (
    "frame,Load (N),Marker 3 X,Marker 3 Y\n0,1,100,480\n1,2,110,470\n2,3,120,460\n4,3,120,460\n"
)


@pytest.mark.parametrize(
    ("unit", "model", "first"),
    [
        ("K", "degC", 26.85),
        ("°F", "degC", 148.888889),
        ("°C", "K", 573.15),
        ("degF", "K", 422.038889),
        ("K", "K", 300.0),
        ("°F", "", 300.0),
    ],
)
def test_a_temperature_is_converted_to_the_scale_of_the_model(tmp_path, unit, model, first):
    path = put(tmp_path, f"time [s],u [V],T [{unit}]\n0,1,300\n1,2,301\n2,3,302\n")
    record = read_record(path, inputs=["u"], outputs=["T"], units={"T": model, "u": "V"})
    assert record.outputs["T"][0] == pytest.approx(first, abs=1e-6)
    assert record.sensors["T"].unit == (model or "degF")


@pytest.mark.parametrize(
    ("unit", "model", "factor"),
    [
        ("W", "kW", 1e-3),
        ("kW", "W", 1e3),
        ("mV", "V", 1e-3),
        ("V", "mV", 1e3),
        ("mA", "A", 1e-3),
        ("mol/l", "mol/m^3", 1e3),
        ("mmol/l", "mol/l", 1e-3),
        ("l/min", "m^3/s", 1e-3 / 60.0),
        ("l/h", "L/min", 1.0 / 60.0),
        ("bar", "Pa", 1e5),
        ("hPa", "kPa", 0.1),
        ("RPM", "rad/s", math.pi / 30.0),
        ("rad/s", "RPM", 30.0 / math.pi),
        ("kWh", "MJ", 3.6),
        ("J/(kg K)", "kJ/kg °C", 1e-3),
    ],
)
@pytest.mark.parametrize("heading", ["u [{}]", "u ({})"])
def test_inputs_and_outputs_are_converted_to_the_unit_of_the_model(
    tmp_path, heading, unit, model, factor
):
    path = put(tmp_path, f"time [s],{heading.format(unit)},y [{unit}]\n0,1,5\n1,2,6\n2,3,7\n")
    record = read_record(path, inputs=["u"], outputs=["y"], units={"u": model, "y": model})
    assert record.inputs["u"] == pytest.approx([factor, 2.0 * factor, 3.0 * factor], rel=1e-12)
    assert record.outputs["y"][0] == pytest.approx(5.0 * factor, rel=1e-12)
    assert record.input_units["u"] == record.sensors["y"].unit == model
    again = read_record(write_record(record, tmp_path / "again.csv"))
    assert again.inputs["u"] == pytest.approx(record.inputs["u"], rel=1e-12)
    assert again.input_units["u"] == record.input_units["u"]


def test_a_unit_that_only_the_model_knows_is_kept(tmp_path):
    path = put(tmp_path, "time [s],u [turns],y [turns]\n0,1,5\n1,2,6\n2,3,7\n")
    told = {"inputs": ["u"], "outputs": ["y"]}
    record = read_record(path, **told, units={"u": "turns", "y": "turns"})
    assert record.input_units["u"] == record.sensors["y"].unit == "turns"
    with pytest.raises(DataError, match="unit 'turns' is unknown"):
        read_record(path, **told, units={"u": "rad", "y": "rad"})


def test_a_unit_of_a_scale_may_be_a_temperature(tmp_path):
    path = put(tmp_path, "time [s],u [V],T\n0,1,3000\n1,2,3010\n2,3,3020\n")
    told = ReadOptions(scales={"T": "0.1 K"})
    record = read_record(path, inputs=["u"], outputs=["T"], units={"T": "degC"}, options=told)
    assert record.outputs["T"] == pytest.approx([26.85, 27.85, 28.85])


def test_electrical_and_thermal_columns_may_have_prefixes(tmp_path):
    path = put(tmp_path, "time [s],u [mV],T [°C],heat [kW]\n0,10,20,1\n0.1,20,21,2\n0.2,5,22,3\n")
    (found,) = read_records([path], inputs=["u"], outputs=["T", "heat"])
    assert found.inputs["u"] == pytest.approx([0.01, 0.02, 0.005])
    assert found.input_units["u"] == "V"
    assert found.outputs["T"] == pytest.approx([20.0, 21.0, 22.0])
    assert found.outputs["heat"] == pytest.approx([1e3, 2e3, 3e3])
    assert [found.sensors[n].unit for n in ("T", "heat")] == ["degC", "W"]


def test_columns_in_pixels_with_scale_and_origin(tmp_path):
    options = ReadOptions(
        columns={"tip.x": "Marker 3 X", "tip.y": "Marker 3 Y"},
        units={"": "px"},
        scales={"": "0.2mm"},
        origins={"": "90,480"},
        frame_rate=500.0,
        delays={"tip.x": 0.004},
        references={"": "rest"},
    )
    record = read_record(put(tmp_path, PIXELS), **MODEL, options=options)
    np.testing.assert_allclose(record.time, [0.0, 2e-3, 4e-3, 8e-3])
    np.testing.assert_allclose(record.outputs["tip.x"], [2e-3, 4e-3, 6e-3, 6e-3])
    np.testing.assert_allclose(record.outputs["tip.y"], [0.0, 2e-3, 4e-3, 4e-3], atol=1e-15)
    assert record.sensors["tip.x"].delay == 0.004
    assert record.sensors["tip.y"].reference == "rest"
    up = ReadOptions(**{**vars(options), "y_up": True, "origins": {"": "start"}})
    record = read_record(put(tmp_path, PIXELS), **MODEL, options=up)
    np.testing.assert_allclose(record.outputs["tip.y"], [0, -2e-3, -4e-3, -4e-3], atol=1e-15)


@pytest.mark.parametrize("origin", ["90,480,0", "90,", "x,480"])
def test_an_origin_that_is_no_point_of_the_picture_is_refused(tmp_path, origin):
    options = ReadOptions(units={"": "px"}, scales={"": "0.2mm"}, origins={"": origin})
    path = put(tmp_path, "t [s],tip.x,tip.y\n0,90,480\n1,91,479\n2,92,478\n")
    with pytest.raises(DataError, match=r"origin of tip\.[xy]: got .*, expected"):
        read_record(path, options=options)


@pytest.mark.parametrize("points", ["from 10 20 to 13 24", "from 10, 20 to 13, 24"])
def test_the_scale_is_that_of_two_points_of_the_picture(tmp_path, points):
    """3 and 4 pixels: they are 5 pixels apart."""
    options = ReadOptions(
        columns={"tip.x": "Marker 3 X", "tip.y": "Marker 3 Y"},
        scales={"": f"1 mm {points}"},
        origins={"": "90,480"},
        frame_rate=500.0,
    )
    record = read_record(put(tmp_path, PIXELS), **MODEL, options=options)
    np.testing.assert_allclose(record.outputs["tip.x"], [2e-3, 4e-3, 6e-3, 6e-3])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "Marker 3 X' is no|no unit in the header|tip.x"),
        ({"units": {"": "px"}, "frame_rate": 100.0}, "is in pixels: how large is one"),
        ({"scales": {"": "0.2mm"}}, "counts frames: how many are a second"),
        ({"scales": {"": "wide"}, "frame_rate": 100.0}, "scale = 'wide', expected what one px is"),
        ({"scales": {"": "1mm from 3 4 to 3 4"}, "frame_rate": 100.0}, "expected what one px is"),
        ({"scales": {"": "1mm from 3 4 to a b"}, "frame_rate": 100.0}, "expected what one px is"),
        (
            {"scales": {"": "1mm", "toe": "1mm"}},
            "scale of toe: there is no such channel; known are",
        ),
        ({"scales": {"": "1mm"}, "origins": {"tip.x": "left"}}, "origin of tip.x: got 'left'"),
    ],
)
def test_what_is_not_told_of_pixels_is_asked_for(tmp_path, options, said):
    told = ReadOptions(columns={"tip.x": "Marker 3 X"}, **options)
    with pytest.raises(DataError, match=said):
        read_record(put(tmp_path, PIXELS), **MODEL, options=told)


def test_a_video_that_plays_slowly_gets_its_true_clock(tmp_path):
    path = put(tmp_path, "t [s],force [N],tip.x [mm]\n0,1,1\n0.04,1,2\n0.08,1,3\n0.16,1,4\n")
    record = read_record(path, **MODEL, options=ReadOptions(frame_rate=1000.0))
    np.testing.assert_allclose(record.time, [0.0, 1e-3, 2e-3, 4e-3])


def test_options_go_before_the_sheet(tmp_path):
    path = put(tmp_path, "t,f,a,b\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    path.with_suffix(".toml").write_text("[inputs.force]\ncolumn='f'\n[outputs.q]\ncolumn='a'\n")
    record = read_record(path, options=ReadOptions(columns={"q": "b"}, units={"q": "mm"}))
    np.testing.assert_allclose(record.outputs["q"], [3e-3, 4e-3, 5e-3])


# ---------------------------------------------------------------- several runs in one file


def test_a_clock_that_begins_again_begins_a_run(tmp_path):
    rows = "".join(f"{t},{t},{run}{t}\n" for run in (1, 2, 3) for t in range(4))
    records = read_records([put(tmp_path, "t,force [N],tip.x [mm]\n" + rows)], **MODEL)
    assert [r.name for r in records] == ["a-1", "a-2", "a-3"]
    assert {r.repeats for r in records} == {"a"}
    np.testing.assert_allclose(records[2].outputs["tip.x"], 1e-3 * np.arange(30, 34))
    with pytest.raises(DataError, match="holds 3 runs, expected one"):
        read_record(tmp_path / "a.csv", **MODEL)


def test_a_column_numbers_the_runs(tmp_path):
    rows = "".join(f"{run},{t},{t},{run}{t}\n" for t in range(4) for run in (7, 8))
    path = put(tmp_path, "Trial,t,force [N],tip.x [mm]\n" + rows)
    records = read_records([path], **MODEL)
    assert [r.name for r in records] == ["a-7", "a-8"]
    np.testing.assert_allclose(records[1].outputs["tip.x"], 1e-3 * np.arange(80, 84))
    # A clock that goes on is one run, unless it is told.
    going = "".join(f"{t // 4},{t},{t},{t}\n" for t in range(8))
    path = put(tmp_path, "Trial,t,force [N],tip.x [mm]\n" + going)
    assert len(read_records([path], **MODEL)) == 1
    assert len(read_records([path], **MODEL, options=ReadOptions(run="Trial"))) == 2


def test_a_clock_that_stumbles_is_a_fault(tmp_path):
    path = put(tmp_path, "t,force [N],tip.x [mm]\n0,1,1\n1,1,1\n2,1,1\n1.9,1,1\n3,1,1\n")
    with pytest.raises(DataError, match=r"line 5: time does not increase, from 2 s to 1\.9 s"):
        read_record(path, **MODEL)


def test_faults_tell_the_line_of_the_file(tmp_path):
    # Comments, empty lines and a quoted line break count as in an editor.
    head = '# rig\n\nnotes,,\n"time\n[s]",force [N],tip.x [mm]\n'
    path = put(tmp_path, head + "0,1,1\n\n1,x,1\n2,1\n3,1,1\n")
    with pytest.raises(DataError) as error:
        read_record(path, **MODEL)
    assert "line 8: force = 'x', expected a number" in str(error.value)
    assert "line 9: 2 cells, expected 3" in str(error.value)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("0,1,1\n,1,1\n2,1,1\n3,1,1\n", "line 3: no time"),
        ("3,1,1\n2,1,1\n1,1,1\n0,1,1\n", "time decreases, from 3 s to 0 s"),
    ],
)
def test_a_clock_without_time_is_a_fault(tmp_path, rows, says):
    with pytest.raises(DataError, match=says):
        read_record(put(tmp_path, f"t,force [N],tip.x [mm]\n{rows}"), **MODEL)


def test_a_fault_of_the_header_tells_its_line(tmp_path):
    head = '"a\nb\nc",,\nt,force [N],force [N]\n'
    path = put(tmp_path, head + "0,1,1\n1,1,1\n2,1,1\n")
    with pytest.raises(DataError, match=r"left out: force \(2 columns in line 4\)"):
        read_record(path, **MODEL)
    # A form feed ends no line.
    path = put(tmp_path, "# page\x0c1\nt,force [N],tip.x [mm]\n0,1,1\n1,x,1\n2,1,1\n")
    with pytest.raises(DataError, match="line 4: force = 'x', expected a number"):
        read_record(path, **MODEL)


# ---------------------------------------------------------------- exports of trackers


def test_deeplabcut(tmp_path):
    text = (
        "scorer,net,net,net,net,net,net\nbodyparts,tip,tip,tip,toe,toe,toe\n"
        "coords,x,y,likelihood,x,y,likelihood\n0,100,480,0.99,5,5,0.9\n1,110,470,0.2,5,5,0.9\n"
        "2,120,460,0.98,5,5,0.9\n"
    )
    options = ReadOptions(frame_rate=100.0, scales={"": "0.1mm"})
    record = read_record(put(tmp_path, text), options=options)
    assert list(record.outputs) == ["tip.x", "tip.y", "toe.x", "toe.y"]
    np.testing.assert_allclose(record.outputs["tip.x"], [10e-3, np.nan, 12e-3])
    np.testing.assert_allclose(record.outputs["tip.y"], [-48e-3, np.nan, -46e-3])
    assert record.source == "DeepLabCut"
    lax = read_record(tmp_path / "a.csv", options=ReadOptions(**{**vars(options), "likelihood": 0}))
    assert np.isfinite(lax.outputs["tip.x"]).all()
    several = text.replace("bodyparts", "individuals,one,one,one,two,two,two\nbodyparts")
    record = read_record(put(tmp_path, several, "b.csv"), options=options)
    assert list(record.outputs) == ["one.tip.x", "one.tip.y", "two.toe.x", "two.toe.y"]


def test_the_zero_of_a_load_cell_can_be_subtracted(tmp_path):
    rows = [(i, 0.8 + max(0.0, i - 30), max(0.0, i - 30)) for i in range(60)]
    text = "t,force [N],tip.x [mm]\n" + "".join(f"{t},{f},{x}\n" for t, f, x in rows)
    path = put(tmp_path, text)
    for options in (ReadOptions(origins={"force": "start"}), ReadOptions(origins={"force": "0.8"})):
        own = read_record(path, **MODEL, options=options)
        np.testing.assert_allclose(own.inputs["force"], [f - 0.8 for _, f, _ in rows], atol=1e-12)


@pytest.mark.parametrize("header", ["tip_x,tip_y,tip_likelihood", "tip.x,tip.y,Tip Confidence",
                                    "x,y,score"])  # fmt: skip
def test_the_likelihood_of_a_point_in_a_table(tmp_path, header):
    rows = "0,1,4,0.99\n1,2,5,0.7\n2,3,6,0.5\n"
    path = put(tmp_path, f"t,{header}\n{rows}")
    options = ReadOptions(units={"": "mm"})
    record = read_record(path, options=options)
    assert list(record.outputs) == header.split(",")[:2]
    for values, first in zip(record.outputs.values(), (1e-3, 4e-3), strict=True):
        np.testing.assert_allclose(values, [first, first + 1e-3, np.nan])
    (told,) = [n for n in record.notes if "left out" in n]
    assert "1 of 3 points are left out" in told
    assert f"{header.split(',')[2]} is below 0.6" in told
    strict = read_record(path, options=ReadOptions(units={"": "mm"}, likelihood=0.9))
    assert [np.isnan(v).sum() for v in strict.outputs.values()] == [2, 2]
    lax = read_record(path, options=ReadOptions(units={"": "mm"}, likelihood=0.5))
    assert all(np.isfinite(v).all() for v in lax.outputs.values())
    assert not [n for n in lax.notes if "left out" in n]


def test_a_likelihood_without_a_column_is_a_fault(tmp_path):
    # A score above 1 is no likelihood, and one of another point does not belong to tip.
    for third in ("score", "toe_likelihood"):
        path = put(tmp_path, f"t,tip_x [mm],tip_y [mm],{third}\n0,1,4,9\n1,2,5,8\n2,3,6,7\n")
        with pytest.raises(DataError, match=r"likelihood = 0.9, but the file has no likelihood"):
            read_record(path, options=ReadOptions(likelihood=0.9))
        assert np.isfinite(read_record(path).outputs["tip_x"]).all()
        path.with_suffix(".toml").write_text("likelihood = 0.9\n[outputs.tip_x]\n")
        with pytest.raises(DataError, match=r"expected a column such as tip_likelihood"):
            read_record(path)
        path.with_suffix(".toml").unlink()


@pytest.mark.parametrize(
    ("text", "outputs"),
    [
        ("mass A\nt\tx\ty\n0.0\t1\t2\n0.1\t2\t3\n0.2\t\t\n", ["mass A.x", "mass A.y"]),
        ("#mass_A\nt\tx\ty\n0.0\t1\t2\n0.1\t2\t3\n0.2\t\t\n", ["mass_A.x", "mass_A.y"]),
        ("#multi:\n;A;;B;;\nt;x;y;x;y;\n0,0;1;2;3;4;\n0,1;2;3;4;5;\n0,2;;;5;6;\n",
         ["A.x", "A.y", "B.x", "B.y"]),
    ],
)  # fmt: skip
def test_tracker(tmp_path, text, outputs):
    options = ReadOptions(units={"": "cm"})
    record = read_record(put(tmp_path, text, "a.txt"), options=options)
    assert list(record.outputs) == outputs
    np.testing.assert_allclose(record.outputs[outputs[1]], [0.02, 0.03, np.nan])
    np.testing.assert_allclose(record.time, [0.0, 0.1, 0.2])
    assert record.source == "Tracker"


def test_kinovea(tmp_path):
    table = '"Time";"tip/0/X";"tip/0/Y";"toe/0/X";"toe/0/Y"\n'
    table += '"0,0";"1,5";"2,0";;\n"0,1";"2,5";"3,0";"7,0";"8,0"\n"0,2";"3,5";"4,0";;\n'
    options = ReadOptions(units={"": "mm"})
    one = read_record(put(tmp_path, table), options=options)
    assert one.source == "Kinovea"
    assert "seconds, its default" in one.notes[0]
    np.testing.assert_allclose(one.outputs["toe.y"], [np.nan, 8e-3, np.nan])
    text = "#Kinovea Trajectory data export\n#T X Y\n\n# tip\n0 1.5 2\n0.1 2.5 3\n0.2 3.5 4\n\n"
    two = read_record(put(tmp_path, text + "# toe\n0.1 7 8\n\n", "b.txt"), options=options)
    np.testing.assert_allclose(two.time, one.time)
    for name, values in one.outputs.items():
        np.testing.assert_allclose(two.outputs[name], values)
    old = "#Kinovea Trajectory data export\n#T X Y\n0:00:00:00 866,00 320,00\n"
    old += "0:00:00:04 847,00 321,00\n0:00:01:00 840,00 322,00\n"
    three = read_record(put(tmp_path, old, "c.txt"), options=options)
    np.testing.assert_allclose(three.time, [0.0, 0.04, 1.0])
    np.testing.assert_allclose(three.outputs["point1.x"], [0.866, 0.847, 0.84])


ODD = (
    "t,x\n0,1\n1,2\n2,3\n",
    "Zeit;Kraft\ns;N\n0,0;1,0\n0,1;2,0\n0,2;3,0\n",
    "scorer,a,a,a\nbodyparts,p,p,p\ncoords,x,y,likelihood\n0,1,2,.9\n1,2,3,.9\n2,2,3,.9\n",
    "#Kinovea Trajectory data export\n#T X Y\n0 1 2\n1 2 3\n",
    "#multi:\n,A,,B,\nt,x,y,x,y\n0,1,2,3,4\n1,2,3,4,5\n2,2,3,4,5\n",
)


@pytest.mark.parametrize("text", ODD)
def test_damaged_texts_are_read_or_refused(tmp_path, text):
    """Whatever a text holds: records, or one message."""
    generator = np.random.default_rng(0)
    refused = 0
    for _ in range(150):
        letters = list(text)
        for place in generator.integers(0, len(letters), 3):
            letters[place] = generator.choice([*',;\t\n "#x.-:0', ""])
        path = put(tmp_path, "".join(letters))
        try:
            read_records([path], options=ReadOptions(scales={"": "1mm"}, frame_rate=100.0))
        except DataError:
            refused += 1
    assert 0 < refused < 150


# ---------------------------------------------------------------- the sheet that new writes


def test_a_sheet_is_written_that_reads_the_same(tmp_path):
    path = put(tmp_path, PIXELS)
    options = ReadOptions(
        columns={"tip.x": "Marker 3 X"}, scales={"": "0.2mm"}, origins={"": "90,480"},
        frame_rate=500.0,
    )  # fmt: skip
    before = read_record(path, **MODEL, options=options)
    text, lacks = sketch_sheet(path, Signals(**MODEL), options)
    assert lacks == ""
    assert "# Columns that are not used: Marker 3 Y" in text
    path.with_suffix(".toml").write_text(text)
    after = read_record(path)
    assert after.input_mode == before.input_mode
    np.testing.assert_array_equal(after.time, before.time)
    np.testing.assert_array_equal(after.outputs["tip.x"], before.outputs["tip.x"])
    np.testing.assert_array_equal(after.inputs["force"], before.inputs["force"])


@pytest.mark.parametrize(
    ("columns", "missing"),
    [
        ("tip.x (mm)", "no input"),
        ("Kraft (N)", "no output"),
        ("Lampe (V)", "no output"),
    ],
)
def test_a_sheet_of_one_of_two_files_tells_how_to_join_them(tmp_path, columns, missing):
    path = put(tmp_path, f"Zeit (s);{columns}\n0;1\n1;2\n2;3\n")
    signals = Signals(inputs=("force",), outputs=("tip.x",), units={"force": "N", "tip.x": "m"})
    text, lacks = sketch_sheet(path, signals)
    told = f"{path.name} has {missing} of the model. If another file of the same experiment has it"
    assert told in lacks
    assert f"unmodeled join {path.name} OTHER.csv --same" in lacks
    assert f"# {told}" in text
    path = put(tmp_path, "Zeit (s);tip.x (mm);Kraft (N)\n0;1;1\n1;2;2\n2;3;3\n")
    assert sketch_sheet(path, signals)[1] == ""


def test_new_writes_a_sheet_beside_a_file(tmp_path, capsys):
    path = put(tmp_path, "Zeit (s);Kraft (N);a (mm)\n0;1;2,5\n1;2;3,5\n2;3;4,5\n")
    assert command("new", str(path)) == 0
    record = read_record(path)
    assert list(record.inputs) == ["force"]
    np.testing.assert_allclose(record.outputs["a"], [2.5e-3, 3.5e-3, 4.5e-3])
    assert command("new", str(path)) == 2
    assert "exists" in capsys.readouterr().err
    assert command("new") == 2
    assert "Missing argument 'DATA'" in capsys.readouterr().err


def test_options_of_the_command_line():
    def options(**given):
        words = [(f"--{key.replace('_', '-')}", v) for key, vs in given.items() for v in vs]
        made = []
        command = declare("read")(lambda reading=READING: made.append(reading))
        command.main([w for pair in words for w in pair], standalone_mode=False)
        return made[0]

    told = options(column=("tip.x=Marker 3 X",), unit=("px", "time=ms"), delay=("12ms",))
    assert options(missing=("-9999", "1e30")).missing == (-9999.0, 1e30)
    assert told.columns == {"tip.x": "Marker 3 X"}
    assert told.units == {"": "px", "time": "ms"}
    assert told.delays == {"": 0.012}
    for wrong in (
        {"column": ("tip.x",)},
        {"missing": ("none",)},
        {"delay": ("soon",)},
        {"reference": ("floor",)},
        {"unit": ("mm", "px")},
    ):
        with pytest.raises(InvalidParameter):
            options(**wrong)


def test_a_column_that_is_told_and_missing_is_said_to_be_missing(tmp_path):
    path = put(tmp_path, "time [s],force [N],T [m]\n0,1,2\n1,2,3\n")
    told = ReadOptions(columns={"T": "Tx"})
    with pytest.raises(DataError, match="no column 'Tx' for T; there are time, force, T") as error:
        read_record(path, outputs=["T"], modes=MODES, units={"T": "m", "force": "N"}, options=told)
    assert "unit" not in str(error.value)


def test_an_empty_unit_of_a_model_is_none_that_is_known(tmp_path):
    path = put(tmp_path, "time [s],T\n0,2\n1,3\n")
    record = read_record(path, outputs=["T"], units={"T": ""})
    assert record.outputs["T"].tolist() == [2.0, 3.0]


@pytest.mark.parametrize("name", ["Course de l’outil", "A–B", "Abstand „a“", "Größe"])
def test_quotes_and_dashes_of_western_files_are_no_kanji(name):
    (line,) = text_lines(f"Temps [s];{name} [mm];Force [N]".encode("cp1252"), Path("a.csv")).texts
    assert line == f"Temps [s];{name} [mm];Force [N]"


def test_a_unit_behind_the_name_of_a_channel(tmp_path):
    text = "t_ms,U_V,phi_deg,x_rad\n0,1,0,0\n10,2,90,0\n20,3,180,0\n"
    path = put(tmp_path, text)
    model = {"inputs": ("U",), "outputs": ("phi", "x"), "units": {"U": "V", "phi": "rad", "x": "m"}}
    record = read_record(path, **model)
    assert list(record.outputs) == ["phi"]  # x in rad measures nothing of x
    assert record.outputs["phi"][2] == pytest.approx(math.pi)
    assert record.input_units == {"U": "V"}
    assert any("phi_deg is phi in deg" in note for note in record.notes)
    read = read_record(
        path, **model, options=ReadOptions(columns={"x": "phi_deg"}, units={"x": "mm"})
    )
    assert read.outputs["x"][1] == pytest.approx(0.09)
    assert "phi" not in read.outputs
    other = {**model, "outputs": ("angle",), "units": {"U": "V", "angle": "rad"}}
    named = read_record(path, **other, options=ReadOptions(columns={"angle": "phi_deg"}))
    assert named.outputs["angle"][1] == pytest.approx(math.pi / 2)
    text, note = sketch_sheet(path, Signals(("U",), ("phi",), units={"U": "V", "phi": "rad"}))
    assert not note
    assert '[outputs."phi"]\ncolumn = "phi_deg"\nunit = "deg"' in text


def test_a_tick_is_a_part_of_a_turn(tmp_path):
    path = put(tmp_path, "t [ms],phi\n0,0\n10,1024\n20,4096\n")
    model = {"outputs": ("phi",), "units": {"phi": "rad"}}
    record = read_record(path, **model, options=ReadOptions(scales={"phi": "360deg/4096"}))
    assert record.outputs["phi"] == pytest.approx([0.0, math.pi / 2, 2 * math.pi])
    with pytest.raises(DataError, match=r"such as 0\.21mm or 360deg/4096"):
        read_record(path, **model, options=ReadOptions(scales={"phi": "deg/4096"}))
