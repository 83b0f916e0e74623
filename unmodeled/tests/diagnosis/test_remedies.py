"""A written remedy in the original simulator: the held-out gap is the one that was promised."""

import tomllib

import numpy as np
import pytest

import unmodeled
from unmodeled import Options
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit import Candidate, Effect
from unmodeled.models.matching import matched
from unmodeled.models.writing import text, write

STEP, EVERY, COUNT, NOISE = 2e-3, 5, 150, 2e-4
SERVO = """<mujoco model="servo">
  <option timestep="0.002" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <!-- the arm -->
    <body name="arm">
      <joint name="elbow" type="hinge" axis="0 0 1" armature='0.002'
             damping="0.05"/>
      <geom type="box" pos="0.15 0 0" size="0.15 0.02 0.02" mass="0.4" contype="0"
            conaffinity="0"/>
    </body>
    <body name="base" pos="0 1 0"><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
      <joint name="slide" type="slide" axis="1 0 0" stiffness="30" damping="2"/></body>
  </worldbody>
  <actuator>
    <position name="servo" joint="elbow" kp="8" kv="0.1"/>
    <motor name="push" joint="slide" gear="2"/>
  </actuator>
  <sensor>
    <jointpos name="angle" joint="elbow"/>
    <jointpos name="x" joint="slide"/>
  </sensor>
</mujoco>
"""


def played(path, controls):
    """Sensors at the samples, by MuJoCo alone: controls are held between the samples."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    seen = np.empty((len(controls), model.nsensordata))
    for row, control in zip(seen, controls, strict=True):
        data.ctrl[: len(control)] = control
        mujoco.mj_forward(model, data)
        row[:] = data.sensordata
        mujoco.mj_step(model, data, EVERY)
    return seen


def controls(seed, size):
    random = np.random.default_rng(seed)
    time = STEP * EVERY * np.arange(COUNT)
    rates, phases = random.uniform(2.0, 10.0, (2, 3)), random.uniform(0.0, 6.0, (2, 3))
    waves = np.sin(rates * time[:, None, None] + phases) - np.sin(phases)
    return time, size * waves.sum(axis=2)


def records(path, outputs=("angle", "x")):
    found = []
    for seed, role in enumerate(("fit", "fit", "held_out")):
        time, control = controls(seed, 0.2 + 0.1 * seed)
        noise = NOISE * np.random.default_rng(9 + seed).standard_normal((COUNT, 2))
        seen = dict(zip(("angle", "x"), (played(path, control) + noise).T, strict=True))
        found.append(
            Record(
                name=f"run{seed}",
                time=time,
                inputs={"servo": control[:, 0], "push": control[:, 1]},
                outputs={n: seen[n] for n in outputs},
                sensors={n: Sensor(name=n, sigma=NOISE) for n in outputs},
                role=role,
            )
        )
    return found


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def promised(report, name):
    return next(c for c in report.channels if c.name == name).held_out_explained


@pytest.mark.slow
def test_the_changed_mjcf_file_closes_the_gap_in_mujoco(tmp_path):
    pytest.importorskip("mujoco")
    source, fixed = tmp_path / "servo.xml", tmp_path / "fixed.xml"
    source.write_text(SERVO)
    truth = tmp_path / "truth.xml"
    truth.write_text(SERVO.replace('damping="0.05"', 'damping="0.05" frictionloss="0.12"'))
    measured = records(truth, ("angle",))
    model = unmodeled.mujoco(source)
    report = model.diagnose(
        measured, effects=["elbow.frictionloss", "elbow.damping"], options=Options(seconds=900.0)
    )
    assert [n.cause for n in report.named] == ["elbow.frictionloss"]
    report.model.write(fixed)
    last = measured[-1]
    seen = played(fixed, np.column_stack(list(last.inputs.values())))[:, 0]
    assert rms(seen - last.outputs["angle"]) == pytest.approx(promised(report, "angle"), rel=0.02)
    old, new = text(model).splitlines(), fixed.read_text().splitlines()
    changed = [line for line in new if line not in old]
    assert len(changed) == 2  # a comment and the line of the joint
    assert len(new) == len(old) + 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("elbow.backlash", 0.02),
        ("elbow.damping", 0.2),
        ("elbow.stiffness", 3.0),
        ("elbow.armature", 0.01),
        ("arm.mass", 0.7),
        ("base.mass", 3.0),
        ("servo.kp", 5.0),
        ("servo.gear", 1.1),
        ("push.gear", 3.0),
        ("slide.stiffness", 50.0),
    ],
)
def test_each_property_is_written_as_it_was_simulated(tmp_path, name, value):
    mujoco = pytest.importorskip("mujoco")
    source, fixed = tmp_path / "servo.xml", tmp_path / "fixed.xml"
    source.write_text(SERVO)
    time, control = controls(4, 0.5)
    record = Record(
        name="run",
        time=time,
        inputs={"servo": control[:, 0], "push": control[:, 1]},
        outputs={"angle": np.zeros(COUNT), "x": np.zeros(COUNT)},
        sensors={n: Sensor(name=n, sigma=NOISE) for n in ("angle", "x")},
    )
    model = matched(
        unmodeled.mujoco(source, parameters={name: (None, 0.1)}, unknown={}), [record]
    ).model
    write(model, fixed, np.array([value]), (), np.zeros(0))
    wanted = model.mjcf(time, record.inputs, {name: value})
    seen, before = played(fixed, control), played(source, control)
    for k, output in enumerate(("angle", "x")):
        np.testing.assert_allclose(seen[:, k], wanted[output], atol=1e-6)
    assert np.abs(seen - before).max() > 1e-3
    written = mujoco.MjModel.from_xml_path(str(fixed))
    compiled = model.mjcf.patched({name: value}).compile()
    for part in (n for n in dir(written) if n.startswith(("body_", "dof_", "jnt_", "actuator_"))):
        np.testing.assert_allclose(getattr(written, part), getattr(compiled, part), rtol=1e-5)
    changed = [n for n in fixed.read_text().splitlines() if n not in text(model).splitlines()]
    assert 2 <= len(changed) <= 3  # a comment, and the lines of the property


def test_an_unstable_run_has_no_numbers_and_writes_no_file(tmp_path, monkeypatch):
    """MuJoCo resets the state, goes on, and writes a file into the folder of the user."""
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    source = tmp_path / "servo.xml"
    source.write_text(SERVO.replace('kv="0.1"', 'kv="0"').replace("implicitfast", "Euler"))
    time, control = controls(4, 0.5)
    inputs = {"servo": control[:, 0], "push": control[:, 1]}
    seen = unmodeled.mujoco(source).mjcf(time, inputs, {"servo.kp": 1e7})
    assert np.isnan(seen["angle"]).all()
    assert [p.name for p in tmp_path.iterdir()] == ["servo.xml"]


def test_a_late_input_is_the_delay_of_the_actuator(tmp_path):
    pytest.importorskip("mujoco")
    source, fixed = tmp_path / "servo.xml", tmp_path / "fixed.xml"
    source.write_text(SERVO)
    effect = Effect(name="delay of input push", component="input push", unit="s", scale=0.01)
    model = unmodeled.mujoco(source, unknown={})
    write(model, fixed, np.zeros(0), (Candidate(effect),), np.array([-0.04]))
    _, control = controls(4, 0.5)
    late = np.vstack([np.zeros((4, 2)), control[:-4]])
    late[:, 0] = control[:, 0]
    np.testing.assert_allclose(played(fixed, control), played(source, late), atol=1e-9)


def test_a_file_of_parts_is_written_whole(tmp_path):
    pytest.importorskip("mujoco")
    source, fixed = tmp_path / "servo.xml", tmp_path / "fixed.xml"
    head, _, tail = SERVO.partition("  <actuator>")
    part, _, end = ("  <actuator>" + tail).partition("  <sensor>")
    (tmp_path / "part.xml").write_text(f"<mujoco>{part}</mujoco>")
    source.write_text(head + '<include file="part.xml"/>\n  <sensor>' + end)
    model = unmodeled.mujoco(source, parameters={"servo.kp": (None, 0.1)}, unknown={})
    other = tmp_path / "other" / "fixed.xml"
    other.parent.mkdir()
    write(model, other, np.array([5.0]), (), np.zeros(0))
    write(model, fixed, np.array([5.0]), (), np.zeros(0))
    _, control = controls(4, 0.5)
    alone = tmp_path / "alone.xml"
    alone.write_text(SERVO.replace('kp="8"', 'kp="5"'))
    for whole in (fixed, other):
        np.testing.assert_allclose(played(whole, control), played(alone, control), atol=1e-6)


def test_a_file_with_a_mesh_is_written_into_another_folder(tmp_path):
    """The report of such a model could not have a folder."""
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "bob.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    source, fixed = tmp_path / "bob.xml", tmp_path / "report" / "remedy.xml"
    source.write_text(
        """<mujoco><compiler meshdir="parts"/><asset><mesh name="bob" file="bob.obj"/></asset>
        <worldbody><body><joint name="pin"/><geom type="mesh" mesh="bob"/></body></worldbody>
        <actuator><motor name="drive" joint="pin"/></actuator></mujoco>"""
    )
    fixed.parent.mkdir()
    model = unmodeled.mujoco(source, parameters={"pin.damping": (None, 0.1)}, unknown={})
    write(model, fixed, np.array([5.0]), (), np.zeros(0))
    assert mujoco.MjModel.from_xml_path(str(fixed)).dof_damping == pytest.approx([5.0])


def test_numbers_of_a_function(tmp_path):
    def cart(time, inputs, parameters):
        return {"x": parameters["gain"] * inputs["u"] + parameters["offset"]}

    time = np.linspace(0.0, 1.0, 50)
    found = []
    for size in (1.0, 2.0, 3.0):
        u = size * np.sin(7.0 * time)
        x = 2.0 * u + 0.3 + 1e-3 * np.random.default_rng(int(size)).standard_normal(time.size)
        found.append(
            Record(
                name=f"run{size:g}",
                time=time,
                inputs={"u": u},
                outputs={"x": x},
                sensors={"x": Sensor(name="x", sigma=1e-3)},
            )
        )
    model = unmodeled.Simulator(
        cart, parameters={"gain": (2.1, 0.2, "m/N")}, unknown={"offset": (0.0, 0.1, "m")}
    )
    report = model.diagnose(found, effects=["offset"])
    assert report.summary().startswith("The effect offset has a size of 300.00 mm (")
    report.model.write(tmp_path / "found.toml")
    numbers = tomllib.loads((tmp_path / "found.toml").read_text())["parameters"]
    assert numbers == pytest.approx({"gain": 2.0, "offset": 0.3}, rel=1e-2)
    with pytest.raises(InvalidParameter, match=r"cannot write \.xml, expected \.toml"):
        report.model.write(tmp_path / "found.xml")


FRICTION = "bodies.arm.friction.viscous"
