"""Small inputs with known answers, which diagnoses had wrong once: the answer and the list."""

from __future__ import annotations

from pathlib import Path

import pytest

from blind.marks import mark
from blind.yardstick import diagnosed
from blind.yardstick_sets import SETS
from unmodeled import Options, diagnose

#: Seconds of a diagnosis; none of them reaches it.
LIMIT = 120.0


def _slow(*cases):
    return [pytest.param(n, marks=pytest.mark.slow) for n in cases]


def _answer(name, number):
    task = SETS[name].task(number, Path())
    return task.truth, diagnosed(task.model, task.effects, task.records, LIMIT)


@pytest.mark.parametrize("number", [7, 12, 13, *_slow(0, 1, 2, 3, 5, 6, 8, 9, 10, 11)])
def test_a_wrong_scale_a_delay_or_a_parameter_is_told_as_such(number):
    assert mark(*_answer("signals", number)) == "right"


@pytest.mark.slow
def test_twice_the_input_of_a_lag_is_a_class_without_the_parameter():
    """The parameter would be 20 tolerances off; its fit ends elsewhere."""
    assert mark(*_answer("signals", 4)) == "class"


@pytest.mark.slow
def test_the_interval_of_a_lag_covers_it():
    truth, answer = _answer("signals", 14)
    assert mark(truth, answer) == "right"
    _, low, high = answer.parameters["tau"]
    assert low <= 0.07 <= high
    assert high - low < 0.001


@pytest.mark.parametrize("number", [3, 4, 7, 8, *_slow(1, 2, 5, 6)])
def test_trials_are_right(number):
    assert mark(*_answer("trials", number)) in ("right", "quiet")


@pytest.mark.slow
def test_an_overdamped_joint_lists_both_frictions_and_the_inertia():
    """Its records were made by steps of 0.25 ms: they are early by 0.1 ms, which does not matter.

    Semi-implicit Euler with this step leaves the noise, with smaller and larger ones more.
    """
    task = SETS["trials"].task(0, Path())
    report = diagnose(task.model, task.effects, task.records, options=Options(seconds=LIMIT))
    sizes = {c.name: c.size for c in report.changes}
    assert set(sizes) == {"viscous friction joint", "dry friction joint", "J"}
    assert sizes["dry friction joint"] == pytest.approx(0.2, abs=0.005)
    assert sizes["J"] == pytest.approx(0.01, abs=2e-4)
    (early,) = [n for n in report.named if n.cause not in sizes]
    assert (early.cause, early.magnitude) == ("delay of sensor position", pytest.approx(-1e-4, 0.2))
