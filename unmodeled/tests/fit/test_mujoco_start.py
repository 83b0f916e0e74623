"""Starts of MuJoCo runs: where the record starts, in a keyframe, or as the command line states."""

from dataclasses import replace

import numpy as np
import pytest

import unmodeled
from unmodeled.data import Record, Sensor
from unmodeled.fit.mjcf_start import begin_of
from unmodeled.loading import load_model
from unmodeled.search.records import ready_records

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body name="upper" pos="0 0 1"><joint name="hip" axis="0 1 0" damping="{damping}"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".8"/>
<body name="fore" pos=".25 0 0"><joint name="knee" axis="0 1 0" damping=".12" armature=".005"/>
<geom type="capsule" fromto="0 0 0 .22 0 0" size=".018" mass=".45"/>
<body name="tool" pos=".22 0 0"><geom size=".02" mass="{tool}"/><site name="tip" pos=".03 0 0"/>
</body></body></body></worldbody>
<actuator>{drives}</actuator>
<keyframe><key name="home" qpos=".4 -.9"/><key name="low" qpos="1.5 .2"/></keyframe></mujoco>"""
SERVOS = """<position name="c1" joint="hip" kp="70" kv="1.5"/>
<position name="c2" joint="knee" kp="30" kv=".5"/>"""
NOISE = 3e-4


def arm(folder, *, damping=0.3, tool=0.1, servos=True):
    path = folder / "arm.xml"
    path.write_text(ARM.format(damping=damping, tool=tool, drives=SERVOS * servos))
    return path


def run(path, start, *, speed=(0.0, 0.0), goals=None, sd=NOISE, name="run", joints=("hip", "knee")):
    """A record of the model itself, which starts there."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start, speed
    time, seen = np.arange(0.0, 2.0, 0.01), []
    for t in time:
        seen.append(data.qpos.copy())
        if goals is not None:
            data.ctrl[:] = goals(t)
        mujoco.mj_step(model, data, 5)
    seen = np.array(seen) + sd * np.random.default_rng(3).standard_normal((time.size, 2))
    driven = np.array([goals(t) for t in time]) if goals is not None else np.empty((0, 0))
    inputs = {f"c{k + 1}": driven[:, k] for k in range(driven.shape[1])}
    outputs = {n: seen[:, ("hip", "knee").index(n)] for n in joints}
    return Record(name=name, time=time, inputs=inputs, outputs=outputs,
                  sensors={n: Sensor(name=n, unit="rad", sigma=sd) for n in outputs})  # fmt: skip


def wave(t):
    return 0.6 + 0.3 * np.sin(7 * t), -0.7 + 0.4 * np.sin(11 * t)


def test_a_beginning_is_as_long_as_it_is_a_parabola():
    time, noise = np.arange(200) * 0.01, np.random.default_rng(1).standard_normal((400, 200))
    off = []
    for row in noise:
        found = begin_of(time, 0.3 + np.sin(6.0 * time) + 1e-3 * row, 1e-3)
        off.append(((found.value - 0.3) / found.value_sd, (found.rate - 6.0) / found.rate_sd))
    assert np.std(off, axis=0) == pytest.approx([1.2, 1.2], abs=0.5)
    assert found.value_sd < 1e-3
    assert found.rate_sd < 0.1
    assert begin_of(time[:4], np.zeros(4), 1e-3) is None


def test_a_perfect_servo_arm_that_starts_anywhere_has_no_gap(tmp_path):
    path = arm(tmp_path)
    record = run(path, (0.7, -0.5), goals=wave)
    found = unmodeled.check(unmodeled.mujoco(path), record)
    assert not found.hints
    assert all(r.rms < 1.6 * NOISE for r in found.rows)
    assert any("starts where its first samples are" in n for n in found.notes)


def test_a_start_of_a_record_is_no_noise_of_the_model(tmp_path):
    """Both runs that are compared begin where the record begins."""
    path = arm(tmp_path)
    ready = unmodeled.mujoco(path).ready([run(path, (0.7, -0.5), goals=wave)])
    assert not any("same arguments differ" in n for n in ready.notes)


def test_a_free_swing_fits_its_start_and_finds_the_damping(tmp_path):
    """A pendulum keeps its start: it is an unknown of each record, within the first samples."""
    path = arm(tmp_path, servos=False)
    records = [run(path, (1.0, 0.5), speed=(-1.0, 2.0), name="a"), run(path, (1.9, -0.4), name="b")]
    model = unmodeled.mujoco(arm(tmp_path, damping=0.4, servos=False),
                             parameters={"hip.damping": (None, 0.2)}, unknown={})  # fmt: skip
    ready = ready_records(model, records)
    assert all(sd > 0.0 for r in ready.records for sd in r.start.sd.values())
    report = model.fit(records)
    (damping,) = [p for p in report.parameters if p.name == "hip.damping"]
    assert damping.low < 0.3 < damping.high
    assert damping.value == pytest.approx(0.3, rel=2e-3)
    assert all(c.explained < 1.1 * NOISE for c in report.channels)


def test_a_joint_that_is_not_measured_starts_as_in_the_nearest_keyframe(tmp_path):
    path = arm(tmp_path)
    record = run(path, (0.4, -0.9), goals=wave, joints=("hip",))
    ready = ready_records(unmodeled.mujoco(path), [record])
    assert ready.model.mjcf.key == "home"
    assert "model arm: its runs start in keyframe home" in ready.notes
    (row,) = unmodeled.check(unmodeled.mujoco(path), record).rows
    assert row.rms < 1.2 * NOISE
    assert ready_records(ready.model, ready.records).records[0].start == ready.records[0].start


def test_a_stated_start_that_does_not_fit_is_told_first(tmp_path):
    path = arm(tmp_path)
    record = run(path, (0.4, -0.9), goals=wave)
    found = unmodeled.check(load_model(str(path), running={"key": "low"}).model, record)
    assert [h.kind for h in found.hints] == ["start"]
    assert "hip of run at 0.40" in found.hints[0].text
    assert "--key" in found.hints[0].text
    assert not unmodeled.check(unmodeled.mujoco(path, key="home"), record).hints
    settled = load_model(str(path), running={"settle": 3.0, "key": "home"}).model
    assert settled.mjcf.settle == 3.0
    with pytest.raises(unmodeled.errors.InvalidParameter, match="--key, which belongs to a MuJoCo"):
        load_model("f.py:f", running={"key": "home"})


def test_a_payload_is_at_the_outermost_body_or_a_named_site(tmp_path):
    """It was at the center of the forearm, to which the tool is welded: 74 % too large."""
    path = arm(tmp_path)
    effects = {e.name: e for e in unmodeled.mujoco(path).effects}
    assert [n for n in effects if n.endswith("payload")] == ["tool.payload"]
    heavier = [n for n in effects if n.endswith(".mass")]  # bodies that carry another one
    assert heavier
    assert not {"tool.mass", "world.mass"} & {*heavier}
    assert "center of mass of the body tool, (0, 0, 0) m" in effects["tool.payload"].mechanism
    record = run(arm(tmp_path, tool=0.16), (0.4, -0.9), goals=wave)
    record = replace(record, sensors={n: replace(s, sigma=None) for n, s in record.sensors.items()})
    model = unmodeled.mujoco(arm(tmp_path), parameters={"tool.payload": (0.0, 1.0)}, unknown={})
    found = model.fit(record).parameters[0]
    assert found.value == pytest.approx(0.06, abs=2e-3)
    named = unmodeled.mujoco(path, unknown={"tip.payload": "kg"})
    assert "site tip of the body tool, (0.03, 0, 0) m" in named.effects[0].mechanism
    time = record.time
    inputs = record.inputs
    at_site = named.mjcf(time, inputs, {"tip.payload": 0.06})
    same = {"tool.payload": 0.06, "tool.payload_x": 0.03}
    np.testing.assert_allclose(at_site["hip"], named.mjcf(time, inputs, same)["hip"], atol=1e-12)


URDF = """<robot name="swing"><link name="base"/><link name="bar"><inertial><origin xyz="0 0 -0.2"/>
<mass value="0.7"/><inertia ixx="0.004" iyy="0.004" izz="0.0004" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="hip" type="continuous"><parent link="base"/><child link="bar"/>
<axis xyz="0 1 0"/><dynamics damping="0.05" friction="0.02"/></joint></robot>"""
SAME = """<mujoco><worldbody><body name="bar"><joint name="hip" axis="0 1 0" damping="0.05"
 frictionloss="0.02"/><inertial pos="0 0 -0.2" mass="0.7" diaginertia="0.004 0.004 0.0004"/>
</body></worldbody></mujoco>"""


def test_a_urdf_is_the_model_of_the_same_mjcf(tmp_path):
    (tmp_path / "swing.urdf").write_text(URDF)
    (tmp_path / "swing.xml").write_text(SAME)
    urdf, mjcf = (unmodeled.mujoco(tmp_path / f"swing.{end}") for end in ("urdf", "xml"))
    time = np.arange(0.0, 2.0, 0.01)
    start = {"hip.position": 0.8}
    seen = [m.mjcf(time, {}, start)["hip"] for m in (urdf, mjcf)]
    np.testing.assert_allclose(*seen, atol=1e-9)
    assert np.ptp(seen[0]) > 0.8
    noise = NOISE * np.random.default_rng(2).standard_normal(time.size)
    record = Record(name="swing", time=time, inputs={}, outputs={"hip": seen[1] + noise},
                    sensors={"hip": Sensor(name="hip", unit="rad", sigma=NOISE)})  # fmt: skip
    (row,) = unmodeled.check(urdf, record).rows
    assert row.rms < 2.0 * NOISE
