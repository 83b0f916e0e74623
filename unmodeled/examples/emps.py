"""Electro-mechanical positioning system: inverse dynamics with mass and viscous friction only.

    unmodeled diagnose emps.py data/emps_*.csv --hold-out emps_pulses

The model lacks the dry friction of the guide.
"""

from unmodeled import LinearModel, Parameter, library

model = LinearModel(
    name="EMPS, mass and viscous friction",
    output="force",
    columns={
        "mass": lambda r: r.inputs["ddq"],
        "viscous": lambda r: r.inputs["dq"],
    },
    parameters=[
        Parameter(name="mass", value=100.0, sd=50.0, unit="kg", lower=0.0),
        Parameter(name="viscous", value=200.0, sd=300.0, unit="N s/m", lower=0.0),
    ],
)
effects = library.for_force_balance("q", "dq", force=100.0, travel=0.25, pace=0.2)
