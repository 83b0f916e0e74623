"""Bags of ROS 2 and MCAP: their messages as columns, or as logs of robots.

A bag is an MCAP file, an SQLite file (.db3), or the folder of one with its ``metadata.yaml``.
"""

from __future__ import annotations

import io
import json
import re
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from unmodeled.data.formats import MOST_COLUMNS, reading
from unmodeled.data.robots import Kind, Log, Signal, with_units
from unmodeled.data.series import MOST_NUMBERS, Columns, limit_text
from unmodeled.errors import DataError
from unmodeled.files import LARGEST_FILE, LARGEST_TABLE, is_file, open_input, plain_text, read_input

#: Words in a topic of goals.
_GOALS = re.compile(r"command|cmd|goal|target|desired|reference|set_?point", re.IGNORECASE)
#: Definitions of messages that bags before ROS 2 Iron do not contain (from their .msg files).
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
_LAYOUT = (
    "MSG: std_msgs/MultiArrayLayout\nstd_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    "MSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride",
)
_DEFINITIONS = {
    "sensor_msgs/msg/JointState": ("std_msgs/Header header\nstring[] name\nfloat64[] position\n"
                                   "float64[] velocity\nfloat64[] effort", _HEADER, _TIME),
    "std_msgs/msg/Float64MultiArray": (
        "std_msgs/MultiArrayLayout layout\nfloat64[] data", *_LAYOUT),
    "trajectory_msgs/msg/JointTrajectory": (
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint[] points", _HEADER, _TIME,
        "MSG: trajectory_msgs/JointTrajectoryPoint\nfloat64[] positions\nfloat64[] velocities\n"
        "float64[] accelerations\nfloat64[] effort\nbuiltin_interfaces/Duration time_from_start",
        "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec"),
}  # fmt: skip


@dataclass(frozen=True)
class Message:
    """A message of a bag."""

    topic: str
    time: int
    """Time at which it was logged [ns]."""
    content: Any
    """Decoded message; None: its encoding is not known, which ``why`` tells."""
    why: str = ""


def messages(path: Path) -> Iterator[Message]:
    """Messages of a bag, in their order.

    Raises
    ------
    DataError
        A package is missing, or the file is damaged.
    """
    if path.suffix.lower() == ".db3":
        yield from _of_database(path)
        return
    with reading(path, "MCAP", "mcap", "mcap"):
        from mcap.reader import make_reader

        reader = make_reader(io.BytesIO(read_input(path, most=LARGEST_TABLE)))
        for schema, channel, message in reader.iter_messages():
            topic = plain_text(channel.topic.strip("/"))
            if channel.message_encoding == "json":
                yield Message(topic, message.log_time, json.loads(message.data))
            elif channel.message_encoding == "cdr" and schema and schema.encoding == "ros2msg":
                decode = _decoder(path, schema.name, schema.data.decode())
                yield Message(topic, message.log_time, decode(message.data))
            else:
                yield Message(topic, 0, None, f"messages in {channel.message_encoding}")


def _of_database(path: Path) -> Iterator[Message]:
    with open_input(path, most=LARGEST_FILE) as file:
        if file.read(15) != b"SQLite format 3":
            raise DataError(f"{path}: is no SQLite file, expected a bag of ROS 2")
    with (
        reading(path, "a bag of ROS 2", "mcap-ros2-support", "mcap"),
        closing(sqlite3.connect(f"file:{path.absolute()}?mode=ro&immutable=1", uri=True)) as base,
    ):
        topics = {i: (plain_text(str(n).strip("/")), str(kind)) for i, n, kind in
                  base.execute("SELECT id, name, type FROM topics")}  # fmt: skip
        known = {k: "\n====\n".join(parts) for k, parts in _DEFINITIONS.items()}
        there = {n for (n,) in base.execute("SELECT name FROM sqlite_master")}
        if "message_definitions" in there:
            known |= dict(base.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions "
                "WHERE encoding = 'ros2msg'"))  # fmt: skip
        told: set[int] = set()
        rows = base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp")
        for topic_id, time, data in rows:
            name, kind = topics[topic_id]
            if kind in known:
                yield Message(name, time, _decoder(path, kind, known[kind])(data))
            elif topic_id not in told:
                told.add(topic_id)
                yield Message(name, 0, None, f"{kind}: its definition is not in the file")


_decoders: dict[tuple[str, str], Any] = {}


def _decoder(path: Path, kind: str, definition: str) -> Any:
    """Function that decodes the messages of a type."""
    if (kind, definition) not in _decoders:
        with reading(path, "ROS 2", "mcap-ros2-support", "mcap"):
            from mcap_ros2.decoder import DecoderFactory

            data = "\n".join("=" * 80 if line.startswith("====") else line
                             for line in definition.splitlines()).encode()  # fmt: skip
            schema: Any = SimpleNamespace(id=0, name=kind, data=data, encoding="ros2msg")
            _decoders[kind, definition] = DecoderFactory().decoder_for("cdr", schema)
    return _decoders[kind, definition]


# ------------------------------------------------------------------------------------ columns


def read_messages(path: Path) -> Columns:
    """Numbers of all messages of a bag with JSON or ROS 2 messages, as ``topic.field``.

    The clock is the log time from the first message. Topics are interpolated to the times of the
    topic with the most messages.
    """
    columns = Columns()
    topics: dict[str, tuple[list[int], list[dict[str, float]]]] = {}
    count = 0
    for message in messages(path):
        if message.why:
            columns.left_out[message.topic] = message.why
            continue
        with reading(path, "a bag"):
            values = dict(_numbers(message.content, message.topic))
        count += len(values) + 1
        if count > MOST_NUMBERS:
            raise DataError(f"{path}: more than {MOST_NUMBERS} numbers; {limit_text()}")
        times, rows = topics.setdefault(message.topic, ([], []))
        times.append(message.time)
        rows.append(values)
    _merge(columns, topics)
    return columns


def _numbers(message: Any, name: str) -> Iterator[tuple[str, float]]:
    """Numbers in a message, with their places; lists have the names of a list ``name`` beside."""
    if isinstance(message, (bool, int, float)):
        yield name, float(message)
    elif isinstance(message, (str, bytes)) or message is None:
        return
    elif isinstance(message, Mapping) or hasattr(message, "__slots__"):
        if not isinstance(message, Mapping):
            message = {key: getattr(message, key) for key in message.__slots__}
        if message.keys() in ({"sec", "nanosec"}, {"sec", "nsec"}):
            seconds, rest = message.values()
            yield name, float(seconds) + 1e-9 * float(rest)
            return
        labels = message.get("name")
        for key, value in message.items():
            place = name if len(message) == 1 and key == "data" else f"{name}.{key}"
            if isinstance(value, (list, tuple, np.ndarray)):
                named = isinstance(labels, (list, tuple)) and len(labels) == len(value)
                parts: Any = labels if named else range(len(value))
                for part, item in zip(parts, value[:MOST_COLUMNS], strict=False):
                    yield from _numbers(item, f"{place}.{part}")
            else:
                yield from _numbers(value, place)


def _merge(
    columns: Columns, topics: Mapping[str, tuple[list[int], list[dict[str, float]]]]
) -> None:
    """Join the topics on the times of the one with the most messages, where all of them are."""
    used = {topic: samples for topic, samples in topics.items() if len(samples[0]) > 1}
    columns.left_out |= {topic: "one message" for topic in topics.keys() - used.keys()}
    if not used:
        return
    origin = min(times[0] for times, _ in used.values())
    clocks = {
        t: np.array([1e-9 * (at - origin) for at in samples[0]]) for t, samples in used.items()
    }
    main = max(clocks, key=lambda t: clocks[t].size)
    begin, end = max(c[0] for c in clocks.values()), min(c[-1] for c in clocks.values())
    clock = clocks[main][(clocks[main] >= begin) & (clocks[main] <= end)]
    columns.values["time"], columns.units["time"] = clock, "s"
    for topic, (_, rows) in used.items():
        for name in dict.fromkeys(n for row in rows for n in row):
            series = np.array([row.get(name, np.nan) for row in rows])
            columns.values[name] = np.interp(clock, clocks[topic], series)
    others = [t for t in used if t != main]
    if others:
        columns.notes.append(f"{', '.join(others)}: interpolated to the times of {main}")


# ------------------------------------------------------------------------------ logs of robots


def _file_of(path: Path) -> Path | None:
    """The file of a bag, which may be a folder; None: it is no bag."""
    if not path.is_dir():
        return path if path.suffix.lower() in (".db3", ".mcap") else None
    inside = sorted(p for p in path.iterdir() if p.suffix.lower() in (".db3", ".mcap"))
    if not inside or not is_file(path / "metadata.yaml"):
        return None
    if len(inside) > 1:
        raise DataError(f"{path}: is a bag of {len(inside)} files; give one of them")
    return inside[0]


def read_logs(path: Path) -> Sequence[Log] | None:
    """The run of a bag with states of joints; None: it is no bag, or has none."""
    file = _file_of(path)
    if file is None:
        return None
    found: dict[tuple[str, Kind], tuple[list[int], list[float]]] = {}
    count = 0
    for message in messages(file):
        stamp = _stamp(message)
        for joint, kind, value in _of_joints(message):
            times, values = found.setdefault((joint, kind), ([], []))
            if not times or stamp > times[-1]:
                times.append(stamp)
                values.append(value)
                count += 1
        if count > MOST_NUMBERS:
            raise DataError(f"{file}: more than {MOST_NUMBERS} numbers; {limit_text()}")
    moving = {k: v for k, v in found.items() if len(v[0]) > 1 and (not k[0].startswith("motor ")
              or any(found.get((k[0], "position"), ([], []))[1]))}  # fmt: skip
    if not any(kind == "position" for _, kind in moving):
        return None
    origin = min(times[0] for times, _ in moving.values())
    signals = [
        Signal(
            joint,
            kind,
            1e-9 * np.array([t - origin for t in times]),
            np.array(values),
            _UNITS[kind],
        )
        for (joint, kind), (times, values) in moving.items()
    ]
    return [Log(path.stem, with_units(signals), "ROS 2 bag")]


#: Units of ROS, REP 103; positions of slides are in m: that of the joint.
_UNITS = {"goal": "", "position": "", "velocity": "rad/s", "torque": "N m"}


def _stamp(message: Message) -> int:
    """Time of a message [ns]: that of its header, else that of the log."""
    stamp = getattr(getattr(message.content, "header", None), "stamp", None)
    return 10**9 * getattr(stamp, "sec", 0) + getattr(stamp, "nanosec", 0) or message.time


def _of_joints(message: Message) -> Iterator[tuple[str, Kind, float]]:
    """Numbers of joints in a message: JointState, JointTrajectory, arrays of goals, LowState."""
    content, goal = message.content, bool(_GOALS.search(message.topic))
    names = [str(n) for n in getattr(content, "name", None) or ()]
    if names and hasattr(content, "position"):
        fields: tuple[tuple[str, Kind], ...] = (("position", "position"), ("velocity", "velocity"),
                                                ("effort", "torque"))  # fmt: skip
        for field, kind in fields[:1] if goal else fields:
            yield from ((n, "goal" if goal else kind, float(v))
                        for n, v in zip(names, getattr(content, field), strict=False))  # fmt: skip
    elif getattr(content, "joint_names", None) and getattr(content, "points", None):
        for n, v in zip(content.joint_names, content.points[0].positions, strict=False):
            yield str(n), "goal", float(v)
    elif goal and hasattr(content, "layout") and hasattr(content, "data"):
        yield from ((f"motor {i}", "goal", float(v)) for i, v in enumerate(content.data))
    for i, state in enumerate(getattr(content, "motor_state", None) or ()):
        yield f"motor {i}", "position", float(state.q)
        yield f"motor {i}", "velocity", float(state.dq)
        yield f"motor {i}", "torque", float(state.tau_est)
    for i, command in enumerate(getattr(content, "motor_cmd", None) or ()):
        yield f"motor {i}", "goal", float(command.q)
