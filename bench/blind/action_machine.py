"""The full action as a machine of the bench."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from blind import action_truth as truth
from blind.action_calibration import packaged_scales, to_record
from blind.action_lookalikes import of_outside
from blind.action_strength import noncentralities
from blind.machine import Machine
from feltmb import gap
from feltmb.adapters import mechanism_model
from feltmb.data import Record
from feltmb.errors import InvalidParameter
from feltmb.files import make_folder, read_json, read_npz, write_file

__all__ = ["ActionMachine"]

#: Tolerance of the model's integrator: near let-off a motion is seen to jump by 0.1 of the
#: camera's noise at 3e-6, by 0.02 at this one.
RTOL = 1e-6


class ActionMachine(Machine):
    """The packaged upright action with all its tolerances and effects."""

    name = "steinway45"
    generator = ("action_truth.py", "action_scales.json")
    engine = ("action_machine.py", "action_calibration.py")
    options = gap.Options(bootstrap=0, width=3, max_effects=3, advice=False)

    def draw(self, seed: int, cases: int, outside: Path | None) -> list[Any]:
        if outside is not None:
            raise InvalidParameter(
                f"{outside}: kinds of one's own are for the machine key_hammer; those of "
                f"{self.name} are in action_truth.py"
            )
        _, _, library, outputs = truth.setup()
        scales = packaged_scales()
        return [truth.as_dict(truth.draw(seed, n, scales, library, outputs)) for n in range(cases)]

    def make_records(self, folder: Path, _outside: Path | None, numbers: Sequence[int], /) -> None:
        truths = read_json(folder / "truths.json")
        for n in numbers:
            _make(truth.from_dict(truths[n]), make_folder(folder / "records") / f"{n}.npz")

    def make_answers(self, folder: Path, _outside: Path | None, numbers: Sequence[int], /) -> None:
        truths = read_json(folder / "truths.json")
        for n in numbers:
            self.write_answer(folder, n, _answer(truth.from_dict(truths[n])))

    def read_records(self, path: Path) -> list[Record]:
        file = read_npz(path)
        views = {
            s: {k.partition(".")[2]: v for k, v in file.items() if k.partition(".")[0] == s}
            for s in truth.STROKES
        }
        return [to_record(s, v) for s, v in views.items()]

    def diagnose(
        self,
        records: Sequence[Record],
        names: Sequence[str] = (),
        options: gap.Options | None = None,
    ) -> Any:
        action, _, library, outputs = _setup()
        first = records[0]
        seen = outputs if first.outputs.keys() >= {*outputs} else truth.ONE_CAMERA
        asked = list(names) or [e.name for e in truth.candidates(library, seen)]
        model, known = mechanism_model(
            action,
            channels=[*first.outputs],
            library=library,
            effects=asked,
            rtol=RTOL,
            workers=1,
        )
        return gap.diagnose(model, known, records, options=options or self.options)


@functools.cache
def _setup() -> tuple[Any, ...]:
    return truth.setup()


def _make(case: truth.Case, path: Path) -> None:
    """Simulate and store the records of one case."""
    _, base, library, outputs = _setup()
    arrays: dict[str, Any] = {}
    for stroke in truth.STROKES:
        view, _ = truth.record(base, library, case, stroke, outputs)
        arrays |= {f"{stroke}.{channel}": values for channel, values in view.items()}

    def save(path: Path) -> None:
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)

    write_file(path, save, force=True)


def _answer(case: truth.Case) -> dict[str, Any]:
    """What the scorer needs to know of a case.

    When an effect of the action first can act, apart from showing, is not defined.
    """
    _, base, library, outputs = _setup()
    moments = {s: truth.moments(base, library, case, s, outputs) for s in truth.STROKES}
    parts = []
    strengths, alike = noncentralities(case), of_outside(case)
    for k, part in enumerate(case.parts):
        data = False
        if part.form == "outside":
            component = truth.OUTSIDE[part.name][0]
        else:
            entry = library.effect(part.name)
            component = entry.component
            data = truth.is_signal(entry) or entry.kind in ("sensor", "input")
        told = {"component": component, "data": data, "onset": {}}
        if component != "input":  # what is recorded of the input moves no camera
            shown = {s: moments[s][k] for s in moments}
            told["shows"] = {s: t for s, t in shown.items() if math.isfinite(t)}
        if second := truth.second_of(part, library):
            told["second"] = second
        if strengths[k] is not None:
            told["nc"] = strengths[k]
        if alike[k]:
            told["alike"] = alike[k]
        parts.append({**asdict(part), **told})
    return {"number": case.number, "mode": case.view, "parts": parts}
