"""Expected information of experiments on the whole action: designed, random, repeated.

No truth and no diagnosis: the linearized expectation that `feltmb gap plan` works with, of all
default effects at half, once and twice the size that one would expect. It says what a plan promises
over chance; what comes of it is for the interactive bench.

    PYTHONPATH=bench python -m blind.action_plans [--whole] [FOLDER]

With --whole, records count to their end; else until 10 ms after the impact, as in a diagnosis
without further settings.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
from feltmb.gap.information import Information, Knowledge, information
from feltmb.gap.information import planned as expected_of

from feltmb import gap
from feltmb.adapters import finger_limits, mechanism_model, planned_strokes
from feltmb.files import Store
from feltmb.gap.score import all_candidates
from feltmb.mechanism import load_action

__all__ = ["compare"]

COUNTS = (1, 2, 4, 6)
DRAWS = 12


def compare(
    folder: Path | None = None, *, whole: bool = False
) -> list[tuple[str, int, float, float]]:
    """(policy, experiments, expected probability of the correct name, the same for two names)."""
    until = math.inf if whole else None
    model, effects = mechanism_model(load_action("steinway45"), until=until)
    limits = finger_limits(model)
    assert limits is not None
    planned = planned_strokes(model)
    sensors = planned[0].sensors
    every = all_candidates(effects)
    start = Knowledge.start(model, every, gap.Belief.even(every))
    cache = None if folder is None else Store(folder)

    def told(record: Any) -> Information:
        found = information(model, record, every, store=cache)
        assert found is not None
        return found

    def value(some: list[Information]) -> tuple[float, float]:
        known = start
        for one in some:
            known = known.plus(one)
        weights = known.belief.over(every)
        return known.names(), float(weights @ known.beliefs(2))

    out = []
    found = gap.design(
        model, effects, limits=limits, sensors=sensors, budget=float(COUNTS[-1]), folder=folder
    )
    designed = [told(e.record) for e in found.experiments]
    repeats = [told(expected_of(model, r, sensors)) for r in planned]
    drawn = [
        told(gap.draw_experiment(model, limits, sensors=sensors, seed=i)[2]) for i in range(DRAWS)
    ]
    generator = np.random.default_rng(0)
    for count in COUNTS:
        out.append(("designed", count, *value(designed[:count])))
        sets = [generator.choice(DRAWS, size=count, replace=False) for _ in range(20)]
        mean = np.mean([value([drawn[i] for i in s]) for s in sets], axis=0)
        out.append(("random", count, float(mean[0]), float(mean[1])))
        some = [repeats[i % len(repeats)] for i in range(count)]
        out.append(("repeats", count, *value(some)))
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--whole", action="store_true")
    given = parser.parse_args()
    for row in compare(given.folder, whole=given.whole):
        print("| {} | {} | {:.0%} | {:.0%} |".format(*row))
