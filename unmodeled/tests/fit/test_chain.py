"""One chain of errors of sensors: derivatives, inverse, and a new fault in one file."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from unmodeled import Equations, Record, Sensor, State, diagnose, library
from unmodeled.chain import _FAULTS, Fault, fault_of, faults, register, true_value
from unmodeled.chain.splines import Spline
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit.observe import observe

TIME = 0.01 * np.arange(301)
SIZES = {
    "clock": 0.02,
    "lag": 0.03,
    "delay": 0.017,
    "gain": 0.2,
    "offset": 0.3,
    "nonlinearity": 0.1,
    "saturation": 0.4,
    "dead zone": 0.4,
    "backlash": 0.1,
    "wrap": 1.3,
    "absolute value": 0.4,
    "gain drift": 0.05,
    "gain fade": 0.3,
    "zero drift": 0.2,
}
KINKS = ("absolute value", "saturation", "dead zone", "backlash", "wrap")
SHAPES = {"nonlinearity": "even", "saturation": 0.5, "dead zone": 0.2, "gain fade": 0.8}


def signal(time=TIME):
    return np.stack([np.sin(3.0 * time) + 0.3 * time, np.cos(2.0 * time)])


def record(**sensor):
    return Record(
        name="r",
        time=TIME,
        inputs={"u": signal()[0]},
        outputs={"y": 0.0 * TIME},
        sensors={"y": Sensor(name="y", **sensor)},
    )


def test_a_gain_that_settles_is_a_candidate_of_inputs_only():
    signal = np.sin(np.linspace(0.0, 6.0, 50))
    record = Record(
        name="r",
        time=np.linspace(0.0, 1.0, 50),
        inputs={"u": signal},
        outputs={"y": signal},
        sensors={"y": Sensor(name="y", unit="m", sigma=1e-3)},
    )
    assert "gain fade of input u" in {e.name for e in library.for_input("u", record)}
    assert not any("fade" in e.name for e in library.for_sensor(["y"], "y", record))


def test_every_fault_is_tested_here():
    assert {*SIZES} == {*faults()}


@pytest.mark.parametrize("name", list(SIZES))
def test_derivatives_are_those_of_differences(name):
    fault, size, shape, run, y = fault_of(name), SIZES[name], SHAPES.get(name), record(), signal()

    def compared(exact, up, down, h):
        numeric = (up - down) / (2.0 * h)
        near = np.abs(exact - numeric) < 1e-6 * max(np.abs(numeric).max(), 1.0)
        assert near.mean() > (0.98 if fault.name in KINKS else 1 - 1e-9)

    h = 1e-5 * size
    up, down = (fault.act(run, y, size + s * h, shape) for s in (1.0, -1.0))
    compared(fault.by_size(run, y, size, shape), up, down, h)
    change = np.cos(5.0 * TIME)
    up, down = (fault.act(run, y[:1] + s * 1e-6 * change, size, shape) for s in (1.0, -1.0))
    compared(fault.push(run, y[:1], size, shape, change[None]), up, down, 1e-6)


@pytest.mark.parametrize("samples", [2, 3, 4, 5, 60])
def test_splines_are_those_of_scipy(samples):
    rng = np.random.default_rng(samples)
    time, y = np.cumsum(rng.uniform(0.5, 1.5, samples)), rng.standard_normal((3, samples))
    want = np.linspace(time[0], time[-1], 77)
    for order in (0, 1, 2):
        theirs = CubicSpline(time, y, axis=1)(want, order)
        assert np.allclose(Spline(time, y)(want, order), theirs, atol=1e-12)


@pytest.mark.parametrize("name", ["lag", "delay", "clock", "gain"])
def test_derivatives_at_zero_are_limits(name):
    fault, run, y, h = fault_of(name), record(), signal(), 1e-6
    limit = (fault.act(run, y, h) - y) / h
    exact = fault.by_size(run, y, 0.0)
    assert np.allclose(exact, limit, atol=2e-5 * np.abs(exact).max())


@pytest.mark.parametrize("name", list(SIZES))
def test_what_a_fault_does_is_undone(name):
    fault, size, shape, run, y = fault_of(name), SIZES[name], SHAPES.get(name), record(), signal()
    known = fault.act(run, y, size, "smooth" if name == "delay" else shape)
    if name == "backlash":
        with pytest.raises(InvalidParameter, match="what rests is lost"):
            fault.undo(run, known, size)
        return
    back = fault.undo(run, known, size, "smooth" if name == "delay" else shape)
    inside = slice(10, -10)
    exact = {"lag": 2e-4, "delay": 1e-6, "clock": 1e-6}.get(name, 1e-12)
    moved = np.abs(known - y).max()
    assert moved > 1e-2
    if name == "wrap":  # whole periods are lost at the first sample
        back = back - np.round((back[:, :1] - y[:, :1]) / size) * size
    assert np.allclose(back[:, inside], y[:, inside], atol=exact)


def test_what_a_sensor_loses_is_not_made_up():
    with pytest.raises(InvalidParameter, match="loses the signal"):
        fault_of("saturation").undo(record(), np.full((1, 301), 0.7), 1.0, 0.5)


def test_all_known_errors_together_are_removed():
    sensor = Sensor(name="y", gain=-1.3, offset=0.2, bandwidth=20.0, faults={"clock": 0.01})
    y = signal()
    for name, size in sensor.known.items():
        y = fault_of(name).act(record(), y, size)
    back = true_value(record(), y[0], sensor.known)
    assert [*sensor.known] == ["clock", "lag", "gain", "offset"]
    assert np.allclose(back[5:-10], signal()[0][5:-10], atol=1e-4)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"faults": {"gian": 0.1}}, "gian"),
        ({"faults": {"gain": 0.1}}, "gain is not stated here"),
        ({"faults": {"saturation": 0.1}}, "saturation is not stated here"),
        ({"faults_sd": {"clock": -0.1}}, "clock = -0.1"),
    ],
)
def test_sensors_refuse_what_they_cannot_have(given, message):
    with pytest.raises((DataError, InvalidParameter), match=message):
        Sensor(name="y", **given)


# ------------------------------------------------------------------------- a fault in one file


class Hum(Fault):
    """reading = y + size sin(2 pi 5 Hz t)."""

    name, unit = "hum", ""
    sensor = "The mains are in the signal.", "Shield the cable."
    each = "hum", "Shield the cable."

    def act(self, run, y, size, _=None):
        return y + size * np.sin(2.0 * np.pi * 5.0 * run.time)

    def fields(self, signal):
        return {"scale": 0.05 * signal.size}


@pytest.fixture
def hum():
    yield register(Hum())
    del _FAULTS["hum"]


MODEL = Equations(
    lambda t, x, u, p: ((u.u - x.x) / p.tau,),
    states=[State(name="x", start_sd=0.0)],
    parameters={"tau": (0.3, 0.01, "s")},
    inputs=["u"],
    outputs={"y": "x"},
)


def measured(sizes, **sensor):
    """Records whose sensor hums by a size of each."""
    rng, records = np.random.default_rng(3), []
    for k, size in enumerate(sizes):
        u = np.sin((1.0 + k) * TIME) + 0.5 * np.sign(np.sin(2.3 * (1.0 + k) * TIME))
        blank = replace(record(sigma=1e-3, **sensor), name=f"r{k}", inputs={"u": u})
        plain = replace(blank, sensors={"y": Sensor(name="y", sigma=1e-3)})
        y = observe(MODEL, plain, np.array([0.302]), np.zeros(1))[:, 0]
        y = Hum().act(blank, y[None], size)[0] + 1e-3 * rng.standard_normal(TIME.size)
        records.append(replace(blank, outputs={"y": y}))
    return records


def test_a_new_fault_is_a_known_error(hum):
    (one,) = measured([0.1], faults={"hum": 0.1})
    y = observe(MODEL, one, np.array([0.302]), np.zeros(1))[:, 0]
    assert np.std(one.outputs["y"] - y) == pytest.approx(1e-3, rel=0.1)
    freed = replace(one, inputs={"u": 2.0 * TIME + 0.1 * np.sin(10.0 * np.pi * TIME)})
    freed = freed.with_sensed_input("u", faults={"hum": 0.1})
    assert np.allclose(freed.inputs["u"], 2.0 * TIME)


def test_a_new_fault_is_an_unknown_of_a_record(hum):
    report = MODEL.fit(measured([0.08, -0.05, 0.02], faults_sd={"hum": 0.1}))
    assert report.model.parameters["tau"] == pytest.approx(0.302, abs=2e-3)
    assert report.channels[0].explained == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize("sizes", [(0.1, 0.1, 0.1), (0.1, 0.0, -0.07)])
def test_a_new_fault_is_a_cause_in_all_records_or_in_each(hum, sizes):
    records = measured(sizes)
    report = diagnose(MODEL, library.for_sensor(["y"], "y", records[0]), records, hold_out=())
    (named,) = report.named
    if sizes[0] == sizes[1]:
        assert (named.cause, named.remedy) == ("hum of sensor y", "Shield the cable.")
        assert named.magnitude == pytest.approx(0.1, abs=2e-3)
    else:
        assert named.cause == "hum of sensor y in each record"
        assert named.by_record == pytest.approx(sizes, abs=2e-3)


def test_a_gain_of_single_records_is_found():
    records = []
    for k, r in enumerate(measured([0.0] * 4)):
        gain = 1.0 if k % 2 else 1.1
        records.append(replace(r, outputs={"y": gain * r.outputs["y"]}))
    (named,) = MODEL.diagnose(records, hold_out=()).named
    assert named.cause == "gain of sensor y in each record"
    assert named.by_record == pytest.approx([0.1, 0.0, 0.1, 0.0], abs=3e-3)
