"""Derivatives of MuJoCo runs along the motion are those of differences of runs."""

from dataclasses import replace

import numpy as np
import pytest

import unmodeled
from unmodeled.data import Record
from unmodeled.fit.mjcf_laws import LAWS
from unmodeled.fit.mjcf_linear import _Linear, columns_of
from unmodeled.fit.mjcf_runs import Mjcf
from unmodeled.models.model import Candidate, SensitivityRequest, difference_sensitivities
from unmodeled.search.identifiable import told_apart

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body name="upper" pos="0 0 1"><joint name="hip" axis="0 1 0" damping=".3"
 frictionloss=".1" armature=".01"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".8"/>
<body name="fore" pos=".25 0 0"><joint name="knee" axis="0 1 0" damping=".12" armature=".005"/>
<geom type="capsule" fromto="0 0 0 .22 0 0" size=".018" mass=".45"/><site name="tip" pos=".2 0 0"/>
</body></body></worldbody><actuator><position name="c1" joint="hip" kp="70" kv="1.5"/>
<position name="c2" joint="knee" kp="30" kv=".5"/></actuator>
<sensor><framepos name="place" objtype="site" objname="tip"/></sensor></mujoco>"""


@pytest.fixture
def ready(tmp_path):
    """The model, and a record whose interval is five and a half of its steps."""
    (tmp_path / "arm.xml").write_text(ARM)
    time = np.arange(0.0, 1.5, 0.025)
    inputs = {"c1": 0.5 * np.sin(7.0 * time), "c2": -0.4 + 0.4 * np.sin(11.0 * time)}
    function = Mjcf(tmp_path / "arm.xml", "", 0.0, "zero")
    seen = function(time, inputs, {"hip.damping": 0.5, "fore.payload": 0.1})
    outputs = {n: seen[n] for n in ("hip", "knee", "place.x", "place.z")}
    record = Record(name="run", time=time, inputs=inputs, outputs=outputs)
    model = unmodeled.mujoco(tmp_path / "arm.xml", parameters={"c1.kp": (None, 5.0)})
    return model.ready([record])


def asked(ready, **given):
    model, record = ready.model, ready.records[0]
    changes = tuple({n: np.cos(5.0 * record.time)} for n in ("c1", "c2"))
    return SensitivityRequest(
        record,
        np.array([p.value for p in model.parameters]),
        np.array([s.start for s in model.states()]),
        candidates=tuple(Candidate(e) for e in model.effects),
        input_changes=changes,
        **given,
    )


def test_they_are_those_of_runs_without_the_runs(ready):
    record = ready.records[0]
    free = {s.name: 1.0 for s in ready.model.states()}
    ready = replace(ready, records=(replace(record, start=replace(record.start, sd=free)),))
    request = asked(ready, rough=True)
    before = ready.model.simulations
    (found,) = ready.model.sensitivities([request])
    backlash = sum(c.name.endswith("backlash") for c in request.candidates)
    assert ready.model.simulations - before <= 1 + backlash  # these change the structure
    (exact,) = difference_sensitivities(ready.model, [request])
    np.testing.assert_array_equal(found.outputs, exact.outputs)
    pairs = [(c.name, found.d_candidates[..., k], exact.d_candidates[..., k])
             for k, c in enumerate(request.candidates)
             if c.name.rpartition(".")[2] not in LAWS]  # fmt: skip  # by sizes that are not small
    pairs += [("c1.kp", found.d_theta[..., 0], exact.d_theta[..., 0])]
    pairs += [(f"input {k}", found.d_inputs[..., k], exact.d_inputs[..., k]) for k in range(2)]
    pairs += [(f"start {k}", found.d_starts[..., k], exact.d_starts[..., k]) for k in range(4)]
    assert len(pairs) > 20
    for name, one, other in pairs:
        size = np.linalg.norm(other)
        assert np.linalg.norm(one - other) <= 0.08 * size, name
        assert size > 0.0 or name.endswith("force"), name


def test_numbers_of_joints_and_servos_need_no_steps_of_a_changed_model(ready, monkeypatch):
    """Their forces follow from their laws; a largest force that is not used changes nothing."""
    used = []
    monkeypatch.setattr(_Linear, "by_change", lambda *a: used.append(a[-1]) or 1 / 0)
    model, record = ready.model, ready.records[0]
    run = model._run(record, model._point([p.value for p in model.parameters]))
    names = ("hip.damping", "knee.stiffness", "knee.armature", "c1.kp", "c2.kv", "c1.gear")
    steps = {n: 0.01 * (model.mjcf.properties[n].value or 1.0) for n in names}
    changes = [[({n: run.parameters.get(n, model.mjcf.properties[n].value) + h}, 1.0 / h)]
               for n, h in steps.items()]  # fmt: skip
    found = columns_of(model.mjcf, run, changes, (), (), model.outputs)
    for column, (name, h) in zip(np.moveaxis(found, 2, 0), steps.items(), strict=True):
        value = model.mjcf.properties[name].value
        own = [{**run.parameters, name: value + k * h} for k in (0, 1)]
        one, other = (model.mjcf(record.time, record.inputs, values) for values in own)
        exact = np.array([(other[n] - one[n]) / h for n in model.outputs]).T
        assert np.linalg.norm(column - exact) < 0.06 * np.linalg.norm(exact), name
    assert not used


def test_a_measured_torque_is_that_of_the_servo_and_shows_its_numbers_at_once(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    time = np.arange(0.0, 1.0, 0.01)
    inputs = {"c1": 0.5 * np.sin(7.0 * time), "c2": -0.4 + 0.4 * np.sin(11.0 * time)}
    raw = mujoco.MjModel.from_xml_string(ARM)
    data, torque, seen = mujoco.MjData(raw), [], []
    for row in zip(*inputs.values(), strict=True):
        data.ctrl[:] = row
        mujoco.mj_forward(raw, data)
        seen.append(data.qpos.copy())
        torque.append(data.qfrc_actuator.copy())
        mujoco.mj_step(raw, data, 5)
    names = ("hip.position", "knee.position", "hip.torque", "knee.torque")
    outputs = dict(zip(names, np.hstack([seen, torque]).T, strict=True))
    record = Record(name="run", time=time, inputs=inputs, outputs=outputs)
    model = unmodeled.mujoco(tmp_path / "arm.xml")
    ready = model.ready([record])
    model, (record,) = ready.model, ready.records
    run = model._tabulated_run(record)
    plain = model.mjcf(time, inputs, run.parameters)
    for name in names:
        np.testing.assert_allclose(plain[name], outputs[name], atol=1e-3 * np.ptp(outputs[name]))
    for name, h in (
        ("c1.kp", 0.1),
        ("c2.kv", 0.01),
        ("hip.damping", 0.01),
        ("knee.armature", 1e-4),
    ):
        value = model.mjcf.properties[name].value
        run.parameters[name] = value
        found = columns_of(model.mjcf, run, [[({name: value + h}, 1.0 / h)]], (), (), names)
        other = model.mjcf(time, inputs, {**run.parameters, name: value + h})
        for k, n in enumerate(names):
            exact = (other[n] - plain[n]) / h
            assert np.linalg.norm(found[:, k, 0] - exact) < 0.08 * np.linalg.norm(exact), (name, n)
    assert "torque" not in model.mjcf.spec.to_xml()


def test_many_starts_need_no_runs_in_a_fit_either(ready):
    record = ready.records[0]
    free = {s.name: 1.0 for s in ready.model.states()}
    ready = replace(ready, records=(replace(record, start=replace(record.start, sd=free)),))
    request = replace(asked(ready), candidates=(), input_changes=())
    before = ready.model.simulations
    (found,) = ready.model.sensitivities([request])
    assert ready.model.simulations - before <= 3
    (exact,) = difference_sensitivities(ready.model, [request])
    np.testing.assert_allclose(found.d_theta, exact.d_theta)
    for k in range(4):
        gap = np.linalg.norm(found.d_starts[..., k] - exact.d_starts[..., k])
        assert gap < 0.02 * np.linalg.norm(exact.d_starts[..., k])


def test_exact_ones_are_made_by_runs(ready):
    request = asked(ready)
    (found,) = ready.model.sensitivities([request])
    (exact,) = difference_sensitivities(ready.model, [request])
    np.testing.assert_array_equal(found.d_candidates, exact.d_candidates)


def test_sizes_need_no_trials(ready):
    """Each size changes the channel that it moves most by the same share of its motion."""
    model, record = ready.model, ready.records[0]
    told = [n for n in ready.notes if "expected sizes, from their influence" in n]
    assert "hip.damping" in told[0]
    by_name = {e.name: e for e in model.effects}
    motion = np.array([np.std(record.outputs[n]) for n in model.outputs])
    plain = model.mjcf(record.time, record.inputs, {})
    shares = []
    for name in ("hip.damping", "knee.damping", "fore.payload", "c2.kv"):
        value = model.mjcf.properties[name].value + by_name[name].scale
        seen = model.mjcf(record.time, record.inputs, {name: value})
        moved = [np.sqrt(np.mean((seen[n] - plain[n]) ** 2)) for n in model.outputs]
        shares.append(max(moved / motion))
    assert max(shares) < 2.0 * min(shares)
    assert model.simulations < 30


@pytest.mark.parametrize("limit", [4.0, 60.0])
def test_a_largest_force_gets_a_size_whether_it_is_reached_or_not(tmp_path, limit):
    """A servo that never reaches its limit shows only a smaller one."""
    text = ARM.replace('kp="70" kv="1.5"', f'kp="70" kv="1.5" forcerange="-{limit} {limit}"')
    (tmp_path / "arm.xml").write_text(text)
    time = np.arange(0.0, 1.5, 0.025)
    inputs = {"c1": 0.5 * np.sin(7.0 * time), "c2": -0.4 + 0.4 * np.sin(11.0 * time)}
    model = unmodeled.mujoco(tmp_path / "arm.xml")
    outputs = {n: v for n, v in model.mjcf(time, inputs, {}).items() if n in ("hip", "knee")}
    ready = model.ready([Record(name="run", time=time, inputs=inputs, outputs=outputs)])
    (force,) = [e for e in ready.model.effects if e.name == "c1.force"]
    assert 0.0 < force.scale < limit
    assert force.sign == (0 if limit < 60.0 else -1)
    seen = ready.model.mjcf(time, inputs, {"c1.force": limit - force.scale})
    assert np.abs(seen["hip"] - outputs["hip"]).max() > 1e-3


def test_a_check_tells_which_numbers_the_motions_cannot_tell_apart(ready):
    """Damping of a joint and of its servo are one law; a joint that rests shows no number of it."""
    model, (record,) = unmodeled.mujoco(ready.model.mjcf.path), ready.records
    told = unmodeled.check(model, record).identifiability
    (same,) = [t for t in told if "no motion tells them apart" in t]
    assert "hip.damping and c1.kv" in same
    assert "knee.damping and c2.kv" in same
    assert told_apart(ready.model, [record], 0.0)[0].startswith("left out")
    line = unmodeled.Simulator(lambda time, inputs, p: {"hip": p["a"] * inputs["c1"]},
                               parameters={"a": (1.0, 0.1, "rad")})  # fmt: skip
    assert told_apart(line.ready([record]).model, [record], 3.0) == ()
