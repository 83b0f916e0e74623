"""Slow simulators: runs on executors, and runs that are kept in a folder."""

import gc
import json
import math
import subprocess
import sys
import textwrap
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from unmodeled import Equations, Record, Sensor, Simulator, Verdict, diagnose, fit_model
from unmodeled.cli import main
from unmodeled.errors import InvalidParameter
from unmodeled.models.elsewhere import running
from unmodeled.models.matching import matched

CLOCK = np.arange(200) * 0.01
CAUSES = tuple(f"cause{k}" for k in range(22))
#: Runs by arguments, and threads in which they were made.
MADE: Counter = Counter()
THREADS: set[int] = set()
#: Number of runs after which the next one is interrupted; None: it is not.
LIMIT: list[int | None] = [None]


def plant(clock, inputs, parameters):
    """A lag with 22 possible causes, each a wave of its own."""
    if LIMIT[0] is not None and sum(MADE.values()) >= LIMIT[0]:
        raise KeyboardInterrupt
    MADE[tuple(parameters.values()), inputs["u"].tobytes()] += 1
    THREADS.add(threading.get_ident())
    p = parameters
    y = p["gain"] * inputs["u"] * (1.0 - np.exp(-clock / p["tau"]))
    for k, name in enumerate(CAUSES):
        y = y + p[name] * np.sin((2.0 + 1.7 * k) * clock) * inputs["u"]
    return {"y": y}


def slow_plant(clock, inputs, parameters):
    """The plant as a run of some milliseconds."""
    time.sleep(2e-3)
    return plant(clock, inputs, parameters)


def model(function=plant, **fields):
    given = {
        "parameters": {"gain": (2.0, 0.2, "m"), "tau": (0.4, 0.05, "s")},
        "unknown": {name: (0.0, 0.05, "m") for name in CAUSES},
        "inputs": {"u": "1"},
        "outputs": {"y": "m"},
        "workers": 1,
        "name": "plant",
    }
    return Simulator(function, **{**given, **fields})


def records():
    out = []
    for seed, level in enumerate((1.0, 1.5, 0.7)):
        u = np.full(CLOCK.size, level)
        point = dict.fromkeys(CAUSES, 0.0) | {"gain": 2.1, "tau": 0.38, "cause7": 0.04}
        clean = plant(CLOCK, {"u": u}, point)["y"]
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(CLOCK.size)
        sensors = {"y": Sensor(name="y", sigma=1e-3, unit="m")}
        name = f"r{seed}"
        own = {"time": CLOCK, "inputs": {"u": u}, "outputs": {"y": clean + noise}}
        out.append(Record(name=name, sensors=sensors, **own))
    return tuple(out)


@pytest.fixture(autouse=True)
def forgotten():
    """No run was made."""
    measured = records()
    MADE.clear()
    THREADS.clear()
    LIMIT[0] = None
    return measured


def told(report):
    """The answer, without the time that it took."""
    return {**report.as_dict(), "seconds": 0.0}


class Later:
    """A future of :class:`Batches`."""

    def __init__(self, batches, work):
        self.batches, self.work, self.value = batches, work, None

    def result(self):
        """Computes all that was submitted until now, as one batch."""
        self.batches.finish()
        return self.value

    def cancel(self):
        """Nothing to cancel."""


class Batches:
    """An executor that is none of the standard library and knows its batches."""

    def __init__(self, workers=8):
        self.workers, self.waiting, self.rounds, self.runs = workers, [], 0, 0

    def submit(self, work, *args):
        """A future."""
        self.waiting.append(Later(self, lambda: work(*args)))
        return self.waiting[-1]

    def finish(self):
        """Compute, and count how often all workers are busy one after the other."""
        self.rounds += math.ceil(len(self.waiting) / self.workers)
        self.runs += len(self.waiting)
        for later in self.waiting:
            later.value = later.work()
        self.waiting = []


def test_eight_workers_share_the_runs_of_22_causes(forgotten):
    alone = told(diagnose(model(), None, forgotten))
    assert alone["verdict"] == Verdict.NAMED.name
    whole = sum(MADE.values())
    MADE.clear()
    batches = Batches()
    report = diagnose(model(), None, forgotten, executor=batches)
    assert told(report) == alone
    assert sum(MADE.values()) == whole
    single = whole - batches.runs
    # In units of a run: what 8 workers need, against one process.
    assert (batches.rounds + single) < whole / 5, (batches.rounds, single, whole)


def test_the_sizes_of_22_causes_are_found_together(forgotten):
    """Trials of all causes are one batch after the other, however many causes there are."""
    unsized = {name: "m" for name in CAUSES}
    alone = model(unknown=unsized).ready(forgotten)
    batches = Batches()
    shared = running(model(unknown=unsized), executor=batches).ready(forgotten)
    assert shared.notes == alone.notes
    assert [e.scale for e in shared.model.effects] == [e.scale for e in alone.model.effects]
    single = shared.model.simulations - batches.runs
    assert batches.rounds + single < len(MADE) / 4, (batches.rounds, single)


def test_the_run_that_finds_the_channels_is_not_made_again(forgotten):
    """Only the first run is made twice, to see whether it returns the same again."""
    found = matched(model(inputs=None, outputs=None), forgotten).model.ready(forgotten).model
    assert (found.inputs, found.outputs) == (("u",), ("y",))
    assert sorted(MADE.values())[-2:] == [1, 2]


def test_the_run_that_finds_the_channels_must_succeed(forgotten):
    def nothing(clock, inputs, parameters):
        return {"y": np.nan * inputs["u"]}

    found = matched(model(nothing, inputs=None, outputs=None), forgotten[:1]).model
    with pytest.raises(InvalidParameter, match="returns nan for y at t = 0 s, sample 0"):
        found.ready(forgotten[:1])


def test_threads_of_an_executor_make_the_runs(forgotten):
    alone = told(fit_model(model(), forgotten))
    THREADS.clear()
    with ThreadPoolExecutor(8) as pool:
        report = fit_model(model(slow_plant), forgotten, executor=pool)
        assert pool.submit(int).result() == 0  # it is not shut down
    assert told(report) == alone
    assert len(THREADS) > 1


def test_dask_makes_the_runs(forgotten):
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    alone = told(fit_model(model(), forgotten))
    before = sum(MADE.values())
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        report = fit_model(model(), forgotten, executor=client)
    assert told(report) == alone
    assert sum(MADE.values()) <= 2 * before
    assert len(THREADS) > 1


def test_what_cannot_be_sent_is_named(forgotten):
    lock = threading.Lock()

    def locked(clock, inputs, parameters):
        with lock:
            return plant(clock, inputs, parameters)

    with pytest.raises(
        InvalidParameter, match=r"plant: its function cannot be sent .*(lock|local)"
    ):
        diagnose(model(locked), None, forgotten, executor=Batches())
    with pytest.raises(InvalidParameter, match=r"executor is int, expected .* with submit"):
        diagnose(model(), None, forgotten, executor=8)
    with pytest.raises(InvalidParameter, match="workers = 2 and an executor"):
        running(model(), workers=2, executor=Batches())


def test_a_worker_without_the_function_is_one_message(forgotten):
    class Elsewhere(Batches):
        def finish(self):
            raise ModuleNotFoundError("No module named 'plant'")

    with pytest.raises(
        InvalidParameter, match=r"executor raises ModuleNotFoundError.*workers need unmodeled"
    ):
        diagnose(model(), None, forgotten, executor=Elsewhere())


def test_equations_have_no_runs_to_share(tmp_path):
    own = Equations(lambda t, x, u, p: (-x.y,), states={"y": "m"}, parameters={})
    with pytest.raises(InvalidParameter, match="for a Simulator, an FMU or a MuJoCo model, got Eq"):
        running(own, cache=tmp_path)


# ------------------------------------------------------------------------------------- the folder


@pytest.mark.parametrize(
    "share", [0.5, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.05, 0.9))]
)
def test_an_interrupted_diagnosis_continues_and_repeats_no_run(forgotten, tmp_path, share):
    whole = diagnose(model(), None, forgotten)
    runs = dict(MADE)
    MADE.clear()
    LIMIT[0] = int(share * sum(runs.values()))
    try:
        first = diagnose(model(), None, forgotten, cache=tmp_path / "runs")
        assert not first.complete
    except KeyboardInterrupt:
        pass
    before = sum(MADE.values())
    assert before == LIMIT[0]
    LIMIT[0] = None
    report = diagnose(model(), None, forgotten, cache=tmp_path / "runs")
    assert dict(MADE) == runs  # together not one more than without the interruption
    assert told(report) == told(whole)
    total = sum(runs.values())
    assert report.cached == f"{before} of {total} runs from the cache {tmp_path / 'runs'}"
    wide = 400  # the last line is not folded, however long the path of the folder
    assert report.text(wide) == f"{whole.text(wide)}\n\n{report.cached}"


def test_an_interruption_in_the_first_fit_tells_what_is_kept(forgotten, tmp_path):
    for cache in (None, tmp_path / "runs"):
        MADE.clear()
        LIMIT[0] = 4
        try:
            with pytest.raises(KeyboardInterrupt) as end:
                diagnose(model(), None, forgotten, cache=cache)
        finally:
            LIMIT[0] = None
        told = "nothing is kept, and the same command begins anew; with --cache FOLDER"
        if cache:
            told = f"the finished runs are kept in {cache}, and the same command goes on from them"
        assert str(end.value).startswith(f"before there was an answer: {told}")


KILLED = """
    import os, sys
    import numpy as np
    from unmodeled import Record, Sensor, Simulator, fit_model

    left, folder = int(sys.argv[1]), sys.argv[2]
    made = 0

    def plant(clock, inputs, parameters):
        global made
        if made == left:
            os._exit(7)
        made += 1
        return {"y": parameters["gain"] * np.exp(-clock / parameters["tau"])}

    clock = np.arange(100) * 0.01
    noise = 1e-3 * np.random.default_rng(0).standard_normal(clock.size)
    seen = {"y": 1.1 * np.exp(-clock / 0.3) + noise}
    measured = Record(name="r", time=clock, inputs={}, outputs=seen,
                      sensors={"y": Sensor(name="y", sigma=1e-3, unit="m")})
    prior = {"gain": (1.0, 0.2, "m"), "tau": (0.35, 0.1, "s")}
    model = Simulator(plant, parameters=prior, inputs={}, outputs={"y": "m"}, workers=1)
    report = fit_model(model, measured, cache=folder)
    print(made, [p.value.hex() for p in report.parameters], report.cached.partition(" ")[0] or 0)
"""


def test_a_killed_process_leaves_its_runs(tmp_path):
    script = tmp_path / "plant.py"
    script.write_text(textwrap.dedent(KILLED))

    def started(left, folder):
        words = [sys.executable, str(script), str(left), str(tmp_path / folder)]
        return subprocess.run(words, capture_output=True, text=True, check=False)

    whole = started(-1, "whole")
    assert whole.returncode == 0, whole.stderr
    made, values = whole.stdout.split(" ", 1)
    assert started(9, "killed").returncode == 7
    again = started(-1, "killed")
    assert again.stdout == f"{int(made) - 9} {values.replace('] 0', '] 9')}"


def test_a_damaged_run_is_made_again(forgotten, tmp_path):
    whole = told(fit_model(model(), forgotten, cache=tmp_path))
    MADE.clear()
    assert told(fit_model(model(), forgotten, cache=tmp_path)) == whole
    assert not MADE
    files = [f for f in tmp_path.rglob("*.json") if f.name != "model.json"]
    text = files[0].read_text()
    files[0].write_text(text[: len(text) // 2])
    with pytest.warns(RuntimeWarning, match="computed again: the file is damaged"):
        assert told(fit_model(model(), forgotten, cache=tmp_path)) == whole
    assert sum(MADE.values()) == 1


def other(clock, inputs, parameters):
    """Another function of the same file."""
    return {"y": 1.1 * plant(clock, inputs, parameters)["y"]}


def test_another_function_has_its_own_runs(forgotten, tmp_path):
    fit_model(model(), forgotten, cache=tmp_path)
    fit_model(model(other), forgotten, cache=tmp_path)
    folders = sorted(tmp_path.iterdir())
    assert len(folders) == 2

    def scaled(factor):
        return lambda *args: {"y": factor * plant(*args)["y"]}

    for factor in (1.0, 1.1, 1.1):  # the same source with other data
        fit_model(model(scaled(factor)), forgotten, cache=tmp_path)
    assert len([*tmp_path.iterdir()]) == 4
    stored = json.loads((folders[0] / "model.json").read_text())
    assert stored["names"]["inputs"] == ["u"]
    assert "sha256 of its source" in stored["function"][0]


def test_a_version_stands_for_the_source(forgotten, tmp_path):
    class Program:
        """A simulator that is a program: only its user knows when it changes."""

        def __init__(self, version):
            self.version, self.lock = version, threading.Lock()

        __call__ = staticmethod(plant)

    fit_model(model(Program("1")), forgotten, cache=tmp_path)
    MADE.clear()
    fit_model(model(Program("1")), forgotten, cache=tmp_path)
    assert not MADE
    fit_model(model(Program("2")), forgotten, cache=tmp_path)
    assert MADE
    nameless = Program(None)
    with pytest.raises(InvalidParameter, match=r"nothing identifies its function.*version"):
        running(model(nameless), cache=tmp_path)


def test_what_raises_is_not_kept(forgotten, tmp_path):
    broken = [True]

    def flaky(clock, inputs, parameters):
        if broken[0] and parameters["gain"] > 2.05:
            raise OSError("no license")
        return plant(clock, inputs, parameters)

    flaky.version = "1"
    with pytest.warns(RuntimeWarning, match="no license"):
        fit_model(model(flaky), forgotten, cache=tmp_path)
    broken[0] = False
    whole = told(fit_model(model(), forgotten))
    assert told(fit_model(model(flaky), forgotten, cache=tmp_path)) == whole


def test_the_command_line_keeps_runs(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("plant.py").write_text(
        "import numpy as np\n"
        "def model(time, inputs, parameters):\n"
        "    return {'y': parameters['gain'] * inputs['u'] + parameters['slip'] * time}\n"
    )
    random = np.random.default_rng(0)
    rows = [f"{t:.2f},{u:.6f},{2.1 * u + 1e-3 * random.standard_normal():.6f}"
            for t, u in zip(CLOCK, np.sin(7.0 * CLOCK), strict=True)]  # fmt: skip
    Path("run.csv").write_text("time [s],u,y [m]\n" + "\n".join(rows) + "\n")
    words = ["diagnose", "plant.py", "run.csv", "--parameter", "gain=2m±0.2m", "--unknown",
             "slip=m/s", "--cache", "runs", "--workers", "1"]  # fmt: skip
    shown = []
    for _ in range(2):
        with pytest.raises(SystemExit) as end:
            main(words)
        assert end.value.code == 0, capsys.readouterr().err
        shown.append(capsys.readouterr().out)
    first, second = shown
    answer, _, line = second.rstrip().rpartition("\n\n")
    assert answer == first.rstrip()
    number, total = line.split(" runs from the cache runs")[0].split(" of ")
    assert number == total


def test_idle_processes_have_ended_when_a_model_is_forgotten():
    """At the end of Python, a pool that was still closing its pipe raised an exception."""

    def rig(time, inputs, parameters):
        return {"y": parameters["a"] * time}

    model = Simulator(rig, parameters={"a": (1.0, 0.1, "1")}, inputs=(), outputs=("y",),
                                workers=2)  # fmt: skip
    clock = np.linspace(0.0, 1.0, 20)
    sensors = {"y": Sensor(name="y", unit="1", sigma=1e-3)}
    model.ready([Record(name="r", time=clock, inputs={}, outputs={"y": clock}, sensors=sensors)])
    thread = model._runner._pool._executor_manager_thread
    assert thread.is_alive()
    del model
    gc.collect()
    assert not thread.is_alive()
