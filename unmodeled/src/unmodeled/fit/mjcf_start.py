"""Starts of MuJoCo runs: position and rate of each measured joint from the first samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.data import Array, Record, StartPrior
from unmodeled.data.smoothing import noise_of_samples
from unmodeled.fit.mjcf_changes import BACKLASH, import_mujoco
from unmodeled.models.model import Jobs, Model, prior_jobs

#: Ends of the names of the start states of a joint.
POSITION, VELOCITY = ".position", ".velocity"
#: Lengths of the beginnings that are tried [samples]; distance of two estimates that agree
#: [standard deviations].
LENGTHS, AGREE = (5, 6, 8, 10, 13, 17, 22, 29, 38, 50, 66, 87), 2.5
#: Lengths by which a beginning is shorter than the last one that agrees: just there, it bends most.
BACK = 2
#: Samples of a record that show its start with the model.
BEGINNING = 60
#: Squared change of the outputs by one standard deviation of a start, in units of their noise, and
#: share of its largest change that it has after the beginning, above which a start is fitted.
MATTERS, DECAYED = 1.0, 0.02


def measured_joints(model: Any, names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Outputs that show the position or the velocity of a joint: ``{JOINT: {POSITION: output}}``.

    ``names``: outputs that the records have.
    """
    mj, found = import_mujoco(), {}
    kinds = {
        int(mj.mjtSensor.mjSENS_JOINTPOS): POSITION,
        int(mj.mjtSensor.mjSENS_JOINTVEL): VELOCITY,
    }
    sensors = {
        (model.joint(int(model.sensor_objid[i])).name, kinds[int(model.sensor_type[i])]):
        model.sensor(i).name
        for i in range(model.nsensor) if int(model.sensor_type[i]) in kinds
    }  # fmt: skip
    for i in range(model.njnt):
        joint = model.joint(i).name
        if model.jnt_type[i] < 2 or not joint or joint.endswith(BACKLASH):
            continue
        known = [(k, n) for k in (POSITION, VELOCITY) for n in (joint + k, sensors.get((joint, k)))]
        shown = {k: n for k, n in (*known, (POSITION, joint)) if n in names}
        if POSITION in shown:
            found[joint] = shown
    return found


def set_starts(model: Any, data: Any, states: Mapping[str, float]) -> None:
    """Set start states, by their names, in the data of a run."""
    for name, value in states.items():
        joint = model.joint(name.rpartition(".")[0])
        if name.endswith(POSITION):
            data.qpos[joint.qposadr[0]] = value
        else:
            data.qvel[joint.dofadr[0]] = value


@dataclass(frozen=True)
class Begin:
    """Values of a channel and its rate at the first time, with standard deviations."""

    value: float
    rate: float
    value_sd: float
    rate_sd: float


def begin_of(time: Array, values: Array, sigma: float) -> Begin | None:
    """Parabola through the first samples, as many as agree with it; None: too few are measured.

    ``sigma``: standard deviation of the noise [unit of the values].
    """
    there = np.flatnonzero(np.isfinite(values))
    if there.size < LENGTHS[0]:
        return None
    t, y = time[there] - time[0], values[there]
    made: list[Begin] = []
    for count in (n for n in LENGTHS if n <= t.size):
        powers = t[:count, None] ** np.arange(3)
        cov = np.linalg.inv(powers.T @ powers)
        found = cov @ (powers.T @ y[:count])
        off = float(np.sum((y[:count] - powers @ found) ** 2)) / sigma**2
        sd = sigma * np.sqrt(np.diag(cov))
        if not made:  # also where it does not fit: then with the noise that it leaves
            sd *= max(1.0, np.sqrt(off / (count - 3)))
        elif (
            off > count - 3 + AGREE * np.sqrt(2.0 * (count - 3))
            or abs(found[0] - made[-1].value) > AGREE * made[-1].value_sd
            or abs(found[1] - made[-1].rate) > AGREE * made[-1].rate_sd
        ):
            made = made[: max(1, len(made) - BACK)]
            break
        made.append(Begin(float(found[0]), float(found[1]), float(sd[0]), float(sd[1])))
    return made[-1]


def noise_of(record: Record, name: str) -> float:
    """Standard deviation of the noise of a channel, stated or estimated [its unit], > 0."""
    if sigma := record.sensors[name].sigma:
        return float(sigma)
    there = np.isfinite(record.outputs[name])
    t, y = record.time[there], record.outputs[name][there]
    steps = np.diff(np.unique(y))
    rounding = float(steps.min() / np.sqrt(12.0)) if steps.size else 0.0
    return float(max(noise_of_samples(t, y), rounding)) or 1e-9


def starts_of(
    record: Record, joints: Mapping[str, Mapping[str, str]]
) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of the start states of the measured joints of a record.

    ``joints``: as :func:`measured_joints` returns them.
    """
    found: dict[str, tuple[float, float]] = {}
    for joint, shown in joints.items():
        channels = {k: n for k, n in shown.items() if n in record.outputs}
        begins = {
            k: begin_of(record.time, record.outputs[n], noise_of(record, n))
            for k, n in channels.items()
        }
        if (place := begins.get(POSITION)) is None:
            continue
        found[joint + POSITION] = place.value, place.value_sd
        speed = begins.get(VELOCITY)
        direct = speed is not None and speed.value_sd < place.rate_sd
        found[joint + VELOCITY] = (
            (speed.value, speed.value_sd) if direct and speed else (place.rate, place.rate_sd)
        )
    return found


def poses(model: Any, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Start states by name in each keyframe, and in the pose of the file (""), in this order."""

    def at(qpos: Array, qvel: Array) -> dict[str, float]:
        found = {}
        for name in names:
            joint, _, kind = name.rpartition(".")
            compiled = model.joint(joint)
            found[name] = float(qpos[compiled.qposadr[0]] if kind == POSITION[1:]
                                else qvel[compiled.dofadr[0]])  # fmt: skip
        return found

    out = {"": at(model.qpos0, np.zeros(model.nv))}
    out |= {
        model.key(k).name: at(model.key_qpos[k], model.key_qvel[k])
        for k in range(model.nkey) if model.key(k).name
    }  # fmt: skip
    return out


def nearest(starts: Sequence[Mapping[str, tuple[float, float]]], known: Mapping[str, Any]) -> str:
    """Name of the pose that is nearest to the first positions of all records."""

    def off(name: str) -> float:
        return sum(float(m - known[name][n]) ** 2 for s in starts for n, (m, _) in s.items()
                   if n.endswith(POSITION))  # fmt: skip

    return min(known, key=off)  # the first of equal ones: the pose of the file


def begun_records(
    model: Model,
    records: Sequence[Record],
    joints: Mapping[str, Mapping[str, str]],
    measured: Sequence[Mapping[str, tuple[float, float]]],
) -> tuple[tuple[Record, ...], list[str]]:
    """The records with their starts, and the names of those that do not start in the pose.

    A record starts in the pose of the model, at rest at its first samples, or in motion: as the
    beginning of the record shows it with the model. What the record itself states is kept.

    ``joints``: see :func:`measured_joints`; ``measured``: parabolas, see :func:`starts_of`.
    """
    pose = {s.name: s.start for s in model.states()}
    parts = [r.cut(0, min(BEGINNING, r.samples)) for r in records]
    ways = [_ways(r, joints, m, pose) for r, m in zip(parts, measured, strict=True)]
    out, moved = [], []
    tried = [(p, _jobs(model, p, w)) for p, w in zip(parts, ways, strict=True)]
    chosen = []
    for part, way, seen in zip(parts, ways, model.simulate_all(tried), strict=True):
        off = _misfits(model, part, seen)
        # Each way has unknowns of all joints more than the one before it.
        off += len(pose) * np.arange(len(way))
        chosen.append(way[int(np.argmin(np.nan_to_num(off, nan=np.inf)))])
    small = _small(model, parts, chosen)
    for record, start, without in zip(records, chosen, small, strict=True):
        own = record.start or StartPrior()
        mean = {n: m for n, (m, _) in start.items()} | dict(own.mean)
        sd = {n: 0.0 if n in without else s for n, (_, s) in start.items() if n not in own.mean}
        prior = StartPrior(mean=mean, sd={**sd, **own.sd}, known=own.known)
        out.append(replace(record, start=prior))
        moved += [record.name] if any(mean[n] != pose[n] for n in mean) else []
    return tuple(out), moved


def _ways(
    part: Record,
    joints: Mapping[str, Mapping[str, str]],
    measured: Mapping[str, tuple[float, float]],
    pose: Mapping[str, float],
) -> list[dict[str, tuple[float, float]]]:
    """Possible starts of a record as mean and standard deviation by state, simplest first."""
    rest = dict(measured)
    for name in measured:
        joint, _, kind = name.rpartition(".")
        channel = joints[joint][POSITION]
        if kind == VELOCITY[1:]:
            rest[name] = 0.0, 0.0
        elif np.isfinite(first := float(part.outputs[channel][0])):
            rest[name] = first, noise_of(part, channel)
    return [{n: (v, 0.0) for n, v in pose.items()}, rest, dict(measured)]


def _jobs(model: Model, part: Record, starts: Sequence[Mapping[str, tuple[float, float]]]) -> Jobs:
    """Simulations of a record from several starts."""
    one = prior_jobs(model, part)
    rows = [[w[s.name][0] if s.name in w else s.start for s in model.states()] for w in starts]
    return Jobs(theta=np.repeat(one.theta, len(rows), axis=0), starts=np.array(rows))


def _noise(model: Model, part: Record) -> Array:
    """Noise by output of the model; infinite where it is not measured."""
    return np.array([noise_of(part, n) if n in part.outputs else np.inf for n in model.outputs])


def _misfits(model: Model, part: Record, seen: Array) -> Array:
    """Sum of squares between simulations and a record, in units of the noise, one a simulation."""
    gap = (seen - part.output_array(model.outputs)) / _noise(model, part)
    there = np.isfinite(part.output_array(model.outputs))
    return np.asarray(np.where(there, gap**2, 0.0).sum(axis=(1, 2)))


def _small(
    model: Model,
    parts: Sequence[Record],
    starts: Sequence[Mapping[str, tuple[float, float]]],
) -> list[set[str]]:
    """Start states, by record, whose uncertainty the outputs hardly show: they are no unknowns.

    A servo soon leads its joint to the goal, whatever its start; a pendulum keeps it.
    """
    batches, free = [], []
    for part, way in zip(parts, starts, strict=True):
        free.append([n for n, (_, sd) in way.items() if sd > 0.0])
        moved = [{**way, n: (way[n][0] + way[n][1], 0.0)} for n in free[-1]]
        batches.append((part, _jobs(model, part, [way, *moved])))
    out = []
    for (part, _), names, seen in zip(batches, free, model.simulate_all(batches), strict=True):
        change = (((seen[1:] - seen[0]) / _noise(model, part)) ** 2).sum(axis=2)
        small = (change.sum(axis=1) < MATTERS) & (change[:, -1] <= DECAYED * change.max(axis=1))
        out.append({n for n, is_small in zip(names, small, strict=True) if is_small})
    return out


def unit_of_start(model: Any, name: str) -> str:
    """Unit of a start state."""
    mj = import_mujoco()
    joint, _, kind = name.rpartition(".")
    hinge = int(model.jnt_type[model.joint(joint).id]) == int(mj.mjtJoint.mjJNT_HINGE)
    return ("rad" if hinge else "m") + "/s" * (kind == VELOCITY[1:])


def scale_of(
    records: Sequence[Record], joints: Mapping[str, Mapping[str, str]], name: str
) -> float:
    """Motion of a joint in the records, of its position or its rate [unit of the state], > 0."""
    joint, _, kind = name.rpartition(".")
    sizes = []
    for r in (r for r in records if joints[joint][POSITION] in r.outputs):
        values = r.outputs[joints[joint][POSITION]]
        there = np.isfinite(values)
        if there.sum() > 2:
            y, t = values[there], r.time[there]
            sizes.append(float(np.std(y if kind == POSITION[1:] else np.gradient(y, t))))
    return max(sizes, default=0.0) or 1.0
