"""Effects on the states of first-order systems: closed forms, wrong input, and a diagnosis."""

import numpy as np
import pytest

from unmodeled import Equations, Parameter, State, Verdict, candidates, diagnose, library
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.models.model import Candidate, Jobs, SensitivityRequest

MINUTE = 60.0
VESSEL = Equations(
    name="heated vessel",
    states=[State(name="T", unit="degC", scale=20.0, start=20.0, start_sd=10.0)],
    parameters=[
        Parameter(name="C", value=20e3, sd=2e3, unit="J/K", lower=1e3),
        Parameter(name="G", value=3.0, sd=0.5, unit="W/K", lower=0.0),
    ],
    inputs={"heater": "W", "room": "degC"},
    hold="zero",
    rates=lambda t, x, u, p: ((u.heater - p.G * (x.T - u.room)) / p.C,),
    outputs={"vessel": "T"},
    ports={"vessel": "T"},
)


def record(name, heater, room, seen):
    return Record(
        name=name,
        time=MINUTE * np.arange(len(seen)),
        inputs={"heater": heater, "room": room},
        outputs={"vessel": seen},
        sensors={"vessel": Sensor(name="vessel", unit="degC", sigma=0.1)},
    )


def measured(seed, size):
    """A vessel that also loses size * difference |difference| [degC/s] to the air of a room."""
    random = np.random.default_rng(seed)
    heater = np.repeat(random.permutation([0.0, 60.0, 120.0, 180.0, 250.0]), 60)
    room = random.uniform(17.0, 23.0) + 2.0 * np.sin(np.arange(heater.size) / 60.0 + seed)
    vessel, seen = 21.0, []
    for watts, air in zip(heater, room, strict=True):
        seen.append(vessel)
        for _ in range(60):  # s
            d = vessel - air
            vessel += (watts - 2.8 * d) / 21e3 - size * d * abs(d)
    return record(f"day {seed}", heater, room, seen + 0.1 * random.standard_normal(heater.size))


@pytest.mark.parametrize("power", [1.0, 1.25, 2.0])
@pytest.mark.parametrize("start", [60.0, -10.0])
def test_exchange_and_its_derivative_have_closed_forms(power, start):
    """d' = -m d |d|^(p - 1) of the difference d, for a body above and below the ambient value."""
    room, size = 20.0, 1e-4
    effect = library.exchange("T", "room", power, scale=1e-4)
    alone = Equations(
        states=[State(name="T", unit="degC", scale=20.0)],
        inputs={"room": "degC"},
        rates=lambda t, x, u, p: (0.0 * x.T,),
        outputs={"T": "T"},
    )
    time = 30.0 * np.arange(101)
    one = Record(name="r", time=time, inputs={"room": room + 0 * time}, outputs={"T": 0 * time})
    first = abs(start - room)
    if power == 1.0:
        exact = first * np.exp(-size * time)
    else:
        exact = (first ** (1.0 - power) + (power - 1.0) * size * time) ** (1.0 / (1.0 - power))
    slope = -time * exact**power  # from the closed form, by the magnitude
    sign = np.sign(start - room)
    request = SensitivityRequest(
        record=one,
        theta=np.zeros(0),
        start=np.array([start]),
        included=(Candidate(effect),),
        magnitudes=np.array([size]),
    )
    (found,) = alone.sensitivities([request])
    assert np.allclose(found.outputs[:, 0], room + sign * exact, atol=1e-4)
    assert np.allclose(found.d_magnitudes[:, 0, 0], sign * slope, atol=1e-2 * np.ptp(slope))
    jobs = Jobs(
        theta=np.zeros((1, 0)),
        starts=request.start[None],
        included=request.included,
        magnitudes=np.zeros((1, 1)),
    )
    assert np.array_equal(alone.simulate(one, jobs)[0, :, 0], np.full(101, start))


def test_a_quadratic_loss_to_the_room_is_named():
    """It was named as a combination of leak, inflow and T^2, which is the same polynomial."""
    effects = (
        library.leak("T", scale=1e-5),
        library.constant_rate("T", scale=1e-4, unit="degC/s"),
        library.power_outflow("T", 2.0, scale=1e-6, unit="1/(degC s)"),
        library.exchange("T", "room", 2.0, scale=1e-6, unit="1/(degC s)"),
        library.sensor_fault(["vessel"], "vessel", "gain"),
    )
    days = [measured(seed, 1.4e-6) for seed in (1, 2, 3)]
    report = diagnose(VESSEL, effects, days, hold_out=["day 3"])
    assert report.verdict is Verdict.NAMED
    (found,) = report.named
    assert found.cause == "exchange ~ (T - room)^2"
    assert found.low < 1.4e-6 < found.high
    assert 0.8 < found.magnitude / 1.4e-6 < 1.2


@pytest.mark.parametrize("power", [0.0, -1.0, np.inf, np.nan, "2", True])
def test_a_wrong_power_is_told(power):
    with pytest.raises(InvalidParameter, match=r"exchange: power.*expected a finite number"):
        library.exchange("T", "room", power, scale=1.0)


@pytest.mark.parametrize(
    ("state", "ambient", "told"),
    [("T", "rom", "no 'rom'; known are heater, room"), ("Q", "room", "no 'Q'; known are T")],
)
def test_a_wrong_name_is_told_with_the_known_ones(state, ambient, told):
    effect = library.exchange(state, ambient, scale=1e-4)
    time = np.zeros(50)
    with pytest.raises(InvalidParameter, match=told):
        diagnose(VESSEL, [effect], [record("r", time, time, time)])


def test_a_state_that_stays_where_it_is_has_effects_of_a_finite_size():
    """Its rate is 0; with an uneven clock, differences of its values are rounding."""
    time = np.r_[np.arange(0.0, 30.0, 0.5), np.arange(30.0, 70.0), np.arange(70.0, 80.0, 0.1)]
    current = np.where(time < 30.0, 30.0, 0.0)
    cell = Equations(
        lambda t, x, u, p: (0.0 * u.I,),
        states={"ocv": (4.0, 0.1, "V")},
        parameters={"R0": (0.002, 0.001, "Ohm")},
        inputs={"I": "A"},
        outputs={"V": (lambda t, x, u, p: x.ocv - p.R0 * u.I, "V")},
    )
    record = Record(name="p", time=time, inputs={"I": current}, outputs={"V": 4.0 - 1e-3 * current})
    offered = {e.name: e.scale for e in candidates(cell, record)}
    assert offered["constant inflow ocv"] == 0.1
