"""The steps of the search by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from unmodeled import Effect
from unmodeled.search.evidence import best_of
from unmodeled.search.options import Options
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.search import search

from .conftest import spring_record

LAWS = {"sides": lambda x: np.tanh(60.0 * x), "wave": lambda x: 0.15 * np.cos(70.0 * x)}


def decoy(x):
    """Nearly the sum of both."""
    return 0.97 * LAWS["sides"](x) + LAWS["wave"](x) + 0.04 * np.sin(90.0 * x)


def law(name, force):
    return Effect(
        name=name, component="spring", unit="N", scale=1.0,
        regressor=lambda r, _: force(r.inputs["x"]),
    )  # fmt: skip


def test_a_law_that_nearly_is_the_sum_of_two_is_no_answer(spring):
    """It is the best single one; beside the first of the two, the second is better."""
    record = spring_record("fit", 2, seed=5)
    x = record.inputs["x"]
    total = sum(f(x) for f in LAWS.values())
    record = replace(record, outputs={"force": record.outputs["force"] + total})
    effects = [law("decoy", decoy), *(law(n, f) for n, f in LAWS.items())]
    problem = prepare(ready_records(spring, [record]), effects, (), Options())
    found = search(problem, Options(max_effects=2))
    best = best_of(problem, list(found.sets.values()))
    assert {problem.causes[i].name for i in best.causes} == {*LAWS}
