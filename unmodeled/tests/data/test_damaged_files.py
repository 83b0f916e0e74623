"""Measured files that crashed, hung or filled the memory: each ends in one message."""

import struct
import zlib

import h5py
import numpy as np
import pytest

from unmodeled.data import read_record
from unmodeled.data.mat import mat_variables
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import parse_toml
from unmodeled.search.records import check_records


def element(kind, body):
    return struct.pack("<II", kind, len(body)) + body + b"\0" * (-len(body) % 8)


def mat_file(kind, packed):
    """MAT 5 file with an array whose numbers have the data type ``kind``."""
    numbers = np.arange(100.0).tobytes()

    def array(name, kind):
        body = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<2i", 100, 1))
        return element(14, body + element(1, name) + element(kind, numbers))

    y = array(b"y_mm", kind)
    y = element(15, zlib.compress(y)) if packed else y
    return b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + array(b"time", 9) + y


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", [8, 10, 14, 15, 19, 100, 70000])
def test_a_mat_element_of_an_unknown_type_is_refused(kind, packed, tmp_path):
    (tmp_path / "a.mat").write_bytes(mat_file(kind, packed))
    with pytest.raises(DataError, match="data type"):
        read_record(tmp_path / "a.mat")
    (tmp_path / "a.mat").write_bytes(mat_file(9, False))
    assert read_record(tmp_path / "a.mat").samples == 100


def test_points_of_kinovea_at_different_times_are_limited(tmp_path):
    lines = [f"#p{i}\n{i} 1 2\n{i + 0.5} 2 3" for i in range(4000)]
    text = "#Kinovea Trajectory data export\n#T X Y\n" + "\n".join(lines)
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(DataError, match="4000 points at 8000 times"):
        read_record(tmp_path / "a.txt")


def test_chunks_of_a_dataset_are_limited_before_it_is_read(tmp_path):
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("time", (10**7,), "f8", chunks=(1,))[0] = 0.0
    with pytest.raises(DataError, match="10000000 chunks"):
        read_record(tmp_path / "a.nc")


def test_runs_units_and_keys_are_limited(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [s],x [mm]\n" + "\n".join(f"{i % 2},{i}" for i in range(5000)))
    with pytest.raises(DataError, match="starts 2500 times"):
        read_record(path)
    path.write_text("time [s],x [" + "m/" * 60_000 + "s]\n0,1\n1,2\n2,3\n")
    with pytest.raises(DataError) as told:
        read_record(path)
    assert len(str(told.value)) < 1000
    with pytest.raises(InvalidParameter, match="the limit is"):
        parse_toml("\n".join(f"a{i}=1" for i in range(200_000)), "a")
    with pytest.raises(InvalidParameter, match="nested too deeply"):
        parse_toml("a" + ".a" * 200_000 + "=1", "a")


def test_many_columns_with_a_likelihood_are_paired(tmp_path):
    head = ",".join(["time [s]"] + [f"p{i}_x [mm],p{i}_likelihood" for i in range(300)])
    rows = "\n".join(",".join([str(k)] + ["0.5,0.9"] * 300) for k in range(4))
    (tmp_path / "a.csv").write_text(f"{head}\n{rows}")
    assert len(read_record(tmp_path / "a.csv").outputs) == 300


@pytest.mark.parametrize("form", ["4", "5", "5 packed"])
def test_mat_variables_are_those_of_scipy(form, tmp_path):
    from scipy.io import savemat

    rng = np.random.default_rng(1)
    given = {
        "time": np.arange(50.0),
        "y": rng.standard_normal((50, 3)),
        "rows": rng.standard_normal((2, 50)),
        "small": np.arange(2),
        "single": rng.standard_normal(50).astype("f4"),
        "counts": rng.integers(-9, 9, (50, 1)).astype("i2"),
        "complex": np.arange(50) * 1j,
        "word": "text",
    }
    if form[0] == "5":
        given |= {"struct": {"a": 1.0}, "on": np.arange(50) > 9, "cell": np.array([1, "a"], object)}
    path = tmp_path / "a.mat"
    savemat(path, given, format=form[0], do_compression="packed" in form)
    found = {v.name: v for v in mat_variables(path.read_bytes())}
    assert found.keys() == given.keys()
    for name, values in given.items():
        if found[name].why:
            assert name in ("complex", "word", "struct", "cell")
        else:
            np.testing.assert_array_equal(found[name].values.ravel(), np.ravel(values))
    record = read_record(path)
    assert {"y.0", "y.2", "rows.0", "rows.1", "single", "counts"} <= record.outputs.keys()
    np.testing.assert_array_equal(record.outputs["rows.1"], given["rows"][1])
    np.testing.assert_array_equal(record.outputs["y.2"], given["y"][:, 2])


def test_a_complex_array_without_an_imaginary_part_is_left_out(tmp_path):
    """One byte of the file; it ended the process in SciPy."""
    from scipy.io import savemat

    time = np.arange(100) * 0.01
    savemat(tmp_path / "f.mat", {"time": time, "force": np.sin(time), "x": np.cos(time)})
    data = bytearray((tmp_path / "f.mat").read_bytes())
    data[128 + 17] = 0x08
    (tmp_path / "f.mat").write_bytes(data)
    with pytest.raises(DataError, match=r"time \(complex numbers\)"):
        read_record(tmp_path / "f.mat")


@pytest.mark.parametrize("count", [300, pytest.param(20_000, marks=pytest.mark.slow)])
def test_any_damage_of_a_mat_file_is_a_value_error(count, tmp_path):
    from scipy.io import savemat

    rng = np.random.default_rng(2)
    seeds = []
    for form, packed in (("4", False), ("5", False), ("5", True)):
        given = {"time": np.arange(40.0), "y": np.ones((2, 40)), "s": "text"}
        savemat(tmp_path / "a.mat", given, format=form, do_compression=packed)
        seeds.append((tmp_path / "a.mat").read_bytes())
    for k in range(count):
        data = bytearray(seeds[k % 3])
        head = 128 if k % 3 else 0
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(head, len(data))] = rng.integers(256)
        data = data[: rng.integers(head, len(data))] if k % 5 == 0 else data
        try:
            [*mat_variables(bytes(data))]
        except (ValueError, zlib.error):
            continue


def test_matrices_of_hdf5_lie_along_the_clock(tmp_path):
    values = np.arange(150.0).reshape(3, 50)
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.arange(50.0)
        file["q"] = values
        file["image"] = np.zeros((20, 20))
    record = read_record(tmp_path / "a.nc")
    assert [*record.outputs] == ["q.0", "q.1", "q.2"]
    np.testing.assert_array_equal(record.outputs["q.2"], values[2])


def test_steps_of_a_clock_with_a_date_are_exact(tmp_path):
    """Seconds since the year 0 have steps of 7.6 us as floats."""
    rows = [f"2026-11-30T12:00:00.{k:06d},{k}" for k in range(0, 1000, 7)]
    (tmp_path / "a.csv").write_text("time,x\n" + "\n".join(rows))
    time = read_record(tmp_path / "a.csv").time
    np.testing.assert_allclose(np.diff(time), 7e-6, rtol=1e-9)


def test_a_channel_of_codes_for_missing_values_alone_is_checked(tmp_path):
    rows = [f"{k},{1e30 if k < 5 else 2.5}" for k in range(40)]
    (tmp_path / "a.csv").write_text("time [s],x [m]\n" + "\n".join(rows))
    told = " ".join(check_records([read_record(tmp_path / "a.csv")]))
    assert "5 values of 1e+30" in told
