"""What a model of one's own does between samples: steps of the integrator, run of the inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled import (
    Coordinate,
    Coupling,
    Equations,
    Options,
    Parameter,
    Record,
    Sensor,
    State,
    Verdict,
    diagnose,
    library,
)

NOISE = 1e-4
SLIDE = Coordinate(name="slide", position="q", speed="v", inertia="m")


def make_model(k: float = 400.0, **options: object) -> Equations:
    return Equations(
        name="slide",
        states=[
            State(name="q", unit="m", scale=0.01, start_sd=1e-3),
            State(name="v", unit="m/s", scale=0.2, start_sd=1e-2),
        ],
        parameters=[
            Parameter(name="m", value=1.02, sd=0.03, unit="kg", lower=0.1),
            Parameter(name="k", value=0.98 * k, sd=0.03 * k, unit="N/m", lower=1.0),
            Parameter(name="d", value=2.1, sd=0.3, unit="N s/m"),
        ],
        inputs=["f"],
        rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.d * x.v) / p.m),
        outputs={"q": "q"},
        coordinates=[SLIDE],
        **options,  # type: ignore[arg-type]
    )


def drive(t: object, i: int) -> object:
    """Six tones, the highest with eight samples a period."""
    tones = np.array([0.7, 1.9, 3.1, 4.6, 5.8, 6.2])
    phase = np.array([0.3, 1.1, 2.5, 0.9, 4.0, 5.2]) * (i + 1)
    return 4.0 * np.sum(np.sin(2.0 * np.pi * np.multiply.outer(t, tones) + phase), axis=-1)


def runs(
    held: str, k: float = 400.0, samples: int = 400, sigma: float | None = NOISE
) -> list[Record]:
    """Records of the true machine whose input is smooth, or straight between samples."""
    time = 0.02 * np.arange(samples)
    noise = np.random.default_rng(5)
    out = []
    for i in range(3):
        f = np.asarray(drive(time, i))

        def force(t: float, i: int = i, f: object = f) -> float:
            return float(drive(t, i)) if held == "smooth" else float(np.interp(t, time, f))  # type: ignore[arg-type]

        y = solve_ivp(
            lambda t, x, force=force: (
                x[1],
                force(t) - k * x[0] - 2.0 * x[1],
            ),
            (0.0, time[-1]), (0.0, 0.0), "LSODA", time, rtol=1e-9, atol=1e-11, max_step=0.02,
        ).y[0]  # fmt: skip
        out.append(
            Record(
                name=f"run {i}",
                time=time,
                inputs={"f": f},
                outputs={"q": y + NOISE * noise.standard_normal(samples)},
                sensors={"q": Sensor(name="q", unit="m", sigma=sigma)},
            )
        )
    return out


@pytest.mark.parametrize("held", ["smooth", pytest.param("straight", marks=pytest.mark.slow)])
def test_the_run_of_an_input_between_samples_is_estimated_and_is_no_cause(held: str) -> None:
    effects = [
        library.dry_friction(SLIDE, scale=0.5, speed=0.5),
        library.polynomial_stiffness(SLIDE, 3, scale=1e4),
        library.sensor_fault(["q"], "q", "gain"),
    ]
    model, records = make_model(), runs(held, samples=240)
    assert "between.f" in [p.name for p in model.ready(records).model.parameters]
    report = diagnose(model, effects, records)
    assert report.verdict is Verdict.CALIBRATED
    assert "between.f" not in report.unknowns  # it is no number of the machine
    assert report.worst.explained == pytest.approx(NOISE, rel=0.1)


def test_substeps_are_as_many_as_it_takes() -> None:
    found = {}
    for k in (40.0, 400.0, 1e4):
        ready = make_model(k=k).ready(runs("straight", k=k))
        assert ready.notes == ()
        found[k] = ready.model.substeps  # type: ignore[attr-defined]
    assert found[40.0] == 1
    assert found[400.0] > 1
    assert found[1e4] > 1  # though it hardly moves: one step a sample would not be stable
    told = make_model(k=1e4, substeps=1).ready(runs("straight", k=1e4))
    assert "substeps = 1: half the step changes the outputs by" in told.notes[0]
    assert told.model.substeps == 1  # type: ignore[attr-defined]


@pytest.mark.parametrize("sigma", [NOISE, None])
def test_what_is_ready_comes_back_as_it_is(sigma: float | None) -> None:
    records = runs("smooth", sigma=sigma)
    ready = make_model().ready(records)
    assert [p.name for p in ready.model.parameters] == ["m", "k", "d", "between.f"]
    assert ready.model.ready(records).model is ready.model


def test_a_clearance_between_two_masses_is_named() -> None:
    """Backlash of a shaft between motor and load, which no force on one of them could be."""
    inertia, load, k, d, gap = 0.01, 0.02, 40.0, 0.03, 0.006
    motor = Coordinate(name="motor", position="a", speed="v", inertia=inertia, unit="N m")
    wheel = Coordinate(name="load", position="b", speed="w", inertia=load, unit="N m")
    shaft = Coupling(name="shaft", first=motor, second=wheel, unit="N m")
    time = 0.004 * np.arange(500)
    noise = np.random.default_rng(8)
    records = []
    for i in range(3):
        torque = np.asarray(drive(time, i)) * (0.08 + 0.02 * i)

        def rates(t: float, x: object, i: int = i) -> tuple[float, ...]:
            twist, turning = x[0] - x[1], x[2] - x[3]  # type: ignore[index]
            inner = k * (twist - np.clip(twist, -gap, gap)) + 0.02 * turning
            push = float(drive(t, i)) * (0.08 + 0.02 * i)
            return (
                x[2],  # type: ignore[index]
                x[3],  # type: ignore[index]
                (push - inner - d * x[2]) / inertia,  # type: ignore[index]
                (inner - d * x[3]) / load,  # type: ignore[index]
            )

        y = solve_ivp(rates, (0.0, time[-1]), np.zeros(4), t_eval=time, rtol=1e-8, atol=1e-10,
                      max_step=0.002).y  # fmt: skip
        sigma = 2e-4
        records.append(
            Record(
                name=f"run {i}",
                time=time,
                inputs={"T": torque},
                outputs={
                    "a": y[0] + sigma * noise.standard_normal(time.size),
                    "b": y[1] + sigma * noise.standard_normal(time.size),
                },
                sensors={n: Sensor(name=n, unit="rad", sigma=sigma) for n in "ab"},
            )
        )
    model = Equations(
        name="drive",
        states=[State(name=n, unit="rad", scale=0.1, start_sd=1e-3) for n in "ab"]
        + [State(name=n, unit="rad/s", scale=2.0, start_sd=1e-2) for n in "vw"],
        parameters=[
            Parameter(name="k", value=41.0, sd=1.5, unit="N m/rad", lower=1.0),
            Parameter(name="d", value=0.031, sd=0.002, unit="N m s/rad"),
        ],
        inputs=["T"],
        rates=lambda t, x, u, p: (
            x.v,
            x.w,
            (u.T - p.k * (x.a - x.b) - 0.02 * (x.v - x.w) - p.d * x.v) / inertia,
            (p.k * (x.a - x.b) + 0.02 * (x.v - x.w) - p.d * x.w) / load,
        ),
        outputs={"a": "a", "b": "b"},
        coordinates=[motor, wheel, shaft],
    )
    effects = [
        library.backlash(shaft, stiffness=40.0, travel=0.04),
        library.polynomial_stiffness(shaft, 3, scale=1e4),
        library.dry_friction(shaft, scale=0.05, speed=1.0),
        library.dry_friction(motor, scale=0.05, speed=3.0),
        library.dry_friction(wheel, scale=0.05, speed=3.0),
        library.viscous_friction(shaft, scale=0.01),
    ]
    report = diagnose(model, effects, records, options=Options(good_enough={"rad": 1e-3}))
    (found,) = report.named
    assert found.cause == "dead zone shaft"
    assert abs(found.magnitude - 40.0) < 2.0
    assert isinstance(found.shape, float)
    assert abs(found.shape - gap) < 0.05 * gap
    assert report.worst.explained < 0.1 * report.worst.calibrated


def test_the_steps_are_fine_enough_for_sensors_that_do_not_state_their_noise() -> None:
    stated = runs("straight", k=4e3, samples=100)
    records = [replace(r, sensors={"q": Sensor(name="q", unit="m")}) for r in stated]
    found, known = (make_model(k=4e3).ready(r).model for r in (records, stated))
    assert found.substeps == known.substeps > 1  # type: ignore[attr-defined]
