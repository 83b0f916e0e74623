"""The gap before anything is fitted, and channels that are absolute or from rest."""

import dataclasses
import json
import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb import gap
from feltmb.cli import main
from feltmb.data import Record, Sensor, write_record
from feltmb.errors import DataError, InvalidParameter
from feltmb.gap import overlay

sys.path.insert(0, str(Path(__file__).parent))
import models

POINTS = ("key_front.y", "hammer_tip.x")


def command(*arguments):
    """Exit code of a command."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    return stop.value.code


@cache
def action():
    from feltmb.adapters import mechanism_model

    return mechanism_model(feltmb.load_action("steinway45"), channels=POINTS)[0]


@cache
def run():
    return feltmb.simulate("steinway45", "forte", duration=0.1, output_rate=2000.0)


def record(shift=None, *, reference="", sigma=2e-5, scale=1.0, late=0):
    """The run as a record; ``shift``: what is added to absolute coordinates, None: from rest."""
    generator = np.random.default_rng(3)
    done = run()
    outputs, sensors = {}, {}
    for name in POINTS:
        values = np.array(done[name])
        values = values - values[0] if shift is None else values + shift
        values = np.roll(values, late) if late else values
        values[:late] = values[late]
        outputs[name] = scale * values + sigma * generator.standard_normal(values.size)
        sensors[name] = Sensor(name=name, unit="m", sigma=sigma, reference=reference)
    force = np.array(done["finger.force"])
    return Record(
        name="run", time=done.time, inputs={"force": force}, outputs=outputs, sensors=sensors
    )


def test_absolute_channels_are_told_from_those_that_start_at_rest():
    absolute, notes = action().referred(record(0.0))
    assert "key_front.y, hammer_tip.x: absolute coordinates" in notes[0]
    assert absolute.sensors["hammer_tip.x"].reference == "rest"
    again, nothing = action().referred(absolute)
    assert nothing == ()
    assert again is absolute
    plain = record()
    same, nothing = action().referred(plain)
    assert same is plain
    assert nothing == ()
    for name in POINTS:  # exactly the rest of the model: no noise of a mean is added
        difference = absolute.outputs[name] - plain.outputs[name]
        assert np.abs(difference).max() < 1e-9


def test_a_channel_that_starts_elsewhere_is_told_of():
    far = record(0.5e-3)
    same, notes = action().referred(far)
    assert same is far
    assert "neither zero nor the rest value of steinway45" in notes[0]
    told, notes = action().referred(record(0.5e-3, reference="absolute"))
    assert any("the first value of the record is used as rest value" in n for n in notes)
    assert abs(np.mean(told.outputs["hammer_tip.x"][:40])) < 1e-5
    offset = record(0.5e-3, reference="rest")
    same, notes = action().referred(offset)
    assert same is offset
    assert notes == ()


def test_a_channel_whose_rest_is_lost_in_noise_goes_with_the_others():
    from feltmb.adapters.references import from_rest

    time = np.arange(40) * 1e-3
    noise = 1e-5 * np.random.default_rng(0).standard_normal(40)
    sensors = {n: Sensor(name=n, unit="m", sigma=1e-5) for n in "ab"}
    both = Record(
        name="r", time=time, inputs={}, outputs={"a": 0.1 + noise, "b": 3e-5 + noise},
        sensors=sensors,
    )  # fmt: skip
    moved, _ = from_rest(both, {"a": 0.1, "b": 3e-5}, "m")
    np.testing.assert_allclose(moved.outputs["b"], noise, atol=1e-12)
    alone = replace(both, outputs={"b": 3e-5 + noise}, sensors={"b": sensors["b"]})
    assert from_rest(alone, {"b": 3e-5}, "m")[0] is alone


def test_the_data_checks_of_a_diagnosis_tell_what_was_absolute():
    ready = action().ready([record(0.0)])
    assert any("absolute coordinates" in n for n in ready.notes)
    assert abs(ready.records[0].outputs["hammer_tip.x"][0]) < 1e-4


def test_outputs_of_a_run_are_compared_as_they_are(tmp_path, capsys):
    path, picture = tmp_path / "run.csv", tmp_path / "run.png"
    assert command("stroke", "steinway45", "forte", "--duration", "0.1", "-o", str(path)) == 0
    capsys.readouterr()
    given = ["gap", "check", "steinway45", str(path), "--json", "-o", str(picture)]
    assert command(*given) == 0
    found = json.loads(capsys.readouterr().out)
    assert {r["channel"] for r in found["gap"]} > set(POINTS)
    assert all(r["rms"] < 1e-6 for r in found["gap"])
    assert any("absolute coordinates" in n for n in found["notes"])
    assert picture.read_bytes()[:4] == b"\x89PNG"


# ---------------------------------------------------------------- model beside records


def test_a_model_that_is_right_leaves_the_noise():
    found = gap.check(action(), record(0.0))
    assert [r.channel for r in found.rows] == list(POINTS)
    for row in found.rows:
        assert row.in_noise == pytest.approx(1.0, abs=0.2)
        assert np.isnan(row.delay)
        assert np.isnan(row.factor)
    figure = found.plot()
    assert len(figure.axes) == 2 * len(POINTS)
    assert [line.get_label() for line in figure.axes[0].lines] == ["record", "model"]


def test_a_wrong_scale_and_a_late_clock_are_seen():
    scaled = gap.check(action(), record(scale=1e-3, sigma=1e-8))
    for row in scaled.rows:
        assert row.factor == pytest.approx(1e-3, rel=0.01)
    assert any("m labeled as mm?" in n for n in scaled.notes)
    late = gap.check(action(), record(late=8))  # samples of 0.5 ms
    for row in late.rows:
        assert row.delay == pytest.approx(4e-3, abs=3e-4)
    assert any("every channel is about" in n and "ms late" in n for n in late.notes)


def test_any_model_is_compared(tmp_path, capsys):
    own = models.records(2)
    found = gap.check(models.NOMINAL, own)
    assert [r.record for r in found.rows] == [r.name for r in own]
    assert all(r.rms > r.noise for r in found.rows)
    path = write_record(own[0], tmp_path / "one.csv")
    assert command("gap", "check", str(Path(models.__file__)), str(path)) == 2
    assert "model is missing" in capsys.readouterr().err
    file = tmp_path / "m.py"
    file.write_text(
        f"import sys\nsys.path.insert(0, {str(Path(models.__file__).parent)!r})\n"
        "import models\nmodel, effects = models.NOMINAL, models.EFFECTS\n"
    )
    assert command("gap", "check", str(file), str(path)) == 0
    shown = capsys.readouterr().out
    assert "- oscillator, nothing fitted" in shown
    path.with_suffix(".toml").unlink()
    assert command("gap", "check", str(file), str(path)) == 0


def swinging(start_sd, *, rate=lambda q, v: -9.0 * q):
    """A free oscillator, and two records of it that start at a turn and at full speed."""
    model = gap.OdeModel(
        name="pendulum",
        states=[
            gap.State(name="q", unit="rad", scale=0.5, start_sd=start_sd),
            gap.State(name="v", unit="rad/s", scale=1.5, start_sd=start_sd),
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
    found = gap.check(*swinging(2.0))
    for row, start in zip(found.rows, ((0.7, 0.0), (0.0, 1.2)), strict=True):
        assert row.in_noise == pytest.approx(1.0, abs=0.3)
        (note,) = [n for n in found.notes if n.startswith(f"{row.record}: the start is not known")]
        q, v = map(float, re.findall(r"= ([-\d.e]+) rad", note))
        assert (q, v) == pytest.approx(start, abs=0.03)
    assert not [n for n in gap.check(*swinging(0.0)).notes if "start" in n]


def test_a_model_that_diverges_from_the_start_of_the_record_starts_as_expected():
    found = gap.check(*swinging(2.0, rate=lambda q, v: 1e4 * q**3))
    assert not [n for n in found.notes if "the start is not known" in n]
    np.testing.assert_array_equal(found.simulated["turn"]["angle"], 0.0)


def test_what_cannot_be_compared_is_refused(tmp_path, capsys):
    with pytest.raises(DataError, match="none of its outputs"):
        gap.check(models.NOMINAL, record())
    assert command("gap", "check", "steinway45") == 2
    assert "got 'steinway45' alone, expected measured files" in capsys.readouterr().err
    path = write_record(models.records(1)[0], tmp_path / "one.csv")
    assert command("gap", "check", str(path), "-o", str(tmp_path / "a.png")) == 2
    assert "need a MODEL before the data" in capsys.readouterr().err


def straight(factor, sd=0.1):
    """A line through records that are a factor too large."""
    model = gap.LinearModel(
        name="line",
        output="y",
        columns={"slope": lambda r: r.inputs["u"]},
        parameters=[gap.Parameter(name="slope", value=1.0, sd=sd)],
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


def exchanged(r, *names):
    """The record with each channel under the name of the next one."""
    moved = dict(zip((*names[1:], names[0]), [r.outputs[n] for n in names], strict=True))
    return replace(r, outputs={**r.outputs, **moved})


def three(stiffness_sd=0.1):
    """Three outputs of one input, with the records of a model that is a tenth softer."""
    model = gap.SimulatorModel(
        lambda time, inputs, p: {
            "a": p["k"] * inputs["u"], "b": np.cumsum(inputs["u"]) * 0.02, "c": inputs["u"] ** 2
        },
        parameters=[gap.Parameter(name="k", value=1.0, sd=stiffness_sd)],
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


def test_exchanged_columns_are_told():
    assert not [n for n in gap.check(action(), record()).notes if "exchanged" in n]
    (note,) = [n for n in gap.check(action(), exchanged(record(), *POINTS)).notes
               if "exchanged" in n]  # fmt: skip
    assert note == (
        "run: key_front.y looks like hammer_tip.x, hammer_tip.x looks like key_front.y: are the "
        "columns exchanged?"
    )


def test_single_numbers_are_not_exchanged_columns():
    model, (first, _) = three()
    blank = {n: np.where(np.arange(v.size) == 5, v, np.nan) for n, v in first.outputs.items()}
    swapped = exchanged(replace(first, outputs=blank), "a", "b")
    assert not [n for n in gap.check(model, swapped).notes if "exchanged" in n]


def test_a_wrong_direction_is_no_exchange():
    model = gap.SimulatorModel(
        lambda time, inputs, p: {"front": inputs["u"], "back": -p["arm"] * inputs["u"]},
        parameters=[gap.Parameter(name="arm", value=1.0, sd=0.05)],
        inputs={"u": "1"},
        outputs={"front": "m", "back": "m"},
    )
    _, (first, _) = three()
    u = first.inputs["u"]
    sensors = {n: Sensor(name=n, unit="m", sigma=1e-3) for n in ("front", "back")}
    seen = replace(first, outputs={"front": -u, "back": u}, sensors=sensors)
    notes = gap.check(model, seen).notes
    assert not [n for n in notes if "exchanged" in n]
    assert len([n for n in notes if "the other direction" in n]) == 2


def test_exchanged_columns_end_a_diagnosis_before_any_fit():
    model, records = three()
    told = []
    with pytest.raises(DataError, match="a looks like c, c looks like b, b looks like a: the col"):
        gap.diagnose(model, [], [exchanged(r, *"abc") for r in records], progress=told.append)
    assert {p.stage for p in told} == {"checks of the data"}
    # One record alone may be a cause of its own, and free parameters may explain another order.
    quick = gap.Options(bootstrap=0, restarts=0, advice=False)
    one = gap.diagnose(model, [], [exchanged(records[0], "a", "b"), records[1]], options=quick)
    assert one.verdict is gap.Verdict.UNKNOWN
    free, own = three(np.inf)
    assert gap.diagnose(free, [], [exchanged(r, "a", "b") for r in own], options=quick).verdict
    # Records may list their outputs in another order, or lack some.
    turned = replace(records[1], outputs=dict(reversed(records[1].outputs.items())))
    blank = replace(records[0], outputs={**records[0].outputs, "c": np.full(200, np.nan)})
    with pytest.raises(DataError, match="a looks like b, b looks like a: the columns"):
        gap.diagnose(model, [], [exchanged(r, "a", "b") for r in (blank, turned)])


def test_a_channel_without_values_has_no_row():
    model, records = three()
    blank = [replace(r, outputs={**r.outputs, "c": np.full(200, np.nan)}) for r in records]
    quick = gap.Options(bootstrap=0, restarts=0, advice=False)
    report = gap.diagnose(model, [], blank, options=quick)
    assert report.verdict is gap.Verdict.CALIBRATED
    assert {row.channel for row in report.how_far.rows} == {"a", "b"}


def test_exchanged_channels_that_are_alike_are_told():
    """Two thermocouples: each explains three quarters of the other one."""

    def run(_, inputs, p):
        return {"near": inputs["u"], "far": 0.6 * p["share"] * inputs["u"]}

    model = gap.SimulatorModel(
        run, parameters=[gap.Parameter(name="share", value=1.0, sd=0.1)],
        inputs={"u": "1"}, outputs={"near": "degC", "far": "degC"},
    )  # fmt: skip
    generator, time = np.random.default_rng(7), np.arange(300.0)
    records = []
    for i in range(2):
        u = 40.0 * np.sin((0.02 + 0.01 * i) * time)
        outputs = {n: s * u + 0.1 * generator.standard_normal(time.size)
                   for n, s in (("near", 0.63), ("far", 1.0))}  # fmt: skip
        sensors = {n: Sensor(name=n, unit="degC", sigma=0.1) for n in outputs}
        records.append(
            Record(name=f"r{i}", time=time, inputs={"u": u}, outputs=outputs, sensors=sensors)
        )
    with pytest.raises(DataError, match="near looks like far, far looks like near: the columns"):
        gap.diagnose(model, [], records)


def test_channels_that_are_nearly_equal_are_not_exchanged():
    model = gap.SimulatorModel(
        lambda time, inputs, p: {
            "left": (1.0 + p["tilt"]) * inputs["u"], "right": (1.0 - p["tilt"]) * inputs["u"]
        },
        parameters=[gap.Parameter(name="tilt", value=0.1, sd=0.02)],
        inputs={"u": "1"},
        outputs={"left": "m", "right": "m"},
    )  # fmt: skip
    generator = np.random.default_rng(6)
    time = np.arange(200) * 1e-3
    records = []
    for i in range(2):
        u = np.sin((20.0 + 9.0 * i) * time)
        sensors = {n: Sensor(name=n, unit="m", sigma=1e-3) for n in ("left", "right")}
        outputs = {n: s * u + 1e-3 * generator.standard_normal(time.size)
                   for n, s in (("left", 0.92), ("right", 1.08))}  # fmt: skip
        made = Record(name=f"r{i}", time=time, inputs={"u": u}, outputs=outputs, sensors=sensors,
                      role="held_out" if i else "fit")  # fmt: skip
        records.append(made)
    assert not [n for n in gap.check(model, records).notes if "exchanged" in n]
    quick = gap.Options(bootstrap=0, restarts=0, advice=False)
    assert gap.diagnose(model, [], records, options=quick).verdict is gap.Verdict.CALIBRATED


def test_a_wrong_unit_ends_a_diagnosis_before_any_fit():
    """It was fitted for four minutes before, and told as parameters at their limits."""
    told = []
    for factor, says in ((10.0, "mm labeled as cm"), (0.1, "cm labeled as mm")):
        with pytest.raises(DataError, match=rf"DATA PROBLEM: the unit of y: .*{says}.*--unit"):
            gap.diagnose(straight(factor)[0], [], straight(factor)[1], progress=told.append)
    assert {p.stage for p in told} == {"checks of the data"}


@pytest.mark.parametrize(
    ("factor", "told"),
    [(1.13e3, "mm labeled as m"), (-1.12, "the other direction"), (28.6, "mm labeled as inches")],
)
def test_a_wrong_unit_is_found_beside_a_gap(factor, told):
    """A spring that the model lacks made the force 1.13 times as large, in the wrong unit."""
    model, records = straight(factor)
    with pytest.raises(DataError, match=f"in all records .{told}"):
        gap.diagnose(model, [], records)


def test_a_wrong_unit_of_one_record_is_found():
    model, (right, _) = straight(1.0)
    _, (wrong, held_out) = straight(1e3)
    records = [right, dataclasses.replace(wrong, name="w"), straight(1.0)[1][1]]
    with pytest.raises(DataError, match=r"1e\+03 times the model in record w \(mm labeled as m"):
        gap.diagnose(model, [], records)
    assert held_out.role == "held_out"


def test_records_that_disagree_in_another_factor_are_no_wrong_unit_of_one():
    model, (first, held_out) = straight(3.0)
    third = dataclasses.replace(straight(8.0)[1][0], name="third")
    quick = gap.Options(bootstrap=0, restarts=0, advice=False)
    assert gap.diagnose(model, [], [first, third, held_out], options=quick).verdict


def test_no_length_is_labeled_as_a_force():
    model, records = straight(9.81)
    with pytest.raises(DataError, match="mm labeled as cm"):
        gap.diagnose(model, [], records)
    newtons = [
        dataclasses.replace(r, sensors={"y": Sensor(name="y", unit="N", sigma=1e-3)})
        for r in records
    ]
    with pytest.raises(DataError, match="N labeled as kgf"):
        gap.diagnose(model, [], newtons)


def heated(change_input=1.0, scale=(1.0, 0.0), gain=1.0):
    """Model and records of a block in a room of 22 degC, with a wrong input or scale."""
    random = np.random.default_rng(2)
    model = gap.OdeModel(
        name="block",
        states=[gap.State(name="T", unit="degC", scale=10.0, start=22.0, start_sd=0.5)],
        parameters=[
            gap.Parameter(name="C", value=100.0, sd=5.0, lower=1.0),
            gap.Parameter(name="G", value=1.0, sd=0.1, lower=0.01),
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
        sensor = Sensor(name="T", unit="degC", sigma=0.02)
        inputs = {"P": change_input * power}
        records.append(
            Record(name=f"r{k}", time=time, inputs=inputs, outputs={"T": shown},
                   sensors={"T": sensor})
        )  # fmt: skip
    return model, records


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"change_input": 1e-3}, r"unit of P: the model follows all records with 1000 times"),
        ({"change_input": 1e3}, r"unit of P: the model follows all records with 0\.001 times"),
        ({"scale": (1.0, 273.15)}, r"unit of T: .* \(K labeled as degC"),
        ({"scale": (1.8, 32.0)}, r"unit of T: .* \(degrees Fahrenheit labeled as degC"),
        # The label of the file is not the unit of the model.
        ({"scale": (1.0, -273.15)}, r"unit of T: .* \(degC labeled as K"),
        ({"scale": (1.0 / 1.8, -32.0 / 1.8)}, r"of T: .* \(degC labeled as degrees Fahrenheit"),
    ],
)
def test_a_wrong_unit_beside_a_constant_is_found(wrong, told):
    model, records = heated(**wrong)
    with pytest.raises(DataError, match=told):
        gap.diagnose(model, [], records)


@pytest.mark.parametrize(
    ("factor", "told"),
    [(1.0 / 60.0, "minutes labeled as s"), (1e3, "ms labeled as s"), (60.0, "s labeled as min")],
)
def test_a_clock_in_a_wrong_unit_is_found(factor, told):
    model, records = heated()
    wrong = [dataclasses.replace(r, time=factor * r.time) for r in records]
    with pytest.raises(DataError, match=f"unit of time: .*{told}"):
        gap.diagnose(model, [], wrong)


def in_another_time(second, rate=1.5e-3, **known):
    """A first-order lag whose rates are per ``second``, and its records over two hours."""
    model = gap.OdeModel(
        name="lag",
        states=[gap.State(name="a", unit="mol/l", scale=1.0, start_sd=0.0)],
        parameters=[gap.Parameter(name="k", value=rate * second, unit="1/s", **known)],
        inputs=["feed"],
        rates=lambda t, x, u, p: (p.k * (u.feed - x.a),),
        outputs={"a": "a"},
    )
    time = np.arange(0.0, 7200.0, 20.0)
    records = []
    for i in range(2):
        feed = np.where((time > 300.0) & (time < 2500.0 + 900.0 * i), 1.0, 0.2)
        a = np.zeros(time.size)
        for j in range(time.size - 1):  # exact between samples, but for the ramp of the input
            mean = 0.5 * (feed[j] + feed[j + 1])
            a[j + 1] = mean + (a[j] - mean) * np.exp(-1.5e-3 * 20.0)
        records.append(
            Record(
                name=f"r{i}", time=time, inputs={"feed": feed},
                outputs={"a": a + 0.01 * np.random.default_rng(i).standard_normal(time.size)},
                sensors={"a": gap.Sensor(name="a", unit="mol/l", sigma=0.01)},
            )
        )  # fmt: skip
    return model, records


@pytest.mark.parametrize(
    ("second", "told"),
    [
        (3600.0, "0.0002778 times as long (s labeled as hours? Or are the rates {} per hour?)"),
        (60.0, "0.01667 times as long (s labeled as minutes? Or are the rates {} per minute?)"),
        (1.0 / 3600.0, "3600 times as long (hours labeled as s?)"),
        (1e-3, "1000 times as long (s labeled as ms? Or are the rates {} per ms?)"),
    ],
)  # fmt: skip
def test_rates_in_another_unit_of_time_are_told(second, told):
    """With rates per hour the simulation diverges, and with rates per ms nothing moves."""
    model, records = in_another_time(second, sd=1e-4 * second)
    told = told.format("of the model")
    notes = gap.check(model, records).notes
    assert notes == (f"the unit of time: the model follows all records with a clock {told}",)
    with pytest.raises(DataError) as error:
        gap.diagnose(model, [], records)
    assert told in str(error.value)
    assert "rates of a model are per second" in str(error.value)


def test_rates_in_the_right_unit_of_time_are_not_told():
    model, records = in_another_time(1.0, sd=1e-4)
    assert not gap.check(model, records).notes
    model, records = in_another_time(1.0, rate=3e-3, sd=1e-4)  # a gap, but of no clock
    assert "unit of time" not in " ".join(gap.check(model, records).notes)


def test_a_divergence_without_tabulated_values_asks_for_the_unit_of_the_rates():
    model, records = in_another_time(3600.0, sd=np.inf)
    assert "are the rates of the model per second?" in " ".join(gap.check(model, records).notes)
    with pytest.raises(InvalidParameter, match="are the rates of the model per second"):
        gap.diagnose(model, [], records)


def test_a_function_that_fails_in_another_unit_of_time_is_told():
    def function(t, u, p):
        x, out = 0.0, []
        for i, now in enumerate(t):
            x += (now - t[i - 1] if i else 0.0) * 3600.0 * p["k"] * (u["feed"][i] - x)
            if abs(x) > 1e9:
                raise OverflowError("too large")
            out.append(x)
        return {"a": out}

    _, records = in_another_time(1.0, sd=1e-4)
    model = gap.SimulatorModel(
        function,
        parameters=[gap.Parameter(name="k", value=1.5e-3, sd=1e-4)],
        inputs=["feed"], outputs=["a"], workers=1,
    )  # fmt: skip
    with pytest.raises(DataError, match="are the rates of the model per hour"):
        gap.diagnose(model, [], records)


@pytest.mark.parametrize(("factor", "told"), [(1e3, "ms labeled as s"), (1e-3, "s labeled as ms")])
def test_a_clock_of_a_stroke_in_a_wrong_unit_is_found_before_a_long_simulation(factor, told):
    model = action()
    stroke = record(0.0)
    wrong = dataclasses.replace(stroke, time=factor * stroke.time)
    with pytest.raises(DataError, match=f"unit of time: .*{told}"):
        gap.diagnose(model, [], [wrong])
    found = gap.check(model, wrong)
    assert any(f"({told}?)" in note for note in found.notes)
    assert bool(found.rows) == (factor < 1.0)  # not simulated for a minute and more
    assert any("not simulated with this clock" in n for n in found.notes) == (factor > 1.0)
    found.plot()
    # Simulations of another clock are not those of the first one.
    slow, fast = (
        overlay.expected_outputs(model, dataclasses.replace(stroke, time=f * stroke.time))
        for f in (2.0, 1.0)
    )
    assert np.ptp(slow - fast, axis=0).max() > 1e-3


@pytest.mark.parametrize("gain", [1.0, 2.0, 5.0])
def test_a_gap_of_a_temperature_is_no_wrong_unit(gain):
    model, records = heated(gain=gain)
    quick = gap.Options(bootstrap=0, restarts=0, advice=False)
    assert gap.diagnose(model, [], records, options=quick).verdict


def test_an_estimated_interpolation_does_not_hide_a_wrong_unit():
    """Its share of 0.5 with a standard deviation of 0.5 is no factor of an output."""
    rng = np.random.default_rng(3)
    model = gap.OdeModel(
        name="lag",
        states=[gap.State(name="x", unit="m", scale=1.0, start_sd=0.1)],
        parameters=[gap.Parameter(name="rate", value=30.0, sd=1.0, unit="1/s")],
        inputs=["u"],
        rates=lambda t, x, u, p: (p.rate * (u.u - x.x),),
        outputs={"y": "x", "z": "x"},
    )
    time = np.arange(300) * 0.02
    records = []
    for i in range(3):
        u = np.repeat(rng.standard_normal(60), 5)
        x = np.zeros(300)
        for k in range(299):
            x[k + 1] = u[k] + (x[k] - u[k]) * np.exp(-30.0 * 0.02)
        noise = 1e-3 * rng.standard_normal((2, 300))
        records.append(
            Record(
                name=f"r{i}", time=time, inputs={"u": u},
                outputs={"y": x + noise[0], "z": 1e3 * (x + noise[1])},
                sensors={
                    "y": Sensor(name="y", unit="m", sigma=1e-3),
                    "z": Sensor(name="z", unit="m", sigma=1.0),
                },
            )
        )  # fmt: skip
    assert any(p.name == "between.u" for p in model.ready(records).model.parameters)
    with pytest.raises(
        DataError, match=r"unit of z: .* times the model in all records \(mm labeled as m"
    ):
        gap.diagnose(model, [], records)


def test_a_factor_that_a_parameter_may_be_is_no_wrong_unit():
    quick = gap.Options(bootstrap=0, restarts=0, advice=False)
    for factor, sd in ((10.0, 5.0), (1.3, 0.1)):
        model, records = straight(factor, sd)
        report = gap.diagnose(model, [], records, options=quick)
        assert report.calibrated[0].value == pytest.approx(factor, rel=0.01)


def test_check_writes_a_page(tmp_path, capsys):
    write_record(record(), tmp_path / "run.csv")
    page = tmp_path / "gap.html"
    data = ["steinway45", str(tmp_path / "run.csv")]
    assert command("gap", "check", *data, "--html", str(page)) == 0
    text = page.read_text()
    assert text.count('class="feltmb-view"') == 1
    assert "model, nothing fitted" in text
    assert "http" not in text.replace("http-equiv", "").replace("http://www.w3.org", "")
    assert command("gap", "check", *data, "--html", str(page)) == 2
    assert "--force" in capsys.readouterr().err
    assert command("gap", "check", *data, "--html", str(tmp_path / "gap.txt")) == 2
    assert command("gap", "check", data[1], "--html", str(tmp_path / "b.html")) == 2
    assert "need a MODEL" in capsys.readouterr().err


def test_a_record_that_the_model_does_not_resemble_has_no_unit():
    """The best factor of an orthogonal record is exactly 0, whose logarithm does not exist."""
    assert overlay._distance(0.0, 1.0) == np.inf
    assert overlay._distance(1130.0, 1000.0) == pytest.approx(np.log(1.13) / np.log(1000.0))
    assert overlay._distance(-1.1, -1.0) == pytest.approx(np.log(1.1) / np.log(10.0))
    assert overlay._distance(1.1, -1.0) == np.inf


def test_uncertain_start_states_do_not_hide_a_wrong_unit():
    """A start state that is estimated could absorb degrees that were labeled as radians."""
    arm = gap.Coordinate(name="arm", position="q", speed="v", inertia="J", unit="N m")
    model = gap.OdeModel(
        name="arm",
        states=[
            gap.State(name="q", unit="rad", scale=0.1, start_sd=1.0),
            gap.State(name="v", unit="rad/s", scale=1.0, start_sd=10.0),
        ],
        parameters=[
            gap.Parameter(name="J", value=0.02, sd=0.001, unit="kg m^2"),
            gap.Parameter(name="k", value=2.0, sd=0.1, unit="N m/rad"),
        ],
        inputs=["M"],
        rates=lambda t, x, u, p: (x.v, (u.M - p.k * x.q - 0.02 * x.v) / p.J),
        outputs={"angle": "q"},
        coordinates=[arm],
    )
    time = np.arange(400) * 5e-3
    records = []
    for i in range(3):
        moment = (0.1 + 0.05 * i) * np.sin((5.0 + i) * time)
        empty = Record(name=f"r{i}", time=time, inputs={"M": moment}, outputs={"angle": 0.0 * time})
        jobs = gap.Jobs(
            theta=np.array([[0.0205, 2.06]]),
            segments=np.array([[0, time.size - 1]]),
            starts=np.zeros((1, 2)),
        )
        angle = np.degrees(model.simulate(empty, jobs).outputs[0, :, 0])
        noise = 0.02 * np.random.default_rng(i).standard_normal(time.size)
        sensor = Sensor(name="angle", unit="rad", sigma=0.02)
        records.append(replace(empty, outputs={"angle": angle + noise}, sensors={"angle": sensor}))
    with pytest.raises(DataError, match="degrees labeled as rad"):
        gap.diagnose(model, [], records)
