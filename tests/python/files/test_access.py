"""What is opened: files within their limits; no pipes, devices or folders."""

import os
import socket
from pathlib import Path

import pytest
from calls import refused
from readers import READERS

import feltmb
from feltmb.fiber import read_compression
from feltmb.run.stroke import load_stroke
from unmodeled.data import columns, read_record
from unmodeled.files import access as files
from unmodeled.files import hdf5


def fifo(path):
    os.mkfifo(path)


def listening(path):
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(path))
    server.close()


def device(path):
    path.symlink_to("/dev/zero")


def folder(path):
    path.mkdir()


@pytest.mark.parametrize("make", [fifo, listening, device, folder])
@pytest.mark.parametrize(
    ("suffix", "reader"), [(s, r) for s, readers in READERS.items() for r in readers]
)
def test_what_is_no_file_is_refused_at_once(tmp_path, monkeypatch, suffix, reader, make):
    # a pipe was waited for for ever, a device filled the memory
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    path = Path(f"given{suffix}")
    make(path)
    refused(lambda: reader(path))


def test_a_pipe_that_takes_the_place_of_a_file(tmp_path, monkeypatch):
    # between the look at the file and its opening
    path = tmp_path / "a.toml"
    os.mkfifo(path)
    monkeypatch.setattr(Path, "is_file", lambda _: True)
    refused(lambda: files.read_toml(path), "is a device or a pipe")


def test_files_of_the_system_that_state_no_size():
    if not Path("/proc/self/status").exists():
        pytest.skip("no /proc")
    refused(lambda: files.read_toml(Path("/proc/self/status")), "longer than the 0 bytes")


@pytest.mark.parametrize(
    ("reader", "suffix", "limit"),
    [
        (files.read_toml, ".toml", files.LARGEST_TOML),
        (load_stroke, ".csv", files.LARGEST_TABLE),
        (lambda p: read_compression(p, v_f0=0.1, area=1e-4), ".csv", files.LARGEST_TABLE),
        (lambda p: read_record(p, outputs=["q"]), ".csv", files.LARGEST_TABLE),
        (lambda p: read_record(p, outputs=["q"]), ".mat", columns.LARGEST_MAT),
        (feltmb.load_run, ".nc", hdf5.LARGEST_FILE),
    ],
)
def test_files_beyond_their_limit_are_not_read(tmp_path, reader, suffix, limit):
    path = tmp_path / f"a{suffix}"
    with path.open("wb") as file:
        file.truncate(limit + 1)  # takes no room on the disk
    refused(lambda: reader(path), str(limit))
