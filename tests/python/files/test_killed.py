"""Killed at any moment, on a full disk, in a closed folder: nothing is lost, nothing is half."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

import feltmb

DATA = Path(__file__).resolve().parents[2] / "data"

CHILD = """
import feltmb
stroke = feltmb.pulse_stroke(3.0, start=0.001, duration=0.02)
values = {{"arm.mass": [{{"value": 0.02 + 1e-4 * k, "unit": "kg"}} for k in range({count})]}}
print("begin", flush=True)
result = feltmb.sweep({action!r}, stroke, values, folder={folder!r}, jobs=2, progress=False,
                      summary_only=False, options={{"duration": 0.05, "ledger": True}})
result.table.to_pickle({table!r})
"""


def members(folder):
    """Finished members and when they were written."""
    return {p: p.stat().st_mtime_ns for p in folder.glob("*.json")}


def child(folder, table, count):
    text = CHILD.format(
        action=str(DATA / "pendulum.toml"), folder=str(folder), table=str(table), count=count
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.Popen(
        [sys.executable, "-c", text], env=environment, stdout=subprocess.PIPE, text=True
    )


def kill_until_done(tmp_path, kills, seed, count=24):
    """Kill sweeps at random moments, each resumed in the folder of the last; count the kills."""
    rng = random.Random(seed)
    done, rounds = 0, 0
    whole = tmp_path / "whole.pickle"
    with child(tmp_path / "whole", whole, count) as process:
        assert process.wait() == 0
    want = pd.read_pickle(whole)
    while done < kills:
        rounds += 1
        folder, table = tmp_path / f"sweep{rounds}", tmp_path / f"table{rounds}.pickle"
        while True:
            before = members(folder) if folder.is_dir() else {}
            process = child(folder, table, count)
            assert process.stdout.readline() == "begin\n"
            if done < kills:
                time.sleep(rng.uniform(0.0, 0.25))
                process.send_signal(signal.SIGKILL)
            code = process.wait()
            process.stdout.close()
            after = members(folder) if folder.is_dir() else {}
            assert {p: after.get(p) for p in before} == before, "lost, or computed twice"
            for path in after:
                assert json.loads(path.read_text())["feltmb"] == "member", "half a file"
                feltmb.load_run(path.with_suffix(".nc")) if path.with_suffix(".nc").is_file() else 0
            if code == 0:
                break
            assert code == -signal.SIGKILL
            done += 1
        got = pd.read_pickle(table)
        pd.testing.assert_frame_equal(got, want, check_exact=True)
        assert len(members(folder)) == count
    return done


def test_a_killed_sweep_goes_on(tmp_path):
    assert kill_until_done(tmp_path, 1, seed=1, count=8) == 1


@pytest.mark.slow
def test_a_sweep_killed_a_hundred_times_goes_on(tmp_path):
    assert kill_until_done(tmp_path, 100, seed=2) == 100


# ---------------------------------------------------------------- full disks, closed folders

WRITERS = {
    "run": "run.save(folder / 'a.nc')",
    "page": "feltmb.view(run, folder / 'a.html')",
    "sound": "string.write_wav(folder / 'a.wav', slowness=50)",
    "plots": "feltmb.plot.save_all(run, folder / 'plots', 'a')",
    "animation": "feltmb.animate.animate(run, folder / 'a.gif', slowness=2)",
    "mechanism": "unmodeled.files.write_text(folder / 'a.toml', action.to_toml())",
    "sweep": (
        "table = feltmb.sweep(action, 'forte', {'arm.mass': [0.02, 0.03]}, folder=folder / 'sweep',"
        " progress=False, summary_only=False).table\n"
        "    if set(table['status']) != {'done'}: raise feltmb.Error(table['error'][0])"
    ),
}
CHILD_THAT_WRITES = """
import json, pathlib, resource, sys, traceback
import feltmb, unmodeled.files
import feltmb.graphics.plot.files as plots
plots.PICTURES = {"motion": plots.PICTURES["motion"]}  # one shows how all are written
action_file, string_file, writers = json.loads(sys.argv[1])
action = feltmb.load_action(action_file)
run = feltmb.simulate(action, "forte", 0.02)
string = feltmb.simulate(string_file, feltmb.ramp_stroke(0.0, duration=0.005))
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
for place, limit in (("full", 900), ("file", hard), ("full", hard)):
    folder = pathlib.Path(place)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    for name, code in writers.items():
        try:
            exec(code.replace("\\n    ", "\\n"))
            said = "wrote"
        except feltmb.Error as error:
            said = str(error)
        except BaseException:
            said = traceback.format_exc()
        print(json.dumps([name, said]))
    print(json.dumps(sorted(str(p) for p in pathlib.Path().rglob("*") if p.is_file())))
"""


def test_full_disks_and_closed_folders_give_messages_and_leave_nothing_half(tmp_path):
    """Every way to write a file: on a full disk, below a file, and then with room."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "kept.txt").write_text("mine")
    # A file where a folder is needed: refused for every user, root too.
    (tmp_path / "file").write_text("mine")
    given = [str(DATA / "pendulum.toml"), str(DATA / "hammer_string.toml"), WRITERS]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "-c", CHILD_THAT_WRITES, json.dumps(given)],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    n = len(WRITERS)
    full, closed, room = (lines[k * (n + 1) : (k + 1) * (n + 1)] for k in range(3))
    for said in (full, closed, room):
        assert [name for name, _ in said[:n]] == list(WRITERS)
    for name, text in (*full[:n], *closed[:n]):
        assert text != "wrote", name
        assert "Traceback" not in text, (name, text)
    assert all("cannot be written: File too large" in text for _, text in full[:n])
    assert full[n] == closed[n] == ["file", "full/kept.txt"]
    assert {text for _, text in room[:n]} == {"wrote"}  # what failed is not remembered
    assert len(room[n]) > 2 + n
    assert not [path for path in room[n] if ".feltmb" in path]
    assert [(tmp_path / p).read_text() for p in ("file", "full/kept.txt")] == ["mine", "mine"]
