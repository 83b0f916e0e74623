"""Key switch: its force after a change, by a table of its force before.

The finger moves slowly, down and up. ``zero`` is where the switch sits in the machine that presses
it. The finger has one speed, so that friction that grows with the speed is no candidate. Friction
may be reduced.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from unmodeled import FunctionModel, Parameter, library

TABLE = np.loadtxt(Path(__file__).with_name("before.csv"), delimiter=",", skiprows=1)
TURN = int(TABLE[:, 0].argmax())
PRESSED, RELEASED = TABLE[: TURN + 1].T, TABLE[TURN:][::-1].T
KNOWN = (
    "dry friction", "friction along the travel", "hysteresis", "constant force",
    "linear stiffness", "quadratic stiffness", "cubic stiffness", "end stop",
)  # fmt: skip


def force(record, p):
    x = record.inputs["x"] - p.zero
    down = record.inputs["v"] > 0.0
    return np.where(down, np.interp(x, *PRESSED), np.interp(x, *RELEASED))


model = FunctionModel(
    name="key switch before the change",
    outputs={"force": force},
    parameters=[Parameter(name="zero", value=0.0, sd=1e-4, unit="m", lower=-5e-4, upper=5e-4)],
)
effects = tuple(
    replace(e, lower=-math.inf) if e.name == "dry friction" else e
    for e in library.for_force_balance("x", "v", force=0.5, travel=4e-3, pace=1e-3)
    if e.name in KNOWN
)
