"""What a first user meets: his model file, faults of his data, and the answer."""

from dataclasses import replace

import numpy as np
import pytest

import unmodeled
from unmodeled.cli import main as command_line
from unmodeled.data import Record, Sensor, read_record
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.loading import load_model

QUICK = unmodeled.Options(tries=2, max_effects=1)

MODEL = """
from unmodeled import Coordinate, Equations, Parameter, State, candidates, library

table = Coordinate(name="table", position="x", speed="v", inertia="m")
model = Equations(
    name="table",
    states=[State(name="x", unit="m", start_sd=1e-4), State(name="v", unit="m/s", start_sd=1e-3)],
    parameters=[Parameter(name="m", value=2.0, sd=0.1, unit="kg"),
                Parameter(name="k", value=90.0, sd=3.0, unit="N/m")],
    inputs={"motor": "N"},
    rates=lambda t, x, u, p: (x.v, (u.motor - p.k * x.x) / p.m),
    outputs={"table": "x", "speed": "v"},
    coordinates=[table],
)
"""
EFFECTS = """
def effects(records):
    return candidates(model, records)
"""


def load(folder, text):
    path = folder / "model.py"
    path.write_text(text)
    return load_model(str(path))


def record(time=None, **outputs):
    time = np.arange(100) * 0.01 if time is None else time
    outputs = outputs or {"table": 1e-2 * np.sin(6.0 * time)}
    return Record(name="run", time=time, inputs={"motor": np.sin(6.0 * time)}, outputs=outputs,
                  sensors={n: Sensor(name=n, unit="m") for n in outputs})  # fmt: skip


def test_effects_of_a_model_file_may_be_a_function_of_the_records(tmp_path):
    adapter = load(tmp_path, MODEL + EFFECTS)
    assert adapter.effects == ()
    effects = {e.name: e for e in adapter.with_records([record()]).effects}
    assert effects["offset of input motor"].unit == "N"
    assert effects["saturation of input motor"].shape_names == ("level [N]",)
    assert effects["delay of sensor table"].scale == pytest.approx(0.01)
    with pytest.raises(InvalidParameter, match="give measured files, or define planned"):
        adapter.with_records([])
    for text, told in (
        ("effects = lambda records: [1]", r"effects\(records\) holds something that is no"),
        ("effects = lambda records: None", r"effects\(records\) is NoneType, expected a sequence"),
        ("def effects(records):\n    yield 1", r"effects\(records\) holds something that is no"),
        ("effects = lambda records: records[7]", r"effects\(records\) raises IndexError"),
    ):
        with pytest.raises(InvalidParameter, match=told):
            load(tmp_path, MODEL + text).with_records([record()])
    one_by_one = MODEL + EFFECTS.replace("return ", "yield from ")
    assert len(load(tmp_path, one_by_one).with_records([record()]).effects) == len(effects)
    with pytest.raises(InvalidParameter, match="effects is int, expected a sequence"):
        load(tmp_path, MODEL + "effects = 3")
    lazy = "\nmade = library.for_coordinate(table, force=4.0, travel=0.04, speed=0.3)\n"
    lazy += "effects = (e for e in made)\n"
    assert len(load(tmp_path, MODEL + lazy).effects) > 5


DOOR = (
    MODEL.replace("sd=0.1", "sd=0.005")
    .replace("sd=3.0", "sd=0.2")
    .replace("u.motor - p.k * x.x", "u.motor - p.k * x.x - 5.0 * x.v")
    .replace('"speed": "v"', "")
)


def motion(gain, seed):
    """Motion of the machine in two runs, shown by a sensor with a gain."""
    rng, records = np.random.default_rng(seed), []
    t = np.arange(400) * 5e-3
    for run in range(2):
        u = (3.0 + run) * (1.0 - np.cos((4.0 + 3.0 * run) * t))
        state, shown = np.zeros(2), []
        for k in range(t.size):
            shown.append(state[0])
            for i in range(20):
                force = np.interp(t[k] + i * 2.5e-4, t, u)
                rate = np.array([state[1], (force - 90.0 * state[0] - 5.0 * state[1]) / 2.0])
                half = state + 1.25e-4 * rate
                state = state + 2.5e-4 * np.array(
                    [half[1], (force - 90.0 * half[0] - 5.0 * half[1]) / 2.0])  # fmt: skip
        y = gain * np.array(shown) + 1e-4 * rng.standard_normal(t.size)
        records.append(Record(
            name=f"run {run}", time=t, inputs={"motor": u + 0.01 * rng.standard_normal(t.size)},
            outputs={"table": y}, sensors={"table": Sensor(name="table", unit="m", sigma=1e-4)},
            input_sigma={"motor": 0.01},
        ))  # fmt: skip
    return records


@pytest.mark.slow
def test_gain_of_a_sensor_and_of_the_input_are_not_told_apart(tmp_path):
    """In a linear machine both give the same record."""
    records = motion(1.12, 1)
    adapter = load(tmp_path, DOOR + EFFECTS).with_records(records)
    both = {"gain of sensor table", "gain of input motor"}
    effects = [e for e in adapter.effects if e.name in both]
    report = unmodeled.diagnose(adapter.model, effects, records, options=QUICK)
    assert report.verdict is unmodeled.Verdict.ONE_OF
    (group,) = report.classes
    assert {n.cause for n in group} >= both


def test_a_wrong_unit_of_a_single_record_is_refused(tmp_path):
    adapter = load(tmp_path, DOOR + EFFECTS)
    first = motion(1e3, 1)[0]
    wrong = replace(first, sensors={"table": Sensor(name="table", unit="m", sigma=0.1)})
    with pytest.raises(DataError, match="times the model in all records: is its unit"):
        unmodeled.diagnose(adapter.model, (), [wrong])


def test_outputs_that_only_the_records_or_only_the_model_have_are_told(tmp_path):
    model = load(tmp_path, MODEL + EFFECTS).model
    absent = "speed: not compared, because no record has this output"
    assert absent in unmodeled.check(model, record()).notes
    more = record(table=1e-2 * np.sin(0.06 * np.arange(100)), tabel=np.arange(100.0))
    told = "tabel: not compared, because the model has no such output; near are table"
    assert told in unmodeled.check(model, more).notes
    report = unmodeled.diagnose(model, (), more, options=QUICK)
    assert told in report.notes
    assert [c.name for c in report.channels] == ["table"]


def test_a_reversed_channel_is_not_called_late(tmp_path):
    model = load(tmp_path, MODEL + EFFECTS).model
    time = np.arange(400) * 0.005
    bare = Record(name="run", time=time, inputs={"motor": np.sin(9.0 * time)},
                  outputs={"table": time, "speed": time},
                  sensors={"table": Sensor(name="table", unit="m", sigma=1e-5),
                           "speed": Sensor(name="speed", unit="m/s", sigma=1e-4)})  # fmt: skip
    shown = unmodeled.check(model, bare).simulated["run"]
    (hint,) = unmodeled.check(model, replace(bare, outputs={n: -v for n, v in shown.items()})).hints
    assert (hint.kind, hint.channels) == ("sign", ("table", "speed"))


def test_where_an_input_has_no_number_is_told_by_its_time(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time [s],motor [N],table [m]\n0,1,0\n0.1,,0\n0.2,,0\n0.3,1,0\n")
    with pytest.raises(DataError, match=r"no number at 2 samples from 0\.1 s to 0\.2 s"):
        read_record(path, inputs=["motor"], outputs=["table"])


def with_cube(**limits):
    """The model of :func:`sum_of_two`, a cubic effect, and records of 0.3 of it."""
    model, records = sum_of_two(noise=0.01)
    cube = unmodeled.Effect(name="cube", component="drive", scale=0.1, sign=0, kind="force",
                      regressor=lambda r, shape: r.inputs["u"] ** 3, **limits)  # fmt: skip
    for i, r in enumerate(records):
        records[i] = Record(name=r.name, time=r.time, inputs=r.inputs, sensors=r.sensors,
                            outputs={"y": r.outputs["y"] + 0.3 * r.inputs["u"] ** 3})  # fmt: skip
    return model, cube, records


def test_an_effect_stays_within_its_limits():
    model, cube, records = with_cube(upper=0.2995)
    report = unmodeled.diagnose(model, [cube], records, options=QUICK)
    (named,) = report.named
    assert named.cause == "cube"
    assert named.magnitude == pytest.approx(0.2995)
    assert named.high <= 0.2995
    assert unmodeled.explained_model(model, [cube], report).effects == {
        "cube": pytest.approx(0.2995)
    }


def test_a_model_file_with_a_function_is_checked_on_the_command_line(tmp_path, capsys):
    (tmp_path / "model.py").write_text(MODEL + EFFECTS)
    (tmp_path / "run.csv").write_text(
        "time [s],motor [N],table [mm]\n" + "".join(f"{0.01 * i},1,{i}\n" for i in range(40))
    )
    with pytest.raises(SystemExit) as ended:
        command_line(["check", str(tmp_path / "model.py"), str(tmp_path / "run.csv")])
    assert ended.value.code in (0, None)
    assert "speed: not compared" in capsys.readouterr().out


def sum_of_two(noise):
    """A model of which only the sum of two parameters shows, and records of another sum."""
    model = unmodeled.LinearModel(
        name="sum",
        output="y",
        columns={"a": lambda r: r.inputs["u"], "b": lambda r: 1.01 * r.inputs["u"]},
        parameters=[
            unmodeled.Parameter(name="a", value=1.0, sd=0.3, label="the first"),
            unmodeled.Parameter(name="b", value=1.0, sd=0.3),
        ],
    )
    rng = np.random.default_rng(4)
    records = []
    for i in range(3):
        u = rng.standard_normal(200)
        y = 2.2 * u + noise * rng.standard_normal(200)
        records.append(
            Record(
                name=f"r{i}", time=np.arange(200) * 0.01, inputs={"u": u}, outputs={"y": y},
                sensors={"y": Sensor(name="y", sigma=noise)},
            )
        )  # fmt: skip
    return model, records


def test_parameters_that_moved_together_are_told():
    """Only the sum shows: neither parameter moves by itself."""
    model, records = sum_of_two(noise=0.01)
    report = unmodeled.diagnose(model, [], records, options=QUICK)
    assert report.correlation[0, 1] < -0.98
    assert sum(p.value for p in report.parameters) == pytest.approx(2.19, abs=0.02)
