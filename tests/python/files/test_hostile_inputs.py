"""Inputs that crashed, hung or filled the memory: each ends in one message."""

import json
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

import feltmb
from feltmb.data import read_record
from feltmb.errors import DataError, FeltmbError, InvalidParameter
from feltmb.files import parse_toml
from feltmb.graphics.plot.readings import run_action
from feltmb.run.reading import strike_words

PENDULUM = (Path(__file__).resolve().parents[2] / "data" / "pendulum.toml").read_text()


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


@pytest.mark.parametrize("contact", ["99", "99.0", "1e12", "3.5"])
def test_a_contact_that_does_not_exist_is_a_fault(contact):
    with pytest.raises(InvalidParameter):
        feltmb.Action(parse_toml(f"{PENDULUM}\n[events.e]\ncontact = {contact}\n"
                                 'change = "opens"\n', "a"))  # fmt: skip


def test_a_length_beyond_reason_is_refused():
    action = feltmb.Action(parse_toml(PENDULUM, "a"))
    name = next(iter(action.raw["points"]))
    with pytest.raises(InvalidParameter, match="1e\\+06 m"):
        action.with_values({f"points.{name}.point": [1e12, 0.0]})


def test_names_are_shortened():
    assert len(str(InvalidParameter("there is no " + "a" * 5000 + " here"))) < 230


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_a_pipe_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "a.csv")
    with pytest.raises(FeltmbError, match="pipe"):
        read_record(tmp_path / "a.csv")


def test_a_changed_checkpoint_is_refused(tmp_path):
    from feltmb import fiber

    box, cycle = fiber.FiberBox(n_fibers=40, n_beads=8), fiber.Cycle(0.12, 1e-3, 10, 20, 1)
    good = fiber.simulate(box, cycle, max_samples=2).save(tmp_path / "a.npz")
    whole = dict(np.load(good))
    header = json.loads(str(whole["header"]))
    for changed in (
        whole | {"state_positions": np.array(1.0)},
        whole | {"table_pressure": np.full(3, np.nan)},
        {k: v for k, v in whole.items() if k != "state_box"},
        whole | {"header": np.array(json.dumps(header | {"box": {"nope": 1}}))},
    ):
        np.savez(tmp_path / "b.npz", **changed)
        with pytest.raises(DataError):
            fiber.FiberRun.load(tmp_path / "b.npz")
    assert fiber.FiberRun.load(good).box == box


def test_a_closed_pipe_ends_a_command_quietly():
    process = subprocess.Popen(
        [sys.executable, "-m", "feltmb", "list", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(60) == 0


@pytest.mark.parametrize("options", [{"duration": 1e6}, {"tolerance": 1e-17}])
def test_a_gradient_without_end_is_refused(options):
    action = feltmb.Action(parse_toml(PENDULUM, "a"))
    with pytest.raises(InvalidParameter, match="expected at most 100 s"):
        feltmb.gradient(action, "forte", "arm.mass", ["arm.angle"], **options)


@pytest.fixture(scope="module")
def run():
    stroke = feltmb.pulse_stroke(1.0, 0.0, 0.005, 0.005, duration=0.02)
    return feltmb.simulate(feltmb.Action(parse_toml(PENDULUM, "a")), stroke, output_rate=1000.0)


@pytest.mark.parametrize("text", [
    "a" + ".a" * 200_000 + "=1",
    "contacts = 5\n[reading]\nstrike_contact = 6\n",
    "[contacts.06]\nsurfaces = 5\n[reading]\nstrike_contact = 6\n",
])  # fmt: skip
def test_a_strange_mechanism_in_a_run_is_refused_and_nothing_is_written(text, run, tmp_path):
    path = run.save(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        provenance = json.loads(file.attrs["provenance"])
        file.attrs["provenance"] = json.dumps(provenance | {"toml": text})
    strange = feltmb.load_run(path)
    assert strike_words(strange) == strike_words(strange)  # no exception
    with pytest.raises(FeltmbError):
        run_action(strange)
    assert [p.name for p in tmp_path.iterdir()] == ["a.nc"]


def test_plots_are_drawn_before_one_is_written(run, tmp_path, monkeypatch):
    from feltmb.graphics.plot import files

    def refuse(_):
        raise RuntimeError("x")

    monkeypatch.setattr(files, "PICTURES", {"motion": files.motion, "energy": refuse})
    with pytest.raises(RuntimeError):
        files.save_all(run, tmp_path / "out", "a")
    assert not (tmp_path / "out").exists()


def test_a_name_longer_than_a_file_name_can_be():
    long = "a" * 5000
    action = feltmb.Action(parse_toml(PENDULUM, "a"))
    with pytest.raises(FeltmbError):
        feltmb.felt.audit_targets(long)
    with pytest.raises(FeltmbError):
        feltmb.sweep(action, "forte", {"arm.mass": [0.1]}, folder=long)


def test_lengths_of_compression_and_rate():
    law = feltmb.contact.law("stulov", stiffness=1e8, exponent=2.5, amplitude=0.3, time=1e-3)
    with pytest.raises(InvalidParameter, match="shape"):
        law.force([1e-3, 2e-3], [0.0, 0.0, 0.0])
    assert law.force([1e-3, 2e-3], 0.0).shape == (2,)


def test_an_actuator_run_is_written_as_one_text_of_bytes(tmp_path, monkeypatch):
    from feltmb.action.actuator import ActuatorRun

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ActuatorRun, "_variables", lambda _: [])
    monkeypatch.setattr(ActuatorRun, "_attributes", lambda _: {})
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(FeltmbError, match="No space"):
        ActuatorRun.__new__(ActuatorRun).save(tmp_path / "a.nc")
    assert not list(tmp_path.iterdir())


def test_uploaded_columns_are_read_once(tmp_path):
    pytest.importorskip("starlette", reason="extra live is not installed")
    from feltmb.live.measured import Shelf

    shelf = Shelf(tmp_path)
    shelf.add("a.csv", b"time [s],q [mm]\n0,0\n1,1\n2,2\n")
    (path,) = tmp_path.rglob("a.csv")
    path.unlink()
    (columns,) = shelf.kept([]).values()
    assert list(columns.values) == ["time", "q"]
