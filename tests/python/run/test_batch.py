"""Many strokes in one call: order, faults, memory by counting, independence of the threads."""

import gc
import threading
import weakref

import pytest

import feltmb
from feltmb.run.batch import simulate_many

SHORT = {"duration": 0.02, "output_rate": 500.0}


def pairs(pendulum, count):
    stroke = feltmb.pulse_stroke(2.0, 0.001, 0.01)
    for i in range(count):
        yield pendulum.with_values({"arm.mass": 0.020 + 1e-3 * i}), stroke


def test_outcomes_are_those_of_single_runs_for_any_number_of_threads(pendulum):
    alone = [
        feltmb.simulate(a, s, ledger=False, **SHORT).values.tobytes() for a, s in pairs(pendulum, 9)
    ]
    for jobs in (1, 2, 5):
        got = []

        def take(index, run, got=got):
            assert index == len(got)
            got.append(run.values.tobytes())

        assert simulate_many(pairs(pendulum, 9), take, jobs=jobs, **SHORT) == 9
        assert got == alone


def test_memory_does_not_grow_with_the_batch(pendulum):
    """Runs alive at once, and pairs asked for ahead, by count."""
    jobs, count = 2, 60
    alive = weakref.WeakSet()
    asked = 0
    ahead = []
    most = []

    def source():
        nonlocal asked
        for pair in pairs(pendulum, count):
            asked += 1
            yield pair

    def take(index, run):
        alive.add(run)
        gc.collect()
        most.append(len(alive))
        ahead.append(asked - index)

    gc.collect()
    gc.freeze()  # what other tests left need not be looked through at each run
    try:
        assert simulate_many(source(), take, jobs=jobs, **SHORT) == count
    finally:
        gc.unfreeze()
    assert max(most) <= 2
    assert max(ahead) <= 4 * jobs + 1


def test_faults_have_their_turn(pendulum):
    bad = feltmb.torque_stroke([0.0, 0.01], [0.0, 1.0])  # the pendulum has no motor
    good = feltmb.pulse_stroke(2.0, 0.001, 0.01)
    strokes = [(pendulum, s) for s in (bad, good, bad, good, bad)]
    got = []
    assert simulate_many(strokes, lambda i, outcome: got.append((i, outcome)), **SHORT) == 5
    assert [i for i, _ in got] == [0, 1, 2, 3, 4]
    assert [isinstance(outcome, feltmb.Run) for _, outcome in got] == [False, True] * 2 + [False]
    assert isinstance(got[0][1], feltmb.InvalidParameter)


def test_a_stroke_that_the_core_refuses_has_the_code_of_its_error(pendulum):
    got = []
    simulate_many(pairs(pendulum, 1), lambda _, outcome: got.append(outcome), rtol=1.0, **SHORT)
    assert got[0].code == "invalid_parameter"


def test_a_batch_stops_when_told(pendulum):
    got = []

    def take(index, run):
        assert isinstance(run, feltmb.Run)
        got.append(index)
        return len(got) < 3

    assert simulate_many(pairs(pendulum, 50), take, jobs=2, **SHORT) == 3
    assert got == [0, 1, 2]

    def fail(index, run):
        raise RuntimeError(f"no more after {index}: {run!r}")

    with pytest.raises(RuntimeError, match="no more"):
        simulate_many(pairs(pendulum, 5), fail, jobs=2, **SHORT)


def test_bad_arguments():
    with pytest.raises(feltmb.InvalidParameter, match="jobs"):
        simulate_many([], print, jobs=0)
    with pytest.raises(feltmb.InvalidParameter, match="progress"):
        simulate_many([], print, progress=print)


def test_with_values_shares_what_did_not_change(action):
    """A number is changed without checking the whole file again; faults are those of the file."""
    changed = action.with_values({"key.mass": 0.12})
    assert changed.config.bodies["jack"] is action.config.bodies["jack"]
    assert changed.config.bodies["key"].mass == pytest.approx(0.12)
    again = feltmb.Action(changed.raw, changed.origin)
    assert again.hash == changed.hash
    assert again.raw == changed.raw
    assert action.raw["bodies"]["key"]["mass"]["value"] != 0.12
    with pytest.raises(feltmb.InvalidParameter, match=r"bodies\.key\.mass"):
        action.with_values({"key.mass": -1.0})
    with pytest.raises(feltmb.InvalidParameter, match="leads into a quantity"):
        action.with_values({"key.mass.kg": 1.0})


def test_without_order_each_outcome_comes_as_soon_as_it_is_known(pendulum):
    """A long first stroke holds nothing up; all come once, with the bits of the ordered batch."""
    long = feltmb.pulse_stroke(2.0, 0.001, 0.01)
    strokes = [(pendulum, long, {"duration": 30.0}), *pairs(pendulum, 6)]
    got = {}
    count = simulate_many(
        strokes, got.__setitem__, jobs=2, ordered=False, **{**SHORT, "rtol": 1e-8}
    )
    assert count == 7
    assert list(got)[-1] == 0
    want = []
    simulate_many(strokes, lambda _, run: want.append(run), jobs=1, **{**SHORT, "rtol": 1e-8})
    assert [got[i].values.tobytes() for i in range(7)] == [w.values.tobytes() for w in want]
    assert want[0].time[-1] == 30.0  # options of one stroke alone


def test_a_flag_ends_a_batch_at_once(pendulum):
    stop = feltmb._core.StopFlag()
    timer = threading.Timer(0.3, stop.set)
    timer.start()
    forever = feltmb.pulse_stroke(2.0, 0.001, 0.01, duration=1e5)
    got = {}
    options = {"output_rate": 1.0, "ordered": False, "stop": stop}
    assert simulate_many([(pendulum, forever)] * 9, got.__setitem__, jobs=2, **options) == 0
    assert not got
    timer.join()


@pytest.mark.parametrize("stroke", ["forte", "piano"])
def test_a_run_for_its_summary_has_the_numbers_of_a_whole_one(action, stroke):
    options = {"rtol": 1e-5, "ledger": False}
    whole = feltmb.simulate(action, stroke, **options)
    quick = feltmb.simulate(action, stroke, summary_only=True, **options)
    assert quick.summary == pytest.approx(whole.summary, rel=1e-9)
    assert {"key_travel", "check_gap", "check_gap_swing"} <= set(quick.summary)
    assert quick.time[0] >= quick.time[-1] - 0.0103
    tail = whole.time >= quick.time[0]
    assert quick.values == pytest.approx(whole.values[tail], rel=1e-9, abs=1e-12)
    y = whole[f"{action.config.reading.key_point}.y"]
    assert whole.summary["key_travel"] == y[0] - y.min()
