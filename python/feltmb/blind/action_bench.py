"""Cases of the full action for the bench: drawn, made into records, diagnosed one at a time."""

from __future__ import annotations

import functools
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.blind import action_truth as truth
from feltmb.blind.action_calibration import packaged_scales, to_record
from feltmb.blind.action_strength import noncentralities
from feltmb.data import Record
from feltmb.files import write_file

__all__ = ["SOURCES", "answer", "diagnose", "draw_all", "make_records", "read_records"]

#: What a result of the engine depends on beside the engine.
SOURCES = ("subjects", "params", "blind/action_bench.py", "blind/action_calibration.py")
#: Tolerance of the nominal's integrator: near let-off a motion is heard to jump by 0.1 of the
#: camera's noise at 3e-6, by 0.02 at this one.
RTOL = 1e-6
#: What the cases depend on.
GENERATOR = ("blind/action_truth.py", "blind/action_scales.json")


def draw_all(seed: int, cases: int) -> list[dict[str, Any]]:
    """Truths of a bench as plain data."""
    _, _, library, outputs = truth.setup()
    scales = packaged_scales()
    return [truth.as_dict(truth.draw(seed, n, scales, library, outputs)) for n in range(cases)]


@functools.cache
def _setup() -> tuple[Any, ...]:
    return truth.setup()


def make_records(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """Simulate and store the records of one case; what the scorer must know of it."""
    _, base, library, outputs = _setup()
    case = truth.from_dict(data)
    arrays: dict[str, Any] = {}
    onsets: dict[str, list[float]] = {}
    for stroke in truth.STROKES:
        view, _ = truth.record(base, library, case, stroke, outputs)
        onsets[stroke] = [truth.onset(p, view) for p in case.parts]
        arrays |= {f"{stroke}.{channel}": values for channel, values in view.items()}

    def save(path: Path) -> None:
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)

    write_file(path, save, force=True)
    return answer(case, library, onsets)


def answer(case: truth.Case, library: Any, onsets: dict[str, list[float]]) -> dict[str, Any]:
    """What the scorer needs to know of a case."""
    parts = []
    strengths = noncentralities(case)
    for k, part in enumerate(case.parts):
        data = False
        if part.form == "outside":
            component = truth.OUTSIDE[part.name][0]
        else:
            entry = library.effect(part.name)
            component = entry.component
            data = truth.is_signal(entry) or entry.kind in ("sensor", "input")
        times = {s: onsets[s][k] for s in onsets}
        told = {"component": component, "data": data, "onset": times}
        if strengths[k] is not None:
            told["nc"] = strengths[k]
        parts.append({**asdict(part), **told})
    return {"number": case.number, "mode": "force", "parts": parts}


def read_records(path: Path) -> list[Record]:
    """Records of a case with what a data sheet says of their sensors."""
    outputs = _setup()[3]
    with np.load(path) as file:
        return [
            to_record(s, {c: file[f"{s}.{c}"] for c in ("force", *outputs)}, outputs)
            for s in truth.STROKES
        ]


def diagnose(records: Sequence[Record], effects: Sequence[str] = ()) -> Any:
    """Diagnosis of one case with the packaged action, all tolerances and all effects.

    ``effects``: those of the library that are asked; default: all that the records could show.
    """
    from feltmb import gap
    from feltmb.adapters import mechanism_nominal

    action, _, library, outputs = _setup()
    names = list(effects) or [e.name for e in truth.candidates(library, outputs)]
    nominal, known = mechanism_nominal(
        action, library=library, effects=names, shooting="single", rtol=RTOL, workers=1
    )
    nominal = nominal.with_floor(records, truth.VARIATION)  # type: ignore[attr-defined]
    options = gap.Options(bootstrap=0, restarts=0, width=3, max_effects=3, advice=False)
    return gap.diagnose(nominal, known, records, options=options)


def oracle(folder: Path, number: int, records: Sequence[Record]) -> dict[str, Any] | None:
    """Diagnosis with a library of the true effects only; None where it does not apply."""
    known = json.loads((folder / "answers" / f"{number}.json").read_text("utf-8"))
    names = sorted({p["name"] for p in known["parts"]})
    if not names or any(p["form"] == "outside" for p in known["parts"]):
        return None
    try:
        report = diagnose(records, names)
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}", "closed": math.nan, "named": []}
    return {"closed": float(report.how_far.closed), "named": list(report.named)}


def result(folder: Path, number: int, *, with_oracle: bool) -> dict[str, Any]:
    """What the engine says of a case, as plain data."""
    from feltmb.blind.bench import summarize

    records = read_records(folder / "records" / f"{number}.npz")
    clock = time.process_time()
    found: dict[str, Any] = {"number": number}
    try:
        report = diagnose(records)
    except Exception as error:  # a crash is a result too, and a bad one
        found["error"] = f"{type(error).__name__}: {error}"
    else:
        found |= summarize(report)
    found["cpu_seconds"] = time.process_time() - clock
    if with_oracle and "error" not in found:
        found["oracle"] = oracle(folder, number, records)
    return found
