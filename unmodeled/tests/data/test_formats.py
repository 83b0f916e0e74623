"""Files of other programs as records: HDF5, Parquet, Feather, MCAP, LeRobot, ROS bags as CSV."""

import json
import sys

import h5py
import numpy as np
import pandas as pd
import pytest

from unmodeled.data import ReadOptions, read_record, read_records
from unmodeled.errors import DataError

TIME = 0.01 * np.arange(50)
FORCE = np.sin(20.0 * TIME)
X = 1e-3 * np.cos(15.0 * TIME)
START = 1_700_000_000 * 10**9  # ns since 1970


def same(record):
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=2e-7)
    np.testing.assert_allclose(record.inputs["force"], FORCE, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(record.outputs["x"], X, rtol=1e-6, atol=1e-9)


def test_hdf5_with_groups_and_a_table(tmp_path):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["time"] = TIME
        group = file.create_group("rig")
        group["force"] = FORCE
        group["force"].attrs["units"] = "N"
        group["joints"] = np.column_stack([X, 2.0 * X])
    options = ReadOptions(columns={"x": "rig.joints.0"}, units={"x": "m"})
    same(read_record(path, inputs=["force"], outputs=["x"], options=options))
    assert read_record(path, inputs=["force"], outputs=["force"]).inputs["force"][3] == FORCE[3]


@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_a_frame(tmp_path, kind):
    pytest.importorskip("pyarrow")
    path = tmp_path / f"run.{kind}"
    frame = pd.DataFrame({"time [ms]": 1e3 * TIME, "force [N]": FORCE, "x [mm]": 1e3 * X})
    getattr(frame, f"to_{kind}")(path)
    same(read_record(path, inputs=["force"], outputs=["x"], units={"x": "m"}))


def test_dates_of_the_index_are_the_clock(tmp_path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "run.parquet"
    when = pd.Timestamp("2026-11-27T12:00:00Z") + pd.to_timedelta(TIME, unit="s")
    frame = pd.DataFrame({"force": FORCE, "x": X, "state": "ok"}, index=when)
    frame.to_parquet(path)
    same(read_record(path, inputs=["force"], outputs=["x"]))


def test_episodes_of_lerobot_are_runs_with_named_joints(tmp_path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    names = {"observation.state": ["elbow.pos", "wrist.pos"], "action": {"motors": ["elbow"]}}
    features = {k: {"dtype": "float32", "names": v} for k, v in names.items()}
    features["timestamp"] = {"dtype": "float32", "names": None}
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"features": features}))
    count = TIME.size
    pd.DataFrame(
        {
            "observation.state": list(np.tile(np.column_stack([X, -X]), (2, 1))),
            "action": list(np.tile(FORCE, 2)[:, None]),
            "timestamp": np.tile(TIME, 2),
            "frame_index": np.tile(np.arange(count), 2),
            "episode_index": np.repeat([0, 1], count),
            "index": np.arange(2 * count),
        }
    ).to_parquet(path)
    columns = {"x": "observation.state.elbow.pos", "force": "action.elbow"}
    options = ReadOptions(columns=columns)
    records = read_records([path], inputs=["force"], outputs=["x"], options=options)
    assert [r.name for r in records] == ["file-000-0", "file-000-1"]
    for record in records:
        same(record)


def test_topics_of_mcap_in_json(tmp_path):
    """The slow topic is interpolated to the times of the fast one, where both are."""
    writer = pytest.importorskip("mcap.writer")
    path = tmp_path / "run.mcap"
    slow = np.arange(-0.005, 0.6, 0.02)
    with path.open("wb") as file:
        out = writer.Writer(file)
        out.start()
        schema = out.register_schema("s", "jsonschema", b"{}")
        for topic, clock, message in (
            ("/rig", TIME, lambda i: {"force": FORCE[i], "x": X[i], "note": "ok"}),
            ("/thermometer", slow, lambda i: {"data": 300.0 + slow[i]}),
        ):
            channel = out.register_channel(topic, "json", schema)
            for i, t in enumerate(clock):
                at = START + round(1e9 * t)
                out.add_message(channel, at, json.dumps(message(i)).encode(), at)
        out.finish()
    record = read_record(path, inputs=["force"], outputs=["x", "thermometer"])
    same(record)
    want = 300.0 + record.time - 0.005
    np.testing.assert_allclose(record.outputs["thermometer"], want, atol=1e-6)
    assert any("thermometer: interpolated" in n for n in record.notes)


JOINT_STATE = b"""std_msgs/Header header
string[] name
float64[] position
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def test_messages_of_ros_2_have_the_names_of_the_joints(tmp_path):
    writer = pytest.importorskip("mcap_ros2.writer")
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        out = writer.Writer(file)
        schema = out.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE.decode())
        for i, t in enumerate(TIME):
            at = START + round(1e9 * t)
            stamp = {"sec": at // 10**9, "nanosec": at % 10**9}
            message = {
                "header": {"stamp": stamp, "frame_id": ""},
                "name": ["slide", "arm"],
                "position": [X[i], 0.0],
                "effort": [FORCE[i], 1.0],
            }
            out.write_message("/joint_states", schema, message, at, at)
        out.finish()
    columns = {"x": "joint_states.position.slide", "force": "joint_states.effort.slide"}
    options = ReadOptions(columns=columns)
    same(read_record(path, inputs=["force"], outputs=["x"], options=options))


def test_a_ros_bag_as_csv_counts_nanoseconds(tmp_path):
    path = tmp_path / "bag.csv"
    stamps = [START + round(1e9 * t) for t in TIME]
    rows = zip(stamps, stamps, FORCE, X, strict=True)
    path.write_text(
        "%time,field.header.stamp,field.force,field.x\n"
        + "".join(f"{a},{b},{f},{x}\n" for a, b, f, x in rows)
    )
    record = read_record(path, inputs=["force"], outputs=["x"])
    same(record)
    assert record.time[0] == 0.0
    assert any("ns since 1970" in n for n in record.notes)


@pytest.mark.parametrize(
    ("kind", "package", "extra"),
    [
        ("parquet", "pyarrow", "parquet"),
        ("feather", "pyarrow", "parquet"),
        ("mcap", "mcap", "mcap"),
    ],
)
def test_a_missing_package_has_a_cure(tmp_path, monkeypatch, kind, package, extra):
    path = tmp_path / f"run.{kind}"
    path.write_bytes(b"PAR1")
    for name in [m for m in sys.modules if m.split(".")[0] == package]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(DataError, match=rf"pip install {package} \(extra '{extra}'"):
        read_record(path)


@pytest.mark.parametrize("kind", ["h5", "parquet", "feather", "mcap"])
def test_a_damaged_file_is_one_message(tmp_path, kind):
    path = tmp_path / f"run.{kind}"
    path.write_bytes(b"nothing of this kind" * 20)
    with pytest.raises(DataError, match=f"run.{kind}: "):
        read_record(path)
