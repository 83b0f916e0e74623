"""Diagnoses of a user's equations: processor time, and what they find.

    python bench/speed/equations.py [cart silverbox go1 pendulum] [--data FOLDER] [--seconds 300]

``--data`` is a folder with the measured swings of a pendulum (swing1.csv to swing6.csv). Run it
with two trees in PYTHONPATH, one after the other, to compare them.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import unmodeled


def cart(_data):
    """A cart on a spring with a dry friction of 0.43 N that the model lacks."""

    def rates(t, x, u, p):
        return x.v, (u.force - 40.0 * x.x - p.damping * x.v) / p.mass

    prior = {"mass": (2.0, 0.1, "kg"), "damping": (0.3, 0.3, "N s/m")}
    model = unmodeled.Equations(
        rates, states={"x": (0.0, 1e-4, "m"), "v": (0.0, 1e-3, "m/s")}, parameters=prior
    )
    clock, records = np.arange(2000) * 5e-3, []
    for k, size in enumerate((1.0, 2.0, 3.0)):
        random = np.random.default_rng(k)
        tones, phases = random.uniform(2.0, 15.0, 4), random.uniform(0.0, 6.0, 4)
        force = size * np.sin(np.outer(clock, tones) + phases).sum(axis=1)
        x = v = 0.0
        seen = np.zeros(clock.size)
        for i in range(clock.size - 1):
            for j in range(10):
                now = force[i] + (j + 0.5) / 10.0 * (force[i + 1] - force[i])
                v += 5e-4 / 2.06 * (now - 40.0 * x - 0.4 * v)
                v = np.sign(v) * max(abs(v) - 5e-4 / 2.06 * 0.43, 0.0)
                x += 5e-4 * v
            seen[i + 1] = x
        seen += 1e-4 * random.standard_normal(clock.size)
        records.append(
            unmodeled.Record(
                name=f"run {k}",
                time=clock,
                inputs={"force": force},
                outputs={"x": seen},
                sensors={"x": unmodeled.Sensor(name="x", unit="m", sigma=1e-4)},
            )
        )
    return model, None, records


def silverbox(_data):
    """The electronic oscillator of the examples with all default candidates."""
    from blind import yardstick_sets

    task = yardstick_sets._silverbox()
    return task.model, None, task.records


def go1(_data):
    """The motor of a robot leg."""
    from blind import yardstick_sets

    task = yardstick_sets._go1()
    return task.model, task.effects, task.records


def pendulum(data):
    """Free swings of a pendulum whose noise is not told."""

    def rates(t, x, u, p):
        return x.rate, -p.w2 * np.sin(x.angle) - p.damping * x.rate

    model = unmodeled.Equations(
        rates,
        states={"angle": "rad", "rate": "rad/s"},
        parameters={"w2": (64.0, 10.0, "1/s^2"), "damping": (0.07, 0.07, "1/s")},
    )
    return model, None, unmodeled.read(str(Path(data) / "swing*.csv"))


CASES = {f.__name__: f for f in (cart, silverbox, go1, pendulum)}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=[*CASES])
    parser.add_argument("--data", default=".")
    parser.add_argument("--seconds", type=float, default=300.0)
    given = parser.parse_args()
    for name in given.cases:
        model, effects, records = CASES[name](given.data)
        options = unmodeled.Options(seconds=given.seconds)
        begin = time.process_time()
        if effects is None:
            report = model.diagnose(records, options=options)
        else:
            report = unmodeled.diagnose(model, effects, records, options=options)
        spent = time.process_time() - begin
        found = ", ".join(f"{n.cause} {n.magnitude:.4g}" for n in report.named) or "none"
        names = "; ".join(" or ".join(c.cause for c in group) for group in report.classes)
        left = f"{report.worst.explained / report.worst.calibrated:.3f}"
        values = ", ".join(f"{p.name} {p.value:.5g}" for p in report.parameters)
        reasons = ", ".join(r.value for r in report.reasons)
        print(
            f"{name}: {spent:.1f} CPU s, {len(records)} records, {report.verdict.value}, "
            f"named: {found}; classes: {names or 'none'}; left {left}; {values}; {reasons}",
            flush=True,
        )


if __name__ == "__main__":
    main()
