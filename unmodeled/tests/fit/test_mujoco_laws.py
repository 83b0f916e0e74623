"""Laws of servos that MJCF has no word for, and mounts: in runs, in derivatives, in a remedy."""

import numpy as np
import pytest
from PIL import Image

import unmodeled
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit.mjcf_linear import columns_of
from unmodeled.fit.mjcf_runs import Mjcf
from unmodeled.fit.running import Run
from unmodeled.search.compare import simulated

mujoco = pytest.importorskip("mujoco")

LIFT = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody><body name="upper"><joint name="lift" axis="0 1 0" damping=".3" frictionloss=".1"
 armature=".02"/><geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".8"/>
<body name="fore" pos=".25 0 0"><joint name="bend" axis="0 1 0" damping=".1" armature=".01"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".4"/>
<body name="tool" pos=".2 0 0"><geom size=".02" mass=".1"/><site name="tip" pos=".05 0 0"/></body>
</body></body></worldbody><actuator>
<position name="up" joint="lift" kp="60" kv="2" forcerange="-8 8" ctrlrange="-1 1"/>
<position name="in" joint="bend" kp="20" kv="1" gear="2"/></actuator>
<sensor><framepos name="at" objtype="site" objname="tip"/></sensor></mujoco>"""
TIME = np.arange(60) * 0.02
GOALS = {"up": 0.4 + 0.9 * np.sin(5.0 * TIME), "in": 0.5 * np.sin(7.0 * TIME)}


@pytest.fixture
def path(tmp_path):
    at = tmp_path / "lift.xml"
    at.write_text(LIFT)
    return at


def by_hand(path, size, law):
    """Positions of both joints with a law that is written out here."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data, seen = mujoco.MjData(model), []
    for k in range(TIME.size):
        seen.append(data.qpos.copy())
        data.ctrl[:] = GOALS["up"][k], GOALS["in"][k]
        for _ in range(10):
            goal = np.clip(data.ctrl[0], -1.0, 1.0)
            angle, rate = data.qpos[0], data.qvel[0]
            force = np.clip(60.0 * (goal - angle) - 2.0 * rate, -8.0, 8.0)
            if law == "lift.load_friction":
                model.dof_frictionloss[0] = 0.1 + size * abs(force)
            elif law == "lift.one_sided_friction":
                model.dof_frictionloss[0] = 0.1 + size * np.sign(rate)
            elif law == "up.dead_band":
                error = goal - angle
                beyond = np.sign(error) * max(abs(error) - size, 0.0)
                model.actuator_gainprm[0, 0] = model.actuator_biasprm[0, 1] = 0.0
                model.actuator_biasprm[0, 0] = 60.0 * beyond
            else:
                model.actuator_forcerange[0] = -8.0 - 8.0 * size * rate, 8.0 - 8.0 * size * rate
                if size * rate > 0.0:
                    model.actuator_forcerange[0, 0] = -8.0
                else:
                    model.actuator_forcerange[0, 1] = 8.0
            mujoco.mj_step(model, data)
    return np.array(seen)


SIZES = {
    "lift.load_friction": 0.3,
    "lift.one_sided_friction": 0.08,
    "up.dead_band": 0.02,
    "up.speed_loss": 0.15,
}


@pytest.mark.parametrize("law", SIZES)
def test_a_law_is_that_of_its_formula_and_the_remedy_holds_it(path, law):
    model = unmodeled.mujoco(path)
    seen = model.mjcf(TIME, GOALS, {law: SIZES[law]})
    plain = model.mjcf(TIME, GOALS, {})
    wanted = by_hand(path, SIZES[law], law)
    moved = np.abs(seen["lift.position"] - plain["lift.position"]).max()
    assert moved > 3e-3
    np.testing.assert_allclose(seen["lift.position"], wanted[:, 0], atol=1e-9 + 1e-6 * moved)
    # The copies of the model are as before, and the remedy simulates the same by MuJoCo alone.
    again = model.mjcf(TIME, GOALS, {})
    np.testing.assert_array_equal(again["lift.position"], plain["lift.position"])
    (path.parent / "fixed.xml").write_text(model.mjcf.patched({law: SIZES[law]}).to_xml())
    fixed = mujoco.MjModel.from_xml_path(str(path.parent / "fixed.xml"))
    data, laws = mujoco.MjData(fixed), unmodeled.servo_laws(fixed)
    for k in range(TIME.size):
        assert data.qpos[0] == pytest.approx(wanted[k, 0], abs=1e-4 * moved)
        data.ctrl[:] = GOALS["up"][k], GOALS["in"][k]
        for _ in range(10):
            laws(data)
            mujoco.mj_step(fixed, data)
    own = unmodeled.mujoco(path.parent / "fixed.xml").mjcf(TIME, GOALS, {})
    np.testing.assert_allclose(own["lift.position"], wanted[:, 0], atol=1e-4 * moved)


def test_a_law_is_known_along_the_motion(path):
    """The direction of a first change needs no run."""
    function = Mjcf(path, "", 0.0, "zero")
    plain = function(TIME, GOALS, {})
    names = ["lift.position", "bend.position"]
    for law, most in SIZES.items():
        size = 0.1 * most if law != "up.speed_loss" else most
        run = Run("run", TIME, GOALS, dict.fromkeys(SIZES, 0.0))
        column = columns_of(function, run, [[({law: size}, 1.0)]], (), (), names)[..., 0]
        seen = function(TIME, GOALS, {law: size})
        change = np.column_stack([seen[n] - plain[n] for n in names])
        if law == "up.speed_loss":  # a limit is reached or not: no first change tells it well
            continue
        alike = np.sum(column * change) / np.linalg.norm(column) / np.linalg.norm(change)
        assert alike > 0.97, law


def record(path, values, seed=1, name="run"):
    random, function = np.random.default_rng(seed), Mjcf(path, "", 0.0, "zero")
    goals = {n: 0.4 * np.sin(random.uniform(4.0, 9.0) * TIME) for n in GOALS}
    seen = function(TIME, goals, values)
    outputs = {n: seen[n] + 2e-4 * random.standard_normal(TIME.size)
               for n in ("lift", "bend", "at.x", "at.y", "at.z")}  # fmt: skip
    sensors = {
        n: Sensor(name=n, sigma=2e-4, unit="m" if n[:3] == "at." else "rad") for n in outputs
    }
    return Record(name=name, time=TIME, inputs=goals, outputs=outputs, sensors=sensors)


CAUSES = {"lift.load_friction": 0.3, "bend.zero": 0.05, "tool.pos_x": 0.23, "tool.turn_z": 0.2,
          "in.dead_band": 0.03}  # fmt: skip


def diagnosed(path, cause, value, effects=None):
    """The report names the cause; its file, simulated again, leaves what the report says."""
    model = unmodeled.mujoco(path)
    records = [record(path, {cause: value}, s, f"run{s}") for s in (1, 2)]
    report = model.diagnose(records, effects=effects)
    assert [n.cause for n in report.named] == [cause]
    change = value - model.mjcf.properties[cause].value
    assert report.named[0].magnitude == pytest.approx(change, rel=0.05)
    again = unmodeled.mujoco(report.model.write(path.parent / "fixed.xml")).ready(records)
    left = [(simulated(again.model, r), r.outputs) for r in again.records]
    for channel in report.channels:
        rms = np.sqrt(np.mean([(x[channel.name] - y[channel.name]) ** 2 for x, y in left]))
        assert rms == pytest.approx(channel.explained, rel=0.02), channel.name
    return report, records


@pytest.mark.parametrize("cause", ["lift.load_friction", "bend.zero"])
def test_a_remedy_leaves_what_the_page_says(path, cause):
    few = [cause, "lift.damping", "lift.frictionloss", "tool.payload", "offset of input up"]
    diagnosed(path, cause, CAUSES[cause], few)


@pytest.mark.slow
@pytest.mark.parametrize("cause", CAUSES)
def test_causes_of_servos_and_mounts_are_named_among_all(path, cause):
    diagnosed(path, cause, CAUSES[cause])


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_wrong(path):
    report = unmodeled.mujoco(path).diagnose([record(path, {}, s, f"run{s}") for s in (1, 2)])
    assert report.verdict.name == "NO_GAP"


def test_mounts_are_candidates_only_where_something_is_tracked(path):
    names = {e.name for e in unmodeled.mujoco(path).effects}
    assert {"tool.pos_x", "tool.turn_y", "fore.length", "lift.zero"} <= names
    assert "tool.length" not in names  # it is that of its place
    path.write_text(LIFT.partition("<sensor>")[0] + "</mujoco>")
    assert not {n for n in names if "tool.pos" in n or ".length" in n} & {
        e.name for e in unmodeled.mujoco(path).effects
    }


def test_numbers_of_laws_without_a_servo_are_refused(path):
    with pytest.raises(InvalidParameter, match=r"got str, expected a mujoco\.MjModel"):
        unmodeled.servo_laws("lift.xml")
    number = '<custom><numeric name="unmodeled.lift.load_fricton" data="1"/></custom></mujoco>'
    model = mujoco.MjModel.from_xml_string(LIFT.replace("</mujoco>", number))
    with pytest.raises(InvalidParameter, match=r"lift\.load_fricton of the model is no law"):
        unmodeled.servo_laws(model)


def test_a_video_shows_the_robot_and_a_picture_its_joints(path, monkeypatch):
    monkeypatch.setattr("unmodeled.report.robot._rendered", lambda *_: 1 / 0)  # no graphics
    report, records = diagnosed(path, "lift.load_friction", 0.5, ["lift.load_friction"])
    with Image.open(report.model.film(path.parent / "film.gif", records[0])) as video:
        assert (video.n_frames, video.size) == (15, (900, 260))
        video.seek(8)
        assert len(np.unique(np.asarray(video.convert("L")))) > 3
    titles = [a.get_title(loc="left") for a in report.plot("channels").axes]
    assert [t.partition(":")[0] for t in titles] == ["lift", "bend", "at.x", "at.y", "at.z"]
    assert all("rms" in t for t in titles)
    with pytest.raises(InvalidParameter, match=r"expected the name of a \.gif"):
        report.model.film(path.parent / "film.mp4", records[0])
