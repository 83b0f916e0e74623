"""Fits, diagnoses and benches killed at any moment, on a full disk, in a closed folder."""

import json
import multiprocessing
import os
import random
import signal
import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import killing

from feltmb.files import Store

COMMANDS = {
    "fit": (["fit"], ["--restarts", "4"], ["fit.json"]),
    "diagnose": (
        ["gap", "diagnose"],
        ["--bootstrap", "2"],
        ["report.html", "report.json"],
    ),
}


@pytest.fixture(scope="module")
def started():
    """Makes processes that have loaded what they need."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["feltmb.cli", "feltmb.gap", "feltmb.cli.gap", "killing"])
    return context


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    return killing.prepare(tmp_path_factory.mktemp("given"))


def command(kind, given, folder):
    before, after, _ = COMMANDS[kind]
    return [*before, *given, *after, "-o", str(folder)]


def outcome(started, arguments, limit=0):
    """Exit code, what was said on stderr, and processor time [s]."""
    here, there = started.Pipe()
    process = started.Process(target=killing.work, args=(arguments, there, limit))
    process.start()
    there.close()
    try:
        return here.recv()
    finally:
        process.join()


def spent(pid):
    """Processor time of a process so far [s]; infinite if it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return float("inf")
    ticks = int(fields[11]) + int(fields[12])
    return float("inf") if fields[0] == "Z" else ticks / os.sysconf("SC_CLK_TCK")


def kill_at(process, moment):
    """Kill a process when it has worked for so long [s], which no other work on the machine moves.

    Below the clock's hundredth of a second the moment is a wait.
    """
    while spent(process.pid) < moment - 0.01:
        time.sleep(0.003)
    time.sleep(min(0.01, moment))
    process.kill()


def kept(folder):
    """Finished optimizations and when they were written."""
    found = (folder / ".resume").rglob("[!.]*.json")
    # That file says what the fits belong to.
    return {p: p.stat().st_mtime_ns for p in found if p.name != "diagnosis.json"}


def kill_until_done(started, given, kind, folder, kills, seed):
    """Kill at random moments, each resumed in the folder of the last; count the kills."""
    rng = random.Random(seed)
    files = COMMANDS[kind][2]
    for name in ("first", "whole"):  # the first process of all takes longer than any other
        code, said, whole = outcome(started, command(kind, given, folder / name))
        assert code == 0, said
    want = [(folder / "whole" / name).read_bytes() for name in files]
    done, rounds, resumed = 0, 0, 0
    while done < kills:
        rounds += 1
        here = folder / f"run{rounds}"
        while True:
            before = kept(here)
            resumed += bool(before)
            process = started.Process(target=killing.work, args=(command(kind, given, here),))
            process.start()
            if done < kills:
                kill_at(process, rng.uniform(0.0, 1.05 * whole))
            process.join()
            after = kept(here)
            if process.exitcode == 0:
                break
            assert process.exitcode == -signal.SIGKILL
            done += 1
            if not all((here / name).exists() for name in files):
                assert {p: after.get(p) for p in before} == before, "lost, or computed twice"
            for path in after:
                key = json.loads(path.read_text())["key"]
                found = Store(path.parent).get(key)
                assert "cost" in found.arrays, "half a file"
            if any((here / name).exists() for name in files):
                break  # killed when it had written: nothing to go on with
        for name, data in zip(files, want, strict=True):
            if (here / name).exists():
                assert (here / name).read_bytes() == data, name
        if process.exitcode == 0:
            assert sorted(p.name for p in here.iterdir()) == files
    return done, resumed


@pytest.mark.parametrize("kind", COMMANDS)
def test_killed_twice_goes_on(kind, started, given, tmp_path):
    assert kill_until_done(started, given, kind, tmp_path, 2, seed=3)[0] == 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", COMMANDS)
def test_killed_a_hundred_times_goes_on(kind, started, given, tmp_path):
    done, resumed = kill_until_done(started, given, kind, tmp_path, 100, seed=4)
    assert done == 100
    assert resumed >= 20  # else the kills came too early to test anything


@pytest.mark.parametrize("kind", COMMANDS)
def test_a_full_disk_gives_a_message_and_keeps_what_was_written(kind, started, given, tmp_path):
    (tmp_path / "kept.txt").write_text("mine")
    code, said, _ = outcome(started, command(kind, given, tmp_path / "a"), limit=900)
    assert code == 1, said
    assert "cannot be written: File too large" in said.splitlines()[-1]
    assert "Traceback" not in said
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["kept.txt"]
    assert not [p for p in tmp_path.rglob(".feltmb*")]
    # With room it goes on in the same folder.
    code, said, _ = outcome(started, command(kind, given, tmp_path / "a"))
    assert code == 0, said
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == COMMANDS[kind][2]


@pytest.mark.parametrize("kind", COMMANDS)
def test_a_place_that_cannot_be_written_is_told_before_the_work(kind, started, given, tmp_path):
    # A file where a folder is needed: refused for every user, root too.
    (tmp_path / "file").write_text("mine")
    code, said, _ = outcome(started, command(kind, given, tmp_path / "file"))
    assert code in (1, 2), said
    assert "cannot be written" in said or "is a file, expected a folder" in said
    assert "model fit" not in said
    assert "Traceback" not in said
    assert (tmp_path / "file").read_text() == "mine"
