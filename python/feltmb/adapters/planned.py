"""Strokes that could be measured: what a diagnosis could tell before anything is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feltmb.adapters.model import MechanismModel
from feltmb.data import Record, Sensor
from feltmb.run.stroke import load_stroke

__all__ = ["STROKES", "planned_strokes"]

#: Packaged strokes, the one that says most first.
STROKES = ("forte", "piano", "staccato")
#: Samples a second.
RATE = 2000.0
#: A camera that reads to a fifth of a pixel of 0.1 mm [m], and a good load cell [N].
CAMERA, LOAD_CELL = 2e-5, 0.01


def planned_strokes(model: MechanismModel, names: Sequence[str] = STROKES) -> tuple[Record, ...]:
    """Packaged strokes as records without measured values, with sensors as they may be bought.

    The force is known to 0.01 N, displacements to 0.02 mm; sampled at 2 kHz. None for a mechanism
    that has no finger.

    Parameters
    ----------
    names
        Packaged strokes or files of strokes.
    """
    if model.action.config.finger is None:
        return ()
    seen = [o for o in model.outputs if o not in model.beside]
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
