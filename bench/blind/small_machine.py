"""The small machine of the bench: key and hammer, see :mod:`blind.key_hammer`."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from blind import truth, truth_machine, truth_outside, truth_sensors
from blind.calibration import calibrate, packaged_scales
from blind.key_hammer import GATE_WIDTH, KeyHammer, effects
from blind.machine import Machine
from feltmb import gap
from feltmb.data import Record, Sensor
from feltmb.errors import InvalidParameter
from feltmb.files import NPZ_FAULTS, make_folder, read_json, read_npz, write_file

__all__ = ["KeyHammerMachine", "load_kinds", "record_of_view", "stated_model"]

LARGEST_OUTSIDE = 30.0  # times the magnitude that a kind says is worth trying first
#: Relative standard deviation of ``truth.WANDERING`` from stroke to stroke [1].
VARIATION = 0.01
#: Standard deviation with which ``truth.draw`` draws the width of let-off and backcheck [m].
WIDTH_SD = 0.1 * GATE_WIDTH


class KeyHammerMachine(Machine):
    """Key and hammer, with a library of 22 effects; takes further causes from a Python file."""

    name = "key_hammer"
    chunk = 20
    generator = ("truth.py", "truth_machine.py", "truth_sensors.py", "truth_outside.py")
    engine = (
        "lumped.py",
        "key_hammer.py",
        *(f"network/{n}.cpp" for n in ("bind", "dynamics", "network", "simulate", "slopes")),
    )

    def draw(self, seed: int, cases: int, outside: Path | None) -> list[Any]:
        kinds = load_kinds(outside)
        scales = packaged_scales()
        new = {k: v for k, v in kinds.items() if f"{k}:outside" not in scales["force"]}
        if new:
            for mode, found in calibrate(new, only_outside=True).items():
                scales[mode] |= found
        largest = {name: LARGEST_OUTSIDE * kind.size for name, kind in kinds.items()}
        return [asdict(truth.draw(seed, n, scales, largest)) for n in range(cases)]

    def make_records(self, folder: Path, outside: Path | None, numbers: Sequence[int], /) -> None:
        kinds = load_kinds(outside)
        truths = _read_truths(folder)
        cases = [truths[n] for n in numbers]
        strokes = truth.STROKES
        result = truth_machine.integrate(cases, [strokes] * len(cases), kinds)
        for i, case in enumerate(cases):
            views = truth_sensors.record(case, strokes, result, i * len(strokes), kinds)
            arrays = {
                f"{s}.{channel}": v for s, view in views.items() for channel, v in view.items()
            }

            def save(path: Path, arrays: dict[str, Any] = arrays, mode: str = case.mode) -> None:
                with path.open("wb") as file:
                    np.savez_compressed(file, mode=np.array(mode), **arrays)

            write_file(make_folder(folder / "records") / f"{case.number}.npz", save, force=True)

    def make_answers(self, folder: Path, outside: Path | None, numbers: Sequence[int], /) -> None:
        kinds = load_kinds(outside)
        truths = _read_truths(folder)
        cases = [truths[n] for n in numbers]
        # Every case without each of its effects, for the moment from which they show.
        lacking = [
            replace(case, parts=[q for q in case.parts if q is not part])
            for case in cases
            for part in case.parts
        ]
        both = [*cases, *lacking]
        strokes = truth.STROKES
        result = truth_machine.integrate(both, [strokes] * len(both), kinds)
        ideal = [
            truth_sensors.record(c, strokes, result, i * len(strokes), kinds, ideal=True)
            for i, c in enumerate(both)
        ]
        without = iter(ideal[len(cases) :])
        for i, case in enumerate(cases):
            answer = _answer(case, result, i * len(strokes), kinds)
            for told in answer["parts"]:
                view = next(without)
                if told["component"] != "input":  # what is recorded of the input moves no camera
                    moments = {k: truth_sensors.shows(ideal[i][k], view[k]) for k in strokes}
                    told["shows"] = {k: t for k, t in moments.items() if math.isfinite(t)}
            self.write_answer(folder, case.number, answer)

    def read_records(self, path: Path) -> list[Record]:
        try:
            arrays = read_npz(path)
            mode = str(arrays.pop("mode"))
            return _records(arrays, mode)
        except NPZ_FAULTS as error:
            raise InvalidParameter(f"{path}: is damaged: {error}") from None

    def diagnose(
        self,
        records: Sequence[Record],
        names: Sequence[str] = (),
        options: gap.Options | None = None,
    ) -> Any:
        library = [e for e in effects() if not names or e.name in names]
        return gap.diagnose(stated_model(), library, records, options=options or self.options)


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


def load_kinds(outside: Path | None) -> dict[str, Any]:
    """Kinds from outside the library: the packaged ones and those of a Python file.

    Raises
    ------
    InvalidParameter
        The file cannot be loaded, or a kind in it lacks what it needs; all faults at once.
    """
    kinds = truth.load_outside(truth_outside)
    if outside is None:
        return kinds
    if not outside.is_file():
        raise InvalidParameter(
            f"{outside}: there is no such file; expected Python that defines KINDS"
        )
    spec = importlib.util.spec_from_file_location("feltmb_outside", outside)
    if spec is None or spec.loader is None:
        raise InvalidParameter(f"{outside}: is no Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise InvalidParameter(f"{outside}: {type(error).__name__}: {error}") from None
    faults = []
    found = getattr(module, "KINDS", None)
    if not isinstance(found, (tuple, list)) or not found:
        raise InvalidParameter(f"{outside}: expected KINDS, a tuple of kinds, see `--help`")
    onsets = ("start", "key", "bed", "string", "letoff", "check")
    for i, kind in enumerate(found):
        name = getattr(kind, "name", None)
        where = f"KINDS[{i}] ({name})"
        for attribute in ("name", "component", "onset"):
            if not isinstance(getattr(kind, attribute, None), str):
                faults.append(f"{where}: {attribute} is missing, expected a text")
        if getattr(kind, "onset", None) not in onsets:
            faults.append(f"{where}: onset, expected one of {', '.join(onsets)}")
        size = getattr(kind, "size", None)
        if not (isinstance(size, (int, float)) and math.isfinite(size) and size > 0.0):
            faults.append(f"{where}: size = {size!r}, expected a number > 0")
        if not (hasattr(kind, "force") or hasattr(kind, "observe")):
            faults.append(f"{where}: has neither force nor observe")
        if name in kinds or name in truth.EFFECTS:
            faults.append(f"{where}: the name is taken")
    if faults:
        raise InvalidParameter("\n".join(f"{outside}: {f}" for f in faults))
    return {**kinds, **{kind.name: kind for kind in found}}


def _read_truths(folder: Path) -> list[truth.Case]:
    cases = []
    for entry in read_json(folder / "truths.json"):
        parts = [truth.Part(**p) for p in entry.pop("parts")]
        cases.append(truth.Case(parts=parts, **entry))
    return cases


def _answer(
    case: truth.Case, result: truth_machine.Strokes, first: int, kinds: Mapping[str, Any]
) -> dict[str, Any]:
    """What the scorer needs to know of a case."""
    parts = []
    for part in case.parts:
        if part.form == "outside":
            component, what = kinds[part.name].component, kinds[part.name].onset
        else:
            component, what = truth.EFFECTS[part.name]
        onsets = {
            stroke: truth_sensors.onset(case, result, first + k, what)
            for k, stroke in enumerate(truth.STROKES)
        }
        parts.append({**asdict(part), "component": component, "onset": onsets})
    return {"number": case.number, "mode": case.mode, "parts": parts}


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
