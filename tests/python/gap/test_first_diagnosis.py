"""What a first user meets: his model file, faults of his data, and the words of the answer."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import fit_problem
from feltmb.fit.watch import CHECKS, FIT, Watch
from feltmb.gap.checks import not_compared
from feltmb.gap.information import linearized, planned
from feltmb.gap.judged_data import ready
from feltmb.gap.sizes import Size
from feltmb.gap.smoke_test import divergence

from feltmb import gap
from feltmb.cli import main as command_line
from feltmb.cli.gap_models import load_adapter
from feltmb.data import Record, Sensor, read_record
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit.model import Candidate
from feltmb.gap import library

MODEL = """
from feltmb.gap import Coordinate, OdeModel, Parameter, State, library

table = Coordinate(name="table", position="x", speed="v", inertia="m")
model = OdeModel(
    name="table",
    states=[State(name="x", unit="m", start_sd=1e-4), State(name="v", unit="m/s", start_sd=1e-3)],
    parameters=[Parameter(name="m", value=2.0, sd=0.1, unit="kg"),
                Parameter(name="k", value=90.0, sd=3.0, unit="N/m")],
    inputs=["motor"],
    rates=lambda t, x, u, p: (x.v, (u.motor - p.k * x.x) / p.m),
    outputs={"table": "x", "speed": "v"},
    coordinates=[table],
)
"""
EFFECTS = """
def effects(records):
    return library.standard_effects(
        model.outputs, {"motor": "N"}, [table], records[0], force=4.0, travel=0.04, speed=0.3
    )
"""


def load(folder, text):
    path = folder / "model.py"
    path.write_text(text)
    return load_adapter(str(path))


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
    with pytest.raises(InvalidParameter, match="give measured files, or define limits or planned"):
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


@pytest.mark.parametrize("missing", [0, 90])
def test_evidence_does_not_depend_on_the_unit_of_a_state(missing):
    """States with a flat prior in m and in mm, also if the first segments have no value."""
    record = motion(1.0, 1)[0]
    shown = record.outputs["table"].copy()
    shown[:missing] = np.nan
    record = replace(record, outputs={"table": shown})

    def fitted(per_meter):
        model = gap.OdeModel(
            name="table",
            states=[gap.State(name="x", scale=0.1 * per_meter),
                    gap.State(name="v", scale=per_meter)],
            parameters=[gap.Parameter(name="k", value=90.0, sd=1.0)],
            inputs=["motor"], outputs={"table": lambda t, x, u, p: x.x / per_meter},
            rates=lambda t, x, u, p: (
                x.v, (per_meter * u.motor - p.k * x.x - 5.0 * x.v) / 2.0
            ),
        )  # fmt: skip
        segmented = segment_record(model, record, {"table": Noise(1e-4)}, 0.2)
        return fit_problem(Problem(model, (segmented,)))

    meters, millimeters = fitted(1.0), fitted(1e3)
    assert meters.cost == pytest.approx(millimeters.cost, abs=0.01)
    assert meters.log_evidence == pytest.approx(millimeters.log_evidence, abs=0.02)


def test_a_planned_record_at_other_parameters_has_continuous_states(tmp_path):
    """The signatures of two equal gains are equal, also far from the tabulated parameters."""
    records = motion(1.0, 1)
    adapter = load(tmp_path, DOOR + EFFECTS).with_records(records)
    both = {"gain of sensor table", "gain of input motor"}
    pair = tuple(Candidate(e) for e in adapter.effects if e.name in both)
    theta = np.array([2.0, 75.0])
    plan = planned(adapter.model, records[0], records[0].sensors, theta)
    (found,) = linearized(adapter.model, plan, pair, [{"table": 1.0}], theta=theta)
    sizes = np.sqrt(np.diag(found.matrix)[-2:])
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-3)


@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.slow) for s in (2, 3))])
def test_gain_of_a_sensor_and_of_the_input_are_not_told_apart(tmp_path, seed):
    """In a linear machine both give the same record. Unknown starts of blocks favored one."""
    records = motion(1.12, seed)
    adapter = load(tmp_path, DOOR + EFFECTS).with_records(records)
    both = {"gain of sensor table", "gain of input motor"}
    effects = [e for e in adapter.effects if e.name in both]
    report = gap.diagnose(adapter.model, effects, records, options=gap.Options(bootstrap=0))
    assert set(report.one_of) == both
    # No other input separates them, although the parameters were wrong.
    assert min(a.confusion_then for a in report.next if len(a.separates) == 2) > 0.4
    first, second = (s.evidence for s in report.which.sets[:2])
    assert first - second < 1.0


def test_a_wrong_unit_of_a_single_record_is_refused(tmp_path):
    """The record is cut into blocks, of which only the first has a known start."""
    adapter = load(tmp_path, DOOR + EFFECTS)
    first = motion(1e3, 1)[0]
    wrong = replace(first, sensors={"table": Sensor(name="table", unit="m", sigma=0.1)})
    with pytest.raises(DataError, match="times the model in all records"):
        gap.diagnose(adapter.model, (), [wrong])


def test_noise_of_an_input_that_is_not_given_is_told(tmp_path):
    adapter = load(tmp_path, DOOR + EFFECTS)
    records = motion(1.0, 1)
    silent = [replace(r, input_sigma={}) for r in records]

    def warnings(given):
        checks = ready(adapter.model, given)[2]
        return [w for w in checks.warnings if "motor is taken as exact" in w]

    (told,) = warnings(silent)
    assert "scatter by 0.01" in told or "scatter by 0.0099" in told
    assert not warnings(records)
    smooth = np.sin(9.0 * records[0].time)
    drawn = np.random.default_rng(1).standard_normal(smooth.size)
    sweep = np.sin(200.0 * records[0].time ** 2)
    for value in (smooth, drawn, sweep, np.round(smooth, 2)):  # exact, random itself, rounded
        assert not warnings([replace(r, inputs={"motor": value}) for r in silent])


def test_a_plan_before_any_data_makes_effects_from_the_limits(tmp_path, capsys):
    (tmp_path / "model.py").write_text(MODEL + EFFECTS)
    limits = tmp_path / "limits.toml"
    limits.write_text(
        'schema = 1\nduration = "1 s"\nsample_rate = "100 Hz"\n'
        '[inputs.motor]\nunit = "N"\nmost = "5 N"\n[sensors.table]\nsigma = "0.1 mm"\n'
    )
    plan = ["gap", "plan", str(tmp_path / "model.py"), "--limits", str(limits), "--budget", "1",
            "--candidates", "2", "--refine", "0"]  # fmt: skip
    effects = load_adapter(str(tmp_path / "model.py")).with_records((), limits).effects
    offset = next(e for e in effects if e.name == "offset of sensor table")
    assert 1e-4 < offset.scale < 0.02  # the table moves by 5 N / (90 N/m)
    with pytest.raises(SystemExit) as end:
        command_line(plan)
    assert end.value.code == 0
    assert " of motor: " in capsys.readouterr().out
    report = tmp_path / "report.json"
    report.write_text('{"model": "another"}')
    with pytest.raises(SystemExit):
        command_line([*plan, "--report", str(report)])
    assert "is of the model 'another', expected one of 'table'" in capsys.readouterr().err


def test_outputs_that_no_record_has_are_told(tmp_path):
    model = load(tmp_path, MODEL + EFFECTS).model
    told = "speed: not compared, because no record has this output of the model"
    assert not_compared(model, [record()]) == (told,)
    assert told in gap.check(model, record()).notes
    whole = record(table=np.zeros(100), speed=np.zeros(100))
    fast = {n: Sensor(name=n, unit=u) for n, u in (("table", "m"), ("speed", "m/s"))}
    whole = Record(name="run", time=whole.time, inputs=whole.inputs, outputs=whole.outputs,
                   sensors=fast)  # fmt: skip
    assert not_compared(model, [whole]) == ()


def test_an_output_that_the_model_does_not_have_is_told_and_not_used(tmp_path):
    """A diagnosis ended in a KeyError when its pictures were drawn."""
    from feltmb.cli.gap_curves import record_viewers

    model = load(tmp_path, MODEL + EFFECTS).model
    more = record(table=1e-2 * np.sin(0.06 * np.arange(100)), tabel=np.zeros(100))
    told = "tabel: not compared, because the model has no such output; near are table"
    assert told in not_compared(model, [more])
    assert told in gap.check(model, more).notes
    report = gap.diagnose(model, (), more, options=gap.Options(bootstrap=0))
    assert told in report.checks.warnings
    assert "table" in record_viewers(report, [more])


def test_a_clock_in_another_unit_is_told(tmp_path):
    """Milliseconds labeled as seconds made the first effect look faulty."""
    adapter = load(tmp_path, MODEL + EFFECTS)
    wrong = record(time=np.arange(100) * 10.0)
    with pytest.raises(InvalidParameter, match=r"10 s apart: is this their unit \(--unit time=ms"):
        gap.diagnose(adapter.model, adapter.with_records([wrong]).effects, [wrong])
    assert any("10 s apart" in n for n in gap.check(adapter.model, wrong).notes)
    outputs = np.array([[math.inf], [1.0], [9.9e6]])  # the record stays below 0.01
    assert divergence(record(), ["table"], outputs) == ""
    assert "after 2 samples" in divergence(record(), ["table"], 2.0 * outputs)
    still = record(table=np.zeros(100))
    assert divergence(still, ["table"], outputs) == ""


def test_a_reversed_channel_is_not_called_late(tmp_path):
    model = load(tmp_path, MODEL + EFFECTS).model
    time = np.arange(400) * 0.005
    bare = Record(name="run", time=time, inputs={"motor": np.sin(9.0 * time)},
                  outputs={"table": np.zeros(400), "speed": np.zeros(400)},
                  sensors={"table": Sensor(name="table", unit="m", sigma=1e-5),
                           "speed": Sensor(name="speed", unit="m/s", sigma=1e-4)})  # fmt: skip
    shown = gap.check(model, bare).simulated["run"]
    reversed_ = Record(name="run", time=time, inputs=bare.inputs, sensors=bare.sensors,
                       outputs={n: -v for n, v in shown.items()})  # fmt: skip
    notes = gap.check(model, reversed_).notes
    assert sum("the other direction?" in n for n in notes) == 2
    assert not any("late" in n for n in notes)


def test_where_an_input_has_no_number_is_told_by_its_time(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time [s],motor [N],table [m]\n0,1,0\n0.1,,0\n0.2,,0\n0.3,1,0\n")
    with pytest.raises(DataError, match=r"no number at 2 samples from 0\.1 s to 0\.2 s"):
        read_record(path, inputs=["motor"], outputs=["table"])


def test_a_statement_gives_the_fitted_numbers_of_a_shape():
    wheel = gap.Coordinate(name="wheel", position="q", speed="v", inertia="J", unit="N m")
    effect = library.backlash(wheel, stiffness=40.0, travel=0.1)
    assert (effect.unit, effect.scale) == ("N m/rad", pytest.approx(12.0))
    size = Size(Candidate(effect, 0.0069), 38.0, 1.0, {0: 0.01})
    assert size.text == (
        "dead zone wheel of 38 N m/rad (95% from 36 to 40 N m/rad; half width 0.0069 rad)"
    )
    assert "width" not in Size(Candidate(effect, 0.0069), 38.0, 1.0, {}).text


def test_fits_and_proof_have_their_parts_of_a_budget(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(Watch, "elapsed", property(lambda self: now[0]))
    watch = Watch(budget=10.0)
    watch.enter("search")
    now[0] = 5.9
    assert not watch.over()
    watch.enter("proof on held-out records")
    for time, over in ((6.5, False), (9.8, False), (9.95, True)):
        now[0] = time
        assert watch.proof_over() == over
    assert watch.why == "the budget of 10 s was spent"
    late = Watch(budget=10.0)
    late.enter("search")
    now[0] = 14.0  # a fit that had started
    assert late.over()
    assert "60% of the budget" in late.why
    late.enter("proof on held-out records")
    now[0] = 17.9
    assert not late.proof_over()
    # The fit of the model alone leaves half of that to the search.
    first = Watch(budget=10.0)
    now[0] = 1.0
    first.enter(FIT)
    for time, ends in ((3.9, False), (4.1, True)):
        now[0] = time
        assert first.stopping() == ends
    assert first.model_cut == pytest.approx(3.1)
    first.enter("search")
    assert not first.stopping()
    assert first.why == ""
    now[0] = 14.0
    alone = Watch(budget=10.0, stages=(CHECKS, FIT))  # no proof follows
    alone.enter(FIT)
    now[0] = 9.9
    assert not alone.over()
    now[0] = 10.1
    assert alone.over()
    pressed = [False]
    interrupted = Watch(stop=lambda: pressed[0], budget=10.0)
    interrupted.enter("search")
    now[0] += 6.5  # the fits end by their time limit
    assert interrupted.over()
    interrupted.enter("proof on held-out records")
    assert not interrupted.proof_over()
    pressed[0] = True
    assert not interrupted.proof_over()
    now[0] += 5.5  # the proof has 5 s after an interruption
    assert interrupted.proof_over()
    interrupted = Watch(stop=lambda: pressed[0])
    pressed[0] = False
    interrupted.enter("proof on held-out records")
    pressed[0] = True
    assert not interrupted.proof_over()
    assert interrupted.stopped_in == "proof on held-out records"
    earlier = Watch(stop=lambda: True)
    earlier.enter("search")
    assert earlier.over()
    earlier.enter("proof on held-out records")
    assert not earlier.proof_over()  # it judges what the search found


def with_cube(**limits):
    """The model of :func:`sum_of_two`, a cubic effect, and records of 0.3 of it."""
    model, records = sum_of_two(noise=0.01)
    cube = gap.Effect(name="cube", component="drive", scale=0.1, sign=0, kind="force",
                      regressor=lambda r, shape: r.inputs["u"] ** 3, **limits)  # fmt: skip
    for i, r in enumerate(records):
        records[i] = Record(name=r.name, time=r.time, inputs=r.inputs, sensors=r.sensors,
                            outputs={"y": r.outputs["y"] + 0.3 * r.inputs["u"] ** 3})  # fmt: skip
    return model, cube, records


def test_an_effect_at_its_limit_is_told():
    model, cube, records = with_cube(upper=0.2995)
    report = gap.diagnose(model, [cube], records, options=gap.Options(advice=False, bootstrap=0))
    assert report.model.effects == {"cube": pytest.approx(0.2995)}
    assert "At a limit of its range: cube" in report.text(80)


def test_a_proof_without_time_names_nothing(monkeypatch):
    model, cube, records = with_cube()
    quick = gap.Options(advice=False, bootstrap=0)
    assert gap.diagnose(model, [cube], records, options=quick).named == ("cube",)
    late = Watch.proof_over

    def over(self):
        if self.stage == "proof on held-out records":
            self._end("the budget of 1 s was spent")
            return True
        return late(self)

    monkeypatch.setattr(Watch, "proof_over", over)
    report = gap.diagnose(model, [cube], records, options=quick)
    assert report.named == report.one_of == ()
    assert report.verdict == "NOT COMPLETE"
    assert (
        "Stopped in the proof on held-out records (the budget of 1 s was spent): the proof on "
        "held-out records is not complete, so nothing is named."
    ) in report.statement
    assert re.search(r"times the sum of squares of noise\. cube of ", report.statement)


def test_a_model_file_with_a_function_is_checked_on_the_command_line(tmp_path, capsys):
    (tmp_path / "model.py").write_text(MODEL + EFFECTS)
    (tmp_path / "run.csv").write_text(
        "time [s],motor [N],table [mm]\n" + "".join(f"{0.01 * i},1,{i}\n" for i in range(40))
    )
    with pytest.raises(SystemExit) as ended:
        command_line(["gap", "check", str(tmp_path / "model.py"), str(tmp_path / "run.csv")])
    assert ended.value.code in (0, None)
    assert "speed: not compared" in capsys.readouterr().out


def sum_of_two(noise):
    """A model of which only the sum of two parameters shows, and records of another sum."""
    model = gap.LinearModel(
        name="sum",
        output="y",
        columns={"a": lambda r: r.inputs["u"], "b": lambda r: 1.01 * r.inputs["u"]},
        parameters=[
            gap.Parameter(name="a", value=1.0, sd=0.3, label="the first"),
            gap.Parameter(name="b", value=1.0, sd=0.3),
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
    told = "The records hardly separate b and the first (-1.00)"
    model, records = sum_of_two(noise=0.01)
    report = gap.diagnose(model, [], records, options=gap.Options(advice=False))
    assert told in " ".join(report.text(80).split())
    model, records = sum_of_two(noise=1.0)  # calibration explains next to nothing
    report = gap.diagnose(model, [], records, options=gap.Options(advice=False))
    assert told not in " ".join(report.text(80).split())
