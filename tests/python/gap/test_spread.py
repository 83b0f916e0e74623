"""Intervals of sizes and shapes together, against the covariance of the same problem by hand."""

from __future__ import annotations

import numpy as np

from feltmb.fit import Candidate, Effect, LinearModel, Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem, polish
from feltmb.gap import Record
from feltmb.gap.spread import WIDE, spread

SIGMA = 0.01
LINE = LinearModel(
    name="line",
    output="y",
    columns={"slope": lambda record: record.inputs["x"]},
    parameters=[Parameter(name="slope", value=1.0, sd=0.5)],
)


def test_a_fitted_shape_widens_the_interval_of_its_size() -> None:
    """y = a x + s exp(-x / w): size and width trade against each other."""
    x = np.linspace(0.0, 1.0, 200)
    noise = SIGMA * np.random.default_rng(2).standard_normal(200)
    y = 1.1 * x + 0.4 * np.exp(-x / 0.3) + noise
    record = Record(name="run", time=x, inputs={"x": x}, outputs={"y": y})
    effect = Effect(
        name="decay",
        component="line",
        scale=0.1,
        shapes=(0.1, 0.5),
        shape_names=("width [1]",),
        regressor=lambda record, w: np.exp(-record.inputs["x"] / w),
    )
    problem = Problem(LINE, (segment_record(LINE, record, {"y": Noise(SIGMA)}, None),))
    candidate = (Candidate(effect, 0.3),)
    start = fit_problem(problem)
    fit = polish(
        problem.with_candidates(candidate),
        problem.carry(start.point, candidate, np.array([0.4])),
        start.level,
        FitSettings(),
    )
    size = float(fit.point.magnitudes[0])
    decay = np.exp(-x / 0.3)
    columns = np.column_stack([x, decay, size * decay * x / 0.3]) / SIGMA
    matrix = columns.T @ columns + np.diag([1.0 / 0.5**2, 0.0, 1.0 / WIDE**2])
    sd = np.sqrt(np.diag(np.linalg.inv(matrix)))
    found = spread(fit)
    assert np.allclose(np.sqrt(np.diag(found.covariance)), sd[:2], rtol=2e-3)
    assert np.allclose(found.shapes[0, 0], sd[2], rtol=2e-3)
    alone = np.sqrt(fit.covariance[1, 1])
    assert np.sqrt(found.covariance[1, 1]) > 1.3 * alone
