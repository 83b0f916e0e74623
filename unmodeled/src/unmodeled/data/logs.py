"""Readers of logs of robots: data sets of LeRobot, SAGE, BAM, and those of other packages."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from unmodeled.data import bags
from unmodeled.data.formats import read_frame
from unmodeled.data.records import Array
from unmodeled.data.robots import Log, Signal, with_units
from unmodeled.errors import DataError
from unmodeled.files import LARGEST_TABLE, is_file, read_input, read_json

#: Group of the entry points of readers.
GROUP = "unmodeled.readers"


class Reader(Protocol):
    """What an entry point of the group ``unmodeled.readers`` names: a module with this function.

    A package that has such an entry point adds a format of logs to ``unmodeled`` in one file.
    """

    def read_logs(self, path: Path) -> Sequence[Log] | None:
        """Runs of a file or a folder; None: it is not of this format."""


@cache
def _installed() -> tuple[Reader, ...]:
    return tuple(e.load() for e in entry_points(group=GROUP))


def logs_of(path: Path) -> Sequence[Log] | None:
    """Runs of a file or a folder that a reader knows; None: it is no log of a robot."""
    for read in (*(r.read_logs for r in _installed()), _lerobot, _sage, _bam, bags.read_logs):
        if (found := read(path)) is not None:
            return found
    return None


# ------------------------------------------------------------------------------------ LeRobot


def _lerobot(path: Path) -> list[Log] | None:
    """Episodes of a data set of version 2 or 3: its folder, or one of its Parquet files."""
    folder, files = path, [path]
    if path.is_dir():
        files = sorted((path / "data").glob("chunk-*/*.parquet"))
    elif path.suffix == ".parquet":
        folder = next((p for p in list(path.absolute().parents)[:3]
                       if is_file(p / "meta" / "info.json")), path)  # fmt: skip
    if not is_file(folder / "meta" / "info.json"):
        return None
    info = read_json(folder / "meta" / "info.json")
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise DataError(
            f"{folder / 'meta' / 'info.json'}: has no features of a data set of LeRobot"
        )
    if not files:
        raise DataError(f"{folder}: has no file data/chunk-*/*.parquet")
    fps, what = float(info.get("fps") or 0.0), f"LeRobot {info.get('codebase_version', '')}".strip()
    return [log for file in files for log in _episodes(file, fps, what)]


def _episodes(path: Path, fps: float, what: str) -> list[Log]:
    columns = read_frame(path)
    values = columns.values
    runs = values.get("episode_index", np.zeros(len(next(iter(values.values())))))
    out = []
    for number in np.unique(runs):
        rows = runs == number
        count = int(rows.sum())
        # Frames are even; times in single precision are not.
        time = np.arange(count) / fps if fps else values["timestamp"][rows]
        signals = []
        for column, series in values.items():
            kind, _, name = column.partition(".")
            if kind == "observation":
                _, _, name = name.partition(".")
            if (kind == "action" or column.startswith("observation.state.")) and name:
                joint, _, end = name.rpartition(".")
                position = end in ("pos", "q", "position") or not joint
                if position or end not in ("vel", "torque", "current", "effort"):
                    joint = joint if position and joint else name
                    goal = kind == "action"
                    signals.append(
                        Signal(joint, "goal" if goal else "position", time, series[rows])
                    )
        out.append(Log(f"episode{int(number)}", with_units(signals, lerobot=True), what))
    return out


# --------------------------------------------------------------------------------------- SAGE


#: Lists of a state of SAGE: quantity, and unit.
_SAGE = {"positions": ("position", "rad"), "velocities": ("velocity", "rad/s"),
         "torques": ("torque", "N m")}  # fmt: skip


def _sage(path: Path) -> list[Log] | None:
    """A motion: folder with control.csv, state_motor.csv and joint_list.txt; or folders of them."""
    if path.name in ("control.csv", "state_motor.csv"):
        path = path.parent
    if not path.is_dir():
        return None
    if not is_file(path / "state_motor.csv"):
        below = sorted(p.parent for p in path.glob("*/state_motor.csv"))
        return [log for p in below for log in _sage(p) or []] or None
    names: list[str] = []
    if is_file(path / "joint_list.txt"):
        text = read_input(path / "joint_list.txt", most=LARGEST_TABLE).decode("utf-8", "replace")
        names = [line.strip() for line in text.splitlines() if line.strip()]
    files = [path / name for name in ("control.csv", "state_motor.csv") if is_file(path / name)]
    return [Log(path.name, tuple(s for file in files for s in _of_sage(file, names)), "SAGE")]


def _of_sage(file: Path, names: Sequence[str]) -> Iterator[Signal]:
    """Signals of a file of a motion; of goals, only the positions count."""
    time, lists = _lists(file)
    goals = file.name == "control.csv"
    for heading, block in lists.items():
        if heading not in _SAGE:
            continue
        kind, unit = _SAGE[heading]
        own = names or [f"joint{j + 1}" for j in range(block.shape[1])]
        if len(own) != block.shape[1]:
            raise DataError(
                f"{file}: {heading} has {block.shape[1]} numbers, and joint_list.txt {len(own)} "
                "names"
            )
        if kind == "position" or not goals:
            for j, name in enumerate(own):
                yield Signal(name, "goal" if goals else kind, time, block[:, j], unit)  # type: ignore[arg-type]


def _lists(path: Path) -> tuple[Array, dict[str, Array]]:
    """Clock [s] of a CSV with stamps in microseconds, and its columns of lists, (n, joints)."""
    text = read_input(path, most=LARGEST_TABLE).decode("utf-8", "replace")
    rows = list(csv.DictReader(io.StringIO(text)))
    if not rows or "timestamp" not in rows[0]:
        raise DataError(f"{path}: has no column timestamp, expected a log of SAGE")
    try:
        time = 1e-6 * np.array([float(r["timestamp"]) for r in rows])
        wanted = [h for h in rows[0] if h and str(rows[0][h]).lstrip().startswith("[")]
        lists = {h: np.array([json.loads(r[h]) for r in rows], dtype=np.float64) for h in wanted}
    except (ValueError, TypeError) as error:
        raise DataError(f"{path}: {error}; expected lists of numbers of one length") from None
    _check_clock(path, time)
    return time, lists


def _check_clock(path: Path, time: Array) -> None:
    wrong = np.flatnonzero(~(np.diff(time) > 0.0))
    if wrong.size:
        k = int(wrong[0])
        raise DataError(
            f"{path}: row {k + 2}: time does not increase, from {time[k]:.10g} s to "
            f"{time[k + 1]:.10g} s"
        )


# ---------------------------------------------------------------------------------------- BAM


#: Entries of BAM: quantity, and unit.
_BAM = {"goal_position": ("goal", "rad"), "position": ("position", "rad"),
        "speed": ("velocity", "rad/s"), "torque_demand": ("torque", "N m")}  # fmt: skip


def _bam_content(path: Path) -> dict[str, Any] | None:
    try:
        content = read_json(path)
    except DataError:  # another reader tells what is wrong
        return None
    entries = content.get("entries") if isinstance(content, dict) else None
    listed = isinstance(entries, list) and len(entries) > 1 and isinstance(entries[0], dict)
    return content if listed else None


def _with_torque(entries: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """First and last sample of the record: while the torque is off there is no goal."""
    on = [bool(e.get("torque_enable", True)) for e in entries]
    first = on.index(True) if any(on) else 0
    return first, next((k for k in range(first + 1, len(on)) if not on[k]), len(on))


def _bam(path: Path) -> list[Log] | None:
    """A JSON file with ``entries`` of one servo, or a folder of them."""
    if path.is_dir():  # it may hold other files, also damaged ones
        return [log for p in sorted(path.glob("*.json")) for log in _bam(p) or []] or None
    if path.suffix.lower() != ".json":
        return None
    content = _bam_content(path)
    if content is None:
        return None
    entries = content["entries"]
    wanted = [n for n in _BAM if n in entries[0]]
    if "timestamp" not in entries[0] or "position" not in wanted:
        raise DataError(f"{path}: its entries have no timestamp and position; there are "
                        f"{', '.join(map(str, entries[0]))}")  # fmt: skip
    first, end = _with_torque(entries)
    notes: tuple[str, ...] = ()
    if end - first < len(entries):
        notes = (f"{path.stem}: samples {first} to {end} of {len(entries)} are used: the torque "
                 "is off in the others",)  # fmt: skip
    try:
        table = {n: np.array([float(e[n]) for e in entries[first:end]])
                 for n in ("timestamp", *wanted)}  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: an entry has no number {error}") from None
    time = table["timestamp"]
    _check_clock(path, time)
    joint = str(content.get("motor", "motor"))
    signals = [Signal(joint, _BAM[n][0], time, table[n], _BAM[n][1]) for n in wanted]  # type: ignore[arg-type]
    known: dict[str, Any] = {k: v for k, v in content.items() if isinstance(v, (int, float, str))}
    return [Log(path.stem, tuple(signals), "BAM", known, notes)]
