"""Cascaded water tanks: square-root outflow, without the overflow of the upper tank.

unmodeled diagnose unmodeled/examples/tanks.py unmodeled/examples/data/tanks_*.csv
"""

import numpy as np

from unmodeled import Equations, Parameter, State, library


def root(level):
    """Square root that stays smooth near an empty tank."""
    return level / np.sqrt(np.sqrt(level**2 + 1e-4))


model = Equations(
    name="tanks, square-root outflow",
    states=[
        State(name="upper", unit="V", scale=3.0, start=5.0, start_sd=3.0),
        State(name="lower", unit="V", scale=3.0, start=5.0, start_sd=3.0),
    ],
    parameters=[
        Parameter(name="transfer", value=0.05, sd=0.03, unit="V^0.5/s", lower=0.0),
        Parameter(name="drain", value=0.05, sd=0.03, unit="V^0.5/s", lower=0.0),
        Parameter(name="pump", value=0.04, sd=0.03, unit="1/s", lower=0.0),
    ],
    inputs=["u"],
    rates=lambda t, x, u, p: (
        p.pump * u.u - p.transfer * root(x.upper),
        p.transfer * root(x.upper) - p.drain * root(x.lower),
    ),
    outputs={"y": "lower"},
    ports={"upper tank": "upper", "lower tank": "lower"},
    hold="zero",
)
LEVELS = tuple(float(v) for v in np.linspace(4.0, 12.0, 9))
effects = (
    library.overflow("upper", levels=LEVELS, rate_scale=0.02, into="lower"),
    library.overflow("lower", levels=(8.0, 9.0, 10.0), rate_scale=0.02),
    library.leak("upper", scale=0.002),
    library.leak("lower", scale=0.002),
    library.constant_rate("upper", unit="V/s", scale=0.01),
    library.constant_rate("lower", unit="V/s", scale=0.01),
    library.power_outflow("upper", 2.0, unit="1/(V s)", scale=2e-4),
    library.power_outflow("lower", 2.0, unit="1/(V s)", scale=2e-4),
    library.sensor_fault(["y"], "y", "offset", unit="V", scale=0.1),
    library.sensor_fault(["y"], "y", "delay", scale=4.0),
    library.input_fault("u", "delay", scale=4.0),
    library.input_fault("u", "saturation", shapes=(3.0, 4.0, 5.0)),
    library.input_fault("u", "dead zone", shapes=(1.0, 2.0)),
)
