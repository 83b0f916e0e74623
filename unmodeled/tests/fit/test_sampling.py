"""No adapter moves a signal in time: outputs that are the inputs, and a lag that is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import unmodeled
from unmodeled import (
    Equations,
    LinearModel,
    Parameter,
    Simulator,
    State,
    Verdict,
    diagnose,
    library,
)
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit import FunctionModel
from unmodeled.fit.observe import observe
from unmodeled.models import Candidate

from . import units

INPUTS, OUTPUTS = ("u1", "u2", "u3"), ("y1", "y2", "y3")
TAU = 0.05  # s, of the lag of every model
DELAY = 7e-3  # s


def clock(even, samples=80, interval=0.01):
    time = interval * np.arange(samples)
    return time if even else time + 0.3 * interval * np.sin(40.0 * time)


def signal(channel, time):
    """A smooth input, zero before the record."""
    rate = 2.0 * np.pi * (1.0 + 0.6 * channel)
    return np.where(time > 0.0, np.sin(rate * time) ** 3 * (1.0 + 0.1 * channel), 0.0)


def record(time, outputs=OUTPUTS, **fields):
    inputs = {name: signal(i, time) for i, name in enumerate(INPUTS)}
    zeros = {name: np.zeros(time.size) for name in outputs}
    return Record(name="r", time=time, inputs=inputs, outputs=zeros, **fields)


def readings(model, of, *included):
    chosen = tuple(Candidate(e, e.shapes[0]) for e, _ in included)
    sizes = np.array([size for _, size in included])
    theta = np.array([p.value for p in model.parameters])
    return observe(model, of, theta, np.zeros(len(model.states())), chosen, sizes)


def lag_of(time, values, hold="linear"):
    """Response of the lag to values that are linear between samples, or constant."""
    now, out = 0.0, [0.0]
    for h, u, end in zip(np.diff(time), values, values[1:], strict=False):
        decay, slope = np.exp(-h / TAU), 0.0 if hold == "zero" else (end - u) / h
        # The particular solution of u + slope t is itself, a time constant late.
        now = (now - u + slope * TAU) * decay + u + slope * (h - TAU)
        out.append(now)
    return np.array(out)


def function(record, name):
    return lag_of(record.time, record.inputs["u1"]) if name == "late" else record.inputs[name]


def ode(hold):
    return Equations(
        states=[State(name="x", scale=1.0)],
        rates=lambda t, x, u, p: ((u.u1 - x.x) / TAU,),
        inputs=INPUTS,
        outputs={
            "y1": lambda t, x, u, p: u.u1,
            "y2": lambda t, x, u, p: u.u2,
            "y3": lambda t, x, u, p: u.u3,
            "late": "x",
        },
        substeps=2,
        hold=hold,
    )


def functions(_hold):
    def at(name):
        return lambda r, p: function(r, name)

    names = dict(zip(OUTPUTS, INPUTS, strict=True)) | {"late": "late"}
    return FunctionModel(outputs={o: at(n) for o, n in names.items()}, parameters=[])


def simulator(hold):
    def run(time, inputs, _parameters):
        own = {o: inputs[u] for o, u in zip(OUTPUTS, INPUTS, strict=True)}
        return {**own, "late": lag_of(time, inputs["u1"], hold)}

    return Simulator(run, parameters=[], inputs=INPUTS, outputs=(*OUTPUTS, "late"), workers=1)


@pytest.fixture(scope="module")
def make(tmp_path_factory):
    """make(adapter, hold): outputs that are the three inputs, and a lag of the first input."""

    def of_fmu(*kinds):
        def build(hold):
            folder = tmp_path_factory.mktemp("units")
            path = units.three_channels(folder, *kinds)
            return unmodeled.fmu(
                path,
                parameters=[],
                inputs=INPUTS,
                outputs=(*OUTPUTS, "late"),
                hold=hold,
                workers=1,
            )

        return build

    known = {
        "ode": ode,
        "function": functions,
        "simulator": simulator,
        "co-simulation": of_fmu("CoSimulation"),
        "model exchange": of_fmu("ModelExchange"),
        "both": of_fmu("ModelExchange", "CoSimulation"),
    }
    return lambda adapter, hold="linear": known[adapter](hold)


ADAPTERS = ("ode", "function", "simulator", "co-simulation", "model exchange")


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("adapter", ADAPTERS)
def test_an_identity_is_one(make, adapter, even):
    given = record(clock(even))
    seen = readings(make(adapter), given)
    for i, name in enumerate(INPUTS):
        assert np.array_equal(seen[:, i], given.inputs[name]), name


#: Largest error of the lag, of an input of size one. Half a sample of delay would be 0.04.
ERRORS = {"function": 1e-12, "simulator": 1e-12, "ode": 2e-6, "co-simulation": 2e-5,
          "model exchange": 5e-5}  # fmt: skip


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("adapter", ADAPTERS)
def test_a_lag_is_that_of_its_equation(make, adapter, even):
    given = record(clock(even))
    late = readings(make(adapter), given)[:, 3]
    exact = lag_of(given.time, given.inputs["u1"])
    assert np.max(np.abs(late - exact)) < ERRORS[adapter]
    # The time by which it is late beyond that, in samples.
    slope = np.gradient(exact, given.time)
    shift = -np.sum(slope * (late - exact)) / np.sum(slope**2)
    assert abs(shift) < 2e-3 * given.interval


@pytest.mark.parametrize("adapter", ["ode", "simulator", "co-simulation", "model exchange"])
def test_a_held_input_is_constant_between_samples(make, adapter):
    given = record(clock(True))
    seen = readings(make(adapter, "zero"), given)
    exact = lag_of(given.time, given.inputs["u1"], "zero")
    assert np.max(np.abs(seen[:, 3] - exact)) < 1e-5
    assert np.array_equal(seen[:, 0], given.inputs["u1"])


def test_the_lag_of_these_tests_is_right():
    time = clock(True, 60)
    values = signal(0, time)
    exact = solve_ivp(lambda t, x: (np.interp(t, time, values) - x) / TAU, (0.0, time[-1]), [0.0],
                      t_eval=time, rtol=1e-10, atol=1e-12, max_step=2e-3)  # fmt: skip
    assert np.allclose(lag_of(time, values), exact.y[0], atol=1e-8)


def delayed(values, time):
    """A recorded input that acts later; it is linear between samples."""
    return np.interp(time - DELAY, time, values)


@pytest.mark.parametrize("adapter", ADAPTERS)
def test_a_delay_of_an_input_is_that_delay(make, adapter):
    """An input that acts 7 ms later than recorded, at samples every 10 ms."""
    given = record(clock(True))
    effect = library.input_fault("u2", "delay", scale=given.interval)
    seen = readings(make(adapter), given, (effect, -DELAY))
    assert np.allclose(seen[:, 1], delayed(given.inputs["u2"], given.time), atol=1e-12)
    assert np.array_equal(seen[:, 0], given.inputs["u1"])


def test_a_linear_model_takes_the_same_sample():
    one = Parameter(name="one", value=1.0, sd=0.0)
    model = LinearModel(output="y1", columns={"one": lambda r: r.inputs["u1"]}, parameters=[one])
    given = record(clock(False), ["y1"])
    assert np.array_equal(readings(model, given)[:, 0], given.inputs["u1"])
    effect = library.input_fault("u1", "delay", scale=given.interval)
    seen = readings(model, given, (effect, -DELAY))
    assert np.allclose(seen[:, 0], delayed(given.inputs["u1"], given.time), atol=1e-12)


def diagnosed(folder, delay=0.0):
    """Diagnosis of an FMU whose outputs are its inputs; the second one acts later."""
    path = units.three_channels(folder, "CoSimulation")
    model = unmodeled.fmu(path, parameters=[], inputs=INPUTS, outputs=OUTPUTS, workers=1)
    records = []
    for seed, role in enumerate(("fit", "held_out")):
        random = np.random.default_rng(seed)
        own = record(clock(True))
        shown = dict(zip(OUTPUTS, own.inputs.values(), strict=True))
        if delay:
            shown["y2"] = delayed(shown["y2"], own.time)
        outputs = {n: v + 1e-3 * random.standard_normal(v.size) for n, v in shown.items()}
        sensors = {n: Sensor(name=n, sigma=1e-3) for n in OUTPUTS}
        records.append(replace(own, name=role, role=role, outputs=outputs, sensors=sensors))
    interval = records[0].interval
    return diagnose(
        model, [library.input_fault(n, "delay", scale=interval) for n in INPUTS], records
    )


def test_perfect_data_of_an_fmu_have_no_gap(tmp_path):
    report = diagnosed(tmp_path)
    assert report.named == ()
    assert report.verdict is Verdict.NO_GAP


def test_a_delay_of_an_fmu_is_named_with_its_size(tmp_path):
    report = diagnosed(tmp_path, DELAY)
    (named,) = report.named
    assert named.cause == "delay of input u2"
    assert named.magnitude == pytest.approx(-DELAY, rel=0.02)


# ---------------------------------------------------------------- FMUs


def test_model_exchange_is_preferred(make):
    """Its lag is that of the equation, to the tolerance of its integrator."""
    given = record(clock(True))
    both, exchange = (readings(make(a), given) for a in ("both", "model exchange"))
    assert np.array_equal(both, exchange)


def test_a_short_pulse_is_not_stepped_over(make):
    """A pulse of three samples, after a long rest, in model exchange."""
    time = clock(True, 200, 1e-3)
    values = np.where(np.abs(np.arange(200) - 150) < 2, 1.0, 0.0)
    given = record(time)
    given = replace(given, inputs={**given.inputs, "u1": values})
    late = readings(make("model exchange"), given)[:, 3]
    assert np.allclose(late, lag_of(time, values), atol=1e-5)
    assert late.max() > 0.05


def test_the_assumptions_about_an_fmu_are_told(tmp_path):
    path = units.three_channels(tmp_path, "CoSimulation")
    model = unmodeled.fmu(path, parameters=[], inputs=["u1"], outputs=["y1"], workers=1)
    notes = model.ready([record(clock(True), ["y1"])]).notes
    assert any("late, by up to half a sample" in note for note in notes)
    assert any("its inputs u2, u3 keep their start values" in note for note in notes)


def test_an_fmu_without_the_wanted_interface_is_told(tmp_path):
    path = units.three_channels(tmp_path, "CoSimulation")
    with pytest.raises(InvalidParameter, match="is an FMU for CoSimulation, expected ModelExch"):
        unmodeled.fmu(path, parameters=[], inputs=INPUTS, outputs=OUTPUTS, kind="ModelExchange")


def test_uneven_steps_that_an_fmu_refuses_are_told(tmp_path):
    path = units.three_channels(tmp_path, "CoSimulation", variable=False)
    model = unmodeled.fmu(path, parameters=[], inputs=INPUTS, outputs=("late",), workers=1)
    given = record(clock(True), ["late"])
    exact = lag_of(given.time, given.inputs["u1"])
    assert np.max(np.abs(readings(model, given)[:, 0] - exact)) < 2e-3  # with the mean of a step
    with pytest.warns(RuntimeWarning, match="takes steps of one duration only"):
        assert np.all(np.isnan(readings(model, record(clock(False), ["late"]))))


def test_times_that_fmpy_cannot_tell_apart_are_told(make):
    with pytest.warns(RuntimeWarning, match="let its clock start near zero"):
        assert np.all(np.isnan(readings(make("model exchange"), record(1e8 + clock(True)))))


def test_an_input_that_repeats_its_values_may_be_constant_between_samples():
    """Linear steps would be half a sample early, and look like a delay of the sensor."""
    time, rng = np.arange(0.0, 60.0, 1.0), np.random.default_rng(2)
    records = []
    for k in range(2):
        u, x, path = np.repeat(rng.uniform(-1.0, 1.0, 12), 5), 0.0, []
        for v in u:
            path.append(x)
            x += (1.0 - np.exp(-1.0 / 3.0)) * (v - x)
        y = np.array(path) + 1e-3 * rng.standard_normal(time.size)
        sensors = {"x": Sensor(name="x", sigma=1e-3)}
        records.append(
            Record(name=f"r{k}", time=time, inputs={"u": u}, outputs={"x": y}, sensors=sensors)
        )
    model = Equations(
        lambda t, x, u, p: ((u.u - x.x) / p.tau,),
        states={"x": (0.0, 0.01, "1")},
        parameters={"tau": (3.0, 0.01, "s")},
        inputs=["u"],
    )
    report = model.diagnose(records)
    assert (report.named, report.classes) == ((), ())
    assert report.channels[0].explained == pytest.approx(1e-3, rel=0.1)
