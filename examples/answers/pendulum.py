"""A pendulum without friction; its stiffness is g over its length."""

import numpy as np

import unmodeled

model = unmodeled.Equations(
    lambda t, x, u, p: (x.rate, -p.stiffness * np.sin(x.angle)),
    states={"angle": "rad", "rate": "rad/s"},
    parameters={"stiffness": (60.0, 10.0, "1/s^2")},
    outputs={"angle": "angle"},
    name="pendulum",
)
