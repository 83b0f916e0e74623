"""Silverbox, an electronic oscillator: a linear model without its cubic stiffness.

unmodeled diagnose unmodeled/examples/silverbox.py unmodeled/examples/data/silverbox_*.nc
"""

from unmodeled import Coordinate, Equations, Parameter, State, library

FREQUENCY = 430.0  # rad/s, a first guess of the resonance

mass = Coordinate(
    name="mass", position="y", speed="v", inertia=1.0, unit="V/s^2", position_unit="V"
)
model = Equations(
    name="Silverbox, linear",
    states=[
        State(name="y", unit="V", scale=0.05, start_sd=0.1),
        State(name="v", unit="V/s", scale=20.0, start_sd=50.0),
    ],
    parameters=[
        Parameter(name="stiffness", value=FREQUENCY**2, sd=0.2 * FREQUENCY**2, unit="1/s^2"),
        Parameter(name="damping", value=25.0, sd=20.0, unit="1/s", lower=0.0),
        Parameter(name="gain", value=FREQUENCY**2, sd=0.4 * FREQUENCY**2, unit="1/s^2"),
    ],
    inputs=["u"],
    rates=lambda t, x, u, p: (x.v, p.gain * u.u - p.stiffness * x.y - p.damping * x.v),
    outputs={"y": "y"},
    coordinates=[mass],
    substeps=2,
    hold="spline",  # nine samples a period of the resonance: straight lines would weaken the input
)
effects = (
    *library.for_coordinate(mass, force=0.1 * FREQUENCY**2, travel=0.1, speed=40.0, time=0.02),
    library.sensor_fault(["y"], "y", "offset", unit="V", scale=0.001),
    library.sensor_fault(["y"], "y", "gain"),
    library.input_fault("u", "delay", scale=0.001),
    library.input_fault("u", "offset", unit="V", scale=0.001),
)
