"""Further sensors in a plan, against closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest

from feltmb.adapters.resolve import resolve
from feltmb.cli import main as feltmb_main
from feltmb.cli.gap_models import Adapter
from feltmb.cli.gap_plan import sensors_of
from feltmb.data import read_record, write_record
from feltmb.errors import DataError, InvalidParameter
from feltmb.gap import (
    Effect,
    FurtherSensor,
    InputLimits,
    Limits,
    Options,
    Record,
    Sensor,
    design,
    read_limits,
    session,
)
from feltmb.gap.designs import sensors_now
from feltmb.gap.further_sensors import Sensors, offered
from feltmb.gap.information import information, informations
from feltmb.gap.score import all_candidates

SAMPLES = 200
#: y = slope u + magnitude u^2, z = 0.5 slope u - 2 magnitude u^2; the file of a user.
CODE = """
import numpy as np
from feltmb.gap import Effect, FunctionModel, Parameter
model = FunctionModel(
    name="lever",
    outputs={
        "y": lambda r, p: p.slope * r.inputs["u"],
        "z": lambda r, p: 0.5 * p.slope * r.inputs["u"],
    },
    parameters=[Parameter(name="slope", value=1.0, sd=0.2)],
)
model.inputs = ("u",)
model.units = {"u": "N", "y": "m", "z": "m"}
effects = tuple(
    Effect(name=name, component="c", unit="m",
           regressor=lambda r, s, a=a: np.outer(r.inputs["u"] ** 2, [1.0, a]))
    for name, a in (("square", -2.0), ("lookalike", 1.0))
)
"""
_NAMES: dict = {}
exec(CODE, _NAMES)
MODEL = _NAMES["model"]


def both(a, b, power, name):
    """An effect that is seen by both outputs."""
    return Effect(
        name=name,
        component="c",
        unit="m",
        regressor=lambda r, s: np.outer(r.inputs["u"] ** power, [a, b]),
    )


SQUARE = both(1.0, -2.0, 2, "square")
LIMITS = Limits(
    inputs={"u": InputLimits(least=0.0, most=1.0, unit="N")},
    duration=1.0,
    sample_rate=float(SAMPLES),
    lead=0.0,
)
SENSORS = {"y": Sensor(name="y", unit="m", sigma=0.5)}
GIVEN = {"sensors": SENSORS, "refinements": 0, "families": ["step"], "candidates": 1}


def gain_of(u, sigmas):
    """1/2 log(1 + G): the slope is projected out, its prior counts."""
    s = np.concatenate(
        [share * u / sigmas[n] for n, share in (("y", 1.0), ("z", 0.5)) if n in sigmas]
    )
    e = np.concatenate([a * u**2 / sigmas[n] for n, a in (("y", 1.0), ("z", -2.0)) if n in sigmas])
    g = e @ e - (e @ s) ** 2 / (s @ s + 1.0 / 0.2**2)
    return 0.5 * np.log1p(g)


@pytest.mark.parametrize(
    ("offer", "then"),
    [
        (FurtherSensor(output="z", sigma=0.3, cost=0.5), {"y": 0.5, "z": 0.3}),
        (FurtherSensor(output="z", cost=0.5), {"y": 0.5, "z": 0.5}),
        (FurtherSensor(output="y", sigma=0.05, cost=0.5), {"y": 0.05}),
        (FurtherSensor(output="y", cost=0.5), {"y": 0.5 / 3.0}),
    ],
)
def test_gain_of_a_sensor_is_the_analytic_one(offer, then):
    """Of a second sensor and of a less noisy one, with their noise told or not."""
    found = design(
        MODEL, [SQUARE], limits=replace(LIMITS, further=(offer,)), budget=1.5, aim="sizes", **GIVEN
    )
    plain = design(MODEL, [SQUARE], limits=LIMITS, budget=1, aim="sizes", **GIVEN)
    u = plain.experiments[0].record.inputs["u"]
    (one,) = found.sensors
    assert one.before == pytest.approx(gain_of(u, {"y": 0.5}), rel=1e-6)
    assert one.after == pytest.approx(gain_of(u, then), rel=1e-6)
    assert one.gain_per_cost == pytest.approx((one.after - one.before) / 0.5)
    # It is worth half an experiment, and the stroke is made with it.
    sensor, stroke = found.experiments
    assert (sensor.kind, stroke.kind) == ("sensor", "record")
    assert one.planned
    assert found.after == pytest.approx(one.after, rel=1e-6)
    assert set(stroke.record.outputs) == set(then)
    assert stroke.record.sensors[offer.output].sigma == pytest.approx(then[offer.output])


def test_a_sensor_is_bought_only_where_the_same_budget_ends_better():
    """A little information is worth no experiment, and too dear is too dear."""
    dim = FurtherSensor(output="z", sigma=50.0, cost=2.0, how="old camera")
    keen = FurtherSensor(output="z", sigma=0.05, cost=2.0, how="camera")
    box = replace(LIMITS, further=(dim, keen))
    found = design(MODEL, [SQUARE], limits=box, budget=3, aim="sizes", **GIVEN)
    assert [e.kind for e in found.experiments] == ["sensor", "record"]
    assert found.experiments[0].sensor == keen
    best, worst = found.sensors
    assert (best.sensor, best.planned, worst.planned) == (keen, True, False)
    assert best.gain_per_cost > worst.gain_per_cost > 0.0
    assert worst.after_paid < worst.before < worst.after
    assert found.experiments[0].before == best.before < best.after_paid < best.after
    poor = design(MODEL, [SQUARE], limits=box, budget=2, aim="sizes", **GIVEN)
    assert [e.kind for e in poor.experiments] == ["record", "record"]
    assert poor.sensors[0].after > poor.after  # what it would tell is told still


def test_twins_of_one_sensor_are_separated_by_another():
    """No stroke of the present sensor tells them apart; the plan says which sensor does."""
    lookalike = both(1.0, 1.0, 2, "lookalike")
    alone = design(MODEL, [SQUARE, lookalike], limits=LIMITS, budget=3, **GIVEN)
    assert alone.inseparable == (("lookalike", "square"),)
    camera = FurtherSensor(output="z", sigma=0.05, cost=1.0, how="camera")
    found = design(
        MODEL, [SQUARE, lookalike], limits=replace(LIMITS, further=(camera,)), budget=3, **GIVEN
    )
    assert found.experiments[0].name == "camera: z, noise 50 mm"
    (reason,) = found.sensors[0].reasons
    assert reason == "separates square from lookalike: probability of confusion 50% -> 0%"
    assert found.inseparable == ()
    assert found.after > 0.95 > alone.after
    # Also where the budget does not pay for it.
    poor = design(
        MODEL, [SQUARE, lookalike], limits=replace(LIMITS, further=(camera,)), budget=1, **GIVEN
    )
    assert [e.kind for e in poor.experiments] == ["record"]
    assert poor.inseparable == ()


def test_two_sensors_are_bought_one_after_the_other():
    """The second is judged beside the first."""
    z = FurtherSensor(output="z", sigma=0.1, cost=0.5)
    y = FurtherSensor(output="y", sigma=0.1, cost=0.5)
    found = design(
        MODEL, [SQUARE], limits=replace(LIMITS, further=(y, z)), budget=2, aim="sizes", **GIVEN
    )
    kinds = [e.kind for e in found.experiments]
    assert kinds == ["sensor", "sensor", "record"]
    assert found.experiments[1].before == found.experiments[0].after
    u = found.experiments[2].record.inputs["u"]
    assert found.after == pytest.approx(gain_of(u, {"y": 0.1, "z": 0.1}), rel=1e-6)


def test_one_linearization_gives_each_way_to_measure():
    """What is read of a record with more sensors is what a record of fewer tells."""
    every = all_candidates([SQUARE])
    time = np.arange(SAMPLES) / SAMPLES
    colored = Sensor(
        name="y", unit="m", sigma=0.3, colored_sigma=0.2, correlation_time=0.02, offset_sd=0.1
    )
    now = Sensors({"y": colored, "z": SENSORS["y"]}, (FurtherSensor(output="y", sigma=0.1),))

    def told(sensors):
        u = np.sin(9.0 * time) ** 2
        outputs = {"y": u, "z": 0.5 * u}
        return Record(
            name="a", time=time, inputs={"u": u}, outputs={n: outputs[n] for n in sensors},
            sensors={n: replace(s, name=n) for n, s in sensors.items()},
        )  # fmt: skip

    one, fine, only = informations(MODEL, told(now.all), every, [*now.ways, {"z": 1.0}])
    for found, sensors in ((one, now.now), (fine, now.all), (only, {"z": now.now["z"]})):
        alone = information(MODEL, told(sensors), every)
        assert found.matrix == pytest.approx(alone.matrix, rel=1e-6)
        assert found.samples == alone.samples
    assert fine.matrix[1, 1] > 5.0 * one.matrix[1, 1] * (0.1 / 0.3) ** 2


@pytest.mark.parametrize(
    ("further", "sensors", "told"),
    [
        (FurtherSensor(output="x"), SENSORS, "further sensor x: no output of lever"),
        (FurtherSensor(output="y", sigma=0.5), SENSORS, "expected less than that of its present"),
        (
            FurtherSensor(output="z"),
            {"y": Sensor(name="y")},
            "z: its noise is not given; expected sigma",
        ),
        (
            FurtherSensor(output="y"),
            {"y": Sensor(name="y")},
            "y: is already measured by a sensor with unk",
        ),
    ],
)
def test_bad_sensors_are_refused(further, sensors, told):
    box = replace(LIMITS, further=(further,))
    with pytest.raises(InvalidParameter, match=told):
        design(MODEL, [SQUARE], limits=box, budget=2, **{**GIVEN, "sensors": sensors})


def test_all_bad_sensors_are_told_at_once():
    rows = (FurtherSensor(output="y", sigma=1.0), FurtherSensor(output="y", sigma=2.0))
    with pytest.raises(InvalidParameter, match=r"1 m, .*; y: sigma = 2 m"):
        offered(rows, SENSORS, MODEL)
    with pytest.raises(InvalidParameter, match="further sensor y: is stated twice"):
        replace(LIMITS, further=(rows[0], rows[0]))  # both were marked as planned
    for bad in ({"sigma": 0.0}, {"sigma": -1.0}, {"cost": 0.0}, {"sigma": np.inf}):
        with pytest.raises(InvalidParameter, match=next(iter(bad))):
            FurtherSensor(output="y", **bad)


FILE = """
schema = 1
duration = "1 s"
sample_rate = 200
lead = 0
[inputs.u]
most = "1 N"
[sensors.y]
sigma = "500 mm"
[[further_sensors]]
output = "z"
sigma = "300 mm"
cost = 0.5
how = "camera"
[[further_sensors]]
output = "y"
"""


def test_sensors_of_a_limits_file(tmp_path):
    path = tmp_path / "limits.toml"
    path.write_text(FILE)
    found = read_limits(path, MODEL)
    camera = FurtherSensor(output="z", sigma=0.3, cost=0.5, how="camera")
    assert found.further == (camera, FurtherSensor(output="y"))
    path.write_text(
        FILE.replace('output = "z"', 'output = "zz"').replace('output = "y"', 'output="y"\ncost=-1')
        .replace('"500 mm"', '"500 kg"')
    )  # fmt: skip
    with pytest.raises(DataError, match="3 faults") as failure:
        read_limits(path, MODEL)
    lines = [text.strip() for text in str(failure.value).splitlines()[1:]]
    starts = ("further sensor zz: no output", "further_sensors.1.cost: got -1", "sensors.y.sigma: ")
    assert [t.startswith(s) for t, s in zip(lines, starts, strict=True)] == [True] * 3


def test_sensors_of_an_action_cost_no_simulation_of_their_own():
    """A camera at the whippen and a force at the key, beside a camera at the key."""
    settings = {"effects": "coulomb_friction.butt,felt_hardening.06", "tolerances": "felt.0*"}
    settings |= {"variation": "none", "channels": "key,whippen,force"}
    model, effects = resolve("steinway45", settings)
    camera = FurtherSensor(output="whippen.y", cost=5.0)
    force = FurtherSensor(output="finger.force", sigma=0.01, cost=5.0)
    own = InputLimits(most=0.009, rate=1.0, unit="m")
    box = Limits(inputs={"displacement": own}, duration=0.15, further=(camera, force))
    given = {
        "sensors": {"key_front.y": Sensor(name="key_front.y", unit="m", sigma=2e-5)},
        "budget": 3, "refinements": 0, "candidates": 1, "families": ["pulse"],
    }  # fmt: skip
    found = design(model, effects, limits=box, **given)
    plain = design(model, effects, limits=replace(box, further=()), **given)
    assert found.worked_out == plain.worked_out == 1
    assert found.before == plain.before
    rows = {s.sensor.output: s for s in found.sensors}
    assert rows["whippen.y"].sensor.sigma == 2e-5  # that of the other camera
    assert rows["whippen.y"].name == "further sensor: whippen.y, noise 0.02 mm"
    # A key whose motion is given shows nothing; what another point and its force show, does.
    for row in rows.values():
        assert row.after > row.before + 0.1
        assert not row.planned  # beyond the budget
    assert found.reachable > plain.reachable + 0.1


class Lever:
    """Plays requests on a lever with the effect "square"; it gets a second sensor on request."""

    def __init__(self):
        self.asked = []
        self.sensors = dict(SENSORS)

    def __call__(self, request, answer):
        self.asked.append(request.name)
        if request.suffix == ".toml":
            assert 'output = "z"' in request.read_text()
            self.sensors["z"] = Sensor(name="z", unit="m", sigma=0.02)
            answer.write_text('[sensors.z]\nsigma = "20 mm"\n')
            return
        time, u = np.loadtxt(request, delimiter=",", skiprows=1).T
        clean = {"y": 1.05 * u + u**2, "z": 0.5 * 1.05 * u - 2.0 * u**2}
        generator = np.random.default_rng(len(self.asked))
        seen = {n: clean[n] + s.sigma * generator.standard_normal(u.size)
                for n, s in self.sensors.items()}  # fmt: skip
        made = Record(name="x", time=time, inputs={"u": u}, outputs=seen, sensors=self.sensors)
        write_record(made, answer, force=True)


def test_a_session_gets_a_sensor_and_measures_with_it(tmp_path):
    lever = Lever()
    lookalike = both(1.0, 1.0, 2, "lookalike")
    camera = FurtherSensor(output="z", sigma=0.05, how="camera")
    given = {
        "limits": replace(LIMITS, further=(camera,)), "sensors": SENSORS, "budget": 2,
        "options": Options(bootstrap=0, restarts=0, advice=False), "candidates": 1,
        "refinements": 0, "units": MODEL.units,
    }  # fmt: skip
    found = session(
        MODEL, [SQUARE, lookalike], lever, lambda p: [read_record(p)], tmp_path, **given
    )
    assert [s.kind for s in found.steps[:2]] == ["sensor", "record"]
    assert lever.asked[:2] == ["request.toml", "request.csv"]
    assert found.steps[-1].named == ("square",)
    # Nothing is asked again, and a present sensor is not offered.
    again = session(
        MODEL, [SQUARE, lookalike], pytest.fail, lambda p: [read_record(p)], tmp_path, **given
    )
    assert again.steps == found.steps
    assert json.loads((tmp_path / "2" / "plan.json").read_text())["sensors"] == []


def test_an_answer_about_another_sensor_is_refused(tmp_path):
    def heavy(_, answer):
        answer.write_text('[sensors.y]\nsigma = "20 kg"\n')

    def other(_, answer):
        answer.write_text("[sensors.y]\nsigma = 0.01\n")

    lookalike = both(1.0, 1.0, 2, "lookalike")
    box = replace(LIMITS, further=(FurtherSensor(output="z", sigma=0.05),))
    for k, (run, told) in enumerate(
        (
            (heavy, r"sensors\.y\.sigma: got .20 kg.; unit .kg."),
            (other, "got y, expected the sensor of z"),
        )
    ):
        with pytest.raises(DataError, match=told):
            session(
                MODEL, [SQUARE, lookalike], run, lambda p: [read_record(p)], tmp_path / str(k),
                limits=box, sensors=SENSORS, budget=4, candidates=1, refinements=0,
            )  # fmt: skip


@pytest.mark.parametrize(
    ("output", "sigma", "told"),
    [
        ("z", 30.0, "z: noise 30 m, the plan assumed 0.05 m"),
        ("y", 0.9, "y: noise 0.9 m, the plan assumed 0.05 m; the present sensor with 0.5 m is"),
    ],
)
def test_a_sensor_with_more_noise_than_assumed_is_not_asked_for_again(
    tmp_path, output, sigma, told
):
    """The same sensor was requested until the budget was used."""
    lever, asked = Lever(), []

    def run(request, answer):
        asked.append(request.name)
        if request.suffix == ".toml":
            lever.sensors[output] = Sensor(name=output, unit="m", sigma=sigma)
            answer.write_text(f"[sensors.{output}]\nsigma = {sigma}\n")
        else:
            lever(request, answer)

    box = replace(LIMITS, further=(FurtherSensor(output=output, sigma=0.05, cost=0.5),))
    found = session(
        MODEL, [SQUARE, both(1.0, 1.0, 2, "lookalike")], run, lambda p: [read_record(p)], tmp_path,
        limits=box, sensors=SENSORS, budget=2, candidates=1, refinements=0, units=MODEL.units,
        options=Options(bootstrap=0, restarts=0, advice=False),
    )  # fmt: skip
    assert asked.count("request.toml") == 1
    assert [s.kind for s in found.steps][:2] == ["sensor", "record"]
    assert found.steps[0].warnings[0].startswith(told)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("further_sensors = 3", "further_sensors: got 3, expected a list"),
        ("further_sensors = [3]", "further_sensors.0: got 3, expected a table"),
        ("[further_sensors]\noutput = 'y'", "hint: [[further_sensors]] in place of [further_"),
        (
            "[[further_sensors]]\noutput = 'y'\nsigma = nan",
            "1 fault\n  further_sensors.0.sigma: got nan, expected a finite number or a text",
        ),
        ("[[further_sensors]]\noutput = 'y'\nsigma = ''", "further_sensors.0.sigma: got ''"),
    ],
)
def test_a_wrong_kind_of_table_is_told_in_words_of_toml(tmp_path, wrong, told):
    """The message spoke of dictionaries and of a class."""
    path = tmp_path / "limits.toml"
    text = FILE[: FILE.index("[[further")]
    path.write_text(wrong + "\n" + text if wrong.startswith("f") else text + wrong)
    with pytest.raises(DataError) as failure:
        read_limits(path, MODEL)
    assert told in str(failure.value)


def test_given_sensors_are_all_that_is_measured():
    """Outputs of old records, and those of the limits, were planned in addition."""
    time = np.arange(20) * 0.01
    seen = {n: Sensor(name=n, unit="m", sigma=0.1) for n in ("y", "z")}
    record = Record(name="a", time=time, inputs={"u": time}, outputs=dict.fromkeys("yz", time),
                    sensors=seen)  # fmt: skip
    box = replace(LIMITS, sensors={"z": 0.2})
    assert sensors_now(MODEL, LIMITS, [record], SENSORS) == SENSORS
    assert sensors_now(MODEL, box, [record], SENSORS) == SENSORS
    assert {n: s.sigma for n, s in sensors_now(MODEL, box, [record], None).items()} == {"z": 0.2}
    assert sensors_now(MODEL, LIMITS, [record], None) == seen


def test_channels_of_the_command_may_be_new_ones():
    """A channel that no record has was dropped without a word."""
    time = np.arange(20) * 0.01
    planned = Record(name="p", time=time, inputs={"u": time},
                     outputs=dict.fromkeys("yz", time), sensors={
                         n: Sensor(name=n, unit="m", sigma=0.1) for n in ("y", "z")})  # fmt: skip
    adapter = Adapter(model=MODEL, effects=(SQUARE,), planned=(planned,))
    old = replace(planned, name="a", outputs={"y": time},
                  sensors={"y": Sensor(name="y", unit="m", sigma=0.3)})  # fmt: skip
    for wanted, sigmas in (((), {"y": 0.3}), (("z",), {"z": 0.1}), (("y",), {"y": 0.3})):
        found = sensors_of(adapter, LIMITS, [old], wanted)
        assert {n: s.sigma for n, s in found.items()} == sigmas


def test_command_shows_sensors_in_words_and_numbers(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")  # no cell is folded
    (tmp_path / "lever.py").write_text(CODE)
    (tmp_path / "limits.toml").write_text(FILE)
    words = ["gap", "plan", str(tmp_path / "lever.py"), "--limits", str(tmp_path / "limits.toml")]
    words += ["--budget", "2", "--refine", "0", "--candidates", "1", "--family", "step"]
    with pytest.raises(SystemExit, match="0"):
        feltmb_main([*words, "-o", str(tmp_path / "plan")])
    text = " ".join(capsys.readouterr().out.split())
    assert "further sensors" in text
    assert "camera: z, noise 300 mm" in text
    assert "less noisy sensor: y, noise 167 mm in place of 500 mm" in text
    assert "all experiments after it are made with it" in text
    assert 'output = "z"' in (tmp_path / "plan" / "1.toml").read_text()
    with pytest.raises(SystemExit, match="0"):
        feltmb_main([*words, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["experiments"][0]["kind"] == "sensor"
    assert found["experiments"][0]["sensor"]["output"] == "z"
    first = found["sensors"][0]
    assert first["sensor"]["sigma"] == pytest.approx(0.3)
    assert first["gain_per_cost"] == pytest.approx(2.0 * (first["after"] - first["before"]))
    assert first["planned"] is True
