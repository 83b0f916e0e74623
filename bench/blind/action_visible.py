"""Which effects of the whole action could be named at all, with strokes of a finger and cameras.

For each effect of the library, the best strokes are chosen for this effect alone, as if one knew
that it acts: about the most that a plan can reach with strokes of this pool (greedy choice).
Expected log evidence is that of the linear model, at half, once and twice the size that one would
expect, relative to the best rival (a name) or to the second best one (a class of two). No truth and
no diagnosis.

    PYTHONPATH=bench python -m blind.action_visible [--pool 150] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from feltmb.gap.criteria import least_odds
from feltmb.gap.information import WIDE, Information, information, planned
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from blind.action_requests import ActionRequests
from blind.action_truth import NOISE_CAMERA
from feltmb import gap
from feltmb.adapters import MechanismModel, planned_strokes
from feltmb.data import Array
from feltmb.files import Store
from feltmb.gap.score import all_candidates

#: Output of a load cell, which keeps its noise.
FORCE = "finger.force"
COUNTS = (0, 2, 4, 6)
SIZES = (0.5, 1.0, 2.0)


def margins(
    matrix: Array, parameters: int, one: int, same: NDArray[np.bool_]
) -> tuple[float, float]:
    """Expected log evidence of a candidate at its scale against its best and second best rival."""
    pp = cho_factor(matrix[:parameters, :parameters])
    pe = matrix[:parameters, parameters:]
    absorbed = cho_solve(pp, pe)
    row = matrix[parameters + one, parameters:] - pe[:, one] @ absorbed
    own = np.diag(matrix)[parameters:] - np.sum(pe * absorbed, axis=0)
    own = np.maximum(own, 1e-300)
    against = 0.5 * np.maximum(own[one] - row**2 / (own + WIDE**-2), 0.0)
    rivals = np.sort(np.append(against[~same], 0.5 * own[one]))
    return float(rivals[0]), float(rivals[1])


def greedy(
    start: Array, pool: Sequence[Information], parameters: int, one: int, same: NDArray[np.bool_]
) -> list[tuple[float, float]]:
    """Margins after 0, 1, ... chosen experiments."""
    matrix, out = start, [margins(start, parameters, one, same)]
    for _ in range(COUNTS[-1]):
        found = [margins(matrix + i.matrix, parameters, one, same) for i in pool]
        best = int(np.argmax([f[0] for f in found]))
        matrix = matrix + pool[best].matrix
        out.append(found[best])
    return out


def main() -> None:
    """Print the table, and one line for each effect."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pool", type=int, default=150)
    parser.add_argument("--folder", type=Path)
    given = parser.parse_args()
    machine = ActionRequests()
    model = machine.model
    assert isinstance(model, MechanismModel)
    every = all_candidates(machine.effects)
    store = None if given.folder is None else Store(given.folder)
    strokes = planned_strokes(model)
    sensors = {
        n: s if n == FORCE else replace(s, sigma=NOISE_CAMERA)
        for n, s in strokes[0].sensors.items()
    }
    known = [information(model, planned(model, r, sensors), every, store=store) for r in strokes]
    pool = []
    for seed in range(given.pool):
        record = gap.draw_experiment(model, machine.limits, sensors=sensors, seed=seed)[2]
        found = information(model, record, every, store=store)
        if found is not None:
            pool.append(found)
        print(f"stroke {seed + 1} of {given.pool}", flush=True)
    priors = [1.0 / p.sd**2 if 0.0 < p.sd < math.inf else 0.0 for p in model.parameters]
    start = np.diag([*priors, *np.zeros(len(every))]) + sum(k.matrix for k in known if k)
    names = [t.name for t in every]
    margin: dict[str, list[list[tuple[float, float]]]] = {}
    for one, name in enumerate(names):
        same = np.array([n == name for n in names])
        way = greedy(start, pool, len(model.parameters), one, same)
        margin.setdefault(name, []).append(way)
        print(name, every[one].shape, [round(m[0], 2) for m in way], flush=True)
    odds = least_odds(gap.Options().credibility)
    print(f"\n{len(margin)} effects, {len(pool)} strokes\n")
    print("| experiments | " + " | ".join(f"{s:g} size, name | class of two" for s in SIZES) + " |")
    for count in COUNTS:
        cells = []
        for size in SIZES:
            for which in (0, 1):
                seen = [np.mean([size**2 * w[count][which] > odds for w in ways])
                        for ways in margin.values()]  # fmt: skip
                cells.append(f"{np.mean(seen):.0%}")
        print(f"| {count} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
