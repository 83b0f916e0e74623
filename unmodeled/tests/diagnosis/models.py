"""Models of the tests: a line, and a small oscillator with and without what it lacks."""

import numpy as np

from unmodeled import Coordinate, Effect, Equations, LinearModel, Parameter, Record, Sensor, State
from unmodeled.models import Candidate, Jobs


def line(sd):
    """The output y is the input x times a slope of 1 with this prior standard deviation."""
    return LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="slope", value=1.0, sd=sd)],
        name="line",
    )


MASS = Coordinate(name="mass", position="q", speed="v", inertia="m")
NOMINAL = Equations(
    name="oscillator",
    states=[
        State(name="q", unit="m", scale=0.01, start_sd=1e-3),
        State(name="v", unit="m/s", scale=0.1, start_sd=1e-2),
    ],
    parameters=[
        Parameter(name="m", value=1.0, sd=0.1, unit="kg", lower=0.1),
        Parameter(name="k", value=100.0, sd=10.0, unit="N/m", lower=1.0),
        Parameter(name="d", value=0.5, sd=0.3, unit="N s/m", lower=0.0),
    ],
    inputs=["f"],
    rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.d * x.v) / p.m),
    outputs={"q": "q"},
    coordinates=[MASS],
)
DRY = Effect(
    name="dry friction",
    component="guide",
    unit="N",
    scale=0.05,
    sign=1,
    mechanism="A constant force <against> the motion.",
    rate=lambda t, x, u, p, size, shape: {"v": -size * np.tanh(x.v / 5e-3) / p.m},
)
CUBIC = Effect(
    name="cubic stiffness",
    component="spring",
    unit="N/m^3",
    scale=1e4,
    rate=lambda t, x, u, p, size, shape: {"v": -size * x.q**3 / p.m},
)
EFFECTS = (DRY, CUBIC)
TRUTH = np.array([1.03, 96.0, 0.6])


def record(name, amplitude, seed, *, dry=0.0, cubic=0.0, noise=1e-4, samples=600, role="fit"):
    """A multisine record of the oscillator with dry friction and a cubic spring."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples) * 4e-3
    force = sum(
        amplitude * np.sin(w * time + phase)
        for w, phase in zip(generator.uniform(2, 25, 5), generator.uniform(0, 6, 5), strict=True)
    )
    empty = Record(name=name, time=time, inputs={"f": force}, outputs={"q": 0.0 * time})
    fine = Record(  # four times the step: another grid than that of the fit
        name=name,
        time=np.linspace(0.0, time[-1], 4 * (samples - 1) + 1),
        inputs={"f": np.interp(np.linspace(0.0, time[-1], 4 * (samples - 1) + 1), time, force)},
        outputs={"q": np.zeros(4 * (samples - 1) + 1)},
    )
    jobs = Jobs(
        theta=TRUTH[None, :],
        starts=np.zeros((1, 2)),
        included=(Candidate(DRY), Candidate(CUBIC)),
        magnitudes=np.array([[dry, cubic]]),
    )
    clean = NOMINAL.simulate(fine, jobs)[0, ::4, 0]
    return Record(
        name=name,
        time=empty.time,
        inputs=empty.inputs,
        outputs={"q": clean + noise * generator.standard_normal(samples)},
        sensors={"q": Sensor(name="q", unit="m", sigma=noise)},
        role=role,
    )


def records(seed, **what):
    """Two records to fit and one to hold out, of different force."""
    return [
        record("soft", 0.5, 3 * seed, **what),
        record("middle", 1.0, 3 * seed + 1, **what),
        record("hard", 1.4, 3 * seed + 2, role="held_out", **what),
    ]
