"""Choose the most informative of some records, make it, diagnose, until a cause is named.

The rig is simulated: an oscillator whose guide rubs dry, which the model lacks. Replace `measure`
by a function that plays `planned.inputs` on a machine and returns the record.
"""

from dataclasses import replace

import numpy as np

from unmodeled import Effect, Equations, Parameter, Record, Sensor, State, diagnose
from unmodeled.experiment import Belief, plan
from unmodeled.fit.observe import observe
from unmodeled.models import Candidate

model = Equations(
    name="oscillator",
    states=[State(name="q", unit="m", scale=0.01, start_sd=1e-3), State(name="v", unit="m/s")],
    parameters=[
        Parameter(name="m", value=1.0, sd=0.1, unit="kg", lower=0.1),
        Parameter(name="k", value=100.0, sd=10.0, unit="N/m", lower=1.0),
        Parameter(name="d", value=0.5, sd=0.3, unit="N s/m", lower=0.0),
    ],
    inputs=["f"],
    rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.d * x.v) / p.m),
    outputs={"q": "q"},
)
DRY = Effect(
    name="dry friction", component="guide", unit="N", scale=0.05, sign=1,
    rate=lambda t, x, u, p, size, shape: {"v": -size * np.tanh(x.v / 5e-3) / p.m},
)  # fmt: skip
CUBIC = Effect(
    name="cubic stiffness", component="spring", unit="N/m^3", scale=1e4,
    rate=lambda t, x, u, p, size, shape: {"v": -size * x.q**3 / p.m},
)  # fmt: skip
SIGMA = 2e-3  # m, a poor camera
TIME = np.arange(1000) / 250.0
#: What the motor can play: forces [N].
FORCES = {
    "slow sine": np.sin(2 * np.pi * TIME),
    "sweep": np.sin(2 * np.pi * (0.5 + 0.375 * TIME) * TIME),
    "small steps": np.where(TIME < 2.0, 0.1, -0.1),
    "large steps": np.where(TIME < 2.0, 1.0, -0.4),
}
proposed = [
    Record(
        name=name, time=TIME, inputs={"f": f}, outputs={"q": 0.0 * TIME},
        sensors={"q": Sensor(name="q", unit="m", sigma=SIGMA)},
    )
    for name, f in FORCES.items()
]  # fmt: skip


def measure(planned: Record, number: int) -> Record:
    """The record of the rig: 4 % less stiff than tabulated, and 0.05 N of dry friction."""
    theta, start = np.array([1.03, 96.0, 0.6]), np.zeros(2)
    q = observe(model, planned, theta, start, (Candidate(DRY),), np.array([0.05]))[:, 0]
    noise = SIGMA * np.random.default_rng(number).standard_normal(q.size)
    return replace(planned, name=f"record_{number}", outputs={"q": q + noise})


records: list[Record] = []
belief = None
for number in range(1, 7):
    best = plan(model, [DRY, CUBIC], proposed, records, belief=belief).records[0]
    records.append(measure(best.record, number))
    report = diagnose(model, [DRY, CUBIC], records, hold_out=[])
    belief = Belief.of_report(report)
    print(f"{best.record.name}: {report.verdict.value}")
    if report.named:
        print(f"{report.named[0].cause}: {report.named[0].magnitude:.3f} {report.named[0].unit}")
        break
