"""Logs of robots: LeRobot, SAGE, BAM, ROS 2 bags and tables, with joints, units and clocks."""

import json
import sqlite3
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from unmodeled.data import ReadOptions
from unmodeled.data import logs as module
from unmodeled.data.files import read, read_each
from unmodeled.data.mapping import Signals
from unmodeled.data.robots import Joint, Log, Signal, records_of
from unmodeled.errors import DataError

JOINTS = (Joint("lift", "lift", "rad", -2.0, 2.0), Joint("gripper", "grip", "rad", -0.2, 1.8))
COUNT = 40
GOAL, PLACE = 0.5 * np.sin(0.3 * np.arange(COUNT)), 0.5 * np.sin(0.3 * np.arange(COUNT) - 0.1)
HAND = 0.01 * np.arange(COUNT)  # share of the range


def records(path, joints=JOINTS, tell=None, **options):
    (group,) = read_each([path], Signals(joints=joints, tell=tell), ReadOptions(**options))
    return group


def same(record, atol=1e-9):
    assert set(record.inputs) == {"lift", "grip"}
    np.testing.assert_allclose(record.inputs["lift"], GOAL, atol=atol)
    np.testing.assert_allclose(record.outputs["lift.position"], PLACE, atol=atol)
    np.testing.assert_allclose(record.outputs["gripper.position"], -0.2 + 2.0 * HAND, atol=atol)
    assert record.sensors["lift.position"].unit == record.input_units["lift"] == "rad"


# ------------------------------------------------------------------------------------ LeRobot


def lerobot(folder, *, version, names=("lift.pos", "gripper.pos"), scale=20.0):
    pytest.importorskip("pyarrow")
    goals = np.column_stack([np.rad2deg(GOAL), 100.0 * HAND])
    states = np.column_stack([np.rad2deg(PLACE), 100.0 * HAND])
    features = {k: {"dtype": "float32", "shape": [2], "names": list(names)}
                for k in ("action", "observation.state")}  # fmt: skip
    (folder / "meta").mkdir(parents=True)
    info = {"codebase_version": version, "fps": scale, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (folder / "data" / "chunk-000").mkdir(parents=True)
    frame = pd.DataFrame({
        "action": list(goals), "observation.state": list(states),
        "timestamp": np.float32(np.arange(COUNT) / scale), "frame_index": np.arange(COUNT),
        "episode_index": 0,
    })  # fmt: skip
    if version == "v3.0":
        both = pd.concat([frame, frame.assign(episode_index=1)])
        both.to_parquet(folder / "data" / "chunk-000" / "file-000.parquet")
    else:
        for k in range(2):
            one = frame.assign(episode_index=k)
            one.to_parquet(folder / "data" / "chunk-000" / f"episode_{k:06d}.parquet")
    return folder


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_data_set_of_lerobot_is_one_record_an_episode(tmp_path, version):
    table = []
    folder = lerobot(tmp_path / "set", version=version)
    found = records(folder, tell=lambda path, rows: table.extend(rows))
    assert [r.name for r in found] == ["episode0", "episode1"]
    for record in found:
        same(record)
        np.testing.assert_allclose(np.diff(record.time), 0.05, rtol=1e-12)  # times are float32
    by_name = {r.signal: r for r in table}
    assert by_name["lift goal"].channel == "lift"
    assert by_name["lift goal"].unit == "deg"
    assert "--unit lift=rad" in by_name["lift position"].guessed
    assert by_name["gripper position"].unit == "0 to 100"
    assert read(folder, model=SimpleNamespace(
        inputs=(), outputs=(), input_modes={}, units={}, input_names={}, any_inputs=False,
        joints=JOINTS))[0].samples == COUNT  # fmt: skip


def test_joints_with_other_names_are_assigned_by_their_order_or_as_stated(tmp_path):
    folder = lerobot(tmp_path / "set", version="v3.0", names=("Elbow.pos", "Jaw.pos"))
    table = []
    same(records(folder, tell=lambda path, rows: table.extend(rows))[0])
    assert all("--column" in r.guessed for r in table)
    (first, _) = records(folder, columns={"gripper": "Elbow"})
    assert set(first.inputs) == {"grip"}
    three = (*JOINTS, Joint("wrist", "wrist"))
    with pytest.raises(DataError, match=r"Elbow, Jaw are none of the model.*--column lift=NAME"):
        records(folder, joints=three)
    (other, _) = records(folder, units={"Elbow": "rad", "Jaw": "deg"})
    np.testing.assert_allclose(other.inputs["lift"], np.rad2deg(GOAL))
    np.testing.assert_allclose(other.inputs["grip"], np.deg2rad(100.0 * HAND))


# --------------------------------------------------------------------------------- SAGE and BAM


def sage(folder, names=("lift", "gripper"), goal_step=20_000.0):
    folder.mkdir()
    (folder / "joint_list.txt").write_text("\n".join(names) + "\n")
    hand = -0.2 + 2.0 * HAND
    lines = ["type,timestamp,positions"]
    for k, (a, b) in enumerate(zip(GOAL.tolist(), hand.tolist(), strict=True)):
        lines.append(f'CONTROL,{5.0 + goal_step * k},"[{a!r}, {b!r}]"')
    (folder / "control.csv").write_text("\n".join(lines))
    lines = ["type,timestamp,positions,velocities,torques"]
    for k, (a, b) in enumerate(zip(PLACE.tolist(), hand.tolist(), strict=True)):
        lines.append(f'STATE_MOTOR,{5.0 + 2e4 * k},"[{a!r}, {b!r}]","[0, 0]","[0.1, 0.2]"')
    (folder / "state_motor.csv").write_text("\n".join(lines))
    return folder


def test_a_motion_of_sage_is_its_folder_or_one_of_its_files(tmp_path):
    folder = sage(tmp_path / "wave")
    table = []
    (record,) = records(folder, tell=lambda path, rows: table.extend(rows))
    same(record)
    assert record.name == "wave"
    assert record.time[-1] == pytest.approx(0.02 * (COUNT - 1))
    assert {r.signal: r.channel for r in table}["lift torque"] == ""
    same(records(folder / "control.csv")[0])
    same(records(tmp_path)[0])
    (folder / "joint_list.txt").write_text("lift\n")
    with pytest.raises(DataError, match=r"positions has 2 numbers, and joint_list.txt 1 names"):
        records(folder)
    (folder / "control.csv").write_text("type,timestamp,positions\nCONTROL,5,[1 2\n")
    with pytest.raises(DataError, match=r"control.csv"):
        records(folder)


def test_a_goal_is_held_until_the_next_one_of_its_own_clock(tmp_path):
    (record,) = records(sage(tmp_path / "wave", goal_step=40_000.0))
    np.testing.assert_array_equal(record.inputs["lift"][:-1:2], GOAL[: COUNT // 2])
    np.testing.assert_array_equal(record.inputs["lift"][1::2], GOAL[: COUNT // 2])


def test_a_clock_that_jitters_is_made_even():
    time = 0.02 * np.arange(COUNT) + 1e-3 * np.sin(np.arange(COUNT))
    signals = (Signal("lift", "position", time, 3.0 * time, "rad"),
               Signal("lift", "goal", time, time, "rad"))  # fmt: skip
    found, _ = records_of(Path("x"), [Log("a", signals)], JOINTS, columns={}, units={})
    np.testing.assert_allclose(np.diff(found[0].time), np.diff(found[0].time)[0], rtol=1e-9)
    even = 3.0 * (found[0].time + time[0])
    np.testing.assert_allclose(found[0].outputs["lift.position"], even, atol=1e-12)
    assert "interpolated to even ones" in found[0].notes[0]


def test_a_file_of_bam_ends_where_the_torque_is_off(tmp_path):
    entries = [
        {"timestamp": 0.005 * k, "position": PLACE[k], "goal_position": GOAL[k], "speed": 0.0,
         "load": 4, "torque_enable": k < 30} for k in range(COUNT)
    ]  # fmt: skip
    path = tmp_path / "log.json"
    path.write_text(json.dumps({"mass": 0.49, "motor": "xl330", "entries": entries}))
    (record,) = records(path, joints=[Joint("swing", "servo")])
    np.testing.assert_array_equal(record.inputs["servo"], GOAL[:30])
    np.testing.assert_array_equal(record.outputs["swing.position"], PLACE[:30])
    assert record.conditions["mass"] == 0.49
    assert "samples 0 to 30 of 40" in record.notes[0]
    assert [r.name for r in records(tmp_path, joints=[Joint("swing", "servo")])] == ["log"]
    (alone,) = read(path)
    assert (set(alone.inputs), set(alone.outputs)) == ({"xl330.goal"}, {"xl330"})
    del entries[3]["position"]
    path.write_text(json.dumps({"entries": entries}))
    with pytest.raises(DataError, match="an entry has no number 'position'"):
        records(path)


# ---------------------------------------------------------------------------------------- bags


def of_joints(values, names=("lift", "gripper")):
    stamp = {"sec": 0, "nanosec": 0}
    return {"header": {"stamp": stamp, "frame_id": ""}, "name": list(names),
            "position": list(values), "velocity": [], "effort": []}  # fmt: skip


def database(path, *, definitions=False):
    """A bag of ROS 2 with states and goals of joints, as rosbag2 stores it."""
    dynamic = pytest.importorskip("mcap_ros2._dynamic")
    from unmodeled.data.bags import _DEFINITIONS

    kind = "sensor_msgs/msg/JointState"
    text = f"\n{'=' * 80}\n".join(_DEFINITIONS[kind])
    encode = dynamic.serialize_dynamic(kind, text)[kind]
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, "
                     "serialization_format TEXT, offered_qos_profiles TEXT)")  # fmt: skip
        base.execute("CREATE TABLE messages (id INTEGER, topic_id INTEGER, timestamp INTEGER, "
                     "data BLOB)")  # fmt: skip
        base.execute(f"INSERT INTO topics VALUES (1, '/joint_states', '{kind}', 'cdr', '')")
        base.execute(f"INSERT INTO topics VALUES (2, '/joint_commands', '{kind}', 'cdr', '')")
        base.execute("INSERT INTO topics VALUES (3, '/odd', 'own_msgs/msg/Odd', 'cdr', '')")
        base.execute("INSERT INTO messages VALUES (0, 3, 5, x'00')")
        hand = -0.2 + 2.0 * HAND
        for k in range(COUNT):
            for topic, joint in ((2, GOAL), (1, PLACE)):
                data = encode(of_joints([joint[k], hand[k]]))
                base.execute("INSERT INTO messages VALUES (?, ?, ?, ?)",
                             (k, topic, 10**18 + 10**7 * k, data))  # fmt: skip
    base.close()


def test_a_bag_of_ros_2_in_sqlite(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    database(folder / "bag_0.db3")
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    for path in (folder, folder / "bag_0.db3"):
        (record,) = records(path)
        same(record)
        np.testing.assert_allclose(np.diff(record.time), 0.01, rtol=1e-6)
    (plain,) = read(folder / "bag_0.db3")
    assert {"joint_states.position.lift", "joint_commands.position.lift"} <= {*plain.outputs}
    (tmp_path / "no.db3").write_bytes(b"nothing")
    with pytest.raises(DataError, match="is no SQLite file"):
        records(tmp_path / "no.db3")


def test_goals_and_states_of_an_mcap(tmp_path):
    writer = pytest.importorskip("mcap.writer")
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        out = writer.Writer(file)
        out.start()
        schema = out.register_schema("sensor_msgs/msg/JointState", "ros2msg", text().encode())
        ids = {t: out.register_channel(t, "cdr", schema) for t in ("/joint_states", "/arm/command")}
        hand = -0.2 + 2.0 * HAND
        for k in range(COUNT):
            for topic, joint in (("/arm/command", GOAL), ("/joint_states", PLACE)):
                at = 10**18 + 10**7 * k
                out.add_message(ids[topic], at, encoded([joint[k], hand[k]]), at)
        out.finish()
    same(records(path)[0])


def text():
    from unmodeled.data.bags import _DEFINITIONS

    return f"\n{'=' * 80}\n".join(_DEFINITIONS["sensor_msgs/msg/JointState"])


def encoded(values):
    dynamic = pytest.importorskip("mcap_ros2._dynamic")
    kind = "sensor_msgs/msg/JointState"
    return dynamic.serialize_dynamic(kind, text())[kind](of_joints(values))


def test_low_states_have_joints_by_their_order():
    from unmodeled.data.bags import Message, _of_joints

    motors = [SimpleNamespace(q=0.1 * k, dq=0.0, tau_est=0.5) for k in range(3)]
    state = SimpleNamespace(motor_state=motors)
    found = list(_of_joints(Message("lowstate", 0, state)))
    assert ("motor 2", "position", pytest.approx(0.2)) in found
    command = SimpleNamespace(motor_cmd=[SimpleNamespace(q=0.3)])
    assert list(_of_joints(Message("lowcmd", 0, command))) == [("motor 0", "goal", 0.3)]
    array = SimpleNamespace(layout=None, data=[1.0, 2.0])
    goals = list(_of_joints(Message("arm/commands", 0, array)))
    assert goals == [("motor 0", "goal", 1.0), ("motor 1", "goal", 2.0)]


# ------------------------------------------------------------------------- tables, other readers


def test_columns_that_name_joint_and_role_need_no_options(tmp_path):
    path = tmp_path / "run.csv"
    pd.DataFrame({
        "time": 0.02 * np.arange(COUNT), "action.lift.pos": np.rad2deg(50 * GOAL),
        "observation.state.lift.pos": np.rad2deg(PLACE), "gripper_goal": HAND,
        "gripper_pos": HAND, "lift_velocity": 0.0,
    }).to_csv(path, index=False)  # fmt: skip
    (record,) = records(path)
    np.testing.assert_allclose(record.inputs["lift"], 50 * GOAL)
    np.testing.assert_allclose(record.outputs["lift.position"], PLACE)
    assert set(record.outputs) == {"lift.position", "gripper.position"}


def test_a_package_adds_a_reader_by_an_entry_point(tmp_path, monkeypatch):
    time = 0.1 * np.arange(5)

    class Own:
        @staticmethod
        def read_logs(path):
            if path.suffix != ".own":
                return None
            return [Log("first", (Signal("lift", "position", time, time, "rad"),
                                  Signal("lift", "goal", time, 2.0 * time, "rad")))]  # fmt: skip

    point = SimpleNamespace(load=lambda: Own)
    monkeypatch.setattr(module, "entry_points", lambda group: [point] * (group == module.GROUP))
    module._installed.cache_clear()
    try:
        (tmp_path / "run.own").write_text("")
        (record,) = records(tmp_path / "run.own")
        np.testing.assert_array_equal(record.inputs["lift"], 2.0 * time)
    finally:
        module._installed.cache_clear()
