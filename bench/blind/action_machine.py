"""The full action as a machine of the bench: truths, their records, and what a data sheet says."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind import action_truth as truth
from unmodeled.data import Array, Record, Sensor
from unmodeled.files import make_folder, read_json, read_npz, write_file

__all__ = ["draw", "make_records", "packaged_scales", "read_records", "to_record"]

CHUNK = 1


def packaged_scales() -> dict[str, float]:
    """Noncentrality of effects and forms per unit of magnitude, computed once.

    It is the norm of the change of the fitted records in units of the noise, beside all tolerances
    and the variability from run to run, at the drawing values.
    """
    data: dict[str, float] = json.loads(Path(__file__).with_name("action_scales.json").read_text())
    return data


def draw(seed: int, cases: int) -> list[Any]:
    """Truths as plain data."""
    _, _, library, outputs = truth.setup()
    scales = packaged_scales()
    return [truth.as_dict(truth.draw(seed, n, scales, library, outputs)) for n in range(cases)]


def make_records(folder: Path, numbers: Sequence[int]) -> None:
    """Write the records of some cases of ``truths.json`` into the folder."""
    truths = read_json(folder / "truths.json")
    for n in numbers:
        _make(truth.from_dict(truths[n]), make_folder(folder / "records") / f"{n}.npz")


def read_records(path: Path) -> list[Record]:
    """Records of a case with the properties of their sensors from a data sheet."""
    file = read_npz(path)
    views = {
        s: {k.partition(".")[2]: v for k, v in file.items() if k.partition(".")[0] == s}
        for s in truth.STROKES
    }
    return [to_record(s, v) for s, v in views.items()]


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


def _make(case: truth.Case, path: Path) -> None:
    """Simulate and store the records of one case."""
    _, base, library, outputs = truth.setup()
    arrays: dict[str, Any] = {}
    for stroke in truth.STROKES:
        view, _ = truth.record(base, library, case, stroke, outputs)
        arrays |= {f"{stroke}.{channel}": values for channel, values in view.items()}

    def save(path: Path) -> None:
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)

    write_file(path, save, force=True)
