"""Whether the order of `plan` beats a random one: records until the right cause is named.

    python bench/plan_order.py --first 0 --count 20

Machines are oscillators with other parameters, noise and missing effects; of eight records that
could be made, one after another is made, by the order of the plan (planned again after each) or by
two random orders, until the right cause alone is named, at most four. One line of JSON a machine.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace

import numpy as np

from unmodeled import Equations, Options, Record, Sensor, candidates, diagnose
from unmodeled.experiment import Belief, plan
from unmodeled.fit.observe import observe
from unmodeled.models import Candidate

MOST = 4
TIME = np.arange(600) / 150.0
WAVES = {
    "slow sine": np.sin(2 * np.pi * 0.5 * TIME),
    "quick sine": np.sin(2 * np.pi * 2.5 * TIME),
    "sweep": np.sin(2 * np.pi * (0.3 + 0.5 * TIME) * TIME),
    "steps": np.where(TIME < 2.0, 1.0, -0.4),
}


def rates(t, x, u, p):
    return x.v, (u.f - p.k * x.q - p.d * x.v) / p.m


def machine(number: int):
    """Model, candidates, proposed records, and what makes a record."""
    rng = np.random.default_rng(number)
    m, k, d = rng.uniform(0.5, 2.0), rng.uniform(50.0, 200.0), rng.uniform(0.3, 1.5)
    model = Equations(
        rates, states={"q": "m", "v": "m/s"}, outputs={"q": "q"}, inputs={"f": "N"},
        parameters={"m": (m, 0.1 * m, "kg"), "k": (k, 0.1 * k, "N/m"), "d": (d, 0.3 * d, "N s/m")},
    )  # fmt: skip
    force, noise = rng.uniform(0.5, 2.0), 10 ** rng.uniform(-3.5, -2.5)
    sensors = {"q": Sensor(name="q", unit="m", sigma=noise)}
    proposed = [
        Record(
            name=f"{size} {name}", time=TIME, inputs={"f": factor * force * wave},
            outputs={"q": 0.0 * TIME}, sensors=sensors,
        )
        for name, wave in WAVES.items() for size, factor in (("small", 0.2), ("large", 1.0))
    ]  # fmt: skip
    true = np.array([m, k, d]) * (1.0 + 0.05 * rng.standard_normal(3))
    effects = candidates(model, proposed)
    inside = [e for e in effects if e.rate is not None]
    effect = inside[number % len(inside)]
    shape = effect.shapes[len(effect.shapes) // 2]
    size = effect.scale * (1.0 if effect.sign >= 0 else -1.0)

    def measure(record: Record, place: int) -> Record:
        lacks = (Candidate(effect, shape),)
        start = np.zeros(len(model.states(lacks)))
        q = observe(model, record, true, start, lacks, np.array([size]))
        y = q[:, 0] + noise * np.random.default_rng([number, place]).standard_normal(TIME.size)
        return replace(record, name=f"r{place}", outputs={"q": y})

    return model, effects, proposed, effect.name, measure


def needed(number: int, order: str) -> int:
    """Records until the right cause alone is named; MOST + 1: not within MOST."""
    model, effects, proposed, true, measure = machine(number)
    rng, records, belief = np.random.default_rng([number, len(order)]), [], None
    for place in range(1, MOST + 1):
        if order == "plan":
            best = plan(model, effects, proposed, records, belief=belief).records[0].record.name
        else:
            best = proposed[rng.integers(len(proposed))].name
        chosen = next(r for r in proposed if r.name == best)
        records.append(measure(chosen, place))
        report = diagnose(model, effects, records, hold_out=[], options=Options(seconds=20.0))
        if [c.cause for c in report.named] == [true]:
            return place
        belief = Belief.of_report(report)
    return MOST + 1


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--first", type=int, default=0, help="first machine")
    parser.add_argument("--count", type=int, default=20, help="number of machines")
    options = parser.parse_args()
    for number in range(options.first, options.first + options.count):
        row = {"machine": number, "cause": machine(number)[3]}
        row |= {order: needed(number, order) for order in ("plan", "random", "random 2")}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
