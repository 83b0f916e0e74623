"""A battery cell: a voltage that grows with its charge, and a resistance."""

import unmodeled

model = unmodeled.Equations(
    lambda t, x, u, p: (u.current,),
    states={"charge": "C"},
    inputs={"current": "A"},
    parameters={
        "empty": (3.2, 0.05, "V"),
        "slope": (1e-4, 1e-5, "V/C"),
        "resistance": (0.05, 0.01, "ohm"),
    },
    outputs={"voltage": lambda t, x, u, p: p.empty + p.slope * x.charge + p.resistance * u.current},
    hold="zero",
    name="cell",
)
