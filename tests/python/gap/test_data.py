"""Measured files: what is read, and what is said of files that cannot be used."""

import numpy as np
import pytest

from feltmb.data import Record, Sensor, StartPrior, read_record, read_records, write_record
from feltmb.errors import DataError
from feltmb.gap import check_records

SHEET = """
name = "forte"
role = "held_out"
input_mode = "motion"
[inputs.key]
sigma = "x"
"""


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


def test_units_of_the_header_become_si(tmp_path):
    (tmp_path / "a.csv").write_text("t [ms],key [mm],f [N]\n0,1,2\n1,2,3\n2,,4\n")
    (tmp_path / "a.toml").write_text("[inputs.force]\ncolumn = 'f'\n[outputs.key]\n")
    one = read_record(tmp_path / "a.csv")
    np.testing.assert_allclose(one.time, [0.0, 1e-3, 2e-3])
    np.testing.assert_allclose(one.outputs["key"], [1e-3, 2e-3, np.nan])
    assert one.sensors["key"].unit == "m"
    np.testing.assert_allclose(one.inputs["force"], [2, 3, 4])


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
        ("t,q\n0,1\n1,2\n2,3\n", "[outputs.z]\n", "no column 'z'; there are t, q"),
        ("t,q\n0,1\n1,x\n2,3\n", "[outputs.q]\n", "row 2, column q: 'x' is no number"),
        ("t,q\n0,1\n1,2\n1,3\n", "[outputs.q]\n", "time does not rise at sample 2"),
        ("t,q\n0,1\n1,2\n2,3\n", "[outputs.q]\nsigme = 1\n", "did you mean 'sigma'"),
        ("t,q\n0,1\n1,2\n2,3\n", "[outputs.q]\nsigma = -1.0\n", "expected a finite number > 0"),
        ("t,q,u\n0,1,1\n1,2,\n2,3,1\n", "[inputs.u]\n[outputs.q]\n", "input u is missing"),
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
    records = [
        Record(
            name=f"r{i}",
            time=time,
            inputs={"f": clean},
            outputs={"q": clean + 0.01 * generator.standard_normal(2000)},
            repeats="same" if i < 2 else "",
        )
        for i in range(3)
    ]
    gates = check_records(records)
    assert gates.channels[0].method == "repeats"
    assert gates.channels[2].method in ("differences", "rest", "prediction")
    for channel in gates.channels:
        assert channel.sigma == pytest.approx(0.01, rel=0.1)


def test_gates_see_clocks_and_saturation():
    time = np.arange(300) * 0.01
    jumped = np.where(time > 1.0, time + 5.0, time)
    signal = np.clip(np.sin(3.0 * time), -0.5, 0.5)
    gates = check_records([Record(name="a", time=jumped, inputs={}, outputs={"q": signal})])
    assert "the clock jumps" in gates.problems[0]
    assert any("saturated" in w for w in gates.warnings)


def test_a_unit_that_does_not_exist_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time [s],f [N],q [furlong]\n0,1,2\n0.1,1,2\n0.2,1,2\n")
    path.with_suffix(".toml").write_text("[inputs.f]\n[outputs.q]\n")
    with pytest.raises(DataError, match=r"unit 'furlong' is unknown; give its si and factor"):
        read_record(path)


def test_a_file_that_is_not_there_is_told_before_its_sheet(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_record(tmp_path / "nothing.csv")
