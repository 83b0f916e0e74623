"""A plain engineer's fit: least squares with the right set, starts free, within three tolerances.

    python bench/blind/engineer.py measured 4 "dry friction arm" "quadratic friction arm"

prints the rms of each output in the held-out records, whose starts alone are fitted. Each output
counts by its motion.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from blind.yardstick_sets import SETS
from unmodeled import Options
from unmodeled.search.fit import empty_point
from unmodeled.search.linear import EvaluationRequest, Point, count_global, evaluate, local_of
from unmodeled.search.problem import Member, Members, Observed, Problem
from unmodeled.search.records import prepare, ready_records

Array = NDArray[np.float64]
#: Growing parts of the records that are fitted.
PARTS = (0.05, 0.2, 0.5, 1.0)
#: Largest deviation of a parameter from its tabulated value, in standard deviations.
TOLERANCES = 3.0


def fitted(problem: Problem, members: Members, x: Array | None = None) -> tuple[Array, Array]:
    """Unknowns of all records by least squares, and the rms by output.

    ``x``: these unknowns of the machine are kept, and the starts of the held-out records fitted.
    """
    records = problem.fit if x is None else problem.held_out
    start = empty_point(problem, members, records)
    g = count_global(problem, members) if x is None else 0
    size = len(problem.free) + len(problem.effects_of(members))
    first = np.ones(g)
    first[: len(problem.free)] = 0.0
    first[size:] = 0.0
    z = np.concatenate([first, *start.local])
    counts = [len(local_of(problem, members, o)) for o in records]
    weight = 1.0 / np.maximum(problem.motion, 1e-300)

    def asked(z: Array, part: float) -> tuple[list[Array], list[Array]]:
        ends = np.cumsum([g, *counts])
        local = tuple(z[a:b] for a, b in itertools.pairwise(ends))
        cut: tuple[Observed, ...] = tuple(o.first(part) for o in records)
        own = z[:g] if x is None else x
        seen = evaluate(problem, [EvaluationRequest(members, Point(own, local), cut)])[0]
        rest, slopes = [], []
        for k, (o, linear) in enumerate(zip(cut, seen, strict=True)):
            scale = o.sd * weight
            rest.append(np.nan_to_num(linear.residual * scale, nan=1e6).ravel())
            columns = np.zeros((*linear.residual.shape, z.size))
            columns[..., :g] = linear.by_global[..., :g]
            columns[..., ends[k] : ends[k + 1]] = linear.by_local
            slopes.append(-(columns * scale[..., None]).reshape(linear.residual.size, z.size))
        return rest, slopes

    low, high = np.full(z.size, -np.inf), np.full(z.size, np.inf)
    if g:
        own_low, own_high = problem.parameter_bounds
        known = TOLERANCES / np.sqrt(problem.prior)
        low[: own_low.size] = np.maximum(own_low, -known) - 1e-12
        high[: own_high.size] = np.minimum(own_high, known) + 1e-12
        for j, i in enumerate(m.cause for m in members):
            a, b = problem.causes[i].bounds
            low[own_low.size + j], high[own_low.size + j] = a - 1e-12, b
        low[size:g], high[size:g] = -3.0, 3.0
    for part in PARTS if z.size else ():
        z = least_squares(
            lambda z, part=part: np.concatenate(asked(z, part)[0]),
            np.clip(z, low + 1e-9, high - 1e-9),
            lambda z, part=part: np.concatenate(asked(z, part)[1]),
            bounds=(low, high),
            x_scale="jac",
            max_nfev=60,
        ).x
    rest, _ = asked(z, 1.0)
    m = problem.motion.size
    squares = sum((r.reshape(-1, m) ** 2).sum(axis=0) for r in rest)
    samples = sum(o.samples for o in records)
    return z, problem.motion * np.sqrt(squares / samples)


def main() -> None:
    """Fit the named effects to a case and predict its held-out records."""
    name, case, *effects = sys.argv[1:]
    task = SETS[name].task(int(case), Path("out"))
    ready = ready_records(task.model, task.records)
    problem = prepare(ready, task.effects, None, Options())
    places = [next(i for i, c in enumerate(problem.causes) if c.name == e) for e in effects]
    members = tuple(
        Member(i, c.effect.shapes[0])
        for i in sorted(places)
        if (c := problem.causes[i]).effect is not None
    )
    z, rms = fitted(problem, members)
    x = z[: count_global(problem, members)]
    _, held = fitted(problem, members, x)
    free = len(problem.free)
    theta = problem.tabulated[problem.free] + problem.unit * x[:free]
    scales = [e.scale for e in problem.effects_of(members)]
    print("parameters", theta, "magnitudes", scales * x[free : free + len(scales)], x)
    print("fit", rms, "held out", held)


if __name__ == "__main__":
    main()
