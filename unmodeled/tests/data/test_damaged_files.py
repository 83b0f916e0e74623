"""Measured files that crashed, hung or filled the memory: each ends in one message."""

import struct
import zlib

import h5py
import numpy as np
import pytest

from unmodeled.data import read_record
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import parse_toml


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
