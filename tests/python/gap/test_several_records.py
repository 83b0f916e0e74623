"""All records of a fit are simulated in one call, with the same results as one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feltmb.errors import InvalidParameter
from feltmb.fit import Candidate, Jobs, Simulated, State, including
from feltmb.fit.model import Batch
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import chained
from feltmb.gap import Coordinate, OdeModel, Parameter, Record, Sensor, library

SLIDE = Coordinate(name="slide", position="q", speed="v", inertia="m")


def make_model(of: type[OdeModel] = OdeModel, **options: object) -> OdeModel:
    rates = options.pop("rates", lambda t, x, u, p: (x.v, (u.f - 50.0 * x.q - 0.4 * x.v) / p.m))
    return of(
        states=[State(name="q", unit="m", scale=0.01), State(name="v", unit="m/s", scale=0.1)],
        parameters=[Parameter(name="m", value=1.0, sd=0.1)],
        inputs=["f"],
        rates=rates,  # type: ignore[arg-type]
        outputs={"q": "q"},
        coordinates=[SLIDE],
        **options,  # type: ignore[arg-type]
    )


def record(name: str, samples: int, pitch: float) -> Record:
    time = np.linspace(0.0, 0.01 * (samples - 1), samples)
    return Record(
        name=name, time=time, inputs={"f": np.sin(pitch * time)}, outputs={"q": np.zeros(samples)}
    )


RECORDS = [record("slow", 120, 2.0), record("fast", 90, 9.0), record("short", 40, 5.0)]


def jobs(r: Record, candidate: Candidate) -> Jobs:
    half = r.samples // 2
    return Jobs(
        theta=np.array([[1.0], [1.1]]),
        segments=np.array([[0, half], [half, r.samples - 1]]),
        starts=np.array([[0.01, 0.0, 0.0], [0.0, 0.1, 0.002]]),
        included=(candidate,),
        magnitudes=np.array([[0.2], [0.4]]),
    )


@pytest.mark.parametrize("hold", ["linear", "zero", "spline"])
def test_records_together_are_records_one_by_one(hold: str) -> None:
    model = make_model(hold=hold)
    candidate = Candidate(library.hysteresis(SLIDE, scale=0.1, travel=0.02), (0.002, 2.0))
    batches = [(r, jobs(r, candidate)) for r in RECORDS]
    for one, (r, own) in zip(model.simulate_all(batches), batches, strict=True):
        alone = model.simulate(r, own)
        assert one.outputs.shape == alone.outputs.shape
        assert np.allclose(one.outputs, alone.outputs, rtol=1e-13, atol=1e-16)
        assert np.allclose(one.ends, alone.ends, rtol=1e-13, atol=1e-16)


class Counted(OdeModel):
    """Records the number of batches of each call of ``simulate_all``."""

    def __init__(self, **options: object) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self.calls: list[int] = []

    def simulate_all(self, batches: Sequence[Batch]) -> list[Simulated]:
        self.calls.append(len(batches))
        return super().simulate_all(batches)


HYSTERESIS = Candidate(library.hysteresis(SLIDE, scale=0.1, travel=0.02), (0.002, 2.0))
FRICTION = Candidate(library.viscous_friction(SLIDE, scale=0.1))
DELAY = Candidate(library.delay_input("f", scale=1e-3))


def problem_of(model: OdeModel, records: list[Record], **options: Any) -> Problem:
    """Records with two, three and four segments."""
    segmented = []
    for i, r in enumerate(records):
        edges = np.array([0, 10, 20, 30][: i + 2] + [r.samples - 1])
        own = np.column_stack([edges[:-1], edges[1:]])
        segmented.append(segment_record(model, r, {"q": Noise(1e-3)}, None, own))
    return Problem(model, tuple(segmented), **options)


def same(one: Any, other: Any) -> bool:
    """Whether all arrays of two results are equal except for rounding."""
    return all(
        np.allclose(a, b, rtol=1e-12, atol=1e-15)
        for a, b in zip(vars(one).values(), vars(other).values(), strict=True)
        if isinstance(a, np.ndarray)
    )


def test_start_states_of_all_records_take_one_call_per_segment() -> None:
    model = make_model(of=Counted)
    problem = problem_of(model, RECORDS)
    point = problem.start()
    assert model.calls == [3, 2, 1]  # the last segment of a record gives no start state
    for i, place in enumerate(point.places):
        alone = replace(problem, segmented_records=problem.segmented_records[i : i + 1])
        assert same(place, alone.start().places[0])
    model.calls.clear()
    carried = problem.carry(point, (HYSTERESIS,), np.array([0.1]))
    assert model.calls == [3, 2, 1]
    assert all(np.any(p.starts[1:, 2]) for p in carried.places)
    model.calls.clear()
    closed = chained(problem.with_candidates((HYSTERESIS,)), carried)
    assert model.calls == [3, 2, 1]
    assert all(
        np.any(c.starts != p.starts) for c, p in zip(closed.places, carried.places, strict=True)
    )


def test_a_prediction_takes_one_call() -> None:
    model = make_model(of=Counted)
    problem = problem_of(model, RECORDS)
    point = problem.start()
    model.calls.clear()
    seen = problem.predict(point)
    assert model.calls == [3]
    for i, found in enumerate(seen):
        alone = replace(problem, segmented_records=problem.segmented_records[i : i + 1])
        own = alone.predict(replace(point, places=point.places[i : i + 1]))[0]
        assert all(np.array_equal(a, b) for a, b in zip(found, own, strict=True))


def test_a_linearization_takes_as_many_calls_for_several_records_as_for_one() -> None:
    """Rounds: point, candidates, candidates with hidden states, inputs with both signs."""
    model = make_model(of=Counted)
    noisy = [replace(r, input_sigma={"f": 0.1}) for r in RECORDS]
    problem = problem_of(model, noisy)
    point = problem.start()
    candidates = (FRICTION, HYSTERESIS, DELAY)
    model.calls.clear()
    linears = problem.linear(point, candidates)
    assert model.calls == [3, 3, 3, 3, 2, 1, 3 * 2 * (1 + 6)]
    for i, linear in enumerate(linears):
        alone = replace(problem, segmented_records=problem.segmented_records[i : i + 1])
        own = alone.linear(replace(point, places=point.places[i : i + 1], memo={}), candidates)
        assert same(linear, own[0])


def test_one_record_with_another_sensor_changes_no_other_record() -> None:
    model = make_model()
    late = replace(RECORDS[1], sensors={"q": Sensor(name="q", sigma=1e-3, delay=2e-3)})
    plain = problem_of(model, RECORDS)
    problem = problem_of(model, [RECORDS[0], late, RECORDS[2]])
    point = problem.start()
    one, other = (
        plain.linear(point, (FRICTION,)),
        problem.linear(replace(point, memo={}), (FRICTION,)),
    )
    assert same(one[0], other[0])
    assert same(one[2], other[2])
    assert not np.allclose(one[1].residual, other[1].residual)


def test_a_model_that_includes_an_effect_simulates_all_records_in_one_call() -> None:
    base = make_model(of=Counted)
    model = including(base, [library.viscous_friction(SLIDE, scale=0.1)], [0.3])
    segments = [np.array([[0, 20], [20, 39]])] * 3
    starts = model.guess(RECORDS, segments)
    assert base.calls == [3]
    for r, own, found in zip(RECORDS, segments, starts, strict=True):
        assert np.allclose(found, model.guess([r], [own])[0], rtol=1e-13, atol=1e-16)


def test_the_error_of_the_first_record_is_raised() -> None:
    class OneByOne(OdeModel):
        def simulate(self, record: Record, jobs: Jobs) -> Simulated:
            if record.name != "slow":
                raise InvalidParameter(f"cannot simulate {record.name}")
            return super().simulate(record, jobs)

    model = make_model(of=OneByOne)
    segments = [np.array([[0, 10], [10, 20]])] * 3
    with pytest.raises(InvalidParameter, match="cannot simulate fast"):
        model.guess(RECORDS, segments)


def test_a_subclass_with_a_simulation_of_its_own_is_asked_for_it() -> None:
    class Doubled(OdeModel):
        def simulate(self, record: Record, jobs: Jobs) -> Simulated:
            run = super().simulate(record, jobs)
            return Simulated(outputs=2.0 * run.outputs, ends=run.ends)

    candidate = Candidate(library.viscous_friction(SLIDE, scale=0.1))
    batches = [
        (r, replace(jobs(r, candidate), starts=jobs(r, candidate).starts[:, :2])) for r in RECORDS
    ]
    plain, doubled = make_model(), make_model(of=Doubled)
    for one, other in zip(plain.simulate_all(batches), doubled.simulate_all(batches), strict=True):
        assert np.array_equal(2.0 * one.outputs, other.outputs, equal_nan=True)
