"""Tests whether the fit of the whole action finds its minimum, and at which cost.

Development cases of the whole action, each with nothing withheld and again, at the same tolerances,
with one withheld effect. The model alone is fitted from its priors, from random starts within them,
and from the tolerances of the truth. A fit has found its minimum if its log evidence is at most
``SAME`` below that of the fit from the truth. A line of JSON a fit; what is in the file is not done
again.

    PYTHONPATH=bench python -m blind.action_fits -o out/fits.jsonl --cases 10
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from blind import action_truth as truth
from blind.action_calibration import packaged_scales, to_record
from blind.action_machine import RTOL
from feltmb.adapters import mechanism_model
from feltmb.data import Array
from feltmb.fit.problem import Point, Problem
from feltmb.fit.solve import Fit, FitSettings, fit_problem
from feltmb.gap.checks import check_records
from feltmb.gap.judged_data import prepare
from feltmb.gap.refine import full_evidence

__all__ = ["Result", "cases", "measure", "problem_of", "read", "starts", "table"]

#: A fit has found the minimum if its log evidence differs from the fit from the truth by less.
SAME = 2.0
SEED = 20261203

Way = Callable[[Problem, Point], Fit]


@dataclass(frozen=True)
class Result:
    """One fit."""

    number: int
    withheld: str
    """Name of the withheld effect; empty: none."""
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
    _, _, library, outputs = truth.setup()
    scales = packaged_scales()
    for n in numbers:
        one = truth.draw(
            seed, n, scales, library, outputs, mix=(0.0, 1.0, 0.0, 0.0, 0.0), views={"force": 1.0}
        )
        yield replace(one, parts=())
        yield one


def problem_of(case: truth.Case) -> Problem:
    """The model alone and the fitted records of a case."""
    action, base, library, outputs = truth.setup()
    records = [to_record(s, truth.record(base, library, case, s, outputs)[0]) for s in truth.FIT]
    model, _ = mechanism_model(
        action, library=library, effects=["input_gain"], rtol=RTOL, workers=1
    )
    model = model.with_variability(records, truth.VARIATION)  # type: ignore[attr-defined]
    return Problem(model, prepare(model, records, check_records(records), None))


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
    return fit_problem(problem, FitSettings(restarts=0), point=point)


def measure(
    numbers: Sequence[int],
    wanted: Sequence[str],
    file: Path,
    *,
    seed: int = SEED,
    way: Way = the_fit,
) -> None:
    """Fit from the given starts (truth, priors, random K), except for results in the file."""
    done = {(r.number, r.withheld, r.start) for r in read(file)}
    most = max((int(name.partition(" ")[2] or 0) for name in wanted), default=0)
    for case in cases(numbers, seed):
        withheld = case.parts[0].name if case.parts else ""
        left = [name for name in wanted if (case.number, withheld, name) not in done]
        if not left:
            continue
        problem = problem_of(case)
        places = dict(starts(problem, case, most))
        for name in left:
            found = _fitted(problem, case.number, withheld, name, places[name], way)
            with file.open("a", encoding="utf-8") as f:
                f.write(json.dumps(asdict(found)) + "\n")


def read(file: Path) -> list[Result]:
    """Results in a file; none if the file does not exist."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [Result(**json.loads(line)) for line in lines]


def _fitted(
    problem: Problem, number: int, withheld: str, name: str, theta: Array, way: Way
) -> Result:
    problem.model.forget()
    clock = time.process_time()
    fit = way(problem, problem.start(theta=theta))
    return Result(
        number=number,
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
        "| withheld | start | fits | found its minimum | within 2 of the best known | "
        "median [s] | mean [s] | most [s] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for withheld in (False, True):
        for kind in ("truth", "priors", "random"):
            some = [r for r in results if bool(r.withheld) == withheld and r.start.startswith(kind)]
            if not some:
                continue
            at = [(r.number, r.withheld) for r in some]
            found = [r.evidence >= truths[k] - SAME for r, k in zip(some, at, strict=True)]
            near = [r.evidence >= best[k] - SAME for r, k in zip(some, at, strict=True)]
            seconds = [r.seconds for r in some]
            lines.append(
                f"| {'one effect' if withheld else 'nothing'} | {kind} | {len(some)} | "
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
    parser.add_argument("--beside", type=Path, help="results of another engine")
    told = parser.parse_args()
    # Even numbers belong to the development half.
    measure(range(0, 2 * told.cases, 2), told.wanted.split(","), told.output, seed=told.seed)
    print(table(read(told.output), [] if told.beside is None else read(told.beside)))
