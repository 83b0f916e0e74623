"""Local minima over the start states of a record."""

from __future__ import annotations

import numpy as np
import pytest

from feltmb.fit.linearize import Place
from feltmb.fit.problem import Point, Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem, polish
from feltmb.fit.starts import from_other_starts
from feltmb.gap import OdeModel, Parameter, Record, Sensor, State

SIGMA, COUNT = 0.02, 101
TIME = np.linspace(0.0, 2.0, COUNT)
EDGES = np.arange(0, COUNT, 20)
SEGMENTS = np.column_stack([EDGES[:-1], EDGES[1:]])


def well(expected):
    """A state that moves to one of two wells; the output shows its square, and hardly its sign."""
    return OdeModel(
        states=[State(name="x", start=expected, start_sd=0.1, scale=0.1)],
        inputs=["u"],
        parameters=[Parameter(name="rate", value=2.0, sd=0.2)],
        rates=lambda t, x, u, p: (p["rate"] * x["x"] * (1.0 - x["x"] ** 2),),
        outputs={"y": lambda t, x, u, p: x["x"] ** 2 + 0.05 * x["x"]},
        name="well",
    )


def path(start):
    """Solution of x' = 2 x (1 - x^2)."""
    grown = start * np.exp(2.0 * TIME)
    return grown / np.sqrt(1.0 - start**2 + grown**2)


def wrong(expected, seed=1):
    """A fit of a record from the right well, in the left one."""
    x = path(0.05)
    y = x**2 + 0.05 * x + SIGMA * np.random.default_rng(seed).standard_normal(COUNT)
    record = Record(
        name="r",
        time=TIME,
        inputs={"u": np.zeros(COUNT)},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=SIGMA)},
    )
    model = well(expected)
    segmented = segment_record(model, record, {"y": Noise(SIGMA)}, None, SEGMENTS)
    problem = Problem(model, (segmented,))
    starts = path(-0.05)[SEGMENTS[:, 0]][:, None]
    point = Point(np.array([2.0]), np.zeros(0), (Place(starts, np.zeros(0)),))
    return polish(problem, point, 1e-4, FitSettings())


@pytest.mark.parametrize("expected", [0.02, 0.0])
def test_a_fit_leaves_the_wrong_well(expected):
    stuck = wrong(expected)
    assert np.all(stuck.point.places[0].starts < 0.0)
    found = from_other_starts(stuck, FitSettings())
    assert np.all(found.point.places[0].starts > 0.0)
    assert found.cost < stuck.cost - 50.0
    assert found.chi2 / found.dof == pytest.approx(1.0, abs=0.3)
    assert found.point.theta == pytest.approx([2.0], abs=0.1)


def test_a_minimum_is_kept():
    right = from_other_starts(wrong(0.02), FitSettings())
    assert from_other_starts(right, FitSettings()) is right


def test_one_segment_is_enough():
    problem = wrong(0.02).problem
    whole = segment_record(problem.model, problem.segmented_records[0].record, {"y": Noise(SIGMA)},
                           None, np.array([[0, COUNT - 1]]))  # fmt: skip
    fit = fit_problem(Problem(problem.model, (whole,)))
    assert from_other_starts(fit, FitSettings()).cost <= fit.cost
