"""A MuJoCo model that lacks the dry friction of its guide: the diagnosis names it, with its size.

Usage: python examples/simulators/mujoco_cart.py      (needs feltmb, and pip install mujoco)
"""

from __future__ import annotations

import mujoco
import numpy as np

from feltmb.gap import Exposed, Parameter, Record, Sensor, Simulator, diagnose, library

STEP = 1e-3  # s
MODEL = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option timestep="{STEP}" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" frictionloss="1e-9"/>
      <geom type="box" size="0.1 0.05 0.03" mass="2" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor joint="slide"/></actuator>
</mujoco>
""")
TRUTH = {"mass": 2.06, "stiffness": 40.8, "damping": 1.1, "friction": 0.43}


def cart(time, inputs, parameters):
    """Position of the cart at the samples, from rest; the force is held between them."""
    MODEL.body_mass[1] = parameters["mass"]
    MODEL.jnt_stiffness[0] = parameters["stiffness"]
    MODEL.dof_damping[0] = parameters["damping"]
    MODEL.dof_frictionloss[0] = max(parameters["friction"], 1e-9)
    mujoco.mj_setConst(MODEL, data := mujoco.MjData(MODEL))
    position = np.zeros(time.size)
    steps = np.round(np.diff(time) / STEP).astype(int)
    for i, count in enumerate(steps):
        data.ctrl[0] = inputs["force"][i]
        mujoco.mj_step(MODEL, data, count)
        position[i + 1] = data.qpos[0]
    return {"x": position}


def measured(name, amplitude, seed, role="fit"):
    """A record as a rig would give it: the cart with its friction, read to 0.1 mm."""
    random = np.random.default_rng(seed)
    time = np.arange(500) * 5e-3
    rates, phases = random.uniform(2, 15, 5), random.uniform(0, 6, 5)
    force = amplitude * sum(np.sin(w * time + p) for w, p in zip(rates, phases, strict=True))
    x = cart(time, {"force": force}, TRUTH)["x"]
    return Record(
        name=name,
        time=time,
        inputs={"force": force},
        outputs={"x": x + 1e-4 * random.standard_normal(time.size)},
        sensors={"x": Sensor(name="x", unit="m", sigma=1e-4)},
        role=role,
    )


def main():
    """Diagnose; returns the report."""
    model = Simulator(
        cart,
        name="cart",
        parameters=[
            Parameter(name="mass", value=2.0, sd=0.1, unit="kg", lower=0.1),
            Parameter(name="stiffness", value=40.0, sd=2.0, unit="N/m", lower=1.0),
            Parameter(name="damping", value=1.0, sd=0.3, unit="N s/m", lower=0.0),
        ],
        inputs={"force": "N"},
        outputs={"x": "m"},
        unknown={"friction": Exposed(scale=0.5, unit="N", component="guide", sign=+1)},
    )
    records = [
        measured("soft", 1.0, 1),
        measured("middle", 2.0, 2),
        measured("hard", 3.0, 3, "held_out"),
    ]
    effects = [
        *model.effects,
        *library.for_input("force", records[0], unit="N"),
        *library.for_sensor(model.outputs, "x", records[0]),
    ]
    report = diagnose(model, effects, records)
    print(report.summary())
    for cause in report.named:
        print(f"{cause.cause}: {cause.magnitude:.3g} N, {TRUTH['friction']:g} N in truth")
    print(f"{model.simulations} simulations")
    return report


if __name__ == "__main__":
    main()
