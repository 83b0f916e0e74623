"""The small machine of the bench, key and hammer: truths, their records, and the stated model."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from blind import truth, truth_machine, truth_outside, truth_sensors
from blind.key_hammer import GATE_WIDTH, KeyHammer
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.files import NPZ_FAULTS, make_folder, read_json, read_npz, write_file

__all__ = ["draw", "make_records", "packaged_scales", "read_records", "stated_model"]

#: Number of cases that are simulated together.
CHUNK = 20
LARGEST_OUTSIDE = 30.0  # times the magnitude that a kind says is worth trying first
#: Relative standard deviation of ``truth.WANDERING`` from stroke to stroke [1].
VARIATION = 0.01
#: Standard deviation with which ``truth.draw`` draws the width of let-off and backcheck [m].
WIDTH_SD = 0.1 * GATE_WIDTH


def packaged_scales() -> dict[str, dict[str, float]]:
    """Noncentrality per unit of magnitude, {mode: {"effect:form": number}}, computed once.

    It is the norm of the change of the fitted records in units of the noise, beside the parameters
    and free start states of every 30 ms, at the drawing values.
    """
    path = Path(__file__).with_name("scales.json")
    data: dict[str, dict[str, float]] = json.loads(path.read_text(encoding="utf-8"))
    return data


def draw(seed: int, cases: int) -> list[Any]:
    """Truths as plain data."""
    kinds = truth.load_outside(truth_outside)
    largest = {name: LARGEST_OUTSIDE * kind.size for name, kind in kinds.items()}
    scales = packaged_scales()
    return [asdict(truth.draw(seed, n, scales, largest)) for n in range(cases)]


def make_records(folder: Path, numbers: Sequence[int]) -> None:
    """Write the records of some cases of ``truths.json`` into the folder."""
    kinds = truth.load_outside(truth_outside)
    truths = _read_truths(folder)
    cases = [truths[n] for n in numbers]
    strokes = truth.STROKES
    result = truth_machine.integrate(cases, [strokes] * len(cases), kinds)
    for i, case in enumerate(cases):
        views = truth_sensors.record(case, strokes, result, i * len(strokes), kinds)
        arrays = {f"{s}.{channel}": v for s, view in views.items() for channel, v in view.items()}

        def save(path: Path, arrays: dict[str, Any] = arrays, mode: str = case.mode) -> None:
            with path.open("wb") as file:
                np.savez_compressed(file, mode=np.array(mode), **arrays)

        write_file(make_folder(folder / "records") / f"{case.number}.npz", save, force=True)


def read_records(path: Path) -> list[Record]:
    """Records of a case with the properties of their sensors from a data sheet."""
    try:
        arrays = read_npz(path)
        mode = str(arrays.pop("mode"))
        return _records(arrays, mode)
    except NPZ_FAULTS as error:
        raise InvalidParameter(f"{path}: is damaged: {error}") from None


def stated_model() -> KeyHammer:
    """Model that states all tolerances of the machine and its variation from stroke to stroke.

    A machine with another width of the let-off than a model with a fixed width permits is not one
    without an effect: the records show a width that differs by 10 %.
    """
    model = KeyHammer(width_sd=WIDTH_SD)
    model.parameters = tuple(
        replace(p, process_sd=VARIATION * p.value) if p.name in truth.WANDERING else p
        for p in model.parameters
    )
    return model


def _read_truths(folder: Path) -> list[truth.Case]:
    cases = []
    for entry in read_json(folder / "truths.json"):
        parts = [truth.Part(**p) for p in entry.pop("parts")]
        cases.append(truth.Case(parts=parts, **entry))
    return cases


def _records(arrays: Mapping[str, Any], mode: str) -> list[Record]:
    return [
        record_of_view(
            stroke,
            {c: arrays[f"{stroke}.{c}"] for c in ("key", "hammer", "finger")},
            mode,
            "fit" if stroke in truth.FIT else "held_out",
        )
        for stroke in truth.STROKES
    ]


def record_of_view(name: str, view: Mapping[str, Any], mode: str, role: Any) -> Record:
    """What the sensors showed of one stroke, with what a data sheet says of them."""
    channels = {c: view[c] for c in ("key", "hammer")}
    sensors = {
        c: Sensor(
            name=c,
            unit="m",
            sigma=truth_sensors.NOISE_CAMERA,
            quantum=truth_sensors.PIXEL,
            # The mean of three frames is worth one independent look per three frames.
            correlation_time=1.5 * truth.FRAME,
        )
        for c in channels
    }
    return Record(
        name=name,
        time=np.arange(channels["key"].size) * truth.FRAME,
        inputs={"finger": view["finger"]},
        outputs=channels,
        sensors=sensors,
        input_mode="force" if mode == "force" else "motion",
        input_sigma={"finger": truth_sensors.NOISE_INPUT[mode]},
        role=role,
    )
