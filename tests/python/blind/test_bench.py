"""The blind bench: seal, faults, resumption, a run through the command line."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import blind.run
from blind.bench import MACHINES, Bench, _diagnose
from blind.run import command
from blind.score import read
from blind.small_machine import load_kinds
from feltmb.cli import main
from feltmb.errors import FileExists, InvalidParameter
from feltmb.files import make_folder, write_text

RUN = blind.run.__file__


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A bench of four cases with records and answers."""
    bench = Bench(tmp_path_factory.mktemp("bench") / "b")
    bench.seal(4, 11)
    bench.make_records(workers=1)
    bench.machine.make_answers(bench.folder, None, [0, 1, 2, 3])
    return bench


def test_seal_is_written_before_records_and_holds(tmp_path):
    bench = Bench(tmp_path / "b")
    seal = bench.seal(6, 5)
    assert not (tmp_path / "b" / "records").exists()
    assert bench.sealed() == seal
    with pytest.raises(FileExists, match="--resume"):
        bench.seal(6, 5)
    assert bench.seal(6, 5, resume=True) == seal
    with pytest.raises(InvalidParameter, match="seed = 5, got 6"):
        bench.seal(6, 6, resume=True)
    path = tmp_path / "b" / "truths.json"
    path.write_text(path.read_text().replace("force", "motion", 1))
    with pytest.raises(InvalidParameter, match="not what was sealed"):
        bench.sealed()


def test_records_of_another_generator_are_not_added(tmp_path, monkeypatch):
    bench = Bench(tmp_path / "b")
    bench.seal(3, 11)
    bench.machine.make_records(bench.folder, None, [0, 1])
    monkeypatch.setattr("blind.bench.digest_of", lambda *_: "0" * 64)
    with pytest.raises(InvalidParameter, match="1 cases have no records"):
        bench.make_records(workers=1)
    assert not (bench.folder / "records" / "2.npz").exists()
    bench.machine.make_records(bench.folder, None, [2])
    bench.make_records(workers=1)  # nothing is missing: a newer engine may diagnose them


def test_same_seed_same_hash(tmp_path):
    one, two = (Bench(tmp_path / k).seal(10, 5) for k in "ab")
    assert one["truths_sha256"] == two["truths_sha256"]
    assert Bench(tmp_path / "c").seal(10, 6)["truths_sha256"] != one["truths_sha256"]


def test_halves_are_disjoint_and_whole(made):
    a, b = made.numbers("development"), made.numbers("test")
    assert sorted(a + b) == made.numbers("both") == [0, 1, 2, 3]
    assert a == [0, 2]


def test_records_hold_no_truth_and_are_as_the_data_sheet_says(made):
    records = made.machine.read_records(made.folder / "records" / "0.npz")
    assert [r.role for r in records] == ["fit"] * 3 + ["held_out"] * 2
    with np.load(made.folder / "records" / "0.npz") as file:
        assert {name.split(".")[-1] for name in file} == {"mode", "key", "hammer", "finger"}
    for r in records:
        key = r.outputs["key"]
        assert np.allclose(key / 2e-5, np.round(key / 2e-5), atol=1e-6)
        noise = key[:15] - np.mean(key[:15])
        assert 1e-5 < np.std(noise) < 2e-4


def test_interrupted_records_are_the_same(made, tmp_path):
    other = Bench(tmp_path / "b")
    other.seal(4, 11)
    other.make_records("development", workers=1)
    assert not (tmp_path / "b" / "records" / "1.npz").exists()
    other.make_answers(workers=1)  # no case has a result
    assert not (tmp_path / "b" / "answers").exists()
    for n in (0, 2):
        write_text(make_folder(tmp_path / "b" / "results") / f"{n}.json", "{}")
    other.make_answers(workers=1)
    for n in (0, 2):
        for name in (f"records/{n}.npz", f"answers/{n}.json"):
            assert (tmp_path / "b" / name).read_bytes() == (made.folder / name).read_bytes()


def test_outside_file(tmp_path):
    file = tmp_path / "more.py"
    file.write_text(
        "class Drag:\n"
        "    name, component, onset, size = 'magnet', 'hammer', 'key', 0.01\n"
        "    def force(self, t, x, v, h, w, contacts, size, memory, dt):\n"
        "        return 0.0, -size * (h > 0.02)\n"
        "KINDS = (Drag(),)\n"
    )
    kinds = load_kinds(file)
    assert "magnet" in kinds
    assert len(kinds) >= 11


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("KINDS = ()", ["expected KINDS"]),
        ("import nothing_like_this", ["ModuleNotFoundError"]),
        (
            "class A:\n    name = 'tight_spot'\n    size = -1\nKINDS = (A(),)",
            ["component is missing", "onset", "size = -1", "neither force nor observe", "taken"],
        ),
    ],
)
def test_bad_outside_file(tmp_path, text, messages):
    file = tmp_path / "more.py"
    file.write_text(text)
    with pytest.raises(InvalidParameter) as error:
        load_kinds(file)
    for message in messages:
        assert message in str(error.value)
    with pytest.raises(InvalidParameter, match="no such file"):
        load_kinds(tmp_path / "none.py")


def test_bad_folder_is_told(tmp_path, capsys):
    with pytest.raises(SystemExit) as error:
        main(["-o", str(tmp_path), "--score-only"], command)
    assert error.value.code == 2
    assert "is no bench" in capsys.readouterr().err


def test_two_cases_are_diagnosed(tmp_path):
    """A null and a single effect of the development half of a sealed bench, end to end."""
    bench = Bench(tmp_path / "b")
    bench.seal(40, 7)
    bench.machine.make_records(bench.folder, None, [2, 20])
    for n in (2, 20):
        _diagnose(bench.machine, bench.folder, n, False)
    bench.make_answers(workers=1)
    null, drag = read(bench.folder, [2, 20])
    assert null.kind == 0
    assert not null.claims
    assert drag.truth == {"hammer_drag"}
    assert drag.top(1)
    assert not drag.wrong()


@pytest.mark.slow
def test_dask_cluster_gives_the_same(made, tmp_path, monkeypatch):
    """Records, answers and results of a local Dask cluster are those of this process."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("PYTHONPATH", str(Path(RUN).parents[1]), prepend=os.pathsep)
    folder = tmp_path / "b"
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        local_directory=tmp_path,
    ) as cluster:
        told = ["--cases", "4", "--seed", "11", "-o", str(folder), "--half", "development"]
        with pytest.raises(SystemExit) as end:
            main([*told, "--no-oracle", "--dask", cluster.scheduler_address], command)
        assert end.value.code in (None, 0)
    for n in (0, 2):
        for name in (f"records/{n}.npz", f"answers/{n}.json"):
            assert (folder / name).read_bytes() == (made.folder / name).read_bytes()
        _diagnose(made.machine, made.folder, n, False)
        here, there = (
            json.loads((f / "results" / f"{n}.json").read_text()) for f in (made.folder, folder)
        )
        assert there.pop("cpu_seconds") > 0.0
        assert here.pop("cpu_seconds") > 0.0
        assert here == there


@pytest.mark.parametrize("address", ["nowhere", "tls://127.0.0.1:1"])
def test_a_cluster_that_does_not_answer_is_told(tmp_path, capsys, address):
    pytest.importorskip("distributed")
    with pytest.raises(SystemExit) as end:
        main(["--cases", "2", "-o", str(tmp_path / "b"), "--dask", address], command)
    assert end.value.code == 2
    assert f"--dask {address}: no scheduler answers" in capsys.readouterr().err


def test_a_cluster_that_cannot_import_the_bench_is_told(tmp_path, capsys, monkeypatch):
    distributed = pytest.importorskip("distributed")
    probe = Future()

    class Cluster(nullcontext):
        def get_executor(self, **_):
            return self

        def submit(self, *_):
            return probe

    def fail_late(*_, **__):  # as if the worker answered after the first wait
        probe.set_exception(RuntimeError("different environments"))
        return SimpleNamespace(not_done={probe})

    monkeypatch.setattr(distributed, "Client", lambda *_, **__: Cluster())
    monkeypatch.setattr(blind.run, "wait", fail_late)
    with pytest.raises(SystemExit) as end:
        main(["--cases", "2", "-o", str(tmp_path / "b"), "--dask", "tcp://a:1"], command)
    assert end.value.code == 2
    told = capsys.readouterr().err
    assert "no worker answers, waiting" in told
    assert "scheduler cannot import the bench" in told
    assert not (tmp_path / "b").exists()


@pytest.mark.slow
def test_twenty_cases_by_the_command(tmp_path):
    folder = tmp_path / "b"
    main_arguments = ["--cases", "40", "--seed", "7", "-o", str(folder)]
    with pytest.raises(SystemExit) as end:
        main([*main_arguments, "--half", "development", "--workers", "1"], command)
    assert end.value.code in (None, 0)
    score = json.loads((folder / "score_development.json").read_text())
    assert score["cases"] == 20
    figures = {f["name"]: f for f in score["figures"]}
    assert figures["diagnosis failed with an error"]["value"] == 0.0
    assert figures["false alarm, no effect"]["n"] >= 5
    # Twenty cases say little: a mark that only a broken engine misses.
    assert figures["false alarm, no effect"]["value"] <= 25.0
    assert figures["top-1, one effect, nc >= 5"]["value"] >= 50.0
    assert "| false alarm" in (folder / "score_development.md").read_text()


@pytest.mark.slow
def test_killed_bench_goes_on_where_it_was(tmp_path):
    folder = tmp_path / "b"
    command = [sys.executable, str(RUN), "--cases", "4", "--seed", "2"]
    command += ["-o", str(folder), "--half", "development", "--no-oracle"]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    results = folder / "results"
    limit = time.monotonic() + 600
    while not list(results.glob("*.json")) and time.monotonic() < limit:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = {p.name: p.read_bytes() for p in results.glob("*.json")}
    assert kept
    subprocess.run([*command, "--resume"], check=True, stderr=subprocess.DEVNULL)
    after = {p.name: p.read_bytes() for p in results.glob("*.json")}
    assert set(after) == {"0.json", "2.json"}
    for name, data in kept.items():
        assert after[name] == data
    score = json.loads((folder / "score_development.json").read_text())
    assert score["cases"] == 2


def test_score_only_takes_the_machine_of_the_seal(tmp_path, capsys):
    """It wrote answers of the machine of the option, and told a changed generator."""
    bench = Bench(tmp_path / "b", machine=MACHINES["steinway45"])
    bench.seal(2, 3)
    with pytest.raises(SystemExit) as end:
        main(["-o", str(bench.folder), "--score-only"], command)
    assert end.value.code in (None, 0)
    assert "Blind bench of steinway45" in (bench.folder / "score.md").read_text()
    capsys.readouterr()


def test_answers_need_the_kinds_of_the_seal(tmp_path):
    file = tmp_path / "more.py"
    file.write_text(
        "class Drag:\n"
        "    name, component, onset, size = 'magnet', 'hammer', 'key', 0.01\n"
        "    def force(self, t, x, v, h, w, contacts, size, memory, dt):\n"
        "        return 0.0, -size * (h > 0.02)\n"
        "KINDS = (Drag(),)\n"
    )
    Bench(tmp_path / "b", file).seal(2, 3)
    with pytest.raises(InvalidParameter, match="another file of kinds from outside"):
        Bench(tmp_path / "b").make_records(workers=1)
