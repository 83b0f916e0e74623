"""MuJoCo models: keyframes, names of actuators, files from elsewhere, and a stop by Ctrl-C."""

import os
import signal
import subprocess
import sys
import threading
import time as clock
from dataclasses import replace

import numpy as np
import pytest

import unmodeled
from unmodeled.data import Record
from unmodeled.errors import InvalidParameter
from unmodeled.fit import mjcf_runs
from unmodeled.fit.running import Run
from unmodeled.models.matching import matched
from unmodeled.models.writing import write

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><joint damping="0.2" springref="0.4" stiffness="0.3" frictionloss="0.01"/></default>
  <worldbody>
    <body name="base" pos="0 0 1"><joint name="pan" axis="0 0 1"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .1 0 0"/>
      <body name="upper"><joint name="j1" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" contype="0" conaffinity="0"/>
        <body name="lower" pos=".3 0 0"><joint name="j2" axis="0 1 0"/>
          <joint name="j3" axis="1 0 0"/>
          <geom type="box" size=".1 .02 .03" pos=".15 0 0" contype="0" conaffinity="0"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="turn" joint="pan"/>
    <position joint="j1" kp="30" kv="1"/>
    <general name="slow" joint="j2" dyntype="filter" dynprm="0.5" gainprm="4"/>
  </actuator>
  <keyframe>
    <key name="other" qpos="0 0 0 0"/>
    <key name="home" qpos=".1 .9 -.5 .3" qvel="1 -2 3 -4" act=".7" ctrl=".2 .8 .4"/>
  </keyframe>
</mujoco>
"""
NAMES = ("pan", "j1", "j2", "j3")


def played(path, count):
    """Positions by MuJoCo alone from the second keyframe, both sides of a clearance together."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 1)
    seen = []
    for _ in range(count):
        seen.append([
            sum(data.qpos[model.joint(j).qposadr[0]] for j in range(model.njnt)
                if model.joint(j).name in (n, f"{n}_backlash"))
            for n in NAMES
        ])  # fmt: skip
        mujoco.mj_step(model, data, 5)
    return np.array(seen)


def test_a_clearance_of_a_microradian_changes_nothing_from_a_keyframe(tmp_path):
    """Keyframes kept their numbers while joints were added in between: other joints got them."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    time = np.arange(60) * 0.01
    slack = {"pan.backlash": 0.0, "j1.backlash": 0.0}
    model = unmodeled.mujoco(path, key="home", unknown={}, parameters=slack)
    plain = model.mjcf(time, {}, {})
    alone = played(path, 60)
    slack = model.mjcf(time, {}, dict.fromkeys(slack, 1e-6))
    write(model, tmp_path / "slack.xml", np.array([1e-6, 1e-6]), (), np.zeros(0))
    written = played(tmp_path / "slack.xml", 60)
    for i, name in enumerate(NAMES):
        assert np.ptp(alone[:, i]) > 0.1
        np.testing.assert_allclose(plain[f"{name}.position"], alone[:, i], atol=1e-12)
        assert slack[f"{name}.position"][0] == alone[0, i]
        np.testing.assert_allclose(slack[f"{name}.position"], alone[:, i], atol=5e-3)
        np.testing.assert_allclose(written[:, i], slack[f"{name}.position"], atol=1e-6)
    assert slack["j2.velocity"][0] == pytest.approx(3.0)
    found = mujoco.MjModel.from_xml_path(str(tmp_path / "slack.xml"))
    assert found.key_act[1] == pytest.approx([0.7])
    assert found.key_ctrl[1] == pytest.approx([0.2, 0.8, 0.4])


def test_a_joint_before_others_of_its_body_has_no_clearance(tmp_path):
    """The second joint would be behind the next one, with another axis."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    names = {e.name for e in unmodeled.mujoco(path).effects}
    assert "j3.backlash" in names
    assert "j2.backlash" not in names


def made(*, inputs, outputs=("j2",)):
    time = np.arange(50) * 0.01
    return Record(
        name="run",
        time=time,
        inputs={n: np.sin(time) for n in inputs},
        outputs={n: np.zeros(50) for n in outputs},
    )


def test_an_actuator_without_a_name_has_that_of_its_joint(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    model = unmodeled.mujoco(path, parameters={"j1.kp": (None, 1.0)}, unknown={})
    ready = matched(model, [made(inputs=["j1", "turn"])])
    assert set(ready.model.inputs) == {"j1", "turn"}
    assert "no column is its actuator slow, which keeps its start value" in ready.notes
    write(model, tmp_path / "fixed.xml", np.array([12.0]), (), np.zeros(0))
    found = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    assert found.actuator("j1").gainprm[0] == 12.0


def test_a_column_with_the_name_of_an_actuator_is_an_input(tmp_path):
    """A file of columns does not say which are inputs."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    ready = matched(unmodeled.mujoco(path), [made(inputs=(), outputs=("turn", "j2", "j1"))])
    assert set(ready.model.inputs) == {"turn", "j1"}
    assert set(ready.model.outputs) == {"j2"}
    assert set(ready.records[0].inputs) == {"turn", "j1"}


def test_a_rail_and_a_hinge_have_a_position_and_a_ball_joint_has_none(tmp_path):
    path = tmp_path / "cart.xml"
    bodies = "".join(
        f'<body><joint name="{kind}" type="{kind}"/><geom size="0.1" mass="1"/></body>'
        for kind in ("slide", "hinge", "ball")
    )
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    for kind in ("slide", "hinge"):
        for of in ("", ".position", ".velocity"):
            record = made(inputs=(), outputs=(f"{kind}{of}",))
            assert set(matched(unmodeled.mujoco(path), [record]).model.outputs) == {f"{kind}{of}"}
    with pytest.raises(InvalidParameter, match="ball"):
        matched(unmodeled.mujoco(path), [made(inputs=(), outputs=("ball.position",))])


def test_an_input_that_is_no_actuator_is_told(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    with pytest.raises(
        InvalidParameter, match=r"input trn is no actuator.*there are turn, j1, slow"
    ):
        unmodeled.mujoco(path, inputs=["trn"])
    with pytest.raises(
        InvalidParameter, match="input load of record run is no actuator; there are turn, j1, slow"
    ):
        matched(unmodeled.mujoco(path), [made(inputs=["turn", "load"])])
    with pytest.raises(InvalidParameter, match="has no keyframe hom; near are home"):
        unmodeled.mujoco(path, key="hom")
    with pytest.raises(InvalidParameter, match=r"turm.* near are turn"):
        matched(unmodeled.mujoco(path), [made(inputs=["turm"])])


# ---------------------------------------------------------------- files


BOX = "<mujoco>{}<worldbody><body><joint name='j'/><geom size='1'/>{}</body></worldbody></mujoco>"
FIELD = '<asset><hfield name="h" nrow="{0}" ncol="{0}" size="1 1 1 1"/></asset>'

PICTURE = '<asset><texture name="t" {}/></asset>'
MOTOR = "<motor joint='j'/>"
MANY = '<replicate count="1000">{}</replicate>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOX.format(FIELD.format(37000), ""), "<hfield h> has 1369000000 elements; the limit is"),
        (BOX.format(PICTURE.format('builtin="flat" width="90000" height="90000"'), ""),
         "<texture t> has 8100000000 elements"),
        (BOX.format("", MANY.format(MANY.format("<site/>"))),
         "<replicate > has 1000000 elements; the limit is 20000"),
        (BOX.format('<option timestep="0" iterations="1000000000"/>', ""),
         "timestep = 0 s, expected at least 1e-09 s; iterations = 1000000000; the limit is 10000"),
        (BOX.format('<option timestep="nan"/>', ""), "timestep = nan s"),
        (BOX.format('<keyframe><key qpos="1e308"/></keyframe>', ""), r"key_qpos holds 1e\+308"),
        (BOX.format('<option timestep="-1" gravity="0 nan 0"/>', ""),
         "timestep = -1 s, .*; gravity holds nan"),
        (BOX.format("", "<body>" * 5000 + "</body>" * 5000), "more than 300 elements are inside"),
        (BOX.format("", "").replace("</mujoco>", f"<actuator>{MOTOR * 501}</actuator></mujoco>"),
         "501 actuators; the limit is 500"),
        (BOX.format('<include file="pipe.xml"/>', ""), "pipe.xml: is a device or a pipe"),
        (BOX.format('<asset><mesh file="pipe.xml"/></asset>', ""), "is a device or a pipe"),
        (BOX.format('<asset><mesh file="/dev/zero"/></asset>', ""), "/dev/zero: is a device"),
        (BOX.format('<include file="nothing.xml"/>', ""), "cannot be read as MJCF"),
        (BOX.format(PICTURE.format('type="2d" file="big.png"'), ""),
         "the picture has 10000000000 elements"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "cannot be read as MJCF"),
        ("<mujoco", "cannot be read as MJCF"),
    ],
)  # fmt: skip
def test_a_file_that_would_hang_or_fill_the_memory_is_refused(tmp_path, monkeypatch, text, said):
    monkeypatch.chdir(tmp_path)
    os.mkfifo(tmp_path / "pipe.xml")
    size = (100_000).to_bytes(4, "big")
    (tmp_path / "big.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + size + size)
    (tmp_path / "model.xml").write_text(text)
    with pytest.raises(InvalidParameter, match=said):
        unmodeled.mujoco("model.xml")
    assert {p.name for p in tmp_path.iterdir()} == {"model.xml", "pipe.xml", "big.png"}


def test_files_outside_the_folder_of_the_model_are_told(tmp_path):
    (tmp_path / "model").mkdir()
    (tmp_path / "part.xml").write_text("<mujoco><option timestep='0.001'/></mujoco>")
    path = tmp_path / "model" / "model.xml"
    path.write_text(BOX.format('<include file="../part.xml"/>', ""))
    ready = unmodeled.mujoco(path).ready([made(inputs=(), outputs=("j",))])
    (told,) = [n for n in ready.notes if "outside its folder" in n]
    assert "part.xml" in told


@pytest.fixture
def interruptible():
    """Ctrl-C raises, also where a shell started the tests in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_ends_a_run_of_many_steps(tmp_path, interruptible):
    path = tmp_path / "model.xml"
    path.write_text(BOX.format("<option timestep='1e-8'/>", ""))
    model = unmodeled.mujoco(path)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    begin = clock.monotonic()
    with pytest.raises(KeyboardInterrupt):
        model.mjcf(np.array([0.0, 10.0]), {}, {})
    assert clock.monotonic() - begin < 30.0  # without it, 1e9 steps


def test_a_warning_of_mujoco_is_no_file(tmp_path):
    """In the folder where the user works."""
    light = '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-14 1e-14 1e-14"/><geom type="box"'
    text = ARM.replace('"j3" axis="1 0 0"', '"j3" axis="0 1 0"')
    (tmp_path / "model.xml").write_text(text.replace('<geom type="box"', light))
    code = (
        "import unmodeled, numpy as np\n"
        "model = unmodeled.mujoco('model.xml')\n"
        "model.mjcf(np.arange(20) * 0.1, {}, {})\n"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert [p.name for p in tmp_path.iterdir()] == ["model.xml"]


# ---------------------------------------------------------------- changes without a new compilation


TIP = '<site name="tip" pos=".2 0 0"/><geom type="box" size=".1 .02'
PARTS = (
    ARM.replace(
        '<position joint="j1" kp="30" kv="1"/>',
        '<position joint="j1" kp="30" kv="1" forcerange="-8 8"/>',
    )
    .replace(
        "</worldbody>",
        '<body name="ball" pos="2 0 1"><freejoint/><geom name="ball" size=".1"/>'
        '<geom type="box" size=".1 .1 .1" contype="0" conaffinity="0" mass="0"/></body>'
        "</worldbody>",
    )
    .replace('"0 0 0 0"', '"0 0 0 0 2 0 1 1 0 0 0"')
    .replace(
        'qpos=".1 .9 -.5 .3" qvel="1 -2 3 -4"',
        'qpos=".1 .9 -.5 .3 2 0 1 1 0 0 0" qvel="1 -2 3 -4 0 1 0 3 2 1"',
    )
    .replace(
        "</actuator>",
        '</actuator><sensor><framepos name="at" objtype="body" objname="ball"/>'
        '<framepos name="mid" objtype="xbody" objname="ball"/>'
        '<actuatorfrc name="pull" actuator="slow"/><accelerometer name="felt" site="tip"/>'
        "</sensor>",
    )
    .replace('<geom type="box" size=".1 .02', TIP)
)


@pytest.fixture
def parts(tmp_path):
    path = tmp_path / "parts.xml"
    path.write_text(PARTS)
    return unmodeled.mujoco(path, key="home", unknown={})


def again(path, time, inputs):
    """Outputs of a file by MuJoCo alone, with the inputs of each sample."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 1)
    seen = []
    for k in range(time.size):
        for name, values in inputs.items():
            data.ctrl[model.actuator(name).id] = values[k]
        mujoco.mj_forward(model, data)
        seen.append(np.concatenate([data.qpos[:4], data.sensordata]))
        mujoco.mj_step(model, data, 5)
    return np.array(seen)


CHANGES = {
    "j1.damping": 0.7, "j2.frictionloss": 0.5, "j3.armature": 0.05, "j1.stiffness": 2.0,
    "j1.backlash": 0.05, "j1.kp": 20.0, "j1.kv": 2.0, "j1.gear": 1.2, "j1.force": 3.0,
    "slow.gain": 6.0, "lower.mass": 2.0, "lower.payload": 0.8, "lower.center_y": 0.04,
    "lower.inertia_x": 2e-3, "j2.offset_z": 0.02, "gravity.tilt_x": 0.1, "gravity.tilt_y": -0.2,
    "ball.center_x": 0.05, "j1.zero": 0.1, "lower.length": 0.25,
}  # fmt: skip


@pytest.mark.parametrize("name", [*CHANGES, "all", "place"])
def test_a_changed_field_is_a_changed_file(parts, tmp_path, name):
    """The file is compiled by MuJoCo; the run changes fields of a compiled model."""
    values = {name: CHANGES[name]} if name in CHANGES else {**CHANGES, "ball.mass": 3.0}
    if name == "place":
        values = {"lower.payload": 0.8, "lower.payload_x": 0.3, "ball.payload": 5.0,
                  "ball.payload_y": 0.2}  # fmt: skip
    time = np.arange(40) * 0.01
    inputs = {"turn": np.sin(9.0 * time), "j1": 0.8 + 0.3 * np.sin(7.0 * time)}
    plain = parts.mjcf(time, inputs, {})
    seen = parts.mjcf(time, inputs, values)
    told = tmp_path / "changed.xml"
    told.write_text(parts.mjcf.patched(values).to_xml())
    wanted = again(told, time, inputs)
    if "j1.backlash" in values:
        seen["j1.position"] = seen["j1.position"]  # both sides together
        keep = [0, *range(4, wanted.shape[1])]
    else:
        keep = list(range(wanted.shape[1]))
    names = [*(f"{n}.position" for n in NAMES), *(f"at.{a}" for a in "xyz"),
             *(f"mid.{a}" for a in "xyz"), "pull", *(f"felt.{a}" for a in "xyz")]  # fmt: skip
    moved = 0.0
    for i in keep:
        spread = max(np.ptp(wanted[:, i]), 1e-3)
        np.testing.assert_allclose(
            seen[names[i]], wanted[:, i], atol=2e-3 * spread, err_msg=names[i]
        )
        moved = max(moved, np.abs(seen[names[i]] - plain[names[i]]).max() / spread)
    assert moved > 0.01
    # The copies are as before.
    for n, y in parts.mjcf(time, inputs, {}).items():
        assert np.array_equal(y, plain[n])


def test_runs_on_threads_are_those_alone(parts, monkeypatch):
    """Equal bytes, whatever the number of threads and the other runs of the batch."""
    time = np.arange(60) * 0.01
    uneven = time + 2e-3 * np.sin(np.arange(60))
    runs = [
        Run("r", clock_, {"turn": np.sin(k + time)}, {name: value})
        for k, (name, value) in enumerate(CHANGES.items())
        for clock_ in (time, uneven)
    ]
    monkeypatch.setattr(mjcf_runs, "WORTH_A_THREAD", 1)
    together = parts.mjcf.run_all(runs, 3)
    for run, seen in zip(runs, together, strict=True):
        alone = parts.mjcf(run.time, run.inputs, run.parameters)
        assert all(np.array_equal(seen[n], alone[n]) for n in alone)


def test_a_long_run_is_made_in_parts(parts, monkeypatch):
    time = np.arange(60) * 0.01
    inputs = {"turn": np.sin(9.0 * time)}
    whole = parts.mjcf(time, inputs, {})
    monkeypatch.setattr(mjcf_runs, "STEPS", 7)
    for name, y in parts.mjcf(time, inputs, {}).items():
        np.testing.assert_allclose(y, whole[name], rtol=1e-9, atol=1e-9)


def test_the_error_of_the_time_step_is_told(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace('timestep="0.002"', 'timestep="0.008"'))
    record = made(inputs=["turn"])
    sensors = {"j2": unmodeled.data.Sensor(name="j2", sigma=1e-4, unit="rad")}
    record = replace(record, sensors=sensors)
    notes = " ".join(unmodeled.mujoco(path, key="home", unknown={}).ready([record]).notes)
    assert "its time step of 0.008 s is 0.005 s in record run" in notes
    assert "half its time step changes j2 by" in notes
    path.write_text(ARM.replace('timestep="0.002"', 'timestep="0.0001"'))
    record = replace(record, sensors={"j2": replace(sensors["j2"], sigma=1e-3)})
    notes = " ".join(unmodeled.mujoco(path, key="home", unknown={}).ready([record]).notes)
    assert "time step" not in notes


CRANE = """<mujoco><option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="one" pos="0 0 1"><joint name="j1" axis="0 1 0" damping=".3"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
    <body name="two" pos=".3 0 0"><joint name="j2" axis="0 1 0" damping=".2"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body></body></worldbody>
  <actuator><position joint="j1" kp="60" kv="2"/><position joint="j2" kp="30" kv="1"/></actuator>
</mujoco>"""


@pytest.mark.parametrize(("cause", "value"), [("two.payload", 0.15), ("gravity.tilt_y", 0.03)])
def test_payload_and_tilt_are_named(tmp_path, cause, value):
    """Withheld in records that MuJoCo makes alone; recorded set points of two servos drive."""
    path = tmp_path / "crane.xml"
    path.write_text(CRANE)
    true = mujoco.MjModel.from_xml_path(str(path))
    if cause == "two.payload":
        true.body("two").mass[0] += value
    else:
        true.opt.gravity[:] = -9.81 * np.sin(value), 0.0, -9.81 * np.cos(value)
    found = []
    for seed in range(3):
        random, data = np.random.default_rng(seed), mujoco.MjData(true)
        time = np.arange(80) * 0.01
        u = 0.4 * np.sin(random.uniform(4.0, 12.0, 2) * time[:, None])
        q = np.empty((80, 2))
        for k in range(80):
            q[k] = data.qpos
            data.ctrl[:] = u[k]
            mujoco.mj_step(true, data, 5)
        q += 1e-4 * random.standard_normal(q.shape)
        sensors = {n: unmodeled.data.Sensor(name=n, sigma=1e-4, unit="rad")
                   for n in ("j1.position", "j2.position")}  # fmt: skip
        found.append(
            Record(
                name=f"run{seed}",
                time=time,
                inputs={"j1": u[:, 0], "j2": u[:, 1]},
                outputs={"j1.position": q[:, 0], "j2.position": q[:, 1]},
                sensors=sensors,
            )
        )
    tested = ["*.payload", "gravity.*", "*.frictionloss", "*.kp"]
    options = unmodeled.Options(good_enough={"rad": 1e-4})
    (named,) = unmodeled.mujoco(path).diagnose(found, effects=tested, options=options).named
    assert named.cause == cause
    assert named.magnitude == pytest.approx(value, rel=0.05)
