"""MuJoCo models: keyframes, names of actuators, files from elsewhere, and a stop by Ctrl-C."""

import os
import signal
import subprocess
import sys
import threading
import time as clock

import numpy as np
import pytest

import unmodeled
from unmodeled.data import Record
from unmodeled.errors import InvalidParameter

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
    model.write(tmp_path / "slack.xml", np.array([1e-6, 1e-6]), (), np.zeros(0))
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
    ready = model.matched([made(inputs=["j1", "turn"])])
    assert set(ready.model.inputs) == {"j1", "turn"}
    assert "no column is its actuator slow, which keeps its start value" in ready.notes
    model.write(tmp_path / "fixed.xml", np.array([12.0]), (), np.zeros(0))
    found = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    assert found.actuator("j1").gainprm[0] == 12.0


def test_an_input_that_is_no_actuator_is_told(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    with pytest.raises(
        InvalidParameter, match=r"input trn is no actuator.*there are turn, j1, slow"
    ):
        unmodeled.mujoco(path, inputs=["trn"])
    with pytest.raises(
        InvalidParameter, match="input load of record run is no actuator; there are"
    ):
        unmodeled.mujoco(path).matched([made(inputs=["turn", "load"])])
    with pytest.raises(InvalidParameter, match=r"turm.* near are turn"):
        unmodeled.mujoco(path).matched([made(inputs=["turm"])])


# ---------------------------------------------------------------- files


BOX = "<mujoco>{}<worldbody><body><joint name='j'/><geom size='1'/>{}</body></worldbody></mujoco>"
FIELD = '<asset><hfield name="h" nrow="{0}" ncol="{0}" size="1 1 1 1"/></asset>'

PICTURE = '<asset><texture name="t" {}/></asset>'
MANY = '<replicate count="1000">{}</replicate>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOX.format(FIELD.format(37000), ""), "<hfield h> has 1369000000 elements; the limit is"),
        (BOX.format(PICTURE.format('builtin="flat" width="90000" height="90000"'), ""),
         "<texture t> has 8100000000 elements"),
        (BOX.format("", MANY.format(MANY.format("<site/>"))),
         "<replicate > has 1000000 elements; the limit is 20000"),
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


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_ends_a_run_of_many_steps(tmp_path):
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
