"""A line through the origin, and what it may lack."""

import numpy as np

from unmodeled import Effect, LinearModel, Parameter, Sensor
from unmodeled.experiment import InputLimits, Limits

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


def limits(least=0.0, most=1.0, rate=float(SAMPLES), **more):
    own = InputLimits(least=least, most=most)
    return Limits(inputs={"u": own}, duration=1.0, sample_rate=rate, lead=0.0, **more)


SQUARE, CUBE = effect("square", lambda u: u**2), effect("cube", lambda u: u**3)
