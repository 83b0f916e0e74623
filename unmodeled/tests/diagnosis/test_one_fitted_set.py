"""Small machines whose answers were of several fits, or lost after the search had found them."""

from __future__ import annotations

import numpy as np
import pytest

from unmodeled import (
    Effect,
    Equations,
    LinearModel,
    Options,
    Parameter,
    Record,
    Sensor,
    Verdict,
    diagnose,
)
from unmodeled.search.ledger import Mark
from unmodeled.search.result import Reason


def measured(name, time, inputs, outputs, sigma, unit, role="fit"):
    """A record of one output."""
    ((key, values),) = outputs.items()
    sensors = {key: Sensor(name=key, unit=unit, sigma=sigma)}
    return Record(name=name, time=time, inputs=inputs, outputs={key: values}, sensors=sensors,
                  role=role)  # fmt: skip


def capacitor(k):
    """Voltage of a capacitor behind a resistor: R is 4 % larger than tabulated, C 2 % smaller."""
    rng = np.random.default_rng(k)
    time, u, v = np.arange(600) * 2e-5, 4.0 * np.sign(rng.standard_normal(24)).repeat(25), [0.0]
    for a in u[:-1]:
        v.append(a + (v[-1] - a) * np.exp(-2e-5 / (10.4 * 98e-6)))
    noisy = np.array(v) + 4e-3 * rng.standard_normal(600)
    return measured(f"r{k}", time, {"u": u}, {"vc": noisy}, 4e-3, "V")


def test_of_two_parameters_that_act_as_a_product_the_product_is_told():
    """A number of one of them "alone" holds only if the other one has not changed: it has."""
    model = Equations(
        lambda t, x, u, p: ((u.u - x.vc) / (p.R * p.C),),
        states={"vc": (0.0, 1e-3, "V")},
        parameters={"R": (10.0, 0.5, "ohm"), "C": (1e-4, 5e-6, "F")},
        inputs={"u": "V"},
        hold="zero",
    )
    report = model.diagnose([capacitor(k) for k in (1, 2, 3)])
    ends = {p.name: (p.low, p.high) for p in report.parameters}
    assert ends["R"][0] < 10.4 < ends["R"][1]
    assert ends["C"][0] < 98e-6 < ends["C"][1]
    (change,) = report.changes
    assert change.name == "R C"
    assert change.low < 10.4 * 98e-6 / 1e-3 - 1.0 < change.high
    assert change.high - change.low < 1e-3
    assert report.summary().startswith("The product R C (R, or C, or both) differs from the model")
    assert report.verdict is Verdict.CALIBRATED


def motor(k):
    """Speed of a motor with dry friction of 0.03 N m, and an inertia 3 % above the tabulated."""
    rng, h, n = np.random.default_rng(k), 2e-3, 40
    time = np.arange(1001) * h
    waves = zip(rng.uniform(0.3, 5.0, 4), rng.uniform(0.0, 6.0, 4), strict=True)
    voltage = 3.0 * sum(np.sin(2.0 * np.pi * f * time + phase) for f, phase in waves)
    inertia, w = 2.06e-3, [0.0]
    for a, b in zip(voltage[:-1].tolist(), voltage[1:].tolist(), strict=True):
        x = w[-1]
        for j in range(n):
            torque = 0.08 * (a + (j + 0.5) / n * (b - a) - 0.08 * x) / 1.2 - 1e-4 * x
            free = x + h / n * torque / inertia
            x = np.sign(free) * max(abs(free) - h / n * 0.03 / inertia, 0.0)
        w.append(x)
    noisy = np.array(w) + 0.1 * rng.standard_normal(time.size)
    role = "held_out" if k % 3 == 2 else "fit"
    return measured(f"r{k}", time, {"voltage": voltage}, {"w": noisy}, 0.1, "rad/s", role)


@pytest.mark.parametrize("effects", [["dry*"], pytest.param(None, marks=pytest.mark.slow)])
def test_a_ridge_of_two_parameters_does_not_name_one_of_them(effects):
    """R and J act through their product: what is told of one of them must hold the truth."""
    model = Equations(
        lambda t, x, u, p: ((p.k * (u.voltage - p.k * x.w) / p.R - p.visc * x.w) / p.J,),
        states={"w": (0.0, 0.0, "rad/s")},
        parameters={
            "J": (2e-3, 1e-4, "kg m^2"),
            "R": (1.2, 0.06, "ohm"),
            "k": (0.08, 0.0, "V s"),
            "visc": (1e-4, 0.0, "N m s/rad"),
        },
        inputs={"voltage": "V"},
    )
    report = model.diagnose([motor(k) for k in (3, 4, 5)], effects=effects)
    (named,) = report.named
    assert named.cause == "dry friction w"
    assert named.low < 0.03 < named.high
    ends = {p.name: (p.low, p.high) for p in report.parameters}
    assert ends["J"][0] < 2.06e-3 < ends["J"][1]
    assert ends["R"][0] < 1.2 < ends["R"][1]
    for change in report.changes[1:]:  # the product, if it is surely another one
        assert change.name == "J R"
        assert change.low < 0.03 < change.high
    told = " ".join(report.summary().split())
    assert told.startswith("Dry friction of 0.029")
    assert "parameter R is" not in told
    assert "parameter J is" not in told


def coil(k, samples):
    """Voltage of a capacitor behind a resistor and a coil, which the model lacks."""
    rng, h, v, i, out = np.random.default_rng(50 + k), 2e-5, 0.0, 0.0, []
    u = 3.0 * np.sign(rng.standard_normal(samples // 20)).repeat(20)
    for a in u.tolist():
        out.append(v)
        for _ in range(50):
            i += h / 50.0 * (a - 12.0 * i - v) / 1.6e-3
            v += h / 50.0 * i / 80e-6
    noisy = np.array(out) + 3e-3 * rng.standard_normal(samples)
    return measured(f"r{k}", np.arange(samples) * h, {"u": u}, {"v": noisy}, 3e-3, "V")


COIL = Equations(
    lambda t, x, u, p: ((u.u - x.v) / (p.R * p.C),),
    states={"v": (0.0, 1e-3, "V")},
    parameters={"R": (12.0, 0.2, "ohm"), "C": (80e-6, 2e-6, "F")},
    inputs={"u": "V"},
    outputs={"v": "v"},
    hold="zero",
)


@pytest.mark.parametrize(
    ("samples", "effects"),
    [(300, ["lag*", "delay of input*"]), pytest.param(700, None, marks=pytest.mark.slow)],
)
def test_the_model_that_is_handed_out_leaves_what_the_page_says(samples, effects):
    records = [coil(k, samples) for k in range(3)]
    report = COIL.diagnose(records, effects=effects)
    (c,) = report.channels
    assert c.explained < 1.1 * c.noise
    squares = [(report.model.simulate(r)["v"] - r.outputs["v"]) ** 2 for r in records]
    assert np.sqrt(np.mean(squares)) == pytest.approx(c.explained, rel=0.02)
    # Its effects and parameters are those of the list.
    sizes = {n.cause: n.magnitude for g in (*report.classes, report.named) for n in g}
    for name, size in report.model.effects.items():
        assert size == pytest.approx(sizes[name], rel=1e-9)
    fitted = {p.name: p.value for p in report.parameters}
    for name, value in report.model.parameters.items():
        assert value == pytest.approx(fitted[name], rel=1e-9)
    assert {*report.model.effects} <= {*report.reported}


@pytest.mark.slow
def test_no_parameter_is_an_equivalent_of_two_members_of_the_answer():
    """A lag of the input or of the sensor, and R, C or an exchange: not R or C for a lag."""
    report = COIL.diagnose([coil(k, 700) for k in range(3)])
    told = [n.cause for g in report.classes for n in g]
    assert len({*told}) == len(told)
    lag = next(g for g in report.classes if g[0].cause.startswith("lag"))
    assert {n.cause for n in lag} == {"lag of input u", "lag of sensor v"}


def swing(parts):
    """Parts of a swing with dry friction that rises a little at low speed; encoder of 2 pi/1000."""
    step, q, v, out = 1e-3, -2.2, 0.0, []

    def rate(q, v):
        rise = 0.125 + 0.075 * np.exp(-((v / 2.8) ** 2))
        return -30.9 * np.sin(q) - 0.026 * v - rise * np.tanh(v / 0.02)

    for _ in range(int(12 * parts / step)):
        out.append(q)
        k = rate(q, v)
        middle = rate(q + 0.5 * step * v, v + 0.5 * step * k)
        q, v = q + step * (v + 0.5 * step * k), v + step * middle
    each = np.array(out).reshape(parts, -1)[:, ::20]
    count = 2.0 * np.pi / 1000.0
    time = np.arange(each.shape[1]) * 20 * step
    sensors = {"q": Sensor(name="q", unit="rad")}
    return [
        Record(name=f"part{k + 1}", time=time, inputs={}, sensors=sensors,
               outputs={"q": np.round(q / count) * count}, role="held_out" if k % 2 else "fit")
        for k, q in enumerate(each)
    ]  # fmt: skip


PENDULUM = Equations(
    lambda t, x, u, p: (x.w, -p.w2 * np.sin(x.q) - p.d * x.w),
    states={"q": "rad", "w": "rad/s"},
    parameters={"w2": (31.0, 3.0, "1/s^2"), "d": (0.02, 0.02, "1/s")},
    bounds={"d": (0, 10), "w2": (1, 1e3)},
    outputs={"q": "q"},
)


@pytest.mark.parametrize("parts", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_a_law_that_is_right_to_some_percent_is_not_refused(parts):
    """Its size differs between records by less than what matters; it leaves less than that."""
    report = PENDULUM.diagnose(swing(parts), effects=["dry*"])
    assert report.refused == ()
    assert Reason.DIFFERS_BETWEEN_RECORDS not in report.reasons
    (named,) = report.named
    assert named.cause == "dry friction q"
    assert 0.125 < named.low < named.high < 0.21  # of 0.125 at high speed and 0.2 at low speed
    (c,) = report.channels
    assert c.share(c.explained) < 0.01
    assert c.held_out_explained < 0.4 * c.held_out_calibrated


@pytest.mark.slow
def test_two_laws_that_take_little_each_and_much_together_both_matter():
    report = PENDULUM.diagnose(swing(5))
    sizes = {n.cause: n for n in report.named}
    assert {*sizes} == {"dry friction q", "Stribeck friction q"} == {*report.reported}
    assert sizes["dry friction q"].low < 0.125 < sizes["dry friction q"].high
    assert sizes["Stribeck friction q"].low < 0.075 < sizes["Stribeck friction q"].high


@pytest.mark.parametrize(("third", "fifth"), [(0.08, 0.08), (0.08, 0.0)])
def test_a_member_is_small_if_all_small_ones_are_small_together(third, fifth):
    """Without one of two like laws the other one follows; without both, more than 1 % is left."""
    u = np.linspace(-1.0, 1.0, 400)
    records = []
    for k in range(3):
        noise = 1e-4 * np.random.default_rng(k).standard_normal(u.size)
        y = u + third * u**3 + fifth * u**5 + 0.006 * np.cos(3.0 * u) + noise
        sensors = {"y": Sensor(name="y", sigma=1e-4)}
        records.append(Record(name=f"r{k}", time=np.arange(u.size) * 0.01, inputs={"u": u},
                              outputs={"y": y}, sensors=sensors))  # fmt: skip
    laws = {
        "third power": lambda r, _: r.inputs["u"] ** 3,
        "fifth power": lambda r, _: r.inputs["u"] ** 5,
        "cosine": lambda r, _: np.cos(3.0 * r.inputs["u"]),
    }
    effects = [Effect(name=n, component="spring", scale=0.1, regressor=f) for n, f in laws.items()]
    slope = Parameter(name="slope", value=1.0, sd=0.1)
    model = LinearModel(output="y", columns={"slope": lambda r: r.inputs["u"]}, parameters=[slope])
    report = diagnose(model, effects, records)
    assert {n.cause for (n,) in report.small} == {"cosine"}
    alike = {"third power", "fifth power"} if fifth else {"third power"}
    assert {n.cause for n in report.named} == alike
    if fifth:
        change = next(c for c in report.changes if c.name == "third power")
        assert {*change.beside} == {"cosine", "fifth power"}
        assert "without it, " in str(report)


HARDENING = Effect(
    name="hardening",
    component="spring",
    unit="N/m^3",
    scale=1000.0,
    regressor=lambda r, _: r.inputs["x"] ** 3,
)


def spring(tabulated=100.0):
    k = Parameter(name="k", value=tabulated, sd=0.05, unit="N/m")
    columns = {"k": lambda r: r.inputs["x"]}
    return LinearModel(name="spring", output="force", columns=columns, parameters=[k])


def stroke(name, cycles, hardening):
    t = np.linspace(0.0, 2.0, 200)
    x = 0.1 * np.sin(cycles * np.pi * t)
    force = 100.0 * x + hardening * x**3
    force += np.random.default_rng(cycles).normal(0.0, 0.05, t.size)
    return measured(name, t, {"x": x}, {"force": force}, 0.05, "N")


def test_the_residual_does_not_choose_what_is_held_out():
    """A fault acts in c only. Whatever the model misses, the same record is held out, and told."""
    records = [stroke("a", 2, 0.0), stroke("b", 5, 0.0), stroke("c", 3, 2000.0)]
    notes = set()
    for tabulated in (60.0, 100.0, 140.0):
        report = diagnose(spring(tabulated), [HARDENING], records)
        notes |= {n for n in report.notes if n.startswith("held out")}
    (note,) = notes
    assert "chosen before any fit from the ranges of inputs and outputs" in note
    # A size that differs between the records is no size of all records.
    report = diagnose(spring(), [HARDENING], records)
    (named,) = report.named
    assert (named.cause, named.subject.scope.records) == ("hardening in c", ("c",))
    assert named.low < 2000.0 < named.high


def test_held_out_records_have_the_ranges_of_the_others():
    """The record inside the ranges of the others; none: every third one."""
    inside = [stroke("a", 2, 2000.0), stroke("b", 5, 2000.0), stroke("c", 3, 2000.0)]
    small = stroke("small", 4, 2000.0)
    half = {"x": 0.5 * small.inputs["x"]}
    force = 100.0 * half["x"] + 2000.0 * half["x"] ** 3
    small = measured("small", small.time, half, {"force": force}, 0.05, "N")
    report = diagnose(spring(), [HARDENING], [small, *inside[:2]])
    assert any(n.startswith("held out: small, ") for n in report.notes)
    assert report.finding("hardening").mark is Mark.NAMED
    assert report.findings[0].of == 1


def test_readings_of_tolerances_are_the_users():
    """The product is known as well in both; of one alone, a repair tells more than a drawing."""
    model = Equations(
        lambda t, x, u, p: ((u.u - x.vc) / (p.R * p.C),),
        states={"vc": (0.0, 1e-3, "V")},
        parameters={"R": (10.0, 0.5, "ohm"), "C": (1e-4, 5e-6, "F")},
        inputs={"u": "V"},
        hold="zero",
    )
    records = [capacitor(k) for k in (1, 2, 3)]
    drawn = model.diagnose(records, effects=[], options=Options(tolerances="drawn"))
    kept = model.diagnose(records, effects=[], options=Options(tolerances="kept"))
    assert (drawn.drawn, kept.drawn) == (1.0, 0.0)
    (a, b) = (next(p for p in r.parameters if p.name == "R") for r in (drawn, kept))
    assert b.high - b.low < a.high - a.low
    assert a.low < 10.4 < a.high
