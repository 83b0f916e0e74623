"""Writes the measured files of docs/howto/first_answer.md; each machine has what its model lacks.

Usage: python measure.py [cart table pendulum servo]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from cart import cart

import feltmb
import unmodeled


def waves(seed, time, size, low=2.0, high=15.0):
    """A sum of sines, which excites a machine at many frequencies."""
    random = np.random.default_rng(seed)
    rates, phases = random.uniform(low, high, 4), random.uniform(0.0, 6.0, 4)
    return size * np.sin(np.outer(time, rates) + phases).sum(axis=1), random


def write_cart():
    """The guide of the cart has a dry friction of 0.43 N."""
    time, parts = np.arange(400) * 5e-3, []
    for k, size in enumerate((1.0, 2.0, 3.0)):
        force, random = waves(k, time, size)
        truth = {"mass": 2.06, "damping": 0.4, "dry_friction": 0.43}
        x = cart(time, {"force": force}, truth)["x"] + 1e-4 * random.standard_normal(time.size)
        parts.append(pd.DataFrame({"run": k, "time": time, "force": force, "x": x}))
    pd.concat(parts).to_csv("cart.csv", index=False)


def write_table():
    """The spring of the table hardens: 1500 N/m^3."""
    time = np.arange(400) * 5e-3
    for k, size in enumerate((1.0, 1.5, 2.0)):
        force, random = waves(10 + k, time, size)
        x = v = 0.0
        seen = []
        for f in force:
            seen.append(x)
            for _ in range(100):  # the force is held; the position is advanced on both sides
                x += 2.5e-5 * v
                v += 5e-5 / 2.05 * (f - 90.0 * x - 1500.0 * x**3 - 3.0 * v)
                x += 2.5e-5 * v
        x = np.array(seen) + 5e-5 * random.standard_normal(time.size)
        data = {"time [s]": time, "motor [N]": force, "x [mm]": 1e3 * x}
        pd.DataFrame(data).to_csv(f"table_{k}.csv", index=False, float_format="%.6g")


def write_pendulum():
    """The pivot of the pendulum has a friction of 1 mN m; its FMU has none."""
    action = feltmb.load_action("pendulum.toml")
    feltmb.export_fmu(action, "pendulum.fmu", parameters=["bodies.arm.*"], force=True)
    friction = {"amplitude": {"value": 1.0, "unit": "mN m"}}
    mass = {"value": 20.4, "unit": "g"}
    real = action.with_values({"bodies.arm.friction": friction, "bodies.arm.mass": mass})
    time = np.arange(300) * 4e-3
    for k, size in enumerate((0.01, 0.015, 0.02)):
        force, random = waves(20 + k, time, size, 3.0, 20.0)
        stroke = feltmb.table_stroke(time, force, name="swing")
        run = feltmb.simulate(real, stroke, output_rate=250.0).to_dataframe()
        angle = np.interp(time, run.index, run["arm.angle"])
        data = {"time [s]": time, "force [N]": force}
        data["arm.angle [rad]"] = angle + 1e-4 * random.standard_normal(time.size)
        pd.DataFrame(data).to_csv(f"swing_{k}.csv", index=False, float_format="%.6g")


def write_servo():
    """The gear of the servo has a clearance of 20 mrad and a friction of 0.3 N m."""
    servo = unmodeled.mujoco("servo.xml").mjcf
    time = np.arange(300) * 5e-3
    for k in range(3):
        angle, random = waves(30 + k, time, 0.13)
        truth = {"shoulder.frictionloss": 0.3, "shoulder.backlash": 0.01}
        seen = servo(time, {"servo": angle}, truth)["shoulder"]
        data = {"time": time, "servo": angle}
        data["shoulder"] = seen + 2e-4 * random.standard_normal(time.size)
        pd.DataFrame(data).to_csv(f"servo_{k}.csv", index=False, float_format="%.6g")


if __name__ == "__main__":
    for name in sys.argv[1:] or ["cart", "table", "pendulum", "servo"]:
        globals()[f"write_{name}"]()
        print(f"{name}: {len(list(Path().glob('*.csv')))} files")
