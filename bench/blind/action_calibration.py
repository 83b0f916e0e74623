"""Noncentrality of the withheld effects of the full action, per unit of magnitude.

How far an effect exceeds what tolerances, run-to-run variability and the sensors leave open, on the
strokes that are fitted, at drawing values:

    nc^2 = |d|^2 - d' S (S' S + I)^-1 S' d

with d the whitened change of the records by the effect, made by the generator, and S the whitened
derivatives by tolerances and by run-to-run variability, in standard deviations of their priors.

    PYTHONPATH=bench python -m blind.action_calibration     writes action_scales.json; no seed
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from feltmb.fit.segmented_records import Noise, SegmentedRecord, segment_record

from blind import action_truth as truth
from feltmb.data import Array, Record, Sensor
from feltmb.fit import SensitivityRequest

__all__ = ["calibrate", "packaged_scales", "to_record"]

SHARE = 0.3  # of the natural magnitude of the effect that is tried


def to_record(name: str, view: Mapping[str, Array]) -> Record:
    """A view of the generator with what a data sheet says of its sensors."""
    motion = "displacement" in view
    driven = "displacement" if motion else "force"
    outputs = [o for o in view if o != driven]
    force_noise = float(np.hypot(truth.NOISE_FORCE, truth.STEP_FORCE / np.sqrt(12.0)))
    sensors = {
        o: Sensor(name=o, unit="N", sigma=truth.NOISE_FORCE, quantum=truth.STEP_FORCE)
        if o == "finger.force"
        else Sensor(
            name=o,
            unit="m",
            sigma=truth.NOISE_CAMERA,
            quantum=truth.PIXEL,
            # The mean of three frames is worth one independent look per three frames.
            correlation_time=1.5 / truth.RATE,
        )
        for o in outputs
    }
    return Record(
        name=name,
        time=np.arange(view[driven].size) / truth.RATE,
        inputs={driven: view[driven]},
        outputs={o: view[o] for o in outputs},
        sensors=sensors,
        input_mode="motion" if motion else "force",
        input_sigma={driven: truth.NOISE_ENCODER if motion else force_noise},
        role="fit" if name in truth.FIT else "held_out",
    )


def whole_segmented(model: Any, record: Record) -> SegmentedRecord:
    """A record in one piece with the noise of its sensors."""
    noise = {o: Noise(s.sigma or 0.0, s.correlation_time) for o, s in record.sensors.items()}
    return segment_record(model, record, noise, None, np.array([[0, record.samples - 1]]))


def white_columns(model: Any, segmented: SegmentedRecord, theta: Array) -> Array:
    """Whitened derivatives of a record by all parameters, in standard deviations of the priors."""
    request = SensitivityRequest(
        segmented.record, theta, segmented.segments, np.zeros((1, 0)), by_starts=False
    )
    unit = model.sensitivities([request])[0].d_theta * np.array([p.sd for p in model.parameters])
    return np.asarray(segmented.whiten(unit).reshape(-1, unit.shape[3]))


def answer_to_force(model: Any, record: Record, force: Array) -> Array | float:
    """Change of the model's motion where it is shown another force than that of the record.

    An effect of the input changes what the force sensor shows, and the model answers to that.
    """
    if not np.any(force - record.inputs["force"]):
        return 0.0
    zero = np.zeros(model.mechanical)
    shown = record.with_inputs({"force": force})
    moved, still = (model.simulator.motion(r, zero, (), np.zeros(0)) for r in (shown, record))
    return np.asarray(moved - still)


def calibrate(progress: Callable[[str, int, int], None] | None = None) -> dict[str, float]:
    """Noncentrality per unit of magnitude of every effect, form and kind from outside."""
    from feltmb.adapters import mechanism_model

    action, base, library, outputs = truth.setup()
    model: Any = mechanism_model(action, rtol=1e-6, workers=1)[0]
    plain = truth.plain_case()
    views, segmented_records, roots = [], [], []
    records = []
    for stroke in truth.FIT:
        view, _ = truth.record(base, library, plain, stroke, outputs, ideal=True)
        views.append(view)
        records.append(to_record(stroke, view))
    whole = model.with_variability(records)
    for r in records:
        segmented = whole_segmented(whole, r)
        segmented_records.append(segmented)
        roots.append(white_columns(whole, segmented, np.zeros(len(whole.parameters))))
    root = np.vstack(roots)
    height = np.asarray(np.linalg.inv(root.T @ root + np.eye(root.shape[1])), dtype=np.float64)

    def strength(parts: tuple[truth.Part, ...]) -> float:
        case = truth.plain_case(parts)
        rows = []
        for stroke, view, segmented in zip(truth.FIT, views, segmented_records, strict=True):
            length = view["force"].size / truth.RATE
            moved, _ = truth.record(base, library, case, stroke, outputs, ideal=True, length=length)
            change = np.stack([moved[o] - view[o] for o in outputs], axis=-1)
            change = change - answer_to_force(whole, segmented.record, moved["force"])
            rows.append(segmented.whiten(change[None]).reshape(-1))
        d = np.concatenate(rows)
        pull = root.T @ d
        return math.sqrt(max(float(d @ d - pull @ height @ pull), 0.0))

    found: dict[str, float] = {}
    batches = [
        (e.name, form, SHARE * e.magnitude)
        for e in truth.candidates(library, outputs)
        for form, _ in truth.forms(e, library)
    ]
    batches += [(name, "outside", 1.0) for name in sorted(truth.OUTSIDE)]
    for i, (name, form, size) in enumerate(batches):
        if progress is not None:
            progress("calibration", i, len(batches))
        try:
            found[f"{name}:{form}"] = strength((truth.Part(name, form, size, 0.0),)) / size
        except Exception:  # these numbers make no mechanism: it cannot be withheld
            found[f"{name}:{form}"] = 0.0
    return found


def packaged_scales() -> dict[str, float]:
    """What :func:`calibrate` gave, from the package."""
    file = Path(__file__).parent / "action_scales.json"
    data: dict[str, float] = json.loads(file.read_text(encoding="utf-8"))
    return data


if __name__ == "__main__":
    rounded = {name: float(f"{value:.6g}") for name, value in calibrate().items()}
    target = Path(__file__).parent / "action_scales.json"
    target.write_text(json.dumps(rounded, indent=1, sort_keys=True) + "\n", encoding="utf-8")
