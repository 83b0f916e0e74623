"""A cart on a spring and a damper, pushed by a force; its sensor may be late."""

import unmodeled

model = unmodeled.Equations(
    lambda t, x, u, p: (x.v, (u.force - p.k * x.x - p.d * x.v) / p.m),
    states={"x": "m", "v": "m/s"},
    parameters={"m": (2.0, 0.1, "kg"), "k": (40.0, 1.0, "N/m"), "d": (0.3, 0.3, "N s/m")},
    name="cart",
)
