"""A line through the origin, and what it may lack."""

import numpy as np

from unmodeled import Effect, LinearModel, Parameter, Record, Sensor

SENSORS = {"y": Sensor(name="y", sigma=1.0)}
SAMPLES = 2000


def line(sd=np.inf, columns=None):
    model = LinearModel(
        output="y",
        columns=columns or {"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name=n, value=1.0, sd=sd) for n in columns or ("slope",)],
    )
    model.inputs = ("u",)
    return model


def effect(name, column, scale=1.0):
    return Effect(
        name=name, component="c", scale=scale, regressor=lambda r, s: column(r.inputs["u"])
    )


def proposed(u, name="ramp", sensors=SENSORS):
    """A record that could be made, of an input over one second."""
    u = np.asarray(u)
    return Record(
        name=name, time=np.arange(u.size) / u.size, inputs={"u": u}, sensors=sensors,
        outputs=dict.fromkeys(sensors, 0.0 * u),
    )  # fmt: skip


RAMP = np.linspace(0.0, 1.0, SAMPLES)
SQUARE, CUBE = effect("square", lambda u: u**2), effect("cube", lambda u: u**3)
