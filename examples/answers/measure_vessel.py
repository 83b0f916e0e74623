"""Writes the records of the vessel, which also loses 0.03 W/K^2 by evaporation."""

import numpy as np

MINUTES = np.arange(0.0, 300.0, 2.0)


def measure(name, powers, room, vessel, seed):
    """One day: the heater changes every hour; the thermometer has a noise of 0.1 K."""
    random, seen = np.random.default_rng(seed), []
    heater, air = np.repeat(powers, 30), room + np.sin(MINUTES / 60.0 + seed)
    for power, outside in zip(heater, air, strict=True):
        seen.append(vessel)
        for _ in range(120):  # s
            apart = vessel - outside
            vessel += (power - 2.8 * apart - 0.03 * apart * abs(apart)) / 21e3
    seen = np.array(seen) + 0.1 * random.standard_normal(MINUTES.size)
    table = np.column_stack([MINUTES, heater, air, seen])
    head = "time [min],heater [W],room [degC],vessel [degC]"
    np.savetxt(name, table, fmt="%.3f", delimiter=",", header=head, comments="")


measure("monday.csv", [100.0, 250.0, 50.0, 150.0, 0.0], 21.0, 21.0, 1)
measure("tuesday.csv", [250.0, 80.0, 200.0, 0.0, 120.0], 19.0, 25.0, 2)
measure("friday.csv", [60.0, 180.0, 90.0, 230.0, 200.0], 22.0, 20.0, 3)
