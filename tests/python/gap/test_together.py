"""Simulations of several records in one go are those of each by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feltmb.errors import InvalidParameter
from feltmb.fit import Candidate, Effect, Jobs, Simulated, State, including
from feltmb.fit.together import each
from feltmb.gap import Coordinate, OdeModel, Parameter, Record, library

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


def test_all_that_is_asked_at_once_is_one_simulation() -> None:
    model = make_model()
    asked: list[int] = []
    plain = model.simulate_all

    def counted(batches):  # type: ignore[no-untyped-def]
        asked.append(len(batches))
        return plain(batches)

    model.simulate_all = counted  # type: ignore[method-assign]
    segments = [np.array([[0, 10], [10, 20], [20, r.samples - 1]]) for r in RECORDS]
    found = each(model, lambda m, i: m.guess(RECORDS[i], segments[i]), [0, 1, 2])
    assert asked == [3, 3, 3]
    for i, starts in enumerate(found):
        assert np.allclose(starts, model.guess(RECORDS[i], segments[i]), rtol=1e-13, atol=1e-16)


def test_who_asks_less_often_is_not_waited_for() -> None:
    model = make_model()
    segments = [np.array([[0, 10], [10, 20]][: 1 + i]) for i in range(2)]
    found = each(model, lambda m, i: m.guess(RECORDS[i], segments[i]).shape, [0, 1])
    assert found == [(1, 2), (2, 2)]


def test_a_model_that_includes_an_effect_asks_its_core() -> None:
    effect = library.viscous_friction(SLIDE, scale=0.1)
    model = including(make_model(), [effect], [0.3])
    segments = np.array([[0, 20], [20, 39]])
    found = each(model, lambda m, r: m.guess(r, segments), RECORDS)
    for r, starts in zip(RECORDS, found, strict=True):
        assert np.allclose(starts, model.guess(r, segments), rtol=1e-13, atol=1e-16)


def test_a_fault_is_raised_and_nobody_waits() -> None:
    bad = Effect(
        name="bad",
        component="slide",
        unit="N",
        scale=1.0,
        mechanism="Wrong.",
        rate=lambda t, x, u, p, size, shape: {"w": size},
    )
    model = make_model()

    def work(m: OdeModel, r: Record) -> int:
        own = jobs(r, Candidate(bad, None))
        m.simulate(
            r,
            Jobs(
                theta=own.theta,
                segments=own.segments,
                starts=own.starts[:, :2],
                included=own.included,
                magnitudes=own.magnitudes,
            ),
        )
        return 0

    with pytest.raises(InvalidParameter, match="'w', which is no state"):
        each(model, work, RECORDS)


@pytest.mark.parametrize("kind", [SystemExit, KeyboardInterrupt])
def test_an_exit_within_a_model_is_raised_and_nobody_waits(kind: type[BaseException]) -> None:
    def rates(*_: object) -> object:
        raise kind

    model = make_model(rates=rates)
    segments = np.array([[0, 10], [10, 20]])
    with pytest.raises(kind):
        each(model, lambda m, r: m.guess(r, segments), RECORDS)


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
