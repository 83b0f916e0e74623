"""Tests whether the fit of the whole action finds its minimum, and at which cost.

Development cases of the whole action, each with nothing withheld and again, at the same tolerances,
with one withheld effect; with ``--drawn``, the cases of the blind bench as they are, with all kinds
of records. The model alone is fitted as in a diagnosis from its priors and from random starts
within them, and once, without paths along the records, from the tolerances of the truth. A fit has
found its minimum if its log evidence is at most ``SAME`` below that of the fit from the truth. A
line of JSON a fit; what is in the file is not done again.

    PYTHONPATH=bench python -m blind.action_fits -o out/fits.jsonl --cases 10
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from feltmb.fit.problem import Point, Problem
from feltmb.fit.solve import Fit, FitSettings, fit_problem, polish
from feltmb.gap.judged_data import prepare, ready

from blind import action_truth as truth
from blind.action_calibration import packaged_scales, to_record
from blind.action_machine import RTOL
from feltmb.adapters import mechanism_model
from feltmb.data import Array
from feltmb.gap.evidence import full_evidence

__all__ = ["Result", "cases", "drawn_cases", "measure", "problem_of", "read", "starts", "table"]

#: A fit has found the minimum if its log evidence differs from the fit from the truth by less.
SAME = 2.0
SEED = 20261203

Way = Callable[[Problem, Point], Fit]


@dataclass(frozen=True)
class Result:
    """One fit."""

    number: int
    view: str
    """Kind of the records."""
    withheld: str
    """Names of the withheld effects; empty: none."""
    start: str
    """truth, priors, or random K"""
    evidence: float
    cost: float
    samples: int
    explains: bool
    converged: bool
    farthest: float
    """Largest deviation of a tolerance from its prior, in prior standard deviations."""
    seconds: float
    """Processor time [s]."""


def cases(numbers: Sequence[int], seed: int = SEED) -> Iterator[truth.Case]:
    """Cases without an effect, each followed by the same case with one withheld effect."""
    one_effect = (0.0, 1.0, 0.0, 0.0, 0.0)
    for one in drawn_cases(numbers, seed, mix=one_effect, views={"force": 1.0}):
        yield replace(one, parts=())
        yield one


def drawn_cases(numbers: Sequence[int], seed: int = SEED, **shares: Any) -> Iterator[truth.Case]:
    """Cases of the blind bench; ``shares``: other shares of effects and views."""
    _, _, library, outputs = truth.setup()
    scales = packaged_scales()
    for n in numbers:
        yield truth.draw(seed, n, scales, library, outputs, **shares)


def problem_of(case: truth.Case) -> Problem:
    """The model alone and the fitted records of a case, prepared as in a diagnosis."""
    action, base, library, outputs = truth.setup()
    given = [to_record(s, truth.record(base, library, case, s, outputs)[0]) for s in truth.FIT]
    made, _ = mechanism_model(
        action,
        channels=[*given[0].outputs],
        library=library,
        effects=["input_gain"],
        rtol=RTOL,
        workers=1,
    )
    model, records, checks, _ = ready(made, given)
    model = model.with_variability(records, truth.VARIATION)  # type: ignore[attr-defined]
    return Problem(model, prepare(model, records, checks, None))


def starts(problem: Problem, case: truth.Case, count: int) -> Iterator[tuple[str, Array]]:
    """Names and parameters of the start points: truth, priors, draws from the priors."""
    everything = problem.model.parameters
    prior = np.array([p.value for p in everything])
    yield "truth", np.array([case.tolerances.get(p.name, p.value) for p in everything])
    yield "priors", prior
    for k in range(count):
        rng = np.random.default_rng([*case.seed, 11, k])
        drawn = [
            np.clip(p.value + p.sd * rng.standard_normal(), p.lower, p.upper)
            if p.name in case.tolerances
            else p.value
            for p in everything
        ]
        yield f"random {k + 1}", np.array(drawn)


def the_fit(problem: Problem, point: Point) -> Fit:
    """Fit as in a diagnosis."""
    return fit_problem(problem, FitSettings(), point=point)


def from_truth(problem: Problem, point: Point) -> Fit:
    """Fit from a start near the minimum."""
    return polish(problem, point, 1.0, FitSettings())


def measure(
    chosen: Iterable[truth.Case], wanted: Sequence[str], file: Path, *, way: Way = the_fit
) -> None:
    """Fit from the given starts (truth, priors, random K), except for results in the file."""
    done = {(r.number, r.withheld, r.start) for r in read(file)}
    most = max((int(name.partition(" ")[2] or 0) for name in wanted), default=0)
    for case in chosen:
        withheld = ", ".join(part.name for part in case.parts)
        left = [name for name in wanted if (case.number, withheld, name) not in done]
        if not left:
            continue
        problem = problem_of(case)
        places = dict(starts(problem, case, most))
        for name in left:
            own = from_truth if name == "truth" else way
            found = _fitted(problem, case, withheld, name, places[name], own)
            with file.open("a", encoding="utf-8") as f:
                f.write(json.dumps(asdict(found)) + "\n")


def read(file: Path) -> list[Result]:
    """Results in a file; none if the file does not exist."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [Result(**json.loads(line)) for line in lines]


def _fitted(
    problem: Problem, case: truth.Case, withheld: str, name: str, theta: Array, way: Way
) -> Result:
    problem.model.forget()
    clock = time.process_time()
    fit = way(problem, problem.start(theta=theta))
    return Result(
        number=case.number,
        view=case.view,
        withheld=withheld,
        start=name,
        evidence=full_evidence(fit, 1.0),
        cost=fit.cost,
        samples=problem.samples,
        explains=fit.explains,
        converged=fit.converged,
        farthest=float(np.max(np.abs(fit.prior_deviation))),
        seconds=time.process_time() - clock,
    )


def table(results: Sequence[Result], others: Sequence[Result] = ()) -> str:
    """Markdown: share of the fits that found their minimum, and processor time.

    ``others``: fits of the same cases by another engine. Of the two fits from the truth, the better
    one is used.
    """
    truths: dict[tuple[int, str], float] = {}
    best: dict[tuple[int, str], float] = {}
    for r in (*results, *others):
        key = (r.number, r.withheld)
        best[key] = max(best.get(key, -np.inf), r.evidence)
        if r.start == "truth":
            truths[key] = max(truths.get(key, -np.inf), r.evidence)
    results = [r for r in results if (r.number, r.withheld) in truths]
    lines = [
        "| records | start | fits | found its minimum | within 2 of the best known | "
        "median [s] | mean [s] | most [s] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for view in sorted({r.view for r in results}):
        for kind in ("truth", "priors", "random"):
            some = [r for r in results if r.view == view and r.start.startswith(kind)]
            if not some:
                continue
            at = [(r.number, r.withheld) for r in some]
            found = [r.evidence >= truths[k] - SAME for r, k in zip(some, at, strict=True)]
            near = [r.evidence >= best[k] - SAME for r, k in zip(some, at, strict=True)]
            seconds = [r.seconds for r in some]
            lines.append(
                f"| {view} | {kind} | {len(some)} | "
                f"{np.mean(found):.0%} | {np.mean(near):.0%} | {np.median(seconds):.1f} | "
                f"{np.mean(seconds):.1f} | {np.max(seconds):.1f} |"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--from", dest="wanted", default="truth,priors,random 1")
    parser.add_argument("--drawn", action="store_true", help="the cases of the blind bench")
    parser.add_argument("--beside", type=Path, help="results of another engine")
    told = parser.parse_args()
    # Even numbers belong to the development half.
    draw = drawn_cases if told.drawn else cases
    measure(draw(range(0, 2 * told.cases, 2), told.seed), told.wanted.split(","), told.output)
    print(table(read(told.output), [] if told.beside is None else read(told.beside)))
