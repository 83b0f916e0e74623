"""Writes the records of a cell that loses 2e-5 of its charge per second, which its model lacks."""

import numpy as np

TIME = np.arange(0.0, 6000.0, 20.0)  # s


def measure(name, currents, charge, seed):
    """One cycle of charge and discharge; the voltmeter has a noise of 0.5 mV."""
    noise = 5e-4 * np.random.default_rng(seed).standard_normal(TIME.size)
    current, seen = np.repeat(currents, TIME.size // len(currents)), []
    for flow in current:
        seen.append(3.22 + 1.03e-4 * charge + 0.056 * flow)
        charge = (charge - flow / 2e-5) * np.exp(-2e-5 * 20.0) + flow / 2e-5
    table = np.column_stack([TIME, current, np.array(seen) + noise])
    head = "time [s],current [A],voltage [V]"
    np.savetxt(name, table, fmt="%.5f", delimiter=",", header=head, comments="")


measure("cycle_1.csv", [2.0, 0.0, -1.5, 0.5, 0.0], 1000.0, 1)
measure("cycle_2.csv", [0.0, 2.0, -0.5, 0.0, -1.0], 4000.0, 2)
measure("cycle_3.csv", [-0.5, 1.5, 0.0, 2.0, -1.0], 2000.0, 3)
