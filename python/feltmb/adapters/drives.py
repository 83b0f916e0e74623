"""Inputs of a mechanism from a record: force of the finger, or motion of the key front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from feltmb import _core
from feltmb.adapters.variants import Variant
from feltmb.data import Array, Record, Sensor
from feltmb.data.records import NOT_OF_INPUTS
from feltmb.data.smoothing import LEAST_SAMPLES, noise_of_record, smooth_record
from feltmb.errors import DataError
from feltmb.fit.latest import Latest
from feltmb.mechanism import Action

__all__ = [
    "DISPLACEMENT",
    "FORCE",
    "Drive",
    "Drives",
    "driven",
    "start_state",
    "with_noise",
]

#: Outputs of the finger: its force [N], and its displacement [m].
FORCE, DISPLACEMENT = "finger.force", "finger.displacement"

#: Number of cached smoothed motions; a diagnosis uses each of them thousands of times.
SMOOTHED = 256
#: Estimated noise of an input above which a note is given: of a motion [m], of a force [N].
NOTED_NOISE = {"displacement": 2e-7, "force": 1e-4}


@dataclass(frozen=True)
class Drive:
    """Input of a record: force of the finger [N], or displacement of the key front [m]."""

    time: Array
    value: Array
    motion: bool

    @cached_property
    def profile(self) -> _core.Profile:
        """Input over the time from the first sample.

        A force is interpolated without overshoot. A motion is a spline, because its acceleration
        matters.
        """
        kind = _core.Interpolation.spline if self.motion else _core.Interpolation.monotone
        return _core.Profile(list(self.time - self.time[0]), list(self.value), kind)

    @cached_property
    def input(self) -> _core.Input:
        """Input of the core."""
        return _core.Input(self.profile, "key_motion" if self.motion else "force")


class Drives:
    """Inputs of records; a noisy motion is smoothed once and cached."""

    def __init__(self) -> None:
        self._smoothed: Latest[tuple[object, ...], Array] = Latest(SMOOTHED)

    def of(self, record: Record) -> Drive:
        """Input of a record.

        Raises
        ------
        DataError
            The input of the input mode is missing.
        """
        motion, wanted = record.input_mode == "motion", _input_of(record)
        if wanted not in record.inputs:
            raise DataError(
                f"record {record.name}: input {wanted!r} is missing "
                f"(inputs are {', '.join(record.inputs) or 'none'}); "
                f"input_mode {record.input_mode!r} needs it"
            )
        value, sigma = record.inputs[wanted], record.input_sigma.get(wanted, 0.0)
        if motion and sigma > 0.0 and value.size >= LEAST_SAMPLES:
            key = (record.time.tobytes(), value.tobytes(), sigma)
            noisy = value
            value = self._smoothed.get(key, lambda: smooth_record(record.time, noisy, sigma))
        return Drive(record.time, value, motion)


def start_state(action: Action, v: Variant, drive: Drive) -> Array:
    """Full state at the first sample: at rest, but the joint of the finger follows a motion."""
    full = v.rest.copy()
    if not drive.motion:
        return full
    finger = action.config.finger
    assert finger is not None
    coordinates = list(v.mechanism.coordinates)
    k = coordinates.index(action.config.bodies[finger.body].coordinate)
    n, profile = len(coordinates), drive.profile
    wanted = v.finger_reference + float(profile.value(0.0))

    def place(q: Array) -> float:
        return float(_core.finger_place(v.mechanism, q))

    step = 1e-6
    for _ in range(4):
        here = place(full[:n])
        ahead = full[:n].copy()
        ahead[k] += step
        full[k] -= (here - wanted) * step / (place(ahead) - here)
    full[n + k] = 0.0
    here = place(full[:n])
    ahead = full[:n].copy()
    ahead[k] += step
    lever = (place(ahead) - here) / step
    drift = (place(full[:n] + step * full[n : 2 * n]) - here) / step
    full[n + k] = (float(profile.rate(0.0)) - drift) / lever
    return full


def driven(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records with one kind of input, and sentences about what was changed.

    Where motion and force of the finger are measured, the force is the input, and the motion an
    output. The force that a motion needs depends on the second derivative of the motion, in which
    noise is large; the motion that a force causes depends on integrals of the force. Its samples
    must resolve the force. If the force of one record cannot drive a model, the motion drives all
    of them. The input of a record is not one of its outputs: the model repeats it exactly.
    """
    both = [r for r in records if r.input_mode == "motion" and FORCE in r.outputs]
    refused = [f"{r.name}: {why}" for r in both if (why := _why_not(r))]
    notes: list[str] = []
    if refused:
        notes.append(
            f"the motion drives the model, and {FORCE} is an output; the force would determine "
            f"more, but it cannot drive the model ({'; '.join(refused)})"
        )
    elif both:
        names = ", ".join(r.name for r in both)
        notes.append(
            f"{names}: {FORCE} is measured beside the motion. The measured force drives the model, "
            f"and the measured motion is compared with its {DISPLACEMENT}"
        )
    out = [r if refused or r not in both else _by_force(r) for r in records]
    repeated = [r for r in out if _own(r) in r.outputs and len(r.outputs) > 1]
    if repeated:
        names = ", ".join(r.name for r in repeated)
        notes.append(f"{names}: {_own(repeated[0])} drives the model and is therefore not compared")
    return tuple(_without(r, _own(r)) if r in repeated else r for r in out), tuple(notes)


def _own(record: Record) -> str:
    """Output of the model that repeats the input of a record."""
    return DISPLACEMENT if record.input_mode == "motion" else FORCE


def _without(record: Record, output: str) -> Record:
    return replace(
        record,
        outputs={n: v for n, v in record.outputs.items() if n != output},
        sensors={n: s for n, s in record.sensors.items() if n != output},
    )


def _why_not(record: Record) -> str:
    """Reason why the measured force of a record cannot drive a model; "": it can."""
    force, sensor = record.outputs[FORCE], record.sensors[FORCE]
    missing = int(np.count_nonzero(~np.isfinite(force)))
    if missing:
        return f"{missing} of {force.size} samples are missing"
    if not np.ptp(force) > 0.0:
        return "it is constant"
    unknown = [key for key in NOT_OF_INPUTS if getattr(sensor, key)]
    return f"an input has no {', '.join(unknown)}" if unknown else ""


def _by_force(record: Record) -> Record:
    """A record of a motion with the measured force as its input."""
    outputs, sensors = dict(record.outputs), dict(record.sensors)
    if DISPLACEMENT not in outputs:
        outputs[DISPLACEMENT] = record.inputs["displacement"]
        sensors[DISPLACEMENT] = Sensor(
            name=DISPLACEMENT,
            unit=record.input_units.get("displacement", "m"),
            sigma=record.input_sigma.get("displacement") or None,
            correlation_time=record.input_correlation_time.get("displacement", 0.0),
        )
    free = replace(
        record,
        inputs={},
        input_units={},
        input_sigma={},
        input_correlation_time={},
        outputs=outputs,
        sensors=sensors,
    )
    return free.with_output_as_input(FORCE, "force", mode="force")


def with_noise(record: Record, notes: list[str]) -> Record:
    """A record with the noise of its input; it is estimated, and noted, if it is not specified.

    The noise of a motion is removed by smoothing. The noise of a force moves the model but not the
    machine; it is therefore part of the run-to-run variability.
    """
    name = _input_of(record)
    if name not in record.inputs or name in record.input_sigma:
        return record
    sigma = noise_of_record(record.inputs[name])
    if not sigma > 0.0:
        return record
    if sigma > NOTED_NOISE[name]:
        unit, what = ("m", "taken out") if name == "displacement" else ("N", "allowed for")
        notes.append(
            f"{record.name}: the noise of {name} is not specified; {sigma:.2g} {unit} are "
            f"estimated and {what} (specify sigma in the TOML)"
        )
    return replace(record, input_sigma={**record.input_sigma, name: sigma})


def _input_of(record: Record) -> str:
    """Name of the input for the input mode of a record."""
    return "displacement" if record.input_mode == "motion" else "force"
