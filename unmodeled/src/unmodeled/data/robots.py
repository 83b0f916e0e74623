"""Logs of robots: goals and positions by joint, each with its clock, as records of a model.

A reader makes a :class:`Log` of a file or a folder. This module assigns its joints to those of a
model, converts units, and holds each goal until the next one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from unmodeled.data.records import Array, Record, Sensor, evenly_spaced
from unmodeled.data.tables import plain_name
from unmodeled.errors import DataError, shortened
from unmodeled.units import zero_and_factor

#: Units of logs that are a share of the range of a joint: 0 to 100, and -100 to 100.
PERCENT, RANGE = "0 to 100", "-100 to 100"
#: Largest change of an interval, as a share of it, at which a clock is made even [1].
UNEVEN = 3.0
#: Joints that open and close, whose unit in LeRobot is 0 to 100.
_GRIPPERS = re.compile(r"grip|jaw|finger", re.IGNORECASE)
#: Words of a column by what it holds.
_WORDS: dict[str, tuple[str, ...]] = {
    "goal": ("action", "command", "cmd", "goal", "target", "desired", "reference", "des", "ref"),
    "velocity": ("velocity", "vel", "speed", "dq", "qd"),
    "torque": ("torque", "effort", "tau", "current", "load", "trq"),
    "position": ("observation", "state", "position", "pos", "measured", "actual", "q", "present"),
}

Kind = Literal["goal", "position", "velocity", "torque"]


@dataclass(frozen=True, eq=False)
class Signal:
    """One quantity of one joint, as it was logged."""

    joint: str
    """Name in the log."""
    kind: Kind
    """"goal" of its servo; measured "position", "velocity" or "torque"."""
    time: Array
    """Times of the samples [s], increasing, (n,)."""
    values: Array
    """Values [unit], (n,)."""
    unit: str = ""
    """Unit; "0 to 100" and "-100 to 100": share of the range of the joint; "": not known."""

    @property
    def rate(self) -> float:
        """Mean rate of the samples [Hz]."""
        return (self.time.size - 1) / max(float(self.time[-1] - self.time[0]), 1e-9)

    @property
    def told(self) -> str:
        """Joint and kind, for messages."""
        return f"{self.joint} ({self.kind})"


@dataclass(frozen=True, eq=False)
class Log:
    """One run of a robot."""

    name: str
    signals: tuple[Signal, ...]
    source: str = ""
    """Format of the file, for the report."""
    conditions: Mapping[str, float | str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Joint:
    """A joint of a model with the actuator that drives it."""

    name: str
    actuator: str = ""
    """Its servo of position; "": there is none, and goals are not used."""
    unit: str = "rad"
    low: float = -math.inf
    high: float = math.inf
    """Range [unit]."""

    @property
    def output(self) -> str:
        """Output that is its position; without a model, the name of the joint."""
        return f"{self.name}.position" if self.unit else self.name


@dataclass(frozen=True)
class Assigned:
    """A row of the table of a log: what a signal became, and what was guessed."""

    signal: str
    channel: str
    """Channel of the model; "": it is not used."""
    unit: str
    samples: int
    rate: float
    """Samples in a second [Hz]."""
    guessed: str = ""
    """What was guessed, and the option that states otherwise."""


# ------------------------------------------------------------------------- columns of any table


def log_of_columns(
    name: str,
    values: Mapping[str, Array],
    time: Array,
    joints: Sequence[Joint],
    units: Mapping[str, str],
) -> Log | None:
    """A run from columns such as ``action.elbow.pos`` and ``observation.state.elbow.pos``.

    None: a column has the name of an actuator or a joint itself, or there is no goal or position.
    """  # fmt: skip
    own = {plain_name(n) for j in joints for n in (j.name, j.actuator, j.output)}
    if any(plain_name(c) in own for c in values):
        return None
    signals = []
    for column, series in values.items():
        found = kind_of(column, [j.name for j in joints])
        if found is not None:
            signals.append(Signal(found[0], found[1], time, series, units.get(column, "")))
    kinds = {s.kind for s in signals}
    places = [(s.joint, s.kind) for s in signals]
    if not {"goal", "position"} <= kinds or len({*places}) < len(places):
        return None
    return Log(name, with_units(signals))


def kind_of(column: str, joints: Sequence[str]) -> tuple[str, Kind] | None:
    """Joint of a column and what it holds; None: its name tells neither."""
    words = re.split(r"[^0-9A-Za-z]+", column)
    for joint in sorted(joints, key=len, reverse=True):
        own = re.split(r"[^0-9A-Za-z]+", joint)
        for at in range(len(words) - len(own) + 1):
            if [w.lower() for w in words[at : at + len(own)]] == [w.lower() for w in own]:
                rest = {w.lower() for w in (*words[:at], *words[at + len(own) :])}
                kinds = [k for k, known in _WORDS.items() if rest & {*known}]
                # action.elbow.pos is a goal, and observation.state.elbow.vel a velocity.
                return (joint, kinds[0]) if kinds else None  # type: ignore[return-value]
    return None


def with_units(signals: Sequence[Signal], lerobot: bool = False) -> tuple[Signal, ...]:
    """The signals with the likely units of angles that state none."""
    angles = [s for s in signals if s.kind in ("goal", "position") and not s.unit]
    largest = max((float(np.nanmax(np.abs(s.values), initial=0.0)) for s in angles
                   if not _GRIPPERS.search(s.joint)), default=0.0)  # fmt: skip

    def unit(s: Signal) -> str:
        if s.unit or s.kind not in ("goal", "position"):
            return s.unit
        if lerobot and _GRIPPERS.search(s.joint) and largest > 2.0 * math.pi:
            return PERCENT
        return "deg" if largest > 2.0 * math.pi else ""

    return tuple(replace(s, unit=unit(s)) for s in signals)


# ------------------------------------------------------------------------- records of a model


def records_of(
    path: Path,
    logs: Sequence[Log],
    joints: Sequence[Joint],
    *,
    columns: Mapping[str, str],
    units: Mapping[str, str],
) -> tuple[tuple[Record, ...], tuple[Assigned, ...]]:
    """Records of the runs of a log, and the table of what became of its signals.

    Parameters
    ----------
    path
        File or folder, for messages.
    logs
        Runs.
    joints
        Joints of the model; none: the names of the log are those of the channels.
    columns
        Joint of the log by joint or actuator of the model, where it was stated.
    units
        Unit by joint of the log or of the model, where it was stated; "": of all.

    Raises
    ------
    DataError
        The joints cannot be assigned, or a unit is not that of a joint.
    """
    names = tuple(dict.fromkeys(s.joint for log in logs for s in log.signals))
    place, guessed = _places(path, names, joints, columns)
    known = {n: (place[n].name, place[n].actuator, n) for n in place}
    stated = {n: next((units[k] for k in (*known[n], "") if k in units), "") for n in place}
    records: list[Record] = []
    rows: list[Assigned] = []
    for log in logs:
        record, table = _record(path, log, place, stated, guessed)
        records.append(record)
        rows = rows or table
    return tuple(records), tuple(rows)


def _places(
    path: Path, names: Sequence[str], joints: Sequence[Joint], columns: Mapping[str, str]
) -> tuple[dict[str, Joint], set[str]]:
    """Joint of the model by joint of the log, and which of them were guessed by their order."""
    if not joints:
        return {n: Joint(n, f"{n}.goal", "") for n in names}, set()
    stated = {c: k for k, c in columns.items()}
    by_name = {plain_name(n): j for j in joints for n in (j.actuator, j.name) if n}
    found = {n: by_name[k] for n in names if (k := plain_name(stated.get(n, n))) in by_name}
    driven = [j for j in joints if j.actuator] or list(joints)
    in_order = dict(zip(names, driven, strict=False))
    if len(found) < len(names) == len(driven) and found.items() <= in_order.items():
        return in_order, in_order.keys() - found.keys()
    if found:
        return found, set()
    lines = " ".join(f"--column {j.name}=NAME" for j in driven[:3])
    raise DataError(
        f"{path}: its joints {shortened(', '.join(names), 200)} are none of the model, "
        f"{shortened(', '.join(j.name for j in driven), 200)}, and their numbers differ, so that "
        f"their order tells nothing; state them: {lines} ..."
    )


def _even(clock: Array) -> tuple[Array, list[str]]:
    """A clock with even intervals if its own are nearly so, and what was done [s]."""
    steps = np.diff(clock)
    if clock.size <= 2 or evenly_spaced(clock):
        return clock, []
    middle = float(np.median(steps))
    if not np.abs(steps - middle).max() < UNEVEN * middle:
        return clock, []
    ends = f"{1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms"
    told = f"its intervals of {ends} are interpolated to even ones"
    return np.linspace(clock[0], clock[-1], clock.size), [told]


def _unit_of(s: Signal, joint: Joint, stated: Mapping[str, str]) -> str:
    return stated[s.joint] or s.unit or joint.unit


def _guessed(s: Signal, joint: Joint, stated: Mapping[str, str], by_order: Collection[str]) -> str:
    """What was guessed of a signal, and the option that says otherwise."""
    angle = s.unit in ("deg", PERCENT, RANGE) and not stated[s.joint]
    other = "rad" if s.unit == "deg" else "deg"
    told = [f"unit (--unit {s.joint}={other})"] * angle
    told += [f"joint by its order (--column {joint.name}=NAME)"] * (s.joint in by_order)
    return "; ".join(told)


def _record(
    path: Path,
    log: Log,
    place: Mapping[str, Joint],
    stated: Mapping[str, str],
    by_order: Collection[str],
) -> tuple[Record, list[Assigned]]:
    """Record of a run at the times of its first measured position."""
    known = [(s, joint) for s in log.signals if (joint := place.get(s.joint))]
    used = [(s, joint, channel) for s, joint in known if (channel := _channel(s, joint))]
    measured = next((s for s, *_ in used if s.kind == "position"), None)
    if measured is None:
        there = shortened(", ".join(s.told for s in log.signals), 300)
        raise DataError(f"{path}: {log.name}: no measured position of a joint; there are {there}")
    clock = measured.time
    begin = max(s.time[0] for s, *_ in used) - 1e-3 * float(np.median(np.diff(clock)))
    clock, told = _even(clock[clock >= begin])
    notes = [*log.notes, *(f"{log.name}: {text}" for text in told)]
    columns: dict[str, dict[str, Array]] = {"goal": {}, "position": {}}
    rows = {s: _row(s) for s in log.signals}
    for s, joint, channel in used:
        unit = _unit_of(s, joint, stated)
        values = _at(clock, s.time, _in_si(path, s, joint, unit), held=s.kind == "goal")
        columns[s.kind][channel] = values
        rows[s] = _row(s, channel, unit, _guessed(s, joint, stated, by_order))
    goals = columns["goal"]
    units = {j.actuator: j.unit for j in place.values()}
    record = Record(
        name=log.name,
        time=clock - clock[0],
        inputs=goals,
        input_units={n: units[n] for n in goals if units.get(n)},
        outputs=columns["position"],
        sensors={c: Sensor(name=c, unit=j.unit or "1") for s, j, c in used if s.kind == "position"},
        conditions=log.conditions,
        source=log.source,
        notes=tuple(notes),
    )
    return record, [*rows.values()]


def _row(s: Signal, channel: str = "", unit: str = "", guessed: str = "") -> Assigned:
    """What a signal became."""
    return Assigned(f"{s.joint} {s.kind}", channel, unit or s.unit, s.time.size, s.rate, guessed)


def _channel(signal: Signal, joint: Joint) -> str:
    """Channel of the model that a signal is; "": it is not used."""
    if signal.kind == "goal":
        return joint.actuator
    return joint.output if signal.kind == "position" else ""


def _in_si(path: Path, signal: Signal, joint: Joint, unit: str) -> Array:
    """Values of a signal in the unit of its joint."""
    if unit in (PERCENT, RANGE):
        if not math.isfinite(joint.high - joint.low):
            return signal.values / 100.0  # a share of an unknown range
        share = signal.values / 100.0 if unit == PERCENT else (signal.values + 100.0) / 200.0
        return np.asarray(joint.low + (joint.high - joint.low) * share)
    try:
        zero, factor = zero_and_factor(unit or "1", joint.unit or unit or "1")
    except Exception as error:
        raise DataError(f"{path}: {signal.joint}: {error}") from None
    return np.asarray(factor * (signal.values - zero))


def _at(clock: Array, time: Array, values: Array, *, held: bool) -> Array:
    """Values at the times of another clock: of the last sample, or between two."""
    if np.array_equal(clock, time):
        return values
    if not held:
        return np.asarray(np.interp(clock, time, values))
    # A command that is logged in the same instant as the state holds from it on.
    late = 1e-6 * float(np.median(np.diff(clock)))
    return np.asarray(values[np.maximum(np.searchsorted(time, clock + late, "right") - 1, 0)])


#: Function that gets the table of a log.
Tell = Callable[[Path, Sequence[Assigned]], None]
