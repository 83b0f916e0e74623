"""A felt of feltmb as a contact in Exudyn: a hammer of 9 g strikes a felt pad and comes back.

The felt remembers. Exudyn asks for the force several times a step, at trial positions: `peek`
answers without remembering. After the step `step` moves the memory on.

Usage: python examples/felt_in_exudyn.py      (needs feltmb, and pip install exudyn)
"""

from __future__ import annotations

import exudyn
import exudyn.itemInterface as items
import numpy as np
from energy_balance import first_impact

from feltmb.contact import law
from feltmb.felt import SphereOnLayer

MASS = 9e-3  # kg
SPEED = 2.0  # m/s
STEP = 2e-6  # s


def make_felt():
    """A micromechanical felt, 6 mm thick, under a sphere of 9 mm radius, by columns."""
    return law(
        "micromechanical",
        felt="synthetic_soft_red",
        thickness=6e-3,
        area=SphereOnLayer(9e-3),
        compression="columns",
    )


def main():
    """Run the impact in Exudyn; returns the same numbers."""
    felt = make_felt()
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
    ground = mbs.AddNode(items.NodePointGround())
    start = {"initialCoordinates": [0.0], "initialVelocities": [SPEED]}
    node = mbs.AddNode(items.Node1D(referenceCoordinates=[0.0], **start))
    mbs.AddObject(items.ObjectMass1D(mass=MASS, nodeNumber=node))
    on_ground = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
    on_hammer = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=0))

    def contact_force(_mbs, _t, _item, compression, *_others):
        return felt.peek(compression, STEP)

    mbs.AddObject(
        items.ObjectConnectorCoordinateSpringDamper(
            markerNumbers=[on_ground, on_hammer], springForceUserFunction=contact_force
        )
    )
    seen = []

    def remember(mbs, _t):
        place = float(mbs.GetNodeOutput(node, exudyn.OutputVariableType.Coordinates))
        seen.append((place, felt.step(place, STEP)))
        return True

    mbs.SetPostStepUserFunction(remember)
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.endTime = 8e-3
    settings.timeIntegration.numberOfSteps = round(8e-3 / STEP)
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    # The slope of the contact is found by differences, in every step anew.
    settings.timeIntegration.newton.useModifiedNewton = False
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    speed = float(mbs.GetNodeOutput(node, exudyn.OutputVariableType.Coordinates_t))
    compression, force = np.array(seen).T
    return {"compression": compression.max(), "force": force.max(), "rebound": -speed}


if __name__ == "__main__":
    here, exact = main(), first_impact(make_felt(), MASS, SPEED)
    for name, unit in (("compression", "m"), ("force", "N"), ("rebound", "m/s")):
        balance = f"from the energy balance {exact[name]:.6g} {unit}"
        print(f"{name:12s} {here[name]:.6g} {unit}, {balance}")
