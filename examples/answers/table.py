"""A table on a linear spring with a damper, moved by a motor."""

import unmodeled

model = unmodeled.Equations(
    lambda t, x, u, p: (x.v, (u.motor - p.k * x.x - p.d * x.v) / p.m),
    states={"x": "m", "v": "m/s"},
    parameters={"m": (2.0, 0.1, "kg"), "k": (88.0, 5.0, "N/m"), "d": (3.0, 0.5, "N s/m")},
    name="table",
)
