"""The same input gives the same bits: again, in threads, after pickling, from a written file."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import feltmb


@pytest.fixture(scope="module")
def action(rigid):
    """Rigid members: these tests are not about the members."""
    return rigid


def same(a, b):
    return (
        np.array_equal(a.values, b.values)
        and np.array_equal(a.eta, b.eta)
        and a.summary == b.summary
        and a.event_table == b.event_table
        and {k: v for k, v in a.stats.items() if k not in ("wall", "time")}
        == {k: v for k, v in b.stats.items() if k not in ("wall", "time")}
    )


def test_twice(action):
    assert same(feltmb.simulate(action, "forte"), feltmb.simulate(action, "forte"))


def test_twice_with_flexible_members():
    action = feltmb.load_action("steinway45")
    first = feltmb.simulate(action, "forte", duration=0.15)
    assert same(first, feltmb.simulate(action, "forte", duration=0.15))


def test_fresh_objects(action):
    other = feltmb.Action(action.raw)
    assert same(feltmb.simulate(action, "piano"), feltmb.simulate(other, "piano"))


def test_in_threads(action):
    """One action, shared by threads that run at the same time."""
    fresh = feltmb.Action(action.raw)
    strokes = ["piano", "forte", "staccato", "forte", "piano", "staccato"]
    with ThreadPoolExecutor(3) as pool:
        runs = list(pool.map(lambda s: feltmb.simulate(fresh, s), strokes))
    for stroke, run in zip(strokes, runs, strict=True):
        assert same(run, feltmb.simulate(action, stroke))


def test_after_pickling_and_from_a_file(action, tmp_path):
    run = feltmb.simulate(action, "forte")
    copied = pickle.loads(pickle.dumps(action))
    assert same(run, feltmb.simulate(copied, "forte"))
    path = tmp_path / "again.toml"
    path.write_text(action.to_toml(), encoding="utf-8")
    assert same(run, feltmb.simulate(feltmb.load_action(path), "forte"))


def test_sampling_does_not_change_the_motion(action):
    coarse = feltmb.simulate(action, "forte", output_rate=1000.0)
    fine = feltmb.simulate(action, "forte", output_rate=10000.0)
    assert np.array_equal(coarse.values, fine.values[::10])
    assert np.array_equal(coarse.end_state, fine.end_state)


def test_events_do_not_change_the_motion(action):
    with_events = feltmb.simulate(action, "forte")
    without = feltmb.simulate(action, "forte", events=False)
    assert np.array_equal(with_events.values, without.values)
    assert len(without.events) == 0
