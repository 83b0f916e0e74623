"""Writes the records of a plasma that exchanges a drug with a tissue, which its model lacks."""

import numpy as np


def measure_plasma(name, infusion, seed):
    """Six hours; the tissue fills at 1e-3 1/s with a time constant of 20 min."""
    time, plasma, tissue, seen = np.arange(0.0, 360.0, 3.0), 0.0, 0.0, []
    rate = np.repeat(infusion, time.size // len(infusion))
    for flow in rate:
        seen.append(plasma)
        for _ in range(180):  # s
            plasma += flow - 2.5e-4 * plasma + 1e-3 * (tissue - plasma)
            tissue += (plasma - tissue) / 1200.0
    seen = np.array(seen) + 0.3 * np.random.default_rng(seed).standard_normal(time.size)
    table = np.column_stack([time, rate, seen])
    head = "time [min],infusion [mg/s],drug [mg]"
    np.savetxt(name, table, fmt="%.4f", delimiter=",", header=head, comments="")


measure_plasma("monday_drug.csv", [0.05, 0.0, 0.0, 0.08, 0.0, 0.0], 1)
measure_plasma("tuesday_drug.csv", [0.08, 0.02, 0.0, 0.0, 0.05, 0.0], 2)
measure_plasma("friday_drug.csv", [0.03, 0.06, 0.0, 0.06, 0.03, 0.0], 3)
