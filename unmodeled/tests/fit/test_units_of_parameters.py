"""A stated unit is the unit of the number; the function gets SI, or the unit that it states."""

import numpy as np
import pytest

import unmodeled
from unmodeled import Options, Record, Sensor
from unmodeled.cli.models import StatedOptions
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit import Effect, Exposed, Parameter
from unmodeled.loading import load_model
from unmodeled.models.model import prior_jobs
from unmodeled.units import ACCEPTED_UNITS

TIME = np.linspace(0.0, 2.0, 60)
POUND = 0.45359237


def records(mass=2.0, extra=0.0):
    found = []
    for k in range(3):
        u = np.sin((k + 1) * TIME)
        noise = 1e-3 * np.random.default_rng(k).standard_normal(TIME.size)
        y = (mass + extra) * u + noise
        found.append(
            Record(
                name=f"r{k}",
                time=TIME,
                inputs={"u": u},
                outputs={"y": y},
                sensors={"y": Sensor(name="y", sigma=1e-3, unit="N")},
            )
        )
    return found


def function_of(got, units=None):
    """A function that writes down what it gets."""

    def load(time, inputs, parameters):
        got.append(dict(parameters))
        return {"y": inputs["u"] * sum(parameters.values())}

    if units:
        load.units = units
    return load


def simulator(got, units=None, **given):
    given.setdefault("parameters", {"m": (4.41, 0.22, "lb")})
    return unmodeled.Simulator(function_of(got, units), **given)


def equations(got, units=None, **given):
    def rates(t, x, u, p):
        got.append(dict(p._values))
        return ((u.u * sum(p._values.values()) - x.y) / 1e-3,)

    if units:
        rates.units = units
    given.setdefault("parameters", {"m": (4.41, 0.22, "lb")})
    return unmodeled.Equations(
        rates, states={"y": (0.0, 0.1, "N")}, method="rosenbrock", hold="linear", **given
    )


@pytest.mark.parametrize("kind", [simulator, equations])
def test_the_function_gets_si_and_a_note_tells_it(kind):
    model = kind([], bounds={"m": (4.0, 5.0)})
    (p,) = model.parameters
    assert (p.value, p.sd) == pytest.approx((4.41 * POUND, 0.22 * POUND))
    assert (p.lower, p.upper) == pytest.approx((4.0 * POUND, 5.0 * POUND))
    assert p.unit == "kg"
    ready = model.ready(records())
    record = ready.records[0]
    force = ready.model.simulate(record, prior_jobs(ready.model, record))[0, -1, 0]
    assert force == pytest.approx(4.41 * POUND * record.inputs["u"][-1], rel=0.01)
    (note,) = [n for n in ready.notes if "units: " in n]
    assert "m = 2.00034 kg (4.41 lb)" in note
    assert ".units = {'m': 'lb'}" in note


@pytest.mark.parametrize("kind", [simulator, equations])
def test_the_function_gets_the_unit_that_it_states(kind):
    got = []
    model = kind(got, {"m": "g"})
    (p,) = model.parameters
    assert (p.value, p.sd, p.unit) == (pytest.approx(4410 * POUND), pytest.approx(220 * POUND), "g")
    (same,) = kind(got, {"m": "lb"}).parameters
    assert (same.value, same.unit) == (4.41, "lb")
    (bare,) = kind(got, {"m": "lb"}, parameters={"m": (4.41, 0.22)}).parameters
    assert (bare.value, bare.unit) == (4.41, "lb")
    with pytest.raises(InvalidParameter, match="parameter m: unit 'lb' does not measure"):
        kind(got, {"m": "s"})


@pytest.mark.parametrize("kind", [simulator, equations])
def test_parameter_objects_follow_the_same_rule(kind):
    own = Parameter(name="m", value=4.41, sd=0.22, unit="lb", lower=4.0, process_sd=0.1)
    (p,) = kind([], parameters=[own], bounds={"m": (0.0, 5.0)}).parameters
    assert p.unit == "kg"
    assert (p.value, p.sd, p.lower, p.upper, p.process_sd) == pytest.approx(
        tuple(POUND * v for v in (4.41, 0.22, 4.0, 5.0, 0.1))
    )


@pytest.mark.parametrize("kind", [simulator, equations])
def test_unknown_effects_follow_the_same_rule(kind):
    forms = {
        "a": (10.0, 50.0, "g"),
        "b": Exposed(scale=50.0, neutral=10.0, upper=80.0, unit="g"),
        "c": Effect(name="c", component="c", scale=50.0, upper=80.0, unit="g"),
        "d": "g",
    }
    model = kind([], unknown=forms, bounds={"a": (0.0, 90.0)})
    a, b, c, d = model.effects
    assert {e.unit for e in model.effects} == {"kg"}
    assert (a.scale, b.scale, c.scale) == pytest.approx((0.05, 0.05, 0.05))
    assert (a.lower, a.upper) == pytest.approx((-0.01, 0.08))
    assert (b.upper, c.upper, d.scale) == pytest.approx((0.07, 0.08, 1.0))


@pytest.mark.parametrize("kind", [simulator, equations])
def test_an_unknown_unit_is_refused(kind):
    for given in (
        {"parameters": {"m": (2.0, 0.1, "kgs")}},
        {"parameters": [Parameter(name="m", value=2.0, unit="kgs")]},
        {"unknown": {"loss": "kgs"}},
        {"unknown": {"loss": (0.0, 0.1, "kgs")}},
    ):
        with pytest.raises(InvalidParameter, match=r"parameter (m|loss): unit 'kgs': unknown unit"):
            kind([], **given)


def test_the_command_line_and_python_give_the_function_the_same(tmp_path):
    path = tmp_path / "model.py"
    path.write_text(
        "def load(time, inputs, parameters):\n"
        "    return {'y': inputs['u'] * sum(parameters.values())}\n"
        "def pounds(time, inputs, parameters):\n    return load(time, inputs, parameters)\n"
        "pounds.units = {'m': 'lb'}\n"
    )
    stated = StatedOptions(("m=4.41lb±0.2lb",), ("extra=50g",))
    given = {"parameters": stated.parameters, "unknown": stated.causes}
    model = load_model(f"{path}:load", **given).model
    own = simulator([], parameters={"m": (4.41, 0.2, "lb")}, unknown={"extra": (0, 50, "g")})
    assert model.parameters == own.parameters
    assert [(e.scale, e.unit) for e in model.effects] == [(e.scale, e.unit) for e in own.effects]
    kept = load_model(f"{path}:pounds", **given).model
    assert kept.parameters[0].value == 4.41


def test_the_answer_of_a_diagnosis_is_in_the_unit_of_the_function():
    for units, unit, mass in ((None, "kg", 2.0), ({"m": "lb"}, "lb", 4.5)):
        report = simulator([], units).diagnose(
            records(mass), effects=[], options=Options(max_effects=1)
        )
        (p,) = report.parameters
        assert (p.value, p.unit) == (pytest.approx(mass, rel=1e-3), unit)


def test_an_effect_in_another_unit_than_its_parameter_is_refused():
    extra = Effect(name="extra mass", component="load", unit="g", scale=50.0, data="m")
    with pytest.raises(InvalidParameter, match=r"extra mass: is in g .*parameter m, .* in kg"):
        simulator([]).diagnose(records(), effects=[extra])


def test_units_of_a_function_are_those_of_its_inputs_and_outputs(tmp_path):
    (tmp_path / "beside.py").write_text("GAIN = 2.0\n")
    (tmp_path / "fan.py").write_text(
        "from beside import GAIN\n\n\ndef fan(time, inputs, parameters):\n"
        "    return {'flow': GAIN * parameters['c'] * inputs['speed']}\n"
    )
    rows = "".join(f"{0.1 * k:.1f},{60 + k},{1.0 + k}\n" for k in range(20))
    (tmp_path / "a.csv").write_text("time [s],speed [rpm],flow [l/min]\n" + rows)
    parameters = {"c": (0.01, 0.001, "1")}
    loaded = load_model(f"{tmp_path / 'fan.py'}:fan", parameters=parameters)
    ready = loaded.model.ready(loaded.read([tmp_path / "a.csv"]))
    assert ready.records[0].inputs["speed"][0] == pytest.approx(2.0 * np.pi)
    told = [n for n in ready.notes if "speed in rad/s" in n and "flow in m^3/s" in n]
    assert len(told) == 1
    assert "fan.units = {" in told[0]
    with (tmp_path / "fan.py").open("a") as file:
        file.write("\n\nfan.units = {'speed': 'rpm', 'flow': 'l/min'}\n")
    loaded = load_model(f"{tmp_path / 'fan.py'}:fan", parameters=parameters)
    ready = loaded.model.ready(loaded.read([tmp_path / "a.csv"]))
    assert ready.records[0].inputs["speed"][0] == pytest.approx(60.0)
    assert ready.records[0].outputs["flow"][0] == pytest.approx(1.0)
    assert not any("gets and returns" in n for n in ready.notes)
    (record,) = unmodeled.read(tmp_path / "a.csv", model=loaded.model)
    assert record.outputs["flow"][0] == pytest.approx(1.0)
    assert (record.units["flow"], record.units["speed"]) == ("l/min", "rpm")
    with pytest.raises(
        DataError, match=r"speed is in rad/s, in the model fan in rpm; .*model=model"
    ):
        unmodeled.check(loaded.model, unmodeled.read(tmp_path / "a.csv"))


def test_a_share_is_that_of_the_value_of_the_file():
    def rig(time, inputs, parameters):
        return {"y": inputs["u"]}

    rig.units, rig.values = {"bulk": "Pa", "ratio": "%"}, {"bulk": 9e8, "ratio": 40.0}
    stated = StatedOptions(("bulk=±10%", "ratio=±2%")).parameters
    bulk, ratio = unmodeled.Simulator(rig, parameters=stated).parameters
    assert (bulk.value, bulk.unit) == (9e8, "Pa")
    assert bulk.sd == pytest.approx(9e7)
    assert (ratio.value, ratio.sd) == (40.0, 2.0)


def test_an_output_that_is_a_function_has_a_unit(tmp_path):
    def rates(t, x, u, p):
        return (-x.q / p.tau,)

    def voltage(t, x, u, p):
        return 2.0 * x.q

    model = unmodeled.Equations(
        rates,
        states={"q": (1.0, 0.0, "1")},
        parameters={"tau": (2.0, 0.1, "s")},
        outputs={"U": (voltage, "V")},
    )
    assert model.units["U"] == "V"
    rows = "".join(f"{0.1 * k:.1f},{2000.0 * np.exp(-0.05 * k):.3f}\n" for k in range(20))
    (tmp_path / "a.csv").write_text("time [s],U [mV]\n" + rows)
    (record,) = unmodeled.read(str(tmp_path / "a.csv"))
    comparison = unmodeled.check(model, [record])
    assert comparison.rows[0].rms < 1e-3


def test_a_force_on_a_coordinate_in_mm_is_an_acceleration():
    """With an inertia in kg, it would be in mN."""
    model = unmodeled.Equations(
        lambda t, x, u, p: (x.v, -p.k * x.x / p.m),
        states={"x": "mm", "v": "mm/s"},
        parameters={"m": (2.0, 0.1, "kg"), "k": (90.0, 3.0, "N/m")},
    )
    (coordinate,) = model.coordinates
    assert (coordinate.inertia, coordinate.unit) == (None, "mm/s^2")


def test_records_that_contradict_the_conversion_of_a_parameter_are_refused():
    """A battery: its capacity is stated in A h, and the equations multiply it by 3600."""
    time = np.arange(0.0, 2000.0, 10.0)
    current = np.where((time // 200.0) % 2 < 1, 5.0, -1.0)
    charge = np.r_[0.0, np.cumsum(current[:-1]) * 10.0]
    rng = np.random.default_rng(0)
    noise = 2e-3 * rng.standard_normal(time.size)
    voltage = 3.3 + 0.8 * (0.9 - charge / 3600.0 / 2.4) - 0.04 * current + noise
    record = Record(name="r", time=time, inputs={"current": current},
                    outputs={"U": voltage}, sensors={"U": Sensor(name="U", unit="V")})  # fmt: skip

    def battery(units=None):
        def rates(t, x, u, p):
            return (-u.current / (3600.0 * p.Q),)

        if units:
            rates.units = units
        return unmodeled.Equations(
            rates,
            states={"soc": (0.9, 0.01, "1")},
            parameters={"Q": (2.5, 0.1, "A h"), "R": (0.04, 0.004, "ohm")},
            inputs={"current": "A"},
            outputs={"U": (lambda t, x, u, p: 3.3 + 0.8 * x.soc - p.R * u.current, "V")},
        )

    with pytest.raises(DataError, match=r"follows the records with Q = 2.5 \(A h, not 9000 s A\)"):
        battery().diagnose([record])
    report = battery({"Q": "A h"}).fit([record])
    assert report.model.parameters["Q"] == pytest.approx(2.4, rel=0.02)


def test_a_value_alone_is_a_parameter_without_a_prior_on_the_command_line(tmp_path):
    path = tmp_path / "model.py"
    path.write_text("def load(time, inputs, p):\n    return {'y': inputs['u'] * p['m']}\n")
    loaded = load_model(f"{path}:load", parameters=StatedOptions(("m=4kg",), ()).parameters)
    (p,) = loaded.model.parameters
    assert (p.value, p.sd, p.unit) == (4.0, np.inf, "kg")


def test_a_parameter_without_a_label_has_its_name():
    assert Parameter(name="k", value=1.0).title == "k"
    assert Parameter(name="k", value=1.0, label="stiffness of the spring").title[:9] == "stiffness"


def test_the_size_of_a_parameter_is_its_tolerance_or_its_value():
    def size(**what):
        return Parameter(name="k", **what).size

    assert size(value=-2.0, sd=0.1) == 0.1
    assert size(value=-2.0) == 2.0
    assert size(value=-2.0, sd=0.0) == 2.0
    assert size(value=0.0) == 1.0


def end_of(parameters, states, inputs=None, units=None, u=0.0):
    """Where s ends, if its equation is s' = (c + K u - s)/tau."""

    def rates(t, x, u, p):
        return ((p.c + p.K * u.u - x.s) / p.tau,)

    rates.units = units or {}
    model = unmodeled.Equations(
        rates, states=states, parameters=parameters, inputs=inputs or {"u": "1"}, hold="linear"
    )
    time = np.arange(0.0, 60.0, 1.0)
    record = Record(name="r", time=time, inputs={"u": np.full(60, u)}, outputs={"s": time},
                    sensors={"s": Sensor(name="s", sigma=0.01, unit=states["s"][2])})  # fmt: skip
    ready = model.ready([record])
    return ready.model.simulate(record, prior_jobs(ready.model, record))[0, -1, 0]


@pytest.mark.parametrize("unit", ACCEPTED_UNITS)
def test_a_state_and_a_parameter_in_one_unit_are_in_this_unit_in_the_equations(unit):
    """Both are 50: the state stays there, whatever the unit."""
    parameters = {"c": (50.0, 1.0, unit), "K": (0.0, 0.0, unit), "tau": (5.0, 1.0, "s")}
    assert end_of(parameters, {"s": (50.0, 1.0, unit)}) == pytest.approx(50.0, rel=1e-9)
    got = []

    def level(time, inputs, parameters):
        got.append(parameters["c"])
        return {"s": 0.0 * time + parameters["c"]}

    level.units = {"s": unit}
    time = np.arange(9.0)
    sensors = {"s": Sensor(name="s", sigma=1.0, unit=unit)}
    record = Record(name="r", time=time, inputs={}, outputs={"s": time}, sensors=sensors)
    unmodeled.check(unmodeled.Simulator(level, parameters={"c": (50.0, 1.0, unit)}), [record])
    assert got[0] == 50.0


def test_products_of_units_of_states_and_inputs_stay_and_other_units_become_si():
    """A level in cm follows a pump in l/min: K in cm min/l stays, and tau in min is in seconds."""
    parameters = {"c": (5.0, 1.0, "cm"), "K": (2.0, 0.1, "cm min/l"), "tau": (0.05, 0.01, "min")}
    states = {"s": (5.0, 1.0, "cm")}
    level = end_of(parameters, states, {"u": "l/min"}, u=4.0)
    assert level == pytest.approx(13.0, rel=1e-6)
    mm = parameters | {"c": (50.0, 10.0, "mm"), "K": (20.0, 1.0, "mm min/l")}
    with pytest.raises(InvalidParameter, match=r"rates.units = \{'c': 'mm', 'K': 'mm min/l'\} or"):
        end_of(mm, states, {"u": "l/min"})
    same = end_of(mm, states, {"u": "l/min"}, {"c": "cm", "K": "cm min/l"}, u=4.0)
    assert same == pytest.approx(13.0, rel=1e-6)


def test_equations_in_mm_with_a_factor_of_1000_get_their_parameters_in_si_as_they_are_stated():
    """Regression: with states converted to SI, they were wrong by 1000."""

    def rates(t, x, u, p):
        force = u.f - p.k * x.x / 1000.0 - p.d * x.v / 1000.0
        return x.v, 1000.0 * force / p.m

    model = unmodeled.Equations(
        rates,
        states={"x": (0.0, 0.0, "mm"), "v": (0.0, 0.0, "mm/s")},
        parameters={"m": (2.0, 0.1, "kg"), "k": (100.0, 3.0, "N/m"), "d": (20.0, 1.0, "N s/m")},
        inputs={"f": "N"},
        outputs={"x": "x"},
        hold="linear",
    )
    record = Record(name="r", time=np.arange(0.0, 5.0, 0.01), inputs={"f": np.full(500, 3.0)},
                    outputs={"x": np.zeros(500)})  # fmt: skip
    assert model.simulate(record, prior_jobs(model, record))[0, -1, 0] == pytest.approx(30.0)


def test_an_input_without_a_unit_beside_a_state_of_the_same_quantity_is_refused(tmp_path):
    """A column in rpm would become rad/s, and the state stays in rpm."""
    (tmp_path / "spin.py").write_text(
        "import unmodeled\n\n\ndef rates(t, x, u, p):\n    return ((u.asked - x.s) / p.tau,)\n\n\n"
        "given = {'states': {'s': (60.0, 1.0, 'rpm')}, 'hold': 'linear',\n"
        "         'parameters': {'tau': (0.05, 0.01, 'min')}}\n"
        "model = unmodeled.Equations(rates, **given)\n"
    )
    rows = "".join(f"{0.5 * k:.1f},60,60\n" for k in range(20))
    (tmp_path / "a.csv").write_text("time [s],asked [rpm],s [rpm]\n" + rows)
    loaded = load_model(f"{tmp_path / 'spin.py'}:model")
    with pytest.raises(InvalidParameter, match=r"rates.units = \{'asked': 'rpm'\} or .*'rad/s'"):
        loaded.model.ready(loaded.read([tmp_path / "a.csv"]))
    with (tmp_path / "spin.py").open("a") as file:
        file.write("rates.units = {'asked': 'rpm'}\n")
        file.write("model = unmodeled.Equations(rates, **given)\n")
    loaded = load_model(f"{tmp_path / 'spin.py'}:model")
    (record,) = loaded.read([tmp_path / "a.csv"])
    ready = loaded.model.ready([record])
    end = ready.model.simulate(record, prior_jobs(ready.model, record))[0, -1, 0]
    assert end == pytest.approx(60.0)
