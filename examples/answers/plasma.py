"""A drug in the blood plasma: an infusion, and an elimination in proportion to the amount."""

import unmodeled

model = unmodeled.Equations(
    lambda t, x, u, p: (u.infusion - p.elimination * x.drug,),
    states={"drug": "mg"},
    inputs={"infusion": "mg/s"},
    parameters={"elimination": (3e-4, 1e-4, "1/s")},
    hold="zero",  # the pump switches at the samples
    name="plasma",
)
