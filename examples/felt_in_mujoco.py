"""A felt of feltmb as a contact in MuJoCo: a hammer of 9 g strikes a felt pad and comes back.

The felt remembers. MuJoCo steps forward with the forces of the present state: `step` is called
once a step, with the compression there, and gives the force that is applied.

Usage: python examples/felt_in_mujoco.py      (needs feltmb, and pip install mujoco)
"""

from __future__ import annotations

import mujoco
from energy_balance import first_impact

from feltmb.contact import law

MASS = 9e-3  # kg
SPEED = 2.0  # m/s
STEP = 1e-6  # s
MODEL = f"""
<mujoco>
  <option timestep="{STEP}" gravity="0 0 0" integrator="Euler"/>
  <worldbody>
    <body>
      <joint name="slide" type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.009" mass="{MASS}" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""


def make_felt():
    """The law with memory on the curve fits of the key's rest rail, thesis Table A.12, row 1."""
    return law("felt_memory", loading=(5.52e3, 1.58e3, -0.60e3), unloading=(0.19e3, 5.04e3, 3.04e3))


def main():
    """Run the impact in MuJoCo; returns the same numbers."""
    felt = make_felt()
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qvel[0] = SPEED
    compression, force = [], []
    while data.time < 4e-3:
        compression.append(float(data.qpos[0]))
        force.append(felt.step(compression[-1], STEP))
        data.qfrc_applied[0] = -force[-1]
        mujoco.mj_step(model, data)
    return {
        "compression": max(compression),
        "force": max(force),
        "rebound": -float(data.qvel[0]),
    }


if __name__ == "__main__":
    here, exact = main(), first_impact(make_felt(), MASS, SPEED)
    for name, unit in (("compression", "m"), ("force", "N"), ("rebound", "m/s")):
        balance = f"from the energy balance {exact[name]:.6g} {unit}"
        print(f"{name:12s} {here[name]:.6g} {unit}, {balance}")
