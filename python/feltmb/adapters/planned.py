"""Typical strokes for a plan, before anything is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from feltmb.adapters.drives import DISPLACEMENT
from feltmb.adapters.model import MechanismModel
from feltmb.arguments import checked
from feltmb.data import Array, Record, Sensor
from feltmb.files import write_text
from feltmb.fit.limits import InputLimits, Limits
from feltmb.run.stroke import load_stroke
from feltmb.run.stroke.strokes import Kind, usual_interpolation

__all__ = [
    "STROKES",
    "STROKE_KINDS",
    "finger_limits",
    "planned_strokes",
    "write_planned_stroke",
    "write_planned_torque",
]

#: Kind of a stroke by input of the model.
STROKE_KINDS: Mapping[str, Kind] = {"force": "force", "displacement": "key_motion"}

#: Packaged strokes, the most informative first.
STROKES = ("forte", "piano", "staccato")
#: Sample rate [Hz].
RATE = 2000.0
#: Noise of a camera that resolves a fifth of a pixel of 0.1 mm [m], and of a good load cell [N].
CAMERA, LOAD_CELL = 2e-5, 0.01


@checked
def planned_strokes(model: MechanismModel, names: Sequence[str] = STROKES) -> tuple[Record, ...]:
    """Packaged strokes as records without measured values, with typical commercial sensors.

    The noise is 0.01 N for the force and 0.02 mm for displacements, at 2 kHz. None for a mechanism
    without a finger.

    Parameters
    ----------
    names
        Packaged strokes or files of strokes.
    """
    if model.action.config.finger is None:
        return ()
    seen = [o for o in model.outputs if o not in model.beside and o != DISPLACEMENT]
    sensors = {
        o: Sensor(
            name=o,
            unit=model.units[o],
            sigma=LOAD_CELL if o == "finger.force" else CAMERA,
        )
        for o in seen
    }
    records = []
    for name in names:
        stroke = load_stroke(name)
        time = np.arange(0.0, stroke.duration, 1.0 / RATE)
        records.append(
            Record(
                name=name,
                time=time,
                inputs={"force": stroke.at(time)},
                outputs={o: np.zeros(time.size) for o in seen},
                sensors=sensors,
                input_sigma={"force": LOAD_CELL},
            )
        )
    return tuple(records)


@checked
def finger_limits(model: MechanismModel) -> Limits | None:
    """Limits of a finger on a key; None for a mechanism without a finger.

    0 to 25 N (the loudest packaged stroke), 2 kN/s (it rises in 12 ms), 0.6 s; sampled at 2 kHz.
    """
    if model.action.config.finger is None:
        return None
    force = InputLimits(least=0.0, most=25.0, rate=2000.0, unit="N", sigma=LOAD_CELL)
    return Limits(inputs={"force": force}, duration=0.6, sample_rate=RATE)


@checked
def write_planned_stroke(
    path: Path, kind: Kind, time: Array, value: Array, *, unit: str, about: str, force: bool = False
) -> Path:
    """Write a stroke file for ``feltmb stroke`` through points.

    Parameters
    ----------
    path
        The file.
    kind
        Kind of the stroke.
    time
        Times [s], the last one is the duration.
    value
        Values [unit].
    unit
        Unit of the values.
    about
        What it is for.
    force
        Whether an existing file is overwritten.
    """
    import tomlkit

    table = {
        "schema": 1,
        "name": path.stem,
        "about": about,
        "source": "planned by feltmb gap plan",
        "kind": kind,
        "duration": float(time[-1]),
        "knots": {
            "unit": ["s", unit],
            "time": [float(f"{t:.9g}") for t in time],
            "value": [float(f"{v:.9g}") for v in value],
            "interpolation": usual_interpolation(kind),
        },
    }
    return write_text(path, tomlkit.dumps(table), force=force)


@checked
def write_planned_torque(path: Path, time: Array, torque: Array, *, force: bool = False) -> Path:
    """Write a torque as CSV, for ``feltmb actuator`` and the controller of a key actuator.

    Parameters
    ----------
    path
        The file.
    time
        Times [s], evenly spaced.
    torque
        Torque of the motor [N m].
    force
        Whether an existing file is overwritten.
    """
    lines = ["time [s],torque [N m]"]
    lines += [f"{t:.9g},{v:.9g}" for t, v in zip(time, torque, strict=True)]
    return write_text(path, "\n".join(lines) + "\n", force=force)
