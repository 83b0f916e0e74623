"""HDF5 and MAT files that lead elsewhere or unpack to more than they say."""

import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from calls import refused

import feltmb
from unmodeled.data import read_record
from unmodeled.files import hdf5

DATA = Path(__file__).parents[2] / "data"


def elsewhere(tmp_path, count):
    """A file of someone else, as raw numbers and as HDF5."""
    (tmp_path / "secret.bin").write_bytes(np.full(count, 42.0).tobytes())
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = np.full(count, 42.0)


def external_link(file, name, _count, folder):
    file[name] = h5py.ExternalLink(str(folder / "secret.h5"), "x")


def external_storage(file, name, count, folder):
    file.create_dataset(name, (count,), "f8", external=[(str(folder / "secret.bin"), 0, 8 * count)])


def virtual_dataset(file, name, count, folder):
    layout = h5py.VirtualLayout((count,), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "secret.h5"), "x", (count,))
    file.create_virtual_dataset(name, layout)


def soft_link(file, name, count, folder):
    external_link(file, "door", count, folder)
    file[name] = h5py.SoftLink("/door")


def group(file, name, _count, _folder):
    file.create_group(name)


def reference(file, name, count, _folder):
    file.create_dataset(name, (count,), h5py.ref_dtype)


WAYS_OUT = [external_link, external_storage, virtual_dataset, soft_link, group, reference]


@pytest.mark.parametrize("way", WAYS_OUT)
def test_a_saved_run_reads_no_other_file(run_file, tmp_path, way):
    # validated "ok", and showed the numbers of the other file
    with h5py.File(run_file, "a") as file:
        name = next(n for n in file if n.endswith(".angle"))
        count = file[name].size
        elsewhere(tmp_path, count)
        del file[name]
        way(file, name, count, tmp_path)
    refused(lambda: feltmb.load_run(run_file), "is no complete run")


@pytest.mark.parametrize("way", WAYS_OUT)
def test_a_record_reads_no_other_file(tmp_path, way):
    elsewhere(tmp_path, 9)
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.arange(9.0)
        way(file, "q", 9, tmp_path)
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    refused(lambda: read_record(tmp_path / "a.nc"), "no column 'q'", "left out: ", "q (")


def test_attributes_that_are_references_are_no_text(run_file):
    with h5py.File(run_file, "a") as file:
        name = next(n for n in file if n.endswith(".angle"))
        file[name].attrs["units"] = file[name].ref
        file.attrs["message"] = file[name].regionref[:]
    refused(lambda: feltmb.load_run(run_file), "'message' is missing")


def test_there_is_one_reader_of_hdf5():
    users = [
        str(p.relative_to(DATA.parents[1]))
        for p in sorted(Path(feltmb.__file__).parent.rglob("*.py"))
        if "h5py" in p.read_text() and p.name not in ("hdf5.py", "netcdf.py")
    ]
    assert not users


def test_a_chunk_larger_than_the_limit_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.arange(10.0)
        q = file.create_dataset(
            "q", (10,), "f8", chunks=(30_000_000,), maxshape=(None,), compression="gzip"
        )
        q.id.write_direct_chunk((0,), zlib.compress(bytes(80)))
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    refused(lambda: read_record(tmp_path / "a.nc"), "claims more than")


def test_a_mat_file_that_unpacks_to_more_than_it_says(tmp_path):
    packed = zlib.compress(bytes(200_000_000), 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    body = np.array([15, len(packed)], "<u4").tobytes() + packed
    (tmp_path / "a.mat").write_bytes(head + body)
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    refused(lambda: read_record(tmp_path / "a.mat"), "cannot be read as MAT: unpacks to more than")


@pytest.mark.parametrize(("at", "value"), [(8, 0), (8, 2**63), (24, 2**63), (40, 4096)])
def test_a_damaged_text_is_one_message(tmp_path, at, value):
    # HDF5 2.0 finds damaged lengths in the heap of the texts itself
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.arange(10.0)
        file["time"].attrs["units"] = "s"
        file["q"] = np.arange(10.0)
        file["q"].attrs["units"] = "mm"
    data = bytearray((tmp_path / "a.nc").read_bytes())
    at += data.index(b"GCOL\x01\x00\x00\x00")
    data[at : at + 8] = value.to_bytes(8, "little")
    (tmp_path / "a.nc").write_bytes(data)
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    refused(lambda: read_record(tmp_path / "a.nc"), "cannot be read as NetCDF 4: ")


def test_heaps_that_overlap_cost_no_more_than_the_file_is_long(monkeypatch):
    # every header of thousands had its own walk to the end: a minute for 1 MB
    count = 3000
    one = b"GCOL\x01\x00\x00\x00" + (0).to_bytes(8, "little")
    data = bytearray(one * count + bytes(16) * 2000)
    for i in range(count):
        at = 16 * i
        data[at + 8 : at + 16] = (len(data) - at).to_bytes(8, "little")
    steps = 0
    unpack = hdf5.struct.unpack_from

    def counted(*given):
        nonlocal steps
        steps += 1
        return unpack(*given)

    monkeypatch.setattr(hdf5.struct, "unpack_from", counted)
    with pytest.raises(ValueError, match="global heap"):
        hdf5._check_heaps(bytes(data))
    assert steps <= 2 * len(data) // 16


def folder(path):
    path.mkdir()
