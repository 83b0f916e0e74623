"""Machines for the tests of the diagnosis."""

from __future__ import annotations

import numpy as np
import pytest

from unmodeled import Effect, LinearModel, Parameter, Record, Sensor

SIGMA = 0.05  # N


def spring_record(name, cycles, *, role="fit", hardening=0.0, preload=0.0, seed=None, foreign=0.0):
    """A spring of 100 N/m that is moved by a sine; ``foreign``: rms of another force [N]."""
    t = np.linspace(0.0, 2.0, 200)
    x = 0.1 * np.sin(cycles * np.pi * t)
    force = 100.0 * x + hardening * x**3 + preload
    force += foreign * np.sqrt(2.0) * np.sin(12.0 * x / 0.1)
    force += np.random.default_rng(cycles if seed is None else seed).normal(0.0, SIGMA, t.size)
    sensors = {"force": Sensor(name="force", unit="N", sigma=SIGMA)}
    return Record(
        name=name, role=role, time=t, inputs={"x": x}, outputs={"force": force}, sensors=sensors
    )


@pytest.fixture
def spring():
    """Linear spring with a stiffness of 95 +- 10 N/m."""
    return LinearModel(
        name="spring",
        output="force",
        columns={"k": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="k", value=95.0, sd=10.0, unit="N/m")],
    )


@pytest.fixture
def causes():
    """Hardening, preload, and an even force that never acts."""
    return (
        Effect(
            name="hardening",
            component="spring",
            unit="N/m^3",
            scale=1000.0,
            regressor=lambda r, _: r.inputs["x"] ** 3,
        ),
        Effect(
            name="preload",
            component="spring",
            unit="N",
            scale=1.0,
            regressor=lambda r, _: np.ones_like(r.time),
        ),
        Effect(
            name="even",
            component="spring",
            unit="N/m^2",
            scale=100.0,
            regressor=lambda r, _: r.inputs["x"] ** 2,
        ),
    )
