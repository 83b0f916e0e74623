"""Laws that the library does not have, from a simulator of their own, are told in its words."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from feltmb.data import Record, Sensor
from feltmb.fit import Parameter, State
from feltmb.gap import Coordinate, OdeModel, Verdict, diagnose, library

STEP, COUNT, NOISE = 0.005, 800, 1e-4
SLIDE = Coordinate(name="slide", position="q", speed="v", inertia="m")
NOMINAL = OdeModel(
    name="slide",
    states=[
        State(name="q", unit="m", scale=0.02, start_sd=1e-3),
        State(name="v", unit="m/s", scale=0.3, start_sd=0.01),
    ],
    parameters=[
        Parameter(name="m", value=1.0, sd=0.05, unit="kg", lower=0.0),
        Parameter(name="k", value=400.0, sd=20.0, unit="N/m"),
        Parameter(name="c", value=4.0, sd=0.4, unit="N s/m", lower=0.0),
    ],
    inputs=["f"],
    rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.c * x.v) / p.m),
    outputs={"q": "q"},
    coordinates=[SLIDE],
)


def records(seed, force, memory):
    """Mass, spring and damper with a force (v, z) against the motion and a memory dz/dt (v, z)."""
    random = np.random.default_rng(seed)
    time = np.arange(COUNT) * STEP
    out = []
    for i, strength in enumerate((5.0, 4.0, 6.0, 5.0)):
        frequency, phase = random.uniform(0.3, 6.0, 25), random.uniform(0.0, 2.0 * np.pi, 25)
        drive = np.sin(2.0 * np.pi * frequency[:, None] * time + phase[:, None]).sum(axis=0)
        drive *= np.minimum(1.0, time / 0.2)
        drive *= strength / np.sqrt(np.mean(drive**2))

        def rates(t, x, drive=drive):
            q, v, z = x
            push = np.interp(t, time, drive)
            return [v, (push - 390.0 * q - 4.2 * v - force(v, z)) / 1.03, memory(v, z)]

        run = solve_ivp(
            rates, (0.0, time[-1]), [0.0] * 3, "LSODA", time, rtol=1e-8, atol=1e-10, max_step=0.01
        )
        out.append(
            Record(
                name=f"run {i + 1}",
                time=time,
                inputs={"f": drive},
                outputs={"q": run.y[0] + NOISE * random.standard_normal(COUNT)},
                sensors={"q": Sensor(name="q", unit="m", sigma=NOISE)},
            )
        )
    return out


def diagnosed(runs):
    effects = library.standard_effects(
        ["q"], ["f"], [SLIDE], runs[0], force=8.0, travel=0.03, speed=0.5
    )
    return diagnose(NOMINAL, effects, runs, ["run 4"])


@pytest.mark.slow
def test_hysteresis_of_bouc_and_wen_is_found_with_its_width_and_roundness():
    report = diagnosed(
        records(
            31,
            lambda v, z: z,
            lambda v, z: v / 0.004 * (1.0 - z**2 * (0.5 * np.sign(v * z) + 0.5)),
        )
    )
    assert report.verdict is Verdict.NAMED
    assert report.named == ("hysteresis slide",)
    found = report.which["hysteresis slide"]
    assert found.magnitude == pytest.approx(1.0, rel=0.03)
    assert found.shape == pytest.approx((0.004, 2.0), rel=0.15)
    assert report.how_far.closed > 0.97


@pytest.mark.slow
def test_friction_with_presliding_is_friction_and_hysteresis():
    # LuGre: bristles of 2000 N/m, 0.8 N at rest and 0.5 N in motion.
    def slip(v, z):
        return v - 2000.0 * abs(v) / (0.5 + 0.3 * np.exp(-((v / 0.02) ** 2))) * z

    report = diagnosed(records(41, lambda v, z: 2000.0 * z + 2.0 * slip(v, z), slip))
    assert "dry friction slide" in report.named
    assert set(report.named) <= {"dry friction slide", "hysteresis slide"}
    assert report.how_far.closed > 0.85
