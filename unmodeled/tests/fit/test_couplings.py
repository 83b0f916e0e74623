"""Couplings that are found in the rates, and what acts in them."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled import Coupling, Equations, Options, Record, Sensor, candidates
from unmodeled.cli import main
from unmodeled.fit import Named

TURNS = {"a": "rad", "v": "rad/s", "b": "rad", "w": "rad/s"}
SLIDES = {"a": "m", "v": "m/s", "b": "m", "w": "m/s"}
WHEELS = {"J": (1e-3, 1e-4, "kg m^2"), "I": (0.02, 1e-3, "kg m^2"), "k": (30.0, 1.0, "N m/rad")}
CARTS = {"m": (2.0, 0.1, "kg"), "n": (3.0, 0.1, "kg"), "k": (30.0, 1.0, "N/m"), "c": (1.0, 0.1)}


def couplings(rates, states, parameters):
    model = Equations(rates, states=states, parameters=parameters)
    return model, [c for c in model.coordinates if isinstance(c, Coupling)]


def geared(ratio, own=lambda x, p: 0.0):
    """Two wheels at a shaft with a gear; something of its own pulls at the second."""

    def rates(t, x, u, p):
        n = ratio(p)
        torque = p.k * (x.a / n - x.b)
        return x.v, (u.T - torque / n - 0.1 * x.v) / p.J, x.w, (torque - own(x, p)) / p.I

    return rates


@pytest.mark.parametrize(
    ("rates", "ratio"),
    [
        (geared(lambda p: 1.0), 1.0),
        (geared(lambda p: 50.0), 50.0),
        (geared(lambda p: -2.0), -2.0),
        (geared(lambda p: p.n), 20.0),  # a parameter
        (geared(lambda p: 50.0, lambda x, p: 7.0 * np.sin(x.b)), 50.0),  # the second one hangs
        (geared(lambda p: 50.0, lambda x, p: p.g * x.b), 50.0),
        (geared(lambda p: 1.0, lambda x, p: 7.0 * x.b), 1.0),
        (geared(lambda p: 1.0, lambda x, p: 7.0 * math.sin(x.b)), 1.0),  # numbers only
    ],
)
def test_the_ratio_of_a_coupling_follows_from_the_rates(rates, ratio):
    model, (found,) = couplings(rates, TURNS, {**WHEELS, "n": (20.0, 0.1, "1"), "g": (4.0, 1.0)})
    assert found.name == "between a and b"
    assert (found.ratio, found.first.inertia, found.second.inertia) == (ratio, "J", "I")
    assert (found.unit, found.travel_unit) == ("N m", "rad")
    assert (model._coupled.assumed, model._coupled.untold) == ((), ())


def test_forces_between_bodies_that_travel_in_mm_are_accelerations():
    """An inertia in kg times an acceleration in mm/s^2 would be told in N, and is in mN."""

    def rates(t, x, u, p):
        inner = p.k * (x.a - x.b)
        return x.v, (1000.0 * u.f - inner) / p.m, x.w, inner / p.n

    states = {"a": "mm", "v": "mm/s", "b": "mm", "w": "mm/s"}
    _, (found,) = couplings(rates, states, CARTS)
    assert (found.unit, found.first.inertia) == ("mm/s^2", None)
    assert found.second.inertia == pytest.approx(1.5)  # n / m


def test_a_ratio_that_the_rates_do_not_tell_is_assumed_for_equal_units_and_printed():
    def rates(t, x, u, p):
        inner = p.k * (x.a - x.b)
        return x.v, (u.f - inner - 4.0 * x.a) / p.m, x.w, (inner - p.c * x.b) / p.n

    model, (found,) = couplings(rates, SLIDES, CARTS)
    assert (found.ratio, model._coupled.assumed) == (1.0, (found.name,))
    time = np.linspace(0.0, 1.0, 101)
    record = Record(name="r", time=time, inputs={"f": 0 * time}, outputs={"a": np.cos(time)})
    text = "couplings, from the rates: between a and b (ratio 1, assumed, inertias m and n)"
    assert text in model.ready([record]).notes

    # A rack between a wheel and a mass, and a spring at both: no ratio is usual.
    def rack(t, x, u, p):
        inner = p.k * (p.r * x.a - x.b)
        return x.v, (-p.r * inner - 4.0 * x.a) / p.J, x.w, (inner - p.c * x.b) / p.n

    units = {**SLIDES, "a": "rad", "v": "rad/s"}
    model, found = couplings(rack, units, {**WHEELS, **CARTS, "r": (0.02, 1e-3, "m")})
    assert (found, model._coupled.untold) == ([], ("between a and b",))
    notes = " ".join(model.ready([record]).notes)
    assert "do not tell the ratio of the coupling between a and b" in notes


def test_inertias_that_are_no_parameters_are_in_proportion():
    def rates(t, x, u, p):
        inner = p.k * (x.a - x.b)
        return x.v, (u.f - inner) / 2.0, x.w, (inner - 0.1 * x.w) / 3.0

    _, (found,) = couplings(rates, SLIDES, CARTS)
    assert (found.first.inertia, found.second.inertia, found.unit) == (None, 1.5, "m/s^2")
    pushed = found.push(6.0, 0.0, Named({}), Named({}), Named({}))
    assert pushed == {"v": 6.0, "w": -4.0}


def test_a_chain_has_a_coupling_between_neighbors():
    def rates(t, x, u, p):
        one, two = p.k * (x.a - x.b), p.c * (x.b - x.q)
        return x.v, -one / p.m, x.w, (one - two) / p.n, x.r, two / p.m

    _, found = couplings(rates, {**SLIDES, "q": "m", "r": "m/s"}, CARTS)
    assert [c.name for c in found] == ["between a and b", "between b and q"]


@pytest.mark.parametrize("stiffness", [1.0, 40.0])
def test_a_state_that_is_the_twist_or_the_torque_of_a_shaft_is_its_position(stiffness):
    """The usual equations of a drive: two speeds, and what is between them."""

    def rates(t, x, u, p):
        torque = p.k / stiffness * x.z
        return (u.T - torque) / p.J, (torque - 0.1 * x.w) / p.I, stiffness * (x.v - x.w)

    model, (found,) = couplings(rates, {"v": "rad/s", "w": "rad/s", "z": "rad"}, WHEELS)
    assert (found.position, found.position_scale) == ("z", 1.0 / stiffness)
    assert (found.ratio, found.first.inertia, found.second.inertia) == (1.0, "J", "I")
    motion = found.motion(Named({"v": 3.0, "w": 1.0, "z": 8.0}))
    assert motion == pytest.approx((8.0 / stiffness, 2.0))
    time = np.linspace(0.0, 1.0, 101)
    record = Record(name="r", time=time, inputs={"T": np.sin(9.0 * time)}, outputs={"v": 0 * time})
    names = [e.name for e in candidates(model, [record])]
    assert "dead zone between v and w" in names
    assert "leak z" not in names  # it is no level


def test_a_clutch_between_two_speeds_has_laws_of_the_speed():
    def rates(t, x, u, p):
        torque = p.k * (x.v - x.w)
        return -torque / p.J, torque / p.I  # no input: each rate is in proportion to a difference

    model, (found,) = couplings(rates, {"v": "rad/s", "w": "rad/s"}, WHEELS)
    assert (found.position, found.ratio) == ("", 1.0)
    time = np.linspace(0.0, 1.0, 101)
    record = Record(name="r", time=time, inputs={}, outputs={"v": np.cos(time)})
    names = [e.name for e in candidates(model, [record]) if e.component == "between v and w"]
    assert "dry friction between v and w" in names
    assert not [n for n in names if "stiffness" in n or "dead zone" in n]


def double_pendulum(t, x, u, p):
    """Angles that are absolute: what is between them acts through the inertia of both."""
    c, s = np.cos(x.a - x.b), np.sin(x.a - x.b)
    one = -p.n * s * x.w**2 - 9.8 * (p.m + p.n) * np.sin(x.a)
    two = p.n * s * x.v**2 - 9.8 * p.n * np.sin(x.b)
    free = (p.m + p.n) * p.n - (p.n * c) ** 2
    turns = (p.n * one - p.n * c * two) / free, ((p.m + p.n) * two - p.n * c * one) / free
    return x.v, turns[0], x.w, turns[1]


def test_where_no_force_acts_between_two_bodies_there_is_no_coupling():
    def none(rates, states, parameters=CARTS):
        model, found = couplings(rates, states, parameters)
        return (found, model._coupled.untold) == ([], ())

    apart = lambda t, x, u, p: (x.v, (u.f - p.k * x.a) / p.m, x.w, -p.k * x.b / p.n)  # noqa: E731
    assert none(apart, SLIDES)
    # Forces of a gyroscope are no pair of opposite forces.
    turning = lambda t, x, u, p: (  # noqa: E731
        x.v, (p.c * x.w - p.k * x.a) / p.m, x.w, (-p.c * x.v - p.k * x.b) / p.m
    )  # fmt: skip
    assert none(turning, SLIDES)
    assert none(double_pendulum, TURNS)
    # Two temperatures or levels are no bodies.
    flow = lambda t, x, u, p: (-p.k * (x.a - x.b) / p.m, p.k * (x.a - x.b) / p.n)  # noqa: E731
    for unit in ("degC", "m"):
        assert none(flow, {"a": unit, "b": unit})


def test_the_size_of_a_candidate_follows_from_the_force_in_the_coupling():
    """A stiff shaft that moves slowly: its twist has next to no acceleration."""

    def rates(t, x, u, p):
        inner = p.k * (x.a - x.b)
        return x.v, (u.T - inner) / p.J, x.w, inner / p.I

    model, (found,) = couplings(rates, TURNS, {**WHEELS, "k": (1e4, 100.0, "N m/rad")})
    time = np.linspace(0.0, 2.0, 201)
    x = {"a": 0.3 + 0.2 * time, "v": time, "b": 0.1 * time, "w": 0 * time}
    record = Record(name="r", time=time, inputs={"T": np.sin(5 * time)}, outputs={"a": 0 * time})
    force = model.force_in(found, record, Named(x))
    np.testing.assert_allclose(force, -1e4 * (x["a"] - x["b"]))


def test_what_a_parameter_does_is_no_candidate_of_a_coupling():
    """A linear spring beside one whose stiffness is a parameter with a tolerance."""

    def names(k):
        def rates(t, x, u, p):
            inner = p.k * (x.a - x.b) + 0.1 * (x.v - x.w)
            return x.v, (u.T - inner) / p.J, x.w, inner / p.I

        model, _ = couplings(rates, TURNS, {**WHEELS, "k": k})
        time = np.linspace(0.0, 2.0, 201)
        torque = {"T": np.sin(5 * time)}
        record = Record(name="r", time=time, inputs=torque, outputs={"a": 0 * time})
        found = candidates(model, [record])
        return {e.name for e in found if e.component == "between a and b"}

    with_tolerance, fixed = names((30.0, 1.0, "N m/rad")), names((30.0, 0.0, "N m/rad"))
    assert fixed - with_tolerance == {"linear stiffness between a and b"}
    assert {"dead zone between a and b", "viscous friction between a and b"} <= with_tolerance


# ---------------------------------------------------------------- a drive of two bodies

DRIVE = """
import unmodeled

PRIORS = {
    "J1": (0.0103, 3e-4, "kg m^2"),
    "J2": (0.0194, 6e-4, "kg m^2"),
    "k": (41.0, 2.0, "N m/rad"),
    "d": (0.031, 0.003, "N m s/rad"),
}


def rates(t, x, u, p):
    torque = p.k * (x.motor - x.load) + 0.02 * (x.speed - x.rate)
    motor = (u.T - torque - p.d * x.speed) / p.J1
    return x.speed, motor, x.rate, (torque - p.d * x.rate) / p.J2


model = unmodeled.Equations(
    rates,
    states={"motor": "rad", "speed": "rad/s", "load": "rad", "rate": "rad/s"},
    parameters=PRIORS,
    inputs={"T": "N m"},
    outputs={"motor": "motor"},
)
"""
TIME, NOISE = 0.004 * np.arange(500), 2e-4


def drive(t, i):
    return (0.8 + 0.2 * i) * sum(
        np.sin(2 * np.pi * f * t + f * (i + 1)) for f in (1.3, 3.1, 6.2, 9.7)
    ) / 2  # fmt: skip


def measured(between, at_motor, stiffness=40.0):
    """Runs of the drive, by SciPy, with torques of two laws that the model does not have."""
    random, out = np.random.default_rng(8), []
    for i in range(2):

        def rates(t, x, i=i):
            twist, rate = x[0] - x[2], x[1] - x[3]
            torque = stiffness * twist + 0.02 * rate + between(twist, rate)
            motor = drive(t, i) - torque - 0.03 * x[1] - at_motor(x[1])
            return x[1], motor / 0.01, x[3], (torque - 0.03 * x[3]) / 0.02

        y = solve_ivp(rates, (0.0, TIME[-1]), np.zeros(4), t_eval=TIME, rtol=1e-8, atol=1e-10,
                      max_step=0.002).y[0]  # fmt: skip
        out.append(y + NOISE * random.standard_normal(y.size))
    return [
        Record(
            name=f"run{i}",
            time=TIME,
            inputs={"T": drive(TIME, i)},
            outputs={"motor": y},
            sensors={"motor": Sensor(name="motor", unit="rad", sigma=NOISE)},
        )
        for i, y in enumerate(out)
    ]


def nothing(*_):
    return 0.0


def clearance(twist, rate):
    return -40.0 * np.clip(twist, -0.006, 0.006)


def rubbing(twist, rate):
    return 0.2 * np.tanh(rate / 0.02)


@pytest.mark.parametrize(
    ("between", "at_motor", "cause", "said"),
    [
        (clearance, nothing, "dead zone between motor and load",
         "There is backlash of \N{PLUS-MINUS SIGN}0.00"),
        (rubbing, nothing, "dry friction between motor and load", "acts between motor and load"),
        (nothing, lambda v: 0.1 * np.tanh(v / 0.02), "dry friction motor",
         "The motor has dry friction of 0."),
    ],
)  # fmt: skip
def test_what_acts_between_two_bodies_is_told_from_what_acts_at_one(between, at_motor, cause, said):
    """The position of the motor alone is measured, and the coupling is stated nowhere."""
    place = {}
    exec(DRIVE, place)
    options = Options(max_effects=2)
    report = place["model"].diagnose(measured(between, at_motor), options=options)
    assert [c.cause for c in report.named if not c.parameter] == [cause]
    assert report.classes == ()
    assert said in str(report).replace("\n", " ")


def test_a_stiffness_that_is_off_stays_a_parameter():
    place = {}
    exec(DRIVE, place)
    records = measured(nothing, nothing, stiffness=52.0)
    report = place["model"].diagnose(records, options=Options(max_effects=2))
    (k,) = report.named
    assert (k.cause, k.parameter, round(k.magnitude)) == ("k", True, 52)


def test_a_clearance_between_two_bodies_is_told_on_the_command_line(tmp_path, capsys):
    (tmp_path / "drive.py").write_text(DRIVE, encoding="utf-8")
    for record in measured(clearance, nothing):
        columns = np.column_stack([record.time, record.inputs["T"], record.outputs["motor"]])
        np.savetxt(tmp_path / f"{record.name}.csv", columns, delimiter=",",
                   header="time (s),T (N m),motor (rad)", comments="")  # fmt: skip
    files = [str(tmp_path / n) for n in ("drive.py", "run0.csv", "run1.csv")]
    with pytest.raises(SystemExit):
        main(["diagnose", *files, "--max-effects", "1"])
    told = " ".join(capsys.readouterr().out.split())
    assert "here is backlash of \N{PLUS-MINUS SIGN}0.00" in told
    assert "between motor and load, where the stiffness of" in told
