"""A model beside records before anything is fitted, and what would explain the difference."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

import unmodeled
from unmodeled import Equations, check
from unmodeled.cli import main
from unmodeled.cli.screen import LateLine
from unmodeled.data import ReadOptions, Record, Sensor, read_records, write_record
from unmodeled.data.wrapping import wrap_of
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.search.compare import _delay
from unmodeled.search.records import check_records

from . import models

POINTS = ("key_front.y", "hammer_tip.x")
QUICK = unmodeled.Options(tries=2, max_effects=1)


def command(*arguments):
    """Exit code of a command."""
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code


def kinds(model, records):
    """Kind and certainty of each hint."""
    return [(h.kind, h.sure) for h in unmodeled.check(model, records).hints]


# ---------------------------------------------------------------- the numbers


def test_numbers_of_a_difference_are_those_by_hand():
    time = np.arange(400) * 0.01
    u = np.sin(3.0 * time)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(400)
    record = Record(
        name="r", time=time, inputs={"x": u}, outputs={"y": 1.3 * u + 0.2 + noise},
        sensors={"y": Sensor(name="y", sigma=1e-3)},
    )  # fmt: skip
    found = unmodeled.check(models.line(0.1), record)
    (row,) = found.rows
    difference = 0.3 * u + 0.2 + noise
    assert row.rms == pytest.approx(np.sqrt(np.mean(difference**2)))
    assert row.motion == pytest.approx(np.std(record.outputs["y"]))
    assert row.share == pytest.approx(row.rms / row.motion)
    assert row.factor == pytest.approx(1.3, rel=1e-3)
    assert (row.noise, row.stated, row.samples) == (pytest.approx(1e-3), True, 400)
    beside, apart = found.plot().axes
    np.testing.assert_allclose(beside.lines[0].get_ydata(), record.outputs["y"])
    np.testing.assert_allclose(beside.lines[1].get_ydata(), u)
    np.testing.assert_allclose(apart.lines[0].get_ydata(), difference)


def swinging(start_sd, *, rate=lambda q, v: -9.0 * q):
    """A free oscillator, and two records of it that start at a turn and at full speed."""
    model = unmodeled.Equations(
        name="pendulum",
        states=[
            unmodeled.State(name="q", unit="rad", scale=0.5, start_sd=start_sd),
            unmodeled.State(name="v", unit="rad/s", scale=1.5, start_sd=start_sd),
        ],
        rates=lambda t, x, u, p: (x.v, rate(x.q, x.v)),
        outputs={"angle": "q"},
    )
    time = np.arange(400) * 0.01
    generator = np.random.default_rng(3)
    sensor = Sensor(name="angle", unit="rad", sigma=2e-3)
    records = [
        Record(
            name=name,
            time=time,
            inputs={},
            outputs={"angle": angle + 2e-3 * generator.standard_normal(time.size)},
            sensors={"angle": sensor},
        )
        for name, angle in (("turn", 0.7 * np.cos(3.0 * time)), ("fast", 0.4 * np.sin(3.0 * time)))
    ]
    return model, records


def test_a_start_that_is_not_known_is_taken_from_the_record():
    """A free motion was compared with a model that never moved."""
    for row in unmodeled.check(*swinging(2.0)).rows:
        assert row.in_noise == pytest.approx(1.0, abs=0.4)
    model, records = swinging(0.0)  # the start is known: at rest, so that nothing moves
    assert all(row.in_noise > 100.0 for row in unmodeled.check(model, records).rows)


def test_a_model_that_diverges_from_the_start_of_the_record_starts_as_expected():
    found = unmodeled.check(*swinging(2.0, rate=lambda q, v: 1e4 * q**3))
    np.testing.assert_array_equal(found.simulated["turn"]["angle"], 0.0)


def test_a_model_without_finite_outputs_is_refused():
    model, records = swinging(0.0, rate=lambda q, v: float("nan") + 0.0 * q)
    with pytest.raises(InvalidParameter, match="is no finite number"):
        unmodeled.check(model, records)


# ---------------------------------------------------------------- units and signs


def straight(factor, sd=0.1):
    """A line through records that are a factor too large."""
    model = unmodeled.LinearModel(
        name="line",
        output="y",
        columns={"slope": lambda r: r.inputs["u"]},
        parameters=[unmodeled.Parameter(name="slope", value=1.0, sd=sd)],
    )
    generator = np.random.default_rng(4)
    time = np.arange(200) * 1e-3
    records = []
    for i in range(2):
        u = np.sin((20.0 + 9.0 * i) * time)
        y = factor * u + 1e-3 * generator.standard_normal(time.size)
        sensor = Sensor(name="y", unit="m", sigma=1e-3)
        role = "held_out" if i else "fit"
        records.append(
            Record(name=f"r{i}", time=time, inputs={"u": u}, outputs={"y": y},
                   sensors={"y": sensor}, role=role)
        )  # fmt: skip
    return model, records


@pytest.mark.parametrize(
    ("factor", "kind", "told"),
    [
        (10.0, "unit", "times the model in all records: is its unit another one"),
        (0.1, "unit", "is its unit another one"),
        (1.13e3, "unit", "is 1130 times the model in all records: is its unit"),
        (28.6, "unit", "is its unit another one"),
        (-1.12, "sign", "the other direction"),
    ],
)
def test_a_wrong_unit_or_sign_ends_a_diagnosis_before_any_fit(factor, kind, told):
    """Also beside a gap: a spring that the model lacks made the force 1.13 times as large."""
    model, records = straight(factor)
    (hint,) = unmodeled.check(model, records).hints
    assert (hint.kind, hint.channels, hint.sure) == (kind, ("y",), True)
    assert told in hint.text
    stages = []
    with pytest.raises(DataError, match=f"{told}.*--unit"):
        unmodeled.diagnose(model, [], records, progress=stages.append)
    assert {p.stage for p in stages} == {"prepare"}


def test_a_wrong_unit_of_one_record_is_found():
    model, (right, held_out) = straight(1.0)
    wrong = replace(straight(1e3)[1][0], name="w")
    (hint,) = unmodeled.check(model, [right, wrong, held_out]).hints
    assert hint.sure
    assert "times the model in record w: is its unit another one" in hint.text


def test_factors_that_differ_or_are_no_unit_are_not_told():
    model, (first, held_out) = straight(3.0)
    third = replace(straight(8.0)[1][0], name="third")
    assert kinds(model, [first, third, held_out]) == []
    assert kinds(*straight(1.3)) == []


def test_a_unit_belongs_to_its_quantity():
    model, records = straight(9.81)
    newtons = [replace(r, sensors={"y": Sensor(name="y", unit="N", sigma=1e-3)}) for r in records]
    volts = [replace(r, sensors={"y": Sensor(name="y", unit="V", sigma=1e-3)}) for r in records]
    assert kinds(model, records) == kinds(model, newtons) == [("unit", True)]
    assert kinds(model, volts) == []


def test_a_factor_that_a_parameter_may_be_is_no_certain_unit():
    assert kinds(*straight(10.0, np.inf)) == []
    assert kinds(*straight(10.0, 5.0)) == [("unit", False)]
    model, records = straight(10.0, 5.0)
    report = unmodeled.diagnose(model, [], records, options=QUICK)
    assert report.parameters[0].value == pytest.approx(10.0, rel=0.01)
    assert any("is its unit another one" in n for n in report.notes)


def heated(change_input=1.0, scale=(1.0, 0.0), gain=1.0, start_sd=0.5):
    """Model and records of a block in a room of 22 degC, with a wrong input or scale."""
    random = np.random.default_rng(2)
    model = unmodeled.Equations(
        name="block",
        states=[unmodeled.State(name="T", unit="degC", scale=10.0, start=22.0, start_sd=start_sd)],
        parameters=[
            unmodeled.Parameter(name="C", value=100.0, sd=5.0, lower=1.0),
            unmodeled.Parameter(name="G", value=1.0, sd=0.1, lower=0.01),
        ],
        inputs=["P"],
        rates=lambda t, x, u, p: ((u.P - p.G * (x.T - 22.0)) / p.C,),
        outputs={"T": "T"},
    )
    records = []
    for k in range(3):
        time = np.arange(0.0, 400.0, 2.0)
        power = 20.0 * (np.sin(0.02 * time + k) > 0.0)
        rise = np.zeros(time.size)
        for i in range(1, time.size):
            rise[i] = rise[i - 1] + 2.0 * (power[i - 1] - 1.02 * rise[i - 1]) / 103.0
        shown = (
            scale[0] * (22.0 + gain * rise) + scale[1] + 0.02 * random.standard_normal(time.size)
        )
        records.append(
            Record(name=f"r{k}", time=time, inputs={"P": change_input * power},
                   outputs={"T": shown}, sensors={"T": Sensor(name="T", unit="degC", sigma=0.02)})
        )  # fmt: skip
    return model, records


@pytest.mark.parametrize(
    ("wrong", "kind", "told"),
    [
        ({"change_input": 1e-3}, "input", "1000 times the values of P"),
        ({"change_input": 1e3}, "input", "0.001 times the values of P"),
        ({"change_input": -1.0}, "input", "-1 times the values of P: has it the other direction"),
        ({"scale": (1.0, 273.15)}, "scale", "another scale of temperature"),
        ({"scale": (1.8, 32.0)}, "scale", "another scale of temperature"),
        # The label of the file is not the unit of the model.
        ({"scale": (1.0, -273.15)}, "scale", "another scale of temperature"),
        ({"scale": (1.0 / 1.8, -32.0 / 1.8)}, "scale", "another scale of temperature"),
    ],
)
def test_a_wrong_unit_beside_a_constant_is_found(wrong, kind, told):
    (hint,) = unmodeled.check(*heated(**wrong)).hints
    assert (hint.kind, hint.sure) == (kind, True)
    assert told in hint.text


@pytest.mark.parametrize(
    ("wrong", "kind", "told"),
    [
        ({"inflow": 60.0}, "input", "0.0166667 times the values of inflow"),
        ({"inflow": 1.0 / 3600.0}, "input", "3600 times the values of inflow"),
        ({"drain": 100.0}, "input", "0.01 times the values of drain"),
        ({"exchanged": True}, "exchange", "with inflow and rain exchanged: are their columns?"),
    ],
)
def test_a_flow_in_another_unit_and_two_exchanged_inputs_are_found(wrong, kind, told):
    model = unmodeled.Equations(
        lambda t, x, u, p: (u.inflow + 0.2 * u.rain - p.a * u.drain * x.V,),
        states={"V": (1.0, 0.01, "m^3")},
        parameters={"a": (0.01, 5e-4, "1/s")},
        inputs={"inflow": "m^3/s", "rain": "m^3/s", "drain": "1"},
        name="tank",
    )
    time = np.arange(0.0, 600.0, 4.0)
    records = []
    for k in range(2):
        inputs = {"inflow": 5e-3 * (1.0 + np.sin(0.02 * time + k)), "rain": 2e-3 * (time > 200.0),
                  "drain": 0.6 + 0.3 * np.cos(0.03 * time + k)}  # fmt: skip
        volume = np.ones(time.size)
        for i in range(1, time.size):
            u = {n: v[i - 1] for n, v in inputs.items()}
            flow = u["inflow"] + 0.2 * u["rain"] - 0.01 * u["drain"] * volume[i - 1]
            volume[i] = volume[i - 1] + 4.0 * flow
        if wrong.get("exchanged"):
            inputs |= {"inflow": inputs["rain"], "rain": inputs["inflow"]}
        inputs = {n: v * wrong.get(n, 1.0) for n, v in inputs.items()}
        units = {"inflow": "m^3/s", "rain": "m^3/s", "drain": "1"}
        sensors = {"V": Sensor(name="V", unit="m^3", sigma=1e-3)}
        records.append(Record(name=f"r{k}", time=time, inputs=inputs, outputs={"V": volume},
                              sensors=sensors, input_units=units))  # fmt: skip
    (hint,) = unmodeled.check(model, records).hints
    assert hint.kind == kind
    assert told in hint.text


@pytest.mark.parametrize("zero", [273.15, -273.15])
def test_a_start_that_is_not_known_does_not_hide_a_scale_of_temperature(zero):
    """The diagnosis named a constant inflow."""
    (hint,) = unmodeled.check(*heated(scale=(1.0, zero), start_sd=1e3)).hints
    assert (hint.kind, hint.sure) == ("scale", True)
    assert f"zero at {zero:.5g}" in hint.text
    assert unmodeled.check(*heated(start_sd=1e3)).hints == ()


@pytest.mark.parametrize("gain", [1.0, 2.0, 5.0])
def test_a_gap_of_a_temperature_is_no_wrong_unit(gain):
    assert not [h for h in unmodeled.check(*heated(gain=gain)).hints if h.sure]


def test_uncertain_start_states_do_not_hide_a_wrong_unit():
    """A start state that is estimated could absorb degrees that were labeled as radians."""
    model = unmodeled.Equations(
        name="arm",
        states=[unmodeled.State(name="q", unit="rad", scale=0.1, start_sd=1.0),
                unmodeled.State(name="v", unit="rad/s", scale=1.0, start_sd=10.0)],
        parameters=[unmodeled.Parameter(name="k", value=100.0, sd=5.0)],
        inputs=["M"],
        rates=lambda t, x, u, p: (x.v, u.M - p.k * x.q - 1.0 * x.v),
        outputs={"angle": "q"},
    )  # fmt: skip
    wrong = []
    for i in range(2):
        time = np.arange(400) * 5e-3
        moment = (5.0 + 2.0 * i) * np.sin((5.0 + i) * time)
        empty = Record(name=f"r{i}", time=time, inputs={"M": moment}, outputs={"angle": 0.0 * time})
        jobs = unmodeled.fit.Jobs(theta=np.array([[103.0]]), starts=np.zeros((1, 2)))
        angle = np.degrees(model.simulate(empty, jobs)[0, :, 0])
        noise = 0.02 * np.random.default_rng(i).standard_normal(time.size)
        sensor = Sensor(name="angle", unit="rad", sigma=0.02)
        wrong.append(replace(empty, outputs={"angle": angle + noise}, sensors={"angle": sensor}))
    found = unmodeled.check(model, wrong)
    assert [(h.kind, h.sure) for h in found.hints] == [("unit", True)]
    assert "is its unit another one" in found.hints[0].text


# ---------------------------------------------------------------- clocks


@pytest.mark.parametrize("factor", [1.0 / 60.0, 60.0])
def test_a_clock_in_a_wrong_unit_is_found(factor):
    model, records = heated()
    wrong = [replace(r, time=factor * r.time) for r in records]
    with pytest.raises(
        DataError, match=f"clock {1.0 / factor:.4g} times as long: is the unit of time"
    ):
        unmodeled.diagnose(model, [], wrong)


def test_a_reversed_oscillation_is_not_called_late():
    model, records = straight(-1.0)
    assert kinds(model, records) == [("sign", True)]


# ---------------------------------------------------------------- exchanged columns


def exchanged(r, *names):
    """The record with each channel under the name of the next one."""
    moved = dict(zip((*names[1:], names[0]), [r.outputs[n] for n in names], strict=True))
    return replace(r, outputs={**r.outputs, **moved})


def three(stiffness_sd=0.1):
    """Three outputs of one input, with the records of a model that is a tenth softer."""
    model = unmodeled.Simulator(
        lambda time, inputs, p: {
            "a": p["k"] * inputs["u"], "b": np.cumsum(inputs["u"]) * 0.02, "c": inputs["u"] ** 2
        },
        parameters=[unmodeled.Parameter(name="k", value=1.0, sd=stiffness_sd)],
        inputs={"u": "1"},
        outputs=dict.fromkeys("abc", "m"),
    )  # fmt: skip
    generator = np.random.default_rng(5)
    time = np.arange(200) * 1e-3
    records = []
    for i in range(2):
        u = np.sin((20.0 + 9.0 * i) * time)
        clean = {"a": 0.9 * u, "b": np.cumsum(u) * 0.02, "c": u**2}
        sensors = {n: Sensor(name=n, unit="m", sigma=1e-3) for n in clean}
        outputs = {n: v + 1e-3 * generator.standard_normal(time.size) for n, v in clean.items()}
        made = Record(name=f"r{i}", time=time, inputs={"u": u}, outputs=outputs, sensors=sensors,
                      role="held_out" if i else "fit")  # fmt: skip
        records.append(made)
    return model, records


def test_exchanged_columns_of_one_record_or_of_a_free_model_are_not_certain():
    model, records = three()
    assert kinds(model, [exchanged(records[0], "a", "b"), records[1]]) == [("exchange", False)]
    free, own = three(np.inf)
    assert kinds(free, [exchanged(r, "a", "b") for r in own]) == []
    # Records may list their outputs in another order, or lack some.
    turned = replace(records[1], outputs=dict(reversed(records[1].outputs.items())))
    blank = replace(records[0], outputs={**records[0].outputs, "c": np.full(200, np.nan)})
    assert kinds(model, [exchanged(r, "a", "b") for r in (blank, turned)]) == [("exchange", True)]


def test_single_numbers_are_not_exchanged_columns():
    model, (first, _) = three()
    blank = {n: np.where(np.arange(v.size) == 5, v, np.nan) for n, v in first.outputs.items()}
    assert kinds(model, exchanged(replace(first, outputs=blank), "a", "b")) == []


def pair(model_shares, record_shares, noise, sd=0.02):
    """A model of two channels in proportion to the input, and records of other shares."""
    names = ("left", "right")
    model = unmodeled.Simulator(
        lambda time, inputs, p: {
            n: p["size"] * s * inputs["u"] for n, s in zip(names, model_shares, strict=True)
        },
        parameters=[unmodeled.Parameter(name="size", value=1.0, sd=sd)],
        inputs={"u": "1"},
        outputs=dict.fromkeys(names, "m"),
    )  # fmt: skip
    generator = np.random.default_rng(6)
    time = np.arange(200) * 1e-3
    records = []
    for i in range(2):
        u = np.sin((20.0 + 9.0 * i) * time)
        outputs = {n: s * u + noise * generator.standard_normal(time.size)
                   for n, s in zip(names, record_shares, strict=True)}  # fmt: skip
        sensors = {n: Sensor(name=n, unit="m", sigma=noise) for n in names}
        made = Record(name=f"r{i}", time=time, inputs={"u": u}, outputs=outputs, sensors=sensors)
        records.append(made)
    return model, records


def test_exchanged_channels_that_are_alike_are_told_unless_they_are_nearly_equal():
    """Two thermocouples: each explains three quarters of the other one."""
    assert kinds(*pair((1.0, 0.6), (0.63, 1.0), 2e-3)) == [("exchange", True)]
    assert kinds(*pair((1.1, 0.9), (0.92, 1.08), 1e-3)) == []
    wrong_signs = unmodeled.check(*pair((1.0, -1.0), (-1.0, 1.0), 1e-3)).hints
    assert [h.kind for h in wrong_signs] == ["sign"]


def test_a_channel_without_values_is_not_compared():
    model, records = three()
    blank = [replace(r, outputs={**r.outputs, "c": np.full(200, np.nan)}) for r in records]
    report = unmodeled.diagnose(model, [], blank, options=QUICK)
    assert report.verdict is unmodeled.Verdict.CALIBRATED
    assert {c.name for c in report.channels} == {"a", "b"}
    empty = [replace(r, outputs={n: np.full(200, np.nan) for n in r.outputs}) for r in records]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as those of a mean of nothing
        with pytest.raises(DataError, match="hold no number"):
            unmodeled.check(model, empty)


# ---------------------------------------------------------------- the command


def wheel(wraps):
    """Records of a wheel whose speed a counter of 16 bits shows, and its model."""
    rng, t, records = np.random.default_rng(4), np.arange(0, 8, 0.04), []
    volts = np.minimum(1.5 * t, 11.0), 10 * np.sin(1.1 * t), np.where(t // 1.6 % 2 < 1, 9.8, 3.0)
    for k, volt in enumerate(volts):
        w, speed = 0.0, []
        for v in volt:
            speed.append(w)
            w += (1 - np.exp(-0.2)) * (4000.0 * v - w)
        values = np.array(speed) + rng.normal(0, 50, t.size)
        values = (values + 32768) % 65536 - 32768 if wraps else values
        sensors = {"speed": Sensor(name="speed", sigma=50.0)}
        records.append(Record(name=f"r{k}", time=t, inputs={"volt": volt}, sensors=sensors,
                              outputs={"speed": values}))  # fmt: skip
    model = Equations(
        lambda t, x, u, p: ((p.g * u.volt - x.w) / p.T,),
        states={"w": (0.0, 100.0, "1")},
        parameters={"g": (4000.0, 200.0, "1/V"), "T": (0.2, 0.03, "s")},
        hold="zero",
        inputs={"volt": "V"},
        outputs={"speed": "w"},
    )
    return model, records


def test_a_counter_that_wraps_is_told_and_its_advice_works(tmp_path):
    model, records = wheel(wraps=True)
    (hint,) = check(model, records).hints
    assert hint.kind == "wrap"
    assert hint.sure
    assert "speed of r0, r1, r2 jumps by about 65536, as a counter of 16 bits" in hint.text
    with pytest.raises(DataError, match="speed of r0, r1, r2 jumps") as refused:
        model.diagnose(records)
    option = re.search(r"--period (\S+)=(\S+) makes", str(refused.value))
    periods = {option[1]: option[2]}
    files = [write_record(r, tmp_path / f"{r.name}.csv") for r in records]
    assert "--period speed=65536" in check_records(read_records(files))[0]
    again = read_records(files, options=ReadOptions(periods=periods))
    found = check(model, again)
    assert not found.hints
    assert max(r.in_noise for r in found.rows) < 1.2
    for text in ("many", "1mm", "-1"):
        with pytest.raises(DataError, match=r"period = .*expected a number > 0"):
            read_records(files, options=ReadOptions(periods={"speed": text}))


def test_an_angle_that_wraps_is_told_in_degrees():
    t = np.arange(0.0, 4.0, 0.01)
    angle = (20.0 * t + 0.5 * np.sin(9.0 * t)) % (2 * np.pi) - np.pi
    sensor = {"q": Sensor(name="q", unit="rad", sigma=1e-3)}
    record = Record(name="a", time=t, inputs={}, outputs={"q": angle}, sensors=sensor)
    (note,) = check_records([record])
    assert "a.q: jumps by about 6.28319, as an angle that wraps: --period q=360deg" in note


@pytest.mark.parametrize(
    "signal",
    [
        lambda t: np.where(np.sin(7.0 * t) > 0.0, 255.0, 0.0),  # two levels
        lambda t: 127.5 + 127.5 * np.sin(7.0 * t),
        lambda t: 250.0 * np.exp(-3.0 * (t % 1.0)),  # decays and restarts
        lambda t: np.random.default_rng(0).uniform(0.0, 256.0, t.size),
    ],
)
def test_a_signal_that_jumps_without_a_wrap_is_not_told(signal):
    t = np.arange(0.0, 4.0, 0.01)
    assert wrap_of(signal(t)) is None


def test_a_delay_in_some_records_is_told():
    rng, h, n, records = np.random.default_rng(9), 1e-3, 400, []
    for name, late in (("good 1", 0), ("good 2", 0), ("late 1", 1), ("late 2", 1)):
        u = np.repeat(rng.uniform(-1, 1, n // 10 + 1), 10)[:n]
        x, values = 0.0, []
        for v in u:
            values.append(x)
            x += (1 - np.exp(-h / 5e-3)) * (v - x)
        y = np.r_[np.zeros(late), values[: n - late]] + 1e-3 * rng.standard_normal(n)
        sensors = {"x": Sensor(name="x", sigma=1e-3, unit="V")}
        records.append(Record(name=name, time=np.arange(n) * h, inputs={"u": u}, sensors=sensors,
                              outputs={"x": y}))  # fmt: skip
    model = Equations(
        lambda t, x, u, p: ((u.u - x.x) / p.tau,),
        states={"x": (0.0, 0.01, "V")},
        parameters={"tau": (5e-3, 2.5e-4, "s")},
        hold="zero",
        inputs={"u": "V"},
        outputs={"x": "x"},
    )
    (hint,) = check(model, records).hints
    assert (hint.kind, hint.sure) == ("delay", False)
    assert "x is 1 ms late in record late 1, late 2, and not in the others" in hint.text


def test_a_sensor_that_lags_in_every_record_is_told():
    t, records = np.arange(0.0, 2.0, 1e-3), []
    for name, phase in (("one", 0.0), ("two", 1.0)):
        wave = np.sin(9.0 * t + phase)
        late = np.sin(9.0 * (t - 5e-3) + phase)
        outputs = {"current": 1e3 * wave, "speed": late}  # in mA beside V: residuals are shares
        sensors = {n: Sensor(name=n, sigma=s, unit="V")
                   for n, s in (("current", 1.0), ("speed", 1e-3))}  # fmt: skip
        noise = np.random.default_rng(3).normal(0.0, 1e-3, (2, t.size)) * [[1e3], [1.0]]
        outputs = {n: y + e for (n, y), e in zip(outputs.items(), noise, strict=True)}
        records.append(Record(name=name, time=t, inputs={"u": wave}, sensors=sensors,
                              outputs=outputs))  # fmt: skip
    model = unmodeled.Simulator(
        lambda time, inputs, parameters: {"current": 1e3 * inputs["u"], "speed": inputs["u"]},
        inputs=("u",),
        outputs={"current": "V", "speed": "V"},
    )
    (hint,) = check(model, records).hints
    assert hint.text == (
        "speed is 5 ms late in every record, and current is not: does its sensor lag, or its clock?"
    )
    early = []
    for r, phase in zip(records, (0.0, 1.0), strict=True):
        speed = np.sin(9.0 * (t + 5e-3) + phase)
        early.append(replace(r, outputs={**r.outputs, "speed": speed}))
    (hint,) = check(model, early).hints
    assert hint.text.endswith("5 ms early in every record, and current is not: is its clock ahead?")


def test_check_says_what_comes_next(tmp_path, capsys):
    (tmp_path / "spring.py").write_text(
        "from unmodeled import Simulator\n"
        "def line(time, inputs, parameters):\n"
        "    return {'y': parameters['k'] * inputs['push']}\n"
        "model = Simulator(line, parameters={'k': (2.0, 0.1, '')})\n"
    )
    time = np.linspace(0.0, 1.0, 50)
    rows = [f"{t:.3f},{np.sin(9 * t):.6f},{2.2 * np.sin(9 * t) ** 3:.6f}" for t in time]
    (tmp_path / "run.csv").write_text("\n".join(["t,push,y", *rows]))
    assert command("check", str(tmp_path / "spring.py"), str(tmp_path / "run.csv")) == 0
    assert "go on with `unmodeled diagnose`" in " ".join(capsys.readouterr().out.split())


def test_what_cannot_be_compared_is_refused(tmp_path, capsys):
    record = models.records(1)[0]
    other = replace(record, outputs={"w": record.time}, sensors={"w": Sensor(name="w", unit="m")})
    with pytest.raises(DataError, match="none of its outputs"):
        unmodeled.check(models.NOMINAL, other)
    assert command("check", "model.xyz") == 2
    assert "got 'model.xyz' alone, expected measured files" in capsys.readouterr().err
    path = write_record(record, tmp_path / "one.csv")
    assert command("check", path, "-o", tmp_path / "a.png") == 2
    assert "need a MODEL before the data" in capsys.readouterr().err
    assert command("check", path, "--json") == 0
    (row,) = json.loads(capsys.readouterr().out)["channels"]
    assert (row["channel"], row["unit"], row["samples"]) == ("q", "m", 600)


def test_a_delay_is_finer_than_the_samples():
    time = np.arange(400) * 0.01
    late, left = _delay(time, np.sin(3.0 * (time - 0.0234)), np.sin(3.0 * time))
    assert late == pytest.approx(0.0234, abs=5e-4)
    assert left < 0.01


# ---------------------------------------------------------------- what a check simulates


def counted(runs):
    """A function that counts its runs, with candidates without a size, and four records."""

    def gain(time, inputs, parameters):
        runs.append(parameters["k"])
        return {"y": parameters["k"] * inputs["u"] + parameters["dry"] * np.sign(inputs["u"])}

    parameters = {name: (1.0, 0.1, "1") for name in ("k", "a", "b", "c")}
    model = unmodeled.Simulator(gain, parameters=parameters, unknown={"dry": "N", "bend": "N"})
    time = np.arange(60) * 0.05
    records = []
    for k in range(4):
        u = np.sin((k + 1.0) * time)
        noise = 1e-3 * np.random.default_rng(k).standard_normal(60)
        y = 1.1 * u - 3.0 * np.sin(9.0 * time) + noise
        records.append(Record(name=f"r{k}", time=time, inputs={"u": u}, outputs={"y": y},
                              sensors={"y": Sensor(name="y", sigma=1e-3)}))  # fmt: skip
    return model, records


def test_a_check_simulates_each_record_once_and_the_first_one_twice(monkeypatch):
    """Of 29 runs, 24 were for sizes of candidates and steps of derivatives."""
    monkeypatch.setattr("unmodeled.search.compare.TRIED", -1.0)  # no other clocks
    runs, told = [], []
    model, records = counted(runs)
    found = check(model, records, progress=told.append)
    assert len(runs) <= 6
    assert found.rows[0].rms > 0.1
    assert told[1] == "simulates r0, record 1 of 4"
    before = len(runs)
    model.ready(records)
    assert len(runs) > before + 10  # a diagnosis sizes the candidates


def test_a_check_tells_what_it_does_not_try(monkeypatch):
    monkeypatch.setattr("unmodeled.search.compare.TRIED", -1.0)
    model, records = counted([])
    slow = [replace(r, time=60.0 * r.time) for r in records]
    assert any("left out" in text and "another clock" in text for text in check(model, slow).notes)
    monkeypatch.undo()
    assert not any("left out" in text for text in check(model, slow).notes)


def test_the_progress_of_a_check_is_shown_if_it_takes_long(capsys):
    line = LateLine()
    with line:
        line("simulates r0")
        line._timer.cancel()
        assert capsys.readouterr().err == ""
        line._begin()
        line("simulates r1")
    assert capsys.readouterr().err == "unmodeled: simulates r0\nunmodeled: simulates r1\n"
