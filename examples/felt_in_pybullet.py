"""A felt of feltmb as a contact in PyBullet: a hammer of 9 g strikes a felt pad and comes back.

Bullet steps forward with the forces of the present state: `step` is called once a step, with the
compression there, and gives the force that is applied. Bullet damps all bodies unless told not to.

Usage: python examples/felt_in_pybullet.py      (needs feltmb, and pip install pybullet)
"""

from __future__ import annotations

import pybullet
from energy_balance import first_impact

from feltmb.contact import law

MASS = 9e-3  # kg
SPEED = 2.0  # m/s
STEP = 1e-6  # s


def make_felt():
    """The law with memory on the curve fits of the key's rest rail, thesis Table A.12, row 1."""
    return law("felt_memory", loading=(5.52e3, 1.58e3, -0.60e3), unloading=(0.19e3, 5.04e3, 3.04e3))


def main():
    """Run the impact in PyBullet; returns the same numbers."""
    felt = make_felt()
    world = pybullet.connect(pybullet.DIRECT)
    pybullet.setTimeStep(STEP, world)
    hammer = pybullet.createMultiBody(baseMass=MASS, physicsClientId=world)
    pybullet.changeDynamics(hammer, -1, linearDamping=0.0, physicsClientId=world)
    pybullet.resetBaseVelocity(hammer, [SPEED, 0.0, 0.0], physicsClientId=world)
    compression, force = [], []
    for _ in range(4000):
        place, _ = pybullet.getBasePositionAndOrientation(hammer, world)
        compression.append(place[0])
        force.append(felt.step(place[0], STEP))
        push = [-force[-1], 0.0, 0.0]
        pybullet.applyExternalForce(
            hammer, -1, push, place, pybullet.WORLD_FRAME, physicsClientId=world
        )
        pybullet.stepSimulation(world)
    speed, _ = pybullet.getBaseVelocity(hammer, world)
    pybullet.disconnect(world)
    return {"compression": max(compression), "force": max(force), "rebound": -speed[0]}


if __name__ == "__main__":
    here, exact = main(), first_impact(make_felt(), MASS, SPEED)
    for name, unit in (("compression", "m"), ("force", "N"), ("rebound", "m/s")):
        balance = f"from the energy balance {exact[name]:.6g} {unit}"
        print(f"{name:12s} {here[name]:.6g} {unit}, {balance}")
