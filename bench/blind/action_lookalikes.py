"""How far a withheld cause differs from the most similar effect of the library.

A cause that the library does not hold may move the machine as one of its effects does: another
angle of the hammer head looks like a marker that sits elsewhere. No diagnosis can call such a cause
unknown. Here every effect of the library takes the place of the cause in the generator's own
machine, together with all tolerances. What is left is the noncentrality of the difference:

    nc^2 = min over e, m, p, z of |W (y(cause) - y(e, m, p) - D z)|^2 + |(p - p0) / sd|^2 + |z|^2,

m the magnitude of effect e, without a prior and within the bounds of a diagnosis; the rest as in
:mod:`blind.action_strength`. One linearization at the tolerances that compensate the cause best
compares all effects. The most similar ones are fitted, from there and from the tolerances of the
case. One effect at a time: two together may come closer.

    PYTHONPATH=bench python -m blind.action_lookalikes FOLDER NUMBER...     cases of a bench folder
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from blind import action_truth as truth
from blind.action_strength import Compensation, compensations
from feltmb.files import read_json

__all__ = ["Lookalike", "lookalikes", "of_outside"]

SHARE = 0.3  # of the natural magnitude of an effect: the step of its difference
FITTED = 4  # effects that are fitted, the most similar ones by the linearization


@dataclass(frozen=True)
class Lookalike:
    """An effect of the library in the place of a withheld cause."""

    effect: str
    size: float
    """Magnitude [unit of the effect]."""
    left: float
    """Noncentrality of what it does not reproduce [1]."""
    linear: float
    """The same by the linearization [1]."""


def lookalikes(fit: Compensation, names: Sequence[str] = ()) -> list[Lookalike]:
    """Most similar effects of a part, the best first; ``names``: only of these."""
    *_, library, outputs = truth.setup()
    bare = fit.fit()
    r = fit.residual(bare.moved)
    joint = np.hstack([fit.columns(bare.moved), fit.variability])
    height = np.linalg.inv(joint.T @ joint + np.eye(joint.shape[1]))
    pull = joint.T @ r
    pull[: bare.moved.size] -= bare.moved

    found = []
    for rival, unit in _rivals(fit, library, outputs):
        if names and rival.name not in names:
            continue
        try:
            d = (r - fit.residual(bare.moved, rival)) / math.copysign(SHARE, rival.size)
        except Exception:  # this magnitude defines no valid mechanism
            continue
        own = joint.T @ d
        gain = float(d @ r - own @ height @ pull)
        size = gain / max(float(d @ d - own @ height @ own), 1e-12)  # in natural magnitudes
        sign = library.effect(rival.name).sign
        size = 0.0 if size * sign < 0.0 else size
        found.append((bare.cost - size * gain, size, rival, unit))
    found.sort(key=lambda f: f[0])
    out = []
    for linear, size, rival, unit in found[:FITTED]:
        # A large magnitude is outside the linearization: the fit starts within it.
        start = math.copysign(min(max(abs(size), 0.1), 1.0) * unit, size or rival.size)
        part, promised = truth.Part(rival.name, rival.form, start, 0.0), math.sqrt(max(linear, 0.0))
        for moved in (bare.moved, None):  # either may be the start of the lower minimum
            try:
                end = fit.fit(part, unit, moved)
            except Exception:
                continue
            assert end.rival is not None
            out.append(Lookalike(rival.name, end.rival.size, end.noncentrality, promised))
    best: dict[str, Lookalike] = {}
    for o in sorted(out, key=lambda o: o.left):
        best.setdefault(o.effect, o)
    return [*best.values()]


def _rivals(fit: Compensation, library: Any, outputs: Any) -> Iterator[tuple[truth.Part, float]]:
    """Effects that may take the place of a part, with a small magnitude, and their natural one."""
    own = {fit.part.name, truth.second_of(fit.part, library)}
    for e in truth.candidates(library, outputs, fit.bare.view):
        if e.name in own:
            continue
        size = SHARE * e.magnitude * (e.sign or 1)
        if not e.lower <= size <= e.upper:
            size = -size
        yield truth.Part(e.name, "A", size, 0.0), e.magnitude
        if e.shape_path and len(e.shapes) > 1:  # form B: another shape
            yield truth.Part(e.name, "B", size, 0.0), e.magnitude


def of_outside(case: truth.Case) -> list[list[dict[str, Any]]]:
    """By part, the most similar effects of a cause from outside; none of an effect of the library.

    Each: "effect", "size" [unit of the effect], "left" and "linear" [1], see :class:`Lookalike`.
    """
    if all(p.form != "outside" for p in case.parts):
        return [[] for _ in case.parts]
    found = []
    for part, make in zip(case.parts, compensations(case), strict=True):
        try:
            alike = lookalikes(make()) if make is not None and part.form == "outside" else []
        except Exception:  # not a valid mechanism
            alike = []
        found.append([asdict(o) for o in alike])
    return found


def _main(folder: Path, numbers: list[int]) -> None:
    truths = read_json(folder / "truths.json")
    for n in numbers:
        case = truth.from_dict(truths[n])
        for part, make in zip(case.parts, compensations(case), strict=True):
            if make is not None:
                found = [asdict(o) for o in lookalikes(make())]
                line = {"case": n, "part": part.name, "form": part.form, "alike": found}
                print(json.dumps(line), flush=True)


if __name__ == "__main__":
    _main(Path(sys.argv[1]), [int(n) for n in sys.argv[2:]])
