"""Coordinates of a model, on which effects act."""

import itertools

import numpy as np
import pytest

from unmodeled import Options, candidates
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


def wheel(torque, b, w):
    """Rate of a wheel of 0.02 kg m^2 with dry friction of 0.03 N m."""
    return (torque - b * w - 0.03 * np.tanh(w / 0.05)) / 0.02


def test_a_speed_without_a_position_has_friction():
    """The speed of a motor is its only state: laws of the speed act on it, and no others."""
    model = Equations(
        lambda t, x, u, p: ((u.torque - p.b * x.w) / p.J,),
        states={"w": "rad/s"},
        parameters={"J": (0.02, 1e-3, "kg m^2"), "b": (0.01, 2e-3, "N m s/rad")},
        inputs={"torque": "N m"},
    )
    (place,) = model.coordinates
    assert (place.position, place.speed, place.inertia, place.unit) == ("", "w", "J", "N m")
    time, w = np.arange(0.0, 6.0, 0.01), [0.0]
    torque = 0.2 * np.sin(2.0 * time) + 0.1 * np.sin(5.0 * time)
    for one, other in itertools.pairwise(torque):  # fine steps of its own
        v = w[-1]
        for s in np.linspace(0.0, 1.0, 40, endpoint=False) + 0.0125:
            v += wheel(one + s * (other - one), 0.01, v) * 0.01 / 40
        w.append(v)
    noise = 0.01 * np.random.default_rng(1).standard_normal(time.size)
    record = Record(
        name="run", time=time, inputs={"torque": torque}, outputs={"w": w + noise},
        sensors={"w": Sensor(name="w", unit="rad/s", sigma=0.01)},
    )  # fmt: skip
    inside = [e for e in candidates(model, record) if e.component == "w"]
    laws = ["dry", "one-sided", "Stribeck", "viscous", "quadratic"]
    expected = [*(f"{law} friction w" for law in laws), "constant force w", "friction by torque w"]
    assert [e.name for e in inside] == expected
    (named,) = model.diagnose([record], options=Options(max_effects=2, tries=4)).named
    assert (named.cause, named.unit) == ("dry friction w", "N m")
    assert named.low < 0.03 < named.high


def test_states_that_are_no_speeds_are_no_coordinates():
    units = {"T": "degC", "h": "m", "q": "m^3/s", "n": "1/s"}
    model = Equations(lambda t, x, u, p: (-x.T, -x.h, -x.q, -x.n), states=units)
    assert model.coordinates == ()
    speeds = Equations(lambda t, x, u, p: (-x.a, -x.b), states={"a": "mm/s", "b": "deg/s"})
    assert [c.travel_unit for c in speeds.coordinates] == ["mm", "deg"]
    assert [c.unit for c in speeds.coordinates] == ["mm/s^2", "deg/s^2"]
