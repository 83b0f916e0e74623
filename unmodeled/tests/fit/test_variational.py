"""Derivatives of a model of one's own from its variational equations, against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Coordinate, Effect, Equations, Parameter, Rate, Record, Sensor, State, library
from unmodeled.fit.observe import observed_sensitivities
from unmodeled.models import Candidate
from unmodeled.models.model import Batch, SensitivityRequest, difference_sensitivities

SLIDE = Coordinate(name="slide", position="q", speed="v", inertia="m")
TRUTH = np.array([1.0, 90.0, 0.0])
TIME = np.cumsum(np.r_[0.0, np.tile([3e-3, 5e-3, 4e-3], 40)])


def rates(_, x, u, p):
    return x.v, (u.f - p.k * x.q - p.d * x.v - 0.2 * np.tanh(x.v / 0.02)) / p.m


def make_model(**options: object) -> Equations:
    options = {"rates": rates, "inputs": ["f"], **options}
    return Equations(
        name="slide",
        states=[
            State(name="q", unit="m", scale=0.01),
            State(name="v", unit="m/s", scale=0.1),
        ],
        parameters=[
            Parameter(name="m", value=1.0, sd=0.1, lower=0.1),
            Parameter(name="k", value=90.0, sd=10.0, lower=1.0, upper=90.0),
            Parameter(name="d", value=0.5, sd=0.3, lower=0.0),
        ],
        outputs={
            "q": "q",
            "a": Rate("v"),
            "power": lambda t, x, u, p: x.v * (u.f + p.d * x.v),
        },
        coordinates=[SLIDE],
        **options,  # type: ignore[arg-type]
    )


def record(name: str, amplitude: float) -> Record:
    force = amplitude * (np.sin(9.0 * TIME) + np.sin(23.0 * TIME + 1.0))
    return Record(
        name=name,
        time=TIME,
        inputs={"f": force},
        outputs={"q": np.where(np.arange(TIME.size) % 7, 0.01, np.nan)},
        sensors={"q": Sensor(name="q", unit="m", sigma=1e-4, delay=0.002, gain=1.1)},
    )


def fine(effect: Effect) -> Effect:
    """With a small step, so that the error of its differences is small."""
    return replace(effect, step=1e-4)


DRY = fine(library.dry_friction(SLIDE, scale=0.3, speed=1.0))
SLIP = fine(library.hysteresis(SLIDE, scale=0.3, travel=0.04))
CREEP = fine(library.creep(SLIDE, scale=9.0, travel=0.1, times=(0.05, 0.5)))
DRAG = fine(library.quadratic_friction(SLIDE, scale=2.0))
PLAIN = tuple(Candidate(e, s) for e in (DRY, DRAG, SLIP, CREEP) for s in e.shapes)
NUMBERS = ("d_theta", "d_magnitudes", "d_starts", "d_candidates", "d_inputs")


def request(one: Record, included: tuple[Candidate, ...] = (), **fields: object):
    states = 2 + sum(len(t.effect.hidden) for t in included)
    return SensitivityRequest(
        one,
        TRUTH,
        0.01 * np.arange(1, states + 1) / states,
        included,
        np.array([0.5 * t.effect.scale for t in included]),
        **fields,  # type: ignore[arg-type]
    )


def differing(ours: list, theirs: list) -> dict[str, float]:
    """Largest difference of a column of derivatives, relative to its norm, per output."""
    found = {}
    for s, d in zip(ours, theirs, strict=True):
        assert np.allclose(s.outputs, d.outputs, rtol=1e-12, atol=1e-15)
        for name in NUMBERS:
            one, other = getattr(s, name), getattr(d, name)
            assert one.shape == other.shape, name
            axes = tuple(range(other.ndim - 2)) or (0,)
            size = np.sqrt(np.sum(other**2, axis=axes))
            error = np.sqrt(np.sum((one - other) ** 2, axis=axes))
            large = size > 1e-9 * np.max(size, initial=0.0)
            share = error[large] / size[large]
            found[name] = max(found.get(name, 0.0), float(np.max(share, initial=0.0)))
    return found


def both(monkeypatch: pytest.MonkeyPatch, model: Equations, requests: list) -> dict[str, float]:
    """Differences between the derivatives of the model and differences with small steps."""
    model.difference_step = 1e-4
    with monkeypatch.context() as patch:
        for place in ("models.model", "ode.batch"):  # it is not needed
            patch.setattr(f"unmodeled.{place}.difference_sensitivities", None)
        ours = observed_sensitivities(model, requests)
    with monkeypatch.context() as patch:
        patch.setattr(Equations, "sensitivities", difference_sensitivities)
        theirs = observed_sensitivities(model, requests)
    return differing(ours, theirs)


CHANGE = {"f": 0.01 * np.sin(40.0 * TIME)}


@pytest.mark.parametrize(("method", "substeps"), [("rk4", 1), ("rk4", 3), ("rosenbrock", 2)])
def test_derivatives_agree_with_small_differences(monkeypatch, method, substeps):
    model = make_model(method=method, substeps=substeps)
    cases = [
        request(record("a", 0.6), candidates=PLAIN, input_changes=(CHANGE,)),
        request(record("b", 1.0), (Candidate(DRAG), Candidate(SLIP, (0.008, 2.0))), by_theta=[2]),
        request(record("c", 1.0), (Candidate(CREEP, 0.5),), by_starts=False, candidates=PLAIN[:3]),
    ]
    found = both(monkeypatch, model, cases)
    # Those of ROS2 have its order, not its errors.
    assert max(found.values()) < (1e-3 if method == "rk4" else 0.02), found


@pytest.mark.parametrize("hold", ["linear", "zero", "spline", "between"])
def test_inputs_are_differentiated_as_they_are_held(monkeypatch, hold):
    model = make_model(hold="auto" if hold == "between" else hold)
    if hold == "between":  # as after a fit could detect the difference
        model.hold = "between"
        model.parameters = (
            *model.parameters,
            Parameter(name="between.f", value=0.5, sd=0.5, lower=-1.0, upper=2.0),
        )
    one = record("a", 0.6)
    effects = (
        *library.for_input("f", one, unit="N"),
        *library.for_sensor(model.outputs, "q", one),
    )
    everything = tuple(Candidate(fine(e), e.shapes[0]) for e in effects)
    by_step = [Candidate(e.effect, e.shape) for e in everything if e.effect.excite is not None]
    theta = np.append(TRUTH, 0.4)[: len(model.parameters)]
    wanted = replace(
        request(one, (by_step[2],), candidates=everything, input_changes=(CHANGE,)), theta=theta
    )
    found = both(monkeypatch, model, [wanted])
    assert max(found.values()) < 1e-3, found


def test_a_rate_that_jumps_is_differentiated_by_differences():
    """The derivative of np.sign is zero almost everywhere; the friction holds the mass."""
    model = make_model(rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - 0.6 * np.sign(x.v)) / p.m))
    requests = [request(record("a", 0.3), candidates=PLAIN[:2])]
    (ours,), (theirs,) = model.sensitivities(requests), difference_sensitivities(model, requests)
    for name in NUMBERS[:4]:
        assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name


def test_a_subclass_with_its_own_simulation_is_differentiated_by_differences():
    class Doubled(Equations):
        def simulate(self, record, jobs):
            return 2.0 * super().simulate(record, jobs)

    plain = make_model()
    double = make_model()
    double.__class__ = Doubled
    requests = [request(record("a", 0.8))]
    (one,), (two,) = plain.sensitivities(requests), double.sensitivities(requests)
    assert np.allclose(two.d_theta, 2.0 * one.d_theta, atol=1e-4 * np.abs(one.d_theta).max())


def test_jobs_with_different_effects_are_integrated_together():
    model, batches = make_model(), []
    for k, included in enumerate([(), PLAIN[2:4], (), PLAIN[3:4], PLAIN[-1:], PLAIN[2:4]]):
        one = request(record(f"r{k}", 0.2 + 0.2 * k), tuple(included))
        batch: Batch = (one.record, one.jobs())
        batches.append(batch)
    together = model.simulate_all(batches)
    for (one, jobs), run in zip(batches, together, strict=True):
        alone = model.simulate(one, jobs)
        assert np.allclose(run, alone, rtol=1e-12, atol=1e-15)


def test_shapes_that_a_rate_cannot_take_as_arrays_are_integrated_one_by_one(monkeypatch):
    def rate(_t, x, _u, _p, size, shape):
        tau = shape if shape > 0.1 else 2.0 * shape  # fails with an array
        return {"v": -size * (x.q - x.z), "z": (x.q - x.z) / tau}

    own = Effect(
        name="own", component="c", rate=rate, shapes=(0.05, 0.2), step=1e-4, sign=1,
        hidden=(State(name="z", hidden=True),),
    )  # fmt: skip
    wanted = request(record("a", 0.8), candidates=tuple(Candidate(own, s) for s in own.shapes))
    found = both(monkeypatch, make_model(), [wanted])
    assert max(found.values()) < 1e-3, found


def test_a_failed_record_does_not_spoil_the_others():
    model = make_model(
        rates=lambda t, x, u, p: (x.v, np.where(x.q > 5.0, np.nan, (u.f - p.k * x.q) / p.m))
    )
    good = request(record("a", 0.8), candidates=PLAIN)
    bad = replace(good, start=np.array([6.0, 0.0]))
    ours, failed = model.sensitivities([good, bad])
    (alone,) = model.sensitivities([good])
    assert np.isnan(failed.outputs[-1, 0])
    for name in NUMBERS[:4]:
        assert np.allclose(getattr(ours, name), getattr(alone, name), atol=1e-12), name


def test_the_rates_are_called_to_be_traced_and_never_again():
    """For their inputs and coordinates, with symbols, and twice at the points of comparison."""
    calls = []

    def counted(t, x, u, p):
        calls.append(1)
        return rates(t, x, u, p)

    model = make_model(rates=counted)
    model.sensitivities([request(record("a", 0.6), candidates=PLAIN)])
    once = len(calls)
    model.sensitivities([request(record("b", 0.8), (Candidate(DRAG),), candidates=PLAIN)])
    assert len(calls) == once <= 60
