"""From a model and records to a cause: short forms, defaults, and messages of bad input."""

import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import feltmb
import unmodeled
from unmodeled import Options, candidates
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit import Coordinate, Jobs, Parameter
from unmodeled.models import writing
from unmodeled.models.matching import matched

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "howto" / "first_answer.md").read_text(encoding="utf-8")
BLOCKS = [b for b in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "diagnose(" in b]
TIME = np.arange(200) * 0.01


def wave(size=1.0, seed=1):
    random = np.random.default_rng(seed)
    rates, phases = random.uniform(2.0, 15.0, 4), random.uniform(0.0, 6.0, 4)
    return size * np.sin(np.outer(TIME, rates) + phases).sum(axis=1)


def lag(time, inputs, parameters):
    """A first-order lag, exact for a held input, with a dead zone of its input."""
    u = inputs["force"]
    u = np.sign(u) * np.maximum(np.abs(u) - parameters["gap"], 0.0)
    x = [0.0]
    for h, f in zip(np.diff(time), u[:-1], strict=True):
        decay = np.exp(-h / parameters["tau"])
        x.append(decay * x[-1] + (1.0 - decay) * f)
    return {"x": x, "x2": np.array(x) ** 2}


def frame(size=1.0, seed=1, gap=0.0, run=0):
    force = wave(size, seed)
    x = np.array(lag(TIME, {"force": force}, {"tau": 0.2, "gap": gap})["x"])
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(TIME.size)
    return pd.DataFrame({"run": run, "time": TIME, "force": force, "x": x + noise})


def simulator(**fields):
    fields = {"parameters": {"tau": (0.22, 0.05, "s")}, "unknown": {"gap": "N"}, **fields}
    return unmodeled.Simulator(lag, **fields)


def records():
    table = pd.concat([frame(1.0 + k, k, 0.3, run=k) for k in range(3)])
    return unmodeled.records_from_frame(table, by="run", inputs=["force"], sigma={"x": 1e-3})


# ---------------------------------------------------------------- the page


@pytest.mark.parametrize("block", BLOCKS)
def test_a_first_answer_has_at_most_ten_lines_and_three_names(block):
    lines = [s for s in block.splitlines() if s.strip() and not re.match(r"import|from", s)]
    assert len(lines) <= 10
    assert len(set(re.findall(r"feltmb\.(\w+)", block))) <= 3


def residuals(record, seen):
    return {n: float(np.sqrt(np.mean((seen[n] - record.outputs[n]) ** 2))) for n in record.outputs}


def numbers(remedy, kind="parameters"):
    return {} if remedy is None else tomllib.loads(remedy.read_text(encoding="utf-8"))[kind]


def cart_again(remedy):
    from cart import cart  # the file of the example

    frame = pd.read_csv("cart.csv")
    record = unmodeled.records_from_frame(frame, by="run", inputs=["force"])[-1]
    values = {"mass": 2.0, "damping": 0.3, "dry_friction": 0.0, **numbers(remedy)}
    return residuals(record, cart(record.time, record.inputs, values))


def table_again(remedy):
    (record,) = unmodeled.read("table_2.csv", inputs=["motor"])
    p = {"m": 2.0, "k": 90.0, "d": 3.0, **numbers(remedy)}
    cubic = numbers(remedy, "effects").get("cubic stiffness x", 0.0)
    x, v, seen, step = 0.0, 0.0, [], record.interval / 100
    for force in record.inputs["motor"]:  # held until the next sample
        seen.append(x)
        for _ in range(100):
            x += 0.5 * step * v
            v += step * (force - p["k"] * x - cubic * x**3 - p["d"] * v) / p["m"]
            x += 0.5 * step * v
    return residuals(record, {"x": np.array(seen)})


def fmu_again(remedy):
    """FMPy holds the input during a step: the steps are short."""
    import fmpy

    (record,) = unmodeled.read("swing_1.csv", inputs=["force"])
    names = [("time", float), ("force", float)]
    seen = fmpy.simulate_fmu(
        "pendulum.fmu",
        start_values=numbers(remedy),
        input=np.array([*zip(record.time, record.inputs["force"], strict=True)], names),
        output=["arm.angle"],
        stop_time=record.time[-1],
        output_interval=record.interval / 200,
    )
    return residuals(record, {"arm.angle": np.interp(record.time, seen["time"], seen["arm.angle"])})


def servo_again(remedy):
    import mujoco

    (record,) = unmodeled.read("servo_0.csv", inputs=["servo"])
    model = mujoco.MjModel.from_xml_path(str(remedy or "servo.xml"))
    data, seen = mujoco.MjData(model), []
    for data.ctrl[0] in record.inputs["servo"]:
        seen.append(data.qpos.sum())  # with the joint of the backlash
        mujoco.mj_step(model, data, round(record.interval / model.opt.timestep))
    return residuals(record, {"shoulder": np.array(seen)})


def action_again(remedy):
    (record,) = unmodeled.read("strokes/fast.csv", inputs=["force"])
    stroke = feltmb.table_stroke(record.time, record.inputs["force"], name="fast")
    run = feltmb.simulate(feltmb.load_action(remedy or "steinway45"), stroke, output_rate=2000.0)
    moved = {n: np.interp(record.time, run.time, run[n] - run[n][0]) for n in record.outputs}
    return residuals(record, moved)


ORIGINAL = {
    "records_from_frame": cart_again,
    "Equations": table_again,
    "unmodeled.fmu": fmu_again,
    "unmodeled.mujoco": servo_again,
    "load_action": action_again,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "wanted", "causes"),
    [
        ("pandas", "records_from_frame", {"dry_friction"}),
        ("pandas", "Equations", {"cubic stiffness x"}),
        ("fmpy", "unmodeled.fmu", {"bodies.arm.friction.amplitude"}),
        ("mujoco", "unmodeled.mujoco", {"shoulder.frictionloss", "shoulder.backlash"}),
        ("pandas", "load_action", {"compliance.shank", "shank_compliance"}),  # one of these
    ],
)
def test_a_first_answer_names_what_was_withheld_and_its_remedy_closes_the_gap(
    package, wanted, causes, tmp_path, monkeypatch
):
    pytest.importorskip(package)
    (block,) = [b for b in BLOCKS if wanted in b]
    for file in (ROOT / "examples" / "first_answer").iterdir():
        shutil.copy(file, tmp_path)
    shutil.copytree(ROOT / "examples" / "gap_action" / "small", tmp_path / "strokes")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    import measure  # the file of the example

    for name, machine in (("cart", "cart"), ("table", "Equations"), ("pendulum", "unmodeled.fmu"),
                          ("servo", "unmodeled.mujoco")):  # fmt: skip
        if machine in wanted or (name == "cart" and "frame" in wanted):
            getattr(measure, f"write_{name}")()
    found = {}
    exec(compile(block, wanted, "exec"), found)
    report = found["report"]
    told = (*report.named, *(n for group in report.classes for n in group))
    assert {n.cause for n in told} == causes
    remedy = report.model.write(tmp_path / ("fixed.xml" if package == "mujoco" else "found.toml"))
    before, after = (ORIGINAL[wanted](path) for path in (None, remedy))
    for channel in report.channels:
        assert after[channel.name] == pytest.approx(channel.held_out_explained, rel=0.02)
        assert after[channel.name] < 0.2 * before[channel.name]


# ---------------------------------------------------------------- a function


def test_channels_sizes_and_candidates_come_from_function_and_records():
    ready = matched(simulator(), records())
    assert ready.model.inputs == ("force",)
    assert ready.model.outputs == ("x",)  # x2 was not measured
    named = {e.name: e for e in candidates(simulator(), records())}
    assert 0.1 < named["gap"].scale < 1.0
    assert named["gap"].sign == 0
    assert {"delay of input force", "delay of sensor x"} <= set(named)


def test_an_effect_that_fails_below_zero_has_a_sign():
    def function(time, inputs, parameters):
        if parameters["loss"] < 0.0:
            raise ValueError("negative")
        return {"x": inputs["force"] - parameters["loss"] * np.tanh(inputs["force"])}

    model = unmodeled.Simulator(function, unknown={"loss": "N"})
    (effect,) = model.ready(records()).model.effects
    assert effect.sign == 1
    assert effect.bounds == (0.0, np.inf)


def test_the_diagnosis_of_a_function_names_its_unknown_parameter():
    report = simulator().diagnose(
        records(), options=Options(max_effects=1), exclude=["input force"]
    )
    (named,) = report.named
    assert named.cause == "gap"
    assert abs(named.magnitude) == pytest.approx(0.3, rel=0.02)
    assert report.model.parameters["tau"] == pytest.approx(0.2, rel=0.02)
    row = report.frame.loc["gap"]
    assert (row["kind"], row["tier"], row["unit"]) == ("change", "named", "N")
    assert not any("of input force" in name for name in report.frame.index)
    for kind in ("waterfall", "residual", "correlation"):
        assert report.plot(kind).axes
    fit = simulator().fit(records())
    assert list(fit.frame[fit.frame["kind"] == "parameter"].index) == ["tau"]
    assert fit.worst.explained > 10.0 * report.worst.explained


def test_priors_in_short_form():
    model = simulator(
        parameters={"tau": (0.2, 0.1, "s"), "a": (1, 0), "b": 2.0},
        bounds={"tau": (0.1, 0.3), "gap": (0.0, 1.0)},
    )
    tau, a, b = model.parameters
    assert tau == Parameter(name="tau", value=0.2, sd=0.1, unit="s", lower=0.1, upper=0.3)
    assert a.sd == 0.0
    assert np.isinf(b.sd)
    assert model.effects[0].bounds == (0.0, 1.0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"parameters": {"tau": "fast"}}, r"parameter tau: got 'fast', expected \(value, standard"),
        ({"parameters": {"tau": (1.0, "s")}}, r"parameter tau: got .* expected \(value"),
        ({"unknown": {"gap": 0.3}}, r"unknown gap: got 0.3, expected its unit"),
        ({"bounds": {"gap": (1.0, 2.0)}}, "bounds of gap: they do not hold 0"),
        ({"bounds": {"tua": (0.0, 2.0)}}, "bounds of tua, which is no parameter.*tau"),
        ({"bounds": {"tau": 3.0}}, r"bounds of tau: got 3.0, expected \(lowest, highest\)"),
    ],
)
def test_a_wrong_short_form_is_told(fields, message):
    with pytest.raises(InvalidParameter, match=message):
        simulator(**fields)


def test_channels_that_do_not_meet_are_told():
    def other(time, inputs, parameters):
        return {"angle": inputs["force"]}

    with pytest.raises(InvalidParameter, match="returns angle, and the records show x"):
        unmodeled.Simulator(other).diagnose(records())

    def misspelled(time, inputs, parameters):
        return {"x": inputs["forse"]}

    with pytest.raises(InvalidParameter, match=r"forse.*force.*--column forse=COLUMN"):
        unmodeled.Simulator(misspelled).diagnose(records())

    def copying(time, inputs, parameters):
        return {"x": inputs["x"]}

    with pytest.raises(InvalidParameter, match="a measured output must not be used"):
        unmodeled.Simulator(copying).diagnose(records())


def test_effects_are_chosen_by_name_pattern_and_component():
    model, some = simulator(), records()
    with pytest.raises(InvalidParameter, match=r"exclude: got 'gapp'.*gap"):
        model.diagnose(some, exclude="gapp")
    report = model.diagnose(some, effects=["gap", "delay*"], options=Options(max_effects=1))
    (note,) = [n for n in report.notes if n.startswith("effects tested")]
    assert note.startswith("effects tested: 3 (1 of gap, 1 of input force, 1 of sensor x)")


# ---------------------------------------------------------------- equations


def rates(t, x, u, p):
    return x.v, (u.motor - p.k * x.x - p.d * x.v) / p.m


PRIORS = {"m": (2.0, 0.1, "kg"), "k": (90.0, 3.0, "N/m"), "d": (3.0, 0.5, "N s/m")}


@pytest.mark.parametrize("unit", [{}, {"inputs": {"motor": "N"}}])
def test_a_column_that_is_an_input_of_equations_is_one_in_the_model_of_the_report(tmp_path, unit):
    """The diagnosed records were refused; a record without the input was a KeyError."""
    path, drive = tmp_path / "a.csv", wave()
    table = pd.DataFrame({"time [s]": TIME, "motor [N]": drive, "x [m]": 0.01 * drive})
    table.to_csv(path, index=False)
    model = unmodeled.Equations(rates, states={"x": "m", "v": "m/s"}, parameters=PRIORS, **unit)
    (record,) = unmodeled.read(str(path))
    found = model.fit([record]).model.simulate(record)["x"]
    assert found.shape == TIME.shape
    assert np.std(found) > 0.0
    table.rename(columns={"motor [N]": "f [N]"}).to_csv(path, index=False)
    with pytest.raises(InvalidParameter, match="needs the input motor; there is force"):
        model.fit(unmodeled.read(str(path)))


def test_inputs_and_coordinates_come_from_the_rates():
    model = unmodeled.Equations(rates, states={"x": "m", "v": "m/s"}, parameters=PRIORS)
    assert model.inputs == ("motor",)
    assert model.outputs == ("x", "v")
    (c,) = model.coordinates
    assert (c.name, c.speed, c.inertia, c.unit) == ("x", "v", "m", "N")


def test_sizes_of_forces_follow_from_the_inertia():
    table = pd.DataFrame({"t": TIME, "motor": wave(), "x": 0.02 * wave(seed=2)})
    record = unmodeled.Record.from_frame(table, inputs=["motor"])
    sizes = []
    for inertia in ("m", lambda t, x, u, p: p.m, lambda t, x, u, p: 3.0 * p.m):
        place = Coordinate(name="x", position="x", speed="v", inertia=inertia)
        model = unmodeled.Equations(rates, states={"x": "m", "v": "m/s"}, parameters=PRIORS,
                                 coordinates=[place])  # fmt: skip
        found = {e.name: e.scale for e in candidates(model, record)}
        sizes.append(found["dry friction x"])
    assert sizes[1:] == pytest.approx([sizes[0], 3.0 * sizes[0]])


def test_an_inertia_that_also_weighs_is_not_guessed():
    def heavy(t, x, u, p):
        return x.v, -9.81 + (u.motor - p.k * x.x) / p.m

    model = unmodeled.Equations(heavy, states={"x": "m", "v": "m/s"}, parameters=PRIORS)
    (c,) = model.coordinates
    assert (c.inertia, c.unit) == (None, "m/s^2")


def test_an_unknown_parameter_of_rates_is_an_effect():
    def leaky(t, x, u, p):
        return (u.flow - p.leak * x.h,)

    model = unmodeled.Equations(leaky, states={"h": (1.0, 0.1, "m")}, unknown={"leak": "1/s"})
    flow = 1.0 + 0.5 * np.sign(wave())
    table = pd.DataFrame({"t": TIME, "flow": flow, "h": 1.0 + 0.5 * TIME})
    record = unmodeled.Record.from_frame(table, inputs=["flow"])
    names = [e.name for e in candidates(model, record)]
    assert names[:3] == ["leak", "constant inflow h", "leak h"]
    assert [p.name for p in model.ports] == ["h"]


@pytest.mark.parametrize(
    ("states", "message"),
    [({"x": 3.0}, "state x: got 3.0, expected its unit"), ({"x": ("m", 1.0)}, "state x: got")],
)
def test_a_wrong_state_is_told(states, message):
    with pytest.raises(InvalidParameter, match=message):
        unmodeled.Equations(rates, states=states)


# ---------------------------------------------------------------- tables and files


def test_a_table_becomes_a_record():
    table = frame().drop(columns="run").rename(columns={"force": "force [kN]", "x": "x [mm]"})
    record = unmodeled.Record.from_frame(table, inputs=["force"], sigma={"x": 1e-5})
    assert record.inputs["force"] == pytest.approx(1e3 * table["force [kN]"])
    assert record.outputs["x"] == pytest.approx(1e-3 * table["x [mm]"])
    assert (record.sensors["x"].sigma, record.input_units) == (1e-5, {"force": "N"})


@pytest.mark.parametrize("clock", ["times", "durations", "index"])
def test_the_index_can_be_the_clock(clock):
    table = frame()[["force", "x"]]
    seconds = pd.to_timedelta(TIME, unit="s")
    table.index = {"times": pd.Timestamp("2026-01-01") + seconds, "durations": seconds,
                   "index": pd.Index(TIME, name="t")}[clock]  # fmt: skip
    record = unmodeled.Record.from_frame(table, inputs=["force"])
    assert record.time == pytest.approx(TIME, abs=1e-8)
    assert list(record.outputs) == ["x"]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"inputs": ["forse"]}, "no column input forse.*force"),
        ({"sigma": {"y": 1.0}}, "sigma of y, which is no column"),
        ({"units": {"x": "apples"}}, "x: unit 'apples' is unknown"),
    ],
)
def test_a_wrong_name_of_a_column_is_told(fields, message):
    with pytest.raises((DataError, InvalidParameter), match=message):
        unmodeled.Record.from_frame(frame(), **fields)
    with pytest.raises(InvalidParameter, match="got list, expected a DataFrame"):
        unmodeled.Record.from_frame([1.0])
    with pytest.raises(DataError, match="no column trial; there are run"):
        unmodeled.records_from_frame(frame(), by="trial")


def test_files_are_read_by_a_pattern(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for k in range(2):
        frame(seed=k).drop(columns="run").to_csv(f"run_{k}.csv", index=False)
    for given in ("run_*.csv", str(tmp_path / "run_?.csv"), tmp_path, ["run_0.csv", "run_1.csv"]):
        assert [r.name for r in unmodeled.read(given)] == ["run_0", "run_1"]
    frame().rename(columns={"force": "motor"}).to_csv("motor.csv")
    (one,) = unmodeled.read("motor.csv", inputs=["motor"])
    assert (list(one.inputs), list(one.outputs)) == (["motor"], ["x"])
    with pytest.raises(DataError, match=r"swing\*.csv: no measured file"):
        unmodeled.read("swing*.csv")


# ---------------------------------------------------------------- MuJoCo


def test_a_file_for_mujoco_has_properties(tmp_path):
    pytest.importorskip("mujoco")
    servo = ROOT / "examples" / "first_answer" / "servo.xml"
    model = unmodeled.mujoco(servo, parameters={"arm.mass": (None, 0.05)})
    assert (model.parameters[0].value, model.parameters[0].unit) == (0.5, "kg")
    assert {"shoulder.backlash", "shoulder.frictionloss", "servo.kp"} < {
        e.name for e in model.effects
    }
    changed = model.mjcf.patched({"shoulder.backlash": 0.01, "arm.mass": 1.0}).compile()
    assert changed.body("arm").mass[0] == pytest.approx(1.0)
    assert changed.joint("shoulder_backlash").range == pytest.approx([-0.01, 0.01])
    with pytest.raises(InvalidParameter, match=r"no property elbow.damping.*shoulder.damping"):
        unmodeled.mujoco(servo, unknown={"elbow.damping": "N m s/rad"})
    (tmp_path / "no.xml").write_text("<urdf/>")
    with pytest.raises(InvalidParameter, match="cannot be read as MJCF"):
        unmodeled.mujoco(tmp_path / "no.xml")


# ---------------------------------------------------------------- shapes


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda t, x, u, p: (x.v,), "rates returned 1 values, expected one for each state: x, v"),
        (lambda t, x, u, p: (x.v, u.motor / p.m, 0.0), "rates returned 3 values"),
        (lambda t, x, u, p: {"x": x.v, "v": u.motor}, "the rate of x is 'x', expected a number"),
        (lambda t, x, u, p: None, "its rates function raises TypeError"),
    ],
)
def test_rates_that_are_not_one_for_each_state_are_told(given, message):
    model = unmodeled.Equations(given, states={"x": "m", "v": "m/s"}, parameters=PRIORS)
    record = unmodeled.Record.from_frame({"time": TIME, "motor": wave(), "x": wave()})
    with pytest.raises(InvalidParameter, match=message):
        model.diagnose([record], effects=[])


def test_parameters_that_the_model_got_from_the_records_are_told_where_they_are_missing(tmp_path):
    time = np.linspace(0.0, 4.0, 21)
    some = [
        unmodeled.Record.from_frame(
            {"time": time, "motor": np.sin(8.0 * time + k), "x": np.sin(3.0 * time + k)},
            sigma={"x": 1e-6},
        )
        for k in range(2)
    ]
    model = unmodeled.Equations(rates, states={"x": "m", "v": "m/s"}, parameters=PRIORS)
    ready = model.ready(matched(model, some).records)
    short = np.array([2.0, 90.0, 3.0])
    calls = (
        lambda: ready.model.simulate(
            ready.records[0], Jobs(theta=short[None], starts=np.zeros((1, 2)))
        ),
        lambda: ready.model.motion(
            ready.records[0], Jobs(theta=short[None], starts=np.zeros((1, 2)))
        ),
        lambda: writing.numbers(ready.model, short, (), np.zeros(0)),
        lambda: writing.write(ready.model, tmp_path / "x.toml", short, (), np.zeros(0)),
    )
    for call in calls:
        with pytest.raises(InvalidParameter, match=r"theta has .*: m, k, d, between.motor"):
            call()
