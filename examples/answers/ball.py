"""A ball that falls without air."""

import unmodeled

model = unmodeled.Equations(
    lambda t, x, u, p: (x.speed, -p.gravity),
    states={"h": "m", "speed": "m/s"},
    parameters={"gravity": (9.81, 0.01, "m/s^2")},
    outputs={"h": "h"},
    name="ball",
)
