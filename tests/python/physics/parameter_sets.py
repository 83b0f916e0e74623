"""Parameter sets of the upright action around its own, each through a forte stroke.

    python parameter_sets.py FIRST COUNT

Prints a line a set and a table of what became of them. A set is known by its number alone.
Materials and laws are scaled by 0.5 to 1.5; points of surfaces move by up to 3 mm in x and y, their
radii change by up to a half and at most 3 mm; in every fourth set by up to a half whatever their
size, which moves surfaces by decimeters.
"""

from __future__ import annotations

import random
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

import feltmb

KINDS = ("materials", "geometry", "both", "radii")
#: Ends of the paths of what is scaled.
MATERIALS = (
    *("mass", "inertia", "density", "area", "young_modulus", "second_moment", "tension"),
    *("linear_density", "damping_ratio", "stiffness", "k1", "k2", "k3"),
    *("amplitude", "b1", "b2", "alpha"),
    *(f"{branch}.{name}" for branch in ("loading", "unloading") for name in "abc"),
)
WALL = 60.0  # s a set: then it is given up, which is a reason


def values(action: feltmb.Action, number: int) -> tuple[str, dict[str, Any]]:
    """Kind and values by path of one set."""
    rng = random.Random(f"parameter set {number}")
    kind = KINDS[number % len(KINDS)]
    out: dict[str, Any] = {}
    for path, value, unit, _ in action.quantities():
        if path.startswith("surfaces."):
            if kind == "materials":
                continue
            if path.endswith(".point"):
                assert unit == "mm"
                moved = [v + rng.uniform(-3.0, 3.0) for v in value]
                out[path] = {"value": moved, "unit": unit}
            elif path.endswith(".radius"):
                change = value * rng.uniform(-0.5, 0.5)
                change = change if kind == "radii" else max(-3.0, min(3.0, change))
                out[path] = {"value": value + change, "unit": unit}
        elif kind in ("materials", "both") and path.endswith(tuple(f".{m}" for m in MATERIALS)):
            out[path] = {"value": value * rng.uniform(0.5, 1.5), "unit": unit}
    return kind, out


@dataclass(frozen=True)
class Outcome:
    """What became of a set: done, refused, failed, or wrong."""

    number: int
    kind: str
    status: str
    text: str


def outcome(action: feltmb.Action, number: int) -> Outcome:
    """Simulate one set."""
    kind, changed = values(action, number)
    try:
        varied = action.with_values(changed)
        varied.rest_pose  # noqa: B018
    except feltmb.Error as error:
        return Outcome(number, kind, "refused" if str(error).strip() else "wrong", str(error))
    try:
        run = feltmb.simulate(varied, "forte", max_wall=WALL)
    except feltmb.IntegrationError as error:
        return Outcome(number, kind, "failed" if str(error).strip() else "wrong", str(error))
    missing = run.energy["residual_relative"]
    sound = missing < 1e-3 and bool(np.all(np.isfinite(run.values)))
    text = f"{missing:.1e} of {run.energy['turned_over']:.3g} J, {run.stats['steps']} steps"
    return Outcome(number, kind, "done" if sound else "wrong", text)


def outcomes(first: int, count: int) -> list[Outcome]:
    """Simulate several sets, in their order."""
    action = feltmb.load_action("steinway45")
    return [outcome(action, number) for number in range(first, first + count)]


def table(found: list[Outcome]) -> str:
    """Counts by kind and status."""
    names = ("done", "refused", "failed", "wrong")
    rows = [f"{'':10}" + "".join(f"{name:>9}" for name in names)]
    for kind in (*KINDS, "all"):
        of = [o.status for o in found if kind in ("all", o.kind)]
        rows.append(f"{kind:10}" + "".join(f"{of.count(name):9}" for name in names))
    return "\n".join(rows)


if __name__ == "__main__":
    everything: list[Outcome] = []
    start, size = int(sys.argv[1]), int(sys.argv[2])
    for k in range(start, start + size):
        everything += outcomes(k, 1)
        one = everything[-1]
        print(one.number, one.kind, one.status, " ".join(one.text.split())[:300], flush=True)
    print(table(everything))
