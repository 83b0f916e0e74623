"""Coordinates of a model, on which effects act."""

import numpy as np
import pytest

from unmodeled.data import Record, Sensor
from unmodeled.fit import Coordinate, Equations, Named, State

NOTHING = Named({})


def model(*coordinates):
    return Equations(
        states=[State(name="q", unit="m"), State(name="v", unit="m/s")],
        rates=lambda t, x, u, p: (x.v, -4.0 * x.q),
        outputs={"q": "q"},
        coordinates=coordinates,
    )


def place(**more):
    return Coordinate(name="slide", position="q", speed="v", **more)


def notes(*coordinates):
    time = np.linspace(0.0, 1.0, 101)
    record = Record(
        name="r", time=time, inputs={}, outputs={"q": np.cos(2.0 * time)},
        sensors={"q": Sensor(name="q", unit="m", sigma=1e-3)},
    )  # fmt: skip
    return [n for n in model(*coordinates).ready([record]).notes if "inertia" in n]


def test_a_coordinate_without_inertia_tells_that_its_forces_are_accelerations():
    (text,) = notes(place())
    assert text.startswith(
        "coordinate slide has no inertia: its forces in N are accelerations in m/s^2"
    )
    (text,) = notes(place(unit="N m", position_unit="m"))
    assert "in N m are accelerations in m/s^2" in text
    other = Coordinate(name="other", position="q", speed="v")
    assert len(notes(place(), other)) == 2


@pytest.mark.parametrize("more", [{"inertia": 1.0}, {"inertia": 3.0}, {"unit": "m/s^2"}])
def test_a_coordinate_with_inertia_or_in_accelerations_tells_nothing(more):
    assert notes(place(**more)) == []


def test_a_force_without_inertia_is_an_acceleration():
    """As with an inertia of 1, and three times that with an inertia of 3."""
    for inertia, expected in ((None, 6.0), (1.0, 6.0), (3.0, 2.0)):
        rates = place(inertia=inertia).push(6.0, 0.0, NOTHING, NOTHING, NOTHING)
        assert rates == {"v": expected}
