"""Measured files: what is read, and what is said of files that cannot be used."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled import (
    Equations,
    Parameter,
    Simulator,
    State,
    diagnose,
    fit_model,
    library,
)
from unmodeled.data import (
    ReadOptions,
    Record,
    Sensor,
    StartPrior,
    read_record,
    read_records,
    write_record,
)
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.loading import LoadedModel
from unmodeled.search.records import (
    _blocks,
    _spikes,
    check_records,
    noise_of_channel,
    ready_records,
)
from unmodeled.units import convert

from . import models


def some():
    time = np.arange(50) * 0.01
    q = np.sin(time)
    q[7] = np.nan
    return Record(
        name="run",
        time=time,
        inputs={"f": np.cos(time)},
        outputs={"q": q},
        sensors={"q": Sensor(name="q", unit="m", sigma=1e-3, delay=0.002, offset_sd=0.01)},
        input_sigma={"f": 0.1},
        conditions={"humidity": 0.4, "operator": "A"},
        role="held_out",
        start=StartPrior(mean={"x": 1.0}, sd={"x": 0.5}),
        repeats="a",
        source="made here",
    )


def test_written_record_is_read_again(tmp_path):
    one = some()
    two = read_record(write_record(one, tmp_path / "a.csv"))
    np.testing.assert_array_equal(one.time, two.time)
    np.testing.assert_array_equal(one.outputs["q"], two.outputs["q"])
    np.testing.assert_array_equal(one.inputs["f"], two.inputs["f"])
    for name in ("name", "role", "input_mode", "sensors", "input_sigma", "conditions", "repeats"):
        assert getattr(one, name) == getattr(two, name)
    assert dict(two.start.mean) == {"x": 1.0}


def test_a_record_in_other_units_than_si_is_read_again(tmp_path):
    """Values, and the noise that is stated in the same unit."""
    time = np.arange(10) * 0.1
    one = Record(
        name="tank",
        time=time,
        inputs={"valve": 40.0 + time, "pump": 0.1 * time},
        outputs={"level": 3.0 * time, "T": 20.0 + time},
        input_units={"valve": "%", "pump": "1"},
        input_sigma={"valve": 0.5},
        sensors={
            "level": Sensor(name="level", unit="mm", sigma=0.1),
            "T": Sensor(name="T", unit="degC", sigma=0.2),
        },
    )
    two = read_record(write_record(one, tmp_path / "a.csv"))
    for name in ("input_units", "input_sigma", "sensors"):
        assert getattr(one, name) == getattr(two, name)
    for name in ("inputs", "outputs"):
        for channel, values in getattr(one, name).items():
            assert getattr(two, name)[channel] == pytest.approx(values)


def test_a_record_knows_its_whole_and_what_was_before():
    one = some()
    for name, whole in (
        ("run [1]", "run [1]"),
        ("run [1][2/3]", "run [1]"),
        ("run[1/2][3/4]", "run"),
        ("run[held-out]", "run"),
    ):
        assert replace(one, name=name).whole == whole
    late = one.cut(5, 15)
    assert late.excitation != replace(late, before=None).excitation
    assert late.excitation != replace(late, input_mode="motion").excitation
    long = late.stretched(60.0)
    assert long.before.time == pytest.approx(60.0 * late.before.time)
    assert long.time == pytest.approx(60.0 * late.time)


def test_an_output_becomes_an_input():
    time = np.arange(200) * 1e-3
    read = 0.5 + 2.0 * np.sin(20.0 * (time - 0.01))
    sensor = Sensor(name="f", unit="N", sigma=0.3, colored_sigma=0.4, correlation_time=5e-3,
                    quantum=0.12, delay=0.01, gain=2.0, offset=0.5, offset_sd=0.1)  # fmt: skip
    whole = Record(
        name="run",
        time=time,
        inputs={},
        outputs={"f": read, "y": time},
        sensors={"f": sensor},
        notes=("made here",),
    )
    for one in (whole, whole.cut(50, 150)):
        made = one.with_output_as_input("f", "force", mode="motion")
        inner = made.time < made.time[-1] - 0.01
        np.testing.assert_allclose(made.inputs["force"][inner], np.sin(20.0 * made.time[inner]),
                                   atol=1e-3)  # fmt: skip
        assert list(made.outputs) == ["y"]
        assert (made.input_mode, made.input_units) == ("motion", {"force": "N"})
        assert made.input_sigma["force"] == pytest.approx(np.hypot(0.5, 0.12 / np.sqrt(12.0)) / 2)
        assert made.input_correlation_time == {"force": 5e-3}
        assert made.notes[0] == "made here"
        assert "offset_sd of f has no influence" in made.notes[1]
        twice = one.with_columns_as_inputs({"force": "f", "copy": "f"}, "motion")
        assert np.array_equal(twice.inputs["copy"], made.inputs["force"])
        assert twice.input_sigma["copy"] == twice.input_sigma["force"] == made.input_sigma["force"]
        assert twice.notes == made.notes
    assert np.array_equal(twice.before.inputs["copy"], made.before.inputs["force"])
    assert made.before.inputs["force"][:40] == pytest.approx(np.sin(20.0 * time[:40]), abs=1e-3)
    holes = replace(whole, outputs={**whole.outputs, "f": np.where(time < 0.01, np.nan, read)})
    late = holes.cut(50, 150).with_output_as_input("f", "force")
    assert late.before is None
    assert "f is missing in them" in late.notes[-1]
    with pytest.raises(DataError, match="input force has no number"):
        holes.with_output_as_input("f", "force")
    steps = replace(holes, sensors={"f": Sensor(name="f", quantum=0.12)})
    with pytest.raises(DataError, match="input force has no number"):  # its noise is estimated
        steps.with_output_as_input("f", "force")
    with pytest.raises(InvalidParameter, match="no channel 'g'"):
        whole.with_output_as_input("g", "force")
    with pytest.raises(InvalidParameter, match="input y exists already"):
        whole.with_output_as_input("f", "y")


def test_inputs_that_exchange_their_names_keep_their_noise():
    time = np.arange(100) * 1e-3
    one = Record(name="run", time=time, inputs={"a": time, "b": 2.0 * time}, outputs={"y": time},
                 input_units={"a": "N"}, input_sigma={"a": 0.1})  # fmt: skip
    for record in (one, one.cut(50, 100)):
        found = record.with_columns_as_inputs({"a": "b", "b": "a"})
        for part, of in ((found, record), (found.before, record.before)):
            if of is None:
                continue
            assert np.array_equal(part.inputs["a"], of.inputs["b"])
            assert np.array_equal(part.inputs["b"], of.inputs["a"])
            assert (part.input_units, part.input_sigma) == ({"b": "N"}, {"b": 0.1})


def test_units_of_the_header_become_si(tmp_path):
    (tmp_path / "a.csv").write_text("t [ms],key [mm],f [N]\n0,1,2\n1,2,3\n2,,4\n")
    (tmp_path / "a.toml").write_text("[inputs.force]\ncolumn = 'f'\n[outputs.key]\n")
    one = read_record(tmp_path / "a.csv")
    np.testing.assert_allclose(one.time, [0.0, 1e-3, 2e-3])
    np.testing.assert_allclose(one.outputs["key"], [1e-3, 2e-3, np.nan])
    assert one.sensors["key"].unit == "m"
    np.testing.assert_allclose(one.inputs["force"], [2, 3, 4])


def test_units_in_the_names_of_arrays(tmp_path):
    from scipy.io import savemat

    time = np.arange(30.0)
    savemat(tmp_path / "a.mat", {"t_ms": time, "x_mm": 2.0 * time, "force_N": time, "gain_2": time})
    for column in ("x", "x_mm"):
        which = ReadOptions(columns={"q": column})
        one = read_record(tmp_path / "a.mat", outputs=["q"], options=which)
        assert one.time == pytest.approx(1e-3 * time)
        assert one.outputs["q"] == pytest.approx(2e-3 * time)
    assert set(read_record(tmp_path / "a.mat").outputs) == {"x", "gain_2"}


def test_mat_and_netcdf_hold_the_same(tmp_path):
    import h5py
    from scipy.io import savemat

    time, q = np.arange(20) * 0.1, np.arange(20) ** 2.0
    savemat(tmp_path / "a.mat", {"t": time[:, None], "q": q[:, None], "kp": 3.0})
    with h5py.File(tmp_path / "b.nc", "w") as file:
        file["time"] = time
        file["q"] = q
        file["q"].attrs["units"] = "mm"
    for name in "ab":
        (tmp_path / f"{name}.toml").write_text("[outputs.q]\n")
    a, b = read_records([tmp_path / "a.mat", tmp_path / "b.nc"])
    np.testing.assert_allclose(a.outputs["q"], q)
    np.testing.assert_allclose(b.outputs["q"], 1e-3 * q)
    np.testing.assert_allclose(a.time, b.time)


@pytest.mark.parametrize(
    ("text", "sheet", "said"),
    [
        (
            "t,q\n0,1\n1,2\n2,3\n",
            "[outputs.z]\n",
            "no column 'z' (--column z=COLUMN says which it is, in Python columns of "
            "ReadOptions); there are t, q",
        ),
        ("t,q\n0,1\n1,x\n2,3\n", "[outputs.q]\n", "line 3: q = 'x', expected a number"),
        (
            "t,q\n0,1\n1,2\n1,3\n",
            "[outputs.q]\n",
            "line 4: time does not increase, from 1 s to 1 s",
        ),
        ("t,q\n0,1\n1,2\n2,3\n", "[outputs.q]\nsigme = 1\n", "did you mean 'sigma'"),
        ("t,q\n0,1\n1,2\n2,3\n", "[outputs.q]\nsigma = -1.0\n", "expected a finite number > 0"),
        (
            "t,q,u\n0,1,1\n1,2,\n2,3,1\n",
            "[inputs.u]\n[outputs.q]\n",
            "u has no number at 1 s",
        ),
        ("t,q\n0,1\n1,2\n2,3\n", "name = 'x'\n", "no table [outputs.NAME]"),
    ],
)
def test_faults_of_files(tmp_path, text, sheet, said):
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "a.toml").write_text(sheet)
    with pytest.raises(DataError) as error:
        read_record(tmp_path / "a.csv")
    assert said in str(error.value)


def test_all_files_are_named_at_once(tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.csv").write_text("t,q\n0,1\n1,2\n2,3\n")
        (tmp_path / f"{name}.toml").write_text("[outputs.z]\n")
    with pytest.raises(DataError) as error:
        read_records([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert "a.csv" in str(error.value)
    assert "b.csv" in str(error.value)


def test_noise_is_found_where_it_is_not_told():
    generator = np.random.default_rng(0)
    time = np.arange(2000) * 1e-3
    clean = np.sin(12.0 * time)
    q = clean + 0.01 * generator.standard_normal(2000)
    record = Record(name="r", time=time, inputs={"f": clean}, outputs={"q": q})
    assert noise_of_channel(record, "q").sigma == pytest.approx(0.01, rel=0.1)
    # A motion over few steps of a grid has the rounding error as noise.
    grid = replace(record, outputs={"q": 0.05 * np.round(clean / 0.05)})
    assert noise_of_channel(grid, "q").sigma == pytest.approx(0.05 / np.sqrt(12.0), rel=0.01)


def test_the_checks_see_clocks_and_saturation():
    time = np.arange(300) * 0.01
    signal = np.clip(np.sin(3.0 * time), -0.5, 0.5)
    record = Record(name="a", time=time, inputs={}, outputs={"q": signal})
    assert any("saturated" in n for n in check_records([record]))
    with pytest.raises(DataError, match="the clock jumps by 5"):
        check_records([replace(record, time=np.where(time > 1.0, time + 5.0, time))])
    for late, jumps in ((0.17, False), (0.22, True)):  # 18 and 23 steps
        delayed = replace(record, time=np.where(time > 1.0, time + late, time))
        if jumps:
            with pytest.raises(DataError, match="the clock jumps"):
                check_records([delayed])
        else:
            check_records([delayed])
    slower = np.cumsum(np.where(np.arange(300) < 200, 0.01, 0.6))  # 1 Hz in a pulse, slow in a rest
    assert any(
        "uneven clock, 100 steps" in n for n in check_records([replace(record, time=slower)])
    )
    lost = replace(record, time=np.delete(time, [7]), outputs={"q": np.delete(signal, [7])})
    assert any("uneven clock, 1 steps" in n for n in check_records([lost]))


def wave(**change):
    """Notes about a wave of 400 samples with other values at some of them."""
    time = np.arange(400) * 0.01
    q = np.sin(3.0 * time) + 1e-3 * np.random.default_rng(1).standard_normal(400)
    for at, value in change.items():
        q[int(at.strip("_")) :: 400 if at.endswith("_") else 100] = value
    return check_records([Record(name="a", time=time, inputs={}, outputs={"q": q})])


def test_codes_for_missing_values_are_told_or_refused():
    for code in (-9999.0, 99999.0, 1e20):
        with pytest.raises(DataError, match=r"4 values of .*--missing NUMBER"):
            wave(_5=code)
    (note,) = wave(_5=-999.0)  # a measurement could be meant
    assert "4 values of -999" in note
    assert wave(_30=0.2) == ["a.q: 4 single values are far from the samples before and after; if "
                            "they are faults of the sensor, leave these cells empty in the file "
                            "(in Python NaN)"]  # fmt: skip
    assert wave() == []


def test_steps_and_beginnings_of_vibrations_are_no_spikes():
    time = np.arange(400) * 0.01
    noise = 1e-3 * np.random.default_rng(1).standard_normal(400)
    step = np.where(time > 2.0, 1.0, 0.0) + noise
    ring = np.where(time > 2.0, np.exp(2.0 - time) * np.sin(150.0 * (time - 2.0)), 0.0) + noise
    for q in (step, ring):
        assert check_records([Record(name="a", time=time, inputs={}, outputs={"q": q})]) == []


def test_a_sample_within_the_scatter_of_the_record_is_no_spike():
    """Beside samples that happen to be equal, too."""
    noise = np.random.default_rng(1).standard_normal(400)
    noise[195:206] = 0.0
    for size, found in ((5.0, 0), (50.0, 1)):
        noise[200] = size
        assert _spikes(noise).sum() == found


def test_a_unit_that_does_not_exist_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time [s],f [N],q [furlong]\n0,1,2\n0.1,1,2\n0.2,1,2\n")
    path.with_suffix(".toml").write_text("[inputs.f]\n[outputs.q]\n")
    with pytest.raises(DataError, match=r"unit 'furlong' is unknown; give its si and factor"):
        read_record(path)


def test_a_file_that_is_not_there_is_told_before_its_sheet(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_record(tmp_path / "nothing.csv")


# ---------------------------------------------------------------- damaged and odd files


def netcdf(folder, **columns):
    import h5py

    with h5py.File(folder / "a.nc", "w") as file:
        for name, values in columns.items():
            file[name] = values
            file[name].attrs["units"] = "s" if name == "time" else "m"
    (folder / "a.toml").write_text("[outputs.q]\n")
    return folder / "a.nc"


def test_a_heap_whose_lengths_are_damaged_does_not_hang(tmp_path):
    """HDF5 2.0 goes round for ever on such a file: the texts of its attributes lie in a heap."""
    path = netcdf(tmp_path, time=np.arange(9.0), q=np.arange(9.0))
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL")
    for first in (16, 40):  # the length of an object, and the room after the last
        broken = data.copy()
        broken[heap + first + 8 : heap + first + 16] = (2**64 - 16).to_bytes(8, "little")
        path.write_bytes(broken)
        with pytest.raises(DataError, match="cannot be read as NetCDF 4: global heap at byte"):
            read_record(path)


@pytest.mark.parametrize(
    ("attribute", "value", "said"),
    [
        ("scale_factor", "x", r"q: scale_factor = 'x', expected a number"),
        ("add_offset", [1.0, 2.0], r"q: add_offset = .*, expected a number"),
        ("_FillValue", [], r"q: _FillValue = .*, expected a number"),
        ("scale_factor", 1e308, "output q holds an infinite number"),
    ],
)
def test_odd_attributes_of_netcdf(tmp_path, attribute, value, said):
    import h5py

    path = netcdf(tmp_path, time=np.arange(9.0), q=np.arange(9.0))
    with h5py.File(path, "r+") as file:
        file["q"].attrs[attribute] = value
    with pytest.raises(DataError, match=said):
        read_record(path)


def test_fill_values_of_floats_are_missing_too(tmp_path):
    import h5py

    q = np.array([0.0, 9.96921e36, 2.0, -9.0])
    path = netcdf(tmp_path, time=np.arange(4.0), q=q)
    with h5py.File(path, "r+") as file:
        file["q"].attrs.update(_FillValue=9.96921e36, missing_value=-9.0)
    np.testing.assert_array_equal(read_record(path).outputs["q"], [0.0, np.nan, 2.0, np.nan])


def test_a_matrix_beside_the_series_does_not_hide_them(tmp_path):
    from scipy.io import savemat

    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    series = {"t": np.arange(20.0), "q": np.arange(20.0) ** 2}
    savemat(tmp_path / "a.mat", {**series, "image": np.zeros((20, 20)), "text": "x"})
    np.testing.assert_array_equal(read_record(tmp_path / "a.mat").outputs["q"], series["q"])
    (tmp_path / "a.toml").write_text("[outputs.image]\n")
    with pytest.raises(DataError, match=r"no column 'image' .* left out: image \(20 x 20\)"):
        read_record(tmp_path / "a.mat")


def test_damaged_mat_files_give_one_message(tmp_path):
    from scipy.io import savemat

    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    savemat(tmp_path / "a.mat", {"t": np.arange(20.0), "q": np.arange(20.0)}, do_compression=True)
    data = bytearray((tmp_path / "a.mat").read_bytes())
    data[150] ^= 255
    for text in (data, data[:140], b"MATLAB 7.3" + bytes(502) + b"\x89HDF\r\n\x1a\n"):
        (tmp_path / "a.mat").write_bytes(text)
        with pytest.raises(DataError, match="cannot be read as MAT"):
            read_record(tmp_path / "a.mat")


def test_a_size_beyond_reason_is_refused_before_it_is_read(tmp_path):
    import h5py

    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    with h5py.File(tmp_path / "a.nc", "w") as file:
        for name in ("time", "q"):
            file.create_dataset(name, (10**12,), "f8", chunks=True)
    with pytest.raises(DataError, match="the limit of a measured file is 20000000 numbers"):
        read_record(tmp_path / "a.nc")


def test_links_out_of_a_file_are_not_followed(tmp_path):
    import h5py

    other = netcdf(tmp_path, time=np.arange(9.0), q=np.arange(9.0)).rename(tmp_path / "b.nc")
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.arange(9.0)
        file["q"] = h5py.ExternalLink(str(other), "q")
    with pytest.raises(DataError, match="no column 'q'"):
        read_record(tmp_path / "a.nc")


def test_all_faults_of_columns_and_sensors_come_together(tmp_path):
    (tmp_path / "a.csv").write_text("t,q\n0,1\n1,2\n2,3\n")
    (tmp_path / "a.toml").write_text("[outputs.z]\n[outputs.q]\nsigma = -1.0\ngain = 0.0\n")
    with pytest.raises(DataError) as error:
        read_record(tmp_path / "a.csv")
    assert "2 faults" in str(error.value)
    assert "no column 'z'" in str(error.value)
    assert "gain = 0.0" in str(error.value)


def test_numbers_that_no_instrument_gives_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("t,q\n0,1\n1,1e200\n2,3\n")
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    with pytest.raises(DataError, match=r"output q holds a number beyond 1e\+100"):
        read_record(tmp_path / "a.csv")
    with pytest.raises(DataError, match=r"y: sd = -1.0, expected >= 0"):
        StartPrior(mean={"x": 0.0}, sd={"y": -1.0})


# ---------------------------------------------------------------- records against a model


def test_units_of_records_are_compared_with_those_of_the_model(tmp_path):
    record = models.records(4)[0]
    path = write_record(record, tmp_path / "a.csv")
    text = path.read_text().splitlines()
    path.write_text("\n".join(["time [s],f [N],q [N]", *text[1:]]) + "\n")
    wrong = read_record(path)
    model = models.NOMINAL
    assert dict(model.units) == {"q": "m"}
    said = "q is in N, in the model oscillator in m"
    for work in (
        lambda: diagnose(model, models.EFFECTS, [wrong]),
        lambda: fit_model(model, [wrong]),
    ):
        with pytest.raises(DataError, match=said):
            work()
    assert wrong.input_units == {"f": "N"}
    path.write_text("\n".join(["time [s],f [mm],q [mm]", *text[1:]]) + "\n")
    right = read_record(path)  # another unit of the same quantity is converted
    assert right.input_units == {"f": "m"}
    assert right.sensors["q"].unit == "m"


@pytest.mark.parametrize("unit", ["(g)", "[G]"])
def test_an_accelerometer_in_g_is_one_of_gravity(unit, tmp_path):
    """The model says that the signal is an acceleration; elsewhere g is a gram."""
    rows = "".join(f"{0.01 * k},{k}\n" for k in range(20))
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],a {unit}\n{rows}")
    record = read_record(path, inputs=[], outputs=["a"], units={"a": "m/s^2"})
    assert record.outputs["a"][1] == pytest.approx(9.80665)
    assert record.sensors["a"].unit == "m/s^2"
    assert any("an accelerometer in g; 1 g is 9.80665 m/s^2" in n for n in record.notes)
    assert convert(2.0, "gn", "mm/s^2") == pytest.approx(19613.3)


@pytest.mark.parametrize(("unit", "newton"), [("(g)", 9.80665e-3), ("[kg]", 9.80665)])
def test_a_force_in_grams_is_a_weight(unit, newton, tmp_path):
    hint = "a force in grams has the unit gf (kilograms: kgf, pounds: lbf)"
    path = tmp_path / "a.csv"
    rows = "".join(f"{0.01 * k},{k},{k}\n" for k in range(20))
    path.write_text(f"time [s],f {unit},q [m]\n{rows}")
    model = copy.copy(models.NOMINAL)
    model.units = {"f": "N", "q": "m"}
    # A reader that does not know the model keeps a mass, and the model refuses it.
    path.with_suffix(".toml").write_text("inputs.f = {}\noutputs.q = {}\n")
    record = read_record(path)
    with pytest.raises(
        DataError, match=f"f is in kg, in the model oscillator in N; {re.escape('hint: ' + hint)}"
    ):
        check_records([record], model)
    path.with_suffix(".toml").write_text('inputs.f.si = "N"\noutputs.q = {}\n')
    right = read_record(path)
    check_records([right], model)
    assert right.inputs["f"][1] == pytest.approx(newton)
    assert any("a scale in g or kg shows a force" in n for n in right.notes)
    path.with_suffix(".toml").unlink()
    known = read_record(path, inputs=["f"], outputs=["q"], units=model.units)
    assert known.inputs["f"][1] == pytest.approx(newton)


def test_six_samples_are_enough_for_one_parameter():
    """First-order decay from published samples: dCa/dt = -k Ca, least squares give k = 2.589."""
    model = Equations(
        name="first-order decay",
        states=[State(name="Ca", unit="mol/l", scale=1.0, start=2.0081, start_sd=0.0)],
        parameters=[Parameter(name="k", value=1.3, unit="1/s", lower=0.0)],
        inputs=[],
        rates=lambda _t, x, _u, p: (-p.k * x.Ca,),
        outputs={"Ca": "Ca"},
    )
    record = Record(
        name="decay", time=[0.0, 0.1, 0.2, 0.4, 0.8, 1.0], inputs={},
        outputs={"Ca": [2.0081, 1.5512, 1.1903, 0.7160, 0.2562, 0.1495]},
        sensors={"Ca": Sensor(name="Ca", unit="mol/l", sigma=0.01)},
    )  # fmt: skip
    (k,) = fit_model(model, [record]).parameters
    assert k.value == pytest.approx(2.589, abs=0.01)
    assert k.low < 2.589 < k.high
    assert k.high - k.low < 0.2


MODES = {"force": ("force",), "motion": ("displacement",)}


@pytest.mark.parametrize(
    ("head", "mode", "driven"),
    [("t,force,a,extra", "force", "force"), ("t,displacement,a,extra", "motion", "displacement"),
     ("t,a,force,displacement", "force", "force")],
)  # fmt: skip
def test_without_a_sheet_the_names_of_the_model_are_read(tmp_path, head, mode, driven):
    (tmp_path / "a.csv").write_text(head + "\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    record = read_record(tmp_path / "a.csv", outputs=("a", "b"), modes=MODES)
    assert record.input_mode == mode
    assert list(record.inputs) == [driven]
    assert list(record.outputs) == ["a"]  # b was not measured


def test_without_a_sheet_something_must_be_there(tmp_path):
    (tmp_path / "a.csv").write_text("t,f\n0,1\n1,2\n2,3\n")
    with pytest.raises(DataError) as error:
        read_record(tmp_path / "a.csv", outputs=("a", "b"), modes=MODES)
    for fault in ("no column force or displacement for the input", "none of the outputs a, b"):
        assert fault in str(error.value)


def test_without_a_sheet_the_header_says_the_units(tmp_path):
    (tmp_path / "a.csv").write_text("t,force [N],a\n0,1,2\n1,2,3\n2,3,4\n")
    with pytest.raises(DataError, match=r"column a has no unit in the header, .* \[m\]"):
        read_record(tmp_path / "a.csv", outputs=("a",), modes=MODES, units={"a": "m", "force": "N"})


def test_a_fault_of_several_files_is_told_once(tmp_path):
    paths = [tmp_path / name for name in ("a.csv", "b.csv")]
    for path in paths:
        path.write_text("t,a\n0,1\n1,2\n2,3\n")
    with pytest.raises(DataError) as error:
        read_records(paths, outputs=("a",), units={"a": "m"})
    assert str(error.value).startswith(f"{paths[0]}, {paths[1]}: 1 fault")
    assert str(error.value).count("has no unit in the header") == 1


def moving(name, seed):
    y = np.random.default_rng(seed).standard_normal(60)
    return Record(
        name=name,
        time=np.arange(60) * 0.01,
        inputs={"u": np.zeros(60)},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=1.0)},
    )


def test_a_copy_of_a_record_is_refused():
    """It would prove what it was fitted to."""
    with pytest.raises(DataError, match="c holds the same numbers as a"):
        check_records([moving("a", 1), moving("b", 2), moving("c", 1)])
    with pytest.raises(DataError, match="the name a is used twice"):
        check_records([moving("a", 1), moving("a", 2)])
    other = replace(moving("b", 1), inputs={"u": np.full(60, 2.0)})
    still = [replace(moving(n, 1), outputs={"y": np.zeros(60)}) for n in "ab"]
    few = [moving(n, 1).cut(0, 5) for n in "ab"]
    for records in ([moving("a", 1), moving("b", 2)], [moving("a", 1), other], still, few):
        check_records(records)


def test_a_column_without_a_unit_is_told(tmp_path):
    (tmp_path / "a.csv").write_text("t [s],y,u [N]\n0,1,2\n1,2,3\n2,3,4\n")
    record = read_record(tmp_path / "a.csv", inputs=["u"], outputs=["y"])
    (note,) = record.notes
    assert note.startswith("y: no unit")
    told = ReadOptions(units={"y": "mm"})
    assert read_record(tmp_path / "a.csv", inputs=["u"], outputs=["y"], options=told).notes == ()


def test_a_unit_that_the_model_knows_is_asked_for_whatever_the_model_is(tmp_path):
    """A model in Python took such columns in SI without a word, a mechanism refused them."""
    (tmp_path / "a.csv").write_text("t [s],y,u [N]\n0,1,2\n1,2,3\n2,3,4\n")
    model = Simulator(
        lambda time, inputs, parameters: {"y": inputs["u"]},
        parameters=[],
        inputs=["u"],
        outputs={"y": "m"},
    )
    adapter = LoadedModel(model, ())
    with pytest.raises(DataError, match=r"column y has no unit.*--unit y=m"):
        adapter.read([tmp_path / "a.csv"])
    (record,) = adapter.read([tmp_path / "a.csv"], ReadOptions(units={"y": "mm"}))
    assert record.outputs["y"][0] == pytest.approx(1e-3)


def test_channels_that_never_change():
    """Their noise is not known, unless it is stated or another record shows it."""
    time = 4e-3 * np.arange(200)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(200)
    flat = Record(name="flat", time=time, inputs={"f": 0.0 * time}, outputs={"q": 0.0 * time})
    moved = replace(flat, name="moved", outputs={"q": np.sin(20.0 * time) + noise})
    assert [r.name for r in ready_records(models.NOMINAL, [flat, moved]).records] == [
        "flat", "moved",
    ]  # fmt: skip
    with pytest.raises(DataError, match="record flat: q: never changes"):
        ready_records(models.NOMINAL, [flat])
    stated = replace(flat, sensors={"q": Sensor(name="q", unit="m", sigma=1e-4)})
    assert list(ready_records(models.NOMINAL, [stated]).records[0].outputs) == ["q"]
    assert noise_of_channel(flat, "q", 1e-3).sigma == 1e-3
    assert noise_of_channel(stated, "q", 1e-3).sigma == 1e-4


def test_a_part_of_a_record_knows_what_came_before():
    time = 0.01 * np.arange(60)
    whole = Record(name="r", time=time, inputs={"u": np.sin(time)}, outputs={"y": time})

    def late(record):
        return {"u": np.interp(record.time - 0.035, record.time, record.inputs["u"])}

    expected = whole.with_changed_inputs(late).inputs["u"]
    for part in (whole.cut(20, 50), whole.cut(18, 55).cut(2, 32)):
        moved = part.with_changed_inputs(late)
        twice = moved.with_changed_inputs(lambda r: {"u": 2.0 * r.inputs["u"]})
        assert twice.inputs["u"] == pytest.approx(2.0 * expected[20:50], abs=1e-15)
        assert np.array_equal(twice.outputs["y"], time[20:50])
    assert whole.cut(0, 30).before is None
    part = whole.cut(20, 50).cut(1, 30)
    assert np.array_equal(part.before.time, time[:21])
    # A reading that is late is converted with the samples of the whole run.
    sensed = whole.with_sensed_input("u", delay=-0.035).inputs["u"]
    assert part.with_sensed_input("u", delay=-0.035).inputs["u"] == pytest.approx(sensed[21:50])


def test_faults_of_the_samples_before_a_record():
    time = 0.01 * np.arange(60)
    whole = Record(name="r", time=time, inputs={"u": time}, outputs={"y": time})
    part = whole.cut(20, 50)
    with pytest.raises(DataError, match=r"ends at 0\.19 s, expected before -0\.8 s"):
        replace(part, time=part.time - 1.0)
    with pytest.raises(DataError, match="the record before it has no input v"):
        replace(part, inputs={"u": part.time, "v": part.time})
    with pytest.raises(DataError, match="the record before it has an earlier one"):
        replace(whole.cut(40, 50), before=part)
    # A further output was not measured before.
    more = replace(part, outputs={"z": part.time}, sensors={})
    assert more.with_changed_inputs(lambda r: {"u": r.time}).inputs["u"] == pytest.approx(
        time[20:50]
    )


def test_a_record_in_motion_is_written_and_read(tmp_path):
    time = 0.01 * np.arange(60)
    whole = Record(name="r", time=time, inputs={"u": time}, outputs={"y": time})
    write_record(whole.cut(20, 50), tmp_path / "part.csv")
    start = read_record(tmp_path / "part.csv").start
    assert start is not None
    assert not start.known


def test_a_slow_clock_is_named_though_it_shows_times_after_the_end():
    """A clock that is 2 % slow: the record lasts 2 % longer than its clock says."""
    time, rate = np.arange(0.0, 6.0, 0.02), 1.02
    model = Equations(
        name="pendulum",
        states=[
            State(name="q", unit="rad", scale=0.5, start=0.5, start_sd=0.5),
            State(name="v", unit="rad/s", scale=1.0, start_sd=0.5),
        ],
        parameters=[Parameter(name="b", value=0.05, sd=0.05, unit="1/s", lower=0.0)],
        rates=lambda _t, x, _u, p: (x.v, -9.81 * np.sin(x.q) - p.b * x.v),
        outputs={"q": "q"},
    )
    effect = library.clock_rate()
    generator = np.random.default_rng(3)
    records = []
    for k, start in enumerate((0.4, 0.6, 0.8)):
        true = solve_ivp(
            lambda _t, x: (x[1], -9.81 * np.sin(x[0]) - 0.05 * x[1]),
            (0.0, 6.2), (start, 0.0), t_eval=rate * time, rtol=1e-10, atol=1e-12,
        ).y[0]  # fmt: skip
        records.append(
            Record(
                name=f"swing {k}",
                time=time,
                inputs={},
                outputs={"q": true + 1e-3 * generator.standard_normal(time.size)},
                sensors={"q": Sensor(name="q", unit="rad", sigma=1e-3)},
            )
        )
    result = diagnose(model, [effect], records)
    assert [n.cause for n in result.named] == ["clock of the sensors"]
    assert result.named[0].magnitude == pytest.approx(0.02, abs=2e-4)
    assert max(c.explained / c.noise for c in result.channels) < 1.05


@pytest.mark.parametrize(("samples", "blocks"), [(100, 5), (99, 2)])
def test_every_second_block_of_a_record_is_held_out(samples, blocks):
    time = 0.01 * np.arange(samples)
    record = Record(name="run", time=time, inputs={}, outputs={"q": np.sin(time)})
    fitted, held = (np.isfinite(_blocks(record, odd).outputs["q"]) for odd in (0, 1))
    assert np.array_equal(fitted, ~held)
    assert fitted[0]
    assert np.count_nonzero(np.diff(fitted)) == blocks - 1
    assert [_blocks(record, odd).role for odd in (0, 1)] == ["fit", "held_out"]
