"""A heated vessel that loses heat in proportion to its temperature above the room."""

import unmodeled

model = unmodeled.Equations(
    lambda t, x, u, p: ((u.heater - p.G * (x.vessel - u.room)) / p.C,),
    states={"vessel": "degC"},
    inputs={"heater": "W", "room": "degC"},
    parameters={"C": (20e3, 2e3, "J/K"), "G": (3.0, 0.5, "W/K")},
    hold="zero",  # the heater switches at the samples
    name="heated vessel",
)
