"""The steps of the search by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Effect, Equations, Record, Sensor, State
from unmodeled.search.evidence import best_of, log_odds
from unmodeled.search.fit import Start, empty_point, fit_local, fit_sets, run_in_lockstep
from unmodeled.search.options import Options
from unmodeled.search.progress import Stop
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.search import _keep_smaller, search

from . import models
from .conftest import spring_record

LAWS = {"sides": lambda x: np.tanh(60.0 * x), "wave": lambda x: 0.15 * np.cos(70.0 * x)}


def decoy(x):
    """Nearly the sum of both."""
    return 0.97 * LAWS["sides"](x) + LAWS["wave"](x) + 0.04 * np.sin(90.0 * x)


def law(name, force):
    return Effect(
        name=name, component="spring", unit="N", scale=1.0,
        regressor=lambda r, _: force(r.inputs["x"]),
    )  # fmt: skip


def test_a_law_that_nearly_is_the_sum_of_two_is_no_answer(spring):
    """It is the best single one; beside the first of the two, the second is better."""
    record = spring_record("fit", 2, seed=5)
    x = record.inputs["x"]
    total = sum(f(x) for f in LAWS.values())
    record = replace(record, outputs={"force": record.outputs["force"] + total})
    effects = [law("decoy", decoy), *(law(n, f) for n, f in LAWS.items())]
    problem = prepare(ready_records(spring, [record]), effects, (), Options())
    found = search(problem, Options(max_effects=2))
    best = best_of(problem, list(found.sets.values()))
    assert {problem.causes[i].name for i in best.causes} == {*LAWS}


def test_a_fit_goes_on_where_the_noise_changes_little_unless_it_is_rough():
    """Dry friction that the model lacks."""
    records = [models.record(n, a, k, samples=300, dry=0.2) for k, (n, a) in
               enumerate((("soft", 0.5), ("hard", 1.0)), 3)]  # fmt: skip
    problem = prepare(ready_records(models.NOMINAL, records), (), (), Options())
    start = Start((), (empty_point(problem, (), problem.fit),))
    (whole,), (rough,) = fit_sets(problem, [start]), fit_sets(problem, [start], rough=True)
    assert log_odds(problem, whole, rough) > 1.0
    assert np.abs(np.log(whole.noise / rough.noise)).max() < 0.2


@pytest.mark.parametrize("seed", [2, 15, 35])
def test_a_member_is_exchanged_for_the_one_that_acts(spring, seed, monkeypatch):
    """The best single law is not among the two that act, and no pair is tried."""
    monkeypatch.setattr("unmodeled.search.search.pairs", lambda *_: [])
    mix = np.random.default_rng(seed).standard_normal((4, 4))

    def force(x, row):
        return sum(a * np.sin((3.0 + 2.0 * k) * x / 0.1 + k) for k, a in enumerate(row))

    record = spring_record("fit", 2)
    total = sum(force(record.inputs["x"], row) for row in mix[:2])
    record = replace(record, outputs={"force": record.outputs["force"] + total})
    effects = [law(str(i), lambda x, row=row: force(x, row)) for i, row in enumerate(mix)]
    problem = prepare(ready_records(spring, [record]), effects, (), Options())
    found = search(problem, Options(max_effects=2))
    assert best_of(problem, list(found.sets.values())).causes == (0, 1)


def test_a_start_whose_full_step_is_too_long_is_fitted_by_shorter_ones():
    """Newton's method leaves the zero of arctan(5 q) from q = 0.6."""
    model = Equations(
        name="rest",
        states=[State(name="q", unit="m", scale=1.0, start=0.6, start_sd=1.0)],
        parameters=[],
        rates=lambda t, x, u, p: (0.0 * x.q,),
        outputs={"y": lambda t, x, u, p: np.arctan(5.0 * x.q)},
    )
    time = np.linspace(0.0, 1.0, 20)
    noise = 0.01 * np.random.default_rng(0).standard_normal(20)
    record = Record(
        name="r", time=time, inputs={}, outputs={"y": noise},
        sensors={"y": Sensor(name="y", unit="1", sigma=0.01)},
    )  # fmt: skip
    problem = prepare(ready_records(model, [record]), (), (), Options())
    start, one = empty_point(problem, (), problem.fit), np.ones(1)
    run = fit_local(problem, problem.fit, (), start, one, one, rounds=20)
    (found,) = run_in_lockstep(problem, [run])
    assert 0.6 + found.point.local[0][0] == pytest.approx(0.0, abs=0.01)


def test_at_the_limit_a_smaller_set_may_have_the_parameters_of_the_larger_one(spring, causes):
    """A cause is not needed because the fit without it is a bad one."""
    records = [spring_record(f"r{k}", 2 + k, seed=k, hardening=2000.0) for k in range(3)]
    problem = prepare(ready_records(spring, records), causes, (), Options())
    found = search(problem, Options())
    alone, now = found.sets[()], found.ranked()[0][0]
    assert now.members
    found.sets = {(): replace(alone, noise=1e3 * alone.noise), now.causes: now}
    _keep_smaller(found)
    assert found.sets[()].point.x == pytest.approx(now.point.x[: len(problem.free)])
    assert np.all(found.sets[()].noise < 1e3 * alone.noise)


def test_at_the_limit_of_time_the_search_looks_at_smaller_sets(spring, causes, monkeypatch):
    def late(*_):
        raise Stop("late")

    looked = []
    monkeypatch.setattr("unmodeled.search.search._Climb.run", late)
    monkeypatch.setattr("unmodeled.search.search._keep_smaller", looked.append)
    problem = prepare(ready_records(spring, [spring_record("r", 2)]), causes, (), Options())
    found = search(problem, Options())
    assert looked == [found]
    assert isinstance(found.ended_by, Stop)
