"""Sweeps: order, failing members, resuming after a kill, executors, same numbers for all."""

import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pandas as pd
import pytest

import feltmb
from feltmb.run.sweep import Axis, Member, axis_values, run_member, run_members, sweep
from unmodeled.errors import InvalidParameter

SHORT = {"duration": 0.03}
FORCES = {"stroke.scale": [0.5, 1.0, 2.0]}


@pytest.fixture(scope="module")
def action():
    """Rigid parts: few steps."""
    return feltmb.load_action("steinway45").with_values({"shank.rigid": True, "wire.rigid": True})


@pytest.fixture(scope="module")
def stroke():
    return feltmb.pulse_stroke(8.0, start=0.0, duration=0.03)


def quiet(*args, **options):
    return sweep(*args, progress=False, **options)


def test_order_is_that_of_the_values(action, stroke):
    values = {"stroke.scale": [2.0, 0.5], "string.modes": [5, 3, 4]}
    table = quiet(action, stroke, values, jobs=3).table
    assert list(zip(table["stroke.scale"], table["string.modes"], strict=True)) == [
        (s, m) for s in (2.0, 0.5) for m in (5, 3, 4)
    ]
    assert list(table.columns[:5]) == ["stroke.scale", "string.modes", "stroke", "status", "error"]
    assert set(table["status"]) == {"done"}
    assert (table["steps"] > 10).all()


def test_same_bits_for_one_and_four_workers(action, stroke):
    values = {"stroke.scale": [0.7, 1.0, 1.3, 1.6], "key.mass": {"scale": [1.0, 1.1]}}
    one = quiet(action, stroke, values, jobs=1).table
    four = quiet(action, stroke, values, jobs=4).table
    pd.testing.assert_frame_equal(one, four, check_exact=True)


def test_process_pool_gives_the_same(action, stroke):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        there = quiet(action, stroke, FORCES, executor=pool).table
        assert pool.submit(int, "3").result() == 3  # a given executor is not shut down
    pd.testing.assert_frame_equal(
        there, quiet(action, stroke, FORCES, jobs=1).table, check_exact=True
    )


@pytest.mark.slow
def test_dask_cluster_gives_the_same(action, stroke, tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            local_directory=tmp_path,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        there = quiet(action, stroke, FORCES, executor=client.get_executor()).table
    pd.testing.assert_frame_equal(
        there, quiet(action, stroke, FORCES, jobs=1).table, check_exact=True
    )


def test_failing_members_do_not_take_the_others_along(action, stroke):
    values = {"string.tension": [654.0, -1.0, "no tension", 600.0]}
    result = quiet(action, stroke, values)
    assert list(result.table["status"]) == ["done", "failed", "failed", "done"]
    assert re.search("string.tension: got .*-1.0.* must be > 0", result.table["error"][1])
    assert np.isnan(result.table["steps"][1])
    assert len(result.failed) == 2
    assert "2 failed" in repr(result)
    # a path that does not exist is the member's fault too: another member may have it
    points = [{"string.modes": 3}, {"string.moods": 3}, {"stroke.shape": 1}]
    assert list(quiet(action, stroke, points).table["status"]) == ["done", "failed", "failed"]


def test_solver_failure_keeps_what_was_reached(action, stroke, monkeypatch):
    run = feltmb.simulate(action, stroke, 0.01)
    object.__setattr__(run, "status", "failed")

    def fail(*_args, **_options):
        raise feltmb.IntegrationError("stopped", partial=run, time=0.01, state="x", contact="c")

    monkeypatch.setattr(sys.modules["feltmb.run.simulate"], "simulate", fail)
    outcome = run_member(Member(action, stroke))
    assert (outcome.status, outcome.error) == ("failed", "stopped")
    assert outcome.reached == run.reached


def test_wall_time_is_an_error_without_numbers(stroke):
    flexible = feltmb.load_action("steinway45")
    outcome = run_member(Member(flexible, stroke, options={"max_wall": 1e-9}))
    assert outcome.status == "error"
    assert "wall time" in outcome.error
    assert not outcome.numbers


class _Broken(Executor):
    """Loses its workers at the second job."""

    def __init__(self):
        self.count = 0

    def submit(self, fn, /, *args, **kwargs):
        self.count += 1
        if self.count > 2:
            raise RuntimeError("cannot schedule new futures")
        future = Future()
        if self.count == 2:
            future.set_exception(OSError("worker died"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_broken_executor_is_reported_and_repaired_by_resuming(action, stroke, tmp_path):
    first = quiet(action, stroke, FORCES, executor=_Broken(), folder=tmp_path).table
    assert list(first["status"]) == ["done", "error", "error"]
    assert "worker died" in first["error"][1]
    again = quiet(action, stroke, FORCES, folder=tmp_path).table
    assert list(again["status"]) == ["done"] * 3


# --- resuming ------------------------------------------------------------------------------------

CHILD = """
import feltmb
from feltmb.run.sweep import sweep
if __name__ == "__main__":
    stroke = feltmb.pulse_stroke(8.0, start=0.0, duration=0.1)
    sweep("steinway45", stroke, {{"string.modes": list(range(20, 28))}}, jobs=1, folder={folder!r},
          progress=False)
"""


def test_resumes_after_a_kill_in_the_middle(tmp_path):
    folder = tmp_path / "members"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD.format(folder=str(folder))], env=environment
    )
    try:
        deadline = time.monotonic() + 60
        while len(list(folder.glob("*.json"))) < 2 and time.monotonic() < deadline:
            assert child.poll() is None, "finished before it could be killed"
            time.sleep(0.005)
        child.send_signal(signal.SIGKILL)
    finally:
        child.kill()
        child.wait()
    finished = {p: p.stat().st_mtime_ns for p in folder.glob("*.json")}
    assert 2 <= len(finished) < 8
    for path in finished:  # whole or not there
        assert json.loads(path.read_text())["feltmb"] == "member"

    stroke = feltmb.pulse_stroke(8.0, start=0.0, duration=0.1)
    values = {"string.modes": list(range(20, 28))}
    calls = []
    result = sweep(
        "steinway45",
        stroke,
        values,
        folder=folder,
        progress=lambda done, total, name: calls.append((done, total, name)),
    )
    assert [c[:2] for c in calls] == [(i + 1, 8) for i in range(8)]
    assert {p: p.stat().st_mtime_ns for p in finished} == finished  # nothing computed twice
    assert len(list(folder.glob("*.json"))) == 8
    fresh = quiet("steinway45", stroke, values)
    pd.testing.assert_frame_equal(result.table, fresh.table, check_exact=True)


def test_finished_sweep_computes_nothing(action, stroke, tmp_path, monkeypatch):
    first = quiet(action, stroke, FORCES, folder=tmp_path).table
    monkeypatch.setattr(feltmb._core, "simulate_many", lambda strokes, *_: list(strokes) and 1 / 0)
    pd.testing.assert_frame_equal(
        first, quiet(action, stroke, FORCES, folder=tmp_path).table, check_exact=True
    )


def test_failures_are_remembered_and_damaged_files_computed_again(action, stroke, tmp_path):
    values = {"string.tension": [654.0, -1.0]}
    first = quiet(action, stroke, values, folder=tmp_path).table
    files = sorted(tmp_path.glob("*.json"))
    assert len(files) == 2
    done = next(f for f in files if json.loads(f.read_text())["status"] == "done")
    done.write_text(done.read_text()[:40])
    with pytest.warns(RuntimeWarning, match="computed again"):
        again = quiet(action, stroke, values, folder=tmp_path).table
    pd.testing.assert_frame_equal(first, again, check_exact=True)
    assert json.loads(done.read_text())["status"] == "done"


def test_key_tells_parameters_stroke_and_options_apart(action, stroke):
    members = [
        Member(action, stroke),
        Member(action, stroke, {"string.modes": 3}),
        Member(action, stroke.scaled(1.01)),
        Member(action, stroke, options={"rtol": 1e-7}),
        Member(action.with_values({"string.modes": 3}), stroke),
    ]
    assert len({m.key for m in members}) == len(members)
    assert Member(action, stroke, name="other").key == members[0].key
    assert pickle.loads(pickle.dumps(members[1])).key == members[1].key


def test_twins_run_once(action, stroke):
    class Counting(ThreadPoolExecutor):
        jobs = 0

        def submit(self, *args, **options):
            Counting.jobs += 1
            return super().submit(*args, **options)

    with Counting(1) as pool:
        found = dict(run_members([Member(action, stroke)] * 3, executor=pool))
    assert Counting.jobs == 1
    assert sorted(found) == [0, 1, 2]


def test_runs_can_be_kept(action, stroke, tmp_path):
    values = {"stroke.scale": [0.5, 1.0]}
    result = quiet(action, stroke, values, folder=tmp_path, summary_only=False)
    run = result.run(1)
    assert run.provenance["stroke"]["value"][1] == 8.0
    next(tmp_path.glob("*.nc")).unlink()
    assert quiet(action, stroke, values, folder=tmp_path, summary_only=False).run(0).time.size
    with pytest.raises(InvalidParameter, match="summary_only"):
        quiet(action, stroke, values).run(0)
    with pytest.raises(InvalidParameter, match="folder"):
        quiet(action, stroke, values, summary_only=False)


def test_interrupt_stops_running_members(action):
    long = feltmb.pulse_stroke(8.0, start=0.0, duration=100.0)
    seen = []

    def interrupt(done, _total, _name):
        seen.append(done)
        raise KeyboardInterrupt

    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        sweep(
            action,
            long,
            [{"options.duration": 0.01}, {"options.duration": 100.0}],
            jobs=2,
            progress=interrupt,
        )
    assert seen == [1]
    assert time.monotonic() - start < 30


# --- what a sweep goes over ----------------------------------------------------------------------


def test_values_are_lists_ranges_scales_and_offsets(action, stroke):
    assert axis_values({"from": 1, "to": 100, "count": 3, "spacing": "log"}, "x") == (
        (1.0, 10.0, 100.0),
        "set",
    )
    assert axis_values(np.array([1, 2]), "x") == ((1, 2), "set")
    assert axis_values({"scale": {"from": 1, "to": 2, "count": 2}}, "x") == ((1.0, 2.0), "scale")
    offset = Axis("surfaces.Gp10.point.y", (1e-4,), "offset")
    assert offset.at(1e-4) == {"surfaces.Gp10.point.y +=": 1e-4}
    changed = action.with_values(Axis("shank.young_modulus", (2.0,), "scale").at(2.0))
    assert changed.value("shank.young_modulus") == (pytest.approx(25.236e9), "Pa")
    table = quiet(
        action,
        stroke,
        {"string.modes": [3, 4], "options.rtol": [1e-5, 1e-7]},
        mode="list",
    ).table
    assert list(table["options.rtol"]) == [1e-5, 1e-7]
    assert table["steps"][1] > table["steps"][0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"string.modes": []}, "no values"),
        ({"string.modes": 3}, "expected a list"),
        ({"string.modes": "345"}, "expected a list"),
        ({"string.modes": {"from": 1, "to": 2}}, "from, to, count"),
        ({"string.modes": {"from": 0, "to": 2, "count": 3, "spacing": "log"}}, "log between"),
        ({"string.modes": {"from": 1, "to": 2, "count": 0}}, "count"),
        ({"string.modes": {"scale": [1], "offset": [1]}}, "stands alone"),
        ({"string.moods": {"scale": [1]}}, "no such number; did you mean 'modes'"),
        ({"string.kind": {"scale": [1]}}, "the value is 'modal', expected a number"),
        ({"contacts.*.alfa": {"scale": [1]}}, "no such number; did you mean 'alpha'"),
        ([], "no points"),
    ],
)
def test_wrong_values_are_refused(action, stroke, values, message):
    with pytest.raises(InvalidParameter, match=message):
        quiet(action, stroke, values)


def test_wrong_arguments_are_refused(action, stroke, tmp_path):
    with pytest.raises(InvalidParameter, match="same length"):
        quiet(action, stroke, {"string.modes": [3], "key.mass": [0.1, 0.2]}, mode="list")
    with pytest.raises(InvalidParameter, match="'tol' is unknown"):
        quiet(action, stroke, FORCES, options={"tol": 1})
    with pytest.raises(InvalidParameter, match="no stroke"):
        quiet(action, [], FORCES)
    with pytest.raises(InvalidParameter, match="jobs = 0"):
        quiet(action, stroke, FORCES, jobs=0)
    with pytest.raises(InvalidParameter, match="mode"):
        quiet(action, stroke, FORCES, mode="all")
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InvalidParameter, match="is a file"):
        quiet(action, stroke, FORCES, folder=file)


def test_numbers_without_a_unit_are_in_si_units(action, stroke):
    """The file gives the button in mm: 0.0771 m, 77.1 mm, an offset and a factor are the same."""
    path = "surfaces.Gp10.point.y"
    equal = [
        ({path: [0.0771]}, True),
        ({path: {"from": 0.0771, "to": 0.08, "count": 1}}, True),
        ([{path: 0.0771}], True),
        ([{f"{path} +=": 1e-4}], True),
        ({path: {"offset": [1e-4]}}, True),
        ({path: ["77.1 mm"]}, False),
        ({path: {"offset": ["0.1 mm"]}}, False),
        ({path: {"scale": [77.1 / 77.0]}}, False),
    ]
    found = []
    for values, told in equal:
        result = quiet(action, stroke, values)
        found.append(result.table["steps"][0])
        assert bool(result.notes) == told, values
        if told:
            (note,) = result.notes
            assert note.endswith("numbers without a unit are in SI units, m; the file has mm")
            assert note in repr(result)
    assert len(set(found)) == 1
    given = quiet(action, stroke, {path: [0.0771], "string.modes": [3, 4], "key.mass": [0.1]})
    assert given.to_xarray()[path].attrs["units"] == "m"
    mixed = quiet(action, stroke, {path: ["77.1 mm", "78 mm"], "key.mass": [0.1, "200 g"]})
    assert mixed.to_xarray()["steps"].dims == (path, "key.mass", "stroke")
    assert len(given.notes) == 1  # the file gives the mass in kg


def test_table_is_saved_as_csv(action, stroke, tmp_path):
    result = quiet(action, [stroke, stroke.scaled(0.5)], {"string.modes": [3]})
    path = result.save(tmp_path / "sweep.csv")
    back = pd.read_csv(path, keep_default_na=True)
    assert len(back) == 2
    assert back["steps"][0] == result.table["steps"][0]
